"""Throws animated in the page: a path on the sheet with residuals, and draws of
a prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from curlfit.html_report.blocks import Block
from curlfit.inference.fit.result import FitResult
from curlfit.inference.verdict import Verdict
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
_NAMES = {
    "x": ("to the right", "m"),
    "y": ("along the sheet", "m"),
    "phi": ("angle", "turns"),
    "speed": ("speed", "m/s"),
    "omega": ("spin", "rad/s"),
}
_STARTS = {"x": ("x0", "heading"), "phi": ("phi0", "omega0"), "omega": ("omega0",)}
_ASSUMED = (Verdict.FIXED, Verdict.NOT_IDENTIFIABLE)
_TURN = {"phi": 2 * math.pi}
_MARGIN = 0.4  # m around what is drawn of the sheet


def sheet_view(
    x: Sequence[float], y: Sequence[float]
) -> tuple[float, float, float, float]:
    """The part of the plane to draw, thrown to the right: smallest y and x, and the
    extents of both, m; it contains the sheet from hack to hack, and the path."""
    low_y = min(0.0, *y) - _MARGIN
    high_y = max(TEE + LINES["tee"], *y) + _MARGIN
    low_x = min(-WIDTH / 2, *x) - _MARGIN / 2
    high_x = max(WIDTH / 2, *x) + _MARGIN / 2
    return low_y, low_x, high_y - low_y, high_x - low_x


def rounded(values: Floats, places: int) -> list[float | None]:
    """Numbers rounded to decimal places; None where they are not finite."""
    return [
        float(round(value, places)) if math.isfinite(value) else None
        for value in np.asarray(values, float).tolist()
    ]


def replay_of_fit(
    fit: FitResult, id: str, label: str = ""
) -> tuple[Block, dict[str, Any]] | None:
    """The fitted throw; None if the record has no path, as with timed events alone."""
    if not fit.fitted or len(fit.observed["t"]) < 2:
        return None
    rows = some_rows(len(fit.observed["t"]), _MOST)
    what = "the law with the model discrepancy" if fit.discrepancy else "the fit"
    if fit.counts_from_hack or fit.events:
        shift = {"x": 0.0, "y": 0.0}
        where = f"The path is that of {what}, on the sheet as measured."
    else:
        shift = {
            "x": 0.0 - fit.parameters["x0"].value,
            "y": LINES["hog"] - fit.parameters["y0"].value,
        }
        where = (
            f"The path is that of {what}, drawn from the near hog line, "
            "since the data do not say where on the sheet they were taken."
        )
    assumed = [channel for channel in _STARTS if _is_assumed(fit, channel)]
    if assumed:
        meanings = join_words([_NAMES[channel][0] for channel in assumed])
        where += f" Not determined, and drawn as assumed: {meanings}."
    path = {channel: fit.predicted[channel][rows] for channel in _NAMES}
    for channel, distance in shift.items():
        path[channel] = path[channel] + distance
    measured = {
        channel: fit.observed[channel][rows] + shift[channel]
        for channel in shift
        if channel in fit.rms
    }
    residuals = {
        channel: fit.observed[channel][rows] - fit.predicted[channel][rows]
        for channel in fit.residuals
    }
    known = [channel for channel in _NAMES if channel not in assumed]
    thrown = _Thrown(fit.observed["t"][rows], path, measured, residuals, fit.stone.R)
    return thrown.replay(id, label, where, known)


def _is_assumed(fit: FitResult, channel: str) -> bool:
    """Whether a channel was not measured, and the data do not say how it began."""
    if channel in fit.rms:
        return False
    return any(fit.parameters[name].verdict in _ASSUMED for name in _STARTS[channel])


def replay_of_prediction(
    prediction: Prediction, id: str
) -> tuple[Block, dict[str, Any]]:
    """The predicted throw, to rest."""
    series = prediction.series
    moving = series["t"] <= prediction.quantities["time"].value
    first_at_rest = np.cumsum(~moving) == 1
    rows = np.flatnonzero(moving | first_at_rest)
    rows = rows[some_rows(len(rows), _MOST)]
    path = {channel: series[channel][rows] for channel in _NAMES}
    measured = {
        channel: values
        for channel, values in prediction.measured.items()
        if channel in ("x", "y")
    }
    thrown = _Thrown(series["t"][rows], path, measured, {}, prediction.stone.R)
    return thrown.replay(id, "", "The path is that of the best estimate.", list(_NAMES))


class _Thrown(NamedTuple):
    """A throw that is animated.

    Attributes
    ----------
    t : times, s.
    path : by channel, at these times.
    measured : points of the path by channel, drawn where there are x and y.
    residuals : by channel, at these times.
    ring : radius of the contact ring, m.
    """

    t: Floats
    path: dict[str, Floats]
    measured: dict[str, Floats]
    residuals: dict[str, Floats]
    ring: float

    def replay(
        self, id: str, label: str, where: str, channels: list[str]
    ) -> tuple[Block, dict[str, Any]]:
        """The part of the page, which shows some channels as numbers, and its data."""
        residuals: dict[str, Any] = {}
        traces = []
        for channel, values in self.residuals.items():
            if np.isfinite(values).any():
                residuals[channel], trace = self._trace(channel, values)
                traces.append(trace)
        data: dict[str, Any] = {"kind": "replay", "t": rounded(self.t, 4)}
        for channel, values in self.path.items():
            data[channel] = rounded(values, 5)
        data["residuals"] = residuals
        points = []
        if {"x", "y"} <= self.measured.keys():
            points = _points(self.measured["x"], self.measured["y"])
        end = {channel: float(self.path[channel][-1]) for channel in _NAMES}
        rows = []
        for channel in channels:
            meaning, unit = _NAMES[channel]
            rows.append(
                {
                    "name": channel,
                    "meaning": meaning,
                    "unit": unit,
                    "value": end[channel] / _TURN.get(channel, 1.0),
                    "residual": _last(residuals.get(channel)),
                }
            )
        x = self.path["x"].tolist()
        y = self.path["y"].tolist()
        begin = float(self.t[0])
        end_time = float(self.t[-1])
        block = Block(
            "replay",
            {
                "id": id,
                "label": label,
                "explained": id.endswith("-0"),
                "where": where,
                "view": sheet_view(x, y),
                "points": points,
                "path": list(zip(x, y, strict=True)),
                "end": end,
                "from": begin,
                "to": end_time,
                "step": _step(end_time - begin),
                "traces": traces,
                "rows": rows,
                "radius": STONE_RADIUS,
                "ring": self.ring,
            },
        )
        return block, data

    def _trace(
        self, channel: str, values: Floats
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Residuals of a channel as numbers, in a unit that suits their size, and as
        dots over time: 0 to 1 across, and down -1 to 1."""
        finite = values[np.isfinite(values)]
        rms = float(np.sqrt(np.mean(finite**2)))
        size, unit = unit_for(max(rms, 1e-12), channel)
        scaled = values / size
        reach = float(np.nanmax(np.abs(scaled))) or 1.0
        places = min(decimals(reach / 10) + 1, 6)
        numbers = {"unit": unit, "values": rounded(scaled, places)}
        across = (self.t - self.t[0]) / float(self.t[-1] - self.t[0])
        trace = {
            "name": channel,
            "unit": unit,
            "reach": f"{float(f'{reach:.2g}'):g}",
            "dots": _points(across, -scaled / reach),
            "color": DATA_COLOR,
        }
        return numbers, trace


