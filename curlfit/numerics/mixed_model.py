"""Linear mixed models: vectors that vary about a mean that depends on covariates.

The observations of block i are

    z_i = A_i (m + D (E x_i + u_i)) + noise of unit variance,
    u_i ~ N(0, diag(variances)),

for the mean m, effects E of covariates x_i (with mean zero), and deviations u_i in some
directions D. m and E are estimated by generalised least squares given the variances,
these by restricted maximum likelihood (Patterson and Thompson 1971, Biometrika 58,
545). All costs are linear in the number of blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.numerics.arrays import Floats

# singular value below which nothing is determined: by itself, and over the largest
_UNSEEN = 1e-3
_UNSEEN_SHARE = 1e-7
# information on effects over the largest, so that undetermined ones are zero
_DIFFUSE = 1e-10
_RANGE = np.log([1e-6, 1e6])  # of variances over their initial values
# of a variance over that of a typical block, below which it counts as zero
_ZERO = 1e-4
_OUTSIDE = 1e-9  # beyond a bound, by rounding


class MixedModel(NamedTuple):
    """Sums of squares and products of each block, from which all else follows."""

    products: Floats
    """of the columns A_i D, A_i, A_i D x_i and z_i, shape (blocks, columns, columns)"""
    directions: Floats
    """D, shape (mean, deviations)"""
    covariates: Floats
    """x_i, shape (blocks, covariates)"""
    null: Floats
    """directions of the mean that nothing determines, where it is held, as
    orthonormal columns"""
    prior: Floats
    """sums of products of the rows of a prior of the mean, of the same columns but
    those of the deviations"""

    @classmethod
    def of(
        cls,
        rows: Floats,
        target: Floats,
        directions: Floats,
        covariates: Floats,
        prior: tuple[Floats, Floats] | None = None,
    ) -> Self:
        """The model of observations.

        Parameters
        ----------
        rows, target : A_i, shape (blocks, rows, mean), and z_i, shape (blocks, rows).
        directions, covariates : D and x_i, see the class.
        prior : rows of the mean, shape (n, mean), and what they give, shape (n,), with
            errors of unit variance.
        """
        size = rows.shape[-1]
        prior_rows = (
            np.zeros((0, size + 1)) if prior is None else np.column_stack(prior)
        )
        all_rows = np.concatenate([rows.reshape(-1, size), prior_rows[:, :-1]])
        factor: Any = np.linalg.qr(all_rows, mode="r")
        _, singular, axes = np.linalg.svd(factor)
        seen = singular > max(_UNSEEN, _UNSEEN_SHARE * singular[0])
        null = axes[int(seen.sum()) :].T
        directions = directions - null @ (null.T @ directions)
        deviations = rows @ directions
        effects = deviations[:, :, None, :] * covariates[:, None, :, None]
        effects = effects.reshape(
            *deviations.shape[:2], covariates.shape[1] * directions.shape[1]
        )
        columns = np.concatenate([deviations, rows, effects, target[..., None]], -1)
        # the same columns, but those of the deviations, on which a prior says nothing
        prior_columns = np.zeros(
            (len(prior_rows), columns.shape[-1] - directions.shape[1])
        )
        prior_columns[:, :size] = prior_rows[:, :-1]
        prior_columns[:, -1] = prior_rows[:, -1]
        return cls(
            products=columns.mT @ columns,
            directions=directions,
            covariates=covariates,
            null=null,
            prior=prior_columns.T @ prior_columns,
        )

    def with_covariates(self, covariates: Floats) -> Self:
        """The model with further covariates, shape (blocks, covariates)."""
        blocks, before, _ = self.products.shape
        deviations = self.directions.shape[1]
        effects = covariates.shape[1] * deviations
        # the columns of further effects are those of the deviations, A_i D, times x_i
        further = covariates[:, None, :, None] * np.eye(deviations)[:, None, :]
        change = np.zeros((blocks, before, before + effects))
        change[:, : before - 1, : before - 1] = np.eye(before - 1)
        change[:, :deviations, before - 1 : -1] = further.reshape(
            blocks, deviations, effects
        )
        change[:, -1, -1] = 1.0
        # a prior says nothing of effects; its last column is that of the observations
        positions = np.full(effects, len(self.prior) - 1)
        prior = np.insert(self.prior, positions, 0.0, axis=0)
        prior = np.insert(prior, positions, 0.0, axis=1)
        return self._replace(
            products=change.mT @ self.products @ change,
            covariates=np.concatenate([self.covariates, covariates], 1),
            prior=prior,
        )

    def marginal(self, variances: Floats) -> tuple[Floats, Floats]:
        """The products of each block with the deviations integrated out, without
        their columns, and the logarithm of the determinant of the covariance of its
        observations; for variances of shape (..., deviations), with the blocks
        after these axes."""
        k = variances.shape[-1]
        cross, solved, determinants = self._integrated(variances)
        return self.products[:, k:, k:] - cross.mT @ solved, determinants

    def marginal_sum(self, variances: Floats) -> tuple[Floats, Floats]:
        """The sums over the blocks of what `marginal` returns, without the arrays of
        each."""
        k = variances.shape[-1]
        cross, solved, determinants = self._integrated(variances)
        # one below the other
        cross = cross.reshape(*cross.shape[:-3], -1, cross.shape[-1])
        solved = solved.reshape(*solved.shape[:-3], -1, solved.shape[-1])
        products = self.products[:, k:, k:].sum(0) - cross.mT @ solved
        return products, determinants.sum(-1)

    def _integrated(self, variances: Floats) -> tuple[Floats, Floats, Floats]:
        """Of each block, for deviations in units of their standard deviations: their
        products with the other columns, these divided by the matrix of the deviations,
        and the logarithm of its determinant."""
        k = variances.shape[-1]
        root = np.sqrt(variances)[..., None, :, None]
        inner = np.eye(k) + root * self.products[:, :k, :k] * root.mT
        cross = root * self.products[:, :k, k:]
        solved: Any = np.linalg.solve(inner, cross)
        return cross, solved, np.linalg.slogdet(inner)[1]

    def criterion(self, variances: Floats) -> Floats:
        """-2 times the logarithm of the restricted likelihood, up to a constant."""
        products, determinants = self.marginal_sum(variances)
        normal, right, square = self.parts(products)
        mean: Any = np.linalg.solve(normal, right[..., None])[..., 0]
        explained = (right * mean).sum(-1)
        value: Floats = determinants + np.linalg.slogdet(normal)[1] + square - explained
        return value

    def criterion_slopes(self, variances: Floats) -> Floats:
        """Derivatives of the criterion by the variances, shape (deviations,).

        Where C = diag(variances)^-1 + S, with the products S of the deviations of a
        block, a variance v_j adds to C^-1 the square of column j of 1 - C^-1 S. The
        products t_j of deviation j with all columns, with the deviations integrated
        out, are those of this column: the marginal products change by -t_j t_j^T, and
        the logarithm of the determinant by the product of deviation j with itself.
        """
        k = len(variances)
        root = np.sqrt(variances)[:, None]
        products = self.products[:, :k]
        inner = np.eye(k) + root * products[:, :, :k] * root.T
        solved: Any = np.linalg.solve(inner, root * products)
        integrated = products - (products[:, :, :k] * root.T) @ solved
        of_deviation = np.diagonal(integrated, axis1=1, axis2=2)
        with_mean = integrated[:, :, k:-1]
        normal, right, _ = self.parts(self.marginal_sum(variances)[0])
        mean: Any = np.linalg.solve(normal, right)
        unexplained = integrated[:, :, -1] - with_mean @ mean
        # by which the determinant of the normal matrix changes
        by_mean = ((with_mean @ np.linalg.inv(normal)) * with_mean).sum(-1)
        slopes: Floats = (of_deviation - by_mean - unexplained**2).sum(0)
        return slopes

    def parts(self, products: Floats) -> tuple[Floats, Floats, Any]:
        """Normal matrix and right side of the mean and the effects, and the sum of
        squares, from the sum of the products of blocks and the prior."""
        products = products + self.prior
        normal = products[..., :-1, :-1].copy()
        size = len(self.null)
        normal[..., :size, :size] += self.null @ self.null.T
        effects = np.arange(size, normal.shape[-1])
        largest = np.diagonal(normal, axis1=-2, axis2=-1).max(-1, keepdims=True)
        normal[..., effects, effects] += _DIFFUSE * largest
        return normal, products[..., :-1, -1], products[..., -1, -1]

    def fitted(self, guess: Floats, lower: Floats, upper: Floats) -> MixedFit:
        """The estimate; `guess` is of the variances, the bounds are those of the means
        of all blocks."""
        return MixedFit(self, self.variances(guess), lower, upper)

    @property
    def typical(self) -> Floats:
        """Variances of the deviations as a typical block tells them."""
        information = np.diagonal(self.products, axis1=1, axis2=2)
        of_deviations = information[:, : self.directions.shape[1]]
        typical_information = np.maximum(np.median(of_deviations, axis=0), 1e-300)
        variances: Floats = 1 / typical_information
        return variances

    def variances(self, guess: Floats) -> Floats:
        """Variances of the deviations, by restricted maximum likelihood; zero where
        this is hardly less likely."""
        from scipy.optimize import minimize  # slow to load

        def by_logarithms(logarithms: Floats) -> tuple[float, Floats]:
            variances = guess * np.exp(logarithms)
            slopes = variances * self.criterion_slopes(variances)
            return float(self.criterion(variances)), slopes

        best = minimize(
            by_logarithms,
            np.zeros(len(guess)),
            jac=True,
            bounds=[_RANGE] * len(guess),
            options={"ftol": 1e-14, "gtol": 1e-6},
        )
        variances: Floats = guess * np.exp(best.x)
        small = variances < _ZERO * self.typical
        without_small = np.where(small, 0.0, variances)
        if small.any() and self.criterion(without_small) < best.fun + _ZERO:
            return without_small
        return variances


def to_mean(directions: Floats, covariates: Floats) -> Floats:
    """Matrix from the mean of all blocks and the effects, by covariate and direction,
    to the mean where the covariates have some values, of shape (..., covariates)."""
    by_effect = covariates[..., None, :, None] * directions[:, None, :]
    flat = by_effect.reshape(*by_effect.shape[:-2], -1 if by_effect.size else 0)
    mean = np.broadcast_to(np.eye(len(directions)), (*flat.shape[:-1], len(directions)))
    return np.concatenate([mean, flat], -1)


def within(
    free: Floats, root: Floats, sides: Floats, limits: Floats
) -> tuple[Floats, Floats]:
    """The x nearest to `free`, by the length of root (x - free), where sides x >=
    limits, and the sides at their limit."""
    from scipy.optimize import nnls  # slow to load

    violated = limits - sides @ free
    if not (violated > _OUTSIDE).any():
        return free, sides[:0]
    # Least distance programming by nonnegative least squares (Lawson and Hanson 1974,
    # ch. 23) for the step root (x - free), with sides of length 1 and limits up to 1.
    along = np.linalg.solve(root.T, sides.T)
    size = np.maximum(np.linalg.norm(along, axis=0), np.finfo(float).tiny)
    scale = (violated / size).max()
    rows = np.vstack([along, violated / scale]) / size
    weights, _ = nnls(rows, np.append(np.zeros(len(free)), 1.0))
    step = scale * (rows[:-1] @ weights) / (1 - rows[-1] @ weights)
    return free + np.linalg.solve(root, step), sides[weights > 0]


def bounded(
    free: Floats, root: Floats, to: Floats, lower: Floats, upper: Floats
) -> Floats:
    """The x nearest to `free`, by the length of root (x - free), where `to` x is within
    bounds, which contain zero but for rounding."""
    sides, limits = _sides(to[None], lower, upper)
    return within(free, root, sides, np.minimum(limits, 0.0))[0]


@dataclass(frozen=True, eq=False)
class MixedFit:
    """The estimate of a mixed model; the mean of each block is within the bounds.

    A number of the mean that is cut keeps its variance whatever the blocks say of it,
    and its uncertainty is in those that depend on it (the cut model of Plummer 2015,
    Statistics and Computing 25, 37).
    """

    model: MixedModel
    variances: Floats
    lower: Floats
    upper: Floats
    cut: Floats = field(default_factory=lambda: np.zeros(0))
    """variances that numbers of the mean keep, zero of those that are not cut; empty
    where none is"""

    @cached_property
    def _products(self) -> Floats:
        """Of each block, with the deviations integrated out."""
        return self.model.marginal(self.variances)[0]

    @cached_property
    def _bounded(self) -> tuple[Floats, Floats]:
        """The mean and the effects, and the sides of bounds that they are at."""
        means = self.at(np.unique(self.model.covariates, axis=0))
        normal, right, _ = self.model.parts(self._products.sum(0))
        root: Any = np.linalg.cholesky(normal).T
        sides, limits = _sides(means, self.lower, self.upper)
        free: Any = np.linalg.solve(normal, right)
        return within(free, root, sides, limits)

    @property
    def at_bound(self) -> bool:
        """Whether a bound holds a mean."""
        return len(self._bounded[1]) > 0

    @property
    def estimate(self) -> Floats:
        """The mean, then the effects of each covariate."""
        return self._bounded[0]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the estimate along what is determined, while what is at a bound
        stays there."""
        normal, _, _ = self.model.parts(self._products.sum(0))
        covariance = self._with_cut(np.linalg.inv(normal))
        _, held_sides = self._bounded
        of_held = held_sides @ covariance
        removed = of_held.T @ np.linalg.pinv(of_held @ held_sides.T) @ of_held
        covariance = covariance - removed
        null = self.model.null
        size = len(null)
        covariance[:size] -= null @ (null.T @ covariance[:size])
        covariance[:, :size] -= (covariance[:, :size] @ null) @ null.T
        return covariance

    @property
    def unbounded(self) -> tuple[Floats, Floats]:
        """The estimate without bounds, and its covariance, one along the
        null directions."""
        normal, right, _ = self.model.parts(self._products.sum(0))
        covariance: Any = np.linalg.inv(normal)
        return covariance @ right, self._with_cut(covariance)

    def at(self, covariates: Floats) -> Floats:
        """Matrix from the estimate to the mean where the covariates have some values,
        each of shape (..., covariates)."""
        return to_mean(self.model.directions, covariates)

    def predicted_by_others(self) -> tuple[Floats, Floats]:
        """Mean and covariance of the vector of each block before its own observations;
        along the null directions the variance is one. What is cut has the variance that
        the model gives it."""
        normal, right, _ = self.model.parts(self._products.sum(0) - self._products)
        to = self.at(self.model.covariates)
        mean = to @ np.linalg.solve(normal, right[..., None])
        directions = self.model.directions
        between = directions * self.variances @ directions.T
        return mean[..., 0], to @ np.linalg.inv(normal) @ to.mT + between

    def _with_cut(self, covariance: Any) -> Any:
        """The covariance of the estimate in which what is cut has its own variance."""
        which = np.flatnonzero(self.cut)
        if not len(which):
            return covariance
        return covariance + added_by_cut(covariance, which, self.cut[which])


def following(matrix: Any, which: Any) -> Floats:
    """By how much numbers with some covariance follow some of them, by index, shape
    (..., numbers, which)."""
    columns = matrix[..., which]
    followed: Floats = columns @ np.linalg.inv(columns[..., which, :])
    return followed


def added_by_cut(matrix: Any, which: Any, variances: Floats) -> Floats:
    """What a covariance lacks where some of its numbers, by index, have other variances
    of their own, and all others follow them."""
    followed = following(matrix, which)
    change = np.diag(variances) - matrix[..., which[:, None], which]
    added: Floats = followed @ change @ followed.mT
    return added


def _sides(to: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Bounds of `to` x, matrices of shape (points, vector, x), as sides x >= limits."""
    limits = np.concatenate([lower, -upper])
    is_bounded = np.isfinite(limits)
    sides = np.concatenate([to, -to], 1)[:, is_bounded]
    return sides.reshape(-1, to.shape[-1]), np.tile(limits[is_bounded], len(to))
