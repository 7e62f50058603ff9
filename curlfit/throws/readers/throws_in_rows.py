"""The throws in a table of several: named by a column, or one after another."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from curlfit.findings import Finding
from curlfit.throws.readers.cells import is_gap
from curlfit.throws.readers.format import Contents
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.words import WORDS

_NAMES = set(WORDS["throws"].split())
_WORDS = re.compile(r"[a-z]+")
_FEWEST = 5
"""Rows of a throw."""


def may_name(header: str) -> bool:
    """Whether a column of this header may name the throw of each row."""
    parts = set(_WORDS.findall(header.lower()))
    return bool(parts & _NAMES) and parts <= _NAMES | {"nr", "no", "number", "index"}


def throws_of(parsed: ParsedFile, words: Mapping[str, Sequence[Any]]) -> Contents:
    """The throws in a table.

    A column such as `stone`, `throw_id` or `track` names them. Without one, a new throw
    begins where the times start again, or where the stone is back at the start from one
    row to the next.

    Parameters
    ----------
    words : cells, by header, of the columns that are not data of a throw.
    """
    header, groups = _by_column(words, len(parsed.series[0].values))
    if groups:
        parsed = replace(
            parsed, ignored=[name for name in parsed.ignored if name != header]
        )
    else:
        groups = _by_restart(parsed)
    if len(groups) < 2:
        return Contents([""], lambda _: parsed)
    return _contents(parsed, groups)


def throws_named(parsed: ParsedFile, heading: str, cells: Sequence[str]) -> Contents:
    """The throws in a table whose program names that of each row in a column.

    Parameters
    ----------
    heading, cells : of the column; a row with a gap there is of no throw.
    """
    parsed.ignored = [name for name in parsed.ignored if name != heading]
    groups: dict[str, list[int]] = {}
    for row, cell in enumerate(cells):
        if not is_gap(cell):
            groups.setdefault(f"{heading} {cell}", []).append(row)
    rows_of_no_throw = len(cells) - sum(map(len, groups.values()))
    if rows_of_no_throw:
        left_out = Finding.note(
            "rows-of-no-throw", count=rows_of_no_throw, column=heading
        )
        parsed.notes.append(left_out)
    if not groups:
        raise parsed.error("no row names its throw", quantity=heading)
    if len(groups) == 1:
        rows = np.array(*groups.values())
        return Contents([""], lambda _: parsed.rows(rows))
    return _contents(parsed, {name: np.array(rows) for name, rows in groups.items()})


def _contents(parsed: ParsedFile, groups: Mapping[str, np.ndarray]) -> Contents:
    """Several throws, from the rows of each by its name."""
    throws = list(groups.items())

    def parse(index: int) -> ParsedFile:
        name, rows = throws[index]
        selected = parsed.rows(rows)
        one_of_several = Finding.note(
            "one-of-throws", count=len(throws), taken=index + 1, name=name
        )
        selected.notes.append(one_of_several)
        return selected

    return Contents([f"{name} ({len(rows)} rows)" for name, rows in throws], parse)


def _by_column(
    words: Mapping[str, Sequence[Any]], n: int
) -> tuple[str, dict[str, np.ndarray]]:
    """The column that names several throws, and the rows of each; empty if
    there is none."""
    for header, cells in words.items():
        if not may_name(header):
            continue
        names = np.array([str(cell).strip() for cell in cells])
        listed = [name for name in dict.fromkeys(names.tolist()) if name]
        if 2 <= len(listed) <= n / _FEWEST:
            return header, {
                f"{header} {name}": np.flatnonzero(names == name) for name in listed
            }
    return "", {}


def _by_restart(parsed: ParsedFile) -> dict[str, np.ndarray]:
    """Rows of each throw if the times start again, or if they run on while the stone is
    back at the start; empty if there is one throw."""
    values = {series.column.quantity: series.values for series in parsed.series}
    if "t" not in values:
        return {}
    times = values["t"]
    if len(times) < 2 * _FEWEST:
        return {}
    again = np.flatnonzero(np.diff(times) < 0) + 1
    if len(again) == 1 and _one_time_is_odd(times, int(again[0])):
        return {}
    begins = again if len(again) else _returns(values)
    if not len(begins):
        return {}
    pieces = np.split(np.arange(len(times)), begins)
    if min(map(len, pieces)) < _FEWEST:
        return {}
    if len(again):
        # Each begins within the first fifth of the previous one, unlike rows that are
        # merely out of order.
        for earlier, later in pairwise(pieces):
            began = times[earlier[0]]
            ended = times[earlier[-1]]
            if not times[later[0]] < began + 0.2 * (ended - began):
                return {}
    lines = parsed.lines
    if lines is None:
        return {f"from row {rows[0] + 1}": rows for rows in pieces}
    return {f"from line {lines[rows[0]]}": rows for rows in pieces}


def _one_time_is_odd(times: np.ndarray, again: int) -> bool:
    """Whether times that go back once grow again where the row before, or the row
    itself, is left out."""
    without_row_before = np.delete(times, again - 1)
    without_row = np.delete(times, again)
    return bool(
        (np.diff(without_row_before) > 0).all() or (np.diff(without_row) > 0).all()
    )


def _returns(series: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rows in which the stone is back at the start: from the one before it has gone
    back by more than half the length of the path; none if it is ever as far ahead."""
    x = series.get("x", series.get("u"))
    y = series.get("y", series.get("v"))
    none = np.array([], int)
    if x is None or y is None:
        return none
    rows = np.flatnonzero(np.isfinite(x + y))
    if not len(rows):
        return none
    positions = np.stack([x[rows], y[rows]])
    step = np.diff(positions)
    length = np.hypot(*np.ptp(positions, axis=1))
    last = np.flatnonzero(np.hypot(*step) > 0.5 * length)  # before each such step
    if not len(last):
        return none
    first = np.append(0, last + 1)[:-1]  # of the rows since the step before
    way = positions[:, last] - positions[:, first]
    back = (way * step[:, last]).sum(0) < 0
    return rows[last + 1] if back.all() else none
