"""AR(1) noise: the correlation of two rows decays exponentially with the time between them.

An Ornstein-Uhlenbeck process, with correlation exp(-gap/memory), which is AR(1) where rows are
evenly spaced: noise of the tracker, such as that of filters or a swaying camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.estimation import (
    ChannelResiduals,
    Sums,
    mean_standard_deviation,
    restricted,
)
from curlfit.inference.noise.models import Noise, ar1_correlation
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS

SHORTEST = 0.2
"""Correlation time over the time between rows at which noise is practically independent."""
_LONGEST = 10.0  # correlation time over the time of motion
_TYPICAL = 0.1  # mean of the prior of the correlation time over the time of motion
_RIDGE = np.linspace(-1.0, 2.0, 61)  # logarithms of the scale along the ridge, from the maximum
_FAR = 30.0  # limit of all logarithms


class AR1Whitener(NamedTuple):
    """Subtracts from each residual what the row before it predicts.

    Arrays of the shape of the data (channels, n).
    """

    before: Any
    """index of the row that was observed before this one"""
    carry: Any
    """correlation with it"""
    scale: Any
    """1 over the part of sigma that it does not predict"""

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats) -> Self:
        """The whitener of a noise model; it changes nothing where the noise has no memory.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        """
        before = np.tile(np.arange(weight.shape[1]), (len(weight), 1))
        carry, scale = np.zeros_like(weight), np.ones_like(weight)
        for row, name in enumerate(CHANNELS[: len(weight)]):
            if name in noise.memory:
                there = np.flatnonzero(weight[row] > 0)
                steps = ar1_correlation(np.diff(times[there]), noise.memory[name])
                before[row, there[1:]] = there[:-1]
                carry[row, there[1:]] = steps
                scale[row, there[1:]] = 1 / np.sqrt(1 - steps**2)
        return cls(before, carry, scale)

    def whiten(self, residual: Array) -> Array:
        """Whitened residuals from residuals over sigma, shape (channels, n)."""
        predicted = self.carry * jnp.take_along_axis(residual, self.before, axis=1)
        return (residual - predicted) * self.scale

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood; shape (channels,)."""
        return np.asarray(np.log(self.scale).sum(-1))


def log_prior(memory: Floats, span: float) -> Floats:
    """Logarithm of the prior density of the logarithm of a correlation time in s.

    Exponential, with a mean of a tenth of the time of motion: what lasts longer is due to the law
    rather than the tracker (a judgement; half or twice this mean changes errors little).
    """
    found: Floats = np.log(memory) - memory / (_TYPICAL * span)
    return found


def estimate(channels: Sequence[ChannelResiduals], span: float) -> tuple[Noise, dict[str, float]]:
    """AR(1) noise of some residuals: one scale for all sigmas that were not given, and a
    correlation time for each channel.

    Parameters
    ----------
    channels : residuals of a fit with white noise.
    span : time after the first row during which the stone moves, s.

    Returns
    -------
    the noise, and by channel its sigma where it was not given.
    """
    from scipy.optimize import minimize

    sums = [Sums.of(np.column_stack([item.basis, item.residual]), item.t) for item in channels]
    n_nuisance = channels[0].basis.shape[1]
    known = np.array([item.given for item in channels])
    sizes = np.array([1.0 if item.given else math.sqrt(item.square) for item in channels])
    lowest = np.log([SHORTEST * item.gap for item in channels])
    highest = math.log(_LONGEST * span)

    def parts(logs: Floats) -> tuple[Floats, Floats]:
        sigma = np.where(known, 1.0, sizes * math.exp(np.clip(logs[0], -_FAR, _FAR)))
        return sigma, np.exp(np.clip(logs[1:], lowest, highest))

    def log_posterior(logs: Floats) -> float:
        total, halves = 0.0, 0.0
        sigmas, memories = parts(logs)
        for item, sigma, memory in zip(sums, sigmas, memories, strict=True):
            each, half = item.ar1(memory)
            total = total + each / sigma**2
            halves += half + item.rows * math.log(sigma)
        try:
            left, spent = restricted(np.asarray(total), n_nuisance)
        except np.linalg.LinAlgError:
            return -math.inf
        prior = float(np.mean(log_prior(memories, span)))
        return prior - halves - spent - float(left[0, 0]) / 2

    starts = [np.array([0.0] + [math.log(part * span)] * len(channels)) for part in (0.01, 0.1)]
    ends = [
        minimize(
            lambda logs: -log_posterior(logs), start, method="Nelder-Mead",
            options={"xatol": 0.01, "fatol": 1e-3,
                     "initial_simplex": start + np.eye(len(start) + 1, len(start), -1)},
        )
        for start in starts
    ]  # fmt: skip
    best = min(ends, key=lambda item: float(item.fun)).x
    best[1:] = np.clip(best[1:], lowest, highest)
    ridge = np.array([logs for logs in _along_ridge(best, channels) if max(logs[1:]) <= highest])
    low = 2 * ridge[:, 0] + ridge[:, 1:].mean(1)
    values = [log_posterior(logs) for logs in ridge]
    sigmas, memories = parts(mean_standard_deviation(low, np.array(values), ridge))
    found = list(zip(channels, sigmas.tolist(), memories.tolist(), strict=True))
    noise = Noise("ar1", memory={item.name: memory for item, _, memory in found})
    return noise, {item.name: own * item.scale for item, own, _ in found if not item.given}


def _along_ridge(best: Floats, channels: Sequence[ChannelResiduals]) -> list[Floats]:
    """Logarithms of scale and correlation times along the ridge: the part of each value that its
    neighbour does not predict, which closely spaced rows determine well, is the same."""
    found = []
    for step in _RIDGE if not all(item.given for item in channels) else [0.0]:
        logs = best.copy()
        logs[0] += step
        for index, item in enumerate(channels, 1):
            apart = -math.expm1(-2 * item.gap / math.exp(best[index])) * math.exp(-2 * step)
            if apart >= 1:
                break
            logs[index] = math.log(-2 * item.gap / math.log1p(-apart))
        else:
            found.append(logs)
    return found
