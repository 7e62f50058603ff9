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
_LEVEL = 1.0
"""Width of the bounds in standard errors, below which the probability is all but
uniform along a direction."""
_FAINT = 1e-9  # slope of the log-density away from a bound that exerts none
_NO_PART = 1e-12  # square of the part of a parameter in null directions, if rounding

# Of a curved ridge:
_REACH = 8.0
"""Standard errors of a weakly determined parameter, along which optima are sought."""
_BEYOND = 0.5  # of a ridge, by which the proposal extends beyond its ends
_CELLS = 96  # intervals of the parameter that is held
_PASSES = 6  # how often the intervals are chosen anew
_SMOOTHED = 0.2
"""Share of the probability that is dealt out as if each interval were as dense as the
densest of its neighbours: Laplace's approximation is rough where probability ends."""
_ENDED = 1e-5
"""Probability density at an end over the highest, above which it has not ended."""
_BEYOND_ENDS = 0.1  # share of the next intervals that lie beyond such an end
_FAR = 100.0  # standard errors from a tangent, above which it says nothing
_NOTHING = 1e-6  # probability of an interval that is given up
_AT_TURNS = 4.0  # times as many intervals where a parameter reaches its bound
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
    seen : rows of determined combinations, shape (r, p).
    spread : standard deviations of these combinations.
    pivots : indices of the pivots.
    low, high : intervals of the pivots, in `z`.
    pushed : indices of the pushed parameters.
    scale : mean distance of the pushed parameters from their bounds in `z`, signed.
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
        """The matrix that makes `z` of the coordinates."""
        unit = np.eye(len(self.centre))
        rows = [self.seen, unit[self.pivots], unit[self.pushed]]
        return np.linalg.inv(np.concatenate(rows))

    def draw(self, n: int, random: Any, *, gaussian: bool = False) -> Floats:
        """n parameter vectors, shape (n, p); Student or `gaussian` along
        determined directions."""
        determined = self.spread * random.standard_normal((n, len(self.seen)))
        if not gaussian:
            determined *= np.sqrt(_DEGREES / random.chisquare(_DEGREES, (n, 1)))
        uniform = random.uniform(size=(n, len(self.pivots)))
        along_ridge = self.low + (self.high - self.low) * uniform
        off_bounds = self.scale * random.standard_exponential((n, len(self.pushed)))
        coordinates = np.concatenate([determined, along_ridge, off_bounds], 1)
        z = coordinates @ self._inverse.T
        draws: Floats = self.centre + self.typical * z
        return draws

    def unreached(self, values: Floats) -> float:
        """Nothing: there are no ends to reach."""
        return 0.0

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        z = (values - self.centre) / self.typical
        determined = z @ self.seen.T / self.spread
        along_ridge = z[:, self.pivots]
        off_bounds = z[:, self.pushed] / self.scale
        power = -(_DEGREES + len(self.seen)) / 2
        student = power * np.log1p((determined**2).sum(1) / _DEGREES)
        log_density = student - off_bounds.sum(1) - self.log_volume
        on_ridge = (along_ridge >= self.low) & (along_ridge <= self.high)
        supported = on_ridge.all(1) & (off_bounds >= 0).all(1)
        return np.where(supported, log_density, -np.inf)

    def distance(self, values: Floats) -> float:
        """Of values from the tangent of the ridge, in standard errors."""
        z = (values - self.centre) / self.typical
        return float(np.linalg.norm(self.seen @ z / self.spread))

    @cached_property
    def log_volume(self) -> float:
        """Logarithm of the inverse of the density at the centre, in `z`."""
        rank = len(self.seen)
        half = _DEGREES / 2
        student = math.lgamma(half) - math.lgamma(half + rank / 2)
        student += rank / 2 * math.log(_DEGREES * math.pi)
        sizes = [*self.spread, *(self.high - self.low), *np.abs(self.scale)]
        log_determinant = np.linalg.slogdet(self._inverse)[1]
        return float(student + np.log(sizes).sum() + log_determinant)


