"""Style of the figures: sizes, colours, axes, units, saving.

Figures are as wide as two journal columns and have journal font sizes. A colour has one
meaning everywhere; markers, dashes and lightness convey the same without colour.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from os import PathLike
from pathlib import Path as FilePath
from typing import Any, cast
from warnings import catch_warnings, filterwarnings

import numpy as np
from matplotlib import rc_context, rc_params_from_file
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.mathtext import MathTextParser
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from curlfit import sheet
from curlfit.foreign import cut, printable

Floats = NDArray[np.float64]

WIDTH = 180 / 25.4
"""Width of a figure in inches: two journal columns."""
DPI = 220
"""Resolution of PNG files, and of points in PDF and SVG files."""

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours distinguishable with colour-vision deficiency (Okabe and Ito 2008)."""
(
    FIT_COLOR,
    REFERENCE_COLOR,
    _,
    POSTERIOR_COLOR,
    COVARIANCE_COLOR,
    PREDICTION_COLOR,
    _,
) = PALETTE
"""of the fitted law; of published or true values, goals and requirements; of samples;
of the covariance; of bands and regions of a prediction"""
DATA_COLOR = "#737373"
QUIET = "0.35"
"""of notes"""

DATA_STYLE: dict[str, Any] = {
    "color": DATA_COLOR,
    "marker": "o",
    "markersize": 2.0,
    "markeredgewidth": 0,
    "linestyle": "none",
    "zorder": 1,
}
LATER_STYLE = DATA_STYLE | {
    "markeredgewidth": 0.5,
    "markerfacecolor": "white",
    "markersize": 2.6,
}
"""of data that were not fitted"""
RINGS = ("#e8ecf0", "#ffffff", "#f5e4e0", "#ffffff")
"""of the rings of a house, from the twelve-foot circle to the button"""
LINE: dict[str, Any] = {"color": "0.6", "lw": 0.6, "zorder": 1}
"""of the lines of the sheet"""
ZERO_LINE: dict[str, Any] = {"color": "0.6", "lw": 0.7, "zorder": 0.9}

DASHES = ("-", "--", "-.", ":")
CHANNEL_LABEL = {
    "x": "x",
    "y": "y",
    "phi": r"\varphi",
    "speed": "v",
    "omega": r"\omega",
}
RATE_LABEL = {"speed": "speed (m/s)", "omega": r"spin $\omega$ (rad/s)"}
_UNDATED: dict[str, dict[str, Any]] = {
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}

_MIN_FONT_SIZE = 1.0  # points
_SLOPES = 40  # maximum number estimated from a measured series
MAX_POINTS = 2000  # maximum number drawn of a series


@lru_cache(1)
def _settings() -> dict[str, Any]:
    """The style sheet, with those of its fonts, one for each script, that
    are installed."""
    file = FilePath(__file__).with_suffix(".mplstyle")
    settings = dict(rc_params_from_file(file, use_default_template=False))
    installed = fontManager.get_font_names()
    return settings | {
        "font.family": [name for name in settings["font.family"] if name in installed]
    }


@contextmanager
def style() -> Iterator[None]:
    """Draw in the common style, whatever the user's matplotlib settings; also as
    a decorator."""
    with rc_context(cast("Any", _settings())), catch_warnings():
        filterwarnings("ignore", message="Glyph .* missing from")
        yield


class Picture(Figure):
    """A matplotlib figure in the common style, which notebooks display
    without pyplot."""

    def draw(self, renderer: Any) -> None:
        """Draw in the common style: ticks are made only now."""
        with style():
            super().draw(renderer)

    def savefig(
        self, fname: Any, *, transparent: bool | None = None, **options: Any
    ) -> None:
        """As in `Figure`; PDF files have their fonts embedded, and no
        file has a date."""
        format = options.get("format") or FilePath(str(fname)).suffix[1:].lower()
        if format in _UNDATED:
            options["metadata"] = _UNDATED[format] | (options.get("metadata") or {})
        with style():
            super().savefig(fname, transparent=transparent, **options)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=110)
        return file.getvalue()


