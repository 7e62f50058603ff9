"""Figures of one style: colours, axes, units, and how they are saved."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DATA_STYLE: dict[str, Any] = {
    "color": "0.45",
    "marker": "o",
    "markersize": 2.2,
    "linestyle": "none",
    "zorder": 1,
}

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that the colour-blind tell apart (Okabe and Ito 2008)."""

DASHES = ("-", "--", "-.", ":")
CHANNEL_COLOR = dict(zip(("x", "y", "phi", "speed", "omega"), PALETTE, strict=False))
CHANNEL_MARKER = {"x": "o", "y": "s", "phi": "^"}
FIT_COLOR = "#1b2a49"
REFERENCE_COLOR = "#e07a1f"
CHANNEL_LABEL = {"x": "x", "y": "y", "phi": r"\varphi", "speed": "v", "omega": r"\omega"}
_LENGTHS = ((1e3, "km"), (1.0, "m"), (1e-3, "mm"), (1e-6, "\N{MICRO SIGN}m"))
_ANGLES = ((2 * np.pi, "turns"), (1.0, "rad"), (1e-3, "mrad"), (1e-6, "\N{MICRO SIGN}rad"))
_UNIT_SIZES = {
    "x": _LENGTHS,
    "y": _LENGTHS,
    "phi": _ANGLES,
    "speed": tuple((size, f"{unit}/s") for size, unit in _LENGTHS),
    "omega": tuple((size, f"{unit}/s") for size, unit in _ANGLES),
}

_LEAST_SHOWN = 0.1  # in a unit, below which the next smaller one is taken
_LETTER = 0.09  # inches that a letter of a tick's label takes
_LEAST_LETTERS = 1.0  # points
_LONG = 1e4  # steps between ticks in a number, from which a part of it is taken from all
MOST_POINTS = 2000  # drawn of a long series


class Picture(Figure):
    """A matplotlib figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=80)
        return file.getvalue()


def title(
    axes: Any,
    text: str,
    *,
    columns: int = 1,
    margin: float = 1.0,
    loc: str = "left",
    size: float = 10,
) -> None:
    """A title in letters small enough for one of so many columns, less a margin in inches."""
    figure = axes.get_figure()
    found = axes.set_title(text, fontsize=size, loc=loc)
    shrink(found, figure.bbox.width / columns - margin * figure.dpi)


def shrink(text: Any, room: float) -> None:
    """Write a text in letters so small that it takes no more than so many pixels across."""
    while text.get_window_extent().width > room and text.get_fontsize() > _LEAST_LETTERS:
        text.set_fontsize(0.95 * text.get_fontsize())


def unit_for(size: float, channel: str) -> tuple[float, str]:
    """The unit in which a size of a channel is neither tiny nor huge: its size in SI, its name."""
    units = _UNIT_SIZES[channel]
    found = (one for one in units if size >= one[0] * (1.0 if one[0] >= 1 else _LEAST_SHOWN))
    return next(found, units[-1])


def neat_axis(axis: Any, label: str, unit: str = "", *, neighbours: bool = False) -> None:
    """Few ticks with short numbers: a power of ten that they have in common, and what they exceed,
    go into the label. Beside `neighbours` none reaches over the ends."""
    low, high = sorted(map(float, axis.get_view_interval()))
    inches = axis.axes.get_window_extent().width / axis.axes.get_figure().dpi
    letter = _LETTER if axis.axis_name == "x" else 0.0
    unit = "" if unit == "1" else unit.replace("^2", "\N{SUPERSCRIPT TWO}")
    most, steps = (5, [1, 2, 3, 4, 5, 10]) if neighbours else (7, [1, 2, 5, 10])
    while True:
        at = np.asarray(MaxNLocator(most, steps=steps).tick_values(low, high))
        step = float(at[1] - at[0])
        at = at[(at >= low) & (at <= high)]
        numbers, start, power = _short(at, step)
        wide = max(0.12, letter * max(map(len, numbers), default=0) / inches) * (high - low)
        margin = wide / 2 if neighbours else 0.0
        inside = (at >= low + margin) & (at <= high - margin)
        if step > 1.1 * wide or most == 2:
            break
        most -= 1
    labels = [number for number, shown in zip(numbers, inside, strict=True) if shown]
    axis.set_ticks(at[inside], labels=labels)
    ten = f"$10^{{{power}}}$" if power else ""
    behind = " ".join(part for part in (ten, unit) if part)
    between = "\n" if start else " "
    axis.set_label_text(label + start + (f"{between}({behind})" if behind else ""))


def _short(at: Floats, step: float) -> tuple[list[str], str, int]:
    """Numbers for ticks, what is taken from them as a text, and their power of ten."""
    start, power = 0.0, 0
    largest = float(np.abs(at).max(initial=0.0))
    if largest > _LONG * step:
        start = float(at[len(at) // 2])
        power = math.floor(math.log10(step) + 1e-9)
    elif largest > 0:
        power = 3 * math.floor((math.log10(largest) + 1) / 3)
    places = max(0, power - math.floor(math.log10(step) + 1e-9))
    numbers = [f"{(value - start) / 10.0**power + 0.0:.{places}f}" for value in at]
    minus = "\N{MINUS SIGN}"
    said = f" {'+' if start < 0 else minus} {abs(start):.12g}" if start else ""
    return [number.replace("-", minus) for number in numbers], said, power


def note_stretch(axes: Any) -> None:
    """How many times the cross-sheet axis is drawn larger than the other."""
    width, height = axes.get_figure().get_size_inches()
    box = axes.get_position()
    across = height * box.height / np.ptp(axes.get_ylim())
    along = width * box.width / np.ptp(axes.get_xlim())
    factor = across / along
    if factor > 1.5:
        axes.text(
            0.01, 0.04, f"x drawn about {float(f'{factor:.2g}'):g} times as large as y",
            transform=axes.transAxes, fontsize=8, color="0.4",
        )  # fmt: skip


def line_styles(number: int) -> list[dict[str, Any]]:
    """A colour and dashes for each of so many lines."""
    count = len(PALETTE)
    return [
        {"color": PALETTE[place % count], "ls": DASHES[place // count % len(DASHES)]}
        for place in range(number)
    ]


def save_figure(figure: Figure, file: str | PathLike[str], dpi: int = 150) -> None:
    """Write a figure, whole or not at all."""
    from curlfit.output.files import replaced

    # Drawn in memory: on a full disk matplotlib's writers fail in ways of their own.
    path, image = FilePath(file), BytesIO()
    figure.savefig(image, dpi=dpi, format=path.suffix[1:] or "png")
    with replaced(path) as temporary:
        temporary.write_bytes(image.getbuffer())
