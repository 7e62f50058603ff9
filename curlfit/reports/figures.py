"""Figures of results, made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from curlfit import sheet
from curlfit.foreign import counted
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.joint.result import JointResult, Variation
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.ticks import neat_axis, unit_for
from curlfit.throws.events import Event

_IN_A_ROW = 3  # panels of residuals, at most
_PANEL, _GAP = 3.32 / 3.15, 0.68  # heights of a panel and of what is below it, inches


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
    rows = -(-len(channels) // _IN_A_ROW)
    tops = 0.3 + 1.15 * _PANEL + _GAP + (_PANEL + _GAP) * np.arange(rows + 1)
    figure = draw.Picture(figsize=(draw.WIDTH, tops[-1] + _PANEL + 0.42))
    (path,) = draw.row(figure, 0.3, 1.15 * _PANEL, right=0.5)
    residuals: list[Any] = []
    for top, first in zip(tops, range(0, len(channels), _IN_A_ROW), strict=False):
        residuals += draw.row(
            figure, top, _PANEL, min(len(channels) - first, _IN_A_ROW)
        )
    speed, spin = draw.row(figure, tops[-1], _PANEL, 2)
    _path(path, fit)
    for axes, channel in zip(residuals, channels, strict=True):
        _residuals(axes, fit, channel)
    for axes, channel in ((speed, "speed"), (spin, "omega")):
        draw.plot_rate(axes, fit.observed, channel)
        draw.legend_above(axes)
        _plot_law(axes, fit, "t", channel)
        low, high = np.min(fit.fitted[channel]), np.max(fit.fitted[channel])
        axes.set_ylim(0 if low >= 0 else None, 0 if high <= 0 <= -low else None)
    draw.letters((path, residuals[0], speed, spin))
    return figure


def _path(axes: Any, fit: FitResult) -> None:
    seen, some = fit.observed, draw.some_rows(len(fit.observed["t"]))
    unseen = [name for name in ("x", "y") if not np.isfinite(seen[name]).any()]
    if unseen:
        draw.note(axes, 0.99, 0.05, f"{' and '.join(unseen)} not measured")
    else:
        axes.plot(seen["y"][some], seen["x"][some], **draw.DATA_STYLE, label="data")
    _plot_law(axes, fit, "y", "x")
    axes.margins(x=0.02, y=0.12)
    draw.x_along_y(axes)
    draw.legend_above(axes)
    draw.title(axes, draw.heading_of(fit), margin=3.4 if fit.discrepancy else 2.7)
    draw.note_stretch(axes)


def _plot_law(axes: Any, fit: FitResult, across: str, up: str) -> None:
    """Plot the law, or it with the discrepancy, and the law alone dashed."""
    curves: list[tuple[str, Any, Any]] = [
        (f"{draw.literal(fit.law)} law", fit.fitted, {})
    ]
    if fit.discrepancy:
        dashed = {"ls": "--", "lw": 0.9}
        curves = [
            ("law and discrepancy", fit.predicted, {}),
            ("law alone", fit.fitted, dashed),
        ]
    for label, series, style in curves:
        along = fit.observed["t"] if across == "t" else series[across]
        said = None if across == "t" else label
        axes.plot(along, series[up], color=draw.FIT_COLOR, label=said, **style)


def _residuals(axes: Any, fit: FitResult, channel: str) -> None:
    """Residuals of a channel."""
    t, left = fit.observed["t"], fit.observed[channel] - fit.predicted[channel]
    some = draw.some_rows(len(t))
    rms = float(np.sqrt(np.nanmean(left**2))) if fit.discrepancy else fit.rms[channel]
    size, unit = unit_for(rms, channel)
    axes.axhline(0, **draw.ZERO_LINE)
    axes.plot(t[some], left[some] / size, **draw.DATA_STYLE | {"color": "0.25"})
    _mark_outliers(axes, fit, channel, left, size)
    said = f"${draw.CHANNEL_LABEL[channel]}$: rms {rms / size:.3g} {unit}"
    draw.title(axes, said, columns=_IN_A_ROW, margin=0.7, loc="center")
    of = " of both" if fit.discrepancy else ""
    axes.set(xlabel="t (s)", ylabel=f"residual{of} ({unit})")


def _mark_outliers(
    axes: Any, fit: FitResult, channel: str, left: Floats, size: float
) -> None:
    """Mark outliers; distant ones are drawn at the edge so that the rest
    stays readable."""
    mine = [item for item in fit.outliers if item["channel"] == channel]
    if not mine:
        return
    times, off = (np.array([item[key] for item in mine]) for key in ("t", "off"))
    if fit.discrepancy:
        off = off - np.interp(times, fit.observed["t"], fit.discrepancy[channel])
    edge = float(np.nanquantile(np.abs(left), 0.9)) * 2.5 / size
    axes.set_ylim(-edge, edge)
    axes.plot(
        times,
        np.clip(off / size, -0.97 * edge, 0.97 * edge),
        "x",
        color="black",
        markersize=4.5,
        mew=0.9,
        clip_on=False,
        label=counted(len(mine), "outlier"),
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
    count, shown = len(result.throws), result.variation
    # events have no path
    columns, paths = min(count, 3), any(one.rms for one in result.throws)
    names_below = 0.17 * (-(-count // columns) - 1) if paths else 0.2
    height = (2.9 if paths else 0.2) + 0.8 + 0.2 * count + names_below
    figure = draw.Picture(figsize=(draw.WIDTH, height), layout="constrained")
    ratios = (1.0, 0.35 + 0.065 * count) if paths else (1.0,)
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    of_throws = [_group(result, one) for one in result.throws]
    groups = {
        name: draw.PALETTE[row % len(draw.PALETTE)]
        for row, name in enumerate(dict.fromkeys(of_throws))
    }
    styles: list[dict[str, Any]] = [{"color": groups[name]} for name in of_throws]
    if paths and len(groups) == 1:
        styles = draw.line_styles(count)
    heading = f"{draw.law_and_load(result)}: {count} throws together"
    handles = []
    if paths:
        path = figure.add_subplot(rows[0])
        _paths(path, result, styles)
        draw.title(path, heading)
        handles = path.get_legend_handles_labels()[0]
    else:
        figure.suptitle(heading)
    panels: Any = []
    if shown:
        panels = (
            rows[-1]
            .subgridspec(1, len(shown), wspace=0.05)
            .subplots(sharey=True, squeeze=False)[0]
        )
        panels[0].set_yticks(
            range(count), [draw.file_name(one.data["file"]) for one in result.throws]
        )
        panels[0].set_ylim(count - 0.4, -0.6)
        handles += _handles(result, groups)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns + 1)
    for axes, item in zip(panels, shown, strict=True):
        _estimates(axes, result, item, styles)
        differs = "differs" if item.significant else "no significant difference"
        beside = " beside groups" if result.differences else ""
        draw.title(
            axes, f"{differs}{beside}, {item.p_text}", columns=len(shown), margin=0.25
        )
    _label(figure, panels, result, result.throws[0].parameters)
    if paths:
        draw.note_stretch(path)
    return figure


def _handles(result: JointResult, groups: Mapping[str, str]) -> list[Any]:
    """What the estimates in a joint figure are."""
    label = "expected of the throw" if result.means else "mean, with its standard error"
    found: list[Any] = [Patch(color=draw.DATA_COLOR, alpha=0.35, lw=0, label=label)]
    if result.means:
        found.append(Line2D([], [], color="k", marker="o", ms=3, label="alone"))
        found.append(
            Line2D([], [], color="k", ls="", label="with all throws", **_POOLED)
        )
    if len(groups) > 1:
        found += [Patch(color=color, label=name) for name, color in groups.items()]
    return found


def _label(
    figure: draw.Picture,
    panels: Any,
    result: JointResult,
    named: Mapping[str, Estimate],
) -> None:
    """Label the horizontal axes of the panels, one of each coefficient
    or combination."""
    figure.draw_without_rendering()  # ticks depend on the layout
    symbols = {name: item.symbol for name, item in named.items()}
    for axes, item in zip(panels, result.variation, strict=True):
        neat_axis(axes.xaxis, draw.in_symbols(item.expression, symbols))


def _season(result: JointResult) -> draw.Picture:
    """The means of groups, and how many throws are where."""
    figure = draw.Picture(figsize=(draw.WIDTH, 2.6), layout="constrained")
    figure.suptitle(f"{draw.law_and_load(result)}: {result.count} throws")
    panels: Any = figure.subplots(1, len(result.variation), squeeze=False)[0]
    means = [one for one in result.groups if one.by or not result.differences]
    labelled: dict[str, Any] = {}
    for axes, item in zip(panels, result.variation, strict=True):
        alone = np.array([one[0] for one in item.each if one is not None])
        ends = np.quantile(alone, (0.01, 0.99))
        beyond = 0.2 * np.ptp(ends)
        bins = np.linspace(
            ends[0] - beyond, ends[1] + beyond, min(40, 8 + len(alone) // 20)
        )
        axes.hist(
            alone, bins, color=draw.DATA_COLOR, alpha=0.35, label="throws, each alone"
        )
        top = axes.get_ylim()[1]
        of_item = [one for one in means if one.parameter == item.expression]
        for row, one in enumerate(of_item):
            axes.errorbar(
                one.value,
                top * (1.06 + 0.1 * row),
                xerr=one.stderr,
                fmt="o",
                ms=4,
                capsize=2,
                label=f"{one.by} {one.group}".strip() or "mean",
                color=draw.PALETTE[row % len(draw.PALETTE)],
            )
        axes.set(ylim=(0, top * (1.12 + 0.1 * len(of_item))), yticks=[])
        handles, labels = axes.get_legend_handles_labels()
        # what does not vary has no groups
        labelled |= dict(zip(labels, handles, strict=True))
    figure.legend(
        labelled.values(), labelled.keys(), loc="outside lower center", ncols=4
    )
    _label(figure, panels, result, result.coefficients)
    return figure


def _paths(axes: Any, result: JointResult, styles: list[dict[str, Any]]) -> None:
    for one, style in zip(result.throws, styles, strict=True):
        some, seen, found = (
            draw.some_rows(len(one.observed["t"]), 400),
            one.observed,
            one.predicted,
        )
        axes.plot(
            seen["y"][some],
            seen["x"][some],
            **draw.DATA_STYLE | {"color": style["color"]},
        )
        axes.plot(
            found["y"],
            found["x"],
            **style,
            lw=1,
            label=draw.file_name(one.data["file"]),
        )
    draw.x_along_y(axes)


def _group(result: JointResult, throw: FitResult) -> str:
    """The group of a throw by the first label of the fit; empty without groups."""
    by = next(iter(result.means.groups), None) if result.means else None
    return "" if by is None else f"{by} {throw.data['labels'].get(by, '')}"


def _estimates(
    axes: Any, result: JointResult, item: Variation, styles: list[dict[str, Any]]
) -> None:
    """Estimates of each throw alone, by row, and their mean or, where throws vary, what
    is expected of each and its estimate from all throws."""
    weights = next(
        (
            one.weights
            for one in result.combinations
            if one.expression == item.expression
        ),
        {item.expression: 1.0},
    )
    if result.means is None:
        ends = item.mean - item.stderr, item.mean + item.stderr
        axes.axvspan(*ends, color=draw.DATA_COLOR, alpha=0.25, lw=0)
    for row, (alone, style, one) in enumerate(
        zip(item.each, styles, result.throws, strict=True)
    ):
        color = style["color"]
        if result.means is not None:
            mean, sd = result.means.expected(weights, one.data["labels"])
            axes.barh(
                row, 2 * sd, left=mean - sd, height=0.9, color=color, alpha=0.25, lw=0
            )
            pooled = sum(
                by * one.parameters[name].value for name, by in weights.items()
            )
            axes.plot(pooled, row, color=color, zorder=3, **_POOLED)
        if alone is not None:
            value, stderr = alone
            axes.errorbar(
                value, row, xerr=stderr, fmt="o", color=color, markersize=3, lw=1
            )


Events = list[tuple[Event, float]]  # each with its fitted value

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


@draw.style()
def event_figure(fit: FitResult) -> draw.Picture:
    """The path on the sheet, the crossings in time, and the residuals."""
    figure = draw.Picture(figsize=(draw.WIDTH, 5.0), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.9))
    on_sheet = figure.add_subplot(rows[0])
    panels: Any = rows[1].subgridspec(1, 2, width_ratios=(1.3, 0.9)).subplots()
    events = fit.timed
    t = fit.observed["t"]
    last = int(np.argmax(fit.fitted["speed"] == 0)) or len(t) - 1
    moving = {
        name: series[: last + 2] for name, series in {**fit.fitted, "t": t}.items()
    }
    _sheet(on_sheet, moving, events, f"{draw.literal(fit.law)} law")
    draw.title(on_sheet, draw.heading_of(fit))
    _distance(panels[0], moving, events)
    _event_residuals(panels[1], events)
    return figure


def _sheet(axes: Any, moving: dict[str, Any], events: Events, law: str) -> None:
    """The path over the lines and the house, thrown to the right."""
    x, y = moving["x"], moving["y"]
    draw.plot_house(axes, (sheet.TEE, 0))
    axes.axhline(0, **_LINE)
    axes.plot(y, x, color=draw.FIT_COLOR, lw=1.4, zorder=4, label=law)
    rests = {
        event.quantity: (event.value, event.sigma)
        for event, _ in events
        if event.at is None
    }
    if "x" in rests or "y" in rests:
        (px, ex), (py, ey) = (
            rests.get("x", (x[-1], 0.0)),
            rests.get("y", (y[-1], 0.0)),
        )
        axes.errorbar(
            py, px, xerr=ey, yerr=ex, **_MEASURED, label="measured resting position"
        )
    axes.set_xlim(
        min(float(y[0]), sheet.LINES["hog"]) - 1, max(float(y[-1]), sheet.END) + 0.6
    )
    names = {line: f"{name} line" for line, name in _NAMES.items()}
    draw.sheet_axes(axes, names, sheet.WIDTH / 2, lw=0.8)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=2)


def _distance(axes: Any, moving: dict[str, Any], events: Events) -> None:
    """y over time; a measured time is drawn on its line, its residual off the
    fitted crossing."""
    t, y = moving["t"], moving["y"]
    axes.plot(t, y, color=draw.FIT_COLOR)
    for line, name in _NAMES.items():
        if sheet.LINES[line] >= y[0] - 1e-6:
            axes.axhline(sheet.LINES[line], **_LINE)
            axes.text(
                0.01,
                sheet.LINES[line],
                name,
                transform=axes.get_yaxis_transform(),
                fontsize=7,
                color=draw.QUIET,
                va="bottom",
            )
    for event, found in events:
        if event.quantity == "time":
            end = y[-1] if event.at is None else event.at  # the last row where at rest
            reached = float(np.interp(end, y, t))
            axes.errorbar(
                reached + event.value - found, end, xerr=event.sigma, **_MEASURED
            )
        elif event.quantity == "y":
            axes.errorbar(t[-1], event.value, yerr=event.sigma, **_MEASURED)
    axes.set(xlabel="t (s)", ylabel="along the sheet, y (m)", xlim=(0, None))


def _event_residuals(axes: Any, events: Events) -> None:
    """Measured minus fitted, in sigmas."""
    off = [(event.value - found) / event.sigma for event, found in events]
    rows = np.arange(len(events))
    axes.axvline(0, **_LINE)
    axes.errorbar(np.clip(off, -_MOST, _MOST), rows, xerr=1.0, **_MEASURED)
    for row, value in zip(rows, off, strict=True):
        if abs(value) > _MOST:
            far = f"{value:.2g} sigma".replace("-", "\N{MINUS SIGN}")
            axes.text(
                0.5, row + 0.12, far, ha="center", transform=axes.get_yaxis_transform()
            )
    axes.set_yticks(rows, [event.name for event, _ in events])
    reach = max(2.5, *(min(abs(value), _MOST) + 1.5 for value in off))
    axes.set(xlim=(-reach, reach), ylim=(len(events) - 0.5, -0.5))
    axes.set_xlabel("measured \N{MINUS SIGN} fit (sigma)")
