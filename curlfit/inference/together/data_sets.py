"""One law and several data sets: its coefficients that all have in common, and
those of each.

All data sets are one problem (`curlfit.inference.together.solver`), in which those that
are left out have no weight, so that one program serves all of them and all laws of a
family. A table of friction takes the place of a throw whose initial state is fixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError, UnusableFitError, require_kind
from curlfit.foreign import file_and_number
from curlfit.friction import Law, Load, no_motion_because
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.advice import NOISE
from curlfit.inference.fit.departures import (
    NO_DEPARTURES,
    Departures,
    departures_along,
    probes_about,
    to_be_held,
)
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.problems import bounds_of
from curlfit.inference.fit.residuals import residual_sigma
from curlfit.inference.fit.revisions import revisions
from curlfit.inference.fit.ridge import Followed, Hold, Point, follow
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.directions import visible
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import options_of
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import (
    ROWS_OF_DATA,
    Problem,
    problem_shape,
    shape_of_all,
)
from curlfit.inference.model.request import Request
from curlfit.inference.noise.independence import Independence
from curlfit.inference.solve.initial_values import default_guess
from curlfit.inference.solve.least_squares import (
    PRECISE,
    Indices,
    Solution,
    Tasks,
)
from curlfit.inference.together.solver import JOINT, minimize_jointly
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import at
from curlfit.settings.choices import Comparing, Fitting
from curlfit.sheet import LINES
from curlfit.throws.events import Event
from curlfit.throws.friction_table import FrictionTable
from curlfit.throws.throw import Throw

# multiples of the default coefficients, for a table of friction
_STARTS = 1.0, 0.4, 2.5
_ASIDE = 1.0  # m/s, initial speed of a throw that is left out, or of a table
_MOMENT = 1e-3  # of its times, since a path that comes to rest takes long
_FEWEST = 20  # residuals whose correlation is examined
_LAST = len(ROWS_OF_DATA) - 1  # row of events and of friction


class DataSet(NamedTuple):
    """A track, a table of throws by stopwatch, or a table of friction."""

    name: str
    throws: tuple[Throw, ...] = ()
    table: FrictionTable | None = None

    @property
    def kind(self) -> str:
        """What it is."""
        if self.table is not None:
            return "friction"
        return "track" if self.throws[0].has_path else "throws"


def data_sets(data: Iterable[Throw | FrictionTable]) -> list[DataSet]:
    """Throws and tables as data sets: timed throws of one file are one.

    Raises
    ------
    InputError : anything else than a throw or a table of friction, or none.
    """
    sets: dict[str, DataSet] = {}
    for part in data:
        require_kind(
            part, (Throw, FrictionTable), "data", "throws and tables of friction"
        )
        if isinstance(part, FrictionTable):
            data_set = DataSet(part.name, table=part)
        else:
            data_set = DataSet(part.name, (part,))
        name = part.name
        if data_set.kind == "throws":
            name, _ = file_and_number(name)
        while name in sets and not sets[name].kind == data_set.kind == "throws":
            name += "'"  # another of the same name
        earlier = sets[name].throws if name in sets else ()
        sets[name] = data_set._replace(name=name, throws=(*earlier, *data_set.throws))
    if not sets:
        raise InputError(
            "no data to compare laws with; expected throws or tables of friction"
        )
    return list(sets.values())


class Noise(NamedTuple):
    """Noise of the rows of data sets, by throw or table and channel."""

    sigma: Floats
    """smallest of a channel"""
    share: Floats
    """of independent values, where residuals are correlated from row to row"""
    assumed: Booleans
    """whether sigma is that of an ordinary tracker: a correlated residual that is
    smaller is what the law misses, and tells no noise"""


class LawOnSets:
    """One law on several data sets.

    Attributes
    ----------
    owner : number of the data set of each throw and, after these, of each table.
    unknown : by throw or table and channel, whether its sigma is estimated.
    """

    def __init__(
        self,
        law: type[Law],
        load: Load,
        sets: Sequence[DataSet],
        chosen: Comparing,
        family: type[LawFamily] | None = None,
    ) -> None:
        self.law = law
        self.sets = sets
        throws = [throw for data_set in sets for throw in data_set.throws]
        tables = [data_set.table for data_set in sets if data_set.table is not None]
        owners_of_throws = [
            number for number, data_set in enumerate(sets) for _ in data_set.throws
        ]
        owners_of_tables = [
            number for number, data_set in enumerate(sets) if data_set.table is not None
        ]
        self.owner = np.array([*owners_of_throws, *owners_of_tables])
        self.throws = len(throws)
        requests = _requests(law, load, throws or [_carrier()], chosen)
        parameters = requests[0].parameters
        coefficients = law.coefficients()
        self.common = np.isin(
            parameters.names, [coefficient.name for coefficient in coefficients]
        )
        self.names = parameters.names_where(self.common)
        self.model = Model(law, load).within(family)
        shapes = [problem_shape(request.throw) for request in requests]
        for table in tables:
            shapes.append((_LAST + 1, 1 << (len(table.mu) - 1).bit_length()))
        self.stack = ThrowStack(self.model, requests, shape=shape_of_all(shapes))
        # A table has the arrays of the last throw, which it fills with its own.
        every = np.minimum(np.arange(len(self.owner)), len(requests) - 1)
        problems = jax.tree.map(lambda leaf: np.array(leaf[every]), self.stack.problems)
        problems = _with_tables(problems, throws, tables)
        start = np.zeros((1, len(parameters)))
        if throws:
            _, sides = self.stack.starts()
            start = sides[0]
        start = start[every]
        self.speed = parameters.index("v0")
        usual = [default_guess(coefficient) for coefficient in coefficients]
        start[self.throws :, self.common] = usual
        start[self.throws :, self.speed] = _ASIDE
        lower, upper = (bound[every] for bound in bounds_of(requests, self.common))
        for bound in (lower, upper):
            bound[self.throws :, ~self.common] = start[self.throws :, ~self.common]
        start = np.clip(start, lower, upper)
        self.tasks = Tasks(
            problems,
            start,
            lower,
            upper,
            parameters.typical,
            Penalty.none(*start.shape),
        )
        self.unknown = np.zeros(problems.weight.shape[:2], bool)
        self.unknown[: self.throws] = self.stack.unknown[: self.throws]
        for row, table in enumerate(tables, self.throws):
            self.unknown[row, _LAST] = table.sigma is None

    def counts(self) -> Floats:
        """Number of values by throw or table and channel."""
        return (self.tasks.problems.weight > 0).sum(-1) * 1.0

    def called(self, row: int, channel: int, place: int) -> str:
        """A value in words, such as "curl of row 7"."""
        table = self.sets[self.owner[row]].table
        if table is not None:
            return f"mu at {table.speed[place]:.3g} m/s"
        throw = self.stack.requests[row].throw
        if channel < _LAST:
            return f"{ROWS_OF_DATA[channel]} at {throw.t[place]:.4g} s"
        _, number = file_and_number(throw.name)
        event = throw.events[place].name
        return f"{event} of row {number}" if number else event

    def of_set(self, number: int) -> Booleans:
        """Which throws and tables are those of a data set."""
        of_set: Booleans = self.owner == number
        return of_set

    @property
    def _every(self) -> Booleans:
        """All throws and tables."""
        return np.ones(len(self.owner), bool)

    def optimum(
        self,
        inside: Booleans,
        start: Floats,
        weight: Floats | None = None,
        held: Sequence[int] = (),
    ) -> Solution:
        """Of some throws and tables from initial values, shape (throws and tables,
        parameters); the others keep these, as do the parameters `held`."""
        problems = self.tasks.problems
        common = self.common
        weight = problems.weight if weight is None else weight
        begin = np.array(start)
        begin[:, common] = begin[inside][:, common].mean(0)
        begin[~inside, self.speed] = _ASIDE
        lower = np.array(self.tasks.lower)
        upper = np.array(self.tasks.upper)
        for bound in (lower, upper):
            bound[np.ix_(~inside, ~common)] = begin[np.ix_(~inside, ~common)]
            bound[:, [*held]] = begin[:, [*held]]
        problems = problems._replace(weight=weight * inside[:, None, None])
        if self.throws:
            moment = np.where(inside, 1.0, _MOMENT)[:, None]
            problems = problems._replace(times=moment * problems.times)
        tasks = self.tasks._replace(
            problems=problems, start=begin, lower=lower, upper=upper
        )
        control = JOINT if self.throws else PRECISE
        solution = minimize_jointly(self.model, tasks, common, how=control)
        values = np.where(inside[:, None] | common, solution.values, start)
        return solution._replace(values=values)

    def alone(self, number: int) -> tuple[Solution, Noise]:
        """The optimum of a data set alone, with the noise that its residuals show."""
        inside = self.of_set(number)
        starts = [self.tasks.start]
        if self.sets[number].table is not None:
            starts = [self._with_coefficients(factor) for factor in _STARTS]
        optimum = best(self.optimum(inside, start) for start in starts)
        if not np.isfinite(optimum.chi_squared).all():
            raise UnusableFitError(
                f"law {self.law.name} with "
                f"{self.model.load} load gives no finite path for "
                f"{self.sets[number].name}{no_motion_because(self.model.load)}"
            )
        throws = np.flatnonzero(inside[: self.throws])

        def optima(some: Indices) -> Solution:
            of_throws: Solution = at(optimum, some)
            return of_throws

        for _ in revisions(self.stack, throws, optima):
            self.tasks.problems.weight[throws] = self.stack.problems.weight[throws]
            optimum = self.optimum(inside, optimum.values)
        return optimum, self._noise(optimum)

    def _with_coefficients(self, factor: float) -> Floats:
        """Initial values with the coefficients times a factor, within the bounds."""
        start = self.tasks.start
        start = np.where(self.common, start * factor, start)
        return np.clip(start, self.tasks.lower, self.tasks.upper)

    def _noise(self, optimum: Solution) -> Noise:
        """The noise that residuals show."""
        problems = self.tasks.problems
        is_measured = problems.weight > 0
        free = (self.tasks.upper > self.tasks.lower) & ~np.isnan(optimum.values)
        sigma = residual_sigma(optimum, problems, free)
        share = np.ones(is_measured.shape[:2])
        for row, channel in np.argwhere(is_measured[:, :_LAST].sum(-1) >= _FEWEST):
            residual = optimum.residual[row, channel][is_measured[row, channel]]
            if not residual.any():
                continue
            independence = Independence.of(residual)
            if independence.doubtful:
                share[row, channel] = independence.effective / len(residual)
        ordinary = np.array([*NOISE.values(), 0.0])[: sigma.shape[1]]
        assumed = (share < 1) & (sigma < ordinary)
        return Noise(
            sigma=np.where(assumed, ordinary, sigma),
            share=np.where(assumed, 1.0, share),
            assumed=assumed,
        )

    def weights(self, noise: Noise) -> Floats:
        """Weights of the values with some noise, where the sigma is not given."""
        weight = self.tasks.problems.weight
        sigma = np.where(noise.sigma > 0, noise.sigma, 1.0)[..., None]
        largest = np.maximum(weight.max(-1, keepdims=True), np.finfo(float).tiny)
        estimated = np.where(self.unknown[..., None], weight / largest / sigma, weight)
        return np.asarray(estimated * np.sqrt(noise.share)[..., None])

    def together(self, alone: Sequence[Solution], weight: Floats) -> Solution:
        """The optimum of all data sets, from those of each."""
        values = np.stack([optimum.values for optimum in alone])
        # Each throw and table begins as it ended alone, with the coefficients of one
        # of the data sets, or their mean.
        start = values[self.owner, np.arange(len(self.owner))]
        starts = [np.where(self.common, of_set[0], start) for of_set in values]
        if len(alone) > 1:
            starts.append(np.where(self.common, values[:, 0].mean(0), start))
        return best(self.optimum(self._every, start, weight) for start in starts)

    def departures_of_all(
        self, covariance: Covariance, optimum: Solution, weight: Floats
    ) -> Departures:
        """How chi squared of all throws and tables departs from its quadratic in the
        coefficients: the ridge is followed along those that probes tell about, as in a
        fit, the initial states refitted.

        Parameters
        ----------
        covariance : of the coefficients to first order, at the optimum.
        """
        indices = np.flatnonzero(self.common).tolist()
        probes = []
        for probe in probes_about(covariance):
            start = np.array(optimum.values)
            start[:, self.common] = probe.point
            refitted = self.optimum(self._every, start, weight, indices)
            rise = float((refitted.chi_squared - optimum.chi_squared).sum())
            probes.append(probe.with_rise(rise))
        held = to_be_held(covariance, probes, len(indices))
        if not held:
            return NO_DEPARTURES
        return self.departures(covariance, optimum, self._every, weight, held)

    def departures(
        self,
        covariance: Covariance,
        optimum: Solution,
        inside: Booleans,
        weight: Floats,
        indices: Sequence[int] | None = None,
    ) -> Departures:
        """How chi squared of throws and tables departs from its quadratic in the
        coefficients.

        Parameters
        ----------
        covariance : of the coefficients to first order, at the optimum.
        indices : of the coefficients to be held, by default all that can move.
        """

        def point_of(solution: Solution, parameter: int | None = None) -> Point:
            information = self.at_optimum(solution).information(inside)
            chi_squared = float(solution.chi_squared[inside].sum())
            return Point(information.values, information.slopes, chi_squared, parameter)

        def refit(holds: Sequence[Hold]) -> list[Point]:
            points = []
            for hold in holds:
                start = np.array(optimum.values)
                start[:, self.common] = hold.start
                held = int(np.flatnonzero(self.common)[hold.parameter])
                solution = self.optimum(inside, start, weight, [held])
                points.append(point_of(solution, hold.parameter))
            return points

        if indices is None:
            indices = np.flatnonzero(covariance.open).tolist()
        followed = Followed(
            point_of(optimum),
            self.tasks.lower[0, self.common],
            self.tasks.upper[0, self.common],
            self.tasks.typical[self.common],
            {index: covariance.error_of(index) for index in indices},
        )
        (ridge,) = follow([followed], refit)
        coefficients = self.law.coefficients()
        usual = np.array([default_guess(coefficient) for coefficient in coefficients])
        return departures_along(covariance, ridge, usual)

    def at_optimum(self, optimum: Solution) -> AtOptimum:
        """What throws and tables say of the coefficients at their optimum."""
        information = Information.of(
            self.stack.requests[0].parameters.names,
            Bounded(np.asarray(optimum.values), self.tasks.lower, self.tasks.upper),
            self.tasks.typical,
            optimum.jacobian,
            optimum.residual,
        )
        return AtOptimum(self.law, information.marginal(self.common))


class AtOptimum(NamedTuple):
    """What throws and tables at an optimum say of the coefficients of a law."""

    law: type[Law]
    marginal: Marginal

    def information(self, inside: Booleans | slice = slice(None)) -> Information:
        """Of some of them together, or all."""
        return self.marginal.information.at(inside).together()

    def covariance(self, inside: Booleans | slice = slice(None)) -> Covariance:
        """By some of them, or all."""
        return Covariance.of(self.information(inside))

    def estimates(
        self,
        covariance: Covariance,
        dof: float | None = None,
        departures: Departures = NO_DEPARTURES,
    ) -> tuple[dict[str, Estimate], tuple[Combination, ...]]:
        """Of the coefficients and of determined sums of them.

        Parameters
        ----------
        covariance : by some of the data sets.
        dof : degrees of freedom of its errors.
        """
        estimates = {}
        for index, coefficient in enumerate(self.law.coefficients()):
            stderr = None
            verdict = Verdict.FIXED
            if covariance.free[index]:
                stderr, verdict, _ = covariance.classified(index)
            stderr, verdict, reason = departures.judged(
                coefficient.name, stderr, verdict, coefficient.typical
            )
            estimates[coefficient.name] = Estimate.of(
                coefficient,
                float(covariance.values[index]),
                verdict,
                stderr=stderr,
                dof=None if stderr is None else dof,
                reason=reason,
            )
        combinations = tuple(
            replace(combination, dof=dof)
            for combination in departures.kept(covariance.combinations)
        )
        return estimates, combinations

    def parameters(self) -> Floats:
        """Number of parameters spent on each, with its share of the coefficients."""
        information = self.marginal.information
        rows = information.scaled * information.free[0]
        left, singular, _ = np.linalg.svd(
            rows.reshape(-1, rows.shape[-1]), full_matrices=False
        )
        leverage = (left[:, visible(singular)] ** 2).sum(-1)
        shares = leverage.reshape(rows.shape[:2]).sum(-1)
        return np.asarray(shares + self.marginal.rank)


def best(solutions: Iterable[Solution]) -> Solution:
    """The optimum of least chi squared."""
    solutions = list(solutions)
    chi_squared = [
        np.nan_to_num(solution.chi_squared.sum(), nan=np.inf) for solution in solutions
    ]
    return solutions[int(np.argmin(chi_squared))]


def _requests(
    law: type[Law], load: Load, throws: Sequence[Throw], chosen: Comparing
) -> list[Request]:
    """The requests to fit a law to throws, without the choices of parameters that it
    does not have."""
    options = options_of(law, {**chosen.by_parameter, "start": chosen.start})
    options |= {
        "stone": chosen.stone,
        "sigma": chosen.sigma,
        "unbounded": chosen.unbounded,
    }
    options |= chosen.rows
    # A heading would take a measured curl from laws that have none.
    of_timed = options | {"fix": {"heading": 0.0, **options.get("fix", {})}}
    requests = []
    for throw in throws:
        of_throw = options if throw.has_path else of_timed
        choices = Fitting.of(throw.settings, of_throw, law=law, load=load)
        requests.append(Request.of(throw, choices))
    return requests


def _carrier() -> Throw:
    """A throw that has the parameters where there are tables of friction alone."""
    speed = Event("speed", "speed", 2.0, 0.02, LINES["hog"])
    rest = Event("rest", "y", LINES["far-tee"], 0.05)
    return Throw.from_events([speed, rest])


def _with_tables(
    problems: Problem, throws: Sequence[Throw], tables: Sequence[FrictionTable]
) -> Problem:
    """Problems of throws, and of tables of friction in place of those after these."""
    count = len(throws)
    total, _, rows = problems.weight.shape
    if not problems.weight[:count, _LAST:].any():
        problems = problems._replace(events=None)
    states = np.zeros((total, 2, rows))
    for row, table in enumerate(tables, count):
        size = len(table.mu)
        problems.observed[row] = 0.0
        problems.weight[row] = 0.0
        problems.times[row] *= _MOMENT
        states[row, 0, :size] = table.speed
        states[row, 1, :size] = table.omega
        problems.observed[row, _LAST, :size] = table.mu
        weight = 1.0 if table.sigma is None else 1 / table.sigma
        problems.weight[row, _LAST, :size] = weight
    if not throws:
        problems = problems._replace(times=None)
    return problems._replace(states=states) if tables else problems
