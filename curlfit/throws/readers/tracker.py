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
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column, parse_header
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.parsed_file import (
    Contents,
    Format,
    ParsedFile,
    Series,
    choose,
    columns_of,
)
from curlfit.throws.readers.table import read_columns
from curlfit.throws.readers.text import (
    EXPECTED,
    TextFile,
    TextTable,
    cells,
    header_cells,
    is_number,
    separator_of,
)

_FEW_VALUES = 5
_MOST_DIGITS = 13
_POLAR = re.compile(r"(θ|theta)_?\{?r\}?(?![a-z])", re.I)
_Objects = list[tuple[str, list[int]]]  # titles and indices of their columns


def _recognizes(head: list[str]) -> bool:
    """Whether the first lines are a title and a header, or a header with two objects."""
    first = _header(head[0])
    if _known(first) >= 2:
        names = [name.lower() for name in first if name]
        return names.count("x") > 1 and names.count("y") > 1
    return len(head) > 1 and _known(_header(head[1])) >= 2 and not any(map(is_number, first))


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The objects of a Tracker export; one that marks the handle is no throw by itself.

    Raises
    ------
    DataError : with the line and column of the fault, and what was expected.
    InputError : there is no such object as the handle.
    """
    first = file.head()
    table, objects = _layout(file, first)
    labels = [title or f"object {k}" for k, (title, _) in enumerate(objects, 1)]

    def parse(index: int) -> ParsedFile:
        parsed = begun(file, "tracker", first)
        if len(objects) > 1:
            listed = ", ".join(f"{k} {name}" for k, name in enumerate(labels, 1))
            other = (
                "" if reading.handle else "; --handle N, one that marks the handle of this stone"
            )
            parsed.notes.append(
                f"{len(objects)} objects: {listed}; taken: {index + 1} {labels[index]} "
                f"(--stone-index selects another{other})"
            )
        elif objects[0][0]:
            parsed.notes.append(f"object: {labels[0]}")
        columns, parsed.ignored = _columns(table, objects[index][1], reading)
        columns |= _mark(table, objects, labels, reading.handle, index, columns)
        read_columns(parsed, table, columns, _in_units_of_the_file)
        # In some frames an object is not marked.
        own = [s.values for s in parsed.series if not s.column.quantity.endswith("_mark")
               and s.column.quantity != "t"]  # fmt: skip
        seen = np.asarray(np.isfinite(own).any(axis=0))
        if seen.any() and not seen.all():
            parsed.notes.append(f"{int((~seen).sum())} rows without {labels[index]} left out")
            parsed = parsed.rows(seen)
        _leave_out_derived(parsed)
        return parsed

    alone = [k for k in range(len(objects)) if len(objects) == 1 or k + 1 != reading.handle]
    return Contents(labels, parse, alone)


TRACKER = Format(
    "tracker", _recognizes, _contents, "object", "stone_index", 0, ("stone_index", "handle")
)


def _columns(
    table: TextTable, indices: list[int], reading: Reading
) -> tuple[dict[int, Column], list[str]]:
    """Columns of one object, by index, and the names of those that are ignored."""
    names = [table.names[index] for index in indices]
    if "t" not in _quantities(names):  # one column of times for all
        shared = [k for k, name in enumerate(table.names) if _quantities([name]) == ["t"]][:1]
        indices, names = [*shared, *indices], [*(table.names[k] for k in shared), *names]
    if "phi" not in _quantities(names):
        names = [_POLAR.sub("θ", name) for name in names]
    columns, ignored = columns_of(names, reading, table.error)
    return {indices[k]: column for k, column in columns.items()}, ignored


def _mark(
    table: TextTable,
    objects: _Objects,
    labels: list[str],
    handle: int | None,
    stone: int,
    columns: Mapping[int, Column],
) -> dict[int, Column]:
    """Columns of the second mark on the stone, by index; empty if none is requested.

    Its positions are in the same units as those of the stone.

    Raises
    ------
    InputError : there is no such object, it is the stone itself, or it has no positions.
    """
    if handle is None:
        return {}
    place = choose("object", "--handle", handle, labels, 0)
    if place == stone:
        raise InputError(f"--handle {place + 1} is the stone itself; expected another object")
    own = {column.base: column for column in columns.values()}
    found: dict[int, Column] = {}
    for index in objects[place][1]:
        column = parse_header(table.names[index])
        axis = {"x": "x", "y": "y", "u": "x", "speed": "y"}.get(column.quantity if column else "")
        stones = own.get(axis or "") or own.get({"x": "u", "y": "v"}.get(axis or "", ""))
        if stones is not None:
            found[index] = stones._replace(quantity=f"{axis}_mark")
    if len(found) != 2:
        raise InputError(f"--handle {place + 1}: {labels[place]} has no columns x and y")
    return found


def _layout(file: TextFile, first: int) -> tuple[TextTable, _Objects]:
    """The table, and its objects."""
    lines, header = file.lines, first
    if _known(_header(lines[first])) < 2:
        below = range(first + 1, min(first + 5, len(lines)))
        header = next((k for k in below if lines[k].strip()), first)
    table = TextTable.at(file, header)
    if _known(table.names) < 2:
        raise table.error(f"no header below the title; {EXPECTED}")
    titles: list[str] = []
    if header != first:
        titles = cells(lines[first], table.separator)
        if table.separator is None and titles:
            titles = [lines[first].strip()]
    return table, _objects(table.names, titles)


def _header(line: str) -> list[str]:
    return header_cells(line, separator_of(line))


def _known(names: Sequence[str]) -> int:
    return len({"t", "x", "y", "phi", "u", "v"} & set(_quantities(names)))


def _quantities(names: Sequence[str]) -> list[str]:
    found = [parse_header(name) for name in names]
    return [column.quantity for column in found if column is not None]


def _objects(names: list[str], titles: list[str]) -> _Objects:
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
    found = {s.column.quantity: _Rounded(s.values, _rounding(s)) for s in parsed.series}
    if not {"t", "x", "y"} <= found.keys() or len(found["t"].values) < 5:
        return
    t, x, y = (found[name] for name in ("t", "x", "y"))
    drop: dict[str, str] = {}
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.hypot(x.values, y.values)
        direction = _Rounded(np.arctan2(y.values, x.values), np.hypot(x.half, y.half) / radius)
        velocity = [_rate(t, axis) for axis in (x, y)]
        speed = _Rounded(*(np.hypot(*parts) for parts in zip(*velocity, strict=True)))
        stated = any(s.column.stated for s in parsed.series if s.column.quantity == "phi")
        units = (1.0,) if stated else (1.0, math.pi / 180)
        if any(_is_direction(found["phi"], direction, unit) for unit in units if "phi" in found):
            drop["phi"] = "the direction from the origin to the stone, not how the stone turns"
        if _proportional(found.get("speed"), speed):
            drop["speed"] = "computed from the positions"
        if _proportional(found.get("omega"), _rate(t, direction.unwrapped())):
            drop["omega"] = "the rate of the direction from the origin to the stone"
        elif "phi" in found and _proportional(
            found.get("omega"), _rate(t, found["phi"].unwrapped())
        ):
            drop["omega"] = "computed from the angle"
    for quantity, header in ((s.column.quantity, s.header) for s in parsed.series):
        if quantity in drop:
            parsed.notes.append(f"{header} left out: {drop[quantity]}")
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


def _rate(time: _Rounded, of: _Rounded) -> _Rounded:
    """Central differences, as Tracker takes them; NaN at the ends."""
    t, step = time.values, np.diff(time.values)
    even = np.ptp(step) < 1e-6 * np.abs(step).max()  # equal steps are not rounded
    half = np.zeros_like(t) if even else time.half
    rate, off = np.full((2, len(t)), np.nan)
    span = t[2:] - t[:-2]
    rate[1:-1] = (of.values[2:] - of.values[:-2]) / span
    off[1:-1] = (of.half[2:] + of.half[:-2] + np.abs(rate[1:-1]) * (half[2:] + half[:-2])) / span
    return _Rounded(rate, off)


def _proportional(given: _Rounded | None, computed: _Rounded) -> bool:
    """Whether a column agrees with computed values, in some unit."""
    size = np.abs(computed.values)
    finite = np.isfinite(size) if given is None else np.isfinite(given.values + size)
    if given is None or not finite.any():
        return False
    scale = float(np.quantile(size[finite], 0.95))
    large = finite & (size > 0.3 * scale)
    unit = float(np.median(given.values[large] / computed.values[large])) if large.any() else 0.0
    limit = unit * (2e-3 * scale + computed.half) + given.half
    return unit > 0 and _small(given.values - unit * computed.values, limit)


def _is_direction(angle: _Rounded, direction: _Rounded, unit: float) -> bool:
    """Whether an angle is the direction of the position, but for its zero and whole turns."""
    off = unit * angle.values - direction.values
    limit = 1e-3 + direction.half + unit * angle.half
    if not np.isfinite(off + limit).any():
        return False
    best = np.nanargmin(np.where(np.isfinite(off), limit, np.nan))
    off = np.remainder(off - off[best] + np.pi, 2 * np.pi) - np.pi
    return _small(off, limit + limit[best])


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
    return np.asarray(
        0.5 * factor * np.maximum(_last_place(values), size * _last_place(values / size))
    )


def _last_place(values: Floats) -> float:
    """The largest power of ten, at most 1, of which all values are multiples."""
    for digits in range(_MOST_DIGITS):
        whole = values * 10.0**digits
        if (np.abs(whole - np.round(whole)) <= 1e-9 * np.maximum(np.abs(whole), 1.0)).all():
            return 10.0**-digits
    return 0.0
