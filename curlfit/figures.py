"""Pictures of results. Made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

import math
import re
from io import BytesIO
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from curlfit.report import listed, number
from curlfit.throw import UNITS

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    from curlfit.chain import Chain
    from curlfit.comparison import Candidate, Comparison
    from curlfit.joint import JointResult
    from curlfit.results import Estimate, FitResult
    from curlfit.throw import Throw

    Floats = NDArray[np.float64]

_DATA: dict[str, Any] = {
    "color": "0.45",
    "marker": "o",
    "markersize": 2.2,
    "linestyle": "none",
    "zorder": 1,
}
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that the colour-blind tell apart (Okabe and Ito 2008)."""

DASHES = ("-", "--", "-.", ":")
_COLOR = dict(zip(("x", "y", "phi", "speed", "omega"), PALETTE, strict=False))
_MARKER = {"x": "o", "y": "s", "phi": "^"}
_FIT = "#1b2a49"
_MARK = "#e07a1f"
_LABEL = {"x": "x", "y": "y", "phi": r"\varphi", "speed": "v", "omega": r"\omega"}
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
_LEFT = 1.3  # inches left of the panels of a corner
_LONG = 1e4  # steps between ticks in a number, from which a part of it is taken from all
_SAME = 0.0075  # share of an axis, about a line's width, up to which curves are one
_MOST_POINTS = 2000  # drawn of a long series


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
    _shrink(found, figure.bbox.width / columns - margin * figure.dpi)


def _shrink(text: Any, room: float) -> None:
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


def throw_figure(throw: Throw) -> Figure:
    """What was measured over time, a panel for each channel."""
    seen = throw.seen
    figure = Picture(figsize=(8, 1.8 * len(seen) + 0.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(seen), 1, sharex=True))
    for axes, name in zip(panels, seen, strict=True):
        axes.plot(throw.t, getattr(throw, name), ".", color=_COLOR[name], markersize=3)
        axes.set_ylabel(f"${_LABEL[name]}$ ({UNITS[name]})")
        axes.grid(alpha=0.3)
    panels[-1].set_xlabel("t (s)")
    title(panels[0], FilePath(throw.name).name)
    return figure


def fit_figure(fit: FitResult) -> Figure:
    """The path with its fit, the residuals of each channel, speed and spin."""
    figure = Picture(figsize=(10, 7.2), layout="constrained")
    rows = figure.add_gridspec(3, 1, height_ratios=(1.15, 1.0, 1.0))
    right = rows[1].subgridspec(1, len(fit.rms))
    bottom = rows[2].subgridspec(1, 2)
    t = fit.observed["t"]
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), _MOST_POINTS)).astype(int))

    path = figure.add_subplot(rows[0])
    path.plot(fit.observed["y"][some], fit.observed["x"][some], **_DATA, label="data")
    path.plot(fit.fitted["y"], fit.fitted["x"], color=_FIT, lw=1.3, label=f"{fit.law} law")
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    title(path, f"{_name(fit)}: {fit.law} law, {fit.load} load")
    path.legend(frameon=False, fontsize=9)
    path.margins(x=0.02, y=0.12)

    for place, name in enumerate(fit.rms):
        axes = figure.add_subplot(right[place])
        size, unit = unit_for(fit.rms[name], name)
        residual = (fit.observed[name] - fit.fitted[name])[some] / size
        axes.axhline(0, color="0.7", lw=0.8)
        axes.plot(t[some], residual, ".", color=_COLOR[name], markersize=3)
        _ring_outliers(axes, fit, name, size)
        said = f"${_LABEL[name]}$: rms {fit.rms[name] / size:.3g} {unit}"
        title(axes, said, columns=len(fit.rms), loc="center")
        axes.set(xlabel="t (s)", ylabel=f"residual ({unit})")

    speed, spin = (figure.add_subplot(bottom[place]) for place in range(2))
    for axes, name in ((speed, "speed"), (spin, "omega")):
        if name in fit.observed:
            axes.plot(t[some], fit.observed[name][some], **_DATA)
    speed.plot(t, fit.fitted["speed"], color=_FIT)
    speed.set(xlabel="t (s)", ylabel="speed (m/s)")
    speed.set_ylim(bottom=0)
    spin.plot(t, fit.fitted["omega"], color=_COLOR["phi"])
    spin.set(xlabel="t (s)", ylabel=r"spin $\omega$ (rad/s)")
    _include_zero(spin, fit.fitted["omega"])
    figure.draw_without_rendering()  # the layout, which the note's number depends on
    _stretch_note(path)
    return figure


