"""From the columns of a file to a throw: clocks, pixels, unwrapping and axes, in that order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.axes import (
    MAX_SPIN,
    AmbiguousTurnError,
    AxisConvention,
    jump_in_degrees,
    parse_axes,
    spin_quantile,
    turning_rate,
    unwrap,
)
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.mark import add_angle_of_mark
from curlfit.throws.readers.parsed_file import ParsedFile, Series, clock_of
from curlfit.throws.readers.pixels import pixels_to_metres
from curlfit.throws.throw import CHANNELS, Conventions, Throw


def assemble(
    parsed: ParsedFile,
    *,
    axes: str | None = None,
    reference: Path | None = None,
    as_given: bool = False,
) -> Throw:
    """The throw in a parsed file.

    Parameters
    ----------
    axes : words as for `parse_axes`, in place of the file's own. reference : file of known points,
        if positions are in pixels. as_given : accept implausible data.

    Raises
    ------
    DataError, InputError : with the location of the fault.
    """
    settings = dict(parsed.settings)
    own = settings.pop("axes", None)
    words = (own if axes is None else axes) or ""
    convention = parse_axes(words)
    if as_given:
        settings["as_given"] = True
    notes = list(parsed.notes)
    if parsed.events:
        if reference is not None or not convention.is_standard:
            raise InputError(
                f"{parsed.source}: times between lines have no axes and no pixels; leave out "
                "--axes and --reference"
            )
        return Throw.from_events(
            parsed.events, assumed=parsed.assumed, name=str(parsed.source),
            reference=parsed.reference, defaults=settings, notes=tuple(notes),
        )  # fmt: skip
    if parsed.ignored:
        notes.append(f"columns ignored: {', '.join(parsed.ignored)}")
    for series in parsed.series:
        column = series.column
        if column.factor != 1:
            notes.append(f"{column.quantity} converted from {column.unit}")
    parsed = _drop_empty(parsed, notes)

    t, columns, lines = _merge_clocks(parsed, notes)
    merged = parsed if lines is parsed.lines else replace(parsed, lines=lines)
    t, columns, lines = _in_order(merged, t, columns, notes)
    merged = replace(merged, lines=lines)
    calibration: Floats | None = None
    unknown: tuple[str, ...] = ()
    if {"u", "v"} & columns.keys():
        calibration, unknown = pixels_to_metres(merged, t, columns, reference, convention, notes)
    elif reference is not None:
        raise InputError(
            f"--reference {reference}: {parsed.source} has no positions in pixels (columns u, v "
            "or x_px, y_px, or x, y without a unit)"
        )
    if not settings.get("as_given"):
        _require_radians(merged, t, columns, notes)
    _unwrap(merged, t, columns, notes)
    mark = columns.pop("x_mark", None), columns.pop("y_mark", None)
    if not convention.is_standard:
        columns = _to_sheet_axes(columns, convention, len(t))
        notes.append(f"axes: {words}")
    elif "from-hack" in words:
        notes.append("y from the hack")
    relative = {name: columns.pop(f"sigma_{name}") for name in unknown}
    if mark[0] is not None and mark[1] is not None:
        add_angle_of_mark(merged, t, columns, convention.to_sheet(mark[0], mark[1]), notes)
    channels: dict[str, Any] = {name: columns.get(name) for name in CHANNELS}
    return Throw.from_arrays(
        t,
        **channels,
        sigma={c: columns[f"sigma_{c}"] for c in CHANNELS if f"sigma_{c}" in columns},
        relative_sigma=relative,
        calibration=calibration,
        name=str(parsed.source),
        reference=parsed.reference,
        defaults=settings,
        notes=tuple(notes),
        lines=lines,
        conventions=Conventions(
            {series.column.quantity: series.column.unit for series in parsed.series}, words
        ),
    )


def _drop_empty(parsed: ParsedFile, notes: list[str]) -> ParsedFile:
    """The parsed file without empty columns; columns of positions must not be empty."""
    empty = [
        series
        for series in parsed.series
        if not series.column.quantity.startswith("t") and not np.isfinite(series.values).any()
    ]
    if not empty:
        return parsed
    kept = [series for series in parsed.series if all(series is not other for other in empty)]
    measured = any(not s.column.quantity.startswith(("t", "sigma_")) for s in kept)
    for series in empty:
        quantity = series.column.quantity
        if quantity in ("x", "y", "u", "v") or not measured:
            raise parsed.error(
                f"no value of {quantity}: every cell is empty or NaN", quantity=quantity
            )
        notes.append(f"column {series.header} is empty: {quantity} is taken as not measured")
    return replace(parsed, series=kept)


def _merge_clocks(
    parsed: ParsedFile, notes: list[str]
) -> tuple[Floats, dict[str, Floats], np.ndarray | None]:
    """Every column on the union of the times of all clocks; gaps are NaN."""
    found = {series.column.quantity: series.values for series in parsed.series}
    clocks = {name: values for name, values in found.items() if name.split("_")[0] == "t"}
    columns = {name: values for name, values in found.items() if name not in clocks}
    if list(clocks) == ["t"] and np.isfinite(clocks["t"]).all():
        return clocks["t"], columns, parsed.lines
    clock = {name: clock_of(name, clocks) for name in columns}
    used = {
        name: np.any([np.isfinite(columns[c]) for c in columns if clock[c] == name], axis=0)
        for name in clocks
        if name in clock.values()
    }
    for name, rows in used.items():
        late = rows & ~np.isfinite(clocks[name])
        if late.any():
            raise parsed.error(
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
            return clocks[name], columns, parsed.lines
        lines = None if parsed.lines is None else parsed.lines[keep]
        return clocks[name][keep], {c: columns[c][keep] for c in columns}, lines

    # With several clocks, a row of a clock counts only where one of its channels has a value.
    for name, rows in used.items():
        times = clocks[name][rows]
        bad = np.diff(times) <= 0
        if bad.any():
            row = int(np.flatnonzero(rows)[np.argmax(bad) + 1])
            raise parsed.error(
                f"time {clocks[name][row]:g} s is not later than the one before", row, name
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
    return t, merged, None if parsed.lines is None else parsed.lines[origin[index]]


def _in_order(
    parsed: ParsedFile, t: Floats, columns: dict[str, Floats], notes: list[str]
) -> tuple[Floats, dict[str, Floats], np.ndarray | None]:
    """The rows sorted by time; repeated rows appear once, rows of equal time are averaged."""
    lines = parsed.lines
    step = np.diff(t)
    if (step > 0).all():
        return t, columns, lines
    late = np.flatnonzero(step < 0)
    if len(late):
        order = np.argsort(t, kind="stable")
        t, columns = t[order], {name: values[order] for name, values in columns.items()}
        lines = None if lines is None else lines[order]
        place = np.empty(len(t), int)
        place[order] = np.arange(len(t))
        moved = int((np.maximum.accumulate(place) > place).sum())
        notes.append(f"{moved} row{'s' * (moved > 1)} out of the order of time, now sorted")
    first = np.append(True, np.diff(t) > 0)
    if first.all():
        return t, columns, lines
    begin = np.flatnonzero(first)
    owner = np.cumsum(first) - 1
    _require_one_place(replace(parsed, lines=lines), t, columns, begin, owner)
    same = np.all(
        [np.isclose(v, v[begin][owner], rtol=0, atol=0, equal_nan=True) for v in columns.values()],
        axis=0,
    )
    repeated = int((same & ~first).sum())
    means = int((~first).sum()) - repeated
    if repeated:
        notes.append(f"{repeated} repeated row{'s' * (repeated > 1)} left out")
    if means:
        notes.append(
            f"{means + len(np.unique(owner[~same]))} rows share their time with others: means over "
            "rows of one time are taken"
        )
    merged = {}
    for name, values in columns.items():
        finite = np.isfinite(values) & (first | ~same)
        count = np.add.reduceat(finite.astype(float), begin)
        total = np.add.reduceat(np.where(finite, values, 0.0), begin)
        merged[name] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return t[begin], merged, None if lines is None else lines[begin]


def _require_one_place(
    parsed: ParsedFile,
    t: Floats,
    columns: dict[str, Floats],
    begin: np.ndarray,
    owner: np.ndarray,
) -> None:
    """Refuse positions at one time that are farther apart than a stone moves from one time to the
    next (or 0.1 m): two stones, or two throws."""
    if len(begin) < 2:
        raise parsed.error(f"all rows have the same time, {t[0]:g} s", 1, "t")
    for name in ("x", "y"):
        if name not in columns:
            continue
        values = columns[name]
        off = np.abs(values - values[begin][owner])
        off[~np.isfinite(off)] = 0.0
        usual = np.abs(np.diff(values[begin]))
        usual = usual[np.isfinite(usual)]
        limit = max(0.1, 3 * float(np.median(usual)) if len(usual) else 0.0)
        if off.max() > limit:
            row = int(np.argmax(off))
            raise parsed.error(
                f"time {t[row]:g} s is repeated with places {off[row]:.3g} m apart, as of two "
                "stones; name the throw of each row in a column `stone`, and choose one with "
                "`--stone-index N`",
                row,
                "t",
            )


def _require_radians(
    parsed: ParsedFile, t: Floats, columns: dict[str, Floats], notes: list[str]
) -> None:
    """Refuse an angle or a spin without a unit whose numbers cannot be radians.

    They cannot be if they jump by 360 or 180, and are unlikely to be if the stone would turn more
    than twice a second; columns named `phi` and `omega` then are rad and rad/s, with a note.
    """
    for series in parsed.series:
        quantity = series.column.quantity
        if quantity not in ("phi", "omega"):
            continue
        if series.column.stated:
            _require_no_jump(parsed, series, columns[quantity])
            continue
        flag, unit = ("angle", "deg") if quantity == "phi" else ("spin", "deg/s")
        remedy = f"--units {flag}={unit} if so, {flag}=rad{unit[3:]} if not"
        values = columns[quantity]
        jump = jump_in_degrees(values) if quantity == "phi" else None
        if jump is not None:
            row, size = jump
            raise parsed.error(
                f"no unit is given, and the numbers jump by {size} as degrees do; give {remedy}",
                row,
                quantity,
            )
        rate = turning_rate(t, values) if quantity == "phi" else spin_quantile(values)
        if rate <= MAX_SPIN:
            continue
        message = (
            f"no unit is given, and {rate:.3g} rad/s would be more than two turns a second; these "
            f"may be degrees: give {remedy}"
        )
        if series.header.strip().lower() != quantity:
            raise parsed.error(message, quantity=quantity)
        notes.append(f"{quantity}: {message}")


def _require_no_jump(parsed: ParsedFile, series: Series, values: Floats) -> None:
    """Refuse an angle that is in radians by its header but jumps as degrees do."""
    header = parse_header(series.header)
    if series.column.quantity != "phi" or series.column.factor != 1 or header is None:
        return
    jump = jump_in_degrees(values) if header.stated else None
    if jump is not None:
        row, size = jump
        raise parsed.error(
            f"the header says {series.column.unit}, and the numbers jump by {size} as degrees do; "
            "give `--units angle=deg`",
            row,
            "phi",
        )


def _unwrap(parsed: ParsedFile, t: Floats, columns: dict[str, Floats], notes: list[str]) -> None:
    if "phi" not in columns:
        return
    try:
        columns["phi"], jumps, period = unwrap(t, columns["phi"], columns.get("omega"))
    except AmbiguousTurnError as error:
        raise parsed.error(
            "the angle is wrapped and the stone turns so far from row to row that the sense is "
            "ambiguous; expected rows closer in time, an unwrapped angle, or a column of the spin",
            error.row,
            "phi",
        ) from None
    if jumps:
        size = "360" if period > 4 else "180"
        notes.append(f"phi: {jumps} jump{'s' * (jumps > 1)} of {size} degrees removed")


def _to_sheet_axes(
    columns: dict[str, Floats], convention: AxisConvention, n: int
) -> dict[str, Floats]:
    """Columns in curlfit's axes."""
    result = dict(columns)
    blank = np.full(n, np.nan)
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
