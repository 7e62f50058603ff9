"""curlfit's own format: a text table with a header, and settings in leading `#` lines."""

from __future__ import annotations

import tomllib
from bisect import bisect_left
from collections.abc import Iterable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from curlfit.errors import DataError, InputError
from curlfit.foreign import quoted
from curlfit.friction import find_law
from curlfit.settings.choices import SEED, Modelling, Reading
from curlfit.stone import Stone
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.columns import in_unit
from curlfit.throws.readers.parsed_file import (
    FilePart,
    Format,
    ParsedFile,
    ReadOptions,
    columns_of,
    in_si,
)
from curlfit.throws.readers.several import may_name_throws, selected, throws_in
from curlfit.throws.readers.text import (
    EXPECTED,
    cells,
    clocks_as_seconds,
    header_cells,
    is_number,
    read_rows,
    separator_of,
)
from curlfit.throws.throw import Reference

_SETTINGS = (
    "since", "until", "exclude", "swept", "law", "load", "stone", "sigma", "seed", "reference",
    "axes", "as_given",
)  # fmt: skip
_MOST_SETTINGS, _MOST_NOTES = 500, 5


_FORMS = {**Modelling.forms(), **Reading.forms(), "seed": SEED}


def first_lines(path: Path, lines: list[str]) -> tuple[int, list[tuple[int, str]]]:
    """Index of the first line that is not a comment, and the comments before it, numbered.

    Raises
    ------
    DataError : the file is empty or contains only comments.
    """
    comments: list[tuple[int, str]] = []
    for index, line in enumerate(lines):
        if not line or line.isspace():
            continue
        if not line.lstrip().startswith("#"):
            return index, comments
        comments.append((index + 1, line))
    what = "the file holds comments only" if comments else "the file is empty"
    raise DataError(f"{what}; {EXPECTED}", file=path)


def read_table(path: Path, lines: list[str], options: ReadOptions) -> ParsedFile:
    """Columns of one throw of a text table.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected; the table contains
        several throws and none is selected.
    InputError : there is no such throw.
    """
    return selected(_throws(path, lines, options), options.stone_index, "--stone-index")


def _parts(path: Path, lines: list[str], options: ReadOptions) -> list[FilePart]:
    """Every throw."""
    throws = _throws(path, lines, options)
    if options.stone_index is not None or len(throws) == 1:
        number = options.stone_index
        return [FilePart(None, number, partial(selected, throws, number, "--stone-index"))]
    return [
        FilePart(None, number, partial(selected, throws, number, "--stone-index"))
        for number in range(1, len(throws) + 1)
    ]


def _throws(path: Path, lines: list[str], options: ReadOptions) -> list[tuple[str, ParsedFile]]:
    header, comments = first_lines(path, lines)
    settings, reference, notes = defaults_of(path, comments)
    separator = separator_of(lines[header])
    names = header_cells(lines[header], separator)
    if all(is_number(cell) for cell in cells(lines[header], separator)):
        raise DataError(f"the table begins with numbers; {EXPECTED}", file=path, line=header + 1)
    columns, ignored = columns_of(
        path, names, options.units, line=header + 1, pixels=options.pixels
    )
    times = [index for index, column in columns.items() if column.quantity.startswith("t")]
    rows, clocks = clocks_as_seconds(lines, header + 1, times, separator)
    for index, begin in clocks.items():
        columns[index] = in_unit(columns[index].quantity, "s")
        notes.append(f"{names[index]}: clock times, taken as seconds since {begin}")
    numbers, values = read_rows(path, rows, header + 1, names, list(columns), separator)
    if not len(numbers):
        raise DataError("a header but no rows of numbers", file=path, line=header + 1)
    parsed = ParsedFile(path, "table", [], ignored, settings, reference, notes=notes, lines=numbers)
    parsed.series = [
        in_si(parsed, names[index], column, values[row])
        for row, (index, column) in enumerate(columns.items())
    ]
    others = {
        names[k]: k for k in range(len(names)) if k not in columns and may_name_throws(names[k])
    }
    words: dict[str, list[str]] = {}
    if others:
        split = [cells(lines[number - 1], separator) for number in numbers.tolist()]
        words = {name: [row[k] for row in split] for name, k in others.items()}
    return throws_in(parsed, words)


