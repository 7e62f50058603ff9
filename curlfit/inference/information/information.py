"""The noun: what data say of parameters to first order about some values.

Methods act along the leading axes of a stack: the likelihoods of a thousand throws are
a thousand rows of one array, not a thousand objects. `open` and `along_axes` take one
information; `together` and `of_others` add up a stack along its first axis.

Which parameters can move has four words here. A parameter is *free* unless its bounds
are equal, which fixes it; *at its bound* where the data push it against that; *movable*
unless that push, however weak, keeps it; and *open* if it is free and no bound holds
it. Errors and verdicts of a fit are those of its open parameters; `Covariance.of` finds
them, by `without_confined`, `at_bound` and `open` in this order. Parameters that cannot
move keep their columns: what counts them too says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any, Self

import numpy as np

from curlfit.inference.information.bounds import Bounded, spread_at_bounds
from curlfit.inference.information.directions import (
    directions_of_squares,
    inverted,
    r_factor,
    visible,
)
from curlfit.numerics.arrays import Booleans, Floats

_LOOSE = 0.1  # typical sizes inside its bound from which a parameter is not held by it
_NEAR = 1e-6  # typical sizes from a bound within which a parameter is at the bound
# least push against a bound over the slopes by the parameters inside theirs ...
_PUSHED = 10.0
# ... within these limits, half chi squared per typical size
_LEAST_PUSH = 1e-6
_CLEAR_PUSH = 1e-3


@dataclass(frozen=True, eq=False)
class Information:
    """Rows [R, r] about values: |R (p - values)/typical + r|^2 is chi squared of the
    parameters p, up to a constant. Or a stack of such, along the first axes.

    Attributes
    ----------
    names : of the parameters.
    values, lower, upper : of the parameters and their bounds, shape (..., parameters);
        one with equal bounds is fixed.
    typical : sizes of the parameters, shape (parameters,).
    rows : R in typical sizes with the residual r as the last column; the error of each
        row is one. Shape (..., rows, parameters + 1).
    """

    names: tuple[str, ...]
    values: Floats
    lower: Floats
    upper: Floats
    typical: Floats
    rows: Floats

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        bounded: Bounded,
        typical: Floats,
        jacobian: Floats,
        residual: Floats,
    ) -> Self:
        """From residuals over their sigma and their derivatives by the parameters.

        Parameters
        ----------
        bounded : values of the parameters and their bounds; of a stack along the
            first axes.
        jacobian, residual : shape (..., n, parameters) and (..., n), where n may be
            several axes, such as channels and rows.
        """
        stack = bounded.values.shape[:-1]
        slopes = jacobian.reshape(*stack, -1, len(names)) * typical
        last = residual.reshape(*stack, -1, 1)
        rows = np.concatenate([slopes, last], -1)
        if rows.shape[-2] > rows.shape[-1]:
            rows = r_factor(rows)
        return cls(tuple(names), *bounded, typical, rows)

    @classmethod
    def of_squares(
        cls,
        names: Sequence[str],
        values: Floats,
        typical: Floats,
        matrix: Floats,
        gradient: Floats,
    ) -> Self:
        """From J^T J and -J^T r, as records have them, of parameters without bounds:
        one row for each direction that these determine."""
        axes, singular, _ = directions_of_squares(matrix, typical)
        residual = -(axes @ (gradient * typical)) / singular
        rows = np.column_stack([singular[:, None] * axes, residual])
        return cls(tuple(names), *Bounded.none(values), typical, rows)

    @property
    def scaled(self) -> Floats:
        """R, in typical sizes."""
        return self.rows[..., :-1]

    @property
    def slopes(self) -> Floats:
        """R, in the units of the parameters."""
        return self.scaled / self.typical

    @property
    def residual(self) -> Floats:
        """r, what is left at the values."""
        return self.rows[..., -1]

    @property
    def bounded(self) -> Bounded:
        """The values and their bounds."""
        return Bounded(self.values, self.lower, self.upper)

    @property
    def free(self) -> Booleans:
        """Which parameters are not fixed."""
        return self.bounded.free

    def at(self, index: Any) -> Self:
        """One of a stack, or some."""
        return replace(
            self,
            values=self.values[index],
            lower=self.lower[index],
            upper=self.upper[index],
            rows=self.rows[index],
        )

    # ---- algebra

    def __add__(self, other: Information) -> Self:
        """What both say together, about the values of the first. The other may be about
        fewer of the parameters."""
        indices = [self.names.index(name) for name in other.names]
        of_other = other.about(self.values[..., indices]).rows.copy()
        of_other[..., :-1] *= self.typical[indices] / other.typical
        widened = np.zeros((*of_other.shape[:-1], len(self.names) + 1))
        widened[..., [*indices, -1]] = of_other
        return self._with(widened)

    def with_rows(self, rows: Floats) -> Self:
        """This and rows of other knowledge, such as priors, about the same values.

        Parameters
        ----------
        rows : in the units of the parameters, unlike those of an Information, with the
            residual as the last column.
        """
        return self._with(rows * np.append(self.typical, 1.0))

    def _with(self, rows: Floats) -> Self:
        return replace(self, rows=r_factor(np.concatenate([self.rows, rows], -2)))

    def about(self, values: Floats) -> Self:
        """The same about other values."""
        step = (values - self.values) / self.typical
        rows = self.rows.copy()
        rows[..., -1] += (rows[..., :-1] @ step[..., None])[..., 0]
        return replace(self, values=values, rows=rows)

    def only(self, which: Booleans) -> Self:
        """About some parameters, where the others stay at their values."""
        return replace(
            self,
            names=tuple(compress(self.names, which)),
            values=self.values[..., which],
            lower=self.lower[..., which],
            upper=self.upper[..., which],
            typical=self.typical[which],
            rows=self.rows[..., np.append(which, True)],
        )

    def held(self, which: Booleans) -> Self:
        """The same with some parameters fixed at their values."""
        return replace(
            self,
            lower=np.where(which, self.values, self.lower),
            upper=np.where(which, self.values, self.upper),
        )

    def marginal(self, which: Booleans) -> Marginal:
        """About some parameters, where the others, the nuisance parameters, follow
        them: the Schur complement, by projection of the rows onto the orthogonal
        complement of the columns of the nuisance parameters, which loses no digits."""
        nuisances = self.held(which)
        moving = nuisances.free & ~nuisances.at_bound()
        by_nuisances = self.scaled * moving[..., None, :]
        left, singular, right = np.linalg.svd(by_nuisances, full_matrices=False)
        seen = visible(singular)
        left = left * seen[..., None, :]
        rows = self.rows - left @ (left.mT @ self.rows)
        inverse = right.mT * inverted(singular, seen)[..., None, :] @ left.mT
        follow = np.eye(len(which))[:, which] - inverse @ self.scaled[..., which]
        return Marginal(
            replace(self, rows=rows).only(which),
            follow * self.typical[:, None] / self.typical[which],
            seen.sum(-1),
            which,
        )

    def together(self) -> Self:
        """What all along the first axis say together, if about the same values."""
        rows = r_factor(self.rows.reshape(-1, self.rows.shape[-1]))
        return replace(self.at(0), rows=rows)

    def of_others(self) -> Self:
        """What all others along the first axis say together, for each: from those
        before it and those after it, at a cost that is linear in their number."""
        before = _sums_before(self.rows)
        after = _sums_before(self.rows[::-1])[::-1]
        return replace(self, rows=r_factor(np.concatenate([before, after], -2)))

    def without_confined(self) -> Self:
        """The same without the directions that only the bounds determine; itself if
        there are none."""
        scaled = self.scaled * self.free[..., None, :]
        _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
        confined = visible(singular)
        confined &= self.bounded.alone_limit(axes, singular, self.typical)
        if not confined.any():
            return self
        axes = axes * confined[..., None]
        rows = self.rows.copy()
        rows[..., :-1] -= (scaled @ axes.mT) @ axes
        return replace(self, rows=rows)

    def along_axes(self) -> Self:
        """One information by orthogonal rows, one for each determined direction, the
        best first."""
        left, singular, axes = np.linalg.svd(self.scaled, full_matrices=False)
        rows = np.column_stack([singular[:, None] * axes, left.T @ self.residual])
        return replace(self, rows=rows[visible(singular)])

    # ---- what it says

    @property
    def normal_matrix(self) -> Floats:
        """J^T J, in the units of the parameters."""
        return self.slopes.mT @ self.slopes

    @property
    def gradient(self) -> Floats:
        """Of the log-likelihood, -J^T r, in the units of the parameters."""
        return -(self.residual[..., None, :] @ self.slopes)[..., 0, :]

    def rise(self, step: Floats) -> Floats:
        """Change of chi squared by a step of the parameters."""
        change = (self.scaled @ (step / self.typical)[..., None])[..., 0]
        of_squares: Floats = (change * (change + 2 * self.residual)).sum(-1)
        return of_squares

    def step_to_optimum(self) -> Floats:
        """Change of all parameters to the least chi squared, along determined
        directions, without regard to bounds."""
        return self.response(-self.gradient)

    def response(self, gradient: Floats) -> Floats:
        """Change of the optimum of all parameters where J^T r changes by a gradient,
        in the units of the parameters: -(J^T J)^-1 times it, along determined
        directions."""
        _, singular, axes = np.linalg.svd(self.scaled, full_matrices=False)
        errors = axes.mT * inverted(singular, visible(singular))[..., None, :]
        in_typical_sizes = (self.typical * gradient)[..., None]
        step = errors @ (errors.mT @ in_typical_sizes)
        return -self.typical * step[..., 0]

    def newton_decrement(self, where: Booleans) -> Floats:
        """Length of the remaining Gauss-Newton step of some parameters, the others
        being held, in sigmas, along determined directions.

        A null direction would have to be followed over a thousand typical sizes.
        """
        scaled = self.scaled * where[..., None, :]
        left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
        along = (self.residual[..., None, :] @ left)[..., 0, :]
        return np.linalg.norm(along * visible(singular), axis=-1)

    # ---- parameters at their bounds

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
        """The push toward lower bounds, half chi squared per typical size, and which
        parameters are at a lower, at an upper bound."""
        push = (self.residual[..., None, :] @ self.scaled)[..., 0, :]
        near = _NEAR * self.typical
        at_lower = self.free & (self.values <= self.lower + near)
        at_upper = self.free & (self.values >= self.upper - near)
        return push, at_lower, at_upper

    def open(self, at_bound: Booleans) -> tuple[Booleans, Floats]:
        """The parameters of one optimum that can move, and the contribution of those
        held at a bound to their spread, in typical sizes, shape (open, held).

        A parameter that the data hardly push against its bound is not held by it: it is
        at the end of a ridge and counts as open.
        """
        if not at_bound.any():
            return self.free, np.zeros((int(self.free.sum()), 0))
        push = np.abs(self.residual @ self.scaled)
        room = (self.upper - self.lower) / self.typical
        stuck = at_bound.copy()
        for _ in range(2):  # again, for those that are left when some have come loose
            is_open = self.free & ~stuck
            distance, spread = spread_at_bounds(
                self.scaled[:, is_open], self.scaled[:, stuck], push[stuck], room[stuck]
            )
            comes_loose = distance > _LOOSE
            if not comes_loose.any():
                break
            stuck[stuck] = ~comes_loose
        return is_open, spread


@dataclass(frozen=True, eq=False)
class Marginal:
    """What throws, along the first axis, say of the parameters that they have in
    common, where the other parameters of each follow these."""

    information: Information
    """about the parameters in common"""
    follow: Floats
    """change of all parameters of a throw with those in common, in their units, shape
    (throws, parameters, common)"""
    rank: Floats
    """number of directions of its other parameters that a throw determines"""
    common: Booleans
    """which parameters these are"""

    def gradient(self, gradients: Floats) -> Floats:
        """Gradient of a sum over all throws by the parameters of each, from the
        gradients of each throw's part by its own parameters, shape (throws,
        parameters). A change of those in common moves the other parameters of every
        throw with it (`follow`), so that each throw has the parts of all others too."""
        by_common = (self.follow.mT @ gradients[..., None])[..., 0]
        of_all = gradients.copy()
        of_all[..., self.common] += by_common.sum(0) - by_common
        return of_all


def _sums_before(rows: Floats) -> Floats:
    """Rows of all of a stack before each together, none before the first."""
    size = rows.shape[-1]
    sums = [np.zeros((size, size))]
    for of_one in rows[:-1]:
        sums.append(r_factor(np.concatenate([sums[-1], of_one])))
    return np.stack(sums)
