"""When and where a stone crosses lines and comes to rest, with derivatives.

A stone crosses a line or stops short of it, and at the transition the time of crossing
ends like a square root: a search would meet an infinite slope, and then no value. Lines
beyond a point `_EDGE` before the resting position are therefore taken to be crossed at
the speed at that point. Times are thus defined for every line and every motion, and are
continuous with their first derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from curlfit.dynamics.trajectory import InitialState, Trajectory, trajectory
from curlfit.friction import Law, Load
from curlfit.stone import Stone

_EDGE = 0.02  # m before the resting position
_NEAR = 0.001  # m to either side of that point, between which the speed there is taken
_LATER = 0.01  # s, in which the motion at a line changes in proportion to time
_POINTS = 64  # of the motion, between which crossings are sought
_STEPS = 5  # of Newton's method for a crossing between two of them
_AT_REST = 1000.0  # s, by when every stone is at rest
_SLOWEST = 1e-4  # m/s, smallest divisor


class Passages(NamedTuple):
    """Times since the start (s), x (m), angles (rad), speeds (m/s) and spins (rad/s) at
    lines, shape (lines,), and at rest."""

    time: Array
    x: Array
    phi: Array
    speed: Array
    omega: Array
    rest: Array
    """time, x, y and phi, shape (4,)"""


def with_passages(
    law: Law,
    stone: Stone,
    forces: Array | None,
    start: InitialState,
    lines: Array,
    times: Array,
    asked: Array,
    *,
    load: Load,
) -> tuple[Trajectory, Passages]:
    """The motion at `times`, as from `ordered_trajectory`, and its passages of lines.

    Parameters
    ----------
    lines : y in m, shape (lines,), increasing.
    asked : whether the passages are needed; the motion is not followed to
        rest otherwise.
    """
    motion = partial(trajectory, law, stone, forces, start, load=load)
    constants = jax.lax.stop_gradient((law, stone, forces, start))
    motion_without_derivatives: Callable[[Array], Trajectory] = partial(
        trajectory, *constants, load=load
    )
    last = jnp.full(1, jnp.where(asked, _AT_REST, 0.0))
    count = len(lines) + 2

    def targets(y_rest: Array) -> Array:
        """y of each line, or of the edge if it lies beyond, and of two points to either
        side of the edge."""
        edge = y_rest - _EDGE
        reached = jnp.minimum(lines, edge)
        near_edge = edge + _NEAR * jnp.array([-1.0, 1.0])
        return jnp.concatenate([reached, near_edge])

    def search(stage: Array, t: Array) -> Array:
        """Times to evaluate next, of which the first ones are those of the targets."""
        path = motion_without_derivatives(jnp.concatenate([t, last]))
        y = targets(path.y[-1])
        # first, points of the whole motion, denser toward rest
        duration = jnp.minimum(path.rest, last)
        points = duration * (1 - jnp.linspace(1.0, 0.0, _POINTS) ** 2)
        # then, the times between these; last, a step of Newton's method
        between = t.at[:count].set(_times_at(y, path))
        later = t[:count]
        later += (y - path.y[:count]) / jnp.maximum(path.vy[:count], _SLOWEST)
        newton = t.at[:count].set(jnp.maximum(later, 0.0))
        return jnp.where(stage == 0, points, jnp.where(stage == 1, between, newton))

    # One integration in a loop, rather than three, keeps the compiled program small.
    t = jax.lax.fori_loop(0, 3, search, jnp.zeros(_POINTS))[:count]
    t = jax.lax.stop_gradient(t)
    # one integration for the rows, the targets, a little later, and rest
    path = motion(jnp.concatenate([times, t, t + _LATER, last]))
    n = len(times)
    crossed = _rows(path, slice(n, n + count))
    shortly_after = _rows(path, slice(n + count, -1))
    # One more step, with its derivatives: those of the implicit function y(t) = line.
    late = (targets(path.y[-1]) - crossed.y) / jnp.maximum(crossed.vy, _SLOWEST)
    time = t + late
    x = crossed.x + crossed.vx * late
    phi = crossed.phi + crossed.omega * late

    def changed(now: Array, after: Array) -> Array:
        return now + late * jax.lax.stop_gradient(after - now) / _LATER

    speed = changed(crossed.speed, shortly_after.speed)
    omega = changed(crossed.omega, shortly_after.omega)
    # A line beyond the edge is taken to be crossed at the speed at the edge.
    slowness = (time[-1] - time[-2]) / (2 * _NEAR)
    beyond = jnp.maximum(lines - (path.y[-1] - _EDGE), 0.0)
    passages = Passages(
        time=time[:-2] + beyond * slowness,
        x=x[:-2],
        phi=phi[:-2],
        speed=speed[:-2],
        omega=omega[:-2],
        rest=jnp.stack([path.rest, path.x[-1], path.y[-1], path.phi[-1]]),
    )
    return _rows(path, slice(n)), passages


def _rows(path: Trajectory, which: slice) -> Trajectory:
    """The path at some of its times; the time of rest is that of the whole."""
    rows: Trajectory = jax.tree.map(
        lambda values: values[which] if values.ndim else values, path
    )
    return rows


def _times_at(targets: Array, path: Trajectory) -> Array:
    """Times at which y first has some values, by cubic polynomials between points
    of the path."""
    after = jnp.argmax(path.y[1:] >= targets[:, None], 1) + 1
    before = after - 1
    t0 = path.t[before]
    y0 = path.y[before]
    v0 = path.vy[before]
    t1 = path.t[after]
    y1 = path.y[after]
    v1 = path.vy[after]
    h = t1 - t0
    h = jnp.where(h > 0, h, 1.0)
    rise = y1 - y0
    # Hermite's polynomial y0 + h v0 s + square s^2 + cube s^3 in s = (t - t0)/h
    square = 3 * rise - h * (2 * v0 + v1)
    cube = h * (v0 + v1) - 2 * rise
    s = jnp.clip((targets - y0) / jnp.where(rise > 0, rise, 1.0), 0.0, 1.0)
    for _ in range(_STEPS):
        excess = y0 + s * (h * v0 + s * (square + s * cube)) - targets
        slope = h * v0 + s * (2 * square + s * 3 * cube)
        s = jnp.clip(s - excess / jnp.maximum(slope, _SLOWEST * h), 0.0, 1.0)
    return t0 + s * h
