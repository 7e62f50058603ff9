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
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.differences import slopes
from curlfit.numerics.mixed_model import MixedFit, MixedModel, following

_WALKERS = 16 * ENSEMBLES
_EFFECTIVE = 1000  # draws of the spreads, as many as independent ones
_MOST_STEPS = 2000
_MOST_THROWS = 1000  # more know their spreads so well that Student's t says the same
_MANY_DRAWS = 100
"""Draws of an evening above which predictions take the spreads for known up to
Student's t. Of 12 to 24 draws whose errors are as large as a spread, t has too short
tails: 92 % of those simulated were within its 95 %, and within those of the posterior
95 %."""
_PROPER = 3
"""Throws beyond the covariates below which the posterior is improper (Gelman 2006,
sect. 3.2)."""
_KEPT = 4000  # samples
_FEWEST = 400  # samples with means within bounds
# proposals: over the normal density at the optimum, and their widest, in logarithms
_WIDER = 1.5
_WIDEST = 1.0
_STEP = 0.05  # of differences, in logarithms
_FARTHEST = 12.0  # a spread from its size, in logarithms
# of a parameter in what nothing determines, where its bounds say nothing
_NO_PART = 1e-6
_AT_ONCE = 50_000  # throws times samples


class Draws(NamedTuple):
    """Samples of a posterior."""

    estimate: Floats
    """the mean and its effects, shape (samples, numbers)"""
    spreads: Floats
    """shape (samples, directions)"""
    r_hat: float
    """largest of the spreads"""
    seed: int = 0


def drawn_for_others(fit: MixedFit, size: Floats, draws: Draws | None) -> Draws | None:
    """Samples of the posterior for predictions of another draw of an evening: those
    that were asked for, or others; none of many draws.

    Parameters
    ----------
    size : of spreads that may be zero.
    draws : that were asked for.
    """
    if draws is not None or len(fit.model.covariates) > _MANY_DRAWS:
        return draws
    return sampled(fit, size, seed=0)


class _SpreadDensity:
    """The posterior density of the spreads about their optimum.

    Its coordinates are asinh(spread/size): linear where a spread is near zero,
    logarithms where it is large, since with few throws its density has long tails. The
    density is even in them. Where zero is near, both of its sides are sampled, so that
    the chain needs no wall there.
    """

    def __init__(self, model: MixedModel, optimum: Floats, size: Floats) -> None:
        self._model = model
        self._size = np.maximum(optimum, size)
        number = len(optimum)
        self.names = tuple(str(index) for index in range(number))
        self.free = np.ones(number, bool)
        centre = np.arcsinh(optimum / self._size)
        covariance = self._covariance_at(centre)
        zero_is_near = centre < 2 * np.sqrt(np.diagonal(covariance))
        self.lower = np.where(zero_is_near, -_FARTHEST, 0.0)
        self.upper = np.full(number, _FARTHEST)
        # about zero the proposal is as wide as both sides together
        squares, axes = np.linalg.eigh(covariance + np.diag(zero_is_near * centre**2))
        self.proposal = _normal_proposal(
            np.where(zero_is_near, 0.0, centre), axes, _WIDER * np.sqrt(squares)
        )

    def _covariance_at(self, centre: Floats) -> Floats:
        """Of the normal density with the curvature of the log-density, no wider than
        `_WIDEST` in any direction."""

        def slope(coordinates: Floats) -> Floats:
            return slopes(
                lambda near: self._log_density(near[None])[0], coordinates, _STEP
            )

        curvature = -slopes(slope, centre, _STEP)
        squares, axes = np.linalg.eigh((curvature + curvature.T) / 2)
        covariance: Floats = axes / np.maximum(squares, _WIDEST**-2) @ axes.T
        return covariance

    def whole(self, free_values: Floats) -> Floats:
        """The spreads."""
        spreads: Floats = np.abs(self._size * np.sinh(free_values))
        return spreads

    def log(self, free_values: Floats) -> Floats:
        """Log-density of walkers, shape (walkers,): the restricted likelihood, since
        the prior of spreads is flat."""
        within = np.clip(free_values, self.lower, self.upper)
        parts = np.array_split(within, _parts(len(within), self._model))
        log_density = np.concatenate([self._log_density(part) for part in parts])
        return np.where((within == free_values).all(1), log_density, -np.inf)

    def _log_density(self, free_values: Floats) -> Floats:
        """That of the coordinates without their limits."""
        volume: Floats = np.log(np.cosh(free_values)).sum(-1)
        return volume - self._model.criterion(self.whole(free_values) ** 2) / 2