def _ring_outliers(axes: Any, fit: FitResult, name: str, size: float) -> None:
    """Outliers in orange; those far outside are drawn at the edge, the rest stays readable."""
    found = [item for item in fit.outliers if item["channel"] == name]
    if not found:
        return
    residual = fit.observed[name] - fit.fitted[name]
    inner = float(np.nanquantile(np.abs(residual), 0.9)) * 2.5 / size
    off = np.array([item["off"] / size for item in found])
    axes.set_ylim(-inner, inner)
    axes.plot(
        [item["t"] for item in found], np.clip(off, -0.97 * inner, 0.97 * inner),
        "x", color=_MARK, markersize=5, clip_on=False,
    )  # fmt: skip
    axes.text(
        0.02, 0.97, f"\N{MULTIPLICATION SIGN} {len(found)} outliers", transform=axes.transAxes,
        color=_MARK, fontsize=8, va="top",
    )  # fmt: skip


def _name(fit: FitResult) -> str:
    return FilePath(fit.data["file"]).name


def _stretch_note(axes: Any) -> None:
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


def _include_zero(axes: Any, values: Any) -> None:
    low, high = float(np.min(values)), float(np.max(values))
    if low >= 0:
        axes.set_ylim(bottom=0)
    elif high <= 0:
        axes.set_ylim(top=0)


def corner_figure(fit: FitResult, chain: Chain) -> Figure:
    """Posterior of the law's coefficients, pair by pair, with reference values marked."""
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
        truth_color=_MARK,
        color=_FIT,
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
            ".", color=_FIT, markersize=2, alpha=0.5,
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
            axes.plot(horizontal, vertical, color=_MARK, lw=1.2)
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
            ha="center", va="center", color=_MARK, fontsize=10,
            arrowprops={"arrowstyle": "->", "color": _MARK},
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
        )  # fmt: skip


def _say_in_corner(fit: FitResult, figure: Figure, grid: Any) -> None:
    """What was fitted, and what is known of it, in the corner that the panels leave free."""
    title(grid[0, 0], f"{_name(fit)}: {fit.law} law, {fit.load} load", margin=_LEFT + 0.2, size=12)
    top, lines = grid[0, 0].get_position().y1, []
    for item in fit.combinations:
        value, stderr = number(item.value, item.stderr)
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
        written.append((_MARK, [fit.reference.source, *found]))
    for other in fit.reference_fits[:1]:
        constants = ", ".join(f"{name} = {value:g} m" for name, value in other["stone"].items())
        values = [
            f"{name} = {other['values'][name]:.4f}"
            for name in (fit.reference.values if fit.reference else {})
            if name in other["values"]
        ]
        written.append((_FIT, [f"this fit with {constants}", *map(symbols, values)]))
    free = grid[0, 0].get_position().x1 + 0.02
    for color, said in written:
        if not said:
            continue
        style: dict[str, Any] = {"ha": "right", "va": "top", "fontsize": 12, "linespacing": 1.6}
        text = figure.text(0.97, top, "\n".join(said), color=color, **style)
        _shrink(text, (0.97 - free) * figure.bbox.width)
        top -= text.get_window_extent().height / figure.bbox.height + 0.03


