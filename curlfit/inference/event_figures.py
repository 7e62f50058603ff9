"""Figure of a fit to timed events: the path on the sheet, and the motion between events."""

from __future__ import annotations

from typing import Any

import numpy as np

from curlfit import sheet
from curlfit.inference.fit.result import FitResult
from curlfit.output import figures as draw
from curlfit.throws.events import Event

Events = list[tuple[Event, float]]  # each with its fitted value

_LINE = draw.LINE | {"lw": 0.8}
_MEASURED: dict[str, Any] = {
    "color": "0.25", "fmt": "o", "markersize": 3, "capsize": 2, "lw": 1, "zorder": 5,
}  # fmt: skip
_NAMES = {"back": "back", "hog": "hog", "far-hog": "hog", "far-tee": "tee"}
_MOST = 5.0  # sigmas, largest residual shown


@draw.style()
def event_figure(fit: FitResult) -> draw.Picture:
    """The path on the sheet, the crossings in time, the speed, and the residuals."""
    figure = draw.Picture(figsize=(draw.WIDTH, 5.0), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 1.9))
    on_sheet = figure.add_subplot(rows[0])
    panels: Any = rows[1].subgridspec(1, 3, width_ratios=(1.3, 1.1, 0.9)).subplots()
    events = [
        (Event(**{key: value for key, value in item.items() if key != "fitted"}), item["fitted"])
        for item in fit.events
    ]
    t = fit.observed["t"]
    last = int(np.argmax(fit.fitted["speed"] == 0)) or len(t) - 1
    moving = {name: series[: last + 2] for name, series in {**fit.fitted, "t": t}.items()}
    _sheet(on_sheet, moving, events, f"{draw.literal(fit.law)} law")
    draw.title(on_sheet, draw.heading_of(fit))
    _distance(panels[0], moving, events)
    _speed(panels[1], moving, events)
    _residuals(panels[2], events)
    return figure


def _sheet(axes: Any, moving: dict[str, Any], events: Events, law: str) -> None:
    """The path over the lines and the house, thrown to the right."""
    x, y = moving["x"], moving["y"]
    draw.plot_house(axes, (sheet.TEE, 0))
    axes.axhline(0, **_LINE)
    axes.plot(y, x, color=draw.FIT_COLOR, lw=1.4, zorder=4, label=law)
    rests = {event.quantity: (event.value, event.sigma) for event, _ in events if event.at is None}
    if "x" in rests or "y" in rests:
        (px, ex), (py, ey) = (rests.get("x", (x[-1], 0.0)), rests.get("y", (y[-1], 0.0)))
        axes.errorbar(py, px, xerr=ey, yerr=ex, **_MEASURED, label="measured resting position")
    axes.set_xlim(min(float(y[0]), sheet.LINES["hog"]) - 1, max(float(y[-1]), sheet.END) + 0.6)
    names = {line: f"{name} line" for line, name in _NAMES.items()}
    draw.sheet_axes(axes, names, sheet.WIDTH / 2, lw=0.8)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.08), ncols=2)


def _distance(axes: Any, moving: dict[str, Any], events: Events) -> None:
    """y over time; a measured time is drawn on its line, its residual off the fitted crossing."""
    t, y = moving["t"], moving["y"]
    axes.plot(t, y, color=draw.FIT_COLOR)
    for line, name in _NAMES.items():
        if sheet.LINES[line] >= y[0] - 1e-6:
            axes.axhline(sheet.LINES[line], **_LINE)
            axes.text(0.01, sheet.LINES[line], name, transform=axes.get_yaxis_transform(),
                      fontsize=7, color=draw.QUIET, va="bottom")  # fmt: skip
    for event, found in events:
        if event.quantity == "time":
            end = y[-1] if event.at is None else event.at  # the last row where at rest
            reached = float(np.interp(end, y, t))
            axes.errorbar(reached + event.value - found, end, xerr=event.sigma, **_MEASURED)
        elif event.quantity == "y":
            axes.errorbar(t[-1], event.value, yerr=event.sigma, **_MEASURED)
    axes.set(xlabel="t (s)", ylabel="along the sheet, y (m)", xlim=(0, None))


def _speed(axes: Any, moving: dict[str, Any], events: Events) -> None:
    """The speed, and the mean speeds between lines from the measured times."""
    label = "measured mean between lines"
    for event, _ in events:
        if event.quantity == "time" and event.at is not None and event.since is not None:
            begin = float(np.interp(event.since, moving["y"], moving["t"]))
            mean = (event.at - event.since) / event.value
            axes.plot(
                [begin, begin + event.value], [mean, mean], marker="|", color=_MEASURED["color"],
                lw=1, zorder=5, label=label,
            )  # fmt: skip
            label = ""
    axes.plot(moving["t"], moving["speed"], color=draw.FIT_COLOR)
    axes.set(xlabel="t (s)", ylabel="speed (m/s)", xlim=(0, None), ylim=(0, None))
    draw.legend_above(axes)


def _residuals(axes: Any, events: Events) -> None:
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
    reach = max(2.5, *(min(abs(value), _MOST) + 1.5 for value in off))
    axes.set(xlim=(-reach, reach), ylim=(len(events) - 0.5, -0.5))
    axes.set_xlabel("measured \N{MINUS SIGN} fit (sigma)")
