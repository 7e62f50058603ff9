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
from typing import Any

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.friction import check_load
from curlfit.friction.curl import can_curl
from curlfit.inference.fit.prepared import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import WEAK_ERROR, Identifiability, analyse
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.noise.models import is_rough
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.settings.noise_kinds import NoiseKind
from curlfit.throws.motion import SURE, motion_of
from curlfit.throws.throw import CHANNELS

_CLEAR = 0.2  # m; a smaller curl of a path may be that of the ice


def curl_warnings(fits: Sequence[FitResult]) -> list[Finding]:
    """A warning if throws fitted with one law were measured to curl, and
    the law cannot.

    A slope of the ice among the parameters may cause the curl instead.
    """
    first = fits[0]
    law, load = first.law_class, check_load(first.load)
    # mypy takes a class for one of its instances, which compare by value and
    # have no hash.
    if can_curl(law, load, first.stone) or first.model.has_slope:  # type: ignore[arg-type]
        return []
    curls = [curl for fit in fits if (curl := measured_curl(fit)) is not None]
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
    """The fit of a single throw with that warning, if any."""
    warnings = curl_warnings([fit])
    return replace(fit, warnings=(*fit.warnings, *warnings)) if warnings else fit


def measured_curl(fit: FitResult) -> float | None:
    """Curl in m to the right as measured, by an event or by the path; None if it
    is not clear."""
    across = [item for item in fit.events if item["quantity"] == "x"]
    if across:
        far = max(across, key=lambda item: abs(item["value"]))
        return far["value"] if abs(far["value"]) > SURE * far["sigma"] else None
    motion = motion_of(fit.throw) if {"x", "y"} <= fit.rms.keys() else None
    if motion is None or abs(motion.curl) - SURE * motion.curl_error < _CLEAR:
        return None
    return -motion.curl


# rms residual of the law over that with independent noise, up to which it is as near
_FARTHER = 2.0


def with_noise_advice(
    result: FitResult, refit: Callable[[FitResult, NoiseKind], FitResult]
) -> FitResult:
    """A fit with independent noise whose warning about correlated residuals
    says what helps."""
    if not any(warning.code == "correlated" for warning in result.warnings):
        return result
    advice = _advice(result, refit)
    warnings = tuple(
        warning.with_remedies(advice) if warning.code == "correlated" else warning
        for warning in result.warnings
    )
    return replace(result, warnings=warnings)


def _advice(
    result: FitResult, refit: Callable[[FitResult, NoiseKind], FitResult]
) -> Remedy:
    """Which noise model describes correlated residuals, if any."""
    doubtful = [name for name, item in result.independence.items() if item.doubtful]
    left = {name: result.observed[name] - result.fitted[name] for name in doubtful}
    if not any(is_rough(series[np.isfinite(series)]) for series in left.values()):
        return Remedy("no-noise-so-smooth")
    for noise in (NoiseKind.AR1, NoiseKind.DISCREPANCY):
        other = refit(result, noise)
        if _describes(other, result):
            option = Option("noise", noise.value)
            factors = _larger_errors(other, result)
            code = "noise-with-errors" if factors else "noise"
            return Remedy(code, option, {"factors": factors})
    return Remedy("no-noise")


def _describes(other: FitResult, white: FitResult) -> bool:
    """Whether a noise model makes residuals independent and leaves the law as near
    to the data."""
    near = all(other.rms[name] <= _FARTHER * size for name, size in white.rms.items())
    return (
        other.converged
        and near
        and not any(one.doubtful for one in other.independence.values())
    )


def _larger_errors(other: FitResult, white: FitResult) -> list[dict[str, Any]]:
    """How many times as large the standard errors of the coefficients are."""
    names = [*white.coefficients, *(item.expression for item in white.combinations)]
    factors = []
    for name in names:
        if name not in other:
            continue
        before = white[name].stderr
        after = other[name].stderr
        if before and after:
            factors.append({"name": name, "factor": after / before})
    return factors


NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01, "speed": 0.02, "omega": 0.02}
"""Of a hypothetical channel: m, m, rad, m/s, rad/s."""
_STEP = 1e-4  # of a typical size, of differences: the path is accurate to 1e-8 of it


def remedies(
    fit: LeastSquaresFit, open_: Sequence[str], held: Collection[str]
) -> tuple[dict[str, Any], ...]:
    """What would determine some parameters, as {"parameters": names,
    "measure": channels}.

    Parameters
    ----------
    open_ : parameters that the data do not determine.
    held : parameters that stay fixed whatever is measured.

    Returns
    -------
    Parameters with the same remedy are grouped. Of several channels in "measure" any
    one suffices, unless "all" is true: then all are needed. It is empty where no
    channel would help.
    """
    parameters = fit.prepared.local_parameters
    free = np.array(
        [place for place, name in enumerate(parameters.names) if name not in held]
    )
    names, values = (
        [parameters.names[place] for place in free],
        fit.solution.values[free],
    )
    jacobian, typical = _slopes_of_all_channels(fit, free), parameters.typical[free]
    weight = np.zeros_like(jacobian[..., 0])
    weight[: len(fit.problem.weight)] = fit.problem.weight[:, : weight.shape[1]]
    missing = [name for row, name in enumerate(CHANNELS) if not weight[row].any()]

    def analysed(channels: Sequence[str]) -> Identifiability:
        full = weight.copy()
        for name in channels:
            full[CHANNELS.index(name)] = 1 / NOISE[name]
        matrix = (full[..., None] * jacobian).reshape(-1, len(free))
        return analyse(matrix, names, values, typical)

    def determined(channels: Sequence[str]) -> set[str]:
        known = analysed(channels)
        spread = np.sqrt(np.diag(known.covariance))
        sharp = (spread < WEAK_ERROR * typical) & ~known.unseen
        return {name for name, take in zip(names, sharp, strict=True) if take}

    if not fit.noise.is_white:
        unseen = dict(zip(names, analysed(missing).unseen, strict=True))
        never = [name for name in open_ if unseen[name]]
        return ({"parameters": never, "measure": [], "all": False},) if never else ()
    alone = {name: determined([name]) for name in missing}
    together = determined(missing) if len(missing) > 1 else set()
    found: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for name in open_:
        enough = [channel for channel, sees in alone.items() if name in sees]
        all_ = not enough and name in together
        if all_:
            enough = list(missing)
            # speed and spin are the least commonly measured
            for channel in reversed(missing):
                fewer = [other for other in enough if other != channel]
                if name in determined(fewer):
                    enough = fewer
        found.setdefault((tuple(enough), all_), []).append(name)
    return tuple(
        {"parameters": named, "measure": list(channels), "all": all_}
        for (channels, all_), named in found.items()
    )


def _slopes_of_all_channels(fit: LeastSquaresFit, free: Indices) -> Floats:
    """Derivatives of the path by some parameters, shape (channels, rows,
    parameters)."""
    parameters, rows = fit.prepared.local_parameters, len(fit.prepared.throw)
    # for lack of a channel that depends on them
    fixed = parameters.lower >= parameters.upper
    return slopes(
        lambda moved: np.asarray(predict_channels(fit.model, moved, fit.problem))[
            :, :rows
        ],
        fit.solution.values,
        _STEP * parameters.typical,
        free,
        lower=np.where(fixed, -np.inf, parameters.lower),
        upper=np.where(fixed, np.inf, parameters.upper),
    )
