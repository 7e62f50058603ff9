"""Fisher information of planned throws, from exact derivatives.

The information is J^T W J, with J the derivatives of the trajectory with respect to coefficients
and initial state, and W = 1/sigma^2 of independent Gaussian noise. It is stored as its factor R, an
upper triangular matrix with R^T R = J^T W J, by QR of J itself: forming the product would lose half
the digits, and with them the distinction between weakly determined and undetermined directions.
The QR of the stacked factors of several throws or channels gives the factor of the sum of their
information.

Columns are scaled by typical sizes of the parameters, as in `curlfit.inference.identifiability`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.friction import Law, Load, no_motion_because
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.identifiability import r_factor, visible
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import linearize, predict_many, prepare_many
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS

LONGEST = 120.0
"""Seconds within which a stone must come to rest if the end of the record is not given."""
MOST_ROWS = 50_000
"""Maximum number of rows of one throw."""

_REFINEMENTS = 3  # 120 s/255^3 is a hundred thousandth of a second
_ROWS = 256  # in a column of a batch
_BATCH = 16  # columns; few, so that one or two throws do not leave most of them empty
_ROUNDING = 1e-13  # relative to the largest singular value of the columns of the initial state
_UNDETERMINED = (
    1e-3  # fraction of a combination outside the determined subspace above which it is unknown
)


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


def prepare_information(
    law: type[Law], load: Load, coefficients: Floats, throw: PlannedThrow, channels: int
) -> None:
    """Begin compiling the programs that `record_information` needs."""
    own = [throw] * _BATCH
    problems = _problems([(0, np.arange(2.0))] * _BATCH, own, channels)
    values = np.stack([_vector(coefficients, one) for one in own])
    prepare_many(Model(law, load), values, problems)
    linearize.prepare(Model(law, load), values, problems)


def record_information(
    law: type[Law],
    load: Load,
    coefficients: Floats,
    throws: Sequence[PlannedThrow],
    *,
    until: float | None = None,
    channels: int = 3,
    widths: Mapping[str, float] | None = None,
    discrepancy: float = 0.0,
) -> list[RecordInformation]:
    """The information of each of several throws.

    Parameters
    ----------
    coefficients : of the law, shape (k,).
    until : end of the records in s; the time of rest if None.
    channels : number of the channels x, y, phi, speed, omega: 3 or 5.
    widths : of the conditions to be examined, see `curlfit.inference.conditions`.
    discrepancy : size of the accelerations that the law may lack, relative to the friction; see
        `curlfit.inference.noise.accelerations`.

    Raises
    ------
    InputError : a stone that does not come to rest, or for which there is no motion; a record
        with fewer than two rows or more than `MOST_ROWS`.
    """
    typical = np.array([item.typical for item in (*law.coefficients(), *START)])
    clocks = []
    ends = _rests(law, load, coefficients, throws, required=until is None)
    for throw, (rest, _) in zip(throws, ends, strict=True):
        end = rest if until is None else until
        rows = math.floor(end * throw.rate + 1e-9) + 1
        if not 2 <= rows <= MOST_ROWS:
            raise InputError(
                f"{end:.4g} s at {throw.rate:g} Hz make {rows} rows; expected 2 to {MOST_ROWS}"
            )
        clocks.append(np.arange(rows) / throw.rate)
    # Long records are split into several columns of a batch.
    parts = [
        (index, clock[first : first + _ROWS])
        for index, clock in enumerate(clocks)
        for first in range(0, len(clock), _ROWS)
    ]
    factors: list[list[Floats]] = [[] for _ in throws]
    responses = (
        _responses(law, load, coefficients, throws, [clock[-1] for clock in clocks])
        if discrepancy
        else None
    )
    for first in range(0, len(parts), _BATCH):
        some = parts[first : first + _BATCH]
        batch = some + [some[-1]] * (_BATCH - len(some))
        own = [throws[index] for index, _ in batch]
        values = np.stack([_vector(coefficients, throw) for throw in own])
        problems, model = _problems(batch, own, channels), Model(law, load)
        _, found = linearize(model, values, problems)
        jacobian = np.asarray(found) * typical
        if widths:
            paths = predict_many(model, values, problems, _BATCH)
            changes = residual_changes(model, problems, values, paths, widths, "linear", _BATCH)
            jacobian = np.concatenate([jacobian, np.stack(list(changes.values()), -1)], -1)
        for column, (index, _) in enumerate(some):
            if not np.isfinite(jacobian[column]).all():
                raise _no_motion(law, load, throws[index])
            own_rows = jacobian[column]
            if responses is not None:
                here = problems.times[column]
                lacking = [responses[index].at(here, row) for row in range(channels)]
                weighted = discrepancy * np.stack(lacking) * problems.weight[column][..., None]
                own_rows = np.concatenate([own_rows, weighted], -1)
            factors[index].append(r_factor(own_rows))
    shapes = 0 if responses is None else responses[0].by_channel.shape[-1]
    return [
        RecordInformation(
            len(clock), float(clock[-1]), *end, r_factor(np.concatenate(parts, 1)), shapes
        )
        for clock, end, parts in zip(clocks, ends, factors, strict=True)
    ]


def _responses(
    law: type[Law], load: Load, coefficients: Floats, throws: Sequence[PlannedThrow],
    ends: Sequence[float],
) -> list[Responses]:  # fmt: skip
    """Responses of the paths of throws to accelerations of the size of the friction."""
    clocks = [np.linspace(0.0, end, _ROWS) for end in ends]
    return [
        Responses.of(clock, path, throw.stone)
        for clock, path, throw in zip(
            clocks, _paths(law, load, coefficients, throws, clocks), throws, strict=True
        )
    ]


def _paths(
    law: type[Law], load: Load, coefficients: Floats, throws: Sequence[PlannedThrow],
    clocks: Iterable[Floats],
) -> Floats:  # fmt: skip
    """x, y, phi, speed and spin of throws at `_ROWS` times of each, shape (throws, 5, times)."""
    values = np.stack([_vector(coefficients, throw) for throw in throws])
    problems = _problems(list(enumerate(clocks)), throws, 3)
    return predict_many(Model(law, load), values, problems, _BATCH)


def _vector(coefficients: Floats, throw: PlannedThrow) -> Floats:
    start = {"v0": throw.v0, "omega0": throw.omega0, "heading": throw.heading}
    return np.array([*coefficients, *(start.get(item.name, 0.0) for item in START)])


def _problems(
    batch: Sequence[tuple[int, Floats]], own: Sequence[PlannedThrow], channels: int
) -> Problem:
    """Problems with unit noise, whose residuals have the derivatives of the trajectory."""
    n = len(batch)
    weight = np.zeros((n, channels, _ROWS))
    times = np.empty((n, _ROWS))
    for column, (_, clock) in enumerate(batch):
        weight[column, :, : len(clock)] = 1.0
        times[column] = np.pad(clock, (0, _ROWS - len(clock)), mode="edge")
    stones = [throw.stone.as_dict() for throw in own]
    stone = Stone(**{name: np.array([float(one[name]) for one in stones]) for name in stones[0]})  # type: ignore[arg-type]
    level = jax.tree.map(lambda value: np.full(n, value), LEVEL_AND_STILL)
    return Problem(times, np.zeros_like(weight), weight, stone, level, np.zeros(n, int))


def _rests(
    law: type[Law], load: Load, coefficients: Floats, throws: Sequence[PlannedThrow], *,
    required: bool,
) -> list[tuple[float, float]]:  # fmt: skip
    """Time of rest (s), above `LONGEST` only if not `required`, and distance (m) of throws."""
    # The first time at rest, on successively finer grids.
    early, late = np.zeros(len(throws)), np.full(len(throws), LONGEST)
    moves = np.zeros(len(throws), bool)
    for _ in range(_REFINEMENTS):
        clocks = np.linspace(early, late, _ROWS, axis=-1)
        paths = _paths(law, load, coefficients, throws, clocks)
        speed = paths[:, 3]
        if (lost := np.isnan(speed).any(1)).any():
            raise _no_motion(law, load, throws[int(np.argmax(lost))])
        moves |= (speed > 0).all(1)
        first = np.maximum(np.argmax(speed == 0, 1), 1)[:, None]
        early, late = (np.take_along_axis(clocks, first - k, 1)[:, 0] for k in (1, 0))
        early, late = np.where(moves, 0.0, early), np.where(moves, LONGEST, late)
    times = np.where(moves, 2 * LONGEST, late)
    for throw, rest in zip(throws, times, strict=True):
        if required and not 0 < rest <= LONGEST:
            raise InputError(
                f"a stone of {throw.v0:g} m/s and {throw.omega0:g} rad/s does not come to rest "
                f"within {LONGEST:g} s; give the length of the record (--until)"
            )
    distances = np.hypot(paths[:, 0, -1], paths[:, 1, -1])
    return list(zip(map(float, times), map(float, distances), strict=True))


def _no_motion(law: type[Law], load: Load, throw: PlannedThrow) -> InputError:
    return InputError(
        f"law {law.name} with {load} load admits no motion from {throw.v0:g} m/s and "
        f"{throw.omega0:g} rad/s{no_motion_because(load)}"
    )


def coefficient_information(
    law: type[Law], record: RecordInformation, sigma: Mapping[str, float], free: Booleans
) -> Floats:
    """R factor of the information on the free coefficients, marginal over the initial state.

    The Schur complement: the columns of the coefficients are projected onto the orthogonal
    complement of those of the initial state.

    Parameters
    ----------
    sigma : noise by channel (SI); channels without one are not measured, and the initial
        values that only they determine are fixed, as in a fit.
    free : mask of the free coefficients, shape (k,).

    Returns
    -------
    Upper triangular, shape (free, free), scaled by typical sizes.
    """
    return marginal_factor(law, record, sigma, np.flatnonzero(free))


def marginal_factor(
    law: type[Law], record: RecordInformation, sigma: Mapping[str, float], columns: Indices
) -> Floats:
    """R factor of the information on some columns of a record, marginal over the initial state.

    Parameters and result as for `coefficient_information`, with columns in place of coefficients.
    """
    k = len(law.coefficients())
    rows = [
        record.factors[row] / sigma[name]
        for row, name in enumerate(CHANNELS[: len(record.factors)])
        if name in sigma
    ]
    lacking = np.arange(record.factors.shape[-1])[record.factors.shape[-1] - record.shapes :]
    # a priori the amplitudes of the shapes have unit variance
    stacked = np.concatenate([*rows, np.eye(record.factors.shape[-1])[lacking]])
    estimated = {
        "x0": "x" in sigma, "y0": "y" in sigma, "phi0": "phi" in sigma,
        "heading": {"x", "y"} <= sigma.keys(),
    }  # fmt: skip
    state = [k + column for column, item in enumerate(START) if estimated.get(item.name, True)]
    wanted, start = stacked[:, columns], stacked[:, [*state, *lacking]]
    left, singular, _ = np.linalg.svd(start, full_matrices=False)
    left = left[:, singular > _ROUNDING * singular[0]]
    for _ in range(2):  # twice, against rounding errors
        wanted = wanted - left @ (left.T @ wanted)
    factor = r_factor(wanted)
    full = np.zeros((factor.shape[1], factor.shape[1]))
    full[: len(factor)] = factor
    return full


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
    along = right[mask] @ weights
    if np.linalg.norm(weights - right[mask].T @ along) > _UNDETERMINED * np.linalg.norm(weights):
        return None
    return float(np.linalg.norm(along / singular[mask]))
