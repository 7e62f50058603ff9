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
_IN_QUOTES = re.compile(r"^([\"'])(.*)\1$")
_IN_FRONT = re.compile(r"\bin\s+front\b", re.I)  # not in inches
_COUNTER_CLOCKWISE = re.compile(r"\b(counter|anti)[\s-]+(?=clock)", re.I)
_UNIT = re.compile(r"[^\W\d_]+[.]?|[°'\u2032\"\u2033]")
_RATE = re.compile(r"(?:[^\W\d_]+|°)(?:\s*/\s*[^\W\d_]+)?[.]?")  # km/h, °/s
_FILLING = set(WORDS["filling"].split())
_FEET_IN_WORDS = ("ft", "foot", "feet")
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


class _Number(NamedTuple):
    """A number with its sign, if any, and its unit, which is empty if none follows."""

    sign: str
    size: float
    unit: str


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
    plain = _in_words(text, quantity)
    numbers, rest = _leading_numbers(plain, text, quantity, unit)
    words = _words(rest)
    if not (numbers or words) or not all(map(_is_known, words)):
        raise InputError(f"{quoted(text.strip())} found, expected a number")
    directions = frozenset(_MEANS[word] for word in words if word in _MEANS)
    if not numbers:
        return Quantity(math.nan, signed=False, words=directions)
    value = 0.0
    for number in numbers:
        factor = in_unit(quantity, number.unit).factor if number.unit else per
        value += number.size * factor
    sign = numbers[0].sign
    negative = sign in ("-", "\u2212")
    return Quantity(-value if negative else value, bool(sign), directions)


def _in_words(text: str, quantity: str) -> str:
    """A text with the marks of feet and inches as words, and each direction as one. A
    last mark of inches belongs to the number, unless the text begins with one too."""
    words = text.strip()
    if units_of(quantity) is units_of("x"):
        words = _IN_QUOTES.sub(r"\2", words).lstrip("\"'")
        words = _INCHES.sub(" in ", words)  # before feet: '' are inches
        words = _FEET.sub(" ft ", words)
    words = _IN_FRONT.sub("front", words.strip("\"'").strip())
    return _COUNTER_CLOCKWISE.sub(r"\1", words)


def _leading_numbers(
    rest: str, text: str, quantity: str, usual_unit: str
) -> tuple[list[_Number], str]:
    """The numbers with which a text begins, and the rest of it. Another number may only
    follow a unit, as in 4 ft 6 in; after feet it is in inches.

    Parameters
    ----------
    rest : the text with units as words. text : as written.
    usual_unit : of a number without one.
    """
    units = units_of(quantity)
    pattern = _RATE if quantity in ("speed", "omega") else _UNIT
    numbers: list[_Number] = []
    may_follow = True
    while may_follow and (match := _NUMBER.match(rest)):
        if numbers and match["sign"]:
            break
        size = parse_number(match["size"] + (match["power"] or ""))
        if size is None:
            break
        rest = rest[match.end() :].strip()
        word = pattern.match(rest)
        written = re.sub(r"[\s/]", "", word[0].rstrip(".").lower()) if word else ""
        may_follow = written in units
        if word and may_follow:
            rest = rest[word.end() :].strip()
            unit = written
        elif written and not _is_known(written):
            raise _unknown_unit(text, quantity, written)
        elif numbers and numbers[-1].unit in _FEET_IN_WORDS:
            unit = "in"  # 3 ft 6
        elif numbers:
            raise InputError(
                f"{quoted(text.strip())} found, expected a unit of {match[0].strip()}"
            )
        else:
            unit = usual_unit
        numbers.append(_Number(match["sign"], size, unit))
    return numbers, rest


def _unknown_unit(text: str, quantity: str, unit: str) -> InputError:
    """The error of a unit that is none of the quantity."""
    try:
        in_unit(quantity, unit)
    except InputError as error:
        return InputError(f"{quoted(text.strip())} found; {error}")
    return InputError(f"{quoted(text.strip())} found, expected a unit after a number")


def _words(text: str) -> list[str]:
    """The words after a number, and further numbers."""
    return re.findall(r"[^\W\d_]+|\d[\d.,]*", text.lower())


def _is_known(word: str) -> bool:
    """Whether a word is a direction, or says nothing beside one."""
    return word in _MEANS or word in _FILLING
