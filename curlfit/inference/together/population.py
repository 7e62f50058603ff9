"""Throws whose coefficients vary about a mean that may depend on groups and drift.

Each throw is a quadratic in the coefficients of the law, to first order about its
optimum for some of them, whether it was fitted beside the others or its line of a table
is all that is left of it. The mixed model of all throws
(`curlfit.numerics.mixed_model`) then tells their mean and how they vary about it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.directions import r_factor
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.model.priors import Normal, Penalty
from curlfit.inference.solve.least_squares import Solution, Tasks, minimize_many
from curlfit.inference.together.effects import Covariates, Means
from curlfit.inference.together.posterior import Draws
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import side_by_side
from curlfit.numerics.mixed_model import MixedFit, MixedModel, bounded

_AGAIN = 8
"""Times that throws are linearised again, at most: tracks with an angle take 2,
evenings whose exponents are far from what is usual 4, tracks without an angle 7."""
_STEPS = 30  # to the optimum of a throw at its coefficients
_LARGE = 1.0  # typical sizes that a step may be long
_SETTLED = 0.01  # standard errors that coefficients still move by, which is none
_ENDED = 0.1  # standard errors that they still move by, which is little
_AT = 1e-9  # typical sizes from a bound
_DRAWN = 400  # draws from the posterior, for predictions
_EXACT = 1e-16  # typical sizes squared: a variance below which a direction is exact
_SHARPER = 1e3
"""Times by which the prior of what is cut is narrower while the rest is estimated: the
throws do not move it by more than 1e-3 of its standard deviation."""


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
    """the fit without priors but of what is cut"""

    @property
    def mean(self) -> Floats:
        """Values of the common parameters, about which throws vary."""
        best = self.fit.estimate[: len(self.typical)]
        values = self.reference + self.typical * best
        return _inside(values, self.typical, *self.bounds)

    @property
    def spreads(self) -> Floats:
        """Standard deviations between throws."""
        spreads: Floats = np.sqrt(self.fit.variances)
        return spreads

    @property
    def dof(self) -> float:
        """Degrees of freedom of the spreads."""
        throws, covariates = self.fit.model.covariates.shape
        return max(throws - 1.0 - covariates, 1.0)

    @property
    def scale(self) -> Floats:
        """Units of the estimate: typical sizes of the mean, one for the effects."""
        scale = np.ones(len(self.fit.estimate))
        scale[: len(self.typical)] = self.typical
        return scale

    def combinations(
        self, of_mean: Iterable[Combination], equal: Iterable[Combination]
    ) -> tuple[Combination, ...]:
        """Combinations that the mean determines, and those of equal throws that vary
        about it."""
        size = len(self.typical)
        mean = self.reference / self.typical + self.fit.estimate[:size]
        by_expression = {combination.expression: combination for combination in of_mean}
        for combination in equal:
            expression = combination.expression
            if expression in self.weights and expression not in by_expression:
                scaled = self.weights[expression] * self.typical
                variance = scaled @ self.fit.covariance[:size, :size] @ scaled
                by_expression[expression] = replace(
                    combination,
                    value=float(scaled @ mean),
                    stderr=float(variance**0.5),
                )
        return tuple(
            replace(combination, dof=self.dof) for combination in by_expression.values()
        )

    def of_mean(self, names: Sequence[str]) -> Covariance:
        """What all throws say of the common parameters of their mean."""
        size = len(self.typical)
        best = self.fit.estimate[:size]
        bounded = Bounded(self.mean, *self.bounds)

        def information(fit: MixedFit) -> Information:
            mean, matrix = fit.unbounded
            rows = _rows(mean[:size], matrix[:size, :size], best, fit.model.null)
            return Information(tuple(names), *bounded, self.typical, rows)

        of_data = None
        if self.of_data is not self.fit:
            of_data = information(self.of_data)
        return Covariance.of(information(self.fit), of_data=of_data)

    def means(
        self,
        names: tuple[str, ...],
        covariates: Covariates,
        angle: float,
        draws: Draws | None = None,
    ) -> Means:
        """The record of the mean, with some draws from the posterior; a draw to the tee
        turns by `angle`."""
        effects = np.zeros(len(self.scale) - len(self.reference))
        reference = np.append(self.reference, effects)
        drawn = np.zeros((0, 0))
        if draws is not None:
            kept = np.linspace(0, len(draws.spreads) - 1, _DRAWN).astype(int)
            off = draws.estimate[kept] - self.fit.estimate
            # where nothing determines the mean, draws are arbitrary: it is held there
            size = len(self.typical)
            null = self.fit.model.null
            off[:, :size] -= (off[:, :size] @ null) @ null.T
            estimates = reference + self.scale * (self.fit.estimate + off)
            drawn = np.concatenate([estimates, draws.spreads[kept]], 1)
        return Means(
            names=names,
            groups=covariates.groups,
            trends=covariates.trends,
            trend_by=covariates.trend_by,
            centre=covariates.mean,
            last=covariates.last,
            estimate=reference + self.scale * self.fit.estimate,
            covariance=self.scale[:, None] * self.fit.covariance * self.scale,
            directions=self.typical[:, None] * self.fit.model.directions,
            spreads=self.spreads,
            dof=self.dof,
            angle=angle,
            drawn=drawn,
        )


class Together(NamedTuple):
    """Throws that are fitted together."""

    stack: ThrowStack
    tasks: Tasks
    solution: Solution
    """their optimum with equal coefficients"""
    common: Booleans
    """which parameters they have in common"""
    covariates: Covariates

    def information(self, solution: Solution) -> Information:
        """What the data of each throw say at an optimum, along the first axis."""
        tasks = self.tasks
        bounded = Bounded(np.array(solution.values), tasks.lower, tasks.upper)
        return Information.of(
            self.stack.requests[0].parameters.names,
            bounded,
            tasks.typical,
            solution.jacobian,
            solution.residual,
        )


class LinearizedThrows(NamedTuple):
    """What throws say of the parameters in common, each to first order about values of
    its own."""

    information: Information
    """along the first axis; the bounds are the same for all, and both are the reference
    where a parameter is fixed"""
    reference: Floats
    prior: tuple[Floats, Floats] | None = None
    """rows of what is known of the mean besides, in typical sizes, and what they then
    give for the distance from the reference"""
    cut: Floats = np.zeros(0)
    """variances, in typical sizes squared, that parameters of the mean keep whatever
    the throws say of them; zero of those that the throws tell"""

    @property
    def typical(self) -> Floats:
        """Typical sizes of the parameters."""
        return self.information.typical

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Of the parameters, in their units."""
        return self.information.lower[0], self.information.upper[0]

    @property
    def at(self) -> Floats:
        """The values of each throw, in typical sizes from the reference."""
        return (self.information.values - self.reference) / self.typical

    @property
    def free(self) -> Booleans:
        """Parameters that are not fixed."""
        return self.information.free[0]

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """The bounds in typical sizes from the reference; a parameter that is fixed,
        which nothing moves, has none."""
        lower, upper = (
            (bound - self.reference) / self.typical for bound in self.bounds
        )
        return (
            np.where(self.free, lower, -np.inf),
            np.where(self.free, upper, np.inf),
        )

    def along(self, projection: Floats) -> Self:
        """These throws where only a projection of the parameters has an effect."""
        prior = self.prior
        if prior is not None:
            prior = prior[0] @ projection, prior[1]
        rows = self.information.rows.copy()
        rows[..., :-1] = self.information.scaled @ projection
        return self._replace(
            information=replace(self.information, rows=rows), prior=prior
        )

    def projection(
        self, weights: Mapping[str, Floats], covariates: Floats, spreads: Floats
    ) -> Floats:
        """On what not only the bounds determine of the mean, where what has these
        weights varies with some spreads."""
        free = np.diag(1.0 * self.free)
        model = self.along(free)._model(weights, covariates, self.prior)
        lower, upper = self.ends
        size = len(lower)
        normal = model.parts(model.marginal(spreads**2)[0].sum(0))[0][:size, :size]
        squares, axes = np.linalg.eigh(normal)
        within = Bounded(np.zeros(size), lower, upper)
        confined = within.alone_limit(axes.T, np.sqrt(squares), np.ones(size))
        hidden = axes[:, confined]
        projection: Floats = (np.eye(size) - hidden @ hidden.T) @ free
        return projection

    def joined(
        self, weights: Mapping[str, Floats], covariates: Floats, spreads: Floats
    ) -> Population:
        """The mean of throws where what has these weights varies.

        Parameters
        ----------
        weights : of the parameters, by coefficient or combination.
        covariates : on which the mean depends, with mean zero, shape
            (throws, covariates).
        spreads : standard deviations between throws, from which better ones
            are searched.
        """
        model = self._model(weights, covariates, self.prior)
        variances = model.variances(spreads**2) if len(spreads) else spreads
        fit = of_data = MixedFit(model, variances, *self.ends, self.cut)
        if self.prior is not None:
            rows, target = self.prior
            of_cut = rows[self.cut > 0], target[self.cut > 0]
            of_data = replace(fit, model=self._model(weights, covariates, of_cut))
        return Population(
            fit, self.reference, self.typical, self.bounds, dict(weights), of_data
        )

    def _model(
        self,
        weights: Mapping[str, Floats],
        covariates: Floats,
        prior: tuple[Floats, Floats] | None,
    ) -> MixedModel:
        weight_matrix = np.array([*weights.values()]).reshape(
            len(weights), len(self.typical)
        )
        directions: Any = np.linalg.pinv(weight_matrix * self.typical * self.free)
        rows = self.information.scaled
        target = (rows @ self.at[..., None])[..., 0] - self.information.residual
        return MixedModel.of(rows, target, directions, covariates, prior)


