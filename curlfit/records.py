"""Results as records: frozen dataclasses in JSON, written and read by one rule.

What is written follows from the fields of a record, and what is read is checked against
their types: a file that somebody else made is a record of these types, or is refused.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass
from enum import StrEnum
from functools import cache, partial
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    NotRequired,
    Self,
    TypedDict,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from curlfit.errors import DataError
from curlfit.findings import Finding, Level
from curlfit.foreign import cut, quoted
from curlfit.numerics.arrays import Floats
from curlfit.output.display import Displayed
from curlfit.output.files import atomic_write

SCHEMA = 1
"""The version mark of records."""
_LARGEST, _MOST_PARTS = 32_000_000, 1_000_000  # bytes; lists and objects

AGAIN = "fit again"
"""What to do about a record that cannot be used."""

UNSAVED = {"saved": False}
"""Metadata of a field that is not in the file."""
ADDED = {"needed": False}
"""Metadata of a field that files of earlier versions lack."""
SERIES = {"series": True}
"""Metadata of a field that a summary leaves out."""

_LEVELS = {"warnings": Level.WARNING, "notes": Level.NOTE}
"""Keys of findings, which are sentences in a file; beside them stands the key
`findings`, with the code, numbers and remedies of each."""


class Axes(int):
    """The number of axes of an array, as an annotation; 0 for one or two."""


def keys(every: bool = True, /, **kinds: Any) -> Any:
    """The keys of an object and their types, as an annotation; `every` one is needed,
    except those that are `NotRequired`."""
    return TypedDict("keys", kinds, total=every)  # type: ignore[operator]


_Keys = type(keys())


class Names(tuple[str, ...]):
    """The keys that an object has, if it has any, as an annotation."""


class Choice(tuple[str, ...]):
    """The admissible values of a text, as an annotation."""


class Kinds(tuple[type, ...]):
    """The types that an object may have, as an annotation: its entry "kind" is the
    default of this field of its type."""


Matrix = Annotated[Floats, Axes(2)]
Arrays = dict[str, Annotated[Floats, Axes(0)]]


class Record(Displayed):
    """Base of all results: `save` writes one as JSON, `read` reads it.

    Class attributes: `kind`, the name of its file; `marks`, entries that tell it
    from others of this kind; `written_together`, fields that are written as one
    object, by its name.
    """

    kind: ClassVar[str] = ""
    marks: ClassVar[dict[str, str]] = {}
    written_together: ClassVar[dict[str, tuple[str, ...]]] = {}

    def to_json(self) -> dict[str, Any]:
        """The record as it is written; NaN is null, and infinities are text."""
        found: dict[str, Any] = plain(self)
        return found

    def summary(self) -> dict[str, Any]:
        """The same without its series."""
        found: dict[str, Any] = plain(self, series=False)
        return found

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))

    @classmethod
    def from_json(cls, entries: Mapping[str, Any]) -> Self:
        """The record from the output of `to_json`. Raises `DataError` for
        anything else."""
        return structured(entries, cls)

    @classmethod
    def read(cls, file: str | PathLike[str]) -> Self:
        """Read a saved record, or the one in a folder.

        Raises
        ------
        DataError : missing, too large, not a record of this kind, or of
            another version.
        """
        path = Path(file)
        if path.is_dir():
            path = path / f"{cls.kind}.json"
        entries = read_json(path, f"a {cls.kind}.json of curlfit")
        version = entries.get("schema")
        if type(version) is not int:
            raise DataError(
                f"not a {cls.kind}.json of curlfit: it names no schema", file=path
            )
        if version != SCHEMA:
            newer = "a newer" if version > SCHEMA else "no"
            raise DataError(
                f"written by {newer} curlfit: schema {version} found, "
                f"this version reads up to {SCHEMA}",
                file=path,
            )
        try:
            return cls._from_file(entries, path.parent)
        except DataError as error:
            if error.file is not None:  # another one
                raise
            raise DataError(str(error), file=path) from None

    @classmethod
    def _from_file(cls, entries: dict[str, Any], folder: Path) -> Self:
        """The record of a file in a folder."""
        return cls.from_json(entries)

    def require_consistent(self) -> None:
        """Raise `ValueError` where fields of a record that was read contradict
        one another."""


def plain(value: Any, *, series: bool = True) -> Any:
    """A value as JSON has it: records as objects, arrays as lists, NaN as null,
    infinities as text.

    `series` is False for records without their series.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(float(value))
    if isinstance(value, Finding):
        return str(value)
    if isinstance(value, Mapping):
        found = {key: plain(item, series=series) for key, item in value.items()}
        return found | _findings_of(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item, series=series) for item in value]
    if isinstance(value, StrEnum):
        return value.value
    if not is_dataclass(value):
        return value
    names = [
        item.name
        for item in saved_fields(type(value))
        if series or "series" not in item.metadata
    ]
    names += getattr(value, "written", ())
    found = {name: plain(getattr(value, name), series=series) for name in names}
    found |= _findings_of({name: getattr(value, name) for name in names})
    if isinstance(value, Record):
        group_of = {
            name: group
            for group, inside in value.written_together.items()
            for name in inside
        }
        whole: dict[str, Any] = {"schema": SCHEMA, **value.marks}
        for name, item in found.items():
            (whole.setdefault(group_of[name], {}) if name in group_of else whole)[
                name
            ] = item
        return whole
    return found


