"""Figure of a prediction: sheet and house to scale, ellipses from the intervals
of the table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.patches import Circle, Ellipse, Rectangle

from curlfit import sheet
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.prediction.result import Prediction

_UNITS = {"x": (100.0, "cm"), "y": (100.0, "cm"), "phi": (1000.0, "mrad")}
_REST = ("rest_x", "rest_y")
_LEVELS = (("2.5", "97.5", 0.3, "95 %"), ("16", "84", 0.6, "68 %"))
"""Percentiles at the ends of the bands, opacity and label."""
_OTHER: dict[str, Any] = {
    "color": draw.REFERENCE_COLOR,
    "lw": 0.9,
    "ls": "--",
    "zorder": 4,
}


@draw.style()
def prediction_figure(prediction: Prediction) -> draw.Picture:
    """The path on the sheet, the resting position in the house, bands of path and
    measured rows, speed and spin.

    Examples
    --------
    >>> curlfit.prediction_figure(prediction).savefig("predict.png")
    """
    check = prediction.check
    figure = draw.Picture(figsize=(draw.WIDTH, 5.15 if check is None else 6.75))
    (top,) = draw.row(figure, 0.3, 0.9, left=0.45, right=0.08)
    (house,) = draw.row(figure, 1.65, 3.05, left=0.6, right=draw.WIDTH - 3.1)
    (across,) = draw.row(figure, 1.65, 1.25, left=4.1, right=0.52)
    rates = draw.row(figure, 3.7, 1.0, 2, left=4.1, right=draw.WIDTH - 6.76, gap=0.7)
    _sheet_view(prediction, top)
    _resting_place(prediction, house)
    _cross_track(prediction, across)
    for axes, name in zip(rates, ("speed", "omega"), strict=True):
        _rate(prediction, axes, name)
    if check is not None:
        below = draw.row(figure, 5.5, 0.85, len(check.channels), left=0.6, gap=0.65)
        for axes, name in zip(below, check.channels, strict=True):
            _residuals(prediction, axes, name)
    law = draw.literal(prediction.law)
    file = draw.file_name(prediction.fit["file"])
    throw = "another throw on this ice"
    if prediction.of == "fitted":
        throw = "extrapolated to rest"
    draw.title(top, f"{law} law fitted to {file}, {throw}", margin=0.6)
    draw.letters([top], 0.38, 5)
    draw.letters((house, across, rates[0], *figure.axes[5:6]), names="bcde")
    return figure


def _sheet_view(prediction: Prediction, axes: Any) -> None:
    """The sheet from above, thrown toward the right: right of the centre
    line is below."""
    length = sheet.TEE + sheet.LINES["tee"]
    half = sheet.WIDTH / 2
    axes.add_patch(
        Rectangle(
            (0, -half), length, 2 * half, fc="#f6fafc", ec="0.55", lw=0.8, zorder=0
        )
    )
    for tee in (sheet.LINES["tee"], sheet.TEE):
        draw.plot_house(axes, (tee, 0.0))
    axes.hlines(0, 0, length, **draw.LINE)
    band = prediction.band
    series = prediction.series
    _plot_bands(axes, band["y"], lambda level: band[f"x_{level}"], zorder=3)
    for rows, style, _ in _measured_rows(prediction):
        axes.plot(rows["y"], rows["x"], **style | {"zorder": 3.5, "markersize": 1.4})
    axes.plot(series["y"], series["x"], color=draw.FIT_COLOR, lw=1, zorder=4)
    _stone(axes, (series["y"][0], series["x"][0]), hollow=True)
    _stone(axes, (series["y"][-1], series["x"][-1]))
    if prediction.other is not None:
        other = prediction.other.series
        axes.plot(other["y"], other["x"], **_OTHER)
        _stone(axes, (other["y"][-1], other["x"][-1]))
    axes.set_xlim(
        min(float(series["y"][0]), 0.0) - 0.5, max(float(series["y"][-1]), length) + 0.5
    )
    names = {"hog": "hog line", "far-hog": "hog line", "tee": "tee", "far-tee": "tee"}
    draw.sheet_axes(axes, names, max(half, float(np.abs(series["x"]).max()) + 0.3))
    axes.spines[:].set_visible(False)


def _plot_bands(
    axes: Any, abscissa: Floats, edge: Callable[[str], Floats], **style: Any
) -> None:
    """Bands between edges, which `edge` gives by percentile."""
    for low, high, alpha, label in _LEVELS:
        axes.fill_between(
            abscissa,
            edge(low),
            edge(high),
            alpha=alpha,
            color=draw.PREDICTION_COLOR,
            lw=0,
            label=label,
            **style,
        )


def _stone(axes: Any, position: tuple[float, float], hollow: bool = False) -> None:
    style: dict[str, Any] = {
        "fc": "none" if hollow else draw.FIT_COLOR,
        "ec": draw.FIT_COLOR,
    }
    axes.add_patch(Circle(position, sheet.STONE_RADIUS, lw=0.8, zorder=6, **style))


def _resting_place(prediction: Prediction, axes: Any) -> None:
    """The resting position, seen along the throw, in m from the tee."""
    half = sheet.WIDTH / 2
    series = prediction.series
    x = series["x"][-1]
    y = series["y"][-1] - sheet.TEE
    centre, size = _interval(prediction, "2.5", "97.5")
    reach = np.abs(centre - (x, y)) + 1.1 * size + 0.3
    draw.plot_house(axes, (0.0, 0.0))
    axes.axvline(0, **draw.LINE)
    axes.hlines([0.0, -sheet.TEE_TO_HOG, sheet.TEE_TO_BACK], -half, half, **draw.LINE)
    axes.plot(series["x"], series["y"] - sheet.TEE, color=draw.FIT_COLOR, zorder=4)
    band = prediction.band
    axes.fill_betweenx(
        band["y"] - sheet.TEE,
        band["x_2.5"],
        band["x_97.5"],
        color=draw.PREDICTION_COLOR,
        alpha=0.2,
        lw=0,
        zorder=2,
    )
    rest = prediction.rest
    for first, last, alpha, _ in _LEVELS:
        style = {"fc": draw.PREDICTION_COLOR, "alpha": alpha, "ec": "none", "zorder": 3}
        _ellipse(axes, *_interval(prediction, first, last), rest["both"], **style)
    if prediction.other is not None:
        other = prediction.other
        axes.plot(other.series["x"], other.series["y"] - sheet.TEE, **_OTHER)
        _ellipse(
            axes,
            *_interval(other, "2.5", "97.5"),
            other.rest["both"],
            fc="none",
            ec=_OTHER["color"],
            lw=0.8,
            zorder=5,
            label=f"{other.call.turn}-turn",
        )
    parameter_sd = [prediction.quantities[name].parameter_sd for name in _REST]
    _ellipse(
        axes,
        np.array([x, y]),
        1.96 * np.array(parameter_sd),
        rest["parameter"],
        fc="none",
        ec=draw.FIT_COLOR,
        lw=0.8,
        ls="--",
        zorder=5,
        label="95 %, parameter uncertainty only",
    )
    _stone(axes, (x, y), hollow=True)
    if prediction.goal is not None:
        axes.plot(
            prediction.goal.x or 0.0,
            prediction.goal.y,
            "+",
            color=draw.REFERENCE_COLOR,
            markersize=9,
            mew=1.5,
            zorder=7,
        )
    for rows, style, _ in _measured_rows(prediction):
        axes.plot(rows["x"], rows["y"] - sheet.TEE, **style | {"zorder": 3.5})
    # the width of the sheet, and of its length the house and the ellipse
    side = max(half, abs(x) + reach[0])
    edge = sheet.HOUSE + 0.5
    bottom = min(-edge, y - reach[1])
    top = min(max(edge, y + reach[1]), sheet.TEE_TO_HACK + 0.3)
    _equal_scales(axes, (-side, side), (bottom, top))
    axes.set(xlabel="right of the centre line (m)", ylabel="beyond the tee line (m)")
    axes.grid(visible=False)
    draw.feet(axes)
    draw.legend_above(axes)


def _equal_scales(axes: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set limits that contain both intervals, at equal scales."""
    box = axes.get_window_extent()
    # twice the pixels of a metre
    scale = 2 * min(box.width / np.ptp(x), box.height / np.ptp(y))
    axes.set_xlim(np.mean(x) + np.array([-1, 1]) * box.width / scale)
    axes.set_ylim(np.mean(y) + np.array([-1, 1]) * box.height / scale)


