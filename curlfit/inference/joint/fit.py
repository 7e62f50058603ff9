"""Joint fit of several throws: coefficients in common or about a common mean, own initial states
and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from curlfit.errors import InputError, UnusableFitError, require_kind
from curlfit.foreign import quoted
from curlfit.friction import Law, find_law, no_motion_because
from curlfit.inference.derived import check_derived
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.factors import Reduction
from curlfit.inference.fit.prepared import PreparedThrow, local_bounds, penalties
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import IMPLAUSIBLE, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.identifiability import Bounded, Combination, r_factors
from curlfit.inference.joint.draw import Draw
from curlfit.inference.joint.effects import Covariates
from curlfit.inference.joint.population import pool, told_by_all
from curlfit.inference.joint.posterior import sampled
from curlfit.inference.joint.result import JointResult, Variation
from curlfit.inference.joint.solver import Progress, minimize_jointly
from curlfit.inference.joint.summary import varying_fields
from curlfit.inference.joint.variation import each_alone, told_by_each, variations_of, wanted_of
from curlfit.inference.least_squares import Solution, Tasks
from curlfit.inference.model import Model
from curlfit.inference.problem import problem_shape
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import unstacked
from curlfit.output.text import join_words
from curlfit.settings.choices import Fitting, takes
from curlfit.throws.throw import Throw, require_throw

_NAMED = 3  # throws whose files a warning of several names
_VARYING = 4  # throws from which on their coefficients may vary
_FEWEST = 3  # throws that determine what varies


@takes(Fitting, "law", "load")
def fit_together(
    throws: Sequence[Throw],
    law: str | type[Law] | None = None,
    *,
    share: str | Sequence[str] | None = None,
    by: str | Sequence[str] = (),
    trend: str | Sequence[str] = (),
    load: str | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> JointResult:
    """Fit one law to several throws that share some or all of its coefficients.

    The coefficients of four throws or more vary about their mean: what the throws determine has a
    standard deviation between throws, estimated by restricted maximum likelihood, and each throw
    has its own value. The mean may differ between groups of throws and drift.

    The choices hold for all throws; where one is not given, each throw's own applies. The prior of
    a shared parameter counts once.

    Parameters
    ----------
    throws : at least two; each has its own initial state, noise and, if its file says so, stone.
    law, load : as in `fit`; the defaults of the throws must agree.
    share : "all" coefficients, or the names of those that are equal in all throws; each throw has
        its own values of the others. Conditions, such as the slope of the ice, are always equal.
    by : labels of the throws, such as "sheet", by which they form groups whose means differ.
    trend : labels, such as "start", along whose numbers or clock times the means change in
        proportion.
    seed : of a sample of the posterior of the mean, its effects and the spreads by emcee, for their
        quantiles; none is taken if not given.
    progress : called with the number of steps done and chi squared.
    {choices}

    Raises
    ------
    InputError : as in `fit`; fewer than two throws; a name that is not a coefficient; labels that
        a throw lacks, or that give no groups or numbers.
    UnusableFitError : a throw has no finite path from the initial values found from its data.

    Examples
    --------
    >>> joint = curlfit.fit_together([throw, throw])
    >>> joint.converged, joint.share
    (True, ('mu1_xi', 'mu2_xi', 'mu1_eta', 'mu2_eta'))
    """
    require_kind(throws, Sequence, "throws", "a list of throws")
    for throw in throws:
        require_throw(throw)
    if len(throws) < 2:
        raise InputError(f"{len(throws)} throw to fit together; expected two or more")
    law = find_law(_common(throws, "law", "front-back") if law is None else law)
    load = _common(throws, "load", "uniform") if load is None else load
    given = {**choices, "law": law, "load": load}
    chosen = [Fitting.of(throw.settings, **given) for throw in throws]
    first = chosen[0]
    shared = _shared(law, share or "all")
    labels = [(throw.name, throw.labels) for throw in throws]
    covariates = Covariates.of(labels, by, trend)
    varies = bool(by or trend) or (share is None and len(throws) >= _VARYING)
    if first.loss != "linear" and varies:
        if by or trend:
            raise InputError("by, trend: groups and trends are estimated with loss linear")
        varies = False
    if (by or trend) and set(shared) != {item.name for item in law.coefficients()}:
        raise InputError("share: with groups or trends, all coefficients have a mean")
    check_derived(first.derive, [item.name for item in law.coefficients()])
    any_swept = any(one.swept is not None for one in chosen)
    prepared = [
        PreparedThrow.of(throw, one, others_swept=any_swept)
        for throw, one in zip(throws, chosen, strict=True)
    ]
    parameters = prepared[0].parameters
    shared = (*shared, *parameters.conditions)
    common = np.isin(parameters.names, shared)
    channels, rows = zip(*(problem_shape(one.throw) for one in prepared), strict=True)
    shape = max(channels), max(rows)
    model = Model(law, first.load, parameters.conditions)
    rounds = Rounds(model, prepared, loss=first.loss, noise=first.noise, shape=shape)
    starts = [
        one.with_start(values, first.start)
        for one, values in zip(prepared, rounds.starts()[1][0], strict=True)
    ]
    tasks = Tasks(
        rounds.problems, np.stack(starts), *local_bounds(prepared, common)[1:], parameters.typical,
        penalties(prepared, first=True),
    )  # fmt: skip
    solution = minimize_jointly(model, tasks, common, progress)
    every = np.arange(len(prepared))
    while np.isfinite(solution.chi_squared).all() and len(rounds.revise(every, solution)):
        tasks = tasks._replace(start=solution.values, penalty=penalties(prepared))
        solution = minimize_jointly(model, tasks, common, progress)
    for failure in rounds.failures.values():
        raise failure
    if not np.isfinite(solution.chi_squared).all():
        raise UnusableFitError(
            f"law {law.name} with {first.load} load gives no finite path for these throws"
            + no_motion_because(first.load)
        )
    widths = widths_of(model, first.systematics, prepared, jointly=True)
    result, weights = _equal(rounds, tasks, solution, common, widths, covariates.values)
    if varies and weights:
        result = _varying(result, rounds, tasks, solution, common, weights, covariates, seed)
    each = tuple(replace(one, quantities=quantities_of(one)) for one in result.throws)
    return replace(result, throws=each).with_derived(first.derive)


def _differs_by_spin(item: Variation, counter_clockwise: Booleans) -> bool:
    """Whether throws of the same sense of spin agree much better than all throws do."""
    known = np.array([one is not None for one in item.each])
    value, error = np.array([one for one in item.each if one is not None]).T
    sense = counter_clockwise[known]

    def chi_squared(rows: Booleans) -> float:
        if not rows.any():
            return 0.0
        mean = np.average(value[rows], weights=error[rows] ** -2)
        return float((((value[rows] - mean) / error[rows]) ** 2).sum())

    within = chi_squared(sense) + chi_squared(~sense)
    return within < chi_squared(np.ones_like(sense)) / 2


def _common(throws: Sequence[Throw], name: str, default: str) -> str:
    """The law or load that the throws state. Raises `InputError` where they differ."""
    first = throws[0].defaults.get(name, default)
    for throw in throws:
        own = throw.defaults.get(name, default)
        if own != first:
            raise InputError(
                f"{throws[0].name} and {throw.name} state different values of {name}, {first} and "
                f"{own}; give the one for this fit"
            )
    return str(first)


def _shared(law: type[Law], share: str | Sequence[str]) -> tuple[str, ...]:
    """Names of the shared coefficients. Raises `InputError` for one that the law does not have."""
    own = tuple(item.name for item in law.coefficients())
    shared = own if share == "all" else (share,) if isinstance(share, str) else tuple(share)
    for name in shared:
        if name not in own:
            raise InputError(
                f"share: law {law.name} has no coefficient {quoted(name)}; it has {', '.join(own)}"
            )
    return shared


def _equal(
    rounds: Rounds,
    tasks: Tasks,
    solution: Solution,
    common: Booleans,
    widths: Mapping[str, float],
    covariates: Floats,
) -> tuple[JointResult, dict[str, Floats]]:
    """The result where the shared coefficients are equal in all throws, and the weights of the
    parameters in what may vary."""
    fits = [rounds.record(row, one) for row, one in enumerate(unstacked(solution))]
    throws = summarize_many(fits, widths=widths, common=common)
    status = _status(throws, solution)
    throws = _with_status(throws, status)
    first, parameters = throws[0], rounds.throws[0].parameters
    shared = tuple(parameters.names_where(common))
    coefficients = {name: first.parameters[name] for name in shared}
    combinations = tuple(item for item in first.combinations if set(item.weights) <= set(shared))
    plain = rounds.loss == "linear" and rounds.noises[0].kind == "white"
    factors = r_factors(solution.jacobian, solution.residual)
    bounded = Bounded(solution.values, tasks.lower, tasks.upper)
    reduction = Reduction.of(factors, bounded, tasks.typical, common)
    verdicts = {name: one.verdict for name, one in coefficients.items()}
    if tasks.penalty is not None:  # what varies is what the throws themselves determine
        rows = reduction.rows[..., np.append(common, True)].reshape(-1, len(shared) + 1)
        at = Bounded(*(part[0, common] for part in bounded))
        alone = told_by_all(shared, rows, at, tasks.typical[common])
        verdicts = {
            name: known if known == "fixed" else alone.classified(row)[1]
            for row, (name, known) in enumerate(verdicts.items())
        }
        known = {item.expression: item for item in (*alone.combinations, *combinations)}
        combinations = tuple(known.values())
    by_name = wanted_of(verdicts, combinations)
    weights = {
        name: np.array([own.get(one, 0.0) for one in parameters.names])
        for name, own in by_name.items()
    }
    variation = variations_of(
        each_alone(solution, tasks, rounds.unknown & plain), tasks.upper > tasks.lower,
        solution.values[0], weights, tasks.typical, covariates,
    )  # fmt: skip
    among = {item.expression: item for item in variation if item.significant}
    open_ = np.array([np.isin(parameters.names, one.covariance["names"]) for one in throws])
    named = {*shared, *(item.expression for item in combinations)}
    result = JointResult(
        law=rounds.model.law.name,
        load=rounds.model.load,
        share=shared,
        converged=all(one.converged for one in throws),
        status=_implausible_ones(throws) or status,
        warnings=(
            *_spin_warnings(variation, throws, rounds),
            *_equality_warnings(variation),
            *_throw_warnings(throws),
        ),
        coefficients={name: _among(item, among.get(name)) for name, item in coefficients.items()},
        combinations=tuple(_among(item, among.get(item.expression)) for item in combinations),
        rank=int(first.rank + reduction.rank[1:].sum()),
        parameters=int(open_[0, common].sum() + open_[:, ~common].sum()),
        variation=variation,
        throws=tuple(throws),
        systematics=replace(
            first.systematics,
            shifts={name: by for name, by in first.systematics.shifts.items() if name in named},
        ),
    )
    of_law = [item.name for item in rounds.model.law.coefficients()]
    told = {one.expression for one in variation if sum(map(bool, one.each)) >= _FEWEST}
    return result, told_by_each(
        reduction.rows[..., :-1], tasks.typical * (tasks.upper > tasks.lower)[0],
        {name: own for name, own in weights.items()
         if name in told and by_name[name].keys() <= set(of_law)},
    )  # fmt: skip


def _varying(
    result: JointResult,
    rounds: Rounds,
    tasks: Tasks,
    solution: Solution,
    common: Booleans,
    weights: dict[str, Floats],
    covariates: Covariates,
    seed: int | None,
) -> JointResult:
    """The result where what the throws determine varies about its mean."""
    variation = {one.expression: one for one in result.variation}
    guess = np.array([variation[name].first_spread for name in weights])
    found, solution, others = pool(
        rounds, tasks, solution, common, weights, guess, covariates.values
    )
    fits = [rounds.record(row, one) for row, one in enumerate(unstacked(solution))]
    throws = [
        replace(one, systematics=before.systematics)
        for one, before in zip(summarize_many(fits, others=others), result.throws, strict=True)
    ]
    status = _status(throws, solution)
    throws = _with_status(throws, status)
    fields = varying_fields(
        found, result.coefficients, result.combinations, result.variation, covariates,
        (tasks.lower[0, common], tasks.upper[0, common]),
        Draw(rounds.model, rounds.throws[0].stone), solution.values[:, common],
        np.array([one.parameters["omega0"].value for one in throws]),
        sampled(found.fit, guess, seed),
    )  # fmt: skip
    return replace(
        result,
        **fields,
        converged=all(one.converged for one in throws),
        status=_implausible_ones(throws) or status,
        warnings=(*_spin_warnings(result.variation, throws, rounds), *_throw_warnings(throws)),
        throws=tuple(throws),
    )


def _with_status(throws: Sequence[FitResult], status: str) -> list[FitResult]:
    """The throws, with the status of all if that is no success."""
    if status.startswith("converged"):
        return [*throws]
    return [
        one if _implausible(one) else replace(one, converged=False, status=status) for one in throws
    ]


def _implausible_ones(throws: Sequence[FitResult]) -> str:
    return ". ".join(f"{one.data['file']}: {one.status}" for one in throws if _implausible(one))


def _throw_warnings(throws: Sequence[FitResult]) -> list[str]:
    return [*curl_warnings(throws), *_warnings_of(throws)]


def _status(throws: Sequence[FitResult], solution: Solution) -> str:
    """How the search for the optimum of all throws ended."""
    ends = (one.status for one in throws if not (one.converged or _implausible(one)))
    converged = "converged" if solution.success.all() else "not converged"
    return next(ends, f"{converged} ({solution.steps[0]} steps)")


def _implausible(fit: FitResult) -> bool:
    return fit.status.startswith(IMPLAUSIBLE)


def _warnings_of(throws: Sequence[FitResult]) -> list[str]:
    """Warnings of single throws; of several with the same, one."""
    files: dict[str, list[str]] = {}
    for one in throws:
        for warning in one.warnings:
            files.setdefault(warning, []).append(one.data["file"])
    found = []
    for warning, some in files.items():
        named = (
            some if len(some) <= _NAMED else [*some[: _NAMED - 1], f"{len(some) - _NAMED + 1} more"]
        )
        found.append(warning if len(some) == len(throws) else f"{join_words(named)}: {warning}")
    return found


_Shared = TypeVar("_Shared", Estimate, Combination)


def _among(item: _Shared, difference: Variation | None) -> _Shared:
    """A shared estimate with its error as that of the mean over throws that differ in it."""
    if difference is None:
        return item
    throws = sum(one is not None for one in difference.each)
    return replace(item, stderr=difference.shared_stderr, dof=float(throws - 1))


def _spin_warnings(
    variation: Sequence[Variation], throws: Sequence[FitResult], rounds: Rounds
) -> list[str]:
    """A warning if throws of opposite spins differ."""
    # For a throw without a path the curl is at most one number, which the heading absorbs.
    paths = any(one.throw.has_path for one in rounds.throws)
    senses = np.array([one.parameters["omega0"].value > 0 for one in throws])
    differ = any(_differs_by_spin(item, senses) for item in variation if item.significant)
    if not differ or not paths or rounds.model.has_slope:
        return []
    return [
        "throws of opposite spins differ, as they do on ice that is not level; `--free slope_x` "
        "fits a common slope"
    ]


def _equality_warnings(variation: Sequence[Variation]) -> list[str]:
    """Warnings about equal coefficients that differ from throw to throw."""
    return [
        f"{item.expression} varies between throws by more than its errors ({item.p_text}); "
        "its standard error is that of the mean over such throws, and large residuals of single "
        "throws may be due to the common value rather than to their data"
        for item in reversed(variation)
        if item.significant
    ]
