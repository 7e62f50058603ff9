"""Style of the figures: sizes, colours, axes, units, saving.

Figures are as wide as two journal columns and have journal font sizes. A colour has one meaning
everywhere; markers, dashes and lightness convey the same without colour.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, wraps
from io import BytesIO
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast
from warnings import catch_warnings, filterwarnings

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.ticker import MaxNLocator

from curlfit.foreign import cut, printable
from curlfit.sheet import FOOT

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

P = ParamSpec("P")
R = TypeVar("R")

WIDTH = 180 / 25.4
"""Width of a figure in inches: two journal columns."""
DPI = 220
"""Resolution of PNG files, and of points in PDF and SVG files."""

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours distinguishable with colour-vision deficiency (Okabe and Ito 2008)."""

DATA_COLOR = "#737373"
FIT_COLOR = PALETTE[0]
"""of the fitted law"""
REFERENCE_COLOR = PALETTE[1]
"""of published or true values, goals and requirements"""
PREDICTION_COLOR = PALETTE[5]
"""of bands and regions of a prediction"""
POSTERIOR_COLOR = PALETTE[3]
COVARIANCE_COLOR = PALETTE[4]
OUTLIER_COLOR = PALETTE[6]
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
LATER_STYLE = DATA_STYLE | {"markeredgewidth": 0.5, "markerfacecolor": "white", "markersize": 2.6}
"""of data that were not fitted"""
RINGS = ("#e8ecf0", "#ffffff", "#f5e4e0", "#ffffff")
"""of the rings of a house, from the twelve-foot circle to the button"""
ZERO_LINE: dict[str, Any] = {"color": "0.6", "lw": 0.7, "zorder": 0.9}

DASHES = ("-", "--", "-.", ":")
CHANNEL_MARKER = {"x": "o", "y": "s", "phi": "^"}
CHANNEL_LABEL = {"x": "x", "y": "y", "phi": r"\varphi", "speed": "v", "omega": r"\omega"}
_STYLE: dict[str, Any] = {
    "mathtext.fontset": "dejavusans",
    "text.usetex": False,
    "axes.unicode_minus": True,
    "axes.formatter.limits": (-4, 4),
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "center",
    "axes.titlepad": 4,
    "axes.labelsize": 8,
    "axes.labelpad": 2.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.pad": 2.5,
    "ytick.major.pad": 2.5,
    "legend.fontsize": 7,
    "legend.title_fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "grid.linestyle": "-",
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "figure.constrained_layout.h_pad": 0.04,
    "figure.constrained_layout.w_pad": 0.04,
    "figure.titlesize": 8,
}
_OTHER_SCRIPTS = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "Source Han Sans", "WenQuanYi Zen Hei", "Hiragino Sans",
    "PingFang SC", "Apple SD Gothic Neo", "Yu Gothic", "Microsoft YaHei", "Malgun Gothic",
    "Noto Sans Arabic", "Noto Sans Hebrew", "Noto Sans Thai", "Noto Sans Devanagari",
)  # fmt: skip
_FILES = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": "curlfit"}
"""Embedded TrueType fonts; the same bytes for the same figure."""
_UNDATED = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}

_MIN_FONT_SIZE = 1.0  # points
_SLOPES = 40  # maximum number estimated from a measured series
MAX_POINTS = 2000  # maximum number drawn of a series


@lru_cache(1)
def _fonts() -> list[str]:
    """The font of all text, and those installed for scripts that it lacks."""
    from matplotlib.font_manager import fontManager

    installed = set(fontManager.get_font_names())
    return ["DejaVu Sans", *(name for name in _OTHER_SCRIPTS if name in installed)]


@contextmanager
def _style(more: Mapping[str, Any] | None = None) -> Iterator[None]:
    settings = _STYLE | {"font.family": _fonts()} | dict(more or {})
    with rc_context(cast("Any", settings)), catch_warnings():
        filterwarnings("ignore", message="Glyph .* missing from")
        yield


