"""Figure of a profile likelihood: profile, covariance and posterior on one scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Patch

from curlfit.inference.fit.estimates import Estimate
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import Series, plot
from curlfit.output.ticks import neat_axis
from curlfit.profile_likelihood.result import PairProfile, Profile, ProfileVerdict

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import XAxis, YAxis

_REGIONS = ("#a6cfe5", "#deedf6")  # of the profile, 68 and 95 %
_HIGH = 10.0  # upper end of the axis, of a limited profile
_LOW = 5.5  # upper end of the axis, of any other
_COVARIANCE = Style(draw.COVARIANCE_COLOR, "--", width=1.4, zorder=4)
_ELLIPSE = Style(draw.COVARIANCE_COLOR, "--", width=1.3, zorder=5)
_PROFILE = Style(draw.FIT_COLOR, width=1.5, marker=".", zorder=3)
_POSTERIOR = Style(draw.POSTERIOR_COLOR, "none", width=0.9, marker="o", size=3)
_MOVES = 0.05  # smallest change of another parameter that is shown, standard errors


@draw.style()
def profile_figure(profile: Profile | PairProfile) -> draw.Picture:
    """Chi squared along one parameter and the response of the others, or
    regions of two.

    Examples
    --------
    >>> curlfit.profile_figure(profile).savefig("profile.png")
    """
    if isinstance(profile, PairProfile):
        return _pair_figure(profile)
    return _single_figure(profile)


def _single_figure(profile: Profile) -> draw.Picture:
    """Chi squared along one parameter, and below it the response of the others."""
    figure, (above, below) = draw.subplots(
        5.6, 2, 1, sharex=True, height_ratios=(1.6, 1.0)
    )
    _chi_squared(profile, above)
    _others(profile, below, figure)
    draw.title(above, draw.heading_of(profile))
    # once so that the layout leaves space for the label, and again by the final width
    _label(below.xaxis, profile.estimate, profile.name)
    figure.draw_without_rendering()
    _label(below.xaxis, profile.estimate, profile.name)
    return figure


def _chi_squared(profile: Profile, axes: Axes) -> None:
    """Chi squared along the parameter, with the parabola of its standard error and the
    density of the posterior on the same scale."""
    limited = profile.verdict == ProfileVerdict.LIMITED
    top = _HIGH if limited else _LOW
    at = profile.at
    estimate = profile.estimate
    posterior = profile.posterior
    for level in profile.levels:
        axes.axhline(level.delta_chi2, color="0.6", lw=0.8, ls=":")
        axes.annotate(
            level.name,
            (1.0, level.delta_chi2),
            xycoords=("axes fraction", "data"),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            color=draw.QUIET,
        )
    if limited:
        for interval, alpha in zip(profile.intervals, (0.16, 0.08), strict=True):
            axes.axvspan(
                interval.low, interval.high, color=draw.FIT_COLOR, alpha=alpha, lw=0
            )
    if estimate.stderr is not None:
        fine = np.linspace(at[0], at[-1], 400)
        parabola = ((fine - estimate.value) / estimate.stderr) ** 2
        plot(axes, Series(fine, parabola, _COVARIANCE, "covariance"))
    plot(axes, Series(at, profile.delta, _PROFILE, "profile"))
    if posterior is not None:
        density = Series(
            posterior.at,
            posterior.height,
            _POSTERIOR,
            r"posterior, $-2\,\ln$ density",
            sigma=posterior.error,
        )
        plot(axes, density)
    axes.plot(
        profile.best,
        0,
        "v",
        color=draw.FIT_COLOR,
        markersize=5,
        mec="white",
        clip_on=False,
        zorder=5,
    )
    axes.set(xlim=_widened(at, 0.02), ylim=(-0.04 * top, top))
    axes.set_ylabel(r"$\Delta\chi^2$, all others refitted")
    axes.legend(loc="upper center", bbox_to_anchor=(0.62, 1.0))
    if not limited:
        low, high = profile.free
        note = f"{_rise(profile)} over {low:.5g} .. {high:.5g}"
        draw.note(axes, 0.04, 0.93, note, color=draw.FIT_COLOR)


def _widened(values: Floats, share: float) -> tuple[float, float]:
    """Limits of an axis, beyond the range of values by a share of it."""
    low = float(values.min())
    high = float(values.max())
    margin = share * (high - low)
    return low - margin, high + margin


def _rise(profile: Profile) -> str:
    """How little chi squared rises within the range that the data leave free."""
    digits = 1 if profile.rise < 1e-3 else 2
    return rf"$\Delta\chi^2 \leq$ {profile.rise:.{digits}g}"


def _others(profile: Profile, axes: Axes, figure: draw.Picture) -> None:
    """Changes of the other parameters in standard errors; where one has none, its
    values, on an axis at the right."""
    shown = np.isfinite(profile.delta) & (profile.delta < _HIGH + 2)
    if profile.verdict != ProfileVerdict.LIMITED:  # beyond, a bound causes the changes
        shown &= (profile.at >= profile.free[0]) & (profile.at <= profile.free[1])
    at = profile.at[shown]
    in_combinations = {
        name for combination in profile.combinations for name in combination.weights
    }
    changes = {}
    values = {}
    for name, series in profile.others.items():
        estimate = profile.parameters[name]
        if estimate.stderr:
            change = (series[shown] - estimate.value) / estimate.stderr
            if np.abs(change).max() > _MOVES:
                changes[name] = change
        elif name in in_combinations:
            values[name] = series[shown]
    axes.axhline(0, **draw.ZERO_LINE.options())
    for name, style in zip(changes, draw.line_styles(len(changes)), strict=True):
        symbol = draw.symbol_of(profile.parameters[name])
        plot(axes, Series(at, changes[name], style, symbol))
    handles: list[Artist] = axes.get_legend_handles_labels()[0]
    axes.set_ylabel("change of other parameters\n(standard errors of each)")
    if values:
        right = axes.twinx()
        _values_at_right(profile, right, at, values)
        handles += right.get_legend_handles_labels()[0]
    if not changes:
        axes.set_ylim(-1, 1)
        which = "others" if values else "parameters"
        note = f"none of the {which} changes by more than {_MOVES:g} standard errors"
        draw.note(axes, 0.02, 0.05, note)
    if handles:
        figure.legend(
            handles=handles,
            loc="outside lower center",
            ncols=min(len(handles), 9),
            title="the other parameters, refitted",
        )


def _values_at_right(
    profile: Profile, axes: Axes, at: Floats, values: Mapping[str, Floats]
) -> None:
    """Values of parameters without a standard error, by name, on the axis at the
    right."""
    axes.grid(visible=False)
    axes.spines["right"].set_visible(True)
    symbols = [draw.symbol_of(profile.parameters[name]) for name in values]
    styles = draw.line_styles(len(values))
    for series, symbol, style in zip(values.values(), symbols, styles, strict=True):
        style = replace(style, color="0.15", width=1.8)
        plot(axes, Series(at, series, style, f"{symbol} (right)"))
    units = {profile.parameters[name].unit for name in values} - {"", "1"}
    unit = f" ({', '.join(sorted(units))})" if units else ""
    axes.set_ylabel(", ".join(symbols) + unit)
    axes.margins(y=0.1)


def _label(axis: XAxis | YAxis, estimate: Estimate, name: str) -> None:
    """Label an axis by the symbol, name and unit of a parameter, and set its ticks."""
    label = f"{draw.symbol_of(estimate)}, {name}"
    # a parameter without a symbol of its own is set in upright letters
    if estimate.symbol in (name, rf"\mathrm{{{name}}}"):
        label = name
    neat_axis(axis, label, estimate.unit)


def _pair_figure(profile: PairProfile) -> draw.Picture:
    """Regions of two parameters, with a legend and what is determined of them."""
    figure, axes = draw.subplots(4.2, 1, 1, 0.72 * draw.WIDTH)
    along = profile.each[0]
    finite = np.isfinite(profile.delta)
    lowest = float(profile.delta[finite].min(initial=np.inf))
    near = finite & (profile.delta < max(_HIGH, 2 * lowest))
    _regions(profile, axes)
    axes.set_xlim(_widened(profile.first[near], 0.04))
    axes.set_ylim(_widened(profile.second[near], 0.04))
    draw.title(axes, draw.heading_of(along), margin=0.5)
    handles = [
        Patch(facecolor=color, edgecolor=draw.FIT_COLOR, label=level.name)
        for level, color in zip(profile.levels, _REGIONS, strict=True)
    ] + axes.get_legend_handles_labels()[0]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    if along.verdict.is_valley:
        notes = [f"along the valley {_rise(along)}"]
        for combination in along.combinations:
            symbols = draw.weighted_sum(combination.weights, profile.parameters)
            notes.append(f"only ${symbols}$ is determined")
        # in the corner that the valley leaves free
        falls = profile.valley[-1] < profile.valley[0]
        draw.note(axes, 0.95 if falls else 0.05, 0.95, "\n".join(notes), color="black")
    figure.draw_without_rendering()  # the layout, which the ticks depend on
    for axis, name in zip((axes.xaxis, axes.yaxis), profile.names, strict=True):
        _label(axis, profile.parameters[name], name)
    return figure


def _regions(profile: PairProfile, axes: Axes) -> None:
    """Regions, ellipse, samples and valley."""
    surface = (profile.first, profile.second, np.ma.masked_invalid(profile.delta))
    edges = [level.delta_chi2_pair for level in profile.levels]
    axes.contourf(*surface, levels=[-1, *edges], colors=_REGIONS, zorder=1)
    if (profile.delta < edges[-1]).any():
        axes.contour(
            *surface, levels=edges, colors=draw.FIT_COLOR, linewidths=0.9, zorder=3
        )
    if len(profile.samples):
        axes.plot(
            *profile.samples.T,
            ".",
            color=draw.POSTERIOR_COLOR,
            markersize=2.6,
            mew=0,
            rasterized=True,
            label="posterior",
        )
    refitted = f"{draw.symbol_of(profile.parameters[profile.names[1]])} refitted"
    valley = Style(draw.FIT_COLOR, "-.", zorder=4)
    plot(axes, Series(profile.each[0].at, profile.valley, valley, refitted))
    best = np.array(profile.best)
    if profile.covariance is not None:
        angle = np.linspace(0, 2 * np.pi, 361)
        # the ellipse on which chi squared is larger by 1 than at the optimum
        ellipse = np.linalg.cholesky(profile.covariance) @ [
            np.cos(angle),
            np.sin(angle),
        ]
        for edge, label in zip(
            edges, ("68 %, 95 % of the covariance", ""), strict=True
        ):
            across, up = best[:, None] + np.sqrt(edge) * ellipse
            plot(axes, Series(across, up, _ELLIPSE, label))
    axes.plot(*best, "+", color="black", markersize=7, mew=1.2, zorder=6)
