"""The posterior of the mean of throws that vary, of its effects and of the spreads.

The throws' own parameters are integrated out by Laplace's approximation, and the mean
and the effects, whose prior is flat within the bounds, in closed form: what is left is
the restricted likelihood of the spreads times their prior, which is flat (Gelman 2006,
Bayesian Analysis 1, 515). emcee samples it. The mean and the effects are normal where
the spreads are given; draws with means out of bounds are left out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.sampling.ridge import RidgeProposal
from curlfit.inference.sampling.sampler import ENSEMBLES, Run
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.numerics.mixed_model import MixedFit, MixedModel

_WALKERS, _EFFECTIVE, _STEPS = 16 * ENSEMBLES, 1000, 2000
_MOST = 1000  # throws; more know their spreads so well that Student's t says the same
_MANY = 100
"""Draws above which predictions take the spreads for known up to Student's t. Of 12 to
24 draws whose errors are as large as a spread, t has too short tails: 92 % of those
simulated were within its 95 %, and within those of the posterior 95 %."""
_PROPER = 3  # throws beyond the covariates
_KEPT, _FEWEST = 4000, 400
# proposals: over the normal density at the optimum, and in logarithms
_WIDER, _WIDEST = 1.5, 1.0
_STEP, _FAR = 0.05, 12.0  # of differences, and the largest, in logarithms
# of a parameter in what nothing determines, where its bounds say nothing
_NO_PART = 1e-6
_SIZE = 50_000  # throws times draws at a time


class Draws(NamedTuple):
    """Of a posterior."""

    estimate: Floats
    """the mean and its effects, shape (draws, numbers)"""
    spreads: Floats
    """shape (draws, directions)"""
    r_hat: float
    """largest of the spreads"""
    seed: int = 0


def drawn_for_others(fit: MixedFit, size: Floats, draws: Draws | None) -> Draws | None:
    """Draws from the posterior for predictions of another draw of an evening: those
    that were asked for, or others; none of many draws.

    Parameters
    ----------
    size : of spreads that may be zero.
    draws : that were asked for.
    """
    if draws is not None or len(fit.model.covariates) > _MANY:
        return draws
    return sampled(fit, size, seed=0)


class _OfSpreads(Run):
    """A chain of the spreads about their optimum, in the inverse hyperbolic sine of
    these over their size: with few throws their density has long tails."""

    def __init__(
        self, model: MixedModel, optimum: Floats, size: Floats, seed: int
    ) -> None:
        self._model, number = model, len(optimum)
        self._size = np.maximum(optimum, size)
        self.names, self.free = tuple(map(str, range(number))), np.ones(number, bool)
        centre = np.arcsinh(optimum / self._size)

        # the density is even, and smooth where a spread is zero
        def slope(at: Floats) -> Floats:
            return slopes(lambda where: self._even(where[None])[0], at, _STEP)

        curved = -slopes(slope, centre, _STEP)
        squares, axes = np.linalg.eigh((curved + curved.T) / 2)
        covariance = axes / np.maximum(squares, _WIDEST**-2) @ axes.T
        # where zero is near, the density is sampled on both of its sides
        even = centre < 2 * np.sqrt(np.diagonal(covariance))
        self.lower, self.upper, self.subject = (
            np.where(even, -_FAR, 0.0),
            np.full(number, _FAR),
            {},
        )
        squares, axes = np.linalg.eigh(covariance + np.diag(even * centre**2))
        none, nowhere = np.zeros(0), np.zeros(0, int)
        self.proposal = RidgeProposal(
            np.where(even, 0.0, centre),
            np.ones(number),
            axes.T,
            _WIDER * np.sqrt(squares),
            nowhere,
            none,
            none,
            nowhere,
            none,
        )
        super().__init__(seed, _WALKERS)

    def whole(self, free_values: Floats) -> Floats:
        """The spreads."""
        found: Floats = np.abs(self._size * np.sinh(free_values))
        return found

    def log_prob(self, free_values: Floats) -> Floats:
        """That of the restricted likelihood, where the prior of spreads is flat."""
        within = np.clip(free_values, self.lower, self.upper)
        count = max(1, len(within) * len(self._model.products) // _SIZE)
        found = np.concatenate(
            [self._even(some) for some in np.array_split(within, count)]
        )
        return np.where((within == free_values).all(1), found, -np.inf)

    def _even(self, free_values: Floats) -> Floats:
        volume: Floats = np.log(np.cosh(free_values)).sum(-1)
        return volume - self._model.criterion(self.whole(free_values) ** 2) / 2


def sampled(fit: MixedFit, size: Floats, seed: int | None) -> Draws | None:
    """Draws from the posterior; none without a seed, where a bound holds a mean or
    bounds leave few draws, of many throws, or of so few that it is improper (Gelman
    2006, sect. 3.2).

    Parameters
    ----------
    size : of spreads that may be zero.
    """
    model, random = fit.model, np.random.default_rng(seed)
    throws, covariates = model.covariates.shape
    if seed is None or fit.at_bound or not covariates + _PROPER <= throws <= _MOST:
        return None
    run = _OfSpreads(model, np.sqrt(fit.variances), size, seed)
    _, diagnosis = run.until(_EFFECTIVE, _STEPS)
    flat = run.chain().flat
    found = flat[np.linspace(0, len(flat) - 1, _KEPT).astype(int)]
    estimates = []
    for some in np.array_split(
        found, max(1, len(found) * len(model.products) // _SIZE)
    ):
        mean, root = _given(model, some)
        noise = random.standard_normal((*mean.shape, 1))
        drawn = mean + np.linalg.solve(root.mT, noise)[..., 0]
        estimates.append(drawn + _off_by_cut(fit, root, random))
    estimate = np.concatenate(estimates)
    means = fit.at(np.unique(model.covariates, axis=0)) @ estimate.T
    beyond = (means < fit.lower[:, None]) | (means > fit.upper[:, None])
    inside = ~beyond[:, (np.abs(model.null) < _NO_PART).all(1)].any((0, 1))
    worst = diagnosis.worst_r_hat if diagnosis else np.inf
    if inside.sum() <= _FEWEST:
        return None
    return Draws(estimate[inside], found[inside], worst, seed=seed)


def _off_by_cut(fit: MixedFit, root: Floats, random: np.random.Generator) -> Any:
    """By how much draws of the estimate, of which these are roots of the information,
    are off for what is cut; zero where nothing is."""
    if not fit.cut.any():
        return 0.0
    deviations = np.sqrt(fit.cut[fit.cut > 0])
    of_cut = deviations * random.standard_normal((len(root), len(deviations)))
    followed = fit.following(np.linalg.inv(root @ root.mT))
    return (followed @ of_cut[..., None])[..., 0]


def _given(model: MixedModel, spreads: Floats) -> tuple[Floats, Floats]:
    """The mean and the effects for some spreads, and Cholesky roots of
    their information."""
    normal, right, _ = model.parts(model.marginal_sum(spreads**2)[0])
    root: Any = np.linalg.cholesky(normal)
    mean: Any = np.linalg.solve(normal, right[..., None])
    return mean[..., 0], root
