"""Covariance of the estimates of a fit, and how far chi squared is from quadratic within it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.systematics import shifts
from curlfit.inference.identifiability import (
    Bounded,
    Combination,
    Identifiability,
    analyse,
    classify,
    confined,
    inverted,
    r_factor,
    slack,
    visible,
)
from curlfit.inference.least_squares import Indices, Solution
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
            distance, columns = slack(
                self.jacobian[:, open_], self.jacobian[:, held], push[held], self.typical[held],
                room[held],
            )  # fmt: skip
            loose = distance > _LOOSE * self.typical[held]
            if not loose.any():
                break
            held[held] = ~loose
        return open_, columns

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
        decrement = self.newton_decrement(self.movable())
        if not np.array_equal(self.jacobian, whole.jacobian):
            decrement = np.minimum(decrement, whole.newton_decrement(whole.movable()))
        return decrement / np.sqrt(np.maximum(reduced, 1.0))


CONVERGED = 0.01
"""Distance to the optimum, in standard errors, at which a fit has converged."""
_CURVED = 0.003  # standard error over typical size below which chi squared is quadratic
_UNKNOWN = 3.0  # the same, above which nothing is determined in any case
_MISLEADING = 4.0  # factor by which the rise of chi squared is off if a standard error is by two
_SMALL = 0.1  # standard error over typical size, below which an estimate is determined even then
_QUADRATIC = 0.5  # largest departure from one of the rise of chi squared at one standard error
_KNOWN = 1e-3  # share of estimated variances in a sum below which the sum counts as known
_MEDIAN_EFFICIENCY = 0.37  # of sigma from the median absolute residual, Gaussian noise (Huber 1981)


class Reduction(NamedTuple):
    """What throws say about the parameters that they have in common, where the own parameters of
    each follow these; all along the first axis."""

    others: Floats
    """R factor of all other throws, whose last column is the residual: rows to be added to those of
    a throw, with zeros for its own parameters"""
    follow: Floats
    """change of the parameters of a throw, first axis, with those in common, second axis"""
    rank: Floats
    """number of directions of its own parameters that a throw determines"""
    common: Booleans

    @classmethod
    def of(cls, factors: Floats, bounded: Bounded, typical: Floats, common: Booleans) -> Reduction:
        """From R factors of the Jacobians with the residuals as the last column."""
        free = (bounded.upper > bounded.lower) & ~common
        problem = LinearizedProblem(factors[..., -1], factors[..., :-1], *bounded, typical, free)
        scaled = factors[..., :-1] * typical
        own = scaled * (free & ~problem.at_bound())[:, None]
        left, singular, right = np.linalg.svd(own, full_matrices=False)
        seen = visible(singular)
        left = left * seen[:, None]
        rest = factors - left @ (left.mT @ factors)
        rest[..., :-1] *= common
        inverse = right.mT * inverted(singular, seen)[:, None] @ left.mT
        follow = np.diag(1.0 * common) - (inverse @ scaled) * common
        follow = follow * typical[:, None] / typical
        return cls(_of_others(rest), follow, seen.sum(-1), common)

    def gradient(self, gradients: Floats) -> Floats:
        """That of all throws by the parameters of each, from the gradients of each throw."""
        reduced = (self.follow.mT @ gradients[..., None])[..., 0]
        return gradients + self.common * (reduced.sum(0) - reduced)

    def chi_squared_change(self, throws: Indices, steps: Floats) -> Floats:
        """Change of chi squared of the others of some throws, whose parameters take steps."""
        rows = self.others[throws]
        change = (rows[..., :-1] @ steps[..., None])[..., 0]
        found: Floats = (change * (change + 2 * rows[..., -1])).sum(-1)
        return found


def _stacked(*factors: Floats) -> Floats:
    """R factor of the rows of several."""
    return r_factor(np.concatenate(factors, -2))


def _of_others(rows: Floats) -> Floats:
    """R factor of the rows of all throws but each, from those before it and those after it."""

    def before(rows: Floats) -> list[Floats]:
        found = [np.zeros((rows.shape[-1],) * 2)]
        for one in rows[:-1]:
            found.append(_stacked(found[-1], one))
        return found

    return _stacked(np.stack(before(rows)), np.stack(before(rows[::-1])[::-1]))


class Factors(NamedTuple):
    """R factors of the Jacobian of a problem, or of many along the first axis; the last column is
    the residual over its sigma."""

    of_data: Floats
    whole: Floats
    """with the priors"""
    confined: Floats
    """with the priors, without the directions that only the bounds determine (`confined`)"""
    reduction: Reduction | None = None
    """of throws that are fitted together, whose others are contained in all of these"""

    @classmethod
    def of(
        cls,
        of_data: Floats,
        bounded: Bounded,
        typical: Floats,
        penalty: Penalty | None,
        common: Booleans | None = None,
    ) -> Factors:
        """From those of the data alone, the parameters with their bounds, the priors, and which
        parameters the throws have in common, if they are fitted together."""
        whole, reduction = of_data, None
        if penalty is not None:
            prior, slope = penalty.residual_and_slope(bounded.values)
            diagonal = slope[..., None] * np.eye(slope.shape[-1])
            priors = np.concatenate([diagonal, prior[..., None]], -1)
        if common is not None:
            about = bounded, typical, common
            # Priors of what is in common count once.
            alone = of_data if penalty is None else _stacked(of_data, priors * ~common[:, None])
            reduction = Reduction.of(alone, *about)
            whole = _stacked(of_data, reduction.others)
            others = reduction if penalty is None else Reduction.of(of_data, *about)
            of_data = whole if penalty is None else _stacked(of_data, others.others)
        if penalty is not None:
            whole = _stacked(whole, priors)
        inside = confined(whole[..., :-1], bounded, typical)
        return cls(of_data, whole, np.concatenate([inside, whole[..., -1:]], -1), reduction)

    def at(self, row: int) -> Factors:
        """Those of one problem."""
        same = self.whole is self.of_data
        of_data = self.of_data[row]
        return Factors(of_data, of_data if same else self.whole[row], self.confined[row])


@dataclass(frozen=True, eq=False)
class Covariance:
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
    has_priors: bool
    others: OtherThrows | None = None
    """of a throw that is fitted together with others"""

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        bounded: Bounded,
        typical: Floats,
        free: Booleans,
        factors: tuple[Factors, Factors],
        jacobian: Floats,
        sigmas: Sigmas,
    ) -> Self:
        """At the optimum of a problem.

        Parameters
        ----------
        bounded : in the data's coordinates.
        factors : those of the search, and those whose normal equations are the estimator's, which
            differ under a robust loss.
        jacobian : of the weighted residuals, shape (channels, n, parameters).
        """
        searched, estimator = factors
        problem = LinearizedProblem(
            searched.confined[:, -1], searched.confined[:, :-1], *bounded, typical, free
        )
        at_bound = problem.at_bound()
        open_, slack = problem.open(at_bound)
        ends = Bounded(*(part[open_] for part in bounded))
        about = list(itertools.compress(names, open_)), ends.values, typical[open_], slack, ends
        known = of_data = analyse(estimator.whole[:, :-1][:, open_], *about)
        has_priors = estimator.whole is not estimator.of_data
        if has_priors:
            of_data = analyse(estimator.of_data[:, :-1][:, open_], *about)
        matrix, by_open = known.covariance - slack @ slack.T, jacobian[..., open_]
        effect = by_open @ matrix
        leverage = (effect * by_open).sum(-1)
        whole = problem._replace(jacobian=searched.whole[:, :-1])
        return cls(
            names, bounded.values, typical, searched.confined, known, of_data, at_bound, open_,
            matrix, float(problem.distance(sigmas.total, whole)), effect,
            sigmas.dof(leverage), leverage, has_priors,
        )  # fmt: skip

    def degrees_of_freedom(self, weights: Floats) -> list[float | None]:
        """For the variances of weighted sums of the open parameters, one per row of weights; None
        where all sigmas were given."""
        parts = ((self.effect @ weights.T) ** 2).sum(1).T
        dof = np.broadcast_to(self.dof, parts.shape)
        if self.others is not None:
            of_others, dof_of_others = self.others.variance(weights)
            parts, dof = np.column_stack([parts, of_others]), np.column_stack([dof, dof_of_others])
        if self.has_priors:  # which are known exactly
            rest = ((weights @ self.matrix) * weights).sum(-1) - parts.sum(-1)
            parts = np.column_stack([parts, rest])
            dof = np.column_stack([dof, np.full(len(dof), np.inf)])
        return satterthwaite(parts, dof)

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """What is determined in place of single parameters."""
        known = self.identifiability
        weights = list(known.determined().values())[-len(known.combinations) :]
        dof = self.degrees_of_freedom(np.array(weights)) if known.combinations else []
        return tuple(replace(item, dof=n) for item, n in zip(known.combinations, dof, strict=True))

    @cached_property
    def _dof_of_each(self) -> list[float | None]:
        return self.degrees_of_freedom(np.eye(len(self.matrix)))

    def classified(self, place: int) -> tuple[float | None, str, float | None]:
        """Standard error of a free parameter, where there is one, its verdict, and the degrees of
        freedom of the error."""
        index, about = int(self.open[:place].sum()), (self.typical[place], self.at_bound[place])
        stderr, verdict = classify(*about, self.identifiability, index)
        if stderr is None:
            return None, verdict, None
        if verdict == "determined" and self.has_priors:
            alone = classify(*about, self.of_data, index)[1]
            verdict = verdict if alone == verdict else "prior"
        return stderr, verdict, self._dof_of_each[index]

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


def satterthwaite(parts: Floats, dof: Floats) -> list[float | None]:
    """Degrees of freedom of sums of estimated variances, along the rows of `parts` (Satterthwaite
    1946, eq. 17); None where all are known, or those with finite `dof` contribute less than a
    thousandth, so that Student's distribution is normal to rounding of what is printed."""
    size = np.abs(parts)
    known = ~(np.where(np.isfinite(dof), size, 0.0).sum(-1) > _KNOWN * size.sum(-1))
    found = parts.sum(-1) ** 2 / np.where(known, 1.0, (parts**2 / dof).sum(-1))
    return [None if exact else n for n, exact in zip(found.tolist(), known, strict=True)]


