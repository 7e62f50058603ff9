"""Figure of a fit to timed events: the path on the sheet, and the motion between events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle

from curlfit import sheet
from curlfit.output.figures import (
    FIT_COLOR,
    QUIET,
    RINGS,
    WIDTH,
    Picture,
    heading_of,
    legend_above,
    literal,
    styled,
    title,
)
from curlfit.throws.events import Event

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from curlfit.inference.fit.result import FitResult

    Floats = NDArray[np.float64]

_LINE: dict[str, Any] = {"color": "0.6", "lw": 0.8, "zorder": 1}
_MEASURED: dict[str, Any] = {
    "color": "0.25", "fmt": "o", "markersize": 3, "capsize": 2, "lw": 1, "zorder": 5,
}  # fmt: skip
_NAMES = {"back": "back", "hog": "hog", "far-hog": "hog", "far-tee": "tee"}
_MOST = 5.0  # sigmas, largest residual shown


@styled
def event_figure(fit: FitResult) -> Figure:
    """The path on the sheet, the crossings in time, the speed, and the residuals.

    Parameters
    ----------
    name : of the throw, for the title.
    """
    figure = Picture(figsize=(WIDTH, 5.0), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.9))
    below = rows[1].subgridspec(1, 3, width_ratios=(1.3, 1.1, 0.9))
    events = [
        (Event(**{key: value for key, value in item.items() if key != "fitted"}), item["fitted"])
        for item in fit.events
    ]
    t = fit.observed["t"]
    last = int(np.argmax(fit.fitted["speed"] == 0)) or len(t) - 1
    moving = slice(0, min(last + 2, len(t)))
    on_sheet = figure.add_subplot(rows[0])
    _sheet(on_sheet, fit, events, moving)
    title(on_sheet, heading_of(fit))
    _distance(figure.add_subplot(below[0]), fit, events, t, moving)
    _speed(figure.add_subplot(below[1]), fit, events, t, moving)
    _residuals(figure.add_subplot(below[2]), events)
    return figure


def _sheet(axes: Any, fit: FitResult, events: list[tuple[Event, float]], moving: slice) -> None:
    """The path over the lines and the house, thrown to the right."""
    x, y = fit.fitted["x"][moving], fit.fitted["y"][moving]
    half = sheet.WIDTH / 2
    for radius, color in zip(sheet.CIRCLES, RINGS, strict=True):
        axes.add_patch(
            Circle((sheet.TEE, 0), radius, facecolor=color, edgecolor="0.55", lw=0.6, zorder=0.5)
        )
    for line in _NAMES:
        axes.plot([sheet.LINES[line]] * 2, [-half, half], **_LINE)
    axes.plot([sheet.TEE + sheet.TEE_TO_BACK] * 2, [-half, half], **_LINE)
    axes.axhline(0, **_LINE)
    axes.plot(y, x, color=FIT_COLOR, lw=1.4, zorder=4, label=f"{literal(fit.law)} law")
    place = {event.quantity: (event, found) for event, found in events if event.at is None}
    if "x" in place or "y" in place:
        (px, ex), (py, ey) = (
            (place[name][0].value, place[name][0].sigma) if name in place else (end, 0.0)
            for name, end in (("x", x[-1]), ("y", y[-1]))
        )
        axes.errorbar(py, px, xerr=ey, yerr=ex, **_MEASURED, label="measured resting position")
    axes.set_aspect("equal")
    axes.set_ylim(half + 0.1, -half - 0.1)
    axes.set_xlim(min(float(y[0]), sheet.LINES["hog"]) - 1, max(float(y[-1]), sheet.END) + 0.6)
    shown = [line for line in _NAMES if sheet.LINES[line] > axes.get_xlim()[0]]
    axes.set_xticks(
        [sheet.LINES[line] for line in shown], [f"{_NAMES[line]} line" for line in shown]
    )
    axes.set_yticks([-half, 0, half], ["left", "0", "right"])
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=2)


def _distance(
    axes: Any, fit: FitResult, events: list[tuple[Event, float]], t: Floats, moving: slice
) -> None:
    """y over time; a measured time is drawn on its line, its residual off the fitted crossing."""
    y = fit.fitted["y"]
    axes.plot(t[moving], y[moving], color=FIT_COLOR)
    for line, name in _NAMES.items():
        if sheet.LINES[line] >= y[0] - 1e-6:
            axes.axhline(sheet.LINES[line], **_LINE)
            axes.text(0.01, sheet.LINES[line], name, transform=axes.get_yaxis_transform(),
                      fontsize=7, color=QUIET, va="bottom")  # fmt: skip
    for event, found in events:
        if event.quantity == "time":
            end = y[moving][-1] if event.at is None else event.at  # the last row where at rest
            reached = float(np.interp(end, y[moving], t[moving]))
            axes.errorbar(reached + event.value - found, end, xerr=event.sigma, **_MEASURED)
        elif event.quantity == "y":
            axes.errorbar(t[moving][-1], event.value, yerr=event.sigma, **_MEASURED)
    axes.set(xlabel="t (s)", ylabel="along the sheet, y (m)")
    axes.set_xlim(left=0)


def _speed(
    axes: Any, fit: FitResult, events: list[tuple[Event, float]], t: Floats, moving: slice
) -> None:
    """The speed, and the mean speeds between lines from the measured times."""
    y, label = fit.fitted["y"], "measured mean between lines"
    for event, _ in events:
        if event.quantity == "time" and event.at is not None and event.since is not None:
            begin = float(np.interp(event.since, y[moving], t[moving]))
            mean = (event.at - event.since) / event.value
            axes.plot(
                [begin, begin + event.value], [mean, mean], marker="|", color=_MEASURED["color"],
                lw=1, zorder=5, label=label,
            )  # fmt: skip
            label = ""
    axes.plot(t[moving], fit.fitted["speed"][moving], color=FIT_COLOR)
    axes.set(xlabel="t (s)", ylabel="speed (m/s)")
    axes.set_ylim(bottom=0)
    axes.set_xlim(left=0)
    if not label:
        legend_above(axes)


def _residuals(axes: Any, events: list[tuple[Event, float]]) -> None:
    """Measured minus fitted, in sigmas."""
    off = [(event.value - found) / event.sigma for event, found in events]
    rows = np.arange(len(events))
    axes.axvline(0, **_LINE)
    axes.errorbar(np.clip(off, -_MOST, _MOST), rows, xerr=1.0, **_MEASURED)
    for row, value in zip(rows, off, strict=True):
        if abs(value) > _MOST:
            far = f"{value:.2g} sigma".replace("-", "\N{MINUS SIGN}")
            axes.text(0.5, row + 0.12, far, ha="center", transform=axes.get_yaxis_transform())
    axes.set_yticks(rows, [event.name for event, _ in events])
    axes.set_ylim(len(events) - 0.5, -0.5)
    reach = max(2.5, *(min(abs(value), _MOST) + 1.5 for value in off))
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("measured \N{MINUS SIGN} fit (sigma)")
