"""Model discrepancy as noise: missing accelerations estimated from residuals, and whitened.

Missing accelerations (`curlfit.inference.noise.accelerations`) with independent or AR(1) noise. The
sizes of the accelerations and the correlation time are averaged over their posterior and not put in
at its maximum: the covariance is that of the sizes' second moments, and the correlation time that
of the mean standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from curlfit.inference.identifiability import triangle
from curlfit.inference.noise import ar1
from curlfit.inference.noise.accelerations import (
    COMPONENTS,
    SHAPES,
    SIZES,
    Responses,
    log_likelihood,
    log_prior,
)
from curlfit.inference.noise.ar1 import AR1Whitener
from curlfit.inference.noise.estimation import ChannelResiduals, mean_standard_deviation
from curlfit.inference.noise.models import Noise, ar1_correlation
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS

_ROUNDS = 2
_PURE = 300.0  # greatest discrepancy over the independent noise
_LONGEST = 0.5  # correlation time over the time of motion
_MEMORIES = 10  # correlation times that are tried
_COUNT = len(COMPONENTS) * SHAPES


class DiscrepancyWhitener(NamedTuple):
    """Every direction u of the residuals, in which the discrepancy has s times the size of the
    noise, is scaled down by sqrt(1 + s^2), after AR(1) noise has been made independent.

    With C = 1 + U diag(s^2) U^T, C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
    """

    directions: Any
    """orthonormal, shape (channels, n, k)"""
    shrink: Any
    """1 - 1/sqrt(1 + s^2) by direction, shape (k,)"""
    ar1: AR1Whitener | None

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, responses: Responses | None) -> Self:
        """That of a noise; it changes nothing where the noise has no memory and no size.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        responses : of the path to accelerations; None for a noise that has no size yet.
        """
        before = AR1Whitener.of(noise, times, weight) if "ar1" in noise.kind else None
        if not noise.sizes or responses is None:
            return cls(np.zeros((*weight.shape, _COUNT)), np.zeros(_COUNT), before)
        rows = np.stack([responses.at(times, row) for row in range(len(weight))])
        rows *= weight[..., None] * np.repeat([noise.sizes[name] for name in COMPONENTS], SHAPES)
        if before is not None:
            rows = np.asarray(jax.vmap(before.whiten, -1, -1)(jnp.asarray(rows)))
        left, singular, _ = np.linalg.svd(rows.reshape(-1, _COUNT), full_matrices=False)
        directions = np.zeros((weight.size, _COUNT))
        directions[:, : left.shape[1]] = left
        shrink = np.zeros(_COUNT)
        shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)
        return cls(directions.reshape(*weight.shape, _COUNT), shrink, before)

    def whiten(self, residual: Array) -> Array:
        """Residuals over sigma, made independent; shape (channels, n)."""
        if self.ar1 is not None:
            residual = self.ar1.whiten(residual)
        along = jnp.einsum("cnk,cn->k", self.directions, residual) * self.shrink
        return residual - jnp.einsum("cnk,k->cn", self.directions, along)

    def log_determinant(self) -> Floats:
        """Of the whitening, by channel: its part of the log-likelihood; shape (channels,)."""
        found = np.zeros(self.directions.shape[0])
        found[0] = np.log1p(-self.shrink).sum()  # of all channels together
        return found if self.ar1 is None else found + self.ar1.log_determinant()


def estimate(
    channels: Sequence[ChannelResiduals], span: float, responses: Responses, kind: str
) -> tuple[Noise, dict[str, float]]:
    """Sizes of the discrepancy, one scale for all sigmas that were not given, and, of
    "ar1+discrepancy", one correlation time.

    Parameters
    ----------
    channels : residuals of a fit with white noise.
    span : time after the first row for which the stone moves, s.

    Returns
    -------
    the noise, and by channel its sigma where it was not given.
    """
    grid = np.stack(np.meshgrid(*[SIZES] * len(COMPONENTS), indexing="ij"), -1)
    grid = grid.reshape(-1, len(COMPONENTS))
    columns = [
        np.column_stack([
            item.basis,
            item.weight[:, None] * responses.at(item.t, CHANNELS.index(item.name)),
            item.residual,
        ])
        for item in channels
    ]  # fmt: skip
    memories = np.zeros(1)
    if "ar1" in kind:
        shortest = ar1.SHORTEST * min(item.gap for item in channels)
        memories = np.geomspace(shortest, max(_LONGEST * span, 2 * shortest), _MEMORIES)
    sigmas, logs = [], []
    for memory in memories:
        sigma, log = _at_memory(channels, columns, float(memory), grid)
        sigmas.append(sigma)
        logs.append(log + (float(ar1.log_prior(memory, span)) if memory else 0.0))
    by_memory = np.logaddexp.reduce(logs, axis=1)
    weights = np.exp(np.array(logs) - by_memory.max())
    rms = np.sqrt(weights.sum(0) @ grid**2 / weights.sum())
    noise = Noise(kind, sizes=dict(zip(COMPONENTS, map(float, rms), strict=True)))
    best = np.array(sigmas[0])
    if len(memories) > 1:
        low = 2 * np.log(sigmas).mean(1) + np.log(memories)
        curve = np.column_stack([np.log(memories), np.log(sigmas)])
        log_memory, *log_sigmas = mean_standard_deviation(
            np.maximum.accumulate(low), by_memory, curve
        )
        noise.memory.update((item.name, math.exp(log_memory)) for item in channels)
        best = np.exp(log_sigmas)
    return noise, {
        item.name: float(own) * item.scale
        for item, own in zip(channels, best, strict=True)
        if not item.given
    }


def _at_memory(
    channels: Sequence[ChannelResiduals], columns: Sequence[Floats], memory: float, grid: Floats
) -> tuple[list[float], Floats]:
    """Sigma of each channel over that of the fit, and the log-posterior of sizes of the
    discrepancy, shape (sizes,), for noise of a memory in s."""
    from scipy.optimize import minimize_scalar  # slow to load

    n_nuisance = channels[0].basis.shape[1]
    parts = [_independent(item, rows, memory) for item, rows in zip(channels, columns, strict=True)]
    count = sum(len(rows) for item, rows in zip(channels, columns, strict=True) if not item.given)
    halves = sum(part.half for part in parts)
    # as few rows as columns, of the channels of known noise and of the others
    factors = [
        triangle(np.concatenate(some)) if some else np.zeros((0, columns[0].shape[1]))
        for some in (
            [part.rows for item, part in zip(channels, parts, strict=True) if item.given == known]
            for known in (True, False)
        )
    ]

    def log_posterior(scale: float, sizes: Floats) -> Floats:
        rows = np.concatenate([factors[0], factors[1] / scale])
        likelihood = log_likelihood(triangle(rows), sizes, n_nuisance)
        return likelihood - count * math.log(scale) - halves + log_prior(sizes)

    scale, logs = 1.0, log_posterior(1.0, grid)
    for _ in range(_ROUNDS if count else 0):
        sizes = grid[np.argmax(logs)][None]
        best = minimize_scalar(
            lambda log, sizes=sizes: -float(log_posterior(math.exp(log), sizes)[0]),
            bounds=(-3.0, 3.0), method="bounded", options={"xatol": 1e-3},
        )  # fmt: skip
        scale = math.exp(best.x)
        logs = log_posterior(scale, grid)
    return [
        1.0 if item.given else scale * part.sigma
        for item, part in zip(channels, parts, strict=True)
    ], logs


class _Independent(NamedTuple):
    rows: Floats
    """columns over noise, made independent"""
    sigma: float
    """of the noise, over that of the fit"""
    half: float
    """half the log-determinant of its covariance"""


def _independent(item: ChannelResiduals, columns: Floats, memory: float) -> _Independent:
    """Columns of a channel made independent; 0 is no memory.

    The part of the residuals that is not smooth, by second differences, is that of noise of the
    given memory, for which their variance is sigma^2 (6 - 8 c + 2 c^2), c its correlation over a
    gap.
    """
    carry = math.exp(-item.gap / memory) if memory else 0.0
    steady = 0.0
    if not item.given:
        steady = float(np.mean(np.diff(item.residual, 2) ** 2)) / (6 - 8 * carry + 2 * carry**2)
    sigma = 1.0 if item.given else math.sqrt(max(steady, item.square / _PURE**2))
    rows, half = columns / sigma, len(columns) * math.log(sigma)
    if memory:
        steps = ar1_correlation(np.diff(item.t), memory)[:, None]
        left = np.sqrt(np.maximum(1 - steps**2, 1e-14))
        rows[1:] = (rows[1:] - steps * rows[:-1]) / left
        half += float(np.log(left).sum())
    return _Independent(rows, sigma, half)
