"""Model discrepancy: accelerations that the law lacks, and their effect on a path.

A law that is not exact lacks an acceleration across the velocity, one along it and an angular one.
These recur at the same speed, so each is a function of speed: a Gaussian process in the logarithm
of the speed (friction laws are powers of it) with Matern covariance (order 5/2, length scale a
factor e in speed). Mirroring a throw reverses the first and the last together with the spin.

Response. The friction of the law is taken as a function of speed along the path. A stone then
passes through the same speeds at other times; with s = int a_along/v' dt, to first order,

    dv = v' s,  db = int (a_across/v - b' a_along/v') dt + b' s,
    domega = int (a_angular - omega' a_along/v') dt + omega' s,

for the speed v, the heading b and the spin omega at a given time, whose integrals are position and
angle.

Sizes. The size of each component has an exponential prior, a penalised-complexity prior (Simpson et
al. 2017, Statistical Science 32, 1), with 5 % of its probability above the friction: a missing
contact force is no larger than the contact force itself. For the rotation, the friction means its
angular acceleration, mu g R/rho^2, times the mean of R omega/v, the relative variation of the
sliding speed along the ring.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.numerics.principal_axes import principal_axes
from curlfit.numerics.trapezoid import running_integral
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.throw import CHANNELS

COMPONENTS = ("across", "along", "turning")
SHAPES = 12  # basis functions of speed
_TAIL = 0.05  # prior probability of a size above the friction
_GRID = 400  # number of times along the path
SPEEDS = np.geomspace(0.02, 10.0, 161)  # m/s, at which shapes are tabulated
_SLOWEST = 0.02  # over the initial speed: lowest speed at which accelerations are evaluated
_EDGES = np.geomspace(0.002, 1.0, 11)
SIZES = np.sqrt(_EDGES[1:] * _EDGES[:-1])
"""Sizes over the friction, at the midpoints of equal intervals of their logarithm."""


class Responses(NamedTuple):
    """Response of a path to accelerations of the size of the friction."""

    t: Floats
    """s since the first row"""
    by_channel: Floats
    """derivatives by components and shapes, shape (channels, times, 3 * SHAPES)"""
    size: Floats
    """those accelerations, across, along and turning, m/s^2 (rad/s^2); shape (3,)"""

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
        last = distinct[min(int(moving[-1]) + 1 if len(moving) else 1, len(distinct) - 1)]
        distinct = distinct[distinct <= last]
        t = np.linspace(0.0, times[last], _GRID)
        rates = CubicSpline(times[distinct], path[:3, distinct], axis=1)(t, 1)
        speed = np.interp(t, times[distinct], path[3, distinct])
        omega = np.interp(t, times[distinct], path[4, distinct])
        speed = np.maximum(speed, _SLOWEST * speed[0])
        heading = np.unwrap(np.arctan2(rates[0], rates[1]))
        slow = np.gradient(speed, t)
        mean = max((speed[0] - speed[-1]) / t[-1], 1e-6)
        # without deceleration a stone would stay at one speed forever
        slow = np.minimum(slow, -0.1 * mean)
        ratio = float(np.mean(np.minimum(stone.R * np.abs(omega) / speed, 1.0)))
        sizes = mean * np.array([1.0, 1.0, stone.R / stone.rho**2 * max(ratio, 0.01)])
        shape = np.array([np.interp(np.log(speed), np.log(SPEEDS), row) for row in shapes()])
        found = np.zeros((len(CHANNELS), 3, SHAPES, _GRID))
        integral = partial(running_integral, steps=np.diff(t))
        turn, spin_up = np.gradient(heading, t), np.gradient(omega, t)
        for component, size in enumerate(sizes):
            across, along, angular = (size * shape * (component == k) for k in range(3))
            s = integral(along / slow)
            heading_change = integral(across / speed - turn * along / slow) + turn * s
            spin_change = integral(angular - spin_up * along / slow) + spin_up * s
            speed_change = slow * s
            sine, cosine = np.sin(heading), np.cos(heading)
            found[:, component] = (
                integral(speed_change * sine + speed * cosine * heading_change),
                integral(speed_change * cosine - speed * sine * heading_change),
                integral(spin_change),
                speed_change,
                spin_change,
            )
        by_channel = found.reshape(len(CHANNELS), 3 * SHAPES, _GRID).swapaxes(1, 2)
        return cls(t, by_channel, sizes)

    def at(self, times: Floats, channel: int) -> Floats:
        """Responses of a channel at some times, constant after the end of the path."""
        columns = [np.interp(times, self.t, column) for column in self.by_channel[channel].T]
        return np.array(columns).T


def log_likelihood(factor: Floats, sizes: Floats, n_nuisance: int) -> Floats:
    """Logarithm of the restricted likelihood at sizes, shape (sizes, 3), up to a constant.

    Parameters
    ----------
    factor : R factor of the columns over their noise: parameters, shapes, residuals.
    """
    spent = np.log(np.abs(np.diag(factor)[:n_nuisance])).sum()
    left = factor[n_nuisance:, n_nuisance:]
    # The diagonal of the Cholesky factor of [1 + D S D, D s; s^T D, r^T r] gives the determinant of
    # the first block and, last, the root of chi squared, r^T (1 + ...)^-1 r.
    scale = np.concatenate([np.repeat(sizes, SHAPES, axis=1), np.ones((len(sizes), 1))], 1)
    whole = scale[:, :, None] * (left.T @ left) * scale[:, None]
    diagonal = np.arange(whole.shape[1])
    whole[:, diagonal, diagonal] += np.append(np.ones(len(diagonal) - 1), 1e-9)
    roots = np.diagonal(np.linalg.cholesky(whole), axis1=1, axis2=2)
    found: Floats = -(roots[:, -1] ** 2) / 2 - np.log(roots[:, :-1]).sum(1) - spent
    return found


def log_prior(sizes: Floats) -> Floats:
    """Logarithm of the prior density of the logarithms of the sizes."""
    rate = -math.log(_TAIL)
    found: Floats = (np.log(sizes) - rate * sizes).sum(-1)
    return found


def covariance(speed: Floats, other: Floats) -> Floats:
    """Covariance of accelerations of size 1 at two speeds: Matern, of order 5/2 and length scale 1
    in the logarithm (Rasmussen and Williams 2006, eq. 4.17)."""
    q = math.sqrt(5) * np.abs(np.log(speed / other))
    return (1 + q + q**2 / 3) * np.exp(-q)


@cache
def shapes() -> Any:
    """`leading_functions` of an acceleration of size 1."""
    return leading_functions(covariance(SPEEDS[:, None], SPEEDS))


def leading_functions(matrix: Floats) -> Floats:
    """Leading Karhunen-Loeve functions of a covariance at `SPEEDS`, shape (functions, speeds)."""
    squares, rows = principal_axes(matrix)
    found: Floats = np.sqrt(np.maximum(squares[:SHAPES, None], 0.0)) * rows[:SHAPES]
    return found
