"""Remedies for a throw in wrong units or axes, as options to type."""

from __future__ import annotations

import math
from dataclasses import replace

from curlfit.errors import Option
from curlfit.findings import Remedy
from curlfit.sheet import LENGTH
from curlfit.throws.motion import motion_of
from curlfit.throws.readers.columns import in_unit
from curlfit.throws.throw import Conventions, Throw

USUAL_FRICTION = (0.003, 0.04)
"""Mean coefficient of friction: the published values with a factor of two on
either side."""
USUAL_SPEED = 4.5
"""m/s; 3.5 m/s with a margin for the slowing down before the hog line."""
USUAL_CURL = 4.0
"""m; ordinary throws curl 0.5 to 2 m."""
_READ = ("60/30fps", "120/30fps", "240/30fps", "30/60fps")  # filmed and read
_UNITS = {
    "t": ("s", "ms", "us", "min", "30fps", *_READ),
    "phi": ("rad", "deg", "mrad"),
    "omega": ("rad/s", "deg/s", "rpm"),
    "speed": ("m/s", "km/h", "ft/s", "mph", "cm/s", "mm/s"),
    "x": ("m", "cm", "mm", "ft", "in"),
}
_NAMES = {
    "ms": "milliseconds",
    "us": "microseconds",
    "min": "minutes",
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
    found = {unit: in_unit(quantity, unit).factor / now for unit in _UNITS[quantity]}
    return {unit: factor for unit, factor in found.items() if factor != 1}


def _candidates(throw: Throw) -> dict[str, dict[str, float]]:
    """Units that may be the right ones, with the factors by which the channels
    would change."""
    times, lengths = factors(throw, "t"), factors(throw, "x")
    found = {f"t={unit}": {"t": factor} for unit, factor in times.items()}
    for unit, factor in lengths.items():
        both = {"x": factor, "y": factor}
        found |= {
            f"length={unit}": both,
            f"x={unit}": {"x": factor},
            f"y={unit}": {"y": factor},
        }
        found |= {
            f"t={time},length={unit}": {"t": of_time, **both}
            for time, of_time in times.items()
            if not time.endswith("fps")
        }
    return found


def unit_remedy(throw: Throw) -> Remedy:
    """The fewest changes of units that make this the least odd throw."""
    best, units = math.inf, ""
    for name, changes in _candidates(throw).items():
        scaled = {
            channel: factor * getattr(throw, channel)
            for channel, factor in changes.items()
        }
        alone = len(changes) == 1 and "t" not in changes  # rare
        odd = _oddity(replace(throw, sigma={}, **scaled), alone) + name.count(",")
        odd += alone * (1 + name.endswith(("in", "ft"))) + 2 * name.endswith(_READ)
        if odd < best:
            best, units = odd, name
    if not units:
        return Remedy("set-units", *some_units(throw))
    typed = option(throw, "units", units)
    if units.endswith(_READ):
        filmed, _, read = units.removeprefix("t=").removesuffix("fps").partition("/")
        return Remedy("units-of-film", typed, {"filmed": filmed, "read": read})
    if units.endswith("fps"):
        return Remedy("units-of-frames", typed)
    subjects = {"t": "the time is", "length": "lengths are"}
    columns = []
    for part in units.split(","):
        name, _, unit = part.partition("=")
        subject = subjects.get(name, f"{name} is")
        columns.append({"subject": subject, "unit": _NAMES.get(unit, unit)})
    return Remedy("units", typed, {"columns": columns})


def _oddity(throw: Throw, alone: bool) -> float:
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
    odd = abs(math.log(motion.friction / 0.01)) + abs(math.log(motion.fastest / 2))
    return odd + abs(math.log(max(abs(motion.curl), 1e-3))) * alone
