"""From the columns of a file to a throw: clocks, pixels, wraps and axes, in that order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.throws.readers.angles import (
    FASTEST,
    AmbiguousTurnError,
    jump_in_degrees,
    most_of,
    turning_rate,
    unwrap,
)
from curlfit.throws.readers.axes import Frame, parse_axes
from curlfit.throws.readers.homography import load_homography
from curlfit.throws.readers.parsed_file import Reading, clock_of
from curlfit.throws.throw import CHANNELS, Floats, Throw


def assemble(reading: Reading, *, axes: str | None = None, reference: Path | None = None) -> Throw:
    """The throw that a reading describes.

    Parameters
    ----------
    axes : words as for `parse_axes`, in place of the file's own. reference : known points, where
        the places are in pixels.

    Raises
    ------
    DataError, InputError : naming the place of the fault.
    """
    settings = dict(reading.settings)
    own = settings.pop("axes", None)
    frame = parse_axes(own if axes is None else axes)
    notes = list(reading.notes)
    if reading.ignored:
        notes.append(f"columns ignored: {', '.join(reading.ignored)}")
    for series in reading.series:
        column = series.column
        if column.factor != 1:
            notes.append(f"{column.quantity} converted from {column.unit}")
    reading = _without_empty(reading, notes)

    t, columns, lines = _on_one_clock(reading, notes)
    t, columns, lines = _in_order(reading, t, columns, lines)
    sorted_reading = reading if lines is reading.lines else replace(reading, lines=lines)
    if {"u", "v"} & columns.keys():
        _to_metres(sorted_reading, columns, reference, notes)
    elif reference is not None:
        raise InputError(
            f"--reference {reference}: {reading.source} has no places in pixels (columns u, v or "
            "x_px, y_px, or x, y without a unit)"
        )
    _require_radians(sorted_reading, t, columns, notes)
    _unwrap(sorted_reading, t, columns, notes)
    if not frame.plain:
        columns = _turned(columns, frame, len(t))
        notes.append(f"axes: {own if axes is None else axes}")
    return Throw.from_arrays(
        t,
        **{name: columns.get(name) for name in CHANNELS},
        sigma={c: columns[f"sigma_{c}"] for c in CHANNELS if f"sigma_{c}" in columns},
        name=str(reading.source),
        reference=reading.reference,
        defaults=settings,
        notes=tuple(notes),
        lines=lines,
    )


def _without_empty(reading: Reading, notes: list[str]) -> Reading:
    """The reading without columns that hold no value; a throw needs the place, if it has one."""
    empty = [
        series
        for series in reading.series
        if not series.column.quantity.startswith("t") and not np.isfinite(series.values).any()
    ]
    if not empty:
        return reading
    kept = [series for series in reading.series if all(series is not other for other in empty)]
    measured = any(not s.column.quantity.startswith(("t", "sigma_")) for s in kept)
    for series in empty:
        quantity = series.column.quantity
        if quantity in ("x", "y", "u", "v") or not measured:
            raise reading.error(
                f"no value of {quantity}: every cell is empty or NaN", quantity=quantity
            )
        notes.append(f"column {series.header} is empty: {quantity} counts as not measured")
    return replace(reading, series=kept)


def _on_one_clock(
    reading: Reading, notes: list[str]
) -> tuple[Floats, dict[str, Floats], np.ndarray | None]:
    """Every column on the union of the times of all clocks; gaps are NaN."""
    found = {series.column.quantity: series.values for series in reading.series}
    clocks = {name: values for name, values in found.items() if name.split("_")[0] == "t"}
    columns = {name: values for name, values in found.items() if name not in clocks}
    if list(clocks) == ["t"] and np.isfinite(clocks["t"]).all():
        return clocks["t"], columns, reading.lines
    clock = {name: clock_of(name, clocks) for name in columns}
    used = {
        name: np.any([np.isfinite(columns[c]) for c in columns if clock[c] == name], axis=0)
        for name in clocks
        if name in clock.values()
    }
    for name, rows in used.items():
        late = rows & ~np.isfinite(clocks[name])
        if late.any():
            raise reading.error(
                "the time is missing; each row needs one", int(np.argmax(late)), name
            )
    n = len(next(iter(found.values())))
    row_used = np.any(list(used.values()), axis=0) if used else np.zeros(n, bool)
    empty = ~row_used & ~np.any([np.isfinite(clocks[name]) for name in used], axis=0)
    if empty.any():
        notes.append(f"{int(empty.sum())} empty rows left out")
    if len(used) == 1:
        (name,) = used
        keep = np.isfinite(clocks[name])
        if keep.all():
            return clocks[name], columns, reading.lines
        lines = None if reading.lines is None else reading.lines[keep]
        return clocks[name][keep], {c: columns[c][keep] for c in columns}, lines

    # A row of one clock alone counts only where something was seen on it.
    for name, rows in used.items():
        times = clocks[name][rows]
        bad = np.diff(times) <= 0
        if bad.any():
            row = int(np.flatnonzero(rows)[np.argmax(bad) + 1])
            raise reading.error(
                f"time {clocks[name][row]:g} s does not lie after the one before it", row, name
            )
    every = np.concatenate([clocks[name][rows] for name, rows in used.items()])
    origin = np.concatenate([np.flatnonzero(rows) for rows in used.values()])
    t, index = np.unique(every, return_index=True)
    merged: dict[str, Floats] = {}
    for c, values in columns.items():
        rows = used[clock[c]]
        merged[c] = np.full(len(t), np.nan)
        merged[c][np.searchsorted(t, clocks[clock[c]][rows])] = values[rows]
    listed = ", ".join(f"{name} ({int(rows.sum())} rows)" for name, rows in used.items())
    notes.append(f"clocks {listed} merged to {len(t)} times")
    return t, merged, None if reading.lines is None else reading.lines[origin[index]]


def _in_order(
    reading: Reading, t: Floats, columns: dict[str, Floats], lines: np.ndarray | None
) -> tuple[Floats, dict[str, Floats], np.ndarray | None]:
    """Refuse times that do not increase, while the column's header is known."""
    step = np.diff(t)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        fault = "is repeated" if step[row - 1] == 0 else f"follows {t[row - 1]:g} s"
        raise replace(reading, lines=lines).error(
            f"time {t[row]:g} s {fault}; times must increase from row to row", row, "t"
        )
    return t, columns, lines


