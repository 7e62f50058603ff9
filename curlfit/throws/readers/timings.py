"""Stopwatch records: times between lines, and where the stone came to rest;
one, or a table."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import file_and_number, quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.channels import UNITS
from curlfit.throws.events import Event
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.cells import headings_in
from curlfit.throws.readers.columns import parse_header, parse_units
from curlfit.throws.readers.comments import headings_named_in
from curlfit.throws.readers.format import Contents, Format
from curlfit.throws.readers.odd_rows import OddValue, odd_values
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.record import (
    ALONG,
    EXPECTED,
    KINDS,
    TIMES,
    Entry,
    Record,
    Row,
    usual_sigma,
)
from curlfit.throws.readers.stopwatch_table import (
    Heading,
    is_header,
    meant,
    throws_of_table,
)
from curlfit.throws.readers.table import MOST_TITLES, Table
from curlfit.throws.readers.text import TextFile, is_aside

_LINE = re.compile(
    r"""(?!\s*["']?[-+.\d])\s*["']?([^=:;,\t"']*?)["']?\s*[=:;,\t]\s*(\S.*?)\s*[;,]?\s*$"""
)
_LETTER = re.compile(r"[^\W\d_]")
_MANY = 4  # throws of a table, from which on it is an evening
_MOST_ODD = 5  # one row in so many may be left out as odd; of more, none is


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The only record, or the rows of a table with one throw per row.

    Raises
    ------
    DataError : an unknown line, an impossible value, a curl without its side, or times
        that do not determine friction.
    """
    of_file = ParsedFile.begin(file, "timings")
    keep = {*reading.keep, *of_file.settings.pop("keep", ())}
    of_file.settings.pop("columns", None)
    rows, without_sense = _with_senses(file, _throws_in(file, reading))
    of_file.settings.setdefault("law", _usual_law(rows))
    labels = [f"line {row.line}" for row in rows]
    if len(rows) == 1:
        return Contents(labels, lambda _: _read_row(file, rows[0], of_file, keep))
    odd_rows = _odd_rows(file, rows, keep)
    finding_at = {odd.row - 1: odd.finding for odd in odd_rows}
    without_time = [index for index, row in enumerate(rows) if not _has_time(row)]

    def parse(index: int) -> ParsedFile:
        parsed = _read_row(file, rows[index], of_file, keep, of_table=True)
        parsed.source = f"{file.path} row {index + 1}"
        parsed.odd_rows = odd_rows
        if without_time:
            lines = [rows[index].line for index in without_time]
            parsed.notes.append(Finding.note("rows-without-a-time", lines=lines))
        if without_sense:
            parsed.notes.append(
                Finding.note("turns-without-a-sense", lines=without_sense)
            )
        if index in finding_at:
            parsed.notes.append(finding_at[index])
        return parsed

    left_out = {odd.row - 1 for odd in odd_rows if odd.left_out}
    return Contents(
        labels,
        parse,
        left_out=left_out.union(without_time),
        odd_rows=odd_rows,
        note=_one_of_rows,
    )


def _with_senses(file: TextFile, rows: list[Row]) -> tuple[list[Row], list[int]]:
    """The rows of a table without turns and spins whose sense is not known, and the
    lines that had one. Where no row tells a sense, the table is refused as it is read.
    """
    without_sense: dict[int, set[str]] = {}
    for index, row in enumerate(rows):
        with suppress(DataError):  # the row itself is refused where it is read
            keys = Record(file, row, limited=False).without_sense()
            if keys:
                without_sense[index] = keys
    turning = [row for row in rows if {"turns", "spin"} & row.entries.keys()]
    if len(without_sense) == len(turning):
        return rows, []
    known_rows = []
    for index, row in enumerate(rows):
        unknown = without_sense.get(index, set())
        entries = {key: row.entries[key] for key in row.entries if key not in unknown}
        known_rows.append(row._replace(entries=entries))
    return known_rows, [rows[index].line for index in without_sense]


def _has_time(row: Row) -> bool:
    """Whether a row has a measurement of the motion along the sheet."""
    return bool(row.entries.keys() & ALONG)


def _read_row(
    file: TextFile,
    row: Row,
    of_file: ParsedFile,
    keep: Collection[int],
    *,
    of_table: bool = False,
) -> ParsedFile:
    """The throw of a row.

    Parameters
    ----------
    of_file : what the file says of all its throws; what the row says is added to a
        copy.
    keep : lines whose values may be larger than usual.
    of_table : whether the file has other rows, with which a throw may be fitted that
        determines no friction by itself.
    """
    record = Record(file, row, limited=row.line not in keep)
    parsed = of_file.copy()
    parsed.events = record.events()
    parsed.labels = row.labels
    fault = record.fault_alone()
    if fault:
        notes_on_row = [str(replace(note, remedies=())) for note in row.notes]
        fault = "; ".join([fault, *notes_on_row])
        parsed.alone = file.error(fault, row.line - 1 if of_table else None)
        if not (of_table and _has_time(row)):
            raise parsed.alone
    spin, notes_on_spin = record.spin()
    parsed.assumed = {"omega0": spin}
    crossed = {y for event in parsed.events for y in (event.at, event.since)}
    lines = [
        {"line": name.replace("far-", "far "), "y": y}
        for name, y in LINES.items()
        if y in crossed
    ]
    from_the_hack = Finding.note(
        "y-from-the-hack", lines=lines, far_tee=LINES["far-tee"]
    )
    parsed.notes += [from_the_hack, *notes_on_spin, *row.notes]
    return parsed


def _one_of_rows(count: int, number: int) -> Finding:
    """The note that one throw of a table of several is read, by its number."""
    another = Remedy("selects-another", Option("shot", "N"))
    return Finding.note("one-of-rows", another, count=count, taken=number)


def _odd_rows(
    file: TextFile, rows: list[Row], keep: Collection[int]
) -> tuple[OddRow, ...]:
    """Rows with a value that is beyond its limit or contradicts the others, but for
    those to keep. A joint fit leaves them out unless they are more than a fifth."""
    columns: dict[str, Floats] = {}
    for index, row in enumerate(rows):
        with suppress(DataError):  # the row itself is refused where it is read
            for key, size in Record(file, row, limited=False).sizes().items():
                empty_column = np.full(len(rows), np.nan)
                columns.setdefault(key, empty_column)[index] = size
    odd_value_of: dict[int, OddValue] = {}  # by row; values beyond limits come first
    for key, values in columns.items():
        for index in np.flatnonzero(np.abs(values) > KINDS[key].limit).tolist():
            impossible = OddValue(index, key, values[index], np.nan, 0.0)
            odd_value_of.setdefault(index, impossible)
            values[index] = np.nan
    floors = {key: usual_sigma(key) / 2 for key in columns}
    usual = {key: KINDS[key].usual for key in columns}
    labels = [row.labels for row in rows]
    for odd_value in odd_values(columns, floors, usual, labels):
        odd_value_of.setdefault(odd_value.row, odd_value)
    odd = [index for index in sorted(odd_value_of) if rows[index].line not in keep]
    left_out = len(odd) <= len(rows) / _MOST_ODD
    return tuple(
        _odd_row(file, rows[index].line, odd_value_of[index], left_out) for index in odd
    )


def _odd_row(file: TextFile, line: int, odd: OddValue, left_out: bool) -> OddRow:
    """The row of an odd value, in the units in which a table has it: turns as such."""
    unit = UNITS[KINDS[odd.column].unit]
    size = 1.0
    if odd.column == "turns":
        unit = "turns"
        size = 2 * math.pi
    return OddRow(
        file=str(file.path),
        row=odd.row + 1,
        line=line,
        column=odd.column.replace("_", " "),
        value=odd.value / size,
        unit=unit,
        deviation=None if math.isnan(odd.off) else odd.off / size,
        left_out=left_out,
    )


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are those of a record or of a table of times, which may
    stand below titles."""
    for line in head[:MOST_TITLES]:
        if not _LETTER.search(line):
            continue  # numbers alone
        headings = headings_in(line)
        if not is_header(headings):
            continue
        quantities = {Heading.of(heading).quantity for heading in headings}
        if quantities & TIMES.keys():
            return True
        if "speed" not in quantities or not quantities & {"curl", "rest"}:
            return False
        # With a column of times, the speed is that of a path.
        columns = map(parse_header, headings)
        return all(column is None or column.base != "t" for column in columns)
    pairs = [pair for pair in map(_pair, head) if pair is not None]
    if any(key in TIMES for key, _, _ in pairs):
        return True
    # The header of a table may begin with such a name too, but has no digits.
    return _pair(head[0]) is not None and any(map(str.isdigit, pairs[0][2]))


