"""Text of a file: lines, cells and numbers."""

from __future__ import annotations

import csv
import math
import os
import re
import stat
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding
from curlfit.foreign import STANDARD_INPUT, counted, quoted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import has_japanese_words
from curlfit.throws.readers.spreadsheet import text_of_sheet
from curlfit.throws.readers.words import WORDS

GAPS = {"", *WORDS["gaps"].split()}
"""Cells without a value, among them the errors of spreadsheets."""
EXPECTED = (
    "expected a header such as t,x,y,phi (time in s, position in m, angle in rad)"
)
# first bytes; of other archives too
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
_MOST_BYTES, _MOST_OF_SETTINGS = 50_000_000, 64_000
# Characters of a comment, a header or a setting; of a row; a line of JSON may
# have any number.
_MOST_IN_HEAD, _MOST_IN_ROW = 1000, 20_000
_MOST_LINES = 2_000_000
_of_pipes: dict[tuple[int, int], bytes] = {}  # contents by device and inode
# "t (s)" in a table separated by spaces
_UNIT_APART = re.compile(r"[ \t]+([(\[][^()\[\]]*[)\]])")


def _bytes_of(path: Path, what: str, most: int) -> bytes:
    """The content of a file; a pipe, such as `<(zcat FILE)`, and standard input are
    read once and kept. Raises `DataError` where there is none, or too much."""
    source = 0 if str(path) == STANDARD_INPUT else path
    try:
        status = os.stat(source)
        place = status.st_dev, status.st_ino
        if place in _of_pipes:
            return _of_pipes[place]
        with open(source, "rb", closefd=source != 0) as stream:
            raw = stream.read(most + 1)
    except ValueError:
        raise DataError("this is not a file name", file=quoted(str(path))) from None
    except OSError as error:
        said = {
            FileNotFoundError: "no such file",
            IsADirectoryError: "this is a folder, expected a file",
        }
        fault = said.get(type(error), f"cannot be read ({error.strerror})")
        raise DataError(fault, file=path) from None
    if len(raw) > most:
        raise DataError(f"larger than {most // 1000} kB; expected {what}", file=path)
    if source == 0 or stat.S_ISFIFO(status.st_mode):
        _of_pipes[place] = raw
    return raw