def _findings_of(entries: Mapping[str, Any]) -> dict[str, Any]:
    """The key `findings` of an object that has warnings or notes."""
    findings = [finding for key in _LEVELS for finding in entries.get(key) or ()]
    has_key = any(key in entries for key in _LEVELS)
    if not has_key or not all(isinstance(item, Finding) for item in findings):
        return {}
    names = [item.name for item in fields(Finding)]
    return {
        "findings": [
            {name: plain(getattr(finding, name)) for name in names}
            for finding in findings
        ]
    }


def saved_fields(kind: Any) -> list[Field[Any]]:
    """The fields of a dataclass that are in its file."""
    return [item for item in fields(kind) if item.metadata.get("saved", True)]


def structured(value: Any, kind: Any) -> Any:
    """A value of JSON as a type: a dataclass, a TypedDict, or lists and
    dictionaries of them.

    Raises
    ------
    DataError : it is not of this type; the message begins with its place, such as
        "parameters.mu1_xi.value".
    """
    try:
        return _converter().structure(value, kind)
    except (BaseExceptionGroup, ValueError) as error:
        *place, because = _first(error)
        groups = getattr(kind, "written_together", {})
        place[:0] = [
            group for group, inside in groups.items() if place and place[0] in inside
        ]
        where = f"{'.'.join(place)}: " if place else ""
        raise DataError(
            f"{where}{because}; damaged, or written by an earlier version: {AGAIN}"
        ) from None


def _first(error: BaseException) -> list[str]:
    """The keys that lead to the first error, and what it is."""
    if not isinstance(error, BaseExceptionGroup):
        return [str(error)]
    first = error.exceptions[0]
    notes = getattr(first, "__notes__", ())
    keys = [getattr(note, "name", getattr(note, "index", None)) for note in notes]
    return [*(cut(str(key)) for key in keys if key is not None), *_first(first)]


def unexpected(value: Any, what: str) -> ValueError:
    """The error for a value that is something else than `what`."""
    kinds = {
        dict: "an object",
        list: "a list",
        type(None): "null",
        bool: str(value).lower(),
    }
    return ValueError(
        f"{kinds.get(type(value)) or quoted(value)} found, expected {what}"
    )


def _exactly(kind: Any, what: str) -> Callable[[Any, Any], Any]:
    def hook(value: Any, _: Any) -> Any:
        if type(value) is not kind or (kind is int and abs(value) > _HUGE):
            raise unexpected(value, what)
        return value

    return hook


def _number(value: Any, _: Any = None) -> float:
    if value is None:
        return math.nan
    if isinstance(value, str) and value in ("inf", "-inf"):
        return float(value)
    if type(value) not in (int, float) or not abs(value) < _HUGE:
        raise unexpected(value, "a number")
    return float(value)


def _array(value: Any, kind: Any) -> Floats:
    axes = next((int(item) for item in get_args(kind) if isinstance(item, Axes)), 1)

    def numbers(items: Any, axes: int) -> Any:
        if type(items) is not list:
            raise unexpected(items, "a list of numbers")
        deeper = axes > 1 or (axes == 0 and items and isinstance(items[0], list))
        return [
            numbers(item, axes - 1 if axes else 1) if deeper else _number(item)
            for item in items
        ]

    lists = numbers(value, axes)
    if len({len(row) if isinstance(row, list) else 0 for row in lists}) > 1:
        raise ValueError("lists of unequal length found, expected a table of numbers")
    found = np.array(lists, float)
    return found if axes != 2 or lists else found.reshape(0, 2)