TIMINGS = Format(
    name="timings",
    recognizes=_recognizes,
    contents=_contents,
    what="row",
    selected_by="shot",
    usual=0,
    selections=("shot", "keep", "columns"),
    columns=KINDS,
    jointly=True,
)


def _pair(line: str) -> tuple[str, str, str] | None:
    """Quantity, unit and text of a line; None if it names no known quantity."""
    match = _LINE.match(line)
    if match is None:
        return None
    heading = Heading.of(match[1])
    return (*heading, match[2]) if heading.quantity else None


def _throws_in(file: TextFile, reading: Reading) -> list[Row]:
    """Each throw in the file: those of a table, or the only one of a record."""
    named = {**headings_named_in(file), **reading.columns}
    units = parse_units(reading.units)

    def knows(table: Table) -> bool:
        return table.has(named.values()) and (bool(named) or is_header(table.headings))

    head = [line for line in file.lines if not is_aside(line)][:MOST_TITLES]
    headings = (headings_in(line) for line in head)
    if named or any(map(is_header, headings)):
        return throws_of_table(Table.find(file, knows), named, units)
    body = []
    for index, line in enumerate(file.lines):
        text = line.split("#", 1)[0].strip(" ")
        if text.strip() and not text.startswith("["):
            body.append((index, text.strip()))
    first_line = body[0][0] + 1 if body else 0
    return [Row(first_line, _entries(file, body, units), {}, [])]


