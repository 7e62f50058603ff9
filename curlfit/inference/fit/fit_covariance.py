"""Errors of the estimates of a fit: those of its information, with the degrees of
freedom that its sigmas leave them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.model.problem import Problem
from curlfit.inference.solve.least_squares import Solution
from curlfit.losses import Loss
from curlfit.numerics.arrays import Booleans, Floats

_KNOWN = 1e-3
"""Share of estimated variances in a sum, below which the sum counts as known: Student's
distribution is then normal to rounding of what is printed."""


@dataclass(frozen=True, eq=False)
class FitCovariance(Covariance):
    """First-order uncertainties of the parameters at the optimum of a throw, or of
    several with parameters in common, whose noise was estimated from the residuals."""

    effect: Floats
    """change of the open parameters for a change of each residual by its sigma, shape
    (channels, n, open)"""
    dof: Floats
    """degrees of freedom of each channel's sigma; infinite where it was given"""
    leverage: Floats
    """of each value on its own fitted value, 0 to 1, shape (channels, n)"""
    has_priors: bool
    others: OtherThrows | None = None
    """of a throw that is fitted together with others"""

    @classmethod
    def of_fit(
        cls,
        information: Information,
        estimator: Information,
        of_data: Information | None,
        jacobian: Floats,
        sigmas: Sigmas,
    ) -> Self:
        """At the optimum of a problem.

        Parameters
        ----------
        information, estimator, of_data : see `Covariance.of`.
        jacobian : of the weighted residuals, shape (channels, n, parameters).
        """
        covariance = Covariance.of(information, estimator, of_data, sigmas.total)
        by_open = jacobian[..., covariance.open]
        effect = by_open @ covariance.conditional_matrix
        leverage = (effect * by_open).sum(-1)
        return cls(
            **vars(covariance),
            effect=effect,
            dof=sigmas.dof(leverage),
            leverage=leverage,
            has_priors=of_data is not None,
        )

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
            variances = ((weights @ self.conditional_matrix) * weights).sum(-1)
            parts = np.column_stack([parts, variances - parts.sum(-1)])
            dof = np.append(dof, np.inf)
        return satterthwaite(parts, dof)


def satterthwaite(parts: Floats, dof: Floats) -> list[float | None]:
    """Degrees of freedom of sums of estimated variances, along the rows of `parts`
    (Satterthwaite 1946, eq. 17); None where all are known, or all but a thousandth."""
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
    covariances: Sequence[FitCovariance], marginal: Marginal
) -> list[FitCovariance]:
    """Covariances of throws that are fitted together, each with the noise of the
    others."""
    common = marginal.common
    first = covariances[0].effect
    effects = np.zeros((len(covariances), *first.shape[:-1], len(common)))
    for effect, covariance in zip(effects, covariances, strict=True):
        effect[..., covariance.open] = covariance.effect
    in_common = effects[..., common]
    matrices = in_common.mT @ in_common
    dof = np.stack([covariance.dof for covariance in covariances])
    completed = []
    for index, covariance in enumerate(covariances):
        follow = marginal.follow[index][covariance.open]
        other_throws = OtherThrows(follow, matrices, dof, own=index)
        completed.append(replace(covariance, others=other_throws))
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
