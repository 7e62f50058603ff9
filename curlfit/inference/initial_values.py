"""Initial values from the data.

A polynomial through each channel gives speed, direction and spin accurately enough to
evaluate the law's forces along the path. These are linear in the law's coefficients,
or are linearized; they are integrated twice over time and fitted to the measured
positions and angles by linear least squares. Only the polynomial is differentiated,
and only once.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.polynomial.chebyshev import chebder, chebint, chebvander

from curlfit.dynamics.contact import accelerations
from curlfit.friction import Coefficient, Law, Load
from curlfit.inference.information.directions import inverted, r_factor
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import Problem
from curlfit.inference.system import assumed_conditions
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import BATCH, in_batches
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.numerics.trapezoid import running_integral
from curlfit.stone import Stone
from curlfit.throws.throw import last_motion

_DEGREE = 5
# length of a column, over the longest, below which it is rounding error
_NOTHING = 1e-13
# singular value over the largest, below which derivatives are not accurate enough
_FAINT = 1e-6
_USUAL_SPEED = 2.0  # m/s, where no measurement determines it
# typical sizes from its initial guess, where a coefficient hardly acts any more
_ASTRAY = 20.0


def default_guess(item: Coefficient) -> float:
    """Initial guess of a coefficient; an optional one that is fitted is not at
    its default."""
    return item.typical if item.optional else item.default


def usual_where_astray(law: type[Law], values: Floats, typical: Floats) -> Floats:
    """Initial guesses of the coefficients that are so far from these that they hardly
    act any more; NaN for the other parameters."""
    found = np.full(len(values), np.nan)
    for place, item in enumerate(law.coefficients()):
        usual = default_guess(item)
        if abs(values[place] - usual) > _ASTRAY * typical[place]:
            found[place] = usual
    return found


class SmoothPath(NamedTuple):
    """Polynomials through the moving part of many paths, throws along
    the first axis."""

    span: Floats
    """s from the first row to the last with the stone in motion, shape (throws,)"""
    curves: Floats
    """Chebyshev coefficients over 0..span of x, y, phi, shape (throws, 3,
    coefficients). Where only the speed or the spin was measured, y or phi is
    its integral"""
    known: Booleans
    """whether anything is known of x, y, phi, shape (throws, 3)"""
    rms: Floats
    """of the data about the polynomials, floored, inf if not observed; shape
    (throws, channels)"""


def smooth(problems: Problem) -> SmoothPath:
    """Polynomials of degree 5 or less through each channel, up to where the stone
    came to rest.

    Parameters
    ----------
    problems : of many throws, as `stacked` returns them.
    """
    t, seen, observed = problems.times, problems.weight > 0, problems.observed
    shown = np.where(seen[:, :2], observed[:, :2], np.nan)
    last = np.array(
        [last_motion(*one) for one in zip(t, shown[:, 0], shown[:, 1], strict=True)]
    )
    span = np.maximum(np.where(last < 0.9 * t[:, -1], last, t[:, -1]), 1e-9)
    use = seen & (t <= span[:, None])[:, None]
    n = use.sum(-1)
    degree = np.minimum(_DEGREE, np.maximum(np.minimum(2, n - 1), (n - 1) // 3))
    part = (np.arange(_DEGREE + 1) <= degree[..., None]) & (n >= 2)[..., None]
    basis = chebvander(2 * t / span[:, None] - 1, _DEGREE)
    few = r_factor(
        np.concatenate([basis[:, None] * part[:, :, None], observed[..., None]], -1)
        * use[..., None]
    )
    matrix = few[..., :-1, :-1] + np.eye(_DEGREE + 1) * ~part[..., None, :]
    found = np.linalg.solve(matrix, few[..., :-1, -1:])[..., 0] * part
    rms = np.maximum(np.abs(few[..., -1, -1]) / np.sqrt(np.maximum(n, 1)), 1e-6)
    known = n >= 2
    curves = np.pad(found, ((0, 0), (0, 0), (0, 1)))  # an integral has one term more
    if len(found[0]) > 3:
        risen = chebint(found[:, 3:], lbnd=-1, axis=-1) * span[:, None, None] / 2
        placeless = ~known[:, 0] & ~known[:, 1] & known[:, 3]
        angleless = ~known[:, 2] & known[:, 4]
        curves[placeless, 1], curves[angleless, 2] = (
            risen[placeless, 0],
            risen[angleless, 1],
        )
        known[:, 1] |= placeless
        known[:, 2] |= angleless
    return SmoothPath(span, curves[:, :3], known[:, :3], np.where(n >= 2, rms, np.inf))


def start_values(
    model: Model,
    problems: Problem,
    path: SmoothPath,
    lower: Floats,
    upper: Floats,
    *,
    spin: float = 1.0,
    mirrored: bool = False,
    batch: int = BATCH,
) -> Floats:
    """Parameter vectors near the optima, within the bounds, shape (throws, parameters).

    What the data do not determine to first order is near the usual
    coefficients of the law.

    Parameters
    ----------
    problems : of many throws, as `stacked` returns them; `path` is what `smooth`
        returns for them.
    lower, upper : bounds, shape (throws, parameters).
    spin : in rad/s, where the angle was not measured.
    mirrored : whether this is near the reflection of the usual coefficients in the
        smallest ones.
    batch : number of throws computed together.
    """
    law = model.law
    k = len(law.coefficients())
    moving = _moving(path, spin)
    use = (problems.weight > 0) & (problems.times <= path.span[:, None])[:, None]
    if use.shape[1] > 3:
        # the positions determine it already
        use[:, 3] &= ~use[:, :2].any((1, 2))[:, None]
    free = np.full((len(lower), len(START)), np.inf)
    low, high = np.hstack([lower[:, :k], -free]), np.hstack([upper[:, :k], free])
    found = np.zeros_like(low)
    found[:, :k] = np.clip(
        [default_guess(item) for item in law.coefficients()], low[:, :k], high[:, :k]
    )
    typical = np.array([item.typical for item in law.coefficients()])
    going = np.arange(len(found))
    for step in range(3):
        here: Any = jax.tree.map(
            lambda leaf, going=going: leaf[going], (problems, path, moving)
        )
        nominal = found[going, :k]
        a, by_coefficient = accelerations_and_slopes(
            model, nominal, typical, here[0].stone, here[2].measured, batch
        )
        linear = (by_coefficient @ nominal[:, None, :, None])[..., 0]
        slopes = np.concatenate([by_coefficient, (a - linear)[..., None]], -1)
        matrix, right = _design(np.nan_to_num(slopes), use[going], *here)
        about = matrix, right, low[going], high[going]
        if mirrored and step == 0:
            nearest = _bounded_least_squares(*about, found)
            found = np.clip(
                2 * _bounded_least_squares(*about, 0 * found) - nearest, low, high
            )
        found[going] = _bounded_least_squares(*about, found[going])
        bent = np.abs(linear - a) > 1e-12 + 1e-9 * np.abs(a)
        going = going[(bent | np.isnan(a)).any((1, 2))]
        if not len(going):
            break
    conditions, state = (
        assumed_conditions(model, problems),
        _state(found[:, k:], path, moving, spin),
    )
    return np.clip(np.hstack([found[:, :k], conditions, state]), lower, upper)


def _state(found: Floats, path: SmoothPath, moving: _Moving, spin: float) -> Floats:
    """Initial states, in the order of `START`, from x0, vx0, y0, vy0, phi0, omega0."""
    x0, vx0, y0, vy0, phi0, omega0 = found.T
    turning = path.known[:, 2]
    v, first = moving.measured[:, 0, 0], moving.velocity[:, :, 0].T
    slow = (v > 0.02) & (np.hypot(vx0, vy0) < 0.2 * v)
    velocity = np.where(slow, first, (vx0, vy0))
    return np.stack(
        [
            x0,
            y0,
            np.arctan2(*velocity),
            np.hypot(*velocity),
            np.where(turning, phi0, 0.0),
            np.where(turning, omega0, spin),
        ],
        -1,
    )


def start_values_of_sides(
    model: Model,
    problems: Problem,
    path: SmoothPath,
    lower: Floats,
    upper: Floats,
    *,
    batch: int = BATCH,
) -> Floats:
    """Initial values on all sides that may fit equally, shape (sides,
    throws, parameters).

    Without the angle a path tells the sense of the spin at most by the side of the
    curl; without x it does not tell this side. Values with the most usual coefficients
    come first. Arguments as in `start_values`.
    """
    about = model, problems, path, lower, upper
    if path.known.all():
        return start_values(*about, batch=batch)[None]
    found = np.stack(
        [
            start_values(*about, spin=spin, mirrored=mirrored, batch=batch)
            for mirrored in (False, True)
            for spin in (1.0, -1.0)
        ]
    )
    items = model.law.coefficients()
    usual = np.array([default_guess(item) for item in items])
    typical = np.array([item.typical for item in items])
    away = (((found[..., : len(items)] - usual) / typical) ** 2).sum(-1)
    order = np.argsort(np.round(away, 6), 0, kind="stable")
    return np.take_along_axis(found, order[..., None], 0)


class _Moving(NamedTuple):
    """Motions along the polynomials, on a grid over the span."""

    velocity: Floats
    """vx, vy, shape (throws, 2, n)"""
    measured: Floats
    """speed, spin, angle and time, shape (throws, 4, n)"""


def _moving(path: SmoothPath, spin: float) -> _Moving:
    size, places = path.curves.shape[-1], np.linspace(0, 1, POINTS)
    values, slopes = chebvander(2 * places - 1, size - 1), chebder(np.eye(size))
    pace = path.curves @ (values[:, :-1] @ slopes).T * (2 / path.span[:, None, None])
    grid = path.span[:, None] * places
    unknown_y, turning = ~path.known[:, 1], path.known[:, 2, None]
    pace[unknown_y, 1] = _USUAL_SPEED * (1 - 0.9 * places)
    omega = np.where(turning, pace[:, 2], spin)
    turned = np.where(turning, path.curves[:, 2] @ (values - values[0]).T, spin * grid)
    velocity = pace[:, :2]
    return _Moving(
        velocity, np.stack([np.hypot(*velocity.swapaxes(0, 1)), omega, turned, grid], 1)
    )


def _design(
    slopes: Floats, use: Booleans, problems: Problem, path: SmoothPath, moving: _Moving
) -> tuple[Floats, Floats]:
    """Linear least-squares problem for coefficients, x0, vx0, y0, vy0, phi0, omega0,
    in few rows.

    Parameters
    ----------
    slopes : accelerations (xi, eta, angular) per unit of each coefficient, and those
        that depend on none, shape (throws, 3, n, coefficients + 1).

    Returns
    -------
    Matrices, of shape (throws, rows, coefficients + 6), and right-hand sides.
    """
    heading = np.arctan2(moving.velocity[:, 0], moving.velocity[:, 1])[..., None]
    s, c = np.sin(heading), np.cos(heading)
    in_ice = np.stack(  # from the moving frame to x, y, phi
        [
            slopes[:, 0] * c + slopes[:, 1] * s,
            -slopes[:, 0] * s + slopes[:, 1] * c,
            slopes[:, 2],
        ],
        1,
    )
    step = path.span[:, None] / (POINTS - 1)
    along_last = np.moveaxis(in_ice, 2, -1)
    once = running_integral(along_last, step[..., None, None])
    twice = np.moveaxis(running_integral(once, step[..., None, None]), -1, 2)
    once = np.moveaxis(once, -1, 2)

    channels, rows = use.shape[1:]
    k, times = slopes.shape[-1] - 1, problems.times
    place = np.minimum(times / step, POINTS - 1.0)
    below = np.minimum(place.astype(int), POINTS - 2)
    share, throw = (place - below)[..., None], np.arange(len(times))[:, None]
    design = np.zeros((len(times), channels, rows, k + len(START) + 1))
    for row in range(channels):
        # Position and angle are integrated twice, speed (along the initial heading)
        # and spin once.
        series, axis = (twice, row) if row < 3 else (once, row - 2)
        early, late = (series[throw, axis, below + here] for here in (0, 1))
        own = early + share * (late - early)
        design[:, row, :, :k] = own[..., :k]
        design[:, row, :, k + 2 * axis] = 1.0 if row < 3 else 0.0
        design[:, row, :, k + 2 * axis + 1] = times if row < 3 else 1.0
        design[:, row, :, -1] = problems.observed[:, row] - own[..., k]
    design = np.where(np.isfinite(design).all((2, 3), keepdims=True), design, 0.0)
    design *= (use / path.rms[..., None])[..., None]
    few = r_factor(design.reshape(len(times), channels * rows, -1))
    return few[..., :-1], few[..., -1]


def _bounded_least_squares(
    matrix: Floats, right: Floats, low: Floats, high: Floats, nominal: Floats
) -> Floats:
    """Linear least squares of many throws within bounds; the solution nearest to the
    nominal one where it is not unique. The smallest could be where by symmetry chi
    squared has a saddle point.
    """
    right, low, high = (
        right - (matrix @ nominal[..., None])[..., 0],
        low - nominal,
        high - nominal,
    )
    size = np.linalg.norm(matrix, axis=1)
    size[size <= _NOTHING * size.max(1, keepdims=True)] = np.inf  # has no effect: 0
    held = np.full_like(low, np.nan)
    solution = np.zeros_like(low)
    for _ in range(low.shape[1]):
        free = np.isnan(held)
        known = (matrix @ np.where(free, 0.0, held)[..., None])[..., 0]
        left, singular, rows = np.linalg.svd(
            matrix * np.where(free, 1 / size, 0.0)[:, None], full_matrices=False
        )
        inverse = inverted(singular, singular > _FAINT * singular[:, :1])[..., None]
        found = rows.mT @ (inverse * (left.mT @ (right - known)[..., None]))
        solution = np.where(free, found[..., 0] / size, held)
        outside = free & ((solution < low) | (solution > high))
        if not outside.any():
            break
        held = np.where(outside, np.clip(solution, low, high), held)
    return nominal + np.clip(solution, low, high)


POINTS = 128
"""Number of points along a path."""
_STEP = 1e-4  # of differences, over the typical size


def accelerations_along(
    model: Model, coefficients: Floats, stones: Stone, paths: Floats, batch: int = BATCH
) -> Floats:
    """Accelerations (xi, eta, angular) along the paths of many throws, shape
    (throws, 3, POINTS).

    Parameters
    ----------
    coefficients : shape (throws, POINTS, coefficients).
    stones : each field of shape (throws,).
    paths : speed, spin, angle and time, shape (throws, 4, POINTS).
    batch : number of throws computed together.
    """
    program = partial(_accelerations, model.of_program.law, model.load)
    found: Any = in_batches(program, (model.vector(coefficients), stones, paths), batch)
    return np.asarray(found)


def accelerations_and_slopes(
    model: Model,
    coefficients: Floats,
    typical: Floats,
    stones: Stone,
    paths: Floats,
    batch: int,
) -> tuple[Floats, Floats]:
    """Accelerations for one coefficient vector per throw, and their derivatives by it;
    these are exact to rounding where the accelerations are linear.

    Parameters
    ----------
    coefficients : shape (throws, coefficients). typical : their order of magnitude.

    Returns
    -------
    Shapes (throws, 3, POINTS) and (throws, 3, POINTS, coefficients).
    """

    def at(change: Floats) -> Floats:
        everywhere = np.repeat((coefficients + change)[:, None], POINTS, 1)
        return accelerations_along(model, everywhere, stones, paths, batch)

    none = np.zeros(len(typical))
    first = at(none)
    return first, slopes(at, none, _STEP * typical, value=first)


@compiled("law", "load")
def _accelerations(
    law: type[Law], load: Load, coefficients: Array, stones: Stone, paths: Array
) -> Array:
    def along(coefficients: Array, stone: Stone, path: Array) -> Array:
        return jnp.stack(
            accelerations(law.from_vector(coefficients.T), stone, load, *path)
        )

    return jax.vmap(along)(coefficients, stones, paths)
