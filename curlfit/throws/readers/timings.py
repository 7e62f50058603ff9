"""Stopwatch records: times between lines, and where the stone came to rest;
one, or a table."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import counted, file_and_number, quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.channels import UNITS
from curlfit.throws.events import RATES, Event
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.notation import parse_quantity
from curlfit.throws.readers.odd_rows import OddValue, odd_values
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile
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
from curlfit.throws.readers.text import (
    GAPS,
    TextFile,
    cells,
    header_cells,
    is_number,
    separator_of,
)
from curlfit.throws.readers.words import WORDS

LABELS = set(WORDS["labels"].split())
"""Columns that say of which throw a row is; any other that has words in most rows
is kept too."""
_ALIASES = {
    "sigma_t": "sigma_time",
    "rotation": "handle",
    "split": "back_to_hog",
    "h2h": "hog_to_hog",
    "hog_hog": "hog_to_hog",
}
_LIKE_MEASUREMENTS = {"hog", "tee", "rest", "curl", "turns", "split", "speed", "spin"}
_SPLIT = re.compile(r"[\s_\-./()\[\]]+")
_LINE = re.compile(
    r"""(?!\s*["']?[-+.\d])\s*["']?([^=:;,\t"']*?)["']?\s*[=:;,\t]\s*(\S.*?)\s*[;,]?\s*$"""
)
_MOST_ROWS = 100_000
_MANY = 4  # throws of a table, from which on it is an evening


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The only record, or the rows of a table with one throw per row.

    Raises
    ------
    DataError : an unknown line, an impossible value, a curl without its side, or times
        that do not determine friction.
    """
    rows = _rows(file)
    keep = {*reading.keep, *begun(file, "timings").settings.get("keep", ())}
    law = _usual_law(rows)
    several = len(rows) > 1
    odd_rows = _odd_rows(file, rows, keep) if several else ()
    without_time = [
        index for index, row in enumerate(rows) if not row.entries.keys() & ALONG
    ]
    left_out = []
    if several and without_time:
        lines = [rows[index].line for index in without_time]
        left_out.append(Finding.note("rows-without-a-time", lines=lines))
    odd_row_at = {odd.row - 1: odd for odd in odd_rows}

    def parse(index: int) -> ParsedFile:
        row = rows[index]
        source = f"{file.path} row {index + 1}" if several else None
        parsed = begun(file, "timings", source=source)
        parsed.settings.setdefault("law", law)
        parsed.settings.pop("keep", None)
        record = Record(file, row, limited=row.line not in keep)
        parsed.events = record.events()
        parsed.labels = row.labels
        parsed.odd_rows = odd_rows
        if fault := record.fault_alone():
            unread = [str(replace(note, remedies=())) for note in row.notes]
            fault = "; ".join([fault, *unread])
            parsed.alone = file.error(fault, row.line - 1 if several else None)
            if not several or not row.entries.keys() & ALONG:
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
        parsed.notes += [from_the_hack, *notes_on_spin, *row.notes, *left_out]
        if index in odd_row_at:
            parsed.notes.append(odd_row_at[index].finding)
        return parsed

    return Contents(
        [f"line {row.line}" for row in rows],
        parse,
        left_out={
            *(odd.row - 1 for odd in odd_rows if odd.left_out),
            *(without_time if several else ()),
        },
        odd_rows=odd_rows,
        note=_of_taken_row,
    )


def _of_taken_row(count: int, taken: int) -> Finding:
    """The note that one throw of a table is read, by its number."""
    another = Remedy("selects-another", Option("shot", "N"))
    return Finding.note("one-of-rows", another, count=count, taken=taken)


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
    odd: dict[int, OddValue] = {}
    for key, values in columns.items():
        for place in np.flatnonzero(np.abs(values) > KINDS[key].limit).tolist():
            odd.setdefault(place, OddValue(place, key, values[place], np.nan, 0.0))
            values[place] = np.nan
    floors = {key: usual_sigma(key) / 2 for key in columns}
    usual = {key: KINDS[key].usual for key in columns}
    for value in odd_values(columns, floors, usual, [row.labels for row in rows]):
        odd.setdefault(value.row, value)
    odd = {place: value for place, value in odd.items() if rows[place].line not in keep}
    left_out = len(odd) <= len(rows) / 5
    return tuple(
        _odd_row(file, rows[place].line, odd[place], left_out) for place in sorted(odd)
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


def is_table(head: list[str]) -> bool:
    """Whether lines, comments removed, begin with a header of several
    known quantities."""
    names = _header(head[0]) if head else []
    known = {key for key, _ in map(_key, names)} - {""}
    if len(known) == 1 and known <= TIMES.keys() and separator_of(head[0]):
        # other columns are named otherwise, perhaps
        return "=" not in head[0] and len(names) > 1 and not any(map(is_number, names))
    return len(known) > 1


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are those of a record or of a table of times."""
    if is_table(head):
        names = _header(head[0])
        keys = {key for key, _ in map(_key, names)}
        columns = [column for name in names if (column := parse_header(name))]
        path = "speed" not in keys or any(column.base == "t" for column in columns)
        return bool(keys & TIMES.keys()) or (bool(keys & {"curl", "rest"}) and not path)
    pairs = [pair for pair in map(_pair, head) if pair is not None]
    # The header of a table may begin with such a name too, but has no digits.
    return any(key in TIMES for key, _, _ in pairs) or (
        _pair(head[0]) is not None and any(map(str.isdigit, pairs[0][2]))
    )


