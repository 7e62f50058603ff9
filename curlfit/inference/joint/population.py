"""Throws whose coefficients vary about a mean that may depend on groups and drift.

Each throw's own parameters are at their optimum for its coefficients; what is left of its residuals
is to first order a measurement of these. The coefficients follow from the mixed model of all throws
(`curlfit.numerics.mixed_model`), and both steps alternate until nothing moves: Gauss-Newton on the
likelihood whose deviations are integrated out by Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.fit.covariance import Covariance, Sigmas
from curlfit.inference.fit.factors import Factors
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.identifiability import Bounded, Combination, r_factor, r_factors
from curlfit.inference.least_squares import Solution, Tasks, minimize_many
from curlfit.inference.priors import Penalty
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.mixed_model import MixedFit, MixedModel, bounded

_MOST = 12  # linearizations
_SETTLED = 2e-3  # standard errors that a throw's coefficients still move by
_NEAR = 0.1  # the same, below which variances are not estimated again
_FEW = 64  # throws for which a program compiled quickly is better than a fast one
_AT = 1e-9  # typical sizes from a bound
_EXACT = 1e-16  # typical sizes squared: a variance below which a direction is exact


class Population(NamedTuple):
    """The mean of throws, and what varies about it."""

    fit: MixedFit
    """in typical sizes from the reference"""
    reference: Floats
    """values of the common parameters"""
    typical: Floats
    varying: tuple[str, ...]
    """coefficients and combinations that vary"""
    weights: Floats
    """of the common parameters in these, shape (varying, common)"""
    of_data: MixedFit
    """the fit without priors"""

    @property
    def spreads(self) -> Floats:
        """Standard deviations between throws."""
        found: Floats = np.sqrt(self.fit.variances)
        return found

    def of_mean_at(self, columns: Floats) -> Floats:
        """The common parameters of the mean where covariates have some values, shape (...,
        parameters)."""
        found: Floats = self.reference + self.typical * (self.fit.at(columns) @ self.fit.estimate)
        return found

    def combinations(
        self, known: Iterable[Combination], before: Iterable[Combination]
    ) -> tuple[Combination, ...]:
        """Those of the mean, known and, from the ones before the throws varied, what varies."""
        found, size = {one.expression: one for one in known}, len(self.typical)
        for one in before:
            if one.expression in self.varying and one.expression not in found:
                scaled = self.weights[self.varying.index(one.expression)] * self.typical
                value = scaled @ (self.reference / self.typical + self.fit.estimate[:size])
                variance = scaled @ self.fit.covariance[:size, :size] @ scaled
                found[one.expression] = replace(one, value=float(value), stderr=variance**0.5)
        return tuple(replace(one, dof=self.dof) for one in found.values())

    def of_mean(self, names: Sequence[str], lower: Floats, upper: Floats) -> Covariance:
        """What all throws say of the common parameters of their mean, within bounds."""
        size = len(self.typical)
        best = self.fit.estimate[:size]
        values = _inside(self.reference + self.typical * best, self.typical, lower, upper)
        bounded = Bounded(values, lower, upper)

        def told(fit: MixedFit) -> Factors:
            mean, matrix = fit.unbounded
            rows = _rows(mean[:size], matrix[:size, :size], best, fit.model.null)
            return Factors.of(rows / np.append(self.typical, 1.0), bounded, self.typical, None)

        factors = told(self.fit)
        if self.of_data is not self.fit:
            factors = factors._replace(of_data=told(self.of_data).whole)
        return _covariance(names, factors, bounded, self.typical)

    @property
    def dof(self) -> float:
        """Degrees of freedom of the spreads."""
        throws, covariates = self.fit.model.covariates.shape
        return max(throws - 1.0 - covariates, 1.0)


def told_by_all(
    names: Sequence[str], rows: Floats, bounded: Bounded, typical: Floats
) -> Covariance:
    """What rows of all throws, with the residual as the last column, say of parameters that these
    have in common."""
    factors = Factors.of(r_factor(rows), bounded, typical, None)
    return _covariance(names, factors, bounded, typical)


def _covariance(
    names: Sequence[str], factors: Factors, bounded: Bounded, typical: Floats
) -> Covariance:
    nothing = np.zeros((1, 1, len(typical)))
    sigmas = Sigmas(np.ones(1, int), np.zeros(1, bool), "linear", len(typical))
    return Covariance.of(names, bounded, typical, (factors, factors), nothing, sigmas, True)


def ends_from(
    reference: Floats, typical: Floats, free: Booleans, lower: Floats, upper: Floats
) -> tuple[Floats, Floats]:
    """Bounds in typical sizes from a reference; a parameter that is fixed, which nothing moves, has
    none."""
    return (
        np.where(free, (lower - reference) / typical, -np.inf),
        np.where(free, (upper - reference) / typical, np.inf),
    )


def pool(
    rounds: Rounds,
    tasks: Tasks,
    solution: Solution,
    common: Booleans,
    weights: Mapping[str, Floats],
    guess: Floats,
    covariates: Floats,
) -> tuple[Population, Solution, Floats]:
    """The mean of throws and their deviations from it; the throws at their own coefficients; and
    rows of what the others say of the parameters of each, with the residual as the last column,
    shape (throws, rows, parameters + 1).

    Parameters
    ----------
    rounds : of the fit; sigmas that it estimated are estimated again as the throws come to their
        own coefficients.
    tasks, solution : the throws, and their optimum with equal coefficients, where this begins.
    weights : of the parameters in what varies, by expression, each of shape (parameters,).
    guess : standard deviations between throws.
    covariates : with mean zero, shape (throws, covariates).
    """
    typical, size = tasks.typical[common], int(common.sum())
    free = (tasks.upper > tasks.lower)[0, common]
    reference = solution.values[0, common]
    whole = np.array([*weights.values()])[:, common]
    directions = np.linalg.pinv(whole * typical * free)
    ends = tasks.lower[0, common], tasks.upper[0, common]
    lower, upper = ends_from(reference, typical, free, *ends)
    values, penalty, scale = np.array(solution.values), tasks.penalty, np.append(typical, 1.0)
    if penalty is not None:
        penalty = penalty._replace(weight=penalty.weight * ~common)
    of_mean = None if tasks.penalty is None else Penalty(*(one[0, common] for one in tasks.penalty))
    distance, centre = np.inf, reference
    for step in range(_MOST):
        if step:
            held = [np.where(common, values, end) for end in (tasks.lower, tasks.upper)]
            own = tasks._replace(start=values, lower=held[0], upper=held[1], penalty=penalty)
            solution = minimize_many(rounds.model, own, few=len(values) <= _FEW)
            values = np.array(solution.values)
        solution = rounds.with_own_sigma(solution)
        factors = r_factors(solution.jacobian, solution.residual)
        within = Bounded(values, tasks.lower, tasks.upper)
        reduction = Factors.of(factors, within, tasks.typical, penalty, common).reduction
        assert reduction is not None
        each = reduction.rows[..., np.append(common, True)] * np.append(typical * free, 1.0)
        rows, left = each[..., :-1], each[..., -1]
        now = (values[:, common] - reference) / typical
        target = (rows @ now[..., None])[..., 0] - left
        prior = None
        if of_mean is not None:
            off, slope = of_mean.residual_and_slope(centre)
            slope = slope * typical * free
            prior = np.diag(slope), slope * (centre - reference) / typical - off
        model = MixedModel.of(rows, target, directions, covariates, prior)
        if distance > _NEAR:  # afterwards variances stay, which might alternate with zero
            variances = model.variances(guess**2)
        fit = MixedFit(model, variances, lower, upper)
        centre = reference + typical * fit.estimate[:size]
        mean, matrix = fit.predicted_by_others()
        told = _rows(mean, matrix, now, fit.model.null)
        every = np.concatenate([each, told], 1)
        move = _moves(every, fit.model.null, lower - now, upper - now)[..., None]
        distance = float(np.linalg.norm(every[..., :-1] @ move, axis=1).max())
        if distance < _SETTLED:
            break
        steps = reduction.follow[:, :, common] @ (typical[:, None] * move)
        values = _inside(values + steps[..., 0], tasks.typical, tasks.lower, tasks.upper)
    others = np.zeros((len(values), size, len(tasks.typical) + 1))
    others[..., np.append(common, True)] = told / scale
    ended = np.full(len(values), distance < _SETTLED)
    of_data = fit
    if prior is not None:
        model = MixedModel.of(rows, target, directions, covariates)
        of_data = MixedFit(model, variances, lower, upper)
    found = Population(fit, reference, typical, tuple(weights), whole, of_data)
    return found, solution._replace(success=ended), others


def _moves(rows: Floats, null: Floats, lower: Floats, upper: Floats) -> Floats:
    """Steps of throws to the least squares of rows, with the residual as the last column, within
    bounds."""
    size = len(null)
    held = np.broadcast_to(np.pad(null.T, ((0, 0), (0, 1))), (len(rows), null.shape[1], size + 1))
    factor = r_factor(np.concatenate([rows, held], 1))[:, :size]
    root = factor[..., :-1]
    found: Any = np.linalg.solve(root, -factor[..., -1:])[..., 0]
    for row in np.flatnonzero(((found < lower) | (found > upper)).any(1)):
        found[row] = bounded(found[row], root[row], np.eye(size), lower[row], upper[row])
    return found


def _inside(values: Floats, typical: Floats, lower: Floats, upper: Floats) -> Floats:
    """Values within their bounds, and at these where only rounding is between."""
    found = np.where(values < lower + _AT * typical, lower, values)
    return np.where(found > upper - _AT * typical, upper, found)


def _rows(mean: Floats, matrix: Floats, at: Floats, null: Floats) -> Floats:
    """Rows whose squares are the quadratic of normal densities of parameters, at some values, with
    the residual as the last column; nothing is known along the null directions."""
    squares, axes = np.linalg.eigh(matrix)
    rows = axes.mT / np.sqrt(np.maximum(squares, _EXACT))[..., None]
    rows = rows - (rows @ null) @ null.T
    return np.concatenate([rows, rows @ (at - mean)[..., None]], -1)
