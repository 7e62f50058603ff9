"""Figures of results, made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from curlfit import sheet
from curlfit.foreign import counted
from curlfit.inference.fit.entries import FittedEvent
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.together.effects import Effect
from curlfit.inference.together.result import JointResult, Variation
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import (
    ERROR_BARS,
    LAW,
    OUTLIERS,
    RESIDUALS,
    Interval,
    Row,
    RowValue,
    Series,
    measured_rate,
    note_stretch,
    plot,
    plot_on_sheet,
    plot_path,
    plot_rate,
    plot_residuals,
    plot_rows,
    plot_value,
)
from curlfit.output.ticks import neat_axis, unit_for

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_IN_A_ROW = 3  # panels of residuals, at most
_PANEL = 3.32 / 3.15  # height of a panel, inches
_GAP = 0.68  # and of what is below it

_POOLED = Style("black", "none", marker="D", size=4.5, fill="white", zorder=3)
"""of estimates from all throws"""
_NAMES = {"back": "back", "hog": "hog", "far-hog": "hog", "far-tee": "tee"}
_MOST = 5.0  # sigmas, largest residual shown
_POINTS_OF_A_THROW = 400  # most drawn of each path among others

Events = Sequence[FittedEvent]


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
    (path,) = draw.side_by_side(figure, 0.3, tall, right=0.5)
    residuals: list[Axes] = []
    for top, in_row in zip(tops, rows, strict=False):
        residuals += draw.side_by_side(figure, top, _PANEL, len(in_row))
    speed, spin = draw.side_by_side(figure, tops[-1], _PANEL, 2)
    _path(path, fit)
    for axes, channel in zip(residuals, channels, strict=True):
        _residuals(axes, fit, channel)
    _rate(speed, fit, "speed")
    _rate(spin, fit, "omega")
    draw.letters((path, residuals[0], speed, spin))
    return figure


@dataclass(frozen=True)
class _Curve:
    """Channels of a curve over the times of a fit, its style and label."""

    channels: Mapping[str, Floats]
    style: Style
    label: str


def _curves(fit: FitResult) -> list[_Curve]:
    """The law, or it with the discrepancy, and the law alone, dashed."""
    if not fit.discrepancy:
        return [_Curve(fit.fitted, LAW, f"{draw.literal(fit.law)} law")]
    dashed = replace(LAW, dashes="--", width=0.9)
    return [
        _Curve(fit.predicted, LAW, "law and discrepancy"),
        _Curve(fit.fitted, dashed, "law alone"),
    ]


def _path(axes: Axes, fit: FitResult) -> None:
    """The path as measured and as fitted, seen from above."""
    unmeasured = [
        channel
        for channel in ("x", "y")
        if not np.isfinite(fit.observed[channel]).any()
    ]
    paths = []
    if unmeasured:
        draw.note(axes, 0.99, 0.05, f"{' and '.join(unmeasured)} not measured")
    else:
        paths = [Series(fit.observed["y"], fit.observed["x"], draw.DATA, "data")]
    for curve in _curves(fit):
        y = curve.channels["y"]
        paths.append(Series(y, curve.channels["x"], curve.style, curve.label))
    plot_path(axes, paths)
    draw.legend_above(axes)
    draw.title(axes, draw.heading_of(fit), margin=3.4 if fit.discrepancy else 2.7)
    note_stretch(axes)


def _residuals(axes: Axes, fit: FitResult, channel: str) -> None:
    """Residuals of a channel over time, in a unit that suits their size, and which of
    them were taken for outliers."""
    t = fit.observed["t"]
    residuals = fit.observed[channel] - fit.predicted[channel]
    rms = fit.rms[channel]
    label = "residual"
    if fit.discrepancy:
        rms = float(np.sqrt(np.nanmean(residuals**2)))
        label = "residual of both"
    size, unit = unit_for(rms, channel)
    outliers = _outliers(fit, channel, size)
    plot_residuals(
        axes,
        [Series(t, residuals / size, RESIDUALS)],
        outliers=outliers,
        label=f"{label} ({unit})",
    )
    if outliers is not None:
        axes.legend(
            loc="upper left",
            handletextpad=0.1,
            borderpad=0.1,
            frameon=True,
            framealpha=0.8,
            edgecolor="none",
        )
    title = f"${draw.CHANNEL_LABEL[channel]}$: rms {rms / size:.3g} {unit}"
    draw.title(axes, title, columns=_IN_A_ROW, margin=0.7, loc="center")


def _outliers(fit: FitResult, channel: str, size: float) -> Series | None:
    """The residuals of the outliers of a channel in a unit, whose size is in SI; None
    if there are none."""
    outliers = [outlier for outlier in fit.outliers if outlier.channel == channel]
    if not outliers:
        return None
    t = np.array([outlier.t for outlier in outliers])
    off = np.array([outlier.off for outlier in outliers])
    if fit.discrepancy:
        off = off - np.interp(t, fit.observed["t"], fit.discrepancy[channel])
    label = counted(len(outliers), "outlier")
    return Series(t, off / size, OUTLIERS, label)


def _rate(axes: Axes, fit: FitResult, rate: str) -> None:
    """The speed or the spin over time."""
    t = fit.observed["t"]
    curves = [Series(t, curve.channels[rate], curve.style) for curve in _curves(fit)]
    plot_rate(axes, rate, [measured_rate(fit.observed, rate)], curves)
    draw.legend_above(axes)


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
    styles = [Style(color_by_group[group]) for group in group_by_throw]
    if has_paths and len(groups) == 1:
        styles = draw.line_styles(count)

    handles: list[Artist] = []
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
        handles += _handles(result, color_by_group)
    figure.legend(handles=handles, loc="outside lower center", ncols=legend_columns + 1)
    for axes, variation in zip(panels, result.variation, strict=True):
        plot_rows(
            axes, _estimates(result, variation, styles), _common(result, variation)
        )
        title = "differs" if variation.significant else "no significant difference"
        if result.differences:
            title += " beside groups"
        title += f", {variation.p_text}"
        draw.title(axes, title, columns=len(panels), margin=0.25)
    _label(figure, panels, result, result.throws[0].parameters)
    if has_paths:
        note_stretch(path)
    return figure


def _handles(result: JointResult, color_by_group: Mapping[str, str]) -> list[Artist]:
    """Handles of a legend that says what the estimates in a joint figure are."""
    label = "expected of the throw" if result.means else "mean, with its standard error"
    handles: list[Artist] = [
        Patch(color=draw.DATA_COLOR, alpha=0.35, lw=0, label=label)
    ]
    if result.means:
        alone = Line2D([], [], color="k", marker="o", ms=3, label="alone")
        pooled = Line2D([], [], label="with all throws", **_POOLED.options())
        handles += [alone, pooled]
    if len(color_by_group) > 1:
        handles += [
            Patch(color=color, label=group) for group, color in color_by_group.items()
        ]
    return handles


def _label(
    figure: draw.Picture,
    panels: Sequence[Axes],
    result: JointResult,
    parameters: Mapping[str, Estimate],
) -> None:
    """Label the horizontal axes of the panels, one of each coefficient, with its unit,
    or combination."""
    figure.draw_without_rendering()  # ticks depend on the layout
    symbols = {name: parameter.symbol for name, parameter in parameters.items()}
    for axes, variation in zip(panels, result.variation, strict=True):
        expression = variation.expression
        unit = parameters[expression].unit if expression in parameters else ""
        neat_axis(axes.xaxis, draw.in_symbols(expression, symbols), unit)


def _season(result: JointResult) -> draw.Picture:
    """The means of groups, and how many throws are where."""
    figure = draw.Picture(figsize=(draw.WIDTH, 2.6), layout="constrained")
    figure.suptitle(f"{draw.law_and_load(result)}: {result.count} throws")
    panels: Any = figure.subplots(1, len(result.variation), squeeze=False)[0]
    handle_by_label: dict[str, Artist] = {}
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


def _histogram(axes: Axes, variation: Variation, means: Sequence[Effect]) -> None:
    """Histogram of a coefficient of the throws, each alone, with means of groups one
    above the other on top of it."""
    values = np.array([alone[0] for alone in variation.each if alone is not None])
    # a few throws far away would make the bins wide
    low, high = np.quantile(values, (0.01, 0.99))
    margin = 0.2 * (high - low)
    bins = np.linspace(low - margin, high + margin, min(40, 8 + len(values) // 20))
    axes.hist(
        values,
        bins.tolist(),
        color=draw.DATA_COLOR,
        alpha=0.35,
        label="throws, each alone",
    )
    top = axes.get_ylim()[1]
    for row, mean in enumerate(means):
        color = draw.PALETTE[row % len(draw.PALETTE)]
        value = RowValue(
            mean.value,
            Style(color, "none", marker="o", size=4, cap=2),
            mean.stderr,
            f"{mean.by} {mean.group}".strip() or "mean",
        )
        plot_value(axes, top * (1.06 + 0.1 * row), value)
    axes.set(ylim=(0, top * (1.12 + 0.1 * len(means))), yticks=[])


def _paths(axes: Axes, result: JointResult, styles: Sequence[Style]) -> None:
    """The paths of all throws as measured and as fitted, seen from above."""
    paths = []
    for throw, style in zip(result.throws, styles, strict=True):
        rows = draw.some_rows(len(throw.observed["t"]), _POINTS_OF_A_THROW)
        x = throw.observed["x"][rows]
        y = throw.observed["y"][rows]
        marks = replace(draw.DATA, color=style.color)
        line = replace(style, width=1)
        file = draw.file_name(throw.data.file)
        paths.append(Series(y, x, marks))
        paths.append(Series(throw.predicted["y"], throw.predicted["x"], line, file))
    plot_path(axes, paths)


def _group(result: JointResult, throw: FitResult) -> str:
    """The group of a throw by the first label of the fit; empty without groups."""
    if not result.means or not result.means.groups:
        return ""
    label = next(iter(result.means.groups))
    return f"{label} {throw.data.labels.get(label, '')}"


def _estimates(
    result: JointResult, variation: Variation, styles: Sequence[Style]
) -> list[Row]:
    """The estimate of each throw alone and, where throws vary, what is expected of it
    and its estimate from all throws."""
    weights_by_expression = {
        combination.expression: combination.weights
        for combination in result.combinations
    }
    expression = variation.expression
    weights = weights_by_expression.get(expression, {expression: 1.0})
    rows = []
    for alone, style, throw in zip(variation.each, styles, result.throws, strict=True):
        values = []
        expected = None
        if result.means is not None:
            mean, sd = result.means.expected(weights, throw.data.labels)
            expected = Interval(mean - sd, mean + sd, style.color, 0.25)
            pooled = sum(
                weight * throw.parameters[name].value
                for name, weight in weights.items()
            )
            values.append(RowValue(pooled, replace(_POOLED, color=style.color)))
        if alone is not None:
            value, stderr = alone
            marks = Style(style.color, "none", width=1, marker="o", size=3)
            values.append(RowValue(value, marks, stderr))
        rows.append(Row(draw.file_name(throw.data.file), values, expected=expected))
    return rows


def _common(result: JointResult, variation: Variation) -> Interval | None:
    """The mean with its standard error, if throws do not vary about it."""
    if result.means is not None:
        return None
    low = variation.mean - variation.stderr
    high = variation.mean + variation.stderr
    return Interval(low, high, draw.DATA_COLOR, 0.25)


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
    _sheet(on_sheet, moving, fit.events, f"{draw.literal(fit.law)} law")
    draw.title(on_sheet, draw.heading_of(fit))
    _distance(panels[0], moving, fit.events)
    _event_residuals(panels[1], fit.events)
    return figure


def _sheet(axes: Axes, moving: Mapping[str, Floats], events: Events, law: str) -> None:
    """The path over the lines and the house, thrown to the right, and the resting
    position if it was measured."""
    x = moving["x"]
    y = moving["y"]
    paths = [Series(y, x, replace(LAW, width=1.4, zorder=4), law)]
    # coordinates of rest, each with its sigma; one that was not measured is the fit's
    rest = {"x": (x[-1], 0.0), "y": (y[-1], 0.0)}
    measured = {
        event.quantity: (event.value, event.sigma)
        for event in events
        if event.at is None and event.quantity in rest
    }
    if measured:
        rest |= measured
        x_rest, x_sigma = rest["x"]
        y_rest, y_sigma = rest["y"]
        paths.append(
            Series(
                np.array([y_rest]),
                np.array([x_rest]),
                ERROR_BARS,
                "measured resting position",
                sigma=np.array([x_sigma]),
                sigma_at=np.array([y_sigma]),
            )
        )
    left = min(float(y[0]), sheet.LINES["hog"]) - 1
    right = max(float(y[-1]), sheet.END) + 0.6
    names = {line: f"{name} line" for line, name in _NAMES.items()}
    plot_on_sheet(axes, paths, ends=(left, right), line_names=names)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=2)


def _distance(axes: Axes, moving: Mapping[str, Floats], events: Events) -> None:
    """y over time; a measured time is drawn on its line, its residual off the
    fitted crossing."""
    t = moving["t"]
    y = moving["y"]
    plot(axes, Series(t, y, LAW))
    for line, name in _NAMES.items():
        at = sheet.LINES[line]
        if at >= y[0] - 1e-6:
            axes.axhline(at, **draw.SHEET_LINE.options())
            axes.text(
                0.01,
                at,
                name,
                transform=axes.get_yaxis_transform(),
                fontsize=7,
                color=draw.QUIET,
                va="bottom",
            )
    for event in events:
        if event.quantity == "time":
            at = y[-1] if event.at is None else event.at  # no line: until rest
            crossing = float(np.interp(at, y, t))
            time = crossing + event.value - event.fitted
            plot_value(axes, at, RowValue(time, ERROR_BARS, event.sigma))
        elif event.quantity == "y":
            rest = Series(
                t[-1:],
                np.array([event.value]),
                ERROR_BARS,
                sigma=np.array([event.sigma]),
            )
            plot(axes, rest)
    axes.set(xlabel="t (s)", ylabel="along the sheet, y (m)", xlim=(0, None))


def _event_residuals(axes: Axes, events: Events) -> None:
    """Measured minus fitted, in sigmas; the number stands beside one that is drawn at
    the edge."""
    rows = []
    reach = 2.5
    for event in events:
        within = float(np.clip(event.residual, -_MOST, _MOST))
        remark = ""
        if within != event.residual:
            remark = f"{event.residual:.2g} sigma".replace("-", "\N{MINUS SIGN}")
        rows.append(Row(event.name, [RowValue(within, ERROR_BARS, 1.0)], remark=remark))
        reach = max(reach, abs(within) + 1.5)
    axes.axvline(0, **draw.SHEET_LINE.options())
    plot_rows(axes, rows)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("measured \N{MINUS SIGN} fit (sigma)")
