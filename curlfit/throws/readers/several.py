"""Several throws in one table: named by a column, or one after another."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from curlfit.throws.readers.parsed_file import Contents, ParsedFile

_NAMES = {
    "stone", "throw", "shot", "track", "trial", "run", "object", "id", "label", "name", "colour",
    "color", "particle", "delivery", "end",
}  # fmt: skip
_WORDS = re.compile(r"[a-z]+")
_FEWEST = 5  # rows of a throw


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