def _decoded(raw: bytes) -> str:
    """Text with "\\n" line ends, in UTF-8, UTF-16 with byte order mark, Windows cp932
    with headings in Japanese, or Windows cp1252."""
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        marked = encoding == "utf-16" or raw[:3] == b"\xef\xbb\xbf"
        text = raw.decode(encoding if marked else _old_encoding(raw), errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _old_encoding(raw: bytes) -> str:
    """The encoding of a file that is not in Unicode: that of Windows in Japan or
    in the West."""
    return (
        "cp932"
        if has_japanese_words(raw[:_MOST_IN_ROW].decode("cp932", "replace"))
        else "cp1252"
    )


class TextFile(NamedTuple):
    """A file and its lines, none of them longer than any throw needs.

    Attributes
    ----------
    note : on what of it was read, if it has more.
    """

    path: Path
    lines: list[str]
    note: Finding | None = None

    @classmethod
    def read(
        cls, path: Path, worksheet: str | None = None, *, settings: bool = False
    ) -> TextFile:
        """A file of data, or a worksheet of a workbook: its first one with data,
        if none is named; or a file of `settings`, in which all lines are as short
        as comments.

        Raises
        ------
        DataError : no such file, a folder, not readable, too large, not text, or a line
            is too long. InputError : no such worksheet.
        """
        kind = ("settings", _MOST_OF_SETTINGS) if settings else ("throws", _MOST_BYTES)
        raw = _bytes_of(path, *kind)
        note = None
        if raw.startswith(_SPREADSHEETS):
            text, note = text_of_sheet(raw, path, _MOST_BYTES, worksheet)
        elif worksheet is not None:
            raise InputError(
                f"--worksheet: {path} is no workbook and holds no worksheets"
            )
        else:
            text = _decoded(raw)
        # In sentences, what is between backticks is an option that curlfit proposes.
        file = cls(path, text.replace("`", "'").split("\n"), note)
        if "\x00" in text:
            raise file.error(f"this is not a text file; {EXPECTED}")
        if len(file.lines) > _MOST_LINES + 1:
            raise file.error(f"more than {_MOST_LINES} lines; expected throws")
        if max(map(len, file.lines)) <= _MOST_IN_HEAD:
            return file
        header = next(
            (k for k, line in enumerate(file.lines) if not is_aside(line)), -1
        )
        json = not settings and file.lines[header].lstrip()[:1] in ("{", "[")
        for index, line in enumerate(file.lines):
            comment = is_aside(line)
            short = settings or comment or index == header
            most = _MOST_IN_HEAD if short else _MOST_IN_ROW
            if len(line) > most and (comment or not json):
                fault = f"a line of {len(line)} characters; expected at most {most}"
                raise file.error(fault, index)
        return file

    def error(
        self,
        message: str,
        index: int | None = None,
        column: str | None = None,
        options: tuple[Option, ...] = (),
    ) -> DataError:
        """An error at the line of this index, with options to type instead."""
        line = None if index is None else index + 1
        return DataError(
            message, file=self.path, line=line, column=column, options=options
        )

    def head(self, expected: str = EXPECTED) -> int:
        """Index of the first line that is not a comment.

        Raises
        ------
        DataError : the file is empty or contains only comments.
        """
        index = next(
            (k for k, line in enumerate(self.lines) if not is_aside(line)), None
        )
        if index is None:
            blank = not any(map(str.strip, self.lines))
            what = "the file is empty" if blank else "the file holds comments only"
            raise self.error(f"{what}; {expected}")
        return index

    def comments(self, until: int | None = None) -> list[tuple[int, str]]:
        """The comments before the line of an index, with their own indices."""
        lines = enumerate(self.lines[:until])
        return [(k, line) for k, line in lines if line.lstrip()[:1] == "#"]


def is_aside(line: str) -> bool:
    """Whether a line is blank or a comment."""
    return line.lstrip()[:1] in ("", "#")


def separator_of(line: str) -> str | None:
    """Separator of the cells of a header line; None for spaces."""
    bare = re.sub(r"\([^()]*\)|\[[^\[\]]*\]", "", line)
    return next((mark for mark in ("\t", ";", ",") if mark in bare), None)


def header_cells(line: str, separator: str | None) -> list[str]:
    """Cells of a header; in a table separated by spaces, `t (s)` is one cell."""
    return cells(_UNIT_APART.sub(r"\1", line) if separator is None else line, separator)


def cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line, without surrounding spaces and quotation marks."""
    if separator is None:
        return [cell.strip('"') for cell in line.split()]
    if '"' in line:
        try:
            return [
                cell.strip() for cell in next(csv.reader([line], delimiter=separator))
            ]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def parse_number(cell: str, *, decimal_comma: bool) -> float | None:
    """A cell as a number; None if it is not one."""
    text = cell.replace(",", ".") if decimal_comma and "." not in cell else cell
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or a decimal comma."""
    return parse_number(cell, decimal_comma=True) is not None


_GROUPED = re.compile(
    r"[-+]?\d{1,3}(?P<mark>[.,'\u2019\s])\d{3}(?:(?P=mark)\d{3})*(?:[.,]\d+)?"
)


def _without_groups(cell: str, mark: str) -> str:
    """A number with a decimal point and without the marks that separate its thousands;
    none where such a mark is anywhere else."""
    if mark in cell and not (
        (found := _GROUPED.fullmatch(cell)) and found["mark"] == mark
    ):
        return "?"
    return cell.replace(mark, "").replace(",", ".")


_CLOCK = re.compile(r"(?:(\d{1,2}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)")


def clock_times(found: Sequence[str | None]) -> tuple[Floats, list[int]]:
    """Clock times such as 14:03:22.150, 03:22.15 or 2026-01-05T14:03:22.150Z, as s
    since the first.

    Without dates, midnight may pass from one row to the next.

    Returns
    -------
    Seconds, shape (n,), NaN for gaps; and the rows that are not clock times, also NaN.
    """
    gaps = np.array([cell is None or cell.lower() in GAPS for cell in found], bool)
    seconds = np.array(
        [math.nan if cell is None else _seconds(cell.strip()) for cell in found]
    )
    known = np.flatnonzero(np.isfinite(seconds))
    if len(known):
        seconds -= seconds[known[0]]
    if not any((cell or "").strip()[4:5] == "-" for cell in found):  # no date
        for row in known[1:][np.diff(seconds[known]) < -43200]:
            seconds[row:] += 86400
    return np.round(seconds, 9), np.flatnonzero(np.isnan(seconds) & ~gaps).tolist()


def _seconds(cell: str) -> float:
    """A clock time in s, since 1970 if it has a date; NaN if it is not one."""
    if match := _CLOCK.fullmatch(cell):
        hours, minutes, seconds = (
            int(match[1] or 0),
            int(match[2]),
            match[3].replace(",", "."),
        )
        valid = hours < 24 and float(seconds) < 60 and (minutes < 60 or not match[1])
        return 3600 * hours + 60 * minutes + float(seconds) if valid else math.nan
    try:
        moment = datetime.fromisoformat(cell) if ":" in cell else None
    except ValueError:
        moment = None
    if moment is None:
        return math.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


@dataclass(frozen=True)
class TextTable:
    """A table of a file: the index of its header, its separator and the cells
    of the header."""

    file: TextFile
    header: int
    separator: str | None
    names: list[str]
    remarks: list[Finding] = field(default_factory=list)
    """on how its numbers were read"""

    @classmethod
    def at(cls, file: TextFile, header: int) -> TextTable:
        """The table with this header."""
        separator = separator_of(file.lines[header])
        return cls(file, header, separator, header_cells(file.lines[header], separator))

    @classmethod
    def of(cls, file: TextFile, expected: str = EXPECTED) -> TextTable:
        """The table with the first line as its header. Raises `DataError` if
        that is a row."""
        table = cls.at(file, file.head(expected))
        if all(map(is_number, cells(file.lines[table.header], table.separator))):
            raise table.error(f"the table begins with numbers; {expected}")
        return table

    def error(self, message: str, options: tuple[Option, ...] = ()) -> DataError:
        """An error at the header, with options to type instead."""
        return self.file.error(message, self.header, options=options)

    @cached_property
    def rows(self) -> list[int]:
        """Indices of its lines, without comments and blank ones. Raises
        `DataError` for none."""
        lines = self.file.lines
        rows = [k for k in range(self.header + 1, len(lines)) if not is_aside(lines[k])]
        if not rows:
            raise self.error("a header but no rows of numbers")
        return rows

    @cached_property
    def _cells(self) -> list[list[str]]:
        return [cells(self.file.lines[index], self.separator) for index in self.rows]

    def column(self, place: int) -> list[str]:
        """The cells of a column."""
        return [row[place] if place < len(row) else "" for row in self._cells]

    def is_numeric(self, place: int) -> bool:
        """Whether a column has numbers or gaps only, at least one number."""
        found = [cell for cell in self.column(place) if cell.lower() not in GAPS]
        return bool(found) and all(
            is_number(cell) or self._grouped(cell) for cell in found
        )

    def clock(self, place: int) -> tuple[str, Floats] | None:
        """Of a column of clock times the first one, and seconds since then;
        None of another.

        Raises
        ------
        DataError : a cell of such a column is not a clock time.
        """
        if ":" not in self.file.lines[self.rows[0]]:
            return None
        found = self.column(place)
        seconds, bad = clock_times(found)
        known = np.flatnonzero(np.isfinite(seconds))
        if len(known) and bad:
            fault = (
                f"{quoted(found[bad[0]])} found, expected a clock time as in other rows"
            )
            raise self.file.error(fault, self.rows[bad[0]], self.names[place])
        return (found[known[0]], seconds) if len(known) else None

    def numbers(self, columns: Sequence[int]) -> list[Floats]:
        """Numbers in the columns of these indices, as written; gaps are NaN.

        Raises
        ------
        DataError : there is no row, a row with a wrong number of cells, or a cell that
            is not a finite number.
        """
        width = len(self.names)
        lines = [self.file.lines[index] for index in self.rows]
        with suppress(ValueError):  # of anything but numbers
            plain = np.loadtxt(lines, delimiter=self.separator, comments=None, ndmin=2)
            if plain.shape[1] == width and not np.isinf(plain).any():
                return list(plain[:, list(columns)].T.copy())
        for index, row in zip(self.rows, self._cells, strict=True):
            if len(row) < width or any(row[width:]):
                cells_of_row = counted(len(row), "cell")
                fault = (
                    f"{cells_of_row} where the header has {counted(width, 'column')}"
                )
                if self.separator == "," and width < len(row) <= 2 * width:
                    fault += (
                        "; where numbers have decimal commas, separate the columns by "
                        "semicolons"
                    )
                raise self.file.error(fault, index)
        try:
            return [self._numbers(place) for place in columns]
        except DataError:
            every = (
                self._grouped(cell) for place in columns for cell in self.column(place)
            )
            if (found := next(filter(None, every), None)) is None:
                raise
            with suppress(DataError):
                values = [self._numbers(place, found["mark"]) for place in columns]
                thousands = Finding.note(
                    "thousands",
                    mark=quoted(found["mark"]),
                    cell=quoted(found[0]),
                    number=_without_groups(found[0], found["mark"]),
                )
                self.remarks.append(thousands)
                return values
            raise

    def _grouped(self, cell: str) -> re.Match[str] | None:
        """A number with its thousands apart, which cannot be read otherwise."""
        number = parse_number(cell, decimal_comma=self.separator != ",")
        return _GROUPED.fullmatch(cell) if number is None else None

    def _numbers(self, place: int, mark: str = "") -> Floats:
        """The numbers in a column; a mark, if any, separates their thousands."""
        found = self.column(place)
        if mark:
            found = [_without_groups(cell, mark) for cell in found]
        values = np.full(len(found), math.nan)
        for row, cell in enumerate(found):
            if cell.lower() in GAPS:
                continue
            value = parse_number(cell, decimal_comma=self.separator != ",")
            if value is None or not math.isfinite(value):
                fault = f"{quoted(cell)} found, expected a finite number"
                raise self.file.error(fault, self.rows[row], self.names[place])
            values[row] = value
        return values