def _chosen(value: Any, kind: Any) -> Any:
    choices: tuple[str, ...] = next(
        item for item in get_args(kind) if isinstance(item, Choice)
    )
    if not isinstance(value, str) or value not in choices:
        raise unexpected(value, f"one of {', '.join(choices)}")
    return value


def _of_kind(made: Any, kind: Any) -> Any:
    """The hook of an object that says of which type it is."""
    kinds = next(item for item in get_args(kind) if isinstance(item, Kinds))
    type_by_name = {of_kind.kind: of_kind for of_kind in kinds}  # type: ignore[attr-defined]

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not dict:
            raise unexpected(value, "an object")
        name = value.get("kind")
        if not isinstance(name, str) or name not in type_by_name:
            raise unexpected(name, f"a kind, one of {', '.join(type_by_name)}")
        return made.structure(value, type_by_name[name])

    return hook


def _member(value: Any, kind: type[StrEnum]) -> StrEnum:
    try:
        return kind(value)
    except ValueError:
        raise unexpected(value, f"one of {', '.join(kind)}") from None


def require(place: str, holds: bool, what: str) -> None:
    """Raise `ValueError` unless fields of a record agree."""
    if not holds:
        raise ValueError(f"{place}: expected {what}")


def require_rows(
    place: str, series: Mapping[str, Sequence[Any] | Floats], rows: int
) -> None:
    """Raise `ValueError` unless all series have as many values."""
    same = all(len(values) == rows for values in series.values())
    require(place, same, f"series of {rows} values each")


@cache
def _converter() -> Any:
    """The converter from JSON; imported only where a record is read."""
    from cattrs import Converter
    from cattrs.gen import make_mapping_structure_fn

    made = Converter()
    made.register_structure_hook(float, _number)
    for kind, what in ((int, "a whole number"), (bool, "true or false"), (str, "text")):
        made.register_structure_hook(kind, _exactly(kind, what))

    def is_a(origins: tuple[Any, ...], kind: Any) -> bool:
        return get_origin(kind) in origins

    def holds(annotation: type, kind: Any) -> bool:
        return any(isinstance(item, annotation) for item in get_args(kind))

    for annotation, read in ((Choice, _chosen), (Axes, _array)):
        made.register_structure_hook_factory(
            partial(holds, annotation),
            lambda kind, read=read: lambda value, _: read(value, kind),
        )
    made.register_structure_hook_func(partial(is_a, (np.ndarray,)), _array)
    made.register_structure_hook(StrEnum, _member)
    made.register_structure_hook_factory(
        partial(holds, _Keys), lambda kind: made.get_structure_hook(get_args(kind)[1])
    )

    made.register_structure_hook_factory(
        partial(holds, Names), partial(_of_names, made)
    )
    made.register_structure_hook_factory(partial(holds, Kinds), partial(_of_kind, made))

    @made.register_structure_hook_factory(partial(is_a, (Union, UnionType)))
    def of_optional(kind: Any) -> Any:
        (other,) = set(get_args(kind)) - {type(None)}
        # found when it is called, since a record may have another of its kind
        return lambda value, _: None if value is None else made.structure(value, other)

    # cattrs takes whatever can be iterated over, defaults for what is missing, and
    # no annotations.
    inside: list[Any] = []

    def is_list(kind: Any) -> bool:
        return is_a((list, tuple, dict), kind) and kind not in inside

    @made.register_structure_hook_factory(is_list)
    def of_list(kind: Any) -> Any:
        if get_origin(kind) is dict:
            wanted: type = dict
            what = "an object"
            # not by the converter, which would prefer its own hook from then on
            usual: Any = make_mapping_structure_fn(kind, made)
        else:
            wanted = list
            what = "a list"
            inside.append(kind)
            usual = made.get_structure_hook(kind, cache_result=False)
            inside.remove(kind)

        def hook(value: Any, _: Any) -> Any:
            if type(value) is not wanted:
                raise unexpected(value, what)
            return usual(value, kind)

        return hook

    made.register_structure_hook_factory(
        lambda kind: is_dataclass(kind) or is_typeddict(kind), partial(_of_object, made)
    )
    return made


