"""Numbers on the axes of figures: units suited to a size, few ticks with
short labels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from curlfit.output.figures import Floats, literal

_LENGTHS = ((1e3, "km"), (1.0, "m"), (1e-3, "mm"), (1e-6, "\N{MICRO SIGN}m"))
_ANGLES = (
    (2 * np.pi, "turns"),
    (1.0, "rad"),
    (1e-3, "mrad"),
    (1e-6, "\N{MICRO SIGN}rad"),
)
_MIN_IN_UNIT = 0.1  # size in a unit below which the next smaller unit is used
_LETTER_WIDTH = 0.065  # inches, in a tick label
# of a tick to the step; above it, an offset is subtracted from all ticks
_MAX_RATIO = 1e4


def unit_for(size: float, channel: str) -> tuple[float, str]:
    """The unit suited to a size of a channel: its factor to SI and its name."""
    units = _ANGLES if channel in ("phi", "omega") else _LENGTHS
    per = "/s" if channel in ("speed", "omega") else ""
    for factor, unit in units:
        smallest = factor if factor >= 1 else factor * _MIN_IN_UNIT
        if size >= smallest:
            return factor, unit + per
    factor, unit = units[-1]
    return factor, unit + per


def neat_axis(
    axis: Any, label: str, unit: str = "", *, neighbours: bool = False
) -> None:
    """Few ticks with short numbers; a common offset and power of ten go into the label.

    With `neighbours`, no tick label extends beyond the ends of the axis.
    """
    low, high = sorted(map(float, axis.get_view_interval()))
    # letters take up a part of a horizontal axis, but not of a vertical one
    inches = axis.axes.get_window_extent().width / axis.axes.get_figure().dpi
    letter_width = _LETTER_WIDTH if axis.axis_name == "x" else 0.0
    unit = "" if unit == "1" else literal(unit).replace("^2", "\N{SUPERSCRIPT TWO}")
    steps = [1, 2, 3, 4, 5, 10] if neighbours else [1, 2, 5, 10]
    # fewer ticks until their labels fit beside one another
    for most in range(5 if neighbours else 7, 1, -1):
        ticks = np.asarray(MaxNLocator(most, steps=steps).tick_values(low, high))
        step = float(ticks[1] - ticks[0])
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        numbers, offset, power = _tick_labels(ticks, step)
        letters = max(map(len, numbers), default=0)
        label_width = max(0.12, letter_width * letters / inches) * (high - low)
        margin = label_width / 2 if neighbours else 0.0
        inside = (ticks >= low + margin) & (ticks <= high - margin)
        if step > 1.1 * label_width:
            break
    labels = [number for number, shown in zip(numbers, inside, strict=True) if shown]
    axis.set_ticks(ticks[inside], labels=labels)
    text = label + offset
    if power:
        unit = f"$10^{{{power}}}$ {unit}".rstrip()
    if unit:
        text += f"\n({unit})" if offset else f" ({unit})"
    axis.set_label_text(text)


def _tick_labels(ticks: Floats, step: float) -> tuple[list[str], str, int]:
    """Tick labels, the offset subtracted from them as text, and their power of ten."""
    start = 0.0
    power = 0
    largest = float(np.abs(ticks).max(initial=0.0))
    if largest > _MAX_RATIO * step:
        start = float(ticks[len(ticks) // 2])
        power = math.floor(math.log10(step) + 1e-9)
    elif largest > 0:
        power = 3 * math.floor((math.log10(largest) + 1) / 3)
    decimals = max(0, power - math.floor(math.log10(step) + 1e-9))
    numbers = [f"{(value - start) / 10.0**power + 0.0:.{decimals}f}" for value in ticks]
    minus = "\N{MINUS SIGN}"
    offset = f" {'+' if start < 0 else minus} {abs(start):.12g}" if start else ""
    return [number.replace("-", minus) for number in numbers], offset, power
