"""Profile likelihood: the minimum of chi squared at fixed values of one parameter or two.

At each value all other parameters are fitted again, with the sigma of the fit. The increase of chi
squared and the thresholds of Wilks (1938) give intervals that are valid where chi squared is not
quadratic; the profile of a parameter that the data do not determine is flat.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from curlfit.errors import InputError, UnusableFitError
from curlfit.inference.fit.fit import fit as least_squares
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.mcmc.chain import Chain
from curlfit.numerics.arrays import Floats
from curlfit.profile_likelihood.refit import ConstrainedFit, ConstrainedFits, Progress, Refit
from curlfit.profile_likelihood.result import Interval, Level, PairProfile, Profile, require_usable
from curlfit.throws.throw import Throw

POINTS = 41
POINTS_OF_PAIR = 25
_NO_RESPONSE = 1e-3  # change of the residuals by a typical size that counts as none
_MIN_STEP, _WIDEST = 0.05, 30.0  # smallest step and largest width, over that at the best fit
_WIDENING = 1.6  # factor
_MAX_SAMPLES = 1500
_REACH = 4.0  # standard errors to either side of the best value
_HIGH = 1.5  # delta chi squared at the ends of a range, over that of a 95 % region of two
_ROUNDS = 8
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
    names : one free parameter or two, of the law, the conditions or the initial state.
    chain : a posterior sample of the fit, for comparison.
    points : values of each parameter, by default `POINTS` for one and `POINTS_OF_PAIR` for two;
        more are added where the profile is steep.
    ranges : (low, high) by name. By default four standard errors to either side where the fit
        determines the parameter; otherwise to where chi squared is 9 higher, or to its bounds (30
        typical sizes away where it has none).
    progress : called with the number of fits done.
    choices : of `curlfit.fit`, for a throw.

    Returns
    -------
    Profile for one name, PairProfile for two.

    Raises
    ------
    InputError : an unknown, fixed or repeated name; more than two; a range that is empty, outside
        the bounds or without the best estimate; a chain of another law; choices given with a fit.
    UnusableFitError : the fit did not converge.

    Examples
    --------
    >>> profile = curlfit.profile(fit, "mu1_xi", points=21)
    >>> profile.verdict
    'limited'
    """
    selected = (names,) if isinstance(names, str) else tuple(names)
    if isinstance(subject, Throw):
        fit = least_squares(subject, **choices)
    else:
        require_fit(subject)
        fit = subject
        if choices:
            raise InputError(f"{', '.join(choices)}: a fit has its own; give a throw to fit anew")
    parameters, ranges = fit.parameter_set, ranges or {}
    require_usable(parameters, selected, points, ranges, parameters.values_of(fit.values))
    count = (POINTS, POINTS_OF_PAIR)[len(selected) - 1] if points is None else points
    if not fit.converged:
        raise UnusableFitError(f"the fit is not usable: {fit.status}")
    if chain is not None and chain.names != parameters.names:
        raise InputError("the chain is of another fit: its parameters differ")
    refit = Refit(fit, progress)
    found: Profile | PairProfile
    for _ in range(3):
        found, *second = [
            _profile_one(refit, name, count, ranges.get(name), chain) for name in selected
        ]
        if second:
            found = _profile_pair(refit, found, second[0], count, ranges, chain)
        if not refit.improved():
            break
    return found


def _profile_one(
    refit: Refit,
    name: str,
    points: int,
    chosen: tuple[float, float] | None,
    chain: Chain | None,
) -> Profile:
    """The profile of one parameter."""
    fit, fits = refit.fit, ConstrainedFits(refit, [name])
    index = refit.parameters.index(name)
    offset, best = refit.offset[index], float(fits.best.held[0])
    if chosen is None:
        low, high = _search_range(fits, name)
    else:
        low, high = min(chosen[0] - offset, best), max(chosen[1] - offset, best)
    line = np.unique([*np.linspace(low, high, points), best])
    fits.settle(line[:, None, None])
    for _ in range(_ROUNDS):
        more = _refinement(line, fits.delta(line[:, None]), best, fits.levels)
        if not len(more):
            break
        line = np.unique([*line, *more])
    fits.settle(line[:, None, None])

    found, delta = fits.at(line[:, None]), fits.delta(line[:, None])
    nowhere = np.full(len(refit.parameters), np.nan)
    values = np.stack([nowhere if item is None else item.values for item in found])
    free, stops = _unconstrained_part(refit, line, values, best, index)
    inside = (line >= free[0]) & (line <= free[1])
    everywhere = values + refit.offset
    made = Profile(
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
        intervals=(),
        free=(free[0] + offset, free[1] + offset),
        stops=stops,
        rise=float(np.nanmax(np.maximum(delta[inside], 0.0))),
        verdict="",
        combinations=tuple(item for item in fit.combinations if name in item.weights),
        posterior=None if chain is None else _marginal(fit, chain, name, line + offset, delta),
        quantiles={} if fit.posterior is None else fit.posterior.quantiles.get(name, {}),
        warnings=(),
    )
    intervals = tuple(_interval_of(made, level.name, level.delta_chi2) for level in fits.levels)
    bounds = refit.parameters.lower[index], refit.parameters.upper[index]
    cut = chosen is not None and any(
        end == edge and edge != bound
        for end, edge, bound in zip(free, (low, high), bounds, strict=True)
    )
    cut &= fit.parameters[name].verdict != "not identifiable"
    soft = free[1] - free[0] > _LARGE_PART * (intervals[0].high - intervals[0].low)
    verdict = _verdict(made.rise, fits.levels[-1].delta_chi2, soft=soft, cut=cut)
    warnings = _warnings(fits, found, intervals[-1], made)
    return replace(made, intervals=intervals, verdict=verdict, warnings=warnings)


