"""Which speed and heading bring a stone somewhere: the inverse of a throw.

Ice is the same in every direction, so that the heading only turns a path about its start. The speed
is therefore found alone, from the distance, and the heading follows from the direction. The speed
is a root of one function: Newton's method with the exact derivative of the motion, kept within a
bracket that shrinks with every step, so that it ends whatever the law does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from curlfit.dynamics.trajectory import InitialState, simulate

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from curlfit.errors import InputError
from curlfit.friction import Law, Load, check_load
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import kept
from curlfit.stone import Stone

FASTEST = 6.0
"""The fastest throw that is looked at, m/s; the hardest takeouts are slower."""
LONGEST = 2000.0
"""Time in s after which a stone that has not come to rest counts as never doing so."""
_SPEEDS = np.append(0.05 * 1.25 ** np.arange(22), FASTEST)  # where a bracket is looked for
_NEAR = 1e-9  # m; a throw this near counts as there
_MOST_STEPS = 80
_TIMES = 129


class Aim(NamedTuple):
    """A throw that was found."""

    v0: float
    heading: float
    """rad, from +y toward +x"""


class _Reach(NamedTuple):
    """Where a throw from the origin along +y has lost its speed down to a given one."""

    place: Floats
    """(x, y) in m"""
    slope: Floats
    """its derivative by the initial speed"""


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
) -> Aim:
    """The throw that comes to rest at a place, or passes it at a given speed.

    Parameters
    ----------
    law, stone, load : what moves, as in `simulate`.
    target : the place (x, y) in m.
    omega0 : spin at the start in rad/s.
    start : where the throw begins, (x, y) in m.
    heading : the direction, where that is given; only y of the target is then met.
    speed : with which the target is passed in m/s; 0 is rest.

    Returns
    -------
    Aim, good to 1e-9 m of the target under the law as it is computed. Where several speeds lead
    there (friction that falls steeply with speed), the lowest that was bracketed.

    Raises
    ------
    InputError : a value that makes no throw; no throw up to 6 m/s goes there, said how far it goes.
    """
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
    reach = partial(_reach, law, stone, check_load(load), omega0, speed)
    distance = math.hypot(across, along)

    def short(v: float) -> tuple[float, float]:
        """How far the throw goes beyond the target, and the derivative."""
        place, slope = reach(v)
        if heading is not None:
            ahead = np.array([-math.sin(heading), math.cos(heading)])
            return float(ahead @ place) - along, float(ahead @ slope)
        size = float(np.hypot(*place))
        return size - distance, float(place @ slope) / size if size > 0 else 0.0

    low = max(speed, 0.0)
    farthest = -math.inf
    for high in _SPEEDS[speed < _SPEEDS]:
        beyond = short(float(high))[0]
        if math.isnan(beyond):
            raise InputError(
                f"no throw found: at {high:.2g} m/s the law admits no motion to "
                + ("rest" if speed == 0 else f"{speed:g} m/s")
            )
        farthest = max(farthest, beyond)
        if beyond >= 0:
            break
        low = float(high)
    else:
        what = "comes to rest" if speed == 0 else f"has slowed to {speed:g} m/s"
        raise InputError(
            f"no throw reaches it: even one of {FASTEST:g} m/s {what} {-farthest:.3g} m short"
        )
    v0 = _root(short, low, float(high))
    if heading is None:
        place = reach(v0).place
        heading = math.atan2(across, along) - math.atan2(*place)
    return Aim(v0, heading)


def _root(f: Callable[[float], tuple[float, float]], low: float, high: float) -> float:
    """Root of a function that gives value and slope, negative at `low`, not so at `high`."""
    x = (low + high) / 2
    before = math.inf
    for _ in range(_MOST_STEPS):
        value, slope = f(x)
        if abs(value) < _NEAR:
            return x
        low, high = (x, high) if value < 0 else (low, x)
        newton = x - value / slope if slope > 0 else math.nan
        # Newton where it stays inside and gains; else the middle.
        x = newton if low < newton < high and abs(value) < before / 2 else (low + high) / 2
        before = abs(value)
        if high - low < 1e-15 * high:
            break
    return x


def _reach(law: Law, stone: Stone, load: Load, omega: float, speed: float, v: float) -> _Reach:
    if v <= speed:
        return _Reach(np.zeros(2), np.zeros(2))
    first, last = 0.0, 60.0
    while True:
        path, slopes = _followed(law, stone, load, v, omega, np.linspace(first, last, _TIMES))
        slow = np.flatnonzero(path[2] <= speed)
        if len(slow):
            break
        if last >= LONGEST or np.isnan(path).any():
            return _Reach(np.full(2, math.nan), np.zeros(2))
        last *= 2
    if speed == 0:
        return _Reach(path[:2, -1], slopes[:2, -1])
    # The moment at which the speed is reached, closer and closer.
    times = np.linspace(first, last, _TIMES)
    for _ in range(2):
        k = max(int(slow[0]), 1)
        times = np.linspace(times[k - 1], times[k], _TIMES)
        path, slopes = _followed(law, stone, load, v, omega, times)
        slow = np.flatnonzero(path[2] <= speed)
        slow = slow if len(slow) else np.array([_TIMES - 1])
    k = max(int(slow[0]), 1)
    slowing = (path[2, k] - path[2, k - 1]) / (times[k] - times[k - 1])
    wait = (speed - path[2, k]) / slowing  # to the moment, of some microseconds at most
    place = path[:2, k] + wait * path[3:, k]
    # A faster stone reaches the speed later.
    later = -slopes[2, k] / slowing
    return _Reach(place, slopes[:2, k] + path[3:, k] * later)


@kept("law", "load")
def _traced(
    law: type[Law], load: Load, coefficients: Array, stone: Stone, v: Array, omega: Array,
    times: Array,
) -> tuple[Array, Array]:  # fmt: skip
    def path(v: Array) -> Array:
        start = InitialState(v=v, omega=omega)
        found = simulate(law.from_vector(coefficients), stone, start, times, load=load, t0=0.0)
        return jnp.stack([found.x, found.y, found.speed, found.vx, found.vy])

    return jax.jvp(path, (v,), (jnp.ones(()),))


def _followed(
    law: Law, stone: Stone, load: Load, v: float, omega: float, times: Floats
) -> tuple[Floats, Floats]:
    """x, y, speed, vx, vy at times, shape (5, n), and their derivatives by the initial speed."""
    coefficients = np.array([float(getattr(law, item.name)) for item in law.coefficients()])
    path, slopes = _traced(type(law), load, coefficients, stone, float(v), float(omega), times)
    return np.asarray(path), np.asarray(slopes)
