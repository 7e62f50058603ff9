"""Profile likelihood: the least misfit at fixed values of one parameter or two.

At each value all other parameters are fitted again, with the sigma of the fit held. What chi
squared rises by, against the threshold of Wilks (1938), gives an interval that holds where the
misfit is not quadratic, and shows a parameter that the data do not determine as what it is: flat.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from curlfit.errors import InputError, UnusableFitError
from curlfit.inference.fit.fit import fit as least_squares
from curlfit.inference.fit.result import FitResult
from curlfit.inference.mcmc.chain import Chain
from curlfit.profile_likelihood.refit import Held, Place, Point, Progress, Refit
from curlfit.profile_likelihood.result import Interval, Level, PairProfile, Profile, require_usable
from curlfit.throws.throw import Throw

Floats = NDArray[np.float64]

POINTS = 41
POINTS_OF_PAIR = 25
_REACH = 4.0  # standard errors to either side
_HIGH = 1.5  # rise of chi squared at the ends of a range, over that around a 95 % region of two
_FIRST, _LAST = 1e-3, 30.0  # typical sizes at which that search begins, and ends without a bound
_ABREAST = 6  # places of the search at a time
_SECTION = 10  # parts of an interval that is searched in, or filled where the misfit is steep
_SHARP = 0.02  # of the way to the end of a range, to which it is found
_STEEP = 0.6  # rise of the root of chi squared between neighbours at a threshold
_ROUNDS = 8
_FLAT = 1e-3  # rise of chi squared that is none
_HARDLY = 1.0  # the same that tells nothing
_LARGE_PART = 0.5  # of an interval, that is walled in by bounds of other parameters
_LESS = 1e-3  # fall of chi squared that makes another fit the better one
_UNSEEN = 1e-3  # slope of the residuals by typical sizes that is none
_LEAST_STEP, _WIDEST = 0.05, 30.0  # of a valley's width at the best fit: to measure it by, and most
_WIDER = 1.6  # at a time
_BINS = 24
_MOST_SAMPLES = 1500


def profile(
    subject: FitResult | Throw,
    names: str | Sequence[str],
    *,
    chain: Chain | None = None,
    points: int | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> Profile | PairProfile:
    """The profile likelihood of a parameter, or of two.

    Parameters
    ----------
    subject : a converged fit, or a throw, which is then fitted first.
    names : one free parameter or two: coefficients of the law, or of the start.
    chain : a posterior sample of the fit, to be shown beside the profile.
    points : places along each parameter, `POINTS` for one and `POINTS_OF_PAIR` for two if not
        given; more are added where the misfit is steep.
    ranges : (low, high) by name. By default four standard errors to either side where the fit
        determines the parameter, and on to where chi squared is 9 higher or to its bounds (30
        typical sizes away where it has none) otherwise.
    progress : called now and then with the number of fits done.
    choices : of `curlfit.fit`, for a throw.

    Returns
    -------
    Profile for one name, PairProfile for two.

    Raises
    ------
    InputError : an unknown, fixed or repeated name; more than two; a range that is empty, outside
        the bounds or without the best estimate; a chain of another law; choices for a fit.
    UnusableFitError : the fit did not converge.
    """
    wanted = (names,) if isinstance(names, str) else tuple(names)
    if isinstance(subject, Throw):
        fit = least_squares(subject, **choices)
    else:
        fit = subject
        if choices:
            raise InputError(f"{', '.join(choices)}: a fit has its own; give a throw to fit anew")
    require_usable(
        fit.parameter_set, wanted, points, ranges or {}, fit.parameter_set.values_of(fit.values)
    )
    count = (POINTS, POINTS_OF_PAIR)[len(wanted) - 1] if points is None else points
    if not fit.converged:
        raise UnusableFitError(f"the fit is not usable: {fit.status}")
    if chain is not None and chain.names != fit.parameter_set.names:
        raise InputError("the chain is not of this fit: it has other parameters")
    refit = Refit(fit, progress)
    for _ in range(3):
        found = [_one(refit, name, count, (ranges or {}).get(name), chain) for name in wanted]
        pair = None if len(found) == 1 else _two(refit, found[0], found[1], count, ranges, chain)
        if not refit.improved():
            break
    return found[0] if pair is None else pair


def _one(
    refit: Refit,
    name: str,
    points: int,
    chosen: tuple[float, float] | None,
    chain: Chain | None,
) -> Profile:
    """The profile of one parameter."""
    fit = refit.fit
    held = Held(refit, [name])
    place = refit.parameters.index(name)
    offset, best = refit.offset[place], float(held.best.held[0])
    if chosen is None:
        low, high = _range(held, name)
    else:
        low, high = min(chosen[0] - offset, best), max(chosen[1] - offset, best)
    line = np.unique([*np.linspace(low, high, points), best])
    held.reach(line[:, None])
    held.settle(_in_turn(line))
    for _ in range(_ROUNDS):
        delta = np.array([held.delta([value]) for value in line])
        more = _between(line, delta, best, held.levels)
        if not len(more):
            break
        held.reach(more[:, None])
        line = np.unique([*line, *more])
    held.settle(_in_turn(line))

    delta = np.array([held.delta([value]) for value in line])
    nowhere = np.full(len(refit.parameters), np.nan)
    found = [held.at([value]) for value in line]
    values = np.stack([nowhere if item is None else item.values for item in found])
    free, stops = _free_part(refit, line, values, best, place)
    inside = (line >= free[0]) & (line <= free[1])
    rise = float(np.nanmax(np.maximum(delta[inside], 0.0)))
    bounds = float(refit.parameters.lower[place]), float(refit.parameters.upper[place])
    intervals = tuple(
        _interval(line, delta, best, level.rise, level.name, free, bounds) for level in held.levels
    )
    cut = chosen is not None and any(
        end == edge and edge != bound
        for end, edge, bound in zip(free, (low, high), bounds, strict=True)
    )
    cut &= fit.parameters[name].verdict != "not identifiable"
    soft = free[1] - free[0] > _LARGE_PART * (intervals[0].high - intervals[0].low)
    everywhere = values + refit.offset
    return Profile(
        name=name,
        best=best + offset,
        law=fit.law,
        load=fit.load,
        loss=fit.loss,
        data={key: fit.data[key] for key in ("file", "rows", "from", "to")},
        parameters=fit.parameters,
        chi_squared=refit.chi_squared,
        n_observations=fit.n_observations,
        at=line + offset,
        delta=delta,
        others={
            other: everywhere[:, row]
            for row, other in enumerate(refit.parameters.names)
            if refit.parameters.free[row] and other != name
        },
        intervals=tuple(
            replace(item, low=item.low + offset, high=item.high + offset) for item in intervals
        ),
        free=(free[0] + offset, free[1] + offset),
        stops=stops,
        rise=rise,
        verdict=_verdict(rise, held.levels[-1].rise, soft=soft, cut=cut),
        combinations=tuple(item for item in fit.combinations if name in item.weights),
        posterior=None if chain is None else _marginal(fit, chain, name, line + offset, delta),
        quantiles={} if fit.posterior is None else fit.posterior.quantiles.get(name, {}),
        warnings=_warnings(held, found, intervals, line + offset, delta),
    )


def _in_turn(line: Floats) -> list[tuple[Point, Point]]:
    return [((float(a),), (float(b),)) for a, b in pairwise(line)]


def _range(held: Held, name: str) -> tuple[float, float]:
    """Where to look at a parameter, if nothing is said."""
    item = held.refit.fit.parameters[name]
    place = held.refit.parameters.index(name)
    bounds = held.refit.parameters.lower[place], held.refit.parameters.upper[place]
    best = float(held.best.held[0])
    if item.verdict == "determined" and item.stderr:
        step, most, abreast = _REACH * item.stderr, _LAST * item.typical, 1
    else:
        step, most, abreast = _FIRST * item.typical, _LAST * item.typical, _ABREAST
    ladders = []
    for sense, bound in zip((-1.0, 1.0), bounds, strict=True):
        farthest = abs(bound - best) if math.isfinite(bound) else max(most, step)
        steps = step * 2.0 ** np.arange(1 + max(0, math.ceil(math.log2(max(farthest / step, 1)))))
        ladder = best + sense * np.minimum(steps, farthest)
        if math.isfinite(bound):
            ladder = np.where(steps >= farthest, bound, ladder)
        ladders.append(np.unique(ladder)[:: int(sense)] if farthest > 0 else ladder[:0])
    held.reach(np.concatenate([ladder[:abreast] for ladder in ladders] or [[]])[:, None])
    sharp = abreast > 1
    low, high = (_end(held, best, ladder, abreast, sharp=sharp) for ladder in ladders)
    return low, high


def _end(held: Held, best: float, ladder: Floats, abreast: int, *, sharp: bool) -> float:
    """The first place of a ladder away from the best where the misfit is high, else its last."""
    inside = best
    for first in range(0, len(ladder), abreast):
        part = ladder[first : first + abreast]
        held.reach(part[:, None])
        for value in map(float, part):
            if held.delta([value]) < _HIGH * held.levels[-1].rise_of_two:
                inside = value
                continue
            outside = value
            while sharp and abs(outside - inside) > _SHARP * abs(outside - best):
                line = np.linspace(inside, outside, _SECTION + 1)[1:-1]
                held.reach(line[:, None])
                low = [
                    value
                    for value in map(float, line)
                    if held.delta([value]) < _HIGH * held.levels[-1].rise_of_two
                ]
                inside = low[-1] if low else inside
                beyond = [value for value in (*map(float, line), outside)
                          if abs(value - best) > abs(inside - best)]  # fmt: skip
                outside = beyond[0]
            return outside if math.isfinite(held.delta([outside])) else inside
    return inside


def _between(line: Floats, delta: Floats, best: float, levels: tuple[Level, ...]) -> Floats:
    """Places to add where the profile passes a threshold too steeply to be interpolated."""
    root = np.sqrt(np.maximum(delta, 0.0))
    more: list[float] = []
    for place, (a, b) in enumerate(pairwise(line)):
        low, high = sorted(root[place : place + 2])
        # also those for the regions of two parameters
        rises = [rise for item in levels for rise in (item.rise, item.rise_of_two)]
        passed = any(low**2 < rise <= high**2 for rise in rises)
        if passed and high - low > _STEEP and b - a > 1e-9 * max(abs(a), abs(b), abs(b - best)):
            more += list(np.linspace(a, b, _SECTION + 1)[1:-1])
    return np.array(more)


def _free_part(
    refit: Refit, line: Floats, values: Floats, best: float, own: int
) -> tuple[tuple[float, float], tuple[tuple[str, ...], tuple[str, ...]]]:
    """How far no other parameter is stopped by a bound that it is off elsewhere, and which are."""
    stuck = np.array([refit.at_bound(each) for each in values])
    stuck[:, own] = False
    stuck &= ~stuck.all(0)
    ends, stops = [], []
    for sense in (-1, 1):
        outward = np.flatnonzero(sense * (line - best) >= 0)[::sense]
        stopped = np.flatnonzero(stuck[outward[1:]].any(1))
        last = stopped[0] if len(stopped) else len(outward) - 1
        ends.append(float(line[outward[last]]))
        stops.append(
            tuple(refit.parameters.names_where(stuck[outward[last + 1]])) if len(stopped) else ()
        )
    return (ends[0], ends[1]), (stops[0], stops[1])


def _interval(
    line: Floats, delta: Floats, best: float, rise: float, level: str,
    free: tuple[float, float], bounds: tuple[float, float],
) -> Interval:  # fmt: skip
    """Where the profile passes a threshold, on either side of the best."""
    seen = np.isfinite(delta)
    line, delta = line[seen], delta[seen]
    root = np.sign(line - best) * np.sqrt(np.maximum(delta, 0.0))
    # nearly straight, but for walls, where it must not overshoot
    curve = PchipInterpolator(line, root)
    ends = []
    for sense, limit, bound in zip((-1, 1), free, bounds, strict=True):
        outward = np.flatnonzero(sense * (line - best) >= 0)[::sense]
        over = outward[delta[outward] >= rise]
        if not len(over):
            end = float(line[outward[-1]])
            ends.append((end, "bound" if end == bound else "range"))
            continue
        first = over[0]
        target = sense * math.sqrt(rise)
        inner, outer = float(line[first - sense]), float(line[first])
        end = float(brentq(lambda x: float(curve(x)) - target, inner, outer, xtol=1e-15))  # noqa: B023
        ends.append((end, "data" if sense * (end - limit) <= 0 else "others"))
    (low, low_by), (high, high_by) = ends
    return Interval(level, low, high, low_by, high_by)


def _verdict(rise: float, threshold: float, *, soft: bool, cut: bool) -> str:
    """See `Profile.verdict`; `soft` where the free part is most of the interval."""
    if cut and rise < threshold:
        return "narrow"
    if not soft or rise >= _HARDLY:
        return "limited"
    return "flat" if rise < _FLAT else "hardly"


def _warnings(
    held: Held, found: Sequence[Place | None], intervals: Sequence[Interval],
    at: Floats, delta: Floats,
) -> tuple[str, ...]:  # fmt: skip
    refit, fit = held.refit, held.refit.fit
    said = list(fit.warnings)
    less = refit.first - refit.chi_squared
    if less > _LESS:
        better = refit.parameters.values_of(refit.values + refit.offset)
        start = ",".join(f"{name}={better[name]:.6g}" for name in fit.coefficients)
        said.append(
            f"a better fit was met on the way, its chi squared {less:.3g} lower, and the profile "
            f"counts from it; fit again with --start {start}"
        )
    rough = sum(item is not None and not item.finished for item in found)
    if rough:
        said.append(f"{rough} of {len(found)} fits did not converge; the misfit there is no more "
                    "than what is shown")  # fmt: skip
    lost = sum(item is None for item in found)
    if lost:
        said.append(f"at {lost} of {len(found)} values the law admits no motion")
    widest = intervals[-1]
    outside = (at < widest.low) | (at > widest.high)
    outside &= delta < held.levels[-1].rise - 0.1
    outside &= np.isfinite(delta)
    if outside.any():
        said.append(
            f"the misfit falls again near {at[outside][np.argmin(delta[outside])]:.4g}: the "
            "intervals are those about the best fit"
        )
    return tuple(said)


def _marginal(
    fit: FitResult, chain: Chain, name: str, at: Floats, delta: Floats
) -> dict[str, Floats] | None:
    """-2 log of the marginal posterior density, laid on the profile, whose zero it has not."""
    samples = chain.of({name: 1.0})
    low, high = np.quantile(samples, [0.0005, 0.9995])
    counts, edges = np.histogram(samples, _BINS, (max(low, at[0]), min(high, at[-1])))
    if not counts.any():
        return None
    centre = (edges[1:] + edges[:-1]) / 2
    some = counts > 0
    height = -2 * np.log(counts[some] / counts.max())
    ess = len(samples) if fit.posterior is None else fit.posterior.ess.get(name, len(samples))
    seen = np.isfinite(delta)
    shift = np.average(
        np.interp(centre[some], at[seen], delta[seen]) - height, weights=counts[some]
    )
    error = 2 / np.sqrt(counts[some] * min(ess / len(samples), 1.0))
    return {"at": centre[some], "height": height + shift, "error": error}


def _two(
    refit: Refit,
    one: Profile,
    other: Profile,
    points: int,
    ranges: Mapping[str, tuple[float, float]] | None,
    chain: Chain | None,
) -> PairProfile:
    """The profile of two parameters, along the valley that the profile of the first follows."""
    fit, names = refit.fit, (one.name, other.name)
    index = [refit.parameters.index(name) for name in names]
    offset = refit.offset[index]
    held = Held(refit, names)
    stiff = float(refit.response(names)[1][1])
    typical = fit.parameters[other.name].typical
    across = 1 / stiff if stiff * typical > _UNSEEN else None
    bounds = refit.parameters.lower[index[1]], refit.parameters.upper[index[1]]
    edges = (
        []
        if across is None
        else [
            bound + sense * _REACH * across + offset[1]
            for bound, sense in zip(bounds, (1, -1), strict=True)
        ]
    )
    first = _columns(one, other.name, edges, points) - offset[0]
    if across is None or other.name in (ranges or {}):
        ends = other.at[0] - offset[1], other.at[-1] - offset[1]
        second = np.tile(np.linspace(*ends, points), (len(first), 1))
    else:
        seen = np.isfinite(one.delta)
        way = one.others[other.name][seen]
        valley = np.interp(first + offset[0], one.at[seen], way) - offset[1]
        second = _across(held, first, valley, across, bounds, points)
    second = np.clip(second, *bounds)
    grid = np.stack([np.broadcast_to(first[:, None], second.shape), second], -1)
    held.reach(grid.reshape(-1, 2))
    held.settle(_beside(grid))
    delta = np.array([held.delta(point) for point in grid.reshape(-1, 2)]).reshape(second.shape)
    covariance = _covariance(fit, names)
    ellipse = None
    if covariance is not None:
        best = np.array([one.best, other.best]) - offset
        away = grid - best
        expected = np.einsum("ijk,kl,ijl->ij", away, np.linalg.inv(covariance), away)
        within = (expected <= held.levels[-1].rise_of_two) & np.isfinite(delta)
        if within.any():
            ellipse = float(np.abs(delta - expected)[within].max())
    extent = {
        level.name: (
            _extent(refit, one, level.rise_of_two, level.name),
            _extent(refit, other, level.rise_of_two, level.name),
        )
        for level in held.levels
    }
    samples = np.zeros((0, 2))
    if chain is not None:
        samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
        some = np.linspace(0, len(samples) - 1, min(len(samples), _MOST_SAMPLES)).astype(int)
        samples = samples[some]
    return PairProfile(
        names=names,
        each=(one, other),
        first=grid[..., 0] + offset[0],
        second=second + offset[1],
        delta=delta,
        across=across,
        extent=extent,
        covariance=covariance,
        ellipse=ellipse,
        samples=samples,
        warnings=one.warnings,
    )


def _columns(one: Profile, other: str, edges: Sequence[float], points: int) -> Floats:
    """Values of the first of two parameters, evenly; of a flat one, more at the end of its valley.

    There the region is cut by the bound of the second, which it begins to be at `edges`.
    """
    if one.verdict == "limited":
        return np.unique([*np.linspace(one.at[0], one.at[-1], points), one.best])
    free = (one.at >= one.free[0]) & (one.at <= one.free[1])
    at, way = one.at[free], one.others[other][free]
    order = np.argsort(way)
    cut = [
        float(np.interp(edge, way[order], at[order]))
        for edge in edges
        if way.min() < edge < way.max()
    ]
    return np.unique([*np.linspace(*one.free, points), one.best, *cut, *one.at[~free]])


def _across(
    held: Held, first: Floats, valley: Floats, across: float, bounds: tuple[float, float],
    points: int,
) -> Floats:  # fmt: skip
    """Values of the second about the bottom of the valley, as far as it is wide at each place."""
    bottom = np.stack([first, valley], -1)
    steps = np.linspace(-_REACH, _REACH, points | 1)
    wide = np.full((len(first), 2), across)
    sides = [np.clip(valley + sense * across, *bounds) for sense in (-1, 1)]
    held.reach(np.concatenate([bottom, *(np.stack([first, side], -1) for side in sides)]))
    for column, side in enumerate(sides):
        for row, value in enumerate(side):
            away = abs(value - valley[row]) / across
            rise = held.delta([first[row], value]) - held.delta([first[row], valley[row]])
            if away > _LEAST_STEP and math.isfinite(rise):
                wide[row, column] *= away / math.sqrt(max(rise, (away / _WIDEST) ** 2))
    for _ in range(_ROUNDS):  # where it is not quadratic either
        ends = np.clip(valley[:, None] + _REACH * np.array([-1, 1]) * wide, *bounds)
        held.reach(np.stack([np.broadcast_to(first[:, None], ends.shape), ends], -1).reshape(-1, 2))
        above = np.array(
            [[held.delta([a, b]) for b in row] for a, row in zip(first, ends, strict=True)]
        )
        low = (
            (above < _HIGH * held.levels[-1].rise_of_two) & (ends > bounds[0]) & (ends < bounds[1])
        )
        if not low.any():
            break
        wide[low] *= _WIDER
    return np.asarray(valley[:, None] + steps * np.where(steps < 0, wide[:, :1], wide[:, 1:]))


def _beside(grid: Floats) -> list[tuple[Point, Point]]:
    """Pairs of neighbours on a grid, along the columns and from one to the next."""
    points = [[(float(a), float(b)) for a, b in row] for row in grid]
    pairs = [pair for row in points for pair in pairwise(row)]
    pairs += [pair for column in zip(*points, strict=True) for pair in pairwise(column)]
    return [(one, other) for one, other in pairs if one != other]


def _extent(refit: Refit, profile: Profile, rise: float, level: str) -> Interval:
    """What a region spans of a parameter: where the profile of that one alone passes its edge."""
    item = profile.estimate
    return _interval(
        profile.at, profile.delta, profile.best, rise, level, profile.free, (item.lower, item.upper)
    )


def _covariance(fit: FitResult, names: Sequence[str]) -> Floats | None:
    known = list(fit.covariance["names"])
    if any(fit.parameters[name].stderr is None or name not in known for name in names):
        return None
    index = [known.index(name) for name in names]
    found: Floats = np.array(fit.covariance["matrix"])[np.ix_(index, index)]
    return found
