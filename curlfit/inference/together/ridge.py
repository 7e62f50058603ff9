"""The ridge of throws that are fitted together: values of what they have in common that
fit all of them about as well as their optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.fit.departures import Departures, departures_together
from curlfit.inference.fit.ridge import Followed, Hold, Point, Ridge, follow
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.ridge_information import demanded_errors
from curlfit.inference.model.parameters import START_INDEX
from curlfit.inference.solve.initial_values import default_guess
from curlfit.inference.solve.least_squares import Solution
from curlfit.inference.together.draw import DRAW, Draw
from curlfit.inference.together.population import Together
from curlfit.inference.together.solver import JOINT, minimize_jointly
from curlfit.numerics.arrays import Booleans, Floats

_REFIT = JOINT._replace(most=60)
"""As many steps as a refit of one throw along its ridge."""
_DRAWN = 16
"""Points of the ridge at most at which a draw is computed."""


@dataclass(frozen=True, eq=False)
class _Refit:
    """The optimum of all throws, or that with a parameter in common held."""

    solution: Solution
    information: Information
    """what each throw says with its own priors"""
    marginal: Marginal
    """of the parameters in common"""
    of_common: Floats
    """rows of the priors of what they have in common, which count once"""
    chi_squared: float
    """with what the priors add to it"""
    held: int | None
    """index of the parameter that is held"""

    @classmethod
    def of(cls, together: Together, solution: Solution, held: int | None) -> Self:
        tasks = together.tasks
        common = together.common
        values = np.asarray(solution.values)
        priors = tasks.penalty.rows(values)
        information = together.information(solution)
        information = information.with_rows(priors * ~common[:, None])
        marginal = information.marginal(common)
        penalty = tasks.penalty.at(0)
        shared = penalty._replace(weight=penalty.weight * common)
        of_throws = tasks.penalty._replace(weight=tasks.penalty.weight * ~common)
        of_priors = of_throws.chi_squared(values).sum() + shared.chi_squared(values[0])
        chi_squared = float(solution.chi_squared.sum() + of_priors)
        of_common = priors[0] * common[:, None]
        return cls(solution, information, marginal, of_common, chi_squared, held)

    @cached_property
    def _others(self) -> Information:
        """What the other throws say of the parameters in common, for each."""
        return self.marginal.information.of_others()

    def of_throw(self, row: int) -> Point:
        """The point among the parameters of a throw, with what the others say."""
        information = self.information.at(row) + self._others.at(row)
        information = information.with_rows(self.of_common)
        values = information.values
        return Point(values, information.slopes, self.chi_squared, self.held)

    def in_common(self) -> Point:
        """The point among the parameters in common."""
        common = self.marginal.common
        of_common = self.of_common[:, np.append(common, True)]
        information = self.marginal.information.together().with_rows(of_common)
        held = self.held
        if held is not None:
            held = int(common[:held].sum())
        return Point(information.values, information.slopes, self.chi_squared, held)

    def near(self, values: Floats) -> Floats:
        """Initial values of all throws for some values of what they have in common,
        where the tangent here leads."""
        common = self.marginal.common
        step = values - self.solution.values[0, common]
        starts = self.solution.values + self.marginal.follow @ step
        return np.asarray(starts)


class JointRidge(NamedTuple):
    """The ridge of throws that are fitted together."""

    in_common: Ridge
    """among the parameters in common"""
    of_throws: list[Ridge]
    """among the parameters of each throw"""
    usual: Floats
    """coefficients of the law where nothing is known, of those in common"""

    def departures(self, covariance: Covariance) -> Departures:
        """What the ridge makes of what throws say of the parameters in common."""
        return departures_together(covariance, self.in_common, self.usual)


def errors_of_draw(ridge: JointRidge, draw: Draw, common: Booleans) -> dict[str, float]:
    """Errors of the quantities of a draw to the tee with the usual angle, by how far
    they move along the ridge: at each of its points by the coefficients and spins of
    that point."""
    optima = [of_throw.optimum for of_throw in ridge.of_throws]
    centre = _drawn(optima, draw, common)
    errors = np.zeros(len(DRAW))
    rises = ridge.in_common.rises
    stride = -(-len(rises) // _DRAWN) or 1
    for number in range(0, len(rises), stride):
        points = [of_throw.points[number] for of_throw in ridge.of_throws]
        moved = np.abs(_drawn(points, draw, common) - centre)
        errors = np.maximum(errors, demanded_errors(moved, rises[number]))
    return dict(zip(DRAW, errors.tolist(), strict=True))


def _drawn(points: Sequence[Point], draw: Draw, common: Booleans) -> Floats:
    """Quantities of a draw that turns as throws usually do, a point of each throw."""
    values = np.array([point.values for point in points])
    spins = values[:, START_INDEX["omega0"]]
    angle = draw.usual_angle(values[:, common], spins)
    return draw.quantities(values[:1, common], angle)[0]


def follow_jointly(
    together: Together, solution: Solution, stderr: Mapping[int, float]
) -> JointRidge:
    """Follow the ridge of throws from their optimum.

    Parameters
    ----------
    stderr : of the parameters in common that are to be held, by index among those of a
        throw; infinite where nothing is known.
    """
    tasks = together.tasks
    common = together.common
    typical = tasks.typical[common]
    columns = np.flatnonzero(common)  # of what is in common, among all parameters
    refits = [_Refit.of(together, solution, None)]
    points = [refits[0].in_common()]

    def refit(holds: Sequence[Hold]) -> list[Point]:
        first = len(points)
        for hold in holds:
            index = int(columns[hold.parameter])
            distances = [
                np.abs(
                    (known_refit.solution.values[0, common] - hold.start) / typical
                ).max()
                for known_refit in refits
            ]
            nearest = refits[int(np.argmin(distances))]
            start = np.clip(nearest.near(hold.start), tasks.lower, tasks.upper)
            lower = np.array(tasks.lower)
            upper = np.array(tasks.upper)
            start[:, index] = hold.start[hold.parameter]
            lower[:, index] = start[:, index]
            upper[:, index] = start[:, index]
            held = tasks._replace(start=start, lower=lower, upper=upper)
            model = together.stack.model
            optimum = minimize_jointly(model, held, common, how=_REFIT)
            refits.append(_Refit.of(together, optimum, index))
            points.append(refits[-1].in_common())
        return points[first:]

    bounds = tasks.lower[0, common], tasks.upper[0, common]
    errors = {int(common[:index].sum()): error for index, error in stderr.items()}
    followed = Followed(points[0], *bounds, typical, errors)
    (ridge,) = follow([followed], refit)
    refit_by_point = {
        id(point): refit_of_all
        for point, refit_of_all in zip(points, refits, strict=True)
    }
    refits_along = [refit_by_point[id(point)] for point in ridge.points]
    intervals = {
        int(columns[parameter]): interval
        for parameter, interval in ridge.intervals.items()
    }
    of_throws = [
        Ridge(
            refits[0].of_throw(row),
            tuple(refit_of_all.of_throw(row) for refit_of_all in refits_along),
            ridge.rises,
            intervals,
        )
        for row in range(len(tasks.start))
    ]
    coefficients = together.stack.model.law.coefficients()
    usual = [
        default_guess(coefficient)
        for coefficient, is_common in zip(coefficients, common, strict=False)
        if is_common
    ]
    return JointRidge(ridge, of_throws, np.array(usual))