def _normal_proposal(centre: Floats, axes: Floats, deviations: Floats) -> RidgeProposal:
    """A proposal that is determined in all directions, and pushed against no bound."""
    none = np.zeros(0)
    nowhere = np.zeros(0, int)
    return RidgeProposal(
        centre=centre,
        typical=np.ones(len(centre)),
        seen=axes.T,
        spread=deviations,
        pivots=nowhere,
        low=none,
        high=none,
        pushed=nowhere,
        scale=none,
    )


def sampled(fit: MixedFit, size: Floats, seed: int | None) -> Draws | None:
    """Samples of the posterior; none without a seed, where a bound holds a mean or
    bounds leave few samples, of many throws, or of so few that it is improper.

    Parameters
    ----------
    size : of spreads that may be zero.
    """
    model = fit.model
    throws, covariates = model.covariates.shape
    proper = covariates + _PROPER <= throws <= _MOST_THROWS
    if seed is None or fit.at_bound or not proper:
        return None
    density = _SpreadDensity(model, np.sqrt(fit.variances), size)
    run = Run(density, density.proposal, {}, seed, _WALKERS)
    _, diagnosis = run.until(_EFFECTIVE, _MOST_STEPS)
    chain = run.chain().flat
    spreads = chain[np.linspace(0, len(chain) - 1, _KEPT).astype(int)]
    random = np.random.default_rng(seed)
    parts = np.array_split(spreads, _parts(len(spreads), model))
    estimate = np.concatenate([_estimates(fit, part, random) for part in parts])
    inside = _within_bounds(fit, estimate)
    if inside.sum() <= _FEWEST:
        return None
    worst = diagnosis.worst_r_hat if diagnosis else np.inf
    return Draws(estimate[inside], spreads[inside], worst, seed=seed)


def _parts(samples: int, model: MixedModel) -> int:
    """Number of parts in which samples are computed, each with memory for some."""
    return max(1, samples * len(model.products) // _AT_ONCE)


def _estimates(fit: MixedFit, spreads: Floats, random: np.random.Generator) -> Floats:
    """The mean and the effects, drawn from their normal density for each of some
    spreads, shape (samples, numbers)."""
    model = fit.model
    normal, right, _ = model.parts(model.marginal_sum(spreads**2)[0])
    root: Any = np.linalg.cholesky(normal)
    mean: Any = np.linalg.solve(normal, right[..., None])
    noise = random.standard_normal(mean.shape)
    estimates: Floats = (mean + np.linalg.solve(root.mT, noise))[..., 0]
    which = np.flatnonzero(fit.cut)
    if len(which):
        deviations = np.sqrt(fit.cut[which])
        of_cut = deviations * random.standard_normal((len(spreads), len(deviations)))
        followed = following(np.linalg.inv(normal), which)
        estimates += (followed @ of_cut[..., None])[..., 0]
    return estimates


def _within_bounds(fit: MixedFit, estimate: Floats) -> Booleans:
    """Which samples have the means of all throws within the bounds of what is
    determined."""
    means = fit.at(np.unique(fit.model.covariates, axis=0)) @ estimate.T
    beyond = (means < fit.lower[:, None]) | (means > fit.upper[:, None])
    takes_no_part = (np.abs(fit.model.null) < _NO_PART).all(1)
    outside: Any = beyond[:, takes_no_part].any((0, 1))
    within: Booleans = ~outside
    return within
