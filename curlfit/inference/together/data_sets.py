"""One law and several data sets: its coefficients that all have in common, and
those of each.

All data sets are one problem (`curlfit.inference.together.solver`), in which those that
are left out have no weight, so that one program serves all of them and all laws of a
family. A table of friction takes the place of a throw whose initial state is fixed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError, UnusableFitError, require_kind
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
from curlfit.inference.fit.throw_stack import ThrowStack, at
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.directions import visible
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import options_of
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import ROWS_OF_DATA, Problem, problem_shape
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


def data_sets(items: Iterable[Throw | FrictionTable]) -> list[DataSet]:
    """Throws and tables as data sets: timed throws of one file are one.

    Raises
    ------
    InputError : anything else than a throw or a table of friction, or none.
    """
    found: dict[str, DataSet] = {}
    for item in items:
        require_kind(
            item, (Throw, FrictionTable), "data", "throws and tables of friction"
        )
        one = (
            DataSet(item.name, table=item) if isinstance(item, FrictionTable) else None
        )
        one = one or DataSet(item.name, (item,))  # type: ignore[arg-type]
        if one.kind == "throws":
            one = one._replace(name=item.name.partition(" row ")[0])
        name = one.name
        while name in found and not found[name].kind == one.kind == "throws":
            name += "'"  # another of the same name
        earlier = found[name].throws if name in found else ()
        found[name] = one._replace(name=name, throws=(*earlier, *one.throws))
    if not found:
        raise InputError(
            "no data to compare laws with; expected throws or tables of friction"
        )
    return list(found.values())


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
        self.law, self.sets = law, sets
        throws = [throw for one in sets for throw in one.throws]
        tables = [one.table for one in sets if one.table is not None]
        owner = [k for k, one in enumerate(sets) for _ in one.throws]
        self.owner = np.array([*owner, *(k for k, one in enumerate(sets) if one.table)])
        self.throws = len(throws)
        options = options_of(law, {**chosen.by_parameter, "start": chosen.start})
        options |= {
            name: getattr(chosen, name) for name in ("stone", "sigma", "unbounded")
        }
        options |= chosen.rows
        # A heading would take a measured curl from laws that have none.
        held = options | {"fix": {"heading": 0.0, **options.get("fix", {})}}
        requests = []
        for throw in throws or [_carrier()]:
            of_throw = options if throw.has_path else held
            choices = Fitting.of(throw.settings, of_throw, law=law, load=load)
            requests.append(Request.of(throw, choices))
        parameters = requests[0].parameters
        self.common = np.isin(
            parameters.names, [item.name for item in law.coefficients()]
        )
        self.names = parameters.names_where(self.common)
        self.model = Model(law, load).within(family)
        shapes = [problem_shape(request.throw) for request in requests]
        shapes += [
            (_LAST + 1, 1 << (len(table.mu) - 1).bit_length()) for table in tables
        ]
        channels, rows = map(max, zip(*shapes, strict=True))
        self.rounds = ThrowStack(self.model, requests, shape=(channels, rows))
        every = np.minimum(np.arange(len(self.owner)), len(requests) - 1)
        problems = _with_tables(
            jax.tree.map(lambda leaf: np.array(leaf[every]), self.rounds.problems),
            throws,
            tables,
        )
        start = (
            self.rounds.starts()[1][0]
            if throws
            else np.zeros((1, len(parameters.names)))
        )
        start = start[every]
        lower, upper = (end[every] for end in bounds_of(requests, self.common))
        self.speed = list(parameters.names).index("v0")
        start[self.throws :, self.common] = [
            default_guess(item) for item in law.coefficients()
        ]
        start[self.throws :, self.speed] = _ASIDE
        for end in (lower, upper):
            end[self.throws :, ~self.common] = start[self.throws :, ~self.common]
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
        self.unknown[: self.throws] = self.rounds.unknown[: self.throws]
        for row, table in enumerate(tables, self.throws):
            self.unknown[row, _LAST] = table.sigma is None

    def counts(self) -> Floats:
        """Number of values by throw or table and channel."""
        return (self.tasks.problems.weight > 0).sum(-1) * 1.0

    def called(self, row: int, channel: int, place: int) -> str:
        """A value in words, such as "curl of row 7"."""
        one = self.sets[self.owner[row]]
        if one.table is not None:
            return f"mu at {one.table.speed[place]:.3g} m/s"
        throw = self.rounds.requests[row].throw
        if channel < _LAST:
            return f"{ROWS_OF_DATA[channel]} at {throw.t[place]:.4g} s"
        _, row_of, number = throw.name.partition(" row ")
        event = throw.events[place].name
        return f"{event} of{row_of}{number}" if row_of else event

    def of_set(self, number: int) -> Booleans:
        """Which throws and tables are those of a data set."""
        found: Booleans = self.owner == number
        return found

    def optimum(
        self,
        inside: Booleans,
        start: Floats,
        weight: Floats | None = None,
        held: Sequence[int] = (),
    ) -> Solution:
        """Of some throws and tables from initial values, shape (throws and tables,
        parameters); the others keep these, as do the parameters `held`."""
        problems, common = self.tasks.problems, self.common
        weight = problems.weight if weight is None else weight
        lower, upper, begin = (np.array(part) for part in (*self.tasks[2:4], start))
        begin[:, common] = begin[inside][:, common].mean(0)
        begin[~inside, self.speed] = _ASIDE
        for end in (lower, upper):
            end[np.ix_(~inside, ~common)] = begin[np.ix_(~inside, ~common)]
            end[:, [*held]] = begin[:, [*held]]
        some = problems._replace(weight=weight * inside[:, None, None])
        if self.throws:
            moment = np.where(inside, 1.0, _MOMENT)[:, None]
            some = some._replace(times=moment * problems.times)
        tasks = self.tasks._replace(
            problems=some, start=begin, lower=lower, upper=upper
        )
        how = JOINT if self.throws else PRECISE
        found = minimize_jointly(self.model, tasks, common, how=how)
        kept = np.where(inside[:, None] | common, found.values, start)
        return found._replace(values=kept)

    def alone(self, number: int) -> tuple[Solution, Noise]:
        """The optimum of a data set alone, with the noise that its residuals show."""
        inside, before = self.of_set(number), self.tasks.start
        starts = [before]
        if self.sets[number].table is not None:
            starts = [
                np.where(self.common, before * factor, before) for factor in _STARTS
            ]
            starts = [np.clip(one, *self.tasks[2:4]) for one in starts]
        found = best(self.optimum(inside, one) for one in starts)
        if not np.isfinite(found.chi_squared).all():
            raise UnusableFitError(
                f"law {self.law.name} with "
                f"{self.model.load} load gives no finite path for "
                f"{self.sets[number].name}{no_motion_because(self.model.load)}"
            )
        throws = np.flatnonzero(inside[: self.throws])

        def optima(some: Indices) -> Solution:
            of_throws: Solution = at(found, some)
            return of_throws

        for _ in revisions(self.rounds, throws, optima):
            self.tasks.problems.weight[throws] = self.rounds.problems.weight[throws]
            found = self.optimum(inside, found.values)
        return found, self._noise(found)

    def _noise(self, found: Solution) -> Noise:
        problems, seen = self.tasks.problems, self.tasks.problems.weight > 0
        free = (self.tasks.upper > self.tasks.lower) & ~np.isnan(found.values)
        sigma, share = residual_sigma(found, problems, free), np.ones(seen.shape[:2])
        for place in np.argwhere(seen[:, :_LAST].sum(-1) >= _FEWEST):
            row = found.residual[*place][seen[*place]]
            if row.any() and (known := Independence.of(row)).doubtful:
                share[*place] = known.effective / len(row)
        ordinary = np.array([*NOISE.values(), 0.0])[: sigma.shape[1]]
        assumed = (share < 1) & (sigma < ordinary)
        return Noise(
            np.where(assumed, ordinary, sigma), np.where(assumed, 1.0, share), assumed
        )

    def weights(self, noise: Noise) -> Floats:
        """Weights of the values with some noise, where the sigma is not given."""
        weight = self.tasks.problems.weight
        sigma = np.where(noise.sigma > 0, noise.sigma, 1.0)[..., None]
        largest = np.maximum(weight.max(-1, keepdims=True), np.finfo(float).tiny)
        own = np.where(self.unknown[..., None], weight / largest / sigma, weight)
        return np.asarray(own * np.sqrt(noise.share)[..., None])

    def together(self, alone: Sequence[Solution], weight: Floats) -> Solution:
        """The optimum of all data sets, from those of each."""
        own, every = (
            np.stack([one.values for one in alone]),
            np.ones(len(self.owner), bool),
        )
        start = own[self.owner, np.arange(len(every))]
        starts = [np.where(self.common, one[0], start) for one in own]
        starts.append(np.where(self.common, own[:, 0].mean(0), start))
        return best(
            self.optimum(every, one, weight)
            for one in starts[: 1 if len(own) == 1 else None]
        )

    def departures_of_all(
        self, known: Covariance, optimum: Solution, weight: Floats
    ) -> Departures:
        """How chi squared of all throws and tables departs from its quadratic in the
        coefficients: the ridge is followed along those that probes tell about, as in a
        fit, the initial states refitted.

        Parameters
        ----------
        known : what they say of the coefficients to first order, at the optimum.
        """
        every = np.ones(len(self.owner), bool)
        coefficients = np.flatnonzero(self.common).tolist()
        lower, upper = (end[0, self.common] for end in self.tasks[2:4])
        bounded = Bounded(optimum.values[0, self.common], lower, upper)
        departing = []
        for probe in probes_about(known, bounded):
            start = np.array(optimum.values)
            start[:, self.common] = probe.point
            refitted = self.optimum(every, start, weight, coefficients)
            rise = float((refitted.chi_squared - optimum.chi_squared).sum())
            if probe.departs(rise if math.isfinite(rise) else math.inf):
                departing.append(probe)
        held = to_be_held(known, departing, len(coefficients))
        if not held:
            return NO_DEPARTURES
        return self.departures(known, optimum, every, weight, held)

    def departures(
        self,
        known: Covariance,
        optimum: Solution,
        inside: Booleans,
        weight: Floats,
        indices: Sequence[int] | None = None,
    ) -> Departures:
        """How chi squared of throws and tables departs from its quadratic in the
        coefficients.

        Parameters
        ----------
        known : what they say of the coefficients to first order, at the optimum.
        indices : of the coefficients to be held, by default all that can move.
        """
        begin = np.array(optimum.values)

        def point_of(solution: Solution, parameter: int | None = None) -> Point:
            information = self.told(solution).information(inside)
            chi_squared = float(solution.chi_squared[inside].sum())
            return Point(information.values, information.slopes, chi_squared, parameter)

        def refit(holds: Sequence[Hold]) -> list[Point]:
            points = []
            for hold in holds:
                start = begin.copy()
                start[:, self.common] = hold.start
                held = int(np.flatnonzero(self.common)[hold.parameter])
                solution = self.optimum(inside, start, weight, [held])
                points.append(point_of(solution, hold.parameter))
            return points

        lower, upper = (end[0, self.common] for end in self.tasks[2:4])
        typical = self.tasks.typical[self.common]
        if indices is None:
            indices = np.flatnonzero(known.open).tolist()
        errors = {index: known.error_of(index) for index in indices}
        followed = Followed(point_of(optimum), lower, upper, typical, errors)
        (ridge,) = follow([followed], refit)
        usual = np.array([default_guess(item) for item in self.law.coefficients()])
        return departures_along(known, ridge, usual)

    def told(self, found: Solution) -> Told:
        """What throws and tables at their optimum say of the coefficients."""
        information = Information.of(
            self.rounds.requests[0].parameters.names,
            Bounded(np.asarray(found.values), *self.tasks[2:4]),
            self.tasks.typical,
            found.jacobian,
            found.residual,
        )
        return Told(self, information.marginal(self.common))


class Told(NamedTuple):
    """What throws and tables at an optimum say of the coefficients."""

    of: LawOnSets
    marginal: Marginal

    def information(self, inside: Booleans | slice = slice(None)) -> Information:
        """Of some of them together, or all."""
        return self.marginal.information.at(inside).together()

    def by(self, inside: Booleans | slice = slice(None)) -> Covariance:
        """By some of them, or all."""
        return Covariance.of(self.information(inside))

    def estimates(
        self,
        known: Covariance,
        dof: float | None = None,
        departures: Departures = NO_DEPARTURES,
    ) -> tuple[dict[str, Estimate], tuple[Combination, ...]]:
        """Of the coefficients and of determined sums of them, by some of the data sets;
        `dof` are the degrees of freedom of their errors."""
        found = {}
        for place, item in enumerate(self.of.law.coefficients()):
            free = known.free[place]
            stderr, verdict, _ = (
                known.classified(place) if free else (None, Verdict.FIXED, None)
            )
            stderr, verdict, reason = departures.judged(
                item.name, stderr, verdict, item.typical
            )
            found[item.name] = Estimate.of(
                item,
                float(known.values[place]),
                verdict,
                stderr=stderr,
                dof=None if stderr is None else dof,
                reason=reason,
            )
        combinations = tuple(
            replace(one, dof=dof) for one in departures.kept(known.combinations)
        )
        return found, combinations

    def parameters(self) -> Floats:
        """Number of parameters spent on each, with its share of the coefficients."""
        information = self.marginal.information
        rows = information.scaled * information.free[0]
        left, singular, _ = np.linalg.svd(
            rows.reshape(-1, rows.shape[-1]), full_matrices=False
        )
        spent = (
            (left[:, visible(singular)] ** 2).sum(-1).reshape(rows.shape[:2]).sum(-1)
        )
        return np.asarray(spent + self.marginal.rank)


def best(solutions: Iterable[Solution]) -> Solution:
    """The optimum of least chi squared."""
    each = list(solutions)
    sizes = [np.nan_to_num(one.chi_squared.sum(), nan=np.inf) for one in each]
    return each[int(np.argmin(sizes))]


def _carrier() -> Throw:
    """A throw that has the parameters where there are tables of friction alone."""
    hog, tee = LINES["hog"], LINES["far-tee"]
    events = Event("speed", "speed", 2.0, 0.02, hog), Event("rest", "y", tee, 0.05)
    return Throw.from_events(events)


def _with_tables(
    problems: Problem, throws: Sequence[Throw], tables: Sequence[FrictionTable]
) -> Problem:
    """Problems of throws, and of tables of friction in place of those after these."""
    count, (every, _, rows) = len(throws), problems.weight.shape
    if not problems.weight[:count, _LAST:].any():
        problems = problems._replace(events=None)
    states = np.zeros((every, 2, rows))
    for row, table in enumerate(tables, count):
        size = len(table.mu)
        problems.observed[row], problems.weight[row] = 0.0, 0.0
        problems.times[row] *= _MOMENT
        states[row, :, :size] = table.speed, table.omega
        problems.observed[row, _LAST, :size] = table.mu
        problems.weight[row, _LAST, :size] = (
            1.0 if table.sigma is None else 1 / table.sigma
        )
    if not throws:
        problems = problems._replace(times=None)
    return problems._replace(states=states) if tables else problems
