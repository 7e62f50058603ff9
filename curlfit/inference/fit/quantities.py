"""Quantities usually quoted for a throw, from the fitted path within the record: curl,
turns, times between lines and mean friction; with errors to first order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.friction import Parameter
from curlfit.inference.derived.assessed import assessed
from curlfit.inference.derived.quantity import Derived, with_quantiles
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.systematics import with_condition_off
from curlfit.inference.model.conditions import CONDITIONS
from curlfit.inference.model.likelihood import predict_channels
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.sheet import HOUSE, LINES, TEE
from curlfit.stone import GRAVITY
from curlfit.throws.events import Event, event_arrays

_STEP = 1e-4  # of a typical size, of differences: the path is accurate to 1e-7 m
_FARTHER = 1e-2  # of the typical size of a condition, which changes the path less
_PRECISION = 1e-7  # of the path, m and rad
_ROUNDING = 1e-7  # of the largest derivative by typical sizes; less is rounding error
_NEAR = 0.05  # m by which the ends of a record may miss a line
_BEYOND = 1.0  # s by which a line may be crossed before or after the record
_DRAWS = 400  # of the posterior
_TRIED = 40  # draws that are tested for linearity in the parameters
_LINEAR = 0.03  # sd by which they may be off


class _Motion(NamedTuple):
    """A path within the record, at evenly spaced times: on the true clock, in the
    lengths of the data."""

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

        at_rest = np.flatnonzero(self.speed <= 0)
        rows = int(at_rest[0]) + 1 if len(at_rest) else len(self.t)
        rows = max(rows, 4)  # which a cubic needs
        first = self.t[0]
        last = self.t[rows - 1]
        times = CubicSpline(self.t[:rows], self.y[:rows]).solve(LINES[line])
        outside = np.maximum(times - last, 0) + np.maximum(first - times, 0)
        if len(times) and outside.min() < _BEYOND:
            return float(times[np.argmin(outside)])
        return math.nan

    def time_between(self, first: str, second: str) -> float:
        """Time from one line to another, s; NaN where it does not cross both."""
        return self.time_at(second) - self.time_at(first)

    def curl(self, line: str | None = None) -> float:
        """Distance to the right of the line along the initial velocity, m, at a line of
        the sheet or at the last row."""
        across = (self.x - self.x[0]) * math.cos(self.heading)
        along = (self.y - self.y[0]) * math.sin(self.heading)
        right = across - along
        if line is None:
            return float(right[-1])
        from scipy.interpolate import CubicSpline  # as in `time_at`

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
    """A quantity of the path that exists at the best estimate; `of` is NaN of a motion
    near it that lacks the quantity."""

    name: str
    meaning: str
    unit: str
    of: Callable[[_Motion], float]


class _Path:
    """The path of a fit within its record, as a function of parameters
    and conditions."""

    def __init__(self, fit: FitResult) -> None:
        self._model = fit.model
        self._heading = list(fit.parameters).index("heading")
        problem = problem_of(fit)
        # As many rows as the fit had, so that no other program is compiled.
        times = np.linspace(0.0, problem.times[-1], len(problem.times))
        rests = fit.fitted["speed"][-1] <= 0
        rest = Event("rest", "time", 0.0, 1.0)
        self._problem = problem._replace(
            times=times,
            weight=np.zeros_like(problem.weight),
            events=event_arrays([rest]) if rests else None,
        )

    def at(self, values: Floats, off: Mapping[str, float] | None = None) -> _Motion:
        """The path of a parameter vector where conditions are off by so much; all times
        are on the true clock."""
        problem = self._problem
        for condition, by in (off or {}).items():
            # a change of `time_scale` moves the rows, and the time of rest is true
            problem = with_condition_off(problem, condition, by)._replace(
                events=problem.events
            )
        path = predict_channels(self._model, values, problem)
        x, y, phi, speed, _ = path[:5]
        # The only event, in the row after the channels, is the rest.
        rest = math.inf if problem.events is None else float(path[5, 0])
        heading = float(values[self._heading])
        return _Motion(np.asarray(problem.times), x, y, phi, speed, heading, rest)


def quantities_of(fit: FitResult, chain: Any = None) -> dict[str, Derived]:
    """The quantities that a record determines, by name; none of a fit without its
    curves, as those of a batch are.

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
    path = _Path(fit)
    best = path.at(fit.values)
    if not np.isfinite(best.y).all():
        return {}
    definitions = _definitions(fit, best)
    if not definitions:
        return {}
    first_order = fit.first_order
    parameters = fit.parameter_set
    # The calibration of lengths does not change the motion.
    conditions = [
        condition for condition in CONDITIONS if condition.name in first_order.widths
    ]
    values, gradients = _values_and_gradients(path, fit, definitions, conditions)
    names = parameters.names_where(parameters.free)
    by_parameter, by_condition = np.split(gradients, [len(names)], axis=1)
    names_of_conditions = [condition.name for condition in conditions]
    widths = np.array([first_order.widths[name] for name in names_of_conditions])
    samples = None
    if chain is not None and len(chain.flat):
        steps = (chain.flat - fit.values)[:, parameters.free]
        linear = values + steps @ by_parameter.T
        samples = _samples(path, chain.flat, definitions, linear)
    quantities = {}
    for row, definition in enumerate(definitions):
        if not np.isfinite([values[row], *gradients[row]]).all():
            continue
        changes = widths * by_condition[row]
        quantity = assessed(
            first_order,
            definition.name,
            float(values[row]),
            dict(zip(names, by_parameter[row].tolist(), strict=True)),
            dict(zip(names_of_conditions, changes.tolist(), strict=True)),
            held_counts=False,
        )
        # Under a law that cannot curl a stone, the path contains no information
        # on the curl.
        is_told = quantity.stderr is not None and quantity.stderr > _PRECISION
        if not (quantity.verdict.is_known and is_told):
            continue
        if samples is not None:
            quantity = with_quantiles(quantity, samples[:, row])
        quantities[definition.name] = replace(
            quantity, meaning=definition.meaning, unit=definition.unit
        )
    return quantities


