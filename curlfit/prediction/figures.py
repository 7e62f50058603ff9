"""Figure of a prediction: sheet and house to scale, ellipses from the intervals of the table."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle, Ellipse, Rectangle

from curlfit import sheet
from curlfit.output.figures import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.prediction.result import Prediction

_PATH = "#1b2a49"
_BAND = "#7b5ea7"
_AIM = "#e07a1f"
_MEASURED = "#2e8b57"
_RINGS = ("#9fc3df", "#ffffff", "#e3a09b", "#ffffff")
_LINE: dict[str, Any] = {"color": "0.55", "lw": 0.8, "zorder": 1}
_UNITS = {"x": (100.0, "cm"), "y": (100.0, "cm"), "phi": (1000.0, "mrad")}
_REST = ("rest_x", "rest_y")
_LETTERS = {"x": "x", "y": "y", "phi": r"\varphi"}


def prediction_figure(prediction: Prediction) -> Figure:
    """The path on the sheet, the resting place in the house, the bands, and measured rows.

    Examples
    --------
    >>> curlfit.prediction_figure(prediction).savefig("predict.png")
    """
    checked = prediction.check is not None
    figure = Picture(figsize=(11, 8.8 if checked else 6.6), layout="constrained")
    rows = figure.add_gridspec(3 if checked else 2, 1, height_ratios=(1, 2.7, 1.4)[: 2 + checked])
    top = figure.add_subplot(rows[0])
    lower = rows[1].subgridspec(1, 2, width_ratios=(1.0, 1.25))
    _sheet_view(prediction, top)
    _resting_place(prediction, figure.add_subplot(lower[0]))
    right = lower[1].subgridspec(2, 1)
    _cross_track(prediction, figure.add_subplot(right[0]))
    _speed(prediction, figure.add_subplot(right[1]))
    if prediction.check is not None:
        panels = rows[2].subgridspec(1, len(prediction.check.channels))
        for index, name in enumerate(prediction.check.channels):
            _residuals(prediction, figure.add_subplot(panels[index]), name)
    name = FilePath(prediction.fit["file"]).name
    top.set_title(
        f"{prediction.law} law fitted to {name}, "
        + ("extrapolated to rest" if prediction.of == "fitted" else "another throw on this ice"),
        fontsize=10, loc="left",
    )  # fmt: skip
    return figure


def _sheet_view(prediction: Prediction, axes: Any) -> None:
    """The sheet from above, throws to the right, so that right of the centre line is below."""
    length, half = sheet.TEE + sheet.LINES["tee"], sheet.WIDTH / 2
    axes.add_patch(
        Rectangle(
            (0, -half), length, 2 * half, facecolor="#f6fafc", edgecolor="0.55", lw=0.8, zorder=0
        )
    )
    for tee in (sheet.LINES["tee"], sheet.TEE):
        _house(axes, (tee, 0.0))
    for name, y in sheet.LINES.items():
        if name not in ("hack", "centre"):
            axes.plot([y, y], [-half, half], **_LINE)
    axes.plot([sheet.END - sheet.STONE_RADIUS] * 2, [-half, half], **_LINE)
    axes.plot([0, length], [0, 0], **_LINE)
    band, series = prediction.band, prediction.series
    for low, high, alpha in (("x_2.5", "x_97.5", 0.25), ("x_16", "x_84", 0.45)):
        axes.fill_between(
            band["y"], band[low], band[high], color=_BAND, alpha=alpha, lw=0, zorder=3
        )
    for rows, color, _ in _measured_rows(prediction):
        axes.plot(rows["y"], rows["x"], ".", color=color, markersize=3, zorder=3.5)
    axes.plot(series["y"], series["x"], color=_PATH, lw=1.2, zorder=4)
    _stone(axes, (series["y"][0], series["x"][0]), hollow=True)
    _stone(axes, (series["y"][-1], series["x"][-1]))
    axes.set_aspect("equal")
    axes.set_xlim(min(float(series["y"][0]), 0.0) - 0.5, max(float(series["y"][-1]), length) + 0.5)
    beyond = max(half, float(np.abs(series["x"]).max()) + 0.3)
    axes.set_ylim(beyond + 0.1, -beyond - 0.1)
    names = {"hog": "hog line", "far-hog": "hog line", "tee": "tee", "far-tee": "tee"}
    axes.set_xticks([sheet.LINES[name] for name in names], list(names.values()), fontsize=8)
    axes.set_yticks([-half, 0, half], ["left", "0", "right"], fontsize=8)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _house(axes: Any, centre: tuple[float, float]) -> None:
    for radius, color in zip(sheet.CIRCLES, _RINGS, strict=True):
        axes.add_patch(
            Circle(centre, radius, facecolor=color, edgecolor="0.55", lw=0.6, zorder=0.5)
        )


def _stone(axes: Any, position: tuple[float, float], hollow: bool = False) -> None:
    axes.add_patch(
        Circle(
            position, sheet.STONE_RADIUS, facecolor="none" if hollow else "0.35", edgecolor=_PATH,
            lw=0.9, zorder=6,
        )
    )  # fmt: skip


def _resting_place(prediction: Prediction, axes: Any) -> None:
    """The resting place, seen along the throw, in m from the tee."""
    series, half = prediction.series, sheet.WIDTH / 2
    x, y = series["x"][-1], series["y"][-1] - sheet.TEE
    centre, size = _interval(prediction, "2.5", "97.5")
    reach = np.abs(centre - (x, y)) + 1.1 * size + 0.3
    _house(axes, (0.0, 0.0))
    axes.axvline(0, **_LINE)
    for level in (0.0, -sheet.TEE_TO_HOG, sheet.TEE_TO_BACK):
        axes.plot([-half, half], [level, level], **_LINE)
    axes.plot(series["x"], series["y"] - sheet.TEE, color=_PATH, lw=1.2, zorder=4)
    band = prediction.band
    axes.fill_betweenx(
        band["y"] - sheet.TEE,
        band["x_2.5"],
        band["x_97.5"],
        color=_BAND,
        alpha=0.15,
        lw=0,
        zorder=2,
    )
    rest = prediction.rest
    both = np.array(rest.get("both", np.add(rest["parameter"], rest["model"])))
    for first, last, alpha in (("2.5", "97.5", 0.3), ("16", "84", 0.5)):
        _ellipse(
            axes,
            *_interval(prediction, first, last),
            both,
            color=_BAND,
            alpha=alpha,
            lw=0,
            zorder=3,
        )
    own = 1.96 * np.array([prediction.quantities[name].parameter_sd for name in _REST])
    _ellipse(
        axes, np.array([x, y]), own, np.array(rest["parameter"]),
        facecolor="none", edgecolor=_PATH, lw=1, zorder=5,
    )  # fmt: skip
    _stone(axes, (x, y), hollow=True)
    if prediction.goal is not None:
        target = prediction.goal["x"] or 0.0, prediction.goal["y"]
        axes.plot(*target, "+", color=_AIM, markersize=13, mew=2, zorder=7)
    for rows, color, _ in _measured_rows(prediction):
        axes.plot(rows["x"], rows["y"] - sheet.TEE, ".", color=color, markersize=3, zorder=3.5)
    end = sheet.TEE_TO_HACK + 0.3
    away = y - reach[1] > end
    sides = half if away else max(half, abs(x) + reach[0])
    low = -sheet.HOUSE - 0.5
    axes.set_aspect("equal", adjustable="box")
    axes.set(
        xlim=(-sides, sides),
        ylim=(low if away else min(low, y - reach[1]), end if away else max(-low, y + reach[1])),
        xlabel="right of the centre line (m)",
        ylabel="beyond the tee line (m)",
    )
    axes.set_title(
        "passes through the house; band: 95 %, both errors"
        if away
        else "at rest; ellipses as wide and high as the table's\n68 % and 95 % intervals; "
        "outline: 95 %, parameters alone",
        fontsize=9,
    )


def _interval(prediction: Prediction, low: str, high: str) -> tuple[Any, Any]:
    """Centre and half width of an interval of the resting place, from the tee, m."""
    ends = np.array(
        [[prediction.quantities[name].quantiles[level] for level in (low, high)] for name in _REST]
    )
    return ends.mean(1), np.diff(ends)[:, 0] / 2


def _ellipse(axes: Any, centre: Any, size: Any, covariance: Any, **style: Any) -> None:
    """The ellipse of given half width and height, slanted as a covariance."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    squares, vectors = np.linalg.eigh(covariance / np.outer(sd, sd) * np.outer(size, size))
    long = 2 * np.sqrt(np.maximum(squares, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    axes.add_patch(Ellipse(centre, long[1], long[0], angle=angle, **style))


def _measured_rows(prediction: Prediction) -> list[tuple[Any, str, str]]:
    """Measured positions on the sheet, fitted and not fitted."""
    check = prediction.check
    later = {} if check is None else check.observed
    found = [
        (prediction.measured, _MEASURED, "measured, fitted"), (later, _AIM, "measured, not fitted"),
    ]  # fmt: skip
    return [item for item in found if "x" in item[0] and "y" in item[0]]


def _cross_track(prediction: Prediction, axes: Any) -> None:
    band = prediction.band
    y = band["y"] - sheet.TEE
    for low, high, alpha, label in (
        ("x_2.5", "x_97.5", 0.25, "95 %"), ("x_16", "x_84", 0.45, "68 %"),
    ):  # fmt: skip
        axes.fill_between(y, band[low], band[high], color=_BAND, alpha=alpha, lw=0, label=label)
    for rows, color, label in _measured_rows(prediction):
        axes.plot(rows["y"] - sheet.TEE, rows["x"], ".", color=color, markersize=3, label=label)
    axes.plot(y, band["x"], color=_PATH, lw=1.2, label="path of the law")
    axes.invert_yaxis()
    axes.set(
        xlabel="along the sheet, from the far tee (m)",
        ylabel="to the right, x (m)",
    )
    axes.legend(frameon=False, fontsize=8)
    axes.margins(x=0.02)


def _speed(prediction: Prediction, axes: Any) -> None:
    series = prediction.series
    axes.plot(series["t"], series["speed"], color=_PATH)
    axes.set(xlabel="t (s)", ylabel="speed (m/s)")
    axes.set(ylim=(0, None), xlim=(0, 1.05 * prediction.quantities["time"].value))
    spin = axes.twinx()
    spin.plot(series["t"], series["omega"], color="#2e8b57")
    spin.set_ylabel(r"spin $\omega$ (rad/s)", color="#2e8b57")
    low, high = float(series["omega"].min()), float(series["omega"].max())
    spin.set_ylim((min(low, 0.0) * 1.05, max(high, 0.0) * 1.05) if high > low else (-1, 1))


def _residuals(prediction: Prediction, axes: Any, name: str) -> None:
    """Measured minus predicted, with the bands of the path (without measurement noise)."""
    assert prediction.check is not None
    factor, unit = _UNITS[name]
    series, measured = prediction.series, prediction.check.observed
    step = series["t"][1] - series["t"][0]
    shown = (series["t"] >= measured["t"][0] - 1) & (series["t"] <= measured["t"][-1] + step)
    for low, high, alpha in (("2.5", "97.5", 0.25), ("16", "84", 0.45)):
        edges = [
            factor * (series[f"{name}_{level}"] - series[name])[shown] for level in (low, high)
        ]
        axes.fill_between(series["t"][shown], *edges, color=_BAND, alpha=alpha, lw=0)
    axes.axhline(0, color="0.6", lw=0.8)
    off = factor * (measured[name] - np.interp(measured["t"], series["t"], series[name]))
    axes.plot(measured["t"], off, ".", color=_AIM, markersize=3)
    axes.set(xlabel="t (s)", ylabel=unit)
    axes.set_title(f"${_LETTERS[name]}$ measured - predicted", fontsize=10)
    axes.margins(x=0.02)
