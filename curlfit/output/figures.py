"""Style of the figures: sizes, colours, lines and marks, words, saving.

Figures are as wide as two journal columns and have journal font sizes. A colour has one
meaning everywhere; markers, dashes and lightness convey the same without colour.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from io import BytesIO
from os import PathLike
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast
from warnings import catch_warnings, filterwarnings

import numpy as np
from matplotlib import rc_context, rc_params_from_file
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager
from matplotlib.mathtext import MathTextParser
from numpy.typing import NDArray

from curlfit.foreign import cut, printable
from curlfit.output.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase
    from matplotlib.text import Text

Floats = NDArray[np.float64]

WIDTH = 180 / 25.4
"""Width of a figure in inches: two journal columns."""
DPI = 220
"""Resolution of PNG files, and of points in PDF and SVG files."""

FIT_COLOR = "#0072B2"
"""of the fitted law"""
REFERENCE_COLOR = "#D55E00"
"""of published or true values, goals and requirements"""
POSTERIOR_COLOR = "#CC79A7"
"""of samples"""
COVARIANCE_COLOR = "#E69F00"
PREDICTION_COLOR = "#56B4E9"
"""of bands and regions of a prediction"""
PALETTE = (
    FIT_COLOR,
    REFERENCE_COLOR,
    "#009E73",
    POSTERIOR_COLOR,
    COVARIANCE_COLOR,
    PREDICTION_COLOR,
    "#000000",
)
"""Colours distinguishable with colour-vision deficiency (Okabe and Ito 2008)."""
DATA_COLOR = "#737373"
QUIET = "0.35"
"""of notes"""

RINGS = ("#e8ecf0", "#ffffff", "#f5e4e0", "#ffffff")
"""of the rings of a house, from the twelve-foot circle to the button"""

DASHES = ("-", "--", "-.", ":")
CHANNEL_LABEL = {
    "x": "x",
    "y": "y",
    "phi": r"\varphi",
    "speed": "v",
    "omega": r"\omega",
}
_UNDATED: dict[str, dict[str, Any]] = {
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}

_MIN_FONT_SIZE = 1.0  # points
MAX_POINTS = 2000  # maximum number drawn of a series


@dataclass(frozen=True)
class Style:
    """How a line or marks look; lengths are in points of print.

    Attributes
    ----------
    dashes : one of `DASHES`, or "none" for marks without a line.
    width : of the line, and of error bars.
    marker : a marker of matplotlib, such as "o"; empty for none.
    size : of a mark.
    edge : width of the edge of a mark.
    fill : colour within a mark, if it is not that of its edge.
    cap : half the width of the ends of error bars.
    zorder : what has a larger one lies above.
    """

    color: str
    dashes: str = "-"
    width: float = 1.2
    marker: str = ""
    size: float = 4.0
    edge: float = 1.0
    fill: str | None = None
    cap: float = 0.0
    zorder: float = 2

    @property
    def is_marks(self) -> bool:
        """Whether there are marks alone, without a line."""
        return self.dashes == "none"

    def options(self) -> dict[str, Any]:
        """Keyword arguments of matplotlib's functions that draw lines."""
        options: dict[str, Any] = {
            "color": self.color,
            "linestyle": self.dashes,
            "linewidth": self.width,
            "zorder": self.zorder,
        }
        # collections of lines know no markers
        if self.marker:
            options |= {
                "marker": self.marker,
                "markersize": self.size,
                "markeredgewidth": self.edge,
                "markerfacecolor": self.fill or self.color,
            }
        return options


DATA = Style(DATA_COLOR, "none", marker="o", size=2.0, edge=0, zorder=1)
LATER_DATA = replace(DATA, edge=0.5, fill="white", size=2.6)
"""of data that were not fitted"""
SHEET_LINE = Style("0.6", width=0.6, zorder=1)
"""of the lines of the sheet"""
ZERO_LINE = Style("0.6", width=0.7, zorder=0.9)


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

    def draw(self, renderer: RendererBase) -> None:
        """Draw in the common style: ticks are made only now."""
        with style():
            super().draw(renderer)

    def savefig(
        self, fname: Any, *, transparent: bool | None = None, **options: Any
    ) -> None:
        """Write the figure as matplotlib's `Figure` does; PDF files have their fonts
        embedded, and no file has a date."""
        format = options.get("format") or FilePath(str(fname)).suffix[1:].lower()
        if format in _UNDATED:
            options["metadata"] = _UNDATED[format] | (options.get("metadata") or {})
        with style():
            super().savefig(fname, transparent=transparent, **options)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=110)
        return file.getvalue()


