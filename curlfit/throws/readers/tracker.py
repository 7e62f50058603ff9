"""Text exports of Tracker, the video tool of Open Source Physics.

A row with the name of the object, such as `mass_A`, precedes the header; several
objects are side by side. Tracker computes `v`, `ω` and the angles `θ_{r}`, `θ` of a
point mass from its positions, so these carry no further information on a stone, and
none on its rotation: they are left out. A measured angle or spin has another name
there, such as `phi`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from curlfit.errors import InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, parse_header
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.headings import Headings
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile, choose
from curlfit.throws.readers.table import read_columns, with_units_below
from curlfit.throws.readers.text import (
    TextFile,
    TextTable,
    cells,
    header_cells,
    is_number,
    separator_of,
)

_COMPUTED = re.compile(r"(v|ω|(θ|theta)_?\{?r\}?|θ)\s*([(\[].*)?")
# of an object, in a heading
_NUMBER = re.compile(r"(?<=[^\W\d])[ ._]?\d+(?=\s*([(\[].*)?$)")
# "v" alone is read as a speed
_AXES = {"x": "x", "y": "y", "u": "x", "v": "y", "speed": "y"}


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are a title and a header, or a header with
    two objects."""
    first = _header(head[0])
    if _known(first) >= 2:
        return min(map(_quantities(first).count, "xy")) > 1
    return (
        len(head) > 1
        and _known(_header(head[1])) >= 2
        and not any(map(is_number, first))
    )


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The objects of a Tracker export; one that marks the handle is no throw by itself.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    InputError : there is no such object as the handle.
    """
    first = file.head()
    table, titles, objects = _layout(file, first)
    labels = [title or f"object {k}" for k, title in enumerate(titles, 1)]

    def parse(index: int) -> ParsedFile:
        parsed = begun(file, "tracker", first)
        if len(objects) > 1:
            remedies = [Remedy("selects-another", Option("stone-index", "N"))]
            if not reading.handle:
                remedies.append(Remedy("marks-the-handle", Option("handle", "N")))
            taken = Finding.note(
                "one-of-objects",
                *remedies,
                count=len(objects),
                objects=[
                    {"number": number, "name": name}
                    for number, name in enumerate(labels, 1)
                ],
                taken=index + 1,
                name=labels[index],
            )
            parsed.notes.append(taken)
        elif titles[0]:
            parsed.notes.append(Finding.note("object", name=labels[0]))
        columns = _columns(parsed, table, objects[index], reading)
        if reading.handle is not None:
            flag = f"--handle {reading.handle}"
            handle = choose("object", "--handle", reading.handle, labels, 0)
            if handle == index:
                raise InputError(f"{flag} is the stone itself; expected another object")
            mark = _mark(table, objects[handle], columns)
            if len(mark) != 2:
                raise InputError(f"{flag}: {labels[handle]} has no columns x and y")
            columns |= mark
        read_columns(parsed, table, columns)
        # In some frames an object is not marked.
        channels = [
            series.values
            for series in parsed.series
            if not series.column.quantity.endswith("_mark")
            and series.column.quantity != "t"
        ]
        marked = np.asarray(np.isfinite(channels).any(axis=0))
        if marked.any() and not marked.all():
            without = Finding.note(
                "rows-without-the-object",
                count=int((~marked).sum()),
                name=labels[index],
            )
            parsed.notes.append(without)
            parsed = parsed.rows(marked)
        return parsed

    alone = [
        k for k in range(len(objects)) if len(objects) == 1 or k + 1 != reading.handle
    ]
    return Contents(labels, parse, alone)


TRACKER = Format(
    "tracker",
    _recognizes,
    _contents,
    "object",
    "stone_index",
    0,
    ("stone_index", "handle", "columns"),
)


def _columns(
    parsed: ParsedFile, table: TextTable, places: list[int], reading: Reading
) -> dict[int, Column]:
    """Columns of one object, by place; those that are ignored or left out are noted."""
    # one column of times for all
    if "t" not in _quantities([table.names[k] for k in places]):
        clocks = [
            k for k, name in enumerate(table.names) if _quantities([name]) == ["t"]
        ]
        places = [*clocks[:1], *places]
    quantities = _quantities([table.names[k] for k in places])
    headings_of_user = {**parsed.settings.get("columns", {}), **reading.columns}
    chosen = {heading.strip().lower() for heading in headings_of_user.values()}
    computed = [
        k
        for k in places
        if _COMPUTED.fullmatch(table.names[k]) and table.names[k].lower() not in chosen
    ]
    if not {"x", "y"} <= set(quantities):  # pixels u, v
        computed = []
    if computed:
        left_out = [table.names[k] for k in computed]
        parsed.notes.append(Finding.note("computed-by-tracker", columns=left_out))
    places = [k for k in places if k not in computed]
    names = [table.names[k] for k in places]
    headings = Headings(
        names, table.error, lambda index: table.is_numeric(places[index])
    )
    columns = headings.of_throw(parsed, reading)
    return {places[k]: column for k, column in columns.items()}


def _mark(
    table: TextTable, places: Sequence[int], columns: Mapping[int, Column]
) -> dict[int, Column]:
    """Columns of the second mark on a stone, by place; in the units of the
    stone's `columns`."""
    column_of_stone = {
        _AXES[column.quantity]: column
        for column in columns.values()
        if column.quantity in ("x", "y", "u", "v")
    }
    columns_of_mark = {}
    for place in places:
        quantities = _quantities([table.names[place]])
        axis = _AXES.get(quantities[0], "") if quantities else ""
        if axis in column_of_stone:
            column = column_of_stone[axis]._replace(quantity=f"{axis}_mark")
            columns_of_mark[place] = column
    return columns_of_mark


