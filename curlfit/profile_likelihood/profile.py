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
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.sampling.chain import Chain
from curlfit.numerics.arrays import Floats
from curlfit.profile_likelihood.refit import BETTER, ConstrainedFits, Refit
from curlfit.profile_likelihood.result import (
    Interval,
    Level,
    LevelName,
    Limit,
    PairProfile,
    PosteriorDensity,
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
_FIRST = 1e-3  # first step of the search, in typical sizes
_LAST = 30.0  # last step of the search, in typical sizes
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
    ranges = ranges or {}
    require_fit(fit)
    parameters = fit.parameter_set
    require_usable(
        parameters, selected, points, ranges, parameters.values_of(fit.values)
    )
    if points is None:
        points = POINTS if len(selected) == 1 else POINTS_OF_PAIR
    if not fit.converged:
        raise UnusableFitError(f"the fit is not usable: {fit.status}")
    if chain is not None and chain.names != parameters.names:
        raise InputError("the chain is of another fit: its parameters differ")
    refit = Refit(fit)
    # A refit may be better than the fit; the profile is then made again about it.
    for _ in range(3):
        profiles = [
            _profile_one(refit, name, points, ranges.get(name), chain)
            for name in selected
        ]
        result: Profile | PairProfile = profiles[0]
        if len(profiles) == 2:
            result = _profile_pair(
                refit, profiles[0], profiles[1], points, ranges, chain
            )
        if not refit.improved():
            break
    return result


def _profile_one(
    refit: Refit,
    name: str,
    points: int,
    chosen: tuple[float, float] | None,
    chain: Chain | None,
) -> Profile:
    """The profile of one parameter, over a chosen range or that of `_search_range`."""
    fit = refit.fit
    fits = ConstrainedFits(refit, [name])
    best = float(fits.best[0])
    low, high = _search_range(fits, name) if chosen is None else chosen
    low = min(low, best)
    high = max(high, best)
    line = _settled(fits, np.unique([*np.linspace(low, high, points), best]))
    optima = fits.at(line[:, None])
    delta = fits.delta(line[:, None])
    without_path = np.full(len(refit.parameters), np.nan)
    values = np.stack(
        [without_path if optimum is None else optimum.values for optimum in optima]
    )
    free, stops = _unconstrained_part(fits, line, values)
    inside = (line >= free[0]) & (line <= free[1])
    refitted = refit.parameters.free & (np.array(refit.parameters.names) != name)
    refitted_names = refit.parameters.names_where(refitted)
    posterior = fit.posterior
    profile = Profile(
        name=name,
        best=best,
        law=fit.law,
        load=fit.load,
        loss=fit.loss,
        data=fit.data.extent,
        parameters=fit.parameters,
        chi_squared=refit.best.chi_squared,
        n_observations=fit.n_observations,
        at=line,
        delta=delta,
        others=dict(zip(refitted_names, values[:, refitted].T, strict=True)),
        intervals=(),
        free=free,
        stops=stops,
        rise=float(np.nanmax(np.maximum(delta[inside], 0.0))),
        verdict=ProfileVerdict.NARROW,  # until the intervals are known
        combinations=tuple(sum_ for sum_ in fit.combinations if name in sum_.weights),
        posterior=None if chain is None else _marginal(fit, chain, name, line, delta),
        quantiles={} if posterior is None else posterior.quantiles.get(name, {}),
        warnings=(),
    )
    intervals = tuple(
        _interval_of(profile, level.name, level.delta_chi2) for level in fits.levels
    )
    # a range that ends where neither a bound nor another parameter does
    lower, upper = fits.bounds
    cut = chosen is not None and (free[0] == low != lower or free[1] == high != upper)
    verdict = _verdict(profile, intervals[0], cut=cut)
    profile = replace(profile, intervals=intervals, verdict=verdict)
    unfinished = sum(optimum is not None and not optimum.finished for optimum in optima)
    warnings = _warnings(refit, profile, unfinished, optima.count(None))
    return replace(profile, warnings=(*fit.warnings, *warnings))


def _settled(fits: ConstrainedFits, line: Floats) -> Floats:
    """Values at which all is fitted: those of a line, and more where the profile
    is steep."""
    best = float(fits.best[0])
    fits.settle(line[:, None, None])
    for _ in range(_ROUNDS):
        more = _refinement(line, fits.delta(line[:, None]), best, fits.levels)
        if not len(more):
            break
        line = np.unique([*line, *more])
    fits.settle(line[:, None, None])
    return line


def _verdict(profile: Profile, first: Interval, *, cut: bool) -> ProfileVerdict:
    """See `ProfileVerdict`; `first` is the 68 % interval, `cut` whether the given
    range may be too narrow."""
    if (
        cut
        and profile.rise < profile.levels[-1].delta_chi2
        and profile.estimate.verdict != Verdict.NOT_IDENTIFIABLE
    ):
        return ProfileVerdict.NARROW
    low, high = profile.free
    mostly_free = high - low > _LARGE_PART * (first.high - first.low)
    if not mostly_free or profile.rise >= _HARDLY:
        return ProfileVerdict.LIMITED
    if profile.rise < _FLAT:
        return ProfileVerdict.FLAT
    return ProfileVerdict.HARDLY


def _search_range(fits: ConstrainedFits, name: str) -> tuple[float, float]:
    """Default range of a parameter: some standard errors where it has one, else as
    far as chi squared is low."""
    best = float(fits.best[0])
    estimate = fits.refit.fit.parameters[name]
    if estimate.verdict.is_known and estimate.stderr:
        sharp = False
        step = _REACH * estimate.stderr
    else:
        sharp = True
        step = _FIRST * estimate.typical
    farthest = max(_LAST * estimate.typical, step)
    lower, upper = fits.bounds
    lowest = lower if math.isfinite(lower) else best - farthest
    highest = upper if math.isfinite(upper) else best + farthest
    low = _search_end(fits, step, lowest, sharp)
    high = _search_end(fits, step, highest, sharp)
    return low, high


def _search_end(
    fits: ConstrainedFits, step: float, farthest: float, sharp: bool
) -> float:
    """First of steps from the best value, each twice the one before, where chi squared
    is high; the farthest value if it is high nowhere.

    A sharp end is then bisected, by tens, to `_SHARP` of its distance.
    """
    best = float(fits.best[0])
    limit = _HIGH * fits.levels[-1].delta_chi2_pair
    inside = best  # the farthest value at which chi squared is low
    outside = best
    while outside == inside:
        if inside == farthest:
            return farthest
        if step < abs(farthest - best):
            outside = best + math.copysign(step, farthest - best)
        else:
            outside = farthest
        if fits.delta(np.array([[outside]]))[0] < limit:
            inside = outside
            step = 2 * step
    while sharp and abs(outside - inside) > _SHARP * abs(outside - best):
        line = np.linspace(inside, outside, _SECTION + 1)
        last_low = int(np.argmin(fits.delta(line[1:, None]) < limit))
        inside, outside = line[last_low : last_low + 2].tolist()
    has_path = np.isfinite(fits.delta(np.array([[outside]]))).all()
    return outside if has_path else inside


def _refinement(
    line: Floats, delta: Floats, best: float, levels: tuple[Level, ...]
) -> Floats:
    """Points to add where the profile crosses a threshold too steeply to
    be interpolated."""
    root = np.sqrt(np.maximum(delta, 0.0))
    low = np.minimum(root[:-1], root[1:])
    high = np.maximum(root[:-1], root[1:])
    # including those of regions of two parameters
    thresholds = np.reshape(
        [[level.delta_chi2, level.delta_chi2_pair] for level in levels], (-1, 1)
    )
    crossed = ((low**2 < thresholds) & (thresholds <= high**2)).any(0)
    size = np.abs([line[:-1], line[1:], line[1:] - best]).max(0)
    apart = np.diff(line) > 1e-9 * size  # by more than rounding
    steep = crossed & (high - low > _STEEP) & apart
    parts = np.linspace(line[:-1][steep], line[1:][steep], _SECTION + 1)[1:-1]
    return parts.T.ravel()


def _unconstrained_part(
    fits: ConstrainedFits, line: Floats, values: Floats
) -> tuple[tuple[float, float], tuple[tuple[str, ...], tuple[str, ...]]]:
    """The range in which no other parameter reaches a bound, and the names of those
    that do beyond either end of it; `values` of all, shape (line, parameters)."""
    parameters = fits.refit.parameters
    stuck = fits.refit.at_bound(values)
    stuck[:, fits.index] = False
    stuck &= ~stuck.all(0)  # one that is at a bound everywhere stops nothing

    def end_of(outward: Any) -> tuple[float, tuple[str, ...]]:
        """The last free value, and what stops; rows from the best value outward."""
        stopped = np.flatnonzero(stuck[outward[1:]].any(1))
        if not len(stopped):
            return float(line[outward[-1]]), ()
        last_free = outward[stopped[0]]
        first_stuck = outward[stopped[0] + 1]
        return float(line[last_free]), tuple(parameters.names_where(stuck[first_stuck]))

    best = fits.best[0]
    low, below = end_of(np.flatnonzero(line <= best)[::-1])
    high, above = end_of(np.flatnonzero(line >= best))
    return (low, high), (below, above)


def _interval_of(profile: Profile, level: LevelName, threshold: float) -> Interval:
    """Interval between the crossings of a threshold on either side of
    the best value."""
    finite = np.isfinite(profile.delta)
    line = profile.at[finite]
    delta = profile.delta[finite]
    # The root with the sign of the side is nearly linear except at bounds, where the
    # interpolation must not overshoot.
    root = PchipInterpolator(
        line, np.sign(line - profile.best) * np.sqrt(np.maximum(delta, 0.0))
    )

    def end_of(sense: int, free_end: float, bound: float) -> tuple[float, Limit]:
        """End below (-1) or above (1) the best value, and what limits it."""
        crossings = sense * root.solve(sense * math.sqrt(threshold), extrapolate=False)
        if crossings.size:
            end = float(sense * crossings.min())
            return end, "data" if sense * (end - free_end) <= 0 else "others"
        end = float(line[0 if sense < 0 else -1])
        return end, "bound" if math.isclose(end, bound, rel_tol=1e-12) else "range"

    low, low_by = end_of(-1, profile.free[0], profile.estimate.lower)
    high, high_by = end_of(1, profile.free[1], profile.estimate.upper)
    return Interval(level, low, high, low_by, high_by)


def _warnings(
    refit: Refit, profile: Profile, unfinished: int, failed: int
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
    values = len(profile.at)
    if unfinished:
        yield Finding.warning("refits-unfinished", unfinished=unfinished, values=values)
    if failed:
        yield Finding.warning("values-without-motion", failed=failed, values=values)
    widest = profile.intervals[-1]
    outside = (profile.at < widest.low) | (profile.at > widest.high)
    outside &= profile.delta < profile.levels[-1].delta_chi2 - 0.1
    if outside.any():
        lowest = profile.at[outside][np.argmin(profile.delta[outside])]
        yield Finding.warning("second-minimum", at=float(lowest))


def _marginal(
    fit: FitResult, chain: Chain, name: str, at: Floats, delta: Floats
) -> PosteriorDensity | None:
    """-2 log of the marginal posterior density, shifted onto the profile."""
    samples = chain.of({name: 1.0})
    low, high = np.quantile(samples, [0.0005, 0.9995])
    counts, edges = np.histogram(samples, _BINS, (max(low, at[0]), min(high, at[-1])))
    if not counts.any():
        return None
    filled = counts > 0
    centre = ((edges[1:] + edges[:-1]) / 2)[filled]
    counts = counts[filled]
    height = -2 * np.log(counts / counts.max())
    finite = np.isfinite(delta)
    below_profile = np.interp(centre, at[finite], delta[finite]) - height
    ess = float(len(samples))
    if fit.posterior is not None:
        ess = fit.posterior.ess.get(name, ess)
    independent_counts = counts * min(ess / len(samples), 1.0)
    return PosteriorDensity(
        at=centre,
        height=height + np.average(below_profile, weights=counts),
        error=2 / np.sqrt(independent_counts),
    )


def _profile_pair(
    refit: Refit,
    first: Profile,
    second: Profile,
    points: int,
    ranges: Collection[str],
    chain: Chain | None,
) -> PairProfile:
    """The profile of two parameters, along the valley that the profile of the
    first follows.

    `ranges` are the names of parameters whose range is given.
    """
    names = (first.name, second.name)
    fits = ConstrainedFits(refit, names)
    columns = _columns(first, points)
    stiffness = float(fits.stiffness[1])
    across = None
    if stiffness * second.estimate.typical > _NO_RESPONSE:
        across = 1 / stiffness
    if across is None or second.name in ranges:
        line = np.linspace(second.at[0], second.at[-1], points)
        values = np.tile(line, (len(columns), 1))
    else:
        finite = np.isfinite(first.delta)
        bottom = first.others[second.name][finite]
        valley = np.interp(columns, first.at[finite], bottom)
        values = _across_valley(fits, columns, valley, across, points)
    grid = _grid(columns, np.clip(values, *fits.bounds))
    fits.settle(grid)
    delta = fits.delta(grid)
    covariance = _covariance(refit.fit, names)
    off_best = grid - np.array([first.best, second.best])
    samples = np.zeros((0, 2))
    if chain is not None:
        samples = np.stack([chain.of({name: 1.0}) for name in names], 1)
        kept = np.linspace(0, len(samples) - 1, min(len(samples), _MAX_SAMPLES))
        samples = samples[kept.astype(int)]
    return PairProfile(
        names=names,
        each=(first, second),
        first=grid[..., 0],
        second=grid[..., 1],
        delta=delta,
        across=across,
        extent={  # crossings of the threshold by each profile alone
            level.name: (
                _interval_of(first, level.name, level.delta_chi2_pair),
                _interval_of(second, level.name, level.delta_chi2_pair),
            )
            for level in fits.levels
        },
        covariance=covariance,
        ellipse=_off_ellipse(
            off_best, delta, covariance, fits.levels[-1].delta_chi2_pair
        ),
        samples=samples,
        warnings=first.warnings,
    )


def _off_ellipse(
    off_best: Floats, delta: Floats, covariance: Floats | None, threshold: float
) -> float | None:
    """Largest difference of chi squared from its quadratic form, within the ellipse
    in which that form is at most the threshold.

    `off_best` are differences from the best values, shape (n, m, 2), and `delta` chi
    squared there, shape (n, m).
    """
    if covariance is None:
        return None
    inverse = np.linalg.inv(covariance)
    expected = np.einsum("ijk,kl,ijl->ij", off_best, inverse, off_best)
    within = (expected <= threshold) & np.isfinite(delta)
    return float(np.abs(delta - expected)[within].max()) if within.any() else None


def _columns(profile: Profile, points: int) -> Floats:
    """Values of the first of two parameters, evenly spaced; of a flat one, within
    its free part."""
    at = profile.at
    low, high = profile.free
    if profile.verdict == ProfileVerdict.LIMITED:
        return np.unique([*np.linspace(at[0], at[-1], points), profile.best])
    beyond = at[(at < low) | (at > high)]
    return np.unique([*np.linspace(low, high, points), profile.best, *beyond])


def _across_valley(
    fits: ConstrainedFits, columns: Floats, valley: Floats, across: float, points: int
) -> Floats:
    """Values of the second parameter about the bottom of the valley, farther where chi
    squared is not high there, shape (columns, values)."""
    lower, upper = fits.bounds
    high = _HIGH * fits.levels[-1].delta_chi2_pair
    bottom = valley[:, None]
    # below and above the bottom, in values of the parameter per step
    widths = np.full((len(columns), 2), across)
    for _ in range(_ROUNDS):
        ends = np.clip(bottom + _REACH * np.array([-1, 1]) * widths, lower, upper)
        too_low = fits.delta(_grid(columns, ends)) < high
        too_low &= (ends > lower) & (ends < upper)
        if not too_low.any():
            break
        widths[too_low] *= _WIDENING
    steps = np.linspace(-_REACH, _REACH, points | 1)  # an odd number of points
    width = np.where(steps < 0, widths[:, :1], widths[:, 1:])
    return np.asarray(bottom + steps * width)


def _grid(columns: Floats, values: Floats) -> Floats:
    """Points from values of one parameter, shape (n,), and for each of them values of
    a second, shape (n, m): shape (n, m, 2)."""
    return np.stack(np.broadcast_arrays(columns[:, None], values), -1)


def _covariance(fit: FitResult, names: Sequence[str]) -> Floats | None:
    """Covariance of some parameters; None where one of them has no standard error."""
    for name in names:
        without_error = fit.parameters[name].stderr is None
        if without_error or name not in fit.covariance.names:
            return None
    rows = np.array([fit.first_order.vector({name: 1.0}) for name in names])
    return np.asarray(rows @ fit.covariance.matrix @ rows.T)
