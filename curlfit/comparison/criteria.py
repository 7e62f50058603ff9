"""Information criteria: log-likelihoods, and the numbers of values and parameters that count.

What the path determines counts, not what the law has: the effective number of parameters (see
`evidence`), and one for each noise that was estimated. Where the residuals of the law that fits
best are correlated from row to row, the log-likelihood of each channel counts by its effective
number of values over the number of its rows (the variance inflation of QAICc: Burnham and Anderson
2002, sect. 2.5), for all laws alike. That is an approximation, and the report says so.

Under a robust loss the likelihood is that of the noise which the loss stands for, at its likeliest
sigma (see `losses.log_density`); all laws are fitted and ranked under the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from curlfit.comparison.evidence import log_evidence
from curlfit.comparison.result import Candidate
from curlfit.inference.likelihood import SIGMA_FLOOR

# isort: split
import jax.numpy as jnp
import numpy as np

from curlfit.inference.fit.prepared import motion_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.noise.correlated import whitener_of
from curlfit.inference.noise.losses import likeliest_sigma, log_density
from curlfit.inference.noise.models import Noise
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS


def noise_parameters(noise: Noise) -> int:
    """Parameters of a noise model beside sigma: correlation times that differ, and sizes of the
    discrepancy."""
    return len(set(noise.memory.values())) + len(noise.sizes)


def residuals_of(result: FitResult) -> dict[str, Floats]:
    """Measured - fitted by channel, where measured."""
    found = {name: result.observed[name] - result.fitted[name] for name in result.rms}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def log_likelihood(result: FitResult) -> dict[str, float]:
    """At the fit, by channel, of noise as the loss or the noise model has it; an estimated sigma is
    at its most likely value."""
    if result.noise.kind != "white":
        return _of_correlated(result)
    found = {}
    for name, residual in residuals_of(result).items():
        given = result.observed.get(f"sigma_{name}")
        sigma: Floats | float = (
            likeliest_sigma(residual, result.loss)
            if given is None
            else given[np.isfinite(result.observed[name])]
        )
        found[name] = float((log_density(residual / sigma, result.loss) - np.log(sigma)).sum())
    return found


def _of_correlated(result: FitResult) -> dict[str, float]:
    """The same of Gaussian noise that is correlated as the fit has it."""
    t = result.observed["t"]
    weight, residual = np.zeros((2, len(CHANNELS), len(t)))
    for row, name in enumerate(CHANNELS):
        if name in result.rms:
            there = np.isfinite(result.observed[name])
            sigma = result.observed.get(f"sigma_{name}")
            weight[row, there] = 1 / (result.sigma[name] if sigma is None else sigma[there])
            off = result.observed[name] - result.fitted[name]
            residual[row] = np.where(there, off, 0.0) * weight[row]
    whitener = whitener_of(result.noise, t - t[0], weight, motion_of(result))
    assert whitener is not None
    white = np.asarray(whitener.whiten(jnp.asarray(residual)))
    determinant = whitener.log_determinant()
    found = {}
    for row, name in enumerate(CHANNELS):
        if name in result.rms:
            there = weight[row] > 0
            scale = likeliest_sigma(white[row, there], "linear") if name in result.sigma else 1.0
            density = log_density(white[row, there] / scale, "linear")
            found[name] = float((density + np.log(weight[row, there] / scale)).sum())
            found[name] += float(determinant[row])
    return found


def effective_values(result: FitResult) -> dict[str, float]:
    """Effective number of values of the channels whose residuals are correlated from row to row.

    n (1 - r)/(1 + r) (Bayley and Hammersley 1946). A fit of p parameters to n rows makes the
    correlation r of neighbours smaller by (2 r + p (1 + r))/n (Marriott and Pope 1954, for a mean).
    """
    found, p = {}, result.rank / len(result.rms)
    for name, residual in residuals_of(result).items():
        item, n = result.independence.get(name), len(residual)
        if item is not None and item.doubtful and result.rms[name] > 10 * SIGMA_FLOOR:
            r = (item.lag1 + p / n) / (1 - (2 + p) / n)
            found[name] = max(n * (1 - r) / (1 + r), 1.0)
    return found


def with_criteria(
    candidate: Candidate,
    result: FitResult,
    likelihood: Mapping[str, float],
    effective: Mapping[str, float],
) -> Candidate:
    """AICc (Hurvich and Tsai 1989) and BIC (Schwarz 1978) by the effective number of values, from
    the log-likelihood of each channel; and the evidence, where all values are independent."""
    k, n = candidate.n_parameters or 0.0, result.n_observations
    values = {name: len(residual) for name, residual in residuals_of(result).items()}
    counted = {name: effective.get(name, float(values[name])) for name in values}
    twice = 2 * sum(part * counted[name] / values[name] for name, part in likelihood.items())
    return replace(
        candidate,
        aicc=2 * k - twice + 2 * k * (k + 1) / max(n - k - 1, 1),
        bic=k * float(np.log(sum(counted.values()))) - twice,
        # A handful of effective values stands for the shape of no likelihood.
        log_evidence=None if effective else log_evidence(result, twice / 2),
    )
