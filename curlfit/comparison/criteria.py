"""Criteria by which laws are ranked: AICc and BIC, evidence, and
leave-one-out cross-validation.

The number of parameters is that of what the path determines, not of what the law has or
a prior says: their effective number (`effective_parameters`), plus one for each
estimated parameter of the noise. Likelihoods are densities of the data in SI units,
with the determinant of the covariance for correlated noise, so that AICc and BIC
compare noise models as well as laws.

Where the residuals of the fit of greatest likelihood are correlated from row to row,
the log-likelihood of each channel is weighted by its effective sample size, minus the
number of parameters that this fit spends on it, over the number of its rows
(quasi-likelihood, with the variance inflation estimated with n - p degrees of freedom:
Burnham and Anderson 2002, sect. 2.5), for all candidates alike. This is an
approximation, and the report says so.

Under a robust loss the likelihood is that of the corresponding noise distribution, at
its most likely sigma (see `Loss.log_density`); all laws are fitted and ranked under
the same loss.

Evidence
--------
The likelihood of a law, averaged over the prior of its parameters. A parameter with a
prior in the fit keeps it. Any other coefficient has a normal density about zero,
truncated at its bounds, whose standard deviation is three times the larger of its
typical size and its default: it specifies only the order of magnitude. The initial
state, and conditions without a prior, have a flat density common to all laws, so that
evidences for one throw are comparable and their ratios are Bayes factors (Kass and
Raftery 1995).

Chi squared is taken as quadratic (Laplace), which leaves a Gaussian integral over the
box of the bounds. It is exact along ridges, where only the prior limits it, and at
bounds: a parameter that the data push against its bound contributes the integral over
its half-line, and the others the probability of the box under their joint normal
density. A parameter p with a lognormal prior is replaced by its logarithm, q = p1 (1 +
ln(p/p1)) about the estimate p1: the prior is normal in q, and the integral exact both
where the data determine p and where only the prior does (MacKay 1998).

Where chi squared is no quadratic, and the values that fit lie on a curve, the integral
is that of importance sampling along it (`curlfit.inference.sampling.draws`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.special import log_ndtr, logsumexp

from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.likelihood import SIGMA_FLOOR
from curlfit.inference.model.priors import Lognormal
from curlfit.inference.noise.whitening import whitened
from curlfit.inference.sampling.draws import WeightedProposals
from curlfit.losses import LOSSES
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.channels import CHANNELS

NULL = 1e-13
"""Share of the largest singular value below which one is rounding error."""
_EXACT = 10 * SIGMA_FLOOR
"""Size of residuals, m or rad, up to which they are rounding errors of exact data."""
_ORDER = 3.0
"""Standard deviation of a coefficient's prior over its typical size or default: the
order of magnitude."""
_FAR = 8.0  # standard deviations within which a bound matters
_PROPOSALS = 4096  # along a ridge
_FEWEST = 100
"""Effective number of proposals, below which their sum is not trusted."""
_LEAST = 1e-12  # smallest probability of a box, and stiffness


class EffectiveValues(NamedTuple):
    """Effective sample sizes with correlated residuals, from the fit of
    greatest likelihood."""

    number: dict[str, float]
    """effective sample size of the channels whose residuals are correlated"""
    spent: float
    """number of parameters that the fit spends on each channel"""


def number_of_parameters(result: FitResult) -> float:
    """Number of parameters that the data determine: of the law and the initial state,
    the estimated sigmas, and those of the noise."""
    of_noise = result.noise.number_of_parameters
    return effective_parameters(result) + len(result.sigma) + of_noise


def residuals_of(result: FitResult) -> dict[str, Floats]:
    """Measured - fitted by channel, where measured."""
    return {
        name: values[np.isfinite(values)] for name, values in result.residuals.items()
    }


def log_likelihood(result: FitResult) -> dict[str, float]:
    """Log-likelihood at the fit, by channel, under the noise model or the loss; an
    estimated sigma is at its most likely value."""
    loss = LOSSES[result.loss]
    problem = problem_of(result)
    weight = problem.weight  # 1/sigma, 0 where not measured, shape (channels, rows)
    whitener = problem.whitener
    residual = np.zeros(weight.shape)  # has more rows than were measured
    for row, name in enumerate(CHANNELS):
        if name in result.residuals:
            values = result.residuals[name]
            residual[row, : len(values)] = np.nan_to_num(values)
    white = np.asarray(whitened(residual * weight, whitener))
    determinant = np.zeros(len(weight))
    if whitener is not None:
        determinant = whitener.log_determinant()
    by_channel = {}
    for row, name in enumerate(CHANNELS):
        if name in result.residuals:
            measured = weight[row] > 0
            of_channel = white[row, measured]
            scale = 1.0
            if name in result.sigma:
                scale = loss.likeliest_sigma(of_channel)
            density = loss.log_density(of_channel / scale)
            density = density + np.log(weight[row, measured] / scale)
            by_channel[name] = float(density.sum() + determinant[row])
    return by_channel


def effective_values(result: FitResult) -> EffectiveValues:
    """Effective sample sizes of the channels whose residuals are correlated
    from row to row.

    n (1 - r)/(1 + r) (Bayley and Hammersley 1946). A fit of p parameters to n rows
    reduces the correlation r of neighbours by (2 r + p (1 + r))/n (Marriott and Pope
    1954, for a mean).
    """
    p = effective_parameters(result) / len(result.rms)
    number = {}
    for name, residual in residuals_of(result).items():
        n = len(residual)
        independence = result.independence.get(name)
        if independence is None or not independence.doubtful:
            continue
        if result.rms[name] > _EXACT:
            r = (independence.lag1 + p / n) / (1 - (2 + p) / n)
            number[name] = max(n * (1 - r) / (1 + r), 1.0)
    return EffectiveValues(number, p)


def criteria(
    result: FitResult, likelihood: Mapping[str, float], effective: EffectiveValues
) -> dict[str, float]:
    """AICc (Hurvich and Tsai 1989) and BIC (Schwarz 1978), from the log-likelihood of
    each channel, weighted by its effective sample size.

    The penalty of BIC is that of the effective sample size. The small-sample
    correction of AICc is that of the number of values: where residuals are
    correlated, the effective sample size is often less than k + 2, and the correction
    would be infinite.
    """
    k = number_of_parameters(result)
    n = result.n_observations
    twice_likelihood = 0.0
    values = 0.0
    for name, residual in residuals_of(result).items():
        rows = len(residual)
        number: float = rows
        counted: float = rows
        if name in effective.number:
            number = effective.number[name]
            counted = max(number - effective.spent, 1.0)
        twice_likelihood += 2 * likelihood[name] * counted / rows
        values += number
    correction = 2 * k * (k + 1) / max(n - k - 1, 1)
    return {
        "aicc": 2 * k - twice_likelihood + correction,
        "bic": k * math.log(values) - twice_likelihood,
    }


class NormalFactors(NamedTuple):
    """Normal factors of the density of some parameters."""

    mean: Floats
    precision: Floats
    """0 where there is none"""


class Parabola(NamedTuple):
    """A function b d - s d^2/2 of one parameter minus its estimate."""

    slope: float
    stiffness: float


class Quadratic(NamedTuple):
    """A function b d - d A d/2 of parameters minus their estimates, in units in which
    the diagonal of A is 1."""

    size: Floats
    """of these units"""
    slope: Floats
    matrix: Floats

    @classmethod
    def of(cls, slope: Floats, precision: Floats) -> Self:
        """From b and A."""
        size = np.sqrt(np.maximum(np.diag(precision), 1e-300))
        return cls(size, slope / size, precision / np.outer(size, size))

    def inverse(self, inner: Booleans | slice = slice(None)) -> Floats:
        """Pseudoinverse of A, of some parameters."""
        block = self.matrix[inner][:, inner]
        return np.asarray(np.linalg.pinv(block, rcond=NULL, hermitian=True), float)

    def alone(self, row: Any, inner: Booleans) -> Parabola:
        """A parameter with others integrated out."""
        gain = self.matrix[row, inner] @ self.inverse(inner)
        slope = float(self.slope[row] - gain @ self.slope[inner])
        stiffness = max(1 - float(gain @ self.matrix[inner, row]), _LEAST)
        return Parabola(slope, stiffness)


class Posterior(NamedTuple):
    """The log-posterior about the estimates of a fit to second order, under the priors
    of the module docstring, and in its coordinates."""

    estimates: Floats
    lower: Floats
    """bounds"""
    upper: Floats
    prior: NormalFactors
    information: Floats
    """of the data, as the gradient"""
    gradient: Floats
    at_bound: Booleans

    @classmethod
    def of(cls, result: FitResult) -> Self:
        """From a fit, whose own priors are among the prior."""
        free = result.parameter_set.free
        names = result.information.names
        # of the data alone: without what the priors of the fit say
        _, slope, square = result.parameter_set.penalty.quadratic(result.values)
        information = result.information.matrix - np.diag(square[free])
        gradient = result.information.gradient + slope[free]
        priors = [_prior(result, name) for name in names]
        sd = np.array([prior.sd for prior in priors])
        at_bound = [
            result.parameters[name].verdict == Verdict.AT_BOUND for name in names
        ]
        return cls(
            result.values[free],
            np.array([prior.lower for prior in priors]),
            np.array([prior.upper for prior in priors]),
            NormalFactors(np.array([prior.mean for prior in priors]), 1 / sd**2),
            information,
            gradient,
            np.array(at_bound),
        )

    @property
    def away(self) -> Floats:
        """From the estimates to the means of the prior."""
        return self.prior.mean - self.estimates

    @property
    def inward(self) -> Floats:
        """Sign of the direction in which each parameter leaves its bound; 0 away
        from bounds."""
        lower = self.estimates - self.lower < self.upper - self.estimates
        return np.where(self.at_bound, np.where(lower, 1.0, -1.0), 0.0)


class _BoundedNormal(NamedTuple):
    """A normal density between bounds; flat where its standard deviation is
    infinite."""

    mean: float
    sd: float
    lower: float
    upper: float


def _prior(result: FitResult, name: str) -> _BoundedNormal:
    """The prior of a parameter, as described in the module docstring."""
    parameter = result.parameters[name]
    lower = parameter.lower
    upper = parameter.upper
    prior = result.parameter_set.priors.get(name)
    if prior is None:
        for coefficient in result.law_class.coefficients():
            if coefficient.name == name:
                size = max(coefficient.typical, abs(coefficient.default))
                return _BoundedNormal(0.0, _ORDER * size, lower, upper)
        return _BoundedNormal(0.0, math.inf, lower, upper)  # of the initial state
    if prior.is_flat:
        return _BoundedNormal(0.0, math.inf, lower, upper)
    if not isinstance(prior, Lognormal):
        return _BoundedNormal(prior.mode, prior.width, lower, upper)
    estimate = parameter.value

    def logarithmic(p: float) -> float:
        """p in the coordinate q, in which the prior is normal."""
        return estimate * (1 + math.log(p / estimate)) if p > 0 else -math.inf

    return _BoundedNormal(
        logarithmic(prior.median),
        prior.sigma * estimate,
        logarithmic(lower),
        logarithmic(upper),
    )


def log_evidence(result: FitResult, log_likelihood: float) -> float:
    """Logarithm of the evidence, up to a constant that is the same for all laws, from
    the log-likelihood at the fit."""
    posterior = Posterior.of(result)
    mean = posterior.prior.mean
    precision = posterior.prior.precision
    away = posterior.away
    total = log_likelihood - 0.5 * float(away @ (precision * away))
    # priors that are flat between the bounds of a parameter
    for name, prior in result.parameter_set.priors.items():
        if prior.is_flat:
            parameter = result.parameters[name]
            total -= math.log(parameter.upper - parameter.lower)
    # normal priors, of which bounds cut off a part
    normal = precision > 0
    root = np.sqrt(precision[normal])
    lower = (posterior.lower - mean)[normal] * root
    upper = (posterior.upper - mean)[normal] * root
    log_density = np.log(root / np.sqrt(2 * np.pi)) - _log_between(lower, upper)
    total += float(log_density.sum())
    if result.ridge:
        along_ridge = _log_integral_along_ridge(result, posterior)
        if along_ridge is not None:
            return total + along_ridge
    return total + _log_integral(
        posterior.gradient + precision * away,
        posterior.information + np.diag(precision),
        posterior.lower - posterior.estimates,
        posterior.upper - posterior.estimates,
        posterior.at_bound,
    )


def _log_integral_along_ridge(result: FitResult, posterior: Posterior) -> float | None:
    """Logarithm of the integral of the posterior density over that at the estimates;
    None where the proposals do not follow the ridge, or a prior is lognormal."""
    priors = result.parameter_set.priors
    if any(prior.is_logarithmic for prior in priors.values()):
        return None
    random = np.random.default_rng(0)
    proposals = WeightedProposals.of(result, _PROPOSALS, random)
    # the priors of the fit are in its posterior, those of the evidence are not
    free = result.parameter_set.free
    names = result.parameter_set.names_where(free)
    precision = np.where(np.isin(names, [*priors]), 0.0, posterior.prior.precision)
    square = precision * (proposals.values[:, free] - posterior.prior.mean) ** 2
    at_estimates = precision * posterior.away**2
    log_prior = -0.5 * (square.sum(1) - at_estimates.sum())
    proposals = proposals._replace(log_ratio=proposals.log_ratio + log_prior)
    if proposals.effective < _FEWEST:
        return None
    return float(logsumexp(proposals.log_ratio) - math.log(_PROPOSALS))


def effective_parameters(result: FitResult) -> float:
    """Number of parameters away from their bounds that the data rather than the prior
    determine: the trace of J^T J (J^T J + P)^-1, P the precision of the prior."""
    posterior = Posterior.of(result)
    free = ~posterior.at_bound
    information = posterior.information[free][:, free]
    prior = np.diag(posterior.prior.precision[free])
    quadratic = Quadratic.of(posterior.gradient[free], information + prior)
    of_data = information / np.outer(quadratic.size, quadratic.size)
    return float(np.trace(quadratic.inverse() @ of_data))


def _log_between(low: Any, high: Any) -> Any:
    """Logarithm of the probability of an interval under the standard normal density."""
    # mirrored where above the mean: log_ndtr is exact in the lower tail alone
    low, high = np.where(low > 0, [-high, -low], [low, high])
    return log_ndtr(high) + np.log1p(-np.exp(log_ndtr(low) - log_ndtr(high)))


def _log_integral(
    linear: Floats, precision: Floats, lower: Floats, upper: Floats, pushed: Booleans
) -> float:
    """Logarithm of the integral of exp(b d - d A d/2) over a box of d, parameters
    minus estimates.

    b is `linear`, A `precision`.
    """
    quadratic = Quadratic.of(linear, precision)
    inner = ~pushed
    size = quadratic.size
    slope = quadratic.slope[inner]
    squares = np.linalg.eigvalsh(quadratic.matrix[inner][:, inner])
    squares = squares[squares > NULL * squares.max(initial=0.0)]
    inverse = quadratic.inverse(inner)
    mean = inverse @ slope
    total = 0.5 * float(slope @ mean + (np.log(2 * math.pi) - np.log(squares)).sum())
    total -= float(np.log(size[inner]).sum())
    total += _log_box(mean, inverse, (lower * size)[inner], (upper * size)[inner])
    # Each pushed parameter over its half-line, with the others following.
    for index in np.flatnonzero(pushed):
        push, stiffness = quadratic.alone(index, inner)
        half_line = float(log_ndtr(-abs(push) / math.sqrt(stiffness)))
        total += push**2 / (2 * stiffness) + half_line
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

    density = multivariate_normal(
        mean[near], covariance[np.ix_(near, near)], allow_singular=True, seed=1
    )
    probability = density.cdf(upper[near], lower_limit=lower[near])
    return math.log(max(float(probability), _LEAST))
