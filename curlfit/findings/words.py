"""The words of findings and remedies, from `messages.toml` beside this file.

Each code of a finding has

    title  what it is about, in a few words without numbers
    brief  the same with numbers, if these make it clearer
    says   a sentence without a full stop, with its numbers in braces
    one    the sentence where the number `count` is 1, if it differs
    parts  words for a number that may be missing, and for each item of a list
    means  what it means and what to do, for `curlfit explain` and the book

Numbers have the formats of Python, and three more: `{x:digits}` is x with two digits
and without an exponent, `{x:error}` a value with the error of its last digits, from a
list of both, `{x:p}` a probability as in "p < 0.001". A list is joined by commas, with
a word as in `{x:and}` before its last item; by signs as in `{x:;}`; with `{x:+}` by
nothing. A part stands for its number: nothing if that is None, False or empty; for a
list, the part of each of its items, which are named `value` or are objects whose keys
are named. A key of such objects that may be missing has a part of its own, as in
`parts."rows.line"`. Words of remedies have `says`, `one` and `parts`, and `{option}`
for what is to be typed.
"""

from __future__ import annotations

import string
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.wording import compact, join_words, p_text, two_digits

_MOST_NAMED = 3  # throws that a sentence names; of more the first two


@dataclass(frozen=True)
class Message:
    """The words of a code; its attributes are those of `messages.toml`."""

    says: str
    title: str = ""
    brief: str = ""
    one: str = ""
    parts: dict[str, str] = field(default_factory=dict)
    means: str = ""

    def filled(self, numbers: Mapping[str, Any]) -> str:
        """The sentence with its numbers. Raises `KeyError` or `ValueError` where
        these are others than it names."""
        filled = dict(numbers)
        for name, template in self.parts.items():
            if "." not in name:
                parts_of_keys = _below(name, self.parts)
                filled[name] = _part(template, numbers[name], numbers, parts_of_keys)
        words = self.one if self.one and numbers.get("count") == 1 else self.says
        return _FORMATTER.vformat(words, (), filled)


class _Formatter(string.Formatter):
    """Formats of Python, and those of this module."""

    def format_field(self, value: Any, spec: str) -> str:
        """A value in a format."""
        if spec == "digits":
            return two_digits(value)
        if spec == "error":
            return compact(*value)
        if spec == "p":
            return p_text(value)
        if isinstance(value, list | tuple):
            return _joined(list(map(str, value)), spec)
        return format(value, spec)


_FORMATTER = _Formatter()


def _joined(texts: list[str], spec: str) -> str:
    """The items of a list in a format."""
    if spec == "+" or not texts:
        return "".join(texts)
    if spec[:1].isalpha():
        return join_words(texts, spec)
    return f"{spec or ','} ".join(texts)


def _below(name: str, parts: Mapping[str, str]) -> dict[str, str]:
    """Parts of the keys of a list's objects, from those of the message, whose names
    begin with that of the list."""
    prefix = f"{name}."
    return {
        part.removeprefix(prefix): template
        for part, template in parts.items()
        if part.startswith(prefix)
    }


def _part(
    template: str,
    value: Any,
    numbers: Mapping[str, Any],
    parts_of_keys: Mapping[str, str] | None = None,
) -> str | list[str]:
    """The words of a part for its number, or for each item of its list, whose keys
    may have parts of their own."""
    if value is None or value is False:
        return ""
    if not isinstance(value, list | tuple):
        return _FORMATTER.vformat(template, (), numbers)
    texts = []
    for entry in value:
        numbers_of_entry = entry if isinstance(entry, Mapping) else {"value": entry}
        context = {**numbers, **numbers_of_entry}
        filled = dict(context)
        for key, template_of_key in (parts_of_keys or {}).items():
            filled[key] = _part(template_of_key, numbers_of_entry[key], context)
        texts.append(_FORMATTER.vformat(template, (), filled))
    return texts


@cache
def _tables() -> dict[str, dict[str, Message]]:
    """The messages of findings and of remedies, by code."""
    file = Path(__file__).with_name("messages.toml")
    findings = tomllib.loads(file.read_text("utf-8"))
    remedies = findings.pop("remedies")
    return {
        "findings": {code: Message(**words) for code, words in findings.items()},
        "remedies": {code: Message(**words) for code, words in remedies.items()},
    }


def messages() -> dict[str, Message]:
    """The words of findings, by code."""
    return _tables()["findings"]


def message_of(code: str) -> Message:
    """The words of a code. Raises `InputError` for one that is not known."""
    message_by_code = messages()
    if code not in message_by_code:
        near = get_close_matches(code, message_by_code, 3, 0.5)
        expected = "`curlfit explain` lists the codes"
        if near:
            expected = f"did you mean {join_words(near, 'or')}?"
        raise InputError(f"no finding {quoted(code)}; {expected}")
    return message_by_code[code]


def sentence(
    code: str,
    numbers: Mapping[str, Any],
    remedies: Iterable[str] = (),
    about: Sequence[str] = (),
) -> str:
    """A finding as a sentence without a full stop: throws that it is about, what was
    found, and the clauses of its remedies. Raises `KeyError` or `ValueError` for a code
    that is not known or other numbers than its words name."""
    words = "; ".join([messages()[code].filled(numbers), *remedies])
    if not about:
        return words
    names = list(about)
    if len(names) > _MOST_NAMED:
        names = [*names[:2], f"{len(names) - 2} more"]
    return f"{join_words(names)}: {words}"


def clause(code: str, numbers: Mapping[str, Any]) -> str:
    """A remedy as a clause."""
    return _tables()["remedies"][code].filled(numbers)
