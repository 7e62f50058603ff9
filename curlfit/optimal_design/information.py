"""Fisher information of planned throws, from exact derivatives.

The information is J^T W J, with J the derivatives of the trajectory with respect to
coefficients and initial state, and W = 1/sigma^2 of independent Gaussian noise. It is
stored as its factor R, an upper triangular matrix with R^T R = J^T W J, by QR of J
itself: forming the product would lose half the digits, and with them the distinction
between weakly determined and undetermined directions. The QR of the stacked factors of
several throws or channels gives the factor of the sum of their information.

Columns are scaled by typical sizes of the parameters, as in
`curlfit.inference.identifiability`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import counted
from curlfit.friction import Law, Load, no_motion_because
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.identifiability import Bounded, confined, r_factor
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import linearize, predict_many
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.parameters import (
    BOUNDS_WITHOUT_ANGLE,
    START,
    ParameterSet,
)
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.inference.system import motions
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import FEW, in_batches, stacked
from curlfit.optimal_design.selection import standard_error
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS

LONGEST = 120.0
"""Seconds within which a stone must come to rest if the end of the record
is not given."""
MOST_ROWS = 50_000
"""Maximum number of rows of one throw."""

_ROWS = 256  # in a column of a batch
# relative to the largest singular value of the columns of the initial state
_ROUNDING = 1e-13


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


class RecordInformation(NamedTuple):
    """Length and Fisher information of the record of a planned throw."""

    rows: int
    last: float
    """time of the last row, s since the first"""
    rest: float
    """time of rest, s since the first row"""
    distance: float
    """from the first row to rest, m"""
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

    @cached_property
    def parameters(self) -> ParameterSet:
        """The coefficients and the initial state."""
        return ParameterSet.build(self.law)

    @cached_property
    def parameters_of_fit(self) -> ParameterSet:
        """The same with the bounds of a fit of what is measured."""
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
        """Their typical sizes."""
        return self.parameters.typical[self.free]

    @property
    def bounded(self) -> Bounded:
        """Their values and bounds; one beyond which the value lies was not
        that of its fit."""
        known = self.parameters
        values, lower, upper = (
            part[self.free] for part in (self.values, known.lower, known.upper)
        )
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

    def errors(
        self, factor: Floats, quantities: Mapping[str, Mapping[str, float]]
    ) -> dict[str, float | None]:
        """Standard errors of combinations within the bounds, by name."""
        factor = (
            confined(factor / self.typical, self.bounded, self.typical) * self.typical
        )
        errors = {
            name: standard_error(factor, self.weights(of))
            for name, of in quantities.items()
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
            within[name] = None if error is not None and error > width else error
        return within

    def noisier(self, channels: Iterable[str], factor: float) -> Assumptions:
        """The same with the noise of some channels multiplied."""
        sigma = dict(self.sigma)
        return replace(
            self, sigma=sigma | {name: factor * sigma[name] for name in channels}
        )

    @cached_property
    def by_load(self) -> dict[Load, Assumptions]:
        """The same for an exact law, under each load."""
        loads: tuple[Load, ...] = tuple(Load)
        own = {} if self.discrepancy else {self.load: self}
        return {load: replace(self, load=load, discrepancy=0.0) for load in loads} | own

    @cached_property
    def _known(self) -> dict[PlannedThrow, RecordInformation]:
        return {}

    def records(self, throws: Sequence[PlannedThrow]) -> list[RecordInformation]:
        """The information of each of several throws, computed once."""
        if new := [
            throw for throw in dict.fromkeys(throws) if throw not in self._known
        ]:
            self._known.update(zip(new, record_information(self, new), strict=True))
        return [self._known[throw] for throw in throws]

    def factors(self, throws: Sequence[PlannedThrow]) -> list[Floats]:
        """R factor of the information of each throw on the free coefficients."""
        return [self.marginal(one) for one in self.records(throws)]

    def marginal(
        self, record: RecordInformation, columns: Indices | None = None
    ) -> Floats:
        """R factor of the information on some columns of a record, marginal over the
        initial state.

        The Schur complement: the columns are projected onto the orthogonal complement
        of those of the initial state. Initial values that only channels without noise
        determine are fixed, as in a fit.

        Parameters
        ----------
        columns : by default those of the free coefficients.

        Returns
        -------
        Upper triangular, shape (columns, columns), scaled by typical sizes.
        """
        width = record.factors.shape[-1]
        lacking = np.arange(width - record.shapes, width)
        # a priori the amplitudes of the shapes have unit variance
        everything = np.concatenate([self.rows(record), np.eye(width)[lacking]])
        wanted = everything[:, self.free if columns is None else columns]
        wanted = apart_from(everything[:, [*self.state, *lacking]], wanted)
        factor = r_factor(wanted)
        return np.pad(factor, ((0, factor.shape[1] - len(factor)), (0, 0)))

    def rows(self, record: RecordInformation) -> Floats:
        """The information of what is measured of a record, in rows over the noise."""
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
            names.index(item.name)
            for item in START
            if needed.get(item.name, set()) <= {*self.sigma}
        ]


def apart_from(columns: Floats, wanted: Floats) -> Floats:
    """Other columns, projected onto the orthogonal complement of some; or those of
    each of many."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    left = left * (singular > _ROUNDING * singular[..., :1])[..., None, :]
    for _ in range(2):  # twice, against rounding errors
        wanted = wanted - left @ (left.mT @ wanted)
    return wanted