def _values_and_gradients(
    path: _Path,
    fit: FitResult,
    definitions: Sequence[_Definition],
    conditions: Sequence[Parameter],
) -> tuple[Floats, Floats]:
    """Quantities at the estimates, and their derivatives by the free parameters and
    then by the conditions, shape (quantities, free parameters and conditions)."""
    parameters = fit.parameter_set
    count = len(parameters)
    names = [condition.name for condition in conditions]

    def quantities(point: Floats) -> Floats:
        """At the parameters and then the conditions, each over its assumed value."""
        off = zip(names, point[count:], strict=True)
        motion = path.at(point[:count], {name: by for name, by in off if by})
        return _values(definitions, motion)

    point = np.append(fit.values, np.zeros(len(names)))
    sizes_of_conditions = [condition.typical for condition in conditions]
    typical = np.append(parameters.typical, sizes_of_conditions)
    steps = np.repeat([_STEP, _FARTHER], [count, len(names)])
    moves = np.append(parameters.free, np.ones(len(names), bool))
    gradients = slopes(quantities, point, steps * typical, moves)
    sizes = np.abs(gradients) * typical[moves]
    largest = sizes.max(-1, keepdims=True, initial=0.0)
    gradients[sizes < _ROUNDING * largest] = 0.0
    return quantities(point), gradients


def _samples(
    path: _Path, flat: Floats, definitions: Sequence[_Definition], linear: Floats
) -> Floats:
    """Draws of the quantities, shape (draws, quantities): from all samples to
    first order where that agrees with the paths of some of them, otherwise from
    the paths of more.

    Parameters
    ----------
    flat : samples of the parameters, shape (draws, parameters).
    linear : the quantities to first order at each of them.
    """

    def evenly(number: int) -> NDArray[np.int64]:
        """Evenly spaced rows of the samples, each once."""
        return np.unique(np.linspace(0, len(flat) - 1, number).astype(int))

    def by_paths(rows: NDArray[np.int64]) -> Floats:
        return np.array([_values(definitions, path.at(flat[row])) for row in rows])

    rows = evenly(_TRIED)
    errors = np.abs(by_paths(rows) - linear[rows])
    if (errors < _LINEAR * linear.std(axis=0)).all():
        return linear
    return by_paths(evenly(_DRAWS))


def _values(definitions: Sequence[_Definition], motion: _Motion) -> Floats:
    """The quantities of a motion."""
    return np.array([definition.of(motion) for definition in definitions])


def _definitions(fit: FitResult, best: _Motion) -> list[_Definition]:
    """Quantities that the measured channels and the lines crossed determine."""
    measured = set(fit.rms)
    rests = best.rest <= best.t[-1]
    passed = set()
    if "y" in measured and fit.counts_from_hack:
        low = best.y.min() - _NEAR
        high = best.y.max() + _NEAR
        lines = ("hog", "far-hog", "far-tee")
        passed = {line for line in lines if low <= LINES[line] <= high}
    until = "until rest" if rests else "over the record"
    definitions = []
    if "y" in measured or "speed" in measured:
        meaning = f"mean deceleration / g, {until}"
        definitions.append(
            _Definition("friction", meaning, "1", lambda motion: motion.friction)
        )
    if "x" in measured and "y" in measured:
        tee = None
        where = "at rest" if rests else "at the end of the record"
        if "far-tee" in passed:
            tee = "far-tee"
            where = "at the tee line"
        meaning = f"curl to the right, {where}"
        definitions.append(
            _Definition("curl", meaning, "m", lambda motion: motion.curl(tee))
        )
    if "phi" in measured or "omega" in measured:
        meaning = f"turns counter-clockwise, {until}"
        definitions.append(
            _Definition("turns", meaning, "1", lambda motion: motion.turns)
        )
    if {"hog", "far-hog"} <= passed:
        definitions.append(
            _Definition(
                "hog_to_hog",
                "hog line to hog line",
                "s",
                lambda motion: motion.time_between("hog", "far-hog"),
            )
        )
    if {"hog", "far-tee"} <= passed:
        definitions.append(
            _Definition(
                "hog_to_tee",
                "near hog line to tee line",
                "s",
                lambda motion: motion.time_between("hog", "far-tee"),
            )
        )
    if "hog" in passed and rests and abs(best.y[-1] - TEE) < HOUSE:
        definitions.append(
            _Definition(
                "draw_time",
                "near hog line to rest in the house",
                "s",
                lambda motion: motion.rest - motion.time_at("hog"),
            )
        )
    return definitions
