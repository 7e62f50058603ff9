"""Independent proposals along the ridge of a fit's optimum.

Along a null direction the posterior is as wide as the prior, and a random walk takes
very long from one end to the other. These proposals need no walk: from a Student
distribution about the optimum along the determined directions, and uniform over the
prior along the null directions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import UnusableFitError
from curlfit.friction.base import START_NAMES
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.directions import directions_of_squares
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.solve.least_squares import Solution, Tasks, minimize_many
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import FEW, unstacked
from curlfit.wording import join_words

Indices = NDArray[np.int64]

_MARGIN = 4.0  # standard errors by which the proposal extends beyond the ridge's ends
# of freedom of the Student distribution: heavier tails than any Gaussian posterior
_DEGREES = 8.0
# standard errors of a weakly determined parameter, along which optima are sought
_REACH = 8.0
_CELLS, _PASSES = 96, 6  # intervals of it, and how often they are chosen anew
# of the probability, to be shared as if intervals were as dense as their neighbours
_ROUGH = 0.2
_BEYOND = 0.5  # of a ridge, by which the proposal extends beyond its ends
# probability density at an end over the highest, above which it has not ended, and
# share of the next intervals that lie beyond it
_ENDED, _BEYOND_ENDS = 1e-5, 0.1
_FAINT = 1e-9  # push against a bound that is none
_FAR = 100.0  # standard errors from a tangent, above which it says nothing
_NOTHING = 1e-6  # probability of an interval that is given up
_LEVEL = 1.0
"""Width of the bounds in standard errors, below which the probability is all but
uniform along a direction."""
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it


@dataclass(frozen=True)
class RidgeProposal:
    """Student along determined directions, uniform along null directions, exponential
    away from the bounds that parameters are pushed against.

    Coordinates are linear in `z = (values - centre)/typical`: determined combinations
    of it, for each null direction one parameter that takes part in it (a pivot), and
    each pushed parameter.

    Attributes
    ----------
    centre, typical : of the parameters, shape (p,).
    seen : rows of determined combinations, shape (r, p). spread : their
        standard deviations.
    pivots : indices of the pivots. low, high : their intervals, in `z`.
    pushed : indices of the pushed parameters. scale : mean distance from the bound in
        `z`, signed.
    """

    centre: Floats
    typical: Floats
    seen: Floats
    spread: Floats
    pivots: Indices
    low: Floats
    high: Floats
    pushed: Indices
    scale: Floats

    @cached_property
    def _inverse(self) -> Floats:
        unit = np.eye(len(self.centre))
        return np.linalg.inv(
            np.concatenate([self.seen, unit[self.pivots], unit[self.pushed]])
        )

    def draw(self, n: int, random: Any, *, gaussian: bool = False) -> Floats:
        """n parameter vectors, shape (n, p); Student or `gaussian` along
        determined directions."""
        along = self.spread * random.standard_normal((n, len(self.seen)))
        if not gaussian:
            along *= np.sqrt(_DEGREES / random.chisquare(_DEGREES, (n, 1)))
        across = self.low + (self.high - self.low) * random.uniform(
            size=(n, len(self.pivots))
        )
        off = self.scale * random.standard_exponential((n, len(self.pushed)))
        z = np.concatenate([along, across, off], 1) @ self._inverse.T
        draws: Floats = self.centre + self.typical * z
        return draws

    def unreached(self, values: Floats) -> float:
        """Nothing: there are no ends to reach."""
        return 0.0

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        z = (values - self.centre) / self.typical
        along = z @ self.seen.T / self.spread
        rank = len(self.seen)
        value = -(_DEGREES + rank) / 2 * np.log1p((along**2).sum(1) / _DEGREES)
        across, off = z[:, self.pivots], z[:, self.pushed] / self.scale
        within = ((across >= self.low) & (across <= self.high)).all(1) & (off >= 0).all(
            1
        )
        return np.where(within, value - off.sum(1) - self.log_volume, -np.inf)

    def distance(self, values: Floats) -> float:
        """Of values from the tangent of the ridge, in standard errors."""
        z = (values - self.centre) / self.typical
        return float(np.linalg.norm(self.seen @ z / self.spread))

    @cached_property
    def log_volume(self) -> float:
        """Inverse of the density at the centre, in `z`."""
        rank, half = len(self.seen), _DEGREES / 2
        student = math.lgamma(half) - math.lgamma(half + rank / 2)
        student += rank / 2 * math.log(_DEGREES * math.pi)
        sizes = [*self.spread, *(self.high - self.low), *np.abs(self.scale)]
        return float(
            student + np.log(sizes).sum() + np.linalg.slogdet(self._inverse)[1]
        )


def ridge_proposal(fit: FitResult) -> RidgeProposal:
    """The proposal from the estimates and information matrix of a fit."""
    free = fit.parameter_set.free
    verdicts = [fit.parameters[name].verdict for name in fit.information.names]
    return _about(
        fit.parameter_set,
        fit.values[free],
        fit.information.matrix,
        fit.information.gradient,
        np.array([verdict == Verdict.AT_BOUND for verdict in verdicts]),
    )


def _about(
    parameters: ParameterSet,
    centre: Floats,
    information: Floats,
    gradient: Floats,
    at_bound: Booleans,
    cell: tuple[int, float, float] | None = None,
) -> RidgeProposal:
    """The proposal about an optimum of the free parameters.

    Parameters
    ----------
    gradient : of the log-likelihood.
    cell : a parameter that is held there, and the interval of its values.
    """
    free = parameters.free
    typical = parameters.typical[free]
    lower = (parameters.lower[free] - centre) / typical
    upper = (parameters.upper[free] - centre) / typical
    information = typical[:, None] * information * typical
    gradient = gradient * typical
    held = np.zeros(len(centre), bool)
    if cell is not None:
        held[cell[0]] = True
    pushed, open_ = np.flatnonzero(at_bound & ~held), np.flatnonzero(~at_bound & ~held)

    block = information[np.ix_(open_, open_)]
    seen, singular, null = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0))
    if len(open_):  # not all of the others at a bound
        seen, singular, null = directions_of_squares(block, np.ones(len(open_)))
        width = (upper - lower)[open_]
        share = (np.abs(seen) / width).max(1, initial=0.0)
        level = singular < _LEVEL * share
        null = np.concatenate([null, seen[level]])
        seen = seen[~level]
        singular = singular[~level]
    spread = 1 / singular
    rows = np.zeros((len(seen), len(centre)))
    rows[:, open_] = seen
    # As another parameter moves, the open ones follow along their regression on it.
    others = np.flatnonzero(at_bound | held)
    rows[:, others] = (seen @ information[np.ix_(open_, others)]) / singular[
        :, None
    ] ** 2
    wide = np.zeros((len(null), len(centre)))
    wide[:, open_] = null
    reach = np.zeros(len(centre))
    reach[open_] = _MARGIN * np.sqrt(((seen.T * spread) ** 2).sum(1))
    names = np.array(parameters.names_where(free))
    pivots, low, high = _pivots(wide, lower, upper, reach, names)
    if cell is not None:
        index, *ends = cell
        begin, end = (np.array(ends) - centre[index]) / typical[index]
        pivots, low, high = (
            np.append(pivots, index),
            np.append(low, begin),
            np.append(high, end),
        )
    # Away from the bound the log-posterior falls by its slope and curvature, which
    # set the scale.
    curvature = np.diag(information)[pushed] - (
        (rows[:, pushed] * singular[:, None]) ** 2
    ).sum(0)
    push = np.abs(gradient[pushed]) + np.sqrt(np.maximum(curvature, 0.0))
    room = (upper - lower)[pushed]
    least = np.where(np.isfinite(room), 1 / room, _FAINT)
    inward = np.where(np.abs(lower) < np.abs(upper), 1.0, -1.0)[pushed]
    sense = np.where(gradient[pushed] == 0.0, inward, -np.sign(gradient[pushed]))
    off = sense / np.maximum(push, least)
    return RidgeProposal(centre, typical, rows, spread, pivots, low, high, pushed, off)


@dataclass(frozen=True)
class CurvedRidge:
    """Proposals about optima along a curved ridge, each for an interval of the
    parameter that is held there, and their probabilities."""

    parts: Sequence[RidgeProposal | None]
    """None where no values fit, with the share 0"""
    shares: Floats
    held: int
    borders: Floats

    def draw(self, n: int, random: Any) -> Floats:
        """n parameter vectors, shape (n, p)."""
        which = random.choice(len(self.parts), n, p=self.shares)
        some_part = next(part for part in self.parts if part is not None)
        values = np.zeros((n, len(some_part.centre)))
        for index in np.unique(which).tolist():
            part = self.parts[index]
            assert part is not None  # its share is not 0
            here = which == index
            values[here] = part.draw(int(here.sum()), random)
        return values

    def unreached(self, values: Floats) -> float:
        """Probability beyond the ends of what the values, shape (n, p), reach."""
        column = values[:, self.held]
        below = self.borders[1:] < column.min()
        above = self.borders[:-1] > column.max()
        return float(self.shares[below | above].sum())

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        found = np.full(len(values), -np.inf)
        which = np.searchsorted(self.borders, values[:, self.held]) - 1
        for index in np.intersect1d(which, np.flatnonzero(self.shares)).tolist():
            here = which == index
            part = self.parts[index]
            assert part is not None  # its share is not 0
            log_share = math.log(self.shares[index])
            found[here] = part.log_density(values[here]) + log_share
        return found


Proposal = RidgeProposal | CurvedRidge


def proposed(proposal: Proposal, coords: Floats, random: Any) -> tuple[Floats, Floats]:
    """Proposals for emcee's Metropolis-Hastings move, and the log of their factors
    in its ratio."""
    new, back = proposal.draw(len(coords), random), proposal.log_density(coords)
    # A walker outside the support of the proposal can only be moved by the other moves.
    reachable = np.isfinite(back)
    there = np.where(reachable, back, 0) - proposal.log_density(new)
    return new, np.where(reachable, there, -np.inf)


class Axis(NamedTuple):
    """The parameter that is held along a ridge."""

    name: str
    low: float
    high: float
    starts: Floats
    """values of all parameters from which the others are refitted: those whose own
    value of this one is nearest, shape (starts, p)"""

    @classmethod
    def of(cls, fit: FitResult) -> Axis | None:
        """The axis of a fit; None where chi squared is a quadratic, and what is
        determined at all is determined well."""
        if fit.ridge:
            return cls._of_ridge(fit)
        weakness = {
            name: item.stderr / item.typical
            for name, item in fit.parameters.items()
            if item.verdict == Verdict.WEAK and item.stderr is not None
        }
        if not weakness:
            return None
        name = _preferred(weakness)
        item = fit.parameters[name]
        reach = _REACH * weakness[name] * item.typical
        ends = np.clip([item.value - reach, item.value + reach], item.lower, item.upper)
        return cls(name, float(ends[0]), float(ends[1]), fit.values[None])

    @classmethod
    def _of_ridge(cls, fit: FitResult) -> Axis:
        """From end to end of a ridge that is known, and half of this farther; as far
        about another solution as about the first."""
        points = np.array([fit.values, *(point.values for point in fit.ridge)])
        columns = dict(zip(fit.parameters, points.T, strict=True))
        held = {point.held for point in fit.ridge if point.held is not None}
        moving = held or {*fit.parameter_set.names_where(fit.parameter_set.free)}
        open_ = {name for name in moving if fit.parameters[name].verdict.is_left_open}
        extents = {
            name: float(np.ptp(columns[name])) / fit.parameters[name].typical
            for name in open_ or moving
        }
        name = _preferred(extents)
        item = fit.parameters[name]
        column = columns[name]
        reach = np.abs(column - item.value)
        is_solution = np.array([True, *(point.held is None for point in fit.ridge)])
        if not is_solution[1:].all():
            reach = reach[~is_solution]
        solutions = column[is_solution]
        beyond = (1 + _BEYOND) * float(reach.max())
        low = max(min(column.min(), solutions.min() - beyond), item.lower)
        high = min(max(column.max(), solutions.max() + beyond), item.upper)
        return cls(name, float(low), float(high), points)


def _preferred(extents: Mapping[str, float]) -> str:
    """The parameter that extends farthest, of the initial state rather than of the law:
    two coefficients may exchange their values."""
    return max(extents, key=lambda name: (name in START_NAMES, extents[name]))


def posterior_proposal(fit: FitResult) -> Proposal:
    """The proposal about the estimates of a fit; where chi squared is no quadratic, or
    some are weakly determined, about the optima with one of them held, since such a
    ridge is curved."""
    axis = Axis.of(fit)
    return ridge_proposal(fit) if axis is None else _along(fit, axis)


def _along(fit: FitResult, axis: Axis) -> Proposal:
    """The proposal along an axis."""
    parameters = fit.parameter_set
    problem = problem_of(fit)
    place = parameters.index(axis.name)
    borders = np.linspace(axis.low, axis.high, _CELLS + 1)
    middle = (borders[:-1] + borders[1:]) / 2
    nearest = np.abs(axis.starts[:, place] - middle[:, None]).argmin(1)
    starts = axis.starts[nearest]
    for _ in range(_PASSES):
        held = (borders[:-1] + borders[1:]) / 2
        tasks = [
            (parameters.with_fixed(axis.name, value), problem, start)
            for value, start in zip(held, starts, strict=True)
        ]
        optima = minimize_many(fit.model, Tasks.of(tasks), FEW)
        parts = [
            _about_solution(parameters, optimum, (place, low, high))
            for optimum, (low, high) in zip(
                unstacked(optima), pairwise(borders), strict=True
            )
        ]
        exists = np.array([part is not None for part in parts])
        # Laplace's approximation to the probability of each interval, and, since that
        # of a wide one where the probability ends is rough, a part as if it were as
        # dense as its neighbours
        volumes = [-np.inf if part is None else part.log_volume for part in parts]
        logs = np.array(volumes) - optima.objective / 2
        logs = np.where(np.isfinite(logs), logs, -np.inf)
        if np.isneginf(logs).all():
            return ridge_proposal(fit)
        shares, width = np.exp(logs - logs.max()), np.diff(borders)
        dense = np.pad(shares / width, 1)
        dense = np.maximum.reduce([dense[:-2], dense[1:-1], dense[2:]]) * width * exists
        shares = (1 - _ROUGH) * shares / shares.sum() + _ROUGH * dense / dense.sum()
        proposal = CurvedRidge(
            parts, shares, int(parameters.free[:place].sum()), borders
        )
        density = _desired_density(parts, shares, width)
        bounds = parameters.lower[place], parameters.upper[place]
        borders, density = _extended(borders, density, shares / width, bounds)
        below = np.cumsum([0.0, *density])
        borders = np.interp(np.linspace(0, below[-1], _CELLS + 1), below, borders)
        middle = (borders[:-1] + borders[1:]) / 2
        starts = np.array(
            [np.interp(middle, held, column) for column in optima.values.T]
        ).T
    return proposal


def _extended(
    borders: Floats, density: Floats, heights: Floats, bounds: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Borders of intervals and the density of the next ones, with one more interval at
    an end where the probability has not ended, as long as all of them if the bounds
    leave as much.

    Parameters
    ----------
    heights : probability of each interval over its width.
    """
    lower, upper = bounds
    length = borders[-1] - borders[0]
    share = _BEYOND_ENDS * density.sum()
    low = max(borders[0] - length, lower)
    high = min(borders[-1] + length, upper)
    if heights[0] > _ENDED * heights.max() and low < borders[0]:
        borders, density = np.append(low, borders), np.append(share, density)
    if heights[-1] > _ENDED * heights.max() and high > borders[-1]:
        borders, density = np.append(borders, high), np.append(density, share)
    return borders, density


