"""`curlfit check`: what was understood of a data file."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from curlfit.cli import reading as r
from curlfit.cli import settings as s

if TYPE_CHECKING:
    from rich.console import Console

    from curlfit.readers.reading import Reading
    from curlfit.throw import Floats, Throw

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


def check(
    data: Annotated[
        Path,
        typer.Argument(help="Data as for `curlfit fit`.", metavar="DATA", show_default=False),
    ],
    format: r.Format = None,
    axes: r.Axes = None,
    units: r.Units = None,
    reference: r.Reference = None,
    stone_index: r.StoneIndex = None,
    shot: r.Shot = None,
    config: Annotated[
        Path | None,
        typer.Option(help="TOML file with settings of `curlfit fit`; flags override it."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Draw the data to this file.", metavar="CHECK.png")
    ] = None,
) -> None:
    """Show what was understood of a data file, and fit nothing.

    Exit status 0 where a fit could begin, 2 where the file cannot be used.

    Example: `curlfit check data/jensen_shegelski_2004.csv`
    """
    from curlfit.errors import InputError
    from curlfit.readers import read
    from curlfit.readers.assemble import assemble

    if out is not None:
        if out.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(f"--out {out}: expected a name that ends in .png, .pdf or .svg")
        if not out.absolute().parent.is_dir():
            raise InputError(f"--out {out}: the folder {out.parent} does not exist")
    flags = r.how(format, axes, units, reference, stone_index, shot)
    configured = s.checked(s.read_config(config), str(config))
    how = s.how_to_read(configured, flags)
    axes, points = how.pop("axes", None), how.pop("reference", None)
    reading = read(data, **how, pixels=points is not None)
    throw = assemble(reading, axes=axes, reference=points and Path(points))
    throw, wanted, _ = s.settled(throw, configured, flags)
    throw.until(wanted.get("until")).require_motion()

    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 110, highlight=False)
    _show(console, reading, throw, wanted)
    if out is not None:
        _draw(throw, out)
        console.print(f"Written: {out}", soft_wrap=True)


def _show(console: Console, reading: Reading, throw: Throw, wanted: dict[str, Any]) -> None:
    import numpy as np
    from rich.table import Table

    console.print(
        f"{reading.source}: {reading.format}, {len(throw)} rows, "
        f"t = {throw.t[0]:.6g} .. {throw.t[-1]:.6g} s",
        soft_wrap=True, markup=False,
    )  # fmt: skip
    table = Table(box=None, pad_edge=False)
    for name in ("column", "quantity", "unit", "factor", "rows", "gaps", "range in the file"):
        right = name in ("factor", "rows", "gaps")
        table.add_column(name, justify="right" if right else "left", overflow="fold")
    from rich.text import Text

    for header, column, values in reading.series:
        seen = values[np.isfinite(values)] / column.factor
        span = f"{seen.min():.6g} .. {seen.max():.6g}" if len(seen) else "-"
        cells = (
            header, column.quantity, column.unit, f"{column.factor:.6g}", str(len(values)),
            str(int((~np.isfinite(values)).sum())), span,
        )  # fmt: skip
        table.add_row(*map(Text, cells))
    console.print(table)
    console.print()
    for line in _facts(throw, wanted):
        console.print(line, markup=False, soft_wrap=True)
    if throw.notes:
        console.print("\nNotes")
        for note in throw.notes:
            console.print(f"- {note}", markup=False, soft_wrap=True)
    for name, values in _curves(throw):
        if not np.isfinite(values).any():
            continue
        lines = _braille(throw.t, values)
        low, high = np.nanmin(values), np.nanmax(values)
        console.print(f"\n{name}: {low:.4g} .. {high:.4g}", markup=False)
        for line in lines:
            console.print(line, markup=False, soft_wrap=True)


def _facts(throw: Throw, wanted: dict[str, Any]) -> Iterator[str]:
    import numpy as np

    from curlfit.throw import CHANNELS, UNITS

    step = np.diff(throw.t)
    if len(step):
        usual = float(np.median(step))
        yield (
            f"interval   {usual:.6g} s"
            + (f" ({step.min():.4g} .. {step.max():.4g} s)" if np.ptp(step) > 1e-6 * usual else "")
            + f", {1 / usual:.6g} rows a second"
        )
        gaps = np.flatnonzero(step > max(2.5 * usual, 1.5 * float(np.quantile(step, 0.9))))
        if len(gaps):
            k = int(gaps[np.argmax(step[gaps])])
            longest = f"the longest {step[k]:.4g} s after t = {throw.t[k]:.6g} s"
            yield f"pauses     {len(gaps)}, {longest}"
    for name, row in (("first row", 0), ("last row", -1)):
        values = (
            f"{c} {getattr(throw, c)[row] + 0.0:.6g} {UNITS[c]}"
            for c in throw.seen
            if np.isfinite(getattr(throw, c)[row])
        )
        yield ", ".join([f"{name:<10} t {throw.t[row]:.6g} s", *values])
    parts = []
    for channel in throw.seen:
        values = getattr(throw, channel)
        values = values[np.isfinite(values)]
        noise = _scatter(values)
        if noise > 1e-12:
            parts.append(f"{channel} {noise:.2g} {UNITS[channel]}")
        jumps = _jumps(values, noise)
        if jumps:
            yield f"jumps      {jumps} in {channel}: steps far from those around them"
    if parts:
        yield "scatter    " + ", ".join(parts) + " (from row to row)"
    if throw.sigma:
        yield "sigma      given for " + ", ".join(c for c in CHANNELS if c in throw.sigma)
    yield "rest       " + _rest(throw)
    shown = {key: value for key, value in wanted.items() if key not in s.HOW}
    if shown:
        yield "settings   " + ", ".join(f"{key} = {value}" for key, value in shown.items() if value)


def _scatter(values: Floats) -> float:
    """Noise from row to row, by third differences; 0 where there are too few rows."""
    import numpy as np

    if len(values) < 10:
        return 0.0
    return float(np.median(np.abs(np.diff(values, 3)))) / (0.6745 * 20**0.5)


def _jumps(values: Floats, noise: float) -> int:
    """Steps that differ from the median step around them by much more than the noise."""
    import numpy as np

    step = np.diff(values)
    if len(step) < 8:
        return 0
    around = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(step, 3, "edge"), 7), axis=1)
    off = np.abs(step - around)
    if not off.any():
        return 0
    usual = 6 * float(np.median(np.abs(step[step != 0])))  # numbers may be rounded coarsely
    return int((off > np.maximum(max(12 * noise, usual), 3 * np.abs(around)) + 1e-9).sum())


def _rest(throw: Throw) -> str:
    import numpy as np

    seen = np.isfinite(throw.x) & np.isfinite(throw.y)
    if seen.sum() < 4:
        if np.isfinite(throw.speed).any():
            last = throw.speed[np.isfinite(throw.speed)][-1]
            return "at the last row" if last == 0 else f"not reached: {last:.3g} m/s at the end"
        return "not known: the place is hardly seen"
    t, x, y = throw.t[seen], throw.x[seen], throw.y[seen]
    away = np.hypot(x - x[-1], y - y[-1])
    limit = max(0.003, 5 * np.hypot(np.std(np.diff(x, 2)), np.std(np.diff(y, 2))) / 2.4)
    moving = np.flatnonzero(away > limit)
    still = int(moving[-1]) + 1 if len(moving) else 0
    if len(t) - still >= 4 and t[-1] - t[still] > 0.2:
        return f"reached at t = {t[still]:.5g} s, within {1000 * limit:.2g} mm"
    k = max(0, len(t) - max(4, len(t) // 20))
    speed = np.hypot(x[-1] - x[k], y[-1] - y[k]) / (t[-1] - t[k])
    return f"not seen: {speed:.3g} m/s at the last rows"


def _curves(throw: Throw) -> list[tuple[str, Floats]]:
    from curlfit.throw import UNITS

    return [(f"{c} ({UNITS[c]})", getattr(throw, c)) for c in ("y", "x", "phi", "speed", "omega")]


def _braille(t: Floats, values: Floats, width: int = 60, height: int = 4) -> list[str]:
    """A curve over time in Braille dots, `height` lines of `width` signs."""
    import numpy as np

    seen = np.isfinite(values)
    t, values = t[seen], values[seen]
    if 8 <= len(t) < 8 * width:  # a line, broken where rows are missing
        dense = np.linspace(t[0], t[-1], 8 * width)
        pause = np.append(np.diff(t), 0.0)[np.searchsorted(t, dense, "right") - 1]
        near = pause <= 2.5 * np.median(np.diff(t))
        t, values = (np.append(old, new[near]) for old, new in
                     ((t, dense), (values, np.interp(dense, t, values))))  # fmt: skip
    span, rise = max(float(np.ptp(t)), 1e-300), max(float(np.ptp(values)), 1e-300)
    columns = np.minimum(((t - t[0]) / span * (2 * width - 1)).round().astype(int), 2 * width - 1)
    rows = ((values.max() - values) / rise * (4 * height - 1)).round().astype(int)
    grid = np.zeros((height, width), int)
    for column, row in set(zip(columns.tolist(), rows.tolist(), strict=True)):
        grid[row // 4, column // 2] |= _DOTS[column % 2][row % 4]
    return ["".join(chr(0x2800 + int(cell)) for cell in line).rstrip("⠀") for line in grid]


def _draw(throw: Throw, out: Path) -> None:
    import numpy as np
    from matplotlib.figure import Figure

    from curlfit.files import replaced
    from curlfit.throw import UNITS

    seen = throw.seen
    figure = Figure(figsize=(8, 1.8 * len(seen) + 0.6), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(seen), 1, sharex=True))
    for ax, channel in zip(axes, seen, strict=True):
        ax.plot(throw.t, getattr(throw, channel), ".", markersize=3)
        ax.set_ylabel(f"{channel} ({UNITS[channel]})")
        ax.grid(alpha=0.3)
    axes[-1].set_xlabel("t (s)")
    axes[0].set_title(throw.name, fontsize=9)
    with replaced(out) as temporary:
        figure.savefig(temporary, dpi=130, format=out.suffix[1:].lower())
