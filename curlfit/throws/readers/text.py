"""Text of a file: lines, cells and numbers."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.spreadsheet import BEGINNINGS, text_of_sheet

GAPS = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
EXPECTED = "expected a header such as t,x,y,phi (time in s, position in m, angle in rad)"
_MOST_BYTES = 50_000_000
# Characters of a comment, a header or a setting; of a row; a line of JSON may have any number.
_MOST_IN_HEAD, _MOST_IN_ROW = 1000, 20_000
_MOST_LINES = 2_000_000
_CHUNK = 20_000
# "t (s)" in a table separated by spaces
_UNIT_APART = re.compile(r"[ \t]+([(\[][^()\[\]]*[)\]])")


def lines_of(path: Path, *, most_bytes: int = _MOST_BYTES, settings: bool = False) -> list[str]:
    """The lines of a file, none of them longer than any throw needs; for a file of `settings`, all
    are as short as comments.

    Raises
    ------
    DataError : as `_text_of`; a line is too long.
    """
    text = _text_of(path, most_bytes, "settings" if settings else "throws")
    lines = text.split("\n")
    if len(lines) > _MOST_LINES + 1:
        raise DataError(f"more than {_MOST_LINES} lines; expected throws", file=path)
    if max(map(len, lines)) <= _MOST_IN_HEAD:
        return lines
    starts = [line[:_MOST_IN_HEAD].lstrip()[:1] for line in lines]
    header = next((k for k, start in enumerate(starts) if start not in ("", "#")), -1)
    json = not settings and starts[header] in ("{", "[")
    for index, (line, start) in enumerate(zip(lines, starts, strict=True)):
        comment = start in ("", "#")
        most = _MOST_IN_HEAD if settings or index == header or comment else _MOST_IN_ROW
        if len(line) > most and (comment or not json):
            fault = f"a line of {len(line)} characters; expected at most {most}"
            raise DataError(fault, file=path, line=index + 1)
    return lines


def _text_of(path: Path, most_bytes: int, what: str) -> str:
    """The file's text with "\\n" line ends: UTF-8, UTF-16 with byte order mark, or Windows cp1252;
    a spreadsheet as text.

    Raises
    ------
    DataError : no such file, a folder, not readable, too large, or not text.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(most_bytes + 1)
    except ValueError:
        raise DataError("this is not a file name", file=quoted(str(path))) from None
    except OSError as error:
        faults: dict[type, str] = {
            FileNotFoundError: "no such file",
            IsADirectoryError: "this is a folder, expected a file",
        }
        fault = faults.get(type(error), f"cannot be read ({error.strerror})")
        raise DataError(fault, file=path) from None
    if len(raw) > most_bytes:
        raise DataError(f"larger than {most_bytes // 1000} kB; expected {what}", file=path)
    if raw.startswith(BEGINNINGS):
        return text_of_sheet(raw, path, most_bytes)
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        marked = encoding == "utf-16" or raw[:3] == b"\xef\xbb\xbf"
        text = raw.decode(encoding if marked else "cp1252", errors="replace")
    if "\x00" in text:
        raise DataError(f"this is not a text file; {EXPECTED}", file=path)
    return text.replace("\r\n", "\n").replace("\r", "\n")


class TextFile(NamedTuple):
    """A file and its lines."""

    path: Path
    lines: list[str]

    def error(self, message: str, index: int | None = None, column: str | None = None) -> DataError:
        """An error at the line of this index."""
        line = None if index is None else index + 1
        return DataError(message, file=self.path, line=line, column=column)

    def head(self, expected: str = EXPECTED) -> int:
        """Index of the first line that is not a comment.

        Raises
        ------
        DataError : the file is empty or contains only comments.
        """
        index = next((k for k, line in enumerate(self.lines) if not is_aside(line)), None)
        if index is None:
            blank = all(not line or line.isspace() for line in self.lines)
            what = "the file is empty" if blank else "the file holds comments only"
            raise self.error(f"{what}; {expected}")
        return index

    def comments(self, until: int | None = None) -> list[tuple[int, str]]:
        """The comments before the line of an index, with their line numbers."""
        return [
            (number, line)
            for number, line in enumerate(self.lines[:until], 1)
            if line.lstrip()[:1] == "#"
        ]


def is_aside(line: str) -> bool:
    """Whether a line is blank or a comment."""
    return not line or line.isspace() or line.lstrip()[0] == "#"


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
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
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


