"""Profile likelihood: the minimum of chi squared at fixed values of one parameter or two.

At each value all other parameters are fitted again, with the sigma of the fit. The increase of chi
squared and the thresholds of Wilks (1938) give intervals that are valid where chi squared is not
quadratic; the profile of a parameter that the data do not determine is flat.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from curlfit.errors import InputError, UnusableFitError
from curlfit.inference.fit.fit import fit as least_squares
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.mcmc.chain import Chain
from curlfit.numerics.arrays import Floats
from curlfit.profile_likelihood.refit import ConstrainedFits, Point, Progress, Refit
from curlfit.profile_likelihood.result import Interval, PairProfile, Profile, require_usable
from curlfit.profile_likelihood.single import HIGH, REACH, ROUNDS, interval_at, profile_one
from curlfit.throws.throw import Throw

POINTS = 41
POINTS_OF_PAIR = 25
_NO_RESPONSE = 1e-3  # change of the residuals by a typical size that counts as none
_MIN_STEP, _WIDEST = 0.05, 30.0  # smallest step and largest width, over that at the best fit
_WIDENING = 1.6  # factor
_MAX_SAMPLES = 1500


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
    require_usable(
        fit.parameter_set,
        selected,
        points,
        ranges or {},
        fit.parameter_set.values_of(fit.values),
    )
    count = (POINTS, POINTS_OF_PAIR)[len(selected) - 1] if points is None else points
    if not fit.converged:
        raise UnusableFitError(f"the fit is not usable: {fit.status}")
    if chain is not None and chain.names != fit.parameter_set.names:
        raise InputError("the chain is of another fit: its parameters differ")
    refit = Refit(fit, progress)
    for _ in range(3):
        found = [
            profile_one(refit, name, count, (ranges or {}).get(name), chain) for name in selected
        ]
        pair = (
            None
            if len(found) == 1
            else _profile_pair(refit, found[0], found[1], count, ranges, chain)
        )
        if not refit.improved():
            break
    return found[0] if pair is None else pair


def _profile_pair(
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
    fits = ConstrainedFits(refit, names)
    stiff = float(refit.response(names)[1][1])
    typical = fit.parameters[other.name].typical
    across = 1 / stiff if stiff * typical > _NO_RESPONSE else None
    bounds = refit.parameters.lower[index[1]], refit.parameters.upper[index[1]]
    edges = (
        []
        if across is None
        else [
            bound + sense * REACH * across + offset[1]
            for bound, sense in zip(bounds, (1, -1), strict=True)
        ]
    )
    first = _columns(one, other.name, edges, points) - offset[0]
    if across is None or other.name in (ranges or {}):
        ends = other.at[0] - offset[1], other.at[-1] - offset[1]
        second = np.tile(np.linspace(*ends, points), (len(first), 1))
    else:
        finite = np.isfinite(one.delta)
        values = one.others[other.name][finite]
        valley = np.interp(first + offset[0], one.at[finite], values) - offset[1]
        second = _across_valley(fits, first, valley, across, bounds, points)
    second = np.clip(second, *bounds)
    grid = np.stack([np.broadcast_to(first[:, None], second.shape), second], -1)
    fits.reach(grid.reshape(-1, 2))
    fits.settle(_neighbours(grid))
    delta = np.array([fits.delta(point) for point in grid.reshape(-1, 2)]).reshape(second.shape)
    covariance = _covariance(fit, names)
    ellipse = None
    if covariance is not None:
        best = np.array([one.best, other.best]) - offset
        away = grid - best
        expected = np.einsum("ijk,kl,ijl->ij", away, np.linalg.inv(covariance), away)
        within = (expected <= fits.levels[-1].delta_chi2_pair) & np.isfinite(delta)
        if within.any():
            ellipse = float(np.abs(delta - expected)[within].max())
    extent = {
        level.name: (
            _extent(one, level.delta_chi2_pair, level.name),
            _extent(other, level.delta_chi2_pair, level.name),
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
    bottom = np.stack([first, valley], -1)
    steps = np.linspace(-REACH, REACH, points | 1)
    wide = np.full((len(first), 2), across)
    sides = [np.clip(valley + sense * across, *bounds) for sense in (-1, 1)]
    fits.reach(np.concatenate([bottom, *(np.stack([first, side], -1) for side in sides)]))
    for column, side in enumerate(sides):
        for row, value in enumerate(side):
            away = abs(value - valley[row]) / across
            rise = fits.delta([first[row], value]) - fits.delta([first[row], valley[row]])
            if away > _MIN_STEP and math.isfinite(rise):
                wide[row, column] *= away / math.sqrt(max(rise, (away / _WIDEST) ** 2))
    for _ in range(ROUNDS):  # wider where chi squared is not quadratic
        ends = np.clip(valley[:, None] + REACH * np.array([-1, 1]) * wide, *bounds)
        fits.reach(np.stack([np.broadcast_to(first[:, None], ends.shape), ends], -1).reshape(-1, 2))
        above = np.array(
            [[fits.delta([a, b]) for b in row] for a, row in zip(first, ends, strict=True)]
        )
        inside = (ends > bounds[0]) & (ends < bounds[1])
        low = inside & (above < HIGH * fits.levels[-1].delta_chi2_pair)
        if not low.any():
            break
        wide[low] *= _WIDENING
    return np.asarray(valley[:, None] + steps * np.where(steps < 0, wide[:, :1], wide[:, 1:]))


def _neighbours(grid: Floats) -> list[tuple[Point, Point]]:
    """Pairs of neighbouring points of a grid, along rows and columns."""
    points = [[(float(a), float(b)) for a, b in row] for row in grid]
    pairs = [pair for row in points for pair in pairwise(row)]
    pairs += [pair for column in zip(*points, strict=True) for pair in pairwise(column)]
    return [(one, other) for one, other in pairs if one != other]


def _extent(profile: Profile, threshold: float, level: str) -> Interval:
    """Extent of a region in a parameter: crossings of its threshold by that profile alone."""
    item = profile.estimate
    bounds = item.lower, item.upper
    return interval_at(
        profile.at, profile.delta, profile.best, threshold, level, profile.free, bounds
    )


def _covariance(fit: FitResult, names: Sequence[str]) -> Floats | None:
    known = list(fit.covariance["names"])
    if any(fit.parameters[name].stderr is None or name not in known for name in names):
        return None
    index = [known.index(name) for name in names]
    found: Floats = np.array(fit.covariance["matrix"])[np.ix_(index, index)]
    return found