def _desired_density(
    parts: Sequence[RidgeProposal | None], shares: Floats, width: Floats
) -> Floats:
    """How many of the next intervals each of these should hold.

    Half of them follow the root of the density, which makes them narrow in its tails
    too, and are narrowest where a parameter reaches its bound. The other half are such
    that the ridge leaves its tangents by as much in each: by the square of the width.
    """
    likely = shares > _NOTHING
    turns = []
    bends = []
    for part, other in pairwise(parts):
        if part is None or other is None:
            turns.append(False)
            bends.append(_FAR)
        else:
            turns.append(list(part.pushed) != list(other.pushed))
            bends.append(min(part.distance(other.centre), _FAR))
    at_turns = np.logical_or([False, *turns], [*turns, False])
    by_density = np.sqrt(width * shares) * np.where(at_turns, 4, 1) * likely
    by_bend = np.sqrt([0.0, *bends]) + np.sqrt([*bends, 0.0])
    by_bend = np.nan_to_num(by_bend) * likely
    density = by_density / by_density.sum()
    if by_bend.any():
        density = density + by_bend / by_bend.sum()
    return density


def _about_solution(
    parameters: ParameterSet,
    optimum: Solution,
    cell: tuple[int, float, float],
) -> RidgeProposal | None:
    """The proposal about an optimum with one parameter held; None where there is no
    path, or nothing that tells a parameter without bounds: where a stone does not
    move."""
    if not np.isfinite(optimum.objective):
        return None
    free = parameters.free
    values = optimum.values
    jacobian = optimum.jacobian.reshape(-1, len(values))
    gradient, information = optimum.residual.ravel() @ jacobian, jacobian.T @ jacobian
    _, slope, square = parameters.penalty.quadratic(values)
    gradient, information = gradient + slope, information + np.diag(square)
    ends = np.stack([parameters.lower, parameters.upper])
    at_bound = (np.abs(values - ends) < _NEAR * parameters.typical).any(0)
    try:
        return _about(
            parameters,
            values[free],
            information[np.ix_(free, free)],
            -gradient[free],
            at_bound[free],
            (int(free[: cell[0]].sum()), *cell[1:]),
        )
    except UnusableFitError:
        return None


