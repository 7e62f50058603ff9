"""The speed and heading that bring a stone to a target: the inverse problem of a throw.

On level ice the heading only rotates the path about its initial position: the speed follows from
the distance alone, and the heading from the direction. The speed is the root of a function of one
variable, found by Newton's method with the exact derivative of the motion, within a bracket that
shrinks at every step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.trajectory import InitialState, external_forces, ordered_trajectory
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.friction import Law, Load, check_load, find_law
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.stone import Stone

FASTEST = 6.0
"""The largest initial speed considered, m/s; the hardest takeouts are slower."""
LONGEST = 2000.0
"""Time in s after which a stone still in motion is taken never to come to rest."""
_SPEEDS = np.append(0.05 * 1.25 ** np.arange(22), FASTEST)  # grid for the bracket
_TOLERANCE = 1e-9  # m
_MAX_ITERATIONS = 80
_GRID_SIZE = 129


class Aim(NamedTuple):
    """Initial speed and heading of a throw.

    Examples
    --------
    >>> v0, heading = curlfit.Aim(2.2, 0.03)
    """

    v0: float
    heading: float
    """rad, from +y toward +x"""


class _Endpoint(NamedTuple):
    """Where a throw from the origin along +y has slowed to a given speed."""

    position: Floats
    """(x, y) in m"""
    slope: Floats
    """its derivative with respect to the initial speed"""


def aim(
    law: Law,
    stone: Stone,
    target: tuple[float, float],
    *,
    omega0: float,
    start: tuple[float, float] = (0.0, 0.0),
    heading: float | None = None,
    speed: float = 0.0,
    load: str = "uniform",
    environment: Environment | None = None,
) -> Aim:
    """The throw that comes to rest at a target, or passes it at a given speed.

    Parameters
    ----------
    law, stone, load, environment : as in `simulate`.
    target : position (x, y) in m.
    omega0 : initial spin in rad/s.
    start : initial position (x, y) in m.
    heading : direction in rad if prescribed; then only y of the target is reached.
    speed : speed at the target in m/s; 0 for rest.

    Returns
    -------
    Aim, within 1e-9 m of the target. If several speeds reach it (friction that decreases steeply
    with speed), the lowest one that was bracketed.

    Raises
    ------
    InputError : invalid arguments, or no throw up to 6 m/s reaches the target.

    Examples
    --------
    >>> law = curlfit.law_with("front-back", {"mu2_xi": 0.055})
    >>> found = curlfit.aim(law, curlfit.Stone(), (0.0, 28.35), omega0=1.0)
    >>> round(found.v0, 2), found.heading > 0
    (2.24, True)
    """
    find_law(type(law))
    across, along = target[0] - start[0], target[1] - start[1]
    for name, value in (("target", across), ("target", along), ("omega0", omega0)):
        if not math.isfinite(value):
            raise InputError(f"{name}: expected finite numbers")
    if not along > 0:
        raise InputError(
            f"the target lies {-along:.3g} m behind the start; expected a place ahead of it"
        )
    if not 0 <= speed < FASTEST:
        raise InputError(f"a speed of {speed:g} m/s at the target; expected 0 to {FASTEST:g} m/s")
    if heading is not None and not abs(heading) < math.pi / 2:
        raise InputError(f"heading = {heading:g} rad: expected one that goes along the sheet")
    distance, surroundings = math.hypot(across, along), environment or Environment()
    direct = math.atan2(across, along)
    guess = direct if heading is None else heading
    for _ in range(_MAX_ITERATIONS):
        # The heading enters only through the direction of the slope.
        forces = np.asarray(_external_forces(stone, surroundings, guess, 0.0))
        endpoint = partial(_endpoint, law, stone, check_load(load), forces, omega0, speed)
        v0 = _speed_to_reach(endpoint, distance if heading is None else along, heading, speed)
        if heading is not None:
            return Aim(v0, heading)
        found = direct - math.atan2(*endpoint(v0).position)
        if abs(found - guess) < _TOLERANCE / distance or environment is None:
            break
        guess = found
    return Aim(v0, found)


def _speed_to_reach(
    endpoint: Callable[[float], _Endpoint], distance: float, heading: float | None, speed: float
) -> float:
    """Initial speed that carries the stone a given distance, measured along the sheet for a
    prescribed heading and in a straight line otherwise."""

    def overshoot(v: float) -> tuple[float, float]:
        """Distance beyond the target, and its derivative with respect to the speed."""
        position, slope = endpoint(v)
        if heading is not None:
            ahead = np.array([-math.sin(heading), math.cos(heading)])
            return float(ahead @ position) - distance, float(ahead @ slope)
        size = float(np.hypot(*position))
        return size - distance, float(position @ slope) / size if size > 0 else 0.0

    low = speed
    largest = -math.inf
    for high in _SPEEDS[speed < _SPEEDS]:
        excess = overshoot(float(high))[0]
        if math.isnan(excess):
            raise InputError(
                f"no throw found: at {high:.2g} m/s the law admits no motion to "
                + ("rest" if speed == 0 else f"{speed:g} m/s")
            )
        largest = max(largest, excess)
        if excess >= 0:
            break
        low = float(high)
    else:
        what = "comes to rest" if speed == 0 else f"has slowed to {speed:g} m/s"
        raise InputError(
            f"no throw reaches it: even one of {FASTEST:g} m/s {what} {-largest:.3g} m short"
        )
    return _root(overshoot, low, float(high))


def _root(f: Callable[[float], tuple[float, float]], low: float, high: float) -> float:
    """Root of a function, given with its derivative, negative at `low` and not at `high`."""
    x = (low + high) / 2
    before = math.inf
    for _ in range(_MAX_ITERATIONS):
        value, slope = f(x)
        if abs(value) < _TOLERANCE:
            return x
        low, high = (x, high) if value < 0 else (low, x)
        newton = x - value / slope if slope > 0 else math.nan
        # Newton's step if it stays inside and the last step halved the value; else bisection.
        x = newton if low < newton < high and abs(value) < before / 2 else (low + high) / 2
        before = abs(value)
        if high - low < 1e-15 * high:
            break
    return x


def _endpoint(
    law: Law, stone: Stone, load: Load, forces: Floats, omega: float, speed: float, v: float
) -> _Endpoint:
    if v <= speed:
        return _Endpoint(np.zeros(2), np.zeros(2))
    first, last = 0.0, 60.0
    while True:
        path, slopes = _speed_and_position(
            law, stone, load, forces, v, omega, np.linspace(first, last, _GRID_SIZE)
        )
        slow = np.flatnonzero(path[2] <= speed)
        if len(slow):
            break
        if last >= LONGEST or np.isnan(path).any():
            return _Endpoint(np.full(2, math.nan), np.zeros(2))
        last *= 2
    if speed == 0:
        return _Endpoint(path[:2, -1], slopes[:2, -1])
    # The time at which the speed is reached, on successively finer grids.
    times = np.linspace(first, last, _GRID_SIZE)
    for _ in range(2):
        k = max(int(slow[0]), 1)
        times = np.linspace(times[k - 1], times[k], _GRID_SIZE)
        path, slopes = _speed_and_position(law, stone, load, forces, v, omega, times)
        slow = np.flatnonzero(path[2] <= speed)
        slow = slow if len(slow) else np.array([_GRID_SIZE - 1])
    k = max(int(slow[0]), 1)
    deceleration = (path[2, k] - path[2, k - 1]) / (times[k] - times[k - 1])
    delay = (speed - path[2, k]) / deceleration  # a few microseconds at most
    position = path[:2, k] + delay * path[3:, k]
    # A faster stone reaches the speed at a later time.
    d_time = -slopes[2, k] / deceleration
    return _Endpoint(position, slopes[:2, k] + path[3:, k] * d_time)


_external_forces = compiled()(external_forces)


@compiled("law", "load")
def _speed_and_position_compiled(
    law: type[Law], load: Load, coefficients: Array, stone: Stone, forces: Array, v: Array,
    omega: Array, times: Array,
) -> tuple[Array, Array]:  # fmt: skip
    def path(v: Array) -> Array:
        start = jax.tree.map(jnp.asarray, InitialState(v=v, omega=omega))
        found = ordered_trajectory(
            law.from_vector(coefficients), stone, forces, start, times, jnp.zeros(()), load=load
        )
        return jnp.stack([found.x, found.y, found.speed, found.vx, found.vy])

    return jax.jvp(path, (v,), (jnp.ones(()),))


def _speed_and_position(
    law: Law, stone: Stone, load: Load, forces: Floats, v: float, omega: float, times: Floats
) -> tuple[Floats, Floats]:
    """x, y, speed, vx, vy at times, shape (5, n), and their derivatives with respect to `v`."""
    coefficients = np.array([float(getattr(law, item.name)) for item in law.coefficients()])
    path, slopes = _speed_and_position_compiled(
        type(law), load, coefficients, stone, forces, float(v), float(omega), times
    )
    return np.asarray(path), np.asarray(slopes)