def record_information(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    widths: Mapping[str, float] | None = None,
) -> list[RecordInformation]:
    """The information of each of several throws.

    Parameters
    ----------
    widths : of the conditions to be examined, see `curlfit.inference.conditions`.

    Raises
    ------
    InputError : a stone that does not come to rest, or for which there is no motion; a
        record with fewer than two rows or more than `MOST_ROWS`.
    """
    model, channels, ends = (
        assumed.model,
        range(assumed.channels),
        ends_of(assumed, throws),
    )
    clocks = [
        clock_of(assumed, throw, rest)
        for throw, (rest, _) in zip(throws, ends, strict=True)
    ]
    responses: list[Responses] = []
    if assumed.discrepancy:  # to accelerations of the size of the friction
        even = [np.linspace(0.0, clock[-1], _ROWS) for clock in clocks]
        about = zip(even, paths_of(assumed, throws, even), throws, strict=True)
        responses = [
            Responses.of(times, path, throw.stone) for times, path, throw in about
        ]
    # Long records are split into several columns of a batch.
    columns = [
        (index, clock[first : first + _ROWS])
        for index, clock in enumerate(clocks)
        for first in range(0, len(clock), _ROWS)
    ]
    owner = np.array([index for index, _ in columns])

    def factors_of(some: Indices) -> Floats:
        own = [throws[index] for index in owner[some]]
        values = _vectors(assumed, own)
        problems = _problems(own, [columns[place][1] for place in some], len(channels))
        jacobian = (
            np.asarray(linearize(model, values, problems)[1])
            * assumed.parameters.typical
        )
        if widths:
            paths = predict_many(model, values, problems, FEW)
            changes = residual_changes(model, problems, values, paths, widths, FEW)
            jacobian = np.concatenate(
                [jacobian, np.stack(list(changes.values()), -1)], -1
            )
        if (lost := ~np.isfinite(jacobian).all((1, 2, 3))).any():
            raise _no_motion(assumed, own[int(np.argmax(lost))])
        if responses:
            about = zip(owner[some], problems.times, strict=True)
            lacking = [
                [responses[one].at(t, row) for row in channels] for one, t in about
            ]
            scale = assumed.discrepancy * problems.weight[..., None]
            jacobian = np.concatenate([jacobian, scale * lacking], -1)
        return r_factor(jacobian)

    factors = in_batches(factors_of, (np.arange(len(columns)),), FEW)
    shapes = responses[0].by_channel.shape[-1] if responses else 0
    return [
        RecordInformation(
            len(clock),
            float(clock[-1]),
            rest,
            distance,
            r_factor(np.concatenate(factors[owner == index], 1)),
            shapes,
        )
        for index, (clock, (rest, distance)) in enumerate(
            zip(clocks, ends.tolist(), strict=True)
        )
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
    return predict_many(assumed.model, _vectors(assumed, throws), problems, FEW)


def exact_problems(
    assumed: Assumptions, throws: Sequence[PlannedThrow]
) -> tuple[Problem, Floats]:
    """Problems of throws, along the first axis, whose data have no noise, and the
    values of their parameters, shape (throws, parameters).

    Each has `_ROWS` rows at most, evenly spread, whose weights stand for all rows of
    the record.
    """
    clocks = []
    shares = []
    for throw, record in zip(throws, assumed.records(throws), strict=True):
        clock = clock_of(assumed, throw, record.rest)
        places = np.linspace(0, len(clock) - 1, _ROWS)
        chosen = clock[np.unique(places.round().astype(int))]
        clocks.append(chosen)
        shares.append(len(chosen) / len(clock))
    problems = _problems(throws, clocks, assumed.channels)
    sigma = np.array([assumed.sigma.get(name, np.inf) for name in CHANNELS])
    noise = sigma[: assumed.channels, None] * np.sqrt(shares)[:, None, None]
    observed = paths_of(assumed, throws, clocks)[:, : assumed.channels]
    problems = problems._replace(observed=observed, weight=problems.weight / noise)
    return problems, _vectors(assumed, throws)


def _vectors(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> Floats:
    """Parameter vectors of throws from the origin."""
    return np.array(
        [
            [*assumed.values, *(getattr(throw, item.name, 0.0) for item in START)]
            for throw in throws
        ]
    )


def _problems(
    throws: Sequence[PlannedThrow], clocks: Sequence[Floats], channels: int
) -> Problem:
    """Problems with unit noise, whose residuals have the derivatives of the trajectory,
    of throws at times of each."""
    times = np.stack(
        [np.pad(clock, (0, _ROWS - len(clock)), mode="edge") for clock in clocks]
    )
    seen = np.arange(_ROWS) < np.array([len(clock) for clock in clocks])[:, None]
    weight = np.repeat(seen[:, None].astype(float), channels, axis=1)
    stone = stacked([jax.tree.map(float, throw.stone) for throw in throws])
    level = jax.tree.map(lambda value: np.full(len(throws), value), LEVEL_AND_STILL)
    return Problem(
        times, np.zeros_like(weight), weight, stone, level, np.zeros(len(throws), int)
    )


def ends_of(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> Floats:
    """Time of rest (s), extrapolated beyond `LONGEST`, and distance (m) of throws."""
    ends = np.empty((len(throws), 2))
    for stone in {throw.stone for throw in throws}:
        own = [row for row, throw in enumerate(throws) if throw.stone == stone]
        values, whole = (
            _vectors(assumed, [throws[row] for row in own]),
            np.array([0.0, LONGEST]),
        )
        state, rest = motions(assumed.model, values, stone, LEVEL_AND_STILL, whole)
        ends[own] = np.column_stack([rest, np.hypot(*state[:, :2, -1].T)])
    for throw, (rest, distance) in zip(throws, ends, strict=True):
        if np.isnan([rest, distance]).any():
            raise _no_motion(assumed, throw)
        if assumed.until is None and not 0 < rest <= LONGEST:
            raise InputError(
                f"a stone of {throw.v0:g} m/s and {throw.omega0:g} rad/s does "
                f"not come to rest within {LONGEST:g} s; give the length of the "
                "record (--until)"
            )
    return ends


def _no_motion(assumed: Assumptions, throw: PlannedThrow) -> InputError:
    return InputError(
        f"law {assumed.law.name} with {assumed.load} load admits no motion from "
        f"{throw.v0:g} m/s and {throw.omega0:g} rad/s{no_motion_because(assumed.load)}"
    )
