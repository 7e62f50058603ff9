"""Fisher information of planned throws, from exact derivatives, and the best choice of N of them.

The information is J^T W J, with J the derivatives of the trajectory with respect to coefficients
and initial state, and W = 1/sigma^2 of independent Gaussian noise. It is stored as its factor R, an
upper triangular matrix with R^T R = J^T W J, by QR of J itself: forming the product would lose half
the digits, and with them the distinction between weakly determined and undetermined directions.
The QR of the stacked factors of several throws or channels gives the factor of the sum of their
information.

Columns are scaled by typical sizes of the parameters, as in `curlfit.inference.identifiability`.

Throws are chosen with repetition. D: largest determinant of the information, that is the smallest
volume of the confidence ellipsoid. A: smallest sum of squared standard errors over typical sizes
(Atkinson, Donev and Tobias 2007). C: smallest standard error of one linear combination. Where all
candidates together do not determine all directions, D and A refer to the subspace that they
determine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.friction import Law, Load, no_motion_because
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.identifiability import Bounded, confined, r_factor, stderr_of, visible
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import linearize, predict_many, prepare_many
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.parameters import START, ParameterSet
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches, stacked
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS

_MAX_ENUMERATED = 20_000  # designs; for more, exchanges of one throw at a time
_MAX_ROUNDS = 50
_SINGULAR = 1e-12  # share of the information of all candidates in an undetermined direction

Criterion = Callable[[Floats], Floats]
LONGEST = 120.0
"""Seconds within which a stone must come to rest if the end of the record is not given."""
MOST_ROWS = 50_000
"""Maximum number of rows of one throw."""

_REFINEMENTS = 3  # 120 s/255^3 is a hundred thousandth of a second
_ROWS = 256  # in a column of a batch
_BATCH = 16  # columns; few, so that one or two throws do not leave most of them empty
_ROUNDING = 1e-13  # relative to the largest singular value of the columns of the initial state


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
    """by channel, for noise of 1 m, 1 rad ...: R factor of the information on coefficients and
    initial state, scaled by typical sizes, on the conditions examined, scaled by their widths, and
    on the shapes of a model discrepancy, scaled by their sizes; shape (channels, parameters,
    parameters)"""
    shapes: int = 0
    """number of shapes of a model discrepancy"""


@dataclass(frozen=True, eq=False)
class Assumptions:
    """A law with assumed values of its coefficients, and what is measured of its throws.

    Attributes
    ----------
    values : of all coefficients, shape (k,).
    sigma : noise by channel (SI); channels without one are not measured.
    until : end of the records in s; the time of rest if None.
    discrepancy : size of the accelerations that the law may lack, relative to the friction; see
        `curlfit.inference.noise.accelerations`.
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
        """Their values and bounds; one beyond which the value lies was not that of its fit."""
        known = self.parameters
        values, lower, upper = (part[self.free] for part in (self.values, known.lower, known.upper))
        return Bounded(
            values, np.where(values > lower, lower, -np.inf),
            np.where(values < upper, upper, np.inf),
        )  # fmt: skip

    def weights(self, combination: Mapping[str, float]) -> Floats:
        """A combination of free coefficients as `standard_error` takes it."""
        return np.array([combination.get(name, 0.0) for name in self.names]) * self.typical

    def errors(
        self, factor: Floats, quantities: Mapping[str, Mapping[str, float]]
    ) -> dict[str, float | None]:
        """Standard errors of combinations within the bounds, by name."""
        factor = confined(factor / self.typical, self.bounded, self.typical) * self.typical
        return {name: standard_error(factor, self.weights(of)) for name, of in quantities.items()}

    def noisier(self, channels: Iterable[str], factor: float) -> Assumptions:
        """The same with the noise of some channels multiplied."""
        sigma = dict(self.sigma)
        return replace(self, sigma=sigma | {name: factor * sigma[name] for name in channels})

    @cached_property
    def by_load(self) -> dict[Load, Assumptions]:
        """The same for an exact law, under each load."""
        loads: tuple[Load, ...] = ("uniform", "consistent")
        own = {} if self.discrepancy else {self.load: self}
        return {load: replace(self, load=load, discrepancy=0.0) for load in loads} | own

    @cached_property
    def _known(self) -> dict[PlannedThrow, RecordInformation]:
        return {}

    def records(self, throws: Sequence[PlannedThrow]) -> list[RecordInformation]:
        """The information of each of several throws, computed once."""
        if new := [throw for throw in dict.fromkeys(throws) if throw not in self._known]:
            self._known.update(zip(new, record_information(self, new), strict=True))
        return [self._known[throw] for throw in throws]


