"""Column headers: quantity, unit, and the factor to SI."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from functools import lru_cache
from itertools import groupby
from typing import NamedTuple
from unicodedata import normalize

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.throws.readers.numbers import parse_number
from curlfit.throws.readers.words import WORDS, by_word

_NAMES: dict[str, str] = WORDS["names"]
_CLOCKS = {
    key: "|".join(filter(None, (_NAMES.get(key.removeprefix("t_")), words)))
    for key, words in WORDS["clocks"].items()
}
_SIGMA = {"sigma", "sd", "std", "stdev", "err", "error", "unc", "uncertainty"}
_UNITS = {
    kind: {unit: factor for units, factor in table.items() for unit in units.split()}
    for kind, table in WORDS["units"].items()
}
_MEANS = by_word(WORDS["means"])
_MAY_MEAN = by_word(WORDS["may_mean"])
# of a time that counts frames, or of a film of 60 frames a second that was read at 30
_FRAMES = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))? ?fps", re.I)
_SEPARATORS = re.compile(r"[\s_\-./()\[\]{},:·*\uff08\uff09\uff3b\uff3d]+")


class Column(NamedTuple):
    """Meaning of a column header."""

    quantity: str
    """"t", "x", "y", "phi", "speed", "omega", pixels "u", "v"; "sigma_x" and so on;
    "t_phi" and so on for a clock of one channel ("t_xy" for x and y)"""
    unit: str
    """as written, or the SI unit if none was"""
    factor: float
    """number in SI / number in the file"""
    stated: bool = True
    """whether the header names the unit"""

    @property
    def base(self) -> str:
        """The quantity in whose units it is: "x" of "sigma_x" and "x_mark", "t"
        of all clocks."""
        first, _, last = self.quantity.partition("_")
        return last if first == "sigma" else first


@lru_cache(1024)
def parse_header(header: str, *, other_words: bool = False) -> Column | None:
    """Meaning of a column header such as `time`, `y_ft`, `x [cm]`, `phi_rev`;
    None if unknown.

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
    """The column of a quantity that the user names, in the unit that ends its
    header, if any.

    Raises
    ------
    InputError : what is in brackets there is no unit of the quantity.
    """
    units = units_of(quantity)
    unit = _unit_at_end(header, units)
    if unit:
        return Column(quantity, "/".join(unit), units["".join(unit)])
    if bracket := re.search(r"[(\[]([^()\[\]]+)[)\]]\s*$", header):
        return in_unit(quantity, bracket[1])
    return Column(quantity, next(iter(units)), 1.0, stated=False)


def unit_in(header: str, kind: str) -> str:
    """The unit in brackets, or as the last word, of a header of some kind of quantity;
    empty if there is none."""
    return "".join(_unit_at_end(header, units_of(kind)))


def _unit_at_end(header: str, units: Collection[str]) -> list[str]:
    """The last word of a header, or the last two, that are one of some units; empty if
    they are none."""
    words = _words(header, True)
    for last in (words[-2:], words[-1:]):
        if "".join(last) in units:
            return last
    return []


def resembled(header: str) -> str | None:
    """The quantity that a header of unknown meaning reminds of; None if none or
    more than one."""
    words = _words(header, True)
    quantities = {_MAY_MEAN.get(word) or _named(word, _NAMES) for word in words}
    quantities.discard(None)
    for angular in ("omega", "phi"):
        if "".join(words[-2:]) in _UNITS[angular]:
            quantities.add(angular)
    if len(quantities) == 1 and quantities <= _NAMES.keys():
        return quantities.pop()
    return None


def has_japanese_words(text: str) -> bool:
    """Whether a text has a word of headings in Japanese."""
    return any(word in text for word in _MEANS if min(word) > "\u3000")


def _words(header: str, other_words: bool) -> list[str]:
    """The words of a header, in English if it may be in another language."""
    words = [
        word
        for word in _SEPARATORS.split(normalize("NFC", header).strip().lower())
        if word
    ]
    if words and words[-1] == "1" and len(words) > 2 and "s^" in words[-2]:
        words = [*words[:-2], words[-2] + "-1"]  # "s^-1" was split at its sign
    if other_words:
        # "in" is a unit only at the end: `time in s` has none of length
        words = [word for word in words[:-1] if word != "in"] + words[-1:]
        words = " ".join(_MEANS.get(word, word) for word in words).split()
        # the unit may say the quantity again
        words = [word for word, _ in groupby(words)]
    return words


