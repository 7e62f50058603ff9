"""Covariance of the estimates of a fit, and how far chi squared is from
quadratic within it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.entries import GaussNewtonInformation
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
    confined: LinearizedProblem
    """the problem at the optimum without the directions that only the bounds
    determine"""
    whole: LinearizedProblem
    """the problem at the optimum with these directions"""
    count: int
    """number of values in the problem"""
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
        bounded : values and bounds of the parameters.
        factors : those of the search, and those whose normal equations are the
            estimator's, which differ under a robust loss.
        jacobian : of the weighted residuals, shape (channels, n, parameters).
        has_priors : whether there is information besides these residuals.
        """
        searched, estimator = factors
        free = bounded.upper > bounded.lower
        confined = LinearizedProblem(
            searched.confined[:, -1], searched.confined[:, :-1], *bounded, typical, free
        )
        whole = confined._replace(jacobian=searched.whole[:, :-1])
        at_bound = confined.at_bound()
        open_, slack = confined.open(at_bound)

        def of_open(factor: Floats) -> Identifiability:
            ends = Bounded(*(part[open_] for part in bounded))
            return analyse(
                factor[:, :-1][:, open_],
                list(itertools.compress(names, open_)),
                ends.values,
                typical[open_],
                slack,
                ends,
            )

        identifiability = of_open(estimator.whole)
        of_data = of_open(estimator.of_data) if has_priors else identifiability
        matrix = identifiability.covariance - slack @ slack.T
        by_open = jacobian[..., open_]
        effect = by_open @ matrix
        leverage = (effect * by_open).sum(-1)
        return cls(
            names=names,
            values=bounded.values,
            typical=typical,
            factor=searched.confined,
            identifiability=identifiability,
            of_data=of_data,
            free=free,
            at_bound=at_bound,
            open=open_,
            matrix=matrix,
            distance=float(confined.distance(sigmas.total, whole)),
            effect=effect,
            dof=sigmas.dof(leverage),
            leverage=leverage,
            has_priors=has_priors,
            confined=confined,
            whole=whole,
            count=sigmas.total,
        )

    def distance_beside(self, indices: Iterable[int]) -> float:
        """Distance to the optimum along all parameters but these, standard errors."""
        others = self.free.copy()
        others[list(indices)] = False
        whole = self.whole._replace(free=others)
        return float(self.confined._replace(free=others).distance(self.count, whole))

    def degrees_of_freedom(self, weights: Floats) -> list[float | None]:
        """For the variances of weighted sums of the open parameters, one per row of
        weights; None where all sigmas were given."""
        # Parts of each variance, one column for each channel's noise.
        parts = ((self.effect @ weights.T) ** 2).sum(1).T
        dof = self.dof
        if self.others is not None:
            parts = np.hstack([parts, self.others.parts(weights)])
            dof = np.append(dof, self.others.dof)
        if self.has_priors:
            # The rest is the part of the priors, which are known exactly.
            variances = ((weights @ self.matrix) * weights).sum(-1)
            parts = np.column_stack([parts, variances - parts.sum(-1)])
            dof = np.append(dof, np.inf)
        return satterthwaite(parts, dof)

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """What is determined in place of single parameters."""
        combinations = self.identifiability.combinations
        if not combinations:
            return ()
        statements = self.identifiability.determined()
        weights = [statements[combination.expression] for combination in combinations]
        degrees = self.degrees_of_freedom(np.array(weights))
        return tuple(
            replace(combination, dof=dof)
            for combination, dof in zip(combinations, degrees, strict=True)
        )

    @cached_property
    def _dof_of_parameters(self) -> list[float | None]:
        """Degrees of freedom of the standard errors of the open parameters."""
        return self.degrees_of_freedom(np.eye(len(self.matrix)))

    def _among_open(self, index: int) -> int:
        """Place of an open parameter among the open ones."""
        return int(self.open[:index].sum())

    def classified(self, index: int) -> tuple[float | None, Verdict, float | None]:
        """Standard error of a free parameter, where there is one, its verdict, and the
        degrees of freedom of the error."""
        among_open = self._among_open(index)
        typical = self.typical[index]
        at_bound = self.at_bound[index]
        stderr, verdict = classify(typical, at_bound, self.identifiability, among_open)
        if stderr is None:
            return None, verdict, None
        if verdict == Verdict.DETERMINED and self.has_priors:
            _, verdict_of_data = classify(typical, at_bound, self.of_data, among_open)
            if verdict_of_data != verdict:
                verdict = Verdict.PRIOR
        return stderr, verdict, self._dof_of_parameters[among_open]

    def shifts(self, gradients: Mapping[str, Floats]) -> dict[str, Floats]:
        """Shifts of the open parameters from the estimates to the true values, by
        condition; `gradients` are J^T times the change of the residuals by each
        condition."""
        factor = self.factor[:, :-1][:, self.open]
        of_open = {
            condition: gradient[self.open] for condition, gradient in gradients.items()
        }
        return shifts(factor, of_open, self.typical[self.open])

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

    def information(self) -> GaussNewtonInformation:
        """The information matrix J^T J of the free parameters, and the gradient of the
        log-likelihood."""
        jacobian = self.factor[:, :-1][:, self.free]
        return GaussNewtonInformation(
            names=tuple(itertools.compress(self.names, self.free)),
            matrix=jacobian.T @ jacobian,
            gradient=-self.factor[:, -1] @ jacobian,
        )

    def stderr(self, weights: Floats) -> float:
        """Standard error of a weighted sum of the open parameters."""
        covariance = self.identifiability.covariance
        return math.sqrt(weights @ covariance @ weights)

    def in_all(self, weights: Floats) -> Floats:
        """Weights of the open parameters as those of all."""
        in_all = np.zeros(len(self.typical))
        in_all[self.open] = weights
        return in_all

    def rooms(self) -> dict[str, float]:
        """Widths of the intervals between the bounds of the parameters, over their
        typical sizes, by name."""
        widths = (self.confined.upper - self.confined.lower) / self.typical
        return dict(zip(self.names, widths.tolist(), strict=True))

    def error_of(self, index: int) -> float:
        """Standard error of a parameter; infinite where nothing is known of it."""
        if not self.open[index]:
            return math.inf
        among_open = self._among_open(index)
        if self.identifiability.unseen[among_open]:
            return math.inf
        return math.sqrt(self.identifiability.covariance[among_open, among_open])


