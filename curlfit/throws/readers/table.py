"""curlfit's own format: a text table with a header, and settings in leading `#` lines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, in_unit
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile, columns_of
from curlfit.throws.readers.several import contents_of, may_name_throws
from curlfit.throws.readers.text import TextFile, TextTable


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The throws of a text table.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    """
    parsed = begun(file, "table", file.head())
    table = TextTable.of(file)
    names = table.names
    columns, parsed.ignored = columns_of(names, reading, table.error)
    read_columns(parsed, table, columns)
    others = [k for k in range(len(names)) if k not in columns and may_name_throws(names[k])]
    return contents_of(parsed, {names[k]: table.column(k) for k in others})


TABLE = Format("table", lambda _: True, _contents, "throw", "stone_index", None, ("stone_index",))


def read_columns(
    parsed: ParsedFile,
    table: TextTable,
    columns: dict[int, Column],
    units: Callable[[dict[int, Column]], dict[int, Column]] = lambda columns: columns,
) -> None:
    """Add columns, by index, to a parsed file; those of clock times become seconds.

    Parameters
    ----------
    units : sets units that follow from those of other columns.

    Raises
    ------
    DataError : with the line and column of the fault.
    """
    clocks = table.clocks(k for k, column in columns.items() if column.base == "t")
    for k, (begin, _) in clocks.items():
        columns[k] = in_unit(columns[k].quantity, "s")
        parsed.notes.append(f"{table.names[k]}: clock times, taken as seconds since {begin}")
    plain = [k for k in columns if k not in clocks]
    values = dict(zip(plain, table.numbers(plain), strict=True))
    parsed.lines = np.asarray(table.rows, np.int64) + 1
    for k, column in units(columns).items():
        parsed.add(table.names[k], column, clocks[k][1] if k in clocks else values[k])
