"""The optimum of several throws that have parameters in common.

The Jacobian has the shape of an arrow: each throw knows the shared coefficients and its own
parameters. Each throw's rows are reduced to a small triangle by QR before anything is put together,
so that a step for a dozen throws costs little more than their paths. Levenberg and Marquardt's
damping, bounds by `scipy.optimize.lsq_linear`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from curlfit.inference.likelihood import Problem, by_lanes, linearised, stacked

# isort: split
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from curlfit.friction import Law, Load
from curlfit.inference.identifiability import few_rows
from curlfit.inference.least_squares import Solution
from curlfit.inference.parameters import ParameterSet

Floats = NDArray[np.float64]

_TOGETHER = 4  # throws are computed in multiples of this many, so that few shapes are compiled
_MOST_STEPS = 60
_FIRST_DAMPING = 1e-3
_LEAST_DAMPING = 1e-12
_TOLERANCE = 1e-9  # relative gain of a step, below which the search ends


class Layout(NamedTuple):
    """Where the parameters of each throw lie in the joint vector."""

    places: NDArray[np.int64]
    """shape (throws, parameters of a throw)"""
    names: tuple[str, ...]


def layout_of(names: Sequence[str], shared: Sequence[str], count: int) -> Layout:
    """The layout for some throws, from the names of one throw's parameters and the shared ones."""
    joint = list(shared)
    places = np.zeros((count, len(names)), int)
    for throw in range(count):
        for column, name in enumerate(names):
            if name in shared:
                places[throw, column] = shared.index(name)
            else:
                places[throw, column] = len(joint)
                joint.append(f"{name}[{throw + 1}]")
    return Layout(places, tuple(joint))


class Bench:
    """Throws side by side: residuals and Jacobians of all of them at once."""

    def __init__(self, law: type[Law], load: Load, problems: Sequence[Problem]) -> None:
        self.law, self.load, self.count = law, load, len(problems)
        rows = max(problem.observed.shape[0] for problem in problems)
        size = max(problem.observed.shape[1] for problem in problems)
        self.stacked = stacked([padded(problem, rows, size) for problem in problems])

    def at(self, values: Floats) -> tuple[Floats, Floats]:
        """Residual and Jacobian for values of shape (throws, parameters)."""
        lanes = -(-self.count // _TOGETHER) * _TOGETHER
        program = partial(linearised, self.law, self.load)
        residual, jacobian = by_lanes(program, (values, self.stacked), lanes)
        return residual, jacobian


def padded(problem: Problem, rows: int, size: int) -> Problem:
    """The same problem with so many channels and rows; the new ones are not seen."""
    c, n = problem.observed.shape
    pad = ((0, rows - c), (0, size - n))
    return problem._replace(
        times=np.pad(problem.times, (0, size - n), mode="edge"),
        observed=np.pad(problem.observed, pad),
        weight=np.pad(problem.weight, pad),
    )


class State(NamedTuple):
    """Where the search is."""

    values: Floats
    """joint vector, in the coordinates of the problems"""
    residual: Floats
    """shape (throws, channels, n)"""
    jacobian: Floats
    """by each throw's own parameters, shape (throws, channels, n, parameters of a throw)"""
    cost: float
    steps: int
    finished: bool


class Search:
    """Levenberg and Marquardt on the arrow."""

    def __init__(
        self,
        local: Sequence[ParameterSet],
        layout: Layout,
        progress: Callable[[int, float], None] | None,
    ) -> None:
        self.layout, self.progress = layout, progress
        self.lower = self._intersected([item.lower for item in local], np.maximum)
        self.upper = self._intersected([item.upper for item in local], np.minimum)
        self.typical = self.gather(np.stack([item.typical for item in local]))
        self.free = self.upper > self.lower

    def _intersected(self, ends: Sequence[Floats], choose: Any) -> Floats:
        found = self.gather(np.stack(ends))
        for throw, own in enumerate(ends):
            places = self.layout.places[throw]
            found[places] = choose(found[places], own)
        return found

    def gather(self, values: Floats) -> Floats:
        """The joint vector from each throw's own; shared parameters are averaged."""
        total = np.zeros(len(self.layout.names))
        count = np.zeros(len(self.layout.names))
        np.add.at(total, self.layout.places, np.where(np.isfinite(values), values, 0.0))
        np.add.at(count, self.layout.places, 1.0)
        found = total / count
        infinite = ~np.isfinite(values)
        found[self.layout.places[infinite]] = values[infinite]
        return found

    def solution(self, state: State, throw: int) -> Solution:
        """One throw's part of a state."""
        return Solution(
            values=state.values[self.layout.places[throw]],
            residual=state.residual[throw],
            jacobian=state.jacobian[throw],
            steps=state.steps,
            finished=state.finished,
        )

    def compressed(self, state: State) -> tuple[Floats, Floats]:
        """A small matrix and right side with the same normal equations."""
        count, p = self.layout.places.shape
        matrix = np.zeros((count * (p + 1), len(self.layout.names)))
        right = np.zeros(count * (p + 1))
        for throw, few in enumerate(few_rows(state.jacobian, state.residual)):
            here = slice(throw * (p + 1), throw * (p + 1) + len(few))
            matrix[here, self.layout.places[throw]] = few[:, :p]
            right[here] = few[:, p]
        return matrix, right

    def _at(self, bench: Bench, values: Floats, steps: int) -> State:
        residual, jacobian = bench.at(values[self.layout.places])
        cost = float((residual**2).sum())
        if not np.isfinite(jacobian).all():
            cost = np.inf
        return State(values, residual, jacobian, cost, steps, False)

    def run(self, bench: Bench, values: Floats) -> State:
        """The optimum reached from a joint vector."""
        now = self._at(bench, np.clip(values, self.lower, self.upper), 0)
        damping = _FIRST_DAMPING
        for step in range(1, _MOST_STEPS + 1):
            if not np.isfinite(now.cost):
                return now
            trial = self._at(bench, now.values + self._move(now, damping), step)
            if self.progress is not None:
                self.progress(step, min(now.cost, trial.cost))
            gain = now.cost - trial.cost
            small = abs(gain) <= _TOLERANCE * now.cost
            now = trial if gain >= 0 else now
            if small and damping <= _LEAST_DAMPING:
                return now._replace(finished=True)
            if small:
                damping = _LEAST_DAMPING  # damping may be what kept it from going on
            elif gain > 0:
                damping = max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
                if damping > 1e8:
                    return now._replace(finished=True)
        return now

    def _move(self, state: State, damping: float) -> Floats:
        matrix, right = self.compressed(state)
        matrix = matrix[:, self.free]
        size = np.linalg.norm(matrix, axis=0)
        size = np.maximum(size, 1e-12 * size.max())
        stacked = np.concatenate([matrix / size, np.sqrt(damping) * np.eye(matrix.shape[1])])
        goal = -np.concatenate([right, np.zeros(matrix.shape[1])])
        low = (self.lower - state.values)[self.free] * size
        high = (self.upper - state.values)[self.free] * size
        found = np.linalg.lstsq(stacked, goal, rcond=None)[0]
        if (found < low).any() or (found > high).any():
            found = lsq_linear(stacked, goal, (low, np.maximum(high, low + 1e-300))).x
        move = np.zeros(len(self.lower))
        move[self.free] = np.clip(found, low, high) / size
        return move
