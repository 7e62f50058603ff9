"""Figure of a prediction: sheet and house to scale, ellipses from the intervals of the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle, Ellipse, Rectangle

from curlfit import sheet
from curlfit.output.figures import (
    CHANNEL_LABEL,
    DATA_STYLE,
    FIT_COLOR,
    LATER_STYLE,
    PREDICTION_COLOR,
    REFERENCE_COLOR,
    RINGS,
    WIDTH,
    ZERO_LINE,
    Picture,
    feet,
    file_name,
    legend_above,
    letter,
    literal,
    measured_slopes,
    place,
    styled,
    title,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.prediction.result import Prediction

_LINE: dict[str, Any] = {"color": "0.6", "lw": 0.6, "zorder": 1}
_UNITS = {"x": (100.0, "cm"), "y": (100.0, "cm"), "phi": (1000.0, "mrad")}
_REST = ("rest_x", "rest_y")
_LEVELS = (("2.5", "97.5", 0.3, "95 %"), ("16", "84", 0.6, "68 %"))
"""Percentiles at the ends of the bands, opacity and label."""


@styled
def prediction_figure(prediction: Prediction) -> Figure:
    """The path on the sheet, the resting position in the house, bands of path and measured rows,
    speed and spin.

    Examples
    --------
    >>> curlfit.prediction_figure(prediction).savefig("predict.png")
    """
    check = prediction.check
    figure = Picture(figsize=(WIDTH, 5.15 if check is None else 6.75))
    top = place(figure, 0.45, 0.3, WIDTH - 0.53, 0.9)
    house = place(figure, 0.6, 1.65, 2.5, 3.05)
    across = place(figure, 4.1, 1.65, WIDTH - 4.62, 1.25)
    speed, spin = (place(figure, left, 3.7, 0.98, 1.0) for left in (4.1, 5.78))
    _sheet_view(prediction, top)
    _resting_place(prediction, house)
    _cross_track(prediction, across)
    _rates(prediction, speed, spin)
    channels = [] if check is None else list(check.channels)
    wide = (WIDTH - 0.12 + 0.05) / max(len(channels), 1)
    for index, name in enumerate(channels):
        _residuals(prediction, place(figure, 0.6 + index * wide, 5.5, wide - 0.65, 0.85), name)
    file = file_name(prediction.fit["file"])
    of = "extrapolated to rest" if prediction.of == "fitted" else "another throw on this ice"
    title(top, f"{literal(prediction.law)} law fitted to {file}, {of}", margin=0.6)
    letter(top, "a", 0.38, 5)
    for axes, mark in zip((house, across, speed, *figure.axes[5:6]), "bcde", strict=False):
        letter(axes, mark)
    return figure


def _sheet_view(prediction: Prediction, axes: Any) -> None:
    """The sheet from above, thrown toward the right: right of the centre line is below."""
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
    for low, high, alpha, _ in _LEVELS:
        axes.fill_between(
            band["y"], band[f"x_{low}"], band[f"x_{high}"], color=PREDICTION_COLOR, alpha=alpha,
            lw=0, zorder=3,
        )  # fmt: skip
    for rows, style, _ in _measured_rows(prediction):
        axes.plot(rows["y"], rows["x"], **style | {"zorder": 3.5, "markersize": 1.4})
    axes.plot(series["y"], series["x"], color=FIT_COLOR, lw=1, zorder=4)
    _stone(axes, (series["y"][0], series["x"][0]), hollow=True)
    _stone(axes, (series["y"][-1], series["x"][-1]))
    axes.set_aspect("equal")
    axes.set_xlim(min(float(series["y"][0]), 0.0) - 0.5, max(float(series["y"][-1]), length) + 0.5)
    beyond = max(half, float(np.abs(series["x"]).max()) + 0.3)
    axes.set_ylim(beyond + 0.1, -beyond - 0.1)
    names = {"hog": "hog line", "far-hog": "hog line", "tee": "tee", "far-tee": "tee"}
    axes.set_xticks([sheet.LINES[name] for name in names], list(names.values()))
    axes.set_yticks([-half, 0, half], ["left", "0", "right"])
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _house(axes: Any, centre: tuple[float, float]) -> None:
    for radius, color in zip(sheet.CIRCLES, RINGS, strict=True):
        axes.add_patch(
            Circle(centre, radius, facecolor=color, edgecolor="0.55", lw=0.6, zorder=0.5)
        )


def _stone(axes: Any, position: tuple[float, float], hollow: bool = False) -> None:
    axes.add_patch(
        Circle(
            position, sheet.STONE_RADIUS, facecolor="none" if hollow else FIT_COLOR,
            edgecolor=FIT_COLOR, lw=0.8, zorder=6,
        )
    )  # fmt: skip


def _resting_place(prediction: Prediction, axes: Any) -> None:
    """The resting position, seen along the throw, in m from the tee."""
    series, half = prediction.series, sheet.WIDTH / 2
    x, y = series["x"][-1], series["y"][-1] - sheet.TEE
    centre, size = _interval(prediction, "2.5", "97.5")
    reach = np.abs(centre - (x, y)) + 1.1 * size + 0.3
    _house(axes, (0.0, 0.0))
    axes.axvline(0, **_LINE)
    for level in (0.0, -sheet.TEE_TO_HOG, sheet.TEE_TO_BACK):
        axes.plot([-half, half], [level, level], **_LINE)
    axes.plot(series["x"], series["y"] - sheet.TEE, color=FIT_COLOR, zorder=4)
    band = prediction.band
    axes.fill_betweenx(
        band["y"] - sheet.TEE, band["x_2.5"], band["x_97.5"], color=PREDICTION_COLOR, alpha=0.2,
        lw=0, zorder=2,
    )  # fmt: skip
    rest = prediction.rest
    both = np.array(rest.get("both", np.add(rest["parameter"], rest["model"])))
    for first, last, alpha, _ in _LEVELS:
        _ellipse(
            axes, *_interval(prediction, first, last), both, facecolor=PREDICTION_COLOR,
            alpha=alpha, edgecolor="none", zorder=3,
        )  # fmt: skip
    own = 1.96 * np.array([prediction.quantities[name].parameter_sd for name in _REST])
    _ellipse(
        axes, np.array([x, y]), own, np.array(rest["parameter"]),
        facecolor="none", edgecolor=FIT_COLOR, lw=0.8, ls="--", zorder=5,
        label="95 %, parameter uncertainty only",
    )  # fmt: skip
    _stone(axes, (x, y), hollow=True)
    if prediction.goal is not None:
        target = prediction.goal["x"] or 0.0, prediction.goal["y"]
        axes.plot(*target, "+", color=REFERENCE_COLOR, markersize=9, mew=1.5, zorder=7)
    for rows, style, _ in _measured_rows(prediction):
        axes.plot(rows["x"], rows["y"] - sheet.TEE, **style | {"zorder": 3.5})
    end = sheet.TEE_TO_HACK + 0.3
    away = y - reach[1] > end
    sides = half if away else max(half, abs(x) + reach[0])
    low = -sheet.HOUSE - 0.5
    ends = low if away else min(low, y - reach[1]), end if away else max(-low, y + reach[1])
    _equal_scales(axes, (-sides, sides), ends)
    axes.set(xlabel="right of the centre line (m)", ylabel="beyond the tee line (m)")
    axes.grid(visible=False)
    feet(axes, "right")
    if away:
        title(axes, "passes through the house; band: 95 %", columns=2)
    else:  # as wide and high as the intervals of the table
        legend_above(axes)


def _equal_scales(axes: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set limits that contain both intervals, at equal scales."""
    box = axes.get_window_extent()
    metre = min(box.width / np.ptp(x), box.height / np.ptp(y))
    for setter, size, ends in (
        (axes.set_xlim, box.width, x), (axes.set_ylim, box.height, y),
    ):  # fmt: skip
        setter(np.mean(ends) - size / metre / 2, np.mean(ends) + size / metre / 2)


