"""The optimum of several throws that share parameters.

The normal matrix has the shape of an arrow: each throw depends on the shared coefficients and its
own parameters only. The normal equations of each throw are formed separately and added up, so that
a step for a dozen throws costs little more than their paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from curlfit.inference.least_squares import Control, Solution, Tasks, solve
from curlfit.inference.model import Model
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked

Progress = Callable[[int, float], None]

_TOGETHER = 4  # throws are computed in multiples of this many, so that few shapes are compiled
_CONTROL = Control(1e-3, 1e-12, 1e-16)


class Bounds(NamedTuple):
    """Bounds of the joint vector, and the typical sizes of its parameters."""

    lower: Floats
    upper: Floats
    typical: Floats


class Layout:
    """Indices of the parameters of each throw in the joint vector.

    Attributes
    ----------
    index : shape (throws, parameters of a throw).
    names : of the joint vector, the shared parameters first.
    bounds : of the joint vector; those of a shared parameter are the intersection over the throws.
    penalty : of the joint vector, from the priors; None without any.
    """

    def __init__(self, sets: Sequence[ParameterSet], shared: Sequence[str]) -> None:
        """`sets` are the parameters of each throw, in the coordinates of its problem."""
        names = list(shared)
        self.index = np.zeros((len(sets), len(sets[0])), int)
        for throw, parameters in enumerate(sets):
            for column, name in enumerate(parameters.names):
                if name in shared:
                    self.index[throw, column] = shared.index(name)
                else:
                    self.index[throw, column] = len(names)
                    names.append(f"{name}[{throw + 1}]")
        self.names = tuple(names)
        self.bounds = Bounds(
            self._intersection([item.lower for item in sets], np.maximum),
            self._intersection([item.upper for item in sets], np.minimum),
            self.joined(np.stack([item.typical for item in sets])),
        )
        penalties = [item.penalty for item in sets]
        self.penalty = None
        if penalties[0] is not None:
            # The prior of a shared parameter counts once.
            self.penalty = Penalty(
                *(self.joined(np.stack(part)) for part in zip(*penalties, strict=True))
            )

    @property
    def free(self) -> Booleans:
        """Which parameters are to be determined."""
        return np.asarray(self.bounds.upper > self.bounds.lower)

    def joined(self, values: Floats) -> Floats:
        """The joint vector from that of each throw; shared parameters are averaged."""
        total, count = np.zeros((2, len(self.names)))
        np.add.at(total, self.index, np.where(np.isfinite(values), values, 0.0))
        np.add.at(count, self.index, 1.0)
        found = total / count
        infinite = ~np.isfinite(values)
        found[self.index[infinite]] = values[infinite]
        return found

    def widened(self, jacobians: Floats) -> Floats:
        """Jacobians of throws, along the first axis, by the joint vector; further columns stay."""
        size, own = len(self.names), self.index.shape[1]
        found = np.zeros((*jacobians.shape[:-1], size + jacobians.shape[-1] - own))
        for one, index, jacobian in zip(found, self.index, jacobians, strict=True):
            one[..., index], one[..., size:] = jacobian[..., :own], jacobian[..., own:]
        return found

    def tasks(self, problems: Problem, start: Floats) -> Tasks:
        """The joint problem, with throws of no weight, whose parameters are fixed, added to a
        multiple of `_TOGETHER`."""
        count, size = len(self.index), len(start)
        added = -count % _TOGETHER
        own = self.index[-1] != self.index[0]
        blocks = np.concatenate([self.index, np.repeat(self.index[-1:], added, 0)])
        blocks[count:, own] = size + np.arange(added * own.sum()).reshape(added, own.sum())
        rows = np.concatenate([np.arange(size), np.tile(self.index[-1, own], added)])
        start, lower, upper, typical = (part[rows] for part in (start, *self.bounds))
        lower[size:] = upper[size:] = start[size:]
        penalty = None if self.penalty is None else Penalty(*(part[rows] for part in self.penalty))
        if penalty is not None:
            penalty.weight[size:] = 0.0
        throws = np.minimum(np.arange(count + added), count - 1)
        padded: Problem = jax.tree.map(lambda leaf: leaf[throws], problems)
        padded.weight[count:] = 0.0
        whole = stacked([Tasks(padded, start, lower, upper, typical, penalty)])
        return whole._replace(typical=typical, blocks=blocks)

    def _intersection(self, ends: Sequence[Floats], choose: Any) -> Floats:
        found = self.joined(np.stack(ends))
        for index, own in zip(self.index, ends, strict=True):
            found[index] = choose(found[index], own)
        return found


class JointSolution(NamedTuple):
    """The optimum of several throws together, in the coordinates of their problems."""

    values: Floats
    """joint vector"""
    each: Solution
    """of the throws, along the first axis of each field"""
    steps: int
    success: bool

    @property
    def chi_squared(self) -> float:
        """Sum over all throws."""
        return float(self.each.chi_squared.sum())


def minimize_jointly(
    model: Model,
    problems: Problem,
    layout: Layout,
    start: Floats,
    progress: Progress | None = None,
) -> JointSolution:
    """The optimum reached from a joint vector.

    Parameters
    ----------
    problems : throws along the first axis.
    progress : called at the end with the number of steps and chi squared.
    """
    found = solve(model, layout.tasks(problems, start), _CONTROL, once=False)
    whole: Solution = jax.tree.map(lambda leaf: leaf[0], found)
    count, values = len(layout.index), whole.values[: len(start)]
    steps, success = int(whole.steps), bool(whole.success)
    each = Solution(
        values[layout.index], whole.residual[:count], whole.jacobian[:count],
        np.full(count, steps), np.full(count, success), np.zeros(count),
    )  # fmt: skip
    if progress is not None:
        progress(steps, float(whole.chi_squared.sum() + whole.penalty))
    return JointSolution(values, each, steps, success)
