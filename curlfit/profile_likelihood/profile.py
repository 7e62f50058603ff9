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

import numpy as np
from scipy.interpolate import PchipInterpolator

from curlfit.errors import InputError, Option, UnusableFitError
from curlfit.findings import Finding, Remedy
from curlfit.inference.fit.estimates import Estimate
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
_REPETITIONS = 3  # of a profile, about a better fit that it met
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
# delta chi squared below a threshold, outside the interval, of a second minimum
_SECOND_MINIMUM = 0.1
_BINS = 24
_TAIL = 0.0005  # part of a posterior sample beyond either end of its histogram


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
    # A fit with parameters fixed may lead to a better one without; the profile is then
    # made again about it.
    for _ in range(_REPETITIONS):
        profiles = [
            _profile_one(refit, name, points, ranges.get(name), chain)
            for name in selected
        ]
        result: Profile | PairProfile = profiles[0]
        if len(profiles) == 2:
            result = _profile_pair(
                refit, profiles[0], profiles[1], points, ranges, chain
            )
        if not refit.adopt_better_fit():
            break
    return result


def _profile_one(
    refit: Refit,
    name: str,
    points: int,
    chosen_range: tuple[float, float] | None,
    chain: Chain | None,
) -> Profile:
    """The profile of one parameter, over a chosen range or that of `_search_range`."""
    fit = refit.fit
    estimate = fit.parameters[name]
    fits = ConstrainedFits(refit, [name])
    best = float(fits.best[0])
    low, high = chosen_range or _search_range(fits, estimate)
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
    rise = float(np.nanmax(np.maximum(delta[inside], 0.0)))
    intervals = tuple(
        _interval(line, delta, best, free, estimate, level.name, level.delta_chi2)
        for level in fits.levels
    )
    verdict = _verdict(rise, free, intervals[0])
    # A chosen range that ends where neither a bound nor another parameter stops it may
    # be too narrow.
    lower, upper = fits.bounds
    cut_below = free[0] == low != lower
    cut_above = free[1] == high != upper
    if (
        chosen_range is not None
        and (cut_below or cut_above)
        and rise < fits.levels[-1].delta_chi2
        and estimate.verdict != Verdict.NOT_IDENTIFIABLE
    ):
        verdict = ProfileVerdict.NARROW
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
        intervals=intervals,
        free=free,
        stops=stops,
        rise=rise,
        verdict=verdict,
        combinations=tuple(
            combination
            for combination in fit.combinations
            if name in combination.weights
        ),
        posterior=None if chain is None else _marginal(fit, chain, name, line, delta),
        quantiles={} if posterior is None else posterior.quantiles.get(name, {}),
        warnings=fit.warnings,
    )
    unfinished = sum(optimum is not None and not optimum.finished for optimum in optima)
    warnings = _warnings(refit, profile, unfinished, optima.count(None))
    return replace(profile, warnings=(*profile.warnings, *warnings))


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


def _verdict(
    rise: float, free: tuple[float, float], interval: Interval
) -> ProfileVerdict:
    """What a profile says of its parameter over a range that is wide enough, by its
    rise within the free part and by the 68 % interval."""
    low, high = free
    mostly_free = high - low > _LARGE_PART * (interval.high - interval.low)
    if not mostly_free or rise >= _HARDLY:
        return ProfileVerdict.LIMITED
    if rise < _FLAT:
        return ProfileVerdict.FLAT
    return ProfileVerdict.HARDLY


def _search_range(fits: ConstrainedFits, estimate: Estimate) -> tuple[float, float]:
    """Default range of a parameter: some standard errors where it has one, else as
    far as chi squared is low."""
    best = float(fits.best[0])
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
    high = _HIGH * fits.levels[-1].delta_chi2_pair
    last_low = best  # the farthest value known at which chi squared is low
    while True:
        if last_low == farthest:
            return farthest
        first_high = farthest
        if step < abs(farthest - best):
            first_high = best + math.copysign(step, farthest - best)
        if not fits.delta(np.array([[first_high]]))[0] < high:  # high, or without path
            break
        last_low = first_high
        step = 2 * step
    while sharp and abs(first_high - last_low) > _SHARP * abs(first_high - best):
        line = np.linspace(last_low, first_high, _SECTION + 1)
        is_low = fits.delta(line[1:, None]) < high
        first = int(np.argmin(is_low))
        last_low = float(line[first])
        first_high = float(line[first + 1])
    has_path = np.isfinite(fits.delta(np.array([[first_high]]))).all()
    return first_high if has_path else last_low


