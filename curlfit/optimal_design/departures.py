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

from curlfit.inference.fit.covariance import Covariance, first_order
from curlfit.inference.fit.departures import (
    NO_DEPARTURES,
    Departures,
    Probe,
    departures_along,
    probes_about,
    to_be_held,
)
from curlfit.inference.fit.factors import Factors, combined
from curlfit.inference.fit.ridge import (
    Followed,
    Hold,
    Point,
    Ridge,
    follow,
)
from curlfit.inference.identifiability import Bounded, r_factor
from curlfit.inference.initial_values import default_guess
from curlfit.inference.joint.solver import JOINT, minimize_jointly
from curlfit.inference.least_squares import (
    ALONG_RIDGE,
    Solution,
    Tasks,
    minimize_many,
)
from curlfit.inference.likelihood import linearize, whitened_residuals_of_many
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.batches import FEW, in_batches, stacked, unstacked
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    apart_from,
    exact_problems,
)

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
    problems = _plans(exact, plans)
    covariances = [problem.covariance for problem in problems]
    probes_by_plan = [
        probes_about(covariance, problem.bounded)
        for covariance, problem in zip(covariances, problems, strict=True)
    ]
    held = []
    for problem, covariance, probes, rises in zip(
        problems,
        covariances,
        probes_by_plan,
        _rises(problems, probes_by_plan),
        strict=True,
    ):
        pairs = zip(probes, rises, strict=True)
        departing = [probe for probe, rise in pairs if probe.departs(rise)]
        held.append(problem.held(covariance, departing))
    due = [number for number, indices in enumerate(held) if indices]
    followed = []
    for number in due:
        errors = {index: covariances[number].error_of(index) for index in held[number]}
        followed.append(problems[number].followed(errors))
    problems_due = [problems[number] for number in due]
    ridges = follow(followed, lambda holds: _refitted(problems_due, holds))
    departures = [NO_DEPARTURES] * len(plans)
    items = [item for item in exact.law.coefficients() if item.name in exact.names]
    usual = np.array([default_guess(item) for item in items])
    for number, ridge in zip(due, ridges, strict=True):
        of_coefficients = problems[number].ridge_of_coefficients(ridge)
        factor = combined(*exact.factors(plans[number]))
        covariance = _covariance_of_coefficients(exact, factor)
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


