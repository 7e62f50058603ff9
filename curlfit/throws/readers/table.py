"""curlfit's own format: a table of text with a header, and settings in leading `#` lines."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from curlfit.errors import DataError
from curlfit.throws.readers.defaults import defaults_of
from curlfit.throws.readers.parsed_file import Reading, columns_of, in_si
from curlfit.throws.readers.text import (
    EXPECTED,
    cells,
    header_cells,
    is_number,
    read_rows,
    separator_of,
)


def first_lines(path: Path, lines: list[str]) -> tuple[int, list[tuple[int, str]]]:
    """Index of the first line that is no comment, and the comments before it with their numbers.

    Raises
    ------
    DataError : the file is empty, or holds comments only.
    """
    comments: list[tuple[int, str]] = []
    for index, line in enumerate(lines):
        if not line or line.isspace():
            continue
        if not line.lstrip().startswith("#"):
            return index, comments
        comments.append((index + 1, line))
    what = "the file holds comments only" if comments else "the file is empty"
    raise DataError(f"{what}; {EXPECTED}", file=path)


def read_table(
    path: Path, lines: list[str], units: Mapping[str, str], *, pixels: bool = False
) -> Reading:
    """Columns of a text table.

    Raises
    ------
    DataError : naming the line and column of the fault, and what was expected.
    """
    header, comments = first_lines(path, lines)
    settings, reference, notes = defaults_of(path, comments)
    separator = separator_of(lines[header])
    names = header_cells(lines[header], separator)
    if all(is_number(cell) for cell in cells(lines[header], separator)):
        raise DataError(f"the table begins with numbers; {EXPECTED}", file=path, line=header + 1)
    columns, ignored = columns_of(path, names, units, line=header + 1, pixels=pixels)
    numbers, values = read_rows(path, lines, header + 1, names, list(columns), separator)
    if not len(numbers):
        raise DataError("a header but no rows of numbers", file=path, line=header + 1)
    reading = Reading(path, "table", [], ignored, settings, reference, notes=notes, lines=numbers)
    reading.series = [
        in_si(reading, names[place], column, values[slot])
        for slot, (place, column) in enumerate(columns.items())
    ]
    return reading
