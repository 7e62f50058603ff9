"""Pictures of results. Made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from curlfit.report import number
from curlfit.throw import UNITS

if TYPE_CHECKING:
    from os import PathLike

    from curlfit.chain import Chain
    from curlfit.comparison import Comparison
    from curlfit.joint import JointResult
    from curlfit.results import FitResult
    from curlfit.throw import Throw

_DATA: dict[str, Any] = {
    "color": "0.45",
    "marker": "o",
    "markersize": 2.2,
    "linestyle": "none",
    "zorder": 1,
}
_COLOR = {
    "x": "#1f77b4", "y": "#d1495b", "phi": "#2e8b57", "speed": "#7b5ea7", "omega": "#b8860b",
}  # fmt: skip
_FIT = "#1b2a49"
_MARK = "#e07a1f"
_LABEL = {"x": "x", "y": "y", "phi": r"\varphi", "speed": "v", "omega": r"\omega"}
_SMALL = {"x": "mm", "y": "mm", "phi": "mrad", "speed": "mm/s", "omega": "mrad/s"}
_MOST_POINTS = 2000  # drawn of a long series


class Picture(Figure):
    """A matplotlib figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=80)
        return file.getvalue()


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
    panels[0].set_title(FilePath(throw.name).name, fontsize=10, loc="left")
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
    path.set_title(f"{_name(fit)}: {fit.law} law, {fit.load} load", fontsize=10, loc="left")
    path.legend(frameon=False, fontsize=9)
    path.margins(x=0.02, y=0.12)

    for place, name in enumerate(fit.rms):
        axes = figure.add_subplot(right[place])
        residual = 1000 * (fit.observed[name] - fit.fitted[name])[some]
        axes.axhline(0, color="0.7", lw=0.8)
        axes.plot(t[some], residual, ".", color=_COLOR[name], markersize=3)
        _ring_outliers(axes, fit, name)
        axes.set_title(
            f"${_LABEL[name]}$ measured - fitted, rms {1000 * fit.rms[name]:.3g} {_SMALL[name]}",
            fontsize=10,
        )
        axes.set(xlabel="t (s)", ylabel=_SMALL[name])

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


def _ring_outliers(axes: Any, fit: FitResult, name: str) -> None:
    """Outliers in orange; those far outside are drawn at the edge, the rest stays readable."""
    found = [item for item in fit.outliers if item["channel"] == name]
    if not found:
        return
    residual = fit.observed[name] - fit.fitted[name]
    inner = 1000 * float(np.nanquantile(np.abs(residual), 0.9)) * 2.5
    off = np.array([1000 * item["off"] for item in found])
    axes.set_ylim(-inner, inner)
    axes.plot(
        [item["t"] for item in found], np.clip(off, -0.97 * inner, 0.97 * inner),
        "x", color=_MARK, markersize=5, clip_on=False,
    )  # fmt: skip
    axes.text(
        0.02, 0.97, f"x: {len(found)} outliers", transform=axes.transAxes,
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
    size = 2.3 * len(names) + 0.6
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
        max_n_ticks=4,
        quantiles=(0.16, 0.5, 0.84),
        levels=(0.393, 0.865),
        range=[_extent(samples[:, place], known.get(name)) for place, name in enumerate(names)],
        plot_datapoints=len(samples) < 5000,
        label_kwargs={"fontsize": 14},
        labelpad=0.06,
    )
    grid = np.array(figure.axes).reshape(len(names), len(names))
    _mark_ridges(fit, names, known, samples, grid)
    _point_to_marks(names, known, grid)
    _say_in_corner(fit, figure)
    return figure


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


def _say_in_corner(fit: FitResult, figure: Figure) -> None:
    lines = [f"{fit.law} law, {fit.load} load", _name(fit)]
    for item in fit.combinations:
        value, stderr = number(item.value, item.stderr)
        lines.append(rf"${_as_math(fit, item.weights)} = {value} \pm {stderr}$")
    for direction in fit.null_directions:
        pair = ", ".join(f"${fit.parameters[name].symbol}$" for name in direction)
        lines.append(f"{pair}: not identifiable one by one")
    figure.text(0.97, 0.97, "\n".join(lines), ha="right", va="top", fontsize=12, linespacing=1.6)
    if fit.reference is not None:
        found = [f"{name} = {value:g}" for name, value in fit.reference.values.items()]
        for name, parameter in fit.parameters.items():
            whole = re.compile(rf"(?<![\w\\{{]){name}\b(?!\$)")
            symbol = f"${parameter.symbol}$".replace("\\", r"\\")
            found = [whole.sub(symbol, text) for text in found]
        below = 0.97 - 0.032 * (len(lines) + 0.4) * 9.8 / figure.get_figheight()
        figure.text(
            0.97, below, "\n".join([fit.reference.source, *found]),
            ha="right", va="top", fontsize=12, color=_MARK, linespacing=1.6,
        )  # fmt: skip