class OtherThrows(NamedTuple):
    """What the noise of the other throws contributes to the variances of a throw's estimates."""

    follow: Floats
    """change of the open parameters with those in common, shape (open, common)"""
    matrix: Floats
    """covariance of those in common due to channels whose sigma was estimated"""
    squares: Floats
    """sum of the squares of its parts by channel, each over its degrees of freedom, by pairs of
    parameters in common"""

    @classmethod
    def of_each(cls, found: Sequence[Covariance], reduction: Reduction) -> list[OtherThrows]:
        """For each of some throws that are fitted together."""
        matrices, squares, common = [], [], reduction.common
        for one in found:
            effect = np.zeros((*one.effect.shape[:-1], len(common)))
            effect[..., one.open] = one.effect
            effect = effect[np.isfinite(one.dof)][..., common]
            parts = effect.mT @ effect
            rows = parts.reshape(len(parts), int(common.sum()) ** 2)
            matrices.append(parts.sum(0))
            squares.append(rows.T @ (rows / one.dof[np.isfinite(one.dof), None]))
        total, all_squares = np.sum(matrices, 0), np.sum(squares, 0)
        return [
            cls(follow[one.open][:, common], total - matrix, all_squares - square)
            for one, follow, matrix, square in zip(
                found, reduction.follow, matrices, squares, strict=True
            )
        ]

    def variance(self, weights: Floats) -> tuple[Floats, Floats]:
        """Of weighted sums of the open parameters, one per row of weights, the part that is due to
        estimated sigmas of the others, and its degrees of freedom."""
        along = weights @ self.follow
        pairs = (along[:, :, None] * along[:, None]).reshape(len(along), -1)
        part, square = pairs @ self.matrix.ravel(), ((pairs @ self.squares) * pairs).sum(-1)
        part = np.maximum(part, 0.0)
        return part, np.where(square > 0, part**2 / np.where(square > 0, square, 1.0), np.inf)


