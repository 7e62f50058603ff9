"""Why a fit may mislead: its warnings, from its record."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.fit.departures import Departures, KnownCondition
from curlfit.inference.fit.entries import Outlier
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.likelihood import SIGMA_FLOOR
from curlfit.inference.noise.independence import time_of_motion
from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import CHANNELS
from curlfit.throws.throw import Throw

_EARLY = 5
"""Rows in which a hand may still be on the stone."""
_MUCH = 1.5
"""Times the given sigma, above which residuals count as too large ..."""
_NOT_BY_CHANCE = 5.0
"""... if chi squared is this many of its own standard deviations too high."""
_MISSED = 4.0
"""Sigmas beyond which an event counts as missed; by chance one in 16,000."""
_FEWEST = 20
"""Values of a channel, above which their independence is judged."""
_EXACT = 10 * SIGMA_FLOOR
"""Root mean square of residuals up to which they are rounding errors."""
_NOT_LINEAR = 10.0
"""Typical sizes, beyond which a shift is not of first order."""
_LASTING = 0.1
"""Memory over time of motion, above which errors are too small
(`tests/statistics`)."""


def warnings_of(
    fit: LeastSquaresFit,
    result: FitResult,
    residual: Floats,
    unusual: Iterable[Finding],
    rival: Mapping[str, float],
    departures: Departures,
) -> tuple[Finding, ...]:
    """The warnings of a result, the gravest first.

    Parameters
    ----------
    residual : measured - fitted, shape (channels, n).
    unusual : findings about the data and the fitted motion.
    rival : parameters that differ in another solution, with their values there.
    departures : how chi squared departs from its quadratic.
    """
    throw = fit.request.throw
    outliers = result.outliers
    warnings = [*unusual, *_of_rival(rival, throw)]
    fault = fit.model.law.from_vector(fit.solution.values).fault()
    if fault is not None:
        warnings.append(Finding.warning("no-friction-law", fault=fault))
    warnings += [
        *of_bounds(result.parameters, result.covariance.names),
        *_of_correlation(result),
        *_of_errors(result),
    ]
    if outliers and not fit.request.loss.is_robust:
        warnings.append(of_outliers(outliers, throw.t))
    if not fit.request.loss.is_robust and fit.noise.is_white:
        warnings += _of_given_sigma(throw, residual, outliers)
    ridges = of_ridges(result.parameters, departures, result.products)
    return (*warnings, *_of_memory(result), *_of_events(result), *ridges)


def _of_rival(rival: Mapping[str, float], throw: Throw) -> list[Finding]:
    """Another solution, and what would distinguish the two."""
    if not rival:
        return []
    unmeasured = []
    if "x" not in throw.seen:
        unmeasured.append("x")
    if "phi" not in throw.seen and "omega" not in throw.seen:
        unmeasured.append("the angle")
    values = [{"name": name, "value": value} for name, value in rival.items()]
    remedies = []
    if unmeasured:
        remedies.append(Remedy("distinguish", numbers={"unmeasured": unmeasured}))
    return [Finding.warning("two-solutions", *remedies, values=values)]


def of_bounds(
    estimates: Mapping[str, Estimate], open_: Collection[str]
) -> list[Finding]:
    """Parameters at a bound; those of `open_` would not leave it if they could."""
    return [
        Finding.warning(
            "open-at-bound" if name in open_ else "at-bound",
            name=name,
            lower=estimate.lower,
            upper=estimate.upper,
        )
        for name, estimate in estimates.items()
        if estimate.verdict == Verdict.AT_BOUND
    ]


def _of_correlation(result: FitResult) -> list[Finding]:
    """Channels whose residuals are not independent, contrary to the noise model."""
    channels = []
    for name, independence in result.independence.items():
        count = int(np.isfinite(result.observed[name]).sum())
        is_exact = result.rms[name] <= _EXACT
        if independence.doubtful and count > _FEWEST and not is_exact:
            channels.append(
                {
                    "channel": name,
                    "lag1": independence.lag1,
                    "effective": independence.effective,
                    "count": count,
                }
            )
    if not channels:
        return []
    if not result.noise.is_white:
        noise = result.noise.kind
        return [Finding.warning("noise-not-described", lag1=channels, noise=noise)]
    return [Finding.warning("correlated", lag1=channels, effective=channels)]


def _of_errors(result: FitResult) -> list[Finding]:
    """Systematic errors that first order does not describe."""
    errors = result.systematics.errors
    names = [
        name
        for name, estimate in result.parameters.items()
        if errors.get(name, 0.0) > _NOT_LINEAR * estimate.typical
    ]
    if not names:
        return []
    return [Finding.warning("systematic-too-large", names=names, count=len(names))]


def of_ridges(
    estimates: Mapping[str, Estimate],
    departures: Departures,
    products: Iterable[Derived] = (),
) -> list[Finding]:
    """Parameters that are not determined since the values that fit lie on a curve, and
    their products that are."""
    open_ = [
        {"name": name, "low": float(low), "high": float(high)}
        for name, (low, high) in departures.intervals.items()
        if estimates[name].verdict.is_left_open
    ]
    if not open_:
        return []
    determined = [
        {
            "expression": product.expression,
            "value": [product.value, product.stderr],
            "meaning": product.meaning,
        }
        for product in products
    ]
    remedies = []
    if departures.remedy is not None:
        remedies.append(_known_condition(departures.remedy))
    return [Finding.warning("curve", *remedies, open=open_, products=determined)]


def _known_condition(condition: KnownCondition) -> Remedy:
    """What would be determined if a parameter were known."""
    determined = [
        {"name": name, "stderr": stderr} for name, stderr in condition.stderr.items()
    ]
    return Remedy(
        "known-condition",
        numbers={
            "parameter": condition.parameter,
            "near": condition.near,
            "known_to": condition.known_to,
            "unit": "" if condition.unit == "1" else f" {condition.unit}",
            "determined": determined,
        },
    )


def of_outliers(outliers: Sequence[Outlier], t: Floats) -> Finding:
    """The number of outliers, the farthest, and whether they are the first of the
    rows at `t`."""
    farthest = outliers[0]
    times = sorted({outlier.t for outlier in outliers})
    count = len(times)
    remedies = []
    if count <= _EARLY < len(t) and times == t[:count].tolist():
        since = Option("since", f"{t[count]:g}")
        remedies.append(Remedy("without-first-rows", since))
    remedies.append(Remedy("robust-loss", Option("loss", "student")))
    return Finding.warning(
        "outliers",
        *remedies,
        count=len(outliers),
        channel=farthest.channel,
        t=farthest.t,
        line=farthest.line,
        sigmas=farthest.sigmas,
    )


def _of_given_sigma(
    throw: Throw, residual: Floats, outliers: Sequence[Outlier]
) -> list[Finding]:
    """Channels whose residuals, apart from outliers, are far larger than their
    given sigma."""
    too_large = []
    for row, channel in enumerate(CHANNELS[: len(residual)]):
        if channel not in throw.sigma:
            continue
        excluded = [outlier.t for outlier in outliers if outlier.channel == channel]
        rows = throw.finite[row] & ~np.isin(throw.t, excluded)
        if not rows.any():
            continue
        over_sigma = residual[row, rows] / throw.sigma[channel][rows]
        per_value = float(np.mean(over_sigma**2))  # chi squared, about 1
        by_chance = 1 + _NOT_BY_CHANCE * np.sqrt(2 / rows.sum())
        if per_value > max(by_chance, _MUCH**2):
            too_large.append({"channel": channel, "times": float(np.sqrt(per_value))})
    if not too_large:
        return []
    return [Finding.warning("sigma-too-small", channels=too_large)]


def _of_memory(result: FitResult) -> list[Finding]:
    """Noise whose correlation time is too long for the throw."""
    memory = max(result.noise.memory.values(), default=0.0)
    if not memory:
        return []
    span = time_of_motion(result.observed["t"], result.fitted["speed"])
    if memory <= _LASTING * span:
        return []
    return [Finding.warning("long-memory", memory=memory, span=span)]


def _of_events(result: FitResult) -> list[Finding]:
    """Events that the fit misses by far."""
    missed = []
    for event in result.events:
        sigmas = abs(event.fitted - event.value) / event.sigma
        if sigmas > _MISSED:
            missed.append({"name": event.name, "sigmas": sigmas})
    if not missed:
        return []
    # Two values along the sheet determine the speed and one coefficient, and cannot
    # distinguish laws.
    along = [
        event for event in result.events if event.quantity in ("time", "y", "speed")
    ]
    remedies = []
    if result.law == "coulomb" and len(along) > 2:
        remedies.append(Remedy("power-law", Option("law", "power")))
    return [Finding.warning("events-missed", *remedies, events=missed, law=result.law)]
