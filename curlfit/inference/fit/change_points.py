"""When the residuals of a fitted throw change.

Residuals that are not independent may have changed at some time: since then the stone
moves otherwise than the fit has it. What changed is not asked. Two kinds of change are
tried, each at many times:

- The friction is another one from one time to a later one. To first order the path
  responds by the difference of two responses, to friction that changes at either time
  and stays so.
- The velocity jumps. All later positions are displaced by the jump times the time
  since.

Both are score tests: a change counts by what its response explains beyond the
parameters of the fit and a quantity that varies smoothly with time: the friction in the
first test, the acceleration along either axis in the second. Residuals that both of
these, and friction by a power of the speed, explain better are smooth: the law is not
exact, or positions are distorted, and nothing changed suddenly.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.likelihood import predict_channels
from curlfit.inference.noise.independence import time_of_motion
from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import CHANNELS

_SURE = 30.0
"""Twice the gain in log-likelihood of a change, at least. Of 2,600 throws that did not
change none is then said to, of 393 that did 285 are (section "Sudden changes" of
tests/statistics/README.md)."""
_TIMES = 24
"""At which the friction may change; the velocity at twice as many."""
_SMOOTH = 2
"""Degree of the polynomials in time for what varies smoothly."""
_PER_SMOOTH_RESPONSE = 2.0
"""What each smooth response costs of twice the log-likelihood, as it has a factor of
its own (Akaike 1974)."""
_CHANGED = 1.001
"""Friction over that of the fit, in a response to it."""
_SLOWEST = 1e-3
"""m/s, of which the logarithm is taken."""
_NOTHING = 1e-300
"""Sum of squares, or length, that stands for zero in a quotient."""
_ROUNDING = 1e-9
"""Singular value over the largest, of factors that may be rounding error ..."""
_ROUNDING_OF_COLUMNS = 1e-8
"""... and of columns of length 1."""


class Change(NamedTuple):
    """A time from which on, or two times between which, a stone moves otherwise than
    fitted; s, by the clock of the data."""

    begin: float
    end: float
    """the same as `begin` where the velocity jumps"""
    channel: str
    """whose residuals it changes most"""
    first: float
    last: float
    """between which the stone moves"""

    def finding(self) -> Finding:
        """When, where to look, and what to try."""
        times = sorted({self.begin, self.end} - {self.first, self.last})
        swept_to = self.end if self.end > self.begin else self.last
        sweep = Option("sweep", f"{self.begin:.1f}:{swept_to:.1f}")
        if self.begin - self.first > self.last - self.end:
            until = math.floor(2 * self.begin - 0.5) / 2
            without = Remedy("without-later-rows", Option("until", f"{until:g}"))
        else:
            since = math.ceil(2 * self.end + 0.5) / 2
            without = Remedy("without-earlier-rows", Option("since", f"{since:g}"))
        return Finding.warning(
            "residuals-change",
            Remedy("sweep", sweep),
            without,
            times=times,
            channel=self.channel,
        )

    def added_to(self, result: FitResult) -> FitResult:
        """The record of a fit with the warning of this change before others."""
        return replace(result, warnings=(self.finding(), *result.warnings))


class _Residuals(NamedTuple):
    """Weighted residuals of a fit, and how the parameters change them, without padded
    rows. Rows are those of channels, one after the other."""

    t: Floats
    """s, from the first row"""
    weight: Floats
    """shape (channels, n)"""
    values: Floats
    jacobian: Floats
    path: Floats
    """as fitted, shape (channels, n)"""
    speed: Floats
    """as fitted, m/s"""
    duration: float
    """of the motion"""

    @classmethod
    def of(cls, fit: LeastSquaresFit) -> Self:
        n = len(fit.request.throw)
        free = fit.request.parameters.free
        weight = np.asarray(fit.problem.weight)[:, :n]
        path = predict_channels(fit.model, fit.solution.values, fit.problem)
        t = np.asarray(fit.problem.times)[:n]
        speed = path[CHANNELS.index("speed"), :n]
        jacobian = np.asarray(fit.solution.jacobian)[:, :n]
        return cls(
            t=t,
            weight=weight,
            values=np.asarray(fit.solution.residual)[:, :n].ravel(),
            jacobian=jacobian.reshape(-1, len(free))[:, free],
            path=path[: len(weight), :n],
            speed=speed,
            duration=time_of_motion(t, speed),
        )

    def displaced(self, displacements: Floats, axis: int) -> Floats:
        """Changes of the weighted x (0) or y (1) by displacements of shape (k, n)."""
        changes = np.zeros((len(displacements), *self.weight.shape))
        changes[:, axis] = displacements * self.weight[axis]
        return changes.reshape(len(displacements), -1)

    def columns_with(self, responses: Floats) -> Floats:
        """Columns of the parameters, and of responses of shape (k, rows)."""
        return np.vstack([self.jacobian.T, responses]).T


class _Candidates(NamedTuple):
    """Changes of one kind that are tried."""

    begins: Floats
    ends: Floats
    responses: Floats
    """of the weighted path, up to a factor for each, shape (changes, factors, rows)"""
    smooth: Floats
    """responses to what varies smoothly, shape (k, rows)"""


class _Explained(NamedTuple):
    """The change of a kind that explains the residuals best."""

    number: int
    """of the change among those that are tried"""
    before: Floats
    """residuals beyond the columns, which explain them in any case"""
    after: Floats
    """those beyond the response to the change too"""


def may_have_changed(fit: LeastSquaresFit, result: FitResult) -> bool:
    """Whether a change is to be sought: the residuals are not independent, and the fit,
    by least squares with independent noise, does not account for sweeping."""
    doubtful = any(
        independence.doubtful for independence in result.independence.values()
    )
    plain = not fit.request.loss.is_robust and fit.noise.is_white
    return doubtful and plain and fit.request.swept is None


def change_of(fit: LeastSquaresFit) -> Change | None:
    """The change that explains the residuals best; None if none is sure."""
    residuals = _Residuals.of(fit)
    times = np.linspace(0.0, residuals.duration, _TIMES + 1)
    since = _responses_to_friction(fit, residuals, times)
    friction = _of_friction(times, since)
    velocity = _of_velocity(residuals)
    surest = _surest(residuals, friction, velocity)
    if surest is None:
        return None
    # What varies smoothly takes up part of a change, and would move it.
    explained = _best(residuals.values, surest.responses, residuals.jacobian)
    by_speed = _response_to_power_of_speed(residuals, times, since)
    smooth = np.vstack([friction.smooth, velocity.smooth, by_speed])
    remainder = _beyond(residuals.columns_with(smooth), residuals.values)
    gain_of_smooth = _gain(explained.after, remainder, residuals.weight)
    if gain_of_smooth > _PER_SMOOTH_RESPONSE * len(smooth):
        return None
    squares = explained.before**2 - explained.after**2
    by_channel = squares.reshape(residuals.weight.shape).sum(axis=1)
    first = float(fit.request.throw.t[0])
    return Change(
        begin=first + float(surest.begins[explained.number]),
        end=first + float(surest.ends[explained.number]),
        channel=CHANNELS[int(by_channel[: len(CHANNELS)].argmax())],
        first=first,
        last=first + residuals.duration,
    )


def _surest(residuals: _Residuals, *kinds: _Candidates) -> _Candidates | None:
    """The kind of change whose best gains most beyond what varies smoothly; None if no
    gain is sure."""
    surest = None
    largest_gain = _SURE
    for candidates in kinds:
        columns = residuals.columns_with(candidates.smooth)
        explained = _best(residuals.values, candidates.responses, columns)
        gain = _gain(explained.before, explained.after, residuals.weight)
        if gain > largest_gain:
            surest = candidates
            largest_gain = gain
    return surest


def with_change(fit: LeastSquaresFit, result: FitResult) -> FitResult:
    """The record of a fit, with a warning first if its residuals change."""
    if not (result.converged and may_have_changed(fit, result)):
        return result
    change = change_of(fit)
    return result if change is None else change.added_to(result)


def _of_friction(times: Floats, since: Floats) -> _Candidates:
    """Friction that is another one between two times.

    Parameters
    ----------
    times : in order; the last is that of rest.
    since : changes of the weighted path if the friction is another one from each of
        the times on, shape (times, rows).
    """
    begins, ends = np.triu_indices(len(times), 1)  # all pairs, the earlier first
    whole_motion = (begins == 0) & (ends == len(times) - 1)  # is no change
    begins = begins[~whole_motion]
    ends = ends[~whole_motion]
    # to first order, between two times is since the first less since the second
    between = since[begins] - since[ends]
    intervals = since[:-1] - since[1:]
    polynomials = chebvander(np.linspace(-1, 1, len(intervals)), _SMOOTH).T
    return _Candidates(
        begins=times[begins],
        ends=times[ends],
        responses=between[:, None],
        smooth=polynomials @ intervals,
    )


def _responses_to_friction(
    fit: LeastSquaresFit, residuals: _Residuals, times: Floats
) -> Floats:
    """Changes of the weighted path if the friction is another one from each time on,
    shape (times, rows); none from the last, when the stone is at rest."""
    model = fit.model
    problem = fit.problem
    values = np.array(fit.solution.values)
    if "sweep" in model.conditions:
        # Other throws of a joint fit were swept. The parameter, without effect on this
        # one, takes the place of the ratio in the environment.
        coefficients = len(model.law.coefficients())
        values[coefficients + model.conditions.index("sweep")] = _CHANGED
    channels, n = residuals.weight.shape
    changes = np.zeros((len(times), channels, n))
    for change, time in zip(changes, times[:-1], strict=False):
        swept = replace(
            problem.environment,
            sweep=np.asarray(_CHANGED),
            swept_from=np.asarray(time),
            swept_to=np.asarray(np.inf),
        )
        path = predict_channels(model, values, problem._replace(environment=swept))
        change[:] = np.asarray(path)[:channels, :n] - residuals.path
    return (changes * residuals.weight).reshape(len(times), -1)


def _response_to_power_of_speed(
    residuals: _Residuals, times: Floats, since: Floats
) -> Floats:
    """Change of the weighted path, up to a factor, if the friction has a power of the
    speed as a factor; arguments as in `_of_friction`."""
    middles = (times[1:] + times[:-1]) / 2
    speed = np.maximum(np.interp(middles, residuals.t, residuals.speed), _SLOWEST)
    response: Floats = np.log(speed) @ (since[:-1] - since[1:])
    return response


def _of_velocity(residuals: _Residuals) -> _Candidates:
    """Velocities that jump, along both axes."""
    times: Floats = np.linspace(0.0, residuals.duration, 2 * _TIMES, endpoint=False)
    time_since: Floats = np.maximum(residuals.t - times[:, None], 0.0)
    jumps = np.stack([residuals.displaced(time_since, axis) for axis in (0, 1)], axis=1)
    # accelerations that are polynomials in time
    polynomials = chebvander(np.linspace(-1, 1, len(times)), _SMOOTH).T @ time_since
    smooth = [residuals.displaced(polynomials, axis) for axis in (0, 1)]
    later = slice(1, None)  # a jump at the start is one of the initial velocity
    return _Candidates(times[later], times[later], jumps[later], np.vstack(smooth))


def _best(values: Floats, responses: Floats, columns: Floats) -> _Explained:
    """Which of some responses, of shape (responses, factors, rows), explains most of
    the residuals beyond the columns."""
    before = _beyond(columns, values)
    remainders = []
    for response in _beyond(columns, responses):
        factors, *_ = np.linalg.lstsq(response.T, before, rcond=_ROUNDING)
        remainders.append(before - factors @ response)
    best = int(np.argmin([remainder @ remainder for remainder in remainders]))
    return _Explained(best, before, remainders[best])


def _beyond(columns: Floats, changes: Floats) -> Floats:
    """Changes, whose last axis has the rows, without what is in the span of columns."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), _NOTHING)
    basis, singular, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, singular > _ROUNDING_OF_COLUMNS]
    beyond: Floats = changes - (changes @ basis) @ basis.T
    return beyond


def _gain(before: Floats, after: Floats, weight: Floats) -> float:
    """Twice the gain in log-likelihood from residuals to others, for noise of unknown
    size that is correlated from row to row."""
    measured = weight > 0
    series = after.reshape(measured.shape)
    neighbours = measured[:, 1:] & measured[:, :-1]
    products = float((series[:, 1:] * series[:, :-1] * neighbours).sum())
    squares = max(float(after @ after), _NOTHING)
    lag1 = max(products / squares, 0.0)
    effective = measured.sum() * (1 - lag1) / (1 + lag1)
    return float(effective * np.log(before @ before / squares))
