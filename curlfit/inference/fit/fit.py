"""Least squares: a fit from data to result.

Where no sigma is given, a first fit weights the channels evenly, 1 m like 1 rad. The scatter of
its residuals, corrected for the parameters spent, is the sigma of the second and last fit (two-step
generalised least squares). It is not repeated until both agree: where a law is not exact, that
ends with one channel fitted perfectly at the expense of the others. A robust loss takes its sigma
from the bulk of the residuals, and repeats that. Noise that goes together from row to row is told
from the residuals of a fit with white noise, and a last fit heeds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import UnusableFitError
from curlfit.friction import Law, check_load, find_law, no_motion_because
from curlfit.inference.fit.missing_channels import remedies
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.summary import Optimum, summarize
from curlfit.inference.initial_values import smooth
from curlfit.inference.least_squares import Solution, best_of, descend, residual_sigma, starts
from curlfit.inference.likelihood import (
    SIGMA_FLOOR,
    Frame,
    Problem,
    frame_of,
    problem_of,
    raw_residuals,
    stacked,
    trace,
)
from curlfit.inference.noise.losses import robust_sigma
from curlfit.inference.noise.models import check_noise, fitted_noise
from curlfit.inference.parameters import ParameterSet, check_loss
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS, Reference, Throw

Floats = NDArray[np.float64]

_LASTING = 0.03  # memory over the time of motion, above which `tests/statistics` finds errors small
_OPEN = ("not identifiable", "weak")  # verdicts that something else might mend
_ROUNDS = 4  # of a robust fit: sigma from the bulk, then the fit


def fit(
    throw: Throw,
    law: str | type[Law] = "front-back",
    *,
    load: str | None = None,
    stone: Stone | None = None,
    until: float | None = None,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    unbounded: bool = False,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
) -> FitResult:
    """Fit a friction law and the start of the throw to a measured path by least squares.

    Parameters
    ----------
    throw : the data. Its own defaults (`until`, `stone`, `load`) hold where nothing else is said.
    law : name or class of the friction law.
    load : "uniform" or "consistent" (eq. 8-9).
    stone : the stone; by default the data file's, and `Stone()` where that says nothing.
    until : use rows with t <= `until` (s).
    fix, bounds : parameters held at a value, and (lower, upper) in place of the law's own.
    unbounded : let coefficients be negative.
    start : start values of some parameters; the rest is found from the data. Not needed.
    loss : "linear" is least squares; "huber", "soft-l1", "cauchy" and "student" (4 degrees of
        freedom) are robust to outliers.
    noise : "white" is independent from row to row; "ar1" forgets itself exponentially; "gp" is
        white on top of a smooth discrepancy, as of a law that is not exact (see
        `curlfit.inference.noise.models`).

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged and what to mind.

    Raises
    ------
    InputError : an unknown law, load, loss, noise or parameter name; too few rows; a stone that
        never moves.
    UnusableFitError : no start led to a finite fit.
    """
    whole = throw
    law = find_law(law) if isinstance(law, str) else law
    loss, noise = check_loss(loss), check_noise(noise, loss)
    load = check_load(load or throw.defaults.get("load", "uniform"))
    throw, stone, until, parameters, frame = prepared(
        throw, law, stone, until, fix=fix, bounds=bounds, unbounded=unbounded
    )
    local = shifted(parameters, -frame.offset(len(parameters)))
    sigma = first_sigma(throw)
    problem = problem_of(throw, stone, frame, sigma)
    path = smooth(stacked([problem]))
    tries = starts(law, load, problem, path, local)
    if start:
        tries.insert(0, _user_start(tries[0], start, parameters, frame))
    solution, tried = best_of(law, load, tries, local, problem, path)
    if solution is None:
        raise UnusableFitError(
            f"{throw.name}: law {law.name} with {load} load gives no finite path from any start"
            + no_motion_because(load)
        )
    if sigma:
        sigma = estimated_sigma(solution, problem, local, sigma)
        problem = problem_of(throw, stone, frame, sigma)
        solution = descend(law, load, solution.values, local, problem) or solution
    if loss != "linear":
        for _ in range(_ROUNDS):
            residual = raw_residuals(law, load, solution.values, problem)
            sigma |= bulk_sigma(throw, residual, problem, sigma)
            problem = problem_of(throw, stone, frame, sigma, loss)
            solution = descend(law, load, solution.values, local, problem) or solution

    def record(problem: Problem, sigma: dict[str, float], solution: Solution) -> FitResult:
        found = Optimum(
            throw, law, load, stone, until, parameters, frame, problem, sigma, solution, tried, loss
        )
        return summarize(found)

    def completed(result: FitResult, problem: Problem, solution: Solution) -> FitResult:
        result = replace(result, reference_fits=reference_fits(result))
        open_ = [n for n, i in result.parameters.items() if i.verdict in _OPEN]
        if not open_ or not result.converged:
            return result
        found = remedies(law, load, solution.values, problem, local, len(throw), open_, fix or ())
        return replace(result, remedies=found)

    def reference_fits(result: FitResult) -> tuple[dict[str, Any], ...]:
        if result.reference is None or not result.converged:
            return ()
        values, found = parameters.values_of(result.values), []
        for constants in _other_stones(result.reference, stone):
            other = fit(
                replace(whole, reference=None), law, load=load, stone=stone.with_values(constants),
                until=until, fix=fix, bounds=bounds, unbounded=unbounded, start=values, loss=loss,
                noise=noise,
            )  # fmt: skip
            each = {name: item.value for name, item in other.coefficients.items()}
            each |= {item.expression: item.value for item in other.combinations}
            found.append({"stone": constants, "values": each})
        return tuple(found)

    if noise == "white":
        return completed(record(problem, sigma, solution), problem, solution)
    n = len(throw)
    speed = np.asarray(trace(law, load, solution.values, problem))[CHANNELS.index("speed"), :n]
    moving = np.flatnonzero(speed > 0)
    span = float(throw.t[moving[-1]] - throw.t[0]) if len(moving) else 0.0
    shown, sizes = fitted_noise(
        noise, throw, solution.residual[:, :n], solution.jacobian[:, :n, parameters.free],
        problem.weight[:, :n], span,
    )  # fmt: skip
    sigma = {name: sizes.get(name, value) + SIGMA_FLOOR for name, value in sigma.items()}
    problem = problem_of(throw, stone, frame, sigma, noise=shown)
    solution = descend(law, load, solution.values, local, problem) or solution
    result = replace(record(problem, sigma, solution), noise=shown)
    lasting = max(shown.memory.values(), default=0.0)
    if lasting > _LASTING * span:
        rough = (
            f"the noise remembers {lasting:.2g} s of a throw of {span:.3g} s, too long to be told "
            "well: its standard errors may be too small by half"
        )
        result = replace(result, warnings=(*result.warnings, rough))
    return completed(result, problem, solution)


def _other_stones(reference: Reference, stone: Stone) -> list[dict[str, float]]:
    """Constants to fit with again: those of the reference, and one more by its rounding each."""
    now = stone.as_dict()
    own = {name: value for name, value in reference.stone.items() if value != now[name]}
    if not own:
        return []
    off = [{name: round(now[name] + by, 9)} for name, by in reference.rounding.items()]
    return [own, *(item for item in off if item != own)]


class Job(NamedTuple):
    """A throw ready to be fitted: cut, with its stone, its parameters and its frame."""

    throw: Throw
    stone: Stone
    until: float | None
    parameters: ParameterSet
    frame: Frame


def prepared(
    throw: Throw, law: type[Law], stone: Stone | None, until: float | None, **choices: Any
) -> Job:
    """The throw with its own defaults filled in, and condensed where it is very long.

    `choices` are those of `ParameterSet.build`.

    Raises
    ------
    InputError : as in `fit`.
    """
    if stone is None:
        stone = Stone().with_values(throw.defaults.get("stone", {}))
    until = throw.defaults.get("until") if until is None else until
    if not throw.sigma and throw.defaults.get("sigma"):
        throw = throw.with_sigma(throw.defaults["sigma"])
    throw = throw.until(until)
    throw.require_motion()
    throw = throw.condensed()
    return Job(throw, stone, until, ParameterSet.for_throw(law, throw, **choices), frame_of(throw))


def bulk_sigma(
    throw: Throw, residual: Floats, problem: Problem, sigma: dict[str, float]
) -> dict[str, float]:
    """Sigma by channel from the bulk of the residuals (in units of the sigma so far)."""
    n = len(throw)
    return {
        name: robust_sigma(residual[row, :n][problem.weight[row, :n] > 0]) * sigma[name]
        + SIGMA_FLOOR
        for row, name in enumerate(CHANNELS[: len(residual)])
        if name in sigma
    }


def first_sigma(throw: Throw) -> dict[str, float]:
    """Sigma of the first fit for the channels whose own is unknown: even weights."""
    given = [float(np.nanmedian(series)) for series in throw.sigma.values()]
    even = float(np.exp(np.mean(np.log(given)))) if given else 1.0
    return {name: even for name in throw.seen if name not in throw.sigma}


def estimated_sigma(
    solution: Solution, problem: Problem, parameters: ParameterSet, names: Iterable[str]
) -> dict[str, float]:
    """Sigma of some channels from the scatter about an optimum (see `residual_sigma`)."""
    (found,) = residual_sigma(stacked([solution]), stacked([problem]), parameters.free[None])
    return {name: float(found[CHANNELS.index(name)]) + SIGMA_FLOOR for name in names}


def shifted(parameters: ParameterSet, by: Floats) -> ParameterSet:
    """The set with values and bounds moved, from the data's coordinates to the problem's."""
    moved_parameters = tuple(
        replace(item, lower=item.lower + shift, upper=item.upper + shift)
        for item, shift in zip(parameters.parameters, by, strict=True)
    )
    fixed = {name: value + by[parameters.index(name)] for name, value in parameters.fixed.items()}
    return ParameterSet(moved_parameters, fixed)


def _user_start(
    values: Floats, start: Mapping[str, float], parameters: ParameterSet, frame: Frame
) -> Floats:
    offset = frame.offset(len(parameters))
    absolute = values + offset
    parameters.require("start", start)
    for name, value in start.items():
        absolute[parameters.index(name)] = value
    return np.clip(absolute, parameters.lower, parameters.upper) - offset
