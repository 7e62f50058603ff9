"""Figure of a prediction: sheet and house to scale, ellipses from the intervals
of the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle, Ellipse

from curlfit import sheet
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import (
    LAW,
    Band,
    Series,
    add_feet,
    measured_rate,
    plot_house,
    plot_on_sheet,
    plot_path,
    plot_rate,
    plot_residuals,
)
from curlfit.prediction.result import HeldOut, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNITS = {"x": (100.0, "cm"), "y": (100.0, "cm"), "phi": (1000.0, "mrad")}
_REST = ("rest_x", "rest_y")
_OTHER = Style(draw.REFERENCE_COLOR, "--", width=0.9, zorder=4)
"""of the throw with the other turn"""
_LINE_NAMES = {
    "hog": "hog line",
    "far-hog": "hog line",
    "tee": "tee",
    "far-tee": "tee",
}


@dataclass(frozen=True)
class _Level:
    """A central interval of the draws: percentiles at its ends, and how it is drawn."""

    low: str
    high: str
    opacity: float
    label: str


_WIDE = _Level("2.5", "97.5", 0.3, "95 %")
_LEVELS = (_WIDE, _Level("16", "84", 0.6, "68 %"))


@dataclass(frozen=True)
class _Measured:
    """Measured channels on the sheet, by name in SI units, and how they are drawn."""

    channels: Mapping[str, Floats]
    style: Style
    label: str


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
    (top,) = draw.side_by_side(figure, 0.3, 0.9, left=0.45, right=0.08)
    (house,) = draw.side_by_side(figure, 1.65, 3.05, left=0.6, right=draw.WIDTH - 3.1)
    (across,) = draw.side_by_side(figure, 1.65, 1.25, left=4.1, right=0.52)
    rates = draw.side_by_side(
        figure, 3.7, 1.0, 2, left=4.1, right=draw.WIDTH - 6.76, gap=0.7
    )
    _sheet_view(prediction, top)
    _resting_place(prediction, house)
    _cross_track(prediction, across)
    for axes, name in zip(rates, ("speed", "omega"), strict=True):
        _rate(prediction, axes, name)
    if check is not None:
        below = draw.side_by_side(
            figure, 5.5, 0.85, len(check.channels), left=0.6, gap=0.65
        )
        for axes, name in zip(below, check.channels, strict=True):
            _residuals(prediction.series, check, axes, name)
    law = draw.literal(prediction.law)
    file = draw.file_name(prediction.fit.file)
    throw = "another throw on this ice"
    if prediction.of == "fitted":
        throw = "extrapolated to rest"
    draw.title(top, f"{law} law fitted to {file}, {throw}", margin=0.6)
    draw.letters([top], 0.38, 5)
    draw.letters((house, across, rates[0], *figure.axes[5:6]), names="bcde")
    return figure


def _measured_of(prediction: Prediction) -> list[_Measured]:
    """What was measured of the path, of the fitted rows and of those not fitted."""
    label = "data, fitted" if prediction.of == "fitted" else "data of the fitted throw"
    measured = [_Measured(prediction.measured, draw.DATA, label)]
    if prediction.check is not None:
        later = prediction.check.observed
        measured.append(_Measured(later, draw.LATER_DATA, "data, not fitted"))
    return [part for part in measured if {"x", "y"} <= part.channels.keys()]


def _bands(at: Floats, edge: Callable[[str], Floats]) -> list[Band]:
    """Bands of 95 and 68 % between edges, which `edge` gives by percentile."""
    return [
        Band(at, edge(level.low), edge(level.high), level.opacity, label=level.label)
        for level in _LEVELS
    ]


def _sheet_view(prediction: Prediction, axes: Axes) -> None:
    """The sheet from above, thrown toward the right: right of the centre
    line is below."""
    series = prediction.series
    band = prediction.band
    paths = []
    for measured in _measured_of(prediction):
        style = replace(measured.style, size=1.4, zorder=3.5)
        paths.append(Series(measured.channels["y"], measured.channels["x"], style))
    paths.append(Series(series["y"], series["x"], replace(LAW, width=1, zorder=4)))
    if prediction.other is not None:
        other = prediction.other.series
        paths.append(Series(other["y"], other["x"], _OTHER))
        _stone(axes, other["y"][-1], other["x"][-1])
    start = float(series["y"][0])
    end = float(series["y"][-1])
    plot_on_sheet(
        axes,
        paths,
        _bands(band["y"], lambda level: band[f"x_{level}"]),
        ends=(min(start, 0.0) - 0.5, max(end, sheet.TEE + sheet.TEE_TO_HACK) + 0.5),
        line_names=_LINE_NAMES,
    )
    _stone(axes, start, series["x"][0], hollow=True)
    _stone(axes, end, series["x"][-1])


def _stone(axes: Axes, across: float, up: float, *, hollow: bool = False) -> None:
    """A stone with its centre at a point of the axes, in m."""
    color = draw.FIT_COLOR
    inside = "none" if hollow else color
    axes.add_patch(
        Circle((across, up), sheet.STONE_RADIUS, fc=inside, ec=color, lw=0.8, zorder=6)
    )


def _resting_place(prediction: Prediction, axes: Axes) -> None:
    """The resting position, seen along the throw, in m from the tee."""
    half = sheet.WIDTH / 2
    series = prediction.series
    band = prediction.band
    line = draw.SHEET_LINE.options()
    plot_house(axes, (0.0, 0.0))
    axes.axvline(0, **line)
    axes.hlines([0.0, -sheet.TEE_TO_HOG, sheet.TEE_TO_BACK], -half, half, **line)
    beyond_tee = series["y"] - sheet.TEE
    axes.plot(series["x"], beyond_tee, **replace(LAW, zorder=4).options())
    axes.fill_betweenx(
        band["y"] - sheet.TEE,
        band["x_2.5"],
        band["x_97.5"],
        color=draw.PREDICTION_COLOR,
        alpha=0.2,
        lw=0,
        zorder=2,
    )
    _regions(prediction, axes)
    rest = np.array([series["x"][-1], beyond_tee[-1]])
    _stone(axes, rest[0], rest[1], hollow=True)
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
    for measured in _measured_of(prediction):
        marks = replace(measured.style, zorder=3.5).options()
        channels = measured.channels
        axes.plot(channels["x"], channels["y"] - sheet.TEE, **marks)
    # the width of the sheet, and of its length the house and the ellipse
    region = _region(prediction, _WIDE)
    reach = np.abs(region.centre - rest) + 1.1 * region.size + 0.3
    side = max(half, abs(rest[0]) + reach[0])
    edge = sheet.HOUSE + 0.5
    bottom = min(-edge, rest[1] - reach[1])
    top = min(max(edge, rest[1] + reach[1]), sheet.TEE_TO_HACK + 0.3)
    _equal_scales(axes, (-side, side), (bottom, top))
    axes.set(xlabel="right of the centre line (m)", ylabel="beyond the tee line (m)")
    axes.grid(visible=False)
    add_feet(axes)
    draw.legend_above(axes)


def _regions(prediction: Prediction, axes: Axes) -> None:
    """Ellipses of the resting position: with all errors, with those of the parameters
    alone, and of the throw with the other turn."""
    covariance = prediction.rest.both
    for level in _LEVELS:
        _ellipse(
            axes,
            _region(prediction, level),
            covariance,
            fc=draw.PREDICTION_COLOR,
            alpha=level.opacity,
            ec="none",
            zorder=3,
        )
    other = prediction.other
    if other is not None:
        style = _OTHER.options()
        axes.plot(other.series["x"], other.series["y"] - sheet.TEE, **style)
        _ellipse(
            axes,
            _region(other, _WIDE),
            other.rest.both,
            fc="none",
            ec=_OTHER.color,
            lw=0.8,
            zorder=5,
            label=f"{other.call.turn}-turn",
        )
    sd = np.array([prediction.quantities[name].parameter_sd for name in _REST])
    series = prediction.series
    best = np.array([series["x"][-1], series["y"][-1] - sheet.TEE])
    _ellipse(
        axes,
        _Region(best, 1.96 * sd),
        prediction.rest.parameter,
        fc="none",
        ec=draw.FIT_COLOR,
        lw=0.8,
        ls="--",
        zorder=5,
        label="95 %, parameter uncertainty only",
    )


def _equal_scales(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Set limits that contain both intervals, at equal scales."""
    box = axes.get_window_extent()
    # twice the pixels of a metre
    scale = 2 * min(box.width / np.ptp(x), box.height / np.ptp(y))
    axes.set_xlim(np.mean(x) + np.array([-1, 1]) * box.width / scale)
    axes.set_ylim(np.mean(y) + np.array([-1, 1]) * box.height / scale)


