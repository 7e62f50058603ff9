"""What a law lacks: the accelerations that the path has beyond it, against
speed and spin.

Neither the size of the misfit nor its cause is assumed. With the fitted path and
what is left of the measured one, r(t), the stone moves at the velocity of the fitted
path + r', under the acceleration of the law at its fitted speed and spin + r''; what
the law gives at the speed and spin that the stone had is subtracted. r is a
penalised spline (`curlfit.numerics.penalized_spline`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from curlfit.comparison.result import PLACE, Lacking
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.solve.initial_values import POINTS, accelerations_along
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.numerics.differences import slopes
from curlfit.numerics.penalized_spline import PenalizedSpline

_STEP = 1e-3  # typical sizes, of differences
_FEWEST = 40  # rows in which the stone moves
_SLOWEST = 0.1
"""Speed over the largest, below which what is lacking changes too fast."""


class _States(NamedTuple):
    """States of a stone along a path, each of shape (POINTS,)."""

    speed: Floats
    omega: Floats
    phi: Floats
    t: Floats
    """since release"""


def lacking(
    label: str,
    best: FitResult,
    others: Mapping[str, FitResult],
    family: type[LawFamily] | None,
) -> Lacking | None:
    """What a law lacks, and what others would add to it. None without x, y and angle,
    where a condition of the ice or sweeping acts too, or of a record that is too short.

    Parameters
    ----------
    label, best : of the law. others : fits of the same throw, by label.
    """
    observed = best.observed
    fitted = best.fitted
    moving = _measured_in_motion(best)
    if moving.sum() < _FEWEST or best.model.conditions or best.data.swept:
        return None
    t = observed["t"][moving]
    at = np.linspace(t[0], t[-1], POINTS)
    residual = {
        name: PenalizedSpline.of(t, observed[name][moving] - fitted[name][moving])
        for name in PLACE
    }
    rate = {name: residual[name].at(at, 1)[0] for name in PLACE}
    acceleration = {}
    error = {}
    for name in PLACE:
        acceleration[name], error[name] = residual[name].at(at, 2)

    # the fitted path: its states, and its accelerations by the law
    x_rate = np.gradient(fitted["x"][moving], t)
    y_rate = np.gradient(fitted["y"][moving], t)
    of_fit = _States(
        speed=np.interp(at, t, fitted["speed"][moving]),
        omega=np.interp(at, t, fitted["omega"][moving]),
        phi=np.interp(at, t, fitted["phi"][moving]),
        t=at - observed["t"][0],
    )
    heading = np.interp(at, t, np.unwrap(np.arctan2(x_rate, y_rate)))
    sine = np.sin(heading)
    cosine = np.cos(heading)
    xi, eta, turning = _accelerations(best, family, of_fit)
    vx = of_fit.speed * sine + rate["x"]
    vy = of_fit.speed * cosine + rate["y"]
    ax = xi * cosine + eta * sine + acceleration["x"]
    ay = eta * cosine - xi * sine + acceleration["y"]

    # the measured one: to the right of its own motion, along it, and angular
    measured = _States(
        speed=np.hypot(vx, vy),
        omega=of_fit.omega + rate["phi"],
        phi=of_fit.phi + residual["phi"].at(at)[0],
        t=of_fit.t,
    )
    sine = vx / measured.speed
    cosine = vy / measured.speed
    of_path = np.array(
        [
            ax * cosine - ay * sine,
            ax * sine + ay * cosine,
            turning + acceleration["phi"],
        ]
    )
    by_spline = np.array(
        [
            np.hypot(error["x"] * cosine, error["y"] * sine),
            np.hypot(error["x"] * sine, error["y"] * cosine),
            error["phi"],
        ]
    )
    of_law = _accelerations(best, family, measured)
    return Lacking(
        law=label,
        speed=measured.speed,
        omega=measured.omega,
        of_law=of_law,
        lacks=of_path - of_law,
        stderr=np.hypot(by_spline, _errors(best, family, measured)),
        others={
            other: _accelerations(fit, family, measured) - of_law
            for other, fit in others.items()
        },
    )


def _measured_in_motion(fit: FitResult) -> Booleans:
    """Rows with x, y and angle in which the stone moves, each later than the one
    before."""
    t = fit.observed["t"]
    missing = np.full(len(t), np.nan)
    measured = [np.isfinite(fit.observed.get(name, missing)) for name in PLACE]
    speed = fit.fitted["speed"]
    moving = (speed > _SLOWEST * speed.max()) & np.all(measured, 0)
    rows: Booleans = moving & (np.diff(t, prepend=-np.inf) > 0)
    return rows


def _errors(fit: FitResult, family: type[LawFamily] | None, states: _States) -> Floats:
    """Standard errors of the accelerations of a fitted law by those of its
    coefficients, shape (3, POINTS)."""
    names = list(fit.coefficients)
    is_coefficient = np.isin(fit.covariance.names, names)
    is_free = np.isin(names, fit.covariance.names)
    if not is_free.any():
        return np.zeros((3, POINTS))
    typical = [estimate.typical for estimate in fit.coefficients.values()]
    by_coefficient = slopes(
        lambda values: _accelerations(fit, family, states, values),
        _coefficients(fit),
        _STEP * np.array(typical),
        is_free,
    )
    matrix = fit.covariance.matrix[np.ix_(is_coefficient, is_coefficient)]
    variance = ((by_coefficient @ matrix) * by_coefficient).sum(-1)
    errors: Floats = np.sqrt(np.maximum(variance, 0.0))
    return errors


def _coefficients(fit: FitResult) -> Floats:
    return np.array([estimate.value for estimate in fit.coefficients.values()])


def _accelerations(
    fit: FitResult,
    family: type[LawFamily] | None,
    states: _States,
    coefficients: Floats | None = None,
) -> Floats:
    """To the right of the motion, along it, and angular, of a fitted law or at other
    values of its coefficients; shape (3, POINTS)."""
    if coefficients is None:
        coefficients = _coefficients(fit)
    # one throw, whose path has the POINTS states
    accelerations = accelerations_along(
        fit.model.within(family),
        np.tile(coefficients, (1, POINTS, 1)),
        stacked([fit.stone]),
        np.array(states)[None],
        batch=1,
    )
    return accelerations[0]
