"""Throws whose coefficients vary about a mean that may depend on groups and drift.

Each throw's own parameters are at their optimum for its coefficients; what is left of
its residuals is to first order a measurement of these. The coefficients follow from the
mixed model of all throws (`curlfit.numerics.mixed_model`), and both steps alternate
until nothing moves: Gauss-Newton on the likelihood whose deviations are integrated out
by Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.fit.covariance import Covariance, first_order
from curlfit.inference.fit.factors import Factors, Reduction, combined
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.identifiability import Bounded, Combination, r_factor, r_factors
from curlfit.inference.joint.effects import Covariates, Means
from curlfit.inference.least_squares import Solution, Tasks, minimize_many
from curlfit.inference.priors import Penalty
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import side_by_side
from curlfit.numerics.mixed_model import MixedFit, MixedModel, bounded

_MOST, _USUAL = 24, 8  # linearizations, and those with whole steps; then they alternate
_STEPS = 30  # to the optimum of a throw at its coefficients
_LARGE = 1.0  # typical sizes that a step may be long
_SETTLED = 2e-3  # standard errors that a throw's coefficients still move by
_NEAR = 0.1  # the same, below which variances are not estimated again
_AT = 1e-9  # typical sizes from a bound
_EXACT = 1e-16  # typical sizes squared: a variance below which a direction is exact


class Population(NamedTuple):
    """The mean of throws, and what varies about it."""

    fit: MixedFit
    """in typical sizes from the reference"""
    reference: Floats
    """values of the common parameters"""
    typical: Floats
    bounds: tuple[Floats, Floats]
    weights: dict[str, Floats]
    """of the common parameters in the coefficients and combinations that vary"""
    of_data: MixedFit
    """the fit without priors"""

    @property
    def spreads(self) -> Floats:
        """Standard deviations between throws."""
        found: Floats = np.sqrt(self.fit.variances)
        return found

    @property
    def dof(self) -> float:
        """Degrees of freedom of the spreads."""
        throws, covariates = self.fit.model.covariates.shape
        return max(throws - 1.0 - covariates, 1.0)

    @property
    def scale(self) -> Floats:
        """Of the estimate: typical sizes, and one for the effects."""
        found = np.ones(len(self.fit.estimate))
        found[: len(self.typical)] = self.typical
        return found

    def combinations(
        self, known: Iterable[Combination], before: Iterable[Combination]
    ) -> tuple[Combination, ...]:
        """Those of the mean, known and, from the ones before the throws varied,
        what varies."""
        found, size = {one.expression: one for one in known}, len(self.typical)
        for one in before:
            if one.expression in self.weights and one.expression not in found:
                scaled = self.weights[one.expression] * self.typical
                value = scaled @ (
                    self.reference / self.typical + self.fit.estimate[:size]
                )
                variance = scaled @ self.fit.covariance[:size, :size] @ scaled
                stderr = float(variance**0.5)
                found[one.expression] = replace(one, value=float(value), stderr=stderr)
        return tuple(replace(one, dof=self.dof) for one in found.values())

    def of_mean(self, names: Sequence[str]) -> Covariance:
        """What all throws say of the common parameters of their mean."""
        size = len(self.typical)
        best = self.fit.estimate[:size]
        values = _inside(
            self.reference + self.typical * best, self.typical, *self.bounds
        )
        bounded = Bounded(values, *self.bounds)

        def told(fit: MixedFit) -> Factors:
            mean, matrix = fit.unbounded
            rows = _rows(mean[:size], matrix[:size, :size], best, fit.model.null)
            return Factors.of(
                rows / np.append(self.typical, 1.0), bounded, self.typical
            )

        factors = told(self.fit)
        if self.of_data is not self.fit:
            factors = factors._replace(of_data=told(self.of_data).whole)
        return first_order(names, factors, bounded, self.typical)

    def means(
        self, names: tuple[str, ...], covariates: Covariates, angle: float
    ) -> Means:
        """The record of the mean; a draw to the tee turns by `angle`."""
        effects = np.zeros(len(self.scale) - len(self.reference))
        return Means(
            names=names,
            groups=covariates.groups,
            trends=covariates.trends,
            trend_by=covariates.trend_by,
            centre=covariates.mean,
            last=covariates.last,
            estimate=np.append(self.reference, effects)
            + self.scale * self.fit.estimate,
            covariance=self.scale[:, None] * self.fit.covariance * self.scale,
            directions=self.typical[:, None] * self.fit.model.directions,
            spreads=self.spreads,
            dof=self.dof,
            angle=angle,
        )


def ends_from(
    reference: Floats, typical: Floats, free: Booleans, lower: Floats, upper: Floats
) -> tuple[Floats, Floats]:
    """Bounds in typical sizes from a reference; a parameter that is fixed, which
    nothing moves, has none."""
    return (
        np.where(free, (lower - reference) / typical, -np.inf),
        np.where(free, (upper - reference) / typical, np.inf),
    )


class Together(NamedTuple):
    """Throws that are fitted together."""

    rounds: Rounds
    tasks: Tasks
    solution: Solution
    """their optimum with equal coefficients"""
    common: Booleans
    """which parameters they have in common"""
    covariates: Covariates


def pool(
    throws: Together, weights: Mapping[str, Floats], guess: Floats
) -> tuple[Population, Solution, Floats]:
    """The mean of throws and their deviations from it; the throws at their own
    coefficients; and rows of what the others say of the parameters of each, with the
    residual as the last column, shape (throws, rows, parameters + 1).

    Sigmas that were estimated are estimated again as the throws come to their
    own coefficients.

    Parameters
    ----------
    weights : of the parameters in what varies, by expression, each of
        shape (parameters,).
    guess : standard deviations between throws.
    """
    rounds, tasks, solution, common, _ = throws
    typical, reference = tasks.typical[common], solution.values[0, common]
    bounds = tasks.lower[0, common], tasks.upper[0, common]
    free = bounds[1] > bounds[0]
    whole = np.array([*weights.values()])[:, common]
    directions = np.linalg.pinv(whole * typical * free)
    lower, upper = ends_from(reference, typical, free, *bounds)
    values, distance, centre = np.array(solution.values), np.inf, reference
    seen = np.diag(1.0 * free)
    for step in range(_MOST):
        if step:
            solution = at_coefficients(throws, values)
            values = np.array(solution.values)
        solution = rounds.with_own_sigma(solution)
        reduction, now = (
            reduced(throws, solution),
            (values[:, common] - reference) / typical,
        )
        each = reduction.in_common(typical)
        each[..., :-1] = each[..., :-1] @ seen
        if not step:
            model = _model(throws, each, now, directions, _prior(throws, centre, seen))
            seen = seen_of(model, guess**2, lower, upper) @ seen
            each[..., :-1] = each[..., :-1] @ seen
        prior = _prior(throws, centre, seen)
        model = _model(throws, each, now, directions, prior)
        # afterwards variances stay, which might alternate with zero
        if distance > _NEAR:
            variances = model.variances(guess**2)
        fit = MixedFit(model, variances, lower, upper)
        centre = reference + typical * fit.estimate[: len(typical)]
        told = _rows(*fit.predicted_by_others(), now, fit.model.null)
        every = np.concatenate([each, told], 1)
        move = _moves(every, fit.model.null, lower - now, upper - now)[..., None]
        distance = float(np.linalg.norm(every[..., :-1] @ move, axis=1).max())
        if distance < _SETTLED:
            break
        move = move * min(1.0 if step < _USUAL else 0.5, _LARGE / np.abs(move).max())
        steps = reduction.follow[:, :, common] @ (typical[:, None] * move)
        values = _inside(
            values + steps[..., 0], tasks.typical, tasks.lower, tasks.upper
        )
    others = np.zeros((*told.shape[:2], len(tasks.typical) + 1))
    others[..., np.append(common, True)] = told / np.append(typical, 1.0)
    of_data = fit
    if prior is not None:
        of_data = MixedFit(
            _model(throws, each, now, directions), variances, lower, upper
        )
    varying = dict(zip(weights, whole, strict=True))
    ended = np.full(len(values), distance < _SETTLED)
    found = Population(fit, reference, typical, bounds, varying, of_data)
    return found, solution._replace(success=ended), others


def at_coefficients(throws: Together, values: Floats, most: int = _STEPS) -> Solution:
    """The optima of throws at coefficients that they are given.

    Parameters
    ----------
    values : of each throw one set or several, one after another, with its initial
        state nearby.
    most : steps.
    """
    count, common = len(throws.tasks.start), throws.common
    tasks = throws.tasks._replace(penalty=_of_throws(throws))
    tasks = tasks.at(np.repeat(np.arange(count), len(values) // count))
    start = np.clip(values, tasks.lower, tasks.upper)
    lower, upper = (np.where(common, start, end) for end in (tasks.lower, tasks.upper))
    tasks = tasks._replace(start=start, lower=lower, upper=upper)
    return minimize_many(throws.rounds.model, tasks, side_by_side(count), most)


def told_by_data(
    tasks: Tasks,
    solution: Solution,
    reduction: Reduction,
    names: Sequence[str],
    held: Booleans | None = None,
) -> Covariance:
    """What all throws, or those of which the reduction has rows, say of what they have
    in common, without priors; some parameters may be `held`, as if they were known."""
    common = reduction.common
    values, lower, upper = (
        part[0, common] for part in (solution.values, tasks.lower, tasks.upper)
    )
    typical = tasks.typical[common]
    rows = r_factor(reduction.in_common().reshape(-1, len(typical) + 1))
    if held is not None:
        known = held[common]
        lower = np.where(known, values, lower)
        upper = np.where(known, values, upper)
        rows[:, :-1] *= ~known
    bounded = Bounded(values, lower, upper)
    return first_order(names, Factors.of(rows, bounded, typical), bounded, typical)


def _of_throws(throws: Together) -> Penalty:
    """The priors of what throws do not have in common."""
    penalty = throws.tasks.penalty
    return penalty._replace(weight=penalty.weight * ~throws.common)


def _prior(
    throws: Together, centre: Floats, seen: Floats
) -> tuple[Floats, Floats] | None:
    """Rows of the priors of what throws have in common, in typical sizes from the first
    optimum, on what is seen of it, and what they then give."""
    common, typical = throws.common, throws.tasks.typical[throws.common]
    penalty = throws.tasks.penalty.at((0, common))
    if not penalty.informative:
        return None
    off, slope = penalty.residual_and_slope(centre)
    rows = (slope * typical)[:, None] * seen
    return rows, rows @ ((centre - throws.solution.values[0, common]) / typical) - off


def _model(
    throws: Together,
    each: Floats,
    now: Floats,
    directions: Floats,
    prior: tuple[Floats, Floats] | None = None,
) -> MixedModel:
    """The model of throws, of which `each` has rows with the residual as the
    last column."""
    target = (each[..., :-1] @ now[..., None])[..., 0] - each[..., -1]
    return MixedModel.of(
        each[..., :-1], target, directions, throws.covariates.values, prior
    )


def seen_of(
    model: MixedModel, variances: Floats, lower: Floats, upper: Floats
) -> Floats:
    """Projection of the mean on what not only its bounds determine, for
    some variances."""
    size = len(lower)
    normal = model.parts(model.marginal(variances)[0].sum(0))[0][:size, :size]
    squares, axes = np.linalg.eigh(normal)
    within = Bounded(np.zeros(size), lower, upper)
    hidden = axes[:, within.confine(axes.T, np.sqrt(squares), np.ones(size))]
    found: Floats = np.eye(size) - hidden @ hidden.T
    return found


def reduced(throws: Together, solution: Solution) -> Reduction:
    """What throws say of what they have in common, near their optima."""
    tasks, factors = throws.tasks, r_factors(solution.jacobian, solution.residual)
    within = Bounded(np.array(solution.values), tasks.lower, tasks.upper)
    whole = combined(factors, _of_throws(throws).rows(within.values))
    return Reduction.of(whole, within, tasks.typical, throws.common)


def _moves(rows: Floats, null: Floats, lower: Floats, upper: Floats) -> Floats:
    """Steps of throws to the least squares of rows, with the residual as the last
    column, within bounds."""
    size = len(null)
    held = np.broadcast_to(
        np.pad(null.T, ((0, 0), (0, 1))), (len(rows), null.shape[1], size + 1)
    )
    factor = combined(rows, held)[:, :size]
    root = factor[..., :-1]
    found: Any = np.linalg.solve(root, -factor[..., -1:])[..., 0]
    for row in np.flatnonzero(((found < lower) | (found > upper)).any(1)):
        found[row] = bounded(
            found[row], root[row], np.eye(size), lower[row], upper[row]
        )
    return found


def _inside(values: Floats, typical: Floats, lower: Floats, upper: Floats) -> Floats:
    """Values within their bounds, and at these where only rounding is between."""
    found = np.where(values < lower + _AT * typical, lower, values)
    return np.where(found > upper - _AT * typical, upper, found)


def _rows(mean: Floats, matrix: Floats, at: Floats, null: Floats) -> Floats:
    """Rows whose squares are the quadratic of normal densities of parameters, at
    some values, with the residual as the last column; nothing is known along the
    null directions."""
    squares, axes = np.linalg.eigh(matrix)
    rows = axes.mT / np.sqrt(np.maximum(squares, _EXACT))[..., None]
    rows = rows - (rows @ null) @ null.T
    return np.concatenate([rows, rows @ (at - mean)[..., None]], -1)
