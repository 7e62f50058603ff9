"""CSV files of OptiTrack's Motive, of rigid bodies and markers seen by many cameras.

The first line has names and values of the take, such as `Length Units,Meters`. Below it
are lines of the type, the name and the ID of what each column belongs to (in some
versions also its parent), then what it is (Rotation, Position, Mean Marker Error), and
the header `Frame, Time (Seconds), X, Y, Z, W, X, Y, Z ...`
(docs.optitrack.com, "Data Export: CSV"). Axes are right-handed and y points up, unless
the export was made with others. Seen from above, x is then 90 degrees counter-clockwise
of z, as y is of x in curlfit: z is read as x, and x as y.
"""

from __future__ import annotations

from dataclasses import replace

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import quoted
from curlfit.throws.readers.cells import headings_in
from curlfit.throws.readers.columns import units_of
from curlfit.throws.readers.objects import places_by_name
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table, lines_of_data
from curlfit.throws.readers.text import TextFile

_MOST_ABOVE_HEADER = 8


def _recognizes(head: list[str]) -> bool:
    """Whether a file begins with the names and values of a take."""
    return headings_in(head[0])[:1] == ["Format Version"] and "Take Name" in head[0]


def _table(file: TextFile) -> Table:
    """The table with each rigid body and each marker as an object."""
    first = file.head()
    above = lines_of_data(file, first, _MOST_ABOVE_HEADER)
    header = next((k for k in above if headings_in(file.lines[k])[0] == "Frame"), None)
    if header is None or above.index(header) < 4:
        raise file.error(
            "expected lines of types, names and kinds of columns, and then a header "
            "Frame, Time (Seconds), X, Y, Z",
            first,
        )
    types = headings_in(file.lines[above[1]])
    names = headings_in(file.lines[above[2]])
    kinds = headings_in(file.lines[above[above.index(header) - 1]])
    table = Table.at(file, header)
    # the mean error of a rigid body may have no heading
    headings = table.headings + [""] * (len(types) - len(table.headings))
    names_of_columns = []
    rotations: dict[str, dict[str, int]] = {}
    for column, (type, name, kind, heading) in enumerate(
        zip(types, names, kinds, headings, strict=False)
    ):
        owner = f"{name} ({type.lower()})"
        names_of_columns.append(owner if kind == "Position" else "")
        if kind == "Rotation":
            rotations.setdefault(owner, {})[heading] = column
    objects = {
        owner: [0, 1, *columns]  # with the frame and the time
        for owner, columns in places_by_name(names_of_columns).items()
    }
    quaternions = {
        owner: parts
        for owner, parts in rotations.items()
        if parts.keys() == set("WXYZ")
    }
    axes = Finding.note(
        "y-points-up",
        Remedy("z-points-up", Option("columns", '"x=X, y=Y"')),
        program="Motive",
    )
    notes = [axes]
    if rotations and not quaternions:
        notes.append(Finding.note("rotation-not-used"))
    return replace(
        table,
        headings=headings,
        objects=objects,
        columns={"x": "Z", "y": "X"},
        units=_units(file, first),
        quaternions=quaternions,
        noted=notes,
    )


def _units(file: TextFile, first: int) -> str:
    """The unit of lengths that the first line states, in m where it states none."""
    values = headings_in(file.lines[first])
    pairs = dict(zip(values[::2], values[1::2], strict=False))
    unit = pairs.get("Length Units", "Meters")
    if unit.lower() not in units_of("x"):
        raise file.error(f"Length Units {quoted(unit)}: unknown unit", first)
    return f"length={unit}"


OPTITRACK = layout("optitrack", _recognizes, _table)
