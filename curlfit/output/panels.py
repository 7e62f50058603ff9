"""The panels of which figures are made: paths, residuals, rates and values by row.

Each function draws what it is given into axes and knows nothing of its origin: a
`Series` as marks or as a line, a `Band` as an area, a `Row` of values with error bars.
Titles, legends and sizes are the caller's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator

from curlfit import sheet
from curlfit.output.figures import (
    DATA,
    FIT_COLOR,
    PREDICTION_COLOR,
    RINGS,
    SHEET_LINE,
    ZERO_LINE,
    Floats,
    Style,
    some_rows,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAW = Style(FIT_COLOR)
RESIDUALS = replace(DATA, color="0.25")
ERROR_BARS = Style("0.25", dashes="none", width=1, marker="o", size=3, cap=2, zorder=5)
"""of measured times and places, and of residuals with their standard errors"""
OUTLIERS = Style("black", dashes="none", marker="x", size=4.5, edge=0.9)
_ICE = "#f6fafc"
_RATE_LABEL = {"speed": "speed (m/s)", "omega": r"spin $\omega$ (rad/s)"}
_SLOPES = 40  # most slopes estimated from a measured series
_EDGE = 2.5  # end of the axis of residuals with outliers, over their 90 % quantile
_WITHIN = 0.97  # of the axis, where outliers beyond its end are drawn
_STRETCHED = 1.5  # ratio of scales above which a note says so


@dataclass(frozen=True)
class Series:
    """Values at places, drawn as marks or as a line.

    Attributes
    ----------
    at : horizontal coordinates, such as times in s, or y of a path in m.
    values : vertical coordinates, as many; NaN where there is none.
    style : of the marks or of the line.
    label : of the legend; empty for none.
    sigma : standard errors of the values, drawn as vertical bars.
    sigma_at : standard errors of the places, drawn as horizontal bars.
    """

    at: Floats
    values: Floats
    style: Style
    label: str = ""
    sigma: Floats | None = None
    sigma_at: Floats | None = None


@dataclass(frozen=True)
class Band:
    """The area between two curves.

    Attributes
    ----------
    at : horizontal coordinates.
    low, high : vertical coordinates of its edges, as many.
    opacity : from 0 to 1.
    color : by default that of predictions.
    label : of the legend; empty for none.
    """

    at: Floats
    low: Floats
    high: Floats
    opacity: float
    color: str = PREDICTION_COLOR
    label: str = ""


@dataclass(frozen=True)
class Interval:
    """A range of values, drawn as an area of a colour and an opacity from 0 to 1."""

    low: float
    high: float
    color: str
    opacity: float


@dataclass(frozen=True)
class RowValue:
    """One value in a row, with its standard error if it has one.

    `label` is that of the legend, where equal labels appear once.
    """

    value: float
    style: Style
    error: float | None = None
    label: str = ""


@dataclass(frozen=True)
class Row:
    """A row of a panel of values.

    Attributes
    ----------
    name : at its left end.
    values : drawn in it; it may have none, and keeps its place.
    joined : whether a line leads from the first value to the last.
    expected : a range of values, shaded along the row.
    remark : small text in its middle, above the values.
    bold : whether its name is in bold letters.
    """

    name: str
    values: Sequence[RowValue] = ()
    joined: bool = False
    expected: Interval | None = None
    remark: str = ""
    bold: bool = False


def plot(axes: Axes, *series: Series) -> None:
    """Draw series, of marks at most `figures.MAX_POINTS`, evenly spaced."""
    for drawn in series:
        options = drawn.style.options()
        if drawn.sigma is not None or drawn.sigma_at is not None:
            axes.errorbar(
                drawn.at,
                drawn.values,
                yerr=drawn.sigma,
                xerr=drawn.sigma_at,
                capsize=drawn.style.cap,
                label=drawn.label,
                **options,
            )
            continue
        at = drawn.at
        values = drawn.values
        if drawn.style.is_marks:
            rows = some_rows(len(at))
            at = at[rows]
            values = values[rows]
        axes.plot(at, values, label=drawn.label, **options)


def shade(axes: Axes, bands: Sequence[Band], zorder: float = 1) -> None:
    """Draw bands, the last above the others."""
    for band in bands:
        axes.fill_between(
            band.at,
            band.low,
            band.high,
            color=band.color,
            alpha=band.opacity,
            lw=0,
            label=band.label,
            zorder=zorder,
        )


# --- path -----------------------------------------------------------------------------


def plot_path(
    axes: Axes,
    paths: Sequence[Series],
    bands: Sequence[Band] = (),
    along: str = "along the sheet, y (m)",
) -> None:
    """Draw paths as seen from above, thrown to the right: x over y, both in m.

    What is right of the centre line is below. x has a scale of its own, in feet too at
    the right; where the size of the axes is known, `note_stretch` says how much larger
    it is. `along` is the label of the horizontal axis.
    """
    shade(axes, bands)
    plot(axes, *paths)
    axes.margins(x=0.02, y=0.12)
    axes.set(xlabel=along, ylabel="to the right, x (m)")
    axes.invert_yaxis()
    add_feet(axes)


def plot_on_sheet(
    axes: Axes,
    paths: Sequence[Series],
    bands: Sequence[Band] = (),
    *,
    ends: tuple[float, float],
    line_names: Mapping[str, str],
) -> None:
    """Draw paths to scale on the sheet from above, thrown to the right: x over y in m.

    Parameters
    ----------
    ends : of the horizontal axis, m from the hack.
    line_names : by line of `sheet.LINES`, the names below those that lie within the
        ends.
    """
    half = sheet.WIDTH / 2
    length = sheet.TEE + sheet.TEE_TO_HACK
    axes.add_patch(
        Rectangle((0, -half), length, 2 * half, fc=_ICE, ec="0.55", lw=0.8, zorder=0)
    )
    for tee in (sheet.LINES["tee"], sheet.TEE):
        plot_house(axes, (tee, 0.0))
    lines = [y for line, y in sheet.LINES.items() if line not in ("hack", "centre")]
    axes.hlines(0, 0, length, **SHEET_LINE.options())
    axes.vlines(
        [*lines, sheet.TEE + sheet.TEE_TO_BACK], -half, half, **SHEET_LINE.options()
    )
    shade(axes, bands, zorder=3)
    plot(axes, *paths)
    farthest = max(np.nanmax(np.abs(path.values), initial=0.0) for path in paths)
    beyond = max(half, float(farthest) + 0.3) + 0.1
    axes.set_aspect("equal")
    axes.set(xlim=ends, ylim=(beyond, -beyond))
    name_by_place = {
        sheet.LINES[line]: name
        for line, name in line_names.items()
        if ends[0] < sheet.LINES[line] < ends[1]
    }
    axes.set_xticks(list(name_by_place), list(name_by_place.values()))
    axes.set_yticks([-half, 0, half], ["left", "0", "right"])
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def plot_house(axes: Axes, centre: tuple[float, float]) -> None:
    """Draw the rings of a house, in m."""
    for radius, color in zip(sheet.CIRCLES, RINGS, strict=True):
        axes.add_patch(Circle(centre, radius, fc=color, ec="0.55", lw=0.6, zorder=0.5))


def add_feet(axes: Axes) -> None:
    """Add a vertical axis in feet at the right of one in metres."""
    second = axes.secondary_yaxis(
        "right",
        functions=(
            lambda metres: np.divide(metres, sheet.FOOT),
            lambda feet: np.multiply(feet, sheet.FOOT),
        ),
    )
    second.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    second.set_ylabel("(ft)")
    second.spines["right"].set_visible(True)
    second.grid(visible=False)


def note_stretch(axes: Axes) -> None:
    """Say in the label of the horizontal axis how many times as large the vertical
    scale is; the layout must be final."""
    spans = np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1)
    along, across = axes.get_window_extent().size / spans
    if across > _STRETCHED * along:
        times = float(f"{across / along:.2g}")
        axes.set_xlabel(f"{axes.get_xlabel()}; x is drawn {times:g} times as large")


# --- residuals ------------------------------------------------------------------------


def plot_residuals(
    axes: Axes,
    residuals: Sequence[Series],
    bands: Sequence[Band] = (),
    *,
    outliers: Series | None = None,
    label: str,
    over: str = "t (s)",
) -> None:
    """Draw residuals, as marks or as lines, about a line at zero.

    Parameters
    ----------
    outliers : residuals that were taken for outliers. The axis then ends at 2.5 times
        what nine tenths of the residuals lie within, so that these stay readable, and
        farther outliers are drawn at its ends.
    label : of the vertical axis, with the unit of all values.
    over : label of the horizontal axis.
    """
    shade(axes, bands)
    axes.axhline(0, **ZERO_LINE.options())
    plot(axes, *residuals)
    axes.set(xlabel=over, ylabel=label)
    if outliers is not None:
        sizes = np.abs(np.concatenate([series.values for series in residuals]))
        edge = _EDGE * float(np.nanquantile(sizes, 0.9))
        within = np.clip(outliers.values, -_WITHIN * edge, _WITHIN * edge)
        axes.plot(
            outliers.at,
            within,
            clip_on=False,
            label=outliers.label,
            **outliers.style.options(),
        )
        axes.set_ylim(-edge, edge)


# --- rates ----------------------------------------------------------------------------


def plot_rate(
    axes: Axes, rate: str, measured: Sequence[Series], curves: Sequence[Series] = ()
) -> None:
    """Draw speeds in m/s or spins in rad/s over time in s.

    Parameters
    ----------
    rate : its channel, "speed" or "omega".
    measured : as of `measured_rate`.
    curves : of laws. Where they all have one sign, the axis begins or ends at zero.
    """
    plot(axes, *measured, *curves)
    axes.set(xlabel="t (s)", ylabel=_RATE_LABEL[rate])
    if curves:
        low = min(float(np.min(curve.values)) for curve in curves)
        high = max(float(np.max(curve.values)) for curve in curves)
        if low >= 0:
            axes.set_ylim(bottom=0)
        elif high <= 0:
            axes.set_ylim(top=0)


def measured_rate(
    channels: Mapping[str, Floats], rate: str, style: Style = DATA
) -> Series:
    """Speeds or spins as measured, or else as slopes of the path or of the angle, with
    a label that says so; without values if there is neither.

    Parameters
    ----------
    channels : by name, "t" among them, in SI units.
    rate : channel of the rate, "speed" or "omega".
    """
    if rate in channels:
        return Series(channels["t"], channels[rate], style)
    sources = ("x", "y") if rate == "speed" else ("phi",)
    series = [channels[source] for source in sources if source in channels]
    if series:
        slopes = measured_slopes(channels["t"], *series)
        if len(slopes.at):
            rates = slopes.values
            values = np.hypot(*rates) if rate == "speed" else rates[0]
            label = f"slopes of the data over {slopes.duration:.2g} s"
            return Series(slopes.at, values, style, label)
    return Series(np.zeros(0), np.zeros(0), style)


@dataclass(frozen=True)
class Slopes:
    """Slopes of series at times.

    Attributes
    ----------
    at : mean times of groups of rows, s.
    values : slopes there, of the unit of each series over s, shape (series, groups).
    duration : of a group, s; the median of all.
    """

    at: Floats
    values: Floats
    duration: float


def measured_slopes(t: Floats, *series: Floats) -> Slopes:
    """Slopes of straight lines through groups of successive rows: measured speeds and
    spins.

    There are at most 40 groups of at least three rows, or none if there are too few
    rows; rows with a gap in any series are left out.
    """
    complete = np.isfinite(series).all(0)
    t = t[complete]
    values = np.array(series)[:, complete]
    number = min(_SLOPES, len(t) // 3)
    if number < 2:
        return Slopes(np.zeros(0), np.zeros((len(series), 0)), 0.0)
    middles = []
    slopes = []
    durations = []
    for rows in np.array_split(np.arange(len(t)), number):
        duration = np.ptp(t[rows])
        if duration > 0:
            middle = t[rows].mean()
            dt = t[rows] - middle
            middles.append(middle)
            slopes.append(values[:, rows] @ dt / (dt @ dt))
            durations.append(duration)
    usual = float(np.median(durations))
    return Slopes(np.array(middles), np.transpose(slopes), usual)


# --- values by row --------------------------------------------------------------------


def plot_rows(axes: Axes, rows: Sequence[Row], common: Interval | None = None) -> None:
    """Draw rows of values, from above, with their names at the left; each value is a
    mark with its standard error as a bar. The range `common` is shaded in all rows."""
    if common is not None:
        axes.axvspan(
            common.low, common.high, color=common.color, alpha=common.opacity, lw=0
        )
    labels: set[str] = set()
    for height, row in enumerate(rows):
        if row.expected is not None:
            axes.barh(
                height,
                row.expected.high - row.expected.low,
                left=row.expected.low,
                height=0.9,
                color=row.expected.color,
                alpha=row.expected.opacity,
                lw=0,
            )
        if row.joined:
            first = row.values[0]
            last = row.values[-1]
            axes.hlines(height, first.value, last.value, color=first.style.color, lw=1)
        for value in row.values:
            label = "" if value.label in labels else value.label
            labels.add(label)
            plot_value(axes, height, replace(value, label=label))
        if row.remark:
            axes.text(
                0.5,
                height + 0.12,
                row.remark,
                ha="center",
                transform=axes.get_yaxis_transform(),
            )
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    for tick, row in zip(axes.yaxis.get_major_ticks(), rows, strict=True):
        tick.label1.set_fontweight("bold" if row.bold else "normal")


def plot_value(axes: Axes, height: float, value: RowValue) -> None:
    """Draw a value as a mark at a height, with its standard error as a bar."""
    error = None if value.error is None else np.array([value.error])
    at = np.array([value.value])
    plot(
        axes,
        Series(at, np.array([height]), value.style, value.label, sigma_at=error),
    )
