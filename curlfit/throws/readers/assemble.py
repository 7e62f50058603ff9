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
_APART = 0.1
"""m; at one time, a stone is at places no farther apart."""
_Columns = dict[str, Floats]  # by quantity, with the times as "t"


def assemble(parsed: ParsedFile, reading: Reading) -> dict[str, Any]:
    """The values in a parsed file, as arguments of `Throw.from_arrays`, or of
    `Throw.from_events` where the file has events.

    Raises
    ------
    DataError, InputError : with the location of the fault.
    """
    settings = dict(parsed.settings)
    axes = settings.pop("axes", None)
    if reading.axes is not None:
        axes = reading.axes
    axes = axes or ""
    convention = parse_axes(axes)
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
        _require_no_axes(parsed, convention, reading)
        return common | {
            "conventions": Conventions(),
            "events": parsed.events,
            "assumed": parsed.assumed,
            "odd_rows": parsed.odd_rows,
            "notes": tuple(parsed.notes),
        }
    columns = _in_order(parsed, _on_one_clock(parsed))
    as_given = bool(settings.get("as_given"))
    if not as_given:
        columns = _only_measured(parsed, columns)
    calibration, unscaled = _in_metres(
        parsed, columns, reading.reference, convention, as_given
    )
    if "quaternion_scalar" in columns:
        add_angle_of_quaternion(parsed, columns)
    if not as_given:
        require_radians(parsed, columns)
    if "phi" in columns:
        parsed.notes += unwrap_angle(parsed, columns)
    mark = None
    if {"x_mark", "y_mark"} <= columns.keys():
        mark = convention.to_sheet(columns.pop("x_mark"), columns.pop("y_mark"))
    columns = _to_sheet_axes(columns, convention)
    if axes:
        parsed.notes.append(
            Finding.note("axes", axes=axes, states_zero=states_zero(axes))
        )
    relative_sigma = {name: columns.pop(f"sigma_{name}") for name in unscaled}
    if mark is not None:
        add_angle_of_mark(parsed, columns, mark)
    return common | {
        **{name: columns.get(name) for name in ("t", *CHANNELS)},
        "sigma": {
            name: columns[f"sigma_{name}"]
            for name in CHANNELS
            if f"sigma_{name}" in columns
        },
        "relative_sigma": relative_sigma,
        "calibration": calibration,
        "notes": tuple(parsed.notes),
        "lines": parsed.lines,
        "conventions": Conventions(_factors(parsed), axes),
    }


def _require_no_axes(
    parsed: ParsedFile, convention: AxisConvention, reading: Reading
) -> None:
    """Refuse choices of axes and pixels for times between lines."""
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


def _factors(parsed: ParsedFile) -> dict[str, float]:
    """Number in SI over number in the file, by quantity."""
    return {series.column.quantity: series.column.factor for series in parsed.series}


def _not_empty(parsed: ParsedFile) -> _Columns:
    """The columns with a value; those of positions must have one."""
    empty = [
        series
        for series in parsed.series
        if series.column.base != "t" and not np.isfinite(series.values).any()
    ]
    headers = {series.header for series in empty}
    parsed.series = [series for series in parsed.series if series.header not in headers]
    measured = any(
        not series.column.quantity.startswith(("t", "sigma_"))
        for series in parsed.series
    )
    for header, column, _ in empty:
        if column.quantity in ("x", "y", "u", "v") or not measured:
            fault = f"no value of {column.quantity}: every cell is empty or NaN"
            raise parsed.error(fault, quantity=header)
        parsed.notes.append(
            Finding.note("empty-column", column=header, quantity=column.quantity)
        )
    return {series.column.quantity: series.values for series in parsed.series}


def _only_measured(parsed: ParsedFile, columns: _Columns) -> _Columns:
    """The columns without what stands for no measurement: a number such as -1 in all of
    a row, and a channel that is the same in all rows. Zeros before the stone moves are
    those of a stone at rest."""
    factors = _factors(parsed)
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
            measured = columns[name][np.isfinite(columns[name])]
            never_changes = Finding.note(
                "never-changes",
                Remedy("keeps", Option("as-given"), {"count": 1}),
                quantity=name,
                value=float(measured[0] / factors[name]),
            )
            parsed.notes.append(never_changes)
        left_out = {*constant, *(f"sigma_{name}" for name in constant)}
        columns = {
            name: values for name, values in columns.items() if name not in left_out
        }
        parsed.series = [
            series for series in parsed.series if series.column.quantity not in left_out
        ]
    return columns


def _never_changes(values: Floats) -> bool:
    """Whether many values are all the same."""
    measured = values[np.isfinite(values)]
    return len(measured) >= _MANY and bool(np.ptp(measured) == 0)


def _keep_lines(parsed: ParsedFile, rows: np.ndarray) -> None:
    """Keep the lines of some rows, in another order perhaps."""
    parsed.lines = None if parsed.lines is None else parsed.lines[rows]