TABLE = Format("table", lambda _: True, read_table, _parts, ("stone_index",))


def defaults_of(
    path: Path, comments: Iterable[tuple[int, str]]
) -> tuple[dict[str, Any], Reference | None, list[str]]:
    """Settings, a reference and notes from comments with their line numbers.

    Comments that are not `key = value` are skipped.

    Raises
    ------
    DataError : a setting that cannot be read or used.
    """
    numbers: list[int] = []
    bodies: list[str] = []
    notes: list[str] = []
    unknown = 0
    for number, line in comments:
        body = line.lstrip().lstrip("#").strip()
        key = body.split("=", 1)[0].strip().split(".")[0]
        if "=" not in body or not key.isidentifier():
            continue
        if key not in _SETTINGS:
            unknown += 1
            if unknown <= _MOST_NOTES:
                notes.append(f"line {number}: setting {quoted(key)} is not known and was ignored")
            continue
        if len(bodies) == _MOST_SETTINGS:
            raise DataError(
                f"more than {_MOST_SETTINGS} settings; expected those of one throw",
                file=path,
                line=number,
            )
        numbers.append(number)
        bodies.append(body)
    if unknown > _MOST_NOTES:
        notes.append(f"{unknown - _MOST_NOTES} more settings are not known and were ignored")
    try:
        common = _settings(tuple(bodies))
    except (ValueError, RecursionError, InputError):
        _raise_at_fault(path, numbers, bodies)
    # A copy: the cached settings are shared by all files with the same comments.
    settings = {k: dict(v) if isinstance(v, dict) else v for k, v in common.items()}
    reference = settings.pop("reference", None)
    return settings, None if reference is None else _reference(path, reference), notes


@lru_cache(64)
def _settings(bodies: tuple[str, ...]) -> dict[str, Any]:
    """The settings in some lines, each of them valid TOML."""
    text = "\n".join(bodies)
    if any(mark in text for mark in ("[", '"""', "'''")):  # values that may extend over lines
        for body in bodies:
            tomllib.loads(body)
    found = tomllib.loads(text)
    _check(found)
    return found


def _raise_at_fault(path: Path, numbers: list[int], bodies: list[str]) -> None:
    """Raise `DataError` with the first line that makes the settings unusable."""

    def fault(count: int) -> str:
        """What is wrong with the first lines; more lines mend nothing."""
        try:
            _settings(tuple(bodies[:count]))
        except InputError as error:
            return str(error)
        except (ValueError, RecursionError):
            return (
                f"cannot read the setting {quoted(bodies[count - 1])}; expected key = value as in "
                "TOML, text in quotes, each key once"
            )
        return ""

    last = 1 + bisect_left(range(1, len(bodies)), True, key=lambda count: bool(fault(count)))
    raise DataError(fault(last), file=path, line=numbers[last - 1])


def _check(settings: dict[str, Any]) -> None:
    """Raise `InputError` for settings that cannot be used."""
    for name, value in settings.items():
        if name in _FORMS and name != "reference":  # there, values to compare with
            _FORMS[name].checked(name, value)
    Stone().with_values(settings.get("stone", {}))
    if "law" in settings:
        find_law(settings["law"], from_files=False)
    parse_axes(settings.get("axes"))


def _reference(path: Path, found: Any) -> Reference:
    try:
        return Reference(
            source=str(found.get("source", "reference")),
            law=str(found["law"]),
            values={str(name): float(value) for name, value in found["values"].items()},
            note=str(found.get("note", "")),
            **{key: _stone_constants(found.get(key, {})) for key in ("stone", "rounding")},
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise DataError(
            'a reference needs reference.law = "NAME" and reference.values.NAME = number, and may '
            "have reference.stone.NAME and reference.rounding.NAME, NAME being R, rho, h or m",
            file=path,
        ) from None


def _stone_constants(found: dict[str, Any]) -> dict[str, float]:
    Stone().with_values(found)  # checks names and signs
    return {str(name): float(value) for name, value in found.items()}
