"""The search for the optima of throws: from initial values on all sides, through the
fits that follow the first, to those that may fit equally.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, no_motion_because
from curlfit.inference.fit.other_rests import (
    MOST_REST_SEARCHES,
    optima_with_other_rests,
)
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of, penalties
from curlfit.inference.fit.revisions import revisions
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.model.likelihood import prepare_channels
from curlfit.inference.model.problem import Problem
from curlfit.inference.solve.initial_values import (
    SmoothPath,
    default_guess,
    usual_where_astray,
)
from curlfit.inference.solve.least_squares import (
    Indices,
    Solution,
    Tasks,
    is_lower,
    minimize_from,
    prepare_minimize,
)
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked, unstacked

_SAME_START = 1e-3
"""Typical sizes within which initial values are the same."""
_FACTORS = (1.0, 0.3, 3.0)
"""On the usual coefficients, for other initial values."""
_EQUAL = 4.0
"""Chi squared within which optima fit equally: two standard deviations ..."""
_APART = 9.0
"""... if the linearized problem expects this much of their distance."""
_OVER_POLYNOMIAL = 3.0
"""Times the rms about a polynomial, above which the rms of a fit is poor ..."""
_OVER_RANGE = 0.02
"""... if it is above this share of the range of the data too."""
_FEWEST = 3
"""Values of a channel from which its rms is judged."""


def fitted(stack: ThrowStack) -> list[LeastSquaresFit | CurlfitError]:
    """Fits of throws side by side; an error takes the place of one that fails."""
    if stack.batch == 1:
        # Programs are compiled while the initial values are computed.
        (problem,) = unstacked(stack.problems)
        parameters = stack.requests[0].parameters
        prepare_minimize(stack.model, parameters, problem)
        prepare_channels(stack.model, len(parameters), problem)
    return _Search(stack).outcomes()


class _Search:
    """A search for the optima of a stack of throws.

    Attributes
    ----------
    tasks : the problems of the stack, which its revisions change in place.
    optima : of each throw the best so far, and then others that may fit equally; none
        where no path is finite.
    """

    def __init__(self, stack: ThrowStack) -> None:
        self.stack = stack
        lower, upper = bounds_of(stack.requests)
        self._paths, self._sides = stack.starts()
        self.tasks = Tasks(
            stack.problems,
            self._sides[0],
            lower,
            upper,
            stack.requests[0].parameters.typical,
            penalties(stack.requests, first=True),
        )
        self.optima: list[list[Solution]] = []

    def outcomes(self) -> list[LeastSquaresFit | CurlfitError]:
        """The fits of the throws, in the order in which they come about."""
        tried = self._tried()
        self.optima = [_best_and_rival(solutions) for solutions in tried]
        self._search_other_rests()
        self.tasks = self.tasks._replace(penalty=penalties(self.stack.requests))
        throws = np.flatnonzero(list(map(len, self.optima)))
        for revised in revisions(self.stack, throws, self._best_of):
            self._solve_again(revised)
            self._search_other_rests()
        self._settle()
        self._add_usual()
        return [
            self.stack.failures.get(row) or self._outcome(row, len(solutions))
            for row, solutions in enumerate(tried)
        ]

    def _best_of(self, throws: Indices) -> Solution:
        """The best optima of some throws, along the first axis."""
        return stacked([self.optima[row][0] for row in throws])

    def _reached(
        self, starts: Mapping[int, list[Floats]], tasks: Tasks | None = None
    ) -> dict[int, list[Solution]]:
        """What is reached from initial values of throws, both by row; throws without
        initial values are left out.

        Parameters
        ----------
        tasks : those of the search, with other bounds; as they are by default.
        """
        tasks = self.tasks if tasks is None else tasks
        return minimize_from(self.stack.model, tasks, starts, self.stack.batch)

    def _tried(self) -> list[list[Solution]]:
        """What is reached from the initial values of each throw: from those that may
        fit equally, and from all others where the best of these is poor."""
        law = self.stack.model.law
        first_starts = {}
        other_starts = {}
        for row, request in enumerate(self.stack.requests):
            first = _distinct(self._sides[:, row], self.tasks.typical)
            others = _with_usual_coefficients(
                law, first[0], self.tasks.lower[row], self.tasks.upper[row]
            )
            if request.start:
                given_start = request.with_given_start(first[0])
                if len(first) == 1:
                    others = first + others
                    first = [given_start]
                else:
                    first = [given_start, *first]
            first_starts[row] = first
            other_starts[row] = others
        tried = self._reached(first_starts)
        best = stacked(
            [(_best_first(solutions) or solutions)[0] for solutions in tried.values()]
        )
        # If the first optimum is poor, all are tried: a later one may be local
        # and look good.
        poor = np.flatnonzero(_needs_restart(best, self._paths, self.stack.problems))
        restarts = {row: other_starts[row] for row in poor.tolist()}
        for row, solutions in self._reached(restarts).items():
            tried[row] += solutions
        return list(tried.values())

    def _solve_again(self, throws: Indices) -> None:
        """Solve the revised problems of some throws from their optima, which stay where
        a path then is not finite."""
        starts = {
            row: [optimum.values for optimum in self.optima[row]]
            for row in throws.tolist()
        }
        for row, solutions in self._reached(starts).items():
            for number, solution in enumerate(solutions):
                if np.isfinite(solution.chi_squared):
                    self.optima[row][number] = solution

    def _search_other_rests(self) -> None:
        """Search on with the rest of the stone in other rows of a measured spin, as
        long as that leads to lower optima."""
        due = [
            row for row, optima_of_throw in enumerate(self.optima) if optima_of_throw
        ]
        for _ in range(MOST_REST_SEARCHES):
            optima = {row: self.optima[row][0] for row in due}
            due = []
            others_by_row = optima_with_other_rests(self.stack, self.tasks, optima)
            for row, others in others_by_row.items():
                self.optima[row] = _best_and_rival([*self.optima[row], *others])
                if self.optima[row][0] is not optima[row]:
                    due.append(row)
            if not due:
                return

    def _settle(self) -> None:
        """End searches that have not ended, since along some direction chi squared is
        level or has no slope (the spin, of a stone that hardly spins): the parameter
        that takes part in it most is held, and the others are refitted."""
        lower = np.array(self.tasks.lower)
        upper = np.array(self.tasks.upper)
        typical = self.tasks.typical
        starts = {}
        for row, optima_of_throw in enumerate(self.optima):
            if not optima_of_throw or optima_of_throw[0].success:
                continue
            best = optima_of_throw[0]
            free = np.flatnonzero(self.tasks.free[row])
            slopes = best.jacobian.reshape(-1, len(typical)) * typical
            # The last direction is that in which the residuals change least.
            _, _, directions = np.linalg.svd(slopes[:, free], full_matrices=False)
            levellest = free[np.abs(directions[-1]).argmax()]
            lower[row, levellest] = best.values[levellest]
            upper[row, levellest] = best.values[levellest]
            starts[row] = [best.values]
        held = self.tasks._replace(lower=lower, upper=upper)
        for row, (settled,) in self._reached(starts, held).items():
            if settled.objective <= self.optima[row][0].objective:
                self.optima[row][0] = settled

    def _add_usual(self) -> None:
        """Where coefficients went astray, add the optimum with their defaults, which
        may fit equally: about the first, where they hardly act, the others seem better
        determined than they are."""
        lower = np.array(self.tasks.lower)
        upper = np.array(self.tasks.upper)
        law = self.stack.model.law
        starts = {}
        for row, optima_of_throw in enumerate(self.optima):
            if not optima_of_throw:
                continue
            best = optima_of_throw[0]
            usual = usual_where_astray(law, best.values, self.tasks.typical)
            astray = np.isfinite(usual) & self.tasks.free[row]
            if astray.any():
                starts[row] = [np.where(astray, usual, best.values)]
                lower[row, astray] = usual[astray]
                upper[row, astray] = usual[astray]
        held = self.tasks._replace(lower=lower, upper=upper)
        for row, solutions in self._reached(starts, held).items():
            self.optima[row] += solutions

    def _outcome(self, row: int, tried: int) -> LeastSquaresFit | CurlfitError:
        """The fit of a throw from its optimum, and one that may fit equally; an error
        where none of those tried is finite."""
        if not self.optima[row]:
            model = self.stack.model
            return UnusableFitError(
                f"{self.stack.requests[row].throw.name}: law {model.law.name} with "
                f"{model.load} load gives no finite "
                "path from any start" + no_motion_because(model.load)
            )
        best, *other_optima = self.optima[row]
        return self.stack.record(row, best, tried, _rival(best, other_optima))


def _distinct(sides: Floats, typical: Floats) -> list[Floats]:
    """Initial values of a throw on all sides that may fit equally, each once; sides
    have the shape (sides, parameters)."""
    distinct: list[Floats] = []
    for values in sides:
        if all(
            (np.abs(values - other) > _SAME_START * typical).any() for other in distinct
        ):
            distinct.append(values)
    return distinct


def _with_usual_coefficients(
    law: type[Law], values: Floats, lower: Floats, upper: Floats
) -> list[Floats]:
    """Initial values with the usual coefficients of a law, and with smaller and larger
    ones, in place of its own."""
    coefficients = law.coefficients()
    usual = np.array([default_guess(coefficient) for coefficient in coefficients])
    starts = []
    for factor in _FACTORS:
        start = values.copy()
        start[: len(usual)] = factor * usual
        starts.append(np.clip(start, lower, upper))
    return starts


def _best_first(solutions: Iterable[Solution]) -> list[Solution]:
    """The optima of a problem whose chi squared is finite, the first of the best
    before others."""
    ordered: list[Solution] = []
    for solution in solutions:
        if not np.isfinite(solution.chi_squared):
            continue
        if ordered and is_lower(solution, ordered[0]):
            ordered.insert(0, solution)
        else:
            ordered.append(solution)
    return ordered


def _best_and_rival(solutions: Iterable[Solution]) -> list[Solution]:
    """The best of the optima of a throw, and the first other one that fits equally, if
    there is one; empty where none is finite."""
    optima = _best_first(solutions)
    if not optima:
        return []
    best, *other_optima = optima
    rival = _rival(best, other_optima)
    return [best] if rival is None else [best, rival]


def _rival(best: Solution, others: Iterable[Solution]) -> Solution | None:
    """The first other optimum that fits as well as the best; None without one."""
    return next((other for other in others if _fits_equally(best, other)), None)


def _fits_equally(best: Solution, other: Solution) -> bool:
    """Whether another optimum of the same problem fits as well as the best, within
    two standard deviations of the noise, though to first order about the best
    it should not."""
    count = max(int((best.jacobian != 0).any(-1).sum()), 1)
    noise = best.objective / count
    expected = ((best.jacobian @ (other.values - best.values)) ** 2).sum()
    rise = other.objective - best.objective
    return bool(other.success and rise < _EQUAL * noise and expected > _APART * noise)


def _needs_restart(
    solutions: Solution, paths: SmoothPath, problems: Problem
) -> Booleans:
    """Which of many optima are so poor that other initial values are worth trying."""
    observed = problems.observed[:, :3]  # x, y and the angle
    weight = problems.weight[:, :3]
    is_seen = weight > 0
    count = is_seen.sum(-1)
    residual = solutions.residual[:, :3] / np.where(is_seen, weight, np.inf)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(count, 1))
    highest = np.where(is_seen, observed, -np.inf).max(-1)
    lowest = np.where(is_seen, observed, np.inf).min(-1)
    is_rougher = rms > _OVER_POLYNOMIAL * paths.rms[:, :3]
    is_large = rms > _OVER_RANGE * (highest - lowest)
    is_poor = (is_rougher & is_large & (count >= _FEWEST)).any(-1)
    has_ended = solutions.success & np.isfinite(solutions.chi_squared)
    return ~np.asarray(has_ended) | is_poor
