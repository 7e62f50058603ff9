"""Draws from the posterior of a fit without a chain, along the whole ridge."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.fit.result import FitResult
from curlfit.inference.sampling.density import PosteriorDensity
from curlfit.inference.sampling.ridge import posterior_proposal
from curlfit.numerics.arrays import Floats

_PROPOSED = 8
"""Proposals for each draw: along a curve about half of them count."""


class WeightedProposals(NamedTuple):
    """Proposals along the ridge of a fit, and what makes them a sample of its
    posterior (importance sampling)."""

    values: Floats
    """of all parameters, shape (proposals, parameters)"""
    log_ratio: Floats
    """of the posterior density, over that at the estimates, to the density of the
    proposal, in units of the free parameters; minus infinity outside the bounds"""

    @classmethod
    def of(cls, fit: FitResult, number: int, random: np.random.Generator) -> Self:
        """A number of proposals for a fit that converged."""
        density = PosteriorDensity(fit)
        proposal = posterior_proposal(fit)
        free_values = proposal.draw(number, random)
        at_estimates = density.log(fit.values[None, density.free])
        log_posterior = density.log(free_values) - at_estimates
        # the density of the proposal is one in typical sizes
        typical = fit.parameter_set.typical[density.free]
        log_proposed = proposal.log_density(free_values) - np.log(typical).sum()
        log_ratio = log_posterior - log_proposed
        log_ratio = np.where(np.isfinite(log_ratio), log_ratio, -np.inf)
        return cls(density.whole(free_values), log_ratio)

    @property
    def weights(self) -> Floats:
        """Of the proposals, with the sum 1."""
        weights = np.exp(self.log_ratio - self.log_ratio.max())
        return weights / weights.sum()

    @property
    def effective(self) -> float:
        """How many independent draws they are worth (Kish 1965)."""
        return float(1 / (self.weights**2).sum())


def draws_along_ridge(
    fit: FitResult, number: int, random: np.random.Generator
) -> tuple[Floats, float]:
    """Draws from the posterior, shape (number, parameters), and how many independent
    ones they are worth.

    Raises
    ------
    UnusableFitError : the data leave a parameter open that has no bounds.
    """
    proposals = WeightedProposals.of(fit, _PROPOSED * number, random)
    weights = proposals.weights
    # evenly spaced along the cumulated weights, which adds the least noise
    levels = (random.uniform() + np.arange(number)) / number
    chosen = np.searchsorted(np.cumsum(weights), levels).clip(max=len(weights) - 1)
    return random.permutation(proposals.values[chosen]), proposals.effective
