"""Joint fit of several throws: coefficients in common or about a common mean, own
initial states and noise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from curlfit.errors import Option, UnusableFitError
from curlfit.friction import Law, no_motion_because
from curlfit.inference.fit.departures import NO_DEPARTURES, Departures
from curlfit.inference.fit.estimates import Estimate, Systematics
from curlfit.inference.fit.other_rests import (
    MOST_REST_SEARCHES,
    optima_with_other_rests,
)
from curlfit.inference.fit.problems import bounds_of, penalties
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.revisions import revisions
from curlfit.inference.fit.ridge import Ridge
from curlfit.inference.fit.summary import summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.model.priors import Normal
from curlfit.inference.model.problem import problem_shape, shape_of_all
from curlfit.inference.model.request import Request
from curlfit.inference.solve.least_squares import (
    Control,
    Indices,
    Solution,
    Tasks,
    is_lower,
)
from curlfit.inference.together.advice import with_throws
from curlfit.inference.together.alone import ThrowsAlone, fitted_alone
from curlfit.inference.together.draw import Draw
from curlfit.inference.together.effects import Covariates
from curlfit.inference.together.evening import (
    by_prior,
    same_in_all,
    untold_by,
    with_untold,
)
from curlfit.inference.together.population import Together, vary
from curlfit.inference.together.posterior import drawn_for_others, sampled
from curlfit.inference.together.request import VARYING, JointRequest
from curlfit.inference.together.result import DeterminedTogether, JointResult, Variation
from curlfit.inference.together.ridge import JointRidge, follow_jointly
from curlfit.inference.together.solver import (
    BEFORE_VARIATION,
    JOINT,
    Progress,
    minimize_jointly,
)
from curlfit.inference.together.summary import about_mean
from curlfit.inference.together.variation import (
    Varying,
    variations_of,
    weights_of_known,
)
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import at, side_by_side, unstacked
from curlfit.settings.choices import Fitting, takes
from curlfit.throws.throw import Throw

_EstimateOrCombination = TypeVar("_EstimateOrCombination", Estimate, Combination)

_MORE_SEARCHES = 4
"""After one that ended at its limit of 200 steps: 10 tracks without an angle took
up to 133."""


@takes(Fitting, "law", "load")
def fit_together(
    throws: Sequence[Throw],
    law: str | type[Law] | None = None,
    *,
    share: str | Sequence[str] | None = None,
    by: str | Sequence[str] = (),
    trend: str | Sequence[str] = (),
    trend_by: str | Sequence[str] = (),
    load: str | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> JointResult:
    """Fit one law to several throws that share some or all of its coefficients.

    The coefficients of four throws or more vary about their mean: what the throws
    determine has a standard deviation between throws, estimated by restricted maximum
    likelihood, and each throw has its own value. The mean may differ between groups of
    throws and drift.

    The choices hold for all throws; where one is not given, each throw's own applies.
    The prior of a shared parameter counts once.

    Parameters
    ----------
    throws : at least two; each has its own initial state, noise and, if its file
        says so, stone.
    law, load : as in `fit`; the defaults of the throws must agree.
    share : "all" coefficients, or the names of those that are equal in all throws; each
        throw has its own values of the others. Conditions, such as the slope of the
        ice, are always equal.
    by : labels of the throws, such as "sheet", by which they form groups whose
        means differ.
    trend : labels, such as "start", along whose numbers or clock times the means change
        in proportion.
    trend_by : labels of `by`, such as "sheet", whose groups change each in its own
        proportion; otherwise all change alike, and a warning says if they do not.
    seed : of a sample of the posterior of the mean, its effects and the spreads by
        emcee, for their quantiles; none is taken if not given.
    progress : called with the number of steps done and chi squared.
    {choices}

    Raises
    ------
    InputError : as in `fit`; fewer than two throws; a name that is not a coefficient;
        labels that a throw lacks, or that give no groups or numbers.
    UnusableFitError : a throw has no finite path from the initial values found
        from its data.

    Examples
    --------
    >>> joint = curlfit.fit_together([throw, throw])
    >>> joint.converged, joint.share
    (True, ('mu1_xi', 'mu2_xi', 'mu1_eta', 'mu2_eta'))
    """
    choices |= {"law": law, "load": load}
    request = JointRequest.of(
        throws, choices, share=share, by=by, trend=trend, trend_by=trend_by
    )
    return fit_joint_request(request, seed=seed, progress=progress)


def fit_joint_request(
    request: JointRequest,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> JointResult:
    """The joint fit that is requested; the arguments as in `fit_together`.

    Raises
    ------
    UnusableFitError : a throw has no finite path from the initial values found
        from its data.
    """
    first = request.throws[0]
    throws = [of_throw.throw for of_throw in request.throws]
    control = JOINT
    if request.may_vary and _is_evening(request.throws, request.shared):
        control = BEFORE_VARIATION
    together = solved_together(
        request.throws, request.shared, request.covariates, progress, control
    )
    equal = _equal(together, first.systematics, request.untold)
    result = equal.result
    if equal.varying.weights and request.may_vary:
        result = _varying(together, equal, request.untold, seed)
    if not result.converged:  # nothing is told of what was not found
        result = replace(
            result,
            groups=(),
            differences=(),
            trend=(),
            slopes=(),
            slope_differences=(),
        )
    records = tuple(
        replace(record, quantities=quantities_of(record)) for record in result.throws
    )
    odd_rows = dict.fromkeys(odd_row for throw in throws for odd_row in throw.odd_rows)
    result = replace(result, throws=records, odd_rows=tuple(odd_rows))
    return result.with_derived(first.derive)


def _same_in_all(requests: Sequence[Request]) -> set[str]:
    """Coefficients that are the same for all throws, as in draws of an evening."""
    throws = [request.throw for request in requests]
    return set(same_in_all(throws, requests[0].law))


def _is_evening(requests: Sequence[Request], shared: Collection[str]) -> bool:
    """Whether throws are an evening of draws, which with what is usual as a prior is
    near a quadratic."""
    return len(requests) >= VARYING and bool(_same_in_all(requests) & set(shared))


def solved_together(
    requests: Sequence[Request],
    shared: Sequence[str],
    covariates: Covariates,
    progress: Progress | None,
    control: Control = JOINT,
) -> Together:
    """The throws at their optimum with equal values of the shared coefficients.

    Raises
    ------
    UnusableFitError : as in `fit_together`.
    """
    first = requests[0]
    parameters = first.parameters
    common = np.isin(parameters.names, (*shared, *parameters.conditions))
    shape = shape_of_all([problem_shape(request.throw) for request in requests])
    model = Model.of(first)
    stack = ThrowStack(model, requests, shape=shape)
    _, sides = stack.starts()
    starts = [
        request.with_given_start(values)
        for request, values in zip(requests, sides[0], strict=True)
    ]
    tasks = Tasks(
        stack.problems,
        np.stack(starts),
        *bounds_of(requests, common),
        parameters.typical,
        penalties(requests, first=True),
    )
    solution = _lowest(stack, tasks, common, progress, control)
    _require_path(solution, first)

    def optima(throws: Indices) -> Solution:
        solutions: Solution = at(solution, throws)
        return solutions

    for _ in revisions(stack, np.arange(len(requests)), optima):
        tasks = tasks._replace(start=solution.values, penalty=penalties(requests))
        solution = _lowest(stack, tasks, common, progress, control)
        _require_path(solution, first)
    for failure in stack.failures.values():
        raise failure
    return Together(stack, tasks, solution, common, covariates)


def _require_path(solution: Solution, request: Request) -> None:
    """Raise `UnusableFitError` where throws have no path under a law."""
    if not np.isfinite(solution.chi_squared).all():
        raise UnusableFitError(
            f"law {request.law.name} with {request.load} load gives no finite path "
            "for these throws" + no_motion_because(request.load)
        )


def _lowest(
    stack: ThrowStack,
    tasks: Tasks,
    common: Booleans,
    progress: Progress | None,
    control: Control,
) -> Solution:
    """The optimum of throws together, searched on with the rest of stones in other rows
    of a measured spin as long as that leads to lower ones."""
    lowest = _ended(stack.model, tasks, common, progress, control)
    for _ in range(MOST_REST_SEARCHES):
        values = np.array(lowest.values)
        lower = np.where(common, values, tasks.lower)
        upper = np.where(common, values, tasks.upper)
        held = tasks._replace(lower=lower, upper=upper)
        optima = dict(enumerate(unstacked(lowest)))
        others_by_row = optima_with_other_rests(stack, held, optima)
        for row, others in others_by_row.items():
            best = optima[row]
            for other in others:
                best = other if is_lower(other, best) else best
            values[row] = best.values
        if np.array_equal(values, lowest.values):
            break
        tasks = tasks._replace(start=values)
        solution = _ended(stack.model, tasks, common, progress, control)
        if not solution.objective.sum() < lowest.objective.sum():
            break
        lowest = solution._replace(steps=lowest.steps + solution.steps)
    return lowest


def _ended(
    model: Model,
    tasks: Tasks,
    common: Booleans,
    progress: Progress | None,
    control: Control,
) -> Solution:
    """The optimum of throws together; a search at its limit of steps goes on, as along
    a ridge it may have to."""
    solution = minimize_jointly(model, tasks, common, progress, control)
    for _ in range(_MORE_SEARCHES):
        if np.all(solution.success) or not np.isfinite(solution.chi_squared).all():
            break
        steps = solution.steps
        tasks = tasks._replace(start=solution.values)
        solution = minimize_jointly(model, tasks, common, progress, control)
        solution = solution._replace(steps=solution.steps + steps)
    return solution


def _summarized(
    together: Together, solution: Solution, **known: Any
) -> list[FitResult]:
    records = [
        together.stack.record(row, solution_of_throw)
        for row, solution_of_throw in enumerate(unstacked(solution))
    ]
    return summarize_many(records, side_by_side(len(records)), **known)


class _Equal(NamedTuple):
    """Throws with equal shared coefficients."""

    result: JointResult
    varying: Varying
    ridge: JointRidge | None
    """None where chi squared is a quadratic"""
    known: dict[str, Floats]
    """weights of the shared parameters in what the throws determine, by expression"""
    jointly: Floats
    """rows of what each throw tells of the shared parameters that may differ"""


def _equal(
    together: Together,
    given: Mapping[str, float] | None,
    untold: Mapping[str, Normal],
) -> _Equal:
    """The result where the shared coefficients are equal in all throws, with the
    systematic errors due to the `given` conditions."""
    stack, tasks, solution, common, _ = together
    parameters = stack.requests[0].parameters
    shared = tuple(parameters.names_where(common))
    same_names = _same_in_all(stack.requests)
    same = np.isin(shared, [*same_names])
    is_evening = _is_evening(stack.requests, shared)
    throws, ridge = _throws_and_ridge(together, given, quadratic=is_evening)
    first = throws[0]
    coefficients = {name: first.parameters[name] for name in shared}
    marginal = together.information(solution).marginal(common)
    verdicts, combinations = _said_of_shared(
        together, marginal.information, first, same, ridge
    )
    known = weights_of_known(verdicts, combinations, shared)
    weights = {
        expression: of_sum
        for expression, of_sum in known.items()
        if not of_sum[same].any()
    }

    # how throws differ in what they determine together
    jointly = marginal.information.slopes * (tasks.free[0, common] & ~same)
    best = dict(zip(shared, solution.values[0, common].tolist(), strict=True))
    variations = _variations(together, best, untold, weights, jointly)
    names_of_law = [coefficient.name for coefficient in stack.model.law.coefficients()]
    of_law = np.isin(shared, names_of_law)
    may_vary = {
        expression: of_sum
        for expression, of_sum in weights.items()
        if not of_sum[~of_law].any()
    }
    varying = Varying.of(jointly, may_vary, variations, tasks.typical[common])
    differing = {
        expression: variation
        for expression, variation in variations.items()
        if variation.significant
    }

    expressions = {
        *shared,
        *(combination.expression for combination in combinations),
    }
    result = JointResult(
        law=first.law,
        load=first.load,
        share=shared,
        converged=False,
        status="",
        warnings=(),
        coefficients={
            name: _with_shared_error(estimate, differing.get(name))
            for name, estimate in coefficients.items()
        },
        combinations=tuple(
            _with_shared_error(combination, differing.get(combination.expression))
            for combination in combinations
        ),
        identifiability=_determined_together(throws, marginal),
        variation=tuple(variations.values()),
        systematics=_about(first.systematics, expressions),
    )
    result = with_throws(result, throws, solution)
    return _Equal(result, varying, ridge, weights, jointly)


def _said_of_shared(
    together: Together,
    of_shared: Information,
    first: FitResult,
    same: Booleans,
    ridge: JointRidge | None,
) -> tuple[dict[str, Verdict], tuple[Combination, ...]]:
    """Verdicts of the shared parameters, by name, and their combinations: those in the
    record of the first throw and, with priors, what the data say without them.

    Parameters
    ----------
    of_shared : what all throws say of the shared parameters, shape (p, p + 1).
    same : which of these have one value by assumption, shape (p,).
    """
    parameters = together.stack.requests[0].parameters
    shared = parameters.names_where(together.common)
    coefficients = {name: first.parameters[name] for name in shared}
    verdicts = {name: estimate.verdict for name, estimate in coefficients.items()}
    combinations = [
        combination
        for combination in first.combinations
        if set(combination.weights) <= set(shared)
    ]
    if same.all() or not together.tasks.penalty.informative:
        return verdicts, tuple(combinations)
    by_data = Covariance.of(of_shared.together().held(same))
    departures = NO_DEPARTURES if ridge is None else ridge.departures(by_data)
    not_varying = {*np.array(shared)[same].tolist(), *parameters.fixed}
    verdicts |= _verdicts_by_data(by_data, departures, coefficients, not_varying)
    by_expression = {
        combination.expression: combination
        for combination in (*departures.kept(by_data.combinations), *combinations)
    }
    return verdicts, tuple(by_expression.values())


def _variations(
    together: Together,
    shared: Mapping[str, float],
    untold: Mapping[str, Normal],
    known: Mapping[str, Floats],
    jointly: Floats,
) -> dict[str, Variation]:
    """How what is `known` varies between throws that are fitted by themselves, where
    what is the same in all, and what a throw does not tell, has its `shared` value."""
    law = together.stack.model.law
    throws = [request.throw for request in together.stack.requests]
    usual = {name: prior.mean for name, prior in untold.items()}
    same_names = {*same_in_all(throws, law)}
    held_by_throw = []
    for throw in throws:
        names = (same_names | untold_by(throw, law)) & shared.keys()
        held_by_throw.append({name: shared[name] for name in names} | usual)
    alone = ThrowsAlone.of_fits(fitted_alone(together, held_by_throw), [*shared])
    return variations_of(alone, jointly, known, together.covariates.values)


def _throws_and_ridge(
    together: Together, given: Mapping[str, float] | None, *, quadratic: bool
) -> tuple[list[FitResult], JointRidge | None]:
    """The records of throws with equal shared coefficients, and the ridge that all have
    together; None where chi squared is a quadratic, or is taken for one."""
    stack = together.stack
    followed: list[JointRidge] = []

    def ridges(stderr: dict[int, float]) -> list[Ridge]:
        followed.append(follow_jointly(together, together.solution, stderr))
        return followed[-1].of_throws

    throws = _summarized(
        together,
        together.solution,
        widths=widths_of(stack.model, given, stack.requests, jointly=True),
        common=together.common,
        ridges=None if quadratic else ridges,
    )
    return throws, followed[-1] if followed else None


def _determined_together(
    throws: Sequence[FitResult], marginal: Marginal
) -> DeterminedTogether:
    """How much throws determine of what they have in common, which counts once, and of
    their own parameters."""
    first = throws[0]
    in_common = set(marginal.information.names)
    own_of_throws = sum(
        name not in in_common for throw in throws for name in throw.covariance.names
    )
    common = sum(name in in_common for name in first.covariance.names)
    return DeterminedTogether(
        rank=int(first.identifiability.rank + marginal.rank[1:].sum()),
        parameters=common + own_of_throws,
    )


def _verdicts_by_data(
    by_data: Covariance,
    departures: Departures,
    coefficients: Mapping[str, Estimate],
    not_varying: Collection[str],
) -> dict[str, Verdict]:
    """Verdicts of the coefficients that may vary without the priors, since what varies
    is what the throws themselves determine."""
    verdicts = {}
    for row, (name, estimate) in enumerate(coefficients.items()):
        if name not in not_varying:
            stderr, verdict, _ = by_data.classified(row)
            _, verdicts[name], _ = departures.judged(
                name, stderr, verdict, estimate.typical
            )
    return verdicts


def _with_shared_error(
    shared: _EstimateOrCombination, variation: Variation | None
) -> _EstimateOrCombination:
    """A shared estimate; with the variation of throws that differ in it, its error is
    that of the mean over them."""
    if variation is None:
        return shared
    throws = sum(of_throw is not None for of_throw in variation.each)
    return replace(shared, stderr=variation.shared_stderr, dof=float(throws - 1))


def _varying(
    together: Together,
    equal: _Equal,
    untold: Mapping[str, Normal],
    seed: int | None,
) -> JointResult:
    """The result where what the throws determine varies about its mean, which is as
    free along the ridge as equal coefficients are."""
    weights, guess = equal.varying
    stack = together.stack
    try:
        population, solution, others = vary(together, weights, guess, untold)
    except np.linalg.LinAlgError:
        raise UnusableFitError(
            "how these throws vary cannot be estimated: their coefficients become "
            f"unbounded; fix some of them, or fit with {Option('share', 'all')}"
        ) from None
    equal_throws = equal.result
    is_evening = not any(request.throw.has_path for request in stack.requests)
    if is_evening:
        mean = dict(zip(equal.result.share, population.mean.tolist(), strict=True))
        variations = _variations(together, mean, untold, equal.known, equal.jointly)
        equal_throws = replace(equal_throws, variation=tuple(variations.values()))
    draws = of_others = None
    if np.all(solution.success):
        draws = sampled(population.fit, guess, seed)
        # tracks know their coefficients better than these vary: Student's t is exact
        if is_evening:
            of_others = drawn_for_others(population.fit, guess, draws)
    throws = [
        replace(
            with_untold(throw, untold),
            systematics=_about(
                of_equal.systematics, of_equal.systematics.shifts.keys() - untold.keys()
            ),
        )
        for throw, of_equal in zip(
            _summarized(together, solution, others=others),
            equal_throws.throws,
            strict=True,
        )
    ]
    spins = np.array([throw.parameters["omega0"].value for throw in throws])
    result = about_mean(
        equal_throws,
        population,
        together.covariates,
        Draw(stack.model, stack.requests[0].stone),
        (solution.values[:, together.common], spins),
        draws,
        equal.ridge,
        of_others=of_others,
    )
    moved = result.systematics.shifts.keys() - untold.keys()
    result = replace(
        result,
        coefficients=by_prior(result.coefficients, untold),
        systematics=_about(result.systematics, moved),
    )
    return with_throws(result, throws, solution)


def _about(systematics: Systematics, names: Collection[str]) -> Systematics:
    """Systematic errors of some parameters and combinations alone."""
    shifts = {
        name: by_condition
        for name, by_condition in systematics.shifts.items()
        if name in names
    }
    return replace(systematics, shifts=shifts)
