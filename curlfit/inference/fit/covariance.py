"""Covariance of the estimates of a fit, and how far chi squared is from quadratic within it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.residuals import ResidualStatistics
from curlfit.inference.identifiability import Bounded, Identifiability, analyse_many, grouped
from curlfit.inference.least_squares import Solution
from curlfit.inference.linearized_problem import LinearizedProblem
from curlfit.inference.noise.losses import precision, root_slope
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats

CONVERGED = 0.01
"""Distance to the optimum, in standard errors, at which a fit has converged."""
_CURVED = 0.003  # standard error over typical size below which chi squared is quadratic
_UNKNOWN = 3.0  # the same, above which nothing is determined in any case
_MISLEADING = 4.0  # factor by which the rise of chi squared is off if a standard error is by two
_SMALL = 0.1  # standard error over typical size, below which an estimate is determined even then
_QUADRATIC = 0.5  # largest departure from one of the rise of chi squared at one standard error
_KNOWN = 1e-3  # share of estimated variances in a sum below which the sum counts as known
_MEDIAN_EFFICIENCY = 0.37  # of sigma from the median absolute residual, Gaussian noise (Huber 1981)


class Covariance(NamedTuple):
    """First-order uncertainties of the parameters at the optimum of a throw."""

    values: Floats
    """in the data's coordinates"""
    identifiability: Identifiability
    at_bound: Booleans
    open: Booleans
    slack: Floats
    """contribution of those at a bound to the spread of the open ones (`LinearizedProblem.open`)"""
    distance: float
    """to the optimum, standard errors"""
    variance: Floats
    """contributions to the covariance from the noise of each channel and, last, from the priors,
    shape (channels + 1, open, open)"""
    dof: Floats
    """degrees of freedom of each channel's sigma; infinite where it was given and for the priors"""
    leverage: Floats
    """of each value on its own fitted value, 0 to 1, shape (channels, n)"""
    of_data: Identifiability
    """identifiability from the data without the priors"""

    def degrees_of_freedom(self, weights: Floats) -> float | None:
        """For the variance of a weighted sum of the open parameters; None where all sigmas were
        given."""
        return satterthwaite(np.einsum("i,cij,j->c", weights, self.variance, weights), self.dof)


def satterthwaite(parts: Floats, dof: Floats) -> float | None:
    """Degrees of freedom of a sum of estimated variances (Satterthwaite 1946, eq. 17); None where
    all are known, or those with finite `dof` contribute less than a thousandth, so that Student's
    distribution is normal to rounding of what is printed."""
    estimated = np.isfinite(dof)
    if not np.abs(parts[estimated]).sum() > _KNOWN * np.abs(parts).sum():
        return None
    return float(parts.sum()) ** 2 / float((parts**2 / dof).sum())


def noise_dof(number: Any, leverage: Floats, estimated: Booleans, loss: str) -> Floats:
    """Degrees of freedom n - p of the sigma of each channel; infinite where it was given.

    Parameters
    ----------
    number : of values, shape (..., channels). leverage : of each value, shape (..., channels, n);
        the sum over a channel is its p.
    """
    efficiency = 1.0 if loss == "linear" else _MEDIAN_EFFICIENCY
    dof = np.maximum(number - leverage.sum(-1), 1.0)
    return np.where(estimated, efficiency * dof, np.inf)


def bound_warning(name: str, lower: float, upper: float, known: Identifiability) -> str:
    """Warning about a parameter at a bound."""
    within = f"{lower:g}..{upper:g}"
    if name in known.names:
        return (
            f"{name} is at its bound; the data hardly distinguish this value from others within "
            f"{within}"
        )
    return f"{name} is at its bound; the data favour values outside {within}"


def covariances(
    sets: Sequence[ParameterSet],
    values: Floats,
    problems: Sequence[Problem],
    solutions: Sequence[Solution],
    statistics: ResidualStatistics,
    estimated: Booleans,
    loss: str,
    penalty: Penalty | None = None,
) -> list[Covariance]:
    """Covariances of many throws of one law; equal sets of open parameters are treated together.

    Parameters
    ----------
    sets, values : in the data's coordinates. estimated : channels whose sigma was not given.
    penalty : of the priors, in the problems' coordinates.
    """
    linearized = LinearizedProblem(
        statistics.r_factor[..., -1], statistics.r_factor[..., :-1], values,
        *(np.stack([getattr(item, name) for item in sets])
          for name in ("lower", "upper", "typical", "free")),
    )  # fmt: skip
    at_bound = linearized.at_bound()
    whole = linearized._replace(jacobian=statistics.unconfined[..., :-1])
    distance = linearized.distance(statistics.number.sum(-1), whole)
    open_and_slack = [
        LinearizedProblem(*one).open(stuck)
        for one, stuck in zip(zip(*linearized, strict=True), at_bound, strict=True)
    ]
    found: dict[int, Covariance] = {}
    keys = ((stuck, open_) for stuck, (open_, _) in zip(at_bound, open_and_slack, strict=True))
    for throws in grouped(keys):
        first, (open_, _) = sets[throws[0]], open_and_slack[throws[0]]
        jacobians = np.stack(
            [
                statistics.of_data[throw, :, :-1] if loss == "linear"
                else robust_jacobian(
                    problems[throw], solutions[throw], statistics.residual[throw], loss
                ).reshape(-1, len(first.names))
                for throw in throws
            ]
        )  # fmt: skip
        slack = np.stack([open_and_slack[throw][1] for throw in throws])
        ends = (np.stack([getattr(sets[k], name) for k in throws]) for name in ("lower", "upper"))
        bounded = Bounded(*(part[:, open_] for part in (values[throws], *ends)))
        about = first.names_where(open_), bounded.values, first.typical[open_], slack, bounded
        known = of_data = analyse_many(jacobians[..., open_], *about)
        if penalty is not None:
            slopes = penalty.residual_and_slope(np.stack([one.values for one in solutions]))[1]
            rows = slopes[throws][..., None] * np.eye(slopes.shape[-1])
            known = analyse_many(np.concatenate([jacobians, rows], 1)[..., open_], *about)
        by_channel = np.stack([solutions[throw].jacobian[..., open_] for throw in throws])
        matrix = np.stack([item.covariance for item in known])[:, None]
        matrix = matrix - (slack @ slack.mT)[:, None]
        part = matrix @ (by_channel.mT @ by_channel)
        leverage = ((by_channel @ matrix) * by_channel).sum(-1)
        dof = noise_dof(statistics.number[throws], leverage, estimated[throws], loss)
        dof = np.concatenate([dof, np.full((len(dof), 1), np.inf)], -1)
        variance = part @ matrix
        of_priors = matrix - variance.sum(1, keepdims=True) if penalty is not None else 0 * matrix
        variance = np.concatenate([variance, of_priors], 1)
        for row, throw in enumerate(throws):
            found[throw] = Covariance(
                values=values[throw],
                identifiability=known[row],
                at_bound=at_bound[throw],
                open=open_,
                slack=slack[row],
                distance=float(distance[throw]),
                variance=variance[row],
                dof=dof[row],
                leverage=leverage[row],
                of_data=of_data[row],
            )
    return [found[throw] for throw in range(len(sets))]


