"""Model discrepancy as noise: missing accelerations estimated from residuals, and whitened.

Missing accelerations (`curlfit.inference.noise.accelerations`) with independent or AR(1) noise. The
sizes of the accelerations and the correlation time are averaged over their posterior rather than
set to its maximum: the covariance is that of the sizes' second moments, and the correlation time
that of the mean standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.identifiability import r_factor
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
_PURE = 300.0  # largest rms residual over the independent noise
_LONGEST = 0.5  # correlation time over the time of motion
_MEMORIES = 10  # number of correlation times tried
_COUNT = len(COMPONENTS) * SHAPES
_NEGLIGIBLE = 10.0  # log-posterior below its maximum from which it is neglected
_GRID, _COARSE = (
    np.stack(np.meshgrid(*[some] * len(COMPONENTS), indexing="ij"), -1).reshape(-1, len(COMPONENTS))
    for some in (SIZES, SIZES[::2])
)  # sizes of the discrepancy


class DiscrepancyWhitener(NamedTuple):
    """Scales each direction u of the residuals in which the discrepancy is s times the noise down
    by sqrt(1 + s^2), after AR(1) noise has been whitened.

    With C = 1 + U diag(s^2) U^T, C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
    """

    directions: Any
    """orthonormal, shape (channels, n, k)"""
    shrink: Any
    """1 - 1/sqrt(1 + s^2) by direction, shape (k,)"""
    ar1: AR1Whitener | None

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, responses: Responses | None) -> Self:
        """The whitener of a noise model; it changes nothing where that has no memory and no size.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        responses : of the path to accelerations; None for a noise that has no size yet.
        """
        before = AR1Whitener.of(noise, times, weight) if "ar1" in noise.kind else None
        if not noise.sizes or responses is None:
            return cls(np.zeros((*weight.shape, _COUNT)), np.zeros(_COUNT), before)
        rows = _weighted_responses(noise, times, weight, responses, before)
        q, r = np.linalg.qr(rows.reshape(-1, _COUNT))  # faster than an SVD of all rows
        left, singular, _ = np.linalg.svd(r, full_matrices=False)
        directions = np.zeros((weight.size, _COUNT))
        directions[:, : left.shape[1]] = q @ left
        shrink = np.zeros(_COUNT)
        shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)
        return cls(directions.reshape(*weight.shape, _COUNT), shrink, before)

    def whiten(self, residual: Array) -> Array:
        """Whitened residuals from residuals over sigma, shape (channels, n)."""
        if self.ar1 is not None:
            residual = self.ar1.whiten(residual)
        along = jnp.einsum("cnk,cn->k", self.directions, residual) * self.shrink
        return residual - jnp.einsum("cnk,k->cn", self.directions, along)

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood; shape (channels,)."""
        found = np.zeros(self.directions.shape[0])
        found[0] = np.log1p(-self.shrink).sum()  # of all channels together
        return found if self.ar1 is None else found + self.ar1.log_determinant()


def _weighted_responses(
    noise: Noise, times: Floats, weight: Floats, responses: Responses, before: AR1Whitener | None
) -> Floats:
    """B of the covariance N + B B^T of the residuals over sigma, with independent amplitudes of
    variance 1, after AR(1) noise has been whitened; shape (channels, n, 3 * SHAPES)."""
    rows = np.stack([responses.at(times, row) for row in range(len(weight))])
    rows *= weight[..., None] * _amplitudes(noise)
    if before is not None:
        rows = np.asarray(jax.vmap(before.whiten, -1, -1)(jnp.asarray(rows)))
    return rows


def _amplitudes(noise: Noise) -> Floats:
    """Standard deviation of each shape of each component, over the friction."""
    return np.repeat([noise.sizes[name] for name in COMPONENTS], SHAPES)


def posterior_mean(
    noise: Noise, times: Floats, weight: Floats, residual: Floats, responses: Responses
) -> Floats:
    """Mean of the discrepancy given the residuals, in every channel at the times of the rows.

    K (K + N)^-1 r, with the covariances K of the discrepancy and N of the remaining noise
    (Rasmussen and Williams 2006, eq. 2.25). With K = B B^T, also at rows that were not observed, it
    is B (1 + B^T N^-1 B)^-1 B^T N^-1 r.

    Parameters
    ----------
    times : s since the first row, shape (n,).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
    residual : measured minus the path of the law, 0 where nothing was observed, of that shape; SI.

    Returns
    -------
    shape (5, n), SI: of x, y, phi, speed and spin.
    """
    before = AR1Whitener.of(noise, times, weight) if "ar1" in noise.kind else None
    rows = _weighted_responses(noise, times, weight, responses, before).reshape(-1, _COUNT)
    white = weight * residual
    if before is not None:
        white = np.asarray(before.whiten(jnp.asarray(white)))
    mean = np.linalg.solve(np.eye(_COUNT) + rows.T @ rows, rows.T @ white.ravel())
    found = [responses.at(times, channel) for channel in range(len(CHANNELS))]
    return np.array(found) @ (_amplitudes(noise) * mean)


