"""Covariance of the estimates of a fit, and how far chi squared is from
quadratic within it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.factors import Factors, LinearizedProblem, Reduction
from curlfit.inference.fit.systematics import shifts
from curlfit.inference.identifiability import (
    Bounded,
    Combination,
    Identifiability,
    analyse,
    classify,
)
from curlfit.inference.least_squares import Solution
from curlfit.inference.problem import Problem
from curlfit.inference.verdict import Verdict
from curlfit.losses import LINEAR, Loss
from curlfit.numerics.arrays import Booleans, Floats

CONVERGED = 0.01
"""Distance to the optimum, in standard errors, at which a fit has converged."""
# share of estimated variances in a sum below which the sum counts as known
_KNOWN = 1e-3


@dataclass(frozen=True, eq=False)
class Covariance:
    """First-order uncertainties of the parameters at the optimum of a throw, or of
    several with parameters in common."""

    names: Sequence[str]
    values: Floats
    """in the data's coordinates"""
    typical: Floats
    factor: Floats
    """R factor of the Jacobian, with the residual as the last column
    (`Factors.confined`)"""
    identifiability: Identifiability
    of_data: Identifiability
    """identifiability from the data without the priors"""
    free: Booleans
    at_bound: Booleans
    open: Booleans
    matrix: Floats
    """covariance of the open parameters while those at a bound stay there"""
    distance: float
    """to the optimum, standard errors"""
    effect: Floats
    """change of the open parameters for a change of each residual by its sigma, shape
    (channels, n, open)"""
    dof: Floats
    """degrees of freedom of each channel's sigma; infinite where it was given"""
    leverage: Floats
    """of each value on its own fitted value, 0 to 1, shape (channels, n)"""
    has_priors: bool
    linearized: tuple[LinearizedProblem, LinearizedProblem, int]
    """the problem at the optimum, that with the directions that only the bounds
    determine, and its number of values"""
    others: OtherThrows | None = None
    """of a throw that is fitted together with others"""

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        bounded: Bounded,
        typical: Floats,
        factors: tuple[Factors, Factors],
        jacobian: Floats,
        sigmas: Sigmas,
        has_priors: bool,
    ) -> Self:
        """At the optimum of a problem.

        Parameters
        ----------
        bounded : in the data's coordinates.
        factors : those of the search, and those whose normal equations are the
            estimator's, which differ under a robust loss.
        jacobian : of the weighted residuals, shape (channels, n, parameters).
        has_priors : whether there is information besides these residuals.
        """
        searched, estimator = factors
        free = bounded.upper > bounded.lower
        problem = LinearizedProblem(
            searched.confined[:, -1], searched.confined[:, :-1], *bounded, typical, free
        )
        at_bound = problem.at_bound()
        open_, slack = problem.open(at_bound)
        ends = Bounded(*(part[open_] for part in bounded))
        about = (
            list(itertools.compress(names, open_)),
            ends.values,
            typical[open_],
            slack,
            ends,
        )
        known = of_data = analyse(estimator.whole[:, :-1][:, open_], *about)
        if has_priors:
            of_data = analyse(estimator.of_data[:, :-1][:, open_], *about)
        matrix, by_open = known.covariance - slack @ slack.T, jacobian[..., open_]
        effect = by_open @ matrix
        leverage = (effect * by_open).sum(-1)
        whole = problem._replace(jacobian=searched.whole[:, :-1])
        return cls(
            names,
            bounded.values,
            typical,
            searched.confined,
            known,
            of_data,
            free,
            at_bound,
            open_,
            matrix,
            float(problem.distance(sigmas.total, whole)),
            effect,
            sigmas.dof(leverage),
            leverage,
            has_priors,
            (problem, whole, sigmas.total),
        )

    def distance_beside(self, indices: Iterable[int]) -> float:
        """Distance to the optimum along all parameters but these, standard errors."""
        others = self.free.copy()
        others[list(indices)] = False
        problem, whole, count = self.linearized
        whole = whole._replace(free=others)
        return float(problem._replace(free=others).distance(count, whole))

    def degrees_of_freedom(self, weights: Floats) -> list[float | None]:
        """For the variances of weighted sums of the open parameters, one per row of
        weights; None where all sigmas were given."""
        parts = ((self.effect @ weights.T) ** 2).sum(1).T
        dof = self.dof
        if self.others is not None:
            parts = np.hstack([parts, self.others.parts(weights)])
            dof = np.append(dof, self.others.dof)
        if self.has_priors:  # which are known exactly
            rest = ((weights @ self.matrix) * weights).sum(-1) - parts.sum(-1)
            parts, dof = np.column_stack([parts, rest]), np.append(dof, np.inf)
        return satterthwaite(parts, dof)

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """What is determined in place of single parameters."""
        known = self.identifiability
        weights = list(known.determined().values())[-len(known.combinations) :]
        dof = self.degrees_of_freedom(np.array(weights)) if known.combinations else []
        return tuple(
            replace(item, dof=n)
            for item, n in zip(known.combinations, dof, strict=True)
        )

    @cached_property
    def _dof_of_each(self) -> list[float | None]:
        return self.degrees_of_freedom(np.eye(len(self.matrix)))

    def classified(self, place: int) -> tuple[float | None, Verdict, float | None]:
        """Standard error of a free parameter, where there is one, its verdict, and the
        degrees of freedom of the error."""
        index, about = (
            int(self.open[:place].sum()),
            (self.typical[place], self.at_bound[place]),
        )
        stderr, verdict = classify(*about, self.identifiability, index)
        if stderr is None:
            return None, verdict, None
        if verdict == Verdict.DETERMINED and self.has_priors:
            alone = classify(*about, self.of_data, index)[1]
            if alone != verdict:
                verdict = Verdict.PRIOR
        return stderr, verdict, self._dof_of_each[index]

    def shifts(self, gradients: Mapping[str, Floats]) -> dict[str, Floats]:
        """Shifts of the open parameters from the estimates to the true values, by
        condition; `gradients` are J^T times the change of the residuals by each
        condition."""
        typical = self.typical[self.open]
        mine = {name: gradient[self.open] for name, gradient in gradients.items()}
        return shifts(self.factor[:, :-1][:, self.open], mine, typical)

    def shifts_of_determined(
        self, by_condition: Mapping[str, Floats]
    ) -> dict[str, dict[str, float]]:
        """Shifts of what is determined, by parameter or combination and by condition,
        from those of the open parameters."""
        return {
            name: {
                condition: float(row @ shift)
                for condition, shift in by_condition.items()
            }
            for name, row in self.identifiability.determined().items()
        }

    def information(self) -> dict[str, list[Any]]:
        """The information matrix J^T J of the free parameters, and the gradient of the
        log-likelihood."""
        jacobian = self.factor[:, :-1][:, self.free]
        return {
            "names": list(itertools.compress(self.names, self.free)),
            "gradient": (-self.factor[:, -1] @ jacobian).tolist(),
            "matrix": (jacobian.T @ jacobian).tolist(),
        }

    def stderr(self, weights: Floats) -> float:
        """Standard error of a weighted sum of the open parameters."""
        covariance = self.identifiability.covariance
        return math.sqrt(weights @ covariance @ weights)

    def in_all(self, weights: Floats) -> Floats:
        """Weights of the open parameters as those of all."""
        every = np.zeros(len(self.typical))
        every[self.open] = weights
        return every

    def rooms(self) -> dict[str, float]:
        """Widths of the intervals between the bounds of the parameters, over their
        typical sizes, by name."""
        problem, _, _ = self.linearized
        widths = (problem.upper - problem.lower) / self.typical
        return dict(zip(self.names, widths.tolist(), strict=True))

    def error_of(self, index: int) -> float:
        """Standard error of a parameter; infinite where nothing is known of it."""
        if not self.open[index]:
            return math.inf
        place = int(self.open[:index].sum())
        if self.identifiability.unseen[place]:
            return math.inf
        return math.sqrt(self.identifiability.covariance[place, place])