class Cell(NamedTuple):
    """A parameter that is held, and the interval of its values for which that
    stands."""

    parameter: int
    """its index among the free ones"""
    low: float
    high: float


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
    cell: Cell | None = None,
) -> RidgeProposal:
    """The proposal about an optimum of the free parameters.

    Parameters
    ----------
    centre, information, gradient, at_bound : of the free parameters at the optimum;
        `gradient` is that of the log-likelihood.
    cell : of a curved ridge, along which a parameter is held.
    """
    free = parameters.free
    typical = parameters.typical[free]
    lower = (parameters.lower[free] - centre) / typical
    upper = (parameters.upper[free] - centre) / typical
    information = typical[:, None] * information * typical
    gradient = gradient * typical
    is_held = np.zeros(len(centre), bool)
    if cell is not None:
        is_held[cell.parameter] = True
    pushed = np.flatnonzero(at_bound & ~is_held)
    inner = np.flatnonzero(~at_bound & ~is_held)
    outer = np.flatnonzero(at_bound | is_held)

    directions = np.zeros((0, 0))
    singular = np.zeros(0)
    null = np.zeros((0, 0))
    if len(inner):
        directions, singular, null = directions_of_squares(
            information[np.ix_(inner, inner)], np.ones(len(inner))
        )
        # 1/singular is the error along a direction, 1/share the length of it that the
        # bounds leave: where that is shorter, they say more than the data
        share = (np.abs(directions) / (upper - lower)[inner]).max(1, initial=0.0)
        is_level = singular < _LEVEL * share
        null = np.concatenate([null, directions[is_level]])
        directions = directions[~is_level]
        singular = singular[~is_level]
    spread = 1 / singular
    rows = np.zeros((len(directions), len(centre)))
    rows[:, inner] = directions
    # As an outer parameter moves, the inner ones follow along their regression on it.
    by_outer = directions @ information[np.ix_(inner, outer)]
    rows[:, outer] = by_outer / singular[:, None] ** 2

    null_rows = np.zeros((len(null), len(centre)))
    null_rows[:, inner] = null
    margin = np.zeros(len(centre))
    margin[inner] = _MARGIN * np.sqrt(((directions.T * spread) ** 2).sum(1))
    names = np.array(parameters.names_where(free))
    pivots, low, high = _pivots(null_rows, lower, upper, margin, names)
    if cell is not None:
        at_centre = centre[cell.parameter]
        unit = typical[cell.parameter]
        pivots = np.append(pivots, cell.parameter)
        low = np.append(low, (cell.low - at_centre) / unit)
        high = np.append(high, (cell.high - at_centre) / unit)

    # Away from the bound the log-posterior falls by its slope and curvature, which
    # set the scale.
    followed = ((rows[:, pushed] * singular[:, None]) ** 2).sum(0)
    curvature = np.diag(information)[pushed] - followed
    slope = np.abs(gradient[pushed]) + np.sqrt(np.maximum(curvature, 0.0))
    width = (upper - lower)[pushed]
    least_slope = np.where(np.isfinite(width), 1 / width, _FAINT)
    inward = np.where(np.abs(lower) < np.abs(upper), 1.0, -1.0)[pushed]
    sense = np.where(gradient[pushed] == 0.0, inward, -np.sign(gradient[pushed]))
    return RidgeProposal(
        centre=centre,
        typical=typical,
        seen=rows,
        spread=spread,
        pivots=pivots,
        low=low,
        high=high,
        pushed=pushed,
        scale=sense / np.maximum(slope, least_slope),
    )