TIMINGS = Format("timings", _recognizes, _contents, "row", "shot", 0, ("shot", "keep"))


def _key(text: str) -> tuple[str, str]:
    """A known quantity and the unit that follows it, if any, as in `curl_ft`;
    empty if unknown."""
    words = [word for word in _SPLIT.split(text.strip().strip("\"'").lower()) if word]
    for count in range(len(words), max(len(words) - 2, 0), -1):
        name = "_".join(words[:count])
        name = _ALIASES.get(name, name)
        if name in KINDS:
            return name, "".join(words[count:])
    column = parse_header(text.strip("\"' "))
    if column is None or column.base not in RATES:
        return "", ""
    unit = column.unit if column.stated else ""
    return column.quantity.replace("omega", "spin"), unit


def _meant(key: str, text: str) -> str:
    """The quantity under a heading: words alone under that of the spin
    are its sense."""
    return "handle" if key == "spin" and not any(map(str.isdigit, text)) else key


def _header(line: str) -> list[str]:
    """The headings in a line."""
    return header_cells(line, separator_of(line))


def _pair(line: str) -> tuple[str, str, str] | None:
    """Quantity, unit and text of a line; None if it names no known quantity."""
    match = _LINE.match(line)
    if match is None:
        return None
    key, unit = _key(match[1])
    return (key, unit, match[2]) if key else None


def _rows(file: TextFile, *, table: bool = False) -> list[Row]:
    """Each record in the file, which is a `table` even if it has one column of
    times or none."""
    body = [
        (index, text)
        for index, line in enumerate(file.lines)
        if (text := line.split("#", 1)[0].strip(" ")).strip()
        and not text.startswith("[")
    ]
    if not table and not is_table([text for _, text in body]):
        return [Row(body[0][0] + 1 if body else 0, _entries(file, body), {}, [])]
    if len(body) > _MOST_ROWS:
        raise file.error(f"more than {_MOST_ROWS} throws", body[_MOST_ROWS][0])
    first, head = body[0]
    separator = separator_of(head)
    names = _without_blank_end(_header(head))
    header = [_key(name) for name in names]
    rows: dict[int, list[str]] = {}
    for index, text in body[1:]:
        values = _without_blank_end(_cells(text, separator, len(names)), len(names))
        if len(values) != len(names):
            fault = (
                f"{counted(len(values), 'cell')}, expected "
                f"{len(names)} as in the header"
            )
            raise file.error(fault, index)
        rows[index + 1] = ["" if cell.lower() in GAPS else cell for cell in values]
    if not rows:
        raise file.error("a header but no rows", first)
    labels, notes = _labels(names, header, list(rows.values()))
    return [
        Row(
            line,
            {
                _meant(key, cell): Entry(line, cell, unit)
                for (key, unit), cell in zip(header, values, strict=True)
                if key and cell
            },
            {label: values[place] for place, label in labels.items() if values[place]},
            notes,
        )
        for line, values in rows.items()
    ]


