"""Tables of a path: text with a header and settings in leading `#` lines, curlfit's
own format, and the exports of other programs whose headers a layout finds.

A table may hold several throws, one after another or named by a column, or several
objects side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

from curlfit.errors import DataError
from curlfit.findings import Finding
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import frame_rate, parse_units
from curlfit.throws.readers.comments import headings_named_in
from curlfit.throws.readers.format import Contents, Format
from curlfit.throws.readers.headings import Headings, has_clock
from curlfit.throws.readers.objects import objects_of
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.path_columns import read_columns
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile
from curlfit.throws.readers.throws_in_rows import (
    may_name,
    throws_named,
    throws_of,
)


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The throws of a text table. With frames as the unit of time, each row of a table
    without times is a frame.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    """
    table = Table.find(file, lambda table: _has_path(table, reading))
    return contents_of(table, ParsedFile.begin(file, TABLE.name, table.header), reading)


def _has_path(table: Table, reading: Reading) -> bool:
    """Whether the headings are those of a path, as the user or the file names them."""
    with suppress(DataError):
        named = headings_named_in(table.file, table.header)
        timed = _timed(table, reading, named)
        Headings(timed.headings, table.error).columns(reading, named)
        return True
    return False


def _timed(table: Table, reading: Reading, named: Mapping[str, str]) -> Table:
    """The table, with each row as a frame if it has no column of times and frames are
    the unit of time.

    Parameters
    ----------
    named : headings that the file names, by quantity.
    """
    unit = parse_units(reading.units).get("t", "")
    times_are_named = "t" in named or "t" in reading.columns
    if frame_rate(unit) is None or times_are_named or has_clock(table.headings):
        return table
    return table.with_frames()


TABLE = Format(
    name="table",
    recognizes=lambda _: True,
    contents=_contents,
    what="throw",
    selected_by="stone_index",
    usual=None,
    selections=("stone_index", "columns"),
    jointly=True,
)


def layout(
    name: str,
    recognizes: Callable[[list[str]], bool],
    table_of: Callable[[TextFile], Table],
    *,
    throws_in_rows: bool = False,
) -> Format:
    """The format of tables that another program exports, whose header is another one
    than the first line that curlfit knows.

    Parameters
    ----------
    name, recognizes : as of a `Format`.
    table_of : finds the header and, where several are side by side, the objects.
    throws_in_rows : whether it holds throws one below the other, not objects side by
        side of which the first is usual.
    """

    def contents(file: TextFile, reading: Reading) -> Contents:
        table = table_of(file)
        return contents_of(table, ParsedFile.begin(file, name, table.header), reading)

    if throws_in_rows:
        return TABLE._replace(name=name, recognizes=recognizes, contents=contents)
    return Format(
        name=name,
        recognizes=recognizes,
        contents=contents,
        what="object",
        selected_by="stone_index",
        usual=0,
        selections=("stone_index", "handle", "columns"),
    )


def contents_of(table: Table, parsed: ParsedFile, reading: Reading) -> Contents:
    """The throws in a table.

    Parameters
    ----------
    parsed : with the settings of the file, without columns.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    """
    # What the user says overrides the file, and this what its program says elsewhere.
    columns_of_file = {**table.columns, **parsed.settings.get("columns", {})}
    if columns_of_file or table.units:
        units = ",".join(filter(None, [table.units, reading.units])) or None
        columns_named = {**columns_of_file, **reading.columns}
        reading = replace(reading, units=units, columns=columns_named)
    table = _timed(table, reading, {})
    if table.has_frames:
        parsed.notes.append(Finding.note("rows-are-frames"))
    if table.objects:
        return objects_of(table, parsed, reading)
    headings = Headings(table.headings, table.error, table.is_numeric)
    columns = headings.of_throw(parsed, reading)
    read_columns(parsed, table, columns, reading)
    if table.names_of_throws is not None:
        place = table.names_of_throws
        return throws_named(parsed, table.headings[place], table.column(place))
    names = {
        heading: table.column(place)
        for place, heading in enumerate(table.headings)
        if place not in columns and may_name(heading)
    }
    return throws_of(parsed, names)
