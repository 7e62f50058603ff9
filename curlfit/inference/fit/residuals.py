"""Residuals of a fit: their size, their correlation from row to row, and outliers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.least_squares import Solution
from curlfit.inference.likelihood import SIGMA_FLOOR
from curlfit.inference.noise.losses import MAD_TO_SIGMA, robust_sigma
from curlfit.inference.noise.models import Independence, independences, lag1_of
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.output.text import two_digits
from curlfit.throws.throw import CHANNELS, Throw

CORRELATED = "the residuals are correlated from row to row"
"""First words of the warning about residuals of a fit with independent noise."""
_EARLY = 5  # rows in which a hand may still be on the stone
_FEWEST = 10  # values of a channel in which outliers are sought
_FEW = 50  # values, below which a single one pulls the fit
_BY_CHANCE = 1e-3  # fraction of throws that may have an outlier by chance
_MUCH = 1.5  # times the given sigma, above which residuals count as too large ...
_NOT_BY_CHANCE = 5.0  # ... if chi squared is this many of its own standard deviations too high
_MISSED = 4.0  # sigmas beyond which an event counts as missed; by chance one in 16,000
_SMOOTH = 0.5  # lag-1 correlation above which residuals are called smooth


class ResidualStatistics(NamedTuple):
    """Residuals of a throw at its optimum, or of many, along the first axis of each field."""

    path: Floats | None
    """in the problem's coordinates, shape (5, n); None where the record does not include it"""
    residual: Floats
    """measured - fitted, 0 where nothing was observed, shape (channels, n)"""
    number: NDArray[np.int64]
    """of values of each channel, shape (channels,)"""
    rms: Floats
    lag1: Floats
    independence: Any
    """how far the residuals over their sigma are from independent: an `Independence` per channel"""

    def each(self, throws: int) -> list[ResidualStatistics]:
        """The statistics of each throw."""
        paths = [None] * throws if self.path is None else self.path
        return list(map(ResidualStatistics, paths, *self[1:]))

    def by_channel(self, series: Any, more_than: int = 0) -> dict[str, Any]:
        """Values of one throw by name, for the channels with more than `more_than` values."""
        rows = zip(CHANNELS, series, self.number, strict=False)
        return {name: value for name, value, number in rows if number > more_than}


def residual_statistics(
    problems: Problem, solutions: Solution, paths: Floats | None
) -> ResidualStatistics:
    """Residual statistics of many throws."""
    there = problems.weight > 0
    count = there.sum(-1)
    if paths is None:
        residual = -solutions.residual / np.where(there, problems.weight, 1.0)
    else:
        residual = np.where(there, problems.observed - paths[:, : there.shape[1]], 0.0)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(count, 1))
    # Observed values first, gaps last.
    order = np.argsort(~there, -1, kind="stable")
    return ResidualStatistics(
        path=paths,
        residual=residual,
        number=count,
        rms=rms,
        lag1=lag1_of(np.take_along_axis(residual, order, -1), count),
        independence=independences(np.take_along_axis(solutions.residual, order, -1), count),
    )


def outliers_of(
    throw: Throw,
    residual: Floats,
    lag1: Mapping[str, float],
    dof: Floats,
    leverage: Floats,
    loss: str,
) -> tuple[dict[str, Any], ...]:
    """Values too far from the fit to be noise, in channels whose residuals look like noise.

    Either more than 5 + 30/(n - 6) sigmas of the bulk, a limit that Gaussian noise in three
    channels of n values exceeds in one of 1,000 throws, for n from 12 to 400 (Hampel's identifier,
    with constants simulated as by Davies and Gather 1993); or, since a value pulls a fit of few
    rows toward itself, an externally studentized residual beyond a limit of the same probability
    (Cook and Weisberg 1982, sect. 2.2).

    Parameters
    ----------
    dof : degrees of freedom of each channel's sigma.
    leverage : of each value on its own fitted value, shape (channels, n).
    """
    found = []
    for row, name in enumerate(CHANNELS[: len(residual)]):
        there = np.flatnonzero(throw.finite[row])
        if len(there) < _FEWEST or lag1.get(name, 1.0) > _SMOOTH:
            continue
        limit = 5 + 30 / (len(there) - 6)
        series = throw.sigma.get(name)
        size = np.abs(residual[row, there])
        if series is None:
            size = size / throw.sigma_over_smallest(name)[there]
        studentized = len(there) < _FEW and loss == "linear" and series is None and dof[row] > 2
        if not studentized and 2 * (size > size.max() / (limit * MAD_TO_SIGMA)).sum() > len(there):
            continue  # the median size is so large that no value is far off
        bulk = max(robust_sigma(size), SIGMA_FLOOR)
        sigma = np.full(len(throw), bulk) if series is None else np.maximum(series, bulk)
        far = size > limit * sigma[there]
        if studentized:
            from scipy.special import stdtrit  # slow to load, and few throws need it

            free = np.maximum(1 - leverage[row, there], 1e-6)
            others = np.maximum((size**2).sum() - size**2 / free, SIGMA_FLOOR**2) / (dof[row] - 1)
            chance = _BY_CHANCE / (2 * residual.shape[0] * len(there))
            far |= size > -stdtrit(dof[row] - 1, chance) * np.sqrt(free * others)
        for index, out in zip(there[far], size[far], strict=True):
            found.append(
                {
                    "channel": name,
                    "t": float(throw.t[index]),
                    "line": None if throw.lines is None else int(throw.lines[index]),
                    "off": float(residual[row, index]),
                    "sigmas": float(out / sigma[index]),
                }
            )
    return tuple(sorted(found, key=lambda item: -item["sigmas"]))