def first_order(
    names: Sequence[str], factors: Factors, bounded: Bounded, typical: Floats
) -> Covariance:
    """What R factors say of parameters, without the data that they are of."""
    nothing = np.zeros((1, 1, len(typical)))
    sigmas = Sigmas(np.ones(1, int), np.zeros(1, bool), LINEAR, len(typical))
    return Covariance.of(
        names, bounded, typical, (factors, factors), nothing, sigmas, True
    )


def satterthwaite(parts: Floats, dof: Floats) -> list[float | None]:
    """Degrees of freedom of sums of estimated variances, along the rows of `parts`
    (Satterthwaite 1946, eq. 17); None where all are known, or those with finite `dof`
    contribute less than a thousandth, so that Student's distribution is normal to
    rounding of what is printed."""
    size = np.abs(parts)
    known = ~(np.where(np.isfinite(dof), size, 0.0).sum(-1) > _KNOWN * size.sum(-1))
    found = parts.sum(-1) ** 2 / np.where(known, 1.0, (parts**2 / dof).sum(-1))
    return [
        None if exact else n for n, exact in zip(found.tolist(), known, strict=True)
    ]


class OtherThrows(NamedTuple):
    """What the noise of the other throws contributes to the variances of a
    throw's estimates."""

    follow: Floats
    """change of the open parameters with those in common, shape (open, common)"""
    matrices: Floats
    """covariance of those in common due to each channel of all throws, shape (throws,
    channels, common, common)"""
    dof: Floats
    """of each channel's sigma, shape (throws, channels)"""
    own: int
    """index of the throw itself"""

    def parts(self, weights: Floats) -> Floats:
        """Of the variances of weighted sums of the open parameters, one per
        row of weights."""
        along = weights @ self.follow
        found = np.einsum("wi,tcij,wj->wtc", along, self.matrices, along)
        found[:, self.own] = 0.0
        return found.reshape(len(along), -1)