def comparison_figure(comparison: Comparison) -> Figure:
    """All fitted paths over the data, their residuals sideways, and the residuals by channel."""
    shown = [item for item in comparison.candidates if item.fitted is not None]
    t, x, y = (np.array(comparison.observed[name], float) for name in ("t", "x", "y"))
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), _MOST_POINTS)).astype(int))
    curves = _curves(shown, x)
    figure = Picture(figsize=(11, 6.4 + 0.24 * len(shown)), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.6 + 0.06 * len(shown)))
    path = figure.add_subplot(rows[0].subgridspec(1, 1)[0])
    lower = rows[1].subgridspec(1, 2, width_ratios=(1.3, 1.0))
    residual, dots = figure.add_subplot(lower[0]), figure.add_subplot(lower[1])

    path.plot(y[some], x[some], **_DATA, label="data")
    for place, (same, style) in enumerate(zip(curves, _styles(len(curves)), strict=True)):
        fitted = {name: np.array(values) for name, values in (same[0].fitted or {}).items()}
        drawn: dict[str, Any] = {
            **style,
            "lw": 1.8 if same[0].follows else 1.1,
            "zorder": 3 + len(curves) - place,
        }
        path.plot(fitted["y"], fitted["x"], **drawn, label=_names_of(same))
        residual.plot(t, 1000 * (x - fitted["x"]), **drawn)
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    title(path, f"{FilePath(comparison.data['file']).name}: {len(shown)} fits")
    path.margins(x=0.02, y=0.1)
    path.legend(
        loc="upper left", bbox_to_anchor=(1.01, 1.02), frameon=False, fontsize=8, labelspacing=0.8
    )
    residual.axhline(0, color="0.7", lw=0.8)
    residual.set(xlabel="t (s)", ylabel="residual of x (mm)")

    for name, marker in _MARKER.items():
        values = [1000 * item.misfit.get(name, np.nan) for item in shown]
        unit = "mrad" if name == "phi" else "mm"
        dots.plot(
            values, range(len(shown)), marker, color=_COLOR[name], markerfacecolor="none",
            markeredgewidth=1.6, label=f"${_LABEL[name]}$ ({unit})",
        )  # fmt: skip
    dots.grid(axis="y", color="0.9", lw=0.7)
    dots.set_yticks(range(len(shown)), [item.label for item in shown], fontsize=8)
    for tick, item in zip(dots.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if item.follows else "normal")
    dots.set_ylim(len(shown) - 0.4, -0.6)
    dots.set_xscale("log")
    dots.set_axisbelow(True)
    size = "rms" if comparison.loss == "linear" else "bulk"
    dots.set_xlabel(f"{size} of the residuals; bold: follows the path")
    dots.legend(frameon=False, fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    figure.draw_without_rendering()
    _stretch_note(path)
    return figure


def _curves(shown: list[Candidate], x: Floats) -> list[list[Candidate]]:
    """The candidates by curve: together where no line of the figure would tell them apart."""
    if not shown:
        return []
    paths = [np.array([item.fitted["x"], item.fitted["y"]]) for item in shown if item.fitted]
    all_of_them = np.array(paths)
    reach = _SAME * np.array([np.ptp(all_of_them[:, 0] - x), np.ptp(all_of_them[:, 1])])
    found: list[list[int]] = []
    for place, path in enumerate(paths):
        for same in found:
            if (np.abs(path - paths[same[0]]).max(axis=1) <= reach).all():
                same.append(place)
                break
        else:
            found.append([place])
    return [[shown[place] for place in same] for same in found]


def _names_of(same: list[Candidate]) -> str:
    """Ranks, laws and loads of candidates with one path, a line a law."""
    loads: dict[tuple[str, str], list[str]] = {}
    ranks: dict[tuple[str, str], list[str]] = {}
    for item in same:
        law = item.law, ", any sign" if item.signs_free else ""
        loads.setdefault(law, []).append(item.load)
        ranks.setdefault(law, []).extend([] if item.rank is None else [str(item.rank)])
    lines = []
    for law, names in loads.items():
        rank = f"{', '.join(ranks[law])}. " if ranks[law] else ""
        load = "" if names == ["-"] else f", {listed(names)} load"
        lines.append(f"{rank}{law[0]}{load}{law[1]}")
    return "\n".join(lines) + (" (same path)" if len(same) > 1 else "")


def joint_figure(result: JointResult) -> Figure:
    """All throws with their fits, and what each alone would say of the shared coefficients."""
    count, shown = len(result.throws), result.differences
    columns = min(count, 5)
    names_below = 0.22 * -(-count // columns + 1)
    figure = Picture(figsize=(11, 5.4 + 0.26 * count + names_below), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.5 + 0.07 * count))
    path = figure.add_subplot(rows[0])
    styles = _styles(count)
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
        color = _MARK if item.significant else PALETTE[0]
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
    _stretch_note(path)
    return figure


def _styles(number: int) -> list[dict[str, Any]]:
    """A colour and dashes for each of so many lines."""
    count = len(PALETTE)
    return [
        {"color": PALETTE[place % count], "ls": DASHES[place // count % len(DASHES)]}
        for place in range(number)
    ]


def _as_math(fit: FitResult, weights: dict[str, float]) -> str:
    text = ""
    for name, weight in weights.items():
        sign = "-" if weight < 0 else "+" if text else ""
        size = "" if abs(weight) == 1 else f"{abs(weight):.3g}\\,"
        text += f"{sign}{size}{fit.parameters[name].symbol}"
    return text


def save_figure(figure: Figure, file: str | PathLike[str], dpi: int = 150) -> None:
    """Write a figure, whole or not at all."""
    from curlfit.files import replaced

    # Drawn in memory: on a full disk matplotlib's writers fail in ways of their own.
    path, image = FilePath(file), BytesIO()
    figure.savefig(image, dpi=dpi, format=path.suffix[1:] or "png")
    with replaced(path) as temporary:
        temporary.write_bytes(image.getbuffer())