def _interval(prediction: Prediction, low: str, high: str) -> tuple[Any, Any]:
    """Centre and half width of an interval of the resting position, from the tee, m."""
    ends = np.array(
        [[prediction.quantities[name].quantiles[level] for level in (low, high)] for name in _REST]
    )
    return ends.mean(1), np.diff(ends)[:, 0] / 2


def _ellipse(axes: Any, centre: Any, size: Any, covariance: Any, **style: Any) -> None:
    """Draw an ellipse of given half width and height, with the correlation of a covariance."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    squares, vectors = np.linalg.eigh(covariance / np.outer(sd, sd) * np.outer(size, size))
    long = 2 * np.sqrt(np.maximum(squares, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    axes.add_patch(Ellipse(centre, long[1], long[0], angle=angle, **style))


def _measured_rows(prediction: Prediction) -> list[tuple[Any, Any, str]]:
    """Measured rows on the sheet, fitted and not fitted: rows, style and label."""
    check = prediction.check
    later = {} if check is None else check.observed
    label = "data, fitted" if prediction.of == "fitted" else "data of the fitted throw"
    found = [(prediction.measured, DATA_STYLE, label), (later, LATER_STYLE, "data, not fitted")]
    return [item for item in found if "x" in item[0] and "y" in item[0]]


def _cross_track(prediction: Prediction, axes: Any) -> None:
    """x along the sheet: right of the centre line is below, as on the sheet above."""
    band = prediction.band
    y = band["y"] - sheet.TEE
    for low, high, alpha, label in _LEVELS:
        axes.fill_between(
            y, band[f"x_{low}"], band[f"x_{high}"], color=PREDICTION_COLOR, alpha=alpha, lw=0,
            label=label,
        )  # fmt: skip
    for rows, style, label in _measured_rows(prediction):
        axes.plot(rows["y"] - sheet.TEE, rows["x"], **style, label=label)
    axes.plot(y, band["x"], color=FIT_COLOR, label="law")
    axes.invert_yaxis()
    axes.set(xlabel="along the sheet, from the far tee (m)", ylabel="to the right, x (m)")
    feet(axes, "right")
    legend_above(axes, ncols=3)
    axes.margins(x=0.02)


def _rates(prediction: Prediction, speed: Any, spin: Any) -> None:
    """Speed and spin, with those measured, directly or as slopes of the measured path."""
    series = prediction.series
    for rows, style, _ in _measured_rows(prediction):
        if "speed" in rows:
            speed.plot(rows["t"], rows["speed"], **style)
        else:
            at, slopes, _ = measured_slopes(rows["t"], rows["x"], rows["y"])
            speed.plot(at, np.hypot(*slopes), **style)
        if "omega" in rows:
            spin.plot(rows["t"], rows["omega"], **style)
        elif "phi" in rows:
            at, (turning,), _ = measured_slopes(rows["t"], rows["phi"])
            spin.plot(at, turning, **style)
    for axes, name in ((speed, "speed"), (spin, "omega")):
        axes.plot(series["t"], series[name], color=FIT_COLOR)
        axes.set(xlabel="t (s)", xlim=(0, 1.05 * prediction.quantities["time"].value))
    speed.set(ylabel="speed (m/s)", ylim=(0, None))
    spin.set_ylabel(r"spin $\omega$ (rad/s)")
    low, high = float(series["omega"].min()), float(series["omega"].max())
    spin.set_ylim((min(low, 0.0) * 1.05, max(high, 0.0) * 1.05) if high > low else (-1, 1))


def _residuals(prediction: Prediction, axes: Any, name: str) -> None:
    """Measured minus predicted, with the bands of the path (without measurement noise)."""
    assert prediction.check is not None
    factor, unit = _UNITS[name]
    series, measured = prediction.series, prediction.check.observed
    step = series["t"][1] - series["t"][0]
    shown = (series["t"] >= measured["t"][0] - 1) & (series["t"] <= measured["t"][-1] + step)
    for low, high, alpha, _ in _LEVELS:
        edges = [
            factor * (series[f"{name}_{level}"] - series[name])[shown] for level in (low, high)
        ]
        axes.fill_between(series["t"][shown], *edges, color=PREDICTION_COLOR, alpha=alpha, lw=0)
    axes.axhline(0, **ZERO_LINE)
    off = factor * (measured[name] - np.interp(measured["t"], series["t"], series[name]))
    axes.plot(measured["t"], off, **LATER_STYLE)
    axes.set(xlabel="t (s)", ylabel=unit)
    axes.set_title(f"${CHANNEL_LABEL[name]}$, measured \N{MINUS SIGN} predicted")
    axes.margins(x=0.02)