def with_others(found: Sequence[Covariance], reduction: Reduction) -> list[Covariance]:
    """Those of throws that are fitted together, each with the noise of the others."""
    common = reduction.common
    effects = np.zeros((len(found), *found[0].effect.shape[:-1], len(common)))
    for effect, one in zip(effects, found, strict=True):
        effect[..., one.open] = one.effect
    effects = effects[..., common]
    matrices, dof = effects.mT @ effects, np.stack([one.dof for one in found])
    return [
        replace(
            one, others=OtherThrows(follow[one.open][:, common], matrices, dof, row)
        )
        for row, (one, follow) in enumerate(zip(found, reduction.follow, strict=True))
    ]


class Sigmas(NamedTuple):
    """How the sigmas of the channels of a problem are known."""

    number: NDArray[np.int64]
    """of values"""
    estimated: Booleans
    loss: Loss
    total: int
    """number of values in all channels, of all throws that are fitted together"""

    def dof(self, leverage: Floats) -> Floats:
        """Degrees of freedom n - p of each sigma; infinite where it was given. The sum
        of the `leverage` of each value, shape (..., n), over a channel is its p."""
        dof = np.maximum(self.number - leverage.sum(-1), 1.0)
        return np.where(self.estimated, self.loss.sigma_efficiency * dof, np.inf)


def robust_jacobians(
    problems: Problem, solutions: Solution, residual: Floats, loss: Loss
) -> Floats:
    """Jacobians of throws, of shape (throws, channels, n, parameters), whose normal
    equations are those of the estimator: those of the residuals over their sigma, each
    channel rescaled for a robust loss.

    The covariance of an M-estimator is that of least squares divided by
    `Loss.precision` (Huber 1981). `residual` is measured - fitted.
    """
    jacobians: Floats = solutions.jacobian.copy()
    for place in np.ndindex(jacobians.shape[:2]):
        weight = problems.weight[place]
        r = -residual[place] * weight
        precision = loss.precision(r[weight > 0])
        jacobians[place] *= np.sqrt(precision) / loss.root_slope(r)[:, None]
    return jacobians
