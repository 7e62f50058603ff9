"""Whether what planned throws are expected to determine holds off the tangent too.

The information of a plan is that of first order. What a fit of these throws would say
is found as in a fit, here for data without noise: chi squared is compared with its
quadratic (`probes_about`), and where it departs from that the ridge is followed
(`curlfit.inference.fit.ridge`) with the initial states of the throws refitted.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.departures import (
    NO_DEPARTURES,
    Departures,
    Probe,
    departures_along,
    probes_about,
    to_be_held,
)
from curlfit.inference.fit.ridge import (
    Followed,
    Hold,
    Point,
    Ridge,
    follow,
)
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.directions import apart_from, r_factor
from curlfit.inference.information.information import Information
from curlfit.inference.model.likelihood import linearize, whitened_residuals_of_many
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import Problem
from curlfit.inference.solve.initial_values import default_guess
from curlfit.inference.solve.least_squares import (
    ALONG_RIDGE,
    Solution,
    Tasks,
    minimize_many,
)
from curlfit.inference.together.solver import JOINT, minimize_jointly
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.batches import FEW, in_batches, stacked, unstacked
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    exact_problems,
    vectors_of,
)
from curlfit.optimal_design.selection import combined

_STEPS = 24
"""Of a refit: 19 of 20 refits of power+transverse without an angle end within them, and
the others slide along its ridge by a few hundredths of chi squared."""
_FAR = 1e12
"""m/s: a pull of a few 1e-10 on the speed, in the unit of half chi squared."""


def expected_departures(
    assumed: Assumptions, plans: Sequence[Sequence[PlannedThrow]]
) -> list[Departures]:
    """What does not hold of what each of several plans determines to first order of the
    free coefficients.

    A discrepancy of the law widens errors, but bends nothing: departures are those of
    the exact law.

    Parameters
    ----------
    plans : the throws of each, repeated for repeated throws.
    """
    exact = assumed.by_load[assumed.load]
    coefficients = [
        coefficient
        for coefficient in exact.law.coefficients()
        if coefficient.name in exact.names
    ]
    usual = np.array([default_guess(coefficient) for coefficient in coefficients])
    problems = _plans(exact, plans)
    ridge_numbers = []
    ridge_plans = []
    ridge_starts = []
    for number, (plan, rises) in enumerate(
        zip(problems, _rises(problems), strict=True)
    ):
        held = plan.held(rises)
        if held:
            ridge_numbers.append(number)
            ridge_plans.append(plan)
            ridge_starts.append(plan.followed(held))
    ridges = follow(ridge_starts, lambda holds: _refitted(ridge_plans, holds))
    departures = [NO_DEPARTURES] * len(plans)
    for number, plan, ridge in zip(ridge_numbers, ridge_plans, ridges, strict=True):
        factor = combined(exact.factors(plans[number]))
        covariance = Covariance.of(exact.information(factor))
        of_coefficients = plan.ridge_of_coefficients(ridge)
        departures[number] = departures_along(covariance, of_coefficients, usual)
    return departures


def errors_along(
    assumed: Assumptions,
    factor: Floats,
    quantities: Mapping[str, Mapping[str, float]],
    departures: Departures,
) -> dict[str, float | None]:
    """Standard errors of combinations of coefficients by name, along the ridge of the
    throws; None where they do not determine one, or no better than its bounds do.

    Parameters
    ----------
    factor : R factor of the information of the throws, in typical sizes.
    quantities : weights of the coefficients.
    """
    errors = assumed.errors(factor, quantities)
    along = {}
    for name, error in errors.items():
        weights = assumed.weights(quantities[name]) / assumed.typical
        if error is not None:
            error = departures.error_along(weights, error, assumed.typical)
        along[name] = error
    return assumed.within_bounds(along, quantities)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Planned throws without noise as one problem, whose parameters are the
    coefficients, which the throws have in common, and then the initial state of each
    throw."""

    assumed: Assumptions
    problems: Problem
    """of its different throws, along the first axis; one that is repeated has larger
    weights"""
    jacobian: Floats
    """of the weighted residuals, shape (throws, channels, n, parameters of a throw)"""
    of_throws: Bounded
    """values and bounds, shape (throws, parameters of a throw)"""

    @property
    def is_single(self) -> bool:
        """Whether it is one throw, made once or repeated."""
        return len(self.jacobian) == 1

    @property
    def common(self) -> Booleans:
        """Which parameters of a throw are coefficients."""
        count = len(self.assumed.values)
        return np.arange(len(self.assumed.parameters)) < count

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """Indices of the parameters of each throw among those of the plan, of shape
        (throws, parameters of a throw)."""
        index: NDArray[np.intp] = Blocks.of(self.common, len(self.jacobian)).index
        return index

    def joined(self, values: Floats) -> Floats:
        """Values of the parameters of throws as those of the plan."""
        of_throws = values[:, ~self.common].ravel()
        return np.concatenate([values[0, self.common], of_throws])

    @property
    def bounded(self) -> Bounded:
        """Values and bounds of the parameters of the plan."""
        return Bounded(
            self.joined(self.of_throws.values),
            self.joined(self.of_throws.lower),
            self.joined(self.of_throws.upper),
        )

    @cached_property
    def typical(self) -> Floats:
        """Typical sizes of the parameters of the plan."""
        sizes = np.broadcast_to(self.assumed.parameters.typical, self.index.shape)
        return self.joined(sizes)

    @property
    def names(self) -> list[str]:
        """Names of the parameters of the plan: those of a fit, if it is one throw."""
        names = self.assumed.parameters.names
        if self.is_single:
            return list(names)
        throws = range(1, len(self.jacobian) + 1)
        state = list(itertools.compress(names, ~self.common))
        of_throws = [f"{name} of throw {throw}" for throw in throws for name in state]
        return [*itertools.compress(names, self.common), *of_throws]

    @cached_property
    def slopes(self) -> Floats:
        """R factor of the derivatives of the weighted residuals of all throws."""
        return self._slopes(self.jacobian)

    def _slopes(self, jacobian: Floats) -> Floats:
        count, channels, rows, width = jacobian.shape
        of_throws = r_factor(jacobian.reshape(count, channels * rows, width))
        slopes = np.zeros((count, of_throws.shape[1], len(self.typical)))
        for throw, factor in enumerate(of_throws):
            slopes[throw][:, self.index[throw]] = factor
        return r_factor(slopes.reshape(-1, len(self.typical)))

    @cached_property
    def covariance(self) -> Covariance:
        """What the plan says of all its parameters to first order."""
        residual = np.zeros(len(self.slopes))
        information = Information.of(
            self.names, self.bounded, self.typical, self.slopes, residual
        )
        return Covariance.of(information)

    @cached_property
    def probes(self) -> list[Probe]:
        """Where chi squared is compared with its quadratic."""
        return probes_about(self.covariance)

    def held(self, rises: Sequence[float]) -> list[int]:
        """The parameters along which the ridge is to be followed, as in a fit; of
        several throws only coefficients, which all of them depend on.

        Parameters
        ----------
        rises : chi squared at the probes.
        """
        probes = [
            probe.with_rise(rise)
            for probe, rise in zip(self.probes, rises, strict=True)
        ]
        count = int(self.common.sum())
        indices = to_be_held(self.covariance, probes, count)
        if self.is_single:
            return indices
        coefficients = [index for index in indices if index < count]
        if indices and not coefficients:
            return np.flatnonzero(self.covariance.open[:count]).tolist()
        return coefficients

    def followed(self, indices: Sequence[int]) -> Followed:
        """The plan as a fit whose ridge is to be followed, with the parameters to be
        held."""
        optimum = Point(self.bounded.values, self.slopes, 0.0)
        errors = {index: self.covariance.error_of(index) for index in indices}
        return Followed(
            optimum, self.bounded.lower, self.bounded.upper, self.typical, errors
        )

    def task(self, hold: Hold) -> Tasks:
        """The problem with a parameter held at the value of the start."""
        lower = np.array(self.bounded.lower)
        upper = np.array(self.bounded.upper)
        lower[hold.parameter] = hold.start[hold.parameter]
        upper[hold.parameter] = hold.start[hold.parameter]
        return Tasks(
            self.problems,
            start=hold.start[self.index],
            lower=lower[self.index],
            upper=upper[self.index],
            typical=self.assumed.parameters.typical,
            penalty=self.chi_squared_of_noise,
        )

    @property
    def chi_squared_of_noise(self) -> Penalty:
        """What noise adds to chi squared, wherever the parameters are, as a prior of
        the speed that is so far away that it hardly pulls: a search ends where a step
        gains a small share of chi squared, of which exact data have nearly none."""
        penalty = Penalty.none(*self.index.shape)
        speed = self.assumed.parameters.index("v0")
        number = (self.problems.weight > 0).sum((1, 2))
        penalty.location[:, speed] = _FAR
        penalty.weight[:, speed] = np.sqrt(number) / _FAR
        return penalty

    def point(self, solution: Solution, held: int) -> Point:
        """The optimum of the throws, along the first axis, with a parameter held."""
        slopes = self._slopes(np.asarray(solution.jacobian))
        chi_squared = float(solution.chi_squared.sum())
        return Point(self.joined(solution.values), slopes, chi_squared, held)

    def ridge_of_coefficients(self, ridge: Ridge) -> Ridge:
        """The ridge in the free coefficients, whatever the initial states."""
        free = self.assumed.free.tolist()
        return Ridge(
            self._of_coefficients(ridge.optimum),
            tuple(self._of_coefficients(point) for point in ridge.points),
            ridge.rises,
            {
                free.index(index): interval
                for index, interval in ridge.intervals.items()
                if index in free
            },
        )

    def _of_coefficients(self, point: Point) -> Point:
        """A point in the free coefficients; the slopes are those that no change of the
        initial states makes up for."""
        free = self.assumed.free
        moving = self.bounded.free
        moving[: len(self.assumed.values)] = False
        held = None
        if point.held is not None:
            moving[point.held] = False
            if point.held in free:
                held = free.tolist().index(point.held)
        scaled = point.slopes * self.typical
        slopes = apart_from(scaled[:, moving], scaled[:, free])
        of_coefficients = r_factor(slopes) / self.assumed.typical
        return Point(point.values[free], of_coefficients, point.chi_squared, held)


