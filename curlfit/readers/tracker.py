"""Text exports of Tracker, the video tool of Open Source Physics.

Above the header stands a row with the name of the object, such as `mass_A`; several objects lie
side by side. Tracker itself computes `v`, `ω` and the angles `θ_{r}`, `θ` of a point mass from its
places, so these say nothing new of a stone, and nothing of how it turns: where a column agrees with
the places it is left out, and otherwise it is taken for a measurement.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from curlfit.errors import DataError
from curlfit.readers.columns import understand
from curlfit.readers.defaults import defaults_of
from curlfit.readers.reading import Reading, choice, columns_of, in_si
from curlfit.readers.table import first_lines
from curlfit.readers.text import EXPECTED, cells, header_cells, is_number, read_rows, separator_of
from curlfit.throw import Floats

_POLAR = re.compile(r"(θ|theta)_?\{?r\}?(?![a-z])", re.I)


def looks_like_tracker(head: Sequence[str]) -> bool:
    """Whether the first lines are a title and a header, or a header with two objects."""
    if not head:
        return False
    first = _header(head[0])
    if _known(first) >= 2:
        names = [name.lower() for name in first if name]
        return names.count("x") > 1 and names.count("y") > 1
    return len(head) > 1 and _known(_header(head[1])) >= 2 and not any(map(is_number, first))


def read_tracker(
    path: Path,
    lines: list[str],
    units: Mapping[str, str],
    *,
    stone_index: int | None = None,
    pixels: bool = False,
) -> Reading:
    """Columns of one object of a Tracker export, the first unless another is wanted.

    Raises
    ------
    DataError : naming the line and column of the fault, and what was expected.
    InputError : there is no such object.
    """
    first, comments = first_lines(path, lines)
    settings, reference, notes = defaults_of(path, comments)
    header = first
    if _known(_header(lines[first])) < 2:
        header = next(
            (k for k in range(first + 1, min(first + 5, len(lines))) if lines[k].strip()), first
        )
    if _known(_header(lines[header])) < 2:
        raise DataError(f"no header below the title; {EXPECTED}", file=path, line=header + 1)
    separator = separator_of(lines[header])
    names = header_cells(lines[header], separator)
    titles = cells(lines[first], separator) if header != first else []
    if separator is None and titles:
        titles = [lines[first].strip()]
    blocks = _blocks(names, titles)
    called = [title or f"object {k}" for k, (title, _) in enumerate(blocks, 1)]
    wanted = choice("object", "--stone-index", stone_index, called, 0)
    _, places = blocks[wanted]
    if len(blocks) > 1:
        listed = ", ".join(f"{k} {name}" for k, name in enumerate(called, 1))
        notes.append(
            f"{len(blocks)} objects: {listed}; taken: {wanted + 1} {called[wanted]} "
            "(--stone-index takes another)"
        )
    elif titles:
        notes.append(f"object: {called[0]}")
    own = [names[place] for place in places]
    if "t" not in _quantities(own):  # one column of times for all
        shared = next((p for p in range(len(names)) if _quantities([names[p]]) == ["t"]), None)
        if shared is not None:
            places, own = [shared, *places], [names[shared], *own]
    has_angle = "phi" in _quantities(own)
    readable = own if has_angle else [_POLAR.sub("θ", name) for name in own]
    columns, ignored = columns_of(path, readable, units, line=header + 1, pixels=pixels)
    numbers, values = read_rows(
        path, lines, header + 1, names, [places[k] for k in columns], separator
    )
    if not len(numbers):
        raise DataError("a header but no rows of numbers", file=path, line=header + 1)
    reading = Reading(path, "tracker", [], ignored, settings, reference, notes, numbers)
    series = [
        in_si(reading, own[k], column, values[slot])
        for slot, (k, column) in enumerate(columns.items())
    ]
    blank = ~np.any([np.isfinite(s.values) for s in series if s.column.quantity != "t"], axis=0)
    if blank.any() and not blank.all():  # frames in which this object was not marked
        notes.append(f"{int(blank.sum())} rows without {called[wanted]} left out")
        series = [s._replace(values=s.values[~blank]) for s in series]
        reading.lines = numbers[~blank]
    reading.series = series
    _leave_out_derived(reading)
    return reading


def _header(line: str) -> list[str]:
    return header_cells(line, separator_of(line))


def _known(names: Sequence[str]) -> int:
    return len({"t", "x", "y", "phi", "u", "v"} & set(_quantities(names)))


def _quantities(names: Sequence[str]) -> list[str]:
    found = [understand(name) for name in names]
    return [column.quantity for column in found if column is not None]


def _blocks(names: list[str], titles: list[str]) -> list[tuple[str, list[int]]]:
    """Title and places of the columns of each object."""
    starts = [k for k, title in enumerate(titles[: len(names)]) if title]
    if len(starts) < 2:
        # a repeated quantity begins the next object
        starts = [0]
        seen: set[str] = set()
        for place, name in enumerate(names):
            quantity = name.strip().lower()
            if quantity and quantity in seen:
                starts.append(place)
                seen = set()
            seen.add(quantity)
    given = [title for title in titles if title]
    if len(given) != len(starts):
        given = given[:1] if len(starts) == 1 else []
    starts[0] = 0
    ends = [*starts[1:], len(names)]
    called = [*given, *[""] * (len(starts) - len(given))]
    return [
        (title, list(range(start, end)))
        for title, start, end in zip(called, starts, ends, strict=True)
    ]


def _leave_out_derived(reading: Reading) -> None:
    """Take away what Tracker computed from the places."""
    found = {s.column.quantity: s.values for s in reading.series}
    if not {"t", "x", "y"} <= found.keys() or len(found["t"]) < 5:
        return
    t, x, y = found["t"], found["x"], found["y"]
    direction = np.arctan2(y, x)
    seen = np.isfinite(direction)
    turning = direction.copy()
    turning[seen] = np.unwrap(direction[seen])
    drop: dict[str, str] = {}
    if "phi" in found:
        off = found["phi"] - direction
        off = off - off[seen][0] if seen.any() else off
        off = np.abs(np.remainder(off + np.pi, 2 * np.pi) - np.pi)
        if _small(off, 1e-3):
            drop["phi"] = "the direction from the origin to the stone, not how the stone turns"
    with np.errstate(divide="ignore", invalid="ignore"):
        vx, vy, pace = _rate(t, x), _rate(t, y), _rate(t, turning)
        if "speed" in found and _close(found["speed"], np.hypot(vx, vy)):
            drop["speed"] = "computed from the places"
        if "omega" in found:
            if _close(found["omega"], pace):
                drop["omega"] = "the turning of the direction from the origin to the stone"
            elif "phi" in found and _close(found["omega"], _rate(t, found["phi"])):
                drop["omega"] = "computed from the angle"
    for series in reading.series:
        quantity = series.column.quantity
        if quantity in drop:
            reading.notes.append(f"{series.header} left out: {drop[quantity]}")
    reading.series = [s for s in reading.series if s.column.quantity not in drop]


def _rate(t: Floats, values: Floats) -> Floats:
    """Central differences; NaN at the ends."""
    rate = np.full(len(t), np.nan)
    rate[1:-1] = (values[2:] - values[:-2]) / (t[2:] - t[:-2])
    return rate


def _close(values: Floats, computed: Floats) -> bool:
    scale = np.nanmax(np.abs(np.append(computed[np.isfinite(computed)], 0.0)))
    return scale > 0 and _small((values - computed) / scale, 2e-3)


def _small(off: Floats, limit: float) -> bool:
    off = off[np.isfinite(off)]
    return len(off) > 2 and bool(np.mean(np.abs(off) < limit) > 0.9)
