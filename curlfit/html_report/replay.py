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
    half = WIDTH / 2
    ends = min(0.0, *y) - _MARGIN, max(TEE + LINES["tee"], *y) + _MARGIN
    sides = min(-half, *x) - _MARGIN / 2, max(half, *x) + _MARGIN / 2
    return ends[0], sides[0], ends[1] - ends[0], sides[1] - sides[0]


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
    some = some_rows(len(fit.observed["t"]), _MOST)
    t = fit.observed["t"][some]
    path = {name: fit.predicted[name][some] for name in _NAMES}
    shift = np.array([0.0, 0.0])
    what = "the law with the model discrepancy" if fit.discrepancy else "the fit"
    if fit.counts_from_hack or fit.events:
        where = f"The path is that of {what}, on the sheet as measured."
    else:
        start = [fit.parameters[name].value for name in ("x0", "y0")]
        shift = np.array([0.0, LINES["hog"]]) - start
        where = (
            f"The path is that of {what}, drawn from the near hog line, "
            "since the data do not say where on the sheet they were taken."
        )
    assumed = [
        name
        for name, starts in _STARTS.items()
        if any(fit.parameters[start].verdict in _ASSUMED for start in starts)
        and name not in fit.rms
    ]
    if assumed:
        said = join_words([_NAMES[name][0] for name in assumed])
        where += f" Not determined, and drawn as assumed: {said}."
    measured = {
        name: fit.observed[name][some] + add
        for name, add in zip("xy", shift, strict=True)
        if name in fit.rms
    }
    path["x"], path["y"] = path["x"] + shift[0], path["y"] + shift[1]
    residuals = {
        name: fit.observed[name][some] - fit.predicted[name][some]
        for name in fit.residuals
    }
    shown = [name for name in _NAMES if name not in assumed]
    return _Thrown(t, path, measured, residuals, fit.stone.R).replay(
        id, label, where, shown
    )


def replay_of_prediction(
    prediction: Prediction, id: str
) -> tuple[Block, dict[str, Any]]:
    """The predicted throw, to rest."""
    series = prediction.series
    ends = series["t"] <= prediction.quantities["time"].value
    some = np.flatnonzero(ends | (np.cumsum(~ends) == 1))  # and one at rest
    some = some[some_rows(len(some), _MOST)]
    thrown = _Thrown(
        series["t"][some],
        {name: series[name][some] for name in _NAMES},
        {
            name: prediction.measured[name]
            for name in "xy"
            if name in prediction.measured
        },
        {},
        prediction.stone.R,
    )
    return thrown.replay(id, "", "The path is that of the best estimate.", list(_NAMES))


class _Thrown(NamedTuple):
    """What is shown of a throw: times, the path, and what was measured, by channel;
    residuals at these times; the radius of the contact ring."""

    t: Floats
    path: dict[str, Floats]
    measured: dict[str, Floats]
    residuals: dict[str, Floats]
    ring: float

    def replay(
        self, id: str, label: str, where: str, names: list[str]
    ) -> tuple[Block, dict[str, Any]]:
        """The part of the page, with the channels of these names as numbers."""
        t, path, residuals, traces = self.t, self.path, dict[str, Any](), []
        for name, values in self.residuals.items():
            if np.isfinite(values).any():
                residuals[name], trace = self._trace(name, values)
                traces.append(trace)
        data: dict[str, Any] = {"kind": "replay", "t": rounded(t, 4)}
        data |= {name: rounded(values, 5) for name, values in path.items()}
        data["residuals"] = residuals
        measured = (
            self.measured
            if {"x", "y"} <= self.measured.keys()
            else {"x": t[:0], "y": t[:0]}
        )
        shown = [
            {
                "name": name,
                "meaning": _NAMES[name][0],
                "unit": _NAMES[name][1],
                "value": float(path[name][-1]) / _TURN.get(name, 1.0),
                "residual": _last(residuals.get(name)),
            }
            for name in names
        ]
        block = Block(
            "replay",
            {
                "id": id,
                "label": label,
                "explained": id.endswith("-0"),
                "where": where,
                "view": sheet_view(path["x"].tolist(), path["y"].tolist()),
                "points": _points(measured["x"], measured["y"]),
                "path": list(zip(path["x"].tolist(), path["y"].tolist(), strict=True)),
                "end": {name: float(path[name][-1]) for name in _NAMES},
                "from": float(t[0]),
                "to": float(t[-1]),
                "step": _step(float(t[-1] - t[0])),
                "traces": traces,
                "rows": shown,
                "radius": STONE_RADIUS,
                "ring": self.ring,
            },
        )
        return block, data

    def _trace(
        self, name: str, values: Floats
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Residuals as numbers and as points over time, in a unit that
        suits their size."""
        finite = values[np.isfinite(values)]
        size, unit = unit_for(max(float(np.sqrt(np.mean(finite**2))), 1e-12), name)
        scaled = values / size
        reach = float(np.nanmax(np.abs(scaled))) or 1.0
        places = min(decimals(reach / 10) + 1, 6)
        dots = _points(
            (self.t - self.t[0]) / float(self.t[-1] - self.t[0]), -scaled / reach
        )
        return {"unit": unit, "values": rounded(scaled, places)}, {
            "name": name,
            "unit": unit,
            "reach": f"{float(f'{reach:.2g}'):g}",
            "dots": dots,
            "color": DATA_COLOR,
        }


def _points(x: Floats, y: Floats) -> list[tuple[float, float]]:
    """Points whose coordinates are both known."""
    known = np.isfinite(x) & np.isfinite(y)
    return list(zip(x[known].tolist(), y[known].tolist(), strict=True))


def _last(found: dict[str, Any] | None) -> str:
    value = None if found is None else found["values"][-1]
    return "" if found is None or value is None else f"{value:+.3g} {found['unit']}"


def _step(span: float) -> float:
    """Step of the slider, s: 100 to 1000 steps in the whole."""
    return float(10.0 ** math.floor(math.log10(max(span, 1e-3) / 100)))


def rests_of(prediction: Prediction, id: str) -> tuple[Block, dict[str, Any]] | None:
    """The throws of the posterior sample; None for a record without one."""
    sample = prediction.sample
    if not sample:
        return None
    x, y, phi = (sample[name] for name in ("x", "y", "phi"))
    ends = np.stack([x[:, -1], y[:, -1] - TEE], 1)
    inside = np.hypot(*ends.T) < HOUSE + STONE_RADIUS
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
        "phi": [rounded(row, 3) for row in phi],
        "rest": rounded(sample["rest"], 3),
        "tee": TEE,
        "inside": inside.tolist(),
    }
    block = Block(
        "rests",
        {
            "id": id,
            "number": len(x),
            "ends": ends.tolist(),
            "inside": int(inside.sum()),
            "view": (low[0], -high[1], high[0] - low[0], high[1] - low[1]),
            "close": (middle[0] - half, -middle[1] - half, 2 * half, 2 * half),
            "radius": STONE_RADIUS,
            "half": half,
            "used": prediction.draws["used"],
        },
    )
    return block, data