@dataclass(frozen=True)
class _Region:
    """Centre of a region of resting positions and half its width and height: x and y
    from the tee, m."""

    centre: Floats
    size: Floats


def _region(prediction: Prediction, level: _Level) -> _Region:
    """The region between the percentiles of a level."""
    quantiles = [prediction.quantities[name].quantiles for name in _REST]
    ends = np.array(
        [[by_level[level.low], by_level[level.high]] for by_level in quantiles]
    )
    return _Region(ends.mean(1), np.diff(ends)[:, 0] / 2)


def _ellipse(axes: Axes, region: _Region, covariance: Any, **style: Any) -> None:
    """Draw the ellipse that fills a region, with the correlation of a covariance,
    shape (2, 2)."""
    scale = region.size / np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    squares, vectors = np.linalg.eigh(covariance * np.outer(scale, scale))
    short, long = 2 * np.sqrt(np.maximum(squares, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    x, y = region.centre.tolist()
    axes.add_patch(Ellipse((x, y), long, short, angle=angle, **style))


def _cross_track(prediction: Prediction, axes: Axes) -> None:
    """x along the sheet: right of the centre line is below, as on the sheet above."""
    band = prediction.band
    y = band["y"] - sheet.TEE
    paths = []
    for measured in _measured_of(prediction):
        from_tee = measured.channels["y"] - sheet.TEE
        x = measured.channels["x"]
        paths.append(Series(from_tee, x, measured.style, measured.label))
    paths.append(Series(y, band["x"], LAW, "law"))
    bands = _bands(y, lambda level: band[f"x_{level}"])
    plot_path(axes, paths, bands, "along the sheet, from the far tee (m)")
    draw.legend_above(axes, ncols=3)


def _rate(prediction: Prediction, axes: Axes, rate: str) -> None:
    """Speed or spin, with those measured, directly or as slopes of the
    measured path."""
    series = prediction.series
    measured = [
        measured_rate(part.channels, rate, part.style)
        for part in _measured_of(prediction)
    ]
    plot_rate(axes, rate, measured, [Series(series["t"], series[rate], LAW)])
    axes.set_xlim(0, 1.05 * prediction.quantities["time"].value)


def _residuals(
    predicted: Mapping[str, Floats], check: HeldOut, axes: Axes, channel: str
) -> None:
    """Measured minus predicted, with the bands of the path (without
    measurement noise)."""
    factor, unit = _UNITS[channel]
    t = predicted["t"]
    path = predicted[channel]
    measured_t = check.observed["t"]
    off = check.observed[channel] - np.interp(measured_t, t, path)
    step = t[1] - t[0]
    shown = (t >= measured_t[0] - 1) & (t <= measured_t[-1] + step)
    plot_residuals(
        axes,
        [Series(measured_t, factor * off, draw.LATER_DATA)],
        _bands(
            t[shown],
            lambda level: factor * (predicted[f"{channel}_{level}"] - path)[shown],
        ),
        label=unit,
    )
    axes.set_title(
        f"${draw.CHANNEL_LABEL[channel]}$, measured \N{MINUS SIGN} predicted",
        loc="center",
    )
    axes.margins(x=0.02)
