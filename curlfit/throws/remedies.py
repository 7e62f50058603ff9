"""Remedies for a throw in wrong units or axes, as options to type."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from curlfit.errors import Option
from curlfit.findings import Remedy
from curlfit.sheet import LENGTH
from curlfit.throws.motion import motion_of
from curlfit.throws.readers.columns import in_unit
from curlfit.throws.reference import Conventions
from curlfit.throws.throw import Throw

USUAL_FRICTION = (0.003, 0.04)
"""Mean coefficient of friction: the published values with a factor of two on
either side."""
USUAL_SPEED = 4.5
"""m/s; 3.5 m/s with a margin for the slowing down before the hog line."""
USUAL_CURL = 4.0
"""m; ordinary throws curl 0.5 to 2 m."""
_READ = ("60/30fps", "120/30fps", "240/30fps", "30/60fps")  # filmed and read
_UNITS = {
    "t": ("s", "ms", "us", "ns", "min", "h", "days", "30fps", *_READ),
    "phi": ("rad", "deg", "mrad"),
    "omega": ("rad/s", "deg/s", "rpm"),
    "speed": ("m/s", "km/h", "ft/s", "mph", "cm/s", "mm/s"),
    "x": ("m", "cm", "mm", "ft", "in"),
}
_NAMES = {
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
    "min": "minutes",
    "h": "hours",
    "cm": "centimetres",
    "mm": "millimetres",
    "ft": "feet",
    "in": "inches",
    "s": "seconds",
    "m": "metres",
}


def option(throw: Throw, name: str, value: str) -> Option:
    """An option as written on the command line, or in Python for a throw
    from arrays; one without a value is to be left out."""
    from_arrays = throw.conventions is None
    return Option(name, value, in_python=from_arrays, left_out=not value)


def some_units(throw: Throw) -> tuple[Option, dict[str, str]]:
    """Units as an example of what to type: an option, and the words of another as the
    number `other`."""
    other = option(throw, "units", "length=cm")
    return option(throw, "units", "t=ms"), {"other": str(other)}


def factors(throw: Throw, quantity: str) -> dict[str, float]:
    """Units that a column may really be in, with the factors by which its values
    would change."""
    now = (throw.conventions or Conventions()).factors.get(quantity, 1.0)
    by_unit = {unit: in_unit(quantity, unit).factor / now for unit in _UNITS[quantity]}
    return {unit: factor for unit, factor in by_unit.items() if factor != 1}


class _Change(NamedTuple):
    """Units that columns may really be in.

    Attributes
    ----------
    units : by the name of the columns in `--units`, as {"t": "ms", "length": "cm"}.
    factors : by channel, by which its values would change.
    """

    units: dict[str, str]
    factors: dict[str, float]

    @property
    def typed(self) -> str:
        """The value of `--units`."""
        return ",".join(f"{name}={unit}" for name, unit in self.units.items())

    @property
    def of_one_axis(self) -> bool:
        """Whether only one of x and y changes."""
        return len(self.factors) == 1 and "t" not in self.factors

    @property
    def rarity(self) -> int:
        """How seldom people's files need it, beside the oddity of the throw: that two
        columns, one axis alone (feet or inches still less often) or a film read at
        another rate are wrong."""
        rarity = len(self.units) - 1
        if self.of_one_axis:
            rarity += 1
            if set(self.units.values()) & {"in", "ft"}:
                rarity += 1
        if self.units.get("t") in _READ:
            rarity += 2
        return rarity


def _changes(throw: Throw) -> Iterator[_Change]:
    """Changes of the units of times, of lengths, of one axis, and of times and
    lengths together."""
    times = factors(throw, "t")
    for time, factor in times.items():
        yield _Change({"t": time}, {"t": factor})
    for length, factor in factors(throw, "x").items():
        lengths = {"x": factor, "y": factor}
        yield _Change({"length": length}, lengths)
        yield _Change({"x": length}, {"x": factor})
        yield _Change({"y": length}, {"y": factor})
        for time, of_time in times.items():
            if not time.endswith("fps"):
                yield _Change({"t": time, "length": length}, {"t": of_time, **lengths})


def unit_remedy(throw: Throw) -> Remedy:
    """The fewest changes of units that make this the least odd throw."""
    least_odd = math.inf
    best = None
    for change in _changes(throw):
        scaled = {
            channel: factor * getattr(throw, channel)
            for channel, factor in change.factors.items()
        }
        in_other_units = replace(throw, sigma={}, **scaled)
        oddity = _oddity(in_other_units, change.of_one_axis) + change.rarity
        if oddity < least_odd:
            least_odd = oddity
            best = change
    if best is None:
        return Remedy("set-units", *some_units(throw))
    typed = option(throw, "units", best.typed)
    time = best.units.get("t", "")
    if time in _READ:
        filmed, _, read = time.removesuffix("fps").partition("/")
        return Remedy("units-of-film", typed, {"filmed": filmed, "read": read})
    if time.endswith("fps"):
        return Remedy("units-of-frames", typed)
    subjects = {"t": "the time is", "length": "lengths are"}
    columns = [
        {"subject": subjects.get(name, f"{name} is"), "unit": _NAMES.get(unit, unit)}
        for name, unit in best.units.items()
    ]
    return Remedy("units", typed, {"columns": columns})


def _oddity(throw: Throw, one_axis_alone: bool) -> float:
    """How far a throw is from a draw of 2 m/s, friction 0.01 and, where one axis alone
    is scaled, a curl of 1 m; infinite if it is not usual."""
    motion = motion_of(throw)
    if (
        motion is None
        or not 0.1 < motion.fastest < USUAL_SPEED
        or motion.length > LENGTH
        or abs(motion.curl) > USUAL_CURL
        or not USUAL_FRICTION[0] < motion.friction < USUAL_FRICTION[1]
    ):
        return math.inf
    oddity = abs(math.log(motion.friction / 0.01)) + abs(math.log(motion.fastest / 2))
    if one_axis_alone:
        oddity += abs(math.log(max(abs(motion.curl), 1e-3)))
    return oddity
