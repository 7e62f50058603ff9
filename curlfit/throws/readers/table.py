"""A table of a file: where its header is, its columns, and the rows that hold data.

Above the header may be titles, comments and `sep=;`; below it a row of units. The
header may stand behind a `#`, and rows may have names without a heading, as R writes
them. Rows of means, sums and formulas below the data are left out, and a finding says
so.
"""

from __future__ import annotations

from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, Option
from curlfit.findings import Finding
from curlfit.foreign import counted, quoted
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.readers.cells import (
    GAPS,
    LOST,
    cells,
    header_cells,
    headings_in,
    is_gap,
    separator_of,
)
from curlfit.throws.readers.clocks import AmbiguousTimesError, ClockTimes, clock_times
from curlfit.throws.readers.columns import is_unit
from curlfit.throws.readers.numbers import (
    is_grouped,
    is_number,
    numbers_in,
    thousands_of_whole_numbers,
    thousands_that_bar,
    without_groups,
)
from curlfit.throws.readers.text import EXPECTED, TextFile, is_aside
from curlfit.throws.readers.words import WORDS

MOST_TITLES = 20
"""Lines above a header."""
_MOST_BELOW = 12
"""Rows of means, sums and such below a table."""
_AGGREGATES = set(WORDS["aggregates"].split())
_MAY_BE_NAMES = set(WORDS["aggregates_or_names"].split())
"""Aggregates by words that are also names of people, as Max is."""
_FIRST_ROWS = 1000
_OF_NUMBERS = "0123456789+-"
"""First characters of a cell that is no word for a gap; an empty one is none either."""


class _Rows(NamedTuple):
    """Indices of the lines of rows, and their cells."""

    lines: list[int]
    cells: list[list[str]]


class Likelihood(NamedTuple):
    """How sure a program is of the values of a column: the place of the column that
    says it, and the least with which a value counts."""

    place: int
    least: float


