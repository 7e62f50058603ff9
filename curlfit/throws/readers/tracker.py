"""Text exports of Tracker, the video tool of Open Source Physics, and tables of several
throws side by side.

A row with the name of the object, such as `mass_A`, precedes the header; several
objects are side by side. Tracker computes `v`, `ω` and the angles `θ_{r}`, `θ` of a
point mass from its positions, so these carry no further information on a stone, and
none on its rotation: they are left out. A measured angle or spin has another name
there, such as `phi`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from curlfit.throws.readers.cells import cells, headings_in
from curlfit.throws.readers.columns import quantities_of
from curlfit.throws.readers.numbers import is_number
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile

_COMPUTED = re.compile(r"(v|ω|(θ|theta)_?\{?r\}?|θ)\s*([(\[].*)?")
# of an object, in a heading
_NUMBER = re.compile(r"(?<=[^\W\d])[ ._]?\d+(?=\s*([(\[].*)?$)")
_MOST_BELOW_TITLES = 5
"""Lines from the titles to the header, of which the others are blank."""


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are a title and a header, or a header with
    two objects."""
    first = _header(head[0])
    if _names_a_path(first):
        quantities = quantities_of(first)
        return quantities.count("x") > 1 and quantities.count("y") > 1
    return (
        len(head) > 1
        and _names_a_path(_header(head[1]))
        and not any(map(is_number, first))
    )


def _table(file: TextFile) -> Table:
    """The table with its objects: each begins at its title, or else where a quantity is
    repeated."""
    lines = file.lines
    first = file.head()
    header = first
    if not _names_a_path(_header(lines[first])):
        below = range(first + 1, min(first + _MOST_BELOW_TITLES, len(lines)))
        header = next((k for k in below if lines[k].strip()), first)
    table = Table.at(file, header).with_units_below()
    headings = _without_numbers(table.headings)
    titles = [""]
    if header != first and table.separator is None:
        titles = [lines[first].strip()]
    elif header != first:
        titles = cells(lines[first], table.separator)
    starts = [column for column, title in enumerate(titles[: len(headings)]) if title]
    if len(starts) < 2:
        starts = _repetitions(headings)
    starts[0] = 0
    ends = [*starts[1:], len(headings)]
    objects = {}
    for number, (start, end) in enumerate(zip(starts, ends, strict=True), 1):
        title = next(filter(None, titles[start:end]), "")
        if title in objects or (not title and len(starts) > 1):
            title = f"object {number}"
        objects[title] = range(start, end)
    computed = {
        column for column, name in enumerate(headings) if _COMPUTED.fullmatch(name)
    }
    return replace(table, headings=headings, objects=objects, computed=computed)


TRACKER = layout("tracker", _recognizes, _table)


def _repetitions(headings: Sequence[str]) -> list[int]:
    """Where an object begins: at the first heading, and at each that the object before
    has too."""
    starts = [0]
    of_object = set[str]()
    for column, heading in enumerate(map(str.lower, headings)):
        if heading and heading in of_object:
            starts.append(column)
            of_object.clear()
        of_object.add(heading)
    return starts


def _header(line: str) -> list[str]:
    """The headings in a line, without numbers of throws side by side."""
    return _without_numbers(headings_in(line))


def _without_numbers(headings: list[str]) -> list[str]:
    """Headings of several throws side by side, `x1, y1, x2, y2` or
    `t, x, y, t.1, x.1, y.1`, as those of each; any others as they are."""
    plain = [_NUMBER.sub("", heading) for heading in headings]
    quantities = quantities_of(plain)
    if quantities.count("x") < 2 or quantities.count("y") < 2:
        return headings
    all_are_numbered = "x" not in quantities_of(headings)
    have_own_times = quantities.count("t") > 1
    some_are_computed = any(map(_COMPUTED.fullmatch, plain))
    if all_are_numbered or (have_own_times and not some_are_computed):
        return plain
    return headings


def _names_a_path(headings: Sequence[str]) -> bool:
    """Whether headings name two or more of the quantities of a path."""
    return len({"t", "x", "y", "phi", "u", "v"} & set(quantities_of(headings))) >= 2
