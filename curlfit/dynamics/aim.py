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
    surroundings, direct = environment or Environment(), math.atan2(across, along)
    guess = direct if heading is None else heading

    def overshoot(place: Floats) -> float:
        """Distance beyond the target, along the sheet for a prescribed heading."""
        if heading is None:
            return math.hypot(*place) - math.hypot(across, along)
        return math.cos(heading) * place[1] - math.sin(heading) * place[0] - along

    for _ in range(_MAX_TURNS):
        forces = np.asarray(_external_forces(stone, surroundings, guess, 0.0))
        place = partial(_place, law, stone, check_load(load), forces, omega0, speed)
        v0 = _speed_without(overshoot, place, speed)
        if heading is not None:
            return Aim(v0, heading)
        found = direct - math.atan2(*place(v0))
        # The heading enters only through the direction of the slope.
        if (
            abs(found - guess) < _TOLERANCE / math.hypot(across, along)
            or environment is None
        ):
            break
        guess = found
    return Aim(v0, found)


def _speed_without(
    overshoot: Callable[[Floats], float], place: Callable[[float], Floats], speed: float
) -> float:
    """Initial speed whose place is neither short of the target nor beyond it; `speed`
    is the one there."""

    def excess_at(v: float) -> float:
        return overshoot(place(v))

    low, largest = speed, -math.inf
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
        low, largest = high, max(largest, excess)
    what = "comes to rest" if speed == 0 else f"has slowed to {speed:g} m/s"
    raise InputError(
        f"no throw reaches it: even one of {FASTEST:g} m/s {what} "
        f"{-largest:.3g} m short"
    )


def _place(
    law: Law,
    stone: Stone,
    load: Load,
    forces: Floats,
    omega: float,
    speed: float,
    v: float,
) -> Floats:
    """Where (x, y) a throw from the origin along +y has slowed to a speed; NaN if
    it does not."""
    if v <= speed:
        return np.zeros(2)
    coefficients = np.array(
        [float(getattr(law, item.name)) for item in law.coefficients()]
    )

    def motion(times: Floats) -> Floats:
        """x, y, speed, vx, vy, shape (5, times)."""
        start = InitialState(v=float(v), omega=float(omega))
        path = _motion(type(law), load, coefficients, stone, forces, start, times)
        return np.asarray(path)

    times = np.linspace(0.0, 60.0, _GRID_SIZE)
    while not ((path := motion(times))[2] <= speed).any():
        if times[-1] >= LONGEST or np.isnan(path).any():
            return np.full(2, math.nan)
        times = 2 * times
    if speed == 0:
        return path[:2, -1]
    for finer in (True, True, False):
        k = max(int(np.append(path[2, :-1] <= speed, True).argmax()), 1)
        if finer:
            times = np.linspace(times[k - 1], times[k], _GRID_SIZE)
            path = motion(times)
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
    friction, start = law.from_vector(coefficients), jax.tree.map(jnp.asarray, start)
    path = ordered_trajectory(
        friction, stone, forces, start, times, jnp.zeros(()), load=load
    )
    return jnp.stack([path.x, path.y, path.speed, path.vx, path.vy])
