"""A smooth function of time under noisy values, and its derivatives, with their errors.

A spline of order 5 whose third derivative is penalised; smoothness and noise by
restricted maximum likelihood. As the mean of a Gaussian process (Wahba 1983, Journal of
the Royal Statistical Society B 45, 133) its errors contain what smoothing may hide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from curlfit.numerics.arrays import Floats

_DEGREE = 5
_PENALISED = 3  # the derivative; a parabola is free
_MOST = 30  # intervals
_ROWS = 6  # per interval, at least
_POINTS = 8  # per interval, for the integral of the penalty
# of the logarithm of the penalty, about its scale
_RANGE = np.linspace(-30.0, 30.0, 121)


@dataclass(frozen=True)
class PenalizedSpline:
    """The function: amplitudes of B-splines between `knots` and their covariance."""

    knots: Floats
    amplitudes: Floats
    covariance: Floats

    @classmethod
    def of(cls, t: Floats, values: Floats) -> Self:
        """From values at times that increase; at least 20, with independent errors
        of one size."""
        from scipy.optimize import minimize_scalar  # slow to load

        intervals = min(_MOST, len(t) // _ROWS)
        ends = np.full(_DEGREE, t[0]), np.full(_DEGREE, t[-1])
        knots = np.concatenate(
            [ends[0], np.linspace(t[0], t[-1], intervals + 1), ends[1]]
        )
        rows, fine = (
            _basis(knots, t, 0),
            np.linspace(t[0], t[-1], _POINTS * intervals + 1),
        )
        bent = _basis(knots, (fine[1:] + fine[:-1]) / 2, _PENALISED)
        # Both matrices diagonal: independent amplitudes z, of which `rough` are
        # the penalties.
        normal = rows.T @ rows
        normal += 1e-10 * np.trace(normal) / len(normal) * np.eye(len(normal))
        root = np.linalg.inv(np.linalg.cholesky(normal))
        rough, axes = np.linalg.eigh(root @ bent.T @ bent @ root.T)
        rough[:_PENALISED] = 0.0
        back = root.T @ axes
        z, free = back.T @ (rows.T @ values), len(t) - _PENALISED

        def variance(log: Any) -> Any:
            return (values @ values - z**2 @ (1 / (1 + np.exp(log) * rough))) / free

        def criterion(log: Any) -> Any:
            """-2 times the logarithm of the restricted likelihood, up to a constant."""
            spent = np.log1p(np.exp(log) * rough).sum() - (len(z) - _PENALISED) * log
            return free * np.log(variance(log)) + spent

        around = _RANGE - np.log(np.median(rough[_PENALISED:]))
        near = min(around, key=criterion)
        log = minimize_scalar(
            criterion, bounds=(near - 1, near + 1), method="bounded"
        ).x
        kept = 1 / (1 + np.exp(log) * rough)
        return cls(knots, back @ (kept * z), variance(log) * (back * kept) @ back.T)

    def at(self, t: Floats, derivative: int = 0) -> tuple[Floats, Floats]:
        """Value or derivative at times, and its standard error."""
        rows = _basis(self.knots, t, derivative)
        error = np.sqrt(np.maximum(((rows @ self.covariance) * rows).sum(1), 0.0))
        return rows @ self.amplitudes, error


def _basis(knots: Floats, t: Floats, derivative: int) -> Floats:
    """The B-splines or their derivatives at times, shape (times, splines)."""
    from scipy.interpolate import BSpline  # slow to load

    unit = np.eye(len(knots) - _DEGREE - 1)
    found: Floats = BSpline(knots, unit, _DEGREE)(t, derivative)
    return found
