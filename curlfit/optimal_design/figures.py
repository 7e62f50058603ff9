"""Figures of a design. Made from a `Design` alone; nothing is computed."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from curlfit.optimal_design.report import noise_text
from curlfit.output.figures import (
    PALETTE,
    REFERENCE_COLOR,
    WIDTH,
    Picture,
    in_symbols,
    law_and_load,
    line_styles,
    literal,
    styled,
)
from curlfit.output.text import two_digits

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from curlfit.optimal_design.result import Design, Separation

_MAX_LABELLED = 80  # cells of a map with a number in each


@styled
def design_figures(design: Design) -> dict[str, Figure]:
    """The figures by name: a map of single throws, errors against noise, rate and number of throws,
    and, where two coefficients are separable, what that takes.

    Examples
    --------
    >>> sorted(curlfit.design_figures(plan))
    ['design-errors', 'design-map', 'design-separate']
    """
    found = {"design-map": _map(design), "design-errors": _errors(design)}
    separation = design.separation
    if separation is not None and separation.scenario("consistent").stderr is not None:
        found["design-separate"] = _separation(design, separation)
    return found


def _label(design: Design, expression: str) -> str:
    """A quantity with its symbols, for matplotlib."""
    return in_symbols(expression, design.symbols)


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
    axes.grid(visible=False)
    known = cells[np.isfinite(cells)]
    low, high = (known.min(), known.max()) if len(known) else (1.0, 1.0)
    if not high > 1.01 * low:
        low, high = low / 1.5, high * 1.5
    shown = axes.imshow(
        cells, origin="lower", aspect="auto", cmap="viridis", norm=LogNorm(low, high)
    )
    if cells.size <= _MAX_LABELLED:
        for (row, column), value in np.ndenumerate(cells):
            dark = np.isfinite(value) and np.log(value / low) < 0.6 * np.log(high / low)
            text = f"{two_digits(value)} %" if shares else _number(value)
            axes.text(
                column, row, text if np.isfinite(value) else "not\ndetermined", ha="center",
                va="center", fontsize=6, color="white" if dark else "black",
            )  # fmt: skip
    else:
        axes.figure.colorbar(shown, ax=axes, label="%" if shares else "")
    for ticks, numbers, most in ((axes.set_xticks, speeds, 6), (axes.set_yticks, spins, 12)):
        some = range(0, len(numbers), -(-len(numbers) // most))
        ticks(some, [f"{numbers[index]:g}" for index in some])
    axes.set_xlabel("initial speed (m/s)")


def _number(value: float) -> str:
    return f"{value:.2g}" if value >= 0.01 else f"{value:.1e}".replace("e-0", "e-")


def _frame_selected(axes: Any, design: Design, indices: Sequence[int]) -> None:
    """Frames around the cells of the selected throws."""
    from matplotlib.patches import Rectangle

    speeds, spins, _ = _grid(design, [None] * len(design.candidates))
    for index in Counter(indices):
        one = design.candidates[index]
        corner = speeds.index(one.v0) - 0.47, spins.index(one.omega0) - 0.47
        axes.add_patch(Rectangle(corner, 0.94, 0.94, fill=False, edgecolor=REFERENCE_COLOR, lw=2.2))


def _map(design: Design) -> Figure:
    names = list(design.quantities)
    columns = 2 if len(names) == 4 else min(len(names), 3)
    rows = -(-len(names) // columns)
    tall = 0.8 + 0.28 * len({one.omega0 for one in design.candidates})
    figure = Picture(figsize=(WIDTH, max(tall, 1.9) * rows + 0.5), layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).reshape(-1)
    best = next(iter(design.best.values())).throws
    for axes, name in zip(panels, names, strict=False):
        _cells(axes, design, [one.stderr[name] for one in design.candidates], shares=False)
        _frame_selected(axes, design, best)
        axes.set_title(f"{_label(design, name)}{_unit(design, design.quantities[name])}")
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes in panels[::columns]:
        axes.set_ylabel("initial spin (rad/s)")
    figure.suptitle(
        f"{law_and_load(design)}: standard error from one throw\n"
        f"noise {noise_text(design.sigma)}; framed: in the optimal {design.throws} throws",
    )
    return figure


def _errors(design: Design) -> Figure:
    about = {
        "place": f"noise relative to\n{_noise_of(design, ('x', 'y', 'speed'))}",
        "angle": f"noise relative to\n{_noise_of(design, ('phi', 'omega'))}",
        "rate": "rows per second\n(Hz)",
        "throws": "number of throws\n(optimal for each)",
    }
    names = [name for name in about if name in design.curves]
    figure = Picture(figsize=(WIDTH, 3.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    for axes, name in zip(panels, names, strict=True):
        curve, styles = design.curves[name], line_styles(len(design.quantities))
        for index, (quantity, weights) in enumerate(design.quantities.items()):
            values = [np.nan if value is None else value for value in curve[quantity]]
            axes.plot(
                curve["at"], values, ".", ms=4, lw=1.2, **styles[index],
                label=_label(design, quantity) + _unit(design, weights),
            )  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel=about[name])
        if name in ("place", "angle"):
            axes.axvline(1.0, color="0.5", lw=0.9, ls=":")
        if name == "rate":
            for rate in {one.rate for one in design.candidates}:
                axes.axvline(rate, color="0.5", lw=0.9, ls=":")
        if name == "throws":
            axes.axvline(design.throws, color="0.5", lw=0.9, ls=":")
            counts = [int(one) for one in curve["at"] if one is not None]
            axes.set_xticks(counts, [str(one) for one in counts])
            axes.minorticks_off()
    panels[0].set_ylabel("standard error")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center",
        ncols=len(design.quantities),
    )  # fmt: skip
    figure.suptitle(
        f"{law_and_load(design)}, optimal {design.throws} throws; dotted: as planned",
    )
    return figure


def _noise_of(design: Design, channels: Sequence[str]) -> str:
    return noise_text({name: value for name, value in design.sigma.items() if name in channels})


def _separation(design: Design, separation: Separation) -> Figure:
    """Left: error of the difference against noise. Right: from single throws."""
    figure = Picture(figsize=(WIDTH, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    difference = _label(design, f"{separation.pair[0]} - {separation.pair[1]}")
    scenario = separation.scenario("consistent")
    factors = np.array([1e-4, 1e2])
    draw = design.candidates[separation.ordinary]
    plain = scenario.each[separation.ordinary]
    ordinary = f"{draw.v0:g} m/s, {draw.omega0:g} rad/s"

    def line(stderr: float | None, label: str, **style: Any) -> None:
        if stderr is not None:
            left.plot(factors, 100 * factors * stderr / separation.size, label=label, **style)

    count = design.throws
    if plain is not None:
        line(plain / np.sqrt(count), f"{count} x ({ordinary})", color=PALETTE[6], lw=1.6)
    line(scenario.stderr, f"the optimal {count} throws, framed", color=PALETTE[0], lw=2.2)
    heights = [
        item
        for item in separation.changes
        if item.name == "h" and item.value in _extreme_heights(separation)
    ]
    for dash, item in zip(("--", "-.", ":"), heights, strict=False):
        line(
            item.all, f"the same, h = {1000 * item.value:.3g} mm", color=PALETTE[0], lw=1.1, ls=dash
        )
    for dash, item in zip(("--", "-.", ":"), heights, strict=False):
        line(
            item.half, f"{count} x ({ordinary}), half with h = {1000 * item.value:.3g} mm",
            color=PALETTE[2], lw=1.4, ls=dash,
        )  # fmt: skip
    left.axhline(100 * separation.wanted, color=REFERENCE_COLOR, lw=1.4)
    left.text(
        1.2e-4,
        115 * separation.wanted,
        f"required: {100 * separation.wanted:g} %",
        color=REFERENCE_COLOR,
    )
    left.axvline(1.0, color="0.5", lw=0.9, ls=":")
    left.set(
        xscale="log", yscale="log", xlim=(1e-4, 1e1), ylim=(1e-1, 1e6),
        xlabel=f"noise, times {noise_text(design.sigma)} (dotted: as planned)",
        ylabel=f"error of {difference}, % of {separation.size:g}",
    )  # fmt: skip
    if separation.proof.hidden:
        left.set_title(
            "uniform load: not separable, at any noise, with any number of throws",
            color=REFERENCE_COLOR, fontsize=7,
        )  # fmt: skip
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=2,
        title="consistent load",
    )  # fmt: skip
    shares = [None if one is None else one / separation.size for one in scenario.each]
    _cells(right, design, shares, shares=True)
    if scenario.throws is not None:
        _frame_selected(right, design, scenario.throws)
    right.set_ylabel("initial spin (rad/s)")
    right.set_title(
        f"{difference} from one throw, % of {separation.size:g}\n"
        f"consistent load; framed: in the optimal {count} throws",
        fontsize=7,
    )
    figure.suptitle(f"{literal(design.law)} law: separation of {' and '.join(separation.pair)}")
    return figure


def _extreme_heights(separation: Separation) -> set[float]:
    """The lowest height of the centre of mass and the two highest."""
    heights = sorted(item.value for item in separation.changes if item.name == "h")
    return {*heights[:1], *heights[-2:]}