def _points(x: Floats, y: Floats) -> list[tuple[float, float]]:
    """Points whose coordinates are both known."""
    known = np.isfinite(x) & np.isfinite(y)
    return list(zip(x[known].tolist(), y[known].tolist(), strict=True))


def _last(residuals: dict[str, Any] | None) -> str:
    """The last residual with its unit; empty where there is none."""
    if residuals is None or residuals["values"][-1] is None:
        return ""
    return f"{residuals['values'][-1]:+.3g} {residuals['unit']}"


def _step(span: float) -> float:
    """Step of the slider, s: 100 to 1000 steps in the whole."""
    return float(10.0 ** math.floor(math.log10(max(span, 1e-3) / 100)))


def rests_of(prediction: Prediction, id: str) -> tuple[Block, dict[str, Any]] | None:
    """The throws of the posterior sample; None for a record without one."""
    sample = prediction.sample
    if not sample:
        return None
    x = sample["x"]
    y = sample["y"]
    # to the right and beyond the tee, m, shape (draws, 2)
    ends = np.stack([x[:, -1], y[:, -1] - TEE], 1)
    in_house = np.hypot(*ends.T) < HOUSE + STONE_RADIUS
    # the house with all draws, and in the close view the draws alone
    reach = HOUSE + _BEYOND
    low = np.minimum(ends.min(0) - _BEYOND, -reach)
    high = np.maximum(ends.max(0) + _BEYOND, reach)
    middle = np.median(ends, axis=0)
    half = max(_SMALLEST, _CLOSE * float(np.abs(ends - middle).max()))
    data = {
        "kind": "rests",
        "t": rounded(sample["t"], 3),
        "x": [rounded(row, 4) for row in x],
        "y": [rounded(row, 4) for row in y],
        "phi": [rounded(row, 3) for row in sample["phi"]],
        "rest": rounded(sample["rest"], 3),
        "tee": TEE,
        "inside": in_house.tolist(),
    }
    block = Block(
        "rests",
        {
            "id": id,
            "number": len(x),
            "ends": ends.tolist(),
            "inside": int(in_house.sum()),
            "view": (low[0], -high[1], high[0] - low[0], high[1] - low[1]),
            "close": (middle[0] - half, -middle[1] - half, 2 * half, 2 * half),
            "radius": STONE_RADIUS,
            "half": half,
            "used": prediction.draws["used"],
        },
    )
    return block, data
