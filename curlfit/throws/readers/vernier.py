"""CSV files of Vernier's programs: Logger Pro, Graphical Analysis, Video Analysis.

Each heading begins with the name of its data set: `Latest: Time (s)`,
`VideoAnalysis: X (m)`, `Data Set 1:Time(s)`. Several runs are side by side. Velocities
are computed from the positions, and have names that curlfit does not read. (From files
and programs that read them in public repositories; Vernier does not describe them.)
"""

from __future__ import annotations

import re
from dataclasses import replace

from curlfit.throws.readers.cells import headings_in
from curlfit.throws.readers.columns import quantities_of
from curlfit.throws.readers.objects import places_by_name
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile

_HEADING = re.compile(r"(?P<data_set>[^:]*[^:\W][^:]*):\s*(?P<column>[^:]+)")


def _recognizes(head: list[str]) -> bool:
    """Whether all headings of a file begin with a data set, and some are of a path."""
    headings = headings_in(head[0])
    matches = list(map(_HEADING.fullmatch, headings))
    columns = [match["column"] for match in matches if match]
    quantities = set(quantities_of(columns))
    return all(matches) and len(quantities & {"t", "x", "y", "phi", "omega"}) > 1


def _table(file: TextFile) -> Table:
    """The table with each data set as an object."""
    table = Table.at(file, file.head())
    data_sets = []
    headings = []
    for heading in table.headings:
        match = _HEADING.fullmatch(heading)
        data_sets.append(match["data_set"].strip() if match else "")
        headings.append(match["column"].strip() if match else heading)
    return replace(table, headings=headings, objects=places_by_name(data_sets))


VERNIER = layout("vernier", _recognizes, _table)