class Sigmas(NamedTuple):
    """How the sigmas of the channels of a problem are known."""

    number: NDArray[np.int64]
    """of values"""
    estimated: Booleans
    loss: str
    total: int
    """number of values in all channels, of all throws that are fitted together"""

    def dof(self, leverage: Floats) -> Floats:
        """Degrees of freedom n - p of each sigma; infinite where it was given. The sum of the
        `leverage` of each value, shape (..., n), over a channel is its p."""
        efficiency = 1.0 if self.loss == "linear" else _MEDIAN_EFFICIENCY
        dof = np.maximum(self.number - leverage.sum(-1), 1.0)
        return np.where(self.estimated, efficiency * dof, np.inf)


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
    for owner, one in enumerate(found):
        # Covariance of the open parameters alone: those at a bound stay there.
        squares, axes = np.linalg.eigh(one.matrix / np.outer(typical[one.open], typical[one.open]))
        some = (squares > _CURVED**2) & (squares < _UNKNOWN**2)
        along = np.zeros((int(some.sum()), 2, len(typical)))
        along[..., one.open] = axes.T[some, None]
        size = np.sqrt(squares[some])[:, None, None] * [[1.0], [-1.0]]
        points = values[owner] + size * along * typical
        inside = ((points >= lower[owner]) & (points <= upper[owner])).all(-1)
        which = np.full(int(inside.sum()), owner)
        parts.append(OneSigmaPoints(which, points[inside], along[inside]))
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
