"""Pictures of what planned throws would tell. Made from a `Design` alone; nothing is computed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from curlfit.optimal_design.report import noise, rough
from curlfit.output.figures import DASHES, PALETTE, Picture, save_figure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from curlfit.optimal_design.result import Design, Separation

FILES = ("design-map", "design-errors", "design-separate")

_MARK = "#e07a1f"
_MOST_WRITTEN = 80  # cells of a map with a number in each


def design_figures(design: Design) -> dict[str, Figure]:
    """The pictures by name: the map of single throws, errors against the plan, and, where two
    coefficients are to be told apart and can be, what that takes."""
    found = {"design-map": _map(design), "design-errors": _errors(design)}
    parted = design.separation
    if parted is not None and parted.way("consistent").stderr is not None:
        found["design-separate"] = _separate(design, parted)
    return found


def save_figures(design: Design, folder: Path, format: str = "png") -> list[Path]:
    """Write the pictures into a folder; the files."""
    written = []
    for name, figure in design_figures(design).items():
        written.append(folder / f"{name}.{format}")
        save_figure(figure, written[-1])
    return written


def _label(design: Design, expression: str) -> str:
    """A quantity with its symbols, for matplotlib."""
    words = [
        f"${design.symbols[word]}$"
        if word in design.symbols
        else word.replace("-", "\N{MINUS SIGN}")
        for word in expression.split()
    ]
    return " ".join(words)


def _unit(design: Design, weights: Mapping[str, float]) -> str:
    units = {design.units[name] for name in weights}
    return (
        ""
        if units == {"1"}
        else f" ({'; '.join(sorted(units))})".replace("^2", "\N{SUPERSCRIPT TWO}")
    )


def _grid(design: Design, values: Sequence[float | None]) -> tuple[list[float], list[float], Any]:
    """Speeds, spins, and values by both, shape (spins, speeds), at the highest rate."""
    rate = max(one.rate for one in design.candidates)
    speeds = sorted({one.v0 for one in design.candidates})
    spins = sorted({one.omega0 for one in design.candidates})
    cells = np.full((len(spins), len(speeds)), np.nan)
    for one, value in zip(design.candidates, values, strict=True):
        if one.rate == rate and value is not None:
            cells[spins.index(one.omega0), speeds.index(one.v0)] = value
    return speeds, spins, cells


def _cells(axes: Any, design: Design, values: Sequence[float | None], *, shares: bool) -> None:
    """A cell for each speed and spin, dark where the error is small."""
    from matplotlib.colors import LogNorm

    speeds, spins, cells = _grid(design, values)
    if shares:
        cells = 100 * cells
    axes.set_facecolor("0.9")
    known = cells[np.isfinite(cells)]
    low, high = (known.min(), known.max()) if len(known) else (1.0, 1.0)
    if not high > 1.01 * low:
        low, high = low / 1.5, high * 1.5
    shown = axes.imshow(
        cells, origin="lower", aspect="auto", cmap="viridis", norm=LogNorm(low, high)
    )
    if cells.size <= _MOST_WRITTEN:
        for (row, column), value in np.ndenumerate(cells):
            dark = np.isfinite(value) and np.log(value / low) < 0.6 * np.log(high / low)
            text = f"{rough(value)} %" if shares else _number(value)
            axes.text(
                column, row, text if np.isfinite(value) else "not\ndetermined", ha="center",
                va="center", fontsize=7.5, color="white" if dark else "black",
            )  # fmt: skip
    else:
        axes.figure.colorbar(shown, ax=axes, label="%" if shares else "")
    for ticks, numbers, most in ((axes.set_xticks, speeds, 6), (axes.set_yticks, spins, 12)):
        some = range(0, len(numbers), -(-len(numbers) // most))
        ticks(some, [f"{numbers[place]:g}" for place in some])
    axes.set_xlabel("initial speed (m/s)")


def _number(value: float) -> str:
    return f"{value:.2g}" if value >= 0.01 else f"{value:.1e}".replace("e-0", "e-")


def _ring(axes: Any, design: Design, places: Sequence[int]) -> None:
    """Frames round the cells of chosen throws."""
    from matplotlib.patches import Rectangle

    speeds, spins, _ = _grid(design, [None] * len(design.candidates))
    for place in Counter(places):
        one = design.candidates[place]
        corner = speeds.index(one.v0) - 0.47, spins.index(one.omega0) - 0.47
        axes.add_patch(Rectangle(corner, 0.94, 0.94, fill=False, edgecolor=_MARK, lw=2.2))


def _map(design: Design) -> Figure:
    names = list(design.quantities)
    columns = 2 if len(names) == 4 else min(len(names), 3)
    rows = -(-len(names) // columns)
    tall = 1.2 + 0.42 * len({one.omega0 for one in design.candidates})
    figure = Picture(
        figsize=(max(3.4 * columns, 6.5), max(tall, 2.4) * rows + 0.7), layout="constrained"
    )
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).reshape(-1)
    best = next(iter(design.best.values())).throws
    for axes, name in zip(panels, names, strict=False):
        _cells(axes, design, [one.stderr[name] for one in design.candidates], shares=False)
        _ring(axes, design, best)
        axes.set_title(
            f"{_label(design, name)}{_unit(design, design.quantities[name])}", fontsize=10
        )
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes in panels[::columns]:
        axes.set_ylabel("initial spin (rad/s)")
    figure.suptitle(
        f"{design.law} law, {design.load} load: standard error from one throw\n"
        f"noise {noise(design.sigma)}; framed: among the best {design.throws} throws",
        fontsize=10,
    )
    return figure


def _errors(design: Design) -> Figure:
    about = {
        "place": f"noise, times\n{_only(design, ('x', 'y', 'speed'))}",
        "angle": f"noise, times\n{_only(design, ('phi', 'omega'))}",
        "rate": "rows a second (Hz)",
        "throws": "number of throws, the best for each",
    }
    names = [name for name in about if name in design.curves]
    figure = Picture(figsize=(2.9 * len(names) + 0.6, 4.5), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for axes, name in zip(panels, names, strict=True):
        curve = design.curves[name]
        for place, (quantity, weights) in enumerate(design.quantities.items()):
            values = [np.nan if value is None else value for value in curve[quantity]]
            axes.plot(
                curve["at"], values, ".", color=PALETTE[place % len(PALETTE)], ms=5, lw=1.4,
                ls=DASHES[place % 2], label=_label(design, quantity) + _unit(design, weights),
            )  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel=about[name])
        axes.grid(alpha=0.3, which="major")
        if name in ("place", "angle"):
            axes.axvline(1.0, color="0.5", lw=0.9, ls=":")
        if name == "rate":
            for rate in {one.rate for one in design.candidates}:
                axes.axvline(rate, color="0.5", lw=0.9, ls=":")
        if name == "throws":
            axes.axvline(design.throws, color="0.5", lw=0.9, ls=":")
            counts = [int(one) for one in curve["at"] if one is not None]
            axes.set_xticks(counts, [str(one) for one in counts], fontsize=8)
            axes.minorticks_off()
    panels[0].set_ylabel("standard error")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False,
        ncols=len(design.quantities), fontsize=9.5,
    )  # fmt: skip
    figure.suptitle(
        f"{design.law} law, {design.load} load, best {design.throws} throws; dotted: as planned",
        fontsize=10,
    )
    return figure


def _only(design: Design, channels: Sequence[str]) -> str:
    return noise({name: value for name, value in design.sigma.items() if name in channels})


def _separate(design: Design, parted: Separation) -> Figure:
    """Left: error of the difference against noise. Right: from single throws."""
    figure = Picture(figsize=(11, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    difference = _label(design, f"{parted.pair[0]} - {parted.pair[1]}")
    way = parted.way("consistent")
    factors = np.array([1e-4, 1e2])
    draw = design.candidates[parted.ordinary]
    plain = way.each[parted.ordinary]
    ordinary = f"{draw.v0:g} m/s, {draw.omega0:g} rad/s"

    def line(stderr: float | None, label: str, **style: Any) -> None:
        if stderr is not None:
            left.plot(factors, 100 * factors * stderr / parted.size, label=label, **style)

    count = design.throws
    if plain is not None:
        line(plain / np.sqrt(count), f"{count} x ({ordinary})", color=PALETTE[6], lw=1.6)
    line(way.stderr, f"the best {count} throws, framed", color=PALETTE[0], lw=2.2)
    heights = [item for item in parted.changes if item.name == "h" and item.value in _ends(parted)]
    for dash, item in zip(("--", "-.", ":"), heights, strict=False):
        line(
            item.all, f"the same, h = {1000 * item.value:.3g} mm", color=PALETTE[0], lw=1.1, ls=dash
        )
    for dash, item in zip(("--", "-.", ":"), heights, strict=False):
        line(
            item.half, f"{count} x ({ordinary}), half with h = {1000 * item.value:.3g} mm",
            color=PALETTE[1], lw=1.4, ls=dash,
        )  # fmt: skip
    left.axhline(100 * parted.wanted, color=_MARK, lw=1.4)
    left.text(
        6e-3, 115 * parted.wanted, f"required: {100 * parted.wanted:g} %", color=_MARK, fontsize=9
    )
    left.axvline(1.0, color="0.5", lw=0.9, ls=":")
    left.set(
        xscale="log", yscale="log", xlim=(1e-4, 1e1), ylim=(1e-1, 1e6),
        xlabel=f"noise, times {noise(design.sigma)} (dotted: as planned)",
        ylabel=f"error of {difference}, % of {parted.size:g}",
    )  # fmt: skip
    left.grid(alpha=0.3)
    if parted.proof.hidden:
        left.set_title(
            "uniform load: never, at any noise, with any number of throws", fontsize=10,
            color="#b02a37",
        )  # fmt: skip
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False,
        fontsize=8.5, title="consistent load", title_fontsize=9,
    )  # fmt: skip
    shares = [None if one is None else one / parted.size for one in way.each]
    _cells(right, design, shares, shares=True)
    if way.throws is not None:
        _ring(right, design, way.throws)
    right.set_ylabel("initial spin (rad/s)")
    right.set_title(
        f"{difference} from one throw, % of {parted.size:g}\n"
        f"consistent load; framed: among the best {count} throws",
        fontsize=10,
    )
    figure.suptitle(f"{design.law} law: telling {' from '.join(parted.pair)}", fontsize=11)
    return figure


def _ends(parted: Separation) -> set[float]:
    """The least height of the centre of mass that was tried, and the two greatest."""
    tried = sorted(item.value for item in parted.changes if item.name == "h")
    return {*tried[:1], *tried[-2:]}