def _pivots(
    null: Floats, lower: Floats, upper: Floats, reach: Floats, names: np.ndarray
) -> tuple[Indices, Floats, Floats]:
    """A bounded parameter for each null direction, and its range along the ridge."""
    pivots: list[int] = []
    rest = null.copy()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    for _ in range(len(null)):
        size = np.where(bounded, (rest**2).sum(0), 0.0)
        if size.max() < 1e-12:
            open_ = list(names[(rest**2).sum(0) >= 1e-12])
            none_of = "which has no" if len(open_) == 1 else "and none of them has"
            raise UnusableFitError(
                f"the path does not determine {join_words(open_)}, "
                f"{none_of} finite bounds; give bounds"
            )
        pivot = int(np.argmax(size))
        pivots.append(pivot)
        column = rest[:, pivot] / np.linalg.norm(rest[:, pivot])
        rest = rest - np.outer(column, column @ rest)
    walls = np.concatenate([null.T, -null.T])
    room = np.concatenate([upper + reach, reach - lower])
    finite = np.isfinite(room)
    ends = [_extent(null[:, pivot], walls[finite], room[finite]) for pivot in pivots]
    low, high = np.clip(np.array(ends).T.reshape(2, -1), lower[pivots], upper[pivots])
    return np.array(pivots, int), low, high


def _extent(along: Floats, walls: Floats, room: Floats) -> tuple[float, float]:
    """Least and greatest `along @ z` of all z with `walls @ z <= room`."""
    if len(along) == 1:
        wall = walls[:, 0]
        low, high = (
            sign * (room[some] / np.abs(wall[some])).min()
            for sign, some in ((-1, wall < 0), (1, wall > 0))
        )
        least, greatest = sorted((float(along[0] * low), float(along[0] * high)))
        return least, greatest
    from scipy.optimize import linprog  # slow, for one direction

    least, greatest = (
        linprog(sign * along, A_ub=walls, b_ub=room, bounds=(None, None)).fun
        for sign in (1, -1)
    )
    return float(least), -float(greatest)
