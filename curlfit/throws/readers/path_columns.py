"""The numbers and clock times in the columns of a path."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, frame_rate, in_unit, parse_units
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.table import Likelihood, Table


def read_columns(
    parsed: ParsedFile, table: Table, columns: dict[int, Column], reading: Reading
) -> None:
    """Add columns, by place, to a parsed file; those of clock times become seconds.

    Raises
    ------
    DataError : with the line and column of the fault.
    """
    order = parse_units(reading.units).get("date")
    day_first = None if order is None else order == "day-first"
    seconds = {}  # of the columns of clock times
    for place, column in columns.items():
        if column.base != "t":
            continue
        clock = table.clock(place, frame_rate(column.unit), day_first)
        if clock is None:
            continue
        seconds[place] = clock.seconds
        columns[place] = in_unit(column.quantity, "s")
        code = "clock-times-in-hundredths" if clock.in_hundredths else "clock-times"
        parsed.notes.append(
            Finding.note(code, column=table.headings[place], since=clock.first)
        )
    with_numbers = [place for place in columns if place not in seconds]
    numbers = table.numbers(with_numbers)
    values = seconds | dict(zip(with_numbers, numbers, strict=True))
    if not (reading.as_given or parsed.settings.get("as_given")):
        values |= _likely(parsed, table, values)
    parsed.notes += table.findings
    parsed.lines = np.asarray(table.rows, np.int64) + 1
    for place, column in columns.items():
        parsed.add(table.headings[place], column, values[place])


def _likely(
    parsed: ParsedFile, table: Table, values: Mapping[int, Floats]
) -> dict[int, Floats]:
    """Columns of whose values a program says how sure it is, by place, with gaps where
    it is not sure enough."""
    places_of: dict[Likelihood, list[int]] = {}
    for place in values:
        if place in table.likelihoods:
            places_of.setdefault(table.likelihoods[place], []).append(place)
    likely = {}
    for likelihood, measured in places_of.items():
        (likelihoods,) = table.numbers([likelihood.place])
        unlikely = likelihoods < likelihood.least
        for place in measured:
            likely[place] = np.where(unlikely, np.nan, values[place])
        if unlikely.any():
            count = int(unlikely.sum())
            taken_as_gaps = Finding.note(
                "unlikely-positions",
                Remedy("keeps", Option("as-given"), {"count": count}),
                count=count,
                least=likelihood.least,
                column=likelihood.place + 1,
            )
            parsed.notes.append(taken_as_gaps)
    return likely