def outlier_warning(outliers: tuple[dict[str, Any], ...], t: Floats) -> str:
    """The number of outliers, the farthest, and whether they are the first of the rows at `t`."""
    first = outliers[0]
    line = f" (line {first['line']})" if first["line"] is not None else ""
    many = "one outlier" if len(outliers) == 1 else f"{len(outliers)} outliers, the farthest"
    times = sorted({item["t"] for item in outliers})
    early = len(times) <= _EARLY < len(t) and times == t[: len(times)].tolist()
    remedy = f"--since {t[len(times)]:g} leaves out the first rows, and " if early else ""
    return (
        f"{many}: {first['channel']} at t = {first['t']:g} s{line}, {two_digits(first['sigmas'])} "
        f"robust sigma off; {remedy}--loss student is robust to outliers"
    )


def given_sigma_warnings(
    throw: Throw, residual: Floats, outliers: tuple[dict[str, Any], ...]
) -> list[str]:
    """Channels whose residuals, apart from outliers, are far larger than their given sigma.

    `residual` is in units of that sigma.
    """
    excluded = {(item["channel"], item["t"]) for item in outliers}
    found = {}
    for row, name in enumerate(CHANNELS):
        if name not in throw.sigma:
            continue
        there = np.flatnonzero(throw.finite[row])
        rest = [index for index in there if (name, float(throw.t[index])) not in excluded]
        if not rest:
            continue
        square = float(np.mean(residual[row, rest] ** 2))
        by_chance = 1 + _NOT_BY_CHANCE * np.sqrt(2 / len(rest))  # chi squared per value
        if square > max(by_chance, _MUCH**2):
            found[name] = float(np.sqrt(square))
    if not found:
        return []
    listed = ", ".join(f"{times:.2g} times in {name}" for name, times in found.items())
    return [
        f"the residuals are far larger than the given sigma ({listed}): either sigma is too small, "
        "or the law or a fixed value is wrong; standard errors are too small by at least this "
        "factor"
    ]


def event_warnings(events: Sequence[Mapping[str, Any]], law: str) -> list[str]:
    """Warnings about events that a fit misses by far."""
    far = {
        item["name"]: abs(item["fitted"] - item["value"]) / item["sigma"] for item in events
    }  # fmt: skip
    listed = [f"{name} by {sigmas:.2g} sigma" for name, sigmas in far.items() if sigmas > _MISSED]
    # Two such values determine the speed and one coefficient, and cannot distinguish laws.
    along = sum(item["quantity"] in ("time", "y") for item in events)
    changing = law == "coulomb" and along > 2
    if not listed:
        return []
    return [
        f"the fit deviates from {', '.join(listed)}: the {law} law does not describe the throw, or "
        "the value was mismeasured or mistyped"
        + ("; --law power lets the friction change with the speed" if changing else "")
    ]


def correlation_warnings(statistics: ResidualStatistics, noise: str) -> list[str]:
    """Channels of a throw whose residuals are not independent, contrary to the noise model."""
    rms, count = (statistics.by_channel(series) for series in (statistics.rms, statistics.number))
    doubtful: dict[str, Independence] = {
        name: item
        for name, item in statistics.by_channel(statistics.independence, 20).items()
        if item.doubtful and rms[name] > 10 * SIGMA_FLOOR
    }
    if not doubtful:
        return []
    listed = ", ".join(f"{item.lag1:.2f} in {name}" for name, item in doubtful.items())
    if noise != "white":
        return [
            f"noise {noise} does not describe these residuals, which stay correlated from row to "
            f"row (lag-1 correlation {listed}); standard errors may be too small"
        ]
    effective = ", ".join(
        f"{item.effective:.0f} of {count[name]} in {name}" for name, item in doubtful.items()
    )
    return [
        f"{CORRELATED} (lag-1 correlation {listed}); standard errors, which assume independent "
        f"noise, are too small (effective sample size: {effective})"
    ]
