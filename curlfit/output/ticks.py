"""Numbers on the axes of figures: units suited to a size, few ticks with
short labels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from curlfit.output.figures import Floats, literal

if TYPE_CHECKING:
    from matplotlib.axis import XAxis, YAxis

_LENGTHS = ((1e3, "km"), (1.0, "m"), (1e-3, "mm"), (1e-6, "\N{MICRO SIGN}m"))
_ANGLES = (
    (2 * np.pi, "turns"),
    (1.0, "rad"),
    (1e-3, "mrad"),
    (1e-6, "\N{MICRO SIGN}rad"),
)
_MIN_IN_UNIT = 0.1  # size in a unit below which the next smaller unit is used
_LETTER_WIDTH = 0.065  # inches, in a tick label
_MAX_RATIO = 1e4  # of a tick to the step, above which all ticks lack an offset


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
    axis: XAxis | YAxis, label: str, unit: str = "", *, neighbours: bool = False
) -> None:
    """Set few ticks with short numbers on an axis, and its label: with the unit, an
    offset that all numbers lack, and their power of ten.

    With `neighbours`, axes on both sides, no number reaches beyond the ends of the
    axis.
    """
    interval = axis.get_view_interval()
    low = float(np.min(interval))
    high = float(np.max(interval))
    # letters take up a part of a horizontal axis, but not of a vertical one
    inches = axis.axes.get_window_extent().width / axis.axes.figure.dpi
    letter_width = _LETTER_WIDTH if axis.axis_name == "x" else 0.0
    unit = "" if unit == "1" else literal(unit).replace("^2", "\N{SUPERSCRIPT TWO}")
    steps = [1, 2, 3, 4, 5, 10] if neighbours else [1, 2, 5, 10]
    # fewer ticks until their labels fit beside one another
    for most in range(5 if neighbours else 7, 1, -1):
        ticks = np.asarray(MaxNLocator(most, steps=steps).tick_values(low, high))
        step = float(ticks[1] - ticks[0])
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        labels = _tick_labels(ticks, step)
        letters = max(map(len, labels.numbers), default=0)
        label_width = max(0.12, letter_width * letters / inches) * (high - low)
        margin = label_width / 2 if neighbours else 0.0
        inside = (ticks >= low + margin) & (ticks <= high - margin)
        if step > 1.1 * label_width:
            break
    numbers = [
        number for number, shown in zip(labels.numbers, inside, strict=True) if shown
    ]
    axis.set_ticks(ticks[inside], labels=numbers)
    text = label + labels.offset
    if labels.power:
        unit = f"$10^{{{labels.power}}}$ {unit}".rstrip()
    if unit:
        text += f"\n({unit})" if labels.offset else f" ({unit})"
    axis.set_label_text(text)


@dataclass(frozen=True)
class _TickLabels:
    """Numbers of ticks, from which an offset was subtracted that is given as text, and
    their power of ten."""

    numbers: list[str]
    offset: str
    power: int


def _tick_labels(ticks: Floats, step: float) -> _TickLabels:
    """Numbers for ticks, which are a step apart, as short as they can be told apart."""
    start = 0.0
    power = 0
    largest = float(np.abs(ticks).max(initial=0.0))
    if largest > _MAX_RATIO * step:
        start = float(ticks[len(ticks) // 2])
        power = _decade(step)
    elif largest > 0:
        # thousands, so that numbers lie between 0.1 and 100
        power = 3 * math.floor((math.log10(largest) + 1) / 3)
    decimals = max(0, power - _decade(step))
    # 0.0 is added since -0.0 would be written with its sign
    numbers = [f"{(value - start) / 10.0**power + 0.0:.{decimals}f}" for value in ticks]
    minus = "\N{MINUS SIGN}"
    offset = f" {'+' if start < 0 else minus} {abs(start):.12g}" if start else ""
    numbers = [number.replace("-", minus) for number in numbers]
    return _TickLabels(numbers, offset, power)


def _decade(step: float) -> int:
    """The power of ten of the first digit of a step, even if rounding left it a little
    short of one."""
    return math.floor(math.log10(step) + 1e-9)
