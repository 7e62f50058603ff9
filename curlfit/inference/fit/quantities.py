"""Quantities usually quoted for a throw, from the fitted path within the record: curl,
turns, times between lines and mean friction; with errors to first order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.conditions import CONDITIONS
from curlfit.inference.derived import Derived, with_quantiles
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.systematics import with_condition_off
from curlfit.inference.likelihood import predict_channels
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.sheet import HOUSE, LINES, TEE
from curlfit.stone import GRAVITY
from curlfit.throws.events import Event, event_arrays

_STEP = 1e-4  # of a typical size, of differences: the path is accurate to 1e-7 m
_FARTHER = 1e-2  # the same of conditions, which change it less
_PRECISION = 1e-7  # of the path, m and rad
_ROUNDING = 1e-7  # of the largest derivative by typical sizes; less is rounding error
_NEAR = 0.05  # m by which the ends of a record may miss a line
_DRAWS = 400  # of the posterior
# draws tested for linearity in the parameters, tolerance in sd
_TRIED, _LINEAR = 40, 0.03


class _Motion(NamedTuple):
    """A path within the record, at evenly spaced times."""

    t: Floats
    x: Floats
    y: Floats
    phi: Floats
    speed: Floats
    heading: float
    rest: float
    """s since the first row"""

    def time_at(self, line: str) -> float:
        """Time at which the path crosses a line, s; NaN where it does not."""
        from scipy.interpolate import CubicSpline  # slow to load, and few fits need it

        n = max(
            int(np.argmin(self.speed > 0)) + 1
            if (self.speed <= 0).any()
            else len(self.t),
            4,
        )
        roots = CubicSpline(self.t[:n], self.y[:n]).solve(LINES[line])
        late = np.maximum(roots - self.t[n - 1], 0) + np.maximum(self.t[0] - roots, 0)
        return (
            float(roots[np.argmin(late)])
            if len(roots) and late.min() < 1.0
            else math.nan
        )

    def curl(self, line: str | None = None) -> float:
        """Distance to the right of the line along the initial velocity, m, at a line of
        the sheet or at the last row."""
        s, c = math.sin(self.heading), math.cos(self.heading)
        right = (self.x - self.x[0]) * c - (self.y - self.y[0]) * s
        if line is None:
            return float(right[-1])
        from scipy.interpolate import CubicSpline

        return float(CubicSpline(self.t, right)(self.time_at(line)))

    @property
    def friction(self) -> float:
        """Mean deceleration over g, until rest or the last row."""
        time = min(self.rest, float(self.t[-1]))
        end = 0.0 if self.rest <= self.t[-1] else float(self.speed[-1])
        return (float(self.speed[0]) - end) / (GRAVITY * time)

    @property
    def turns(self) -> float:
        """Turns counter-clockwise."""
        return float(self.phi[-1] - self.phi[0]) / (2 * math.pi)


class _Definition(NamedTuple):
    """A quantity of the path."""

    name: str
    meaning: str
    unit: str
    of: Callable[[_Motion], float]


class _Path:
    """The path of a fit within its record, as a function of parameters
    and conditions."""

    def __init__(self, fit: FitResult) -> None:
        self._model, self._heading = fit.model, list(fit.parameters).index("heading")
        problem, origin = problem_of(fit)
        self._offset, self._place = origin.offset(len(fit.parameters)), origin.place
        # As many rows as the fit had, so that no other program is compiled.
        times = np.linspace(0.0, fit.observed["t"][-1] - origin.t, len(problem.times))
        rests = fit.fitted["speed"][-1] <= 0
        rest = Event("rest", "time", 0.0, 1.0)
        self._problem = problem._replace(
            times=times,
            weight=np.zeros_like(problem.weight),
            events=event_arrays([rest], 0.0) if rests else None,
        )

    def at(self, values: Floats, off: Mapping[str, float] | None = None) -> _Motion:
        """The path of a parameter vector where conditions are off by so much, in the
        coordinates of the data; all times are on the true clock."""
        problem = self._problem
        for condition, by in (off or {}).items():
            # a change of `time_scale` moves the rows, and the time of rest is true
            problem = with_condition_off(problem, condition, by)._replace(
                events=problem.events
            )
        found = np.asarray(
            predict_channels(self._model, values - self._offset, problem)
        )
        x, y, phi, speed, _ = found[:5] + self._place[:, None]
        rest = math.inf if problem.events is None else float(found[5, 0])
        heading = float(values[self._heading])
        return _Motion(np.asarray(problem.times), x, y, phi, speed, heading, rest)


def quantities_of(fit: FitResult, chain: Any = None) -> dict[str, Derived]:
    """The quantities that a record determines, by name.

    Curl is the distance from the straight line along the velocity at the first row,
    positive to the right. Lines of the sheet are used where y is measured from the hack
    and the record crosses them.

    Parameters
    ----------
    chain : a posterior sample of the fit, for quantiles.
    """
    scaled = {"length_scale", "time_scale"} & set(fit.conditions)
    # Times and places alone, without a channel, determine none of them.
    if not fit.converged or scaled or not fit.fitted or not fit.rms:
        return {}
    path, known = _Path(fit), fit.first_order
    best = path.at(fit.values)
    if not np.isfinite(best.y).all():
        return {}
    wanted, parameters = _definitions(fit, best), fit.parameter_set
    if not wanted:
        return {}
    # the calibration of lengths does not change the motion
    off = {item.name: item.typical for item in CONDITIONS if item.name in known.widths}
    p, free = len(parameters), parameters.free

    def at(point: Floats) -> Floats:
        motion = path.at(
            point[:p], {name: by for name, by in zip(off, point[p:], strict=True) if by}
        )
        return np.array([item.of(motion) for item in wanted])

    typical = np.append(parameters.typical, [*off.values()])
    where, steps = (
        np.append(free, np.ones(len(off), bool)),
        np.repeat([_STEP, _FARTHER], [p, len(off)]),
    )
    gradients = slopes(
        at, np.append(fit.values, 0 * typical[p:]), steps * typical, where
    )
    sizes = np.abs(gradients) * typical[where]
    gradients[sizes < _ROUNDING * sizes.max(-1, keepdims=True, initial=0.0)] = 0.0
    names = [*parameters.names_where(free), *off]
    values = at(np.append(fit.values, 0 * typical[p:]))
    samples = None
    if chain is not None and len(chain.flat):
        linear = (
            values
            + (chain.flat - fit.values)[:, free] @ gradients[:, : int(free.sum())].T
        )
        samples = _samples(path, chain.flat, wanted, linear)
    found = {}
    for row, (item, value, gradient) in enumerate(
        zip(wanted, values, gradients, strict=True)
    ):
        if not np.isfinite([value, *gradient]).all():
            continue
        by_name = dict(zip(names, map(float, gradient), strict=True))
        changes = {name: known.widths[name] * by_name.pop(name) for name in off}
        one = known.assess(item.name, float(value), by_name, changes, held_counts=False)
        # Under a law that cannot curl a stone, the path contains no information
        # on the curl.
        if one.verdict.is_known and one.stderr is not None and one.stderr > _PRECISION:
            one = with_quantiles(one, samples[:, row]) if samples is not None else one
            found[item.name] = replace(one, meaning=item.meaning, unit=item.unit)
    return found


def _samples(
    path: _Path, flat: Floats, wanted: list[_Definition], linear: Floats
) -> Floats:
    """Draws of the quantities, shape (draws, quantities): from all samples to
    first order where that agrees with the paths of some of them, otherwise from
    the paths of more."""

    def by_paths(number: int) -> tuple[Any, Floats]:
        rows = np.unique(np.linspace(0, len(flat) - 1, number).astype(int))
        motions = [path.at(flat[row]) for row in rows]
        return rows, np.array([[item.of(one) for item in wanted] for one in motions])

    rows, found = by_paths(_TRIED)
    if (np.abs(found - linear[rows]) < _LINEAR * linear.std(axis=0)).all():
        return linear
    _, found = by_paths(_DRAWS)
    return found


def _definitions(fit: FitResult, best: _Motion) -> list[_Definition]:
    """Quantities that the measured channels and the lines crossed determine."""
    seen, rests = set(fit.rms), best.rest <= best.t[-1]
    low, high = best.y.min() - _NEAR, best.y.max() + _NEAR
    counts = "y" in seen and fit.counts_from_hack
    passed = {
        name
        for name in ("hog", "far-hog", "far-tee")
        if counts and low <= LINES[name] <= high
    }
    until = "until rest" if rests else "over the record"
    tee = "far-tee" if "far-tee" in passed else None
    where = (
        "at the tee line" if tee else "at rest" if rests else "at the end of the record"
    )
    in_house = rests and abs(best.y[-1] - TEE) < HOUSE
    known = [
        (
            seen & {"y", "speed"},
            _Definition(
                "friction", f"mean deceleration / g, {until}", "1", lambda m: m.friction
            ),
        ),
        (
            {"x", "y"} <= seen,
            _Definition(
                "curl", f"curl to the right, {where}", "m", lambda m: m.curl(tee)
            ),
        ),
        (
            seen & {"phi", "omega"},
            _Definition(
                "turns", f"turns counter-clockwise, {until}", "1", lambda m: m.turns
            ),
        ),
        (
            {"hog", "far-hog"} <= passed,
            _Definition(
                "hog_to_hog",
                "hog line to hog line",
                "s",
                lambda m: m.time_at("far-hog") - m.time_at("hog"),
            ),
        ),
        (
            {"hog", "far-tee"} <= passed,
            _Definition(
                "hog_to_tee",
                "near hog line to tee line",
                "s",
                lambda m: m.time_at("far-tee") - m.time_at("hog"),
            ),
        ),
        (
            "hog" in passed and in_house,
            _Definition(
                "draw_time",
                "near hog line to rest in the house",
                "s",
                lambda m: m.rest - m.time_at("hog"),
            ),
        ),
    ]
    return [quantity for determined, quantity in known if determined]