def _covariance_of_coefficients(assumed: Assumptions, factor: Floats) -> Covariance:
    """What an R factor of information, in typical sizes, says of the free
    coefficients to first order."""
    rows = np.column_stack([factor / assumed.typical, np.zeros(len(factor))])
    factors = Factors.of(rows, assumed.bounded, assumed.typical)
    return first_order(assumed.names, factors, assumed.bounded, assumed.typical)


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
    def common(self) -> Booleans:
        """Which parameters of a throw are coefficients."""
        count = len(self.assumed.values)
        return np.arange(len(self.assumed.parameters)) < count

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """Places of the parameters of each throw among those of the plan, of shape
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
        return Bounded(*map(self.joined, self.of_throws))

    @cached_property
    def typical(self) -> Floats:
        """Typical sizes of these."""
        sizes = np.broadcast_to(self.assumed.parameters.typical, self.index.shape)
        return self.joined(sizes)

    @property
    def names(self) -> list[str]:
        """Names of the parameters of the plan: those of a fit, if it is one throw."""
        names = self.assumed.parameters.names
        if len(self.jacobian) == 1:
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
        for of_throw, factor, index in zip(slopes, of_throws, self.index, strict=True):
            of_throw[:, index] = factor
        return r_factor(slopes.reshape(-1, len(self.typical)))

    @cached_property
    def covariance(self) -> Covariance:
        """What the plan says of all its parameters to first order."""
        rows = np.column_stack([self.slopes, np.zeros(len(self.slopes))])
        factors = Factors.of(rows, self.bounded, self.typical)
        return first_order(self.names, factors, self.bounded, self.typical)

    def held(self, covariance: Covariance, departing: Sequence[Probe]) -> list[int]:
        """The parameters along which the ridge is to be followed, as in a fit; of
        several throws only coefficients, which all of them depend on."""
        count = int(self.common.sum())
        indices = to_be_held(covariance, departing, count)
        if len(self.jacobian) == 1:
            return indices
        coefficients = [index for index in indices if index < count]
        if indices and not coefficients:
            return np.flatnonzero(covariance.open[:count]).tolist()
        return coefficients

    def followed(self, errors: dict[int, float]) -> Followed:
        """The plan as a fit whose ridge is to be followed.

        Parameters
        ----------
        errors : of the parameters to be held, by index.
        """
        optimum = Point(self.bounded.values, self.slopes, 0.0)
        return Followed(
            optimum, self.bounded.lower, self.bounded.upper, self.typical, errors
        )

    def task(self, hold: Hold) -> Tasks:
        """The problem with a parameter held at the value of the start."""
        lower = np.array(self.bounded.lower)
        upper = np.array(self.bounded.upper)
        lower[hold.parameter] = upper[hold.parameter] = hold.start[hold.parameter]
        start = hold.start[self.index]
        typical = self.assumed.parameters.typical
        bounds = lower[self.index], upper[self.index]
        return Tasks(self.problems, start, *bounds, typical, self.chi_squared_of_noise)

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
        places = {index: place for place, index in enumerate(free)}
        return Ridge(
            self._of_coefficients(ridge.optimum),
            tuple(map(self._of_coefficients, ridge.points)),
            ridge.rises,
            {
                places[index]: interval
                for index, interval in ridge.intervals.items()
                if index in places
            },
        )

    def _of_coefficients(self, point: Point) -> Point:
        """A point in the free coefficients; the slopes are those that no change of the
        initial states makes up for."""
        free = self.assumed.free
        moving = self.bounded.upper > self.bounded.lower
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
    problems, values = exact_problems(assumed, throws)
    jacobians = in_batches(
        lambda *batch: linearize(assumed.model, *batch)[1], (values, problems), FEW
    )
    lower, upper = _bounds(assumed, values)
    made = []
    for plan in plans:
        counts = Counter(plan)
        rows = np.array([throws.index(throw) for throw in counts])
        more = np.sqrt([*counts.values()])[:, None, None]
        of_plan = jax.tree.map(lambda leaf, rows=rows: leaf[rows], problems)
        of_plan = of_plan._replace(weight=of_plan.weight * more)
        jacobian = jacobians[rows] * more[..., None]
        of_throws = Bounded(values[rows], lower[rows], upper[rows])
        made.append(_Plan(assumed, of_plan, jacobian, of_throws))
    return made


def _bounds(assumed: Assumptions, values: Floats) -> tuple[Floats, Floats]:
    """Bounds of the parameters of throws as in a fit, shape (throws, parameters); none
    where an assumed value lies beyond."""
    parameters = assumed.parameters_of_fit
    lower = np.where(values >= parameters.lower, parameters.lower, -np.inf)
    upper = np.where(values <= parameters.upper, parameters.upper, np.inf)
    fixed = np.ones(len(parameters), bool)
    fixed[[*assumed.free, *assumed.state]] = False
    return np.where(fixed, values, lower), np.where(fixed, values, upper)


def _rises(
    plans: Sequence[_Plan], probes_by_plan: Sequence[Sequence[Probe]]
) -> list[list[float]]:
    """Chi squared of each plan at its probes."""
    pairs = [
        (plan, probe)
        for plan, probes in zip(plans, probes_by_plan, strict=True)
        for probe in probes
    ]
    if not pairs:
        return [[] for _ in plans]
    values = np.concatenate([probe.point[plan.index] for plan, probe in pairs])
    problems = jax.tree.map(
        lambda *leaves: np.concatenate(leaves), *[plan.problems for plan, _ in pairs]
    )
    model = plans[0].assumed.model
    residuals = whitened_residuals_of_many(model, values, problems, FEW)
    of_throws = (np.nan_to_num(residuals, nan=np.inf) ** 2).sum((1, 2))
    rises = iter(of_throws.tolist())
    return [
        [sum(itertools.islice(rises, len(plan.jacobian))) for _ in probes]
        for plan, probes in zip(plans, probes_by_plan, strict=True)
    ]


def _refitted(plans: Sequence[_Plan], holds: Sequence[Hold]) -> list[Point]:
    """Refits of plans with a parameter held: those of single throws side by side, those
    of several throws one after another."""
    solutions: dict[int, Solution] = {}
    tasks = [plans[hold.fit].task(hold) for hold in holds]
    alone = [number for number, task in enumerate(tasks) if len(task.start) == 1]
    if alone:
        stack = jax.tree.map(
            lambda *leaves: np.concatenate(leaves),
            *[tasks[number]._replace(typical=np.zeros(0)) for number in alone],
        )
        stack = stack._replace(typical=tasks[alone[0]].typical)
        model = plans[0].assumed.model
        together = minimize_many(model, stack, FEW, _STEPS, ALONG_RIDGE)
        for number, solution in zip(alone, unstacked(together), strict=True):
            solutions[number] = stacked([solution])
    for number, (hold, task) in enumerate(zip(holds, tasks, strict=True)):
        if number not in solutions:
            plan = plans[hold.fit]
            how = JOINT._replace(most=_STEPS)
            solutions[number] = minimize_jointly(
                plan.assumed.model, task, plan.common, how=how
            )
    return [
        plans[hold.fit].point(solutions[number], hold.parameter)
        for number, hold in enumerate(holds)
    ]