def _search_range(fits: ConstrainedFits, name: str) -> tuple[float, float]:
    """Default range of a parameter."""
    item = fits.refit.fit.parameters[name]
    index = fits.refit.parameters.index(name)
    bounds = fits.refit.parameters.lower[index], fits.refit.parameters.upper[index]
    best = float(fits.best.held[0])
    if item.verdict in ("determined", "prior") and item.stderr:
        step, most, parallel = _REACH * item.stderr, _LAST * item.typical, 1
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
    fits.at(np.concatenate([ladder[:parallel] for ladder in ladders])[:, None])
    sharp = parallel > 1
    low, high = (_search_end(fits, best, ladder, parallel, sharp=sharp) for ladder in ladders)
    return low, high


def _search_end(
    fits: ConstrainedFits, best: float, ladder: Floats, parallel: int, *, sharp: bool
) -> float:
    """First step of a ladder away from the best value where chi squared is high, or the last."""
    inside, limit = best, _HIGH * fits.levels[-1].delta_chi2_pair
    for first in range(0, len(ladder), parallel):
        part = ladder[first : first + parallel]
        low = part[np.logical_and.accumulate(fits.delta(part[:, None]) < limit)]
        inside = float(low[-1]) if len(low) else inside
        if len(low) == len(part):
            continue
        outside = float(part[len(low)])
        while sharp and abs(outside - inside) > _SHARP * abs(outside - best):
            line = np.linspace(inside, outside, _SECTION + 1)[1:-1]
            low = line[fits.delta(line[:, None]) < limit]
            inside = float(low[-1]) if len(low) else inside
            beyond = np.array([*line, outside])
            outside = float(beyond[np.argmax(np.abs(beyond - best) > abs(inside - best))])
        return outside if np.isfinite(fits.delta(np.array([[outside]]))).all() else inside
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


def _interval_of(profile: Profile, level: str, threshold: float) -> Interval:
    """Interval between the crossings of a threshold on either side of the best value."""
    finite = np.isfinite(profile.delta)
    line, delta, best = profile.at[finite], profile.delta[finite], profile.best
    root = np.sign(line - best) * np.sqrt(np.maximum(delta, 0.0))
    # nearly linear except at bounds, where it must not overshoot
    curve = PchipInterpolator(line, root)
    ends, bounds = [], (profile.estimate.lower, profile.estimate.upper)
    for sense, limit, bound in zip((-1, 1), profile.free, bounds, strict=True):
        outward = np.flatnonzero(sense * (line - best) >= 0)[::sense]
        over = outward[delta[outward] >= threshold]
        if not len(over):
            end = float(line[outward[-1]])
            ends.append((end, "bound" if math.isclose(end, bound, rel_tol=1e-12) else "range"))
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
    fits: ConstrainedFits, found: Sequence[ConstrainedFit | None], widest: Interval, made: Profile
) -> tuple[str, ...]:
    refit, fit, at, delta = fits.refit, fits.refit.fit, made.at, made.delta
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
    outside = (at < widest.low) | (at > widest.high)
    outside &= delta < fits.levels[-1].delta_chi2 - 0.1
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