@dataclass(frozen=True)
class CurvedRidge:
    """Proposals about optima along a curved ridge, each for an interval of the
    parameter that is held there, and their probabilities."""

    parts: Sequence[RidgeProposal | None]
    """by interval; None where no values fit"""
    shares: Floats
    """probabilities of the intervals, 0 where no values fit"""
    held: int
    """index of the parameter that is held among the free ones"""
    borders: Floats
    """of the intervals, shape (intervals + 1,)"""

    def draw(self, n: int, random: Any) -> Floats:
        """n parameter vectors, shape (n, p)."""
        interval = random.choice(len(self.parts), n, p=self.shares)
        dimension = next(len(part.centre) for part in self.parts if part is not None)
        values = np.zeros((n, dimension))
        for index in np.unique(interval).tolist():
            part = self.parts[index]
            assert part is not None  # its share is not 0
            in_interval = interval == index
            values[in_interval] = part.draw(int(in_interval.sum()), random)
        return values

    def unreached(self, values: Floats) -> float:
        """Probability beyond the ends of what the values, shape (n, p), reach."""
        column = values[:, self.held]
        below = self.borders[1:] < column.min()
        above = self.borders[:-1] > column.max()
        return float(self.shares[below | above].sum())

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        log_density = np.full(len(values), -np.inf)
        interval = np.searchsorted(self.borders, values[:, self.held]) - 1
        for index in np.intersect1d(interval, np.flatnonzero(self.shares)).tolist():
            part = self.parts[index]
            assert part is not None  # its share is not 0
            in_interval = interval == index
            log_share = math.log(self.shares[index])
            log_density[in_interval] = part.log_density(values[in_interval]) + log_share
        return log_density


Proposal = RidgeProposal | CurvedRidge


def proposed(proposal: Proposal, coords: Floats, random: Any) -> tuple[Floats, Floats]:
    """Proposals for emcee's Metropolis-Hastings move, and the logarithms of the
    proposal's density at the walkers over that at the proposals."""
    proposals = proposal.draw(len(coords), random)
    at_walkers = proposal.log_density(coords)
    # A walker outside the support of the proposal can only be moved by the other moves.
    reachable = np.isfinite(at_walkers)
    log_ratio = np.where(reachable, at_walkers, 0) - proposal.log_density(proposals)
    return proposals, np.where(reachable, log_ratio, -np.inf)


class Axis(NamedTuple):
    """The parameter that is held along a ridge, and the interval of its values."""

    name: str
    low: float
    high: float
    starts: Floats
    """values of all parameters from which the others are refitted, shape (starts, p):
    of these that which has the nearest value of the parameter that is held"""

    @classmethod
    def of(cls, fit: FitResult) -> Axis | None:
        """The axis of a fit; None where chi squared is a quadratic, and what is
        determined at all is determined well."""
        if fit.ridge:
            return cls._of_ridge(fit)
        weakness = {
            name: estimate.stderr / estimate.typical
            for name, estimate in fit.parameters.items()
            if estimate.verdict == Verdict.WEAK and estimate.stderr is not None
        }
        if not weakness:
            return None
        name = _preferred(weakness)
        estimate = fit.parameters[name]
        reach = _REACH * weakness[name] * estimate.typical
        low = max(estimate.value - reach, estimate.lower)
        high = min(estimate.value + reach, estimate.upper)
        return cls(name, float(low), float(high), fit.values[None])

    @classmethod
    def _of_ridge(cls, fit: FitResult) -> Axis:
        """The axis from end to end of the ridge that the fit has followed, and half of
        this farther; as far about another solution as about the first."""
        points = np.array([fit.values, *(point.values for point in fit.ridge)])
        columns = dict(zip(fit.parameters, points.T, strict=True))
        moving = {point.held for point in fit.ridge if point.held is not None}
        if not moving:
            moving = {*fit.parameter_set.names_where(fit.parameter_set.free)}
        left_open = {
            name for name in moving if fit.parameters[name].verdict.is_left_open
        }
        extents = {
            name: float(np.ptp(columns[name])) / fit.parameters[name].typical
            for name in left_open or moving
        }
        name = _preferred(extents)
        estimate = fit.parameters[name]
        column = columns[name]
        # points at which no parameter was held are solutions, such as a mirrored one
        is_solution = np.array([True, *(point.held is None for point in fit.ridge)])
        distances = np.abs(column - estimate.value)
        if not is_solution[1:].all():
            distances = distances[~is_solution]
        reach = (1 + _BEYOND) * float(distances.max())
        solutions = column[is_solution]
        low = max(min(column.min(), solutions.min() - reach), estimate.lower)
        high = min(max(column.max(), solutions.max() + reach), estimate.upper)
        return cls(name, float(low), float(high), points)


