"""Text exports of Tracker, the video tool of Open Source Physics.

A row with the name of the object, such as `mass_A`, precedes the header; several objects are side
by side. Tracker computes `v`, `ω` and the angles `θ_{r}`, `θ` of a point mass from its positions,
so these carry no further information on a stone, and none on its rotation: a column that agrees
with the positions is left out, any other is taken as a measurement.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import Column, in_unit, parse_header
from curlfit.throws.readers.parsed_file import (
    FilePart,
    Format,
    ParsedFile,
    ReadOptions,
    Series,
    choose,
    columns_of,
    in_si,
)
from curlfit.throws.readers.table import defaults_of, first_lines
from curlfit.throws.readers.text import (
    EXPECTED,
    cells,
    clocks_as_seconds,
    header_cells,
    is_number,
    read_rows,
    separator_of,
)

_FEW_VALUES = 5
_MOST_DIGITS = 13
_POLAR = re.compile(r"(θ|theta)_?\{?r\}?(?![a-z])", re.I)


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are a title and a header, or a header with two objects."""
    first = _header(head[0])
    if _known(first) >= 2:
        names = [name.lower() for name in first if name]
        return names.count("x") > 1 and names.count("y") > 1
    return len(head) > 1 and _known(_header(head[1])) >= 2 and not any(map(is_number, first))


def read_tracker(path: Path, lines: list[str], options: ReadOptions) -> ParsedFile:
    """Columns of one object of a Tracker export, by default the first.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    InputError : there is no such object.
    """
    first, comments = first_lines(path, lines)
    settings, reference, notes = defaults_of(path, comments)
    header, separator, names, blocks = _layout(path, lines, first)
    titled = any(title for title, _ in blocks)
    labels = [title or f"object {k}" for k, (title, _) in enumerate(blocks, 1)]
    selected = choose("object", "--stone-index", options.stone_index, labels, 0)
    _, indices = blocks[selected]
    if len(blocks) > 1:
        listed = ", ".join(f"{k} {name}" for k, name in enumerate(labels, 1))
        notes.append(
            f"{len(blocks)} objects: {listed}; taken: {selected + 1} {labels[selected]} "
            "(--stone-index selects another"
            + ("" if options.handle else "; --handle N, one that marks the handle of this stone")
            + ")"
        )
    elif titled:
        notes.append(f"object: {labels[0]}")
    headers = [names[index] for index in indices]
    if "t" not in _quantities(headers):  # one column of times for all
        shared = next((p for p in range(len(names)) if _quantities([names[p]]) == ["t"]), None)
        if shared is not None:
            indices, headers = [shared, *indices], [names[shared], *headers]
    has_angle = "phi" in _quantities(headers)
    readable = headers if has_angle else [_POLAR.sub("θ", name) for name in headers]
    columns, ignored = columns_of(
        path, readable, options.units, line=header + 1, pixels=options.pixels
    )
    mark = _mark(blocks, names, labels, options, selected, columns)
    times = [indices[k] for k, column in columns.items() if column.quantity == "t"]
    rows, clocks = clocks_as_seconds(lines, header + 1, times, separator)
    for k, column in columns.items():
        if indices[k] in clocks:
            columns[k] = in_unit(column.quantity, "s")
            notes.append(f"{headers[k]}: clock times, taken as seconds since {clocks[indices[k]]}")
    wanted = [*(indices[k] for k in columns), *mark]
    numbers, values = read_rows(path, rows, header + 1, names, wanted, separator)
    if not len(numbers):
        raise DataError("a header but no rows of numbers", file=path, line=header + 1)
    parsed = ParsedFile(path, "tracker", [], ignored, settings, reference, notes, numbers)
    series = [
        in_si(parsed, headers[k], column, values[slot])
        for slot, (k, column) in enumerate(_in_units_of_the_file(columns).items())
    ]
    own = [np.isfinite(s.values) for s in series if s.column.quantity != "t"]
    for slot, (place, column) in enumerate(mark.items(), len(columns)):
        series.append(in_si(parsed, names[place], column, values[slot]))
    blank = ~np.any(own, axis=0)
    if blank.any() and not blank.all():  # frames in which this object was not marked
        notes.append(f"{int(blank.sum())} rows without {labels[selected]} left out")
        series = [s._replace(values=s.values[~blank]) for s in series]
        parsed.lines = numbers[~blank]
    parsed.series = series
    _leave_out_derived(parsed)
    return parsed


