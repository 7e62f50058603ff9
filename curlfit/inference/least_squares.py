"""The optimum: start values tried in turn, optimistix within bounds."""

from __future__ import annotations

from typing import Any, NamedTuple

from curlfit.numerics import jax_setup  # noqa: F401  (before equinox)

# isort: split
import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from curlfit.friction import Law, Load
from curlfit.inference.identifiability import inverted
from curlfit.inference.initial_values import Smooth, start_values, usual
from curlfit.inference.likelihood import Problem, stacked, weighted_residuals
from curlfit.inference.parameters import ParameterSet
from curlfit.numerics.compiled import kept

Floats = NDArray[np.float64]

_TOLERANCE = 1e-10
_MOST_STEPS = 200
_NOTHING = 1e-7  # of the longest column of a Jacobian, below which another is but rounding
_ROUNDING = 1e-12  # squares of columns of length 1 that may be but rounding
_POOR = (3.0, 0.02)  # rms over a polynomial's, and over the range: both, and more starts are tried


class Solution(NamedTuple):
    """An optimum, in the coordinates of its problem."""

    values: Any
    residual: Any
    """weighted, shape (channels, n)"""
    jacobian: Any
    """of the weighted residual by parameter, shape (channels, n, parameters)"""
    steps: Any
    finished: Any


@kept("law", "load")
def _solve(
    law: type[Law], load: Load, start: Array, lower: Array, upper: Array, scale: Array,
    problem: Problem,
) -> Solution:  # fmt: skip
    # Loaded only where the program is made: that takes as long as all else there is to load.
    import optimistix as optx

    from curlfit.numerics.levenberg_marquardt import BoxLevenbergMarquardt

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
    return Solution(
        values=found.value * scale,
        residual=f_info.residual,
        jacobian=f_info.jac.as_matrix().reshape(*f_info.residual.shape, -1) / scale,
        steps=found.stats["num_steps"],
        finished=found.result == optx.RESULTS.successful,
    )


def chi_squared(solution: Solution) -> float:
    """Sum of the squared residuals."""
    return float((solution.residual**2).sum())


def starts(
    law: type[Law], load: Load, problem: Problem, path: Smooth, parameters: ParameterSet
) -> list[Floats]:
    """Start values in the order in which to try them; `path` is that of the problem alone."""
    spins = (1.0,) if path.known[0, 2] else (1.0, -1.0)
    bounds = parameters.lower[None], parameters.upper[None]
    one = stacked([problem])
    first = [start_values(law, load, one, path, *bounds, spin=s, lanes=1)[0] for s in spins]
    others = []
    k = len(law.coefficients())
    defaults = np.array([usual(item) for item in law.coefficients()])
    for factor in (1.0, 0.3, 3.0):
        values = first[0].copy()
        values[:k] = defaults * factor
        others.append(np.clip(values, parameters.lower, parameters.upper))
    return [*first, *others]


def descend(
    law: type[Law], load: Load, start: Floats, parameters: ParameterSet, problem: Problem
) -> Solution | None:
    """The optimum reached from one start; None where that start leads nowhere."""
    solution = jax.tree.map(
        np.asarray,
        _solve(law, load, start, parameters.lower, parameters.upper, parameters.typical, problem),
    )
    return solution if np.isfinite(chi_squared(solution)) else None


def best_of(
    law: type[Law],
    load: Load,
    tries: list[Floats],
    parameters: ParameterSet,
    problem: Problem,
    path: Smooth,
) -> tuple[Solution | None, int]:
    """The best optimum, and how many starts it took."""
    found: Solution | None = None
    tried = 0
    for values in tries:
        if found is not None and not poor(stacked([found]), path, stacked([problem]))[0]:
            break
        tried += 1
        other = descend(law, load, values, parameters, problem)
        if other is not None and (
            found is None or chi_squared(other) < (1 - 1e-9) * chi_squared(found)
        ):
            found = other
    return found, tried


def poor(solutions: Solution, paths: Smooth, problems: Problem) -> NDArray[np.bool_]:
    """Which of many optima are so bad that another start is worth trying."""
    seen = problems.weight[:, :3] > 0
    n = seen.sum(-1)
    residual = solutions.residual[:, :3] / np.where(seen, problems.weight[:, :3], np.inf)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(n, 1))
    observed = problems.observed[:, :3]
    highest = np.where(seen, observed, -np.inf).max(-1)
    lowest = np.where(seen, observed, np.inf).min(-1)
    over_polynomial, over_range = _POOR
    off = (rms > over_polynomial * paths.rms[:, :3]) & (rms > over_range * (highest - lowest))
    return ~np.asarray(solutions.finished) | (off & (n >= 3)).any(-1)


def residual_sigma(
    solutions: Solution, problems: Problem, free: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """sqrt(sum of squares/(n - p)) by channel of many throws, p the parameters it pays for itself.

    Parameters
    ----------
    free : which parameters were fitted, shape (throws, parameters).

    Returns
    -------
    In the channels' units, shape (throws, channels); 0 where nothing was seen.
    """
    jacobian = np.asarray(solutions.jacobian)
    normal = jacobian.mT @ jacobian * (free[:, None, :, None] & free[:, None, None, :])
    whole = normal.sum(1)
    size = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
    scale = inverted(size, size > _NOTHING * size.max(1, initial=0.0)[:, None])
    squares, axes = np.linalg.eigh(whole * scale[:, None] * scale[..., None])
    axes = axes * scale[..., None]
    inverse = axes * inverted(squares, squares > _ROUNDING)[:, None] @ axes.mT
    paid = (normal * inverse[:, None]).sum((-1, -2))
    room = np.maximum((problems.weight > 0).sum(-1) - paid, 1.0)
    largest = problems.weight.max(-1)
    rms = np.sqrt((solutions.residual**2).sum(-1) / room)
    return np.where(largest > 0, rms / np.where(largest > 0, largest, 1.0), 0.0)
