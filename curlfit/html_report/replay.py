"""Throws animated in the page: a path on the sheet with residuals, and draws of
a prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from curlfit.html_report.blocks import InteractiveBlock
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.output.figures import DATA_COLOR, some_rows
from curlfit.output.ticks import unit_for
from curlfit.prediction.result import Prediction
from curlfit.sheet import HOUSE, LINES, STONE_RADIUS, TEE, WIDTH
from curlfit.wording import decimals, join_words

_BEYOND = 0.6  # m drawn around the house
# half the height of the close view, relative to the spread of the resting positions
_CLOSE = 1.6
_SMALLEST = 0.25  # m, lower limit of half its height
_MOST = 600  # times of a path in a page
_MARGIN = 0.4  # m around what is drawn of the sheet
_ASSUMED = (Verdict.FIXED, Verdict.NOT_IDENTIFIABLE)

Numbers = list[float | None]
"""Rounded numbers of a series; None where it has none."""
Point = tuple[float, float]


@dataclass(frozen=True)
class _Channel:
    """A channel of a path in the table of an instant.

    Attributes
    ----------
    unit_size : size of the unit in SI, rad.
    start : parameters without which its beginning is not known.
    """

    meaning: str
    unit: str
    unit_size: float = 1.0
    start: tuple[str, ...] = ()


_CHANNELS = {
    "x": _Channel("to the right", "m", start=("x0", "heading")),
    "y": _Channel("along the sheet", "m"),
    "phi": _Channel("angle", "turns", 2 * math.pi, start=("phi0", "omega0")),
    "speed": _Channel("speed", "m/s"),
    "omega": _Channel("spin", "rad/s", start=("omega0",)),
}


class View(NamedTuple):
    """The part of a plane that a drawing shows, as an `<svg>` element names it."""

    left: float
    top: float
    width: float
    height: float


@dataclass(frozen=True)
class ResidualSeries:
    """Residuals of a channel, in a unit that suits their size."""

    unit: str
    values: Numbers


@dataclass(frozen=True)
class ReplayData:
    """What `replay.js` reads.

    Attributes
    ----------
    t : times, s. x, y, phi, speed, omega : of the path at these times (SI, rad).
    residuals : by channel, at these times.
    """

    t: Numbers
    x: Numbers
    y: Numbers
    phi: Numbers
    speed: Numbers
    omega: Numbers
    residuals: dict[str, ResidualSeries]


@dataclass(frozen=True)
class Trace:
    """Residuals of a channel over time, as dots.

    Attributes
    ----------
    reach : the largest residual, in the unit of its numbers.
    dots : time from 0 to 1 across, residual from -1 to 1 of `reach` down.
    """

    name: str
    unit: str
    reach: str
    dots: list[Point]
    color: str = DATA_COLOR


@dataclass(frozen=True)
class InstantRow:
    """A channel in the table of an instant: its value at the end of the path, and its
    last residual, which is empty where there is none."""

    name: str
    meaning: str
    unit: str
    value: float
    residual: str


@dataclass(frozen=True)
class StoneAt:
    """Position and angle of a stone, m and rad."""

    x: float
    y: float
    phi: float


@dataclass(frozen=True)
class Replay(InteractiveBlock):
    """A throw that is animated; without a program, it is seen at its end.

    Attributes
    ----------
    label : heading; empty for the only throw of a page.
    explained : whether a text says what the two drawings show.
    where : what the path is, and where on the sheet it is drawn.
    points : measured. path : that of the law.
    begin, end, step : of the slider, s.
    radius, ring : of the stone and of its contact ring, m.
    """

    template = "replay"
    data: ReplayData
    label: str
    explained: bool
    where: str
    view: View
    points: list[Point]
    path: list[Point]
    stone: StoneAt
    begin: float
    end: float
    step: float
    traces: list[Trace]
    rows: list[InstantRow]
    ring: float
    radius: float = STONE_RADIUS


@dataclass(frozen=True)
class RestsData:
    """What `rests.js` reads.

    Attributes
    ----------
    t : times, s. x, y, phi : by draw, at these times (m, rad). rest : of each draw, s.
    tee : where the tee is along y, m. inside : whether each draw touches the house.
    """

    t: Numbers
    x: list[Numbers]
    y: list[Numbers]
    phi: list[Numbers]
    rest: Numbers
    tee: float
    inside: list[bool]


@dataclass(frozen=True)
class Rests(InteractiveBlock):
    """Draws of a prediction, and where they come to rest.

    Attributes
    ----------
    number, number_inside : of draws, and of those in the house. used : draws of the
        prediction, most of which are not in the page.
    ends : resting positions, to the right and beyond the tee, m.
    house, close : what the two drawings show. half : half the height of the second, m.
    """

    template = "rests"
    data: RestsData
    number: int
    number_inside: int
    used: int
    ends: list[Point]
    house: View
    close: View
    half: float
    radius: float = STONE_RADIUS


def sheet_view(x: Sequence[float], y: Sequence[float]) -> View:
    """The part of the sheet to draw, thrown to the right, so that y goes to the right
    and x down: from hack to hack, and the whole path (m)."""
    low_y = min(0.0, *y) - _MARGIN
    high_y = max(TEE + LINES["tee"], *y) + _MARGIN
    low_x = min(-WIDTH / 2, *x) - _MARGIN / 2
    high_x = max(WIDTH / 2, *x) + _MARGIN / 2
    return View(low_y, low_x, high_y - low_y, high_x - low_x)


def rounded(values: Floats, places: int) -> Numbers:
    """Numbers rounded to decimal places; None where they are not finite."""
    return [
        float(round(value, places)) if math.isfinite(value) else None
        for value in np.asarray(values, float).tolist()
    ]


def replay_of_fit(
    fit: FitResult, id: str, label: str = "", *, explained: bool = True
) -> Replay | None:
    """The fitted throw; None if the record has no path, as with timed events alone."""
    if not fit.fitted or len(fit.observed["t"]) < 2:
        return None
    rows = some_rows(len(fit.observed["t"]), _MOST)
    what = "the law with the model discrepancy" if fit.discrepancy else "the fit"
    if fit.counts_from_hack or fit.events:
        shift_x = 0.0
        shift_y = 0.0
        where = f"The path is that of {what}, on the sheet as measured."
    else:
        shift_x = 0.0 - fit.parameters["x0"].value
        shift_y = LINES["hog"] - fit.parameters["y0"].value
        where = (
            f"The path is that of {what}, drawn from the near hog line, "
            "since the data do not say where on the sheet they were taken."
        )
    assumed = [name for name in _CHANNELS if _is_assumed(fit, name)]
    if assumed:
        meanings = join_words([_CHANNELS[name].meaning for name in assumed])
        where += f" Not determined, and drawn as assumed: {meanings}."
    path = {name: fit.predicted[name][rows] for name in _CHANNELS}
    path["x"] = path["x"] + shift_x
    path["y"] = path["y"] + shift_y
    points = []
    if {"x", "y"} <= fit.rms.keys():
        points = _finite_points(
            fit.observed["x"][rows] + shift_x, fit.observed["y"][rows] + shift_y
        )
    residuals = {
        name: fit.observed[name][rows] - fit.predicted[name][rows]
        for name in fit.residuals
    }
    return _replay(
        id=id,
        label=label,
        explained=explained,
        where=where,
        t=fit.observed["t"][rows],
        path=path,
        points=points,
        residuals=residuals,
        channels=[name for name in _CHANNELS if name not in assumed],
        ring=fit.stone.R,
    )


def _is_assumed(fit: FitResult, channel: str) -> bool:
    """Whether a channel was not measured, and the data do not say how it began."""
    if channel in fit.rms:
        return False
    start = _CHANNELS[channel].start
    return any(fit.parameters[name].verdict in _ASSUMED for name in start)


def replay_of_prediction(prediction: Prediction, id: str) -> Replay:
    """The predicted throw, to rest."""
    series = prediction.series
    # the rows in motion, and the first one at rest
    moving = series["t"] <= prediction.quantities["time"].value
    first_at_rest = np.cumsum(~moving) == 1
    rows = np.flatnonzero(moving | first_at_rest)
    rows = rows[some_rows(len(rows), _MOST)]
    points = []
    if {"x", "y"} <= prediction.measured.keys():
        points = _finite_points(prediction.measured["x"], prediction.measured["y"])
    return _replay(
        id=id,
        label="",
        explained=True,
        where="The path is that of the best estimate.",
        t=series["t"][rows],
        path={name: series[name][rows] for name in _CHANNELS},
        points=points,
        residuals={},
        channels=list(_CHANNELS),
        ring=prediction.stone.R,
    )


def _replay(
    *,
    id: str,
    label: str,
    explained: bool,
    where: str,
    t: Floats,
    path: dict[str, Floats],
    points: list[Point],
    residuals: dict[str, Floats],
    channels: list[str],
    ring: float,
) -> Replay:
    """The part of the page about one throw.

    Parameters
    ----------
    t : times, s.
    path, residuals : by channel, at these times; NaN in gaps of what was measured.
    channels : those that are shown as numbers.
    ring : radius of the contact ring, m.
    """
    residual_series = {}
    traces = []
    last_residuals = {}
    for name, values in residuals.items():
        if not np.isfinite(values).any():
            continue
        unit_size, unit = _residual_unit(values, name)
        scaled = values / unit_size
        reach = float(np.nanmax(np.abs(scaled))) or 1.0
        # a tenth of the largest residual to three digits
        numbers = rounded(scaled, min(decimals(reach / 10) + 1, 6))
        residual_series[name] = ResidualSeries(unit, numbers)
        if numbers[-1] is not None:
            last_residuals[name] = f"{numbers[-1]:+.3g} {unit}"
        across = (t - t[0]) / float(t[-1] - t[0])
        dots = _finite_points(across, -scaled / reach)
        traces.append(Trace(name, unit, f"{float(f'{reach:.2g}'):g}", dots))

    rows = []
    for name in channels:
        channel = _CHANNELS[name]
        row = InstantRow(
            name=name,
            meaning=channel.meaning,
            unit=channel.unit,
            value=float(path[name][-1]) / channel.unit_size,
            residual=last_residuals.get(name, ""),
        )
        rows.append(row)

    x = path["x"].tolist()
    y = path["y"].tolist()
    begin = float(t[0])
    end = float(t[-1])
    return Replay(
        id=id,
        data=ReplayData(
            t=rounded(t, 4),
            **{name: rounded(values, 5) for name, values in path.items()},
            residuals=residual_series,
        ),
        label=label,
        explained=explained,
        where=where,
        view=sheet_view(x, y),
        points=points,
        path=list(zip(x, y, strict=True)),
        stone=StoneAt(x[-1], y[-1], float(path["phi"][-1])),
        begin=begin,
        end=end,
        step=_slider_step(end - begin),
        traces=traces,
        rows=rows,
        ring=ring,
    )


def _residual_unit(residuals: Floats, channel: str) -> tuple[float, str]:
    """The unit that suits residuals of a channel: its size in SI, and its name."""
    finite = residuals[np.isfinite(residuals)]
    rms = float(np.sqrt(np.mean(finite**2)))
    return unit_for(max(rms, 1e-12), channel)


def _finite_points(x: Floats, y: Floats) -> list[Point]:
    """Points of which both coordinates are known."""
    finite = np.isfinite(x) & np.isfinite(y)
    return list(zip(x[finite].tolist(), y[finite].tolist(), strict=True))


def _slider_step(span: float) -> float:
    """Step of the slider over a span, s: 100 to 1000 steps in the whole."""
    return float(10.0 ** math.floor(math.log10(max(span, 1e-3) / 100)))


def rests_of(prediction: Prediction, id: str) -> Rests | None:
    """The throws of the posterior sample; None for a record without one."""
    sample = prediction.sample
    if not sample:
        return None
    x = sample["x"]
    y = sample["y"]
    # to the right and beyond the tee, m, shape (draws, 2)
    ends = np.stack([x[:, -1], y[:, -1] - TEE], 1)
    in_house = np.hypot(*ends.T) < HOUSE + STONE_RADIUS
    # the house with all draws, and in the close view the draws alone; x to the right
    # and y up, where svg counts down
    reach = HOUSE + _BEYOND
    low = np.minimum(ends.min(0) - _BEYOND, -reach)
    high = np.maximum(ends.max(0) + _BEYOND, reach)
    middle = np.median(ends, axis=0)
    half = max(_SMALLEST, _CLOSE * float(np.abs(ends - middle).max()))
    return Rests(
        id=id,
        data=RestsData(
            t=rounded(sample["t"], 3),
            x=[rounded(row, 4) for row in x],
            y=[rounded(row, 4) for row in y],
            phi=[rounded(row, 3) for row in sample["phi"]],
            rest=rounded(sample["rest"], 3),
            tee=TEE,
            inside=in_house.tolist(),
        ),
        number=len(x),
        number_inside=int(in_house.sum()),
        used=prediction.draws["used"],
        ends=ends.tolist(),
        house=View(low[0], -high[1], high[0] - low[0], high[1] - low[1]),
        close=View(middle[0] - half, -middle[1] - half, 2 * half, 2 * half),
        half=half,
    )
