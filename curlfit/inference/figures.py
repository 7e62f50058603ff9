"""Pictures of results. Made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

import re
import warnings
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from curlfit.inference.event_figures import event_figure
from curlfit.output.figures import (
    CHANNEL_COLOR,
    CHANNEL_LABEL,
    DATA_STYLE,
    FIT_COLOR,
    MAX_POINTS,
    PALETTE,
    REFERENCE_COLOR,
    Picture,
    line_styles,
    neat_axis,
    note_stretch,
    shrink,
    title,
    unit_for,
)
from curlfit.output.text import format_estimate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from curlfit.inference.fit.result import Estimate, FitResult
    from curlfit.inference.joint.result import JointResult
    from curlfit.inference.mcmc.chain import Chain

    Floats = NDArray[np.float64]

_LEFT = 1.3  # inches left of the panels of a corner


def fit_figure(fit: FitResult) -> Figure:
    """The path with its fit, the residuals of each channel, speed and spin; or timed events.

    Examples
    --------
    >>> curlfit.fit_figure(fit).savefig("fit.png")
    """
    if not fit.rms:
        return event_figure(fit, _name(fit))
    figure = Picture(figsize=(10, 7.2), layout="constrained")
    rows = figure.add_gridspec(3, 1, height_ratios=(1.15, 1.0, 1.0))
    right = rows[1].subgridspec(1, len(fit.rms))
    bottom = rows[2].subgridspec(1, 2)
    t = fit.observed["t"]
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), MAX_POINTS)).astype(int))

    path = figure.add_subplot(rows[0])
    path.plot(fit.observed["y"][some], fit.observed["x"][some], **DATA_STYLE, label="data")
    path.plot(fit.fitted["y"], fit.fitted["x"], color=FIT_COLOR, lw=1.3, label=f"{fit.law} law")
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    title(path, f"{_name(fit)}: {fit.law} law, {fit.load} load")
    path.legend(frameon=False, fontsize=9)
    path.margins(x=0.02, y=0.12)

    for place, name in enumerate(fit.rms):
        axes = figure.add_subplot(right[place])
        size, unit = unit_for(fit.rms[name], name)
        residual = fit.residuals[name][some] / size
        axes.axhline(0, color="0.7", lw=0.8)
        axes.plot(t[some], residual, ".", color=CHANNEL_COLOR[name], markersize=3)
        _ring_outliers(axes, fit, name, size)
        said = f"${CHANNEL_LABEL[name]}$: rms {fit.rms[name] / size:.3g} {unit}"
        title(axes, said, columns=len(fit.rms), loc="center")
        axes.set(xlabel="t (s)", ylabel=f"residual ({unit})")

    speed, spin = (figure.add_subplot(bottom[place]) for place in range(2))
    for axes, name in ((speed, "speed"), (spin, "omega")):
        if name in fit.observed:
            axes.plot(t[some], fit.observed[name][some], **DATA_STYLE)
    speed.plot(t, fit.fitted["speed"], color=FIT_COLOR)
    speed.set(xlabel="t (s)", ylabel="speed (m/s)")
    speed.set_ylim(bottom=0)
    spin.plot(t, fit.fitted["omega"], color=CHANNEL_COLOR["phi"])
    spin.set(xlabel="t (s)", ylabel=r"spin $\omega$ (rad/s)")
    _include_zero(spin, fit.fitted["omega"])
    figure.draw_without_rendering()  # the layout, which the note's number depends on
    note_stretch(path)
    return figure


def _ring_outliers(axes: Any, fit: FitResult, name: str, size: float) -> None:
    """Outliers in orange; those far outside are drawn at the edge, the rest stays readable."""
    found = [item for item in fit.outliers if item["channel"] == name]
    if not found:
        return
    inner = float(np.nanquantile(np.abs(fit.residuals[name]), 0.9)) * 2.5 / size
    off = np.array([item["off"] / size for item in found])
    axes.set_ylim(-inner, inner)
    axes.plot(
        [item["t"] for item in found], np.clip(off, -0.97 * inner, 0.97 * inner),
        "x", color=REFERENCE_COLOR, markersize=5, clip_on=False,
    )  # fmt: skip
    many = "1 outlier" if len(found) == 1 else f"{len(found)} outliers"
    axes.text(
        0.02, 0.97, f"\N{MULTIPLICATION SIGN} {many}", transform=axes.transAxes,
        color=REFERENCE_COLOR, fontsize=8, va="top",
    )  # fmt: skip


def _name(fit: FitResult) -> str:
    return FilePath(fit.data["file"]).name


def _include_zero(axes: Any, values: Any) -> None:
    low, high = float(np.min(values)), float(np.max(values))
    if low >= 0:
        axes.set_ylim(bottom=0)
    elif high <= 0:
        axes.set_ylim(top=0)


def corner_figure(fit: FitResult, chain: Chain) -> Figure:
    """Posterior of the law's coefficients, pair by pair, with reference values marked.

    Examples
    --------
    >>> curlfit.corner_figure(sampled, chain).savefig("corner.png")
    """
    with warnings.catch_warnings():  # it loads ArviZ where it is, which announces its next version
        warnings.simplefilter("ignore", FutureWarning)
        import corner  # imports pyplot, which takes half a second

    names = [name for name in fit.coefficients if fit.parameters[name].verdict != "fixed"]
    if len(names) < 2:  # one alone has no corner
        start = ("v0", "omega0", "heading")
        names += [name for name in start if fit.parameters[name].verdict != "fixed"]
    samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
    most = 40_000
    if len(samples) > most:
        samples = samples[np.linspace(0, len(samples) - 1, most).astype(int)]
    known = {} if fit.reference is None else fit.reference.values
    size = 2.3 * max(len(names), 3) + 0.8
    figure = Picture(figsize=(size, size))
    corner.corner(
        samples,
        fig=figure,
        labels=[f"${fit.parameters[name].symbol}$" for name in names],
        truths=[known.get(name) for name in names],
        truth_color=REFERENCE_COLOR,
        color=FIT_COLOR,
        bins=30,
        smooth=0.8,
        quantiles=(0.16, 0.5, 0.84),
        levels=(0.393, 0.865),
        range=[_extent(samples[:, place], known.get(name)) for place, name in enumerate(names)],
        plot_datapoints=len(samples) < 5000,
        label_kwargs={"fontsize": 12},
    )
    grid = np.array(figure.axes).reshape(len(names), len(names))
    figure.subplots_adjust(left=_LEFT / size)
    for place, name in enumerate(names):
        _neat_panels(fit.parameters[name], grid, place)
    _mark_ridges(fit, names, known, samples, grid)
    _point_to_marks(names, known, grid)
    _say_in_corner(fit, figure, grid)
    return figure


def _neat_panels(item: Estimate, grid: Any, place: int) -> None:
    """The same few ticks in all panels of a parameter, with numbers at the outermost."""
    last = len(grid) - 1
    for outer, inner in (
        (grid[last, place].xaxis, [axes.xaxis for axes in grid[place:last, place]]),
        (grid[place, 0].yaxis, [axes.yaxis for axes in grid[place, 1:place]]),
    ):
        if outer.axes is grid[0, 0] and outer.axis_name == "y":
            continue
        outer.set_tick_params(labelrotation=0)
        neat_axis(outer, f"${item.symbol}$", item.unit, neighbours=True)
        for axis in inner:
            axis.set_ticks(outer.get_majorticklocs(), labels=[])
    box = grid[0, 0].get_window_extent()
    inch = grid[0, 0].get_figure().dpi
    grid[last, place].xaxis.set_label_coords(0.5, -0.32 * inch / box.height)
    grid[place, 0].yaxis.set_label_coords(-0.82 * inch / box.width, 0.5)


def _extent(values: Any, mark: float | None) -> tuple[float, float]:
    """Limits that hold the sample, and a reference value near it."""
    low, high = map(float, np.quantile(values, [0.001, 0.999]))
    if mark is not None:
        reach = 3 * (high - low)
        low = mark if high - reach < mark < low else low
        high = mark if high < mark < low + reach else high
    margin = 0.06 * (high - low) or 1e-9
    return low - margin, high + margin


def _mark_ridges(
    fit: FitResult, names: list[str], known: dict[str, float], samples: Any, grid: Any
) -> None:
    """Show a pair of which only a combination is determined as it is: a line of points."""
    for item in fit.combinations:
        pair = list(item.weights)
        if len(pair) != 2 or not set(pair) <= set(names):
            continue
        first, second = sorted(pair, key=names.index)
        axes = grid[names.index(second), names.index(first)]
        limits = axes.get_xlim(), axes.get_ylim()
        for artist in [*axes.collections, *axes.images, *axes.patches, *axes.lines]:
            artist.remove()
        some = samples[:: max(1, len(samples) // 3000)]
        axes.plot(
            some[:, names.index(first)], some[:, names.index(second)],
            ".", color=FIT_COLOR, markersize=2, alpha=0.5,
        )  # fmt: skip
        falling = item.weights[first] * item.weights[second] > 0
        axes.text(
            0.95 if falling else 0.05, 0.95,
            f"only\n${_as_math(fit, item.weights)}$\nis determined",
            transform=axes.transAxes, ha="right" if falling else "left", va="top", fontsize=10,
        )  # fmt: skip
        value = known.get(item.expression)
        if value is not None:
            horizontal = np.array(limits[0])
            vertical = (value - item.weights[first] * horizontal) / item.weights[second]
            axes.plot(horizontal, vertical, color=REFERENCE_COLOR, lw=1.2)
        axes.set(xlim=limits[0], ylim=limits[1])


def _point_to_marks(names: list[str], known: dict[str, float], grid: Any) -> None:
    """Where a reference value lies outside a histogram, say where it is."""
    for place, name in enumerate(names):
        axes, value = grid[place, place], known.get(name)
        if value is None or axes.get_xlim()[0] <= value <= axes.get_xlim()[1]:
            continue
        right = value > axes.get_xlim()[1]
        axes.annotate(
            f"{value:g}", xy=(1.0 if right else 0.0, 0.9), xycoords="axes fraction",
            xytext=(0.72 if right else 0.28, 0.9), textcoords="axes fraction",
            ha="center", va="center", color=REFERENCE_COLOR, fontsize=10,
            arrowprops={"arrowstyle": "->", "color": REFERENCE_COLOR},
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
        )  # fmt: skip


def _say_in_corner(fit: FitResult, figure: Figure, grid: Any) -> None:
    """What was fitted, and what is known of it, in the corner that the panels leave free."""
    title(grid[0, 0], f"{_name(fit)}: {fit.law} law, {fit.load} load", margin=_LEFT + 0.2, size=12)
    top, lines = grid[0, 0].get_position().y1, []
    for item in fit.combinations:
        value, stderr = format_estimate(item.value, item.stderr)
        lines.append(rf"${_as_math(fit, item.weights)} = {value} \pm {stderr}$")
    for direction in fit.null_directions:
        pair = ", ".join(f"${fit.parameters[name].symbol}$" for name in direction)
        lines.append(f"{pair}: not identifiable one by one")
    written = [("black", lines)]

    def symbols(text: str) -> str:
        for name, parameter in fit.parameters.items():
            whole = re.compile(rf"(?<![\w\\{{]){name}\b(?!\$)")
            text = whole.sub(f"${parameter.symbol}$".replace("\\", r"\\"), text)
        return text

    if fit.reference is not None:
        found = [symbols(f"{name} = {value:g}") for name, value in fit.reference.values.items()]
        written.append((REFERENCE_COLOR, [fit.reference.source, *found]))
    for other in fit.reference_fits[:1]:
        constants = ", ".join(f"{name} = {value:g} m" for name, value in other["stone"].items())
        values = [
            f"{name} = {other['values'][name]:.4f}"
            for name in (fit.reference.values if fit.reference else {})
            if name in other["values"]
        ]
        written.append((FIT_COLOR, [f"this fit with {constants}", *map(symbols, values)]))
    free = grid[0, 0].get_position().x1 + 0.02
    for color, said in written:
        if not said:
            continue
        style: dict[str, Any] = {"ha": "right", "va": "top", "fontsize": 12, "linespacing": 1.6}
        text = figure.text(0.97, top, "\n".join(said), color=color, **style)
        shrink(text, (0.97 - free) * figure.bbox.width)
        top -= text.get_window_extent().height / figure.bbox.height + 0.03


def joint_figure(result: JointResult) -> Figure:
    """All throws with their fits, and what each alone would say of the shared coefficients.

    Examples
    --------
    >>> curlfit.joint_figure(joint).savefig("joint.png")
    """
    count, shown = len(result.throws), result.differences
    columns = min(count, 5)
    names_below = 0.22 * -(-count // columns + 1)
    figure = Picture(figsize=(11, 5.4 + 0.26 * count + names_below), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.5 + 0.07 * count))
    path = figure.add_subplot(rows[0])
    styles = line_styles(count)
    for one, style in zip(result.throws, styles, strict=True):
        some = np.unique(np.linspace(0, len(one.observed["t"]) - 1, 400).astype(int))
        path.plot(
            one.observed["y"][some], one.observed["x"][some], ".", color=style["color"],
            markersize=2,
        )  # fmt: skip
        path.plot(one.fitted["y"], one.fitted["x"], **style, lw=1, label=_name(one))
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    title(path, f"{result.law} law, {result.load} load: {count} throws together")
    handles = path.get_legend_handles_labels()[0]
    if shown:
        handles.append(Patch(color="0.5", alpha=0.35, lw=0, label="mean, with its standard error"))
    figure.legend(
        handles=handles, loc="outside lower center", frameon=False, fontsize=8, ncols=columns + 1
    )
    panels = rows[1].subgridspec(1, len(shown), wspace=0.05) if shown else None
    estimates: list[tuple[Any, str]] = []
    for place, item in enumerate(shown):
        assert panels is not None
        axes = figure.add_subplot(panels[place])
        low, high = item.mean - item.stderr, item.mean + item.stderr
        color = REFERENCE_COLOR if item.significant else PALETTE[0]
        axes.axvspan(low, high, color=color, alpha=0.25, lw=0)
        for row, (alone, style) in enumerate(zip(item.each, styles, strict=True)):
            if alone is not None:
                axes.errorbar(
                    alone[0], row, xerr=alone[1], fmt="o", color=style["color"], markersize=4
                )
        axes.set_yticks(
            range(count), [_name(one) for one in result.throws] if not place else [""] * count,
            fontsize=8,
        )  # fmt: skip
        axes.set_ylim(count - 0.4, -0.6)
        differs = "differs" if item.significant else "no difference seen"
        title(axes, f"{differs}, p = {item.p_value:.2g}", columns=len(shown), size=9)
        estimates.append((axes, item.expression))
    figure.draw_without_rendering()  # the layout, by which ticks and the note are chosen
    for axes, expression in estimates:
        neat_axis(axes.xaxis, expression)
    note_stretch(path)
    return figure


def _as_math(fit: FitResult, weights: dict[str, float]) -> str:
    text = ""
    for name, weight in weights.items():
        sign = "-" if weight < 0 else "+" if text else ""
        size = "" if abs(weight) == 1 else f"{abs(weight):.3g}\\,"
        text += f"{sign}{size}{fit.parameters[name].symbol}"
    return text