class Picture(Figure):
    """A matplotlib figure in the common style, which notebooks display without pyplot."""

    def draw(self, renderer: Any) -> None:
        """Draw in the common style: ticks are made only now."""
        with _style():
            super().draw(renderer)

    def savefig(self, fname: Any, *, transparent: bool | None = None, **options: Any) -> None:
        """As in `Figure`; PDF files have their fonts embedded, and no file has a date."""
        format = options.get("format") or FilePath(str(fname)).suffix[1:].lower()
        if format in _UNDATED:
            options["metadata"] = _UNDATED[format] | (options.get("metadata") or {})
        with _style(_FILES):
            super().savefig(fname, transparent=transparent, **options)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=110)
        return file.getvalue()


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Make a function draw in the common style, whatever the user's matplotlib settings."""

    @wraps(draw)
    def drawn(*args: P.args, **options: P.kwargs) -> R:
        with _style():
            return draw(*args, **options)

    return drawn


def panels(
    figure: Figure,
    heights: Sequence[float],
    columns: Sequence[Sequence[float]],
    *,
    left: float = 0.62,
    right: Sequence[float] = (),
    top: float = 0.3,
    bottom: float = 0.42,
    gap: tuple[float, float] = (0.62, 0.68),
) -> list[list[Any]]:
    """Axes in rows at fixed positions: ten times as fast as a layout that measures text.

    Parameters
    ----------
    heights : relative heights of the rows.
    columns : for each row, the relative widths of its columns.
    left, right, top, bottom : margins, inches; `right` has one for each row.
    gap : gaps between columns and between rows, inches.
    """
    width, height = figure.get_size_inches()
    free = height - top - bottom - gap[1] * (len(heights) - 1)
    above, found = top, []
    margins = right or (0.12,) * len(heights)
    for share, row, margin in zip(heights, columns, margins, strict=True):
        tall = free * share / sum(heights)
        across, places = width - left - margin - gap[0] * (len(row) - 1), []
        x = left
        for part in row:
            wide = across * part / sum(row)
            places.append(place(figure, x, above, wide, tall))
            x += wide + gap[0]
        found.append(places)
        above += tall + gap[1]
    return found


