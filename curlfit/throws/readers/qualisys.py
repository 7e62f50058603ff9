"""TSV files of Qualisys Track Manager (QTM), of markers seen by many cameras.

Lines of a name and its values, such as `FREQUENCY 100` and `MARKER_NAMES`, precede the
header `Frame, Time, stone X, stone Y, stone Z, handle X ...`. Positions are in mm,
which the file does not say (docs.qualisys.com, QTM, "Motion data (.tsv)"); z points up.
"""

from __future__ import annotations

import re
from dataclasses import replace

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.throws.readers.columns import unit_of_frames
from curlfit.throws.readers.objects import places_by_name
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table, lines_of_data
from curlfit.throws.readers.text import TextFile

_MOST_ABOVE_HEADER = 200
"""Lines; each event of a capture has one."""
_COORDINATE = re.compile(r"(?P<marker>.+) (?P<axis>[XYZ])")


def _recognizes(head: list[str]) -> bool:
    """Whether a file begins with names and values of QTM, among them of markers."""
    names = {line.split("\t")[0] for line in head}
    return {"NO_OF_FRAMES", "MARKER_NAMES"} <= names


def _table(file: TextFile) -> Table:
    """The table with each marker as an object."""
    first = file.head()
    frames = ""
    for index in lines_of_data(file, first, _MOST_ABOVE_HEADER):
        name, _, value = file.lines[index].partition("\t")
        if name == "FREQUENCY":
            frames = unit_of_frames(value.strip())
        if name in ("Frame", "Time"):
            table = Table.at(file, index)
            break
    else:
        raise file.error(
            "no line of headings Frame, Time ... below the names of the markers; "
            "export with times and headings of columns",
            first,
        )
    markers = []
    headings = []
    for heading in table.headings:
        coordinate = _COORDINATE.fullmatch(heading)
        markers.append(coordinate["marker"] if coordinate else "")
        headings.append(coordinate["axis"] if coordinate else heading)
    # The frame and the time stand before the first marker.
    first_marker = next((column for column, name in enumerate(markers) if name), 0)
    units = "length=mm"
    if "Time" not in headings and frames:
        units += f",t={frames}"
    in_mm = Finding.note(
        "unit-of-the-program",
        Remedy("another-unit", Option("units", "length=UNIT")),
        program="QTM",
        unit="mm",
    )
    return replace(
        table,
        headings=headings,
        objects={
            name: [*range(first_marker), *columns]
            for name, columns in places_by_name(markers).items()
        },
        units=units,
        noted=[in_mm],
    )


QUALISYS = layout("qualisys", _recognizes, _table)
