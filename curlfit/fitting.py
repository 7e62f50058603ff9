"""Least squares: optimistix finds the optimum within bounds, and the answer is weighed.

Where no sigma is given, a first fit weights the channels evenly, 1 m like 1 rad. The scatter of
its residuals, corrected for the parameters spent, is the sigma of the second and last fit (two-step
generalised least squares). It is not repeated until both agree: where a law is not exact, that
ends with one channel fitted perfectly at the expense of the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from curlfit import backend  # noqa: F401  (before equinox)

# isort: split
import jax
import numpy as np
import optimistix as optx
from jaxtyping import Array
from numpy.typing import NDArray

from curlfit.box import BoxLevenbergMarquardt
from curlfit.errors import UnusableFitError
from curlfit.friction import Law, Load, check_load, find_law, no_motion_because
from curlfit.identifiability import Identifiability, analyse, slack
from curlfit.likelihood import (
    SIGMA_FLOOR,
    Frame,
    Problem,
    frame_of,
    problem_of,
    trace,
    weighted_residuals,
)
from curlfit.parameters import ParameterSet
from curlfit.results import Estimate, FitResult
from curlfit.starting import Smooth, smooth, start_values, usual
from curlfit.stone import Stone
from curlfit.throw import CHANNELS, Throw

Floats = NDArray[np.float64]

_TOLERANCE = 1e-10
_MOST_STEPS = 200
_POOR = (3.0, 0.02)  # rms over a polynomial's, and over the range: both, and more starts are tried
_LOOSE = 0.1  # typical sizes a parameter may be inside its bound before it counts as held by it
_SMOOTH = 0.5  # lag-1 correlation of residuals from which they are called smooth


class _Solution(NamedTuple):
    values: Any
    residual: Any
    """weighted, shape (channels, n)"""
    jacobian: Any
    """of the weighted residual by parameter, shape (channels, n, parameters)"""
    steps: Any
    finished: Any


@partial(jax.jit, static_argnames=("law", "load"))
def _solve(
    law: type[Law], load: Load, start: Array, lower: Array, upper: Array, scale: Array,
    problem: Problem,
) -> _Solution:  # fmt: skip
    def residual(z: Array, problem: Problem) -> Array:
        return weighted_residuals(law, load, z * scale, problem)

    solver = BoxLevenbergMarquardt(lower / scale, upper / scale, _TOLERANCE, _TOLERANCE)
    found: Any = optx.least_squares(
        residual,
        solver,
        start / scale,
        args=problem,
        options={"jac": "fwd"},
        max_steps=_MOST_STEPS,
        throw=False,
    )
    f_info = found.state.f_info
    return _Solution(
        values=found.value * scale,
        residual=f_info.residual,
        jacobian=f_info.jac.as_matrix().reshape(*f_info.residual.shape, -1) / scale,
        steps=found.stats["num_steps"],
        finished=found.result == optx.RESULTS.successful,
    )


def _chi_squared(solution: _Solution) -> float:
    return float((solution.residual**2).sum())


def _starts(
    law: type[Law], load: Load, problem: Problem, path: Smooth, parameters: ParameterSet
) -> list[Floats]:
    """Start values in the order in which to try them."""
    spins = (1.0,) if path.curves[2] is not None else (1.0, -1.0)
    first = [start_values(law, load, problem, path, parameters, spin) for spin in spins]
    others = []
    k = len(law.coefficients())
    defaults = np.array([usual(item) for item in law.coefficients()])
    for factor in (1.0, 0.3, 3.0):
        values = first[0].copy()
        values[:k] = defaults * factor
        others.append(np.clip(values, parameters.lower, parameters.upper))
    return [*first, *others]


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

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged and what to mind.

    Raises
    ------
    InputError : an unknown law, load or parameter name; too few rows; a stone that never moves.
    UnusableFitError : no start led to a finite fit.
    """
    law = find_law(law) if isinstance(law, str) else law
    load = check_load(load or throw.defaults.get("load", "uniform"))
    if stone is None:
        stone = Stone().with_values(throw.defaults.get("stone", {}))
    until = throw.defaults.get("until") if until is None else until
    if not throw.sigma and throw.defaults.get("sigma"):
        throw = throw.with_sigma(throw.defaults["sigma"])
    throw = throw.until(until)
    throw.require_motion()
    parameters = ParameterSet.for_throw(law, throw, fix=fix, bounds=bounds, unbounded=unbounded)
    frame = frame_of(throw)
    local = _shifted(parameters, -frame.offset(len(parameters)))
    sigma = _first_sigma(throw)
    problem = problem_of(throw, stone, frame, sigma)
    path = smooth(problem)
    starts = _starts(law, load, problem, path, local)
    if start:
        starts.insert(0, _user_start(starts[0], start, parameters, frame))
    solution, tried = _best(law, load, starts, local, problem, path)
    if solution is None:
        raise UnusableFitError(
            f"{throw.name}: law {law.name} with {load} load gives no finite path from any start"
            + no_motion_because(load)
        )
    if sigma:
        sigma = _estimated_sigma(throw, solution, problem, local, list(sigma))
        problem = problem_of(throw, stone, frame, sigma)
        solution = _descend(law, load, solution.values, local, problem) or solution
    return _result(
        throw, law, load, stone, until, parameters, frame, problem, sigma, solution, tried
    )