def subplots(
    height: float, rows: int, columns: int, width: float = WIDTH, **options: Any
) -> tuple[Picture, Any]:
    """A figure of some height in inches with axes in a grid, as large as their
    labels permit."""
    figure = Picture(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def side_by_side(
    figure: Figure,
    top: float,
    height: float,
    count: int = 1,
    *,
    left: float = 0.62,
    right: float = 0.12,
    gap: float = 0.62,
) -> list[Axes]:
    """Axes beside one another at fixed positions, all lengths in inches from the edges
    of the figure: ten times as fast as a layout that measures text."""
    across, tall = figure.get_size_inches()
    width = (across - left - right - gap * (count - 1)) / count
    return [
        figure.add_axes(
            (x / across, 1 - (top + height) / tall, width / across, height / tall)
        )
        for x in left + (width + gap) * np.arange(count)
    ]


def some_rows(n: int, most: int = MAX_POINTS) -> NDArray[np.intp]:
    """Indices of at most `most` evenly spaced rows."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.intp))


def literal(text: str) -> str:
    """Text from outside, for a figure: cut, and no mathematics."""
    shown = cut(printable(text)).replace("$", r"\$")
    # legends omit labels that begin so
    return f" {shown}" if shown.startswith("_") else shown


def file_name(file: str) -> str:
    """The name of a file, for a figure."""
    return literal(FilePath(file).name)


class _Modelled(Protocol):
    """A result of a law under a load."""

    @property
    def law(self) -> str: ...

    @property
    def load(self) -> str: ...


class _WithSymbol(Protocol):
    """A parameter with the symbol that it has in formulas, such as "v_0"."""

    @property
    def symbol(self) -> str: ...


def law_and_load(result: _Modelled) -> str:
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


def symbol_of(parameter: _WithSymbol) -> str:
    """The symbol of a parameter, as mathematics."""
    return f"${math_symbol(parameter.symbol)}$"


def in_symbols(expression: str, symbols: Mapping[str, str]) -> str:
    """Words with symbols in place of names of parameters."""
    words = [
        f"${math_symbol(symbols[word])}$" if word in symbols else literal(word)
        for word in expression.split()
    ]
    return " ".join(word.replace("-", "\N{MINUS SIGN}") for word in words)


def weighted_sum(
    weights: Mapping[str, float], parameters: Mapping[str, _WithSymbol]
) -> str:
    """A combination of parameters in their symbols, for mathematics."""
    text = ""
    for name, weight in weights.items():
        sign = "-" if weight < 0 else "+"
        size = "" if abs(weight) == 1 else f"{abs(weight):.3g}\\,"
        text += f"{sign}{size}{math_symbol(parameters[name].symbol)}"
    return text.removeprefix("+")


def legend_above(axes: Axes, ncols: int | None = None) -> None:
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


def note(
    axes: Axes, x: float, y: float, text: str, color: str = QUIET, **options: Any
) -> Text:
    """Text inside axes, of which (1, 1) is the upper right corner."""
    return axes.text(
        x,
        y,
        text,
        transform=axes.transAxes,
        color=color,
        ha="right" if x > 0.5 else "left",
        va="top" if y > 0.5 else "baseline",
        **options,
    )


def letters(
    panels: Iterable[Axes], aside: float = 0.5, up: float = 4, names: str = "abcdef"
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
    axes: Axes,
    text: str,
    *,
    columns: int = 1,
    margin: float = 1.0,
    loc: Literal["left", "center", "right"] | None = None,
) -> None:
    """A title that fits the width of one of `columns` columns, minus a
    margin in inches."""
    figure = axes.figure
    width = figure.bbox.width / columns - margin * figure.dpi
    shrink(axes.set_title(text, loc=loc), width)


def shrink(text: Text, max_width: float) -> None:
    """Reduce the font size of a text until it is at most `max_width` pixels wide."""
    size = float(text.get_fontsize())
    while text.get_window_extent().width > max_width and size > _MIN_FONT_SIZE:
        size *= 0.95
        text.set_fontsize(size)


def line_styles(number: int) -> list[Style]:
    """Styles of a number of lines; neighbours differ in colour and dashes."""
    return [
        Style(PALETTE[index % len(PALETTE)], DASHES[index % len(DASHES)])
        for index in range(number)
    ]


def save_figure(figure: Figure, file: str | PathLike[str], dpi: int = DPI) -> None:
    """Write a figure atomically, in the format given by the file name."""
    # Drawn in memory: matplotlib's own writers leave half a file on a full disk.
    path = FilePath(file)
    image = BytesIO()
    with rc_context({"svg.fonttype": "none"}):  # text as text
        figure.savefig(image, dpi=dpi, format=path.suffix[1:].lower() or "png")
    atomic_write(path, image.getvalue())
