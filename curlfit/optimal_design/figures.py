"""Figures of a design. Made from a `Design` alone; nothing is computed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from curlfit.foreign import counted
from curlfit.optimal_design.discrimination import DECISIVE, ODDS, Discrimination
from curlfit.optimal_design.report import noise_text
from curlfit.optimal_design.result import Design
from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import Series, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

_MAX_LABELLED = 80  # cells of a map with a number in each
_PLANNED = Style("0.5", ":", width=0.9)


@draw.style()
def design_figures(design: Design) -> dict[str, Figure]:
    """The figures by name: a map of single throws, and errors against noise, rate and
    number of throws.

    Examples
    --------
    >>> sorted(curlfit.design_figures(plan))
    ['design-errors', 'design-map']
    """
    return {"design-map": _map(design), "design-errors": _errors(design)}


def _quantity(design: Design, name: str) -> str:
    """A quantity in its symbols, with its unit."""
    units = {design.units[parameter] for parameter in design.quantities[name]}
    unit = "" if units == {"1"} else f" ({'; '.join(sorted(units))})"
    return draw.in_symbols(name, design.symbols) + unit.replace(
        "^2", "\N{SUPERSCRIPT TWO}"
    )


def _cells(
    axes: Axes,
    values: Mapping[tuple[float, float], float],
    framed: Iterable[tuple[float, float]],
    number: Callable[[float], str],
    unknown: str = "",
) -> None:
    """A cell for each speed and spin, dark where the value is small; those of the
    selected throws are framed."""
    speeds = sorted({v0 for v0, _ in values})
    spins = sorted({omega0 for _, omega0 in values})
    cells = np.full((len(spins), len(speeds)), np.nan)
    for (v0, omega0), value in values.items():
        cells[spins.index(omega0), speeds.index(v0)] = value
    axes.set_facecolor("0.9")
    axes.grid(visible=False)
    # logarithms are of positive numbers only
    positive = cells[cells > 0]
    low = positive.min() if len(positive) else 1.0
    high = positive.max() if len(positive) else 1.0
    if not high > 1.01 * low:
        low /= 1.5
        high *= 1.5
    norm = LogNorm(low, high, clip=True)
    image = axes.imshow(cells, origin="lower", aspect="auto", cmap="viridis", norm=norm)
    if cells.size <= _MAX_LABELLED:
        for (row, column), value in np.ndenumerate(cells):
            text = unknown
            color = "black"
            if np.isfinite(value):
                text = number(value)
                is_dark = value <= 0 or norm(value) < 0.6
                color = "white" if is_dark else "black"
            axes.text(
                column, row, text, ha="center", va="center", fontsize=6, color=color
            )
    else:
        axes.figure.colorbar(image, ax=axes)
    _label_cells(axes.xaxis, speeds, most=6)
    _label_cells(axes.yaxis, spins, most=12)
    axes.set_xlabel("initial speed (m/s)")
    for v0, omega0 in set(framed):
        corner = speeds.index(v0) - 0.47, spins.index(omega0) - 0.47
        axes.add_patch(
            Rectangle(corner, 0.94, 0.94, fill=False, ec=draw.REFERENCE_COLOR, lw=2.2)
        )


def _label_cells(axis: Axis, numbers: Sequence[float], most: int) -> None:
    """Ticks at the first of the cells along an axis and at each so many from it."""
    step = math.ceil(len(numbers) / most)
    indices = range(0, len(numbers), step)
    axis.set_ticks(indices, [f"{numbers[index]:g}" for index in indices])


def _number(value: float) -> str:
    """A standard error in two digits, short enough for a cell."""
    return f"{value:.2g}" if value >= 0.01 else f"{value:.1e}".replace("e-0", "e-")


def _log_odds(value: float) -> str:
    """Log odds, short enough for a cell."""
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.1f}"


def _map(design: Design) -> draw.Picture:
    """The standard error of each quantity from one throw, over speed and spin."""
    names = list(design.quantities)
    columns = 2 if len(names) == 4 else min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    tall = 0.8 + 0.28 * len({throw.omega0 for throw in design.candidates})
    figure, grid = draw.subplots(
        max(tall, 1.9) * rows + 0.5, rows, columns, squeeze=False
    )
    panels = grid.flat
    starts = [(throw.v0, throw.omega0) for throw in design.candidates]
    framed = [starts[index] for index in next(iter(design.best.values())).throws]
    for axes, name in zip(panels, names, strict=False):
        # NaN where a throw does not determine the quantity
        errors = np.array([throw.stderr[name] for throw in design.candidates], float)
        error_by_start = dict(zip(starts, errors.tolist(), strict=True))
        _cells(axes, error_by_start, framed, _number, "not\ndetermined")
        axes.set_title(_quantity(design, name), loc="center")
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes in panels[::columns]:
        axes.set_ylabel("initial spin (rad/s)")
    figure.suptitle(
        f"{draw.law_and_load(design)}: standard error from one throw\n"
        f"noise {noise_text(design.sigma)}; framed: in the optimal "
        + counted(design.throws, "throw"),
    )
    return figure


@draw.style()
def discrimination_figure(found: Discrimination) -> Figure:
    """The expected log odds of the hardest pair over speed and spin.

    Examples
    --------
    >>> curlfit.discrimination_figure(between).savefig("discrimination.png")
    """
    values = found.by_size
    chosen = [found.candidates[index] for index in found.throws]
    framed = [(throw.v0, abs(throw.omega0)) for throw in chosen]
    height = 1.6 + 0.28 * len({spin for _, spin in values})
    figure, axes = draw.subplots(height, 1, 1, 0.72 * draw.WIDTH)
    _cells(axes, values, framed, _log_odds)
    axes.set_ylabel("initial spin, either sense (rad/s)")
    axes.set_title(
        "log odds for the true law from one throw, hardest pair", loc="center"
    )
    laws = ", ".join(map(draw.literal, found.laws))
    figure.suptitle(
        f"{laws}; odds of {ODDS} to 1: {DECISIVE:.1f}\n"
        f"noise {noise_text(found.sigma)}; framed: chosen",
    )
    return figure


def _errors(design: Design) -> draw.Picture:
    """Standard errors of the optimal throws against noise, rate and their number."""
    about = {
        "place": f"noise relative to\n{_noise_of(design, ('x', 'y', 'speed'))}",
        "angle": f"noise relative to\n{_noise_of(design, ('phi', 'omega'))}",
        "rate": "rows per second\n(Hz)",
        "throws": "number of throws\n(optimal for each)",
    }
    planned = {"place": 1.0, "angle": 1.0, "rate": design.rate, "throws": design.throws}
    names = [name for name in about if name in design.curves]
    figure, (panels,) = draw.subplots(3.2, 1, len(names), sharey=True, squeeze=False)
    for axes, name in zip(panels, names, strict=True):
        curve = design.curves[name]
        styles = draw.line_styles(len(design.quantities))
        for quantity, style in zip(design.quantities, styles, strict=True):
            at = np.array(curve["at"], float)
            errors = np.array(curve[quantity], float)
            dotted = replace(style, marker=".")
            plot(axes, Series(at, errors, dotted, _quantity(design, quantity)))
        axes.set(xscale="log", yscale="log", xlabel=about[name])
        axes.axvline(planned[name], **_PLANNED.options())
        if name == "throws":
            counts = [int(count) for count in curve["at"] if count is not None]
            axes.set_xticks(counts, map(str, counts))
            axes.minorticks_off()
    panels[0].set_ylabel("standard error")
    lines = panels[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(design.quantities))
    figure.suptitle(
        f"{draw.law_and_load(design)}, optimal {counted(design.throws, 'throw')}; "
        "dotted: as planned"
    )
    return figure


def _noise_of(design: Design, channels: Sequence[str]) -> str:
    """The noise of some channels as planned, in words."""
    return noise_text(
        {name: value for name, value in design.sigma.items() if name in channels}
    )
