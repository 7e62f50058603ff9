"""Many optima side by side.

Levenberg and Marquardt's method within bounds, as in `box.py`, for many throws at once: each pass
asks the model for the residuals and Jacobians of all throws that are on their way, which costs far
less than one throw after the other. A throw that has arrived leaves and the next takes its lane, so
none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, NamedTuple, TypeVar

from curlfit.likelihood import LANES, Problem, linearised, stacked

# isort: split
import jax
import numpy as np
from numpy.typing import NDArray

from curlfit.friction import Law, Load
from curlfit.parameters import ParameterSet
from curlfit.solving import Solution

Floats = NDArray[np.float64]
Key = TypeVar("Key")

_FIRST_DAMPING = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e8
_GAIN = 1e-10  # of the misfit, that a step would win: a last one, taken without another look
_MOST_PASSES = 80


class Task(NamedTuple, Generic[Key]):
    """A problem, where to begin, and whose it is. All tasks of a run have one shape."""

    key: Key
    problem: Problem
    start: Floats
    parameters: ParameterSet
    known: tuple[Any, Any] | None = None
    """residual and Jacobian at the start, where they are known"""


class _Lane(Generic[Key]):
    """A task on its way: the best place so far, what it is like there, and the next to try."""

    def __init__(self, task: Task[Key]) -> None:
        self.task = task
        self.lower, self.upper = task.parameters.lower, task.parameters.upper
        self.best = self.trial = np.clip(task.start, self.lower, self.upper)
        self.misfit = np.inf
        self.damping = _FIRST_DAMPING
        self.passes = 0
        self.finished = False
        self.residual: Any = None
        self.jacobian: Any = None
        self.over = task.known is not None and self.take(*task.known)

    def take(self, residual: Floats, jacobian: Floats) -> bool:
        """Take the answer of a pass and choose the next place; True where there is none."""
        self.passes += 1
        misfit = float((residual**2).sum())
        if misfit <= self.misfit and np.isfinite(misfit) and np.isfinite(jacobian).all():
            self.damping = max(self.damping / 10, _LEAST_DAMPING)
            self.best, self.misfit = self.trial, misfit
            # The lanes' arrays are written over by the next pass.
            self.residual, self.jacobian = residual.copy(), jacobian.copy()
            scaled = self.jacobian.reshape(-1, len(self.best)) * self.task.parameters.typical
            self.normal = scaled.T @ scaled
            self.gradient = residual.reshape(-1) @ scaled
        else:
            self.damping *= 30
        if self.residual is None or self.passes >= _MOST_PASSES or self.damping > _MOST_DAMPING:
            return True
        # Cut off at a bound a step may lead uphill; a shorter one does not.
        while (gain := self._step()) < -_GAIN * self.misfit and self.damping < _MOST_DAMPING:
            self.damping *= 30
        self.finished = gain <= _GAIN * self.misfit
        if self.finished:
            move = self.trial - self.best
            self.residual = self.residual + self.jacobian @ move
            self.best = self.trial
        return self.finished

    def _step(self) -> float:
        """Choose the next place; the fall of the misfit that is hoped for."""
        held = (self.best <= self.lower) & (self.gradient >= 0)
        held |= (self.best >= self.upper) & (self.gradient <= 0)
        held |= self.lower >= self.upper
        free = ~held
        normal = self.normal[np.ix_(free, free)]
        size = np.maximum(np.diag(normal), 1e-24 * np.diag(normal).max(initial=0.0) + 1e-300)
        move = np.zeros(len(self.best))
        move[free] = np.linalg.solve(
            normal + np.diag((self.damping + 1e-14) * size), -self.gradient[free]
        )
        step = move * self.task.parameters.typical
        self.trial = np.clip(self.best + step, self.lower, self.upper)
        taken = (self.trial - self.best) / self.task.parameters.typical
        return float(-2 * self.gradient @ taken - taken @ self.normal @ taken)

    def solution(self) -> Solution | None:
        """Where it ended; None where there was no path even at the start."""
        if self.residual is None:
            return None
        return Solution(self.best, self.residual, self.jacobian, self.passes, self.finished)


def solve_many(
    law: type[Law],
    load: Load,
    tasks: Iterable[Task[Key]],
    again: Callable[[Key, Solution], Task[Key] | None],
) -> Iterator[tuple[Key, Solution | None]]:
    """The optima of many problems of one shape, as they are found.

    `again` is shown each optimum and may answer with another task for the same key, which takes
    its place.
    """
    waiting = iter(tasks)
    lanes: list[_Lane[Key] | None] = [None] * LANES
    stack: Any = None
    trials = np.zeros(0)
    while True:
        for place in range(LANES):
            lane = lanes[place]
            while lane is None or lane.over:
                if lane is None:
                    task = next(waiting, None)
                else:
                    solution = lane.solution()
                    task = None if solution is None else again(lane.task.key, solution)
                    if task is None:
                        yield lane.task.key, solution
                        task = next(waiting, None)
                if task is None:
                    lane = None
                    break
                lane = _Lane(task)
                if stack is None:  # lanes that nothing is in follow the first throw
                    stack = stacked([task.problem] * LANES)
                    trials = np.tile(lane.trial, (LANES, 1))
                for whole, part in zip(
                    jax.tree.leaves(stack), jax.tree.leaves(task.problem), strict=True
                ):
                    whole[place] = part
            lanes[place] = lane
            if lane is not None:
                trials[place] = lane.trial
        busy = [(place, lane) for place, lane in enumerate(lanes) if lane is not None]
        if not busy:
            return
        residual, jacobian = map(np.asarray, linearised(law, load, trials, stack))
        for place, lane in busy:
            lane.over = lane.take(residual[place], jacobian[place])
