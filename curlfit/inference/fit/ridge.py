"""The ridge of a fit: values of the parameters that fit about as well as the optimum.

Where data hold fewer numbers than the law has parameters, chi squared is no quadratic:
without the angle only the product of a coefficient and the spin may be determined, and
the values that fit lie on a hyperbola. A sum of parameters that is constant along its
tangent is then no more determined than each of them.

The ridge is followed with one parameter held at values ever farther from its estimate,
while the others are refitted, until chi squared has risen by `HIGHEST` or a bound is
met. What a fit states of a parameter or of a sum is then compared with what these
points say: to first order, its value is within sqrt(rise) standard errors of the
estimate at all points where chi squared has risen by no more than that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.directions import r_factor, wide_errors
from curlfit.inference.information.ridge_information import demanded_errors
from curlfit.inference.information.thresholds import FAR_LESS, INTERVAL
from curlfit.inference.model.priors import Penalty
from curlfit.inference.solve.least_squares import Solution
from curlfit.numerics.arrays import Floats

HIGHEST = 10.83
"""Rise of chi squared at the ends of a 99.9 % interval, of one degree of freedom."""
_MOST_POINTS = 16
"""On either side: with steps that double, 30,000 times the first step."""
_GROWTH = 2.0
"""Of a step over that before."""
_TOWARD_ZERO = 4.0
"""By which a value is divided on its way to zero."""
_NEXT_TO_ZERO = 0.01
"""In typical sizes: from a smaller value the next step leads to zero."""
_FIRST_STEP = 0.1
"""In typical sizes, where the standard error is larger or not known."""
_FARTHEST = 1e3
"""In typical sizes: nothing is known of what may be as far away."""
_ROUNDING = 1e-9
"""Singular value over the largest, along which the other parameters do not follow."""


class Hold(NamedTuple):
    """A refit that the ridge asks for: one parameter held at a value, from a start."""

    fit: int
    """number of the fit"""
    parameter: int
    """index of it"""
    start: Floats
    """values of all parameters, with that of the held one"""


class Point(NamedTuple):
    """Values of the parameters, optimal but for one that is held, or an optimum."""

    values: Floats
    """shape (parameters,)"""
    slopes: Floats
    """R factor of the derivatives of the residuals over their sigma, those of priors
    among them, of at most as many rows as parameters"""
    chi_squared: float
    """with what the priors add to it"""
    held: int | None = None
    """index of the parameter that is held"""

    def errors(self, weights: Floats, sizes: Floats) -> Floats:
        """Standard errors of weighted sums of the parameters to first order here, with
        that one held; infinite where nothing is known of a sum.

        Parameters
        ----------
        weights : shape (sums, parameters).
        sizes : of the parameters; 0 of those that do not move.
        """
        sizes = np.array(sizes)
        if self.held is not None:
            sizes[self.held] = 0.0
        return wide_errors(self.slopes * sizes, weights * sizes)

    @classmethod
    def of(cls, solution: Solution, penalty: Penalty, held: int | None = None) -> Self:
        """The optimum of a throw, with what its priors add to chi squared."""
        values = np.asarray(solution.values)
        slopes = np.asarray(solution.jacobian).reshape(-1, len(values))
        priors = penalty.rows(values)[:, :-1]
        rows = r_factor(np.concatenate([slopes, priors]))
        return cls(values, rows, float(solution.objective), held)


Refit = Callable[[Sequence[Hold]], Sequence[Point]]
"""Carries out refits, in any number side by side."""


class Ridge(NamedTuple):
    """Points near which the data are fitted about as well as at the optimum."""

    optimum: Point
    points: tuple[Point, ...]
    rises: Floats
    """of chi squared from the optimum, at most `HIGHEST`, shape (points,)"""
    intervals: dict[int, tuple[float, float]]
    """by index of the parameters that were held, values between which chi squared rises
    by less than `INTERVAL`"""

    def stretches(self, weights: Floats, errors: Floats, sizes: Floats) -> Floats:
        """How many times as large the errors of weighted sums of the parameters are
        along the ridge as to first order at the optimum: by how far a sum moves, and by
        its error at points where far less is known of it.

        Parameters
        ----------
        weights : shape (sums, parameters).
        errors : of the sums to first order at the optimum.
        sizes : of the parameters; 0 of those that do not move.
        """
        largest = np.zeros(len(weights))
        for point, rise in zip(self.points, self.rises, strict=True):
            moved = np.abs(weights @ (point.values - self.optimum.values))
            largest = np.maximum(largest, demanded_errors(moved, rise) / errors)
            larger = point.errors(weights, sizes) / errors
            largest = np.where(larger > FAR_LESS, np.maximum(largest, larger), largest)
        return largest

    @classmethod
    def of_point(cls, optimum: Point) -> Self:
        """Of an optimum from which no ridge was followed."""
        return cls(optimum, (), np.zeros(0), {})

    def joined(self, other: Ridge) -> Ridge:
        """This ridge and another one of the same fit: about another solution, or one
        from which the search went on."""
        near: list[Point] = []
        rises: list[float] = []
        for point in (other.optimum, *other.points):
            rise = _rise(point, self.optimum)
            if rise <= HIGHEST:
                near.append(point)
                rises.append(rise)
        intervals = dict(other.intervals)
        for index, (low, high) in self.intervals.items():
            other_low, other_high = intervals.get(index, (low, high))
            intervals[index] = (min(low, other_low), max(high, other_high))
        return Ridge(
            self.optimum,
            (*self.points, *near),
            np.append(self.rises, rises),
            intervals,
        )

    def lowest(self) -> Point:
        """The point with the least chi squared."""
        return self.points[int(self.rises.argmin())]

    def nearest(self, usual: Floats, typical: Floats) -> Point:
        """The point with the most usual coefficients, the first parameters."""
        count = len(usual)
        return min(
            self.points,
            key=lambda point: np.sum(((point.values[:count] - usual) / typical) ** 2),
        )


class Followed(NamedTuple):
    """A fit whose ridge is to be followed."""

    optimum: Point
    lower: Floats
    upper: Floats
    typical: Floats
    stderr: dict[int, float]
    """of the parameters to be held by index, infinite where nothing is known"""


@dataclass
class _Side:
    """The points on one side of the estimate of a parameter."""

    number: int
    """of the fit"""
    fit: Followed
    index: int
    """of the parameter"""
    step: float
    """to the next point, in the unit of the parameter; negative toward lower values"""
    points: list[Point] = field(default_factory=list)
    goes_on: bool = True

    def next_hold(self) -> Hold:
        """The next value, and the others where the tangent at the last point leads."""
        last = self.points[-1] if self.points else self.fit.optimum
        value = self._after(float(last.values[self.index]))
        lower = self.fit.lower[self.index]
        upper = self.fit.upper[self.index]
        if not lower < value < upper:
            value = float(np.clip(value, lower, upper))
            self.goes_on = False
        return Hold(self.number, self.index, self._where_others_follow(last, value))

    def _after(self, value: float) -> float:
        """The next value of the parameter, whatever its bounds."""
        next_value = value + self.step
        if value == 0.0 or next_value * value > 0.0:
            return next_value
        # Toward zero in ratios, since what fits may be a product; there a sense of
        # spin, or the sign of a force, ends.
        is_near = abs(value) < _NEXT_TO_ZERO * self.fit.typical[self.index]
        return 0.0 if is_near else value / _TOWARD_ZERO

    def _where_others_follow(self, last: Point, value: float) -> Floats:
        """All parameters with a new value of the one that is held, where the others
        follow from the last point so that residuals change least to first order."""
        typical = self.fit.typical
        others = Bounded(last.values, self.fit.lower, self.fit.upper).free
        others[self.index] = False
        slopes = last.slopes * typical
        by_held = slopes[:, self.index] / typical[self.index]
        follow, *_ = np.linalg.lstsq(slopes[:, others], by_held, rcond=_ROUNDING)
        values = np.array(last.values)
        moved = value - values[self.index]
        values[others] -= moved * follow * typical[others]
        values = np.clip(values, self.fit.lower, self.fit.upper)
        values[self.index] = value
        return values

    def add(self, point: Point) -> None:
        """Add the refit at the value that was asked for."""
        self.points.append(point)
        optimum = self.fit.optimum
        far = abs(point.values[self.index] - optimum.values[self.index])
        self.goes_on &= (
            _rise(point, optimum) < HIGHEST
            and far < _FARTHEST * self.fit.typical[self.index]
            and len(self.points) < _MOST_POINTS
        )
        self.step *= _GROWTH

    def end_of_interval(self) -> float:
        """The value at which chi squared has risen by `INTERVAL`, between two points;
        the last value if it has not risen by so much."""
        value = float(self.fit.optimum.values[self.index])
        root = 0.0
        for point in self.points:
            next_value = float(point.values[self.index])
            rise = _rise(point, self.fit.optimum)
            next_root = math.sqrt(max(rise, 0.0))
            if rise >= INTERVAL:
                share = (math.sqrt(INTERVAL) - root) / (next_root - root)
                return value + share * (next_value - value)
            value = next_value
            root = next_root
        return value


def follow(fits: Sequence[Followed], refit: Refit) -> list[Ridge]:
    """Follow the ridges of fits, those of all fits and parameters side by side."""
    sides = []
    for number, fit in enumerate(fits):
        for index, stderr in fit.stderr.items():
            step = min(stderr, _FIRST_STEP * fit.typical[index])
            sides.append(_Side(number, fit, index, -step))
            sides.append(_Side(number, fit, index, step))
    going = sides
    while going:
        points = refit([side.next_hold() for side in going])
        for side, point in zip(going, points, strict=True):
            side.add(point)
        going = [side for side in going if side.goes_on]
    return [
        _ridge(fit, [side for side in sides if side.number == number])
        for number, fit in enumerate(fits)
    ]


def _ridge(fit: Followed, sides: Sequence[_Side]) -> Ridge:
    """The points of all sides of a fit that fit about as well as the optimum."""
    points = []
    rises = []
    ends: dict[int, list[float]] = {}
    for side in sides:
        ends.setdefault(side.index, []).append(side.end_of_interval())
        for point in side.points:
            rise = _rise(point, fit.optimum)
            if rise <= HIGHEST:
                points.append(point)
                rises.append(rise)
    intervals = {}
    for index, values in ends.items():
        # Values that another parameter leads to count as well.
        for point, rise in zip(points, rises, strict=True):
            if rise <= INTERVAL:
                values.append(float(point.values[index]))
        intervals[index] = (min(values), max(values))
    return Ridge(fit.optimum, tuple(points), np.array(rises), intervals)


def _rise(point: Point, optimum: Point) -> float:
    """Rise of chi squared from the optimum; infinite where there is no path."""
    rise = point.chi_squared - optimum.chi_squared
    return rise if math.isfinite(rise) else math.inf