def estimate(
    channels: Sequence[ChannelResiduals], span: float, responses: Responses, kind: str
) -> tuple[Noise, dict[str, float]]:
    """Sizes of the discrepancy, one scale for all sigmas that were not given, and, for
    "ar1+discrepancy", one correlation time.

    Parameters
    ----------
    channels : residuals of a fit with white noise.
    span : time after the first row during which the stone moves, s.

    Returns
    -------
    the noise, and by channel its sigma where it was not given.
    """
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
    found = [_at_memory(channels, columns, float(memory)) for memory in memories]
    priors = ar1.log_prior(memories, span) if "ar1" in kind else np.zeros(1)
    rough = np.array([np.logaddexp.reduce(one.log_posterior(_COARSE)) for one in found]) + priors
    near = np.flatnonzero(rough > rough.max() - _NEGLIGIBLE)
    logs = np.array([found[index].log_posterior(_GRID) + priors[index] for index in near])
    by_memory = np.logaddexp.reduce(logs, axis=1)
    weights = np.exp(logs - logs.max())
    rms = np.sqrt(weights.sum(0) @ _GRID**2 / weights.sum())
    noise = Noise(kind, sizes=dict(zip(COMPONENTS, map(float, rms), strict=True)))
    sigmas = np.array([found[index].sigmas for index in near])
    best = sigmas[0]
    if "ar1" in kind:
        low = 2 * np.log(sigmas).mean(1) + np.log(memories[near])
        curve = np.column_stack([np.log(memories[near]), np.log(sigmas)])
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


class _AtMemory(NamedTuple):
    """Noise with one correlation time."""

    sigmas: list[float]
    """of each channel, over that of the fit"""
    log_posterior: Callable[[Floats], Floats]
    """of sizes of the discrepancy, shape (sizes, 3)"""


def _at_memory(
    channels: Sequence[ChannelResiduals], columns: Sequence[Floats], memory: float
) -> _AtMemory:
    """Noise with a correlation time in s, with the scale that maximizes the posterior."""
    from scipy.optimize import minimize_scalar  # slow to load

    n_nuisance = channels[0].basis.shape[1]
    parts = [_independent(item, rows, memory) for item, rows in zip(channels, columns, strict=True)]
    count = sum(len(rows) for item, rows in zip(channels, columns, strict=True) if not item.given)
    halves = sum(part.half for part in parts)
    # R factors of the channels of known noise and of the others
    factors = [
        r_factor(np.concatenate(some)) if some else np.zeros((0, columns[0].shape[1]))
        for some in (
            [part.rows for item, part in zip(channels, parts, strict=True) if item.given == known]
            for known in (True, False)
        )
    ]

    def log_posterior(scale: float, sizes: Floats) -> Floats:
        rows = np.concatenate([factors[0], factors[1] / scale])
        likelihood = log_likelihood(r_factor(rows), sizes, n_nuisance)
        return likelihood - count * math.log(scale) - halves + log_prior(sizes)

    scale = 1.0
    for _ in range(_ROUNDS if count else 0):
        sizes = _COARSE[np.argmax(log_posterior(scale, _COARSE))][None]
        best = minimize_scalar(
            lambda log, sizes=sizes: -float(log_posterior(math.exp(log), sizes)[0]),
            bounds=(-3.0, 3.0), method="bounded", options={"xatol": 1e-3},
        )  # fmt: skip
        scale = math.exp(best.x)
    sigmas = [
        1.0 if item.given else scale * part.sigma
        for item, part in zip(channels, parts, strict=True)
    ]
    return _AtMemory(sigmas, partial(log_posterior, scale))


class _Independent(NamedTuple):
    rows: Floats
    """columns over noise, whitened"""
    sigma: float
    """of the noise, over that of the fit"""
    half: float
    """half the log-determinant of its covariance"""


def _independent(item: ChannelResiduals, columns: Floats, memory: float) -> _Independent:
    """Columns of a channel, whitened; a `memory` of 0 means independent noise.

    Sigma follows from the second differences of the residuals, free of their smooth part: for noise
    of the given memory their variance is sigma^2 (6 - 8 c + 2 c^2), with its correlation c over a
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
