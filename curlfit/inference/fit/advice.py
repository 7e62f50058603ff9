"""Advice: a measured curl that a law leaves to the heading; the noise model that
describes correlated residuals, of which those recommended have been tried; and further
measurements that would determine the parameters that a throw does not determine.

For the last, channels that were not measured are added hypothetically at the same
times, with the noise of an ordinary tracker and gyroscope. If one of them, or all
together, would determine a parameter, that is the remedy; if not, no measurement along
this path would, and another throw or another stone is needed (`curlfit design`). All
channels are weighted by their sigma alone, as for white noise. The correlation of noise
that was not measured is unknown; under other noise models only those parameters are
named that no channel determines under any noise (null directions).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.friction import check_load
from curlfit.friction.curl import can_curl
from curlfit.inference.fit.entries import FurtherMeasurement
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.identifiability import Identifiability
from curlfit.inference.information.information import Information
from curlfit.inference.information.thresholds import WEAK_ERROR
from curlfit.inference.model.likelihood import predict_channels
from curlfit.inference.noise.independence import is_rough
from curlfit.inference.solve.least_squares import Indices
from curlfit.noises import NOISES, Noise
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.throws.channels import CHANNELS
from curlfit.throws.motion import SURE, motion_of

_CLEAR = 0.2
"""m; a smaller curl of a path may be that of the ice."""
_FARTHER = 2.0
"""Rms residual of the law over that with independent noise, up to which it is as
near."""
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01, "speed": 0.02, "omega": 0.02}
"""Of a hypothetical channel: m, m, rad, m/s, rad/s."""
_STEP = 1e-4
"""Of a typical size, of differences: the path is accurate to 1e-8 of it."""


def curl_warnings(fits: Sequence[FitResult]) -> list[Finding]:
    """A warning if throws fitted with one law were measured to curl, and
    the law cannot.

    A slope of the ice among the parameters may cause the curl instead.
    """
    first = fits[0]
    load = check_load(first.load)
    # mypy takes a class for one of its instances, which compare by value and
    # have no hash.
    law_curls = can_curl(first.law_class, load, first.stone)  # type: ignore[arg-type]
    if law_curls or first.model.has_slope:
        return []
    curls = [curl for curl in map(measured_curl, fits) if curl is not None]
    if not curls:
        return []
    in_heading = first.parameters["heading"].verdict.is_free
    where = ["in the heading"] if in_heading else []
    if first.rms or not in_heading:
        where.append("in the residuals")
    finding = Finding.warning(
        "law-cannot-curl",
        Remedy("law-that-curls", Option("law", "front-back")),
        law=first.law,
        where=where,
        count=len(fits),
        measured=len(curls),
        curl=abs(curls[0]),
        side="right" if curls[0] > 0 else "left",
    )
    return [finding]


def with_curl_warning(fit: FitResult) -> FitResult:
    """The fit of a single throw, with the warning of `curl_warnings`, if any."""
    warnings = curl_warnings([fit])
    return replace(fit, warnings=(*fit.warnings, *warnings)) if warnings else fit


def measured_curl(fit: FitResult) -> float | None:
    """Curl in m to the right as measured, by an event or by the path; None if it
    is not clear."""
    across = [event for event in fit.events if event.quantity == "x"]
    if across:
        farthest = max(across, key=lambda event: abs(event.value))
        is_clear = abs(farthest.value) > SURE * farthest.sigma
        return farthest.value if is_clear else None
    if not {"x", "y"} <= fit.rms.keys():
        return None
    motion = motion_of(fit.throw)
    if motion is None or abs(motion.curl) - SURE * motion.curl_error < _CLEAR:
        return None
    return -motion.curl


def with_noise_advice(
    result: FitResult, refit: Callable[[FitResult, Noise], FitResult]
) -> FitResult:
    """A fit with independent noise whose warning about correlated residuals
    says what helps."""
    if not any(warning.code == "correlated" for warning in result.warnings):
        return result
    advice = _noise_remedy(result, refit)
    warnings = tuple(
        warning.with_remedies(advice) if warning.code == "correlated" else warning
        for warning in result.warnings
    )
    return replace(result, warnings=warnings)


def _noise_remedy(
    result: FitResult, refit: Callable[[FitResult, Noise], FitResult]
) -> Remedy:
    """Which noise model describes correlated residuals, if any."""
    residuals = [
        result.observed[channel] - result.fitted[channel]
        for channel, independence in result.independence.items()
        if independence.doubtful
    ]
    if not any(is_rough(residual[np.isfinite(residual)]) for residual in residuals):
        return Remedy("no-noise-so-smooth")
    for noise in NOISES.values():
        if noise.is_white:
            continue
        correlated = refit(result, noise)
        if _describes(correlated, result):
            option = Option("noise", noise.kind)
            factors = _error_factors(correlated, result)
            code = "noise-with-errors" if factors else "noise"
            return Remedy(code, option, {"factors": factors})
    return Remedy("no-noise")


def _describes(correlated: FitResult, white: FitResult) -> bool:
    """Whether a noise model makes residuals independent and leaves the law as near
    to the data."""
    is_near = all(
        correlated.rms[channel] <= _FARTHER * rms for channel, rms in white.rms.items()
    )
    is_doubtful = any(
        independence.doubtful for independence in correlated.independence.values()
    )
    return correlated.converged and is_near and not is_doubtful


def _error_factors(correlated: FitResult, white: FitResult) -> list[dict[str, Any]]:
    """How many times as large the standard errors of coefficients and combinations are
    with correlated noise."""
    combinations = [combination.expression for combination in white.combinations]
    factors = []
    for name in (*white.coefficients, *combinations):
        if name not in correlated:
            continue
        before = white[name].stderr
        after = correlated[name].stderr
        if before and after:
            factors.append({"name": name, "factor": after / before})
    return factors


def remedies(
    fit: LeastSquaresFit, open_: Sequence[str], held: Collection[str]
) -> tuple[FurtherMeasurement, ...]:
    """What would determine some parameters.

    Parameters
    ----------
    open_ : parameters that the data do not determine.
    held : parameters that stay fixed whatever is measured.

    Returns
    -------
    Parameters with the same remedy are grouped.
    """
    measurements = _Measurements.of(fit, held)
    if not fit.noise.is_white:
        never_seen = measurements.never_seen()
        names = tuple(name for name in open_ if name in never_seen)
        return (FurtherMeasurement(names, (), all=False),) if names else ()
    missing = measurements.missing
    by_channel = {channel: measurements.determined([channel]) for channel in missing}
    by_all = measurements.determined(missing) if len(missing) > 1 else set()
    names_by_remedy: dict[FurtherMeasurement, list[str]] = {}
    for name in open_:
        channels = [channel for channel in missing if name in by_channel[channel]]
        all_needed = not channels and name in by_all
        if all_needed:
            channels = measurements.needed_for(name)
        remedy = FurtherMeasurement((), tuple(channels), all_needed)
        names_by_remedy.setdefault(remedy, []).append(name)
    return tuple(
        replace(remedy, parameters=tuple(names))
        for remedy, names in names_by_remedy.items()
    )


class _Measurements(NamedTuple):
    """The channels of a fitted throw to first order, those that were measured and
    those that might be."""

    names: list[str]
    """of the parameters that are not held, whose values and typical sizes follow"""
    values: Floats
    typical: Floats
    jacobian: Floats
    """derivatives of the path, shape (channels, rows, parameters)"""
    weight: Floats
    """1/sigma, 0 where nothing was measured, shape (channels, rows)"""

    @classmethod
    def of(cls, fit: LeastSquaresFit, held: Collection[str]) -> Self:
        parameters = fit.request.parameters
        free = np.flatnonzero([name not in held for name in parameters.names])
        jacobian = _slopes_of_all_channels(fit, free)
        channels, rows, _ = jacobian.shape
        weight = np.zeros((channels, rows))
        weight[: len(fit.problem.weight)] = fit.problem.weight[:, :rows]
        return cls(
            [parameters.names[index] for index in free],
            fit.solution.values[free],
            parameters.typical[free],
            jacobian,
            weight,
        )

    @property
    def missing(self) -> list[str]:
        """Channels that were not measured."""
        return [
            channel
            for channel, weight in zip(CHANNELS, self.weight, strict=False)
            if not weight.any()
        ]

    def with_channels(self, channels: Sequence[str]) -> Identifiability:
        """What the throw would determine with these channels besides."""
        weight = self.weight.copy()
        for channel in channels:
            weight[CHANNELS.index(channel)] = 1 / NOISE[channel]
        slopes_of_residuals = weight[..., None] * self.jacobian
        matrix = slopes_of_residuals.reshape(-1, len(self.names))
        information = Information.of(
            self.names,
            Bounded.none(self.values),
            self.typical,
            matrix,
            np.zeros(len(matrix)),
        )
        return Identifiability.of(information)

    def determined(self, channels: Sequence[str]) -> set[str]:
        """Parameters that would be determined with these channels besides."""
        identifiability = self.with_channels(channels)
        stderr = np.sqrt(np.diag(identifiability.covariance))
        sharp = (stderr < WEAK_ERROR * self.typical) & ~identifiability.unseen
        return set(compress(self.names, sharp))

    def never_seen(self) -> set[str]:
        """Parameters of which not even all channels would tell anything."""
        return set(compress(self.names, self.with_channels(self.missing).unseen))

    def needed_for(self, name: str) -> list[str]:
        """Channels that determine a parameter together, of all that were not measured;
        speed and spin, the least commonly measured, are left out first."""
        needed = self.missing
        for channel in reversed(self.missing):
            fewer = [other for other in needed if other != channel]
            if name in self.determined(fewer):
                needed = fewer
        return needed


def _slopes_of_all_channels(fit: LeastSquaresFit, free: Indices) -> Floats:
    """Derivatives of the path by some parameters, shape (channels, rows,
    parameters)."""
    parameters = fit.request.parameters
    rows = len(fit.request.throw)

    def path(values: Floats) -> Floats:
        return predict_channels(fit.model, values, fit.problem)[:, :rows]

    # A parameter may be fixed for lack of a channel that depends on it.
    fixed = parameters.lower >= parameters.upper
    return slopes(
        path,
        fit.solution.values,
        _STEP * parameters.typical,
        free,
        lower=np.where(fixed, -np.inf, parameters.lower),
        upper=np.where(fixed, np.inf, parameters.upper),
    )