def prepare_information(assumed: Assumptions, throw: PlannedThrow) -> None:
    """Begin compiling the programs that `record_information` needs."""
    some = [(throw, np.arange(2.0))] * _BATCH
    values, problems = _stacked(assumed, some, assumed.channels)
    prepare_many(assumed.model, values, problems)
    linearize.prepare(assumed.model, values, problems)


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
    InputError : a stone that does not come to rest, or for which there is no motion; a record
        with fewer than two rows or more than `MOST_ROWS`.
    """
    model, channels, ends = assumed.model, range(assumed.channels), _rests(assumed, throws)
    clocks = [_clock(assumed, throw, rest) for throw, (rest, _) in zip(throws, ends, strict=True)]
    responses: list[Responses] = []
    if assumed.discrepancy:  # to accelerations of the size of the friction
        even = np.linspace(0.0, [clock[-1] for clock in clocks], _ROWS, axis=-1)
        about = zip(even, _paths(assumed, throws, even), throws, strict=True)
        responses = [Responses.of(times, path, throw.stone) for times, path, throw in about]
    # Long records are split into several columns of a batch.
    columns = [
        (index, clock[first : first + _ROWS])
        for index, clock in enumerate(clocks)
        for first in range(0, len(clock), _ROWS)
    ]

    def factors_of(some: Indices) -> Floats:
        owners = [columns[place][0] for place in some]
        batch = [(throws[columns[place][0]], columns[place][1]) for place in some]
        values, problems = _stacked(assumed, batch, len(channels))
        jacobian = np.asarray(linearize(model, values, problems)[1]) * assumed.parameters.typical
        if widths:
            paths = predict_many(model, values, problems, _BATCH)
            changes = residual_changes(model, problems, values, paths, widths, _BATCH)
            jacobian = np.concatenate([jacobian, np.stack(list(changes.values()), -1)], -1)
        if (lost := ~np.isfinite(jacobian).all((1, 2, 3))).any():
            raise _no_motion(assumed, batch[int(np.argmax(lost))][0])
        if responses:
            about = zip(owners, problems.times, strict=True)
            lacking = [[responses[own].at(t, row) for row in channels] for own, t in about]
            scale = assumed.discrepancy * problems.weight[..., None]
            jacobian = np.concatenate([jacobian, scale * lacking], -1)
        return r_factor(jacobian)

    factors = in_batches(factors_of, (np.arange(len(columns)),), _BATCH)
    owner = np.array([index for index, _ in columns])
    shapes = responses[0].by_channel.shape[-1] if responses else 0
    return [
        RecordInformation(
            len(clock), float(clock[-1]), *end,
            r_factor(np.concatenate(factors[owner == index], 1)), shapes,
        )
        for index, (clock, end) in enumerate(zip(clocks, ends, strict=True))
    ]  # fmt: skip


def _clock(assumed: Assumptions, throw: PlannedThrow, rest: float) -> Floats:
    """Times of the rows of a record, s."""
    end = rest if assumed.until is None else assumed.until
    rows = math.floor(end * throw.rate + 1e-9) + 1
    if not 2 <= rows <= MOST_ROWS:
        raise InputError(
            f"{end:.4g} s at {throw.rate:g} Hz make {rows} rows; expected 2 to {MOST_ROWS}"
        )
    return np.arange(rows) / throw.rate


def _paths(
    assumed: Assumptions, throws: Sequence[PlannedThrow], clocks: Iterable[Floats]
) -> Floats:
    """x, y, phi, speed and spin of throws at `_ROWS` times of each, shape (throws, 5, times)."""
    values, problems = _stacked(assumed, list(zip(throws, clocks, strict=True)), 3)
    return predict_many(assumed.model, values, problems, _BATCH)


def _stacked(
    assumed: Assumptions, batch: Sequence[tuple[PlannedThrow, Floats]], channels: int
) -> tuple[Floats, Problem]:
    """Parameter vectors, and problems with unit noise, whose residuals have the derivatives of the
    trajectory, of throws with their times."""
    n = len(batch)
    weight, times = np.zeros((n, channels, _ROWS)), np.empty((n, _ROWS))
    values = np.zeros((n, len(assumed.values) + len(START)))
    values[:, : len(assumed.values)] = assumed.values
    places = {item.name: k for k, item in enumerate(START, start=len(assumed.values))}
    for column, (throw, clock) in enumerate(batch):
        weight[column, :, : len(clock)] = 1.0
        times[column] = np.pad(clock, (0, _ROWS - len(clock)), mode="edge")
        for name, value in (("v0", throw.v0), ("omega0", throw.omega0), ("heading", throw.heading)):
            values[column, places[name]] = value
    stone = stacked([jax.tree.map(float, throw.stone) for throw, _ in batch])
    level = jax.tree.map(lambda value: np.full(n, value), LEVEL_AND_STILL)
    return values, Problem(times, np.zeros_like(weight), weight, stone, level, np.zeros(n, int))


def _rests(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> list[tuple[float, float]]:
    """Time of rest (s), above `LONGEST` only where the records end before, and distance (m) of
    throws."""
    # The first time at rest, on successively finer grids.
    early, late = np.zeros(len(throws)), np.full(len(throws), LONGEST)
    moves = np.zeros(len(throws), bool)
    for _ in range(_REFINEMENTS):
        clocks = np.linspace(early, late, _ROWS, axis=-1)
        paths = _paths(assumed, throws, clocks)
        speed = paths[:, 3]
        if (lost := np.isnan(speed).any(1)).any():
            raise _no_motion(assumed, throws[int(np.argmax(lost))])
        moves |= (speed > 0).all(1)
        first = np.maximum(np.argmax(speed == 0, 1), 1)[:, None]
        early, late = (np.take_along_axis(clocks, first - k, 1)[:, 0] for k in (1, 0))
        early, late = np.where(moves, 0.0, early), np.where(moves, LONGEST, late)
    times = np.where(moves, 2 * LONGEST, late)
    for throw, rest in zip(throws, times, strict=True):
        if assumed.until is None and not 0 < rest <= LONGEST:
            raise InputError(
                f"a stone of {throw.v0:g} m/s and {throw.omega0:g} rad/s does not come to rest "
                f"within {LONGEST:g} s; give the length of the record (--until)"
            )
    distances = np.hypot(paths[:, 0, -1], paths[:, 1, -1])
    return list(zip(times.tolist(), distances.tolist(), strict=True))


def _no_motion(assumed: Assumptions, throw: PlannedThrow) -> InputError:
    return InputError(
        f"law {assumed.law.name} with {assumed.load} load admits no motion from {throw.v0:g} m/s "
        f"and {throw.omega0:g} rad/s{no_motion_because(assumed.load)}"
    )


def marginal_factors(assumed: Assumptions, throws: Sequence[PlannedThrow]) -> list[Floats]:
    """R factor of the information of each throw on the free coefficients."""
    return [marginal_factor(assumed, one) for one in assumed.records(throws)]


def marginal_factor(
    assumed: Assumptions, record: RecordInformation, columns: Indices | None = None
) -> Floats:
    """R factor of the information on some columns of a record, marginal over the initial state.

    The Schur complement: the columns are projected onto the orthogonal complement of those of the
    initial state. Initial values that only channels without noise determine are fixed, as in a fit.

    Parameters
    ----------
    columns : by default those of the free coefficients.

    Returns
    -------
    Upper triangular, shape (columns, columns), scaled by typical sizes.
    """
    sigma, width = assumed.sigma, record.factors.shape[-1]
    rows = [
        factor / sigma[name]
        for name, factor in zip(CHANNELS, record.factors, strict=False)
        if name in sigma
    ]
    lacking = np.arange(width - record.shapes, width)
    # a priori the amplitudes of the shapes have unit variance
    everything = np.concatenate([*rows, np.eye(width)[lacking]])
    needed = {"x0": {"x"}, "y0": {"y"}, "phi0": {"phi"}, "heading": {"x", "y"}}
    names = assumed.parameters.names
    state = [names.index(item.name) for item in START if needed.get(item.name, set()) <= {*sigma}]
    wanted = everything[:, assumed.free if columns is None else columns]
    left, singular, _ = np.linalg.svd(everything[:, [*state, *lacking]], full_matrices=False)
    left = left[:, singular > _ROUNDING * singular[0]]
    for _ in range(2):  # twice, against rounding errors
        wanted = wanted - left @ (left.T @ wanted)
    factor = r_factor(wanted)
    return np.pad(factor, ((0, factor.shape[1] - len(factor)), (0, 0)))


def combined(factors: Sequence[Floats]) -> Floats:
    """R factor of the information of several throws together."""
    return r_factor(np.concatenate(list(factors)))


def standard_error(factor: Floats, weights: Floats) -> float | None:
    """Standard error of a linear combination of coefficients; None where it is undetermined.

    Parameters
    ----------
    factor : scaled by typical sizes, shape (free, free).
    weights : of the free coefficients, times their typical sizes, shape (free,).
    """
    _, singular, right = np.linalg.svd(factor)
    mask = visible(singular)
    return stderr_of(weights, right[mask], singular[mask])


class CandidateSet(NamedTuple):
    """The information of candidates, whitened by that of all of them together."""

    information: Floats
    """of each candidate, shape (candidates, rank, rank); their sum is the identity matrix"""
    basis: Floats
    """whitened directions in coefficients over their typical sizes, shape (free, rank)"""
    factors: Sequence[Floats]
    """R factor of the information of each candidate"""

    @property
    def rank(self) -> int:
        """Number of directions that the candidates together determine."""
        return self.basis.shape[1]

    @classmethod
    def from_factors(cls, factors: Sequence[Floats]) -> CandidateSet:
        """The set from the R factors of the information of each candidate."""
        _, singular, right = np.linalg.svd(combined(factors))
        mask = visible(singular)
        basis = right[mask].T / singular[mask]
        whitened = np.stack([factor @ basis for factor in factors])
        return cls(np.swapaxes(whitened, 1, 2) @ whitened, basis, factors)

    def together(self, indices: Sequence[int]) -> Floats:
        """R factor of the information of some candidates together."""
        return combined([self.factors[index] for index in indices])


def d_criterion(information: Floats) -> Floats:
    """D: minus the logarithm of the determinant, up to a constant."""
    sign, size = np.linalg.slogdet(information)
    return np.where(_nonsingular(information) & (sign > 0), -size, np.inf)


def error_criterion(candidates: CandidateSet, weights: Floats) -> Criterion:
    """Sum of the squared standard errors of linear combinations (rows of weights by typical sizes):
    A for the coefficients themselves, C for one combination."""
    along = np.atleast_2d(weights) @ candidates.basis
    return lambda information: _trace(information, along.T @ along)


def _nonsingular(information: Floats) -> Booleans:
    return np.linalg.eigvalsh(information)[..., 0] > _SINGULAR


def _trace(information: Floats, of: Floats) -> Floats:
    nonsingular = _nonsingular(information)
    safe = np.where(nonsingular[..., None, None], information, np.eye(information.shape[-1]))
    return np.where(nonsingular, np.trace(np.linalg.solve(safe, of), axis1=-2, axis2=-1), np.inf)


def select_design(
    candidates: CandidateSet, criterion: Criterion, throws: int
) -> tuple[int, ...] | None:
    """Indices of the optimal throws, sorted; None if no choice determines all directions.

    Small sets of designs are enumerated; otherwise throws are exchanged one at a time (Fedorov
    1972), from a greedy start.
    """
    n = len(candidates.information)
    if comb(n + throws - 1, throws) <= _MAX_ENUMERATED:
        choices = np.array(list(combinations_with_replacement(range(n), throws)))
        value = criterion(candidates.information[choices].sum(1))
        best = int(np.argmin(value))
        return tuple(map(int, choices[best])) if np.isfinite(value[best]) else None
    # A small multiple of the total information keeps the criterion finite at first.
    total = 1e-6 * candidates.information.sum(0)
    indices: list[int] = []
    for _ in range(throws):
        indices.append(int(np.argmin(criterion(total + candidates.information))))
        total = total + candidates.information[indices[-1]]
    total = candidates.information[indices].sum(0)
    for _ in range(_MAX_ROUNDS):
        previous = list(indices)
        for position, index in enumerate(indices):
            rest = total - candidates.information[index]
            indices[position] = int(np.argmin(criterion(rest + candidates.information)))
            total = rest + candidates.information[indices[position]]
        if indices == previous:
            break
    value = criterion(candidates.information[indices].sum(0))
    return tuple(sorted(indices)) if np.isfinite(value) else None
