"""Start values from the data, so that nobody has to guess.

A polynomial through each channel gives speed, direction and spin well enough to evaluate the
law's forces along the path. In these the law's coefficients are linear, or are made so; their
forces are integrated twice over time and fitted to the measured places and angles themselves by
linear least squares. Nothing is differentiated but the polynomial, and that only once.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, NamedTuple

from curlfit.contact import accelerations

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.polynomial import Chebyshev
from numpy.polynomial.chebyshev import chebder, chebval, chebvander
from numpy.typing import NDArray

from curlfit.friction import Coefficient, Law, Load
from curlfit.identifiability import triangle
from curlfit.likelihood import Problem
from curlfit.parameters import ParameterSet
from curlfit.programs import kept
from curlfit.stone import Stone
from curlfit.throw import last_motion

Floats = NDArray[np.float64]

_GRID = 128
_DEGREE = 5
_USUAL_SPEED = 2.0  # m/s, where nothing tells it


def usual(item: Coefficient) -> float:
    """A value to start from: an optional coefficient that is asked for is not at its default."""
    return item.typical if item.optional else item.default


class Smooth(NamedTuple):
    """Polynomials through the moving part of a path."""

    span: float
    """s from the first row to the last in which the stone moved"""
    curves: tuple[Chebyshev | None, ...]
    """x, y, phi; None for a channel of which nothing is known. Where only the speed or the spin
    was measured, y or phi is its integral"""
    rms: Floats
    """of the data about the polynomials, floored, inf where not seen; shape (channels,)"""


def smooth(problem: Problem) -> Smooth:
    """Polynomials of degree 5 or less through each channel, up to where the stone came to rest."""
    t = problem.times
    span = t[-1]
    shown = np.where(problem.weight > 0, problem.observed, np.nan)
    last = last_motion(t, shown[0], shown[1])
    if last < 0.9 * span:
        span = last
    rms = np.full(len(problem.observed), np.inf)
    bases: dict[tuple[bytes, int], tuple[Floats, Floats, Floats]] = {}

    def through(row: int) -> Chebyshev | None:
        use = (problem.weight[row] > 0) & (t <= span)
        n = int(use.sum())
        if n < 2:
            return None
        degree = min(_DEGREE, max(min(2, n - 1), (n - 1) // 3))
        # Channels that were seen in the same rows have one basis.
        key = (use.tobytes(), degree)
        if key not in bases:
            basis = chebvander(2 * t[use] / span - 1, degree)
            bases[key] = basis, *np.linalg.qr(basis)
        basis, q, r = bases[key]
        values = problem.observed[row][use]
        found = np.linalg.solve(r, q.T @ values)
        residual = values - basis @ found
        rms[row] = max(float(np.sqrt(np.mean(residual**2))), 1e-6)
        return Chebyshev(found, domain=[0, span])

    curves = [through(row) for row in range(3)]
    if len(rms) > 3:
        speed, omega = through(3), through(4)
        if curves[0] is None and curves[1] is None and speed is not None:
            curves[1] = speed.integ(lbnd=0)
        if curves[2] is None and omega is not None:
            curves[2] = omega.integ(lbnd=0)
    return Smooth(span, tuple(curves), rms)


@kept("law", "load")
def _forces(
    law: type[Law],
    load: Load,
    coefficients: Array,
    stone: Stone,
    v: Array,
    omega: Array,
    turned: Array,
    time: Array,
) -> tuple[Array, Array]:
    """Accelerations (xi, eta, angular) along the path and their derivatives by coefficient."""

    def along(coefficients: Array) -> Array:
        friction = law.from_vector(coefficients)
        one = partial(accelerations, friction, stone, load)
        return jnp.stack(jax.vmap(one)(v, omega, turned, time))

    return along(coefficients), jax.jacfwd(along)(coefficients)


def start_values(
    law: type[Law],
    load: Load,
    problem: Problem,
    path: Smooth,
    parameters: ParameterSet,
    spin: float = 1.0,
) -> Floats:
    """A parameter vector near the optimum, inside the bounds.

    `spin` (rad/s) is used where the angle was never seen.
    """
    grid = np.linspace(0, path.span, _GRID)
    x, y, phi = path.curves
    vx = _slope(x) if x is not None else np.zeros(_GRID)
    vy = _slope(y) if y is not None else np.zeros(_GRID)
    if x is None and y is None:
        vy = _USUAL_SPEED * (1 - 0.9 * grid / path.span)
    v, heading = np.hypot(vx, vy), np.arctan2(vx, vy)
    omega = _slope(phi) if phi is not None else np.full(_GRID, spin)
    turned = _rise(phi) if phi is not None else spin * grid
    s, c = np.sin(heading), np.cos(heading)

    k = len(law.coefficients())
    lower, upper = parameters.lower, parameters.upper
    nominal = np.clip([usual(item) for item in law.coefficients()], lower[:k], upper[:k])
    use = (problem.weight > 0) & (problem.times <= path.span)
    values = np.zeros(len(parameters))
    for _ in range(3):
        a, by_coefficient = (
            np.asarray(item)
            for item in _forces(law, load, nominal, problem.stone, v, omega, turned, grid)
        )
        slopes = np.concatenate([by_coefficient, a[..., None]], -1)
        slopes[..., -1] -= by_coefficient @ nominal
        slopes = np.nan_to_num(slopes)
        in_ice = np.stack(  # from the moving frame to x, y, phi
            [
                slopes[0] * c[:, None] + slopes[1] * s[:, None],
                -slopes[0] * s[:, None] + slopes[1] * c[:, None],
                slopes[2],
            ]
        )
        step = grid[1] - grid[0]
        once = _cumulative(in_ice, step)
        twice = _cumulative(once, step)

        # Place and angle are integrated twice, speed (along the first direction) and spin once.
        rows, right = [], []
        for row in range(len(problem.observed)):
            t = problem.times[use[row]]
            series, axis = (twice[row], row) if row < 3 else (once[row - 2], row - 2)
            if row == 3 and (use[0].any() or use[1].any()):
                continue  # the places tell it already
            below = np.minimum((t / step).astype(int), _GRID - 2)
            share = (t / step - below)[:, None]
            between = series[below] * (1 - share) + series[below + 1] * share
            design = np.zeros((len(t), k + 6))
            design[:, :k] = between[:, :k]
            if row < 3:
                design[:, k + 2 * axis] = 1.0
            design[:, k + 2 * axis + 1] = t if row < 3 else 1.0
            rows.append(design / path.rms[row])
            right.append((problem.observed[row][use[row]] - between[:, k]) / path.rms[row])
        low = np.concatenate([lower[:k], np.full(6, -np.inf)])
        high = np.concatenate([upper[:k], np.full(6, np.inf)])
        solution = _bounded_least_squares(np.concatenate(rows), np.concatenate(right), low, high)
        gap = np.abs(by_coefficient @ nominal - a)
        linear = bool((gap <= 1e-12 + 1e-9 * np.abs(a)).all())
        nominal = solution[:k]
        if linear:
            break

    x0, vx0, y0, vy0, phi0, omega0 = solution[k:]
    if phi is None:
        phi0, omega0 = 0.0, spin
    if v[0] > 0.02 and np.hypot(vx0, vy0) < 0.2 * v[0]:
        vx0, vy0 = vx[0], vy[0]
    values[:k] = nominal
    values[k:] = x0, y0, np.arctan2(vx0, vy0), np.hypot(vx0, vy0), phi0, omega0
    return np.clip(values, lower, upper)


@cache
def _bases(size: int) -> tuple[Any, Any]:
    """Chebyshev polynomials on the grid, and their slopes, by -1 to 1."""
    places = np.linspace(-1, 1, _GRID)
    slopes = np.asarray(chebval(places, chebder(np.eye(size))), float)
    return chebvander(places, size - 1), slopes.T


def _slope(curve: Any) -> Floats:
    """Its time derivative on the grid."""
    _, slopes = _bases(len(curve.coef))
    return slopes @ curve.coef * (2 / curve.domain[1])


def _rise(curve: Any) -> Floats:
    """How far it has come on the grid since the beginning."""
    values, _ = _bases(len(curve.coef))
    return (values - values[0]) @ curve.coef


def _cumulative(values: Floats, step: float) -> Floats:
    """Running integral over the second axis, by the trapezoidal rule."""
    middle = (values[:, 1:] + values[:, :-1]) / 2 * step
    return np.concatenate([np.zeros_like(values[:, :1]), np.cumsum(middle, 1)], 1)


def _bounded_least_squares(matrix: Floats, right: Floats, low: Floats, high: Floats) -> Floats:
    """Linear least squares, the smallest solution where several fit, held within bounds."""
    few = triangle(np.column_stack([matrix, right]))
    matrix, right = few[:, :-1], few[:, -1]
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0] = 1.0
    held = np.full(matrix.shape[1], np.nan)
    solution = np.zeros(matrix.shape[1])
    for _ in range(matrix.shape[1]):
        free = np.isnan(held)
        known = matrix[:, ~free] @ held[~free]
        solution[~free] = held[~free]
        solution[free] = (
            np.linalg.lstsq(matrix[:, free] / size[free], right - known, rcond=1e-9)[0] / size[free]
        )
        outside = free & ((solution < low) | (solution > high))
        if not outside.any():
            break
        held[outside] = np.clip(solution, low, high)[outside]
    return np.clip(solution, low, high)
