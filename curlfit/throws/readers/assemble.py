"""From the columns of a file to the values of a throw: clocks, pixels,
unwrapping and axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from curlfit.errors import InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.channels import CHANNELS, block_means
from curlfit.throws.readers.angles import (
    add_angle_of_mark,
    add_angle_of_quaternion,
    require_radians,
    unwrap_angle,
)
from curlfit.throws.readers.axes import AxisConvention, parse_axes, states_zero
from curlfit.throws.readers.camera import pixels_to_metres
from curlfit.throws.readers.parsed_file import ParsedFile, clock_of
from curlfit.throws.reference import Conventions

_MEASURED = ("x", "y", "u", "v", "phi")
_PLACEHOLDERS = np.array([0.0, -1.0, -99.0, -999.0, -9999.0, 999.0, 9999.0])
"""What programs write for a value that was lost."""
_MANY = 10
"""Values of a channel that are not the same by chance."""
_Columns = dict[str, Floats]  # by quantity, with the times as "t"


def assemble(parsed: ParsedFile, reading: Reading) -> dict[str, Any]:
    """The values in a parsed file, as arguments of `Throw.from_arrays`, or of
    `Throw.from_events` where the file has events.

    Raises
    ------
    DataError, InputError : with the location of the fault.
    """
    settings = dict(parsed.settings)
    own = settings.pop("axes", None)
    words = (own if reading.axes is None else reading.axes) or ""
    convention = parse_axes(words)
    if reading.as_given:
        settings["as_given"] = True
    parsed = replace(parsed, notes=list(parsed.notes))
    common = {
        "name": str(parsed.source),
        "reference": parsed.reference,
        "defaults": settings,
        "labels": dict(parsed.labels),
    }
    if parsed.events:
        without = []
        if convention != AxisConvention():
            without.append(Option("axes", left_out=True))
        if reading.reference is not None:
            without.append(Option("reference", left_out=True))
        if without:
            raise InputError(
                f"{parsed.source}: times between lines have no axes and no pixels; "
                f"{' and '.join(map(str, without))}",
                options=tuple(without),
            )
        events = {
            "conventions": Conventions(),
            "events": parsed.events,
            "assumed": parsed.assumed,
            "odd_rows": parsed.odd_rows,
        }
        return common | events | {"notes": tuple(parsed.notes)}
    columns = _in_order(parsed, _on_one_clock(parsed))
    as_given = bool(settings.get("as_given"))
    if not as_given:
        columns = _only_measured(parsed, columns)
    calibration, unknown = _in_metres(
        parsed, columns, reading.reference, convention, as_given
    )
    if "quaternion_scalar" in columns:
        add_angle_of_quaternion(parsed, columns)
    if not as_given:
        require_radians(parsed, columns)
    if "phi" in columns:
        parsed.notes += unwrap_angle(parsed, columns)
    mark = [columns.pop(name) for name in ("x_mark", "y_mark") if name in columns]
    columns = _to_sheet_axes(columns, convention)
    if words:
        parsed.notes.append(
            Finding.note("axes", axes=words, states_zero=states_zero(words))
        )
    relative = {name: columns.pop(f"sigma_{name}") for name in unknown}
    if len(mark) == 2:
        add_angle_of_mark(parsed, columns, convention.to_sheet(mark[0], mark[1]))
    return common | {
        **{name: columns.get(name) for name in ("t", *CHANNELS)},
        "sigma": {
            c: columns[f"sigma_{c}"] for c in CHANNELS if f"sigma_{c}" in columns
        },
        "relative_sigma": relative,
        "calibration": calibration,
        "notes": tuple(parsed.notes),
        "lines": parsed.lines,
        "conventions": Conventions(
            {s.column.quantity: s.column.factor for s in parsed.series}, words
        ),
    }


def _not_empty(parsed: ParsedFile) -> _Columns:
    """The columns with a value; those of positions must have one."""
    empty = [
        s
        for s in parsed.series
        if s.column.base != "t" and not np.isfinite(s.values).any()
    ]
    parsed.series = [
        s for s in parsed.series if s.header not in {e.header for e in empty}
    ]
    measured = any(
        not s.column.quantity.startswith(("t", "sigma_")) for s in parsed.series
    )
    for header, column, _ in empty:
        if column.quantity in ("x", "y", "u", "v") or not measured:
            fault = f"no value of {column.quantity}: every cell is empty or NaN"
            raise parsed.error(fault, quantity=header)
        parsed.notes.append(
            Finding.note("empty-column", column=header, quantity=column.quantity)
        )
    return {s.column.quantity: s.values for s in parsed.series}


def _only_measured(parsed: ParsedFile, columns: _Columns) -> _Columns:
    """The columns without what stands for no measurement: a number such as -1 in all of
    a row, and a channel that is the same in all rows. Zeros before the stone moves are
    those of a stone at rest."""
    factors = {s.column.quantity: s.column.factor for s in parsed.series}
    channels = [name for name in columns if name in _MEASURED]
    if not channels:
        return columns
    written = np.column_stack([columns[name] / factors[name] for name in channels])
    first = written[:, :1]
    alike = (np.abs(written - first) <= 1e-12 * np.abs(first)).all(axis=1)
    lost = alike & (first == _PLACEHOLDERS).any(axis=1)
    lost &= np.maximum.accumulate(~alike)
    if len(channels) > 1 and lost.any():
        count = int(lost.sum())
        not_measured = Finding.note(
            "placeholders",
            Remedy("keeps", Option("as-given"), {"count": count}),
            count=count,
            values=np.unique(written[lost, 0]).tolist(),
            **parsed.place(int(np.argmax(lost))),
        )
        parsed.notes.append(not_measured)
        columns = {
            name: np.where(lost, np.nan, values) if name in channels else values
            for name, values in columns.items()
        }
    constant = [name for name in channels if _never_changes(columns[name])]
    if constant and len(constant) < len(channels):
        for name in constant:
            value = columns[name][np.isfinite(columns[name])][0] / factors[name]
            never_changes = Finding.note(
                "never-changes",
                Remedy("keeps", Option("as-given"), {"count": 1}),
                quantity=name,
                value=float(value),
            )
            parsed.notes.append(never_changes)
        left_out = {*constant, *(f"sigma_{name}" for name in constant)}
        columns = {name: v for name, v in columns.items() if name not in left_out}
        parsed.series = [s for s in parsed.series if s.column.quantity not in left_out]
    return columns


def _never_changes(values: Floats) -> bool:
    """Whether many values are all the same."""
    known = values[np.isfinite(values)]
    return len(known) >= _MANY and bool(np.ptp(known) == 0)


def _chosen(parsed: ParsedFile, columns: _Columns, rows: np.ndarray) -> _Columns:
    """Some rows, in another order perhaps."""
    parsed.lines = None if parsed.lines is None else parsed.lines[rows]
    return {name: values[rows] for name, values in columns.items()}


def _on_one_clock(parsed: ParsedFile) -> _Columns:
    """Every column beside the times "t", with a row for each row of each clock;
    gaps are NaN."""
    if parsed.ignored:
        parsed.notes.append(
            Finding.note("columns-ignored", columns=list(parsed.ignored))
        )
    for _, column, _ in parsed.series:
        if column.factor != 1:
            converted = Finding.note(
                "converted", quantity=column.quantity, unit=column.unit
            )
            parsed.notes.append(converted)
    columns = _not_empty(parsed)
    clocks = {
        name: columns.pop(name) for name in list(columns) if name.split("_")[0] == "t"
    }
    clock = {name: clock_of(name, clocks) for name in columns}
    used = {
        name: np.any(
            [np.isfinite(columns[c]) for c in columns if clock[c] == name], axis=0
        )
        for name in clocks
        if name in clock.values()
    }
    for name, rows in used.items():
        late = rows & ~np.isfinite(clocks[name])
        if late.any():
            fault = "the time is missing; each row needs one"
            raise parsed.error(fault, int(np.argmax(late)), name)
        early = np.diff(clocks[name][rows]) <= 0
        if len(used) > 1 and early.any():
            row = int(np.flatnonzero(rows)[np.argmax(early) + 1])
            fault = f"time {clocks[name][row]:g} s is not later than the one before"
            raise parsed.error(fault, row, name)
    timed = {name: np.isfinite(clocks[name]) for name in used}
    empty = int((~np.any([*used.values(), *timed.values()], axis=0)).sum())
    if empty:
        parsed.notes.append(Finding.note("empty-rows", count=empty))
    # of several clocks, a row counts only where one of its channels has a value
    if len(used) == 1:
        used = timed
    else:
        merged = [
            {"clock": name, "rows": int(rows.sum())} for name, rows in used.items()
        ]
        parsed.notes.append(Finding.note("clocks-merged", clocks=merged))
    origin_of = {name: np.flatnonzero(rows) for name, rows in used.items()}
    every = {}
    for quantity, values in columns.items():
        pieces = [
            values[rows] if name == clock[quantity] else np.full(len(rows), np.nan)
            for name, rows in origin_of.items()
        ]
        every[quantity] = np.concatenate(pieces)
    every["t"] = np.concatenate([clocks[c][rows] for c, rows in origin_of.items()])
    _chosen(parsed, {}, np.concatenate(list(origin_of.values())))
    return every


def _in_order(parsed: ParsedFile, columns: _Columns) -> _Columns:
    """The rows sorted by time; repeated rows appear once, rows of equal time
    are averaged."""
    merged = len({s.column.quantity for s in parsed.series if s.column.base == "t"}) > 1
    if (np.diff(columns["t"]) < 0).any():
        order = np.argsort(columns["t"], kind="stable")
        columns = _chosen(parsed, columns, order)
        place = np.argsort(order)
        moved = int((np.maximum.accumulate(place) > place).sum())
        if not merged:
            parsed.notes.append(Finding.note("rows-sorted", count=moved))
    first = np.append(True, np.diff(columns["t"]) > 0)
    if first.all():
        return columns
    begin, owner = np.flatnonzero(first), np.cumsum(first) - 1
    _require_one_place(parsed, columns, begin, owner)
    same = np.all(
        [
            np.isclose(v, v[begin][owner], 0, 0, equal_nan=True)
            for v in columns.values()
        ],
        axis=0,
    )
    repeated = int((same & ~first).sum())
    means = int((~first).sum()) - repeated
    if repeated:
        parsed.notes.append(Finding.note("repeated-rows", count=repeated))
    if means and not merged:
        sharing = means + len(np.unique(owner[~same]))
        parsed.notes.append(Finding.note("equal-times", count=sharing))
    columns = _chosen(parsed, columns, first | ~same)
    begin = np.flatnonzero(np.append(True, np.diff(columns["t"]) > 0))
    means_of = {name: block_means(values, begin)[0] for name, values in columns.items()}
    return means_of | _chosen(parsed, {"t": columns["t"]}, begin)


def _require_one_place(
    parsed: ParsedFile, columns: _Columns, begin: np.ndarray, owner: np.ndarray
) -> None:
    """Refuse positions at one time that are farther apart than a stone moves from one
    time to the next (or 0.1 m): two stones, or two throws."""
    t = columns["t"]
    if len(begin) < 2:
        raise parsed.error(f"all rows have the same time, {t[0]:g} s", 1, "t")
    for values in (columns[name] for name in ("x", "y") if name in columns):
        off = np.abs(values - values[begin][owner])
        off[~np.isfinite(off)] = 0.0
        usual = np.abs(np.diff(values[begin]))
        usual = usual[np.isfinite(usual)]
        if off.max() > max(0.1, 3 * float(np.median(usual)) if len(usual) else 0.0):
            row = int(np.argmax(off))
            select = Option("stone-index", "N")
            raise parsed.error(
                f"time {t[row]:g} s is repeated with places {off[row]:.3g} m apart, "
                "as of two stones; name the throw of each row in a column `stone`, "
                f"and choose one with {select}",
                row,
                "t",
                options=(select,),
            )


def _in_metres(
    parsed: ParsedFile,
    columns: _Columns,
    reference: str | None,
    convention: AxisConvention,
    as_given: bool,
) -> tuple[Floats | None, tuple[str, ...]]:
    """Positions in pixels as metres; returns as `pixels_to_metres`."""
    if {"u", "v"} & columns.keys():
        return pixels_to_metres(parsed, columns, reference, convention, as_given)
    if reference is not None:
        raise InputError(
            f"--reference {reference}: {parsed.source} has no positions in pixels "
            "(columns u, v or x_px, y_px, or x, y without a unit)"
        )
    return None, ()


def _to_sheet_axes(columns: _Columns, convention: AxisConvention) -> _Columns:
    """Columns in curlfit's axes."""
    result = dict(columns)
    blank = np.full(len(columns["t"]), np.nan)
    if {"x", "y"} & columns.keys():
        result["x"], result["y"] = convention.to_sheet(
            columns.get("x", blank), columns.get("y", blank)
        )
    if convention.swapped:
        for mine, other in (("sigma_x", "sigma_y"), ("sigma_y", "sigma_x")):
            result.pop(mine, None)
            if other in columns:
                result[mine] = columns[other]
    for name in ("phi", "omega"):
        if name in columns:
            result[name] = convention.turn * columns[name]
    return result
