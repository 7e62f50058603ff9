"""Information criteria: log-likelihoods, and effective numbers of values and parameters.

The number of parameters is that of what the path determines, not of what the law has or a prior
says: their effective number (see `evidence`), plus one for each estimated parameter of the noise.
Likelihoods are densities of the data in SI units, with the determinant of the covariance for
correlated noise, so that AICc and BIC compare noise models as well as laws.

Where the residuals of the fit of greatest likelihood are correlated from row to row, the
log-likelihood of each channel is weighted by its effective sample size, minus the number of
parameters that this fit spends on it, over the number of its rows (quasi-likelihood, with the
variance inflation estimated with n - p degrees of freedom: Burnham and Anderson 2002, sect. 2.5),
for all candidates alike. This is an approximation, and the report says so.

Under a robust loss the likelihood is that of the corresponding noise distribution, at its most
likely sigma (see `losses.log_density`); all laws are fitted and ranked under the same loss.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from curlfit.comparison.evidence import effective_parameters
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import SIGMA_FLOOR
from curlfit.inference.noise.losses import likeliest_sigma, log_density
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS


class EffectiveValues(NamedTuple):
    """Effective sample sizes with correlated residuals, from the fit of greatest likelihood."""

    number: dict[str, float]
    """effective sample size of the channels whose residuals are correlated"""
    spent: float
    """number of parameters that the fit spends on each channel"""

    def weight(self, channel: str, rows: int) -> float:
        """Weight of the log-likelihood of a channel."""
        if channel not in self.number:
            return 1.0
        return max(self.number[channel] - self.spent, 1.0) / rows

    def total(self, rows: Mapping[str, int]) -> float:
        """Effective sample size of all channels together."""
        return sum(self.number.get(name, float(count)) for name, count in rows.items())


def number_of_parameters(result: FitResult) -> float:
    """Number of parameters that the data determine: of the law and the initial state, the estimated
    sigmas, and the noise model's own (distinct correlation times, independent shares, sizes of a
    discrepancy)."""
    noise = result.noise
    correlated = {name: memory for name, memory in noise.memory.items() if memory}
    own = len({*correlated.values()}) + len(correlated.keys() & noise.white) + len(noise.sizes)
    return effective_parameters(result) + len(result.sigma) + own


def residuals_of(result: FitResult) -> dict[str, Floats]:
    """Measured - fitted by channel, where measured."""
    found = {name: result.observed[name] - result.fitted[name] for name in result.rms}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def log_likelihood(result: FitResult) -> dict[str, float]:
    """Log-likelihood at the fit, by channel, under the noise model or the loss; an estimated sigma
    is at its most likely value."""
    found, loss = {}, result.loss
    if result.noise.kind == "white":
        standardized = _independent(result)
    else:
        standardized, loss = _whitened(result), "linear"
    for name, (residual, volume) in standardized.items():
        scale = likeliest_sigma(residual, loss) if name in result.sigma else 1.0
        density = log_density(residual / scale, loss) - np.log(scale)
        found[name] = float(density.sum()) + volume
    return found


def _independent(result: FitResult) -> dict[str, tuple[Floats, float]]:
    """Residuals over the sigma of each row, where it is given, and the logarithm of the
    determinant of this change of variables, by channel."""
    found = {}
    for name, residual in residuals_of(result).items():
        by_row = result.observed.get(f"sigma_{name}", np.ones_like(result.observed["t"]))
        sigma = by_row[np.isfinite(result.observed[name])]
        found[name] = residual / sigma, -float(np.log(sigma).sum())
    return found


def _whitened(result: FitResult) -> dict[str, tuple[Floats, float]]:
    """The same for Gaussian noise with the correlation of the fit."""
    problem, _ = problem_of(result)
    weight, whitener = problem.weight, problem.whitener
    residual = np.zeros(weight.shape)
    for row, name in enumerate(CHANNELS):
        if name in result.rms:
            off = result.observed[name] - result.fitted[name]
            residual[row, : len(off)] = np.where(np.isfinite(off), off, 0.0)
    white = np.asarray(whitener.whiten(residual * weight))
    determinant = whitener.log_determinant()
    return {
        name: (
            white[row, there := weight[row] > 0],
            float(np.log(weight[row, there]).sum() + determinant[row]),
        )
        for row, name in enumerate(CHANNELS)
        if name in result.rms
    }


def effective_values(result: FitResult) -> EffectiveValues:
    """Effective sample sizes of the channels whose residuals are correlated from row to row.

    n (1 - r)/(1 + r) (Bayley and Hammersley 1946). A fit of p parameters to n rows reduces the
    correlation r of neighbours by (2 r + p (1 + r))/n (Marriott and Pope 1954, for a mean).
    """
    found, p = {}, effective_parameters(result) / len(result.rms)
    for name, residual in residuals_of(result).items():
        item, n = result.independence.get(name), len(residual)
        if item is not None and item.doubtful and result.rms[name] > 10 * SIGMA_FLOOR:
            r = (item.lag1 + p / n) / (1 - (2 + p) / n)
            found[name] = max(n * (1 - r) / (1 + r), 1.0)
    return EffectiveValues(found, p)


def criteria(
    result: FitResult, likelihood: Mapping[str, float], effective: EffectiveValues
) -> dict[str, float]:
    """AICc (Hurvich and Tsai 1989) and BIC (Schwarz 1978), from the log-likelihood of each channel,
    weighted by its effective sample size.

    The penalty of BIC is that of the effective sample size. The small-sample correction of AICc is
    that of the number of values: where residuals are correlated, the effective sample size is often
    less than k + 2, and the correction would be infinite.
    """
    k, n = number_of_parameters(result), result.n_observations
    rows = {name: len(residual) for name, residual in residuals_of(result).items()}
    twice = 2 * sum(effective.weight(name, rows[name]) * part for name, part in likelihood.items())
    return {
        "aicc": 2 * k - twice + 2 * k * (k + 1) / max(n - k - 1, 1),
        "bic": k * math.log(effective.total(rows)) - twice,
    }