def some_rows(n: int, most: int = MAX_POINTS) -> Any:
    """Indices of at most `most` evenly spaced rows."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def measured_slopes(t: Floats, *series: Floats) -> tuple[Floats, list[Floats], float]:
    """Slopes of straight lines through groups of successive rows: measured speeds and spins.

    Returns
    -------
    mean times of the groups, slopes of each series there, and the duration of a group, s. There are
    at most 40 groups of at least three rows; rows with a gap in any series are left out.
    """
    there = np.isfinite(np.array(series)).all(0)
    t, series = t[there], tuple(one[there] for one in series)
    number = min(_SLOPES, len(t) // 3)
    if number < 2:
        return np.zeros(0), [np.zeros(0) for _ in series], 0.0
    groups = [
        rows for rows in np.array_split(np.arange(len(t)), number) if np.ptp(t[rows]) > 0
    ]  # fmt: skip
    centred = [t[rows] - t[rows].mean() for rows in groups]
    slopes = [
        np.array([one[rows] @ dt / (dt @ dt) for rows, dt in zip(groups, centred, strict=True)])
        for one in series
    ]
    durations = [float(np.ptp(t[rows])) for rows in groups]
    return np.array([t[rows].mean() for rows in groups]), slopes, float(np.median(durations))


def feet(axes: Any, side: str, label: str = "") -> None:
    """A second axis in feet, on the "right" or at the "top", in addition to one in metres."""
    make = axes.secondary_yaxis if side == "right" else axes.secondary_xaxis
    second = make(side, functions=(lambda metres: metres / FOOT, lambda foot: foot * FOOT))
    axis = second.yaxis if side == "right" else second.xaxis
    axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axis.set_label_text(f"{label} (ft)".strip())
    second.spines[side].set_visible(True)
    axis.grid(visible=False)


def literal(text: str) -> str:
    """Text from outside, for a figure: cut, and no mathematics."""
    shown = cut(printable(text)).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown  # legends omit labels that begin so


def file_name(file: str) -> str:
    """The name of a file, for a figure."""
    return literal(FilePath(file).name)


def law_and_load(result: Any) -> str:
    """What was fitted, for a title."""
    return f"{literal(result.law)} law, {literal(result.load)} load"


def heading_of(result: Any) -> str:
    """The data of a result and what was fitted, for a title."""
    return f"{file_name(result.data['file'])}: {law_and_load(result)}"


@lru_cache
def math_symbol(symbol: str) -> str:
    """A symbol, without its dollar signs, of which TeX and matplotlib do nothing but draw it; the
    letters alone of any other."""
    try:
        MathTextParser("path").parse(f"${symbol}$")
        drawn = re.search(r"[%&#~$\n]|\^\^", symbol) is None
    except ValueError:
        drawn = False
    return symbol if drawn else rf"\mathrm{{{re.sub('[^A-Za-z0-9]+', ' ', symbol).strip() or '?'}}}"


def in_symbols(expression: str, symbols: Mapping[str, str]) -> str:
    """A sum of parameters with their symbols in place of their names, for matplotlib."""
    words = [
        f"${math_symbol(symbols[word])}$" if word in symbols else literal(word)
        for word in expression.split()
    ]
    return " ".join(word.replace("-", "\N{MINUS SIGN}") for word in words)


def place(figure: Figure, left: float, top: float, width: float, height: float) -> Any:
    """Axes at a position in the figure, in inches from its left and top edges."""
    across, tall = figure.get_size_inches()
    return figure.add_axes(
        (left / across, 1 - (top + height) / tall, width / across, height / tall)
    )  # fmt: skip


def legend_above(axes: Any, **options: Any) -> None:
    """A legend in one line above the right end of the axes, where no curve runs."""
    count = len(axes.get_legend_handles_labels()[1])
    axes.legend(
        **{
            "loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": count,
            "borderaxespad": 0.1, "borderpad": 0.2, "columnspacing": 1.2, "handletextpad": 0.5,
        }
        | options
    )  # fmt: skip


def letter(axes: Any, text: str, aside: float = 0.5, up: float = 4) -> None:
    """The letter of a panel, `aside` inches left of and `up` points above its upper left corner."""
    axes.annotate(
        text, (0, 1), (-72 * aside, up), xycoords="axes fraction", textcoords="offset points",
        fontsize=9, fontweight="bold", va="bottom", ha="left", annotation_clip=False,
    )  # fmt: skip


def title(
    axes: Any,
    text: str,
    *,
    columns: int = 1,
    margin: float = 1.0,
    loc: str = "left",
    size: float = 8,
) -> None:
    """A title that fits the width of one of `columns` columns, minus a margin in inches."""
    figure = axes.get_figure()
    label = axes.set_title(text, fontsize=size, loc=loc)
    shrink(label, figure.bbox.width / columns - margin * figure.dpi)


def shrink(text: Any, max_width: float) -> None:
    """Reduce the font size of a text until it is at most `max_width` pixels wide."""
    while text.get_window_extent().width > max_width and text.get_fontsize() > _MIN_FONT_SIZE:
        text.set_fontsize(0.95 * text.get_fontsize())


def fix_layout(figure: Figure) -> None:
    """Freeze the layout of a figure: later changes are to take as much room as before."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    figure.set_layout_engine("none")


def note_stretch(axes: Any) -> None:
    """Note in the label of the horizontal axis by what factor the vertical scale is larger."""
    width, height = axes.get_figure().get_size_inches()
    box = axes.get_position()
    across = height * box.height / np.ptp(axes.get_ylim())
    along = width * box.width / np.ptp(axes.get_xlim())
    factor = across / along
    if factor > 1.5:
        times = float(f"{factor:.2g}")
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
    path, image = FilePath(file), BytesIO()
    with rc_context({"svg.fonttype": "none"}):  # text as text
        figure.savefig(image, dpi=dpi, format=path.suffix[1:].lower() or "png")
    with atomic_write(path) as temporary:
        temporary.write_bytes(image.getvalue())
