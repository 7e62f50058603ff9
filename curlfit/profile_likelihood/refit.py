"""Constrained fits: some parameters fixed, all others fitted again with the same law and noise.

The fits run as one batch, each started from the nearest known one along the linear response of the
other parameters. Whether neighbours belong to one valley is checked by the envelope theorem: the
slope of the profile is the partial derivative of chi squared, known at each point, whose integral
has to match the difference of chi squared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.least_squares import Solution, Tasks, minimize_many
from curlfit.inference.parameters import ParameterSet
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import unstacked
from curlfit.profile_likelihood.result import levels_for

Progress = Callable[[int], None]
Point = tuple[float, ...]

_ROUNDS = 8
_BETTER = 1e-3  # decrease of chi squared that counts
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it
_ROUNDING = 1e-9  # of the largest singular value


class ConstrainedFit(NamedTuple):
    """An optimum with some parameters fixed."""

    held: Floats
    chi_squared: float
    values: Floats
    """all parameters"""
    slope: Floats
    """of chi squared by the fixed ones"""
    finished: bool


class Refit:
    """A fit to be repeated with parameters fixed, in the coordinates of its problem."""

    def __init__(self, fit: FitResult, progress: Progress | None) -> None:
        self.fit, self._progress, self.done = fit, progress, 0
        whole = fit.parameter_set
        self.problem, origin = problem_of(fit)
        self.offset = origin.offset(len(whole))
        self.parameters = whole.shifted(-self.offset)
        self.model = fit.model
        (solution,) = self._solved([(self.parameters, fit.values - self.offset)])
        if solution is None:
            raise UnusableFitError("the fit has no path")
        self.solution: Solution = solution
        self.first = self.chi_squared  # of the fit as it was given
        self.lowest: ConstrainedFit | None = None

    @property
    def chi_squared(self) -> float:
        """Of the best fit."""
        return float(self.solution.objective)

    @property
    def values(self) -> Floats:
        """Of the best fit."""
        return np.asarray(self.solution.values)

    def _solved(self, tasks: Iterable[tuple[ParameterSet, Floats]]) -> list[Solution | None]:
        work = Tasks.of((own, self.problem, start) for own, start in tasks)
        before = self.done

        def arrived(count: int) -> None:
            self.done = before + count
            if self._progress is not None:
                self._progress(self.done)

        found = minimize_many(self.model, work, progress=arrived, few=True)
        whole = np.isfinite(found.residual).all((1, 2))
        each = unstacked(found)
        return [one if there else None for one, there in zip(each, whole, strict=True)]

    def optima(
        self, names: Sequence[str], points: Floats, starts: Sequence[Floats]
    ) -> list[ConstrainedFit | None]:
        """The optima with `names` fixed at each of the points; None where there is no path."""
        tasks = []
        for point, start in zip(points, starts, strict=True):
            parameters = self.parameters
            for name, value in zip(names, point, strict=True):
                parameters = parameters.with_fixed(name, float(value))
            tasks.append((parameters, start))
        return [
            None if solution is None else self.optimum(names, solution)
            for solution in self._solved(tasks)
        ]

    def optimum(self, names: Sequence[str], solution: Solution) -> ConstrainedFit:
        """An optimum as a constrained fit."""
        index = [self.parameters.index(name) for name in names]
        slope = 2 * np.einsum("cn,cni->i", solution.residual, solution.jacobian)
        values = np.asarray(solution.values)
        if self.parameters.penalty is not None:
            residual, by_parameter = self.parameters.penalty.residual_and_slope(values)
            slope = slope + 2 * residual * by_parameter
        optimum = ConstrainedFit(
            values[index], float(solution.objective), values, slope[index],
            bool(solution.success),
        )  # fmt: skip
        if self.lowest is None or optimum.chi_squared < self.lowest.chi_squared:
            self.lowest = optimum
        return optimum

    def improved(self) -> bool:
        """Whether a better fit was found, which then replaces the fit."""
        if self.lowest is None or self.lowest.chi_squared > self.chi_squared - _BETTER:
            return False
        (solution,) = self._solved([(self.parameters, self.lowest.values)])
        if solution is None or solution.objective > self.chi_squared - _BETTER:
            return False
        self.solution, self.lowest = solution, None
        return True

    def at_bound(self, values: Floats) -> Booleans:
        """Which free parameters are at a bound."""
        near = _NEAR * self.parameters.typical
        low, high = self.parameters.lower, self.parameters.upper
        return self.parameters.free & ((values <= low + near) | (values >= high - near))

    def response(self, names: Sequence[str]) -> tuple[Floats, Floats]:
        """Response of other parameters to fixed ones, shape (parameters, fixed), and of residuals.

        The second is the norm of the derivative of the residuals by each fixed one, the others
        responding; its inverse is the standard error with the other fixed ones held.
        """
        index = [self.parameters.index(name) for name in names]
        moving = self.parameters.free & ~self.at_bound(self.values)
        moving[index] = False
        jacobian = np.asarray(self.solution.jacobian).reshape(-1, len(self.parameters))
        others, own = jacobian[:, moving], jacobian[:, index]
        size = np.linalg.norm(others, axis=0)
        size[size == 0] = 1.0
        follow = -np.linalg.lstsq(others / size, own, rcond=_ROUNDING)[0] / size[:, None]
        rows = np.zeros((len(self.parameters), len(index)))
        rows[moving], rows[index] = follow, np.eye(len(index))
        return rows, np.linalg.norm(own + others @ follow, axis=0)


class ConstrainedFits:
    """Known optima with some parameters fixed, by the fixed values."""

    def __init__(self, refit: Refit, names: Sequence[str]) -> None:
        self.refit, self.names = refit, tuple(names)
        self._response = refit.response(names)[0]
        best = refit.optimum(names, refit.solution)
        self.best = best
        self.known: dict[Point, ConstrainedFit | None] = {tuple(map(float, best.held)): best}
        self._tried: set[tuple[Point, Point, float]] = set()
        self._scale = np.array([refit.fit.parameters[name].typical for name in names])
        self.levels = levels_for(names, refit.fit.parameters)

    def at(self, points: Floats) -> list[ConstrainedFit | None]:
        """The fits at points, shape (..., held), each made from the nearest that was known."""
        keys = list(map(tuple, points.reshape(-1, len(self.names)).tolist()))
        if new := [key for key in dict.fromkeys(keys) if key not in self.known]:
            good = [fit for fit in self.known.values() if fit is not None and fit.finished]
            good = good or [self.best]
            held, wanted = np.stack([fit.held for fit in good]) / self._scale, np.array(new)
            starts = []
            for point in wanted:
                nearest = int(np.argmin(((held - point / self._scale) ** 2).sum(1)))
                starts.append(self._from(good[nearest], point))
            found = self.refit.optima(self.names, wanted, starts)
            self.known |= dict(zip(new, found, strict=True))
        return [self.known[key] for key in keys]

    def _from(self, optimum: ConstrainedFit, point: Floats) -> Floats:
        low, high = self.refit.parameters.lower, self.refit.parameters.upper
        return np.clip(optimum.values + self._response @ (point - optimum.held), low, high)

    def delta(self, points: Floats) -> Floats:
        """Delta chi squared at points, shape (..., held); NaN without a path."""
        found = [math.nan if fit is None else fit.chi_squared for fit in self.at(points)]
        return np.reshape(found, points.shape[:-1]) - self.refit.chi_squared

    def settle(self, grid: Floats) -> None:
        """Fit on a grid, shape (n, m, held), and again where neighbours are not in one valley, each
        started from the other."""
        self.at(grid)
        neighbours = _neighbours(grid)
        for _ in range(_ROUNDS):
            tries = []
            for first, second in neighbours:
                one, other = self.known[first], self.known[second]
                if one is not None and (other is None or not self._agree(one, other)):
                    tries.append((second, one))
                if other is not None and (one is None or not self._agree(one, other)):
                    tries.append((first, other))
            # not twice from the same optimum
            tries = [
                (point, optimum)
                for point, optimum in tries
                if (point, tuple(optimum.held), optimum.chi_squared) not in self._tried
            ]
            if not tries:
                return
            self._tried |= {(point, tuple(fit.held), fit.chi_squared) for point, fit in tries}
            points = np.array([point for point, _ in tries])
            starts = [self._from(optimum, np.array(point)) for point, optimum in tries]
            better = False
            found = self.refit.optima(self.names, points, starts)
            for (point, _), optimum in zip(tries, found, strict=True):
                known = self.known[point]
                if optimum is not None and (
                    known is None or optimum.chi_squared < known.chi_squared - _BETTER
                ):
                    self.known[point] = optimum
                    better = True
            if not better:
                return

    def _agree(self, first: ConstrainedFit, second: ConstrainedFit) -> bool:
        """Whether the slopes of chi squared integrate to its difference (trapezoidal rule)."""
        difference = second.chi_squared - first.chi_squared
        predicted = (first.slope + second.slope) @ (second.held - first.held) / 2
        large = max(first.chi_squared, second.chi_squared) - self.refit.chi_squared
        agree = bool(abs(difference - predicted) <= 0.1 + 0.1 * large)
        return first.finished and second.finished and agree


def _neighbours(grid: Floats) -> list[tuple[Point, Point]]:
    """Pairs of neighbouring points of a grid, along rows and columns."""
    points = [list(map(tuple, row)) for row in grid.tolist()]
    lines = [*points, *zip(*points, strict=True)]
    return [(one, other) for line in lines for one, other in pairwise(line) if one != other]
