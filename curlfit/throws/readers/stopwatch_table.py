"""Tables of stopwatch times, a throw in each row: headings, measurements, labels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

from curlfit.errors import InputError
from curlfit.findings import Finding, Remedy
from curlfit.throws.events import RATES
from curlfit.throws.readers.cells import GAPS, is_gap
from curlfit.throws.readers.columns import parse_header, unit_in
from curlfit.throws.readers.headings import named_columns
from curlfit.throws.readers.notation import parse_quantity
from curlfit.throws.readers.numbers import is_number
from curlfit.throws.readers.record import KINDS, TIMES, Entry, Row
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.words import WORDS, by_word

LABELS = set(WORDS["labels"].split())
"""Columns that say of which throw a row is; any other that has words in most rows
is kept too."""
_MEANS = by_word(WORDS["timings"])
_MAY_MEAN = by_word(WORDS["timings_may_mean"])
"""Of a column whose cells are measurements with their units or directions."""
_NOT_FITTED = set(WORDS["timings_not_fitted"].split())
_SAYING_NOTHING = {"interval", "time", "line", "lines"}
_LIKE_MEASUREMENTS = {"hog", "tee", "rest", "curl", "turns", "split", "speed", "spin"}
_SPLIT = re.compile(r"[\s_\-./()\[\]]+")
_MOST_ROWS = 100_000


class Heading(NamedTuple):
    """What a heading of a stopwatch table means: a quantity, empty if unknown, and the
    unit that follows it, if any, as in `curl_ft`."""

    quantity: str
    unit: str = ""

    @classmethod
    @lru_cache(1024)
    def of(cls, text: str) -> Heading:
        """The meaning of a heading."""
        words = _words(text.strip().strip("\"'"))
        for candidates in (words, _saying_something(words)):
            for count in range(len(candidates), max(len(candidates) - 2, 0), -1):
                name = "_".join(candidates[:count])
                name = _MEANS.get(name, name)
                unit = "".join(candidates[count:])
                if name in KINDS and unit not in _SAYING_NOTHING:
                    return cls(name, unit)
        column = parse_header(text.strip("\"' "))
        if column is None or column.base not in RATES:
            return cls("")
        quantity = column.quantity.replace("omega", "spin")
        return cls(quantity, column.unit if column.stated else "")

    def in_unit(self, units: Mapping[str, str]) -> Heading:
        """The heading with the unit that the user gives for its kind of quantity."""
        kind = KINDS[self.quantity].unit if self.quantity else ""
        return self._replace(unit=units.get(kind, self.unit))


def _words(heading: str) -> list[str]:
    """The words of a heading, in small letters."""
    return list(filter(None, _SPLIT.split(heading.lower())))


def _saying_something(words: Sequence[str]) -> list[str]:
    """The words of a heading without those that say nothing, as `interval` does."""
    return [word for word in words if word not in _SAYING_NOTHING]


def _name(heading: str) -> str:
    """A heading as a name: its words that say something, with underscores between."""
    return "_".join(_saying_something(_words(heading)))


def is_header(headings: Sequence[str]) -> bool:
    """Whether headings are those of a table of stopwatch times: they name several known
    quantities, or a time and others that are named otherwise."""
    if 2 * sum(map(is_number, headings)) >= len(headings):
        return False
    quantities = {Heading.of(heading).quantity for heading in headings} - {""}
    if len(quantities) == 1 and quantities <= TIMES.keys():
        line_of_a_record = any("=" in text or text[:1].isdigit() for text in headings)
        return (
            len(headings) > 1
            and not line_of_a_record
            and not any(map(is_number, headings))
        )
    return len(quantities) > 1


def meant(quantity: str, cell: str) -> str:
    """The quantity under a heading: words alone under that of the spin are
    its sense."""
    words_alone = not any(map(str.isdigit, cell))
    return "handle" if quantity == "spin" and words_alone else quantity


def throws_of_table(
    table: Table, named: Mapping[str, str], units: Mapping[str, str]
) -> list[Row]:
    """The throws in the rows of a table.

    Parameters
    ----------
    named : headings that the user names, by quantity.
    units : of cells without one of their own, as `parse_units` gives them.

    Raises
    ------
    DataError : two columns mean the same; a row has another number of cells; there are
        no rows or too many.
    """
    headings = [heading.in_unit(units) for heading in _headings(table, named)]
    place_of = table.sole([heading.quantity for heading in headings])
    if len(table.rows) > _MOST_ROWS:
        raise table.file.error(f"more than {_MOST_ROWS} throws", table.rows[_MOST_ROWS])
    labels, notes = _labels(table, headings)
    table.note_gaps(list(place_of.values()))
    notes += table.findings
    rows = []
    for index, cells in zip(table.rows, table.cells, strict=True):
        line = index + 1
        entries = {}
        for quantity, place in place_of.items():
            cell = cells[place]
            if not is_gap(cell):
                unit = headings[place].unit
                entries[meant(quantity, cell)] = Entry(line, cell, unit)
        labels_of_row = {
            label: cells[place]
            for place, label in labels.items()
            if cells[place].lower() not in GAPS
        }
        rows.append(Row(line, entries, labels_of_row, notes))
    return rows


def _headings(table: Table, named: Mapping[str, str]) -> list[Heading]:
    """The meaning of each column: as the user names it, by its heading, or by words
    that are less certain where its cells are measurements."""
    headings = [Heading.of(text) for text in table.headings]
    of_user = named_columns(
        named,
        table.headings,
        table.error,
        lambda key: Heading.of(key).quantity,
        ", ".join(KINDS),
    )
    for place, quantity in of_user.items():
        unit = unit_in(table.headings[place], KINDS[quantity].unit)
        headings = [
            Heading("") if heading.quantity == quantity else heading
            for heading in headings
        ]
        headings[place] = Heading(quantity, unit)
    quantities = {heading.quantity for heading in headings}
    for place, text in enumerate(table.headings):
        quantity = _MAY_MEAN.get(_name(text), "")
        if headings[place].quantity or not quantity or quantity in quantities:
            continue
        measurements = sum(map(_is_measurement, table.column(place)))
        if 2 * measurements > len(table.rows):
            headings[place] = Heading(quantity)
            quantities.add(quantity)
    return headings


def _labels(
    table: Table, headings: Sequence[Heading]
) -> tuple[dict[int, str], list[Finding]]:
    """Columns that are labels, by place, and notes on those that are not used."""
    labels = {}
    not_fitted = []
    unused = []
    strange = []
    for place, name in enumerate(table.headings):
        quantity = headings[place].quantity
        cells = ["" if is_gap(cell) else cell for cell in table.column(place)]
        if quantity and all(meant(quantity, cell) == "handle" for cell in cells):
            labels[place] = "handle"
        if quantity or not name:
            continue
        label = "_".join(name.lower().split())
        if _name(name) in _NOT_FITTED:
            not_fitted.append(name)
            continue
        sounds_measured = not _LIKE_MEASUREMENTS.isdisjoint(_SPLIT.split(name.lower()))
        measurements = sum(map(_is_measurement, cells))
        looks_measured = 2 * measurements > len(cells)
        if label not in LABELS and (sounds_measured or looks_measured):
            strange.append(name)
        words = sum(not is_number(cell) for cell in cells if cell)
        if label in LABELS or 2 * words > len(cells):
            labels[place] = label
        else:
            unused.append(name)
    notes = []
    if not_fitted:
        notes.append(Finding.note("columns-not-fitted", columns=not_fitted))
    if strange:
        expected = Remedy("known-headings", numbers={"times": list(TIMES)})
        not_understood = Finding.note(
            "columns-not-understood", expected, columns=strange, count=len(strange)
        )
        notes.append(not_understood)
    if unused:
        notes.append(Finding.note("columns-ignored", columns=unused))
    return labels, notes


def _is_measurement(cell: str) -> bool:
    """Whether a cell is a number with its unit, or a word of direction."""
    with suppress(InputError):
        return not is_number(cell) and math.isfinite(parse_quantity(cell, "x").value)
    return False
