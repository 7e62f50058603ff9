"""What a throw would tell, before it is made: its Fisher information, from the exact derivatives.

Information is J^T W J, J the derivatives of the path by coefficients and start, W = 1/sigma^2 of
independent Gaussian noise. It is kept as a square root: an upper triangle R with R^T R = J^T W J,
found by QR of J itself, for squaring would cost half the digits, and with them the difference
between what is hardly seen and what is not seen at all. Triangles of throws, or of channels,
stacked upon each other are the root of their sum.

Columns are by typical sizes of the parameters, as in `curlfit.inference.identifiability`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.friction import Law, Load, no_motion_because
from curlfit.inference.identifiability import visible
from curlfit.inference.likelihood import linearize, predict_channels
from curlfit.inference.parameters import START
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import BATCH
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS

LONGEST = 120.0
"""Seconds within which a stone has to come to rest where no end of the record is given."""
MOST_ROWS = 50_000
"""Rows of one throw."""

_ROWS = 256  # computed at a time: the shape that fits have, so that their programs serve
_ROUNDING = 1e-13  # of the largest singular value of the start's columns
_SEES = 1e-3  # share of a weighted sum outside what is seen, from which it is not known


class Trial(NamedTuple):
    """A throw that could be made."""

    v0: float
    """initial speed, m/s, > 0"""
    omega0: float
    """initial spin, rad/s, counter-clockwise positive"""
    rate: float
    """rows a second"""
    stone: Stone


class Told(NamedTuple):
    """What the record of a throw would hold."""

    rows: int
    last: float
    """time of the last row, s since the first"""
    rest: float
    """when the stone comes to rest, s since the first row"""
    distance: float
    """from the first row to where it comes to rest, m"""
    roots: Floats
    """by channel, for noise of 1 m, 1 rad ...: root of the information on coefficients and start,
    by typical sizes; shape (channels, parameters, parameters)"""


def told(
    law: type[Law],
    load: Load,
    coefficients: Floats,
    trials: Sequence[Trial],
    *,
    until: float | None = None,
    channels: int = 3,
) -> list[Told]:
    """What each of some throws would tell.

    Parameters
    ----------
    coefficients : of the law, shape (k,).
    until : end of the records in s; when the stone has come to rest if None.
    channels : how many of x, y, phi, speed, omega: 3 or 5.

    Raises
    ------
    InputError : a stone that does not come to rest, or for which there is no motion; a record
        without two rows, or with more than `MOST_ROWS`.
    """
    typical = np.array([item.typical for item in (*law.coefficients(), *START)])
    clocks, ends = [], []
    for trial in trials:
        rest, distance = _rest(law, load, coefficients, trial, needed=until is None)
        end = rest if until is None else until
        rows = math.floor(end * trial.rate + 1e-9) + 1
        if not 2 <= rows <= MOST_ROWS:
            raise InputError(
                f"{end:.4g} s at {trial.rate:g} Hz make {rows} rows; expected 2 to {MOST_ROWS}"
            )
        clocks.append(np.arange(rows) / trial.rate)
        ends.append((rest, distance))
    # Long records are followed in several lanes, a part of the rows in each.
    parts = [
        (place, clock[first : first + _ROWS])
        for place, clock in enumerate(clocks)
        for first in range(0, len(clock), _ROWS)
    ]
    triangles: list[list[Floats]] = [[] for _ in trials]
    for first in range(0, len(parts), BATCH):
        some = parts[first : first + BATCH]
        lanes = some + [some[-1]] * (BATCH - len(some))
        own = [trials[place] for place, _ in lanes]
        values = np.stack([_vector(coefficients, trial) for trial in own])
        _, found = linearize(law, load, values, _problems(lanes, own, channels))
        jacobian = np.asarray(found) * typical
        for lane, (place, _) in enumerate(some):
            if not np.isfinite(jacobian[lane]).all():
                raise _no_motion(law, load, trials[place])
            triangles[place].append(_triangle(jacobian[lane]))
    return [
        Told(len(clock), float(clock[-1]), *end, _triangle(np.concatenate(parts, 1)))
        for clock, end, parts in zip(clocks, ends, triangles, strict=True)
    ]


def _triangle(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _vector(coefficients: Floats, trial: Trial) -> Floats:
    start = {"v0": trial.v0, "omega0": trial.omega0}
    return np.array([*coefficients, *(start.get(item.name, 0.0) for item in START)])


def _problems(lanes: Sequence[tuple[int, Floats]], own: Sequence[Trial], channels: int) -> Problem:
    """The lanes as data whose residuals have the derivatives of the path itself, noise of 1."""
    n = len(lanes)
    weight = np.zeros((n, channels, _ROWS))
    times = np.empty((n, _ROWS))
    for lane, (_, clock) in enumerate(lanes):
        weight[lane, :, : len(clock)] = 1.0
        times[lane] = np.pad(clock, (0, _ROWS - len(clock)), mode="edge")
    stones = [trial.stone.as_dict() for trial in own]
    stone = Stone(**{name: np.array([float(one[name]) for one in stones]) for name in stones[0]})  # type: ignore[arg-type]
    return Problem(
        times, np.zeros_like(weight), weight, stone, np.zeros(n, int), np.full(n, -1, int)
    )


def _rest(
    law: type[Law], load: Load, coefficients: Floats, trial: Trial, *, needed: bool
) -> tuple[float, float]:
    """When the stone comes to rest (s), later than `LONGEST` only if not needed, and where (m)."""
    # The row of the model that says when a stone came to rest, asked at half of the longest time.
    times = np.full(_ROWS, LONGEST / 2)
    problem = Problem(
        times, np.zeros((3, _ROWS)), np.ones((3, _ROWS)),
        jax.tree.map(lambda value: np.asarray(float(value)), trial.stone),
        np.asarray(0), np.asarray(0),
    )  # fmt: skip
    x, y, _, early, _ = np.asarray(
        predict_channels(law, load, _vector(coefficients, trial), problem)
    )[:, 0]
    rest = times[0] * trial.v0 / (trial.v0 - early)
    if math.isnan(rest):
        raise _no_motion(law, load, trial)
    if needed and not 0 < rest <= LONGEST:
        raise InputError(
            f"a stone of {trial.v0:g} m/s and {trial.omega0:g} rad/s does not come to rest within "
            f"{LONGEST:g} s; give the length of the record (--until)"
        )
    return float(rest), float(np.hypot(x, y))


def _no_motion(law: type[Law], load: Load, trial: Trial) -> InputError:
    return InputError(
        f"law {law.name} with {load} load admits no motion from {trial.v0:g} m/s and "
        f"{trial.omega0:g} rad/s{no_motion_because(load)}"
    )


def about_coefficients(
    law: type[Law], told: Told, sigma: Mapping[str, float], free: Booleans
) -> Floats:
    """Root of the information on the free coefficients, whatever the start was.

    The Schur complement of the start: what the columns of the coefficients have outside the space
    of those of the start.

    Parameters
    ----------
    sigma : noise by channel (SI); channels without one are not measured, and the start that only
        they could tell is known, as in a fit.
    free : which coefficients are to be determined, shape (k,).

    Returns
    -------
    Upper triangle, shape (free, free), by typical sizes.
    """
    k = len(law.coefficients())
    rows = [
        told.roots[row] / sigma[name]
        for row, name in enumerate(CHANNELS[: len(told.roots)])
        if name in sigma
    ]
    whole = np.concatenate(rows)
    place = {"x", "y"} <= sigma.keys()
    known = {"x0": "x" in sigma, "y0": "y" in sigma, "phi0": "phi" in sigma, "heading": place}
    columns = [k + column for column, item in enumerate(START) if known.get(item.name, True)]
    wanted, start = whole[:, :k][:, free], whole[:, columns]
    left, singular, _ = np.linalg.svd(start, full_matrices=False)
    left = left[:, singular > _ROUNDING * singular[0]]
    for _ in range(2):  # once more, for what rounding has left
        wanted = wanted - left @ (left.T @ wanted)
    root = _triangle(wanted)
    full = np.zeros((root.shape[1], root.shape[1]))
    full[: len(root)] = root
    return full


def joined(roots: Sequence[Floats]) -> Floats:
    """Root of the information of several throws together."""
    return _triangle(np.concatenate(list(roots)))


def error_of(root: Floats, weights: Floats) -> float | None:
    """Standard error of a weighted sum of coefficients; None where it is not seen.

    Parameters
    ----------
    root : by typical sizes, shape (free, free).
    weights : of the free coefficients over their typical sizes, times these: shape (free,).
    """
    _, singular, right = np.linalg.svd(root)
    seen = visible(singular)
    along = right[seen] @ weights
    if np.linalg.norm(weights - right[seen].T @ along) > _SEES * np.linalg.norm(weights):
        return None
    return float(np.linalg.norm(along / singular[seen]))