def comparison_figure(comparison: Comparison) -> Figure:
    """All fitted paths over the data, what each misses sideways, and the residuals by channel."""
    shown = [item for item in comparison.candidates if item.fitted is not None]
    t, x, y = (np.array(comparison.observed[name], float) for name in ("t", "x", "y"))
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), _MOST_POINTS)).astype(int))
    figure = Picture(figsize=(11, 6.4 + 0.24 * len(shown)), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.45 + 0.065 * len(shown)))
    path = figure.add_subplot(rows[0])
    lower = rows[1].subgridspec(1, 2, width_ratios=(1.0, 1.25))
    missed, dots = figure.add_subplot(lower[0]), figure.add_subplot(lower[1])

    path.plot(y[some], x[some], **_DATA, label="data")
    laws = list(dict.fromkeys(item.law for item in shown))
    colors = dict(zip(laws, _distinct(len(laws)), strict=True))
    for place, item in enumerate(shown):
        fitted = {name: np.array(values) for name, values in (item.fitted or {}).items()}
        style: dict[str, Any] = {
            "color": colors[item.law],
            "lw": 1.8 if item.follows else 1.1,
            "ls": ":" if item.signs_free else "--" if item.load == "consistent" else "-",
            "zorder": 3 + len(shown) - place,
        }
        rank = "" if item.rank is None else f"{item.rank}. "
        path.plot(fitted["y"], fitted["x"], **style, label=f"{rank}{item.label}")
        missed.plot(t, 1000 * (x - fitted["x"]), **style)
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    path.set_title(
        f"{FilePath(comparison.data['file']).name}: {len(shown)} fits", fontsize=10, loc="left"
    )
    path.margins(x=0.02, y=0.1)
    figure.legend(
        *path.get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8
    )
    missed.axhline(0, color="0.7", lw=0.8)
    missed.set(xlabel="t (s)", ylabel="x measured - fitted (mm)")

    for name in ("x", "y", "phi"):
        values = [1000 * item.misfit.get(name, np.nan) for item in shown]
        unit = "mrad" if name == "phi" else "mm"
        dots.plot(
            values, range(len(shown)), "o", color=_COLOR[name], label=f"${_LABEL[name]}$ ({unit})"
        )
    dots.grid(axis="y", color="0.9", lw=0.7)
    dots.set_yticks(range(len(shown)), [item.label for item in shown], fontsize=8)
    for tick, item in zip(dots.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if item.follows else "normal")
    dots.invert_yaxis()
    dots.set_xscale("log")
    dots.set_axisbelow(True)
    size = "rms" if comparison.loss == "linear" else "bulk"
    dots.set_xlabel(f"{size} of the residuals; bold: follows the path")
    dots.legend(frameon=False, fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    figure.draw_without_rendering()
    _stretch_note(path)
    return figure


def joint_figure(result: JointResult) -> Figure:
    """All throws with their fits, and what each alone would say of the shared coefficients."""
    count, shown = len(result.throws), result.differences
    figure = Picture(figsize=(11, 5.2 + 0.26 * count), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.5 + 0.07 * count))
    path = figure.add_subplot(rows[0])
    for one, color in zip(result.throws, _distinct(count), strict=True):
        some = np.unique(np.linspace(0, len(one.observed["t"]) - 1, 400).astype(int))
        path.plot(one.observed["y"][some], one.observed["x"][some], ".", color=color, markersize=2)
        path.plot(one.fitted["y"], one.fitted["x"], color=color, lw=1, label=_name(one))
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    path.set_title(
        f"{result.law} law, {result.load} load: {count} throws together", fontsize=10, loc="left"
    )
    figure.legend(
        *path.get_legend_handles_labels(), loc="outside right upper", frameon=False, fontsize=8
    )
    if shown:
        panels = rows[1].subgridspec(1, len(shown), wspace=0.05)
        for place, item in enumerate(shown):
            axes = figure.add_subplot(panels[place])
            low, high = item.mean - item.stderr, item.mean + item.stderr
            axes.axvspan(
                low, high, color=_MARK if item.significant else "#2e8b57", alpha=0.25, lw=0
            )
            for row, alone in enumerate(item.each):
                if alone is not None:
                    axes.errorbar(alone[0], row, xerr=alone[1], fmt="o", color=_FIT, markersize=4)
            axes.set_yticks(
                range(count), [_name(one) for one in result.throws] if not place else [""] * count,
                fontsize=8,
            )  # fmt: skip
            axes.set_ylim(count - 0.4, -0.6)
            axes.locator_params(axis="x", nbins=4)
            differs = "differs" if item.significant else "no difference seen"
            axes.set_title(f"{item.expression}\n{differs}, p = {item.p_value:.2g}", fontsize=9)
    figure.draw_without_rendering()
    _stretch_note(path)
    return figure


def _distinct(number: int) -> list[Any]:
    from matplotlib import colormaps

    names = ("tab10", "Dark2", "tab20b")
    palette = [colormaps[name](j) for name in names for j in range(colormaps[name].N)]
    return [palette[place % len(palette)] for place in range(number)]


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
