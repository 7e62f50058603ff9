"""Linearized problems, and the R factors of their Jacobians: of throws alone, and of
several that have parameters in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.identifiability import (
    Bounded,
    confined,
    inverted,
    r_factor,
    visible,
)
from curlfit.inference.priors import Penalty
from curlfit.numerics.arrays import Booleans, Floats

_LOOSE = 0.1  # typical sizes inside its bound from which a parameter is not held by it
_NEAR = 1e-6  # typical sizes from a bound within which a parameter is at the bound
_WIDEST = 1e3  # typical sizes, beyond which nothing is known
# least push against a bound over the slopes by the parameters inside theirs ...
_PUSHED = 10.0
# ... within these limits, half chi squared per typical size
_LEAST_PUSH = 1e-6
_CLEAR_PUSH = 1e-3


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

        Along a valley that descends without end the push may be tiny. It is
        distinguished from the end of an exact ridge, where there is none, by the
        remaining slope along the other parameters.
        """
        push, at_lower, at_upper = self._pushes()
        inside = self.free & ~at_lower & ~at_upper
        remaining = np.abs(push * inside).max(-1, keepdims=True)
        least = np.clip(_PUSHED * remaining, _LEAST_PUSH, _CLEAR_PUSH)
        return at_lower & (push > least) | at_upper & (push < -least)

    def movable(self) -> Booleans:
        """Free parameters except those that only a bound keeps from moving,
        however weakly."""
        push, at_lower, at_upper = self._pushes()
        return self.free & ~(at_lower & (push > 0)) & ~(at_upper & (push < 0))

    def _pushes(self) -> tuple[Floats, Booleans, Booleans]:
        """The push toward lower bounds, and which parameters are at a lower, at an
        upper bound."""
        gradient = (self.residual[..., None, :] @ self.jacobian)[..., 0, :]
        near = _NEAR * self.typical
        at_lower = self.free & (self.values <= self.lower + near)
        at_upper = self.free & (self.values >= self.upper - near)
        return gradient * self.typical, at_lower, at_upper

    def open(self, at_bound: Booleans) -> tuple[Booleans, Floats]:
        """The parameters of one optimum that can move, and the contribution of those
        held at a bound to their spread.

        A parameter that the data hardly push against its bound is not held by it: it is
        at the end of a ridge and counts as open.
        """
        if not at_bound.any():
            return self.free, np.zeros((int(self.free.sum()), 0))
        push = np.abs(self.residual @ self.jacobian)
        room = self.upper - self.lower
        held = at_bound.copy()
        for _ in range(2):
            open_ = self.free & ~held
            distance, columns = _slack(
                self.jacobian[:, open_],
                self.jacobian[:, held],
                push[held],
                self.typical[open_],
                self.typical[held],
                room[held],
            )
            loose = distance > _LOOSE * self.typical[held]
            if not loose.any():
                break
            held[held] = ~loose
        return open_, columns

    def newton_decrement(self, where: Booleans) -> Floats:
        """Length of the remaining Gauss-Newton step, in sigmas, along
        determined directions.

        A null direction would have to be followed over a thousand typical sizes.
        """
        jacobian = self.jacobian * (self.typical * where)[..., None, :]
        left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
        along = (self.residual[..., None, :] @ left)[..., 0, :]
        return np.linalg.norm(along * visible(singular), axis=-1)

    def distance(self, count: Any, whole: LinearizedProblem) -> Any:
        """Distance to the optimum in standard errors, over the noise where `count`
        values scatter by more than their sigma.

        `whole` is the problem with the directions that only the bounds determine. A
        step along them would leave the bounds; without them, parameters at a bound may
        seem free to move. Both are upper limits.
        """
        reduced = (self.residual**2).sum(-1) / np.maximum(count, 1)
        decrement = self.newton_decrement(self.movable())
        if not np.array_equal(self.jacobian, whole.jacobian):
            decrement = np.minimum(decrement, whole.newton_decrement(whole.movable()))
        return decrement / np.sqrt(np.maximum(reduced, 1.0))


def _slack(
    jacobian: Floats,
    bounded: Floats,
    push: Floats,
    open_typical: Floats,
    typical: Floats,
    room: Floats,
) -> tuple[Floats, Floats]:
    """Spread of parameters at a bound, each a normal truncated there; the open
    ones follow, along directions that the data determine: along others a small change
    at the bound would move them far beyond their own bounds.

    An optimum at a bound leaves the parameter a one-sided spread: wide where the
    data hardly push against the bound, as at the end of a ridge, and of scale 1/push
    where they do. Holding it at the bound would make the others appear more precise
    than they are.

    Parameters
    ----------
    jacobian, bounded : of the residuals over their sigma, with respect to the open
        parameters and to those at a bound.
    push : decrease of half of chi squared per unit beyond the bound, >= 0, for
        each at a bound.
    open_typical : typical sizes of the open parameters.
    typical, room : of those at a bound: typical size, and width of the
        interval of bounds.

    Returns
    -------
    the rms distance of each from the bound, and the corresponding change of the open
    parameters, shape (open, bounded).
    """
    from scipy.special import log_ndtr  # slow to load

    left, singular, right = np.linalg.svd(jacobian * open_typical, full_matrices=False)
    inverse = inverted(singular, visible(singular))[:, None] * left.T
    follow = -open_typical[:, None] * (right.T @ (inverse @ bounded))
    stiff = np.linalg.norm(bounded + jacobian @ follow, axis=0)
    sigma = 1 / np.maximum(stiff, 1 / (_WIDEST * typical))
    alpha = push * sigma
    # mean square distance from the cut of a normal truncated alpha sigma above its mean
    least = np.minimum(alpha, 30)
    hazard = np.exp(-(least**2 + np.log(2 * np.pi)) / 2 - log_ndtr(-least))
    square = np.where(
        alpha < 30, 1 + alpha**2 - alpha * hazard, 2 / np.maximum(alpha, 1) ** 2
    )
    distance = np.minimum(sigma * np.sqrt(square), room)
    return distance, follow * distance


