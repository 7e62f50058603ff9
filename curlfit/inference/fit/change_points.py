"""Whether the motion of a fitted throw changes abruptly: its friction by sweeping, or its velocity
where stones touch.

Score tests. The path responds linearly to a small change of the friction from some time on; the
response to a change within an interval is the difference of two of these. A change of the velocity
moves all later positions by itself times the time since then. The interval or time is sought whose
response explains most of the residuals, over and above the parameters of the fit and what changes
smoothly with time, as under a law that is not exact: friction for an interval, accelerations along
both axes for a velocity.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from curlfit.inference.fit.summary import LeastSquaresFit
from curlfit.inference.likelihood import predict_channels

# isort: split
import numpy as np
from numpy.polynomial.chebyshev import chebvander

from curlfit.inference.noise.models import time_of_motion
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS

_TIMES = 24  # at which the friction may change; the velocity at twice as many
_SMOOTH = 2  # degree of what changes smoothly with time
_STEP = 1e-4  # relative change of the friction, for differences
_SURE_FRICTION = 30.0
"""Twice the gain of the log-likelihood by the best of some 300 intervals: below 20 in 50 synthetic
throws in which nothing had changed, under wrong laws and correlated noise too, and above 50 in 18
that were swept for 2 to 6 s, with friction less by a tenth to a third (noise of 5 mm)."""
_SURE_VELOCITY = 40.0
"""The same by the best of 47 times: below 28 in 126 throws in which nothing had changed, under
wrong laws and correlated noise too; above 58 in 8 whose velocity changed by 0.2 m/s, in 5 of 8 by
0.05 m/s (noise of 5 mm). Where a law takes the change for curl, it is not seen; with noise of
0.5 mm or less a wrong law may pass for a change of either kind (9 of 84 throws)."""
_FACTORS = 1 / 3, 3.0
_LEAST_VELOCITY = 0.02  # m/s; and not more than the stone has
_ENDS = 3  # times at both ends that are left out; there a wrong law fails first
_MOST_LAG1 = 0.7  # of what remains; more is left by a wrong law


class SuddenChange(Protocol):
    """What changes abruptly, in words."""

    def warning(self) -> str:
        """In words, with the flags that go with it."""
        ...


class FrictionChange(NamedTuple):
    """An interval in which the friction is another."""

    begin: float
    """on the clock of the data, s"""
    end: float
    factor: float
    """friction over that before"""

    def warning(self) -> str:
        """In words, with the flags that go with it."""
        begin, end = f"{self.begin:.1f}", f"{self.end:.1f}"
        return (
            f"the friction changes abruptly, by a factor of about {self.factor:.2f} between "
            f"{begin} and {end} s, as by sweeping or a touched stone; `--sweep {begin}:{end}` "
            "estimates the factor, `--until` and `--exclude` leave rows out"
        )


class VelocityChange(NamedTuple):
    """A time at which the velocity is another."""

    time: float
    """on the clock of the data, s"""
    size: float
    """m/s"""
    early: bool
    """whether most of the motion follows it"""

    def warning(self) -> str:
        """In words, with the flags that go with it."""
        if self.early:
            remedy = f"`--since {math.ceil(2 * self.time + 0.5) / 2:g}` leaves out what is before"
        else:
            remedy = f"`--until {math.floor(2 * self.time - 0.5) / 2:g}` leaves out what follows"
        return (
            f"the velocity changes abruptly, by about {self.size:.2g} m/s near t = {self.time:.1f} "
            "s, as in a collision; coefficients and the side of the curl are then wrong; "
            f"{remedy}"
        )


class _Fitted(NamedTuple):
    """A fit with its path, without padded rows."""

    fit: LeastSquaresFit
    path: Floats
    t: Floats
    weight: Floats
    residual: Floats
    """One-dimensional, of all channels."""
    jacobian: Floats
    """By the free parameters."""

    @classmethod
    def of(cls, fit: LeastSquaresFit) -> _Fitted:
        n, free = len(fit.prepared.throw), fit.prepared.parameters.free
        jacobian = np.asarray(fit.solution.jacobian)[:, :n][..., free]
        return cls(
            fit,
            np.asarray(predict_channels(fit.model, fit.solution.values, fit.problem)),
            np.asarray(fit.problem.times)[:n],
            np.asarray(fit.problem.weight)[:, :n],
            np.asarray(fit.solution.residual)[:, :n].ravel(),
            jacobian.reshape(-1, int(free.sum())),
        )

    @property
    def duration(self) -> float:
        """Time of motion, s."""
        return time_of_motion(self.t, self.path[CHANNELS.index("speed"), : len(self.t)])

    def response(self, problem: Problem) -> Floats:
        """Change of the weighted channels under another problem."""
        path = np.asarray(predict_channels(self.fit.model, self.fit.solution.values, problem))
        channels, n = self.weight.shape
        return ((path - self.path)[:channels, :n] * self.weight).ravel()

    def displacement(self, by: Any, axis: int) -> Floats:
        """Changes of x (0) or y (1), shape (k, n), among the weighted channels."""
        found = np.zeros((len(by), *self.weight.shape))
        found[:, axis] = by * self.weight[axis]
        return found.reshape(len(by), -1)

    def gain(self, before: Floats, after: Floats) -> float:
        """Twice the gain of the log-likelihood where residuals are these two, the noise being of
        unknown size and correlated from row to row; 0 where the law is wrong after it, too."""
        there = self.weight > 0
        residual = after.reshape(there.shape)
        products = residual[:, 1:] * residual[:, :-1] * (there[:, 1:] & there[:, :-1])
        lag1 = max(float(products.sum() / (residual**2).sum()), 0.0)
        effective = there.sum() * (1 - lag1) / (1 + lag1) if lag1 < _MOST_LAG1 else 0.0
        return float(effective * np.log(before @ before / max(float(after @ after), 1e-300)))


def sudden_change(fit: LeastSquaresFit) -> SuddenChange | None:
    """What changes abruptly, friction or velocity, whichever explains more; None if neither."""
    fitted = _Fitted.of(fit)
    tests = ((_friction_change, _SURE_FRICTION), (_velocity_change, _SURE_VELOCITY))
    found = [(*test(fitted), limit) for test, limit in tests]
    sure = [(gain, change) for gain, change, limit in found if gain > limit]
    return max(sure, key=lambda item: item[0])[1] if sure else None


def _friction_change(fitted: _Fitted) -> tuple[float, FrictionChange]:
    """The interval in which the friction differs abruptly from that before, and its gain."""
    problem, origin = fitted.fit.problem, fitted.fit.prepared.origin
    times = np.linspace(0.0, fitted.duration, _TIMES + 1)
    responses = []
    for time in times[:-1]:
        environment = replace(
            problem.environment, sweep=np.asarray(1 + _STEP), swept_from=np.asarray(time),
            swept_to=np.asarray(np.inf),
        )  # fmt: skip
        responses.append(fitted.response(problem._replace(environment=environment)) / _STEP)
    since = np.array([*responses, np.zeros(fitted.weight.size)])
    # friction that follows polynomials of time
    smooth = chebvander(np.linspace(-1, 1, _TIMES), _SMOOTH).T @ (since[:-1] - since[1:])
    left, since = _without(np.hstack([fitted.jacobian, smooth.T]), fitted.residual, since)
    along, products = since @ left, since @ since.T
    squares = np.diag(products)
    # of the difference of any two: of its square, and along the residuals
    size = squares[:, None] + squares - 2 * products
    score = along[:, None] - along
    there = size > 1e-9 * squares.max()
    factors = 1 - np.divide(score, size, out=np.zeros_like(size), where=there)
    there &= (factors > _FACTORS[0]) & (factors < _FACTORS[1])
    ends = [1, _TIMES - 1]
    there[ends] = there[:, ends] = False
    gain = np.divide(score**2, size, out=np.zeros_like(size), where=there)
    first, last = np.unravel_index(int(np.argmax(np.triu(gain, 1))), gain.shape)
    factor = float(factors[first, last])
    rest = left + (factor - 1) * (since[first] - since[last])
    begin, end = times[first] + origin.t, times[last] + origin.t
    return fitted.gain(left, rest), FrictionChange(float(begin), float(end), factor)


def _velocity_change(fitted: _Fitted) -> tuple[float, VelocityChange]:
    """The time at which the velocity changes abruptly, and its gain; 0 without both positions."""
    best = 0.0, VelocityChange(0.0, 0.0, True)
    if not (fitted.weight[:2] > 0).any(axis=1).all():
        return best
    duration = fitted.duration
    times = np.linspace(0.0, duration, 2 * _TIMES + 1)[:-1]
    late = np.maximum(fitted.t - times[:, None], 0.0)
    # accelerations that follow polynomials of time
    smooth = chebvander(np.linspace(-1, 1, len(times)), _SMOOTH).T @ late
    nuisance = [fitted.displacement(smooth, axis) for axis in (0, 1)]
    changes = np.vstack([fitted.displacement(late, axis) for axis in (0, 1)])
    columns = np.vstack([fitted.jacobian.T, *nuisance]).T
    left, changes = _without(columns, fitted.residual, changes)
    speed = np.interp(times, fitted.t, fitted.path[CHANNELS.index("speed"), : len(fitted.t)])
    for index in range(_ENDS, len(times) - _ENDS):
        pair = changes[[index, len(times) + index]]
        amplitude = np.linalg.lstsq(pair @ pair.T, -(pair @ left), rcond=1e-9)[0]
        gain, size = fitted.gain(left, left + amplitude @ pair), float(np.hypot(*amplitude))
        if gain > best[0] and _LEAST_VELOCITY < size < speed[index]:
            at = float(times[index]) + fitted.fit.prepared.origin.t
            best = gain, VelocityChange(at, size, 2 * index < len(times))
    return best


def _without(nuisance: Floats, residual: Floats, changes: Floats) -> tuple[Floats, Floats]:
    """Residuals and responses less what the nuisance columns can make."""
    columns, singular, _ = np.linalg.svd(
        nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300), full_matrices=False
    )
    basis = columns[:, singular > 1e-8]
    return residual - basis @ (basis.T @ residual), changes - (changes @ basis) @ basis.T
