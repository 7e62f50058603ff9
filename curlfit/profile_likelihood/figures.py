"""Figure of a profile likelihood: profile, covariance and posterior on one scale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Patch

from curlfit.output.figures import (
    COVARIANCE_COLOR,
    DASHES,
    FIT_COLOR,
    POSTERIOR_COLOR,
    QUIET,
    WIDTH,
    ZERO_LINE,
    Picture,
    fix_layout,
    heading_of,
    line_styles,
    math_symbol,
    styled,
    title,
)
from curlfit.output.ticks import neat_axis
from curlfit.profile_likelihood.result import PairProfile, Profile

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from curlfit.inference.fit.result import Estimate

    Floats = NDArray[np.float64]

_REGIONS = ("#a6cfe5", "#deedf6")  # of the profile, 68 and 95 %
_HIGH, _LOW = 10.0, 5.5  # upper ends of the axis, of limited profiles and of others
_MOVES = 0.05  # smallest change of another parameter that is shown, standard errors
_MAX_SHOWN = 8  # of these
_THIN = 0.4  # relative width of a valley below which it is also drawn straightened


@styled
def profile_figure(profile: Profile | PairProfile) -> Figure:
    """Chi squared along one parameter and the response of the others, or regions of two.

    Examples
    --------
    >>> curlfit.profile_figure(profile).savefig("profile.png")
    """
    return _single_figure(profile) if isinstance(profile, Profile) else _pair_figure(profile)


def _single_figure(profile: Profile) -> Figure:
    figure = Picture(figsize=(WIDTH, 5.6), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.6, 1.0))
    above = figure.add_subplot(rows[0])
    below = figure.add_subplot(rows[1], sharex=above)
    _chi_squared(profile, above)
    _others(profile, below)
    above.tick_params(labelbottom=False)
    title(above, heading_of(profile))
    label = _label(profile.estimate, profile.name)
    neat_axis(below.xaxis, *label)  # for which the layout leaves space
    fix_layout(figure)
    neat_axis(below.xaxis, *label)  # by the final width
    return figure


def _chi_squared(profile: Profile, axes: Any) -> None:
    limited = profile.verdict == "limited"
    top = _HIGH if limited else _LOW
    at, item = profile.at, profile.estimate
    for level in profile.levels:
        axes.axhline(level.delta_chi2, color="0.6", lw=0.8, ls=":")
        axes.annotate(
            level.name, (1.0, level.delta_chi2), xycoords=("axes fraction", "data"), xytext=(4, 0),
            textcoords="offset points", va="center", color=QUIET,
        )  # fmt: skip
    if limited:
        for interval, alpha in zip(profile.intervals, (0.16, 0.08), strict=True):
            axes.axvspan(interval.low, interval.high, color=FIT_COLOR, alpha=alpha, lw=0)
    if item.stderr is not None:
        fine = np.linspace(at[0], at[-1], 400)
        axes.plot(
            fine, ((fine - item.value) / item.stderr) ** 2, "--", color=COVARIANCE_COLOR, lw=1.4,
            label="covariance", zorder=4,
        )  # fmt: skip
    axes.plot(at, profile.delta, color=FIT_COLOR, lw=1.5, label="profile", zorder=3)
    axes.plot(at, profile.delta, ".", color=FIT_COLOR, markersize=4, zorder=3)
    if profile.posterior is not None:
        found = profile.posterior
        axes.errorbar(
            found["at"], found["height"], found["error"], fmt="o", color=POSTERIOR_COLOR,
            markersize=3, lw=0.9, capsize=0, label=r"posterior, $-2\,\ln$ density", zorder=2,
        )  # fmt: skip
    axes.plot(
        profile.best, 0, "v", color=FIT_COLOR, markersize=5, zorder=5, clip_on=False, mec="white"
    )
    lowest = -0.04 * top
    if profile.posterior is not None:
        lower = profile.posterior["height"] - profile.posterior["error"]
        lowest = max(-1.0, min(lowest, float(lower.min()) - 0.1))
    axes.set_ylim(lowest, top)
    axes.set_xlim(*_span(profile))
    axes.set_ylabel(r"$\Delta\chi^2$, all others refitted")
    axes.legend(loc="upper center", bbox_to_anchor=(0.62, 1.0))
    if not limited:
        _annotate(profile, axes)


def _span(profile: Profile) -> tuple[float, float]:
    """Limits of the axis, slightly beyond the range."""
    low, high = float(profile.at[0]), float(profile.at[-1])
    margin = 0.02 * (high - low)
    return low - margin, high + margin


def _annotate(profile: Profile, axes: Any) -> None:
    """The largest delta chi squared of a flat profile, and a magnified inset of a small one."""
    low, high = profile.free
    rise = f"{profile.rise:.1g}" if profile.rise < 1e-3 else f"{profile.rise:.2g}"
    axes.text(
        0.04, 0.93, rf"$\Delta\chi^2 \leq$ {rise} over {low:.5g} .. {high:.5g}",
        transform=axes.transAxes, va="top", color=FIT_COLOR,
    )  # fmt: skip
    if profile.verdict != "hardly" or profile.rise > 0.5:
        return
    inside = (profile.at >= low) & (profile.at <= high)
    inset = axes.inset_axes((0.12, 0.46, 0.33, 0.3))
    inset.plot(profile.at[inside], profile.delta[inside], color=FIT_COLOR, lw=1.3)
    inset.set_title(r"the same $\Delta\chi^2$, magnified")
    inset.tick_params(labelsize=6)
    inset.locator_params(nbins=4)
    inset.margins(x=0.02)


def _others(profile: Profile, axes: Any) -> None:
    """Changes of the others in standard errors; those without one, by their values."""
    shown = np.isfinite(profile.delta) & (profile.delta < _HIGH + 2)
    if profile.verdict != "limited":  # beyond, a bound causes the changes
        shown &= (profile.at >= profile.free[0]) & (profile.at <= profile.free[1])
    moves, values = {}, {}
    partners = {name for item in profile.combinations for name in item.weights}
    for name, series in profile.others.items():
        item = profile.parameters[name]
        if item.stderr:
            move = (series - item.value) / item.stderr
            if np.abs(move[shown]).max() > _MOVES:
                moves[name] = move
        elif name in partners:
            values[name] = series
    largest = sorted(moves, key=lambda name: -float(np.abs(moves[name][shown]).max()))[:_MAX_SHOWN]
    axes.axhline(0, **ZERO_LINE)
    lines, styles = [], line_styles(len(moves))
    for index, name in enumerate(name for name in moves if name in largest):
        label = f"${math_symbol(profile.parameters[name].symbol)}$"
        lines += axes.plot(
            profile.at[shown], moves[name][shown], lw=1.2, label=label, **styles[index],
        )  # fmt: skip
    axes.set_ylabel("change of other parameters\n(standard errors of each)")
    if values:
        right = axes.twinx()
        right.grid(visible=False)
        right.spines["right"].set_visible(True)
        for index, (name, series) in enumerate(values.items()):
            item = profile.parameters[name]
            lines += right.plot(
                profile.at[shown], series[shown], ls=DASHES[index % len(DASHES)], color="0.15",
                lw=1.8, label=f"${math_symbol(item.symbol)}$ (right)",
            )  # fmt: skip
        units = {profile.parameters[name].unit for name in values} - {"", "1"}
        unit = f" ({', '.join(sorted(units))})" if units else ""
        named = ", ".join(f"${math_symbol(profile.parameters[name].symbol)}$" for name in values)
        right.set_ylabel(named + unit)
        right.margins(y=0.1)
    if not moves:
        axes.set_ylim(-1, 1)
        axes.text(
            0.02, 0.05, f"none of the {'others' if values else 'parameters'} changes by more than "
            f"{_MOVES:g} standard errors",
            transform=axes.transAxes, color=QUIET,
        )  # fmt: skip
    if lines:
        axes.get_figure().legend(
            lines, [line.get_label() for line in lines], loc="outside lower center",
            ncols=min(len(lines), 9), title="the other parameters, refitted",
        )  # fmt: skip


def _label(item: Estimate, name: str) -> tuple[str, str]:
    """Label and unit of an axis."""
    named = item.symbol in (name, rf"\mathrm{{{name}}}")  # the latter has no symbol of its own
    return (name if named else f"${math_symbol(item.symbol)}$, {name}"), item.unit


def _pair_figure(profile: PairProfile) -> Figure:
    near = np.isfinite(profile.delta) & (profile.delta < _HIGH)
    height = float(np.ptp(profile.second[near]))
    thin = profile.across is not None and 8 * profile.across < _THIN * height
    figure = Picture(figsize=(WIDTH if thin else 0.72 * WIDTH, 4.2), layout="constrained")
    panels = figure.subplots(1, 2 if thin else 1, squeeze=False)[0]
    one, other = (profile.parameters[name] for name in profile.names)
    labels = [_label(item, name) for item, name in zip((one, other), profile.names, strict=True)]
    at, valley = profile.each[0].at, profile.valley
    some = np.isfinite(valley)

    def level(first: Floats) -> Floats:
        return np.interp(first, at[some], valley[some])

    for axes, straight in zip(panels, (False, True), strict=False):
        below = level if straight else np.zeros_like
        _regions(profile, axes, below)
        low, high = profile.first[near].min(), profile.first[near].max()
        _limits(axes.set_xlim, low, high)
        shown = (profile.second - below(profile.first))[near]
        _limits(axes.set_ylim, shown.min(), shown.max())
    title(panels[0], heading_of(profile.each[0]), columns=len(panels), margin=0.5)
    if thin:
        title(panels[1], "the same, minus the refitted value", columns=len(panels))
    handles = [
        Patch(facecolor=color, edgecolor=FIT_COLOR, label=level.name)
        for level, color in zip(profile.levels, _REGIONS, strict=True)
    ] + panels[-1].get_legend_handles_labels()[0]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    _annotate_plane(profile, panels[0])
    figure.draw_without_rendering()  # the layout, which the ticks depend on
    refitted = (
        f"${math_symbol(other.symbol)}$ \N{MINUS SIGN} refitted ${math_symbol(other.symbol)}$",
        other.unit,
    )
    for axes, second in zip(panels, (labels[1], refitted), strict=False):
        neat_axis(axes.xaxis, *labels[0])
        neat_axis(axes.yaxis, *second)
    return figure


def _limits(setter: Any, low: float, high: float) -> None:
    margin = 0.04 * (high - low)
    setter(low - margin, high + margin)


def _regions(profile: PairProfile, axes: Any, below: Any) -> None:
    """Regions, ellipse, samples and valley; `below` is subtracted from the second."""
    first, second = profile.first, profile.second - below(profile.first)
    delta = np.ma.masked_invalid(profile.delta)
    edges = [level.delta_chi2_pair for level in profile.levels]
    axes.contourf(first, second, delta, levels=[-1, *edges], colors=_REGIONS, zorder=1)
    axes.contour(first, second, delta, levels=edges, colors=FIT_COLOR, linewidths=0.9, zorder=3)
    if len(profile.samples):
        a, b = profile.samples.T
        axes.plot(
            a, b - below(a), ".", color=POSTERIOR_COLOR, markersize=2.6, mew=0, zorder=2,
            rasterized=True,
            label="posterior",
        )  # fmt: skip
    at, valley = profile.each[0].at, profile.valley
    axes.plot(
        at, valley - below(at), color=FIT_COLOR, lw=1.2, ls="-.", zorder=4,
        label=f"${math_symbol(profile.parameters[profile.names[1]].symbol)}$ refitted",
    )  # fmt: skip
    if profile.covariance is not None:
        angle = np.linspace(0, 2 * np.pi, 361)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        root = np.linalg.cholesky(profile.covariance)
        for index, edge in enumerate(edges):
            a, b = np.array(profile.best)[:, None] + np.sqrt(edge) * (root @ circle)
            axes.plot(
                a, b - below(a), "--", color=COVARIANCE_COLOR, lw=1.3, zorder=5,
                label=None if index else "68 %, 95 % of the covariance",
            )  # fmt: skip
    a, b = np.array(profile.best)
    axes.plot(a, b - below(np.array(a)), "+", color="black", markersize=7, mew=1.2, zorder=6)


def _annotate_plane(profile: PairProfile, axes: Any) -> None:
    """Note on the valley, where one is drawn."""
    along = profile.each[0]
    if along.verdict not in ("flat", "hardly"):
        return
    rise = f"{along.rise:.1g}" if along.rise < 1e-3 else f"{along.rise:.2g}"
    lines = [rf"along the valley $\Delta\chi^2 \leq$ {rise}"]
    for item in along.combinations:
        symbols = {name: math_symbol(profile.parameters[name].symbol) for name in item.weights}
        parts = [
            f"{'' if weight == 1 else f'{weight:.4g} '}${symbols[name]}$"
            for name, weight in item.weights.items()
        ]
        lines.append("only " + " + ".join(parts) + " is determined")
    falling = profile.valley[-1] < profile.valley[0]
    axes.text(
        0.95 if falling else 0.05, 0.95, "\n".join(lines), transform=axes.transAxes,
        ha="right" if falling else "left", va="top",
    )  # fmt: skip
