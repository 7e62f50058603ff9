"""Figures of results, made from results alone; nothing is fitted or simulated here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Patch

from curlfit.inference.corner_figure import corner_figure
from curlfit.inference.event_figures import event_figure
from curlfit.inference.fit.result import require_fit
from curlfit.output.figures import (
    CHANNEL_LABEL,
    DATA_COLOR,
    DATA_STYLE,
    FIT_COLOR,
    OUTLIER_COLOR,
    QUIET,
    WIDTH,
    ZERO_LINE,
    Picture,
    feet,
    file_name,
    heading_of,
    in_symbols,
    law_and_load,
    legend_above,
    letter,
    line_styles,
    literal,
    measured_slopes,
    note_stretch,
    panels,
    some_rows,
    styled,
    title,
)
from curlfit.output.ticks import neat_axis, unit_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult

    Floats = NDArray[np.float64]

__all__ = ["corner_figure", "fit_figure", "joint_figure"]

_IN_A_ROW = 3  # panels of residuals, at most


@styled
def fit_figure(fit: FitResult) -> Figure:
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
    rows = [channels[k : k + _IN_A_ROW] for k in range(0, len(channels), _IN_A_ROW)]
    widths = [[1.0] * len(row) for row in rows]
    figure = Picture(figsize=(WIDTH, 3.75 + 1.65 * len(rows)))
    (path,), *residuals, (speed, spin) = panels(
        figure, (1.15, *[1.0] * len(rows), 1.0), ([1.0], *widths, [1.0, 1.0]),
        right=(0.5, *[0.12] * (len(rows) + 1)),
    )  # fmt: skip
    t, found = fit.observed["t"], fit.predicted
    some = some_rows(len(t))

    unseen = [name for name in ("x", "y") if not np.isfinite(fit.observed[name]).any()]
    if unseen:
        path.text(
            0.99, 0.05, f"{' and '.join(unseen)} not measured", transform=path.transAxes,
            ha="right", color=QUIET,
        )  # fmt: skip
    else:
        path.plot(fit.observed["y"][some], fit.observed["x"][some], **DATA_STYLE, label="data")
    if fit.discrepancy:
        path.plot(found["y"], found["x"], color=FIT_COLOR, label="law and discrepancy")
    alone = {"ls": "--", "lw": 0.9} if fit.discrepancy else {}
    label = "law alone" if fit.discrepancy else f"{literal(fit.law)} law"
    path.plot(fit.fitted["y"], fit.fitted["x"], color=FIT_COLOR, label=label, **alone)
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    path.margins(x=0.02, y=0.12)
    path.invert_yaxis()  # as seen from above, thrown to the right
    feet(path, "right")
    legend_above(path)
    title(path, heading_of(fit), margin=3.4 if fit.discrepancy else 2.7)
    note_stretch(path)

    together = [axes for row in residuals for axes in row]
    for axes, channel in zip(together, channels, strict=True):
        _residuals(axes, fit, channel, found[channel], some)
    _speed(speed, fit, alone)
    _spin(spin, fit, alone)
    for axes, mark in zip((path, residuals[0][0], speed, spin), "abcd", strict=True):
        letter(axes, mark)
    return figure


def _residuals(axes: Any, fit: FitResult, channel: str, found: Floats, some: Any) -> None:
    """Residuals of a channel."""
    left = fit.observed[channel] - found
    rms = float(np.sqrt(np.nanmean(left**2))) if fit.discrepancy else fit.rms[channel]
    size, unit = unit_for(rms, channel)
    axes.axhline(0, **ZERO_LINE)
    axes.plot(fit.observed["t"][some], left[some] / size, **DATA_STYLE | {"color": "0.25"})
    _mark_outliers(axes, fit, channel, left, size)
    said = f"${CHANNEL_LABEL[channel]}$: rms {rms / size:.3g} {unit}"
    title(axes, said, columns=_IN_A_ROW, margin=0.7, loc="center")
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
    inner, off = float(np.nanquantile(np.abs(left), 0.9)) * 2.5 / size, off / size
    axes.set_ylim(-inner, inner)
    many = "1 outlier" if len(times) == 1 else f"{len(times)} outliers"
    axes.plot(
        times, np.clip(off, -0.97 * inner, 0.97 * inner), "x", color=OUTLIER_COLOR, markersize=4.5,
        mew=0.9, clip_on=False, label=many,
    )  # fmt: skip
    axes.legend(loc="upper left", handletextpad=0.1, borderpad=0.1, frameon=True, framealpha=0.8,
                edgecolor="none")  # fmt: skip


def _speed(axes: Any, fit: FitResult, alone: dict[str, Any]) -> None:
    t, seen = fit.observed["t"], fit.observed
    if "speed" in seen:
        axes.plot(t, seen["speed"], **DATA_STYLE)
    elif np.isfinite(seen["x"]).any() and np.isfinite(seen["y"]).any():
        at, (across, along), over = measured_slopes(t, seen["x"], seen["y"])
        _slopes(axes, at, np.hypot(across, along), over)
    _curves(axes, fit, "speed", alone)
    axes.set(xlabel="t (s)", ylabel="speed (m/s)")
    axes.set_ylim(bottom=0)


def _spin(axes: Any, fit: FitResult, alone: dict[str, Any]) -> None:
    t, seen = fit.observed["t"], fit.observed
    if "omega" in seen:
        axes.plot(t, seen["omega"], **DATA_STYLE)
    elif np.isfinite(seen["phi"]).any():
        at, (turning,), over = measured_slopes(t, seen["phi"])
        _slopes(axes, at, turning, over)
    _curves(axes, fit, "omega", alone)
    axes.set(xlabel="t (s)", ylabel=r"spin $\omega$ (rad/s)")
    _include_zero(axes, fit.fitted["omega"])
    if fit.parameters["omega0"].verdict == "not identifiable":
        axes.set_title("not identifiable", loc="right", color=QUIET)


def _curves(axes: Any, fit: FitResult, channel: str, alone: dict[str, Any]) -> None:
    if fit.discrepancy:
        axes.plot(fit.observed["t"], fit.predicted[channel], color=FIT_COLOR)
    axes.plot(fit.observed["t"], fit.fitted[channel], color=FIT_COLOR, **alone)


def _slopes(axes: Any, at: Floats, rates: Floats, over: float) -> None:
    if len(at):
        axes.plot(at, rates, **DATA_STYLE, label=f"slopes of the data over {over:.2g} s")
        legend_above(axes)


def _include_zero(axes: Any, values: Any) -> None:
    low, high = float(np.min(values)), float(np.max(values))
    if low >= 0:
        axes.set_ylim(bottom=0)
    elif high <= 0:
        axes.set_ylim(top=0)


@styled
def joint_figure(result: JointResult) -> Figure:
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
    figure = Picture(figsize=(WIDTH, height), layout="constrained")
    ratios = (1.0, 0.35 + 0.065 * count) if paths else (1.0,)
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    styles = line_styles(count) if paths else [{"color": FIT_COLOR}] * count
    heading = f"{law_and_load(result)}: {count} throws together"
    handles = []
    if paths:
        path = figure.add_subplot(rows[0])
        for one, style in zip(result.throws, styles, strict=True):
            some, found = some_rows(len(one.observed["t"]), 400), one.predicted
            path.plot(
                one.observed["y"][some], one.observed["x"][some],
                **DATA_STYLE | {"color": style["color"]},
            )  # fmt: skip
            path.plot(found["y"], found["x"], **style, lw=1, label=file_name(one.data["file"]))
        path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
        path.invert_yaxis()
        feet(path, "right")
        title(path, heading)
        handles = path.get_legend_handles_labels()[0]
    else:
        figure.suptitle(heading)
    if shown:
        label = "mean, with its standard error"
        handles.append(Patch(color=DATA_COLOR, alpha=0.35, lw=0, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns + 1)
    panels = rows[-1].subgridspec(1, len(shown), wspace=0.05) if shown else None
    symbols = {
        name: item.symbol for name, item in result.throws[0].parameters.items()
    }  # fmt: skip
    estimates: list[tuple[Any, str]] = []
    for place, item in enumerate(shown):
        assert panels is not None
        axes = figure.add_subplot(panels[place])
        axes.axvspan(
            item.mean - item.stderr, item.mean + item.stderr, color=DATA_COLOR, alpha=0.25, lw=0
        )
        for row, (alone, style) in enumerate(zip(item.each, styles, strict=True)):
            if alone is not None:
                axes.errorbar(
                    alone[0], row, xerr=alone[1], fmt="o", color=style["color"], markersize=3, lw=1
                )
        axes.set_yticks(
            range(count),
            [file_name(one.data["file"]) for one in result.throws] if not place
            else [""] * count,
        )  # fmt: skip
        axes.set_ylim(count - 0.4, -0.6)
        differs = "differs" if item.significant else "no significant difference"
        title(axes, f"{differs}, {item.p_text}", columns=len(shown), margin=0.25)
        estimates.append((axes, in_symbols(item.expression, symbols)))
    figure.draw_without_rendering()  # ticks and the note depend on the layout
    for axes, expression in estimates:
        neat_axis(axes.xaxis, expression)
    if paths:
        note_stretch(path)
    return figure
