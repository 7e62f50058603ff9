"""Evidence: the likelihood of a law, averaged over the prior of its parameters.

Prior. A parameter with a prior in the fit keeps it. Any other coefficient has a normal density
about zero, truncated at its bounds, whose standard deviation is three times the larger of its
typical size and its default: it specifies only the order of magnitude. The initial state, and
conditions without a prior, have a flat density common to all laws, so that evidences for one throw
are comparable and their ratios are Bayes factors (Kass and Raftery 1995).

Integral. Chi squared is taken as quadratic (Laplace), which leaves a Gaussian integral over the box
of the bounds. It is exact along ridges, where only the prior limits it, and at bounds: a parameter
that the data push against its bound contributes the integral over its half-line, and the others the
probability of the box under their joint normal density. A parameter p with a lognormal prior is
replaced by its logarithm, q = p1 (1 + ln(p/p1)) about the estimate p1: the prior is normal in q,
and the integral exact both where the data determine p and where only the prior does (MacKay 1998).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Booleans, Floats

_ORDER = 3.0  # standard deviation of a coefficient's prior over its typical size or default
_FAR = 8.0  # standard deviations within which a bound matters
_LEAST = 1e-12  # smallest probability of a box


class PriorTerms(NamedTuple):
    """Prior of some parameters, normal where it is not flat; a lognormal one about the estimate, in
    the coordinate of the module docstring."""

    mean: Floats
    precision: Floats
    """0 where the density is flat"""
    log_density: float
    """of the flat priors, and the normalization of the truncated normal ones"""


def log_evidence(result: FitResult, log_likelihood: float) -> float:
    """Logarithm of the evidence, up to a constant that is the same for all laws, from the
    log-likelihood at the fit."""
    names = result.information["names"]
    values = np.array([result.parameters[name].value for name in names])
    lower, upper = np.array([_bounds(result, name) for name in names]).T
    prior, (information, gradient) = prior_terms(result, names), _of_data(result, names)
    off = prior.mean - values
    pushed = np.array([result.parameters[name].verdict == "at bound" for name in names])
    constant = log_likelihood + prior.log_density - 0.5 * float(off @ (prior.precision * off))
    return constant + _log_integral(
        gradient + prior.precision * off, information + np.diag(prior.precision), lower - values,
        upper - values, pushed,
    )  # fmt: skip


def effective_parameters(result: FitResult) -> float:
    """Number of parameters away from their bounds that the data rather than the prior determine:
    the trace of J^T J (J^T J + P)^-1, P the precision of the prior."""
    names = result.information["names"]
    free = [
        index for index, name in enumerate(names) if result.parameters[name].verdict != "at bound"
    ]
    information = _of_data(result, names)[0][np.ix_(free, free)]
    prior = prior_terms(result, names).precision[free]
    size = np.sqrt(np.maximum(np.diag(information) + prior, 1e-300))
    scaled, own = information / np.outer(size, size), np.diag(prior / size**2)
    return float(np.trace(np.linalg.lstsq(scaled + own, scaled, rcond=1e-13)[0]))


def prior_terms(result: FitResult, names: list[str]) -> PriorTerms:
    """The prior of parameters by name, as described in the module docstring."""
    coefficients = {item.name: item for item in result.law_class.coefficients()}
    priors = result.parameter_set.priors
    mean, precision = np.zeros((2, len(names)))
    log_density = 0.0
    for index, name in enumerate(names):
        known, item = priors.get(name), result.parameters[name]
        if known is not None and known.kind == "uniform":
            log_density -= math.log(item.upper - item.lower)
            continue
        if known is not None and known.kind == "lognormal":
            median, sigma = known.values
            mean[index], sd = _logarithmic(median, item.value), sigma * item.value
        elif known is not None:
            mean[index], sd = known.mode, known.values[-1]
        elif name in coefficients:
            sd = _ORDER * max(coefficients[name].typical, abs(coefficients[name].default))
        else:
            continue
        precision[index] = 1 / sd**2
        ends = (np.array(_bounds(result, name)) - mean[index]) / sd
        log_density -= math.log(sd) + 0.5 * math.log(2 * math.pi) + _log_between(*ends)
    return PriorTerms(mean, precision, log_density)


def _bounds(result: FitResult, name: str) -> tuple[float, float]:
    """The bounds of a parameter, in its coordinate of the module docstring."""
    item, prior = result.parameters[name], result.parameter_set.priors.get(name)
    if prior is None or prior.kind != "lognormal":
        return item.lower, item.upper
    return _logarithmic(item.lower, item.value), _logarithmic(item.upper, item.value)


def _logarithmic(p: float, estimate: float) -> float:
    """p1 (1 + ln(p/p1)): the logarithm of p, scaled so as to equal p to first order about p1."""
    return estimate * (1 + math.log(p / estimate)) if p > 0 else -math.inf


def _log_between(low: float, high: float) -> float:
    """Logarithm of the probability of an interval under the standard normal density."""
    if low > 0:
        low, high = -high, -low
    return float(log_ndtr(high) + np.log1p(-np.exp(log_ndtr(low) - log_ndtr(high))))


def _of_data(result: FitResult, names: list[str]) -> tuple[Floats, Floats]:
    """Information and gradient of the log-likelihood, without the priors of the fit."""
    information = np.array(result.information["matrix"])
    gradient = np.array(result.information["gradient"])
    penalty = result.parameter_set.penalty
    if penalty is None:
        return information, gradient
    free = [result.parameter_set.index(name) for name in names]
    residual, slope = penalty.residual_and_slope(result.values)
    return information - np.diag(slope[free] ** 2), gradient + (residual * slope)[free]


def _log_integral(
    linear: Floats, precision: Floats, lower: Floats, upper: Floats, pushed: Booleans
) -> float:
    """Logarithm of the integral of exp(b d - d A d/2) over a box of d, parameters minus estimates.

    b is `linear`, A `precision`.
    """
    inner, outer = np.flatnonzero(~pushed), np.flatnonzero(pushed)
    size = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    matrix = precision / np.outer(size, size)
    linear = linear / size
    block = matrix[np.ix_(inner, inner)]
    squares, axes = np.linalg.eigh(block)
    seen = squares > 1e-14 * squares.max(initial=0.0)
    inverse = (axes[:, seen] / squares[seen]) @ axes[:, seen].T
    mean = inverse @ linear[inner]
    total = 0.5 * float(linear[inner] @ mean)
    total += 0.5 * (seen.sum() * math.log(2 * math.pi) - float(np.log(squares[seen]).sum()))
    total -= float(np.log(size[inner]).sum())
    total += _log_box(mean, inverse, (lower * size)[inner], (upper * size)[inner])
    # Each pushed parameter over its half-line, with the others following.
    for index in outer:
        cross = matrix[index, inner]
        stiffness = max(float(matrix[index, index] - cross @ inverse @ cross), 1e-12)
        push = abs(float(linear[index] - cross @ mean))
        root = math.sqrt(stiffness)
        total += push**2 / (2 * stiffness) + float(log_ndtr(-push / root))
        total += 0.5 * math.log(2 * math.pi / stiffness) - math.log(size[index])
    return total


def _log_box(mean: Floats, covariance: Floats, lower: Floats, upper: Floats) -> float:
    """Logarithm of the probability of a box."""
    sd = np.sqrt(np.diag(covariance))
    near = (lower > mean - _FAR * sd) | (upper < mean + _FAR * sd)
    if not near.any():
        return 0.0
    if near.sum() == 1:
        ends = (np.array([lower[near][0], upper[near][0]]) - mean[near]) / sd[near]
        return max(_log_between(*ends), math.log(_LEAST))
    from scipy.stats import multivariate_normal  # slow to load, and few boxes need it

    some = np.ix_(near, near)
    found = multivariate_normal(mean[near], covariance[some], allow_singular=True, seed=1).cdf(
        upper[near], lower_limit=lower[near]
    )
    return math.log(max(float(found), _LEAST))
