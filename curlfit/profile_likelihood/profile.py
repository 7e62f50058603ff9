"""Profile likelihood: the minimum of chi squared at fixed values of one
parameter or two.

At each value all other parameters are fitted again, with the sigma of the fit. The
increase of chi squared and the thresholds of Wilks (1938) give intervals that are valid
where chi squared is not quadratic; the profile of a parameter that the data do not
determine is flat.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from curlfit.errors import InputError, Option, UnusableFitError
from curlfit.findings import Finding, Remedy
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.mcmc.chain import Chain
from curlfit.inference.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.profile_likelihood.refit import BETTER, ConstrainedFits, Refit
from curlfit.profile_likelihood.result import (
    Interval,
    Level,
    PairProfile,
    Profile,
    ProfileVerdict,
    require_usable,
)

POINTS = 41
POINTS_OF_PAIR = 25
_NO_RESPONSE = 1e-3  # change of the residuals by a typical size that counts as none
_WIDENING = 1.6  # factor
_MAX_SAMPLES = 1500
_REACH = 4.0  # standard errors to either side of the best value
# delta chi squared at the ends of a range, over that of a 95 % region of two
_HIGH = 1.5
_ROUNDS = 8
_FIRST, _LAST = 1e-3, 30.0  # first and last step of the search, in typical sizes
_SECTION = 10  # parts of an interval that is searched or refined
_SHARP = 0.02  # precision of the ends of a range, relative to its width
# largest step of the root of delta chi squared between points at a threshold
_STEEP = 0.6
_FLAT = 1e-3  # largest delta chi squared of a flat profile
_HARDLY = 1.0  # largest delta chi squared of a parameter that is weakly determined
_LARGE_PART = 0.5  # of an interval that ends at bounds of other parameters
_BINS = 24


def profile(
    fit: FitResult,
    names: str | Sequence[str],
    *,
    chain: Chain | None = None,
    points: int | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> Profile | PairProfile:
    """The profile likelihood of a parameter, or of two.

    Parameters
    ----------
    fit : a converged fit.
    names : one free parameter or two, of the law, the conditions or the initial state.
    chain : a posterior sample of the fit, for comparison.
    points : values of each parameter, by default `POINTS` for one and `POINTS_OF_PAIR`
        for two; more are added where the profile is steep.
    ranges : (low, high) by name. By default four standard errors to either side where
        the fit determines the parameter; otherwise to where chi squared is 9 higher, or
        to its bounds (30 typical sizes away where it has none).

    Returns
    -------
    Profile for one name, PairProfile for two.

    Raises
    ------
    InputError : an unknown, fixed or repeated name; more than two; a range that is
        empty, outside the bounds or without the best estimate; a chain of another law.
    UnusableFitError : the fit did not converge.

    Examples
    --------
    >>> profile = curlfit.profile(fit, "mu1_xi", points=21)
    >>> profile.verdict
    'limited'
    """
    selected = (names,) if isinstance(names, str) else tuple(names)
    require_fit(fit)
    parameters, ranges = fit.parameter_set, ranges or {}
    require_usable(
        parameters, selected, points, ranges, parameters.values_of(fit.values)
    )
    count = (POINTS, POINTS_OF_PAIR)[len(selected) - 1] if points is None else points
    if not fit.converged:
        raise UnusableFitError(f"the fit is not usable: {fit.status}")
    if chain is not None and chain.names != parameters.names:
        raise InputError("the chain is of another fit: its parameters differ")
    refit = Refit(fit)
    found: Any
    for _ in range(3):
        found, *second = [
            _profile_one(refit, name, count, ranges.get(name), chain)
            for name in selected
        ]
        if second:
            found = _profile_pair(refit, (found, *second), count, ranges, chain)
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
    best = float(fits.best[0])
    low, high = _search_range(fits, name) if chosen is None else chosen
    low, high = min(low, best), max(high, best)
    line = _settled(fits, np.unique([*np.linspace(low, high, points), best]))
    found, delta = fits.at(line[:, None]), fits.delta(line[:, None])
    nowhere = np.full(len(refit.parameters), np.nan)
    values = np.stack([nowhere if item is None else item.values for item in found])
    free, stops = _unconstrained_part(fits, line, values)
    inside = (line >= free[0]) & (line <= free[1])
    others = refit.parameters.free & (np.array(refit.parameters.names) != name)
    same = ("law", "load", "loss", "parameters", "n_observations")
    made = Profile(
        name=name,
        best=best,
        data={key: fit.data[key] for key in ("file", "rows", "from", "to")},
        chi_squared=refit.best.chi_squared,
        at=line,
        delta=delta,
        others=dict(
            zip(refit.parameters.names_where(others), values[:, others].T, strict=True)
        ),
        intervals=(),
        free=free,
        stops=stops,
        rise=float(np.nanmax(np.maximum(delta[inside], 0.0))),
        verdict=ProfileVerdict.NARROW,  # until the intervals are known
        combinations=tuple(item for item in fit.combinations if name in item.weights),
        posterior=None if chain is None else _marginal(fit, chain, name, line, delta),
        quantiles={}
        if fit.posterior is None
        else fit.posterior.quantiles.get(name, {}),
        warnings=(),
        **{key: getattr(fit, key) for key in same},
    )
    intervals = tuple(
        _interval_of(made, level.name, level.delta_chi2) for level in fits.levels
    )
    # a range that ends where neither a bound nor another parameter does
    ends = zip(free, (low, high), fits.bounds, strict=True)
    cut = chosen is not None and any(end == edge != bound for end, edge, bound in ends)
    unfinished = sum(item is not None and not item.finished for item in found)
    made = replace(
        made, intervals=intervals, verdict=_verdict(made, intervals[0], cut=cut)
    )
    warnings = _warnings(refit, made, unfinished, found.count(None))
    return replace(made, warnings=(*fit.warnings, *warnings))


def _settled(fits: ConstrainedFits, line: Floats) -> Floats:
    """Values at which all is fitted, and more where the profile is steep."""
    fits.settle(line[:, None, None])
    for _ in range(_ROUNDS):
        more = _refinement(
            line, fits.delta(line[:, None]), float(fits.best[0]), fits.levels
        )
        if not len(more):
            break
        line = np.unique([*line, *more])
    fits.settle(line[:, None, None])
    return line


def _verdict(made: Profile, first: Interval, *, cut: bool) -> ProfileVerdict:
    """See `ProfileVerdict`; `cut` where the given range may be too narrow."""
    soft = made.free[1] - made.free[0] > _LARGE_PART * (first.high - first.low)
    if (
        cut
        and made.rise < made.levels[-1].delta_chi2
        and (made.estimate.verdict != Verdict.NOT_IDENTIFIABLE)
    ):
        return ProfileVerdict.NARROW
    if not soft or made.rise >= _HARDLY:
        return ProfileVerdict.LIMITED
    if made.rise < _FLAT:
        return ProfileVerdict.FLAT
    return ProfileVerdict.HARDLY


def _search_range(fits: ConstrainedFits, name: str) -> tuple[float, float]:
    """Default range of a parameter."""
    item, best = fits.refit.fit.parameters[name], float(fits.best[0])
    sharp = not item.verdict.is_known or not item.stderr
    step = _FIRST * item.typical if sharp else _REACH * (item.stderr or 0.0)
    farthest = max(_LAST * item.typical, step)
    low, high = (
        _search_end(
            fits, step, bound if math.isfinite(bound) else best + way * farthest, sharp
        )
        for way, bound in zip((-1.0, 1.0), fits.bounds, strict=True)
    )
    return low, high


def _search_end(
    fits: ConstrainedFits, step: float, farthest: float, sharp: bool
) -> float:
    """First of steps from the best value, each twice the one before, where chi squared
    is high; the farthest place if it is high nowhere."""
    inside = outside = best = float(fits.best[0])
    limit = _HIGH * fits.levels[-1].delta_chi2_pair
    while outside == inside:
        if inside == farthest:
            return farthest
        short = step < abs(farthest - best)
        outside = best + math.copysign(step, farthest - best) if short else farthest
        if fits.delta(np.array([[outside]]))[0] < limit:
            inside, step = outside, 2 * step
    while sharp and abs(outside - inside) > _SHARP * abs(outside - best):
        line = np.linspace(inside, outside, _SECTION + 1)
        last = int(np.argmin(fits.delta(line[1:, None]) < limit))
        inside, outside = line[last : last + 2].tolist()
    return outside if np.isfinite(fits.delta(np.array([[outside]]))).all() else inside


def _refinement(
    line: Floats, delta: Floats, best: float, levels: tuple[Level, ...]
) -> Floats:
    """Points to add where the profile crosses a threshold too steeply to
    be interpolated."""
    root = np.sqrt(np.maximum(delta, 0.0))
    low, high = np.minimum(root[:-1], root[1:]), np.maximum(root[:-1], root[1:])
    # including those of regions of two parameters
    thresholds = np.reshape(
        [[item.delta_chi2, item.delta_chi2_pair] for item in levels], (-1, 1)
    )
    passed = ((low**2 < thresholds) & (thresholds <= high**2)).any(0)
    size = np.abs([line[:-1], line[1:], line[1:] - best]).max(0)
    steep = passed & (high - low > _STEEP) & (np.diff(line) > 1e-9 * size)
    parts = np.linspace(line[:-1][steep], line[1:][steep], _SECTION + 1)[1:-1]
    return parts.T.ravel()


def _unconstrained_part(
    fits: ConstrainedFits, line: Floats, values: Floats
) -> tuple[tuple[float, float], tuple[tuple[str, ...], tuple[str, ...]]]:
    """The range in which no other parameter reaches a bound, and those that do
    at its ends."""
    stuck = fits.refit.at_bound(values)
    stuck[:, fits.index] = False
    stuck &= ~stuck.all(0)
    ends = []
    for sense in (-1, 1):
        outward = np.flatnonzero(sense * (line - fits.best[0]) >= 0)[::sense]
        stopped = np.flatnonzero(stuck[outward[1:]].any(1))
        last = stopped[0] if len(stopped) else len(outward) - 1
        names = (
            fits.refit.parameters.names_where(stuck[outward[last + 1]])
            if len(stopped)
            else ()
        )
        ends.append((float(line[outward[last]]), tuple(names)))
    (low, below), (high, above) = ends
    return (low, high), (below, above)


def _interval_of(profile: Profile, level: str, threshold: float) -> Interval:
    """Interval between the crossings of a threshold on either side of
    the best value."""
    finite = np.isfinite(profile.delta)
    line, delta = profile.at[finite], profile.delta[finite]
    # nearly linear except at bounds, where it must not overshoot
    root = PchipInterpolator(
        line, np.sign(line - profile.best) * np.sqrt(np.maximum(delta, 0.0))
    )
    ends, bounds = [], (profile.estimate.lower, profile.estimate.upper)
    for sense, limit, bound in zip((-1, 1), profile.free, bounds, strict=True):
        crossed = sense * root.solve(sense * math.sqrt(threshold), extrapolate=False)
        if crossed.size:
            end = float(sense * crossed.min())
            ends.append((end, "data" if sense * (end - limit) <= 0 else "others"))
        else:
            end = float(line[0 if sense < 0 else -1])
            ends.append(
                (end, "bound" if math.isclose(end, bound, rel_tol=1e-12) else "range")
            )
    (low, low_by), (high, high_by) = ends
    return Interval(level, low, high, low_by, high_by)


def _warnings(
    refit: Refit, made: Profile, unfinished: int, failed: int
) -> Iterator[Finding]:
    """Warnings about the fits, of which some did not converge or have no path."""
    decrease = refit.first - refit.best.chi_squared
    if decrease > BETTER:
        better = refit.parameters.values_of(refit.best.values)
        start = ",".join(
            f"{name}={better[name]:.6g}" for name in refit.fit.coefficients
        )
        remedy = Remedy("fit-again", Option("start", start))
        yield Finding.warning("better-fit", remedy, decrease=float(decrease))
    values = len(made.at)
    if unfinished:
        yield Finding.warning("refits-unfinished", unfinished=unfinished, values=values)
    if failed:
        yield Finding.warning("values-without-motion", failed=failed, values=values)
    widest = made.intervals[-1]
    outside = (made.at < widest.low) | (made.at > widest.high)
    outside &= made.delta < made.levels[-1].delta_chi2 - 0.1
    if outside.any():
        lowest = made.at[outside][np.argmin(made.delta[outside])]
        yield Finding.warning("second-minimum", at=float(lowest))


def _marginal(
    fit: FitResult, chain: Chain, name: str, at: Floats, delta: Floats
) -> dict[str, Floats] | None:
    """-2 log of the marginal posterior density, shifted onto the profile."""
    samples = chain.of({name: 1.0})
    low, high = np.quantile(samples, [0.0005, 0.9995])
    counts, edges = np.histogram(samples, _BINS, (max(low, at[0]), min(high, at[-1])))
    if not counts.any():
        return None
    centre, some = ((edges[1:] + edges[:-1]) / 2)[counts > 0], counts[counts > 0]
    height, finite = -2 * np.log(some / some.max()), np.isfinite(delta)
    ess = (
        len(samples)
        if fit.posterior is None
        else fit.posterior.ess.get(name, len(samples))
    )
    off = np.interp(centre, at[finite], delta[finite]) - height
    error = 2 / np.sqrt(some * min(ess / len(samples), 1.0))
    return {
        "at": centre,
        "height": height + np.average(off, weights=some),
        "error": error,
    }


def _profile_pair(
    refit: Refit,
    each: tuple[Profile, Profile],
    points: int,
    ranges: Collection[str],
    chain: Chain | None,
) -> PairProfile:
    """The profile of two parameters, along the valley that the profile of the
    first follows."""
    (one, other), fit = each, refit.fit
    names = one.name, other.name
    fits = ConstrainedFits(refit, names)
    stiff, first = float(fits.stiffness[1]), _columns(one, points)
    across = 1 / stiff if stiff * other.estimate.typical > _NO_RESPONSE else None
    if across is None or other.name in ranges:
        second = np.tile(
            np.linspace(other.at[0], other.at[-1], points), (len(first), 1)
        )
    else:
        finite = np.isfinite(one.delta)
        valley = np.interp(first, one.at[finite], one.others[other.name][finite])
        second = _across_valley(fits, first, valley, across, points)
    grid = _grid(first, np.clip(second, *fits.bounds))
    fits.settle(grid)
    delta, best = fits.delta(grid), np.array([one.best, other.best])
    covariance = _covariance(fit, names)
    samples = np.zeros((0, 2))
    if chain is not None:
        samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
        some = np.linspace(0, len(samples) - 1, min(len(samples), _MAX_SAMPLES)).astype(
            int
        )
        samples = samples[some]
    return PairProfile(
        names=names,
        each=each,
        first=grid[..., 0],
        second=grid[..., 1],
        delta=delta,
        across=across,
        extent={  # crossings of the threshold by each profile alone
            level.name: (
                _interval_of(one, level.name, level.delta_chi2_pair),
                _interval_of(other, level.name, level.delta_chi2_pair),
            )
            for level in fits.levels
        },
        covariance=covariance,
        ellipse=_off_ellipse(
            grid - best, delta, covariance, fits.levels[-1].delta_chi2_pair
        ),
        samples=samples,
        warnings=one.warnings,
    )


def _off_ellipse(
    away: Floats, delta: Floats, covariance: Floats | None, threshold: float
) -> float | None:
    """Largest difference of chi squared from its quadratic form within an
    ellipse of that."""
    if covariance is None:
        return None
    expected = np.einsum("ijk,kl,ijl->ij", away, np.linalg.inv(covariance), away)
    within = (expected <= threshold) & np.isfinite(delta)
    return float(np.abs(delta - expected)[within].max()) if within.any() else None


def _columns(one: Profile, points: int) -> Floats:
    """Values of the first of two parameters, evenly spaced; of a flat one, within
    its free part."""
    if one.verdict == ProfileVerdict.LIMITED:
        return np.unique([*np.linspace(one.at[0], one.at[-1], points), one.best])
    beyond = one.at[(one.at < one.free[0]) | (one.at > one.free[1])]
    return np.unique([*np.linspace(*one.free, points), one.best, *beyond])


def _across_valley(
    fits: ConstrainedFits, first: Floats, valley: Floats, across: float, points: int
) -> Floats:
    """Values of the second about the bottom of the valley, farther where chi squared is
    not high there."""
    steps, bounds, valley = (
        np.linspace(-_REACH, _REACH, points | 1),
        fits.bounds,
        valley[:, None],
    )
    wide = np.full((len(first), 2), across)
    for _ in range(_ROUNDS):
        ends = np.clip(valley + _REACH * np.array([-1, 1]) * wide, *bounds)
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
    known = fit.covariance["names"]
    if any(fit.parameters[name].stderr is None or name not in known for name in names):
        return None
    rows = np.array([fit.first_order.vector({name: 1.0}) for name in names])
    return np.asarray(rows @ np.array(fit.covariance["matrix"]) @ rows.T)