def _of_names(made: Any, kind: Any) -> Any:
    """The hook of an object with all of its names, or with none."""
    usual, names = (made.get_structure_hook(get_args(kind)[0]), get_args(kind)[1])

    def hook(value: Any, _: Any) -> Any:
        found = usual(value, kind)
        missing = [name for name in names if name not in found]
        if found and missing:
            raise ValueError(f"no {missing[0]!r} in it")
        return found

    return hook


def _of_object(made: Any, kind: Any) -> Any:
    """The hook of a dataclass or a TypedDict."""
    from cattrs.gen import make_dict_structure_fn, override
    from cattrs.gen.typeddicts import make_dict_structure_fn as of_keys

    hints = {
        name: get_args(hint)[0] if get_origin(hint) is NotRequired else hint
        for name, hint in get_type_hints(kind, include_extras=True).items()
    }
    make: Any = make_dict_structure_fn
    if is_dataclass(kind):
        saved = saved_fields(kind)
        required = [item.name for item in saved if item.metadata.get("needed", True)]
        known = {item.name: item in saved for item in fields(kind)}
    else:
        make, required, known = (
            of_keys,
            sorted(kind.__required_keys__),
            dict.fromkeys(hints, True),
        )
    overrides = {
        name: override(struct_hook=made.get_structure_hook(hints[name]), omit=not read)
        for name, read in known.items()
    }
    of_findings = [key for key in _LEVELS if Finding in get_args(hints.get(key))]
    for key in of_findings:
        overrides[key] = override(struct_hook=_findings_at(_LEVELS[key]))
    usual, groups = make(kind, made, **overrides), getattr(kind, "written_together", {})

    def hook(value: Any, _: Any) -> Any:
        if type(value) is not dict:
            raise unexpected(value, "an object")
        for name in groups:
            if type(value.get(name)) is not dict:
                raise ValueError(f"no object {name!r} in it")
            value = value | value[name]
        missing = [name for name in required if name not in value]
        if missing:
            raise ValueError(f"no {missing[0]!r} in it")
        found = usual(_with_codes(value, of_findings), kind)
        if isinstance(found, Record):
            found.require_consistent()
        return found

    return hook


def _with_codes(value: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """An object of a file with pairs in place of the sentences of some keys: a sentence
    and the object that has its code, or None in files of earlier versions."""
    sentences = {key: value[key] for key in keys if type(value.get(key)) is list}
    if not sentences:
        return value
    count = sum(map(len, sentences.values()))
    codes = value.get("findings", [None] * count)
    if type(codes) is not list or len(codes) != count:
        raise ValueError("findings are not those of its warnings and notes")
    remaining = iter(codes)
    pairs = {
        key: [(sentence, next(remaining)) for sentence in of_key]
        for key, of_key in sentences.items()
    }
    return value | pairs


def _findings_at(level: Level) -> Callable[[Any, Any], tuple[Finding, ...]]:
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


_HUGE = 1e100
"""No quantity of curling is larger; the squares of smaller ones are finite."""


def read_json(file: Path, what: str) -> dict[str, Any]:
    """The JSON object in a file, of at most as many bytes as a record can have.

    Raises
    ------
    DataError : the file does not exist, is too large, or is not such JSON.
    """
    try:
        small = file.stat().st_size <= _LARGEST
        text = file.read_text(encoding="utf-8") if small else ""
        small = small and text.count("[") + text.count("{") <= _MOST_PARTS
        found = json.loads(text, parse_constant=_refuse) if small else None
    except FileNotFoundError:
        raise DataError("no such file", file=file) from None
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", file=file) from None
    except (ValueError, RecursionError):
        raise DataError(f"this is not JSON; expected {what}", file=file) from None
    if not small:
        raise DataError(f"larger than {what} can be", file=file)
    if type(found) is not dict:
        raise DataError(f"not {what}", file=file)
    return found


def _refuse(constant: str) -> None:
    raise ValueError(constant)


def write_json(record: dict[str, Any], file: Path) -> None:
    """Write plain values atomically, as JSON that any program can read."""
    text = json.dumps(record, indent=1, allow_nan=False)
    atomic_write(file, _compact_series(text) + "\n")


def _compact_series(text: str) -> str:
    """JSON with each list of numbers on one line, which keeps the rest readable."""
    number = r"(?:-?\d[-+.eE\d]*|null)"
    return re.sub(
        rf"\[\s+({number}(?:,\s+{number})*)\s+\]",
        lambda match: "[" + re.sub(r",\s+", ", ", match[1]) + "]",
        text,
    )
