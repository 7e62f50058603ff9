"""Constrained fits: some parameters fixed, all others fitted again with the same
law and noise.

The fits run as one batch, each started from the nearest known one along the linear
response of the other parameters. Whether neighbours belong to one valley is checked by
the envelope theorem: the slope of the profile is the partial derivative of chi squared,
known at each point, whose integral has to match the difference of chi squared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.information import Information
from curlfit.inference.solve.least_squares import Solution, Tasks, minimize_many
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import FEW, stacked, unstacked
from curlfit.profile_likelihood.result import levels_for

Point = tuple[float, ...]

BETTER = 1e-3
"""Decrease of chi squared that makes another fit the better one."""
_ROUNDS = 8
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it
# How far chi squared of neighbours in one valley may be from the integral of its slope
# by the trapezoidal rule: a constant, and a part of how far it is above the best fit.
_MISMATCH = 0.1
_MISMATCH_OF_RISE = 0.1


class Optimum(NamedTuple):
    """A least chi squared, with or without parameters fixed."""

    chi_squared: float
    values: Floats
    """of all parameters"""
    gradient: Floats
    """derivatives of chi squared by all parameters, fixed ones too"""
    finished: bool
    """whether the search converged"""


class Refit:
    """A fit to be repeated with parameters fixed, and the best fit that is known.

    Attributes
    ----------
    best : the best fit without parameters fixed.
    jacobian : derivatives of its residuals by all parameters.
    lowest : the best of the fits with parameters fixed, since `best` is known.
    chi_squared_of_fit : chi squared of the fit as it was given.
    """

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        self.parameters = fit.parameter_set
        self._problem = problem_of(fit)
        self._penalty = self.parameters.penalty
        solution = self._free_solution(fit.values)
        if solution is None:
            raise UnusableFitError("the fit has no path")
        self._set_best(solution)
        self.chi_squared_of_fit = self.best.chi_squared

    def _set_best(self, solution: Solution) -> None:
        self.best = self._optimum(solution)
        self.jacobian = np.asarray(solution.jacobian)
        self.lowest: Optimum | None = None

    def _free_solution(self, start: Floats) -> Solution | None:
        """The fit without parameters fixed; None where there is no path."""
        (solution,) = self._solutions([], np.zeros((1, 0)), [start])
        return solution

    def _solutions(
        self, fixed: list[int], points: Floats, starts: Sequence[Floats]
    ) -> list[Solution | None]:
        """The fits with the parameters of the indices `fixed` at each of the points,
        shape (starts, fixed); None where there is no path."""
        count = len(starts)
        lower = np.tile(self.parameters.lower, (count, 1))
        upper = np.tile(self.parameters.upper, (count, 1))
        lower[:, fixed] = points
        upper[:, fixed] = points
        problems, penalty = stacked([(self._problem, self._penalty)] * count)
        start = np.array(starts)
        tasks = Tasks(problems, start, lower, upper, self.parameters.typical, penalty)
        solutions = unstacked(minimize_many(self.fit.model, tasks, FEW))
        return [
            solution if np.isfinite(solution.residual).all() else None
            for solution in solutions
        ]

    def optima(
        self, fixed: list[int], points: Floats, starts: Sequence[Floats]
    ) -> list[Optimum | None]:
        """The optima with the parameters of the indices `fixed` at each of the points,
        shape (starts, fixed); None where there is no path."""
        optima: list[Optimum | None] = []
        for solution in self._solutions(fixed, points, starts):
            if solution is None:
                optima.append(None)
                continue
            optimum = self._optimum(solution)
            if self.lowest is None or optimum.chi_squared < self.lowest.chi_squared:
                self.lowest = optimum
            optima.append(optimum)
        return optima

    def _optimum(self, solution: Solution) -> Optimum:
        values = np.asarray(solution.values)
        half_gradient = np.einsum("cn,cni->i", solution.residual, solution.jacobian)
        half_gradient = half_gradient + self._penalty.quadratic(values)[1]
        return Optimum(
            chi_squared=float(solution.objective),
            values=values,
            gradient=2 * half_gradient,
            finished=bool(solution.success),
        )

    def adopt_better_fit(self) -> bool:
        """Continue the lowest of the fits with parameters fixed, without these; returns
        whether this gives a better fit, which is then the best one."""
        threshold = self.best.chi_squared - BETTER
        if self.lowest is None or self.lowest.chi_squared > threshold:
            return False
        solution = self._free_solution(self.lowest.values)
        if solution is None or solution.objective > threshold:
            return False
        self._set_best(solution)
        return True

    def at_bound(self, values: Floats) -> Booleans:
        """Which free parameters are at a bound."""
        near = _NEAR * self.parameters.typical
        at_lower = values <= self.parameters.lower + near
        at_upper = values >= self.parameters.upper - near
        return self.parameters.free & (at_lower | at_upper)

    def response(self, fixed: list[int]) -> tuple[Floats, Floats]:
        """Response of all parameters to fixed ones, shape (parameters, fixed), and
        stiffness, shape (fixed,).

        The stiffness is the norm of the derivative of the residuals by each fixed
        parameter, the others responding; its inverse is the standard error with the
        other fixed ones held.
        """
        parameters = self.parameters
        is_fixed = np.isin(np.arange(len(parameters)), fixed)
        bounds = Bounded(self.best.values, parameters.lower, parameters.upper)
        information = Information.of(
            parameters.names,
            bounds,
            parameters.typical,
            self.jacobian,
            np.zeros(self.jacobian.shape[:-1]),
        )
        stays = self.at_bound(self.best.values) & ~is_fixed
        marginal = information.held(stays).marginal(is_fixed)
        stiffness = np.linalg.norm(marginal.information.slopes, axis=0)
        # the marginal has the order of the parameters, not that of `fixed`
        order = np.argsort(np.argsort(fixed))
        return marginal.follow[:, order], stiffness[order]


class ConstrainedFits:
    """Fits with some parameters fixed, each made once: a cache by the fixed values.

    Attributes
    ----------
    fixed : indices of the fixed parameters.
    best : values of the fixed parameters in the best fit.
    levels : levels of confidence for these parameters.
    stiffness : see `Refit.response`.
    """

    def __init__(self, refit: Refit, names: Sequence[str]) -> None:
        self.refit = refit
        self.fixed = [refit.parameters.index(name) for name in names]
        self.levels = levels_for(names, refit.fit.parameters)
        self.best = refit.best.values[self.fixed]
        best_point = tuple(self.best.tolist())
        self._optima: dict[Point, Optimum | None] = {best_point: refit.best}
        self._response, self.stiffness = refit.response(self.fixed)
        self._typical = refit.parameters.typical[self.fixed]

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the last of the fixed parameters."""
        parameters = self.refit.parameters
        last = self.fixed[-1]
        return parameters.lower[last], parameters.upper[last]

    def at(self, points: Floats) -> list[Optimum | None]:
        """The fits at points, shape (..., fixed), each started from the nearest of
        those made before."""
        keys = list(map(tuple, points.reshape(-1, len(self.fixed)).tolist()))
        new = [key for key in dict.fromkeys(keys) if key not in self._optima]
        if new:
            optima = self._fitted(new, self._nearest_finished(new))
            self._optima |= dict(zip(new, optima, strict=True))
        return [self._optima[key] for key in keys]

    def _nearest_finished(self, points: Sequence[Point]) -> list[Optimum]:
        """Of the optima whose search converged the nearest to each point, in typical
        sizes of the fixed values."""
        finished = [
            optimum
            for optimum in self._optima.values()
            if optimum is not None and optimum.finished
        ]
        finished = finished or [self.refit.best]
        values = np.stack([optimum.values[self.fixed] for optimum in finished])
        nearest = []
        for point in np.array(points):
            distance = (((values - point) / self._typical) ** 2).sum(1)
            nearest.append(finished[int(np.argmin(distance))])
        return nearest

    def _fitted(
        self, points: Sequence[Point], neighbours: Sequence[Optimum]
    ) -> list[Optimum | None]:
        """The fits at points, each started from an optimum along the response of the
        other parameters."""
        parameters = self.refit.parameters
        fixed_values = np.array(points)
        starts = []
        for point, near in zip(fixed_values, neighbours, strict=True):
            start = near.values + self._response @ (point - near.values[self.fixed])
            starts.append(np.clip(start, parameters.lower, parameters.upper))
        return self.refit.optima(self.fixed, fixed_values, starts)

    def delta(self, points: Floats) -> Floats:
        """Delta chi squared at points, shape (..., fixed); NaN without a path."""
        chi_squared = [
            math.nan if optimum is None else optimum.chi_squared
            for optimum in self.at(points)
        ]
        return np.reshape(chi_squared, points.shape[:-1]) - self.refit.best.chi_squared

    def settle(self, grid: Floats) -> None:
        """Fit on a grid, shape (n, m, fixed), and again where neighbours are not in one
        valley, each started from the other."""
        self.at(grid)
        pairs = _neighbours(grid)
        for _ in range(_ROUNDS):
            points, neighbours = self._doubtful(pairs)
            if not points:
                return
            improved = False
            refits = self._fitted(points, neighbours)
            for point, optimum in zip(points, refits, strict=True):
                if optimum is not None and self._is_better(optimum, point):
                    self._optima[point] = optimum
                    improved = True
            if not improved:
                return

    def _doubtful(
        self, pairs: Sequence[tuple[Point, Point]]
    ) -> tuple[list[Point], list[Optimum]]:
        """Points that are not in one valley with a neighbour, and its optimum."""
        points = []
        optima = []
        for first, second in pairs:
            for point, neighbour in ((second, first), (first, second)):
                optimum = self._optima[neighbour]
                if optimum is not None and not self._in_one_valley(
                    self._optima[point], optimum
                ):
                    points.append(point)
                    optima.append(optimum)
        return points, optima

    def _is_better(self, optimum: Optimum, point: Point) -> bool:
        """Whether an optimum is better than the one known at a point."""
        previous = self._optima[point]
        if previous is None:
            return True
        return optimum.chi_squared < previous.chi_squared - BETTER

    def _in_one_valley(self, first: Optimum | None, second: Optimum) -> bool:
        """Whether the slopes of chi squared integrate to its difference
        (trapezoidal rule)."""
        if first is None or not (first.finished and second.finished):
            return False
        slopes = (first.gradient + second.gradient)[self.fixed]
        step = (second.values - first.values)[self.fixed]
        mismatch = second.chi_squared - first.chi_squared - slopes @ step / 2
        higher = max(first.chi_squared, second.chi_squared)
        rise = higher - self.refit.best.chi_squared
        return bool(abs(mismatch) <= _MISMATCH + _MISMATCH_OF_RISE * rise)


def _neighbours(grid: Floats) -> list[tuple[Point, Point]]:
    """Pairs of different neighbouring points of a grid, along rows and columns."""
    rows = [list(map(tuple, row)) for row in grid.tolist()]
    columns = zip(*rows, strict=True)
    return [
        (first, second)
        for line in (*rows, *columns)
        for first, second in pairwise(line)
        if first != second
    ]