def _preferred(extents: Mapping[str, float]) -> str:
    """The parameter that extends farthest, of the initial state rather than of the law:
    two coefficients may exchange their values."""
    return max(extents, key=lambda name: (name in START_NAMES, extents[name]))


def posterior_proposal(fit: FitResult) -> Proposal:
    """The proposal about the estimates of a fit. Where chi squared is no quadratic, or
    parameters are weakly determined, the ridge is curved: then about the optima with
    one of them held."""
    axis = Axis.of(fit)
    return ridge_proposal(fit) if axis is None else _along(fit, axis)


def _along(fit: FitResult, axis: Axis) -> Proposal:
    """The proposal along an axis: the other parameters are refitted in the middle of
    each of its intervals, which are then chosen anew."""
    parameters = fit.parameter_set
    problem = problem_of(fit)
    index = parameters.index(axis.name)
    index_of_free = int(parameters.free[:index].sum())
    bounds = parameters.lower[index], parameters.upper[index]
    borders = np.linspace(axis.low, axis.high, _CELLS + 1)
    middles = (borders[:-1] + borders[1:]) / 2
    nearest = np.abs(axis.starts[:, index] - middles[:, None]).argmin(1)
    starts = axis.starts[nearest]
    for _ in range(_PASSES):
        tasks = [
            (parameters.with_fixed(axis.name, value), problem, start)
            for value, start in zip(middles, starts, strict=True)
        ]
        optima = minimize_many(fit.model, Tasks.of(tasks), FEW)
        cells = [Cell(index_of_free, low, high) for low, high in pairwise(borders)]
        parts = [
            _about_solution(parameters, optimum, cell)
            for optimum, cell in zip(unstacked(optima), cells, strict=True)
        ]
        # Laplace's approximation to the probability of each interval
        volumes = [-np.inf if part is None else part.log_volume for part in parts]
        log_shares = np.array(volumes) - optima.objective / 2
        log_shares = np.where(np.isfinite(log_shares), log_shares, -np.inf)
        if np.isneginf(log_shares).all():
            return ridge_proposal(fit)
        widths = np.diff(borders)
        shares = _smoothed(np.exp(log_shares - log_shares.max()), widths, parts)
        proposal = CurvedRidge(parts, shares, index_of_free, borders)

        density = _desired_density(parts, shares, widths)
        borders, density = _extended(borders, density, shares / widths, bounds)
        # borders at which the cumulated density rises by as much in each interval
        below = np.cumsum([0.0, *density])
        borders = np.interp(np.linspace(0, below[-1], _CELLS + 1), below, borders)
        refitted = middles
        middles = (borders[:-1] + borders[1:]) / 2
        columns = [np.interp(middles, refitted, column) for column in optima.values.T]
        starts = np.transpose(columns)
    return proposal


def _smoothed(
    likely: Floats, widths: Floats, parts: Sequence[RidgeProposal | None]
) -> Floats:
    """Shares of intervals from their probabilities up to a factor; a part of them as if
    each interval where values fit were as dense as the densest of its neighbours."""
    exists = np.array([part is not None for part in parts])
    dense = np.pad(likely / widths, 1)
    dense = np.maximum.reduce([dense[:-2], dense[1:-1], dense[2:]]) * widths * exists
    shares: Floats = (1 - _SMOOTHED) * likely / likely.sum()
    return shares + _SMOOTHED * dense / dense.sum()


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
        borders = np.append(low, borders)
        density = np.append(share, density)
    if heights[-1] > _ENDED * heights.max() and high > borders[-1]:
        borders = np.append(borders, high)
        density = np.append(density, share)
    return borders, density