def _entries(
    file: TextFile, body: Sequence[tuple[int, str]], units: Mapping[str, str]
) -> dict[str, Entry]:
    """The quantities of a record, by name; `units` are those that the user gives."""
    entries: dict[str, Entry] = {}
    for index, text in body:
        pair = _pair(text)
        if pair is None:
            if not entries and re.fullmatch(r"(?i)(name|key|quantity|what)\W.*", text):
                continue  # a header
            raise file.error(f"{quoted(text)} is not known; {EXPECTED}", index)
        heading, unit, value = pair
        key = meant(heading, value)
        if key in entries:
            raise file.error(f"{key} is given twice", index)
        unit = Heading(key, unit).in_unit(units).unit
        entries[key] = Entry(index + 1, value, unit)
    return entries


def usual_law(file: TextFile, reading: Reading) -> str:
    """The law by which each row of a file is fitted for itself if none is named. Raises
    `DataError` as the reader."""
    return _law_of_draws(_throws_in(file, reading))


def _usual_law(rows: list[Row]) -> str:
    """The law that the measurements determine: of an evening, in the numbers of a draw,
    with a force that turns it where the curl was measured."""
    if len(rows) < _MANY:
        return _law_of_draws(rows)
    return "power+deflection" if _usually_have({"curl"}, rows) else "power"


def _law_of_draws(rows: list[Row]) -> str:
    """The law of draws one by one: the curl needs one that curls and slows the spin as
    stones do, and of a single throw the turns too; times and positions along the sheet
    determine a mean friction."""
    curls = _usually_have({"curl"}, rows)
    if len(rows) < _MANY:
        curls = curls and _usually_have({"turns", "spin"}, rows)
    return "front-back" if curls else "coulomb"


def _usually_have(keys: set[str], rows: list[Row]) -> bool:
    """Whether half of the rows or more have one of some quantities."""
    count = sum(bool(keys & row.entries.keys()) for row in rows)
    return 2 * count >= len(rows) > 0


class TableEntry(NamedTuple):
    """What a table of throws says of one: its labels, the events that were measured
    beside its path, and notes on both."""

    labels: dict[str, str]
    events: list[Event]
    notes: list[Finding]


def entry_in(table: Path, source: str) -> TableEntry:
    """What a table with a column `file` or `track` says of a throw.

    Parameters
    ----------
    source : its file, which is named there with or without its folder and suffix.

    Raises
    ------
    DataError : as the reader; no such column, or the throw is named twice.
    """
    file = TextFile.read(table)

    def names_throws(of: Table) -> bool:
        return bool({"file", "track"} & {heading.lower() for heading in of.headings})

    notes_table = Table.find(file, names_throws)
    named = headings_named_in(file)
    path = Path(file_and_number(source)[0]).resolve()
    with_suffix = path.parts
    without_suffix = path.with_suffix("").parts
    rows_of_throw = []
    any_named = False
    for row in throws_of_table(notes_table, named, {}):
        name = row.labels.pop("file", None) or row.labels.pop("track", None) or ""
        parts = Path(name.replace("\\", "/")).parts
        if not parts:
            continue
        any_named = True
        end = slice(-len(parts), None)
        if parts in (with_suffix[end], without_suffix[end]):
            rows_of_throw.append(row)
    if not any_named:
        raise notes_table.error(
            "no names of throws; expected a column `file` or `track`"
        )
    if len(rows_of_throw) > 1:
        again = rows_of_throw[1].line - 1
        raise file.error(f"{quoted(path.name)} is named again", again)
    if not rows_of_throw:
        return TableEntry({}, [], [Finding.note("not-in-the-table", table=str(table))])
    row = rows_of_throw[0]
    events = Record(file, row).events()
    source_of_labels = Finding.note(
        "measurements-of-a-table" if events else "labels-of-a-table",
        table=str(table),
        line=row.line,
    )
    notes = [source_of_labels, *row.notes]
    if file.note is not None:
        notes.append(file.note)
    return TableEntry(row.labels, events, notes)
