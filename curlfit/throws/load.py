"""Throws from files of any format."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from glob import glob
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from curlfit.errors import CurlfitError, DataError, InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import quoted
from curlfit.settings.choices import Reading, takes
from curlfit.throws.odd_row import OddRow
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.columns import parse_units
from curlfit.throws.readers.curling_stone_tracker import CURLING_STONE_TRACKER
from curlfit.throws.readers.deeplabcut import DEEPLABCUT
from curlfit.throws.readers.digitalcurling import DIGITALCURLING
from curlfit.throws.readers.format import Contents, Format
from curlfit.throws.readers.known_points import load_homography
from curlfit.throws.readers.optitrack import OPTITRACK
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.path import TABLE
from curlfit.throws.readers.qualisys import QUALISYS
from curlfit.throws.readers.text import TextFile, is_aside
from curlfit.throws.readers.timings import (
    TIMINGS,
    entry_in,
    usual_law as law_of_timings,
)
from curlfit.throws.readers.tracker import TRACKER
from curlfit.throws.readers.trackmate import TRACKMATE
from curlfit.throws.readers.vernier import VERNIER
from curlfit.throws.readers.vicon import VICON
from curlfit.throws.throw import Throw, counts_from_hack

_READERS = (
    CURLING_STONE_TRACKER,
    DEEPLABCUT,
    DIGITALCURLING,
    OPTITRACK,
    QUALISYS,
    TRACKMATE,
    VERNIER,
    VICON,
    TIMINGS,
    TRACKER,
    TABLE,
)
"""Formats in the order in which they are tried: first those that only one program
writes; the last accepts any file."""
_BY_NAME = {reader.name: reader for reader in reversed(_READERS)}
FORMATS = tuple(_BY_NAME)
_SUFFIXES = (".csv", ".tsv", ".txt", ".jsonl", ".json")
_SWEPT = re.compile(r"[ \t]*#+[ \t]*swept[ \t]*=")
# The format is told by so many first lines, of which so many are neither comments nor
# blank.
_MOST_ASIDES = 200
_HEAD = 30


@takes(Reading)
def load_throw(file: str | PathLike[str], **choices: Any) -> Throw:
    """Read a throw from a file.

    A table has a header and one row for each time. Columns are `t` and any of `x`, `y`,
    `phi`, `speed`, `omega`, and `sigma_x` and so on. Common names and units are
    recognised (`time`, `y_ft`, `angle [deg]`, `phi_rev`), as are separate clocks of
    channels (`t_phi`). Separators are commas, semicolons, tabs or spaces; decimal
    commas are read where the separator is not a comma. Empty cells are gaps. Leading
    lines `# key = value` set defaults of this throw. Wrapped angles are unwrapped.

    Parameters
    ----------
    {choices}

    Raises
    ------
    DataError : with the file, line and column of the fault, and what was expected.
    InputError : an argument that cannot be used.

    Examples
    --------
    >>> throw = curlfit.load_throw("data/jensen_shegelski_2004.csv")
    >>> len(throw), throw.seen
    (230, ('x', 'y', 'phi'))
    """
    reading = Reading.of(**choices)
    return throw_of(read(file, reading), reading)


class Part(NamedTuple):
    """One throw of a file that may contain several.

    Attributes
    ----------
    shot, stone_index : arguments of `load_throw` that select it; None if the file
        has only one.
    throw : the throw, or the error if it cannot be read.
    alone : why a throw determines nothing without others; None if it does.
    left_out : whether a joint fit leaves it out, as `odd_rows` and notes of the others
        say. odd_row : why, if it contradicts the other rows of its table.
    """

    shot: int | None
    stone_index: int | None
    throw: Throw | CurlfitError
    alone: CurlfitError | None = None
    left_out: bool = False
    odd_row: OddRow | None = None


@takes(Reading)
def load_throws(*files: str | PathLike[str], **choices: Any) -> list[Throw]:
    """Read the throws of a joint fit: one from each file, all of a table that holds
    several and, from a table with a throw in each row, all but the odd ones, which the
    others name in `odd_rows`.

    Parameters
    ----------
    {choices}

    Raises
    ------
    DataError : a throw cannot be read; no throw determines friction. InputError : an
        argument that cannot be used.

    Examples
    --------
    >>> throws = curlfit.load_throws("data/two_sheets.csv")
    >>> len(throws), throws[0].labels["sheet"]
    (15, '1')
    """
    reading = Reading.of(**choices)
    parts = []
    for file in files:
        for part in parts_of(file, reading, jointly=True):
            if not part.left_out:
                parts.append(part)
    throws = []
    for part in parts:
        if isinstance(part.throw, CurlfitError):
            raise part.throw
        throw = part.throw
        if part.stone_index is not None and reading.stone_index is None:
            throw = replace(throw, name=f"{throw.name} throw {part.stone_index}")
        throws.append(throw)
    faults = [part.alone for part in parts if part.alone is not None]
    if faults and len(faults) == len(parts):
        raise faults[0]
    return throws


def parts_of(
    file: str | PathLike[str], reading: Reading, *, jointly: bool = False
) -> list[Part]:
    """Every throw in a file: shots of a log, objects of a tracking program, stones of a
    video, throws of a table; `shot` or `stone_index` selects a single one. For a joint
    fit every one of a table alone.

    Raises
    ------
    DataError : the file as a whole cannot be read. InputError : an argument that
        cannot be used.
    """
    path, format, contents = _open(file, reading)
    number = getattr(reading, format.selected_by)
    one_alone = len(contents.labels) < 2 or (jointly and not format.jointly)
    if number is not None or one_alone:
        selected = partial(format.selected, path, contents, number)
        return [_part(selected, reading, format.selected_by, number)]
    indices = range(len(contents.labels)) if contents.among is None else contents.among
    parts = []
    for index in indices:
        parse = partial(contents.parse, index)
        part = _part(parse, reading, format.selected_by, index + 1)
        if index in contents.left_out:
            odd_rows = (odd for odd in contents.odd_rows if odd.row == index + 1)
            part = part._replace(left_out=True, odd_row=next(odd_rows, None))
        parts.append(part)
    return parts


def _part(
    parse: Callable[[], ParsedFile], reading: Reading, key: str, number: int | None
) -> Part:
    """A throw of a file, or why it cannot be read.

    Parameters
    ----------
    key : the choice by which it is selected, "shot" or "stone_index"; `number` is the
        value that selects it.
    """
    selection = {"shot": reading.shot, "stone_index": reading.stone_index, key: number}
    try:
        parsed = parse()
        throw = throw_of(parsed, reading)
    except CurlfitError as error:
        return Part(selection["shot"], selection["stone_index"], error)
    return Part(selection["shot"], selection["stone_index"], throw, parsed.alone)


def rows_of_table(file: str | PathLike[str], reading: Reading) -> list[Part]:
    """The throws in the rows of a stopwatch table, of which none is selected; none of
    another file. Raises as `parts_of`."""
    if reading.shot is not None or format_of(file, reading) != TIMINGS.name:
        return []
    parts = parts_of(file, reading)
    return parts if len(parts) > 1 else []


def throw_of(parsed: ParsedFile, reading: Reading) -> Throw:
    """The throw in a parsed file. Raises `DataError` or `InputError` with the
    place of a fault."""
    make: Callable[..., Throw] = (
        Throw.from_events if parsed.events else Throw.from_arrays
    )
    read_with = tuple(reading.words(Reading))
    throw = make(**assemble(parsed, reading), read_with=read_with)
    if reading.throws is None:
        return throw
    entry = entry_in(Path(reading.throws), throw.name)
    events = entry.events
    notes = [*throw.notes, *entry.notes]
    if events and not counts_from_hack(throw.notes):
        begins_there = Remedy("y-begins-there", Option("axes", "from-hack"))
        notes.append(Finding.note("measurements-not-used", begins_there))
        events = []
    return replace(
        throw,
        labels=throw.labels | entry.labels,
        events=(*throw.events, *events),
        notes=tuple(notes),
    )


def _text_if_any(file: str | PathLike[str], reading: Reading) -> TextFile:
    """A file; without lines if it cannot be read, as is said elsewhere."""
    with suppress(InputError):
        return TextFile.read(Path(file), reading.worksheet)
    return TextFile(Path(file), [])


def states_sweeping(file: str | PathLike[str], reading: Reading) -> bool:
    """Whether a file states that its stone was swept (`# swept = [A, B]`)."""
    comments = _text_if_any(file, reading).comments()
    return any(_SWEPT.match(line) for _, line in comments)


def check_reading(reading: Reading) -> None:
    """Raise `InputError` if no file could be read with these choices."""
    if reading.format is not None and reading.format not in FORMATS:
        raise InputError(
            f"format {quoted(reading.format)}: expected one of {', '.join(FORMATS)}"
        )
    parse_units(reading.units)
    parse_axes(reading.axes)
    if reading.reference is not None:
        load_homography(Path(reading.reference))


def read(file: str | PathLike[str], reading: Reading) -> ParsedFile:
    """The columns of a file in SI."""
    path, format, contents = _open(file, reading)
    return format.selected(path, contents, getattr(reading, format.selected_by))


def _open(file: str | PathLike[str], reading: Reading) -> tuple[Path, Format, Contents]:
    check_reading(reading)
    text = TextFile.read(Path(file), reading.worksheet)
    format = _BY_NAME[reading.format or detect_format(text.lines, reading.columns)]
    format.check(text.path, reading, besides=["worksheet"])
    try:
        return text.path, format, format.contents(text, reading)
    except DataError as error:
        if text.note is not None:
            error.args = (f"{error}; {text.note}",)
        raise


def usual_law(file: str | PathLike[str], reading: Reading) -> str:
    """The law if none is given: for a stopwatch record, the one that its
    values determine."""
    if format_of(file, reading) == TIMINGS.name:
        with suppress(DataError):  # reported where the file is read
            return law_of_timings(_text_if_any(file, reading), reading)
    return "front-back"


def detect_format(lines: list[str], columns: Collection[str] = ()) -> str:
    """The format of a file, from the columns that the user names, if only one has them,
    or from its first lines."""
    for reader in _READERS:
        if set(columns) & set(reader.columns):
            return reader.name
    filled = (line for line in lines[:_MOST_ASIDES] if not is_aside(line))
    head = list(islice(filled, _HEAD)) or ["t"]
    return next(reader.name for reader in _READERS if reader.recognizes(head))


def format_of(file: str | PathLike[str], reading: Reading) -> str:
    """The format of a file, as given or from its first lines."""
    lines = _text_if_any(file, reading).lines
    return reading.format or detect_format(lines, reading.columns)


def found_files(wanted: Sequence[str], besides: Collection[Path] = ()) -> list[Path]:
    """Data files from folders, patterns and names, each once, sorted, except those
    in `besides`.

    Raises
    ------
    InputError : a folder, pattern or name matches no file.
    """
    files: set[Path] = set()
    left_out = {file.resolve() for file in besides}
    for text in wanted:
        path = Path(text)
        if path.is_dir():
            matching = [
                file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES
            ]
            fault = f"no file that ends in {', '.join(_SUFFIXES)} found"
        else:
            matching = [Path(name) for name in glob(text, recursive=True)]
            fault = "no file found"
        readable = [
            file
            for file in matching
            if file.is_file() and file.resolve() not in left_out
        ]
        if not readable:
            raise InputError(f"{text}: {fault}")
        files.update(readable)
    return sorted(files)