def _refinement(
    line: Floats, delta: Floats, best: float, levels: tuple[Level, ...]
) -> Floats:
    """Points to add where the profile crosses a threshold too steeply to
    be interpolated."""
    # near a minimum the root of delta chi squared is nearly linear
    root = np.sqrt(np.maximum(delta, 0.0))
    low = np.minimum(root[:-1], root[1:])
    high = np.maximum(root[:-1], root[1:])
    thresholds = np.array(
        [[level.delta_chi2, level.delta_chi2_pair] for level in levels]
    ).reshape(-1, 1)  # for each of them all intervals
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
    stuck[:, fits.fixed] = False
    stuck &= ~stuck.all(0)  # one that is at a bound everywhere stops nothing
    ends: list[float] = []
    stops: list[tuple[str, ...]] = []
    best = fits.best[0]
    below = np.flatnonzero(line <= best)[::-1]
    above = np.flatnonzero(line >= best)
    for outward in (below, above):  # rows from the best value to an end of the line
        stopped = np.flatnonzero(stuck[outward[1:]].any(1))
        last_free = outward[stopped[0]] if len(stopped) else outward[-1]
        ends.append(float(line[last_free]))
        names: list[str] = []
        if len(stopped):
            first_stuck = outward[stopped[0] + 1]
            names = parameters.names_where(stuck[first_stuck])
        stops.append(tuple(names))
    return (ends[0], ends[1]), (stops[0], stops[1])


def _interval(
    line: Floats,
    delta: Floats,
    best: float,
    free: tuple[float, float],
    estimate: Estimate,
    level: LevelName,
    threshold: float,
) -> Interval:
    """Interval between the crossings of a threshold by delta chi squared along a line,
    on either side of the best value; within the free part the data limit it."""
    finite = np.isfinite(delta)
    line = line[finite]
    # The root with the sign of the side is nearly linear except at bounds, where the
    # interpolation must not overshoot.
    root = PchipInterpolator(
        line, np.sign(line - best) * np.sqrt(np.maximum(delta[finite], 0.0))
    )

    def end_of(side: int, free_end: float, bound: float) -> tuple[float, Limit]:
        """End below (-1) or above (1) the best value, and what limits it."""
        crossings = side * root.solve(side * math.sqrt(threshold), extrapolate=False)
        if crossings.size:
            end = float(side * crossings.min())
            return end, "data" if side * (end - free_end) <= 0 else "others"
        end = float(line[0 if side < 0 else -1])
        return end, "bound" if math.isclose(end, bound, rel_tol=1e-12) else "range"

    low, low_by = end_of(-1, free[0], estimate.lower)
    high, high_by = end_of(1, free[1], estimate.upper)
    return Interval(level, low, high, low_by, high_by)


def _warnings(
    refit: Refit, profile: Profile, unfinished: int, failed: int
) -> Iterator[Finding]:
    """Warnings about the fits, of which some did not converge or have no path."""
    decrease = refit.chi_squared_of_fit - refit.best.chi_squared
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
    outside &= profile.delta < profile.levels[-1].delta_chi2 - _SECOND_MINIMUM
    if outside.any():
        lowest = profile.at[outside][np.argmin(profile.delta[outside])]
        yield Finding.warning("second-minimum", at=float(lowest))


def _marginal(
    fit: FitResult, chain: Chain, name: str, at: Floats, delta: Floats
) -> PosteriorDensity | None:
    """-2 log of the marginal posterior density, shifted onto the profile."""
    samples = chain.of({name: 1.0})
    low, high = np.quantile(samples, [_TAIL, 1 - _TAIL])
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
    threshold = fits.levels[-1].delta_chi2_pair
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
        extent={
            level.name: (_extent(first, level), _extent(second, level))
            for level in fits.levels
        },
        covariance=covariance,
        ellipse=_off_ellipse(off_best, delta, covariance, threshold),
        samples=samples,
        warnings=first.warnings,
    )


def _extent(profile: Profile, level: Level) -> Interval:
    """What the region of two parameters spans of one, by its profile alone: where this
    crosses the threshold of two."""
    return _interval(
        profile.at,
        profile.delta,
        profile.best,
        profile.free,
        profile.estimate,
        level.name,
        level.delta_chi2_pair,
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
    return fit.covariance.among(names)
