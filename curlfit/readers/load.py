"""Which format a file has, and the throw in it."""

from __future__ import annotations

import re
from itertools import islice
from os import PathLike
from pathlib import Path

from curlfit.errors import InputError
from curlfit.readers.assemble import assemble
from curlfit.readers.columns import parse_units
from curlfit.readers.digitalcurling import read_digitalcurling
from curlfit.readers.frames import parse_axes
from curlfit.readers.reading import Reading
from curlfit.readers.table import read_table
from curlfit.readers.text import text_of
from curlfit.readers.timings import TIMES, read_timings
from curlfit.readers.tracker import looks_like_tracker, read_tracker
from curlfit.throw import Throw

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
        as `x-along,clockwise,from-tee`; see `curlfit.readers.frames.WORDS`.
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
    if format is not None and format not in FORMATS:
        raise InputError(f"format {format!r}: expected one of {', '.join(FORMATS)}")
    wanted = parse_units(units)
    path = Path(file)
    lines = text_of(path).split("\n")
    kind = format or guessed(lines)
    if shot is not None and kind != "digitalcurling":
        raise InputError(f"--shot: {path} is a {kind} file and holds no shots")
    if stone_index is not None and kind not in ("digitalcurling", "tracker"):
        raise InputError(f"--stone-index: {path} is a {kind} file and holds one stone")
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


__all__ = ["FORMATS", "guessed", "load_throw", "parse_axes", "read"]
