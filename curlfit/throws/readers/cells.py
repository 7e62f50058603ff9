"""The cells of a line of text: how they are separated, and which hold no value."""

from __future__ import annotations

import csv
import re

from curlfit.throws.readers.words import WORDS

GAPS = {"", *WORDS["gaps"].split()}
"""Cells without a value, among them the errors of spreadsheets."""
LOST = set(WORDS["lost"].split())
"""What people write for a value that was lost; a note says so."""
_IN_BRACKETS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
# "t (s)" in a table separated by spaces
_UNIT_APART = re.compile(r"[ \t]+([(\[][^()\[\]]*[)\]])")


def is_gap(cell: str) -> bool:
    """Whether a cell of a column of measurements holds no value."""
    word = cell.lower()
    return word in GAPS or word in LOST


def separator_of(line: str) -> str | None:
    """Separator of the cells of a header line; None for spaces."""
    bare = _IN_BRACKETS.sub("", line)
    for mark in ("\t", ";", ","):
        if mark in bare:
            return mark
    return None


def headings_in(line: str) -> list[str]:
    """The headings in a line, without empty ones at its end."""
    headings = header_cells(line, separator_of(line))
    while len(headings) > 1 and not headings[-1]:
        headings.pop()
    return headings


def header_cells(line: str, separator: str | None) -> list[str]:
    """Cells of a header; in a table separated by spaces, `t (s)` is one cell."""
    return cells(_UNIT_APART.sub(r"\1", line) if separator is None else line, separator)


def cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line, without surrounding spaces and quotation marks.

    A mark of inches, as in `3'6" left`, is no quotation mark, since these enclose
    a cell.
    """
    if separator is None:
        return [cell.strip('"') for cell in line.split()]
    parts = [part.strip() for part in line.split(separator)]
    if '"' not in line:
        return parts
    if all(_is_whole(part) for part in parts):
        return [
            part[1:-1].replace('""', '"') if part[:1] == '"' else part for part in parts
        ]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    except csv.Error:
        return parts


def _is_whole(part: str) -> bool:
    """Whether a part of a line has both of its quotation marks, or none."""
    return part[:1] != '"' or (len(part) > 1 and part[-1] == '"')
