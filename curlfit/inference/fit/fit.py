"""Least-squares fits from data to result, of one throw or of many side by side."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from operator import itemgetter
from typing import Any

import jax
import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, find_law, no_motion_because
from curlfit.friction.family import LawFamily
from curlfit.inference.conditions import ALL
from curlfit.inference.derived import check_derived
from curlfit.inference.fit.change_points import sudden_change
from curlfit.inference.fit.measured_curl import with_curl_warning
from curlfit.inference.fit.missing_channels import remedies
from curlfit.inference.fit.noise_advice import with_noise_advice
from curlfit.inference.fit.prepared import PreparedThrow, local_bounds, penalties
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import LeastSquaresFit, summarize, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.initial_values import smooth, start_values_of_sides
from curlfit.inference.least_squares import (
    Tasks,
    as_slice,
    best_of_sides,
    fits_equally,
    minimize,
    minimize_many,
    multistart,
    needs_restart,
    prepare_minimize,
    put,
    starts,
)
from curlfit.inference.likelihood import prepare_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import Origin, problem_shape
from curlfit.numerics.batches import BATCH, stacked, unstacked
from curlfit.settings.choices import Fitting, takes
from curlfit.stone import Stone
from curlfit.throws.throw import Reference, Throw, require_throw

_OPEN = ("not identifiable", "weak")  # verdicts that another measurement might change
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
    """Fit a friction law and the initial state of the throw to a measured path by least squares.

    Parameters
    ----------
    throw : the data. Its own settings (such as `until`, `stone`, `law`) apply where an argument is
        not given.
    details : whether to compute also the quantities of the path, the fits with the stones of the
        throw's reference, and what would determine more parameters (`remedies`).
    family : of laws that are fitted to the same throw, including this one: they are compiled as
        one program.
    {choices}

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged, and whose `warnings` say why
    it may mislead.

    Raises
    ------
    InputError : an unknown law, load, loss, noise or parameter name; too few rows; a stone that
        never moves.
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
    prepared: PreparedThrow, chosen: Fitting, *, details: bool, family: type[LawFamily] | None
) -> FitResult:
    model = Model(find_law(chosen.law), chosen.load, prepared.parameters.conditions).within(family)
    loss, noise, start = chosen.loss, chosen.noise, chosen.start
    rounds = Rounds(model, [prepared], loss=loss, noise=noise)
    found = _fitted_alone(rounds, start)
    errors = len(prepared.calibration)
    result = summarize(found, widths_of(model, chosen.systematics, errors))
    if not result.converged:
        return result
    doubtful = any(item.doubtful for item in result.independence.values())
    if doubtful and loss == "linear" and noise == "white" and "sweep" not in result.conditions:
        change = sudden_change(found)
        if change is not None:
            result = replace(result, warnings=(change, *result.warnings))
        elif details and not result.events:
            result = with_noise_advice(result, refit)
    if not details:
        return result
    result = replace(with_curl_warning(result), quantities=quantities_of(result))
    if result.reference is not None:
        result = replace(result, reference_fits=_reference_fits(found, result))
    open_ = [name for name, item in result.parameters.items() if item.verdict in _OPEN]
    if open_:
        local = prepared.local_parameters
        values, n = found.solution.values, len(prepared.throw)
        white = result.noise.kind == "white"
        remedy = remedies(model, values, found.problem, local, n, open_, chosen.fix, white)
        result = replace(result, remedies=remedy)
    return result


def refit(fit: FitResult, noise: str) -> FitResult:
    """Repeat a fit under another noise model, starting from its optimum."""
    throw, origin = fit.throw, Origin.of(fit.throw)
    rows = {name: fit.data[name] for name in ("since", "until", "exclude")}
    prepared = PreparedThrow(
        throw, throw, fit.stone, rows, fit.data["swept"], fit.parameter_set, origin
    )
    rounds = Rounds(fit.model, [prepared], loss=fit.loss, noise=noise)
    return summarize(_fitted_alone(rounds, fit.parameter_set.values_of(fit.values)))


def _fitted_alone(rounds: Rounds, start: Mapping[str, float] | None) -> LeastSquaresFit:
    """Fit the only throw of some rounds, trying all initial values."""
    (prepared,), model = rounds.throws, rounds.model
    parameters = prepared.local_parameters
    (problem,), (sketch,) = unstacked(rounds.problems), unstacked(rounds.initial_problems)
    prepare_minimize(model, prepared.first_parameters, problem)
    prepare_channels(model, len(parameters), problem)
    path = smooth(rounds.initial_problems)
    sides, others = starts(model, sketch, path, parameters)
    if start:
        if len(sides) == 1:
            others = sides + others
            sides = []
        sides.insert(0, prepared.with_start((sides or others)[0], start))
    found, tried = multistart(model, sides, others, prepared.first_parameters, problem, path)
    if not found:
        raise UnusableFitError(
            f"{prepared.throw.name}: law {model.law.name} with {model.load} load gives no finite "
            "path from any start" + no_motion_because(model.load)
        )
    solution, rivals = found[0], [one for one in found[1:] if fits_equally(found[0], one)][:1]
    only = np.zeros(1, int)
    while len(rounds.revise(only, stacked([solution]))):
        (problem,) = unstacked(rounds.problems)
        solution, *rivals = (
            minimize(model, one.values, parameters, problem) or one for one in (solution, *rivals)
        )
    for failure in rounds.failures.values():
        raise failure
    rival = rivals[0].values if rivals and fits_equally(solution, rivals[0]) else None
    return rounds.record(0, solution, tried, rival)