def vary(
    throws: Together,
    weights: Mapping[str, Floats],
    guess: Floats,
    untold: Mapping[str, Normal],
) -> tuple[Population, Solution, Information]:
    """The mean of throws and their deviations from it; the throws at their own
    coefficients; and what the others say of the coefficients of each.

    Throws are linearised at equal coefficients and then, a few times, at those that
    the mixed model expects of each (Lindstrom and Bates 1990, Biometrics 46, 673).
    Sigmas that were estimated are estimated again as the throws come to their
    own coefficients.

    Parameters
    ----------
    weights : of the parameters in common in what varies, by expression.
    guess : standard deviations between throws.
    untold : priors of parameters in common of which the throws tell nothing.
    """
    tasks = throws.tasks
    solution = throws.solution
    common = throws.common
    typical = tasks.typical[common]
    reference = solution.values[0, common]
    covariates = throws.covariates.values
    names = throws.stack.requests[0].parameters.names_where(common)
    deviations = [untold[name].sd if name in untold else 0.0 for name in names]
    cut = (np.array(deviations) / typical) ** 2
    centre = reference
    projection = None
    for linearization in itertools.count():
        solution = throws.stack.with_own_sigma(solution)
        marginal = marginal_of(throws, solution)
        linear = _about(throws, marginal.information, centre, cut)
        if projection is None:
            projection = linear.projection(weights, covariates, guess)
        linear = linear.along(projection)
        population = linear.joined(weights, covariates, guess)
        fit = population.fit
        centre = reference + typical * fit.estimate[: len(typical)]
        rows_of_others = _rows(*fit.predicted_by_others(), linear.at, fit.model.null)
        rows = np.concatenate([linear.information.rows, rows_of_others], 1)
        lower, upper = linear.ends
        move = _moves(rows, fit.model.null, lower - linear.at, upper - linear.at)
        off = np.linalg.norm((rows[..., :-1] @ move[..., None])[..., 0], axis=1).max()
        if off < _SETTLED or linearization == _AGAIN:
            break
        move *= min(1.0, _LARGE / np.abs(move).max())
        steps = marginal.follow @ (typical * move)[..., None]
        values = solution.values + steps[..., 0]
        values = _inside(values, tasks.typical, tasks.lower, tasks.upper)
        solution = at_coefficients(throws, values)
    ended = np.full(len(solution.values), off < _ENDED)
    of_others = replace(linear.information, rows=rows_of_others)
    return population, solution._replace(success=ended), of_others


