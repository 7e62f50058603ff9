"""How well a law predicts rows that it was not fitted to: leave-one-out
cross-validation.

The expected log pointwise predictive density, elpd_loo = sum_i log p(y_i | y_-i), its
standard error and the effective number of parameters p_loo = sum_i [log p(y_i | y) -
log p(y_i | y_-i)] are those of Vehtari, Gelman and Gabry (2017, Statistics and
Computing 27, 1413), eqs. 4, 23 and 24. A point i is a row, with all channels that were
measured in it. Priors are those of the evidence.

If the path is linear in the parameters within their errors, no row has to be left out
explicitly. For residuals e in units of their sigma and the hat matrix H of all rows,

    e_-i = (I - H_ii)^-1 e_i,    cov(e_-i) = (I - H_ii)^-1

are the residual of a row from the fit to all others and its covariance (Cook and
Weisberg 1982, sect. 2.2). Where sigma is estimated, the density is Student's t with
n_c - p_c - 1 degrees of freedom in channel c, p_c being the sum of the leverages of its
values, and sigma is estimated without the row. The bound that a parameter is pushed
against is replaced by a normal factor that gives its density the same mean and variance
(expectation propagation: Minka 2001).

If residuals are correlated from row to row, a row is predicted from its neighbours,
whatever the law; a robust loss has no closed form; and a row that alone determines a
parameter is not predicted by the others at all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln, log_ndtr

from curlfit.comparison.criteria import NULL, NormalFactors, Posterior, Quadratic
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.likelihood import SIGMA_FLOOR, predict_channels
from curlfit.losses import LOSSES
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.differences import slopes
from curlfit.throws.channels import CHANNELS

_STEP = 0.1
"""Step of differences, in standard errors of a parameter with all others known."""
_HARD = 50.0
"""Standard deviations by which a parameter is pushed against its bound, beyond which
its density is exponential."""
_ALONE = 1e-9
"""1 - leverage of a row, below which it alone determines a parameter."""


class LeaveOneOut(NamedTuple):
    """Log predictive densities by row, in SI units."""

    left_out: Floats
    """log p(y_i | y_-i), shape (rows,)"""
    fitted: Floats
    """log p(y_i | y), of the same shape"""

    @property
    def elpd(self) -> float:
        """Expected log pointwise predictive density."""
        return float(self.left_out.sum())

    @property
    def p_loo(self) -> float:
        """Effective number of parameters."""
        return float((self.fitted - self.left_out).sum())

    @property
    def stderr(self) -> float:
        """Standard error of `elpd`."""
        return standard_error(self.left_out)


def standard_error(pointwise: Floats) -> float:
    """Standard error of a sum over rows, from their scatter; 0 for a single row."""
    n = len(pointwise)
    return float(np.sqrt(n * pointwise.var(ddof=1))) if n > 1 else 0.0


def leave_one_out(
    result: FitResult, family: type[LawFamily] | None = None
) -> LeaveOneOut | None:
    """Cross-validation of a fit, by the program of a family of laws; None under a
    robust loss or correlated noise, where a row alone determines a parameter, and where
    the law admits no motion near the fit."""
    if LOSSES[result.loss].is_robust or not result.noise.is_white:
        return None
    posterior = Posterior.of(result)
    parameters = result.parameter_set
    free = parameters.free
    problem = problem_of(result)
    channels = problem.observed.shape[0]
    n = len(result.observed["t"])  # the rows of a problem are filled up to more
    weight = problem.weight[:, :n]
    measured = weight > 0
    model = result.model.within(family)
    # of a parameter with all others known: one over its standard error
    precision_alone = np.sqrt(np.diag(result.information.matrix))
    step = _STEP * parameters.typical
    step[free] = _STEP / np.maximum(precision_alone, 1 / parameters.typical[free])

    def weighted_path(values: Floats) -> Floats:
        path = predict_channels(model, values, problem)[:channels, :n]
        return np.where(measured, path * weight, 0.0)

    residual = problem.observed[:, :n] * weight - weighted_path(result.values)
    jacobian = slopes(
        weighted_path,
        result.values,
        step,
        free,
        lower=parameters.lower,
        upper=parameters.upper,
    )
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        return None
    precision = posterior.prior.precision
    away = posterior.away
    design = jacobian.reshape(-1, len(away))
    bounds = _bound_factors(
        design.T @ design + np.diag(precision),
        design.T @ residual.ravel() + precision * away,
        posterior.inward,
    )
    # a row of the design for each parameter's prior, and one for its bound
    root = np.sqrt(np.stack([precision, bounds.precision]))
    prior_rows = (root[..., None] * np.eye(len(away))).reshape(-1, len(away))
    prior_residual = (root * np.stack([away, bounds.mean])).ravel()
    return densities(
        residual,
        jacobian,
        weight,
        prior_rows,
        prior_residual,
        np.array([name in result.sigma for name in CHANNELS[:channels]]),
    )


def _bound_factors(
    precision: Floats, gradient: Floats, inward: Floats
) -> NormalFactors:
    """Normal factors, about the estimates, that replace the bounds of
    parameters at a bound.

    With all others integrated out, the density of the distance d from the bound is
    proportional to exp(-push d - s d^2/2), d > 0: with a = push/sqrt(s) and l =
    phi(a)/Phi(-a), its mean is (l - a)/sqrt(s) and its variance (1 - l (l - a))/s.

    Parameters
    ----------
    precision, gradient : of the log-posterior, by the parameters.
    inward : see `Posterior.inward`.
    """
    factors = NormalFactors(np.zeros(len(inward)), np.zeros(len(inward)))
    quadratic = Quadratic.of(gradient, precision)
    for row in np.flatnonzero(inward):
        slope, stiffness = quadratic.alone(row, inward == 0)
        push = max(-inward[row] * slope, 0.0)
        a = push / np.sqrt(stiffness)
        if a > _HARD:  # an exponential density, without the rounding error of ratio - a
            mean = 1 / push
            variance = 1 / push**2
        else:
            ratio = np.exp(_log_normal(a) - log_ndtr(-a))
            mean = (ratio - a) / np.sqrt(stiffness)
            variance = (1 - ratio * (ratio - a)) / stiffness
        extra = 1 / variance - stiffness
        size = quadratic.size[row]
        factors.precision[row] = extra * size**2
        factors.mean[row] = inward[row] * (mean / variance + push) / extra / size
    return factors


# Not from `scipy.stats`, which is slow to load.
def _log_normal(u: Any) -> Any:
    """Log density of the standard normal distribution."""
    return -(u**2) / 2 - np.log(2 * np.pi) / 2


def _log_student(u: Floats, dof: Floats) -> Floats:
    """Log density of Student's t distribution."""
    norm = gammaln((dof + 1) / 2) - gammaln(dof / 2) - np.log(np.pi * dof) / 2
    density: Floats = norm - (dof + 1) / 2 * np.log1p(u**2 / dof)
    return density


