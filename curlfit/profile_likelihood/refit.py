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
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.least_squares import Solution, Tasks, minimize_many
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import FEW, stacked, unstacked
from curlfit.profile_likelihood.result import levels_for

Point = tuple[float, ...]

BETTER = 1e-3
"""Decrease of chi squared that makes another fit the better one."""
_ROUNDS = 8
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it
_ROUNDING = 1e-9  # of the largest singular value


class Optimum(NamedTuple):
    """A least chi squared, with or without parameters fixed."""

    chi_squared: float
    values: Floats
    """of all parameters, as the next"""
    gradient: Floats
    """of chi squared, by fixed parameters too"""
    finished: bool


class Refit:
    """A fit to be repeated with parameters fixed, and the best one so far."""

    def __init__(self, fit: FitResult) -> None:
        self.fit, self.parameters, self.model = fit, fit.parameter_set, fit.model
        self._problem, origin = problem_of(fit)
        self._offset = origin.offset(len(self.parameters))
        self._penalty = self.parameters.shifted(-self._offset).penalty
        self.lowest: Optimum | None = None
        (solution,) = self._solved([], np.zeros((1, 0)), [fit.values])
        if solution is None:
            raise UnusableFitError("the fit has no path")
        self._take(solution)
        self.first = self.best.chi_squared  # of the fit as it was given

    def _take(self, solution: Solution) -> None:
        self.best, self.jacobian = (
            self._optimum(solution),
            np.asarray(solution.jacobian),
        )

    def _solved(
        self, held: list[int], points: Floats, starts: Sequence[Floats]
    ) -> list[Solution | None]:
        count, offset = len(starts), self._offset
        ends = self.parameters.lower, self.parameters.upper
        lower, upper = (np.tile(end - offset, (count, 1)) for end in ends)
        lower[:, held] = upper[:, held] = points - offset[held]
        problems, penalty = stacked([(self._problem, self._penalty)] * count)
        start, typical = np.array(starts) - offset, self.parameters.typical

        tasks = Tasks(problems, start, lower, upper, typical, penalty)
        found = unstacked(minimize_many(self.model, tasks, FEW))
        return [one if np.isfinite(one.residual).all() else None for one in found]

    def optima(
        self, held: list[int], points: Floats, starts: Sequence[Floats]
    ) -> list[Optimum | None]:
        """The optima with the parameters `held` at each of the points; None where
        there is no path."""
        found = [
            None if solution is None else self._optimum(solution)
            for solution in self._solved(held, points, starts)
        ]
        known = [one for one in (self.lowest, *found) if one is not None]
        self.lowest = min(known, key=lambda one: one.chi_squared, default=None)
        return found

    def _optimum(self, solution: Solution) -> Optimum:
        values = np.asarray(solution.values)
        half = np.einsum("cn,cni->i", solution.residual, solution.jacobian)
        half = half + self._penalty.quadratic(values)[1]
        chi_squared = float(solution.objective)
        return Optimum(
            chi_squared, values + self._offset, 2 * half, bool(solution.success)
        )

    def improved(self) -> bool:
        """Whether a better fit was found, which then replaces the fit."""
        least = self.best.chi_squared - BETTER
        if self.lowest is None or self.lowest.chi_squared > least:
            return False
        (solution,) = self._solved([], np.zeros((1, 0)), [self.lowest.values])
        if solution is None or solution.objective > least:
            return False
        self._take(solution)
        self.lowest = None
        return True

    def at_bound(self, values: Floats) -> Booleans:
        """Which free parameters are at a bound."""
        near = _NEAR * self.parameters.typical
        low, high = self.parameters.lower, self.parameters.upper
        return self.parameters.free & ((values <= low + near) | (values >= high - near))

    def response(self, held: list[int]) -> tuple[Floats, Floats]:
        """Response of other parameters to fixed ones, shape (parameters, fixed), and
        of residuals.

        The second is the norm of the derivative of the residuals by each fixed one,
        the others responding; its inverse is the standard error with the other
        fixed ones held.
        """
        moving = self.parameters.free & ~self.at_bound(self.best.values)
        moving[held] = False
        jacobian = self.jacobian.reshape(-1, len(self.parameters))
        others, own = jacobian[:, moving], jacobian[:, held]
        size = np.linalg.norm(others, axis=0)
        size[size == 0] = 1.0
        follow = (
            -np.linalg.lstsq(others / size, own, rcond=_ROUNDING)[0] / size[:, None]
        )
        rows = np.zeros((len(self.parameters), len(held)))
        rows[moving], rows[held] = follow, np.eye(len(held))
        return rows, np.linalg.norm(own + others @ follow, axis=0)