def _plans(
    assumed: Assumptions, plans: Sequence[Sequence[PlannedThrow]]
) -> list[_Plan]:
    """Plans with the data that their throws would give without noise."""
    throws = list(dict.fromkeys(itertools.chain(*plans)))
    problems = exact_problems(assumed, throws)
    values = vectors_of(assumed, throws)
    jacobians = in_batches(
        lambda *batch: linearize(assumed.model, *batch)[1], (values, problems), FEW
    )
    bounded = _bounded(assumed, values)
    planned = []
    for plan in plans:
        counts = Counter(plan)
        rows = np.array([throws.index(throw) for throw in counts])
        # a throw made n times has residuals of sqrt(n) times the weight
        repeated = np.sqrt([*counts.values()])[:, None, None]
        of_plan = jax.tree.map(lambda leaf, rows=rows: leaf[rows], problems)
        of_plan = of_plan._replace(weight=of_plan.weight * repeated)
        jacobian = jacobians[rows] * repeated[..., None]
        of_throws = Bounded(
            bounded.values[rows], bounded.lower[rows], bounded.upper[rows]
        )
        planned.append(_Plan(assumed, of_plan, jacobian, of_throws))
    return planned


def _bounded(assumed: Assumptions, values: Floats) -> Bounded:
    """Values and bounds of the parameters of throws as in a fit, shape (throws,
    parameters); no bounds where an assumed value lies beyond."""
    parameters = assumed.parameters_of_fit
    lower = np.where(values >= parameters.lower, parameters.lower, -np.inf)
    upper = np.where(values <= parameters.upper, parameters.upper, np.inf)
    fixed = np.ones(len(parameters), bool)
    fixed[[*assumed.free, *assumed.state]] = False
    return Bounded(
        values, np.where(fixed, values, lower), np.where(fixed, values, upper)
    )