def _desired_density(
    parts: Sequence[RidgeProposal | None], shares: Floats, width: Floats
) -> Floats:
    """How many of the next intervals each of the present ones should hold, up to a
    factor.

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
    by_density = np.sqrt(width * shares) * np.where(at_turns, _AT_TURNS, 1) * likely
    by_bend = np.sqrt([0.0, *bends]) + np.sqrt([*bends, 0.0])
    by_bend = np.nan_to_num(by_bend) * likely
    density = by_density / by_density.sum()
    if by_bend.any():
        density = density + by_bend / by_bend.sum()
    return density


def _about_solution(
    parameters: ParameterSet, optimum: Solution, cell: Cell
) -> RidgeProposal | None:
    """The proposal about an optimum with one parameter held; None where there is no
    path, or nothing that tells a parameter without bounds: where a stone does not
    move."""
    if not np.isfinite(optimum.objective):
        return None
    free = parameters.free
    values = optimum.values
    jacobian = optimum.jacobian.reshape(-1, len(values))
    _, slope, square = parameters.penalty.quadratic(values)
    gradient = optimum.residual.ravel() @ jacobian + slope
    information = jacobian.T @ jacobian + np.diag(square)
    bounds = np.stack([parameters.lower, parameters.upper])
    at_bound = (np.abs(values - bounds) < _NEAR * parameters.typical).any(0)
    try:
        return _about(
            parameters,
            values[free],
            information[np.ix_(free, free)],
            -gradient[free],
            at_bound[free],
            cell,
        )
    except UnusableFitError:
        return None


def _pivots(
    null: Floats, lower: Floats, upper: Floats, margin: Floats, names: np.ndarray
) -> tuple[Indices, Floats, Floats]:
    """A bounded parameter for each null direction, and the ends of its range along the
    ridge.

    Parameters
    ----------
    null : null directions, shape (directions, parameters).
    lower, upper : bounds of the parameters, from the optimum.
    margin : by which the range extends beyond the bounds of the other parameters.
    """
    pivots: list[int] = []
    rest = null.copy()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    for _ in range(len(null)):
        squares = (rest**2).sum(0)
        of_bounded = np.where(bounded, squares, 0.0)
        if of_bounded.max() < _NO_PART:
            unbounded = list(names[squares >= _NO_PART])
            none_of = "which has no" if len(unbounded) == 1 else "and none of them has"
            raise UnusableFitError(
                f"the path does not determine {join_words(unbounded)}, "
                f"{none_of} finite bounds; give bounds"
            )
        pivot = int(np.argmax(of_bounded))
        pivots.append(pivot)
        # of the null directions, what leaves this pivot as it is
        column = rest[:, pivot] / np.linalg.norm(rest[:, pivot])
        rest = rest - np.outer(column, column @ rest)
    walls = np.concatenate([null.T, -null.T])
    room = np.concatenate([upper + margin, margin - lower])
    finite = np.isfinite(room)
    extents = [_extent(null[:, pivot], walls[finite], room[finite]) for pivot in pivots]
    low = np.clip([least for least, _ in extents], lower[pivots], upper[pivots])
    high = np.clip([most for _, most in extents], lower[pivots], upper[pivots])
    return np.array(pivots, int), low, high


def _extent(along: Floats, walls: Floats, room: Floats) -> tuple[float, float]:
    """Least and greatest `along @ z` of all z with `walls @ z <= room`."""
    if len(along) == 1:
        wall = walls[:, 0]
        below = wall < 0
        above = wall > 0
        low = -(room[below] / np.abs(wall[below])).min()
        high = (room[above] / np.abs(wall[above])).min()
        ends = sorted((float(along[0] * low), float(along[0] * high)))
        return ends[0], ends[1]
    from scipy.optimize import linprog  # slow, for one direction

    least = linprog(along, A_ub=walls, b_ub=room, bounds=(None, None)).fun
    greatest = -linprog(-along, A_ub=walls, b_ub=room, bounds=(None, None)).fun
    return float(least), float(greatest)
