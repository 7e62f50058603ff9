"""Throws from files of any format, and from tables in memory (pandas, polars, xarray)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import CurlfitError, DataError, InputError
from curlfit.foreign import quoted
from curlfit.settings.choices import Reading
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.columns import Column, in_unit, parse_header, parse_units, with_units
from curlfit.throws.readers.digitalcurling import DIGITALCURLING
from curlfit.throws.readers.homography import load_homography
from curlfit.throws.readers.parsed_file import (
    FilePart,
    Format,
    ParsedFile,
    ReadOptions,
    columns_of,
    in_si,
)
from curlfit.throws.readers.several import selected, throws_in
from curlfit.throws.readers.table import TABLE
from curlfit.throws.readers.text import clock_times, lines_of
from curlfit.throws.readers.timings import TIMINGS, is_table
from curlfit.throws.readers.tracker import TRACKER
from curlfit.throws.throw import Throw

_READERS = (DIGITALCURLING, TIMINGS, TRACKER, TABLE)
"""Formats in the order in which they are tried; the last accepts any file."""
_BY_NAME = {reader.name: reader for reader in reversed(_READERS)}
FORMATS = tuple(_BY_NAME)
_BEGINNING = 10_000  # characters that show whether a table has one throw per row
_HEAD = 30  # lines that show the format


def load_throw(
    file: str | PathLike[str],
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
    handle: int | None = None,
    as_given: bool = False,
) -> Throw:
    """Read a throw from a file.

    A table has a header and one row for each time. Columns are `t` and any of `x`, `y`, `phi`,
    `speed`, `omega`, and `sigma_x` and so on. Common names and units are recognised
    (`time`, `y_ft`, `angle [deg]`, `phi_rev`), as are separate clocks of channels (`t_phi`).
    Separators are commas, semicolons, tabs or spaces; decimal commas are read where the separator
    is not a comma. Empty cells are gaps. Leading lines `# key = value` set defaults of this throw.
    Wrapped angles are unwrapped.

    Parameters
    ----------
    format : `table`, `tracker` (exports of Tracker), `digitalcurling` (logs of DigitalCurling 3)
        or `timings` (of a stopwatch); detected from the file if not given.
    axes : the file's axes if they are not curlfit's, as words separated by commas, such as
        `x-along,clockwise,from-tee`; see `curlfit.throws.readers.axes.WORDS`.
    reference : file of known points u, v (pixels), x, y (m), if positions are in pixels.
    stone_index : object of a Tracker export, stone of a shot or throw of a table, counting from 1.
    shot : shot of a game's log, counting from 1.
    units : units of columns, in place of those of the header, such as `t=ms,x=cm,angle=deg`.
    handle : object of a Tracker export, counting from 1, that marks another point of the stone; the
        angle is the direction from the stone to it.
    as_given : accept data that are implausible for a curling stone (`curlfit.throws.plausibility`).

    Raises
    ------
    DataError : with the file, line and column of the fault, and what was expected.
    InputError : an argument that cannot be used.

    Examples
    --------
    >>> throw = curlfit.load_throw("data/jensen_shegelski_2004.csv")
    >>> len(throw), throw.seen
    (230, ('x', 'y', 'phi'))
    """
    points = None if reference is None else Path(reference)
    parsed = read(
        file, format, stone_index=stone_index, shot=shot, units=units, handle=handle,
        pixels=points is not None,
    )  # fmt: skip
    throw = assemble(parsed, axes=axes, reference=points, as_given=as_given)
    words = Reading.of(
        format=format, axes=axes, reference=None if points is None else str(points),
        stone_index=stone_index, shot=shot, units=units, handle=handle, as_given=as_given,
    ).words()  # fmt: skip
    return replace(throw, read_with=tuple(words))


class Part(NamedTuple):
    """One throw of a file that may contain several.

    Attributes
    ----------
    shot, stone_index : arguments of `load_throw` that select it; None if the file has only one.
    throw : the throw, or the error if it cannot be read.
    """

    shot: int | None
    stone_index: int | None
    throw: Throw | CurlfitError


def load_throws(
    file: str | PathLike[str],
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
    handle: int | None = None,
    as_given: bool = False,
) -> list[Part]:
    """Every throw in a file: shots of a log, objects of a Tracker export, throws of a table.

    Arguments as for `load_throw`; `shot` or `stone_index` selects a single one.

    Raises
    ------
    DataError : the file as a whole cannot be read. InputError : an argument that cannot be used.
    """
    points = None if reference is None else Path(reference)
    options = ReadOptions(parse_units(units), points is not None, stone_index, shot, handle)
    source = _open(file, format, options)
    parts = [FilePart(shot, stone_index, partial(source.parse, options))]
    if source.format.parts is not None:
        parts = source.format.parts(source.path, source.lines, options)
    found = []
    for number, index, parsed in parts:
        throw: Throw | CurlfitError
        try:
            throw = assemble(parsed(), axes=axes, reference=points, as_given=as_given)
        except CurlfitError as error:
            throw = error
        found.append(Part(number, index, throw))
    return found


def holds_timed_rows(file: str | PathLike[str], format: str | None = None) -> bool:
    """Whether a file is a table of stopwatch times with one throw per row.

    Only its beginning is read. False if it cannot be read.
    """
    if format not in (None, TIMINGS.name):
        return False
    try:
        with Path(file).open(encoding="utf-8-sig", errors="replace") as stream:
            lines = stream.read(_BEGINNING).splitlines()
    except (OSError, ValueError):
        return False
    head = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    return is_table(head) and detect_format(lines) == TIMINGS.name


def states_sweeping(file: str | PathLike[str]) -> bool:
    """Whether a file states that its stone was swept (`# swept = [A, B]`).

    Only its beginning is read. False if it cannot be read.
    """
    try:
        with Path(file).open(encoding="utf-8-sig", errors="replace") as stream:
            lines = stream.read(_BEGINNING).splitlines()
    except (OSError, ValueError):
        return False
    comments = [line.lstrip() for line in lines if line.lstrip().startswith("#")]
    return any(line.lstrip("#").split("=")[0].strip() == "swept" for line in comments)


def check_reader_options(
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
    handle: int | None = None,
    as_given: bool = False,
) -> None:
    """Raise `InputError` if no file could be read with these arguments."""
    _check_format(format)
    for flag, number in (
        ("--shot", shot), ("--stone-index", stone_index), ("--handle", handle),
    ):  # fmt: skip
        if number is not None and number < 1:
            raise InputError(f"{flag} {number}: expected a whole number from 1")
    parse_units(units)
    parse_axes(axes)
    if reference is not None:
        load_homography(Path(reference))


def read(
    file: str | PathLike[str],
    format: str | None = None,
    *,
    stone_index: int | None = None,
    shot: int | None = None,
    units: str | None = None,
    handle: int | None = None,
    pixels: bool = False,
) -> ParsedFile:
    """The columns of a file in SI. Arguments as for `load_throw`."""
    options = ReadOptions(parse_units(units), pixels, stone_index, shot, handle)
    return _open(file, format, options).parse(options)


def _check_format(format: str | None) -> None:
    if format is not None and format not in FORMATS:
        raise InputError(f"format {quoted(format)}: expected one of {', '.join(FORMATS)}")


class _SourceFile(NamedTuple):
    """Lines and format of a file."""

    path: Path
    lines: list[str]
    format: Format

    def parse(self, options: ReadOptions) -> ParsedFile:
        return self.format.parse(self.path, self.lines, options)


def _open(file: str | PathLike[str], format: str | None, options: ReadOptions) -> _SourceFile:
    _check_format(format)
    path = Path(file)
    lines = lines_of(path)
    source = _SourceFile(path, lines, _BY_NAME[format or detect_format(lines)])
    kinds = (("shot", "no shots"), ("stone_index", "one stone"), ("handle", "no objects"))
    for name, what in kinds:
        if getattr(options, name) is not None and name not in source.format.selections:
            flag = name.replace("_", "-")
            raise InputError(f"--{flag}: {path} is a {source.format.name} file and holds {what}")
    return source


def format_of(file: str | PathLike[str]) -> str:
    """The format of a file. Raises `DataError` if it cannot be read."""
    return detect_format(lines_of(Path(file)))


def detect_format(lines: list[str]) -> str:
    """The format of a file, from its first lines."""
    shown = (line for line in lines[:200] if line.strip() and not line.lstrip().startswith("#"))
    head = list(islice(shown, _HEAD))
    if not head:
        return TABLE.name
    return next(reader.name for reader in _READERS if reader.recognizes(head))


def from_table(
    table: Any,
    *,
    axes: str | None = None,
    units: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    as_given: bool = False,
    name: str = "table",
) -> Throw:
    """A throw from a table in memory.

    Parameters
    ----------
    table : a pandas or polars DataFrame, an xarray Dataset, or a mapping of names to arrays of
        equal length. Columns are named as in files, with units in the names; a variable's
        `attrs["units"]` takes precedence. The index of a frame, or the coordinate of a dataset,
        is the time if no column is. Times may be dates or durations.
    axes, units, reference, stone_index, as_given : as for `load_throw`.
    name : name of the throw.

    Raises
    ------
    DataError, InputError : not a table, a column that is missing or not numeric.
    """
    column_units = parse_units(units)
    values, stated, notes = _variables(table, name)
    names = list(values)
    columns, ignored = columns_of(name, names, column_units, pixels=reference is not None)
    parsed = ParsedFile(name, "table", [], ignored, notes=notes)
    lengths = {len(values[names[index]]) for index in columns}
    if len(lengths) > 1:
        raise DataError(
            f"columns of different lengths ({', '.join(map(str, sorted(lengths)))})", file=name
        )
    if lengths == {0}:
        raise DataError("no rows", file=name)
    for index, column in columns.items():
        header = names[index]
        if header in stated and column.quantity.removeprefix("sigma_") not in column_units:
            column = _with_stated_unit(name, header, column, stated[header])
        numbers = _numbers(values[header], column, name, header)
        parsed.series.append(in_si(parsed, header, column, numbers))
    points = None if reference is None else Path(reference)
    words = {names[k]: values[names[k]].tolist() for k in range(len(names)) if k not in columns}
    throws = throws_in(parsed, words)
    parsed = selected(throws, stone_index, "stone_index =")
    return assemble(parsed, axes=axes, reference=points, as_given=as_given)


def _variables(table: Any, name: str) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Columns by name, their stated units, and notes."""
    values: dict[str, Any] = {}
    stated: dict[str, str] = {}
    notes: list[str] = []
    if hasattr(table, "data_vars") and hasattr(table, "coords"):
        for key in [*table.coords, *table.data_vars]:
            variable = table[key]
            if len(variable.dims) != 1:
                notes.append(f"variable {key} has {len(variable.dims)} dimensions and was ignored")
                continue
            values[str(key)] = np.asarray(variable.values)
            unit = variable.attrs.get("units", variable.attrs.get("unit"))
            if isinstance(unit, str) and unit.strip():
                stated[str(key)] = unit
        used = {str(key): table[key].dims[0] for key in [*table.coords, *table.data_vars]
                if str(key) in values and parse_header(str(key)) is not None}  # fmt: skip
        if len(set(used.values())) > 1:
            raise DataError(
                "variables along different dimensions ("
                + ", ".join(f"{key} along {dim}" for key, dim in used.items())
                + "); merge them to one",
                file=name,
            )
        return values, stated, notes
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):
        keys = list(table.columns)
        if len({str(key) for key in keys}) < len(keys):
            raise DataError("two columns of the same name", file=name)
        index = getattr(table, "index", None)
        known = {c.quantity for key in keys if (c := parse_header(str(key))) is not None}
        if index is not None and not known & {"t"} and getattr(index, "nlevels", 1) == 1:
            own = getattr(index, "name", None)
            meaning = parse_header(str(own)) if own is not None else None
            dated = getattr(getattr(index, "dtype", None), "kind", "") in "mM"
            if (meaning is not None and meaning.quantity == "t") or dated:
                label = str(own) if meaning is not None and meaning.quantity == "t" else "time"
                values[label] = np.asarray(index)
        values |= {str(key): np.asarray(table[key]) for key in keys}
        return values, stated, notes
    if isinstance(table, Mapping):
        return {str(key): _fill_masked(table[key]) for key in table}, stated, notes
    raise InputError(
        f"{type(table).__name__}: expected a DataFrame, a Dataset or a mapping of names to arrays"
    )


