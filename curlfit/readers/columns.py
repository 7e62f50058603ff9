"""Column names as people write them: quantity, unit, and the factor to SI."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

_NAMES = {
    "t": {"t", "time", "timestamp", "seconds", "elapsed"},
    "x": {"x", "xpos", "posx", "positionx", "xposition", "xcoord"},
    "y": {"y", "ypos", "posy", "positiony", "yposition", "ycoord"},
    "phi": {"phi", "φ", "ϕ", "angle", "theta", "θ", "rotation", "rot", "orientation"},
    "speed": {"speed", "v", "velocity", "vel"},
    "omega": {
        "omega", "ω", "spin", "spinrate", "angularvelocity", "angularspeed", "gyro", "gyroz", "gz",
        "wz", "rotationrate",
    },
}  # fmt: skip
_SIGMA = {"sigma", "sd", "std", "stdev", "err", "error", "unc", "uncertainty"}

_FOOT = 0.3048
_UNITS = {
    "t": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
        "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "minutes": 60.0,
    },
    "length": {
        "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2,
        "mm": 1e-3, "ft": _FOOT, "foot": _FOOT, "feet": _FOOT, "in": _FOOT / 12,
        "inch": _FOOT / 12, "inches": _FOOT / 12, "yd": 3 * _FOOT,
    },
    "phi": {
        "rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "deg": math.pi / 180,
        "degree": math.pi / 180, "degrees": math.pi / 180, "°": math.pi / 180,
        "rev": 2 * math.pi, "revs": 2 * math.pi, "revolutions": 2 * math.pi,
        "turn": 2 * math.pi, "turns": 2 * math.pi,
    },
    # "m/s" and "m_s" arrive here as "ms"
    "speed": {
        "m/s": 1.0, "ms": 1.0, "mps": 1.0, "cms": 1e-2, "mms": 1e-3, "fts": _FOOT, "fps": _FOOT,
        "kmh": 1 / 3.6, "kph": 1 / 3.6, "mph": 1609.344 / 3600,
    },
    "omega": {
        "rad/s": 1.0, "rads": 1.0, "radps": 1.0, "degs": math.pi / 180, "dps": math.pi / 180,
        "degps": math.pi / 180, "rpm": math.pi / 30, "revs": 2 * math.pi, "rps": 2 * math.pi,
        "revmin": math.pi / 30,
    },
}  # fmt: skip


class Column(NamedTuple):
    """What a column header means."""

    quantity: str
    """"t", "x", "y", "phi", "speed", "omega", or "sigma_x" and so on"""
    unit: str
    """as written, or the SI unit where none was"""
    factor: float
    """number in SI = number in the file times this"""


def understand(header: str) -> Column | None:
    """Meaning of a column header such as `time`, `y_ft`, `x [cm]`, `phi_rev`; None if unknown."""
    words = [word for word in re.split(r"[\s_\-./()\[\]{},:]+", header.strip().lower()) if word]
    for unit_words in (2, 1, 0):
        if len(words) <= unit_words:
            continue
        name = words[: len(words) - unit_words]
        quantity = _quantity(name)
        if quantity is None:
            continue
        units = _UNITS.get(quantity.removeprefix("sigma_"), _UNITS["length"])
        unit = "".join(words[len(name) :])
        if not unit_words:
            return Column(quantity, next(iter(units)), 1.0)
        if unit in units:
            return Column(quantity, "/".join(words[len(name) :]), units[unit])
    return None


def _quantity(words: list[str]) -> str | None:
    rest = [word for word in words if word not in _SIGMA]
    for quantity, names in _NAMES.items():
        if "".join(rest) in names:
            if len(rest) == len(words):
                return quantity
            return f"sigma_{quantity}" if quantity != "t" else None
    return None