def robust_jacobian(problem: Problem, solution: Solution, residual: Floats, loss: str) -> Floats:
    """Jacobian of the residuals over their sigma, each channel rescaled for a robust loss, shape
    (channels, n, parameters).

    The covariance of an M-estimator is that of least squares divided by `precision` (Huber 1981).
    """
    jacobian: Floats = solution.jacobian.copy()
    for row, weight in enumerate(problem.weight):
        r = -residual[row] * weight
        jacobian[row] /= root_slope(r, loss)[:, None]
        jacobian[row] *= np.sqrt(precision(r[weight > 0], loss))
    return jacobian


class OneSigmaPoints(NamedTuple):
    """Points one standard error from the optimum along the principal axes of the covariances."""

    owner: NDArray[np.intp]
    """index of the throw, shape (points,)"""
    point: Floats
    """shape (points, parameters)"""
    axis: Floats
    """in typical sizes, of the same shape; 0 for parameters that are not open"""


def one_sigma_points(
    found: Sequence[Covariance], values: Floats, lower: Floats, upper: Floats, typical: Floats
) -> OneSigmaPoints:
    """The points within bounds on axes whose standard error is neither tiny nor meaningless.

    Parameters
    ----------
    values, lower, upper : of each throw, in the problems' coordinates. typical : of all.
    """
    parts = []
    for throws in grouped((one.open,) for one in found):
        open_ = np.flatnonzero(found[throws[0]].open)
        # Covariance of the open parameters alone: those at a bound stay there.
        covariance = np.stack(
            [found[k].identifiability.covariance - found[k].slack @ found[k].slack.T
             for k in throws]
        )  # fmt: skip
        squares, axes = np.linalg.eigh(covariance / np.outer(typical[open_], typical[open_]))
        some = (squares > _CURVED**2) & (squares < _UNKNOWN**2)
        along = np.zeros((*squares.shape, 2, len(typical)))
        along[..., open_] = axes.mT[:, :, None]
        size = np.sqrt(np.where(some, squares, 0.0))[..., None, None] * [[1.0], [-1.0]]
        points = values[throws][:, None, None] + size * along * typical
        low, high = lower[throws][:, None, None], upper[throws][:, None, None]
        inside = some[..., None] & ((points >= low) & (points <= high)).all(-1)
        owner = np.array(throws)[np.nonzero(inside)[0]]
        parts.append(OneSigmaPoints(owner, points[inside], along[inside]))
    return OneSigmaPoints(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def nonquadratic_estimates(
    found: Sequence[Covariance], around: OneSigmaPoints, delta_chi2: Floats, typical: Floats
) -> list[dict[str, bool]]:
    """Parameters and combinations along which chi squared does not rise by about one at one
    standard error, and whether it is so misleading there that nothing may be determined.

    An axis concerns an estimate if it contributes a quarter or more of its variance. A large
    departure is misleading for the parameters that dominate the axis, and for estimates whose
    standard error is not small.
    """
    off = ~(np.abs(delta_chi2 - 1) < _QUADRATIC)
    rise = np.maximum(np.nan_to_num(delta_chi2, nan=np.inf), 1e-300)
    factor = np.maximum(rise, 1 / rise)
    named: list[dict[str, bool]] = [{} for _ in found]
    for owner in np.unique(around.owner[off]):
        mine = off & (around.owner == owner)
        known, sizes = found[owner].identifiability, typical[found[owner].open]
        axes = around.axis[mine][:, found[owner].open]
        longest = np.abs(axes).max(1)
        for name, row in known.determined().items():
            error = np.sqrt(row @ known.covariance @ row)
            concerned = np.abs(axes @ (row * sizes)) > 0.5 * error
            if not concerned.any():
                continue
            most = float(factor[mine][concerned].max())
            dominant = (np.abs(axes @ row)[concerned] > 0.3 * longest[concerned]).any()
            large = error > _SMALL * sizes[row != 0].max()
            named[owner][name] = bool(most > _MISLEADING and (dominant or large))
    return named
