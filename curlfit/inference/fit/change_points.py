"""Causes of smooth residuals of a fitted throw: abrupt changes of its friction, as by
sweeping, or of its velocity, as in a collision; friction that depends on speed;
distorted positions.

Score tests. The path responds linearly to a small change of the friction from some time
on; the response to a change within an interval is the difference of two of these. A
change of the velocity displaces all later positions by itself times the time elapsed
since. The tests find the interval and the time whose responses explain most of the
residuals, beyond what the parameters of the fit explain and a quantity that varies
smoothly with time, as under a law that is not exact: for the interval the friction, for
the time the accelerations along both axes.

Friction times a power of the speed, and positions that are a cubic function of those
measured, have few parameters. Of all causes that are sure the one is named that leaves
the smallest residuals.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from curlfit.inference.fit.prepared import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.noise.models import time_of_motion
from curlfit.numerics.arrays import Floats
from curlfit.numerics.differences import slopes
from curlfit.throws.throw import CHANNELS

_TIMES = 24  # at which the friction may change; twice as many for the velocity
_SMOOTH = 2  # degree of the polynomials in time for smooth changes
_STEP = 1e-4  # relative change of the friction, for differences
_SURE_FRICTION = 30.0
"""Twice the gain in log-likelihood by the best of some 250 intervals: below 20 in 50
synthetic throws without a change, including wrong laws and correlated noise, and
above 50 in 18 that were swept for 2 to 6 s, with friction lower by a tenth to a third
(noise of 5 mm)."""
_SURE_VELOCITY = 40.0
"""The same by the best of 42 times: below 28 in 126 throws without a change, including
wrong laws and correlated noise; above 58 in 8 whose velocity changed by 0.2 m/s, and in
5 of 8 whose changed by 0.05 m/s (noise of 5 mm). A change that a law can fit as curl is
not detected; with noise of 0.5 mm or less a wrong law may be mistaken for a change of
either kind (9 of 84 throws)."""
_FACTORS = 1 / 3, 3.0
_LEAST_VELOCITY = 0.02  # m/s; the largest is the speed of the stone
_ENDS = 3  # number of times left out at each end, where a wrong law fails first
_MOST_LAG1 = 0.7  # largest lag-1 correlation of what remains; a wrong law leaves more


class _Cause(NamedTuple):
    """A possible cause of the residuals."""

    gain: float
    """in twice the log-likelihood"""
    warning: str
    """the cause in words, with the options that account for it"""
    response: Floats
    """changes of all weighted channels, as rows"""


class _Fitted:
    """A fit with its path, without padded rows."""

    def __init__(self, fit: LeastSquaresFit) -> None:
        n, free = len(fit.prepared.throw), fit.prepared.parameters.free
        self.fit, self.begin = fit, fit.prepared.origin.t
        self.path = np.asarray(
            predict_channels(fit.model, fit.solution.values, fit.problem)
        )[:, :n]
        self.t, self.weight = (
            fit.problem.times[:n],
            np.asarray(fit.problem.weight)[:, :n],
        )
        self.speed = self.path[CHANNELS.index("speed")]
        self.duration = time_of_motion(self.t, self.speed)
        self.residual = np.asarray(fit.solution.residual)[:, :n].ravel()
        jacobian = np.asarray(fit.solution.jacobian)[:, :n]
        self.jacobian = jacobian.reshape(-1, len(free))[:, free]

    def to_friction(self, times: Floats) -> Floats:
        """Responses to a change of the friction from each time on; none
        after the last."""
        model, problem = self.fit.model, self.fit.problem
        values = np.array(self.fit.solution.values)
        rows, n = self.weight.shape
        # A parameter where other throws of a joint fit were swept: without effect on
        # this one, it takes the place of the ratio in the environment.
        place = None
        if "sweep" in model.conditions:
            coefficients = len(model.law.coefficients())
            place = coefficients + model.conditions.index("sweep")

        def swept(since: float, sweep: Floats) -> Floats:
            if place is not None:
                values[place] = sweep[0]
            swept = replace(
                problem.environment,
                sweep=sweep[0],
                swept_from=np.asarray(since),
                swept_to=np.asarray(np.inf),
            )
            path = predict_channels(model, values, problem._replace(environment=swept))
            return np.asarray(path)[:rows, :n]

        found = [
            slopes(partial(swept, since), np.ones(1), _STEP, value=self.path[:rows])[
                ..., 0
            ]
            for since in times[:-1]
        ]
        return np.array(
            [*(self.weight * each for each in found), 0 * self.weight]
        ).reshape(len(times), -1)

    def to_displacement(self, by: Any, axis: int) -> Floats:
        """Responses to changes of x (0) or y (1), shape (k, n)."""
        found = np.zeros((len(by), *self.weight.shape))
        found[:, axis] = by * self.weight[axis]
        return found.reshape(len(by), -1)

    def gain(self, before: Floats, after: Floats) -> float:
        """Twice the gain in log-likelihood from residuals `before` to `after`, for
        noise of unknown size that is correlated from row to row; 0 where the law is
        still wrong afterwards."""
        there = self.weight > 0
        residual = after.reshape(there.shape)
        products = residual[:, 1:] * residual[:, :-1] * (there[:, 1:] & there[:, :-1])
        lag1 = max(float(products.sum() / (residual**2).sum()), 0.0)
        effective = there.sum() * (1 - lag1) / (1 + lag1) if lag1 < _MOST_LAG1 else 0.0
        return float(
            effective * np.log(before @ before / max(float(after @ after), 1e-300))
        )

    def amplitudes(self, response: Floats) -> tuple[float, Any]:
        """The gain of a response beyond the parameters of the fit, and
        its amplitudes."""
        left, beyond = _without(self.jacobian, self.residual, response)
        amplitude = np.linalg.lstsq(beyond.T, -left, rcond=1e-9)[0]
        return self.gain(left, left + amplitude @ beyond), amplitude

    def left_by(self, cause: _Cause) -> float:
        """Sum of squares left by the parameters of the fit and a cause."""
        columns = np.hstack([self.jacobian, cause.response.T])
        left = _without(columns, self.residual, cause.response)[0]
        return float(left @ left)


def may_have_cause(fit: LeastSquaresFit, result: FitResult) -> bool:
    """Whether a cause is to be sought: the residuals are not independent, and the fit,
    by least squares with independent noise, does not account for sweeping."""
    doubtful = any(item.doubtful for item in result.independence.values())
    plain = not fit.loss.is_robust and fit.noise.is_white
    return doubtful and plain and fit.prepared.swept is None


def with_cause(fit: LeastSquaresFit, result: FitResult) -> FitResult:
    """The record of a fit with a warning about the cause of its residuals, if one is
    found; the same record otherwise."""
    change = sudden_change(fit)
    if change is None:
        return result
    return replace(result, warnings=(change, *result.warnings))


def sudden_change(fit: LeastSquaresFit) -> str | None:
    """A warning about the cause that explains the residuals best; None if none does."""
    fitted = _Fitted(fit)
    times = np.linspace(0.0, fitted.duration, _TIMES + 1)
    since = fitted.to_friction(times)
    causes = [
        _friction_change(fitted, since, times),
        _velocity_change(fitted),
        _speed_dependence(fitted, since, times),
        _distortion(fitted),
    ]
    limits = _SURE_FRICTION, _SURE_VELOCITY, _SURE_FRICTION, _SURE_FRICTION
    sure = [
        cause
        for cause, limit in zip(causes, limits, strict=True)
        if cause and cause.gain > limit
    ]
    return min(sure, key=fitted.left_by).warning if sure else None


def _speed_dependence(fitted: _Fitted, since: Floats, times: Floats) -> _Cause | None:
    """Friction times a power of the speed."""
    speed = np.interp((times[1:] + times[:-1]) / 2, fitted.t, fitted.speed)
    if not (speed > 0).all():
        return None
    response = (np.log(speed) @ (since[:-1] - since[1:]))[None]
    gain, (exponent,) = fitted.amplitudes(response)
    return _Cause(
        gain,
        "the friction depends on speed otherwise than under this law, by a factor of "
        f"about v^{exponent:.2g}; compare laws whose friction does (curlfit compare), "
        "or fit your own law with such a factor",
        response,
    )


def _distortion(fitted: _Fitted) -> _Cause | None:
    """Positions along the sheet that are a cubic function of those measured."""
    if not fitted.weight[1].any():
        return None
    y = fitted.path[1]
    place = 2 * (y - y.min()) / max(float(np.ptp(y)), 1e-9) - 1
    # a change of scale would be one of speed and friction
    shapes = chebvander(place, 3).T[2:]
    response = fitted.to_displacement(shapes, 1)
    gain, amplitude = fitted.amplitudes(response)
    return _Cause(
        gain,
        "the positions seem distorted along the sheet, as by the lens of a camera: "
        f"a cubic function of them, {1000 * (amplitude @ shapes).std():.2g} mm (rms), "
        "explains the residuals better than a change of the friction; "
        "correct the lens, then fit again",
        response,
    )


def _friction_change(fitted: _Fitted, since: Floats, times: Floats) -> _Cause:
    """The interval in which the friction differs abruptly from that before.

    Its gain is that beyond friction that is polynomial in time, which is then left out:
    it takes up part of a change.
    """
    smooth = chebvander(np.linspace(-1, 1, _TIMES), _SMOOTH).T @ (
        since[:-1] - since[1:]
    )
    columns = np.hstack([fitted.jacobian, smooth.T])
    left, beyond = _without(columns, fitted.residual, since)
    first, last, factor = _best_interval(left, beyond)
    gain = fitted.gain(left, left + (factor - 1) * (beyond[first] - beyond[last]))
    if gain > _SURE_FRICTION:
        first, last, factor = _best_interval(
            *_without(fitted.jacobian, fitted.residual, since)
        )
    begin, end = (f"{times[place] + fitted.begin:.1f}" for place in (first, last))
    return _Cause(
        gain,
        f"the friction changes abruptly, by a factor of about {factor:.2f} "
        f"between {begin} and {end} s, as by sweeping or a touched stone; "
        f"`--sweep {begin}:{end}` estimates the factor, `--until` and "
        "`--exclude` leave rows out",
        (since[first] - since[last])[None],
    )


def _best_interval(left: Floats, since: Floats) -> tuple[int, int, float]:
    """The places of its ends, and the factor on the friction, that explain most of the
    residuals `left`."""
    along, products = since @ left, since @ since.T
    squares = np.diag(products)
    # of the difference of any two: its square, and its product with the residuals
    size = squares[:, None] + squares - 2 * products
    score = along[:, None] - along
    there = size > 1e-9 * squares.max()
    factors = 1 - np.divide(score, size, out=np.zeros_like(size), where=there)
    there &= (factors > _FACTORS[0]) & (factors < _FACTORS[1])
    ends = [1, _TIMES - 1]
    there[ends] = there[:, ends] = False
    gain = np.divide(score**2, size, out=np.zeros_like(size), where=there)
    first, last = np.unravel_index(int(np.argmax(np.triu(gain, 1))), gain.shape)
    return int(first), int(last), float(factors[first, last])


def _velocity_change(fitted: _Fitted) -> _Cause | None:
    """The time at which the velocity changes abruptly; None without x and y."""
    if not fitted.weight[:2].any(axis=1).all():
        return None
    times = np.linspace(0.0, fitted.duration, 2 * _TIMES + 1)[:-1]
    late = np.maximum(fitted.t - times[:, None], 0.0)
    # accelerations that are polynomial in time
    smooth = chebvander(np.linspace(-1, 1, len(times)), _SMOOTH).T @ late
    nuisance = [fitted.to_displacement(smooth, axis) for axis in (0, 1)]
    every = np.stack([fitted.to_displacement(late, axis) for axis in (0, 1)], 1)
    columns = np.vstack([fitted.jacobian.T, *nuisance]).T
    left, changes = _without(columns, fitted.residual, every)
    speed = np.interp(times, fitted.t, fitted.speed)
    best = None
    for index in range(_ENDS, len(times) - _ENDS):
        pair = changes[index]
        amplitude = np.linalg.lstsq(pair @ pair.T, -(pair @ left), rcond=1e-9)[0]
        gain, size = (
            fitted.gain(left, left + amplitude @ pair),
            float(np.hypot(*amplitude)),
        )
        if (
            gain > (best.gain if best else 0.0)
            and _LEAST_VELOCITY < size < speed[index]
        ):
            time = times[index] + fitted.begin
            remedy = (
                f"`--since {math.ceil(2 * time + 0.5) / 2:g}` leaves out what is before"
                if 2 * index < len(times)
                else f"`--until {math.floor(2 * time - 0.5) / 2:g}` leaves "
                "out what follows"
            )
            words = (
                f"the velocity changes abruptly, by about {size:.2g} m/s near "
                f"t = {time:.1f} s, as in a collision; coefficients and the side of "
                "the curl are then wrong; "
            )
            best = _Cause(gain, words + remedy, every[index])
    return best


def _without(
    nuisance: Floats, residual: Floats, changes: Floats
) -> tuple[Floats, Floats]:
    """Residuals and responses with the span of the nuisance columns projected out."""
    columns, singular, _ = np.linalg.svd(
        nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300),
        full_matrices=False,
    )
    basis = columns[:, singular > 1e-8]
    return residual - basis @ (basis.T @ residual), changes - (
        changes @ basis
    ) @ basis.T
