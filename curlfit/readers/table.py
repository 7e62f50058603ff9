"""curlfit's own format: a table of text with a header, and settings in leading `#` lines."""

from __future__ import annotations

import csv
import math
import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.friction import check_load, find_law
from curlfit.readers.columns import Column, understand
from curlfit.stone import Stone
from curlfit.throw import CHANNELS, Floats, Reference, Throw

_GAPS = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
_SETTINGS = ("until", "law", "load", "stone", "sigma", "reference")
_EXPECTED = "expected a header such as t,x,y,phi (time in s, position in m, angle in rad)"


def load_throw(file: str | PathLike[str]) -> Throw:
    """Read a throw from a text table.

    The table has a header and one row a time. Columns `t`, `x`, `y` are needed; `phi` and
    `sigma_x`, `sigma_y`, `sigma_phi` may be there. Common names and units are understood (`time`,
    `y_ft`, `angle [deg]`, `phi_rev`). Commas, semicolons, tabs or spaces separate; decimal commas
    are read where something else separates. Empty cells are gaps. Leading lines `# key = value`
    are this throw's defaults.

    Raises
    ------
    DataError : naming the file, line and column of the fault, and what was expected.
    """
    path = Path(file)
    numbered = [
        (number, line) for number, line in enumerate(_text(path).split("\n"), 1) if line.strip()
    ]
    if not numbered:
        raise DataError(f"the file is empty; {_EXPECTED}", file=path)
    comments = [(number, line) for number, line in numbered if line.lstrip().startswith("#")]
    table = [(number, line) for number, line in numbered if not line.lstrip().startswith("#")]
    if not table:
        raise DataError(f"the file holds comments only; {_EXPECTED}", file=path)

    header_line, header = table[0]
    settings, notes = _settings(path, [c for c in comments if c[0] < header_line])
    separator = next((mark for mark in ("\t", ";", ",") if mark in header), None)
    names = _cells(header, separator)
    if all(_number(name, decimal_comma=False) is not None for name in names):
        raise DataError(f"the table begins with numbers; {_EXPECTED}", file=path, line=header_line)
    columns, ignored = _columns(path, header_line, names)
    if ignored:
        notes.append(f"columns ignored: {', '.join(ignored)}")
    if len(table) == 1:
        raise DataError("a header but no rows of numbers", file=path, line=header_line)

    lines, values = _rows(path, table[1:], names, columns, separator)
    found = {column.quantity: values[place] for place, column in enumerate(columns.values())}
    for column in columns.values():
        if column.factor != 1:
            notes.append(f"{column.quantity} converted from {column.unit}")
    t = found["t"]
    reference = settings.pop("reference", None)
    throw = Throw.from_arrays(
        t,
        **{name: found.get(name) for name in CHANNELS},
        sigma={c: found[f"sigma_{c}"] for c in CHANNELS if f"sigma_{c}" in found},
        name=str(path),
        reference=None if reference is None else _reference(path, reference),
        defaults=settings,
        notes=tuple(notes),
        lines=np.asarray(lines),
    )
    for channel in CHANNELS:
        if channel in found and not np.isfinite(found[channel]).any():
            raise DataError("every value is empty or NaN", file=path, column=channel)
    return throw


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise DataError("no such file", file=path) from None
    except IsADirectoryError:
        raise DataError("this is a folder, expected a file", file=path) from None
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", file=path) from None
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    if "\x00" in text:
        raise DataError(f"this is not a text file; {_EXPECTED}", file=path)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _settings(path: Path, comments: list[tuple[int, str]]) -> tuple[dict[str, Any], list[str]]:
    """Settings from `# key = value` lines; other comments are comments."""
    kept: list[str] = []
    notes: list[str] = []
    for number, line in comments:
        body = line.lstrip().lstrip("#").strip()
        key = body.split("=", 1)[0].strip().split(".")[0]
        if "=" not in body or not key.isidentifier():
            continue
        if key not in _SETTINGS:
            notes.append(f"line {number}: setting {key!r} is not known and was ignored")
            continue
        try:
            tomllib.loads(body)
            tomllib.loads("\n".join([*kept, body]))
        except tomllib.TOMLDecodeError:
            raise DataError(
                f"cannot read the setting {body!r}; expected key = value as in TOML, "
                "text in quotes, each key once",
                file=path,
                line=number,
            ) from None
        kept.append(body)
        found = tomllib.loads("\n".join(kept))
        try:
            _check(found)
        except InputError as error:
            raise DataError(str(error), file=path, line=number) from None
    return tomllib.loads("\n".join(kept)), notes


