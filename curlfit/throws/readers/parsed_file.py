"""The columns of a file, before clocks, pixels, unwrapping and axes are applied."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError, Option
from curlfit.findings import Finding
from curlfit.foreign import LARGEST
from curlfit.numerics.arrays import Floats
from curlfit.throws.events import Event
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.columns import Column, in_unit
from curlfit.throws.readers.comments import read_comments
from curlfit.throws.readers.text import TextFile
from curlfit.throws.reference import Reference

_CENTURY = (946684800.0, 4102444800.0)
"""s since 1970, of the years 2000 and 2100."""


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
    events, assumed, labels : as in `curlfit.throws.throw.Throw`; with events there
        are no columns.
    alone : why it determines nothing without others; None if it does.
    odd_rows : of its table, as in `curlfit.throws.throw.Throw`.
    """

    source: Path | str
    format: str
    series: list[Series] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    reference: Reference | None = None
    notes: list[Finding] = field(default_factory=list)
    lines: np.ndarray | None = None
    events: list[Event] = field(default_factory=list)
    assumed: dict[str, float] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    alone: DataError | None = None
    odd_rows: tuple[OddRow, ...] = ()

    @classmethod
    def begin(
        cls,
        file: TextFile,
        format: str,
        until: int | None = None,
    ) -> ParsedFile:
        """A file with what its comments say, and no columns yet.

        Parameters
        ----------
        until : as of `read_comments`.

        Raises
        ------
        DataError : a setting that cannot be read or used.
        """
        comments = read_comments(file, until)
        of_file = [] if file.note is None else [file.note]
        return cls(
            file.path,
            format,
            settings=comments.settings,
            reference=comments.reference,
            notes=[*of_file, *comments.notes],
        )

    def error(
        self,
        message: str,
        row: int | None = None,
        quantity: str | None = None,
        options: tuple[Option, ...] = (),
    ) -> DataError:
        """An error with its location in the file, and with options to type instead."""
        header = next(
            (s.header for s in self.series if s.column.quantity == quantity), quantity
        )
        line = None if row is None or self.lines is None else int(self.lines[row])
        if row is not None and line is None:
            message = f"row {row}: {message}"
        return DataError(
            message, file=self.source, line=line, column=header, options=options
        )

    def place(self, row: int) -> dict[str, int | None]:
        """Where a row is: its `line` if that is known, or else its number `row`."""
        if self.lines is None:
            return {"line": None, "row": row + 1}
        return {"line": int(self.lines[row]), "row": None}

    def copy(self) -> ParsedFile:
        """The file with lists and settings of its own."""
        return replace(
            self,
            series=list(self.series),
            ignored=list(self.ignored),
            notes=list(self.notes),
            settings=dict(self.settings),
        )

    def rows(self, rows: np.ndarray) -> ParsedFile:
        """Some of its rows, with lists and settings of their own."""
        return replace(
            self.copy(),
            series=[
                series._replace(values=series.values[rows]) for series in self.series
            ],
            lines=None if self.lines is None else self.lines[rows],
        )

    def add(self, header: str, column: Column, values: Floats) -> None:
        """Add a column of values in its unit; refuses values beyond 1e12 in SI."""
        scaled = values
        if column.factor != 1:
            with np.errstate(over="ignore", invalid="ignore"):
                scaled = values * column.factor
        bad = np.abs(scaled) > LARGEST
        if bad.any():
            row = int(np.argmax(bad))
            fault = f"{values[row]:g} {column.unit} found, expected at most {LARGEST:g}"
            options = []
            if column.base == "t" and (unit := unit_since_1970(values[row])):
                options = [Option("units", f"t={unit}")]
                fault += f"; it may be a time since 1970 in {unit}: give {options[0]}"
            raise self.error(fault, row, header, tuple(options))
        self.series.append(Series(header, column, scaled))


def unit_since_1970(value: float) -> str | None:
    """The unit in which a number is a time since 1970, of this century; None if there
    is none smaller than a second."""
    for unit in ("ms", "us", "ns"):
        if _CENTURY[0] < value * in_unit("t", unit).factor < _CENTURY[1]:
            return unit
    return None


def clock_of(quantity: str, quantities: Any) -> str:
    """The column with the times of a quantity: its own clock, or t."""
    base = quantity.removeprefix("sigma_")
    clock = {"u": "t_x", "v": "t_y"}.get(base, f"t_{base}")
    if clock in quantities:
        return clock
    of_place = base.removesuffix("_mark") in ("x", "y", "u", "v")
    return "t_xy" if of_place and "t_xy" in quantities else "t"
