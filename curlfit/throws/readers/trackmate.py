"""CSV tables of spots of TrackMate, the tracking plugin of Fiji.

Four lines make the header: keys (`POSITION_X`), names (`X`), short names, and units in
brackets; exports before version 7 have the keys alone (imagej.net/plugins/trackmate,
classes of fiji.plugin.trackmate.visualization.table). `TRACK_ID` names the track of
each spot, and is empty for a spot of none; spots are in no order of time. Positions and
times are in the units of the image, perhaps pixels and frames.
"""

from __future__ import annotations

from dataclasses import replace

from curlfit.throws.readers.cells import header_cells, headings_in
from curlfit.throws.readers.numbers import is_number
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table, lines_of_data
from curlfit.throws.readers.text import TextFile

_TRACK = "TRACK_ID"
_NEEDED = {_TRACK, "POSITION_X", "POSITION_Y"}
_MOST_BELOW_KEYS = 3
"""Lines of names, short names and units."""


def _recognizes(head: list[str]) -> bool:
    """Whether a file begins with keys of spots in tracks."""
    return set(headings_in(head[0])) >= _NEEDED


def _table(file: TextFile) -> Table:
    """The table with the names and units of its columns."""
    table = Table.at(file, file.head())
    keys = table.headings
    if not set(keys) >= _NEEDED:
        raise table.error(f"expected a header with {', '.join(sorted(_NEEDED))}")
    track = keys.index(_TRACK)
    names = keys
    units = [""] * len(keys)
    header = table.header
    for index in lines_of_data(file, header + 1, _MOST_BELOW_KEYS):
        cells = header_cells(file.lines[index], table.separator)[: len(keys)]
        cells += [""] * (len(keys) - len(cells))
        if is_number(cells[keys.index("POSITION_X")]):
            break
        header = index
        if cells[track]:
            names = cells
        else:
            units = cells
    headings = [
        f"{name} {unit}".strip() for name, unit in zip(names, units, strict=True)
    ]
    return replace(table, header=header, headings=headings, names_of_throws=track)


TRACKMATE = layout("trackmate", _recognizes, _table, throws_in_rows=True)
