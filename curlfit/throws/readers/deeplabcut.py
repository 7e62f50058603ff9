"""CSV files of DeepLabCut, which finds trained points in the frames of a film.

The header names the network (`scorer`), the point (`bodyparts`) and what is measured of
it (`coords`) in a line each, in projects of several animals also the animal
(`individuals`). The first column counts the frames. x and y are in pixels, and a
likelihood says how sure the network is of them. DeepLabCut itself leaves out of its
plots and errors what is less likely than `pcutoff`, 0.6 in the configuration of a new
project (github.com/DeepLabCut/DeepLabCut, deeplabcut/create_project/new.py).
"""

from __future__ import annotations

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
    kinds = [headings_in(line)[0].lower() for line in head[:3]]
    return kinds[:1] == ["scorer"] and "bodyparts" in kinds


def _table(file: TextFile) -> Table:
    """The table with each point as an object."""
    first = file.head()
    line_of_kind = {}  # index of a line of the header, by its first cell
    for index in lines_of_data(file, first, len(_HEADER)):
        kind = headings_in(file.lines[index])[0].lower()
        line_of_kind[kind] = index
    if not {"bodyparts", "coords"} <= line_of_kind.keys():
        raise file.error(f"expected header lines {', '.join(_HEADER)}", first)
    points = headings_in(file.lines[line_of_kind["bodyparts"]])
    individuals = []
    if "individuals" in line_of_kind:
        individuals = headings_in(file.lines[line_of_kind["individuals"]])
    names = [
        f"{individual} {point}".strip()
        for point, individual in zip_longest(points, individuals, fillvalue="")
    ]
    table = Table.at(file, line_of_kind["coords"])
    headings = ["frame", *table.headings[1:]]
    objects = {}
    likelihoods: dict[int, Likelihood] = {}
    names_of_columns = ["", *names[1 : len(headings)]]
    for name, columns in places_by_name(names_of_columns).items():
        measured = [column for column in columns if headings[column] != "likelihood"]
        objects[name] = [0, *measured]  # with the frame
        for column in columns:
            if headings[column] == "likelihood":
                of_point = Likelihood(column, _PCUTOFF)
                likelihoods |= dict.fromkeys(measured, of_point)
    return replace(
        table,
        headings=headings,
        objects=objects,
        likelihoods=likelihoods,
        units="length=px",
    )


DEEPLABCUT = layout("deeplabcut", _recognizes, _table)