def densities(
    residual: Floats,
    jacobian: Floats,
    weight: Floats,
    prior_rows: Floats,
    prior_residual: Floats,
    estimated: Booleans,
) -> LeaveOneOut | None:
    """Log predictive densities in a linear model; None where a row alone determines
    a parameter.

    Parameters
    ----------
    residual, jacobian : measured - fitted over sigma, and the derivative of fitted over
        sigma by the parameters; shapes (channels, n) and (channels, n, parameters), 0
        where not observed.
    weight : 1/sigma, 0 where not observed, shape (channels, n).
    prior_rows, prior_residual : likewise of the prior, shapes (rows, parameters)
        and (rows,).
    estimated : channels whose sigma is estimated.
    """
    channels, n, count = jacobian.shape
    measured = weight > 0
    # The rows of all channels, then those of the prior, in orthonormal columns: J^T J
    # without a row is then 1 - Q_i^T Q_i.
    design = np.concatenate([jacobian.reshape(-1, count), prior_rows])
    size = np.sqrt((design**2).sum(0))
    left, singular, _ = np.linalg.svd(
        design / np.where(size > 0, size, 1.0), full_matrices=False
    )
    basis = left[:, singular > NULL * singular.max(initial=0.0)]
    target = np.concatenate([residual.ravel(), prior_residual])
    refitted = target - basis @ (basis.T @ target)
    # subscripts of einsum: c, d channels, i rows, k, l columns of the basis
    e = refitted[: channels * n].reshape(channels, n)
    q = basis[: channels * n].reshape(channels, n, -1)
    hat = np.einsum("cik,dik->icd", q, q)
    left_over = np.eye(channels) - hat
    if np.linalg.eigvalsh(left_over).min() < _ALONE:
        return None
    covariance = np.linalg.inv(left_over)
    e_out = np.einsum("icd,di->ci", covariance, e)
    # Without row i the parameters change by -Q_i^T e_-i, and the sums of
    # squares accordingly.
    change = np.einsum("cik,ci->ik", q, e_out)
    gradient = np.einsum("cik,ci->ck", q, e)
    information = np.einsum("cik,cil->ckl", q, q)
    squares = (e**2).sum(1)
    squares_out = squares[:, None] + 2 * gradient @ change.T - e_out**2
    squares_out += np.einsum("ik,ckl,il->ci", change, information, change)
    dof = measured.sum(1) - np.einsum("icc->c", hat)
    # least variance of the noise of a channel, over that of its weights
    floor = (SIGMA_FLOOR * weight.max(1, initial=0.0)) ** 2

    def log_density(
        residual: Floats, covariance: Floats, squares: Floats, dof: Floats
    ) -> Floats:
        """Log density of each row that has values, in SI units.

        Parameters
        ----------
        residual : shape (channels, n).
        covariance : of the residuals of a row, shape (n, channels, channels).
        squares, dof : by which sigma is estimated, by row and channel.
        """
        dof = np.maximum(dof, 1.0)
        scale = np.sqrt(np.where(estimated, np.maximum(squares / dof, floor), 1.0))
        lower = np.linalg.cholesky(covariance)
        u = np.linalg.solve(lower, residual.T[..., None])[..., 0] / scale
        by_channel = np.where(estimated, _log_student(u, dof), _log_normal(u))
        by_channel -= np.log(scale * np.diagonal(lower, axis1=1, axis2=2))
        by_channel += np.log(np.where(measured, weight, 1.0)).T
        return np.where(measured.T, by_channel, 0.0).sum(1)[measured.any(0)]

    return LeaveOneOut(
        left_out=log_density(e_out, covariance, squares_out.T, dof - 1),
        fitted=log_density(e, np.eye(channels) + hat, squares, dof),
    )