def _parts(path: Path, lines: list[str], options: ReadOptions) -> list[FilePart]:
    """Every object. Raises `DataError` if the file has no header."""
    indices: list[int | None] = [options.stone_index]
    if options.stone_index is None:
        first, _ = first_lines(path, lines)
        count = len(_layout(path, lines, first).blocks)
        every = [k for k in range(1, count + 1) if k != options.handle]
        indices = [*every] if count > 1 else [None]
    return [
        FilePart(None, k, partial(read_tracker, path, lines, options._replace(stone_index=k)))
        for k in indices
    ]


TRACKER = Format("tracker", _recognizes, read_tracker, _parts, ("stone_index", "handle"))


def _mark(
    blocks: list[tuple[str, list[int]]],
    names: list[str],
    labels: list[str],
    options: ReadOptions,
    stone: int,
    columns: Mapping[int, Column],
) -> dict[int, Column]:
    """Columns of the second mark on the stone, by index; empty if none is requested.

    Its positions are in the same units as those of the stone.

    Raises
    ------
    InputError : there is no such object, it is the stone itself, or it has no positions.
    """
    if options.handle is None:
        return {}
    place = choose("object", "--handle", options.handle, labels, 0)
    if place == stone:
        raise InputError(f"--handle {place + 1} is the stone itself; expected another object")
    own = {column.quantity: column for column in columns.values()}
    found: dict[int, Column] = {}
    for index in blocks[place][1]:
        column = parse_header(names[index])
        if column is None:
            continue
        axis = {"x": "x", "y": "y", "u": "x", "v": "y"}.get(column.quantity)
        stones = own.get(axis or "") or own.get({"x": "u", "y": "v"}.get(axis or "", ""))
        if axis is not None and stones is not None:
            found[index] = stones._replace(quantity=f"{axis}_mark")
    if len(found) != 2:
        raise InputError(f"--handle {place + 1}: {labels[place]} has no columns x and y")
    return found


class _Layout(NamedTuple):
    """Line, separator and cells of the header; title and column indices of each object."""

    header: int
    separator: str | None
    names: list[str]
    blocks: list[tuple[str, list[int]]]


def _layout(path: Path, lines: list[str], first: int) -> _Layout:
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
    return _Layout(header, separator, names, _blocks(names, titles))


def _header(line: str) -> list[str]:
    return header_cells(line, separator_of(line))


def _known(names: Sequence[str]) -> int:
    return len({"t", "x", "y", "phi", "u", "v"} & set(_quantities(names)))


def _quantities(names: Sequence[str]) -> list[str]:
    found = [parse_header(name) for name in names]
    return [column.quantity for column in found if column is not None]


def _blocks(names: list[str], titles: list[str]) -> list[tuple[str, list[int]]]:
    """Title and column indices of each object."""
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


def _in_units_of_the_file(columns: Mapping[int, Column]) -> dict[int, Column]:
    """The columns; `v` and `ω` without a unit take the units of the file's x, phi and t."""
    found = {column.quantity: column for column in columns.values()}
    lengths = {found[axis].factor for axis in ("x", "y") if axis in found}
    result = dict(columns)
    for place, column in columns.items():
        base = found.get({"speed": "x", "omega": "phi"}.get(column.quantity, ""))
        if column.stated or base is None or "t" not in found:
            continue
        if column.quantity == "omega" or len(lengths) == 1:
            unit, factor = f"{base.unit}/{found['t'].unit}", base.factor / found["t"].factor
            result[place] = Column(column.quantity, unit, factor, base.stated)
    return result


def _leave_out_derived(parsed: ParsedFile) -> None:
    """Remove columns that Tracker computed from the positions, in any unit.

    Tracker computes from more digits than it prints, so the rounding of positions is allowed for.
    """
    series = {s.column.quantity: s for s in parsed.series}
    if not {"t", "x", "y"} <= series.keys() or len(series["t"].values) < 5:
        return
    x, y = (_Rounded(series[axis].values, _rounding(series[axis])) for axis in ("x", "y"))
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = _Rounded(
            np.arctan2(y.values, x.values), np.hypot(x.half, y.half) / np.hypot(x.values, y.values)
        )
        drop: dict[str, str] = {}
        if "phi" in series and _is_direction(series["phi"], direction):
            drop["phi"] = "the direction from the origin to the stone, not how the stone turns"
        if "speed" in series:
            (vx, off_x), (vy, off_y) = _rate(series["t"], x), _rate(series["t"], y)
            speed = _Rounded(np.hypot(vx, vy), np.hypot(off_x, off_y))
            if _proportional(series["speed"], speed):
                drop["speed"] = "computed from the positions"
        if "omega" in series:
            if _proportional(series["omega"], _rate(series["t"], direction.unwrapped())):
                drop["omega"] = "the rate of the direction from the origin to the stone"
            elif "phi" in series:
                phi = _Rounded(series["phi"].values, _rounding(series["phi"]))
                if _proportional(series["omega"], _rate(series["t"], phi.unwrapped())):
                    drop["omega"] = "computed from the angle"
    for quantity, why in drop.items():
        parsed.notes.append(f"{series[quantity].header} left out: {why}")
    parsed.series = [s for s in parsed.series if s.column.quantity not in drop]