def _check(settings: dict[str, Any]) -> None:
    """Refuse settings that no fit could use, while the line is still known."""
    for key, expected in (("stone", dict), ("sigma", dict), ("law", str), ("load", str)):
        if not isinstance(settings.get(key, expected()), expected):
            raise InputError(f"{key} = {settings[key]!r} cannot be used")
    numbers = {f"stone.{name}": value for name, value in settings.get("stone", {}).items()}
    numbers |= {f"sigma.{name}": value for name, value in settings.get("sigma", {}).items()}
    numbers |= {"until": settings["until"]} if "until" in settings else {}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise InputError(f"{key} = {value!r}: expected a number")
    Stone().with_values(settings.get("stone", {}))
    if "law" in settings:
        find_law(settings["law"], from_files=False)
    if "load" in settings:
        check_load(settings["load"])


def _reference(path: Path, found: Any) -> Reference:
    try:
        return Reference(
            source=str(found.get("source", "reference")),
            law=str(found["law"]),
            values={str(name): float(value) for name, value in found["values"].items()},
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        raise DataError(
            'a reference needs reference.law = "NAME" and reference.values.NAME = number',
            file=path,
        ) from None


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return [cell.strip() for cell in line.split(separator)]


def _number(cell: str, *, decimal_comma: bool) -> float | None:
    text = cell.replace(",", ".") if decimal_comma and "." not in cell else cell
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _columns(path: Path, line: int, names: list[str]) -> tuple[dict[int, Column], list[str]]:
    """Columns to read by their place, and the names of the others."""
    columns: dict[int, Column] = {}
    ignored = []
    taken: dict[str, str] = {}
    for place, name in enumerate(names):
        column = understand(name)
        if column is None:
            if name:
                ignored.append(name)
            continue
        if column.quantity in taken:
            raise DataError(
                f"columns {taken[column.quantity]!r} and {name!r} both mean {column.quantity}; "
                "rename or remove one",
                file=path,
                line=line,
            )
        taken[column.quantity] = name
        columns[place] = column
    missing = [name for name in ("t", "x", "y") if name not in taken]
    if missing == ["x", "y"] and taken.keys() & {"phi", "speed", "omega"}:
        missing = []  # a gyroscope or a radar alone
    if missing:
        raise DataError(
            f"no column for {' and '.join(missing)} among {', '.join(names)}; {_EXPECTED}",
            file=path,
            line=line,
        )
    return columns, ignored


def _rows(
    path: Path,
    rows: list[tuple[int, str]],
    names: list[str],
    columns: dict[int, Column],
    separator: str | None,
) -> tuple[list[int], list[Floats]]:
    decimal_comma = separator != "," and any("," in line for _, line in rows)
    lines: list[int] = []
    values: list[list[float]] = [[] for _ in columns]
    for number, line in rows:
        cells = _cells(line, separator)
        if len(cells) > len(names) and not any(cells[len(names) :]):
            cells = cells[: len(names)]
        if len(cells) != len(names):
            hint = (
                "; where numbers have decimal commas, separate the columns by semicolons"
                if separator == "," and len(names) < len(cells) <= 2 * len(names)
                else ""
            )
            raise DataError(
                f"{len(cells)} cells where the header has {len(names)} columns{hint}",
                file=path,
                line=number,
            )
        lines.append(number)
        for slot, (place, column) in enumerate(columns.items()):
            cell = cells[place]
            if cell.lower() in _GAPS:
                if column.quantity == "t":
                    raise DataError(
                        "the time is missing; each row needs one",
                        file=path,
                        line=number,
                        column=names[place],
                    )
                values[slot].append(math.nan)
                continue
            value = _number(cell, decimal_comma=decimal_comma)
            if value is None or not math.isfinite(value):
                raise DataError(
                    f"{cell!r} found, expected a finite number",
                    file=path,
                    line=number,
                    column=names[place],
                )
            values[slot].append(value * column.factor)
    return lines, [np.asarray(column) for column in values]
