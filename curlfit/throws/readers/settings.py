"""Settings of a throw, in the comments of its file or in a configuration file: their types."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from curlfit.errors import InputError
from curlfit.foreign import SIZES, is_number, is_size, quoted


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_pair(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(is_number(v, infinite=True) for v in value)
    )


def _is_whole(value: object, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


class _Kind(NamedTuple):
    """What a setting, or each entry of a table of settings, must be."""

    fits: Callable[[Any], bool]
    expected: str
    entries: bool = False


_TEXT = _Kind(_is_text, "a quoted string")
_TIME = _Kind(is_number, "a time in s")
_COUNT = _Kind(lambda value: _is_whole(value, 1, 10**9), "a whole number from 1")
_SWITCH = _Kind(lambda value: isinstance(value, bool), "true or false")
_NUMBERS = _Kind(
    lambda value: is_number(value) and is_size(value), f"a number, {SIZES}", entries=True
)


def _list_of(expected: str, fits: Callable[[Any], bool] = _is_text) -> _Kind:
    return _Kind(lambda value: isinstance(value, list) and all(map(fits, value)), expected)


_KINDS = {
    "law": _TEXT, "load": _TEXT, "loss": _TEXT, "format": _TEXT, "axes": _TEXT, "units": _TEXT,
    "reference": _TEXT,
    "noise": _Kind(
        lambda value: all(map(_is_text, value if isinstance(value, list) else [value])),
        "a quoted string, for `compare` also a list",
    ),
    "since": _TIME, "until": _TIME,
    "exclude": _list_of("[[A, B], ...], times in s", _is_pair),
    "swept": _Kind(_is_pair, "[A, B], times in s"),
    "stone": _NUMBERS, "sigma": _NUMBERS, "fix": _NUMBERS, "start": _NUMBERS,
    "systematic": _NUMBERS,
    "bound": _Kind(_is_pair, "[low, high]", entries=True),
    "prior": _Kind(_is_text, "a string such as '1+-0.1'", entries=True),
    "free": _list_of("a list of names"), "derive": _list_of("a list of strings"),
    "unbounded": _SWITCH, "as_given": _SWITCH,
    "stone_index": _COUNT, "shot": _COUNT, "handle": _COUNT,
    "seed": _Kind(
        lambda value: _is_whole(value, 0, 2**32 - 1), f"a whole number from 0 to {2**32 - 1}"
    ),
}  # fmt: skip
SETTINGS = tuple(_KINDS)
"""Names of all settings."""


def check_types(settings: Mapping[str, Any], besides: Collection[str] = ()) -> None:
    """Raise `InputError` for a setting of a wrong type, except those in `besides`."""
    for key, value in settings.items():
        kind = _KINDS.get(key)
        if kind is None or key in besides:
            continue
        found = {key: value}
        if kind.entries:
            if not isinstance(value, dict):
                raise InputError(f"{key} = {quoted(value)}; expected {key}.NAME = {kind.expected}")
            found = {f"{key}.{name}": entry for name, entry in value.items()}
        for name, entry in found.items():
            if not kind.fits(entry):
                raise InputError(f"{name} = {quoted(entry)}; expected {kind.expected}")
