"""Corner plot of the posterior: the parameters pair by pair."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from curlfit.inference.fit.result import require_fit
from curlfit.output.figures import (
    FIT_COLOR,
    POSTERIOR_COLOR,
    QUIET,
    REFERENCE_COLOR,
    WIDTH,
    Picture,
    heading_of,
    literal,
    math_symbol,
    shrink,
    styled,
)
from curlfit.output.text import format_estimate
from curlfit.output.ticks import neat_axis

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from curlfit.inference.fit.result import Estimate, FitResult
    from curlfit.inference.mcmc.chain import Chain

    Floats = NDArray[np.float64]

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.8, 0.12, 0.42, 0.65  # inches around the panels
_GAP = 0.06  # between them
_SMALLEST = 0.95  # side of a panel
_BINS = 30
_SMOOTH = 1.0  # bins, standard deviation
_LEVELS = (0.95, 0.68)
_SHADES = ("#ecd2e0", POSTERIOR_COLOR)
_MOST = 40_000  # samples used for the densities
_DOTS = 2000  # points drawn along a ridge, about


@styled
def corner_figure(fit: FitResult, chain: Chain) -> Figure:
    """Corner plot of the posterior of the law's coefficients and the estimated conditions: regions
    that contain 68 and 95 % of the samples, with reference values marked.

    Examples
    --------
    >>> curlfit.corner_figure(sampled, chain).savefig("corner.png")
    """
    require_fit(fit)
    names = _names(fit)
    samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
    if len(samples) > _MOST:
        samples = samples[np.linspace(0, len(samples) - 1, _MOST).astype(int)]
    known = {} if fit.reference is None else fit.reference.values
    count = max(len(names), 2)
    width = max(WIDTH, _LEFT + _RIGHT + count * (_SMALLEST + _GAP) - _GAP)
    side = (width - _LEFT - _RIGHT + _GAP) / count
    height = _TOP + _BOTTOM + len(names) * side - _GAP
    figure = Picture(figsize=(width, height))
    grid = {
        (row, column): figure.add_axes((
            (_LEFT + column * side) / width, (_BOTTOM + (len(names) - 1 - row) * side) / height,
            (side - _GAP) / width, (side - _GAP) / height,
        ))
        for row in range(len(names))
        for column in range(row + 1)
    }  # fmt: skip
    extents = [_extent(samples[:, k], known.get(name)) for k, name in enumerate(names)]
    bins = [_bins_of(samples[:, k], *extent) for k, extent in enumerate(extents)]
    ridges = _ridges(fit, names)
    for (row, column), axes in grid.items():
        axes.grid(visible=False)
        axes.spines[:].set_visible(True)
        axes.set_xlim(extents[column])
        if row == column:
            _histogram(axes, fit.parameters[names[row]], samples[:, row], bins[row])
        else:
            axes.set_ylim(extents[row])
            if (row, column) in ridges:
                weights = ridges[row, column]
                _ridge(axes, fit, weights, samples[:, column], samples[:, row], known)
            else:
                _density(axes, bins[column], bins[row], extents[column], extents[row])
                _reference_line(axes.axhline, known.get(names[row]), extents[row])
        if (row, column) not in ridges:
            _reference_line(axes.axvline, known.get(names[column]), extents[column])
    for place, name in enumerate(names):
        _neat_panels(fit.parameters[name], grid, place, len(names) - 1)
        _point_to_mark(grid[place, place], known.get(name), extents[place])
    _say_in_corner(fit, figure, side)
    return figure


def _names(fit: FitResult) -> list[str]:
    """Coefficients and conditions that are not fixed; if fewer than two, the initial state too."""
    start = ("v0", "omega0", "heading")
    wanted = [*fit.coefficients, *fit.conditions]
    free = [name for name in (*wanted, *start) if fit.parameters[name].verdict != "fixed"]
    found = [name for name in free if name in wanted]
    return found if len(found) > 1 else free


def _extent(values: Floats, mark: float | None) -> tuple[float, float]:
    """Axis limits that enclose the samples, and a reference value if it is near them."""
    low, high = map(float, np.quantile(values, [0.001, 0.999]))
    if mark is not None:
        reach = 3 * (high - low)
        low = mark if high - reach < mark < low else low
        high = mark if high < mark < low + reach else high
    margin = 0.06 * (high - low) or 1e-9
    return low - margin, high + margin


def _bins_of(values: Floats, low: float, high: float) -> Any:
    """Index of the bin of each sample; -1 outside all bins."""
    places = np.floor((values - low) / (high - low) * _BINS).astype(int)
    return np.where((places >= 0) & (places < _BINS), places, -1)


def _histogram(axes: Any, item: Estimate, values: Floats, bins: Any) -> None:
    """Histogram of one parameter with its median and 68 % interval."""
    counts = np.bincount(bins[bins >= 0], minlength=_BINS)
    low, high = axes.get_xlim()
    axes.stairs(
        counts, np.linspace(low, high, _BINS + 1), fill=True, facecolor=_SHADES[0],
        edgecolor=POSTERIOR_COLOR, lw=1,
    )  # fmt: skip
    quantiles = np.quantile(values, [0.16, 0.5, 0.84])
    axes.vlines(
        quantiles, 0, 1, transform=axes.get_xaxis_transform(), colors="black",
        linestyles=["--", "-", "--"], lw=0.7,
    )  # fmt: skip
    axes.set_ylim(0, 1.1 * counts.max())
    axes.set_yticks([])
    low, middle, high = map(float, quantiles)
    said = f"{low:.3g} .. {high:.3g}"
    if item.verdict == "not identifiable":
        said = "not identifiable"
    elif item.verdict in ("determined", "prior"):
        said = " \N{PLUS-MINUS SIGN} ".join(format_estimate(middle, (high - low) / 2))
    text = axes.set_title(said.replace("-", "\N{MINUS SIGN}"), fontsize=7, pad=3)
    shrink(text, axes.get_window_extent().width)


def _density(
    axes: Any, across: Any, up: Any, x: tuple[float, float], y: tuple[float, float]
) -> None:
    """Smallest regions that contain 68 and 95 % of the samples."""
    inside = (across >= 0) & (up >= 0)
    counts = np.bincount(across[inside] * _BINS + up[inside], minlength=_BINS**2)
    kernel = np.exp(-(np.subtract.outer(range(_BINS), range(_BINS)) ** 2) / (2 * _SMOOTH**2))
    kernel /= kernel.sum(1, keepdims=True)
    density = np.pad(kernel @ counts.reshape(_BINS, _BINS) @ kernel.T, 1)  # closes the contours
    falling = np.sort(density, axis=None)[::-1]
    share = np.cumsum(falling) / falling.sum()
    edges = [float(falling[np.searchsorted(share, level)]) for level in _LEVELS]
    edges.append(float(falling[0]))
    for index in range(2):
        edges[index + 1] = max(edges[index + 1], edges[index] * (1 + 1e-6))
    middles = [
        low + (np.arange(-1, _BINS + 1) + 0.5) * (high - low) / _BINS for low, high in (x, y)
    ]
    axes.contourf(*middles, density.T, levels=edges, colors=_SHADES)
    axes.contour(*middles, density.T, levels=edges[:2], colors="0.3", linewidths=0.5)


def _ridges(fit: FitResult, names: list[str]) -> dict[tuple[int, int], dict[str, float]]:
    """Weights, by row and column, for pairs of which only a combination is determined."""
    found = {}
    for item in fit.combinations:
        if len(item.weights) == 2 and item.weights.keys() <= set(names):
            column, row = sorted(map(names.index, item.weights))
            found[row, column] = {names[k]: item.weights[names[k]] for k in (column, row)}
    return found


def _ridge(
    axes: Any, fit: FitResult, weights: dict[str, float], x: Floats, y: Floats,
    known: dict[str, float],
) -> None:  # fmt: skip
    """Draw a pair of which only a combination is determined, as points along a line."""
    first, second = weights.values()
    some = slice(None, None, max(1, len(x) // _DOTS))
    axes.plot(
        x[some], y[some], ".", color=POSTERIOR_COLOR, markersize=1.5, mew=0, rasterized=True
    )  # fmt: skip
    falling = first * second > 0
    text = axes.text(
        0.95 if falling else 0.05, 0.95, f"only\n${_as_math(fit, weights)}$\nis determined",
        transform=axes.transAxes, ha="right" if falling else "left", va="top", fontsize=7,
    )  # fmt: skip
    shrink(text, 0.52 * axes.get_window_extent().width)
    for item in fit.combinations:
        value = known.get(item.expression)
        if value is not None and item.weights.keys() == weights.keys():
            across = np.array(axes.get_xlim())
            axes.plot(across, (value - first * across) / second, color=REFERENCE_COLOR, lw=1)


def _reference_line(draw: Any, value: float | None, extent: tuple[float, float]) -> None:
    if value is not None and extent[0] <= value <= extent[1]:
        draw(value, color=REFERENCE_COLOR, lw=1)


def _neat_panels(item: Estimate, grid: Any, place: int, last: int) -> None:
    """Set the same few ticks in all panels of a parameter, with numbers on the outermost."""
    below, beside = grid[last, place], grid[place, 0]
    groups = [(below.xaxis, [grid[row, place].xaxis for row in range(place, last)])]
    if place:
        groups.append((beside.yaxis, [grid[place, column].yaxis for column in range(1, place)]))
    for outer, inner in groups:
        neat_axis(outer, f"${math_symbol(item.symbol)}$", item.unit, neighbours=True)
        for axis in inner:
            axis.set_ticks(outer.get_majorticklocs(), labels=[])
    box = below.get_window_extent()
    inch = below.get_figure().dpi
    below.xaxis.set_label_coords(0.5, -0.24 * inch / box.height)
    beside.yaxis.set_label_coords(-0.42 * inch / box.width, 0.5)


def _point_to_mark(axes: Any, value: float | None, extent: tuple[float, float]) -> None:
    """Point to a reference value that lies outside a histogram."""
    if value is None or extent[0] <= value <= extent[1]:
        return
    right = value > extent[1]
    axes.annotate(
        f"{value:g}", xy=(1.0 if right else 0.0, 0.88), xycoords="axes fraction",
        xytext=(0.7 if right else 0.3, 0.88), textcoords="axes fraction", ha="center",
        va="center", color=REFERENCE_COLOR, fontsize=7,
        arrowprops={"arrowstyle": "->", "color": REFERENCE_COLOR, "lw": 0.8},
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8},
    )  # fmt: skip


def _say_in_corner(fit: FitResult, figure: Figure, side: float) -> None:
    """Write what was fitted, combinations and references into the corner free of panels."""
    width, height = figure.get_size_inches()
    heading = figure.text(_LEFT / width, 1 - 0.06 / height, heading_of(fit), va="top")
    shrink(heading, (width - _LEFT - _RIGHT) * figure.dpi)
    lines = []
    for item in fit.combinations:
        value, stderr = format_estimate(item.value, item.stderr)
        lines.append(rf"${_as_math(fit, item.weights)} = {value} \pm {stderr}$")
    for direction in fit.null_directions:
        pair = ", ".join(f"${math_symbol(fit.parameters[name].symbol)}$" for name in direction)
        lines.append(f"{pair}: not identifiable individually")
    lines.append("dashed: 68 %; shaded: 68 and 95 % of the posterior")
    written = [("black", lines[:-1]), (QUIET, lines[-1:])]

    def symbols(text: str) -> str:
        for name, parameter in fit.parameters.items():
            whole = re.compile(rf"(?<![\w\\{{]){name}\b(?!\$)")
            text = whole.sub(f"${math_symbol(parameter.symbol)}$".replace("\\", r"\\"), text)
        return text

    if fit.reference is not None:
        found = [symbols(f"{name} = {value:g}") for name, value in fit.reference.values.items()]
        written.append((REFERENCE_COLOR, [literal(fit.reference.source), *found]))
    for other in fit.reference_fits[:1]:
        constants = ", ".join(f"{name} = {value:g} m" for name, value in other["stone"].items())
        values = [
            f"{name} = {other['values'][name]:.4f}"
            for name in (fit.reference.values if fit.reference else {})
            if name in other["values"]
        ]
        written.append((FIT_COLOR, [f"this fit with {constants}", *map(symbols, values)]))
    end, top = 1 - _RIGHT / width, 1 - _TOP / height
    for color, said in written:
        if not said:
            continue
        style: dict[str, Any] = {"ha": "right", "va": "top", "linespacing": 1.5}
        text = figure.text(end, top, "\n".join(said), color=color, **style)
        shrink(text, (end * width - _LEFT - side) * figure.dpi)
        top -= text.get_window_extent().height / figure.bbox.height + 0.1 / height


def _as_math(fit: FitResult, weights: dict[str, float]) -> str:
    text = ""
    for name, weight in weights.items():
        sign = "-" if weight < 0 else "+" if text else ""
        size = "" if abs(weight) == 1 else f"{abs(weight):.3g}\\,"
        text += f"{sign}{size}{math_symbol(fit.parameters[name].symbol)}"
    return text