@dataclass(frozen=True)
class Table:
    """A table of a file.

    Attributes
    ----------
    header : index of the last line of its header. separator : of its cells; None for
        spaces.
    headings : of its columns.
    header_lines : the text of its header, which may be repeated between the rows.
    has_frames : whether the last heading is that of numbers of rows, which the file
        does not have: each row is a frame of a film.
    noted : findings on the header, the rows and the columns, as these are read.
    objects : places of the columns of each object, by its name, where the file says
        which there are.
    computed : places of columns that a program computed from others.
    units, columns : as `--units` and `--columns` have them, which override these: what
        the program says of its columns elsewhere than in the headings.
    likelihoods : of the values of some columns, by place.
    quaternions : places of the parts W, X, Y, Z of the rotations of some objects, by
        name; their positions have headings X, Y, Z of right-handed axes.
    names_of_throws : place of the column that names the throw of each row, where the
        program has one; a row without a name is of no throw.
    """

    file: TextFile
    header: int
    separator: str | None
    headings: list[str]
    header_lines: tuple[str, ...] = ()
    has_frames: bool = False
    noted: list[Finding] = field(default_factory=list)
    objects: Mapping[str, Sequence[int]] = field(default_factory=dict)
    computed: Collection[int] = ()
    units: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    likelihoods: Mapping[int, Likelihood] = field(default_factory=dict)
    quaternions: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    names_of_throws: int | None = None

    @classmethod
    def at(cls, file: TextFile, header: int) -> Table:
        """The table whose header is the line of an index, behind a `#` perhaps."""
        line = file.lines[header].lstrip().removeprefix("#")
        return cls(
            file, header, separator_of(line), headings_in(line), (file.lines[header],)
        )

    @classmethod
    def find(
        cls, file: TextFile, knows: Callable[[Table], bool], expected: str = EXPECTED
    ) -> Table:
        """The table with the first header that a format `knows`, or the first line if
        it knows none; with what stands above and below the header.

        Raises
        ------
        DataError : the file is empty or begins with numbers.
        """
        first = file.head(expected)
        candidates = islice(_each_line_of_data(file, first), MOST_TITLES)
        for titles, header in enumerate(candidates):
            table = cls.at(file, header)
            if knows(table):
                if titles:
                    above = file.lines[first].strip(" ,;\t")
                    not_read = Finding.note(
                        "lines-above-the-header", count=titles, first=quoted(above)
                    )
                    table.noted.append(not_read)
                return table.with_units_below()._with_row_names()
        table = cls.at(file, first)
        if not all(map(is_number, table.headings)):
            return table
        comments = [index for index, _ in file.comments(first)]
        if comments:
            table_below_comment = cls.at(file, comments[-1])
            if knows(table_below_comment):
                return table_below_comment
        raise table.error(f"the table begins with numbers; {expected}")

    def error(self, message: str, options: tuple[Option, ...] = ()) -> DataError:
        """An error at the header, with options to type instead."""
        return self.file.error(message, self.header, options=options)

    def has(self, headings: Iterable[str]) -> bool:
        """Whether it has all of some headings, which a user has written."""
        wanted = {heading.strip().lower() for heading in headings}
        return wanted <= {heading.lower() for heading in self.headings}

    def sole(self, meanings: Sequence[str]) -> dict[str, int]:
        """The place of the column of each meaning; those without one, which is empty
        then, are left out.

        Raises
        ------
        DataError : two columns mean the same.
        """
        places: dict[str, int] = {}
        for place, meaning in enumerate(meanings):
            if not meaning:
                continue
            other = places.setdefault(meaning, place)
            if other != place:
                raise self.error(
                    f"columns {quoted(self.headings[other])} (column {other + 1}) and "
                    f"{quoted(self.headings[place])} (column {place + 1}) both mean "
                    f"{meaning}; rename or remove one"
                )
        return places

    @property
    def findings(self) -> list[Finding]:
        """What was read otherwise than it is written, in the header, in the rows and in
        the columns that were read."""
        _ = self.rows  # as they are read, what is left out is noted
        return self.noted

    @cached_property
    def rows(self) -> list[int]:
        """Indices of the lines of its rows. Raises `DataError` for none."""
        if self._plain is not None:
            return self._lines_of_rows
        return self._rows.lines

    @property
    def cells(self) -> list[list[str]]:
        """The cells of its rows."""
        return self._rows.cells

    @cached_property
    def _lines_of_rows(self) -> list[int]:
        """Indices of the lines below the header, without the rows of means and such at
        the end."""
        lines = lines_of_data(self.file, self.header + 1)
        below = self._aggregates_below(lines)
        if below:
            left_out = Finding.note(
                "rows-below-the-table",
                count=len(below),
                names=[quoted(_first_cell(self._cells_of(index))) for index in below],
                lines=[index + 1 for index in below],
            )
            self.noted.append(left_out)
            lines = lines[: -len(below)]
        if not lines:
            raise self.error("a header but no rows of numbers")
        return lines

    @cached_property
    def _rows(self) -> _Rows:
        """The rows; lines between them that are none are noted.

        Raises
        ------
        DataError : a row with a wrong number of cells.
        """
        width = self._width
        rows = _Rows([], [])
        between = []
        for index in self._lines_of_rows:
            row = self._cells_of(index)
            repeated = self.file.lines[index] in self.header_lines
            if repeated or self._is_remark(row):
                between.append(index)
                continue
            if any(row[width:]) and all(map(_begins_with_a_letter, row[width - 1 :])):
                remark = ", ".join(row[width - 1 :])  # a comma within words
                row = [*row[: width - 1], remark]
            if len(row) < width or any(row[width:]):
                raise self._wrong_width(index, row)
            if self.has_frames:
                row = [*row[:width], str(len(rows.lines))]
            rows.lines.append(index)
            rows.cells.append(row)
        if not rows.lines:
            raise self.error("a header but no rows of numbers")
        if between:
            texts = [quoted(_first_cell(self._cells_of(index))) for index in between]
            not_read = Finding.note(
                "lines-between-rows",
                count=len(between),
                texts=texts,
                lines=[index + 1 for index in between],
            )
            self.noted.append(not_read)
        return rows

    def _is_remark(self, row: Sequence[str]) -> bool:
        """Whether a row of a table of several columns has one cell alone, of words."""
        if len(self.headings) < 3 or row.count("") != len(row) - 1:
            return False
        text = next(filter(None, row))
        return len(text) > 1 and not any(map(str.isdigit, text)) and not is_gap(text)

    def _wrong_width(self, index: int, row: Sequence[str]) -> DataError:
        """The error of a row with another number of cells than the header."""
        width = self._width
        count = counted(len(row), "cell")
        fault = f"{count} where the header has {counted(width, 'column')}"
        if self.separator == "," and width < len(row) <= 2 * width:
            fault += (
                "; where numbers have decimal commas, separate the columns by "
                "semicolons"
            )
        return self.file.error(fault, index)

    def column(self, place: int) -> list[str]:
        """The cells of a column."""
        return [row[place] for row in self.cells]

    def is_numeric(self, place: int) -> bool:
        """Whether a column has numbers or gaps only, at least one number."""
        values = [cell for cell in self.column(place) if not is_gap(cell)]
        return bool(values) and all(
            is_number(cell) or is_grouped(cell) for cell in values
        )

    def numbers(self, places: Sequence[int]) -> list[Floats]:
        """Numbers in some columns, as written; gaps are NaN.

        Raises
        ------
        DataError : a row with a wrong number of cells, or a cell that is not a finite
            number.
        """
        if self._plain is not None:
            return list(self._plain[:, list(places)].T.copy())
        columns = [self.column(place) for place in places]
        decimal_comma = self.separator != "," or not any(
            "." in cell for column in columns for cell in column
        )
        values = [numbers_in(column, decimal_comma=decimal_comma) for column in columns]
        values = self._without_thousands(columns, values, decimal_comma=decimal_comma)
        for place, numbers in zip(places, values, strict=True):
            if None in numbers:
                raise self.not_a("finite number", numbers.index(None), place)
        self.note_gaps(places)
        return [np.array(numbers, float) for numbers in values]

    def _without_thousands(
        self,
        columns: Sequence[Sequence[str]],
        values: list[list[float | None]],
        *,
        decimal_comma: bool,
    ) -> list[list[float | None]]:
        """The numbers of columns with a mark between thousands, if there is one with
        which all cells are numbers; the values as they are, if there is none.

        Parameters
        ----------
        values : the numbers without regard to such marks; None for what is none.
        """
        by_column = map(thousands_of_whole_numbers, columns)
        thousands = next(filter(None, by_column), None)
        if thousands is None and any(None in numbers for numbers in values):
            thousands = thousands_that_bar(columns, decimal_comma=decimal_comma)
        if thousands is None:
            return values
        mark = thousands.mark
        without_marks = [numbers_in(column, mark) for column in columns]
        if any(None in numbers for numbers in without_marks):
            return values
        note = Finding.note(
            "thousands",
            mark=quoted(mark),
            cell=quoted(thousands.example),
            number=without_groups(thousands.example, mark),
        )
        self.noted.append(note)
        return without_marks

    def not_a(self, expected: str, row: int, place: int) -> DataError:
        """The error of a cell that is not what was expected."""
        cell = self.cells[row][place]
        fault = f"{quoted(cell)} found, expected a {expected}"
        return self.file.error(fault, self.rows[row], self.headings[place])

    def note_gaps(self, places: Sequence[int]) -> None:
        """Say that some columns have cells with a word for a value that was lost."""
        lost = [
            cell
            for place in places
            for cell in self.column(place)
            if cell[:1] not in _OF_NUMBERS
            and (cell.lower() in LOST or (cell[:1] == "#" and is_gap(cell)))
        ]
        if lost:
            gaps = Finding.note("gaps", count=len(lost), cell=quoted(lost[0]))
            self.noted.append(gaps)

    def clock(
        self, place: int, frame_rate: float | None, day_first: bool | None
    ) -> ClockTimes | None:
        """The clock times of a column; None of another. The choices are those of
        `clock_times`.

        Raises
        ------
        DataError : a cell of such a column is not a clock time, or these have two
            meanings.
        """
        if self._plain is not None:
            return None
        column = self.column(place)
        if not any(":" in cell for cell in column):
            return None
        try:
            times = clock_times(column, frame_rate=frame_rate, day_first=day_first)
        except AmbiguousTimesError as error:
            options = " or ".join(map(str, error.options))
            raise self.file.error(
                f"{error}; give {options}",
                self.rows[0],
                self.headings[place],
                options=error.options,
            ) from None
        if not times.first:
            return None
        if times.bad:
            raise self.not_a("clock time as in other rows", times.bad[0], place)
        return times

    @cached_property
    def _plain(self) -> Floats | None:
        """All cells, shape (rows, columns), if they are numbers that mean what they
        say. It is the usual table, and the quickest to read."""
        lines = [self.file.lines[index] for index in self._lines_of_rows]
        with suppress(ValueError):  # of anything but numbers
            values = np.loadtxt(lines, delimiter=self.separator, comments=None, ndmin=2)
            if values.shape[1] != self._width or np.isinf(values).any():
                return None
            if self._may_have_thousands(values):
                return None
            frames = np.arange(len(values))
            return np.column_stack([values, frames]) if self.has_frames else values
        return None

    def _may_have_thousands(self, values: Floats) -> bool:
        """Whether a column may have points between thousands: whole numbers of three
        digits, but for some with three decimals. The first rows tell it of almost all
        columns that have none."""
        if not _may_be_grouped(values[:_FIRST_ROWS]).any():
            return False
        is_whole = values == np.round(values)
        size = np.abs(values)
        of_three_digits = is_whole & (size >= 100) & (size < 1000)
        suspects = _may_be_grouped(values) & of_three_digits.any(0) & ~is_whole.all(0)
        return bool(suspects.any())

    def _cells_of(self, index: int) -> list[str]:
        """The cells of a line."""
        return cells(self.file.lines[index], self.separator)

    def with_units_below(self) -> Table:
        """The table with the units of a second row in its headings, if this has
        units alone."""
        index = next(_each_line_of_data(self.file, self.header + 1), None)
        if index is None:
            return self
        row = header_cells(self.file.lines[index], self.separator)
        while len(row) > len(self.headings) and not row[-1]:
            row.pop()
        units = ["" if cell.lower() in GAPS else cell.strip("()[] ") for cell in row]
        if len(units) != len(self.headings) or any(map(is_number, row)):
            return self
        if not any(map(is_unit, units)):
            return self
        headings = [
            f"{heading} ({unit})" if unit else heading
            for heading, unit in zip(self.headings, units, strict=True)
        ]
        header_lines = (*self.header_lines, self.file.lines[index])
        return replace(self, header=index, headings=headings, header_lines=header_lines)

    def with_frames(self) -> Table:
        """The table with the numbers of its rows as a further column: each row is a
        frame of a film."""
        frame = len(self.headings)
        return replace(
            self,
            headings=[*self.headings, "frame"],
            objects={name: [*of, frame] for name, of in self.objects.items()},
            has_frames=True,
        )

    @property
    def _width(self) -> int:
        """Number of columns of the file."""
        return len(self.headings) - int(self.has_frames)

    def _with_row_names(self) -> Table:
        """The table with an empty heading for names of rows, as R writes them: each row
        has one cell more than the header, and they begin with text in quotes or
        count on."""
        first_rows = lines_of_data(self.file, self.header + 1, MOST_TITLES)
        width = len(self.headings) + 1
        names = []
        for index in first_rows:
            row = self._cells_of(index)
            if len(row) != width or not row[-1]:
                return self
            names.append(row[0])
        if not names:
            return self
        in_quotes = all(
            self.file.lines[index].lstrip()[:1] == '"' for index in first_rows
        )
        if not in_quotes and not _counts_on(names):
            return self
        return replace(self, headings=["", *self.headings])

    def _aggregates_below(self, rows: Sequence[int]) -> list[int]:
        """The rows at the end that are no data: of means, sums and such by their names
        in the first cell, and of formulas."""
        if not rows:
            return []
        # In a table whose rows have names of people, Max is one of them.
        numbered = is_number(_first_cell(self._cells_of(rows[0])))
        below: list[int] = []
        certain = False
        for index in reversed(rows[-_MOST_BELOW:]):
            row = self._cells_of(index)
            name = _first_cell(row).lower().strip(" :.")
            if name in _AGGREGATES or any(cell[:1] == "=" for cell in row):
                certain = True
            elif name not in _MAY_BE_NAMES or not numbered:
                break
            below.insert(0, index)
        return below if certain else []