class ConstrainedFits:
    """Known optima with some parameters fixed, by the fixed values."""

    def __init__(self, refit: Refit, names: Sequence[str]) -> None:
        self.refit, self.names = refit, tuple(names)
        self.index = [refit.parameters.index(name) for name in names]
        self.levels = levels_for(names, refit.fit.parameters)
        self.best = refit.best.values[self.index]
        self.known: dict[Point, Optimum | None] = {
            tuple(self.best.tolist()): refit.best
        }
        self._response, stiffness = refit.response(self.index)
        self.stiffness = stiffness
        self._typical = refit.parameters.typical[self.index]

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the last of the fixed parameters."""
        parameters, last = self.refit.parameters, self.index[-1]
        return parameters.lower[last], parameters.upper[last]

    def at(self, points: Floats) -> list[Optimum | None]:
        """The fits at points, shape (..., held), each made from the nearest
        that was known."""
        keys = list(map(tuple, points.reshape(-1, len(self.names)).tolist()))
        if new := [key for key in dict.fromkeys(keys) if key not in self.known]:
            good = [
                fit for fit in self.known.values() if fit is not None and fit.finished
            ]
            good = good or [self.refit.best]
            held = np.stack([fit.values[self.index] for fit in good])
            nearest = [
                good[int(np.argmin((((held - point) / self._typical) ** 2).sum(1)))]
                for point in np.array(new)
            ]
            self.known |= dict(zip(new, self._fitted(new, nearest), strict=True))
        return [self.known[key] for key in keys]

    def _fitted(
        self, points: Sequence[Point], near: Sequence[Optimum]
    ) -> list[Optimum | None]:
        """The fits at points, each started from another."""
        low, high = self.refit.parameters.lower, self.refit.parameters.upper
        wanted = np.array(points)
        starts = [
            np.clip(
                fit.values + self._response @ (point - fit.values[self.index]),
                low,
                high,
            )
            for point, fit in zip(wanted, near, strict=True)
        ]
        return self.refit.optima(self.index, wanted, starts)

    def delta(self, points: Floats) -> Floats:
        """Delta chi squared at points, shape (..., held); NaN without a path."""
        found = [
            math.nan if fit is None else fit.chi_squared for fit in self.at(points)
        ]
        return np.reshape(found, points.shape[:-1]) - self.refit.best.chi_squared

    def settle(self, grid: Floats) -> None:
        """Fit on a grid, shape (n, m, held), and again where neighbours are not in one
        valley, each started from the other."""
        self.at(grid)
        neighbours = _neighbours(grid)
        for _ in range(_ROUNDS):
            tries = [
                (point, near)
                for pair in neighbours
                for point, near in (
                    (pair[1], self.known[pair[0]]),
                    (pair[0], self.known[pair[1]]),
                )
                if near is not None and not self._agree(self.known[point], near)
            ]
            if not tries:
                return
            better = False
            for (point, _), fit in zip(
                tries, self._fitted(*zip(*tries, strict=True)), strict=True
            ):
                known = self.known[point]
                if fit and (
                    known is None or fit.chi_squared < known.chi_squared - BETTER
                ):
                    self.known[point], better = fit, True
            if not better:
                return

    def _agree(self, one: Optimum | None, other: Optimum) -> bool:
        """Whether the slopes of chi squared integrate to its difference
        (trapezoidal rule)."""
        if one is None:
            return False
        slope, step = one.gradient + other.gradient, other.values - one.values
        difference = (
            other.chi_squared
            - one.chi_squared
            - slope[self.index] @ step[self.index] / 2
        )
        large = max(one.chi_squared, other.chi_squared) - self.refit.best.chi_squared
        return (
            one.finished
            and other.finished
            and bool(abs(difference) <= 0.1 + 0.1 * large)
        )


def _neighbours(grid: Floats) -> list[tuple[Point, Point]]:
    """Pairs of neighbouring points of a grid, along rows and columns."""
    points = [list(map(tuple, row)) for row in grid.tolist()]
    lines = [*points, *zip(*points, strict=True)]
    return [
        (one, other) for line in lines for one, other in pairwise(line) if one != other
    ]
