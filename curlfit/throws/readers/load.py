"""Which format a file has, and the throw in it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from curlfit.errors import CurlfitError, InputError
from curlfit.throws.readers.assemble import assemble
from curlfit.throws.readers.axes import parse_axes
from curlfit.throws.readers.columns import parse_units
from curlfit.throws.readers.digitalcurling import read_digitalcurling, read_shot, shots_of
from curlfit.throws.readers.homography import load_homography
from curlfit.throws.readers.parsed_file import Reading
from curlfit.throws.readers.table import read_table
from curlfit.throws.readers.text import text_of
from curlfit.throws.readers.timings import TIMES, read_timings
from curlfit.throws.readers.tracker import count_objects, looks_like_tracker, read_tracker
from curlfit.throws.throw import Throw

FORMATS = ("table", "tracker", "digitalcurling", "timings")
_HEAD = 30  # lines that show the format
_TIMED = re.compile(rf"^[^\S\n]*[\"']?({'|'.join(TIMES)})\b", re.I | re.M)


def load_throw(
    file: str | PathLike[str],
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
) -> Throw:
    """Read a throw from a file.

    A table has a header and one row a time. Columns `t`, `x`, `y` are needed; `phi`, `speed`,
    `omega` and `sigma_x` and so on may be there. Common names and units are understood (`time`,
    `y_ft`, `angle [deg]`, `phi_rev`), and a clock of its own for a channel (`t_phi`). Commas,
    semicolons, tabs or spaces separate; decimal commas are read where something else separates.
    Empty cells are gaps. Leading lines `# key = value` are this throw's defaults. Angles that
    were reduced to one turn are made continuous.

    Parameters
    ----------
    format : `table`, `tracker` (exports of Tracker), `digitalcurling` (logs of DigitalCurling 3)
        or `timings`; found by looking at the file if not given.
    axes : the file's axes where they are not curlfit's, as words with commas between them, such
        as `x-along,clockwise,from-tee`; see `curlfit.throws.readers.axes.WORDS`.
    reference : file of known points u, v (pixels), x, y (m), where the places are in pixels.
    stone_index : which object of a Tracker export or stone of a shot, counting from 1.
    shot : which shot of a game's log, counting from 1.
    units : units of columns, over those of the header, such as `t=ms,x=cm,angle=deg`.

    Raises
    ------
    DataError : naming the file, line and column of the fault, and what was expected.
    InputError : an argument that cannot be used.
    """
    points = None if reference is None else Path(reference)
    reading = read(
        file, format, stone_index=stone_index, shot=shot, units=units, pixels=points is not None
    )
    return assemble(reading, axes=axes, reference=points)


class Part(NamedTuple):
    """One throw of a file that may hold several.

    Attributes
    ----------
    shot, stone_index : which one, as `load_throw` takes them; None where the file holds but one.
    throw : the throw, or why this one cannot be read.
    """

    shot: int | None
    stone_index: int | None
    throw: Throw | CurlfitError


def load_throws(
    file: str | PathLike[str],
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
) -> list[Part]:
    """Every throw in a file: each shot of a log, or each object of a Tracker export.

    Arguments are those of `load_throw`; `shot` or `stone_index` takes one of them alone.

    Raises
    ------
    DataError : the file as a whole cannot be read. InputError : an argument that cannot be used.
    """
    points = None if reference is None else Path(reference)
    source = _opened(file, format, stone_index=stone_index, shot=shot)
    pixels = points is not None
    whole = partial(_read, source, stone_index=stone_index, shot=shot, units=units, pixels=pixels)
    parts: list[tuple[int | None, int | None, Callable[[], Reading]]]
    parts = [(shot, stone_index, whole)]
    path, lines, kind = source
    if kind == "digitalcurling" and shot is None:
        shots = shots_of(path, lines)
        if len(shots) > 1:
            parts = [
                (k, stone_index, partial(read_shot, path, lines, taken, stone_index=stone_index))
                for k, taken in enumerate(shots, 1)
            ]
    elif kind == "tracker" and stone_index is None:
        count = count_objects(path, lines)
        if count > 1:
            parts = [(None, k, partial(whole, stone_index=k)) for k in range(1, count + 1)]
    found = []
    for number, index, reading in parts:
        throw: Throw | CurlfitError
        try:
            throw = assemble(reading(), axes=axes, reference=points)
        except CurlfitError as error:
            throw = error
        found.append(Part(number, index, throw))
    return found


def check_how(
    format: str | None = None,
    axes: str | None = None,
    reference: str | PathLike[str] | None = None,
    stone_index: int | None = None,
    *,
    shot: int | None = None,
    units: str | None = None,
) -> None:
    """Raise `InputError` where no file at all could be read with these arguments."""
    _check_format(format)
    for flag, number in (("--shot", shot), ("--stone-index", stone_index)):
        if number is not None and number < 1:
            raise InputError(f"{flag} {number}: expected a whole number from 1")
    parse_units(units)
    parse_axes(axes)
    if reference is not None:
        load_homography(Path(reference))


def read(
    file: str | PathLike[str],
    format: str | None = None,
    *,
    stone_index: int | None = None,
    shot: int | None = None,
    units: str | None = None,
    pixels: bool = False,
) -> Reading:
    """The columns of a file as they were understood, in SI. Arguments as for `load_throw`."""
    source = _opened(file, format, stone_index=stone_index, shot=shot)
    return _read(source, stone_index=stone_index, shot=shot, units=units, pixels=pixels)


def _check_format(format: str | None) -> None:
    if format is not None and format not in FORMATS:
        raise InputError(f"format {format!r}: expected one of {', '.join(FORMATS)}")


class _Opened(NamedTuple):
    """A file's lines, and the format it has."""

    path: Path
    lines: list[str]
    kind: str


def _opened(
    file: str | PathLike[str], format: str | None, *, stone_index: int | None, shot: int | None
) -> _Opened:
    _check_format(format)
    path = Path(file)
    lines = text_of(path).split("\n")
    kind = format or guessed(lines)
    if shot is not None and kind != "digitalcurling":
        raise InputError(f"--shot: {path} is a {kind} file and holds no shots")
    if stone_index is not None and kind not in ("digitalcurling", "tracker"):
        raise InputError(f"--stone-index: {path} is a {kind} file and holds one stone")
    return _Opened(path, lines, kind)


def _read(
    source: _Opened,
    *,
    stone_index: int | None,
    shot: int | None,
    units: str | None,
    pixels: bool,
) -> Reading:
    path, lines, kind = source
    wanted = parse_units(units)
    if kind == "digitalcurling":
        return read_digitalcurling(path, lines, stone_index=stone_index, shot=shot)
    if kind == "timings":
        return read_timings(path, lines)
    if kind == "tracker":
        return read_tracker(path, lines, wanted, stone_index=stone_index, pixels=pixels)
    return read_table(path, lines, wanted, pixels=pixels)


def guessed(lines: list[str]) -> str:
    """The format that the first lines of a file look like."""
    shown = (line for line in lines[:200] if line.strip() and not line.lstrip().startswith("#"))
    head = list(islice(shown, _HEAD))
    if not head:
        return "table"
    first = head[0].lstrip()
    if first.startswith("{") or re.match(r"\[\s*([{\[]|$)", first):
        return "digitalcurling"
    if _TIMED.search("\n".join(head)):
        return "timings"
    return "tracker" if looks_like_tracker(head[:3]) else "table"


__all__ = [
    "FORMATS", "Part", "check_how", "guessed", "load_throw", "load_throws", "parse_axes", "read",
]  # fmt: skip