class _Rounded(NamedTuple):
    """Numbers in SI and their rounding errors, both of shape (n,)."""

    values: Floats
    half: Floats

    def unwrapped(self) -> _Rounded:
        """The unwrapped angle."""
        finite = np.isfinite(self.values)
        values = self.values.copy()
        values[finite] = np.unwrap(values[finite])
        return _Rounded(values, self.half)


def _rate(time: Series, of: _Rounded) -> _Rounded:
    """Central differences, as Tracker takes them; NaN at the ends."""
    t, half = time.values, _rounding(time)
    step = np.diff(t)
    if np.ptp(step) < 1e-6 * np.abs(step).max():
        half = np.zeros_like(t)  # equal steps are not rounded
    rate, off = np.full((2, len(t)), np.nan)
    span = t[2:] - t[:-2]
    rate[1:-1] = (of.values[2:] - of.values[:-2]) / span
    off[1:-1] = (of.half[2:] + of.half[:-2]) / span
    off[1:-1] += np.abs(rate[1:-1]) * (half[2:] + half[:-2]) / span
    return _Rounded(rate, off)


def _proportional(series: Series, computed: _Rounded) -> bool:
    """Whether a column agrees with computed values, in some unit."""
    values, size = series.values, np.abs(computed.values)
    finite = np.isfinite(values) & np.isfinite(size)
    if not finite.any():
        return False
    scale = float(np.quantile(size[finite], 0.95))
    large = finite & (size > 0.3 * scale)
    unit = float(np.median(values[large] / computed.values[large])) if large.any() else 0.0
    if unit <= 0:
        return False
    limit = unit * (2e-3 * scale + computed.half) + _rounding(series)
    return _small(values - unit * computed.values, limit)


def _is_direction(series: Series, direction: _Rounded) -> bool:
    """Whether an angle is the direction of the position, in radians or degrees."""
    units = (1.0,) if series.column.stated else (1.0, math.pi / 180)
    half = _rounding(series)
    for unit in units:
        off = unit * series.values - direction.values
        limit = 1e-3 + direction.half + unit * half
        finite = np.isfinite(off) & np.isfinite(limit)
        if not finite.any():
            continue
        best = np.argmin(np.where(finite, limit, np.inf))
        off = np.remainder(off - off[best] + np.pi, 2 * np.pi) - np.pi
        if _small(off, limit + limit[best]):
            return True
    return False


def _small(off: Floats, limit: Floats) -> bool:
    finite = np.isfinite(off) & np.isfinite(limit)
    return bool(finite.sum() > 2 and np.mean(np.abs(off[finite]) < limit[finite]) > 0.9)


def _rounding(series: Series) -> Floats:
    """Half a unit of the last digit printed of each number, in SI.

    Tracker prints a fixed number of decimals or of significant digits: both are found from the
    numbers, and the coarser is taken. A column of few distinct numbers does not reveal them.
    """
    factor = series.column.factor
    values = np.nan_to_num(series.values / factor)
    if len(np.unique(values[values != 0])) < _FEW_VALUES:
        return np.zeros_like(values)
    size = 10.0 ** np.floor(np.log10(np.abs(np.where(values == 0, 1.0, values))))
    half: Floats = 0.5 * factor * np.maximum(_last_place(values), size * _last_place(values / size))
    return half


def _last_place(values: Floats) -> float:
    """The largest power of ten, at most 1, of which all values are multiples."""
    for digits in range(_MOST_DIGITS):
        whole = values * 10.0**digits
        if (np.abs(whole - np.round(whole)) <= 1e-9 * np.maximum(np.abs(whole), 1.0)).all():
            return 10.0**-digits
    return 0.0
