"""Model discrepancy: accelerations that the law lacks, and their effect on a path.

A law that is not exact lacks an acceleration across the velocity, one along it and an
angular one. These recur at the same speed, so each is a function of speed: a Gaussian
process in the logarithm of the speed (friction laws are powers of it) with Matern
covariance (order 5/2, length scale a factor e in speed). Mirroring a throw reverses the
first and the last together with the spin.

Response. The friction of the law is taken as a function of speed along the path. A
stone then passes through the same speeds at other times; with s = int a_along/v' dt, to
first order,

    dv = v' s,  db = int (a_across/v - b' a_along/v') dt + b' s,
    domega = int (a_angular - omega' a_along/v') dt + omega' s,

for the speed v, the heading b and the spin omega at a given time, whose integrals are
position and angle.

Sizes. The size of each component has an exponential prior, a penalised-complexity prior
(Simpson et al. 2017, Statistical Science 32, 1), with 5 % of its probability above what
friction does to the throw in that component: along the path the mean deceleration mu g;
across it the acceleration that bends the path, or 5 % of mu g where that is less; for
the rotation mu g R/rho^2 times the mean of R omega/v, the relative variation of the
sliding speed along the ring.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.numerics.namespace import namespace
from curlfit.numerics.principal_axes import principal_axes
from curlfit.numerics.trapezoid import running_integral
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.channels import CHANNELS

COMPONENTS = ("across", "along", "turning")
SHAPES = 12  # basis functions of speed
_TAIL = 0.05  # prior probability of a size above that of friction
_STRAIGHT = 0.05  # acceleration across a straight path that a law may miss, over mu g
_NOT_TURNING = 0.01  # that of the spin of a stone without spin, over mu g R/rho^2
_GRID = 400  # number of times along the path
SPEEDS = np.geomspace(0.02, 10.0, 161)  # m/s, at which shapes are tabulated
# over the initial speed: lowest speed at which accelerations are evaluated
_SLOWEST = 0.02
_LEAST_DECELERATION = 0.1  # over the mean: without any, a stone would stay at one speed
_EDGES = np.geomspace(0.002, 1.0, 11)
SIZES = np.sqrt(_EDGES[1:] * _EDGES[:-1])
"""Sizes over the friction, at the midpoints of equal intervals of their logarithm."""


class Responses(NamedTuple):
    """Response of a path to accelerations of the size of those by friction."""

    t: Floats
    """s since the first row"""
    by_channel: Floats
    """derivatives by components and shapes, shape (channels, times, 3 * SHAPES)"""
    size: Floats
    """accelerations by friction across, along and turning, m/s^2 (rad/s^2); shape
    (3,)"""
    largest: Floats
    """accelerations if all of the friction acted in that component, shape (3,)"""

    @property
    def friction(self) -> float:
        """Coefficient of friction, from the mean deceleration."""
        return float(self.size[1]) / GRAVITY

    @classmethod
    def of(cls, times: Floats, path: Floats, stone: Stone) -> Responses:
        """Responses of a path: x, y, phi, speed and spin at times, shape (5, n)."""
        from scipy.interpolate import CubicSpline  # slow to load, and few fits need it

        distinct = np.flatnonzero(np.diff(times, prepend=-np.inf) > 0)
        moving = np.flatnonzero(path[3, distinct] > 0)
        # up to the first row at rest, and from two rows at least
        at_rest = int(moving[-1]) + 1 if len(moving) else 1
        last = distinct[min(at_rest, len(distinct) - 1)]
        distinct = distinct[distinct <= last]
        t = np.linspace(0.0, times[last], _GRID)
        velocity = CubicSpline(times[distinct], path[:3, distinct], axis=1)(t, 1)
        speed = np.interp(t, times[distinct], path[3, distinct])
        omega = np.interp(t, times[distinct], path[4, distinct])
        speed = np.maximum(speed, _SLOWEST * speed[0])
        heading = np.unwrap(np.arctan2(velocity[0], velocity[1]))
        deceleration = max((speed[0] - speed[-1]) / t[-1], 1e-6)
        speed_rate = np.gradient(speed, t)
        speed_rate = np.minimum(speed_rate, -_LEAST_DECELERATION * deceleration)
        heading_rate = np.gradient(heading, t)
        spin_rate = np.gradient(omega, t)

        ratio = float(np.mean(np.minimum(stone.R * np.abs(omega) / speed, 1.0)))
        bend = float(np.sqrt(np.mean((speed * heading_rate) ** 2)))
        across = np.clip(bend / deceleration, _STRAIGHT, 1.0)
        largest = deceleration * np.array([1.0, 1.0, stone.R / stone.rho**2])
        sizes = largest * np.array([across, 1.0, max(ratio, _NOT_TURNING)])

        shape = np.array(
            [np.interp(np.log(speed), np.log(SPEEDS), row) for row in shapes()]
        )
        integral = partial(running_integral, steps=np.diff(t))
        sine = np.sin(heading)
        cosine = np.cos(heading)
        responses = []
        for component, size in zip(COMPONENTS, sizes, strict=True):
            a_across = size * shape * (component == "across")
            a_along = size * shape * (component == "along")
            a_angular = size * shape * (component == "turning")
            # the equations above, in which `s` is the time between equal speeds
            s = integral(a_along / speed_rate)
            speed_change = speed_rate * s
            heading_change = (
                integral(a_across / speed - heading_rate * a_along / speed_rate)
                + heading_rate * s
            )
            spin_change = (
                integral(a_angular - spin_rate * a_along / speed_rate) + spin_rate * s
            )
            x_rate = speed_change * sine + speed * cosine * heading_change
            y_rate = speed_change * cosine - speed * sine * heading_change
            by_channel = [
                integral(x_rate),
                integral(y_rate),
                integral(spin_change),
                speed_change,
                spin_change,
            ]
            responses.append(np.array(by_channel))
        # from components, channels, shapes, times
        by_channel_and_shape = np.stack(responses, 1).reshape(len(CHANNELS), -1, _GRID)
        return cls(t, by_channel_and_shape.swapaxes(1, 2), sizes, largest)

    def at(self, times: Floats, channel: int) -> Floats:
        """Responses of a channel at some times, constant after the end of the path."""
        columns = [
            np.interp(times, self.t, column) for column in self.by_channel[channel].T
        ]
        return np.array(columns).T


def log_prior(sizes: Any) -> Any:
    """Logarithm of the prior density of the logarithms of the sizes, for
    NumPy or JAX."""
    rate = -math.log(_TAIL)
    return (namespace(sizes).log(sizes) - rate * sizes).sum(-1)


def amplitude_root(sizes: Any, held: Any) -> Any:
    """F of the covariance F F^T of the amplitudes given that combinations of
    them are zero.

    With D the standard deviations of the components, F = D (1 - P) with the projection
    P on the rows of `held` D. For NumPy or JAX.

    Parameters
    ----------
    sizes : of the components, shape (3,).
    held : the combinations, as rows; rows of zeros do not count.
    """
    xp = namespace(sizes)
    scale = xp.repeat(sizes, SHAPES)
    rows = held * scale
    square = (rows**2).sum(-1)
    rows = rows / xp.sqrt(xp.where(square > 0, square, 1.0))[:, None]
    inner = rows @ rows.T + xp.diag(xp.where(square > 0, 1e-12, 1.0))
    return scale[:, None] * (xp.eye(len(scale)) - rows.T @ xp.linalg.solve(inner, rows))


def covariance(speed: Floats, other: Floats) -> Floats:
    """Covariance of accelerations of size 1 at two speeds: Matern, of order 5/2 and
    length scale 1 in the logarithm (Rasmussen and Williams 2006, eq. 4.17)."""
    q = math.sqrt(5) * np.abs(np.log(speed / other))
    return (1 + q + q**2 / 3) * np.exp(-q)


@cache
def shapes() -> Any:
    """Leading functions of speed of an acceleration of size 1, shape
    (`SHAPES`, speeds)."""
    return leading_functions(covariance(SPEEDS[:, None], SPEEDS))


def leading_functions(matrix: Floats) -> Floats:
    """Leading Karhunen-Loeve functions of a covariance at `SPEEDS`, shape
    (functions, speeds)."""
    variances, rows = principal_axes(matrix)
    deviations = np.sqrt(np.maximum(variances[:SHAPES, None], 0.0))
    functions: Floats = deviations * rows[:SHAPES]
    return functions
