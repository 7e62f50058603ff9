"""Several objects side by side in a table, such as a stone and a mark on its handle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from curlfit.errors import InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, quantities_of
from curlfit.throws.readers.format import Contents, choose
from curlfit.throws.readers.headings import Headings
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.path_columns import read_columns
from curlfit.throws.readers.table import Table

_AXES = {"x": "x", "y": "y", "u": "x", "v": "y"}


def places_by_name(names: Sequence[str]) -> dict[str, list[int]]:
    """The places of the columns of each object, from the names of all columns; one
    without a name is of no object."""
    places: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        if name:
            places.setdefault(name, []).append(place)
    return places


def objects_of(table: Table, file: ParsedFile, reading: Reading) -> Contents:
    """The objects of a table; one that marks the handle is no throw by itself.

    Parameters
    ----------
    file : with its settings, without columns.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    InputError : there is no such object as the handle.
    """
    names = list(table.objects)

    def parse(index: int) -> ParsedFile:
        parsed = file.copy()
        if len(names) > 1:
            parsed.notes.append(_of_several(names, index, reading))
        elif names[0]:
            parsed.notes.append(Finding.note("object", name=names[0]))
        columns = _columns(parsed, table, table.objects[names[index]], reading)
        if reading.handle is not None:
            columns |= _handle(table, names, index, columns, reading.handle)
        elif names[index] in table.quaternions:
            columns |= _rotation(table, columns, table.quaternions[names[index]])
        read_columns(parsed, table, columns, reading)
        return _where_marked(parsed, names[index])

    alone = [
        index
        for index in range(len(names))
        if len(names) == 1 or index + 1 != reading.handle
    ]
    return Contents(names, parse, alone)


def _of_several(names: Sequence[str], index: int, reading: Reading) -> Finding:
    """The note that one of several objects is read."""
    remedies = [Remedy("selects-another", Option("stone-index", "N"))]
    if not reading.handle:
        remedies.append(Remedy("marks-the-handle", Option("handle", "N")))
    listed = [{"number": number, "name": name} for number, name in enumerate(names, 1)]
    return Finding.note(
        "one-of-objects",
        *remedies,
        count=len(names),
        objects=listed,
        taken=index + 1,
        name=names[index],
    )


def _columns(
    parsed: ParsedFile, table: Table, of_object: Sequence[int], reading: Reading
) -> dict[int, Column]:
    """Columns of one object, by place; those that are ignored or left out are noted.

    Parameters
    ----------
    of_object : places of its columns.
    """
    quantities = quantities_of([table.headings[place] for place in of_object])
    candidates = list(of_object)
    if "t" not in quantities:
        for place, heading in enumerate(table.headings):
            if quantities_of([heading]) == ["t"]:
                candidates.insert(0, place)  # one column of times for all
                break
    headings_of_user = {**parsed.settings.get("columns", {}), **reading.columns}
    wanted = {heading.strip().lower() for heading in headings_of_user.values()}
    computed: list[int] = []
    if {"x", "y"} <= set(quantities):  # else v is that of pixels u, v
        computed = [
            place
            for place in candidates
            if place in table.computed and table.headings[place].lower() not in wanted
        ]
    if computed:
        left_out = [table.headings[place] for place in computed]
        parsed.notes.append(Finding.note("computed-by-tracker", columns=left_out))
        candidates = [place for place in candidates if place not in computed]
    headings = Headings(
        [table.headings[place] for place in candidates],
        table.error,
        lambda index: table.is_numeric(candidates[index]),
    )
    columns = headings.of_throw(parsed, reading)
    return {candidates[index]: column for index, column in columns.items()}


def _handle(
    table: Table,
    names: Sequence[str],
    stone: int,
    columns: Mapping[int, Column],
    number: int,
) -> dict[int, Column]:
    """Columns of the object that marks the handle, by place: those with the headings
    of the stone's `columns` of positions.

    Raises
    ------
    InputError : it is the stone itself, or has no position.
    """
    handle = choose("object", "--handle", number, names, 0)
    if handle == stone:
        raise InputError(
            f"--handle {number} is the stone itself; expected another object"
        )
    columns_of_stone = {
        table.headings[place].lower(): column
        for place, column in columns.items()
        if column.quantity in _AXES
    }
    columns_of_mark = {}
    for place in table.objects[names[handle]]:
        column = columns_of_stone.get(table.headings[place].lower())
        if column is not None:
            axis = _AXES[column.quantity]
            columns_of_mark[place] = column._replace(quantity=f"{axis}_mark")
    if len(columns_of_mark) != 2:
        raise InputError(f"--handle {number}: {names[handle]} has no columns x and y")
    return columns_of_mark


def _rotation(
    table: Table, columns: Mapping[int, Column], parts: Mapping[str, int]
) -> dict[int, Column]:
    """Columns of a rotation about the axis that is neither x nor y, by place; none if
    the positions are not on two of the axes, or if there is an angle already.

    Parameters
    ----------
    columns : of the positions. parts : places of the parts of the quaternion.
    """
    axis_of = {
        column.quantity: table.headings[place] for place, column in columns.items()
    }
    on_ice = [axis_of.get("x", ""), axis_of.get("y", "")]
    other_axes = set("XYZ") - set(on_ice)
    if "phi" in axis_of or len(other_axes) != 1:
        return {}
    vertical = other_axes.pop()
    scalar_part = parts["W"]
    vertical_part = parts[vertical]
    if "".join(on_ice) not in ("XY", "YZ", "ZX"):
        # Seen from the other side the angle has the other sign. The angle is twice
        # atan2(vertical, scalar), and that of exchanged parts a constant minus it.
        scalar_part, vertical_part = vertical_part, scalar_part
    return {
        scalar_part: Column("quaternion_scalar", "", 1.0),
        vertical_part: Column("quaternion_vertical", "", 1.0),
    }


def _where_marked(parsed: ParsedFile, name: str) -> ParsedFile:
    """The rows in which the object is marked, as it is not in some frames."""
    channels = [
        series.values
        for series in parsed.series
        if not series.column.quantity.endswith("_mark") and series.column.base != "t"
    ]
    marked = np.asarray(np.isfinite(channels).any(axis=0))
    if marked.all() or not marked.any():
        return parsed
    without = Finding.note(
        "rows-without-the-object", count=int((~marked).sum()), name=name
    )
    parsed.notes.append(without)
    return parsed.rows(marked)