def _begins_with_a_letter(cell: str) -> bool:
    """Whether a cell is a word, as of a remark."""
    return cell[:1].isalpha()


def _counts_on(names: Sequence[str]) -> bool:
    """Whether names are whole numbers in order, one after another."""
    if not names or not all(name.isdigit() for name in names):
        return False
    numbers = list(map(int, names))
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _may_be_grouped(values: Floats) -> Booleans:
    """Of each column whether points may separate thousands in its numbers, which were
    read as decimal points."""
    size = np.abs(values)
    is_whole = size == np.round(size)
    below_1000 = np.minimum(size, 1000.0)
    thousandths = np.abs(1000 * below_1000 - np.round(1000 * below_1000)) < 1e-6
    grouped = is_whole | ((size >= 1) & (size < 1000) & thousandths)
    return np.asarray(grouped.all(0))


def _first_cell(row: Sequence[str]) -> str:
    """The first cell that is not empty; empty if all are."""
    return next(filter(None, row), "")


def lines_of_data(file: TextFile, begin: int, most: int | None = None) -> list[int]:
    """Indices of lines from one on that are no comments and not blank."""
    if most is None:
        lines = file.lines
        return [k for k in range(begin, len(lines)) if not is_aside(lines[k])]
    return list(islice(_each_line_of_data(file, begin), most))


def _each_line_of_data(file: TextFile, begin: int) -> Iterator[int]:
    """Indices of the lines of data from one on, found as they are asked for."""
    for index in range(begin, len(file.lines)):
        if not is_aside(file.lines[index]):
            yield index