def _reference_fits(fit: LeastSquaresFit, result: FitResult) -> tuple[dict[str, Any], ...]:
    """The values that the fit gives with other constants of the stone."""
    assert result.reference is not None
    start = fit.prepared.parameters.values_of(result.values)
    found = []
    for constants in _other_stones(result.reference, result.stone, result.conditions):
        prepared = fit.prepared._replace(stone=result.stone.with_values(constants))
        rounds = Rounds(fit.model, [prepared], loss=fit.loss, noise=fit.noise.kind)
        other = summarize(_fitted_alone(rounds, start))
        each = {name: item.value for name, item in other.coefficients.items()}
        each |= {item.expression: item.value for item in other.combinations}
        found.append({"stone": constants, "values": each})
    return tuple(found)


def _other_stones(
    reference: Reference, stone: Stone, parameters: Collection[str]
) -> list[dict[str, float]]:
    """Constants for repeated fits: those of the reference, and each constant of the fit shifted by
    its rounding; none where they are parameters of the fit."""
    if set(parameters) & {*reference.stone, *reference.rounding}:
        return []
    now = stone.as_dict()
    own = {name: value for name, value in reference.stone.items() if value != now[name]}
    if not own:
        return []
    off = [{name: round(now[name] + by, 9)} for name, by in reference.rounding.items()]
    return [own, *(item for item in off if item != own)]


def fit_throws(
    throws: Sequence[Throw],
    law: str | type[Law] = "front-back",
    *,
    curves: bool = True,
    systematics: Mapping[str, float] | None = None,
    **choices: Any,
) -> list[FitResult | CurlfitError]:
    """Fit each throw individually, many at a time; an error takes the place of a fit that fails.

    Throws go through the rounds of `fit` side by side. One whose first initial values give no good
    fit is fitted again alone, with all those that `fit` would try, so that it delays no other.

    Parameters
    ----------
    law, choices : as in `fit`, for all throws.
    curves : whether the fits contain the fitted curves; they always do under a robust loss or
        correlated noise.
    systematics : as in `fit`, but none by default; they need the curves.

    Raises
    ------
    InputError : as in `fit`, for the arguments common to all throws.
    """
    common = Fitting.of(law=law, **choices)
    law, loss, noise = find_law(common.law), common.loss, common.noise
    curves = curves or loss != "linear" or noise != "white"
    found: dict[int, FitResult | CurlfitError] = {}
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
        while part := dict(islice(rest, max(BATCH, _ROWS // rows))):
            model = Model(law, common.load, next(iter(part.values())).parameters.conditions)
            rounds = Rounds(model, list(part.values()), loss=loss, noise=noise, batch=BATCH)
            solved = _fitted_together(rounds, common.start)
            errors = max(len(one.calibration) for one in part.values())
            widths = {} if systematics is None else widths_of(model, systematics, errors)
            results = map(
                with_curl_warning,
                summarize_many(list(solved.values()), curves=curves, widths=widths),
            )
            found |= zip((list(part)[row] for row in solved), results, strict=True)
            for row, (index, prepared) in enumerate(part.items()):
                if row not in solved:
                    held = {ALL: 0.0} if systematics is None else systematics
                    found[index] = rounds.failures.get(row) or _alone(
                        prepared.given, vars(common) | {"systematics": held}
                    )
    return [found[index] for index in range(len(throws))]


def _fitted_together(
    rounds: Rounds, start: Mapping[str, float] | None
) -> dict[int, LeastSquaresFit]:
    """Fits of throws of one shape, side by side, by index; without those that have to be fitted
    alone."""
    model, throws = rounds.model, rounds.throws
    _, lower, upper = local_bounds(throws)
    paths = smooth(rounds.initial_problems)
    sides = start_values_of_sides(model, rounds.initial_problems, paths, lower, upper)
    begin = sides[0]
    if start:
        begin = np.stack(
            [one.with_start(values, start) for one, values in zip(throws, begin, strict=True)]
        )
    typical = throws[0].parameters.typical
    tasks = Tasks(rounds.problems, begin, lower, upper, typical, penalties(throws, first=True))
    rivals = best_of_sides(model, tasks, sides)
    solutions = minimize_many(model, tasks)
    poor = needs_restart(solutions, paths, rounds.problems)
    tasks, due = tasks._replace(penalty=penalties(throws)), np.flatnonzero(~poor)
    while len(due := rounds.revise(due, jax.tree.map(itemgetter(as_slice(due)), solutions))):
        again = tasks._replace(start=solutions.values).at(due)
        put(solutions, due, minimize_many(model, again))
    each = unstacked(solutions)
    usable = np.flatnonzero(solutions.success & ~poor)
    return {
        int(index): rounds.record(int(index), each[index], rival=rivals.get(int(index)))
        for index in usable
        if index not in rounds.failures
    }


def _alone(throw: Throw, choices: Mapping[str, Any]) -> Any:
    """The fit of one throw with all initial values that `fit` would try, or the error."""
    try:
        return fit(throw, **choices)
    except CurlfitError as error:
        return error
