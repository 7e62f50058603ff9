"""The speed and heading that bring a stone to a target: the inverse problem of a throw.

On level ice the heading only rotates the path about its initial position: the speed
follows from the distance alone, and the heading from the direction. The speed is the
root of a function of one variable, found by Brent's method.
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

from curlfit.dynamics.trajectory import (
    InitialState,
    external_forces,
    ordered_trajectory,
)
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
_MAX_TURNS = 80  # of the heading
_FIRST_DURATION = 60.0  # s, after which most stones are at rest
_GRID_SIZE = 129  # times at which the speed is compared
_REFINEMENTS = 2  # of the interval within which the speed is reached


class Aim(NamedTuple):
    """Initial speed and heading of a throw.

    Examples
    --------
    >>> v0, heading = curlfit.Aim(2.2, 0.03)
    """

    v0: float
    heading: float
    """rad, from +y toward +x"""


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
    Aim, within 1e-9 m of the target. If several speeds reach it (friction that
    decreases steeply with speed), the lowest one that was bracketed.

    Raises
    ------
    InputError : invalid arguments, or no throw up to 6 m/s reaches the target.

    Examples
    --------
    >>> law = curlfit.law_with("front-back", {"mu2_xi": 0.055})
    >>> aimed = curlfit.aim(law, curlfit.Stone(), (0.0, 28.35), omega0=1.0)
    >>> round(aimed.v0, 2), aimed.heading > 0
    (2.24, True)
    """
    find_law(type(law))
    across = target[0] - start[0]
    along = target[1] - start[1]
    for name, value in (("target", across), ("target", along), ("omega0", omega0)):
        if not math.isfinite(value):
            raise InputError(f"{name}: expected finite numbers")
    if not along > 0:
        raise InputError(
            f"the target lies {-along:.3g} m behind the start; "
            "expected a place ahead of it"
        )
    if not 0 <= speed < FASTEST:
        raise InputError(
            f"a speed of {speed:g} m/s at the target; expected 0 to {FASTEST:g} m/s"
        )
    if heading is not None and not abs(heading) < math.pi / 2:
        raise InputError(
            f"heading = {heading:g} rad: expected one that goes along the sheet"
        )
    surroundings = environment or Environment()
    distance = math.hypot(across, along)
    bearing = math.atan2(across, along)
    # a first guess, along which the throw goes if no heading is prescribed
    direction = bearing if heading is None else heading

    def overshoot(end: Floats) -> float:
        """Distance beyond the target, along the sheet for a prescribed heading, of a
        throw along +y that ends at (x, y)."""
        if heading is None:
            return math.hypot(*end) - distance
        return math.cos(heading) * end[1] - math.sin(heading) * end[0] - along

    for _ in range(_MAX_TURNS):
        forces = np.asarray(_external_forces(stone, surroundings, direction, 0.0))
        end_at = partial(_end_of, law, stone, check_load(load), forces, omega0, speed)
        v0 = _speed_without(overshoot, end_at, speed)
        if heading is not None:
            return Aim(v0, heading)
        previous = direction
        # The path is rotated until its end lies in the direction of the target.
        direction = bearing - math.atan2(*end_at(v0))
        # The path depends on the heading only through the direction of the slope.
        if environment is None or abs(direction - previous) < _TOLERANCE / distance:
            return Aim(v0, direction)
    raise InputError(
        f"no throw found: on ice that slopes so much its heading did not settle in "
        f"{_MAX_TURNS} trials; the last was {direction:.4g} rad, at {v0:.4g} m/s"
    )


def _speed_without(
    overshoot: Callable[[Floats], float],
    end_at: Callable[[float], Floats],
    speed: float,
) -> float:
    """Initial speed of the throw that ends, at `speed`, neither short of the target nor
    beyond it.

    Parameters
    ----------
    overshoot : distance beyond the target by the end (x, y) of a throw.
    end_at : the end of a throw by its initial speed.
    """

    def excess_at(v: float) -> float:
        return overshoot(end_at(v))

    low = speed
    largest = -math.inf
    for high in _SPEEDS[speed < _SPEEDS].tolist():
        excess = excess_at(high)
        if math.isnan(excess):
            raise InputError(
                f"no throw found: at {high:.2g} m/s the law admits no motion to "
                + ("rest" if speed == 0 else f"{speed:g} m/s")
            )
        if excess >= 0:
            from scipy.optimize import brentq  # slow to load

            return float(brentq(excess_at, low, high, xtol=_TOLERANCE / 1000))
        low = high
        largest = max(largest, excess)
    end = "comes to rest" if speed == 0 else f"has slowed to {speed:g} m/s"
    raise InputError(
        f"no throw reaches it: even one of {FASTEST:g} m/s {end} {-largest:.3g} m short"
    )


def _end_of(
    law: Law,
    stone: Stone,
    load: Load,
    forces: Floats,
    omega: float,
    speed: float,
    v: float,
) -> Floats:
    """Where (x, y) a throw from the origin along +y, at `v`, has slowed to `speed`; NaN
    if it does not."""
    if v <= speed:
        return np.zeros(2)
    coefficients = np.array([float(value) for value in jax.tree.leaves(law)])

    def motion(times: Floats) -> Floats:
        """x, y, speed, vx, vy, shape (5, times)."""
        start = InitialState(v=float(v), omega=float(omega))
        path = _motion(type(law), load, coefficients, stone, forces, start, times)
        return np.asarray(path)

    def first_slow(path: Floats) -> int:
        """Index of the first time at which the stone is as slow, or of the last."""
        return max(int(np.append(path[2, :-1] <= speed, True).argmax()), 1)

    times = np.linspace(0.0, _FIRST_DURATION, _GRID_SIZE)
    path = motion(times)
    while not (path[2] <= speed).any():
        if times[-1] >= LONGEST or np.isnan(path).any():
            return np.full(2, math.nan)
        times = 2 * times
        path = motion(times)
    if speed == 0:
        return path[:2, -1]
    for _ in range(_REFINEMENTS):
        k = first_slow(path)
        times = np.linspace(times[k - 1], times[k], _GRID_SIZE)
        path = motion(times)
    k = first_slow(path)
    deceleration = (path[2, k] - path[2, k - 1]) / (times[k] - times[k - 1])
    # a few microseconds at most
    return path[:2, k] + (speed - path[2, k]) / deceleration * path[3:, k]


_external_forces = compiled()(external_forces)


@compiled("law", "load")
def _motion(
    law: type[Law],
    load: Load,
    coefficients: Array,
    stone: Stone,
    forces: Array,
    start: InitialState,
    times: Array,
) -> Array:
    friction = law.from_vector(coefficients)
    start = jax.tree.map(jnp.asarray, start)
    path = ordered_trajectory(
        friction, stone, forces, start, times, jnp.zeros(()), load=load
    )
    return jnp.stack([path.x, path.y, path.speed, path.vx, path.vy])