def _first_sigma(throw: Throw) -> dict[str, float]:
    """Sigma of the first fit for the channels whose own is unknown: even weights."""
    given = [float(np.nanmedian(series)) for series in throw.sigma.values()]
    even = float(np.exp(np.mean(np.log(given)))) if given else 1.0
    return {name: even for name in throw.seen if name not in throw.sigma}


def _estimated_sigma(
    throw: Throw,
    solution: _Solution,
    problem: Problem,
    parameters: ParameterSet,
    names: list[str],
) -> dict[str, float]:
    """sqrt(sum of squares/(n - p)) by channel, p the parameters it pays for itself."""
    n = len(throw)
    jacobian = solution.jacobian[:, :n, parameters.free]
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    left = left[:, singular > 1e-9 * singular[0]].reshape(len(solution.residual), n, -1)
    found = {}
    for row, name in enumerate(CHANNELS):
        if name in names:
            weight = problem.weight[row, :n]
            room = max((weight > 0).sum() - (left[row] ** 2).sum(), 1.0)
            scaled = (solution.residual[row] ** 2).sum() / room
            found[name] = float(np.sqrt(scaled) / weight.max()) + SIGMA_FLOOR
    return found


def _descend(
    law: type[Law], load: Load, start: Floats, parameters: ParameterSet, problem: Problem
) -> _Solution | None:
    """The optimum reached from one start; None where that start leads nowhere."""
    solution = jax.tree.map(
        np.asarray,
        _solve(law, load, start, parameters.lower, parameters.upper, parameters.typical, problem),
    )
    return solution if np.isfinite(_chi_squared(solution)) else None


def _shifted(parameters: ParameterSet, by: Floats) -> ParameterSet:
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


def _best(
    law: type[Law],
    load: Load,
    starts: list[Floats],
    parameters: ParameterSet,
    problem: Problem,
    path: Smooth,
) -> tuple[_Solution | None, int]:
    """The best optimum, and how many starts it took."""
    best: _Solution | None = None
    tried = 0
    for values in starts:
        if best is not None and not _poor(best, path, problem):
            break
        tried += 1
        found = _descend(law, load, values, parameters, problem)
        if found is not None and (
            best is None or _chi_squared(found) < (1 - 1e-9) * _chi_squared(best)
        ):
            best = found
    return best, tried


def _poor(solution: _Solution, path: Smooth, problem: Problem) -> bool:
    if not solution.finished:
        return True
    over_polynomial, over_range = _POOR
    for row in range(3):
        use = problem.weight[row] > 0
        if use.sum() < 3:
            continue
        residual = solution.residual[row][use] / problem.weight[row][use]
        rms = float(np.sqrt(np.mean(residual**2)))
        extent = float(np.ptp(problem.observed[row][use]))
        if rms > over_polynomial * path.rms[row] and rms > over_range * extent:
            return True
    return False


