"""Figures of results, made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import Patch

from curlfit.inference.corner_figure import corner_figure
from curlfit.inference.event_figures import event_figure
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.joint.result import Difference, JointResult
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.ticks import neat_axis, unit_for

__all__ = ["corner_figure", "fit_figure", "joint_figure"]

_IN_A_ROW = 3  # panels of residuals, at most
_PANEL, _GAP = 3.32 / 3.15, 0.68  # heights of a panel and of what is below it, inches


@draw.style()
def fit_figure(fit: FitResult) -> draw.Picture:
    """The path with its fit, the residuals of each channel, speed and spin; or timed events.

    With a model discrepancy, solid curves show law and discrepancy together, dashed curves the law
    alone, and the residuals are those of both together.

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
        residuals += draw.row(figure, top, _PANEL, min(len(channels) - first, _IN_A_ROW))
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
    if fit.parameters["omega0"].verdict == "not identifiable":
        spin.set_title("not identifiable", loc="right", color=draw.QUIET)
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
    curves: list[tuple[str, Any, Any]] = [(f"{draw.literal(fit.law)} law", fit.fitted, {})]
    if fit.discrepancy:
        dashed = {"ls": "--", "lw": 0.9}
        curves = [("law and discrepancy", fit.predicted, {}), ("law alone", fit.fitted, dashed)]
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


def _mark_outliers(axes: Any, fit: FitResult, channel: str, left: Floats, size: float) -> None:
    """Mark outliers; distant ones are drawn at the edge so that the rest stays readable."""
    mine = [item for item in fit.outliers if item["channel"] == channel]
    if not mine:
        return
    times, off = (np.array([item[key] for item in mine]) for key in ("t", "off"))
    if fit.discrepancy:
        off = off - np.interp(times, fit.observed["t"], fit.discrepancy[channel])
    edge = float(np.nanquantile(np.abs(left), 0.9)) * 2.5 / size
    axes.set_ylim(-edge, edge)
    axes.plot(
        times, np.clip(off / size, -0.97 * edge, 0.97 * edge), "x", color="black", markersize=4.5,
        mew=0.9, clip_on=False, label=f"{len(mine)} outlier{'s' * (len(mine) > 1)}",
    )  # fmt: skip
    axes.legend(loc="upper left", handletextpad=0.1, borderpad=0.1, frameon=True, framealpha=0.8,
                edgecolor="none")  # fmt: skip


@draw.style()
def joint_figure(result: JointResult) -> draw.Picture:
    """All throws with their fits, and the shared coefficients as each throw alone gives them.

    Examples
    --------
    >>> curlfit.joint_figure(joint).savefig("joint.png")
    """
    count, shown = len(result.throws), result.differences
    columns = min(count, 3)
    paths = any(one.rms for one in result.throws)  # timed events have no measured path
    names_below = 0.17 * -(-count // columns + 1) if paths else 0.2
    height = (2.9 if paths else 0.2) + 0.8 + 0.2 * count + names_below
    figure = draw.Picture(figsize=(draw.WIDTH, height), layout="constrained")
    ratios = (1.0, 0.35 + 0.065 * count) if paths else (1.0,)
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    styles = draw.line_styles(count) if paths else [{"color": draw.FIT_COLOR}] * count
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
        label = "mean, with its standard error"
        handles.append(Patch(color=draw.DATA_COLOR, alpha=0.35, lw=0, label=label))
        grid = rows[-1].subgridspec(1, len(shown), wspace=0.05)
        panels = grid.subplots(sharey=True, squeeze=False)[0]
        panels[0].set_yticks(
            range(count), [draw.file_name(one.data["file"]) for one in result.throws]
        )
        panels[0].set_ylim(count - 0.4, -0.6)
    figure.legend(handles=handles, loc="outside lower center", ncols=columns + 1)
    for axes, item in zip(panels, shown, strict=True):
        _estimates(axes, item, styles)
        differs = "differs" if item.significant else "no significant difference"
        draw.title(axes, f"{differs}, {item.p_text}", columns=len(shown), margin=0.25)
    figure.draw_without_rendering()  # ticks and the note depend on the layout
    symbols = {name: item.symbol for name, item in result.throws[0].parameters.items()}
    for axes, item in zip(panels, shown, strict=True):
        neat_axis(axes.xaxis, draw.in_symbols(item.expression, symbols))
    if paths:
        draw.note_stretch(path)
    return figure


def _paths(axes: Any, result: JointResult, styles: list[dict[str, Any]]) -> None:
    for one, style in zip(result.throws, styles, strict=True):
        some, seen, found = draw.some_rows(len(one.observed["t"]), 400), one.observed, one.predicted
        axes.plot(seen["y"][some], seen["x"][some], **draw.DATA_STYLE | {"color": style["color"]})
        axes.plot(found["y"], found["x"], **style, lw=1, label=draw.file_name(one.data["file"]))
    draw.x_along_y(axes)


def _estimates(axes: Any, item: Difference, styles: list[dict[str, Any]]) -> None:
    """Estimates of each throw alone, by row, and their mean."""
    ends = item.mean - item.stderr, item.mean + item.stderr
    axes.axvspan(*ends, color=draw.DATA_COLOR, alpha=0.25, lw=0)
    for row, (alone, style) in enumerate(zip(item.each, styles, strict=True)):
        if alone is not None:
            value, stderr = alone
            axes.errorbar(
                value, row, xerr=stderr, fmt="o", color=style["color"], markersize=3, lw=1
            )
