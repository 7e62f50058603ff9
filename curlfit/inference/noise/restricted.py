"""Noise models estimated by restricted likelihood, from the residuals of a fit with
white noise.

The restricted likelihood (Patterson and Thompson 1971) is that of the part of the
residuals that no change of the fitted parameters can produce, since the fit has
absorbed the rest. The maximum of the posterior gives the scale of each channel, the
parameters of the noise, which are its own (`curlfit.noises`), and the sizes of a
discrepancy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.accelerations import COMPONENTS, SIZES, log_prior
from curlfit.inference.noise.independence import is_rough
from curlfit.inference.noise.linearized import Linearized, Regression
from curlfit.inference.noise.whitening import STATE
from curlfit.noises import NOISES, Noise, Unknown
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.throws.channels import CHANNELS

_FAR = 8.0  # limit of the logarithm of a scale over the rms residual
_TINY = (
    1e-10  # rms residual over sigma of a channel without noise, so that it has a log
)
_SIZE = 0.05  # initial size of a discrepancy
_PRECISE = 1e-12  # relative change of the log-posterior at which the search ends
_STEP = 1e-3  # of differences of slopes
# mean square of a factor of the discrepancy that is uniform between 0 and 2
_FACTOR = 4 / 3
GRID = np.stack(np.meshgrid(*[SIZES] * len(COMPONENTS), indexing="ij"), -1).reshape(
    -1, len(COMPONENTS)
)
"""Sizes of a discrepancy, shape (sizes, 3)."""


class _Parts(NamedTuple):
    """The parts of a point of the search."""

    log_scale: Any
    """of sigma, by channel"""
    unknowns: Any
    """of the noise"""
    log_sizes: Any
    """of a discrepancy; none without one"""


def _parts(point: Any, data: Linearized) -> _Parts:
    """The parts of a point of the search."""
    channels = len(data.weight)
    end = len(point) - _number_of_sizes(data)
    return _Parts(point[:channels], point[channels:end], point[end:])


def _number_of_sizes(data: Linearized) -> int:
    return len(COMPONENTS) if data.responses.shape[-1] else 0


@compiled("kind")
def _slope(kind: str, point: Array, data: Linearized) -> tuple[Array, Array, Array]:
    """Negative log-posterior of the logarithms of scales, the unknowns of a noise and
    the logarithms of sizes; its gradient; and the restricted log-likelihood."""
    noise = NOISES[kind]

    def negative(point: Array) -> tuple[Array, Array]:
        regression, determinant = _regression(noise, point, data)
        parts = _parts(point, data)
        sizes = jnp.exp(parts.log_sizes)
        likelihood = regression.log_likelihood(sizes) + determinant
        # uniform in the logarithms of scales
        prior = noise.log_prior(parts.unknowns, data.span)
        return -likelihood - prior - log_prior(sizes), likelihood

    (value, likelihood), slope = jax.value_and_grad(negative, has_aux=True)(point)
    return value, slope, likelihood


def _regression(
    noise: Noise, point: Array, data: Linearized
) -> tuple[Regression, Array]:
    """The regression, and the log-determinant of the whitening."""
    measured = data.weight > 0
    parts = _parts(point, data)
    whitening = noise.filter(noise.values(parts.unknowns), data.gaps, measured)
    by_channel = whitening.log_determinant() - measured.sum(-1) * parts.log_scale
    regression = data.regression(whitening, jnp.exp(parts.log_scale))
    return regression, by_channel.sum()


@compiled("kind")
def _at(kind: str, point: Array, data: Linearized) -> Regression:
    return _regression(NOISES[kind], point, data)[0]


@compiled()
def _of_sizes(regression: Regression, sizes: Array) -> Array:
    return jax.vmap(regression.log_likelihood)(sizes)


class Estimate(NamedTuple):
    """The noise of some residuals."""

    noise: Noise
    scale: Floats
    """sigma by channel, over that of the fit"""
    regression: Regression | None = None
    """at that noise; None without a discrepancy"""
    log_likelihood: Floats = np.zeros(0)
    """of the sizes of `GRID`"""

    @property
    def weights(self) -> Floats:
        """Posterior probabilities of the sizes of `GRID`."""
        log_posterior = self.log_likelihood + log_prior(GRID)
        likely: Floats = np.exp(log_posterior - log_posterior.max())
        return likely / likely.sum()


def estimate(noise: Noise, data: Linearized, sigma_given: Sequence[bool]) -> Estimate:
    """A noise with its estimates, from some residuals.

    Independent noise is preferred unless a correlation raises the likelihood by more
    than its number of parameters (Akaike 1974, IEEE Trans. Autom. Control 19, 716). A
    channel whose residuals are smoother than any noise keeps its sigma: it would be
    fitted perfectly, at the expense of the others.

    Parameters
    ----------
    sigma_given : by channel.
    """
    enough = data.enough
    nowhere = np.zeros(len(enough), bool)
    search = _Search(noise, data, enough & ~np.asarray(sigma_given))
    white = search.highest(nowhere)
    correlated = enough & search.rough(white)
    if (search.free & ~correlated).any():
        search.free &= correlated
        white = search.highest(nowhere)
    best = white
    if correlated.any():
        maximum = search.highest(correlated)
        added = sum(unknown.lower < unknown.upper for unknown in maximum.unknowns)
        if maximum.log_likelihood > white.log_likelihood + added:
            best = search.widened(maximum)
    return search.estimate(best)


class _Maximum(NamedTuple):
    """A maximum of the posterior of a noise."""

    point: Floats
    correlated: Booleans
    """which channels have correlated noise"""
    unknowns: list[Unknown]
    log_posterior: float
    log_likelihood: float


class _Search:
    """The search for the maximum of the posterior of a noise.

    Attributes
    ----------
    free : by channel, whether its scale is searched for; the others have sigma of the
        fit.
    """

    def __init__(self, noise: Noise, data: Linearized, free: Booleans) -> None:
        self.noise = noise
        self.data = data
        self.free = free
        self.number_of_sizes = _number_of_sizes(data)

    @cached_property
    def log_rms(self) -> Floats:
        """Logarithm of the rms residual over sigma, by channel."""
        data = self.data
        count = np.maximum((data.weight > 0).sum(1), 1)
        mean_square = ((data.weight * data.residual) ** 2).sum(1) / count
        log_rms: Floats = np.log(np.sqrt(mean_square) + _TINY)
        return log_rms

    def highest(self, correlated: Booleans) -> _Maximum:
        """The highest of the maxima to which initial values lead, with correlated noise
        in some channels."""
        gap = float(np.median(self.data.gaps[self.data.gaps > 0]))
        unknowns = self.noise.search(correlated.tolist(), gap, float(self.data.span))
        starts = product(*(unknown.starts for unknown in unknowns))
        maxima = [self._maximum(start, unknowns, correlated) for start in starts]
        return max(maxima, key=lambda maximum: maximum.log_posterior)

    def _maximum(
        self, start: Sequence[float], unknowns: list[Unknown], correlated: Booleans
    ) -> _Maximum:
        """The maximum to which an initial value of each unknown leads."""
        from scipy.optimize import minimize  # slow to load

        far = _FAR * self.free
        scale = np.where(self.free, self.log_rms, 0.0)
        sizes = self.number_of_sizes
        first = [*scale, *start, *[math.log(_SIZE)] * sizes]
        lowest = [
            *scale - far,
            *(unknown.lower for unknown in unknowns),
            *[math.log(SIZES[0])] * sizes,
        ]
        highest = [
            *scale + far,
            *(unknown.upper for unknown in unknowns),
            *[0.0] * sizes,
        ]

        def slope(point: Floats) -> tuple[float, Floats]:
            value, gradient, _ = _slope(self.noise.kind, point, self.data)
            return float(value), np.asarray(gradient)

        end = minimize(
            slope,
            np.clip(first, lowest, highest),
            jac=True,
            method="L-BFGS-B",
            bounds=np.transpose([lowest, highest]),
            options={"ftol": _PRECISE},
        )
        _, _, log_likelihood = _slope(self.noise.kind, end.x, self.data)
        return _Maximum(
            point=end.x,
            correlated=correlated,
            unknowns=unknowns,
            log_posterior=-float(end.fun),
            log_likelihood=float(log_likelihood),
        )

    def rough(self, maximum: _Maximum) -> Booleans:
        """Channels whose residuals are as rough as noise, and of a size; others are due
        to the law, or to a file without noise."""
        data = self.data
        residual = data.residual
        parts = _parts(maximum.point, data)
        if self.number_of_sizes:
            amplitudes = self._at(maximum).mean(np.exp(parts.log_sizes))
            residual = residual - np.asarray(data.adjusted_responses) @ amplitudes
        series = zip(data.weight * residual, data.weight > 0, strict=True)
        has_size = ~self.free | (parts.log_scale > self.log_rms - _FAR)
        return has_size & [is_rough(values[measured]) for values, measured in series]

    def _at(self, maximum: _Maximum) -> Regression:
        """The regression at a maximum."""
        regression = _at(self.noise.kind, maximum.point, self.data)
        in_numpy: Regression = jax.tree.map(np.asarray, regression)
        return in_numpy

    def widened(self, best: _Maximum) -> _Maximum:
        """The maximum with the mean variance of the noise at low frequencies in place
        of the most probable, where the noise has a correlation time.

        Noise of longer memory is larger, and the likelihood has a ridge along which
        the variance at low frequencies grows as the square of the correlation time.
        For a log-normal posterior its mean is at a shift of the logarithm of the time
        by its variance.
        """
        if not self.noise.has_time:
            return best
        *other_unknowns, time = best.unknowns
        values = _parts(best.point, self.data).unknowns
        inside = [
            unknown.lower < value < unknown.upper
            for unknown, value in zip(other_unknowns, values[:-1], strict=True)
        ]
        moving = np.flatnonzero([*self.free, *inside, True])
        hessian = slopes(
            lambda point: _slope(self.noise.kind, point, self.data)[1][moving],
            best.point,
            _STEP,
            moving,
        )
        # twice the second derivatives, and no variance above 1
        doubled, axes = np.linalg.eigh(hessian + hessian.T)
        covariance = (2 * axes / np.maximum(doubled, 2.0)) @ axes.T
        point = best.point.copy()
        point[moving] += covariance[-1]  # of all with the logarithm of the time
        point[moving[-1]] = min(point[moving[-1]], time.upper)
        return best._replace(point=point)

    def estimate(self, best: _Maximum) -> Estimate:
        """The estimate at a maximum."""
        data = self.data
        parts = _parts(best.point, data)
        values = self.noise.values(parts.unknowns)
        parameters: dict[str, Any] = {}
        for name, independent in self.noise.parameters.items():
            by_channel = {}
            for row in np.flatnonzero(data.enough):
                is_correlated = best.correlated[row]
                value = float(values[name][row]) if is_correlated else independent
                by_channel[CHANNELS[row]] = value
            parameters[name] = by_channel
        noise = replace(self.noise, **parameters)
        scale = np.exp(parts.log_scale)
        if not self.number_of_sizes:
            return Estimate(noise, scale)
        regression = self._at(best)
        log_likelihood = np.asarray(_of_sizes(regression, GRID))
        estimate = Estimate(noise, scale, regression, log_likelihood)
        rms = np.sqrt(estimate.weights @ GRID**2)
        noise = replace(
            noise,
            sizes=dict(zip(COMPONENTS, map(float, rms), strict=True)),
            initial_state=self._initial_state(regression, rms).tolist(),
        )
        return estimate._replace(noise=noise)

    def _initial_state(self, regression: Regression, sizes: Floats) -> Floats:
        """Covariance of the change of the initial state that compensates a
        discrepancy."""
        data = self.data
        lower, white, root = jax.device_get(regression.posterior(sizes))
        spread = np.linalg.inv(lower.T)
        mean = spread @ white
        squares = spread @ spread.T + _FACTOR * np.outer(mean, mean)
        shift = data.from_standard[-STATE:] @ np.asarray(data.coupling) @ root
        covariance: Floats = shift @ squares @ shift.T
        return covariance
