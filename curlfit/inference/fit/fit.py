"""Least-squares fits from data to result, of one throw or of many side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, Load, NetLaw, find_law, no_motion_because
from curlfit.friction.family import LawFamily
from curlfit.inference.derived import check_derived
from curlfit.inference.fit.advice import remedies, with_curl_warning, with_noise_advice
from curlfit.inference.fit.change_points import may_have_changed, with_change
from curlfit.inference.fit.other_rests import starts_with_other_rests
from curlfit.inference.fit.prepared import (
    LeastSquaresFit,
    PreparedThrow,
    local_bounds,
    penalties,
)
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import summarize, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.initial_values import usual_where_astray
from curlfit.inference.least_squares import (
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
from curlfit.inference.problem import Origin, problem_shape
from curlfit.losses import LOSSES, loss_at
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH, side_by_side, stacked, unstacked
from curlfit.settings.choices import Fitting, takes
from curlfit.settings.noise_kinds import NoiseKind
from curlfit.throws.throw import Reference, Throw, require_throw

_MOST_REST_SEARCHES = 20  # each moves the rest by up to eight rows
_ROWS = 2 * BATCH * 256  # of throws that are fitted together, to limit memory


@takes(Fitting, "law")
def fit(
    throw: Throw,
    law: str | type[Law] | None = None,
    *,
    details: bool = True,
    family: type[LawFamily] | None = None,
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
    family : of laws that are fitted to the same throw, including this one: they are
        compiled as one program.
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
    prepared = PreparedThrow.of(throw, chosen)
    check_derived(chosen.derive, prepared.parameters.names)
    result = _fit(prepared, chosen, details=details, family=family)
    return result.with_derived(chosen.derive) if chosen.derive else result


def _fit(
    prepared: PreparedThrow,
    chosen: Fitting,
    *,
    details: bool,
    family: type[LawFamily] | None,
) -> FitResult:
    model = Model(
        find_law(chosen.law), Load(chosen.load), prepared.parameters.conditions
    ).within(family)
    loss = LOSSES[chosen.loss]
    noise = NoiseKind(chosen.noise)
    start = chosen.start
    rounds = Rounds(model, [prepared], loss=loss, noise=noise)
    found = _fitted_alone(rounds, start)
    result = summarize(found, widths_of(model, chosen.systematics, [prepared]))
    if not result.converged:
        return result
    if may_have_changed(found, result):
        changed = with_change(found, result)
        if changed is result and details and not result.events:
            changed = with_noise_advice(result, refit)
        result = changed
    if not details:
        return result
    result = replace(with_curl_warning(result), quantities=quantities_of(result))
    if result.reference is not None:
        fits = _reference_fits(found, result, result.reference)
        result = replace(result, reference_fits=fits)
    open_ = [name for name, item in result.parameters.items() if item.verdict.is_open]
    return (
        replace(result, remedies=remedies(found, open_, chosen.fix))
        if open_
        else result
    )


def refit(fit: FitResult, noise: NoiseKind) -> FitResult:
    """Repeat a fit under another noise model, starting from its optimum."""
    throw, origin = fit.throw, Origin.of(fit.throw)
    rows = {name: fit.data[name] for name in ("since", "until", "exclude")}
    prepared = PreparedThrow(
        throw, fit.stone, rows, fit.data["swept"], fit.parameter_set, origin
    )
    rounds = Rounds(fit.model, [prepared], loss=LOSSES[fit.loss], noise=noise)
    return summarize(_fitted_alone(rounds, fit.parameter_set.values_of(fit.values)))


def _fitted_alone(rounds: Rounds, start: Mapping[str, float] | None) -> LeastSquaresFit:
    """Fit the only throw of some rounds."""
    (found,) = fitted(rounds, start)
    if isinstance(found, CurlfitError):
        raise found
    return found


def fitted(
    rounds: Rounds, start: Mapping[str, float] | None
) -> list[LeastSquaresFit | CurlfitError]:
    """Fits of throws side by side; an error takes the place of one that fails."""
    model, throws, batch = rounds.model, rounds.throws, rounds.batch
    if batch == 1:
        (problem,) = unstacked(rounds.problems)
        prepare_minimize(model, throws[0].local_parameters, problem)
        prepare_channels(model, len(throws[0].parameters), problem)
    _, lower, upper = local_bounds(throws)
    paths, sides = rounds.starts()
    tasks = Tasks(
        rounds.problems,
        sides[0],
        lower,
        upper,
        throws[0].parameters.typical,
        penalties(throws, first=True),
    )
    plans = []
    for row, one in enumerate(throws):
        ends = lower[row], upper[row]
        first, others = starts_to_try(model.law, sides[:, row], ends, tasks.typical)
        if start:  # takes the place of the only initial values that the data give
            given = one.with_start(first[0], start)
            first, others = (
                ([given], first + others)
                if len(first) == 1
                else ([given, *first], others)
            )
        plans.append((first, others))
    tried = optima(model, tasks, [first for first, _ in plans], batch)
    best = stacked([(best_first(found) or found)[0] for found in tried])
    poor = needs_restart(best, paths, rounds.problems)
    # If the first optimum is poor, all are tried: a later one may be local
    # and look good.
    again = [
        others if bad else [] for (_, others), bad in zip(plans, poor, strict=True)
    ]
    for found, more in zip(tried, optima(model, tasks, again, batch), strict=True):
        found += more
    followed = [best_first(found) for found in tried]
    for found in followed:
        found[1:] = [one for one in found[1:] if fits_equally(found[0], one)][:1]
    _search_other_rests(rounds, tasks, followed)
    due = np.flatnonzero([len(found) for found in followed])
    tasks = tasks._replace(penalty=penalties(throws))
    while len(due) and len(
        due := rounds.revise(due, stacked([followed[row][0] for row in due]))
    ):
        last = [
            [one.values for one in found] if row in due else []
            for row, found in enumerate(followed)
        ]
        for found, new in zip(followed, optima(model, tasks, last, batch), strict=True):
            found[: len(new)] = [
                one if np.isfinite(one.chi_squared) else old
                for one, old in zip(new, found, strict=False)
            ]
        _search_other_rests(rounds, tasks, followed)
    _settle(model, tasks, followed, batch)
    _add_usual(model, tasks, followed, batch)
    return [
        rounds.failures.get(row) or _outcome(rounds, row, found, len(tried[row]))
        for row, found in enumerate(followed)
    ]


def _search_other_rests(
    rounds: Rounds, tasks: Tasks, followed: Sequence[list[Solution]]
) -> None:
    """Search on with the rest of the stone in other rows of a measured spin, as long as
    that leads to lower optima. Under a robust loss, and with correlated noise, the rest
    stays in the row where least squares have found it."""
    if tasks.problems.spins is None or not issubclass(rounds.model.law, NetLaw):
        return
    problems = unstacked(tasks.problems)
    due = [
        row
        for row, optima_of_throw in enumerate(followed)
        if optima_of_throw
        and not loss_at(tasks.problems.loss[row]).is_robust
        and not rounds.noises[row].sizes
    ]
    for _ in range(_MOST_REST_SEARCHES):
        starts: list[list[Floats]] = [[] for _ in followed]
        for row in due:
            starts[row] = starts_with_other_rests(
                rounds.model,
                followed[row][0],
                problems[row],
                tasks.lower[row],
                tasks.upper[row],
                tasks.typical,
            )
        if not any(starts):
            return
        reached = optima(rounds.model, tasks, starts, rounds.batch)
        due = []
        for row, optima_of_throw in enumerate(followed):
            if reached[row]:
                before = optima_of_throw[0]
                best, *others = best_first([*optima_of_throw, *reached[row]])
                rivals = [one for one in others if fits_equally(best, one)]
                optima_of_throw[:] = [best, *rivals[:1]]
                if best is not before:
                    due.append(row)


def _settle(
    model: Model, tasks: Tasks, followed: Sequence[list[Solution]], batch: int
) -> None:
    """End searches that have not ended, since along some direction chi squared is level
    or has no slope (the spin, of a stone that hardly spins): the parameter that takes
    part in it most is held, and the others are refitted."""
    lower, upper = np.array(tasks.lower), np.array(tasks.upper)
    starts: list[list[Floats]] = [[] for _ in followed]
    for optima_of_throw, start, low, high in zip(
        followed, starts, lower, upper, strict=True
    ):
        if optima_of_throw and not optima_of_throw[0].success:
            best = optima_of_throw[0]
            free = high > low
            slopes = best.jacobian.reshape(-1, len(free)) * tasks.typical * free
            _, _, rows = np.linalg.svd(slopes[:, free], full_matrices=False)
            levellest = np.flatnonzero(free)[np.abs(rows[-1]).argmax()]
            low[levellest] = high[levellest] = best.values[levellest]
            start.append(best.values)
    held = tasks._replace(lower=lower, upper=upper)
    settled = optima(model, held, starts, batch)
    for optima_of_throw, ended in zip(followed, settled, strict=True):
        if ended and ended[0].objective <= optima_of_throw[0].objective:
            optima_of_throw[0] = ended[0]


def _add_usual(
    model: Model, tasks: Tasks, followed: Sequence[list[Solution]], batch: int
) -> None:
    """Where coefficients went astray, add the optimum with their defaults, which may
    fit equally: about the first, where they hardly act, the others seem better
    determined than they are."""
    lower, upper = np.array(tasks.lower), np.array(tasks.upper)
    starts: list[list[Floats]] = [[] for _ in followed]
    for found, start, low, high in zip(followed, starts, lower, upper, strict=True):
        if found:
            usual = usual_where_astray(model.law, found[0].values, tasks.typical)
            if (astray := np.isfinite(usual) & (high > low)).any():
                start.append(np.where(astray, usual, found[0].values))
                low[astray] = high[astray] = usual[astray]
    held = tasks._replace(lower=lower, upper=upper)
    for found, more in zip(followed, optima(model, held, starts, batch), strict=True):
        found += more


def _outcome(
    rounds: Rounds, row: int, found: Sequence[Solution], tried: int
) -> LeastSquaresFit | CurlfitError:
    """The fit of a throw from its optimum, and one that may fit equally, if
    any is finite."""
    if not found:
        model = rounds.model
        return UnusableFitError(
            f"{rounds.throws[row].throw.name}: law {model.law.name} with "
            f"{model.load} load gives no finite "
            "path from any start" + no_motion_because(model.load)
        )
    best, *others = found
    rival = next((one for one in others if fits_equally(best, one)), None)
    return rounds.record(row, best, tried, rival)


def _reference_fits(
    fit: LeastSquaresFit, result: FitResult, reference: Reference
) -> tuple[dict[str, Any], ...]:
    """The values that the fit gives with other constants of the stone: those of the
    reference, and each constant of the fit shifted by its rounding; none where they are
    parameters of the fit."""
    now, start = result.stone.as_dict(), result.parameter_set.values_of(result.values)
    own = {name: value for name, value in reference.stone.items() if value != now[name]}
    if not own or result.conditions.keys() & {*reference.stone, *reference.rounding}:
        return ()
    off = [{name: round(now[name] + by, 9)} for name, by in reference.rounding.items()]
    found = []
    for constants in (own, *(one for one in off if one != own)):
        prepared = fit.prepared._replace(stone=result.stone.with_values(constants))
        rounds = Rounds(fit.model, [prepared], loss=fit.loss, noise=fit.noise.kind)
        other = summarize(_fitted_alone(rounds, start))
        each = {name: item.value for name, item in other.coefficients.items()}
        each |= {item.expression: item.value for item in other.combinations}
        found.append({"stone": constants, "values": each})
    return tuple(found)


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
    curves : whether the fits contain the fitted curves; they always do under a robust
        loss or correlated noise.
    systematics : as in `fit`, but none by default; they need the curves.

    Raises
    ------
    InputError : as in `fit`, for the arguments common to all throws.
    """
    common = Fitting.of(law=law, **choices)
    law = find_law(common.law)
    loss = LOSSES[common.loss]
    noise = NoiseKind(common.noise)
    curves = curves or loss.is_robust or not noise.is_white
    found: dict[int, Any] = {}
    groups: dict[tuple[int, int, tuple[str, ...]], dict[int, PreparedThrow]] = {}
    for index, throw in enumerate(throws):
        try:
            prepared = PreparedThrow.of(throw, Fitting.of(throw.settings, vars(common)))
        except CurlfitError as error:
            found[index] = error
        else:
            key = (*problem_shape(prepared.throw), prepared.parameters.names)
            groups.setdefault(key, {})[index] = prepared
    for (_, rows, _), alike in groups.items():
        rest = iter(alike.items())
        batch = side_by_side(len(alike))
        while part := dict(islice(rest, max(BATCH, _ROWS // rows))):
            model = Model(
                law, Load(common.load), next(iter(part.values())).parameters.conditions
            )
            rounds = Rounds(
                model, list(part.values()), loss=loss, noise=noise, batch=batch
            )
            each = dict(zip(part, fitted(rounds, common.start), strict=True))
            usable = {
                k: one for k, one in each.items() if isinstance(one, LeastSquaresFit)
            }
            widths = (
                {}
                if systematics is None
                else widths_of(model, systematics, rounds.throws)
            )
            results = summarize_many(
                list(usable.values()), batch, curves=curves, widths=widths
            )
            found |= each | dict(
                zip(usable, map(with_curl_warning, results), strict=True)
            )
    return [found[index] for index in range(len(throws))]