def _interval(prediction: Prediction, low: str, high: str) -> tuple[Any, Any]:
    """Centre and half width of an interval of the resting position, from the tee, m."""
    quantiles = [prediction.quantities[name].quantiles for name in _REST]
    ends = np.array([[levels[low], levels[high]] for levels in quantiles])
    return ends.mean(1), np.diff(ends)[:, 0] / 2


def _ellipse(axes: Any, centre: Any, size: Any, covariance: Any, **style: Any) -> None:
    """Draw an ellipse of given half width and height, with the correlation of
    a covariance."""
    scale = size / np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    squares, vectors = np.linalg.eigh(covariance * np.outer(scale, scale))
    short, long = 2 * np.sqrt(np.maximum(squares, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    axes.add_patch(Ellipse(centre, long, short, angle=angle, **style))


def _measured_rows(prediction: Prediction) -> list[tuple[Any, dict[str, Any], str]]:
    """Measured rows on the sheet, fitted and not fitted: rows, style and label."""
    label = "data, fitted" if prediction.of == "fitted" else "data of the fitted throw"
    sources: list[Any] = [(prediction.measured, draw.DATA_STYLE, label)]
    if prediction.check is not None:
        later = prediction.check.observed
        sources.append((later, draw.LATER_STYLE, "data, not fitted"))
    return [source for source in sources if {"x", "y"} <= source[0].keys()]


def _cross_track(prediction: Prediction, axes: Any) -> None:
    """x along the sheet: right of the centre line is below, as on the sheet above."""
    band = prediction.band
    y = band["y"] - sheet.TEE
    _plot_bands(axes, y, lambda level: band[f"x_{level}"])
    for rows, style, label in _measured_rows(prediction):
        axes.plot(rows["y"] - sheet.TEE, rows["x"], **style, label=label)
    axes.plot(y, band["x"], color=draw.FIT_COLOR, label="law")
    draw.x_along_y(axes, "along the sheet, from the far tee (m)")
    draw.legend_above(axes, ncols=3)
    axes.margins(x=0.02)


def _rate(prediction: Prediction, axes: Any, name: str) -> None:
    """Speed or spin, with those measured, directly or as slopes of the
    measured path."""
    series = prediction.series
    for rows, style, _ in _measured_rows(prediction):
        draw.plot_rate(axes, rows, name, style)
    axes.plot(series["t"], series[name], color=draw.FIT_COLOR)
    axes.axhline(0, **draw.ZERO_LINE)  # which the scale then includes
    axes.set(xlabel="t (s)", ylabel=draw.RATE_LABEL[name])
    axes.set_xlim(0, 1.05 * prediction.quantities["time"].value)


def _residuals(prediction: Prediction, axes: Any, name: str) -> None:
    """Measured minus predicted, with the bands of the path (without
    measurement noise)."""
    assert prediction.check is not None
    factor, unit = _UNITS[name]
    series = prediction.series
    t = series["t"]
    measured = prediction.check.observed
    measured_t = measured["t"]
    step = t[1] - t[0]
    shown = (t >= measured_t[0] - 1) & (t <= measured_t[-1] + step)
    _plot_bands(
        axes,
        t[shown],
        lambda level: factor * (series[f"{name}_{level}"] - series[name])[shown],
    )
    axes.axhline(0, **draw.ZERO_LINE)
    predicted = np.interp(measured_t, t, series[name])
    axes.plot(measured_t, factor * (measured[name] - predicted), **draw.LATER_STYLE)
    axes.set(xlabel="t (s)", ylabel=unit)
    axes.set_title(
        f"${draw.CHANNEL_LABEL[name]}$, measured \N{MINUS SIGN} predicted", loc="center"
    )
    axes.margins(x=0.02)
