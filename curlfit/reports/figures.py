"""Figures of results, made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from curlfit import sheet
from curlfit.foreign import counted
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.joint.effects import Effect
from curlfit.inference.joint.result import JointResult, Variation
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.ticks import neat_axis, unit_for
from curlfit.throws.events import Event

_IN_A_ROW = 3  # panels of residuals, at most
_PANEL = 3.32 / 3.15  # height of a panel, inches
_GAP = 0.68  # and of what is below it

_LINE = draw.LINE | {"lw": 0.8}
_POOLED: dict[str, Any] = {"marker": "D", "ms": 4.5, "mfc": "w"}
_MEASURED: dict[str, Any] = {
    "color": "0.25",
    "fmt": "o",
    "markersize": 3,
    "capsize": 2,
    "lw": 1,
    "zorder": 5,
}
_NAMES = {"back": "back", "hog": "hog", "far-hog": "hog", "far-tee": "tee"}
_MOST = 5.0  # sigmas, largest residual shown

Events = list[tuple[Event, float]]
"""Timed events, each with its fitted value."""


@draw.style()
def fit_figure(fit: FitResult) -> draw.Picture:
    """The path with its fit, the residuals of each channel, speed and spin; or
    timed events.

    With a model discrepancy, solid curves show law and discrepancy together, dashed
    curves the law alone, and the residuals are those of both together.

    Examples
    --------
    >>> curlfit.fit_figure(fit).savefig("fit.png")
    """
    require_fit(fit)
    if not fit.rms:
        return event_figure(fit)
    channels = list(fit.rms)
    rows = [
        channels[first : first + _IN_A_ROW]
        for first in range(0, len(channels), _IN_A_ROW)
    ]
    # from above: the path, rows of residuals, speed beside spin; inches
    tall = 1.15 * _PANEL
    tops = 0.3 + tall + _GAP + (_PANEL + _GAP) * np.arange(len(rows) + 1)
    figure = draw.Picture(figsize=(draw.WIDTH, tops[-1] + _PANEL + 0.42))
    (path,) = draw.row(figure, 0.3, tall, right=0.5)
    residuals: list[Any] = []
    for top, in_row in zip(tops, rows, strict=False):
        residuals += draw.row(figure, top, _PANEL, len(in_row))
    speed, spin = draw.row(figure, tops[-1], _PANEL, 2)
    _path(path, fit)
    for axes, channel in zip(residuals, channels, strict=True):
        _residuals(axes, fit, channel)
    _rate(speed, fit, "speed")
    _rate(spin, fit, "omega")
    draw.letters((path, residuals[0], speed, spin))
    return figure


def _rate(axes: Any, fit: FitResult, channel: str) -> None:
    """The speed or the spin over time; the axis begins or ends at zero where the fit
    has one sign."""
    draw.plot_rate(axes, fit.observed, channel)
    draw.legend_above(axes)
    _plot_law(axes, fit, "t", channel)
    low = np.min(fit.fitted[channel])
    high = np.max(fit.fitted[channel])
    axes.set_ylim(0 if low >= 0 else None, 0 if high <= 0 <= -low else None)


def _path(axes: Any, fit: FitResult) -> None:
    """The path as measured and as fitted, seen from above."""
    rows = draw.some_rows(len(fit.observed["t"]))
    unmeasured = [
        channel
        for channel in ("x", "y")
        if not np.isfinite(fit.observed[channel]).any()
    ]
    if unmeasured:
        draw.note(axes, 0.99, 0.05, f"{' and '.join(unmeasured)} not measured")
    else:
        x = fit.observed["x"][rows]
        y = fit.observed["y"][rows]
        axes.plot(y, x, **draw.DATA_STYLE, label="data")
    _plot_law(axes, fit, "y", "x")
    axes.margins(x=0.02, y=0.12)
    draw.x_along_y(axes)
    draw.legend_above(axes)
    draw.title(axes, draw.heading_of(fit), margin=3.4 if fit.discrepancy else 2.7)
    draw.note_stretch(axes)


def _plot_law(axes: Any, fit: FitResult, across: str, up: str) -> None:
    """Plot the law, or it with the discrepancy, and the law alone dashed; `across` and
    `up` are channels, or "t", over which the curves have no label."""
    curves: list[tuple[str, Any, dict[str, Any]]]
    curves = [(f"{draw.literal(fit.law)} law", fit.fitted, {})]
    if fit.discrepancy:
        dashed = {"ls": "--", "lw": 0.9}
        curves = [
            ("law and discrepancy", fit.predicted, {}),
            ("law alone", fit.fitted, dashed),
        ]
    for label, series, style in curves:
        if across == "t":
            axes.plot(fit.observed["t"], series[up], color=draw.FIT_COLOR, **style)
        else:
            style = style | {"color": draw.FIT_COLOR, "label": label}
            axes.plot(series[across], series[up], **style)


def _residuals(axes: Any, fit: FitResult, channel: str) -> None:
    """Residuals of a channel over time."""
    t = fit.observed["t"]
    residuals = fit.observed[channel] - fit.predicted[channel]
    rms = fit.rms[channel]
    if fit.discrepancy:
        rms = float(np.sqrt(np.nanmean(residuals**2)))
    size, unit = unit_for(rms, channel)
    rows = draw.some_rows(len(t))
    axes.axhline(0, **draw.ZERO_LINE)
    axes.plot(t[rows], residuals[rows] / size, **draw.DATA_STYLE | {"color": "0.25"})
    _mark_outliers(axes, fit, channel, residuals, size)
    title = f"${draw.CHANNEL_LABEL[channel]}$: rms {rms / size:.3g} {unit}"
    draw.title(axes, title, columns=_IN_A_ROW, margin=0.7, loc="center")
    both = " of both" if fit.discrepancy else ""
    axes.set(xlabel="t (s)", ylabel=f"residual{both} ({unit})")


def _mark_outliers(
    axes: Any, fit: FitResult, channel: str, residuals: Floats, size: float
) -> None:
    """Mark outliers; distant ones are drawn at the edge so that the rest
    stays readable. Residuals are in SI, `size` is the unit of the axes."""
    outliers = [outlier for outlier in fit.outliers if outlier.channel == channel]
    if not outliers:
        return
    times = np.array([outlier.t for outlier in outliers])
    off = np.array([outlier.off for outlier in outliers])
    if fit.discrepancy:
        off = off - np.interp(times, fit.observed["t"], fit.discrepancy[channel])
    edge = float(np.nanquantile(np.abs(residuals), 0.9)) * 2.5 / size
    axes.set_ylim(-edge, edge)
    axes.plot(
        times,
        np.clip(off / size, -0.97 * edge, 0.97 * edge),
        "x",
        color="black",
        markersize=4.5,
        mew=0.9,
        clip_on=False,
        label=counted(len(outliers), "outlier"),
    )
    axes.legend(
        loc="upper left",
        handletextpad=0.1,
        borderpad=0.1,
        frameon=True,
        framealpha=0.8,
        edgecolor="none",
    )


@draw.style()
def joint_figure(result: JointResult) -> draw.Picture:
    """All throws with their fits, and the shared coefficients as each throw
    alone gives them.

    Examples
    --------
    >>> curlfit.joint_figure(joint).savefig("joint.png")
    """
    if result.table is not None:
        return _season(result)
    count = len(result.throws)
    has_paths = any(throw.rms for throw in result.throws)  # events have none
    legend_columns = min(count, 3)
    legend_rows = -(-count // legend_columns)
    heading = f"{draw.law_and_load(result)}: {count} throws together"

    # from above: the paths, if any, a row of panels of estimates, the legend; inches
    paths_height = 2.9 if has_paths else 0.2
    legend_height = 0.17 * (legend_rows - 1) if has_paths else 0.2
    height = paths_height + 0.8 + 0.2 * count + legend_height
    ratios = [1.0, 0.35 + 0.065 * count] if has_paths else [1.0]
    figure = draw.Picture(figsize=(draw.WIDTH, height), layout="constrained")
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)

    group_by_throw = [_group(result, throw) for throw in result.throws]
    groups = list(dict.fromkeys(group_by_throw))
    color_by_group = {
        group: draw.PALETTE[index % len(draw.PALETTE)]
        for index, group in enumerate(groups)
    }
    styles = [{"color": color_by_group[group]} for group in group_by_throw]
    if has_paths and len(groups) == 1:
        styles = draw.line_styles(count)

    handles = []
    if has_paths:
        path = figure.add_subplot(rows[0])
        _paths(path, result, styles)
        draw.title(path, heading)
        handles = path.get_legend_handles_labels()[0]
    else:
        figure.suptitle(heading)
    panels: Any = []
    if result.variation:
        across = rows[-1].subgridspec(1, len(result.variation), wspace=0.05)
        panels = across.subplots(sharey=True, squeeze=False)[0]
        files = [draw.file_name(throw.data.file) for throw in result.throws]
        panels[0].set_yticks(range(count), files)
        panels[0].set_ylim(count - 0.4, -0.6)
        handles += _handles(result, color_by_group)
    figure.legend(handles=handles, loc="outside lower center", ncols=legend_columns + 1)
    for axes, variation in zip(panels, result.variation, strict=True):
        _estimates(axes, result, variation, styles)
        title = "differs" if variation.significant else "no significant difference"
        if result.differences:
            title += " beside groups"
        title += f", {variation.p_text}"
        draw.title(axes, title, columns=len(panels), margin=0.25)
    _label(figure, panels, result, result.throws[0].parameters)
    if has_paths:
        draw.note_stretch(path)
    return figure


def _handles(result: JointResult, color_by_group: Mapping[str, str]) -> list[Any]:
    """Handles of a legend that says what the estimates in a joint figure are."""
    label = "expected of the throw" if result.means else "mean, with its standard error"
    handles: list[Any] = [Patch(color=draw.DATA_COLOR, alpha=0.35, lw=0, label=label)]
    if result.means:
        alone = Line2D([], [], color="k", marker="o", ms=3, label="alone")
        pooled = Line2D([], [], color="k", ls="", label="with all throws", **_POOLED)
        handles += [alone, pooled]
    if len(color_by_group) > 1:
        handles += [
            Patch(color=color, label=group) for group, color in color_by_group.items()
        ]
    return handles


def _label(
    figure: draw.Picture,
    panels: Any,
    result: JointResult,
    parameters: Mapping[str, Estimate],
) -> None:
    """Label the horizontal axes of the panels, one of each coefficient
    or combination."""
    figure.draw_without_rendering()  # ticks depend on the layout
    symbols = {name: parameter.symbol for name, parameter in parameters.items()}
    for axes, variation in zip(panels, result.variation, strict=True):
        neat_axis(axes.xaxis, draw.in_symbols(variation.expression, symbols))


def _season(result: JointResult) -> draw.Picture:
    """The means of groups, and how many throws are where."""
    figure = draw.Picture(figsize=(draw.WIDTH, 2.6), layout="constrained")
    figure.suptitle(f"{draw.law_and_load(result)}: {result.count} throws")
    panels: Any = figure.subplots(1, len(result.variation), squeeze=False)[0]
    handle_by_label: dict[str, Any] = {}
    for axes, variation in zip(panels, result.variation, strict=True):
        means = [
            effect
            for effect in result.groups
            if effect.parameter == variation.expression
            and (effect.by or not result.differences)
        ]
        _histogram(axes, variation, means)
        # what does not vary has no groups, so that one panel may lack labels
        handles, labels = axes.get_legend_handles_labels()
        handle_by_label |= dict(zip(labels, handles, strict=True))
    figure.legend(
        handle_by_label.values(),
        handle_by_label.keys(),
        loc="outside lower center",
        ncols=4,
    )
    _label(figure, panels, result, result.coefficients)
    return figure


def _histogram(axes: Any, variation: Variation, means: Sequence[Effect]) -> None:
    """Histogram of a coefficient of the throws, each alone, with means of groups one
    above the other on top of it."""
    values = np.array([alone[0] for alone in variation.each if alone is not None])
    # a few throws far away would make the bins wide
    low, high = np.quantile(values, (0.01, 0.99))
    margin = 0.2 * (high - low)
    bins = np.linspace(low - margin, high + margin, min(40, 8 + len(values) // 20))
    axes.hist(
        values, bins, color=draw.DATA_COLOR, alpha=0.35, label="throws, each alone"
    )
    top = axes.get_ylim()[1]
    for row, mean in enumerate(means):
        axes.errorbar(
            mean.value,
            top * (1.06 + 0.1 * row),
            xerr=mean.stderr,
            fmt="o",
            ms=4,
            capsize=2,
            label=f"{mean.by} {mean.group}".strip() or "mean",
            color=draw.PALETTE[row % len(draw.PALETTE)],
        )
    axes.set(ylim=(0, top * (1.12 + 0.1 * len(means))), yticks=[])


def _paths(axes: Any, result: JointResult, styles: list[dict[str, Any]]) -> None:
    """The paths of all throws as measured and as fitted, seen from above."""
    for throw, style in zip(result.throws, styles, strict=True):
        rows = draw.some_rows(len(throw.observed["t"]), 400)
        x = throw.observed["x"][rows]
        y = throw.observed["y"][rows]
        axes.plot(y, x, **draw.DATA_STYLE | {"color": style["color"]})
        axes.plot(
            throw.predicted["y"],
            throw.predicted["x"],
            **style,
            lw=1,
            label=draw.file_name(throw.data.file),
        )
    draw.x_along_y(axes)


def _group(result: JointResult, throw: FitResult) -> str:
    """The group of a throw by the first label of the fit; empty without groups."""
    if not result.means or not result.means.groups:
        return ""
    label = next(iter(result.means.groups))
    return f"{label} {throw.data.labels.get(label, '')}"


def _estimates(
    axes: Any, result: JointResult, variation: Variation, styles: list[dict[str, Any]]
) -> None:
    """Estimates of each throw alone, by row, and their mean or, where throws vary, what
    is expected of each and its estimate from all throws."""
    weights_by_expression = {
        combination.expression: combination.weights
        for combination in result.combinations
    }
    expression = variation.expression
    weights = weights_by_expression.get(expression, {expression: 1.0})
    if result.means is None:
        low = variation.mean - variation.stderr
        high = variation.mean + variation.stderr
        axes.axvspan(low, high, color=draw.DATA_COLOR, alpha=0.25, lw=0)
    rows = zip(variation.each, styles, result.throws, strict=True)
    for row, (alone, style, throw) in enumerate(rows):
        color = style["color"]
        if result.means is not None:
            mean, sd = result.means.expected(weights, throw.data.labels)
            axes.barh(
                row, 2 * sd, left=mean - sd, height=0.9, color=color, alpha=0.25, lw=0
            )
            pooled = sum(
                weight * throw.parameters[name].value
                for name, weight in weights.items()
            )
            axes.plot(pooled, row, color=color, zorder=3, **_POOLED)
        if alone is not None:
            value, stderr = alone
            axes.errorbar(
                value, row, xerr=stderr, fmt="o", color=color, markersize=3, lw=1
            )


@draw.style()
def event_figure(fit: FitResult) -> draw.Picture:
    """The path on the sheet, the crossings in time, and the residuals."""
    figure = draw.Picture(figsize=(draw.WIDTH, 5.0), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.9))
    on_sheet = figure.add_subplot(rows[0])
    panels: Any = rows[1].subgridspec(1, 2, width_ratios=(1.3, 0.9)).subplots()
    # the fit until one row after it comes to rest, or all of it
    speed = fit.fitted["speed"]
    last = int(np.argmax(speed == 0)) or len(speed) - 1
    moving = {name: series[: last + 2] for name, series in fit.fitted.items()}
    moving["t"] = fit.observed["t"][: last + 2]
    _sheet(
        on_sheet,
        moving,
        [(fitted.event, fitted.fitted) for fitted in fit.events],
        f"{draw.literal(fit.law)} law",
    )
    draw.title(on_sheet, draw.heading_of(fit))
    _distance(
        panels[0], moving, [(fitted.event, fitted.fitted) for fitted in fit.events]
    )
    _event_residuals(
        panels[1], [(fitted.event, fitted.fitted) for fitted in fit.events]
    )
    return figure


def _sheet(axes: Any, moving: dict[str, Any], events: Events, law: str) -> None:
    """The path over the lines and the house, thrown to the right."""
    x = moving["x"]
    y = moving["y"]
    draw.plot_house(axes, (sheet.TEE, 0))
    axes.axhline(0, **_LINE)
    axes.plot(y, x, color=draw.FIT_COLOR, lw=1.4, zorder=4, label=law)
    # coordinates of rest, each with its sigma; one that was not measured is the fit's
    rest = {"x": (x[-1], 0.0), "y": (y[-1], 0.0)}
    measured = {
        event.quantity: (event.value, event.sigma)
        for event, _ in events
        if event.at is None and event.quantity in rest
    }
    if measured:
        rest |= measured
        x_rest, x_sigma = rest["x"]
        y_rest, y_sigma = rest["y"]
        axes.errorbar(
            y_rest,
            x_rest,
            xerr=y_sigma,
            yerr=x_sigma,
            **_MEASURED,
            label="measured resting position",
        )
    left = min(float(y[0]), sheet.LINES["hog"]) - 1
    right = max(float(y[-1]), sheet.END) + 0.6
    axes.set_xlim(left, right)
    names = {line: f"{name} line" for line, name in _NAMES.items()}
    draw.sheet_axes(axes, names, sheet.WIDTH / 2, lw=0.8)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=2)


def _distance(axes: Any, moving: dict[str, Any], events: Events) -> None:
    """y over time; a measured time is drawn on its line, its residual off the
    fitted crossing."""
    t = moving["t"]
    y = moving["y"]
    axes.plot(t, y, color=draw.FIT_COLOR)
    for line, name in _NAMES.items():
        at = sheet.LINES[line]
        if at >= y[0] - 1e-6:
            axes.axhline(at, **_LINE)
            axes.text(
                0.01,
                at,
                name,
                transform=axes.get_yaxis_transform(),
                fontsize=7,
                color=draw.QUIET,
                va="bottom",
            )
    for event, fitted in events:
        if event.quantity == "time":
            at = y[-1] if event.at is None else event.at  # no line: until rest
            crossing = float(np.interp(at, y, t))
            time = crossing + event.value - fitted
            axes.errorbar(time, at, xerr=event.sigma, **_MEASURED)
        elif event.quantity == "y":
            axes.errorbar(t[-1], event.value, yerr=event.sigma, **_MEASURED)
    axes.set(xlabel="t (s)", ylabel="along the sheet, y (m)", xlim=(0, None))


def _event_residuals(axes: Any, events: Events) -> None:
    """Measured minus fitted, in sigmas; the number stands beside one that is drawn at
    the edge."""
    residuals = [(event.value - fitted) / event.sigma for event, fitted in events]
    rows = np.arange(len(events))
    axes.axvline(0, **_LINE)
    axes.errorbar(np.clip(residuals, -_MOST, _MOST), rows, xerr=1.0, **_MEASURED)
    for row, residual in zip(rows, residuals, strict=True):
        if abs(residual) > _MOST:
            text = f"{residual:.2g} sigma".replace("-", "\N{MINUS SIGN}")
            axes.text(
                0.5, row + 0.12, text, ha="center", transform=axes.get_yaxis_transform()
            )
    axes.set_yticks(rows, [event.name for event, _ in events])
    reach = max(2.5, *(min(abs(residual), _MOST) + 1.5 for residual in residuals))
    axes.set(xlim=(-reach, reach), ylim=(len(events) - 0.5, -0.5))
    axes.set_xlabel("measured \N{MINUS SIGN} fit (sigma)")