def _profile_pair(
    refit: Refit,
    one: Profile,
    other: Profile,
    points: int,
    ranges: Collection[str],
    chain: Chain | None,
) -> PairProfile:
    """The profile of two parameters, along the valley that the profile of the first follows."""
    fit, names = refit.fit, (one.name, other.name)
    index = [refit.parameters.index(name) for name in names]
    offset = refit.offset[index]
    fits = ConstrainedFits(refit, names)
    stiff = float(refit.response(names)[1][1])
    typical = fit.parameters[other.name].typical
    across = 1 / stiff if stiff * typical > _NO_RESPONSE else None
    bounds = refit.parameters.lower[index[1]], refit.parameters.upper[index[1]]
    edges: list[float] = []
    if across is not None:
        edges = [bounds[0] + _REACH * across + offset[1], bounds[1] - _REACH * across + offset[1]]
    first = _columns(one, other.name, edges, points) - offset[0]
    if across is None or other.name in ranges:
        ends = other.at[0] - offset[1], other.at[-1] - offset[1]
        second = np.tile(np.linspace(*ends, points), (len(first), 1))
    else:
        finite = np.isfinite(one.delta)
        values = one.others[other.name][finite]
        valley = np.interp(first + offset[0], one.at[finite], values) - offset[1]
        second = _across_valley(fits, first, valley, across, bounds, points)
    second = np.clip(second, *bounds)
    grid = _grid(first, second)
    fits.settle(grid)
    delta = fits.delta(grid)
    covariance = _covariance(fit, names)
    ellipse = None
    if covariance is not None:
        best = np.array([one.best, other.best]) - offset
        away = grid - best
        expected = np.einsum("ijk,kl,ijl->ij", away, np.linalg.inv(covariance), away)
        within = (expected <= fits.levels[-1].delta_chi2_pair) & np.isfinite(delta)
        if within.any():
            ellipse = float(np.abs(delta - expected)[within].max())
    extent = {  # crossings of the threshold by each profile alone
        level.name: (
            _interval_of(one, level.name, level.delta_chi2_pair),
            _interval_of(other, level.name, level.delta_chi2_pair),
        )
        for level in fits.levels
    }
    samples = np.zeros((0, 2))
    if chain is not None:
        samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
        some = np.linspace(0, len(samples) - 1, min(len(samples), _MAX_SAMPLES)).astype(int)
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
    """Values of the first of two parameters, evenly spaced; of a flat one, more at its ends.

    There the region is cut off by the bound of the second, beginning at `edges`.
    """
    if one.verdict == "limited":
        return np.unique([*np.linspace(one.at[0], one.at[-1], points), one.best])
    free = (one.at >= one.free[0]) & (one.at <= one.free[1])
    at, values = one.at[free], one.others[other][free]
    order = np.argsort(values)
    cut = [
        float(np.interp(edge, values[order], at[order]))
        for edge in edges
        if values.min() < edge < values.max()
    ]
    return np.unique([*np.linspace(*one.free, points), one.best, *cut, *one.at[~free]])


def _across_valley(
    fits: ConstrainedFits, first: Floats, valley: Floats, across: float,
    bounds: tuple[float, float], points: int,
) -> Floats:  # fmt: skip
    """Values of the second about the bottom of the valley, scaled by its local width."""
    steps, sense = np.linspace(-_REACH, _REACH, points | 1), np.array([-1, 1])
    valley = valley[:, None]
    sides = np.clip(valley + sense * across, *bounds)
    bottom, *delta = fits.delta(_grid(first, np.hstack([valley, sides]))).T
    away, rise = np.abs(sides - valley) / across, np.transpose(delta - bottom)
    quick = np.sqrt(np.fmax(rise, (np.maximum(away, _MIN_STEP) / _WIDEST) ** 2))
    wide = across * np.where((away > _MIN_STEP) & np.isfinite(rise), away / quick, 1.0)
    for _ in range(_ROUNDS):  # wider where chi squared is not quadratic
        ends = np.clip(valley + _REACH * sense * wide, *bounds)
        low = fits.delta(_grid(first, ends)) < _HIGH * fits.levels[-1].delta_chi2_pair
        low &= (ends > bounds[0]) & (ends < bounds[1])
        if not low.any():
            break
        wide[low] *= _WIDENING
    return np.asarray(valley + steps * np.where(steps < 0, wide[:, :1], wide[:, 1:]))


def _grid(first: Floats, second: Floats) -> Floats:
    """Points of columns of values of the second of two parameters, shape (n, m, 2)."""
    return np.stack(np.broadcast_arrays(first[:, None], second), -1)


def _covariance(fit: FitResult, names: Sequence[str]) -> Floats | None:
    known = list(fit.covariance["names"])
    if any(fit.parameters[name].stderr is None or name not in known for name in names):
        return None
    index = [known.index(name) for name in names]
    found: Floats = np.array(fit.covariance["matrix"])[np.ix_(index, index)]
    return found
