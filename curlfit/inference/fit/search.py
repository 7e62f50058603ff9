"""The search for the optima of throws: from initial values on all sides, through the
fits that follow the first, to those that may fit equally.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from curlfit.errors import CurlfitError, UnusableFitError
from curlfit.friction import Law, NetLaw, no_motion_because
from curlfit.inference.fit.other_rests import starts_with_other_rests
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
    minimize_many,
    prepare_minimize,
)
from curlfit.losses import loss_at
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked, unstacked

_SAME_START = 1e-3  # typical sizes within which initial values are the same
_FACTORS = 1.0, 0.3, 3.0  # on the usual coefficients, for other initial values
_ROUNDING = 1e-9  # share of chi squared by which one optimum is not better than another
_EQUAL = 4.0  # chi squared within which optima fit equally: two standard deviations ...
_APART = 9.0  # ... if the linearized problem expects this much of their distance
_POOR = (3.0, 0.02)  # rms over that of a polynomial, and over the range, of a poor fit
_MOST_REST_SEARCHES = 20  # each moves the rest by up to eight rows


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
        self, starts: Sequence[Sequence[Floats]], tasks: Tasks | None = None
    ) -> list[list[Solution]]:
        """What is reached from some initial values of each throw; the tasks may have
        other bounds."""
        reached: list[list[Solution]] = [[] for _ in starts]
        counts = [len(of_throw) for of_throw in starts]
        if not any(counts):
            return reached
        rows = np.repeat(np.arange(len(starts)), counts)  # throw of each start
        values = np.concatenate([of_throw for of_throw in starts if of_throw])
        tasks = (self.tasks if tasks is None else tasks).at(rows)
        solutions = minimize_many(
            self.stack.model, tasks._replace(start=values), self.stack.batch
        )
        for row, solution in zip(rows, unstacked(solutions), strict=True):
            reached[row].append(solution)
        return reached

    def _tried(self) -> list[list[Solution]]:
        """What is reached from the initial values of each throw: from those that may
        fit equally, and from all others where the best of these is poor."""
        law = self.stack.model.law
        first_starts = []
        other_starts = []
        for row, request in enumerate(self.stack.requests):
            bounds = self.tasks.lower[row], self.tasks.upper[row]
            first, others = _starts_to_try(
                law, self._sides[:, row], bounds, self.tasks.typical
            )
            if request.start:
                given = request.with_given_start(first[0])
                if len(first) == 1:
                    others = first + others
                    first = [given]
                else:
                    first = [given, *first]
            first_starts.append(first)
            other_starts.append(others)
        tried = self._reached(first_starts)
        best = stacked(
            [(_best_first(solutions) or solutions)[0] for solutions in tried]
        )
        # If the first optimum is poor, all are tried: a later one may be local
        # and look good.
        poor = _needs_restart(best, self._paths, self.stack.problems)
        restarts = [
            others if is_poor else []
            for others, is_poor in zip(other_starts, poor, strict=True)
        ]
        reached = self._reached(restarts)
        return [before + later for before, later in zip(tried, reached, strict=True)]

    def _solve_again(self, throws: Indices) -> None:
        """Solve the revised problems of some throws from their optima, which stay where
        a path then is not finite."""
        starts: list[list[Floats]] = [[] for _ in self.optima]
        for row in throws:
            starts[row] = [optimum.values for optimum in self.optima[row]]
        reached = self._reached(starts)
        for optima_of_throw, refits in zip(self.optima, reached, strict=True):
            for number, refitted in enumerate(refits):
                if np.isfinite(refitted.chi_squared):
                    optima_of_throw[number] = refitted

    def _search_other_rests(self) -> None:
        """Search on with the rest of the stone in other rows of a measured spin, as
        long as that leads to lower optima. Under a robust loss, and with correlated
        noise, the rest stays in the row where least squares have found it."""
        tasks = self.tasks
        law = self.stack.model.law
        if tasks.problems.spins is None or not issubclass(law, NetLaw):
            return
        problems = unstacked(tasks.problems)
        due = [
            row
            for row, optima_of_throw in enumerate(self.optima)
            if optima_of_throw
            and not loss_at(tasks.problems.loss[row]).is_robust
            and not self.stack.noises[row].sizes
        ]
        for _ in range(_MOST_REST_SEARCHES):
            starts: list[list[Floats]] = [[] for _ in self.optima]
            for row in due:
                starts[row] = starts_with_other_rests(
                    self.stack.model,
                    self.optima[row][0],
                    problems[row],
                    tasks.lower[row],
                    tasks.upper[row],
                    tasks.typical,
                )
            if not any(starts):
                return
            reached = self._reached(starts)
            due = []
            for row, optima_of_throw in enumerate(self.optima):
                if reached[row]:
                    before = optima_of_throw[0]
                    optima_of_throw[:] = _best_and_rival(
                        [*optima_of_throw, *reached[row]]
                    )
                    if optima_of_throw[0] is not before:
                        due.append(row)

    def _settle(self) -> None:
        """End searches that have not ended, since along some direction chi squared is
        level or has no slope (the spin, of a stone that hardly spins): the parameter
        that takes part in it most is held, and the others are refitted."""
        lower = np.array(self.tasks.lower)
        upper = np.array(self.tasks.upper)
        typical = self.tasks.typical
        starts: list[list[Floats]] = [[] for _ in self.optima]
        for row, optima_of_throw in enumerate(self.optima):
            if not optima_of_throw or optima_of_throw[0].success:
                continue
            best = optima_of_throw[0]
            free = np.flatnonzero(upper[row] > lower[row])
            slopes = best.jacobian.reshape(-1, len(typical)) * typical
            # The last direction is that in which the residuals change least.
            _, _, directions = np.linalg.svd(slopes[:, free], full_matrices=False)
            levellest = free[np.abs(directions[-1]).argmax()]
            lower[row, levellest] = best.values[levellest]
            upper[row, levellest] = best.values[levellest]
            starts[row] = [best.values]
        held = self.tasks._replace(lower=lower, upper=upper)
        settled = self._reached(starts, held)
        for optima_of_throw, ends in zip(self.optima, settled, strict=True):
            if ends and ends[0].objective <= optima_of_throw[0].objective:
                optima_of_throw[0] = ends[0]

    def _add_usual(self) -> None:
        """Where coefficients went astray, add the optimum with their defaults, which
        may fit equally: about the first, where they hardly act, the others seem better
        determined than they are."""
        lower = np.array(self.tasks.lower)
        upper = np.array(self.tasks.upper)
        law = self.stack.model.law
        starts: list[list[Floats]] = [[] for _ in self.optima]
        for row, optima_of_throw in enumerate(self.optima):
            if not optima_of_throw:
                continue
            best = optima_of_throw[0]
            usual = usual_where_astray(law, best.values, self.tasks.typical)
            astray = np.isfinite(usual) & (upper[row] > lower[row])
            if astray.any():
                starts[row] = [np.where(astray, usual, best.values)]
                lower[row, astray] = usual[astray]
                upper[row, astray] = usual[astray]
        held = self.tasks._replace(lower=lower, upper=upper)
        reached = self._reached(starts, held)
        for optima_of_throw, usual_optima in zip(self.optima, reached, strict=True):
            optima_of_throw += usual_optima

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
        best, *others = self.optima[row]
        rivals = [other for other in others if _fits_equally(best, other)]
        rival = rivals[0] if rivals else None
        return self.stack.record(row, best, tried, rival)


def _starts_to_try(
    law: type[Law], sides: Floats, bounds: tuple[Floats, Floats], typical: Floats
) -> tuple[list[Floats], list[Floats]]:
    """Initial values of which all are to be tried, since they may fit
    equally, and others.

    `sides` are those of a throw, from `start_values_of_sides`.
    """
    apart: list[Floats] = []
    for values in sides:
        away = [np.abs(values - other) > _SAME_START * typical for other in apart]
        if all(differs.any() for differs in away):
            apart.append(values)
    coefficients = law.coefficients()
    usual = np.array([default_guess(coefficient) for coefficient in coefficients])
    others = np.array([apart[0]] * len(_FACTORS))
    others[:, : len(usual)] = np.outer(_FACTORS, usual)
    return apart, [*np.clip(others, *bounds)]


def _best_first(solutions: Iterable[Solution]) -> list[Solution]:
    """The optima of a problem whose chi squared is finite, the first of the best
    before others."""
    ordered: list[Solution] = []
    for solution in solutions:
        if not np.isfinite(solution.chi_squared):
            continue
        is_better = (
            bool(ordered)
            and solution.objective < (1 - _ROUNDING) * ordered[0].objective
        )
        ordered.insert(0 if is_better else len(ordered), solution)
    return ordered


def _best_and_rival(solutions: Iterable[Solution]) -> list[Solution]:
    """The best of the optima of a throw, and the first other one that fits equally, if
    there is one; empty where none is finite."""
    best_and_others = _best_first(solutions)
    if not best_and_others:
        return []
    best, *others = best_and_others
    rivals = [other for other in others if _fits_equally(best, other)]
    return [best, *rivals[:1]]


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
    observed = problems.observed[:, :3]
    weight = problems.weight[:, :3]
    is_seen = weight > 0
    count = is_seen.sum(-1)
    residual = solutions.residual[:, :3] / np.where(is_seen, weight, np.inf)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(count, 1))
    highest = np.where(is_seen, observed, -np.inf).max(-1)
    lowest = np.where(is_seen, observed, np.inf).min(-1)
    over_polynomial, over_range = _POOR
    is_poor = (rms > over_polynomial * paths.rms[:, :3]) & (
        rms > over_range * (highest - lowest)
    )
    ended = solutions.success & np.isfinite(solutions.chi_squared)
    return ~np.asarray(ended) | (is_poor & (count >= 3)).any(-1)
