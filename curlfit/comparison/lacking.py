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
from typing import Any

import numpy as np

from curlfit.comparison.result import PLACE, Lacking
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.initial_values import POINTS, accelerations_along
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked
from curlfit.numerics.differences import slopes
from curlfit.numerics.penalized_spline import PenalizedSpline

_STEP = 1e-3  # typical sizes, of differences
_FEWEST = 40  # rows in which the stone moves
_SLOWEST = 0.1  # over the initial speed: below, what is lacking changes too fast


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
    observed, fitted = best.observed, best.fitted
    moving = (fitted["speed"] > _SLOWEST * fitted["speed"].max()) & np.all(
        [
            np.isfinite(observed.get(name, np.full(len(observed["t"]), np.nan)))
            for name in PLACE
        ],
        0,
    )
    moving &= np.diff(observed["t"], prepend=-np.inf) > 0
    if moving.sum() < _FEWEST or best.model.conditions or best.data["swept"]:
        return None
    t = observed["t"][moving]
    at = np.linspace(t[0], t[-1], POINTS)
    left = {
        name: PenalizedSpline.of(t, observed[name][moving] - fitted[name][moving])
        for name in PLACE
    }
    (dx, _), (dy, _), (spun, _) = (left[name].at(at, 1) for name in PLACE)
    (ax, x_error), (ay, y_error), (angular, angle_error) = (
        left[name].at(at, 2) for name in PLACE
    )
    speed, omega, phi = (
        np.interp(at, t, fitted[name][moving]) for name in ("speed", "omega", "phi")
    )
    steps = [np.gradient(fitted[name][moving], t) for name in ("x", "y")]
    heading = np.interp(at, t, np.unwrap(np.arctan2(*steps)))
    since = at - observed["t"][0]
    xi, eta, turning = _accelerations(best, family, speed, omega, phi, since)
    sine, cosine = np.sin(heading), np.cos(heading)
    vx, vy = speed * sine + dx, speed * cosine + dy
    ax, ay = xi * cosine + eta * sine + ax, eta * cosine - xi * sine + ay
    speed, omega = np.hypot(vx, vy), omega + spun
    sine, cosine = vx / speed, vy / speed
    whole = np.array(
        [ax * cosine - ay * sine, ax * sine + ay * cosine, turning + angular]
    )
    state = speed, omega, phi + left["phi"].at(at)[0], since
    law, by_coefficients = (
        _accelerations(best, family, *state),
        _errors(best, family, *state),
    )
    by_spline = np.array(
        [
            np.hypot(x_error * cosine, y_error * sine),
            np.hypot(x_error * sine, y_error * cosine),
            angle_error,
        ]
    )
    return Lacking(
        label,
        speed,
        omega,
        law,
        whole - law,
        np.hypot(by_spline, by_coefficients),
        {
            name: _accelerations(one, family, *state) - law
            for name, one in others.items()
        },
    )


def _errors(fit: FitResult, family: type[LawFamily] | None, *state: Floats) -> Floats:
    """Standard errors of these by those of the coefficients, which follow what
    is left too."""
    names = list(fit.coefficients)
    known = np.isin(fit.covariance["names"], names)
    free = np.isin(names, fit.covariance["names"])
    if not free.any():
        return np.zeros((3, POINTS))
    by_coefficient = slopes(
        lambda values: _accelerations(fit, family, *state, values=values),
        _values(fit),
        _STEP * np.array([one.typical for one in fit.coefficients.values()]),
        free,
    )
    matrix = np.array(fit.covariance["matrix"])[np.ix_(known, known)]
    variance = ((by_coefficient @ matrix) * by_coefficient).sum(-1)
    found: Floats = np.sqrt(np.maximum(variance, 0.0))
    return found


def _values(fit: FitResult) -> Floats:
    return np.array([item.value for item in fit.coefficients.values()])


def _accelerations(
    fit: FitResult,
    family: type[LawFamily] | None,
    *state: Floats,
    values: Floats | None = None,
) -> Floats:
    """To the right of the motion, along it, and angular, of a fitted law or at other
    values of its coefficients; shape (3, POINTS)."""
    coefficients: Any = np.tile(
        _values(fit) if values is None else values, (1, POINTS, 1)
    )
    found = accelerations_along(
        fit.model.within(family),
        coefficients,
        stacked([fit.stone]),
        np.array(state)[None],
        batch=1,
    )
    return found[0]
