"""Profile likelihood of one parameter: its range, points, intervals and verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from curlfit.inference.fit.result import FitResult
from curlfit.inference.mcmc.chain import Chain
from curlfit.numerics.arrays import Floats
from curlfit.profile_likelihood.refit import ConstrainedFit, ConstrainedFits, Point, Refit
from curlfit.profile_likelihood.result import Interval, Level, Profile

REACH = 4.0  # standard errors to either side of the best value
HIGH = 1.5  # delta chi squared at the ends of a range, over that of a 95 % region of two
ROUNDS = 8
_FIRST, _LAST = 1e-3, 30.0  # first and last step of the search, in typical sizes
_PARALLEL = 6  # points of the search fitted at a time
_SECTION = 10  # parts of an interval that is searched or refined
_SHARP = 0.02  # precision of the ends of a range, relative to its width
_STEEP = 0.6  # largest step of the root of delta chi squared between points at a threshold
_FLAT = 1e-3  # largest delta chi squared of a flat profile
_HARDLY = 1.0  # largest delta chi squared of a parameter that is weakly determined
_LARGE_PART = 0.5  # of an interval that ends at bounds of other parameters
_BETTER = 1e-3  # decrease of chi squared that makes another fit the better one
_BINS = 24


def profile_one(
    refit: Refit,
    name: str,
    points: int,
    chosen: tuple[float, float] | None,
    chain: Chain | None,
) -> Profile:
    """The profile of one parameter."""
    fit = refit.fit
    fits = ConstrainedFits(refit, [name])
    index = refit.parameters.index(name)
    offset, best = refit.offset[index], float(fits.best.held[0])
    if chosen is None:
        low, high = _search_range(fits, name)
    else:
        low, high = min(chosen[0] - offset, best), max(chosen[1] - offset, best)
    line = np.unique([*np.linspace(low, high, points), best])
    fits.reach(line[:, None])
    fits.settle(_neighbours(line))
    for _ in range(ROUNDS):
        delta = np.array([fits.delta([value]) for value in line])
        more = _refinement(line, delta, best, fits.levels)
        if not len(more):
            break
        fits.reach(more[:, None])
        line = np.unique([*line, *more])
    fits.settle(_neighbours(line))

    delta = np.array([fits.delta([value]) for value in line])
    nowhere = np.full(len(refit.parameters), np.nan)
    found = [fits.at([value]) for value in line]
    values = np.stack([nowhere if item is None else item.values for item in found])
    free, stops = _unconstrained_part(refit, line, values, best, index)
    inside = (line >= free[0]) & (line <= free[1])
    rise = float(np.nanmax(np.maximum(delta[inside], 0.0)))
    bounds = float(refit.parameters.lower[index]), float(refit.parameters.upper[index])
    intervals = tuple(
        interval_at(line, delta, best, level.delta_chi2, level.name, free, bounds)
        for level in fits.levels
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
        verdict=_verdict(rise, fits.levels[-1].delta_chi2, soft=soft, cut=cut),
        combinations=tuple(item for item in fit.combinations if name in item.weights),
        posterior=None if chain is None else _marginal(fit, chain, name, line + offset, delta),
        quantiles={} if fit.posterior is None else fit.posterior.quantiles.get(name, {}),
        warnings=_warnings(fits, found, intervals, line + offset, delta),
    )


def _neighbours(line: Floats) -> list[tuple[Point, Point]]:
    return [((float(a),), (float(b),)) for a, b in pairwise(line)]


def _search_range(fits: ConstrainedFits, name: str) -> tuple[float, float]:
    """Default range of a parameter."""
    item = fits.refit.fit.parameters[name]
    index = fits.refit.parameters.index(name)
    bounds = fits.refit.parameters.lower[index], fits.refit.parameters.upper[index]
    best = float(fits.best.held[0])
    if item.verdict in ("determined", "prior") and item.stderr:
        step, most, parallel = REACH * item.stderr, _LAST * item.typical, 1
    else:
        step, most, parallel = _FIRST * item.typical, _LAST * item.typical, _PARALLEL
    ladders = []
    for sense, bound in zip((-1.0, 1.0), bounds, strict=True):
        farthest = abs(bound - best) if math.isfinite(bound) else max(most, step)
        steps = step * 2.0 ** np.arange(1 + max(0, math.ceil(math.log2(max(farthest / step, 1)))))
        ladder = best + sense * np.minimum(steps, farthest)
        if math.isfinite(bound):
            ladder = np.where(steps >= farthest, bound, ladder)
        ladders.append(np.unique(ladder)[:: int(sense)] if farthest > 0 else ladder[:0])
    fits.reach(np.concatenate([ladder[:parallel] for ladder in ladders] or [[]])[:, None])
    sharp = parallel > 1
    low, high = (_search_end(fits, best, ladder, parallel, sharp=sharp) for ladder in ladders)
    return low, high


def _search_end(
    fits: ConstrainedFits, best: float, ladder: Floats, parallel: int, *, sharp: bool
) -> float:
    """First step of a ladder away from the best value where chi squared is high, or the last."""
    inside = best
    for first in range(0, len(ladder), parallel):
        part = ladder[first : first + parallel]
        fits.reach(part[:, None])
        for value in map(float, part):
            if fits.delta([value]) < HIGH * fits.levels[-1].delta_chi2_pair:
                inside = value
                continue
            outside = value
            while sharp and abs(outside - inside) > _SHARP * abs(outside - best):
                line = np.linspace(inside, outside, _SECTION + 1)[1:-1]
                fits.reach(line[:, None])
                low = [
                    value
                    for value in map(float, line)
                    if fits.delta([value]) < HIGH * fits.levels[-1].delta_chi2_pair
                ]
                inside = low[-1] if low else inside
                beyond = [value for value in (*map(float, line), outside)
                          if abs(value - best) > abs(inside - best)]  # fmt: skip
                outside = beyond[0]
            return outside if math.isfinite(fits.delta([outside])) else inside
    return inside


def _refinement(line: Floats, delta: Floats, best: float, levels: tuple[Level, ...]) -> Floats:
    """Points to add where the profile crosses a threshold too steeply to be interpolated."""
    root = np.sqrt(np.maximum(delta, 0.0))
    more: list[float] = []
    for index, (a, b) in enumerate(pairwise(line)):
        low, high = sorted(root[index : index + 2])
        # including those of regions of two parameters
        thresholds = [value for item in levels for value in (item.delta_chi2, item.delta_chi2_pair)]
        passed = any(low**2 < threshold <= high**2 for threshold in thresholds)
        if passed and high - low > _STEEP and b - a > 1e-9 * max(abs(a), abs(b), abs(b - best)):
            more += list(np.linspace(a, b, _SECTION + 1)[1:-1])
    return np.array(more)


def _unconstrained_part(
    refit: Refit, line: Floats, values: Floats, best: float, own: int
) -> tuple[tuple[float, float], tuple[tuple[str, ...], tuple[str, ...]]]:
    """The range in which no other parameter reaches a bound, and those that do at its ends."""
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


def interval_at(
    line: Floats, delta: Floats, best: float, threshold: float, level: str,
    free: tuple[float, float], bounds: tuple[float, float],
) -> Interval:  # fmt: skip
    """Interval between the crossings of a threshold on either side of the best value."""
    finite = np.isfinite(delta)
    line, delta = line[finite], delta[finite]
    root = np.sign(line - best) * np.sqrt(np.maximum(delta, 0.0))
    # nearly linear except at bounds, where it must not overshoot
    curve = PchipInterpolator(line, root)
    ends = []
    for sense, limit, bound in zip((-1, 1), free, bounds, strict=True):
        outward = np.flatnonzero(sense * (line - best) >= 0)[::sense]
        over = outward[delta[outward] >= threshold]
        if not len(over):
            end = float(line[outward[-1]])
            ends.append((end, "bound" if end == bound else "range"))
            continue
        first = over[0]
        target = sense * math.sqrt(threshold)
        inner, outer = float(line[first - sense]), float(line[first])
        end = float(brentq(lambda x: float(curve(x)) - target, inner, outer, xtol=1e-15))  # noqa: B023
        ends.append((end, "data" if sense * (end - limit) <= 0 else "others"))
    (low, low_by), (high, high_by) = ends
    return Interval(level, low, high, low_by, high_by)


def _verdict(rise: float, threshold: float, *, soft: bool, cut: bool) -> str:
    """See `Profile.verdict`; `soft` where the unconstrained part is most of the interval."""
    if cut and rise < threshold:
        return "narrow"
    if not soft or rise >= _HARDLY:
        return "limited"
    return "flat" if rise < _FLAT else "hardly"


def _warnings(
    fits: ConstrainedFits, found: Sequence[ConstrainedFit | None], intervals: Sequence[Interval],
    at: Floats, delta: Floats,
) -> tuple[str, ...]:  # fmt: skip
    refit, fit = fits.refit, fits.refit.fit
    warnings = list(fit.warnings)
    decrease = refit.first - refit.chi_squared
    if decrease > _BETTER:
        better = refit.parameters.values_of(refit.values + refit.offset)
        start = ",".join(f"{name}={better[name]:.6g}" for name in fit.coefficients)
        warnings.append(
            f"a better fit was found, its chi squared {decrease:.3g} lower, and the profile is "
            f"relative to it; fit again with --start {start}"
        )
    unconverged = sum(item is not None and not item.finished for item in found)
    if unconverged:
        warnings.append(
            f"{unconverged} of {len(found)} fits did not converge; chi squared there is at most "
            "the value shown"
        )
    failed = sum(item is None for item in found)
    if failed:
        warnings.append(f"at {failed} of {len(found)} values the law admits no motion")
    widest = intervals[-1]
    outside = (at < widest.low) | (at > widest.high)
    outside &= delta < fits.levels[-1].delta_chi2 - 0.1
    outside &= np.isfinite(delta)
    if outside.any():
        warnings.append(
            f"chi squared falls again near {at[outside][np.argmin(delta[outside])]:.4g}: the "
            "intervals are those about the best fit"
        )
    return tuple(warnings)


def _marginal(
    fit: FitResult, chain: Chain, name: str, at: Floats, delta: Floats
) -> dict[str, Floats] | None:
    """-2 log of the marginal posterior density, shifted onto the profile."""
    samples = chain.of({name: 1.0})
    low, high = np.quantile(samples, [0.0005, 0.9995])
    counts, edges = np.histogram(samples, _BINS, (max(low, at[0]), min(high, at[-1])))
    if not counts.any():
        return None
    centre = (edges[1:] + edges[:-1]) / 2
    some = counts > 0
    height = -2 * np.log(counts[some] / counts.max())
    ess = len(samples) if fit.posterior is None else fit.posterior.ess.get(name, len(samples))
    finite = np.isfinite(delta)
    shift = np.average(
        np.interp(centre[some], at[finite], delta[finite]) - height, weights=counts[some]
    )
    error = 2 / np.sqrt(counts[some] * min(ess / len(samples), 1.0))
    return {"at": centre[some], "height": height + shift, "error": error}