@dataclass(frozen=True, eq=False)
class Reduction:
    """What throws say about the parameters that they have in common, where the own
    parameters of each follow these; all along the first axis."""

    rows: Floats
    """of each throw on the parameters in common, whose last column is the residual"""
    follow: Floats
    """change of the parameters of a throw, first axis, with those in
    common, second axis"""
    rank: Floats
    """number of directions of its own parameters that a throw determines"""
    common: Booleans

    @classmethod
    def of(
        cls, factors: Floats, bounded: Bounded, typical: Floats, common: Booleans
    ) -> Reduction:
        """From R factors of the Jacobians with the residuals as the last column."""
        free = (bounded.upper > bounded.lower) & ~common
        problem = LinearizedProblem(
            factors[..., -1], factors[..., :-1], *bounded, typical, free
        )
        scaled = factors[..., :-1] * typical
        by_own = scaled * (free & ~problem.at_bound())[:, None]
        left, singular, right = np.linalg.svd(by_own, full_matrices=False)
        seen = visible(singular)
        left = left * seen[:, None]
        # What the own parameters of a throw take up is projected out of its rows.
        rows = factors - left @ (left.mT @ factors)
        rows[..., :-1] *= common
        inverse = right.mT * inverted(singular, seen)[:, None] @ left.mT
        follow = np.diag(1.0 * common) - (inverse @ scaled) * common
        follow = follow * typical[:, None] / typical
        return cls(rows, follow, seen.sum(-1), common)

    def in_common(self, typical: Floats | float = 1.0) -> Floats:
        """The rows, on the parameters in common alone, in units of `typical` sizes."""
        rows = self.rows[..., np.append(self.common, True)]
        rows[..., :-1] *= typical
        return rows

    @cached_property
    def others(self) -> Floats:
        """R factor of the rows of all throws but each, to be added to those of that
        throw; from those before it and those after it."""
        before = _factors_before(self.rows)
        after = _factors_before(self.rows[::-1])[::-1]
        return combined(before, after)

    def gradient(self, gradients: Floats) -> Floats:
        """Gradient of all throws by the parameters of each, from the gradients of each
        throw."""
        reduced = (self.follow.mT @ gradients[..., None])[..., 0]
        return gradients + self.common * (reduced.sum(0) - reduced)


def _factors_before(rows: Floats) -> Floats:
    """R factors of the rows of all throws before each, none before the first."""
    size = rows.shape[-1]
    factors = [np.zeros((size, size))]
    for of_throw in rows[:-1]:
        factors.append(combined(factors[-1], of_throw))
    return np.stack(factors)


def chi_squared_change(rows: Floats, steps: Floats) -> Floats:
    """Change of the sum of squares of rows, with the residual as the last column, by a
    step of the parameters; of many along the first axis."""
    before = rows[..., -1]
    change = (rows[..., :-1] @ steps[..., None])[..., 0]
    of_squares: Floats = (change * (change + 2 * before)).sum(-1)
    return of_squares


def combined(*factors: Floats) -> Floats:
    """R factor of the rows of several."""
    return r_factor(np.concatenate(factors, -2))


class Factors(NamedTuple):
    """R factors of the Jacobian of a problem, or of many along the first axis; the last
    column is the residual over its sigma."""

    of_data: Floats
    whole: Floats
    """with the priors"""
    confined: Floats
    """with the priors, without the directions that only the bounds
    determine (`confined`)"""
    reduction: Reduction | None = None
    """of throws that are fitted together, whose others are contained in all of these"""

    @classmethod
    def of(
        cls,
        of_data: Floats,
        bounded: Bounded,
        typical: Floats,
        penalty: Penalty | None = None,
        common: Booleans | None = None,
        others: Floats | None = None,
    ) -> Factors:
        """From those of the data alone, the parameters with their bounds, the priors,
        and which parameters the throws have in common, if they are fitted together; or
        rows of what others say of the parameters of each."""
        if others is not None:
            of_data = combined(of_data, others)
        if penalty is None:
            penalty = Penalty.none(*bounded.values.shape)
        priors = penalty.rows(bounded.values)
        whole = of_data
        reduction = None
        if common is not None:
            # Priors of what is in common count once.
            with_own_priors = combined(of_data, priors * ~common[:, None])
            reduction = Reduction.of(with_own_priors, bounded, typical, common)
            without_priors = reduction
            if penalty.informative:
                without_priors = Reduction.of(of_data, bounded, typical, common)
            whole = combined(of_data, reduction.others)
            of_data = combined(of_data, without_priors.others)
        whole = combined(whole, priors)
        jacobian = confined(whole[..., :-1], bounded, typical)
        confined_rows = np.concatenate([jacobian, whole[..., -1:]], -1)
        return cls(of_data, whole, confined_rows, reduction)

    def at(self, row: int) -> Factors:
        """The R factors of one problem of many."""
        return Factors(self.of_data[row], self.whole[row], self.confined[row])