def _layout(file: TextFile, first: int) -> tuple[TextTable, list[str], list[list[int]]]:
    """The table, and the titles and the places of the columns of its objects: each
    begins at its title, or else where a quantity is repeated."""
    lines = file.lines
    header = first
    titles = [""]
    if _known(_header(lines[first])) < 2:
        below = range(first + 1, min(first + 5, len(lines)))
        header = next((k for k in below if lines[k].strip()), first)
    table = with_units_below(TextTable.at(file, header))
    table = replace(table, names=_without_numbers(table.names))
    if header != first:
        line = lines[first]
        titles = (
            [line.strip()] if table.separator is None else cells(line, table.separator)
        )
    starts = [k for k, title in enumerate(titles[: len(table.names)]) if title]
    if len(starts) < 2:
        starts = [0]
        names_of_object = set[str]()
        for place, name in enumerate(map(str.lower, table.names)):
            if name and name in names_of_object:
                starts.append(place)
                names_of_object.clear()
            names_of_object.add(name)
    ends = [*starts[1:], len(table.names)]
    starts[0] = 0
    title_of_objects = []
    places_of_objects = []
    for start, end in zip(starts, ends, strict=True):
        title_of_objects.append(next(filter(None, titles[start:end]), ""))
        places_of_objects.append(list(range(start, end)))
    return table, title_of_objects, places_of_objects


def _header(line: str) -> list[str]:
    """The headings in a line, without numbers of throws side by side."""
    return _without_numbers(header_cells(line, separator_of(line)))


def _without_numbers(names: list[str]) -> list[str]:
    """Headings of several throws side by side, `x1, y1, x2, y2` or
    `t, x, y, t.1, x.1, y.1`, as those of each; any others as they are."""
    plain = [_NUMBER.sub("", name) for name in names]
    quantities = _quantities(plain)
    if min(map(quantities.count, "xy")) < 2:
        return names
    all_are_numbered = "x" not in _quantities(names)
    whole = quantities.count("t") > 1 and not any(map(_COMPUTED.fullmatch, plain))
    return plain if all_are_numbered or whole else names


def _known(names: Sequence[str]) -> int:
    """How many of the quantities of a path the headings name."""
    return len({"t", "x", "y", "phi", "u", "v"} & set(_quantities(names)))


def _quantities(names: Sequence[str]) -> list[str]:
    """The quantities that headings name, without those of unknown meaning."""
    columns = map(parse_header, names)
    return [column.quantity for column in columns if column is not None]
