"""The optimum of several throws that share parameters.

The normal matrix has the shape of an arrow: each throw depends on the shared coefficients and its
own parameters only. The normal equations of each throw are formed separately and added up, so that
a step for a dozen throws costs little more than their paths. The search is that for single throws,
see `curlfit.numerics.levenberg_marquardt`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.identifiability import r_factors
from curlfit.inference.least_squares import Solution
from curlfit.inference.likelihood import linearize
from curlfit.inference.model import Model
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics import levenberg_marquardt as lm
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches

Progress = Callable[[int, float], None]

_TOGETHER = 4  # throws are computed in multiples of this many, so that few shapes are compiled
_CONTROL = lm.Control(1e-3, 1e-12, 1e-16)


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
        self.bounds = lm.Bounds(
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

    def r_factor(self, layout: Layout, jacobians: Floats | None = None) -> tuple[Floats, Floats]:
        """A small matrix and right-hand side with the same normal equations; priors come last.

        `jacobians` of the throws may take the place of those of the search.
        """
        count, p = layout.index.shape
        matrix = np.zeros((count * (p + 1), len(layout.names)))
        right = np.zeros(count * (p + 1))
        jacobians = self.each.jacobian if jacobians is None else jacobians
        for throw, factor in enumerate(r_factors(jacobians, self.each.residual)):
            rows = slice(throw * (p + 1), throw * (p + 1) + len(factor))
            matrix[rows, layout.index[throw]] = factor[:, :p]
            right[rows] = factor[:, p]
        if layout.penalty is None:
            return matrix, right
        residual, slope = layout.penalty.residual_and_slope(self.values)
        return np.concatenate([matrix, np.diag(slope)]), np.concatenate([right, residual])


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
    progress : called with the number of steps done and chi squared.
    """
    count, p = layout.index.shape
    batch = -(-count // _TOGETHER) * _TOGETHER
    rows, columns = layout.index[:, :, None], layout.index[:, None, :]
    typical = layout.bounds.typical
    search = lm.begin(start, layout.bounds, _CONTROL)
    residual = np.full(problems.observed.shape, np.nan)
    jacobian = np.full((*residual.shape, p), np.nan)
    while not search.done:
        here: tuple[Floats, Floats] = in_batches(
            partial(linearize, model), (search.trial[layout.index], problems), batch
        )
        with np.errstate(invalid="ignore", over="ignore"):  # where there is no path
            each = lm.quadratic_model(
                here[0].reshape(count, -1), here[1].reshape(count, -1, p), typical[layout.index]
            )
            gradient, hessian = np.zeros(len(typical)), np.zeros((len(typical), len(typical)))
            np.add.at(gradient, layout.index, each.gradient)
            np.add.at(hessian, (rows, columns), each.hessian)
            whole = lm.QuadraticModel(each.chi_squared.sum(), gradient, hessian)
            if layout.penalty is not None:
                whole = layout.penalty.added_to(whole, search.trial, typical)
            search, outcome = lm.advance(search, whole, layout.bounds, _CONTROL)
        if outcome.accepted:
            residual, jacobian = here
        if outcome.extrapolation.any():
            move = outcome.extrapolation[layout.index]
            residual = residual + (jacobian @ move[:, None, :, None])[..., 0]
        if progress is not None:
            progress(int(search.evaluations), float(search.model.chi_squared))
    steps, success = int(search.evaluations), bool(search.success)
    each_values = search.values[layout.index]
    solutions = Solution(
        each_values, residual, jacobian, np.full(count, steps), np.full(count, success),
        np.zeros(count),
    )  # fmt: skip
    return JointSolution(search.values, solutions, steps, success)
