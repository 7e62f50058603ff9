"""Whether the friction of a fitted throw changes at once: sweeping, or a touched stone.

Score test. The path responds linearly to a small change of the friction from some time on; the
response to a change within an interval is the difference of two of these. Of all intervals, the one
is sought whose response explains most of the residuals, over and above the parameters of the fit
and friction that changes smoothly with time, as under a law that is not exact.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from curlfit.inference.fit.summary import LeastSquaresFit
from curlfit.inference.likelihood import predict_channels

# isort: split
import numpy as np
from numpy.polynomial.chebyshev import chebvander

from curlfit.inference.noise.models import time_of_motion
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.throw import CHANNELS

_TIMES = 24  # at which the friction may change
_SMOOTH = 2  # terms of friction that changes smoothly with time
_STEP = 1e-4  # relative change of the friction, for differences
_SURE = 30.0
"""Twice the gain of the log-likelihood by the best of some 300 intervals: below 20 in 50 synthetic
throws in which nothing had changed, under wrong laws and correlated noise too, and above 50 in 18
that were swept for 2 to 6 s, with friction less by a tenth to a third (noise of 5 mm)."""


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
            f"the friction changes at once, by a factor of about {self.factor:.2f} between {begin} "
            f"and {end} s: sweeping, or a touched stone; `--sweep {begin}:{end}` makes the factor "
            "a parameter, `--until` and `--exclude` leave rows out"
        )


def friction_change(fit: LeastSquaresFit) -> FrictionChange | None:
    """The interval in which the friction differs at once from that before, if there is one."""
    problem, n = fit.problem, len(fit.prepared.throw)
    channels = problem.observed.shape[0]
    weight = np.asarray(problem.weight)[:, :n]
    best = np.asarray(predict_channels(fit.model, fit.solution.values, problem))
    span = time_of_motion(np.asarray(problem.times)[:n], best[CHANNELS.index("speed"), :n])
    times = np.linspace(0.0, span, _TIMES + 1)
    responses = []
    for time in times[:-1]:
        environment = replace(
            problem.environment, sweep=np.asarray(1 + _STEP), swept_from=np.asarray(time),
            swept_to=np.asarray(np.inf),
        )  # fmt: skip
        changed = problem._replace(environment=environment)
        path = np.asarray(predict_channels(fit.model, fit.solution.values, changed))
        responses.append(((path - best)[:channels, :n] * weight / _STEP).ravel())
    since = np.array([*responses, np.zeros(weight.size)])
    # friction that follows polynomials of time
    smooth = chebvander(np.linspace(-1, 1, _TIMES), _SMOOTH).T @ (since[:-1] - since[1:])
    free = fit.prepared.parameters.free
    jacobian = np.asarray(fit.solution.jacobian)[:, :n][..., free].reshape(-1, int(free.sum()))
    residual = np.asarray(fit.solution.residual)[:, :n].ravel()
    left, since = _without(np.hstack([jacobian, smooth.T]), residual, since)
    return _best_interval(left, since, times + fit.prepared.origin.t, weight > 0)


def _without(nuisance: Floats, residual: Floats, since: Floats) -> tuple[Floats, Floats]:
    """Residuals and responses less what the nuisance columns can make."""
    columns, singular, _ = np.linalg.svd(
        nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300), full_matrices=False
    )
    basis = columns[:, singular > 1e-8]
    return residual - basis @ (basis.T @ residual), since - (since @ basis) @ basis.T


def _best_interval(
    left: Floats, since: Floats, times: Floats, there: Booleans
) -> FrictionChange | None:
    along, products = since @ left, since @ since.T
    squares = np.diag(products)
    # of the difference of any two: of its square, and along the residuals
    size = squares[:, None] + squares - 2 * products
    score = along[:, None] - along
    gain = np.where(size > 1e-9 * squares.max(), score**2 / np.where(size > 0, size, 1.0), 0.0)
    first, last = np.unravel_index(int(np.argmax(np.triu(gain, 1))), gain.shape)
    total = float(left @ left)
    amplitude = -float(score[first, last] / size[first, last])
    rest = left + amplitude * (since[first] - since[last])
    lag1 = _lag1(rest.reshape(there.shape), there)
    effective = there.sum() * min((1 - lag1) / (1 + lag1), 1.0)
    likelihood = effective * np.log(total / max(float(rest @ rest), 1e-300))
    if likelihood < _SURE:
        return None
    return FrictionChange(float(times[first]), float(times[last]), 1 + amplitude)


def _lag1(residual: Floats, there: Booleans) -> float:
    both = there[:, 1:] & there[:, :-1]
    products = residual[:, 1:] * residual[:, :-1] * both
    return float(np.clip(products.sum() / (residual**2).sum(), 0.0, 0.99))