def _result(
    throw: Throw,
    law: type[Law],
    load: Load,
    stone: Stone,
    until: float | None,
    parameters: ParameterSet,
    frame: Frame,
    problem: Problem,
    sigma: dict[str, float],
    solution: _Solution,
    tried: int,
) -> FitResult:
    n = len(throw)
    offset = frame.offset(len(parameters))
    values = solution.values + offset
    seen = np.isfinite(throw.observed)
    curves = np.array(trace(law, load, solution.values, problem.times, problem.stone))[:, :n]
    curves += frame.place[:, None]
    residual = throw.observed - curves
    squares = np.where(seen, residual**2, 0.0).sum(1)
    count = seen.sum(1)
    rms = np.sqrt(squares / np.maximum(count, 1))

    free = parameters.free
    at_bound = _at_bound(solution, parameters, offset)
    open_, slack_columns = _open(solution, parameters, at_bound)
    known = analyse(
        solution.jacobian[:, :n, open_].reshape(-1, int(open_.sum())),
        parameters.names_where(open_),
        values[open_],
        parameters.typical[open_],
        slack_columns,
    )
    rms_by = {name: float(rms[row]) for row, name in enumerate(CHANNELS) if count[row]}
    lag1 = {
        name: _lag1(residual[row][seen[row]]) for row, name in enumerate(CHANNELS) if count[row] > 3
    }
    converged, status, warnings = _judge(
        law, solution, parameters, at_bound, known.names, tried,
        dict(zip(CHANNELS, count, strict=True)), rms_by, lag1,
    )  # fmt: skip
    kept = [name for name in CHANNELS if name in throw.seen or name in ("x", "y", "phi")]
    observed = {name: getattr(throw, name) for name in ("t", *kept)}
    observed |= {f"sigma_{name}": series for name, series in throw.sigma.items()}
    fitted = dict(zip(CHANNELS, curves, strict=True))
    return FitResult(
        law=law.name,
        load=load,
        stone=stone,
        data={
            "file": throw.name,
            "law_file": law.origin or None,
            "rows": n,
            "from": float(throw.t[0]),
            "to": float(throw.t[-1]),
            "until": until,
            "sigma": {name: "estimated" if name in sigma else "given" for name in rms_by},
            "notes": list(throw.notes),
        },
        converged=converged,
        status=status,
        warnings=tuple(warnings),
        n_observations=throw.n_observations,
        rms=rms_by,
        sigma=sigma,
        lag1=lag1,
        parameters=_estimates(parameters, values, known, open_, at_bound),
        combinations=known.combinations,
        rank=known.rank,
        singular_values=tuple(map(float, known.singular_values)),
        null_directions=known.null_directions,
        covariance={"names": list(known.names), "matrix": known.covariance.tolist()},
        information={
            "gradient": (
                -np.einsum("cn,cni->i", solution.residual, solution.jacobian)[free]
            ).tolist(),
            "names": parameters.names_where(free),
            "matrix": np.einsum("cni,cnj->ij", *[solution.jacobian[:, :, free]] * 2).tolist(),
        },
        reference=throw.reference if throw.reference and throw.reference.law == law.name else None,
        observed=observed,
        fitted=fitted,
    )


def _open(
    solution: _Solution, parameters: ParameterSet, at_bound: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Floats]:
    """The parameters that can move, and what those held at a bound add to their spread.

    A parameter that the data hardly push against its bound is not held by it: it is at the end of
    a ridge, and counts as open.
    """
    jacobian = solution.jacobian.reshape(-1, len(parameters))
    push = np.abs(solution.residual.reshape(-1) @ jacobian)
    room = parameters.upper - parameters.lower
    held = at_bound.copy()
    for _ in range(2):
        open_ = parameters.free & ~held
        found = slack(
            jacobian[:, open_], jacobian[:, held], push[held], parameters.typical[held], room[held]
        )
        loose = found.distance > _LOOSE * parameters.typical[held]
        if not loose.any():
            break
        held[held] = ~loose
    return open_, found.columns


