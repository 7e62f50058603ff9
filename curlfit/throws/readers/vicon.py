"""CSV files of Vicon Nexus (its ASCII export), of markers seen by many cameras.

A file has sections, each with its name, its rate in Hz, the names of its columns
(`subject:marker` above the first of X, Y and Z), the header `Frame, Sub Frame, X, Y, Z,
X ...`, a line of units, and rows up to an empty line. The positions of markers are the
section `Trajectories` (docs.vicon.com, Nexus user guide, "Export trial data to ASCII").
Frames count from the start of the trial. z points up.
"""

from __future__ import annotations

from dataclasses import replace

from curlfit.throws.readers.cells import headings_in
from curlfit.throws.readers.columns import unit_of_frames
from curlfit.throws.readers.objects import places_by_name
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table, lines_of_data
from curlfit.throws.readers.text import TextFile

_SECTIONS = {"devices", "joints", "model outputs", "segments", "trajectories"}
_MOST_ABOVE_HEADER = 4
"""Lines from the name of a section to its header, the name included."""


def _recognizes(head: list[str]) -> bool:
    """Whether a file begins with a section of Nexus."""
    if _cells(head[0])[0] not in _SECTIONS:
        return False
    headers = [_cells(line)[:2] for line in head[:_MOST_ABOVE_HEADER]]
    return ["frame", "sub frame"] in headers


def _table(file: TextFile) -> Table:
    """The table of trajectories, with each marker as an object."""
    lines = lines_of_data(file, file.head())
    title = next((k for k in lines if _cells(file.lines[k])[0] == "trajectories"), None)
    if title is None:
        raise file.error("no section Trajectories; export the trajectories of markers")
    above = lines_of_data(file, title, _MOST_ABOVE_HEADER)
    header = next((k for k in above if _cells(file.lines[k])[0] == "frame"), None)
    if header is None:
        raise file.error("expected a header Frame, Sub Frame, X, Y, Z below it", title)
    section = file._replace(lines=file.lines[: _end_of_section(file, header)])
    table = Table.at(section, header).with_units_below()
    above_header = above[: above.index(header)]
    rate = _cells(file.lines[above_header[1]])[0] if len(above_header) > 1 else ""
    frames = unit_of_frames(rate)
    names = _names(file, above_header[-1], len(table.headings))
    objects = {
        name: [0, *columns]  # with the frame
        for name, columns in places_by_name(names).items()
    }
    return replace(table, objects=objects, units=f"t={frames}" if frames else "")


def _names(file: TextFile, index: int, columns: int) -> list[str]:
    """The name of the marker of each column, which stands above the first of its
    columns."""
    line = file.lines[index]
    above = headings_in(line)[:columns]
    names = []
    marker = ""
    for column in range(columns):
        if 1 < column < len(above) and above[column]:
            marker = above[column]
        names.append(marker)
    return names


def _end_of_section(file: TextFile, header: int) -> int:
    """Index of the first empty line below a header, or of the end of the file."""
    below = range(header + 1, len(file.lines))
    return next((k for k in below if not file.lines[k].strip(" ,;\t")), len(file.lines))


def _cells(line: str) -> list[str]:
    """The cells of a line in small letters."""
    return [cell.lower() for cell in headings_in(line)]


VICON = layout("vicon", _recognizes, _table)
