"""Why a fit may mislead: its warnings, from its record."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from curlfit.inference.derived import Derived
from curlfit.inference.fit.departures import Departures
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.prepared import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import SIGMA_FLOOR
from curlfit.inference.noise.models import time_of_motion
from curlfit.inference.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.output.text import compact, join_words, two_digits
from curlfit.throws.plausibility import Finding
from curlfit.throws.throw import CHANNELS, Throw

CORRELATED = "the residuals are correlated from row to row"
"""First words of the warning about residuals of a fit with independent noise."""
_EARLY = 5  # rows in which a hand may still be on the stone
_MUCH = 1.5  # times the given sigma, above which residuals count as too large ...
# ... if chi squared is this many of its own standard deviations too high
_NOT_BY_CHANCE = 5.0
_MISSED = 4.0  # sigmas beyond which an event counts as missed; by chance one in 16,000
_FEWEST = 20  # values of a channel, above which their independence is judged
_NOT_LINEAR = 10.0  # typical sizes, beyond which a shift is not of first order
# memory over time of motion, above which errors are too small (`tests/statistics`)
_LASTING = 0.1


def warnings_of(
    fit: LeastSquaresFit,
    result: FitResult,
    residual: Floats,
    unusual: Iterable[Finding],
    rival: Mapping[str, float],
    departures: Departures,
) -> tuple[str, ...]:
    """The warnings of a result, the gravest first.

    Parameters
    ----------
    residual : measured - fitted, shape (channels, n).
    unusual : findings about the data and the fitted motion.
    rival : parameters that differ in another solution, with their values there.
    departures : how chi squared departs from its quadratic.
    """
    throw, outliers = fit.prepared.throw, result.outliers
    warnings = [*map(str, unusual), *_of_rival(rival, throw)]
    fault = fit.model.law.from_vector(fit.solution.values).fault()
    if fault is not None:
        warnings.append(
            f"{fault}; the fitted coefficients are not those of a friction law"
        )
    warnings += [
        *of_bounds(result.parameters, result.covariance["names"]),
        *_of_correlation(result),
        *_of_errors(result),
    ]
    if outliers and not fit.loss.is_robust:
        warnings.append(outlier_warning(outliers, throw.t))
    if not fit.loss.is_robust and fit.noise.is_white:
        warnings += _of_given_sigma(throw, residual, outliers)
    ridges = of_ridges(result.parameters, departures, result.products)
    return (*warnings, *_of_memory(result), *_of_events(result), *ridges)


def _of_rival(rival: Mapping[str, float], throw: Throw) -> list[str]:
    if not rival:
        return []
    listed = ", ".join(f"{name} = {value:.3g}" for name, value in rival.items())
    unmeasured = [
        said
        for said, channels in (("x", {"x"}), ("the angle", {"phi", "omega"}))
        if not channels & set(throw.seen)
    ]
    remedy = (
        f"; measure {' or '.join(unmeasured)} to distinguish them" if unmeasured else ""
    )
    return [
        f"other values fit as well: {listed}; the estimates are one of two "
        f"solutions, and standard errors include how far they are{remedy}"
    ]


def of_bounds(estimates: Mapping[str, Estimate], open_: Collection[str]) -> list[str]:
    """Parameters at a bound; those of `open_` would not leave it if they could."""
    warnings = []
    for name, item in estimates.items():
        if item.verdict == Verdict.AT_BOUND:
            within = f"{item.lower:g}..{item.upper:g}"
            what = f"favour values outside {within}"
            if name in open_:
                what = f"hardly distinguish this value from others within {within}"
            warnings.append(f"{name} is at its bound; the data {what}")
    return warnings


def _of_correlation(result: FitResult) -> list[str]:
    """Channels whose residuals are not independent, contrary to the noise model."""
    count = {name: int(np.isfinite(result.observed[name]).sum()) for name in result.rms}
    doubtful = {
        name: item
        for name, item in result.independence.items()
        if item.doubtful
        and count[name] > _FEWEST
        and result.rms[name] > 10 * SIGMA_FLOOR
    }
    if not doubtful:
        return []
    listed = ", ".join(f"{item.lag1:.2f} in {name}" for name, item in doubtful.items())
    if not result.noise.is_white:
        return [
            f"noise {result.noise.kind} does not describe these residuals, "
            f"which stay correlated from row to row (lag-1 correlation {listed}); "
            "standard errors may be too small"
        ]
    effective = ", ".join(
        f"{item.effective:.0f} of {count[name]} in {name}"
        for name, item in doubtful.items()
    )
    return [
        f"{CORRELATED} (lag-1 correlation {listed}); standard errors, which assume "
        f"independent noise, are too small (effective sample size: {effective})"
    ]


def _of_errors(result: FitResult) -> list[str]:
    """Systematic errors that first order does not describe."""
    warnings = []
    errors = result.systematics.errors
    beyond = [
        name
        for name, item in result.parameters.items()
        if errors.get(name, 0.0) > _NOT_LINEAR * item.typical
    ]
    if beyond:
        warnings.append(
            f"systematic errors of {', '.join(beyond)} exceed the range in which "
            "they can be estimated: with the conditions as uncertain as assumed, "
            f"the path does not determine {'it' if len(beyond) == 1 else 'them'}"
        )
    return warnings


def of_ridges(
    estimates: Mapping[str, Estimate],
    departures: Departures,
    products: Iterable[Derived] = (),
) -> list[str]:
    """Parameters that are not determined since the values that fit lie on a curve, and
    their products that are."""
    open_ = [
        f"{name} from {low:.3g} to {high:.3g}"
        for name, (low, high) in departures.intervals.items()
        if estimates[name].verdict.is_open
    ]
    if not open_:
        return []
    words = f"the values that fit lie on a curve: {', '.join(open_)}"
    for product in products:
        value = compact(product.value, product.stderr)
        words += f"; {product.expression} = {value} is determined: {product.meaning}"
    remedy = departures.remedy
    if remedy is not None:
        known = join_words(
            [f"{name} to {two_digits(size)}" for name, size in remedy.stderr.items()]
        )
        unit = "" if remedy.unit == "1" else f" {remedy.unit}"
        value = f"{remedy.near:.2g} +- {remedy.known_to:g}{unit}"
        words += f"; {remedy.parameter} = {value} would determine {known}"
    return [words]


def outlier_warning(outliers: Sequence[Mapping[str, Any]], t: Floats) -> str:
    """The number of outliers, the farthest, and whether they are the first of the
    rows at `t`."""
    first = outliers[0]
    line = f" (line {first['line']})" if first["line"] is not None else ""
    many = (
        "one outlier"
        if len(outliers) == 1
        else f"{len(outliers)} outliers, the farthest"
    )
    times = sorted({item["t"] for item in outliers})
    early = len(times) <= _EARLY < len(t) and times == t[: len(times)].tolist()
    remedy = (
        f"--since {t[len(times)]:g} leaves out the first rows, and " if early else ""
    )
    return (
        f"{many}: {first['channel']} at t = {first['t']:g} s{line}, "
        f"{two_digits(first['sigmas'])} robust sigma off; {remedy}--loss student is "
        "robust to outliers"
    )


def _of_given_sigma(
    throw: Throw, residual: Floats, outliers: Sequence[Mapping[str, Any]]
) -> list[str]:
    """Channels whose residuals, apart from outliers, are far larger than their
    given sigma."""
    excluded, found = {(item["channel"], item["t"]) for item in outliers}, {}
    for row, name in enumerate(CHANNELS[: len(residual)]):
        if name not in throw.sigma:
            continue
        kept = throw.finite[row] & [
            (name, time) not in excluded for time in throw.t.tolist()
        ]
        if not kept.any():
            continue
        square = float(np.mean((residual[row, kept] / throw.sigma[name][kept]) ** 2))
        # chi squared per value
        by_chance = 1 + _NOT_BY_CHANCE * np.sqrt(2 / kept.sum())
        if square > max(by_chance, _MUCH**2):
            found[name] = float(np.sqrt(square))
    if not found:
        return []
    listed = ", ".join(f"{times:.2g} times in {name}" for name, times in found.items())
    return [
        f"the residuals are far larger than the given sigma ({listed}): "
        "either sigma is too small, or the law or a fixed value is wrong; "
        "standard errors are too small by at least this factor"
    ]


def _of_memory(result: FitResult) -> list[str]:
    """Noise whose correlation time is too long for the throw."""
    memory = max(result.noise.memory.values(), default=0.0)
    span = (
        time_of_motion(result.observed["t"], result.fitted["speed"]) if memory else 0.0
    )
    if memory <= _LASTING * span:
        return []
    return [
        f"the noise has a correlation time of {memory:.2g} s in a throw of "
        f"{span:.3g} s, too long to be estimated well: its standard errors may be too "
        "small by a quarter"
    ]


def _of_events(result: FitResult) -> list[str]:
    """Events that the fit misses by far."""
    events = result.events
    far = {
        item["name"]: abs(item["fitted"] - item["value"]) / item["sigma"]
        for item in events
    }
    listed = [
        f"{name} by {sigmas:.2g} sigma"
        for name, sigmas in far.items()
        if sigmas > _MISSED
    ]
    if not listed:
        return []
    # Two such values determine the speed and one coefficient, and cannot
    # distinguish laws.
    along = sum(item["quantity"] in ("time", "y", "speed") for item in events)
    changing = "; --law power lets the friction change with the speed"
    return [
        f"the fit deviates from {', '.join(listed)}: the {result.law} law does not "
        "describe the throw, or the value was mismeasured or mistyped"
        + (changing if result.law == "coulomb" and along > 2 else "")
    ]