def _select_rows(parsed: ParsedFile, columns: _Columns, rows: np.ndarray) -> _Columns:
    """The columns with some of their rows, in another order perhaps; the parsed file
    keeps the lines of these."""
    _keep_lines(parsed, rows)
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
    times_of = {
        name: columns.pop(name) for name in list(columns) if name.split("_")[0] == "t"
    }
    clock_by_quantity = {name: clock_of(name, times_of) for name in columns}
    has_value = {}  # of each clock in use, the rows with a value of its quantities
    for clock in times_of:
        measured = [
            np.isfinite(values)
            for quantity, values in columns.items()
            if clock_by_quantity[quantity] == clock
        ]
        if measured:
            has_value[clock] = np.any(measured, axis=0)
    several_clocks = len(has_value) > 1
    for clock, rows in has_value.items():
        _require_times(parsed, clock, times_of[clock], rows, in_order=several_clocks)
    has_time = {clock: np.isfinite(times_of[clock]) for clock in has_value}
    filled = np.any([*has_value.values(), *has_time.values()], axis=0)
    empty_rows = int((~filled).sum())
    if empty_rows:
        parsed.notes.append(Finding.note("empty-rows", count=empty_rows))
    # Of several clocks, a row counts only where one of its channels has a value.
    rows_that_count = has_value if several_clocks else has_time
    rows_of = {clock: np.flatnonzero(rows) for clock, rows in rows_that_count.items()}
    if several_clocks:
        merged = [
            {"clock": clock, "rows": len(rows)} for clock, rows in rows_of.items()
        ]
        parsed.notes.append(Finding.note("clocks-merged", clocks=merged))
    on_one_clock = {}
    for quantity, values in columns.items():
        pieces = [
            values[rows]
            if clock == clock_by_quantity[quantity]
            else np.full(len(rows), np.nan)
            for clock, rows in rows_of.items()
        ]
        on_one_clock[quantity] = np.concatenate(pieces)
    on_one_clock["t"] = np.concatenate(
        [times_of[clock][rows] for clock, rows in rows_of.items()]
    )
    _keep_lines(parsed, np.concatenate(list(rows_of.values())))
    return on_one_clock


def _require_times(
    parsed: ParsedFile, clock: str, times: Floats, rows: np.ndarray, *, in_order: bool
) -> None:
    """Raise `DataError` where a row that needs a time has none or, if the times must be
    in order, one that is not later than that of the row before.

    Parameters
    ----------
    clock : the quantity of the times. rows : whether each row needs one.
    """
    without_time = rows & ~np.isfinite(times)
    if without_time.any():
        fault = "the time is missing; each row needs one"
        raise parsed.error(fault, int(np.argmax(without_time)), clock)
    backward = np.diff(times[rows]) <= 0
    if in_order and backward.any():
        row = int(np.flatnonzero(rows)[np.argmax(backward) + 1])
        fault = f"time {times[row]:g} s is not later than the one before"
        raise parsed.error(fault, row, clock)


def _in_order(parsed: ParsedFile, columns: _Columns) -> _Columns:
    """The rows sorted by time; repeated rows appear once, rows of equal time
    are averaged."""
    clocks = {
        series.column.quantity for series in parsed.series if series.column.base == "t"
    }
    merged = len(clocks) > 1
    if (np.diff(columns["t"]) < 0).any():
        order = np.argsort(columns["t"], kind="stable")
        columns = _select_rows(parsed, columns, order)
        # A row has moved if one that was above it is now below it.
        row_after = np.argsort(order)
        moved = int((np.maximum.accumulate(row_after) > row_after).sum())
        if not merged:
            parsed.notes.append(Finding.note("rows-sorted", count=moved))
    is_later = np.append(True, np.diff(columns["t"]) > 0)
    if is_later.all():
        return columns
    # The rows of one time are a group, which begins with a later row.
    begin = np.flatnonzero(is_later)
    group = np.cumsum(is_later) - 1
    _require_one_place(parsed, columns, begin, group)
    as_first = np.all(
        [
            np.isclose(values, values[begin][group], 0, 0, equal_nan=True)
            for values in columns.values()
        ],
        axis=0,
    )
    repeated = int((as_first & ~is_later).sum())
    averaged = int((~is_later).sum()) - repeated
    if repeated:
        parsed.notes.append(Finding.note("repeated-rows", count=repeated))
    if averaged and not merged:
        sharing = averaged + len(np.unique(group[~as_first]))
        parsed.notes.append(Finding.note("equal-times", count=sharing))
    columns = _select_rows(parsed, columns, is_later | ~as_first)
    begin = np.flatnonzero(np.append(True, np.diff(columns["t"]) > 0))
    _keep_lines(parsed, begin)
    means = {name: block_means(values, begin)[0] for name, values in columns.items()}
    means["t"] = columns["t"][begin]
    return means


def _require_one_place(
    parsed: ParsedFile, columns: _Columns, begin: np.ndarray, group: np.ndarray
) -> None:
    """Refuse positions at one time that are farther apart than a stone moves in three
    steps of time (or `_APART`): two stones, or two throws.

    Parameters
    ----------
    begin : the first row of each time. group : of each row, which of these times it
        has.
    """
    t = columns["t"]
    if len(begin) < 2:
        raise parsed.error(f"all rows have the same time, {t[0]:g} s", 1, "t")
    for name in ("x", "y"):
        if name not in columns:
            continue
        values = columns[name]
        off = np.abs(values - values[begin][group])
        off[~np.isfinite(off)] = 0.0
        steps = np.abs(np.diff(values[begin]))
        steps = steps[np.isfinite(steps)]
        usual = float(np.median(steps)) if len(steps) else 0.0
        if off.max() > max(_APART, 3 * usual):
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
    """Put positions in metres in place of those in pixels, if there are any.

    Returns
    -------
    The independent errors of the map from pixels to metres, and the channels whose
    sigma is known up to a factor, as of `pixels_to_metres`.
    """
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
        for sigma, sigma_in_file in (("sigma_x", "sigma_y"), ("sigma_y", "sigma_x")):
            result.pop(sigma, None)
            if sigma_in_file in columns:
                result[sigma] = columns[sigma_in_file]
    for name in ("phi", "omega"):
        if name in columns:
            result[name] = convention.turn * columns[name]
    return result
