"""Covariance of the estimates of a fit, and how far chi squared is from quadratic within it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.systematics import shifts
from curlfit.inference.identifiability import (
    Bounded,
    Combination,
    Identifiability,
    analyse_many,
    classify,
    confined,
    grouped,
    r_factor,
    slack,
    visible,
)
from curlfit.inference.least_squares import Solution
from curlfit.inference.noise.losses import precision, root_slope
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats

_LOOSE = 0.1  # typical sizes inside its bound from which a parameter is not held by it
_NEAR = 1e-6  # typical sizes from a bound within which a parameter is at the bound
_PUSHED = 10.0  # least push against a bound over the slopes by the parameters inside theirs ...
_LEAST_PUSH, _CLEAR_PUSH = 1e-6, 1e-3  # ... within these limits, half chi squared per typical size


class LinearizedProblem(NamedTuple):
    """The problem of one throw or of several, linearized at its optimum.

    Or many such problems, along the first axis of each field.
    """

    residual: Floats
    """over its sigma, shape (rows,)"""
    jacobian: Floats
    """shape (rows, parameters)"""
    values: Floats
    lower: Floats
    upper: Floats
    typical: Floats
    free: Booleans

    def at_bound(self) -> Booleans:
        """Free parameters at a bound that the data push against it, however weakly.

        Along a valley that descends without end the push may be tiny. It is distinguished from the
        end of an exact ridge, where there is none, by the remaining slope along the other
        parameters.
        """
        push, low, high = self._pushes()
        rest = np.abs(push * (self.free & ~low & ~high)).max(-1, keepdims=True)
        least = np.clip(_PUSHED * rest, _LEAST_PUSH, _CLEAR_PUSH)
        return low & (push > least) | high & (push < -least)

    def movable(self) -> Booleans:
        """Free parameters except those that only a bound keeps from moving, however weakly."""
        push, low, high = self._pushes()
        return self.free & ~(low & (push > 0)) & ~(high & (push < 0))

    def _pushes(self) -> tuple[Floats, Booleans, Booleans]:
        """The push toward lower bounds, and which parameters are at a lower, at an upper bound."""
        near = _NEAR * self.typical
        return (
            (self.residual[..., None, :] @ self.jacobian)[..., 0, :] * self.typical,
            self.free & (self.values <= self.lower + near),
            self.free & (self.values >= self.upper - near),
        )

    def open(self, at_bound: Booleans) -> tuple[Booleans, Floats]:
        """The parameters of one optimum that can move, and the contribution of those held at a
        bound to their spread.

        A parameter that the data hardly push against its bound is not held by it: it is at the
        end of a ridge and counts as open.
        """
        if not at_bound.any():
            return self.free, np.zeros((int(self.free.sum()), 0))
        push = np.abs(self.residual @ self.jacobian)
        room = self.upper - self.lower
        held = at_bound.copy()
        for _ in range(2):
            open_ = self.free & ~held
            found = slack(
                self.jacobian[:, open_], self.jacobian[:, held], push[held], self.typical[held],
                room[held],
            )  # fmt: skip
            loose = found.distance > _LOOSE * self.typical[held]
            if not loose.any():
                break
            held[held] = ~loose
        return open_, found.columns

    def newton_decrement(self, where: Booleans) -> Floats:
        """Length of the remaining Gauss-Newton step, in sigmas, along determined directions.

        A null direction would have to be followed over a thousand typical sizes.
        """
        jacobian = self.jacobian * (self.typical * where)[..., None, :]
        left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
        along = (self.residual[..., None, :] @ left)[..., 0, :]
        return np.linalg.norm(along * visible(singular), axis=-1)

    def distance(self, count: Any, whole: LinearizedProblem) -> Any:
        """Distance to the optimum in standard errors, over the noise where `count` values scatter
        by more than their sigma.

        `whole` is the problem with the directions that only the bounds determine. A step along them
        would leave the bounds; without them, parameters at a bound may seem free to move. Both are
        upper limits.
        """
        reduced = (self.residual**2).sum(-1) / np.maximum(count, 1)
        steps = (one.newton_decrement(one.movable()) for one in (self, whole))
        return np.minimum(*steps) / np.sqrt(np.maximum(reduced, 1.0))


CONVERGED = 0.01
"""Distance to the optimum, in standard errors, at which a fit has converged."""
_CURVED = 0.003  # standard error over typical size below which chi squared is quadratic
_UNKNOWN = 3.0  # the same, above which nothing is determined in any case
_MISLEADING = 4.0  # factor by which the rise of chi squared is off if a standard error is by two
_SMALL = 0.1  # standard error over typical size, below which an estimate is determined even then
_QUADRATIC = 0.5  # largest departure from one of the rise of chi squared at one standard error
_KNOWN = 1e-3  # share of estimated variances in a sum below which the sum counts as known
_MEDIAN_EFFICIENCY = 0.37  # of sigma from the median absolute residual, Gaussian noise (Huber 1981)


class Factors(NamedTuple):
    """R factors of the Jacobians of problems, along the first axis; the last column is the residual
    over its sigma."""

    of_data: Floats
    whole: Floats
    """with the priors"""
    confined: Floats
    """with the priors, without the directions that only the bounds determine (`confined`)"""

    @classmethod
    def of(
        cls, of_data: Floats, bounded: Bounded, typical: Floats, penalty: Penalty | None
    ) -> Factors:
        """From those of the data alone, the parameters with their bounds, and the priors."""
        whole = of_data
        if penalty is not None:
            prior, slope = penalty.residual_and_slope(bounded.values)
            rows = [slope[..., None] * np.eye(slope.shape[-1]), prior[..., None]]
            whole = r_factor(np.concatenate([of_data, np.concatenate(rows, -1)], 1))
        inside = confined(whole[..., :-1], bounded, typical)
        return cls(of_data, whole, np.concatenate([inside, whole[..., -1:]], -1))


class Covariance(NamedTuple):
    """First-order uncertainties of the parameters at the optimum of a throw, or of several with
    parameters in common."""

    names: Sequence[str]
    values: Floats
    """in the data's coordinates"""
    typical: Floats
    factor: Floats
    """R factor of the Jacobian, with the residual as the last column (`Factors.confined`)"""
    identifiability: Identifiability
    of_data: Identifiability
    """identifiability from the data without the priors"""
    at_bound: Booleans
    open: Booleans
    matrix: Floats
    """covariance of the open parameters while those at a bound stay there"""
    distance: float
    """to the optimum, standard errors"""
    effect: Floats
    """change of the open parameters for a change of each residual by its sigma, shape (channels, n,
    open)"""
    dof: Floats
    """degrees of freedom of each channel's sigma; infinite where it was given"""
    leverage: Floats
    """of each value on its own fitted value, 0 to 1, shape (channels, n)"""
    has_priors: bool = False

    def degrees_of_freedom(self, weights: Floats) -> float | None:
        """For the variance of a weighted sum of the open parameters; None where all sigmas were
        given."""
        parts = ((self.effect @ weights) ** 2).sum(-1)
        of_priors = weights @ self.matrix @ weights - parts.sum() if self.has_priors else 0.0
        return satterthwaite(np.append(parts, of_priors), np.append(self.dof, np.inf))

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """What is determined in place of single parameters."""
        weights = self.identifiability.determined()
        return tuple(
            replace(item, dof=self.degrees_of_freedom(weights[item.expression]))
            for item in self.identifiability.combinations
        )

    def classified(self, place: int) -> tuple[float | None, str, float | None]:
        """Standard error of a free parameter, where there is one, its verdict, and the degrees of
        freedom of the error."""
        index, about = int(self.open[:place].sum()), (self.typical[place], self.at_bound[place])
        stderr, verdict = classify(*about, self.identifiability, index)
        if stderr is None:
            return None, verdict, None
        if verdict == "determined" and classify(*about, self.of_data, index)[1] != verdict:
            verdict = "prior"
        return stderr, verdict, self.degrees_of_freedom(np.eye(len(self.matrix))[index])

    def shifts(self, gradients: Mapping[str, Floats]) -> dict[str, dict[str, float]]:
        """Shifts from the estimates to the true values, by determined parameter or combination and
        by condition; `gradients` are J^T times the change of the residuals by each condition."""
        typical = self.typical[self.open]
        mine = {name: gradient[self.open] for name, gradient in gradients.items()}
        by_condition = shifts(self.factor[:, :-1][:, self.open], mine, typical)
        return {
            name: {condition: float(row @ shift) for condition, shift in by_condition.items()}
            for name, row in self.identifiability.determined().items()
        }

    def bound_warnings(self, lower: Floats, upper: Floats) -> list[str]:
        """Warnings about parameters at a bound."""
        warnings = []
        for name, low, high in itertools.compress(
            zip(self.names, lower, upper, strict=True), self.at_bound
        ):
            within = f"{low:g}..{high:g}"
            what = f"favour values outside {within}"
            if name in self.identifiability.names:
                what = f"hardly distinguish this value from others within {within}"
            warnings.append(f"{name} is at its bound; the data {what}")
        return warnings


