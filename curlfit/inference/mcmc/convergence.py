"""Convergence of a sample: R-hat, bulk and tail effective sample sizes.

Vehtari, Gelman, Simpson, Carpenter and Buerkner (2021): Bayesian Analysis 16, 667-718.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from statistics import NormalDist

import numpy as np

from curlfit.numerics.arrays import Floats

BLOCK = 20  # steps between the first tests of convergence; later a fifth of those done
_R_HAT = 1.01
_TAILS = (0.05, 0.95)  # quantiles whose effective sample sizes are those of the tails (sect. 4.3)
_SHORTEST_IN_TIMES = 30.0  # steps over autocorrelation time, below which no estimate is trusted
_FEWEST = 5  # draws of a chain whose autocorrelations say anything


def steps_to_discard(steps: int) -> int:
    """Number of initial steps to leave out."""
    return min(max(BLOCK // 2, steps // 10), steps // 2)


class Diagnosis:
    """Diagnostics of a sample after the first steps, by parameter, computed when they are asked
    for.

    Walkers are the chains of effective sample sizes. Those of an ensemble move by one another, so
    that only ensembles are independent chains for R-hat. Each is split in halves.
    """

    def __init__(self, values: Floats, ensembles: int) -> None:
        """Of values (steps, walkers, parameters)."""
        kept = values[steps_to_discard(len(values)) :].transpose(2, 1, 0)
        half = kept.shape[2] // 2
        halves = np.concatenate([kept[..., :half], kept[..., -half:]], 1)
        self._kept, self._draws = kept, np.ascontiguousarray(halves)
        self._halves = (2 * ensembles, -1)

    @cached_property
    def _scores(self) -> list[Floats]:
        return [normal_scores(draws) for draws in self._draws]

    @cached_property
    def bulk(self) -> Floats:
        """Effective sample sizes of the bulk."""
        return np.array([effective_size(scores) for scores in self._scores])

    @cached_property
    def tail(self) -> Floats:
        """Effective sample sizes of the tails, the smaller of those of two quantiles."""
        ends = np.quantile(self._kept, _TAILS, (1, 2)).T
        sizes = [
            [effective_size(draws <= end) for end in two]
            for draws, two in zip(self._draws, ends, strict=True)
        ]
        return np.min(sizes, 1)

    @cached_property
    def r_hat(self) -> Floats:
        """R-hat, the larger of that of the draws and that of their distances from the median."""
        folded = [normal_scores(np.abs(draws - np.median(draws))) for draws in self._draws]
        both = [
            [r_hat(each.reshape(self._halves)) for each in pair]
            for pair in zip(self._scores, folded, strict=True)
        ]
        return np.max(both, 1)

    @property
    def least_effective(self) -> float:
        """Smallest effective sample size, of bulk or tail, of all parameters."""
        return float(min(self.bulk.min(), self.tail.min()))

    @property
    def worst_r_hat(self) -> float:
        """Largest R-hat of all parameters."""
        return float(self.r_hat.max())

    def good(self, effective: float) -> bool:
        """Whether the sample has converged, with at least this effective sample size, and each
        walker is 30 times as long as the autocorrelation time, its draws over those effective."""
        wanted = max(effective, _SHORTEST_IN_TIMES * self._kept.shape[1])
        long_enough = float(self.bulk.min()) >= wanted and float(self.tail.min()) >= effective
        return long_enough and self.worst_r_hat < _R_HAT


def normal_scores(draws: Floats) -> Floats:
    """Normal scores of the ranks of draws; ties have their mean rank (eq. 14)."""
    _, inverse, count = np.unique(draws, return_inverse=True, return_counts=True)
    twice = 2 * np.cumsum(count) - count - 1  # twice the rank, counted from zero
    return _score_of_twice(draws.size)[twice][inverse].reshape(draws.shape)


@lru_cache(maxsize=1)
def _score_of_twice(size: int) -> Floats:
    normal = NormalDist()
    lower = [normal.inv_cdf((place / 2 + 0.625) / (size + 0.25)) for place in range(size)]
    return np.concatenate([lower, -np.array(lower[-2::-1])])


def effective_size(chains: Floats) -> float:
    """Effective sample size of chains, shape (chains, draws), by Geyer's initial monotone sequence
    (eq. 10-13). Chains too short for autocorrelations count as one draw each."""
    number, n = chains.shape
    if n < _FEWEST:
        return float(number)
    means = chains.mean(1, keepdims=True)
    transform = np.fft.rfft(chains - means, -(-n // 4) * 8)  # zeros: no wrapping around
    covariance = np.fft.irfft((transform.real**2 + transform.imag**2).mean(0))[:n] / n
    total = covariance[0] + means.var(ddof=1)
    if total == 0:
        return float(number * n)
    correlation = 1 - (covariance[0] * n / (n - 1) - covariance) / total
    correlation[0] = 1.0
    pairs = correlation[: (n - 1) // 2 * 2].reshape(-1, 2).sum(1)
    ended = np.append(pairs[:-1] <= 0, True).argmax()
    monotone = np.minimum.accumulate(pairs[:ended]).sum()
    time = 2 * monotone - 1 + max(correlation[2 * ended], 0.0)
    return float(number * n / max(time, 1 / np.log10(number * n)))


def r_hat(chains: Floats) -> float:
    """Potential scale reduction factor of chains, shape (chains, draws) (eq. 1-4)."""
    n = chains.shape[1]
    within, between = chains.var(1, ddof=1).mean(), chains.mean(1).var(ddof=1)
    if within == 0:
        return math.inf if between > 0 else 1.0
    return math.sqrt((n - 1) / n + between / within)