def _labels(
    names: Sequence[str],
    header: Sequence[tuple[str, str]],
    rows: Sequence[Sequence[str]],
) -> tuple[dict[int, str], list[Finding]]:
    """Columns that are labels, by place, and notes on those that are not used."""
    labels = {}
    unused = []
    strange = []
    for place, name in enumerate(names):
        label = "_".join(name.lower().split())
        key, _ = header[place]
        if key and all(_meant(key, row[place]) == "handle" for row in rows):
            labels[place] = "handle"
        if key or not name:
            continue
        like = _LIKE_MEASUREMENTS & set(_SPLIT.split(name.lower()))
        measured = sum(_is_measurement(row[place]) for row in rows)
        if label not in LABELS and (like or 2 * measured > len(rows)):
            strange.append(name)
        words = sum(not is_number(row[place] or "0") for row in rows)
        if label in LABELS or 2 * words > len(rows):
            labels[place] = label
        else:
            unused.append(name)
    notes = []
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


def _without_blank_end(row: list[str], fewest: int = 1) -> list[str]:
    """A row without the empty cells at its end, but of some cells at least."""
    while len(row) > fewest and not row[-1]:
        row.pop()
    return row


def _cells(line: str, separator: str | None, width: int) -> list[str]:
    """Cells of a row, in which a quotation mark may be that of inches."""
    parts = (
        [] if separator is None else [part.strip() for part in line.split(separator)]
    )
    if len(parts) == width and all(
        part[:1] != '"' or part[-1:] == '"' for part in parts
    ):
        return [
            part[1:-1].replace('""', '"') if part[:1] == '"' else part for part in parts
        ]
    return cells(line, separator)


def _entries(file: TextFile, body: Sequence[tuple[int, str]]) -> dict[str, Entry]:
    """The quantities of a record, by name."""
    entries: dict[str, Entry] = {}
    for index, line in body:
        text = line.strip()
        pair = _pair(text)
        if pair is None:
            if not entries and re.fullmatch(r"(?i)(name|key|quantity|what)\W.*", text):
                continue  # a header
            raise file.error(f"{quoted(text)} is not known; {EXPECTED}", index)
        heading, unit, value = pair
        key = _meant(heading, value)
        if key in entries:
            raise file.error(f"{key} is given twice", index)
        entries[key] = Entry(index + 1, value, unit)
    return entries


def usual_law(file: TextFile) -> str:
    """The law by which each row of a file is fitted for itself if none is named. Raises
    `DataError` as the reader."""
    return _law_of_draws(_rows(file))


def _usual_law(rows: list[Row]) -> str:
    """The law that the measurements determine: of an evening, in the numbers of a draw,
    with a force that turns it where the curl was measured."""
    if len(rows) < _MANY:
        return _law_of_draws(rows)
    return "power+deflection" if _told({"curl"}, rows) else "power"


def _law_of_draws(rows: list[Row]) -> str:
    """The law of draws one by one: the curl needs one that curls and slows the spin as
    stones do, and of a single throw the turns too; times and positions along the sheet
    determine a mean friction."""
    curls = _told({"curl"}, rows)
    if len(rows) < _MANY:
        curls = curls and _told({"turns", "spin"}, rows)
    return "front-back" if curls else "coulomb"


def _told(keys: set[str], rows: list[Row]) -> bool:
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
    head = file.head()
    path = Path(file_and_number(source)[0]).resolve()
    names = path.parts, path.with_suffix("").parts
    rows_of_throw = []
    any_named = False
    for row in _rows(file, table=True):
        name = row.labels.pop("file", None) or row.labels.pop("track", None) or ""
        parts = Path(name.replace("\\", "/")).parts
        if parts:
            any_named = True
            if any(parts == ending[-len(parts) :] for ending in names):
                rows_of_throw.append(row)
    if not any_named:
        raise file.error(
            "no names of throws; expected a column `file` or `track`", head
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