def satterthwaite(parts: Floats, dof: Floats) -> float | None:
    """Degrees of freedom of a sum of estimated variances (Satterthwaite 1946, eq. 17); None where
    all are known, or those with finite `dof` contribute less than a thousandth, so that Student's
    distribution is normal to rounding of what is printed."""
    estimated = np.isfinite(dof)
    if not np.abs(parts[estimated]).sum() > _KNOWN * np.abs(parts).sum():
        return None
    return float(parts.sum()) ** 2 / float((parts**2 / dof).sum())


class Sigmas(NamedTuple):
    """How the sigmas of the channels of problems are known, shape (problems, channels)."""

    number: NDArray[np.int64]
    """of values"""
    estimated: Booleans
    loss: str

    def dof(self, leverage: Floats) -> Floats:
        """Degrees of freedom n - p of each sigma; infinite where it was given. The sum of the
        `leverage` of each value, shape (..., n), over a channel is its p."""
        efficiency = 1.0 if self.loss == "linear" else _MEDIAN_EFFICIENCY
        dof = np.maximum(self.number - leverage.sum(-1), 1.0)
        return np.where(self.estimated, efficiency * dof, np.inf)


def covariances(
    names: Sequence[str],
    bounded: Bounded,
    typical: Floats,
    free: Booleans,
    factors: Factors,
    estimator: Factors,
    jacobians: Floats,
    sigmas: Sigmas,
) -> list[Covariance]:
    """Covariances at optima of problems with the same parameters; equal sets of open ones are
    treated together.

    Parameters
    ----------
    bounded : of problems, along the first axis, as of `free`; in the data's coordinates.
    estimator : those whose normal equations are the estimator's, which under a robust loss are not
        those of the search.
    jacobians : of the weighted residuals, shape (problems, channels, n, parameters).
    """
    problems = LinearizedProblem(
        factors.confined[..., -1], factors.confined[..., :-1], bounded.values, bounded.lower,
        bounded.upper, np.tile(typical, (len(free), 1)), free,
    )  # fmt: skip
    at_bound = problems.at_bound()
    has_priors = estimator.whole is not estimator.of_data
    whole = problems._replace(jacobian=factors.whole[..., :-1])
    distance = problems.distance(sigmas.number.sum(-1), whole)
    open_and_slack = [
        LinearizedProblem(*one).open(stuck)
        for one, stuck in zip(zip(*problems, strict=True), at_bound, strict=True)
    ]
    found: dict[int, Covariance] = {}
    keys = ((stuck, open_) for stuck, (open_, _) in zip(at_bound, open_and_slack, strict=True))
    for some in grouped(keys):
        open_ = open_and_slack[some[0]][0]
        slack = np.stack([open_and_slack[row][1] for row in some])
        ends = Bounded(*(part[some][:, open_] for part in bounded))
        about = list(itertools.compress(names, open_)), ends.values, typical[open_], slack
        known = of_data = analyse_many(estimator.whole[some, :, :-1][..., open_], *about, ends)
        if has_priors:
            of_data = analyse_many(estimator.of_data[some, :, :-1][..., open_], *about, ends)
        matrix = np.stack([item.covariance for item in known]) - slack @ slack.mT
        by_channel = jacobians[some][..., open_]
        effect = by_channel @ matrix[:, None]
        leverage = (effect * by_channel).sum(-1)
        dof = Sigmas(sigmas.number[some], sigmas.estimated[some], sigmas.loss).dof(leverage)
        for row, place in enumerate(some):
            found[place] = Covariance(
                names, bounded.values[place], typical, factors.confined[place], known[row],
                of_data[row], at_bound[place], open_, matrix[row], float(distance[place]),
                effect[row], dof[row], leverage[row], has_priors,
            )  # fmt: skip
    return [found[place] for place in range(len(at_bound))]


def robust_jacobians(problems: Problem, solutions: Solution, residual: Floats, loss: str) -> Floats:
    """Jacobians of throws, of shape (throws, channels, n, parameters), whose normal equations are
    those of the estimator: those of the residuals over their sigma, each channel rescaled for a
    robust loss.

    The covariance of an M-estimator is that of least squares divided by `precision` (Huber 1981).
    `residual` is measured - fitted.
    """
    if loss == "linear":
        return solutions.jacobian
    jacobians: Floats = solutions.jacobian.copy()
    for place in np.ndindex(jacobians.shape[:2]):
        weight = problems.weight[place]
        r = -residual[place] * weight
        jacobians[place] *= np.sqrt(precision(r[weight > 0], loss)) / root_slope(r, loss)[:, None]
    return jacobians


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
        covariance = np.stack([found[k].matrix for k in throws])
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