def units_of(quantity: str) -> dict[str, float]:
    """Units that a quantity may have, with their factors to SI."""
    base = quantity.removeprefix("sigma_")
    if base in ("u", "v"):
        return _UNITS["pixel"]
    if base.startswith("t"):
        return _UNITS["t"]
    return _UNITS.get(base, _UNITS["length"])


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any quantity, in any language of `words.toml`."""
    word = "".join(_words(text, True))
    return any(word in units for units in _UNITS.values())


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
        expected = ", ".join(name for name in units if name.isascii())
        raise InputError(
            f"{quantity} in {quoted(unit.strip())}: unknown unit; expected one of "
            f"{expected}"
        )
    return Column(quantity, unit.strip(), units[text])


def parse_units(text: str | None) -> dict[str, str]:
    """`t=ms,x=cm,angle=deg` as units by quantity; `length` stands for x and y.

    Raises
    ------
    InputError : a part that is not QUANTITY=UNIT, an unknown quantity or unit.
    """
    units: dict[str, str] = {}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, equals, unit = (piece.strip() for piece in part.partition("="))
        quantity = _quantity([name.lower()]) if equals and unit else None
        if equals and name.lower() == "date":
            if unit not in ("day-first", "month-first"):
                raise InputError(
                    f"units date={quoted(unit)}: expected date=day-first or "
                    "date=month-first"
                )
            units["date"] = unit
            continue
        if equals and unit and name.lower() == "length":
            quantities = ["x", "y"]
        elif quantity in ("t", "x", "y", "phi", "speed", "omega"):
            quantities = [str(quantity)]
        else:
            raise InputError(
                f"units {quoted(part.strip())}: expected QUANTITY=UNIT such "
                "as t=ms,x=cm,angle=deg with the quantities t, x, y, length, "
                "angle, speed, spin"
            )
        for quantity in quantities:
            in_unit(quantity, unit)
            units[quantity] = unit
    return units


def with_unit(column: Column, unit: str | None) -> Column:
    """A column in the unit given by the user, if any, instead of that of its header."""
    if unit is None:
        return column
    in_its_unit = in_unit(column.base, unit)
    # x in pixels is u
    quantity = column.quantity.replace(column.base, in_its_unit.quantity, 1)
    return in_its_unit._replace(quantity=quantity)


def quantity_of(name: str) -> str | None:
    """The quantity of a name without a unit: `angle` is phi; None if unknown."""
    return _quantity(_words(name, False))


def quantities_of(headings: Iterable[str]) -> list[str]:
    """The quantities that headings name, without those of unknown meaning."""
    columns = map(parse_header, headings)
    return [column.quantity for column in columns if column is not None]


def frame_rate(unit: str) -> float | None:
    """Frames a second of a film as it is read, for a unit such as 30fps or 240/30fps;
    None for another unit."""
    frames = _FRAMES.fullmatch(unit)
    return None if frames is None else float(frames[2] or frames[1])


def unit_of_frames(rate: str) -> str:
    """The unit of times that count frames, from their rate as a file has it; empty for
    what is no rate of a camera."""
    number = parse_number(rate)
    if number is None or not 1e-3 <= number <= 1e6:
        return ""
    return f"{number:.9g}fps"


def _named(name: str, patterns: Mapping[str, str]) -> str | None:
    """The first key whose pattern a name has; None for none."""
    for key, pattern in patterns.items():
        if re.fullmatch(pattern, name):
            return key
    return None


def _quantity(words: list[str]) -> str | None:
    """The quantity that words name, such as `x`, `sigma x`, or `t phi` for a clock of
    the angle; None for none."""
    without_sigma = [word for word in words if word not in _SIGMA]
    quantity = _named("".join(without_sigma), _NAMES)
    if len(without_sigma) < len(words):
        return None if quantity in (None, "t") else f"sigma_{quantity}"
    if quantity is not None or len(words) < 2:
        return quantity
    for clock, channel in ((words[0], words[1:]), (words[-1], words[:-1])):
        if clock != "seconds" and re.fullmatch(_NAMES["t"], clock):
            return _named("".join(channel), _CLOCKS)
    return None