def _with_stated_unit(name: str, header: str, column: Column, unit: str) -> Column:
    try:
        return with_units(column, {column.quantity.removeprefix("sigma_"): unit})
    except InputError:
        try:
            return in_unit(column.quantity, unit)
        except InputError as error:
            raise DataError(str(error), file=name, column=header) from None


def _numbers(values: Any, column: Column, name: str, header: str) -> np.ndarray:
    """Numbers in the column's unit; dates and durations as seconds."""
    if values.ndim != 1:
        raise DataError(f"{values.ndim} dimensions, expected one", file=name, column=header)
    if values.dtype.kind in "mM" and column.quantity.startswith("t"):
        blank = np.isnat(values)
        if blank.all():
            raise DataError("every time is missing", file=name, column=header)
        origin = values[~blank][0] if values.dtype.kind == "M" else np.timedelta64(0, "ns")
        numbers = (values - origin) / np.timedelta64(1, "s") / column.factor
        return np.where(blank, np.nan, numbers)
    if column.quantity.startswith("t") and values.dtype.kind in "OU":
        clock, bad = clock_times([None if _blank(v) else str(v) for v in values.tolist()])
        if not bad and np.isfinite(clock).any():
            return clock / column.factor
    try:
        numbers = np.array([np.nan if _blank(v) else v for v in values.tolist()], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise DataError("expected numbers", file=name, column=header) from None
    if np.isinf(numbers).any():
        row = int(np.argmax(np.isinf(numbers)))
        raise DataError(f"row {row}: {numbers[row]} found, expected a finite number",
                        file=name, column=header)  # fmt: skip
    return numbers


def _blank(value: Any) -> bool:
    return value is None or type(value).__name__ == "NAType"  # of pandas


def _fill_masked(values: Any) -> np.ndarray:
    """An array with masked entries as NaN."""
    if isinstance(values, np.ma.MaskedArray):
        return np.ma.filled(values.astype(float), np.nan)
    return np.asarray(values)
