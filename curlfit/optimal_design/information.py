"""Fisher information of planned throws, from exact derivatives.

The information is J^T W J, with J the derivatives of the trajectory with respect to
coefficients and initial state, and W = 1/sigma^2 of independent Gaussian noise. It is
stored as its factor R, an upper triangular matrix with R^T R = J^T W J, by QR of J
itself: forming the product would lose half the digits, and with them the distinction
between weakly determined and undetermined directions. The QR of the stacked factors of
several throws or channels gives the factor of the sum of their information.

Columns are scaled by typical sizes of the parameters, as in
`curlfit.inference.information`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import counted
from curlfit.friction import Law, Load, no_motion_because
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.directions import (
    apart_from,
    r_factor,
    standard_error,
)
from curlfit.inference.information.information import Information
from curlfit.inference.model.likelihood import linearize, predict_many
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import (
    BOUNDS_WITHOUT_ANGLE,
    START_NAMES,
    ParameterSet,
)
from curlfit.inference.model.problem import LEVEL_AND_STILL, Problem
from curlfit.inference.model.system import motions
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.solve.least_squares import Indices
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import FEW, in_batches, stacked
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS

LONGEST = 120.0
"""Seconds within which a stone must come to rest if the end of the record
is not given."""
MOST_ROWS = 50_000
"""Maximum number of rows of one throw."""

_ROWS = 256  # in a column of a batch


class PlannedThrow(NamedTuple):
    """Initial state, sampling rate and stone of a throw."""

    v0: float
    """initial speed, m/s, > 0"""
    omega0: float
    """initial spin, rad/s, counter-clockwise positive"""
    rate: float
    """rows per second, Hz"""
    stone: Stone
    heading: float = 0.0
    """initial direction, rad; pi is back along the sheet"""


class Rest(NamedTuple):
    """Where and when a stone comes to rest, from the first row of its record."""

    time: float
    """s; extrapolated beyond `LONGEST`"""
    distance: float
    """m; at `LONGEST` if the stone still moves then"""


class RecordInformation(NamedTuple):
    """Length and Fisher information of the record of a planned throw."""

    rows: int
    last: float
    """time of the last row, s since the first"""
    rest: Rest
    factors: Floats
    """by channel, for noise of 1 m, 1 rad ...: R factor of the information on
    coefficients and initial state, scaled by typical sizes, on the conditions examined,
    scaled by their widths, and on the shapes of a model discrepancy, scaled by their
    sizes; shape (channels, parameters, parameters)"""
    shapes: int = 0
    """number of shapes of a model discrepancy"""


@dataclass(frozen=True, eq=False)
class Assumptions:
    """A law with assumed values of its coefficients, and what is measured
    of its throws.

    Attributes
    ----------
    values : of all coefficients, shape (k,).
    sigma : noise by channel (SI); channels without one are not measured.
    until : end of the records in s; the time of rest if None.
    discrepancy : size of the accelerations that the law may lack, relative to the
        friction; see `curlfit.inference.noise.accelerations`.
    """

    law: type[Law]
    load: Load
    values: Floats
    sigma: Mapping[str, float]
    until: float | None = None
    discrepancy: float = 0.0
    _computed: dict[PlannedThrow, RecordInformation] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def parameters(self) -> ParameterSet:
        """The coefficients and the initial state."""
        return ParameterSet.build(self.law)

    @cached_property
    def parameters_of_fit(self) -> ParameterSet:
        """The coefficients and the initial state with the bounds of a fit of what is
        measured."""
        turning = {"phi", "omega"} & self.sigma.keys()
        bounds = {} if turning else BOUNDS_WITHOUT_ANGLE
        return ParameterSet.build(self.law, bounds=bounds)

    @property
    def model(self) -> Model:
        """Law and load."""
        return Model(self.law, self.load)

    @property
    def channels(self) -> int:
        """Number of the channels x, y, phi, speed, omega that are computed: 3 or 5."""
        return 5 if {"speed", "omega"} & self.sigma.keys() else 3

    @property
    def free(self) -> Indices:
        """Which coefficients are estimated."""
        return np.flatnonzero(self.parameters.free[: len(self.values)])

    @property
    def names(self) -> list[str]:
        """Names of the free coefficients."""
        return [self.parameters.names[index] for index in self.free]

    @property
    def typical(self) -> Floats:
        """Typical sizes of the free coefficients."""
        return self.parameters.typical[self.free]

    @property
    def bounded(self) -> Bounded:
        """Values and bounds of the free coefficients, without the bounds beyond which
        a value lies: those were not the bounds of its fit."""
        values = self.values[self.free]
        lower = self.parameters.lower[self.free]
        upper = self.parameters.upper[self.free]
        return Bounded(
            values,
            np.where(values > lower, lower, -np.inf),
            np.where(values < upper, upper, np.inf),
        )

    def weights(self, combination: Mapping[str, float]) -> Floats:
        """A combination of free coefficients as `standard_error` takes it."""
        return (
            np.array([combination.get(name, 0.0) for name in self.names]) * self.typical
        )

    def information(self, factor: Floats) -> Information:
        """What an R factor of information, in typical sizes, says of the free
        coefficients."""
        rows = np.column_stack([factor, np.zeros(len(factor))])
        return Information(tuple(self.names), *self.bounded, self.typical, rows)

    def errors(
        self, factor: Floats, quantities: Mapping[str, Mapping[str, float]]
    ) -> dict[str, float | None]:
        """Standard errors of combinations within the bounds, by name."""
        scaled = self.information(factor).without_confined().scaled
        errors = {
            name: standard_error(scaled, self.weights(combination))
            for name, combination in quantities.items()
        }
        return self.within_bounds(errors, quantities)

    def within_bounds(
        self,
        errors: Mapping[str, float | None],
        quantities: Mapping[str, Mapping[str, float]],
    ) -> dict[str, float | None]:
        """Standard errors of combinations by name, None where one is wider than the
        interval between the bounds, which then alone limit the combination."""
        widths = dict(
            zip(self.names, self.bounded.upper - self.bounded.lower, strict=True)
        )
        within: dict[str, float | None] = {}
        for name, error in errors.items():
            width = sum(
                abs(weight) * widths[coefficient]
                for coefficient, weight in quantities[name].items()
            )
            is_within = error is not None and not error > width
            within[name] = error if is_within else None
        return within

    def noisier(self, channels: Iterable[str], factor: float) -> Assumptions:
        """A copy with the noise of some channels multiplied."""
        multiplied = {name: factor * self.sigma[name] for name in channels}
        return replace(self, sigma={**self.sigma, **multiplied})

    @cached_property
    def by_load(self) -> dict[Load, Assumptions]:
        """Copies for an exact law, under each load."""
        by_load = {load: replace(self, load=load, discrepancy=0.0) for load in Load}
        if not self.discrepancy:
            # the object itself, which keeps the records that it has computed
            by_load[self.load] = self
        return by_load

    def records(self, throws: Sequence[PlannedThrow]) -> list[RecordInformation]:
        """The information of each of several throws, computed once."""
        computed = self._computed
        missing = [throw for throw in dict.fromkeys(throws) if throw not in computed]
        if missing:
            records = record_information(self, missing)
            computed.update(zip(missing, records, strict=True))
        return [computed[throw] for throw in throws]

    def factors(self, throws: Sequence[PlannedThrow]) -> list[Floats]:
        """R factor of the information of each throw on the free coefficients."""
        return [self.marginal(record) for record in self.records(throws)]

    def marginal(
        self, record: RecordInformation, columns: Indices | None = None
    ) -> Floats:
        """R factor of the information on some columns of a record, marginal over the
        initial state.

        The Schur complement: the columns are projected onto the orthogonal complement
        of those of the initial state. Initial values that only channels that are not
        measured determine are fixed, as in a fit.

        Parameters
        ----------
        columns : by default those of the free coefficients.

        Returns
        -------
        Upper triangular, shape (columns, columns), scaled by typical sizes.
        """
        width = record.factors.shape[-1]
        shapes = np.arange(width - record.shapes, width)
        # a priori the amplitudes of the shapes have unit variance
        rows = np.concatenate([self.rows(record), np.eye(width)[shapes]])
        nuisances = rows[:, [*self.state, *shapes]]
        wanted = rows[:, self.free if columns is None else columns]
        factor = r_factor(apart_from(nuisances, wanted))
        return np.pad(factor, ((0, factor.shape[1] - len(factor)), (0, 0)))

    def rows(self, record: RecordInformation) -> Floats:
        """Rows of the information of the measured channels of a record, over the
        noise."""
        return np.concatenate(
            [
                factor / self.sigma[name]
                for name, factor in zip(CHANNELS, record.factors, strict=False)
                if name in self.sigma
            ]
        )

    @property
    def state(self) -> list[int]:
        """Indices of the parameters of the initial state that are estimated: those that
        only channels that are not measured determine are fixed, as in a fit."""
        needed = {"x0": {"x"}, "y0": {"y"}, "phi0": {"phi"}, "heading": {"x", "y"}}
        names = self.parameters.names
        return [
            names.index(name)
            for name in START_NAMES
            if needed.get(name, set()) <= self.sigma.keys()
        ]


class _Piece(NamedTuple):
    """Some consecutive rows of a record, at most `_ROWS`."""

    throw: int
    """index of the throw"""
    times: Floats


def record_information(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    widths: Mapping[str, float] | None = None,
) -> list[RecordInformation]:
    """The information of each of several throws.

    Parameters
    ----------
    widths : of the conditions to be examined, see `curlfit.inference.model.conditions`.

    Raises
    ------
    InputError : a stone that does not come to rest, or for which there is no motion; a
        record with fewer than two rows or more than `MOST_ROWS`.
    """
    model = assumed.model
    rests = rests_of(assumed, throws)
    clocks = [
        clock_of(assumed, throw, rest.time)
        for throw, rest in zip(throws, rests, strict=True)
    ]
    responses: list[Responses] = []
    shapes = 0
    if assumed.discrepancy:
        responses = _responses(assumed, throws, clocks)
        shapes = responses[0].by_channel.shape[-1]
    # Long records are cut into pieces, so that the arrays of a batch are equally long;
    # the stacked factors of the pieces have the factor of the record.
    pieces = [
        _Piece(index, clock[first : first + _ROWS])
        for index, clock in enumerate(clocks)
        for first in range(0, len(clock), _ROWS)
    ]

    def factors_of(indices: Indices) -> Floats:
        """R factors of pieces by channel."""
        batch = [pieces[index] for index in indices]
        throws_of_batch = [throws[piece.throw] for piece in batch]
        values = vectors_of(assumed, throws_of_batch)
        times = [piece.times for piece in batch]
        problems = _problems(throws_of_batch, times, assumed.channels)
        _, slopes = linearize(model, values, problems)
        columns = [np.asarray(slopes) * assumed.parameters.typical]
        if widths:
            paths = predict_many(model, values, problems, FEW)
            changes = residual_changes(model, problems, values, paths, widths, FEW)
            columns.append(np.stack(list(changes.values()), -1))
        finite = np.isfinite(np.concatenate(columns, -1)).all((1, 2, 3))
        if not finite.all():
            raise _no_motion(assumed, throws_of_batch[int(np.argmin(finite))])
        if responses:
            accelerated = [
                [responses[piece.throw].at(t, row) for row in range(assumed.channels)]
                for piece, t in zip(batch, problems.times, strict=True)
            ]
            scale = assumed.discrepancy * problems.weight[..., None]
            columns.append(scale * accelerated)
        return r_factor(np.concatenate(columns, -1))

    factors = in_batches(factors_of, (np.arange(len(pieces)),), FEW)
    throw_of_piece = np.array([piece.throw for piece in pieces])
    records = []
    for index, (clock, rest) in enumerate(zip(clocks, rests, strict=True)):
        factor = r_factor(np.concatenate(factors[throw_of_piece == index], 1))
        records.append(
            RecordInformation(len(clock), float(clock[-1]), rest, factor, shapes)
        )
    return records


def _responses(
    assumed: Assumptions, throws: Sequence[PlannedThrow], clocks: Sequence[Floats]
) -> list[Responses]:
    """Responses of the paths of throws to accelerations of the size of the friction."""
    even = [np.linspace(0.0, clock[-1], _ROWS) for clock in clocks]
    paths = paths_of(assumed, throws, even)
    return [
        Responses.of(times, path, throw.stone)
        for times, path, throw in zip(even, paths, throws, strict=True)
    ]


def clock_of(assumed: Assumptions, throw: PlannedThrow, rest: float) -> Floats:
    """Times of the rows of a record, s."""
    end = rest if assumed.until is None else assumed.until
    rows = math.floor(end * throw.rate + 1e-9) + 1
    if not 2 <= rows <= MOST_ROWS:
        raise InputError(
            f"{end:.4g} s at {throw.rate:g} Hz make {counted(rows, 'row')}; "
            f"expected 2 to {MOST_ROWS}"
        )
    return np.arange(rows) / throw.rate


def paths_of(
    assumed: Assumptions, throws: Sequence[PlannedThrow], clocks: Sequence[Floats]
) -> Floats:
    """Paths at up to `_ROWS` times of each throw, the last repeated,
    (throws, 5, _ROWS)."""
    problems = _problems(throws, clocks, 3)
    return predict_many(assumed.model, vectors_of(assumed, throws), problems, FEW)


def exact_problems(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> Problem:
    """Problems of throws, along the first axis, whose data have no noise.

    Each has `_ROWS` rows at most, evenly spread, whose weights stand for all rows of
    the record.
    """
    clocks = []
    shares = []
    for throw, record in zip(throws, assumed.records(throws), strict=True):
        clock = clock_of(assumed, throw, record.rest.time)
        rows = np.unique(np.linspace(0, len(clock) - 1, _ROWS).round().astype(int))
        clocks.append(clock[rows])
        shares.append(len(rows) / len(clock))
    problems = _problems(throws, clocks, assumed.channels)
    sigma = np.array([assumed.sigma.get(name, np.inf) for name in CHANNELS])
    noise = sigma[: assumed.channels, None] * np.sqrt(shares)[:, None, None]
    observed = paths_of(assumed, throws, clocks)[:, : assumed.channels]
    return problems._replace(observed=observed, weight=problems.weight / noise)


def vectors_of(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> Floats:
    """Parameter vectors of throws from the origin, shape (throws, parameters)."""
    vectors = []
    for throw in throws:
        start = [getattr(throw, name, 0.0) for name in START_NAMES]
        vectors.append([*assumed.values, *start])
    return np.array(vectors)


def _problems(
    throws: Sequence[PlannedThrow], clocks: Sequence[Floats], channels: int
) -> Problem:
    """Problems of throws at the times of each, with unit noise, so that the derivatives
    of the residuals are those of the trajectory."""
    times = np.stack(
        [np.pad(clock, (0, _ROWS - len(clock)), mode="edge") for clock in clocks]
    )
    lengths = np.array([len(clock) for clock in clocks])
    is_measured = np.arange(_ROWS) < lengths[:, None]
    weight = np.repeat(is_measured[:, None].astype(float), channels, axis=1)
    stone = stacked([jax.tree.map(float, throw.stone) for throw in throws])
    level = jax.tree.map(lambda value: np.full(len(throws), value), LEVEL_AND_STILL)
    return Problem(
        times, np.zeros_like(weight), weight, stone, level, np.zeros(len(throws), int)
    )


def rests_of(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> list[Rest]:
    """Where throws come to rest.

    Raises
    ------
    InputError : a stone for which there is no motion, or that does not come to rest
        within `LONGEST` where the record lasts until then.
    """
    rests = [Rest(math.nan, math.nan)] * len(throws)
    for stone in {throw.stone for throw in throws}:
        indices = [row for row, throw in enumerate(throws) if throw.stone == stone]
        values = vectors_of(assumed, [throws[index] for index in indices])
        clock = np.array([0.0, LONGEST])
        states, times = motions(assumed.model, values, stone, LEVEL_AND_STILL, clock)
        distances = np.hypot(*states[:, :2, -1].T)
        for index, time, distance in zip(indices, times, distances, strict=True):
            rests[index] = Rest(float(time), float(distance))
    for throw, rest in zip(throws, rests, strict=True):
        if math.isnan(rest.time) or math.isnan(rest.distance):
            raise _no_motion(assumed, throw)
        if assumed.until is None and not 0 < rest.time <= LONGEST:
            raise InputError(
                f"a stone of {throw.v0:g} m/s and {throw.omega0:g} rad/s does "
                f"not come to rest within {LONGEST:g} s; give the length of the "
                "record (--until)"
            )
    return rests


def _no_motion(assumed: Assumptions, throw: PlannedThrow) -> InputError:
    return InputError(
        f"law {assumed.law.name} with {assumed.load} load admits no motion from "
        f"{throw.v0:g} m/s and {throw.omega0:g} rad/s{no_motion_because(assumed.load)}"
    )