def _at_bound(solution: _Solution, parameters: ParameterSet, offset: Floats) -> NDArray[np.bool_]:
    """Free parameters at a bound that the data push against it."""
    jacobian = solution.jacobian.reshape(-1, len(parameters))
    push = solution.residual.reshape(-1) @ jacobian * parameters.typical
    values = solution.values + offset
    near = 1e-9 * parameters.typical
    at_lower = (values <= parameters.lower + near) & (push > 1e-3)
    at_upper = (values >= parameters.upper - near) & (push < -1e-3)
    return parameters.free & (at_lower | at_upper)


def _estimates(
    parameters: ParameterSet,
    values: Floats,
    known: Identifiability,
    open_: NDArray[np.bool_],
    at_bound: NDArray[np.bool_],
) -> dict[str, Estimate]:
    found = {}
    place = np.cumsum(open_) - 1
    for row, item in enumerate(parameters.parameters):
        stderr = None
        if item.name in parameters.fixed:
            verdict = "fixed"
        elif at_bound[row]:
            verdict = "at bound"
        elif known.unseen[place[row]]:
            verdict = "not identifiable"
        else:
            stderr = float(np.sqrt(known.covariance[place[row], place[row]]))
            verdict = "determined" if stderr < item.typical else "weak"
        found[item.name] = Estimate(
            value=float(values[row]),
            stderr=stderr,
            verdict=verdict,
            unit=item.unit,
            symbol=item.symbol,
            meaning=item.meaning,
            lower=item.lower,
            upper=item.upper,
            typical=item.typical,
        )
    return found


def _lag1(residual: Floats) -> float:
    """Correlation of neighbouring residuals; 0 for independent noise."""
    centred = residual - residual.mean()
    total = float((centred**2).sum())
    return float((centred[1:] * centred[:-1]).sum() / total) if total > 0 else 0.0


def _judge(
    law: type[Law],
    solution: _Solution,
    parameters: ParameterSet,
    at_bound: NDArray[np.bool_],
    open_names: tuple[str, ...],
    tried: int,
    count: dict[str, int],
    rms: dict[str, float],
    correlation: dict[str, float],
) -> tuple[bool, str, list[str]]:
    """Converged or not, the same in words, and what the reader has to mind."""
    left = _distance_to_optimum(solution, parameters.free & ~at_bound)
    converged = bool(left < 0.01)
    steps = f"{int(solution.steps)} steps" + (f", best of {tried} starts" if tried > 1 else "")
    if converged:
        status = f"converged ({steps})"
    else:
        status = (
            f"not converged: the next step would still gain {left:.2g} standard errors ({steps})"
        )
    warnings = []
    fault = law.from_vector(solution.values).fault()
    if fault is not None:
        warnings.append(f"{fault}; the fitted coefficients make no law of friction")
    for item, stuck in zip(parameters.parameters, at_bound, strict=True):
        if stuck:
            within = f"{item.lower:g}..{item.upper:g}"
            warnings.append(
                f"{item.name} sits at its bound; "
                + (
                    f"the data hardly tell this from other values within {within}"
                    if item.name in open_names
                    else f"the data would rather have it outside {within}"
                )
            )
    smooth_in = {
        name: lag1
        for name, lag1 in correlation.items()
        if lag1 > _SMOOTH and count[name] > 20 and rms[name] > 10 * SIGMA_FLOOR
    }
    if smooth_in:
        listed = ", ".join(f"{r:.2f} in {name}" for name, r in smooth_in.items())
        warnings.append(
            f"the residuals are smooth (lag-1 correlation {listed}): they show what the law "
            "misses, not noise, and standard errors, which assume independent noise, are too small"
        )
    return converged, status, warnings


def _distance_to_optimum(solution: _Solution, free: NDArray[np.bool_]) -> float:
    """Length of the Gauss-Newton step that is left, in standard errors along seen directions."""
    jacobian = solution.jacobian.reshape(-1, len(free))[:, free]
    residual = solution.residual.reshape(-1)
    size = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1), full_matrices=False)
    seen = singular > 1e-7 * singular[0]
    scale = float(np.sqrt(np.mean(residual**2)))
    return float(np.linalg.norm(left[:, seen].T @ residual)) / max(1.0, scale)
