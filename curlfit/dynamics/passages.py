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
    held = jax.lax.stop_gradient((law, stone, forces, start))
    fixed: Callable[[Array], Trajectory] = partial(trajectory, *held, load=load)
    last = jnp.full(1, jnp.where(asked, _AT_REST, 0.0))

    def targets(y_rest: Array) -> Array:
        edge = y_rest - _EDGE
        return jnp.concatenate(
            [jnp.minimum(lines, edge), edge + _NEAR * jnp.array([-1.0, 1.0])]
        )

    def step(count: Array, t: Array) -> Array:
        path = fixed(jnp.concatenate([t, last]))
        aims = targets(path.y[-1])
        ends = slice(None, len(aims))
        duration = jnp.minimum(path.rest, last)
        points = duration * (1 - jnp.linspace(1.0, 0.0, _POINTS) ** 2)
        between = t.at[ends].set(_reached(aims, path))
        later = t[ends] + (aims - path.y[ends]) / jnp.maximum(path.vy[ends], _SLOWEST)
        newton = t.at[ends].set(jnp.maximum(later, 0.0))
        return jnp.where(count == 0, points, jnp.where(count == 1, between, newton))

    # One integration in a loop, rather than three, keeps the compiled program small.
    t = jax.lax.fori_loop(0, 3, step, jnp.zeros(_POINTS))[: len(lines) + 2]
    t = jax.lax.stop_gradient(t)
    n, crossed = len(times), slice(len(times), len(times) + len(t))
    path = motion(jnp.concatenate([times, t, t + _LATER, last]))
    x, y, phi, vx, vy, speed, omega = (
        getattr(path, name)[crossed]
        for name in ("x", "y", "phi", "vx", "vy", "speed", "omega")
    )
    # One more step, with its derivatives: those of the implicit function y(t) = line.
    late = (targets(path.y[-1]) - y) / jnp.maximum(vy, _SLOWEST)
    time, x, phi = t + late, x + vx * late, phi + omega * late
    speed, omega = (
        now + late * jax.lax.stop_gradient(after[crossed.stop : -1] - now) / _LATER
        for now, after in ((speed, path.speed), (omega, path.omega))
    )
    slowness = (time[-1] - time[-2]) / (2 * _NEAR)
    beyond = jnp.maximum(lines - (path.y[-1] - _EDGE), 0.0)
    passages = Passages(
        time[:-2] + beyond * slowness,
        x[:-2],
        phi[:-2],
        speed[:-2],
        omega[:-2],
        jnp.stack([path.rest, path.x[-1], path.y[-1], path.phi[-1]]),
    )
    moving = Trajectory(
        **{
            name: getattr(path, name)[:n]
            for name in ("t", "x", "y", "phi", "vx", "vy", "omega")
        },
        rest=path.rest,
    )
    return moving, passages


def _reached(targets: Array, path: Trajectory) -> Array:
    """Times at which y first has these values, by cubic polynomials between points
    of the path."""
    after = jnp.argmax(path.y[1:] >= targets[:, None], 1) + 1
    (t0, y0, v0), (t1, y1, v1) = (
        (path.t[k], path.y[k], path.vy[k]) for k in (after - 1, after)
    )
    h = t1 - t0
    h = jnp.where(h > 0, h, 1.0)
    rise = y1 - y0
    square, cube = 3 * rise - h * (2 * v0 + v1), h * (v0 + v1) - 2 * rise
    s = jnp.clip((targets - y0) / jnp.where(rise > 0, rise, 1.0), 0.0, 1.0)
    for _ in range(_STEPS):
        excess = y0 + s * (h * v0 + s * (square + s * cube)) - targets
        slope = h * v0 + s * (2 * square + s * 3 * cube)
        s = jnp.clip(s - excess / jnp.maximum(slope, _SLOWEST * h), 0.0, 1.0)
    return t0 + s * h
