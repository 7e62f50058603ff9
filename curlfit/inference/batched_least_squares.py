"""Many optima side by side.

Levenberg and Marquardt's method within bounds, as in `box.py`, for many throws at once: each pass
asks the model for the residuals and Jacobians of some throws that are on their way, which costs far
less than one throw after the other. A throw that has arrived leaves and the next takes its lane, so
none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from curlfit.inference.likelihood import LANES, Problem, by_lanes, linearised

# isort: split
from functools import partial
from operator import itemgetter

import jax
import numpy as np
from numpy.typing import NDArray

from curlfit.friction import Law, Load
from curlfit.inference.least_squares import Solution

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

_FIRST_DAMPING = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e8
_GAIN, _AFTER = 1e-8, 1e-10
"""Shares of the misfit that a step would win, and the one after it: a last step, taken without
another look."""
_MOST_PASSES = 80


class Tasks(NamedTuple):
    """Problems of one shape, where to begin each, and within what; throws along the first axis."""

    problems: Problem
    start: Floats
    """shape (throws, parameters), as the next two"""
    lower: Floats
    upper: Floats
    typical: Floats
    """shape (parameters,)"""


Again = Callable[[Places, Solution], tuple[Places, Floats]]
"""From throws that have arrived, and their optima: those to go on, and their new weights."""


def solve_many(
    law: type[Law],
    load: Load,
    tasks: Tasks,
    again: Again | None = None,
    arrived: Callable[[int], None] | None = None,
) -> Solution:
    """The optima of many problems, throws along the first axis of each field.

    Residuals that are not finite say that there was no path even at the start.

    Parameters
    ----------
    again : asked once of each throw that has arrived, whether to go on under other weights.
    arrived : told how many have arrived for good.
    """
    fleet = _Fleet(tasks)
    asked = np.zeros(len(tasks.start), bool)
    going = np.ones(len(tasks.start), bool)
    while going.any():
        now = np.flatnonzero(going)[:LANES]
        here = jax.tree.map(itemgetter(run_of(now)), fleet.problems)
        found = by_lanes(partial(linearised, law, load), (fleet.trial[now], here))
        over = now[fleet.take(now, *found)]
        new = over[~asked[over]]
        asked[new] = True
        if again is not None and len(new):
            more, weight = again(new, fleet.solution(new))
            on = more[~fleet.reweigh(more, weight)]
            over = np.setdiff1d(over, on)
        going[over] = False
        if arrived is not None:
            arrived(int((~going).sum()))
    return fleet.solution(np.arange(len(going)))


def run_of(places: Places) -> Places | slice:
    """Places in rising order; as a slice where none is left out, which copies nothing."""
    if len(places) and places[-1] - places[0] == len(places) - 1:
        return slice(places[0], places[-1] + 1)
    return places


class _Parabola(NamedTuple):
    """The misfits near some places, by parameters in typical sizes."""

    misfit: Floats
    gradient: Floats
    """half of it, shape (throws, parameters)"""
    normal: Floats
    """half of the second derivatives, shape (throws, parameters, parameters)"""


class _Fleet:
    """Throws on their way: the best place of each so far, what it is like there, the next to try.

    Methods take the throws that they are about, and tell which of them have arrived.
    """

    def __init__(self, tasks: Tasks) -> None:
        problems, _, self.lower, self.upper, self.typical = tasks
        self.problems = problems._replace(weight=problems.weight.copy())
        self.best = np.clip(tasks.start, self.lower, self.upper)
        self.trial = self.best.copy()
        count, size = self.best.shape
        self.misfit = np.full(count, np.inf)
        self.damping = np.full(count, _FIRST_DAMPING)
        self.hoped = np.full(count, np.nan)  # fall of the misfit by the step before
        self.passes = np.zeros(count, int)
        self.finished = np.zeros(count, bool)
        shape = self.problems.observed.shape
        self.residual, self.jacobian = np.full(shape, np.nan), np.full((*shape, size), np.nan)
        self.normal, self.gradient = np.zeros((count, size, size)), np.zeros((count, size))

    def take(self, now: Places, residual: Floats, jacobian: Floats) -> NDArray[np.bool_]:
        """Take the answers of a pass and choose the next places."""
        self.passes[now] += 1
        near = self._parabola(residual, jacobian)
        better = (near.misfit <= self.misfit[now]) & np.isfinite(near.normal).all((1, 2))
        if not better.all():
            near = _Parabola(*(part[better] for part in near))
            residual, jacobian = residual[better], jacobian[better]
        run = run_of(now[better])
        self.best[run], self.residual[run] = self.trial[run], residual
        self.jacobian[run] = jacobian
        self._know(run, near)
        self.damping[now[~better]] *= 30
        self.hoped[now[~better]] = np.nan
        return self._chosen(now)

    def reweigh(self, now: Places, weight: Floats) -> NDArray[np.bool_]:
        """Go on under other weights: another scale of what is known already."""
        run = run_of(now)
        before = self.problems.weight[run]
        scale = weight / np.where(before > 0, before, 1.0)
        self.problems.weight[run] = weight
        self.trial[run], self.hoped[run] = self.best[run], np.nan
        self.damping[run], self.passes[run], self.finished[run] = _FIRST_DAMPING, 1, False
        self.residual[run] *= scale
        self.jacobian[run] *= scale[..., None]
        self._know(run, self._parabola(self.residual[run], self.jacobian[run]))
        return self._chosen(now)

    def solution(self, which: Places) -> Solution:
        """Where throws are, for as long as they stay there."""
        run = run_of(which)
        return Solution(
            self.best[run], self.residual[run], self.jacobian[run], self.passes[run],
            self.finished[run],
        )  # fmt: skip

    def _parabola(self, residual: Floats, jacobian: Floats) -> _Parabola:
        count, channels, rows, size = jacobian.shape
        matrix = jacobian.reshape(count, channels * rows, size)
        right = residual.reshape(count, channels * rows, 1)
        with np.errstate(invalid="ignore", over="ignore"):  # where there is no path
            return _Parabola(
                misfit=(right.mT @ right)[:, 0, 0],
                gradient=(matrix.mT @ right)[..., 0] * self.typical,
                normal=matrix.mT @ matrix * np.outer(self.typical, self.typical),
            )

    def _know(self, run: Places | slice, near: _Parabola) -> None:
        """What it is like at the best places so far."""
        self.misfit[run], self.gradient[run], self.normal[run] = near
        self.damping[run] = np.maximum(self.damping[run] / 10, _LEAST_DAMPING)

    def _chosen(self, now: Places) -> NDArray[np.bool_]:
        """Choose the next places."""
        lost = ~np.isfinite(self.misfit[now]) | (self.passes[now] >= _MOST_PASSES)
        lost |= self.damping[now] > _MOST_DAMPING
        gain = np.zeros(len(now))
        trying = ~lost
        while trying.any():
            gain[trying] = self._step(now[trying])
            # Cut off at a bound a step may lead uphill; a shorter one does not.
            trying &= (gain < -_GAIN * self.misfit[now]) & (self.damping[now] < _MOST_DAMPING)
            self.damping[now[trying]] *= 30
        # The step after this would win less by as much again as this than the one before.
        fewer = gain / np.maximum(self.hoped[now], 1e-300)
        after = gain * np.where(fewer < 1, fewer, 1.0)
        misfit = np.where(lost, 0.0, self.misfit[now])
        last = ~lost & (gain <= _GAIN * misfit) & (after <= _AFTER * misfit)
        self.hoped[now] = gain
        done = run_of(now[last])
        move = (self.trial[done] - self.best[done])[:, None, :, None]
        self.residual[done] += (self.jacobian[done] @ move)[..., 0]
        self.best[done] = self.trial[done]
        self.finished[done] = True
        return lost | last

    def _step(self, now: Places) -> Floats:
        """Choose the next places; the falls of the misfit that are hoped for."""
        best, lower, upper = self.best[now], self.lower[now], self.upper[now]
        normal, gradient = self.normal[now], self.gradient[now]
        held = (best <= lower) & (gradient >= 0) | (best >= upper) & (gradient <= 0)
        held |= lower >= upper
        size = np.where(held, 0.0, np.diagonal(normal, axis1=1, axis2=2))
        size = np.sqrt(np.maximum(size, 1e-24 * size.max(1, initial=0.0)[:, None] + 1e-300))
        free = np.where(held, 0.0, 1 / size)
        # Of unit diagonal, so that what damps it keeps it regular.
        matrix = normal * free[:, :, None] * free[:, None, :]
        damping = self.damping[now][:, None] + 1e-14
        matrix += np.eye(len(self.typical)) * np.where(held, 1.0, damping)[:, None]
        move = np.linalg.solve(matrix, -(gradient * free)[..., None])[..., 0] * free
        trial = np.clip(best + move * self.typical, lower, upper)
        self.trial[now] = trial
        taken = (trial - best) / self.typical
        curved = (normal @ taken[..., None])[..., 0]
        return -2 * (gradient * taken).sum(1) - (taken * curved).sum(1)
