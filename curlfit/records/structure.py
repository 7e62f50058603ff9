"""Reading plain values as types: each value of a file is checked against the type of
its field, by hooks of cattrs.

cattrs by itself takes whatever can be iterated over for a list, defaults for what is
missing, and no annotations; the hooks here are stricter. cattrs is imported only where
a record is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from enum import StrEnum
from functools import cache, partial
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from curlfit.errors import DataError
from curlfit.findings import Finding, Level
from curlfit.foreign import cut, quoted
from curlfit.numerics.arrays import Floats
from curlfit.records.annotations import Axes, Kinds, Names, OneOf
from curlfit.records.fields import LEVELS, key_of, saved_fields

AGAIN = "fit again"
"""What to do about a record that cannot be used."""

_HUGE = 1e100
"""No quantity of curling is larger; the squares of smaller ones are finite."""

Hook = Callable[[Any, Any], Any]
"""Makes a value of JSON one of a type; the second argument is the type."""


def structured(value: Any, kind: Any) -> Any:
    """A value of JSON as a type: a dataclass, or lists and dictionaries of them.

    Raises
    ------
    DataError : it is not of this type; the message begins with its place, such as
        "parameters.mu1_xi.value".
    """
    try:
        return _converter().structure(value, kind)
    except (BaseExceptionGroup, ValueError) as error:
        *place, fault = _first(error)
        where = f"{'.'.join(place)}: " if place else ""
        raise DataError(
            f"{where}{fault}; damaged, or written by an earlier version: {AGAIN}"
        ) from None


def _first(error: BaseException) -> list[str]:
    """The keys that lead to the first error of a group, and what it is."""
    if not isinstance(error, BaseExceptionGroup):
        return [str(error)]
    first = error.exceptions[0]
    dataclass = getattr(error, "cl", None)  # the class that cattrs was reading
    key_by_name = {}
    if is_dataclass(dataclass):
        key_by_name = {field.name: key_of(field) for field in saved_fields(dataclass)}
    keys = []
    for note in getattr(first, "__notes__", ()):
        # of a field, or of an item of a list or dictionary
        name = getattr(note, "name", getattr(note, "index", None))
        if name is not None:
            keys.append(cut(str(key_by_name.get(name, name))))
    return [*keys, *_first(first)]


def unexpected(value: Any, what: str) -> ValueError:
    """The error for a value that is something else than `what`."""
    words = {
        dict: "an object",
        list: "a list",
        type(None): "null",
        bool: str(value).lower(),
    }
    in_words = words.get(type(value)) or quoted(value)
    return ValueError(f"{in_words} found, expected {what}")


@cache
def _converter() -> Any:
    """The converter from JSON. The hook that was registered last and takes a type reads
    values of it."""
    from cattrs import Converter

    converter = Converter()
    converter.register_structure_hook(float, _number)
    converter.register_structure_hook(int, _exactly(int, "a whole number"))
    converter.register_structure_hook(bool, _exactly(bool, "true or false"))
    converter.register_structure_hook(str, _exactly(str, "text"))
    converter.register_structure_hook(StrEnum, _member)
    factories: list[tuple[Callable[[Any], bool], Callable[[Any, Any], Hook]]] = [
        (_is_annotated_with(OneOf), _hook_of_text),
        (_is(Literal), _hook_of_text),
        (_is_annotated_with(Axes), _hook_of_array),
        (_is(np.ndarray), _hook_of_array),
        (_is_annotated_with(Names), _hook_of_names),
        (_is_annotated_with(Kinds), _hook_of_kinds),
        (_is(Union, UnionType), _hook_of_optional),
        (_is(dict), _hook_of_mapping),
        (is_dataclass, _hook_of_dataclass),
    ]
    for takes, factory in factories:
        converter.register_structure_hook_factory(takes, partial(factory, converter))
    _register_lists(converter)
    return converter


def _is(*origins: Any) -> Callable[[Any], bool]:
    """Whether a type is one of these with arguments, such as `dict[str, float]`."""
    return lambda kind: get_origin(kind) in origins


def _is_annotated_with(annotation: type) -> Callable[[Any], bool]:
    """Whether a type has an annotation, which stands among its arguments."""
    return lambda kind: any(
        isinstance(argument, annotation) for argument in get_args(kind)
    )


def _annotation(kind: Any, annotation: type) -> Any:
    """The annotation of a type."""
    arguments = get_args(kind)
    return next(argument for argument in arguments if isinstance(argument, annotation))


def _exactly(kind: Any, what: str) -> Hook:
    """The hook of a type of which the value is already."""

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not kind or (kind is int and abs(value) > _HUGE):
            raise unexpected(value, what)
        return value

    return hook


def _number(value: Any, _: Any = None) -> float:
    """A number, NaN of null, and infinities of text."""
    if value is None:
        return math.nan
    if isinstance(value, str) and value in ("inf", "-inf"):
        return float(value)
    if type(value) not in (int, float) or not abs(value) < _HUGE:
        raise unexpected(value, "a number")
    return float(value)


def _member(value: Any, kind: type[StrEnum]) -> StrEnum:
    """A member of an enumeration."""
    try:
        return kind(value)
    except ValueError:
        raise unexpected(value, f"one of {', '.join(kind)}") from None


def _hook_of_text(_: Any, kind: Any) -> Hook:
    """The hook of a text with several admissible values."""
    if get_origin(kind) is Literal:
        choices: tuple[str, ...] = get_args(kind)
    else:
        choices = _annotation(kind, OneOf)

    def hook(value: Any, _: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise unexpected(value, f"one of {', '.join(choices)}")
        return value

    return hook


def _hook_of_array(_: Any, kind: Any) -> Hook:
    """The hook of an array of numbers."""
    axes = Axes(1)
    if get_origin(kind) is not np.ndarray:
        axes = _annotation(kind, Axes)

    def hook(value: Any, _: Any) -> Floats:
        lists = _numbers(value, axes.number)
        lengths = {len(row) if isinstance(row, list) else 0 for row in lists}
        if len(lengths) > 1:
            fault = "lists of unequal length found, expected a table of numbers"
            raise ValueError(fault)
        array = np.array(lists, float)
        if axes.number == 2 and not lists:
            return array.reshape(0, axes.columns)
        return array

    return hook


def _numbers(value: Any, axes: int | None) -> list[Any]:
    """A list of numbers, or of such lists."""
    if type(value) is not list:
        raise unexpected(value, "a list of numbers")
    has_lists = axes == 2
    if axes is None:
        has_lists = bool(value) and isinstance(value[0], list)
    if has_lists:
        return [_numbers(row, 1) for row in value]
    return [_number(number) for number in value]


def _hook_of_names(converter: Any, kind: Any) -> Hook:
    """The hook of an object with all of its names, or with none."""
    of_object = converter.get_structure_hook(get_args(kind)[0])
    names = _annotation(kind, Names)

    def hook(value: Any, _: Any) -> Any:
        entries = of_object(value, kind)
        missing = [name for name in names if name not in entries]
        if entries and missing:
            raise ValueError(f"no {missing[0]!r} in it")
        return entries

    return hook


def _hook_of_kinds(converter: Any, kind: Any) -> Hook:
    """The hook of an object that says of which type it is."""
    kinds = _annotation(kind, Kinds)
    type_by_name = {of_kind.kind: of_kind for of_kind in kinds}

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not dict:
            raise unexpected(value, "an object")
        name = value.get("kind")
        if not isinstance(name, str) or name not in type_by_name:
            raise unexpected(name, f"a kind, one of {', '.join(type_by_name)}")
        return converter.structure(value, type_by_name[name])

    return hook


def _hook_of_optional(converter: Any, kind: Any) -> Hook:
    """The hook of a type or None."""
    (other,) = set(get_args(kind)) - {type(None)}
    # files of version 0.2 have {} where an object of several kinds is missing
    missing: tuple[Any, ...] = (
        (None, {}) if _is_annotated_with(Kinds)(other) else (None,)
    )

    def hook(value: Any, _: Any) -> Any:
        if value in missing:
            return None
        # sought when it is called, since a record may have another of its kind
        return converter.structure(value, other)

    return hook


def _hook_of_mapping(converter: Any, kind: Any) -> Hook:
    """The hook of an object with any keys."""
    from cattrs.gen import make_mapping_structure_fn

    # not by the converter, which would take its own hook from then on
    of_mapping: Any = make_mapping_structure_fn(kind, converter)

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not dict:
            raise unexpected(value, "an object")
        return of_mapping(value, kind)

    return hook


def _register_lists(converter: Any) -> None:
    """Register the hook of lists and tuples: that of cattrs, for lists alone."""
    being_made: list[Any] = []  # types for which the hook of cattrs is sought

    def takes(kind: Any) -> bool:
        return get_origin(kind) in (list, tuple) and kind not in being_made

    def factory(kind: Any) -> Hook:
        being_made.append(kind)
        of_cattrs = converter.get_structure_hook(kind, cache_result=False)
        being_made.remove(kind)

        def hook(value: Any, _: Any) -> Any:
            if type(value) is not list:
                raise unexpected(value, "a list")
            return of_cattrs(value, kind)

        return hook

    converter.register_structure_hook_factory(takes, factory)


def _hook_of_dataclass(converter: Any, kind: Any) -> Hook:
    """The hook of a dataclass: all keys of its fields are needed but those that files
    of earlier versions lack; further keys are ignored."""
    from cattrs.gen import make_dict_structure_fn, override

    hints = get_type_hints(kind, include_extras=True)
    saved = saved_fields(kind)
    needed = [key_of(field) for field in saved if field.metadata.get("needed", True)]
    level_by_key = {
        key: level
        for key, level in LEVELS.items()
        if Finding in get_args(hints.get(key))
    }
    overrides: Any = {}
    for field in kind.__dataclass_fields__.values():
        if field not in saved:
            overrides[field.name] = override(omit=True)
            continue
        if field.name in level_by_key:
            hook_of_field: Hook = _hook_of_findings(level_by_key[field.name])
        else:
            hook_of_field = converter.get_structure_hook(hints[field.name])
        overrides[field.name] = override(
            struct_hook=hook_of_field, rename=key_of(field)
        )
    of_dataclass: Any = make_dict_structure_fn(kind, converter, **overrides)

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not dict:
            raise unexpected(value, "an object")
        missing = [key for key in needed if key not in value]
        if missing:
            raise ValueError(f"no {missing[0]!r} in it")
        instance = of_dataclass(_with_codes(value, list(level_by_key)), kind)
        if hasattr(instance, "require_consistent"):  # a `Record`
            instance.require_consistent()
        return instance

    return hook


def _with_codes(entries: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """An object of a file with pairs in place of the sentences of some keys: a sentence
    and the object that has its code, or None in files of earlier versions."""
    sentences_by_key = {
        key: entries[key] for key in keys if type(entries.get(key)) is list
    }
    if not sentences_by_key:
        return entries
    count = sum(len(sentences) for sentences in sentences_by_key.values())
    codes = entries.get("findings", [None] * count)
    if type(codes) is not list or len(codes) != count:
        raise ValueError("findings are not those of its warnings and notes")
    remaining: Iterator[Any] = iter(codes)
    pairs_by_key = {
        key: [(sentence, next(remaining)) for sentence in sentences]
        for key, sentences in sentences_by_key.items()
    }
    return entries | pairs_by_key


def _hook_of_findings(level: Level) -> Hook:
    """The hook of findings, which are pairs of `_with_codes`; sentences without a code
    have the level."""

    def hook(pairs: Any, _: Any) -> tuple[Finding, ...]:
        if type(pairs) is not list:
            raise unexpected(pairs, "a list")
        return tuple(_finding(sentence, code, level) for sentence, code in pairs)

    return hook


def _finding(sentence: Any, code: Any, level: Level) -> Finding:
    """A finding from its sentence and the object that has its code; one of the sentence
    alone where this version does not know the code."""
    if type(sentence) is not str:
        raise unexpected(sentence, "text")
    if code is not None:
        finding: Finding = _converter().structure(code, Finding)
        if finding.has_words:
            return finding
    return Finding("text", level, {"text": sentence})
