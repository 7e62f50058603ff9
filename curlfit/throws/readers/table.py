"""curlfit's own format: a text table with a header, and settings in leading `#` lines.

A table, also one in memory, may hold several throws: named by a column, or one after another.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, in_unit
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile, columns_of
from curlfit.throws.readers.text import TextFile, TextTable

_NAMES = {
    "stone", "throw", "shot", "track", "trial", "run", "object", "id", "label", "name", "colour",
    "color", "particle", "delivery", "end",
}  # fmt: skip
_WORDS = re.compile(r"[a-z]+")
_FEWEST = 5  # rows of a throw


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


def read_columns(parsed: ParsedFile, table: TextTable, columns: dict[int, Column]) -> None:
    """Add columns, by index, to a parsed file; those of clock times become seconds.

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
    values |= {k: seconds for k, (_, seconds) in clocks.items()}
    parsed.lines = np.asarray(table.rows, np.int64) + 1
    for k, column in columns.items():
        parsed.add(table.names[k], column, values[k])


def may_name_throws(header: str) -> bool:
    """Whether a column of this header may name the throw of each row."""
    parts = set(_WORDS.findall(header.lower()))
    return bool(parts & _NAMES) and parts <= _NAMES | {"nr", "no", "number", "index"}


def contents_of(parsed: ParsedFile, words: Mapping[str, Sequence[Any]]) -> Contents:
    """The throws in a table.

    A column such as `stone`, `throw_id` or `track` names them. Without one, a new throw begins
    where the times start again.

    Parameters
    ----------
    words : cells, by header, of the columns that are not data of a throw.
    """
    header, groups = _by_column(words, len(parsed.series[0].values))
    if header:
        parsed = replace(parsed, ignored=[name for name in parsed.ignored if name != header])
    else:
        groups = _by_restart(parsed)
    if len(groups) < 2:
        return Contents([""], lambda _: parsed)
    throws = list(groups.items())

    def parse(index: int) -> ParsedFile:
        name, rows = throws[index]
        found = parsed.rows(rows)
        found.notes.append(f"{len(throws)} throws; taken: {index + 1} {name}")
        return found

    return Contents([f"{name} ({len(rows)} rows)" for name, rows in throws], parse)


def _by_column(words: Mapping[str, Sequence[Any]], n: int) -> tuple[str, dict[str, np.ndarray]]:
    """The column that names several throws, and the rows of each; empty if there is none."""
    for header, cells in words.items():
        if not may_name_throws(header):
            continue
        names = np.array([str(cell).strip() for cell in cells])
        listed = [name for name in dict.fromkeys(names.tolist()) if name]
        if 2 <= len(listed) <= n / _FEWEST:
            return header, {f"{header} {name}": np.flatnonzero(names == name) for name in listed}
    return "", {}


def _by_restart(parsed: ParsedFile) -> dict[str, np.ndarray]:
    """Rows of each throw if the times start again; empty if they do not."""
    times = next((s.values for s in parsed.series if s.column.quantity == "t"), None)
    if times is None or len(times) < 2 * _FEWEST:
        return {}
    breaks = np.flatnonzero(np.diff(times) < 0) + 1
    pieces = np.split(np.arange(len(times)), breaks)
    if len(pieces) < 2 or min(map(len, pieces)) < _FEWEST:
        return {}
    # Each begins within the first fifth of the previous one, unlike rows merely out of order.
    for before, after in pairwise(pieces):
        began, ended = times[before[0]], times[before[-1]]
        if not times[after[0]] < began + 0.2 * (ended - began):
            return {}
    lines = parsed.lines
    return {
        f"from row {rows[0] + 1}" if lines is None else f"from line {lines[rows[0]]}": rows
        for rows in pieces
    }
