"""Convergence of a sample: autocorrelation time, effective sample size and R-hat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from curlfit.numerics.arrays import Floats

BLOCK = 20  # steps between the first tests of convergence; later a fifth of those done
_R_HAT = 1.01
_WINDOW = 5.0  # autocorrelation times over which autocorrelations are summed
_SHORTEST_IN_TIMES = 30.0  # steps over autocorrelation time, below which no estimate is trusted


@dataclass(frozen=True)
class Diagnosis:
    """Diagnostics of a sample after the discarded steps, by parameter; times are in steps."""

    discarded: int
    times: Floats
    effective: Floats
    r_hat: Floats
    steps: int

    @property
    def least_effective(self) -> float:
        """Smallest effective sample size of all parameters."""
        return float(self.effective.min())

    @property
    def worst_r_hat(self) -> float:
        """Largest R-hat of all parameters."""
        return float(self.r_hat.max())

    @property
    def long_enough(self) -> bool:
        """Whether the sample is long enough for its autocorrelation times to be trusted."""
        return self.steps - self.discarded >= _SHORTEST_IN_TIMES * float(self.times.max())

    def good(self, effective: float) -> bool:
        """Whether the sample has converged, with at least this effective sample size."""
        return self.long_enough and self.least_effective >= effective and self.worst_r_hat < _R_HAT


def steps_to_discard(steps: int) -> int:
    """Number of initial steps to leave out."""
    return min(max(BLOCK // 2, steps // 10), steps // 2)


def diagnose(values: Floats, ensembles: int) -> Diagnosis:
    """Convergence diagnostics of values (steps, walkers, parameters)."""
    steps, walkers, dimension = values.shape
    discarded = steps_to_discard(steps)
    kept = values[discarded:]
    times = autocorrelation_times(kept)
    times = np.maximum(np.nan_to_num(times, nan=float(len(kept))), 1.0)
    effective = kept.shape[0] * walkers / times
    groups = kept.reshape(len(kept), ensembles, -1, dimension)
    # Each ensemble is split in two, so that drift is detected as well as disagreement.
    half = len(kept) // 2
    parts = np.concatenate([groups[:half], groups[half : 2 * half]], 1)
    return Diagnosis(discarded, times, effective, r_hat(parts), steps)


def autocorrelation_times(values: Floats) -> Floats:
    """Integrated autocorrelation times of values (steps, walkers, parameters), in steps; NaN where
    a walker never moved.

    Sokal (1997, sect. 3.3), with the autocorrelation averaged over the walkers, as in emcee, whose
    own function takes one walker at a time and seven times as long.
    """
    steps = len(values)
    size = 2 << (steps - 1).bit_length()  # zero-padded, so that the ends do not wrap around
    times = []
    for series in np.moveaxis(values, 2, 0):
        transform = np.fft.rfft(series.T - series.mean(0)[:, None], size)
        covariance = np.fft.irfft(np.abs(transform) ** 2, size)[:, :steps]
        with np.errstate(invalid="ignore"):
            correlation = (covariance / covariance[:, :1]).mean(0)
        sums = 2 * np.cumsum(correlation) - 1
        within = np.arange(steps) < _WINDOW * sums
        times.append(sums[np.argmin(within) if within.any() else -1])
    return np.array(times)


def r_hat(groups: Floats) -> Floats:
    """Potential scale reduction factor of Gelman and Rubin (1992).

    Parameters
    ----------
    groups : shape (steps, groups, walkers, parameters); the walkers of a group count as one chain.
    """
    n = groups.shape[0] * groups.shape[2]
    means = groups.mean((0, 2))
    within = groups.var((0, 2)).mean(0) * n / (n - 1)
    between = means.var(0, ddof=1)
    return cast(Floats, np.sqrt((n - 1) / n + between / np.where(within > 0, within, 1.0)))