def _to_metres(
    reading: Reading, columns: dict[str, Floats], reference: Path | None, notes: list[str]
) -> None:
    if reference is None:
        raise DataError(
            "the places are in pixels; give four or more known points with --reference FILE "
            "(columns u,v,x,y)",
            file=reading.source,
        )
    if {"x", "y"} & columns.keys():
        raise DataError("places in pixels and in metres; remove one pair", file=reading.source)
    plane = load_homography(Path(reference))
    u, v = columns.pop("u"), columns.pop("v")
    x, y = plane(u, v)
    seen = np.isfinite(u) & np.isfinite(v)
    lost = seen & ~(np.isfinite(x) & np.isfinite(y) & (np.abs(x) < 1e5) & (np.abs(y) < 1e5))
    if lost.any():
        raise reading.error(
            "this pixel lies at the horizon of the plane through the known points, or beyond",
            int(np.argmax(lost)),
            "v",
        )
    columns["x"], columns["y"] = x, y
    notes.append(
        f"pixels to metres by {plane.points} points of {reference}: "
        + (
            f"they are met to {plane.rms_px:.2g} px, {1000 * plane.rms_m:.2g} mm (rms)"
            if plane.points > 4
            else "four points are met exactly, which says nothing of their errors; take more"
        )
    )
    sizes = plane.jacobian(u, v)
    across, along = (np.hypot(*sizes[k])[seen] for k in (0, 1))
    notes.append(
        f"one pixel is {1000 * across.min():.2g} to {1000 * across.max():.2g} mm in x and "
        f"{1000 * along.min():.2g} to {1000 * along.max():.2g} mm in y along the track: the noise "
        "of a place grows likewise; sigma_u and sigma_v (px) are carried over"
    )
    su, sv = (columns.pop(f"sigma_{axis}", None) for axis in ("u", "v"))
    if su is not None and sv is not None:
        columns["sigma_x"], columns["sigma_y"] = np.hypot(sizes[:, 0] * su, sizes[:, 1] * sv)
    if "phi" in columns:
        notes.append(
            "angles were taken as angles on the ice, seen from above; a slanting camera shows "
            "others"
        )


def _require_radians(
    reading: Reading, t: Floats, columns: dict[str, Floats], notes: list[str]
) -> None:
    """Refuse an angle or a spin without a unit whose numbers cannot be radians.

    They cannot where they jump by 360 or 180 as degrees do, and hardly where the stone would turn
    more than twice a second; `phi` and `omega` themselves are rad and rad/s, and are only noted.
    """
    for series in reading.series:
        quantity = series.column.quantity
        if quantity not in ("phi", "omega") or series.column.stated:
            continue
        flag, unit = ("angle", "deg") if quantity == "phi" else ("spin", "deg/s")
        mend = f"--units {flag}={unit} if so, {flag}=rad{unit[3:]} if not"
        values = columns[quantity]
        jump = jump_in_degrees(values) if quantity == "phi" else None
        if jump is not None:
            row, size = jump
            raise reading.error(
                f"without a unit, and the numbers jump by {size}, as degrees do; give {mend}",
                row,
                quantity,
            )
        rate = turning_rate(t, values) if quantity == "phi" else most_of(values)
        if rate <= FASTEST:
            continue
        told = (
            f"without a unit, and {rate:.3g} rad/s would be more than two turns a second; these "
            f"may be degrees: give {mend}"
        )
        if series.header.strip().lower() != quantity:
            raise reading.error(told, quantity=quantity)
        notes.append(f"{quantity}: {told}")


def _unwrap(reading: Reading, t: Floats, columns: dict[str, Floats], notes: list[str]) -> None:
    if "phi" not in columns:
        return
    try:
        columns["phi"], jumps, period = unwrap(t, columns["phi"], columns.get("omega"))
    except AmbiguousTurnError as error:
        raise reading.error(
            "the angle was reduced to one turn, and the stone turns so far from row to row that "
            "which way cannot be told; expected rows closer in time, an angle that counts on, or "
            "a column of the spin",
            error.row,
            "phi",
        ) from None
    if jumps:
        size = "360" if period > 4 else "180"
        notes.append(f"phi: {jumps} jump{'s' * (jumps > 1)} of {size} degrees undone")


def _turned(columns: dict[str, Floats], frame: Frame, n: int) -> dict[str, Floats]:
    """Columns in curlfit's axes."""
    result = dict(columns)
    blank = np.full(n, np.nan)
    if {"x", "y"} & columns.keys():
        result["x"], result["y"] = frame.place(columns.get("x", blank), columns.get("y", blank))
    if frame.swapped:
        for mine, other in (("sigma_x", "sigma_y"), ("sigma_y", "sigma_x")):
            result.pop(mine, None)
            if other in columns:
                result[mine] = columns[other]
    for name in ("phi", "omega"):
        if name in columns:
            result[name] = frame.turn * columns[name]
    return result
