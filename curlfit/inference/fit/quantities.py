"""Quantities usually quoted for a throw, from the fitted path within the record: curl, turns, times
between lines and mean friction; with first-order errors by finite differences of the path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.derived import Derived, with_quantiles
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.systematics import with_condition_off
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.sheet import HOUSE, LINES, TEE
from curlfit.stone import GRAVITY
from curlfit.throws.events import Event, event_arrays

_STEP = 1e-4  # of a typical size, for finite differences: the path is accurate to 1e-7 m
_LINEAR_RANGE = 0.03  # of typical sizes
_PRECISION = 1e-7  # of the path, m and rad
_NEAR = 0.05  # m by which the ends of a record may miss a line
_DRAWS = 400  # of the posterior
_TRIED, _LINEAR = 40, 0.03  # draws tested for linearity in the parameters, tolerance in sd
_SHOWN = ("determined", "prior")


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

    def time_at(self, y: float) -> float:
        """Time at which the path crosses a line, s; NaN where it does not."""
        from scipy.interpolate import CubicSpline  # slow to load, and few fits need it

        n = max(int(np.argmin(self.speed > 0)) + 1 if (self.speed <= 0).any() else len(self.t), 4)
        roots = CubicSpline(self.t[:n], self.y[:n]).solve(y)
        late = np.maximum(roots - self.t[n - 1], 0) + np.maximum(self.t[0] - roots, 0)
        return float(roots[np.argmin(late)]) if len(roots) and late.min() < 1.0 else math.nan

    def curl_at(self, t: float) -> float:
        """Distance to the right of the line along the initial velocity, m."""
        from scipy.interpolate import CubicSpline

        return self._right_of_line(*CubicSpline(self.t, np.stack([self.x, self.y]), axis=1)(t))

    @property
    def curl(self) -> float:
        """The same at the last row."""
        return self._right_of_line(self.x[-1], self.y[-1])

    def _right_of_line(self, x: float, y: float) -> float:
        s, c = math.sin(self.heading), math.cos(self.heading)
        return float((x - self.x[0]) * c - (y - self.y[0]) * s)

    @property
    def friction(self) -> float:
        """Mean deceleration over g, until rest or the last row."""
        time = min(self.rest, float(self.t[-1]))
        end = 0.0 if self.rest <= self.t[-1] else float(self.speed[-1])
        return (float(self.speed[0]) - end) / (GRAVITY * time)


class _Definition(NamedTuple):
    """A quantity of the path."""

    name: str
    meaning: str
    unit: str
    of: Callable[[_Motion], float]


class _Path:
    """The path of a fit within its record, as a function of parameters and conditions."""

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        problem, origin = problem_of(fit)
        self._offset, self._place = origin.offset(len(fit.parameters)), origin.place
        # As many rows as the fit had, so that no other program is compiled.
        times = np.linspace(0.0, fit.observed["t"][-1] - origin.t, len(problem.times))
        rests = fit.fitted["speed"][-1] <= 0
        rest = Event("rest", "time", 0.0, 1.0)
        self.problem = problem._replace(
            times=times, weight=np.zeros_like(problem.weight),
            events=event_arrays([rest], 0.0) if rests else None,
        )  # fmt: skip

    def with_condition_off(self, condition: str, by: float) -> Problem:
        """The problem with a condition changed by `by`, and all times on the true clock: a change
        of `time_scale` moves the rows, and the time of rest is not scaled to the measured clock."""
        return with_condition_off(self.problem, condition, by)._replace(events=self.problem.events)

    def at(self, values: Floats, problem: Problem | None = None) -> _Motion:
        """The path of a parameter vector, in the coordinates of the data."""
        problem = self.problem if problem is None else problem
        found = np.asarray(predict_channels(self.fit.model, values - self._offset, problem))
        x, y, phi, speed, _ = found[:5] + self._place[:, None]
        names = list(self.fit.parameters)
        heading = values[names.index("heading")]
        rest = math.inf if problem.events is None else float(found[5, 0])
        return _Motion(np.asarray(problem.times), x, y, phi, speed, float(heading), rest)


def quantities_of(fit: FitResult, chain: Any = None) -> dict[str, Derived]:
    """The quantities that a record determines, by name.

    Curl is the distance from the straight line along the velocity at the first row, positive to the
    right. Lines of the sheet are used where y is measured from the hack and the record crosses
    them.

    Parameters
    ----------
    chain : a posterior sample of the fit, for quantiles.
    """
    scaled = {"length_scale", "time_scale"} & set(fit.conditions)
    if not fit.converged or scaled or not fit.fitted:
        return {}
    path, known = _Path(fit), fit.first_order
    best = path.at(fit.values)
    if not np.isfinite(best.y).all():
        return {}
    wanted = _definitions(fit, best)
    free = fit.parameter_set.free

    def change(moved: _Motion, back: _Motion, over: float) -> Floats:
        return np.array([(item.of(moved) - item.of(back)) / over for item in wanted])

    slopes = {}
    for index, (name, parameter) in enumerate(fit.parameters.items()):
        if free[index]:
            step = np.zeros(len(fit.values))
            step[index] = _STEP * parameter.typical
            moved, back = path.at(fit.values + step), path.at(fit.values - step)
            slopes[name] = change(moved, back, 2 * step[index])
    movable = [list(fit.parameters).index(name) for name in known.names]
    typical = np.array([fit.parameters[name].typical for name in known.names])
    shifted = {}
    for condition, width in known.widths.items():
        shift = known.shift(condition)
        # The shift along a weakly determined direction may be far outside the linear range.
        small = min(1.0, _LINEAR_RANGE / max(np.abs(shift / typical).max(initial=0.0), 1e-9))
        along_it = np.zeros(len(fit.values))
        along_it[movable] = small * shift
        moved, back = (
            path.at(
                fit.values + sign * along_it,
                path.with_condition_off(condition, sign * small * width),
            )
            for sign in (1, -1)
        )
        # `assess` adds the first-order effect of the shift of the parameters
        whole = change(moved, back, 2 * small)
        along = sum(slopes[name] * by for name, by in zip(known.names, shift, strict=True))
        shifted[condition] = whole - along
    samples = _samples(path, chain, wanted, best, slopes)
    found = {}
    for row, item in enumerate(wanted):
        gradient = {name: float(slope[row]) for name, slope in slopes.items()}
        changes = {name: float(by[row]) for name, by in shifted.items()}
        numbers = (item.of(best), *gradient.values(), *changes.values())
        if not all(map(math.isfinite, numbers)):
            continue
        one = known.assess(item.name, numbers[0], gradient, changes, held_counts=False)
        # Under a law that cannot curl a stone, the path contains no information on the curl.
        if one.verdict in _SHOWN and one.stderr is not None and one.stderr > _PRECISION:
            one = with_quantiles(one, samples[row]) if samples is not None else one
            found[item.name] = replace(one, meaning=item.meaning, unit=item.unit)
    return found


def _samples(
    path: _Path, chain: Any, wanted: list[_Definition], best: _Motion, slopes: dict[str, Floats]
) -> list[Floats] | None:
    """Draws of each quantity: from all samples to first order where that agrees with the paths of
    some of them, otherwise from the paths of more."""
    if chain is None or not len(chain.flat):
        return None
    flat = chain.flat
    names = list(path.fit.parameters)
    columns = [names.index(name) for name in slopes]
    change = flat[:, columns] - path.fit.values[columns]
    linear = np.array([item.of(best) for item in wanted]) + change @ np.array([*slopes.values()])

    def by_paths(number: int) -> tuple[Any, Floats]:
        rows = np.unique(np.linspace(0, len(flat) - 1, number).astype(int))
        motions = [path.at(flat[row]) for row in rows]
        return rows, np.array([[item.of(one) for item in wanted] for one in motions])

    rows, found = by_paths(_TRIED)
    if (np.abs(found - linear[rows]) < _LINEAR * linear.std(axis=0)).all():
        return list(linear.T)
    _, found = by_paths(_DRAWS)
    return [values[np.isfinite(values)] for values in found.T]


def _definitions(fit: FitResult, best: _Motion) -> list[_Definition]:
    """Quantities that the measured channels and the lines crossed determine."""
    seen, end = set(fit.rms), float(best.t[-1])
    rests = best.rest <= end
    until = "until rest" if rests else "over the record"
    found = []
    if seen & {"y", "speed"}:
        found.append(
            _Definition("friction", f"mean deceleration / g, {until}", "1", lambda m: m.friction)
        )
    passed: dict[str, float] = {}
    if "y" in seen and fit.counts_from_hack:
        low, high = best.y.min() - _NEAR, best.y.max() + _NEAR
        passed = {name: LINES[name] for name in ("hog", "far-hog", "far-tee")
                  if low <= LINES[name] <= high}  # fmt: skip
    if {"x", "y"} <= seen:
        at_tee = "far-tee" in passed
        where = "at the tee line" if at_tee else "at rest" if rests else "at the end of the record"
        found.append(
            _Definition(
                "curl", f"curl to the right, {where}", "m",
                (lambda m: m.curl_at(m.time_at(TEE))) if at_tee
                else (lambda m: m.curl),
            )
        )  # fmt: skip
    if seen & {"phi", "omega"}:
        found.append(
            _Definition(
                "turns", f"turns counter-clockwise, {until}", "1",
                lambda m: float(m.phi[-1] - m.phi[0]) / (2 * math.pi),
            )
        )  # fmt: skip
    if {"hog", "far-hog"} <= passed.keys():
        found.append(
            _Definition(
                "hog_to_hog", "hog line to hog line", "s",
                lambda m: m.time_at(LINES["far-hog"]) - m.time_at(LINES["hog"]),
            )
        )  # fmt: skip
    if {"hog", "far-tee"} <= passed.keys():
        found.append(
            _Definition(
                "hog_to_tee", "near hog line to tee line", "s",
                lambda m: m.time_at(TEE) - m.time_at(LINES["hog"]),
            )
        )  # fmt: skip
    if "hog" in passed and rests and abs(best.y[-1] - TEE) < HOUSE:
        found.append(
            _Definition(
                "draw_time", "near hog line to rest in the house", "s",
                lambda m: m.rest - m.time_at(LINES["hog"]),
            )
        )  # fmt: skip
    return found
