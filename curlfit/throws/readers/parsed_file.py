"""The columns of a file, before clocks, pixels, unwrapping and axes are applied."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.foreign import LARGEST, quoted
from curlfit.numerics.arrays import Floats
from curlfit.throws.events import Event
from curlfit.throws.readers.columns import Column, parse_header, with_units
from curlfit.throws.readers.text import EXPECTED
from curlfit.throws.throw import Reference


class Series(NamedTuple):
    """One column of known quantity; `values` in SI (pixels for u and v), shape (n,)."""

    header: str
    column: Column
    values: Floats


@dataclass
class ParsedFile:
    """Columns of one file, in SI.

    Attributes
    ----------
    source : the file, or a name. format : name of its format.
    series : the columns, all of equal length.
    ignored : headers of unknown quantity.
    settings : defaults given in the file. notes : remarks of the reader.
    lines : line number of each row; None if there are none.
    events, assumed : as in `curlfit.throws.throw.Throw`; with events there are no columns.
    """

    source: Path | str
    format: str
    series: list[Series]
    ignored: list[str] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    reference: Reference | None = None
    notes: list[str] = field(default_factory=list)
    lines: np.ndarray | None = None
    events: list[Event] = field(default_factory=list)
    assumed: dict[str, float] = field(default_factory=dict)

    def error(self, message: str, row: int | None = None, quantity: str | None = None) -> DataError:
        """An error with its location in the file."""
        header = next((s.header for s in self.series if s.column.quantity == quantity), quantity)
        line = None if row is None or self.lines is None else int(self.lines[row])
        if row is not None and line is None:
            message = f"row {row}: {message}"
        return DataError(message, file=self.source, line=line, column=header)


class ReadOptions(NamedTuple):
    """How to read a file: units by column, whether positions are pixels, and which throw of it.

    `handle` is the object that marks another point of the stone.
    """

    units: Mapping[str, str]
    pixels: bool = False
    stone_index: int | None = None
    shot: int | None = None
    handle: int | None = None


class FilePart(NamedTuple):
    """One throw of a file: the options that select it, and a function that reads it."""

    shot: int | None
    stone_index: int | None
    parse: Callable[[], ParsedFile]


class Format(NamedTuple):
    """A format of data files.

    Attributes
    ----------
    name : as in `--format`.
    recognizes : whether a file is of this format, from its first lines without comments and blanks.
    parse : reads one throw.
    parts : every throw of a file; None if there can only be one.
    selections : the options that select one of several throws.
    """

    name: str
    recognizes: Callable[[list[str]], bool]
    parse: Callable[[Path, list[str], ReadOptions], ParsedFile]
    parts: Callable[[Path, list[str], ReadOptions], list[FilePart]] | None = None
    selections: tuple[str, ...] = ()


_FRAME_NUMBERS = ("frame", "frames", "frame number", "frame_number", "frame no", "frame_no")


def columns_of(
    source: Path | str,
    names: Sequence[str],
    units: Mapping[str, str],
    *,
    line: int | None = None,
    pixels: bool = False,
) -> tuple[dict[int, Column], list[str]]:
    """Columns to read, by index, and the names of the others.

    With `pixels`, positions are in pixels: x and y without a unit are then in pixels, and v is not
    a speed. With a unit of t such as 25fps, a column of frame numbers is the time if there is no
    other.

    Raises
    ------
    DataError : two columns have the same meaning, or a required one is missing.
    """
    columns: dict[int, Column] = {}
    ignored: list[str] = []
    taken: dict[str, str] = {}
    bare = [str(name).strip().lower() for name in names]
    meant = {column.quantity for name in names if (column := parse_header(name)) is not None}
    velocities = not pixels and {"x", "y"} <= meant and "u" in bare
    pixels = pixels or ("u" in bare and "v" in bare and not velocities)
    for index, name in enumerate(names):
        column = parse_header(name)
        if (
            bare[index] in _FRAME_NUMBERS
            and "t" not in meant
            and units.get("t", "").endswith("fps")
        ):
            column = Column("t", "s", 1.0, stated=False)
        if column is None or (velocities and bare[index] in ("u", "v")):
            if name:
                ignored.append(name)
            continue
        if pixels and bare[index] in ("v", "sigma_v"):
            column = Column(bare[index], "px", 1.0)
        column = with_units(column, units)
        if pixels and not column.stated and column.quantity.removeprefix("sigma_") in ("x", "y"):
            axis = "u" if column.quantity.endswith("x") else "v"
            column = Column(column.quantity[:-1] + axis, "px", 1.0)
        if column.quantity in taken:
            raise DataError(
                f"columns {quoted(taken[column.quantity])} and {quoted(name)} both mean "
                f"{column.quantity}; rename or remove one",
                file=source,
                line=line,
            )
        taken[column.quantity] = name
        columns[index] = column
    missing = missing_columns(taken)
    if missing:
        counted = "t" in missing and set(bare) & set(_FRAME_NUMBERS)
        remedy = (
            "; `--units t=30fps`, with the camera's rate, makes frames times" if counted else ""
        )
        raise DataError(
            f"no column for {' and '.join(missing)} among {_list_names(names)}; {EXPECTED}{remedy}",
            file=source,
            line=line,
        )
    return columns, ignored


def missing_columns(quantities: Any) -> list[str]:
    """Quantities required for a throw that the columns lack."""
    found = set(quantities)
    if {"u", "v"} & found:
        missing = [axis for axis in ("u", "v") if axis not in found]
        need = {"u", "v"}
    else:
        missing = [axis for axis in ("x", "y") if axis not in found]
        if missing == ["x", "y"] and found & {"phi", "speed", "omega"}:
            missing = []  # a gyroscope or a radar alone
        need = {"x", "y"}
    need = (need | {"phi", "speed", "omega"}) & found
    if "t" not in found and (
        not need or any(clock_of(quantity, found) == "t" for quantity in need)
    ):
        missing.insert(0, "t")
    return missing


def clock_of(quantity: str, quantities: Any) -> str:
    """The column with the times of a quantity: its own clock, or t."""
    base = quantity.removeprefix("sigma_")
    clock = {"u": "t_x", "v": "t_y"}.get(base, f"t_{base}")
    if clock in quantities:
        return clock
    return (
        "t_xy"
        if base.removesuffix("_mark") in ("x", "y", "u", "v") and "t_xy" in quantities
        else "t"
    )


def in_si(parsed: ParsedFile, header: str, column: Column, values: Floats) -> Series:
    """A column with its values in SI; refuses values beyond 1e12."""
    scaled = values
    if column.factor != 1:
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = values * column.factor
    bad = np.abs(scaled) > LARGEST
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(
            f"{values[row]:g} {column.unit} found, expected at most {LARGEST:g}",
            file=parsed.source,
            line=None if parsed.lines is None else int(parsed.lines[row]),
            column=header,
        )
    return Series(header, column, scaled)


def choose(what: str, flag: str, number: int | None, options: Sequence[str], default: int) -> int:
    """Index of option `number` (counting from 1), or the default.

    Raises
    ------
    InputError : there is no such option; the message lists them.
    """
    if number is None:
        return default
    if not 1 <= number <= len(options):
        listed = "; ".join(f"{index} {name}" for index, name in enumerate(options, 1))
        raise InputError(f"{flag} {number}: there is no such {what}; expected one of {listed}")
    return number - 1


def _list_names(names: Sequence[str]) -> str:
    short = [str(name)[:40] for name in names[:20]]
    return ", ".join([*short, f"and {len(names) - 20} more"] if len(names) > 20 else short)