_CLOCK = re.compile(
    r"(?:(?P<date>\d{4}-\d\d-\d\d)[T ])?(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):"
    r"(?P<s>\d{1,2}(?:[.,]\d+)?)(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def clock_times(found: Sequence[str | None]) -> tuple[Floats, list[int]]:
    """Clock times such as 14:03:22.150, 03:22.15 or 2026-01-05T14:03:22.150Z, as s since the first.

    Without dates, midnight may pass from one row to the next.

    Returns
    -------
    Seconds, shape (n,), NaN for gaps; and the rows that are not clock times, also NaN.
    """
    seconds, bad, dated = np.full(len(found), math.nan), [], False
    for row, cell in enumerate(found):
        if cell is None or cell.lower() in GAPS:
            continue
        match = _CLOCK.fullmatch(cell.strip())
        seconds[row] = math.nan if match is None else _seconds(match)
        if math.isnan(seconds[row]):
            bad.append(row)
        dated |= match is not None and match["date"] is not None
    known = np.flatnonzero(np.isfinite(seconds))
    if len(known):
        seconds -= seconds[known[0]]
    if not dated:
        for row in known[1:][np.diff(seconds[known]) < -43200]:
            seconds[row:] += 86400
    return np.round(seconds, 9), bad


def _seconds(match: re.Match[str]) -> float:
    """A clock time in s; NaN if its hour, minute, second or date is invalid."""
    hours, minutes = int(match["h"] or 0), int(match["m"])
    seconds = float(match["s"].replace(",", "."))
    try:
        day = datetime.fromisoformat(f"{match['date'] or '1970-01-01'}T00{match['zone'] or 'Z'}")
    except ValueError:
        return math.nan
    if hours > 23 or seconds >= 60 or (match["h"] and minutes > 59):
        return math.nan
    return day.timestamp() + 3600 * hours + 60 * minutes + seconds


@dataclass(frozen=True)
class TextTable:
    """A table of a file: the index of its header, its separator and the cells of the header."""

    file: TextFile
    header: int
    separator: str | None
    names: list[str]

    @classmethod
    def at(cls, file: TextFile, header: int) -> TextTable:
        """The table with this header."""
        separator = separator_of(file.lines[header])
        return cls(file, header, separator, header_cells(file.lines[header], separator))

    @classmethod
    def of(cls, file: TextFile, expected: str = EXPECTED) -> TextTable:
        """The table with the first line as its header. Raises `DataError` if that is a row."""
        table = cls.at(file, file.head(expected))
        if all(map(is_number, cells(file.lines[table.header], table.separator))):
            raise table.error(f"the table begins with numbers; {expected}")
        return table

    def error(self, message: str) -> DataError:
        """An error at the header."""
        return self.file.error(message, self.header)

    @cached_property
    def rows(self) -> list[int]:
        """Indices of its lines, without comments and blank ones. Raises `DataError` for none."""
        lines = self.file.lines
        rows = [k for k in range(self.header + 1, len(lines)) if not is_aside(lines[k])]
        if not rows:
            raise self.error("a header but no rows of numbers")
        return rows

    def column(self, place: int) -> list[str]:
        """The cells of a column."""
        split = (cells(self.file.lines[index], self.separator) for index in self.rows)
        return [row[place] if place < len(row) else "" for row in split]

    def clocks(self, columns: Iterable[int]) -> dict[int, tuple[str, Floats]]:
        """Of those of some columns that hold clock times: the first one, and seconds since then.

        Raises
        ------
        DataError : a cell of such a column is not a clock time.
        """
        clocks = {}
        for place in columns if ":" in self.file.lines[self.rows[0]] else ():
            found = self.column(place)
            seconds, bad = clock_times(found)
            known = np.flatnonzero(np.isfinite(seconds))
            if len(known) and bad:
                fault = f"{quoted(found[bad[0]])} found, expected a clock time as in other rows"
                raise self.file.error(fault, self.rows[bad[0]], self.names[place])
            if len(known):
                clocks[place] = found[known[0]], seconds
        return clocks

    def numbers(self, columns: Sequence[int]) -> list[Floats]:
        """Numbers in the columns of these indices, as written; gaps are NaN.

        Raises
        ------
        DataError : there is no row, a row with a wrong number of cells, or a cell that is not a
            finite number.
        """
        lines, parts = self.file.lines, []
        decimal_comma = self.separator != "," and any("," in lines[index] for index in self.rows)
        for start in range(0, len(self.rows), _CHUNK):
            chunk = self.rows[start : start + _CHUNK]
            found = self._read_fast([lines[index] for index in chunk], columns, decimal_comma)
            if found is None:
                found = self._read_cells(chunk, columns, decimal_comma)
            parts.append(found)
        return list(np.concatenate(parts, axis=1))

    def _read_fast(
        self, rows: list[str], columns: Sequence[int], decimal_comma: bool
    ) -> Floats | None:
        """Rows of numbers and empty cells only; None if there is anything else in the columns."""
        text = "\n".join(rows)
        if '"' in text or "_" in text or (decimal_comma and "." in text):
            return None
        if decimal_comma:
            rows = text.replace(",", ".").split("\n")
        split = [row.split(self.separator) for row in rows]
        if any(len(row) != len(self.names) for row in split):
            return None
        by_column = list(zip(*split, strict=True))
        try:
            found = np.array([[float(c or "nan") for c in by_column[k]] for k in columns])
        except ValueError:
            return None
        return None if np.isinf(found).any() else found

    def _read_cells(
        self, indices: Sequence[int], columns: Sequence[int], decimal_comma: bool
    ) -> Floats:
        """Rows read cell by cell: any notation, and faults with their location."""
        found, width = np.full((len(columns), len(indices)), math.nan), len(self.names)
        for row, index in enumerate(indices):
            line = cells(self.file.lines[index], self.separator)
            if len(line) < width or any(line[width:]):
                fault = f"{len(line)} cells where the header has {width} columns"
                if self.separator == "," and width < len(line) <= 2 * width:
                    fault += "; where numbers have decimal commas, separate the columns by "
                    fault += "semicolons"
                raise self.file.error(fault, index)
            for slot, column in enumerate(columns):
                if (cell := line[column]).lower() in GAPS:
                    continue
                value = parse_number(cell, decimal_comma=decimal_comma)
                if value is None or not math.isfinite(value):
                    fault = f"{quoted(cell)} found, expected a finite number"
                    raise self.file.error(fault, index, self.names[column])
                found[slot, row] = value
        return found