def _about(
    throws: Together, information: Information, centre: Floats, cut: Floats
) -> LinearizedThrows:
    """Throws of which this is known of the parameters in common, with their priors
    about the mean `centre`; those of what is cut hold it while the rest is estimated.
    """
    tasks = throws.tasks
    common = throws.common
    typical = tasks.typical[common]
    reference = throws.solution.values[0, common]
    prior = None
    penalty = tasks.penalty.at((0, common))
    if penalty.informative:
        off, slope = penalty.residual_and_slope(centre)
        sharper = np.where(cut > 0, _SHARPER, 1.0)
        of_prior = np.diag(sharper * slope * typical)
        prior = of_prior, of_prior @ ((centre - reference) / typical) - sharper * off
    return LinearizedThrows(information, reference, prior, cut)


def at_coefficients(throws: Together, values: Floats) -> Solution:
    """The optima of throws at coefficients that they are given.

    Parameters
    ----------
    values : of each throw, with its initial state nearby.
    """
    tasks = throws.tasks._replace(penalty=_of_throws(throws))
    start = np.clip(values, tasks.lower, tasks.upper)
    lower = np.where(throws.common, start, tasks.lower)
    upper = np.where(throws.common, start, tasks.upper)
    tasks = tasks._replace(start=start, lower=lower, upper=upper)
    batch = side_by_side(len(values))
    return minimize_many(throws.stack.model, tasks, batch, _STEPS)