def _rises(plans: Sequence[_Plan]) -> list[list[float]]:
    """Chi squared of each plan at its probes."""
    points = []
    problems_at_points = []
    for plan in plans:
        for probe in plan.probes:
            points.append(probe.point[plan.index])
            problems_at_points.append(plan.problems)
    if not points:
        return [[] for _ in plans]
    # all throws of all plans at all probes side by side
    problems = jax.tree.map(lambda *leaves: np.concatenate(leaves), *problems_at_points)
    model = plans[0].assumed.model
    values = np.concatenate(points)
    residuals = whitened_residuals_of_many(model, values, problems, FEW)
    of_throws = (np.nan_to_num(residuals, nan=np.inf) ** 2).sum((1, 2))
    chi_squared = iter(of_throws.tolist())
    rises_by_plan = []
    for plan in plans:
        rises = []
        for _ in plan.probes:
            rises.append(sum(next(chi_squared) for _ in plan.jacobian))
        rises_by_plan.append(rises)
    return rises_by_plan


def _refitted(plans: Sequence[_Plan], holds: Sequence[Hold]) -> list[Point]:
    """Refits of plans with a parameter held: those of single throws side by side, those
    of several throws one after another."""
    model = plans[0].assumed.model
    tasks = [plans[hold.fit].task(hold) for hold in holds]
    single = [number for number, hold in enumerate(holds) if plans[hold.fit].is_single]
    solutions: dict[int, Solution] = {}
    if single:
        # typical sizes are the same for all, and have no axis of problems
        stack = jax.tree.map(
            lambda *leaves: np.concatenate(leaves),
            *[tasks[number]._replace(typical=np.zeros(0)) for number in single],
        )
        stack = stack._replace(typical=tasks[single[0]].typical)
        side_by_side = minimize_many(model, stack, FEW, _STEPS, ALONG_RIDGE)
        for number, solution in zip(single, unstacked(side_by_side), strict=True):
            solutions[number] = stacked([solution])
    points = []
    for number, hold in enumerate(holds):
        plan = plans[hold.fit]
        if not plan.is_single:
            solutions[number] = minimize_jointly(
                model, tasks[number], plan.common, how=JOINT._replace(most=_STEPS)
            )
        points.append(plan.point(solutions[number], hold.parameter))
    return points
