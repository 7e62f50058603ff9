"""CSV files of DeepLabCut, which finds trained points in the frames of a film.

The header names the network (`scorer`), the point (`bodyparts`) and what is measured of
it (`coords`) in a line each, in projects of several animals also the animal
(`individuals`). The first column counts the frames. x and y are in pixels, and a
likelihood says how sure the network is of them. DeepLabCut itself leaves out of its
plots and errors what is less likely than `pcutoff`, 0.6 in the configuration of a new
project (github.com/DeepLabCut/DeepLabCut, deeplabcut/create_project/new.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

from curlfit.throws.readers.cells import headings_in
from curlfit.throws.readers.objects import places_by_name
from curlfit.throws.readers.path import layout
from curlfit.throws.readers.table import Likelihood, Table, lines_of_data
from curlfit.throws.readers.text import TextFile

_HEADER = ("scorer", "individuals", "bodyparts", "coords")
_PCUTOFF = 0.6


def _recognizes(head: list[str]) -> bool:
    """Whether a file begins with the names of a network and its points."""
    first_cells = [cells[0].lower() for cells in _cells(head[:3])]
    return first_cells[:1] == ["scorer"] and "bodyparts" in first_cells


def _table(file: TextFile) -> Table:
    """The table with each point as an object."""
    first = file.head()
    header = lines_of_data(file, first, len(_HEADER))
    names_of_line = {
        cells[0].lower(): (index, cells)
        for index, cells in zip(
            header, _cells([file.lines[index] for index in header]), strict=True
        )
    }
    if not {"bodyparts", "coords"} <= names_of_line.keys():
        raise file.error(f"expected header lines {', '.join(_HEADER)}", first)
    _, points = names_of_line["bodyparts"]
    _, individuals = names_of_line.get("individuals", (0, []))
    names = [
        f"{individual} {point}".strip()
        for point, individual in zip_longest(points, individuals, fillvalue="")
    ]
    index, _ = names_of_line["coords"]
    table = Table.at(file, index)
    headings = ["frame", *table.headings[1:]]
    objects = {}
    likelihoods: dict[int, Likelihood] = {}
    for name, places in places_by_name(["", *names[1 : len(headings)]]).items():
        measured = [place for place in places if headings[place] != "likelihood"]
        objects[name] = [0, *measured]
        for place in places:
            if headings[place] == "likelihood":
                of_point = Likelihood(place, _PCUTOFF)
                likelihoods |= dict.fromkeys(measured, of_point)
    return replace(
        table,
        headings=headings,
        objects=objects,
        likelihoods=likelihoods,
        units="length=px",
    )


def _cells(lines: Sequence[str]) -> list[list[str]]:
    """The cells of header lines."""
    return [headings_in(line) for line in lines]


DEEPLABCUT = layout("deeplabcut", _recognizes, _table)
