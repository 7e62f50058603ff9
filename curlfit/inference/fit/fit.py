"""Least squares: a fit from data to result, of one throw or of many side by side."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from operator import itemgetter
from typing import Any

import jax
import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, Load, check_load, find_law, no_motion_because
from curlfit.friction.family import LawFamily
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.change_points import sudden_change
from curlfit.inference.fit.missing_channels import remedies
from curlfit.inference.fit.prepared import PreparedThrow, local_bounds, penalties
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import LeastSquaresFit, summarize, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.initial_values import smooth, start_values
from curlfit.inference.least_squares import (
    Indices,
    Revision,
    Solution,
    Tasks,
    minimize,
    minimize_many,
    multistart,
    needs_restart,
    prepare_minimize,
    run_of,
    starts,
)
from curlfit.inference.likelihood import prepare_channels
from curlfit.inference.model import Model
from curlfit.inference.noise.models import check_loss, check_noise
from curlfit.inference.priors import Prior
from curlfit.inference.problem import Origin, problem_shape
from curlfit.numerics.compiled import BATCH, gc_paused, stacked, unstacked
from curlfit.stone import Stone
from curlfit.throws.throw import Reference, Throw, require_throw

_OPEN = ("not identifiable", "weak")  # verdicts that another measurement might change
_ROWS = 2 * BATCH * 256  # of throws that are fitted together, for the sake of memory


def fit(
    throw: Throw,
    law: str | type[Law] | None = None,
    *,
    load: str | None = None,
    stone: Stone | None = None,
    since: float | None = None,
    until: float | None = None,
    exclude: Sequence[tuple[float, float]] = (),
    swept: Sequence[float] | None = None,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    unbounded: bool = False,
    free: Sequence[str] = (),
    priors: Mapping[str, str | Prior] | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
    systematics: Mapping[str, float] | None = None,
    details: bool = True,
    family: type[LawFamily] | None = None,
) -> FitResult:
    """Fit a friction law and the start of the throw to a measured path by least squares.

    Parameters
    ----------
    throw : the data. Its own defaults (`since`, `until`, `exclude`, `stone`, `law`, `load`) hold
        where nothing else is said.
    law : name or class of the friction law; "front-back" where the throw says nothing either.
    load : "uniform" or "consistent" (eq. 8-9).
    stone : the stone; by default the data file's, and `Stone()` where that says nothing.
    since, until : use rows with since <= t <= until (s).
    exclude : intervals (from, to) in s whose rows are not used. The stone moves on in them under
        the same friction.
    swept : when sweeping began and ended (s); `sweep`, the friction meanwhile over that before, is
        then a parameter.
    fix, bounds : parameters held at a value, and (lower, upper) in place of the law's own.
    unbounded : let coefficients be negative.
    free : optional coefficients and conditions (`slope_x`, `rho`, ...; see
        `curlfit.inference.conditions`) that are estimated. Others are held.
    priors : prior densities by the name of the parameter, such as {"rho": "0.1+-0.0025"}; the forms
        are "MEAN+-SD", "lognormal:MEDIAN,SIGMA", "half-normal:SD" and "uniform:LOW,HIGH". They make
        the parameters free.
    start : initial values of some parameters; the rest is found from the data. Not needed.
    loss : "linear" is least squares; "huber", "soft-l1", "cauchy" and "student" (4 degrees of
        freedom) are robust to outliers.
    noise : "white" is independent from row to row; "ar1" has a correlation that decays
        exponentially; "discrepancy" is white on top of accelerations that the law lacks;
        "ar1+discrepancy" is both (see `curlfit.inference.noise.models`).
    systematics : standard uncertainties of conditions that are held, such as {"slope_x": 2e-4}, in
        place of those of `curlfit.inference.conditions`; 0 where one is known, "all" for all that
        are not named. They enter the systematic errors alone.
    details : whether the fit shall also hold the quantities of the path, the fits with the stones
        of the throw's reference, and what would determine more (`remedies`).
    family : of laws that are fitted to the same throw, this one among them: their programs are
        compiled as one.

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged, and its `warnings` why it may
    mislead.

    Raises
    ------
    InputError : an unknown law, load, loss, noise or parameter name; too few rows; a stone that
        never moves.
    UnusableFitError : no start led to a finite fit.

    Examples
    --------
    >>> fit = curlfit.fit(throw, "front-back")
    >>> fit.converged, round(fit["mu2_xi"].value, 4)
    (True, 0.0556)
    >>> fit["mu1_eta"].verdict
    'not identifiable'
    """
    require_throw(throw)
    law = throw.defaults.get("law", "front-back") if law is None else law
    law = find_law(law)
    loss, noise = check_loss(loss), check_noise(noise, loss)
    load = check_load(load or throw.defaults.get("load", "uniform"))
    prepared = PreparedThrow.of(
        throw, law, stone, since=since, until=until, exclude=exclude, swept=swept, fix=fix,
        bounds=bounds, unbounded=unbounded, free=free, priors=priors,
    )  # fmt: skip
    model = Model(law, load, prepared.parameters.conditions).within(family)
    rounds = Rounds(model, [prepared], loss=loss, noise=noise)
    found = _fitted_alone(rounds, start)
    result = summarize(found, widths_of(model, systematics))
    if not result.converged:
        return result
    doubtful = any(item.doubtful for item in result.independence.values())
    if doubtful and loss == "linear" and noise == "white" and "sweep" not in result.conditions:
        change = sudden_change(found)
        if change is not None:
            result = replace(result, warnings=(change.warning(), *result.warnings))
    if not details:
        return result
    result = replace(result, quantities=quantities_of(result))
    if result.reference is not None:
        result = replace(result, reference_fits=_reference_fits(found, result))
    open_ = [name for name, item in result.parameters.items() if item.verdict in _OPEN]
    if open_:
        local = prepared.local_parameters
        values, n = found.solution.values, len(prepared.throw)
        remedy = remedies(model, values, found.problem, local, n, open_, fix or ())
        result = replace(result, remedies=remedy)
    return result


def refit(fit: FitResult, noise: str) -> FitResult:
    """A fit made again under another noise model, from its optimum."""
    throw, origin = fit.throw, Origin.of(fit.throw)
    prepared = PreparedThrow(
        throw, throw, fit.stone, fit.data, fit.data["swept"], fit.parameter_set, origin
    )
    rounds = Rounds(fit.model, [prepared], loss=fit.loss, noise=noise)
    return summarize(_fitted_alone(rounds, fit.parameter_set.values_of(fit.values)))


def _fitted_alone(rounds: Rounds, start: Mapping[str, float] | None) -> LeastSquaresFit:
    """The only throw of some rounds, with all the starts there are."""
    (prepared,), model = rounds.throws, rounds.model
    parameters = prepared.local_parameters
    (problem,), (sketch,) = unstacked(rounds.problems), unstacked(rounds.sketches)
    prepare_minimize(model, prepared.first_parameters, problem)
    prepare_channels(model, len(parameters), problem)
    path = smooth(rounds.sketches)
    tries = starts(model, sketch, path, parameters)
    if start:
        tries.insert(0, prepared.with_start(tries[0], start))
    solution, tried = multistart(model, tries, prepared.first_parameters, problem, path)
    if solution is None:
        raise UnusableFitError(
            f"{prepared.throw.name}: law {model.law.name} with {model.load} load gives no finite "
            "path from any start" + no_motion_because(model.load)
        )
    only = np.zeros(1, int)
    while rounds.revise(only, stacked([solution])):
        (problem,) = unstacked(rounds.problems)
        solution = minimize(model, solution.values, parameters, problem) or solution
    for failure in rounds.failures.values():
        raise failure
    return rounds.record(0, solution, tried)


def _reference_fits(fit: LeastSquaresFit, result: FitResult) -> tuple[dict[str, Any], ...]:
    """The same fit with other constants of the stone: what the values then are."""
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
    """Constants to fit with again: those of the reference, and one more by its rounding each; none
    where they are parameters of the fit."""
    if set(parameters) & {*reference.stone, *reference.rounding}:
        return []
    now = stone.as_dict()
    own = {name: value for name, value in reference.stone.items() if value != now[name]}
    if not own:
        return []
    off = [{name: round(now[name] + by, 9)} for name, by in reference.rounding.items()]
    return [own, *(item for item in off if item != own)]


@gc_paused()
def fit_throws(
    throws: Sequence[Throw],
    law: str | type[Law] = "front-back",
    *,
    load: str = "uniform",
    stones: Sequence[Stone | None] | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
    curves: bool = True,
    systematics: Mapping[str, float] | None = None,
    **choices: Any,
) -> list[FitResult | CurlfitError]:
    """The fit of each throw by itself, many at a time, or why there is none.

    Throws go through the rounds of `fit` side by side. One whose first start leads nowhere good is
    fitted again alone, with all the starts that `fit` would try, so that it delays no other.

    Parameters
    ----------
    throws, law, load, start, loss, noise : as in `fit`; load holds for all.
    stones : one for each throw; its own where not given.
    curves : whether the fits shall hold the fitted curves; they always do under a robust loss or
        correlated noise.
    systematics : as in `fit`, but none where not given; they need the curves.
    choices : `since`, `until`, `exclude`, `swept`, `fix`, `bounds`, `unbounded`, `free` and
        `priors` as in `fit`.

    Raises
    ------
    InputError : as in `fit`, of what holds for all throws.
    """
    law = find_law(law)
    checked, loss = check_load(load), check_loss(loss)
    noise = check_noise(noise, loss)
    curves = curves or loss != "linear" or noise != "white"
    found: dict[int, FitResult | CurlfitError] = {}
    by_shape: dict[tuple[int, int], dict[int, PreparedThrow]] = {}
    for index, (throw, stone) in enumerate(
        zip(throws, stones or [None] * len(throws), strict=True)
    ):
        try:
            prepared = PreparedThrow.of(throw, law, stone, **choices)
        except CurlfitError as error:
            found[index] = error
        else:
            by_shape.setdefault(problem_shape(prepared.throw), {})[index] = prepared
    for (_, rows), alike in by_shape.items():
        rest = iter(alike.items())
        while part := dict(islice(rest, max(BATCH, _ROWS // rows))):
            model = Model(law, checked, next(iter(part.values())).parameters.conditions)
            rounds = Rounds(model, list(part.values()), loss=loss, noise=noise, batch=BATCH)
            solved = _fitted_together(rounds, start)
            widths = {} if systematics is None else widths_of(model, systematics)
            results = summarize_many(list(solved.values()), curves=curves, widths=widths)
            found |= zip((list(part)[row] for row in solved), results, strict=True)
            for row, (index, prepared) in enumerate(part.items()):
                if row not in solved:
                    found[index] = rounds.failures.get(row) or _alone(
                        prepared,
                        law,
                        checked,
                        start=start,
                        loss=loss,
                        noise=noise,
                        systematics={ALL: 0.0} if systematics is None else systematics,
                        **choices,
                    )
    return [found[index] for index in range(len(throws))]


def _fitted_together(
    rounds: Rounds, start: Mapping[str, float] | None
) -> dict[int, LeastSquaresFit]:
    """Throws of one shape, side by side, by index; those are left out that have to be fitted
    alone."""
    model, throws = rounds.model, rounds.throws
    _, lower, upper = local_bounds(throws)
    paths = smooth(rounds.sketches)
    begin = start_values(model, rounds.sketches, paths, lower, upper)
    if start:
        begin = np.stack(
            [one.with_start(values, start) for one, values in zip(throws, begin, strict=True)]
        )
    poor, checked_once = np.zeros(len(throws), bool), np.zeros(len(throws), bool)

    def revise(which: Indices, solutions: Solution) -> list[Revision]:
        if not checked_once[which].all():
            here = jax.tree.map(itemgetter(run_of(which)), (paths, rounds.problems))
            bad = needs_restart(solutions, *here)
            poor[which] |= bad & ~checked_once[which]
            checked_once[which] = True
        if poor[which].any():
            good = ~poor[which]
            which, solutions = which[good], jax.tree.map(itemgetter(good), solutions)
        return rounds.revise(which, solutions) if len(which) else []

    typical = throws[0].parameters.typical
    priors = penalties(throws, first=True), penalties(throws)
    tasks = Tasks(rounds.problems, begin, lower, upper, typical, *priors)
    solutions = minimize_many(model, tasks, revise)
    each = unstacked(solutions)
    usable = np.flatnonzero(solutions.success & ~poor)
    return {
        int(index): rounds.record(int(index), each[index])
        for index in usable
        if index not in rounds.failures
    }


def _alone(prepared: PreparedThrow, law: type[Law], load: Load, **choices: Any) -> Any:
    """The fit of one throw with all the starts that `fit` would try, or why there is none."""
    try:
        return fit(prepared.given, law, load=load, stone=prepared.stone, **choices)
    except CurlfitError as error:
        return error
