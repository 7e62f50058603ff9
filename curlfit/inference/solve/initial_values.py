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
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START
from curlfit.inference.model.problem import Problem
from curlfit.inference.model.system import assumed_conditions
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import BATCH, in_batches
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.numerics.trapezoid import running_integral
from curlfit.stone import Stone
from curlfit.throws.channels import last_motion

_DEGREE = 5
# length of a column, over the longest, below which it is rounding error
_NOTHING = 1e-13
# singular value over the largest, below which derivatives are not accurate enough
_FAINT = 1e-6
_USUAL_SPEED = 2.0  # m/s, where no measurement determines it
# typical sizes from its initial guess, where a coefficient hardly acts any more
_ASTRAY = 20.0


def default_guess(coefficient: Coefficient) -> float:
    """Initial guess of a coefficient; an optional one that is fitted is not at
    its default."""
    return coefficient.typical if coefficient.optional else coefficient.default


def usual_where_astray(law: type[Law], values: Floats, typical: Floats) -> Floats:
    """Initial guesses of the coefficients that are so far from these that they hardly
    act any more; NaN for the other parameters."""
    usual_values = np.full(len(values), np.nan)
    for index, coefficient in enumerate(law.coefficients()):
        usual = default_guess(coefficient)
        if abs(values[index] - usual) > _ASTRAY * typical[index]:
            usual_values[index] = usual
    return usual_values


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
    t = problems.times
    observed = problems.observed
    is_seen = problems.weight > 0
    x, y = np.moveaxis(np.where(is_seen[:, :2], observed[:, :2], np.nan), 1, 0)
    last = np.array([last_motion(*of_throw) for of_throw in zip(t, x, y, strict=True)])
    span = np.maximum(np.where(last < 0.9 * t[:, -1], last, t[:, -1]), 1e-9)
    is_used = is_seen & (t <= span[:, None])[:, None]
    count = is_used.sum(-1)
    degree = np.minimum(_DEGREE, np.maximum(np.minimum(2, count - 1), (count - 1) // 3))
    is_known = count >= 2
    terms = (np.arange(_DEGREE + 1) <= degree[..., None]) & is_known[..., None]
    # Linear least squares of each channel; the right-hand side is the last column.
    basis = chebvander(2 * t / span[:, None] - 1, _DEGREE)
    columns = np.concatenate(
        [basis[:, None] * terms[:, :, None], observed[..., None]], -1
    )
    triangle = r_factor(columns * is_used[..., None])
    matrix = triangle[..., :-1, :-1] + np.eye(_DEGREE + 1) * ~terms[..., None, :]
    series = np.linalg.solve(matrix, triangle[..., :-1, -1:])[..., 0] * terms
    rms = np.abs(triangle[..., -1, -1]) / np.sqrt(np.maximum(count, 1))
    rms = np.where(is_known, np.maximum(rms, 1e-6), np.inf)
    # An integral has one term more.
    curves = np.pad(series[:, :3], ((0, 0), (0, 0), (0, 1)))
    known = is_known[:, :3].copy()
    if observed.shape[1] > 3:
        half = span[:, None] / 2
        distance = chebint(series[:, 3], lbnd=-1, axis=-1) * half
        turned = chebint(series[:, 4], lbnd=-1, axis=-1) * half
        placeless = ~is_known[:, 0] & ~is_known[:, 1] & is_known[:, 3]
        angleless = ~is_known[:, 2] & is_known[:, 4]
        curves[placeless, 1] = distance[placeless]
        curves[angleless, 2] = turned[angleless]
        known[:, 1] |= placeless
        known[:, 2] |= angleless
    return SmoothPath(span, curves, known, rms)


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
    coefficients = model.law.coefficients()
    k = len(coefficients)
    moving = _moving(path, spin)
    is_used = (problems.weight > 0) & (problems.times <= path.span[:, None])[:, None]
    if is_used.shape[1] > 3:
        # The positions determine the speed already.
        is_used[:, 3] &= ~is_used[:, :2].any((1, 2))[:, None]
    unbounded = np.full((len(lower), len(START)), np.inf)
    low = np.hstack([lower[:, :k], -unbounded])
    high = np.hstack([upper[:, :k], unbounded])
    values = np.zeros_like(low)
    usual = [default_guess(coefficient) for coefficient in coefficients]
    values[:, :k] = np.clip(usual, low[:, :k], high[:, :k])
    typical = np.array([coefficient.typical for coefficient in coefficients])
    due = np.arange(len(values))
    for step in range(3):
        of_due: Any = jax.tree.map(
            lambda leaf, due=due: leaf[due], (problems, path, moving)
        )
        nominal = values[due, :k]
        a, by_coefficient = accelerations_and_slopes(
            model, nominal, typical, of_due[0].stone, of_due[2].measured, batch
        )
        linear = (by_coefficient @ nominal[:, None, :, None])[..., 0]
        columns = np.concatenate([by_coefficient, (a - linear)[..., None]], -1)
        matrix, right = _design(np.nan_to_num(columns), is_used[due], *of_due)
        problem = matrix, right, low[due], high[due]
        if mirrored and step == 0:
            nearest_usual = _bounded_least_squares(*problem, values)
            nearest_zero = _bounded_least_squares(*problem, 0 * values)
            values = np.clip(2 * nearest_zero - nearest_usual, low, high)
        values[due] = _bounded_least_squares(*problem, values[due])
        is_bent = np.abs(linear - a) > 1e-12 + 1e-9 * np.abs(a)
        due = due[(is_bent | np.isnan(a)).any((1, 2))]
        if not len(due):
            break
    conditions = assumed_conditions(model, problems)
    state = _state(values[:, k:], path, moving, spin)
    return np.clip(np.hstack([values[:, :k], conditions, state]), lower, upper)


def _state(
    components: Floats, path: SmoothPath, moving: _Moving, spin: float
) -> Floats:
    """Initial states, in the order of `START`, from x0, vx0, y0, vy0, phi0, omega0."""
    x0, vx0, y0, vy0, phi0, omega0 = components.T
    turning = path.known[:, 2]
    v = moving.measured[:, 0, 0]
    first = moving.velocity[:, :, 0].T
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
    arguments = model, problems, path, lower, upper
    if path.known.all():
        return start_values(*arguments, batch=batch)[None]
    sides = np.stack(
        [
            start_values(*arguments, spin=spin, mirrored=mirrored, batch=batch)
            for mirrored in (False, True)
            for spin in (1.0, -1.0)
        ]
    )
    coefficients = model.law.coefficients()
    usual = np.array([default_guess(coefficient) for coefficient in coefficients])
    typical = np.array([coefficient.typical for coefficient in coefficients])
    of_law = sides[..., : len(coefficients)]
    away = (((of_law - usual) / typical) ** 2).sum(-1)
    order = np.argsort(np.round(away, 6), 0, kind="stable")
    return np.take_along_axis(sides, order[..., None], 0)


class _Moving(NamedTuple):
    """Motions along the polynomials, on a grid over the span."""

    velocity: Floats
    """vx, vy, shape (throws, 2, n)"""
    measured: Floats
    """speed, spin, angle and time, shape (throws, 4, n)"""


def _moving(path: SmoothPath, spin: float) -> _Moving:
    size = path.curves.shape[-1]
    shares = np.linspace(0, 1, POINTS)  # of the span
    values = chebvander(2 * shares - 1, size - 1)
    slopes = values[:, :-1] @ chebder(np.eye(size))
    rates = path.curves @ slopes.T * (2 / path.span[:, None, None])
    grid = path.span[:, None] * shares
    unknown_y = ~path.known[:, 1]
    turning = path.known[:, 2, None]
    rates[unknown_y, 1] = _USUAL_SPEED * (1 - 0.9 * shares)
    omega = np.where(turning, rates[:, 2], spin)
    turned = np.where(turning, path.curves[:, 2] @ (values - values[0]).T, spin * grid)
    velocity = rates[:, :2]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    return _Moving(velocity, np.stack([speed, omega, turned, grid], 1))


def _design(
    slopes: Floats,
    is_used: Booleans,
    problems: Problem,
    path: SmoothPath,
    moving: _Moving,
) -> tuple[Floats, Floats]:
    """Linear least-squares problem for coefficients, x0, vx0, y0, vy0, phi0, omega0,
    in few rows.

    Parameters
    ----------
    slopes : accelerations (xi, eta, angular) per unit of each coefficient, and those
        that depend on none, shape (throws, 3, n, coefficients + 1).
    is_used : which values are fitted, shape (throws, channels, rows).

    Returns
    -------
    Matrices, of shape (throws, rows, coefficients + 6), and right-hand sides.
    """
    heading = np.arctan2(moving.velocity[:, 0], moving.velocity[:, 1])[..., None]
    s = np.sin(heading)
    c = np.cos(heading)
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
    integral = running_integral(along_last, step[..., None, None])
    double_integral = running_integral(integral, step[..., None, None])
    once = np.moveaxis(integral, -1, 2)
    twice = np.moveaxis(double_integral, -1, 2)

    # Each row lies between two points of the grid along the path.
    times = problems.times
    on_grid = np.minimum(times / step, POINTS - 1.0)
    below = np.minimum(on_grid.astype(int), POINTS - 2)
    share = (on_grid - below)[..., None]
    throw = np.arange(len(times))[:, None]
    channels, rows = is_used.shape[1:]
    k = slopes.shape[-1] - 1
    design = np.zeros((len(times), channels, rows, k + len(START) + 1))
    for channel in range(channels):
        # Position and angle are integrated twice, speed (along the initial heading)
        # and spin once.
        is_position = channel < 3
        series = twice if is_position else once
        axis = channel if is_position else channel - 2
        before = series[throw, axis, below]
        after = series[throw, axis, below + 1]
        at_rows = before + share * (after - before)
        start = k + 2 * axis  # column of the position, before that of the velocity
        design[:, channel, :, :k] = at_rows[..., :k]
        design[:, channel, :, start] = 1.0 if is_position else 0.0
        design[:, channel, :, start + 1] = times if is_position else 1.0
        design[:, channel, :, -1] = problems.observed[:, channel] - at_rows[..., k]
    design = np.where(np.isfinite(design).all((2, 3), keepdims=True), design, 0.0)
    design *= (is_used / path.rms[..., None])[..., None]
    triangle = r_factor(design.reshape(len(times), channels * rows, -1))
    return triangle[..., :-1], triangle[..., -1]


def _bounded_least_squares(
    matrix: Floats, right: Floats, lower: Floats, upper: Floats, nominal: Floats
) -> Floats:
    """Linear least squares of many throws within bounds; the solution nearest to the
    nominal one where it is not unique. The smallest could be where by symmetry chi
    squared has a saddle point.
    """
    right = right - (matrix @ nominal[..., None])[..., 0]
    low = lower - nominal
    high = upper - nominal
    size = np.linalg.norm(matrix, axis=1)
    size[size <= _NOTHING * size.max(1, keepdims=True)] = np.inf  # has no effect: 0
    held = np.full_like(low, np.nan)
    solution = np.zeros_like(low)
    for _ in range(low.shape[1]):
        free = np.isnan(held)
        of_held = (matrix @ np.where(free, 0.0, held)[..., None])[..., 0]
        left, singular, axes = np.linalg.svd(
            matrix * np.where(free, 1 / size, 0.0)[:, None], full_matrices=False
        )
        inverse = inverted(singular, singular > _FAINT * singular[:, :1])[..., None]
        scaled = axes.mT @ (inverse * (left.mT @ (right - of_held)[..., None]))
        solution = np.where(free, scaled[..., 0] / size, held)
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
    arguments = model.vector(coefficients), stones, paths
    return np.asarray(in_batches(program, arguments, batch))


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
