"""Noise models estimated by restricted likelihood, from the residuals of a fit with
white noise.

The restricted likelihood (Patterson and Thompson 1971) is that of the part of the
residuals that no change of the fitted parameters can produce, since the fit has
absorbed the rest. The maximum of the posterior gives the scale of each channel, the
independent share of its variance, one correlation time (the channels are measured by
one camera) and the sizes of a discrepancy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.accelerations import COMPONENTS, SIZES, log_prior
from curlfit.inference.noise.kalman import KalmanFilter
from curlfit.inference.noise.linearized import Linearized, Regression
from curlfit.inference.noise.models import Noise, is_rough
from curlfit.inference.noise.whitening import STATE
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.settings.noise_kinds import NoiseKind
from curlfit.throws.throw import CHANNELS

_TYPICAL = 0.1  # mean of the prior of the correlation time over the time of motion
_SHORTEST = 0.3  # correlation time over the time between rows
_LONGEST = 0.3  # correlation time over the time of motion
_TRIED = (0.02, 0.1)  # initial correlation times over the time of motion
_FAR = 8.0  # limit of the logarithm of a scale over the rms residual
_WHITE = 12.0  # logit of an independent share that is practically 1
_MOST = 9.0  # limit of the logit of that of correlated noise
_SIZE = 0.05  # initial size of a discrepancy
_PRECISE = 1e-12  # relative change of the log-posterior at which the search ends
_STEP = 1e-3  # of differences of slopes
# mean square of a factor of the discrepancy that is uniform between 0 and 2
_FACTOR = 4 / 3
GRID = np.stack(np.meshgrid(*[SIZES] * len(COMPONENTS), indexing="ij"), -1).reshape(
    -1, len(COMPONENTS)
)
"""Sizes of a discrepancy, shape (sizes, 3)."""


@compiled()
def _slope(logs: Array, data: Linearized) -> tuple[Array, Array, Array]:
    """Negative log-posterior of the logarithms of scales, shares (logits), correlation
    time and sizes; its gradient; and the restricted log-likelihood."""
    channels = len(data.weight)

    def negative(logs: Array) -> tuple[Array, Array]:
        regression, determinant = _regression(logs, data)
        memory, sizes = logs[2 * channels], jnp.exp(logs[2 * channels + 1 :])
        likelihood = regression.log_likelihood(sizes) + determinant
        # Exponential in the correlation time, uniform in shares and
        # logarithms of scales.
        prior = memory - jnp.exp(memory) / (_TYPICAL * data.span)
        return -likelihood - prior - log_prior(sizes), likelihood

    (value, likelihood), slope = jax.value_and_grad(negative, has_aux=True)(logs)
    return value, slope, likelihood


def _regression(logs: Array, data: Linearized) -> tuple[Regression, Array]:
    """The regression, and the log-determinant of the whitening."""
    channels, seen = len(data.weight), data.weight > 0
    share, memory = (
        jax.nn.sigmoid(logs[channels : 2 * channels]),
        jnp.exp(logs[2 * channels]),
    )
    own = KalmanFilter.of(jnp.full(channels, memory), share, data.gaps, seen)
    determinant = own.log_determinant() - seen.sum(-1) * logs[:channels]
    return data.regression(own, jnp.exp(logs[:channels])), determinant.sum()


@compiled()
def _at(logs: Array, data: Linearized) -> Regression:
    return _regression(logs, data)[0]


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
        logs = self.log_likelihood + log_prior(GRID)
        found: Floats = np.exp(logs - logs.max())
        return found / found.sum()


def estimate(kind: NoiseKind, data: Linearized, known: Sequence[bool]) -> Estimate:
    """The noise of some residuals.

    Independent noise is preferred unless a correlation raises the likelihood by more
    than its number of parameters (Akaike 1974, IEEE Trans. Autom. Control 19, 716). A
    channel whose residuals are smoother than any noise keeps its sigma: it would be
    fitted perfectly, at the expense of the others.

    Parameters
    ----------
    known : by channel, whether its sigma was given.
    """
    enough = data.enough
    search = _Search(data, enough, np.asarray(known))
    white = search.maximum(None, enough & False)
    correlated = enough & search.rough(white)
    if (search.free & ~correlated).any():
        search.free &= correlated
        white = search.maximum(None, enough & False)
    best = white
    if correlated.any():
        others = [search.maximum(memory, correlated) for memory in _TRIED]
        other = max(others, key=lambda one: one.log_posterior)
        if other.log_likelihood > white.log_likelihood + 1 + correlated.sum():
            best = search.widened(other)
    return search.estimate(kind, best)


class _Maximum(NamedTuple):
    logs: Floats
    correlated: Booleans
    """which channels have correlated noise"""
    log_posterior: float
    log_likelihood: float


class _Search:
    """The search for the maximum of the posterior of a noise model."""

    def __init__(self, data: Linearized, enough: Booleans, known: Booleans) -> None:
        self.data, self.enough, self.free = data, enough, enough & ~known
        self.sizes = len(COMPONENTS) if data.responses.shape[-1] else 0

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Limits of the logarithm of the correlation time."""
        gap = float(np.median(self.data.gaps[self.data.gaps > 0]))
        shortest = math.log(_SHORTEST * gap)
        return shortest, max(math.log(_LONGEST * float(self.data.span)), shortest)

    @cached_property
    def rms(self) -> Floats:
        """Logarithm of the rms residual over sigma, by channel."""
        data = self.data
        count = np.maximum((data.weight > 0).sum(1), 1)
        found: Floats = np.log(
            np.sqrt(((data.weight * data.residual) ** 2).sum(1) / count) + 1e-10
        )
        return found

    def maximum(self, memory: float | None, correlated: Booleans) -> _Maximum:
        """From an initial correlation time over the time of motion; None: of
        independent noise."""
        from scipy.optimize import minimize  # slow to load

        data, far = self.data, _FAR * self.free
        scale = np.where(self.free, self.rms, 0.0)
        time = math.log((memory or 1e-9) * float(data.span))
        shares = [(0.0, -_MOST, _MOST) if own else (_WHITE,) * 3 for own in correlated]
        start, *bounds = np.array(
            [
                *zip(scale, scale - far, scale + far, strict=True),
                *shares,
                (time, *(self.ends if memory else self.ends[:1] * 2)),
                *[(math.log(_SIZE), math.log(SIZES[0]), 0.0)] * self.sizes,
            ]
        ).T

        def slope(logs: Floats) -> tuple[float, Floats]:
            value, gradient, _ = _slope(logs, data)
            return float(value), np.asarray(gradient)

        found = minimize(
            slope,
            np.clip(start, *bounds),
            jac=True,
            method="L-BFGS-B",
            bounds=np.transpose(bounds),
            options={"ftol": _PRECISE},
        )
        likelihood = float(_slope(found.x, data)[2])
        return _Maximum(found.x, correlated, -float(found.fun), likelihood)

    def rough(self, found: _Maximum) -> Booleans:
        """Channels whose residuals are as rough as noise, and of a size; others are due
        to the law, or to a file without noise."""
        data = self.data
        left = data.residual
        if self.sizes:
            regression: Regression = jax.tree.map(np.asarray, _at(found.logs, data))
            sizes = np.exp(found.logs[-self.sizes :])
            left = left - np.asarray(data.paid) @ regression.mean(sizes)
        series = zip(data.weight * left, data.weight > 0, strict=True)
        sized = ~self.free | (found.logs[: len(self.free)] > self.rms - _FAR)
        return sized & [is_rough(values[seen]) for values, seen in series]

    def widened(self, best: _Maximum) -> _Maximum:
        """With the mean variance of the noise at low frequencies in place of the
        most probable.

        Noise of longer memory is larger, and the likelihood has a ridge along which
        the variance at low frequencies grows as the square of the correlation time.
        For a log-normal posterior its mean is at a shift of the logarithm of the time
        by its variance.
        """
        place = 2 * len(self.enough)
        inside = np.abs(best.logs[place // 2 : place]) < _MOST
        moving = np.flatnonzero([*self.free, *best.correlated & inside, True])
        hessian = slopes(
            lambda logs: _slope(logs, self.data)[1][moving], best.logs, _STEP, moving
        )
        values, axes = np.linalg.eigh(hessian + hessian.T)
        inverse = (2 * axes / np.maximum(values, 2.0)) @ axes.T
        logs = best.logs.copy()
        logs[moving] += inverse[-1]
        logs[place] = min(logs[place], self.ends[1])
        return best._replace(logs=logs)

    def estimate(self, kind: NoiseKind, best: _Maximum) -> Estimate:
        """The estimate at a maximum."""
        data, channels, noise = self.data, len(self.enough), Noise(kind)
        for row in np.flatnonzero(self.enough):
            name, own = CHANNELS[row], bool(best.correlated[row])
            noise.memory[name] = math.exp(best.logs[2 * channels]) if own else 0.0
            noise.white[name] = (
                1 / (1 + math.exp(-best.logs[channels + row])) if own else 1.0
            )
        scale = np.exp(best.logs[:channels])
        if not self.sizes:
            return Estimate(noise, scale)
        regression: Regression = jax.tree.map(np.asarray, _at(best.logs, data))
        found = Estimate(
            noise, scale, regression, np.asarray(_of_sizes(regression, GRID))
        )
        rms = np.sqrt(found.weights @ GRID**2)
        noise.sizes.update(zip(COMPONENTS, map(float, rms), strict=True))
        lower, white, root = map(np.asarray, regression.posterior(rms))
        spread = np.linalg.inv(lower.T)
        shift = data.from_standard[-STATE:] @ np.asarray(data.coupling) @ root
        noise.initial_state.extend(
            (
                shift
                @ (
                    spread @ spread.T
                    + _FACTOR * np.outer(spread @ white, spread @ white)
                )
                @ shift.T
            ).tolist()
        )
        return found