def _of_throws(throws: Together) -> Penalty:
    """The priors of what throws do not have in common."""
    penalty = throws.tasks.penalty
    return penalty._replace(weight=penalty.weight * ~throws.common)


def marginal_of(throws: Together, solution: Solution) -> Marginal:
    """What throws say of what they have in common, near their optima, with the priors
    of their other parameters."""
    information = throws.information(solution)
    priors = _of_throws(throws).rows(information.values)
    return information.with_rows(priors).marginal(throws.common)


def _moves(rows: Floats, null: Floats, lower: Floats, upper: Floats) -> Floats:
    """Steps of throws to the least squares of rows, with the residual as the last
    column, within bounds."""
    size = len(null)
    held = np.broadcast_to(
        np.pad(null.T, ((0, 0), (0, 1))), (len(rows), null.shape[1], size + 1)
    )
    factor = r_factor(np.concatenate([rows, held], -2))[:, :size]
    root = factor[..., :-1]
    moves: Any = np.linalg.solve(root, -factor[..., -1:])[..., 0]
    for row in np.flatnonzero(((moves < lower) | (moves > upper)).any(1)):
        moves[row] = bounded(
            moves[row], root[row], np.eye(size), lower[row], upper[row]
        )
    return moves


def _inside(values: Floats, typical: Floats, lower: Floats, upper: Floats) -> Floats:
    """Values within their bounds, and at these where only rounding is between."""
    raised = np.where(values < lower + _AT * typical, lower, values)
    return np.where(raised > upper - _AT * typical, upper, raised)


def _rows(mean: Floats, matrix: Floats, at: Floats, null: Floats) -> Floats:
    """Rows whose squares are the quadratic of normal densities of parameters, at
    some values, with the residual as the last column; nothing is known along the
    null directions."""
    squares, axes = np.linalg.eigh(matrix)
    rows = axes.mT / np.sqrt(np.maximum(squares, _EXACT))[..., None]
    rows = rows - (rows @ null) @ null.T
    return np.concatenate([rows, rows @ (at - mean)[..., None]], -1)
