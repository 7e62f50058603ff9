"""Least-squares fits from data to result, of one throw or of many side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, NetLaw, find_law, no_motion_because
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.advice import remedies, with_curl_warning, with_noise_advice
from curlfit.inference.fit.change_points import may_have_changed, with_change
from curlfit.inference.fit.entries import RefitWithStone
from curlfit.inference.fit.other_rests import starts_with_other_rests
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of, penalties
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import summarize, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.initial_values import SmoothPath, usual_where_astray
from curlfit.inference.least_squares import (
    Indices,
    Solution,
    Tasks,
    best_first,
    fits_equally,
    needs_restart,
    optima,
    prepare_minimize,
    starts_to_try,
)
from curlfit.inference.likelihood import prepare_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import problem_shape
from curlfit.inference.request import Request
from curlfit.losses import LOSSES, loss_at
from curlfit.noises import Noise
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH, side_by_side, stacked, unstacked
from curlfit.settings.choices import Fitting, takes
from curlfit.throws.throw import Reference, Throw, require_throw

_MOST_REST_SEARCHES = 20  # each moves the rest by up to eight rows
_ROWS = 2 * BATCH * 256  # of throws that are fitted together, to limit memory


@takes(Fitting, "law")
def fit(
    throw: Throw,
    law: str | type[Law] | None = None,
    *,
    details: bool = True,
    **choices: Any,
) -> FitResult:
    """Fit a friction law and the initial state of the throw to a measured path by
    least squares.

    Parameters
    ----------
    throw : the data. Its own settings (such as `until`, `stone`, `law`) apply where an
        argument is not given.
    details : whether to compute also the quantities of the path, the fits with
        the stones of the throw's reference, and what would determine more
        parameters (`remedies`).
    {choices}

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged, and whose
    `warnings` say why it may mislead.

    Raises
    ------
    InputError : an unknown law, load, loss, noise or parameter name; too few rows; a
        stone that never moves.
    UnusableFitError : no initial values led to a finite fit.

    Examples
    --------
    >>> fit = curlfit.fit(throw, "front-back")
    >>> fit.converged, round(fit["mu2_xi"].value, 4)
    (True, 0.0556)
    >>> fit["mu1_eta"].verdict
    'not identifiable'
    """
    require_throw(throw)
    chosen = Fitting.of(throw.settings, law=law, **choices)
    return fit_request(Request.of(throw, chosen), details=details)


def fit_request(
    request: Request, *, details: bool = True, family: type[LawFamily] | None = None
) -> FitResult:
    """The fit that is requested.

    Parameters
    ----------
    details : as in `fit`.
    family : of laws that are fitted to the same throw, including this one: they are
        compiled as one program.

    Raises
    ------
    UnusableFitError : no initial values led to a finite fit.
    """
    result = _fit(request, details=details, family=family)
    return result.with_derived(request.derive) if request.derive else result


def _fit(
    request: Request, *, details: bool, family: type[LawFamily] | None
) -> FitResult:
    model = Model.of(request, family)
    outcome = _fitted_alone(Rounds(model, [request]))
    result = summarize(outcome, widths_of(model, request.systematics, [request]))
    if not result.converged:
        return result
    if may_have_changed(outcome, result):
        explained = with_change(outcome, result)
        if explained is result and details and not result.events:
            explained = with_noise_advice(result, refit)
        result = explained
    if not details:
        return result
    result = replace(with_curl_warning(result), quantities=quantities_of(result))
    if result.reference is not None:
        reference_fits = _reference_fits(outcome, result, result.reference)
        result = replace(result, reference_fits=reference_fits)
    not_determined = [
        name for name, estimate in result.parameters.items() if estimate.verdict.is_open
    ]
    if not_determined:
        measurements = remedies(outcome, not_determined, request.held)
        result = replace(result, remedies=measurements)
    return result


def refit(fit: FitResult, noise: Noise) -> FitResult:
    """Repeat a fit under another noise model, starting from its optimum."""
    request = Request(
        throw=fit.throw,
        law=fit.law_class,
        load=fit.load,
        stone=fit.stone,
        parameters=fit.parameter_set,
        loss=LOSSES[fit.loss],
        noise=noise,
        rows={name: fit.data[name] for name in ("since", "until", "exclude")},
        swept=fit.data.swept,
        start=fit.parameter_set.values_of(fit.values),
    )
    return summarize(_fitted_alone(Rounds(fit.model, [request])))


def _fitted_alone(rounds: Rounds) -> LeastSquaresFit:
    """Fit the only throw of some rounds."""
    (outcome,) = fitted(rounds)
    if isinstance(outcome, CurlfitError):
        raise outcome
    return outcome


def fitted(rounds: Rounds) -> list[LeastSquaresFit | CurlfitError]:
    """Fits of throws side by side; an error takes the place of one that fails."""
    model = rounds.model
    requests = rounds.requests
    if rounds.batch == 1:
        # Programs are compiled while the initial values are computed.
        (problem,) = unstacked(rounds.problems)
        prepare_minimize(model, requests[0].parameters, problem)
        prepare_channels(model, len(requests[0].parameters), problem)
    lower, upper = bounds_of(requests)
    paths, sides = rounds.starts()
    # Rounds revise these problems in place.
    tasks = Tasks(
        rounds.problems,
        sides[0],
        lower,
        upper,
        requests[0].parameters.typical,
        penalties(requests, first=True),
    )
    tried = _tried(rounds, tasks, paths, sides)
    optima_by_throw = [_best_and_rival(solutions) for solutions in tried]
    _search_other_rests(rounds, tasks, optima_by_throw)
    tasks = tasks._replace(penalty=penalties(requests))
    due = np.flatnonzero([len(optima_of_throw) for optima_of_throw in optima_by_throw])
    while len(due):
        best = stacked([optima_by_throw[row][0] for row in due])
        due = rounds.revise(due, best)
        if not len(due):
            break
        _solve_again(rounds, tasks, optima_by_throw, due)
        _search_other_rests(rounds, tasks, optima_by_throw)
    _settle(rounds, tasks, optima_by_throw)
    _add_usual(rounds, tasks, optima_by_throw)
    return [
        rounds.failures.get(row) or _outcome(rounds, row, optima_of_throw, tried[row])
        for row, optima_of_throw in enumerate(optima_by_throw)
    ]


def _tried(
    rounds: Rounds,
    tasks: Tasks,
    paths: SmoothPath,
    sides: Floats,
) -> list[list[Solution]]:
    """What is reached from the initial values of each throw: from those that may fit
    equally, and from all others where the best of these is poor.

    Parameters
    ----------
    paths, sides : from `Rounds.starts`.
    """
    model = rounds.model
    first_starts = []
    other_starts = []
    for row, request in enumerate(rounds.requests):
        bounds = tasks.lower[row], tasks.upper[row]
        first, others = starts_to_try(model.law, sides[:, row], bounds, tasks.typical)
        if request.start:
            given = request.with_given_start(first[0])
            if len(first) == 1:
                others = first + others
                first = [given]
            else:
                first = [given, *first]
        first_starts.append(first)
        other_starts.append(others)
    tried = optima(model, tasks, first_starts, rounds.batch)
    best = stacked([(best_first(solutions) or solutions)[0] for solutions in tried])
    # If the first optimum is poor, all are tried: a later one may be local
    # and look good.
    poor = needs_restart(best, paths, rounds.problems)
    starts = [
        others if is_poor else []
        for others, is_poor in zip(other_starts, poor, strict=True)
    ]
    reached = optima(model, tasks, starts, rounds.batch)
    return [before + later for before, later in zip(tried, reached, strict=True)]


def _best_and_rival(solutions: Iterable[Solution]) -> list[Solution]:
    """The best of the optima of a throw, and the first other one that fits equally, if
    there is one; empty where none is finite."""
    best_and_others = best_first(solutions)
    if not best_and_others:
        return []
    best, *others = best_and_others
    rivals = [other for other in others if fits_equally(best, other)]
    return [best, *rivals[:1]]


def _solve_again(
    rounds: Rounds,
    tasks: Tasks,
    optima_by_throw: Sequence[list[Solution]],
    due: Indices,
) -> None:
    """Solve the revised problems of throws that are due, from their optima, which stay
    where a path then is not finite."""
    starts: list[list[Floats]] = [[] for _ in optima_by_throw]
    for row in due:
        starts[row] = [optimum.values for optimum in optima_by_throw[row]]
    reached = optima(rounds.model, tasks, starts, rounds.batch)
    for optima_of_throw, refits in zip(optima_by_throw, reached, strict=True):
        for number, refitted in enumerate(refits):
            if np.isfinite(refitted.chi_squared):
                optima_of_throw[number] = refitted


def _search_other_rests(
    rounds: Rounds, tasks: Tasks, optima_by_throw: Sequence[list[Solution]]
) -> None:
    """Search on with the rest of the stone in other rows of a measured spin, as long as
    that leads to lower optima. Under a robust loss, and with correlated noise, the rest
    stays in the row where least squares have found it."""
    if tasks.problems.spins is None or not issubclass(rounds.model.law, NetLaw):
        return
    problems = unstacked(tasks.problems)
    due = [
        row
        for row, optima_of_throw in enumerate(optima_by_throw)
        if optima_of_throw
        and not loss_at(tasks.problems.loss[row]).is_robust
        and not rounds.noises[row].sizes
    ]
    for _ in range(_MOST_REST_SEARCHES):
        starts: list[list[Floats]] = [[] for _ in optima_by_throw]
        for row in due:
            starts[row] = starts_with_other_rests(
                rounds.model,
                optima_by_throw[row][0],
                problems[row],
                tasks.lower[row],
                tasks.upper[row],
                tasks.typical,
            )
        if not any(starts):
            return
        reached = optima(rounds.model, tasks, starts, rounds.batch)
        due = []
        for row, optima_of_throw in enumerate(optima_by_throw):
            if reached[row]:
                before = optima_of_throw[0]
                optima_of_throw[:] = _best_and_rival([*optima_of_throw, *reached[row]])
                if optima_of_throw[0] is not before:
                    due.append(row)


def _settle(
    rounds: Rounds, tasks: Tasks, optima_by_throw: Sequence[list[Solution]]
) -> None:
    """End searches that have not ended, since along some direction chi squared is level
    or has no slope (the spin, of a stone that hardly spins): the parameter that takes
    part in it most is held, and the others are refitted."""
    lower = np.array(tasks.lower)
    upper = np.array(tasks.upper)
    starts: list[list[Floats]] = [[] for _ in optima_by_throw]
    for row, optima_of_throw in enumerate(optima_by_throw):
        if not optima_of_throw or optima_of_throw[0].success:
            continue
        best = optima_of_throw[0]
        free = np.flatnonzero(upper[row] > lower[row])
        slopes = best.jacobian.reshape(-1, len(tasks.typical)) * tasks.typical
        # The last direction is that in which the residuals change least.
        _, _, directions = np.linalg.svd(slopes[:, free], full_matrices=False)
        levellest = free[np.abs(directions[-1]).argmax()]
        lower[row, levellest] = best.values[levellest]
        upper[row, levellest] = best.values[levellest]
        starts[row] = [best.values]
    held = tasks._replace(lower=lower, upper=upper)
    settled = optima(rounds.model, held, starts, rounds.batch)
    for optima_of_throw, ends in zip(optima_by_throw, settled, strict=True):
        if ends and ends[0].objective <= optima_of_throw[0].objective:
            optima_of_throw[0] = ends[0]


def _add_usual(
    rounds: Rounds, tasks: Tasks, optima_by_throw: Sequence[list[Solution]]
) -> None:
    """Where coefficients went astray, add the optimum with their defaults, which may
    fit equally: about the first, where they hardly act, the others seem better
    determined than they are."""
    lower = np.array(tasks.lower)
    upper = np.array(tasks.upper)
    starts: list[list[Floats]] = [[] for _ in optima_by_throw]
    for row, optima_of_throw in enumerate(optima_by_throw):
        if not optima_of_throw:
            continue
        best = optima_of_throw[0]
        usual = usual_where_astray(rounds.model.law, best.values, tasks.typical)
        astray = np.isfinite(usual) & (upper[row] > lower[row])
        if astray.any():
            starts[row] = [np.where(astray, usual, best.values)]
            lower[row, astray] = usual[astray]
            upper[row, astray] = usual[astray]
    held = tasks._replace(lower=lower, upper=upper)
    reached = optima(rounds.model, held, starts, rounds.batch)
    for optima_of_throw, usual_optima in zip(optima_by_throw, reached, strict=True):
        optima_of_throw += usual_optima


def _outcome(
    rounds: Rounds,
    row: int,
    optima_of_throw: Sequence[Solution],
    tried: Sequence[Solution],
) -> LeastSquaresFit | CurlfitError:
    """The fit of a throw from its optimum, and one that may fit equally; an error where
    none of those tried is finite."""
    if not optima_of_throw:
        model = rounds.model
        return UnusableFitError(
            f"{rounds.requests[row].throw.name}: law {model.law.name} with "
            f"{model.load} load gives no finite "
            "path from any start" + no_motion_because(model.load)
        )
    best, *others = optima_of_throw
    rivals = [other for other in others if fits_equally(best, other)]
    rival = rivals[0] if rivals else None
    return rounds.record(row, best, len(tried), rival)


def _reference_fits(
    outcome: LeastSquaresFit, result: FitResult, reference: Reference
) -> tuple[RefitWithStone, ...]:
    """The values that the fit gives with other constants of the stone: those of the
    reference, and each constant of the fit shifted by its rounding; none where they are
    parameters of the fit."""
    stone = result.stone.as_dict()
    of_reference = {
        name: constant
        for name, constant in reference.stone.items()
        if constant != stone[name]
    }
    constants_in_question = {*reference.stone, *reference.rounding}
    if not of_reference or result.conditions.keys() & constants_in_question:
        return ()
    rounded = [
        {name: round(stone[name] + rounding, 9)}
        for name, rounding in reference.rounding.items()
    ]
    changes = [of_reference, *(change for change in rounded if change != of_reference)]
    start = result.parameter_set.values_of(result.values)
    reference_fits = []
    for change in changes:
        request = replace(
            outcome.request, stone=result.stone.with_values(change), start=start
        )
        fit = summarize(_fitted_alone(Rounds(outcome.model, [request])))
        values = {name: estimate.value for name, estimate in fit.coefficients.items()}
        for combination in fit.combinations:
            values[combination.expression] = combination.value
        reference_fits.append(RefitWithStone(change, values))
    return tuple(reference_fits)


def fit_throws(
    throws: Sequence[Throw],
    law: str | type[Law] = "front-back",
    *,
    curves: bool = True,
    systematics: Mapping[str, float] | None = None,
    **choices: Any,
) -> list[FitResult | CurlfitError]:
    """Fit each throw individually, many at a time; an error takes the place of a
    fit that fails.

    Throws go through the rounds of `fit` side by side.

    Parameters
    ----------
    law, choices : as in `fit`, for all throws.
    curves : whether the fits contain the fitted curves, by which it is also checked
        whether the fitted motion is that of a stone; they always do under a robust loss
        or correlated noise. Quantities of the path are not computed in any case.
    systematics : as in `fit`, but none by default; they need the curves.

    Raises
    ------
    InputError : as in `fit`, for the arguments common to all throws.
    """
    chosen = Fitting.of(law=law, **choices)
    find_law(chosen.law)  # an unknown one is an error of all throws
    outcomes: dict[int, FitResult | CurlfitError] = {}
    # Throws of one group have arrays of one shape, and the same parameters.
    groups: dict[Any, dict[int, Request]] = {}
    for index, throw in enumerate(throws):
        try:
            request = Request.of(throw, Fitting.of(throw.settings, vars(chosen)))
        except CurlfitError as error:
            outcomes[index] = error
        else:
            shape = problem_shape(request.throw)
            group = groups.setdefault((shape, request.parameters.names), {})
            group[index] = request
    for ((_, rows), _), group in groups.items():
        batch = side_by_side(len(group))
        at_once = max(BATCH, _ROWS // rows)
        indices = list(group)
        for first in range(0, len(indices), at_once):
            part = indices[first : first + at_once]
            results = _fit_alike(
                [group[index] for index in part],
                curves=curves,
                systematics=systematics,
                batch=batch,
            )
            outcomes.update(zip(part, results, strict=True))
    return [outcomes[index] for index in range(len(throws))]


def _fit_alike(
    requests: Sequence[Request],
    *,
    curves: bool,
    systematics: Mapping[str, float] | None,
    batch: int,
) -> list[FitResult | CurlfitError]:
    """Fits of throws whose problems have one shape and the same parameters, `batch` of
    them side by side; the other arguments as in `fit_throws`."""
    first = requests[0]
    model = Model.of(first)
    outcomes = fitted(Rounds(model, requests, batch=batch))
    usable = [fit for fit in outcomes if isinstance(fit, LeastSquaresFit)]
    widths = {}
    if systematics is not None:
        widths = widths_of(model, systematics, requests)
    curves = curves or first.loss.is_robust or not first.noise.is_white
    results = iter(summarize_many(usable, batch, curves=curves, widths=widths))
    return [
        outcome
        if isinstance(outcome, CurlfitError)
        else with_curl_warning(next(results))
        for outcome in outcomes
    ]
