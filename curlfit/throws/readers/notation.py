"""Quantities as people write them: `14,2 s`, `4 ft left`, `3'3"`,
`0.6 m past the tee`."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.throws.readers.clocks import time_by_watch
from curlfit.throws.readers.columns import in_unit, units_of
from curlfit.throws.readers.numbers import parse_number
from curlfit.throws.readers.words import WORDS, by_word

_NUMBER = re.compile(
    r"(?P<sign>[-+\u2212]?)\s*(?P<size>\d[\d.,]*|[.,]\d+)(?P<power>e[-+]?\d+)?", re.I
)
_INCHES = re.compile(r"(?<=\d)\s*(?:[\"\u2033\u201d]|['\u2032\u2019]{2})")
_FEET = re.compile(r"(?<=\d)\s*['\u2032\u2019]")
_UNIT = re.compile(r"[^\W\d_]+[.]?|[°'\u2032\"\u2033]")
_RATE = re.compile(r"(?:[^\W\d_]+|°)(?:\s*/\s*[^\W\d_]+)?[.]?")  # km/h, °/s
_FILLING = set(WORDS["filling"].split())
_MEANS = by_word(WORDS["directions"])


class Quantity(NamedTuple):
    """A quantity as written.

    Attributes
    ----------
    value : in SI; NaN where only words were written. signed : whether it had a sign.
    words : words of direction, those of `directions` in `words.toml`.
    """

    value: float
    signed: bool
    words: frozenset[str]


def parse_quantity(
    text: str, quantity: str, unit: str = "", *, per: float = 1.0
) -> Quantity:
    """A number with its unit and words of direction, or such words alone.

    Parameters
    ----------
    quantity : "t", "x", "y", "phi", "speed" or "omega"; determines the
        units understood.
    unit : unit of numbers written without one; if empty, the SI unit times `per`.

    Raises
    ------
    InputError : no number, an unknown unit or word.
    """
    if units_of(quantity) is units_of("t") and ":" in text:
        time = time_by_watch(text)
        if time is not None:
            return Quantity(time, signed=False, words=frozenset())
    rest = text.strip()
    if units_of(quantity) is units_of("x"):
        # a last mark of inches belongs to the number, unless the text begins
        # with one too
        rest = re.sub(r"^([\"'])(.*)\1$", r"\2", rest).lstrip("\"'")
        rest = _FEET.sub(" ft ", _INCHES.sub(" in ", rest))
    rest = re.sub(r"(?i)\bin\s+front\b", "front", rest.strip("\"'").strip())
    sign, value, signed, units = 1.0, 0.0, False, units_of(quantity)
    given, before = unit, ""
    numbers, bare = 0, False
    while match := _NUMBER.match(rest):
        if numbers and (match["sign"] or bare):
            break  # another number may only follow a unit, as in 4 ft 6 in
        size = parse_number(match["size"] + (match["power"] or ""), decimal_comma=True)
        if size is None:
            break
        rest = rest[match.end() :].strip()
        own = (_RATE if quantity in ("speed", "omega") else _UNIT).match(rest)
        said = re.sub(r"[\s/]", "", own[0].rstrip(".").lower()) if own else ""
        bare = said not in units
        if own and not bare:
            rest, given = rest[own.end() :].strip(), said
        elif said and said not in _MEANS and said not in _FILLING:
            in_unit(quantity, said)  # raises
        elif before in ("ft", "foot", "feet"):
            given = "in"  # 3 ft 6
        elif numbers:
            raise InputError(
                f"{quoted(text.strip())} found, expected a unit of {match[0].strip()}"
            )
        value += size * (in_unit(quantity, given).factor if given else per)
        if match["sign"]:
            signed, sign = True, -1.0 if match["sign"] != "+" else 1.0
        numbers += 1
        given, before = unit, given
    words = re.sub(r"(?i)\b(counter|anti)[\s-]+(?=clock)", r"\1", rest)
    said_words = re.findall(r"[^\W\d_]+|\d[\d.,]*", words.lower())
    unknown = [
        word for word in said_words if word not in _MEANS and word not in _FILLING
    ]
    if unknown or (not numbers and not said_words):
        raise InputError(f"{quoted(text.strip())} found, expected a number")
    return Quantity(
        sign * value if numbers else math.nan,
        signed,
        frozenset(_MEANS[word] for word in said_words if word in _MEANS),
    )
