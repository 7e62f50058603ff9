"""Column headers: quantity, unit, and the factor to SI."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from functools import cache, lru_cache
from itertools import groupby
from pathlib import Path
from typing import NamedTuple
from unicodedata import normalize

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.sheet import FOOT

_NAMES = {
    "t": "t|time|timestamp|seconds|elapsed",
    "x": "(pos(ition)?)?x|x(pos(ition)?|coord)",
    "y": "(pos(ition)?)?y|y(pos(ition)?|coord)",
    "phi": "phi|φ|ϕ|angle|theta|θ|rot(ation)?|orientation",
    "speed": "speed|v|vel(ocity)?",
    "omega": "omega|ω|spin(rate)?|angular(velocity|speed)|speedangular|gyroz?|[gw]z|"
    "(angle|rotation)rate",
    "x_mark": "x(handle|mark)|(handle|mark)x",
    "y_mark": "y(handle|mark)|(handle|mark)y",
    "u": "u|x(pixel|image)|(pixel|image)x",
    "v": "y(pixel|image)|(pixel|image)y",
}
"""Names of quantities, as patterns."""
_SIGMA = {"sigma", "sd", "std", "stdev", "err", "error", "unc", "uncertainty"}
_OF_CLOCKS = {
    "t_x": _NAMES["x"], "t_y": _NAMES["y"], "t_xy": "xy|pos(ition)?|cam(era)?|video|tracker",
    "t_phi": _NAMES["phi"] + "|compass|handle", "t_speed": _NAMES["speed"] + "|radar",
    "t_omega": _NAMES["omega"] + "|imu",
}  # fmt: skip
"""What a clock of single channels is named after, beside the word for time."""

_TURN = 2 * math.pi
_UNITS = {
    "t": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
        "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0, "minutes": 60.0,
    },
    "length": {
        "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "cm": 1e-2,
        "mm": 1e-3, "ft": FOOT, "foot": FOOT, "feet": FOOT, "in": FOOT / 12,
        "inch": FOOT / 12, "inches": FOOT / 12, "yd": 3 * FOOT,
    },
    "phi": {
        "rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "deg": math.pi / 180,
        "degree": math.pi / 180, "degrees": math.pi / 180, "°": math.pi / 180,
        "º": math.pi / 180, "rev": _TURN, "revs": _TURN, "revolutions": _TURN,
        "turn": _TURN, "turns": _TURN,
    },
    # "m/s" and "m_s" arrive here as "ms"
    "speed": {
        "m/s": 1.0, "ms": 1.0, "mps": 1.0, "ms^-1": 1.0, "ms⁻¹": 1.0, "cms": 1e-2, "mms": 1e-3,
        "fts": FOOT, "fps": FOOT, "kmh": 1 / 3.6, "kph": 1 / 3.6, "mph": 1609.344 / 3600,
    },
    "omega": {
        "rad/s": 1.0, "rads": 1.0, "radps": 1.0, "rads^-1": 1.0, "rads⁻¹": 1.0,
        "degs": math.pi / 180, "°s": math.pi / 180, "ºs": math.pi / 180, "dps": math.pi / 180,
        "degps": math.pi / 180, "rpm": math.pi / 30, "revs": _TURN, "rps": _TURN,
        "revmin": math.pi / 30,
    },
    "pixel": {"px": 1.0, "pixel": 1.0, "pixels": 1.0, "pix": 1.0},
}  # fmt: skip
# of a time that counts frames, or of a film of 60 frames a second that was read at 30
_FRAMES = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))? ?fps", re.I)
_SEPARATORS = re.compile(r"[\s_\-./()\[\]{},:·*\uff08\uff09\uff3b\uff3d]+")


class Column(NamedTuple):
    """Meaning of a column header."""

    quantity: str
    """"t", "x", "y", "phi", "speed", "omega", pixels "u", "v"; "sigma_x" and so on; "t_phi" and so
    on for a clock of one channel ("t_xy" for x and y)"""
    unit: str
    """as written, or the SI unit if none was"""
    factor: float
    """number in SI / number in the file"""
    stated: bool = True
    """whether the header names the unit"""

    @property
    def base(self) -> str:
        """The quantity in whose units it is: "x" of "sigma_x" and "x_mark", "t" of all clocks."""
        first, _, last = self.quantity.partition("_")
        return last if first == "sigma" else first


@lru_cache(1024)
def parse_header(header: str, *, other_words: bool = False) -> Column | None:
    """Meaning of a column header such as `time`, `y_ft`, `x [cm]`, `phi_rev`; None if unknown.

    Parameters
    ----------
    other_words : whether it may be in another language, as in `words.toml`.
    """
    words = _words(header, other_words)
    for unit_words in (2, 1, 0):
        if len(words) <= unit_words:
            continue
        name = words[: len(words) - unit_words]
        quantity = _quantity(name)
        if quantity is None:
            continue
        unit = "".join(words[len(name) :])
        units = units_of(quantity)
        if not unit_words:
            return Column(quantity, next(iter(units)), 1.0, stated=False)
        if unit in units:
            return Column(quantity, "/".join(words[len(name) :]), units[unit])
        if unit in _UNITS["pixel"]:
            base = quantity.removeprefix("sigma_")
            axis = "v" if "v" in name else {"x": "u", "y": "v"}.get(base)
            if axis:
                return Column(quantity.removesuffix(base) + axis, "px", 1.0)
    return None


def named_column(header: str, quantity: str) -> Column:
    """The column of a quantity that the user names, in the unit that ends its header, if any.

    Raises
    ------
    InputError : what is in brackets there is no unit of the quantity.
    """
    words, units = _words(header, True), units_of(quantity)
    for begin in (-2, -1):
        if "".join(words[begin:]) in units:
            unit = words[begin:]
            return Column(quantity, "/".join(unit), units["".join(unit)])
    if bracket := re.search(r"[(\[]([^()\[\]]+)[)\]]\s*$", header):
        return in_unit(quantity, bracket[1])
    return Column(quantity, next(iter(units)), 1.0, stated=False)


def resembled(header: str) -> str | None:
    """The quantity that a header of unknown meaning reminds of; None if none or more than one."""
    words, hints = _words(header, True), _other_words()["may_mean"]
    found = {hints.get(word) or _named(word, _NAMES) for word in words} - {None}
    found |= {name for name in ("omega", "phi") if "".join(words[-2:]) in _UNITS[name]}
    return found.pop() if len(found) == 1 and found <= _NAMES.keys() else None


@cache
def _other_words() -> dict[str, dict[str, str]]:
    """By table of `words.toml`, each of its words with its meaning."""
    tables = tomllib.loads(Path(__file__).with_name("words.toml").read_text("utf-8"))
    return {
        name: {word: meaning for meaning, words in table.items() for word in words.split()}
        for name, table in tables.items()
    }


def has_japanese_words(text: str) -> bool:
    """Whether a text has a word of headings in Japanese."""
    return any(word in text for word in _other_words()["means"] if min(word) > "\u3000")


def _words(header: str, other_words: bool) -> list[str]:
    """The words of a header, in English if it may be in another language."""
    words = [word for word in _SEPARATORS.split(normalize("NFC", header).strip().lower()) if word]
    if words and words[-1] == "1" and len(words) > 2 and "s^" in words[-2]:
        words = [*words[:-2], words[-2] + "-1"]  # "s^-1" was split at its sign
    if other_words:
        means = _other_words()["means"]
        words = [word for k, word in enumerate(words, 1) if word != "in" or k == len(words)]
        words = " ".join(means.get(word, word) for word in words).split()
        words = [word for word, _ in groupby(words)]  # the unit may say the quantity again
    return words


def units_of(quantity: str) -> dict[str, float]:
    """Units that a quantity may have, with their factors to SI."""
    base = quantity.removeprefix("sigma_")
    kind = "pixel" if base in ("u", "v") else "t" if base.startswith("t") else base
    return _UNITS.get(kind, _UNITS["length"])


def in_unit(quantity: str, unit: str) -> Column:
    """A quantity in a given unit. Raises `InputError` for an unknown unit."""
    text = "".join(word for word in _SEPARATORS.split(unit.strip().lower()) if word)
    units = units_of(quantity)
    frames = _FRAMES.fullmatch(unit.strip())
    if frames is not None and units is _UNITS["t"] and float(frames[1]) > 0:
        return Column(quantity, unit.strip(), float(frames[2] or 1) / float(frames[1]))
    if text not in units and text in _UNITS["pixel"] and quantity in ("x", "y"):
        return Column("u" if quantity == "x" else "v", "px", 1.0)
    if text not in units:
        known = [name for name in units if name.isascii()]
        raise InputError(
            f"{quantity} in {quoted(unit.strip())}: unknown unit; expected one of "
            f"{', '.join(known)}"
        )
    return Column(quantity, unit.strip(), units[text])


def parse_units(text: str | None) -> dict[str, str]:
    """`t=ms,x=cm,angle=deg` as units by quantity; `length` stands for x and y.

    Raises
    ------
    InputError : a part that is not QUANTITY=UNIT, an unknown quantity or unit.
    """
    found: dict[str, str] = {}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, equals, unit = (piece.strip() for piece in part.partition("="))
        quantity = _quantity([name.lower()]) if equals and unit else None
        if equals and unit and name.lower() == "length":
            quantities = ["x", "y"]
        elif quantity in ("t", "x", "y", "phi", "speed", "omega"):
            quantities = [str(quantity)]
        else:
            raise InputError(
                f"units {quoted(part.strip())}: expected QUANTITY=UNIT such as t=ms,x=cm,angle=deg "
                "with the quantities t, x, y, length, angle, speed, spin"
            )
        for item in quantities:
            in_unit(item, unit)
            found[item] = unit
    return found


def with_unit(column: Column, unit: str | None) -> Column:
    """A column in the unit given by the user, if any, instead of that of its header."""
    if unit is None:
        return column
    found = in_unit(column.base, unit)
    return found._replace(quantity=column.quantity.replace(column.base, found.quantity, 1))


def quantity_of(name: str) -> str | None:
    """The quantity of a name without a unit: `angle` is phi; None if unknown."""
    return _quantity(_words(name, False))


def _named(name: str, patterns: Mapping[str, str]) -> str | None:
    return next((key for key, names in patterns.items() if re.fullmatch(names, name)), None)


def _quantity(words: list[str]) -> str | None:
    rest = [word for word in words if word not in _SIGMA]
    quantity = _named("".join(rest), _NAMES)
    if len(rest) < len(words):
        return f"sigma_{quantity}" if quantity not in (None, "t") else None
    if quantity is None and len(words) > 1:
        for clock, other in ((words[0], words[1:]), (words[-1], words[:-1])):
            if clock != "seconds" and re.fullmatch(_NAMES["t"], clock):
                return _named("".join(other), _OF_CLOCKS)
    return quantity