def first_order(
    names: Sequence[str], factors: Factors, bounded: Bounded, typical: Floats
) -> Covariance:
    """What R factors say of parameters, without the data that they are of."""
    no_residuals = np.zeros((1, 1, len(typical)))
    sigmas = Sigmas(
        number=np.ones(1, int),
        estimated=np.zeros(1, bool),
        loss=LINEAR,
        total=len(typical),
    )
    return Covariance.of(
        names, bounded, typical, (factors, factors), no_residuals, sigmas, True
    )


def satterthwaite(parts: Floats, dof: Floats) -> list[float | None]:
    """Degrees of freedom of sums of estimated variances, along the rows of `parts`
    (Satterthwaite 1946, eq. 17); None where all are known, or those with finite `dof`
    contribute less than a thousandth, so that Student's distribution is normal to
    rounding of what is printed."""
    size = np.abs(parts)
    estimated = np.where(np.isfinite(dof), size, 0.0).sum(-1)
    is_known = ~(estimated > _KNOWN * size.sum(-1))
    spread = np.where(is_known, 1.0, (parts**2 / dof).sum(-1))
    degrees = parts.sum(-1) ** 2 / spread
    return [
        None if exact else number
        for number, exact in zip(degrees.tolist(), is_known, strict=True)
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
        """Parts of the variances of weighted sums of the open parameters, one per row
        of weights, shape (sums, throws times channels); 0 of the throw itself."""
        along = weights @ self.follow
        parts = np.einsum("wi,tcij,wj->wtc", along, self.matrices, along)
        parts[:, self.own] = 0.0
        return parts.reshape(len(along), -1)


def with_others(
    covariances: Sequence[Covariance], reduction: Reduction
) -> list[Covariance]:
    """Covariances of throws that are fitted together, each with the noise of the
    others."""
    common = reduction.common
    first = covariances[0].effect
    effects = np.zeros((len(covariances), *first.shape[:-1], len(common)))
    for effect, covariance in zip(effects, covariances, strict=True):
        effect[..., covariance.open] = covariance.effect
    in_common = effects[..., common]
    matrices = in_common.mT @ in_common
    dof = np.stack([covariance.dof for covariance in covariances])
    completed = []
    for index, covariance in enumerate(covariances):
        follow = reduction.follow[index][covariance.open][:, common]
        others = OtherThrows(follow, matrices, dof, own=index)
        completed.append(replace(covariance, others=others))
    return completed


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
    throws, channels = jacobians.shape[:2]
    for channel in np.ndindex(throws, channels):
        weight = problems.weight[channel]
        over_sigma = -residual[channel] * weight
        precision = loss.precision(over_sigma[weight > 0])
        # In the search each residual was scaled by the root of the loss's slope.
        jacobians[channel] *= np.sqrt(precision) / loss.root_slope(over_sigma)[:, None]
    return jacobians