def panels(
    height: float, rows: int, columns: int, width: float = WIDTH, **options: Any
) -> tuple[Picture, Any]:
    """A figure of some height in inches with axes in a grid, as large as their
    labels permit."""
    figure = Picture(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def row(
    figure: Figure,
    top: float,
    height: float,
    count: int = 1,
    *,
    left: float = 0.62,
    right: float = 0.12,
    gap: float = 0.62,
) -> list[Any]:
    """Axes side by side at fixed positions, all lengths in inches from the edges of the
    figure: ten times as fast as a layout that measures text."""
    across, tall = figure.get_size_inches()
    width = (across - left - right - gap * (count - 1)) / count
    return [
        figure.add_axes(
            (x / across, 1 - (top + height) / tall, width / across, height / tall)
        )
        for x in left + (width + gap) * np.arange(count)
    ]


def some_rows(n: int, most: int = MAX_POINTS) -> Any:
    """Indices of at most `most` evenly spaced rows."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def measured_slopes(t: Floats, *series: Floats) -> tuple[Floats, Floats, float]:
    """Slopes of straight lines through groups of successive rows: measured
    speeds and spins.

    Returns
    -------
    mean times of the groups, slopes of each series there, and the duration of a group,
    s. There are at most 40 groups of at least three rows; rows with a gap in any series
    are left out.
    """
    complete = np.isfinite(series).all(0)
    t = t[complete]
    values = np.array(series)[:, complete]
    number = min(_SLOPES, len(t) // 3)
    if number < 2:
        return np.zeros(0), np.zeros((len(series), 0)), 0.0
    middles = []
    slopes = []
    durations = []
    for rows in np.array_split(np.arange(len(t)), number):
        duration = np.ptp(t[rows])
        if duration > 0:
            middle = t[rows].mean()
            dt = t[rows] - middle
            middles.append(middle)
            slopes.append(values[:, rows] @ dt / (dt @ dt))
            durations.append(duration)
    return np.array(middles), np.transpose(slopes), float(np.median(durations))


def plot_rate(
    axes: Any, rows: Mapping[str, Floats], name: str, style: Any = DATA_STYLE
) -> None:
    """Plot the speed or the spin of measured rows, or else the slopes of the
    path or angle."""
    sources = ("x", "y") if name == "speed" else ("phi",)
    series = [rows[source] for source in sources if source in rows]
    if name in rows:
        axes.plot(rows["t"], rows[name], **style)
    elif series:
        times, slopes, span = measured_slopes(rows["t"], *series)
        if len(times):
            rates = np.hypot(*slopes) if name == "speed" else slopes[0]
            label = f"slopes of the data over {span:.2g} s"
            axes.plot(times, rates, **style, label=label)
    axes.set(xlabel="t (s)", ylabel=RATE_LABEL[name])


def x_along_y(axes: Any, y_label: str = "along the sheet, y (m)") -> None:
    """Label axes with x along the sheet, as seen from above, thrown to the right;
    also in feet."""
    axes.set(xlabel=y_label, ylabel="to the right, x (m)")
    axes.invert_yaxis()
    feet(axes)


def feet(axes: Any) -> None:
    """A second vertical axis, in feet, on the right of one in metres."""
    second = axes.secondary_yaxis(
        "right", functions=(lambda m: m / sheet.FOOT, lambda ft: ft * sheet.FOOT)
    )
    second.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    second.set_ylabel("(ft)")
    second.spines["right"].set_visible(True)
    second.grid(visible=False)


def plot_house(axes: Any, centre: tuple[float, float]) -> None:
    """The rings of a house."""
    for radius, color in zip(sheet.CIRCLES, RINGS, strict=True):
        axes.add_patch(Circle(centre, radius, fc=color, ec="0.55", lw=0.6, zorder=0.5))


def sheet_axes(
    axes: Any, names: Mapping[str, str], beyond: float, lw: float = 0.6
) -> None:
    """The lines of the sheet to scale, thrown to the right, and the names of some
    within the ends of the axes, which reach `beyond` the centre line."""
    half = sheet.WIDTH / 2
    lines = [y for name, y in sheet.LINES.items() if name not in ("hack", "centre")]
    axes.vlines(
        [*lines, sheet.TEE + sheet.TEE_TO_BACK], -half, half, **LINE | {"lw": lw}
    )
    axes.set_aspect("equal")
    axes.set_ylim(beyond + 0.1, -beyond - 0.1)
    named = {sheet.LINES[line]: name for line, name in names.items()}
    shown = [y for y in named if y > axes.get_xlim()[0]]
    axes.set_xticks(shown, [named[y] for y in shown])
    axes.set_yticks([-half, 0, half], ["left", "0", "right"])
    axes.tick_params(length=0)
    axes.grid(visible=False)


def literal(text: str) -> str:
    """Text from outside, for a figure: cut, and no mathematics."""
    shown = cut(printable(text)).replace("$", r"\$")
    # legends omit labels that begin so
    return f" {shown}" if shown.startswith("_") else shown


def file_name(file: str) -> str:
    """The name of a file, for a figure."""
    return literal(FilePath(file).name)


def law_and_load(result: Any) -> str:
    """What was fitted, for a title."""
    return f"{literal(result.law)} law, {literal(result.load)} load"


def heading_of(result: Any) -> str:
    """The data of a result and what was fitted, for a title."""
    return f"{file_name(result.data.file)}: {law_and_load(result)}"


@lru_cache
def math_symbol(symbol: str) -> str:
    """A symbol, without its dollar signs, of which TeX and matplotlib do nothing but
    draw it; the letters alone of any other."""
    try:
        MathTextParser("path").parse(f"${symbol}$")
        drawn = re.search(r"[%&#~$\n]|\^\^", symbol) is None
    except ValueError:
        drawn = False
    if drawn:
        return symbol
    letters = re.sub("[^A-Za-z0-9]+", " ", symbol).strip() or "?"
    return rf"\mathrm{{{letters}}}"


def symbol_of(estimate: Any) -> str:
    """The symbol of an estimate, as mathematics."""
    return f"${math_symbol(estimate.symbol)}$"


def in_symbols(expression: str, symbols: Mapping[str, str]) -> str:
    """Words with symbols in place of names of parameters."""
    words = [
        f"${math_symbol(symbols[word])}$" if word in symbols else literal(word)
        for word in expression.split()
    ]
    return " ".join(word.replace("-", "\N{MINUS SIGN}") for word in words)


def weighted_sum(weights: Mapping[str, float], parameters: Mapping[str, Any]) -> str:
    """A combination of parameters in their symbols, for mathematics."""
    text = ""
    for name, weight in weights.items():
        sign = "-" if weight < 0 else "+"
        size = "" if abs(weight) == 1 else f"{abs(weight):.3g}\\,"
        text += f"{sign}{size}{math_symbol(parameters[name].symbol)}"
    return text.removeprefix("+")


def legend_above(axes: Any, ncols: int | None = None) -> None:
    """A legend above the right end of the axes, where no curve runs, if any;
    in one line."""
    count = len(axes.get_legend_handles_labels()[1])
    if count:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=ncols or count,
            borderaxespad=0.1,
            borderpad=0.2,
            columnspacing=1.2,
            handletextpad=0.5,
        )


def note(axes: Any, x: float, y: float, text: str, **style: Any) -> Any:
    """Text inside axes, of which (1, 1) is the upper right corner."""
    style = {"color": QUIET, "ha": "right" if x > 0.5 else "left"} | style
    return axes.text(
        x,
        y,
        text,
        transform=axes.transAxes,
        va="top" if y > 0.5 else "baseline",
        **style,
    )


def letters(
    panels: Iterable[Any], aside: float = 0.5, up: float = 4, names: str = "abcdef"
) -> None:
    """Letters of panels, `aside` inches left of and `up` points above their upper
    left corners."""
    for axes, name in zip(panels, names, strict=False):
        axes.annotate(
            name,
            (0, 1),
            (-72 * aside, up),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=9,
            fontweight="bold",
            va="bottom",
            annotation_clip=False,
        )


def title(
    axes: Any,
    text: str,
    *,
    columns: int = 1,
    margin: float = 1.0,
    loc: str | None = None,
) -> None:
    """A title that fits the width of one of `columns` columns, minus a
    margin in inches."""
    figure = axes.get_figure()
    shrink(
        axes.set_title(text, loc=loc), figure.bbox.width / columns - margin * figure.dpi
    )


def shrink(text: Any, max_width: float) -> None:
    """Reduce the font size of a text until it is at most `max_width` pixels wide."""
    while (
        text.get_window_extent().width > max_width
        and text.get_fontsize() > _MIN_FONT_SIZE
    ):
        text.set_fontsize(0.95 * text.get_fontsize())


def note_stretch(axes: Any) -> None:
    """Note in the label of the horizontal axis by what factor the vertical
    scale is larger."""
    spans = np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1)
    along, across = axes.get_window_extent().size / spans
    if across > 1.5 * along:
        times = float(f"{across / along:.2g}")
        axes.set_xlabel(f"{axes.get_xlabel()}; x is drawn {times:g} times as large")


def line_styles(number: int) -> list[dict[str, Any]]:
    """Colour and dashes of each of `number` lines; neighbours differ in both."""
    return [
        {"color": PALETTE[index % len(PALETTE)], "ls": DASHES[index % len(DASHES)]}
        for index in range(number)
    ]


def save_figure(figure: Figure, file: str | PathLike[str], dpi: int = DPI) -> None:
    """Write a figure atomically, in the format given by the file name."""
    from curlfit.output.files import atomic_write

    # Drawn in memory: matplotlib's own writers leave half a file on a full disk.
    path = FilePath(file)
    image = BytesIO()
    with rc_context({"svg.fonttype": "none"}):  # text as text
        figure.savefig(image, dpi=dpi, format=path.suffix[1:].lower() or "png")
    atomic_write(path, image.getvalue())
