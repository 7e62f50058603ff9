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
_MOST_INTERVALS = 30
_ROWS = 6  # per interval, at least
_POINTS = 8  # per interval, for the integral of the penalty
_RIDGE = 1e-10  # of the mean square, added where amplitudes are not determined
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

        intervals = min(_MOST_INTERVALS, len(t) // _ROWS)
        inner = np.linspace(t[0], t[-1], intervals + 1)
        before = np.full(_DEGREE, t[0])
        after = np.full(_DEGREE, t[-1])
        knots = np.concatenate([before, inner, after])
        rows = _basis(knots, t, 0)
        ends = np.linspace(t[0], t[-1], _POINTS * intervals + 1)
        bends = _basis(knots, (ends[1:] + ends[:-1]) / 2, _PENALISED)
        # Both matrices diagonal: independent amplitudes z, of which `rough` are
        # the penalties.
        normal = rows.T @ rows
        normal += _RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        root = np.linalg.inv(np.linalg.cholesky(normal))
        rough, axes = np.linalg.eigh(root @ bends.T @ bends @ root.T)
        rough[:_PENALISED] = 0.0
        from_z = root.T @ axes
        z = from_z.T @ (rows.T @ values)
        degrees_of_freedom = len(t) - _PENALISED

        def shrinkage(log: Any) -> Any:
            """Factor of each amplitude, under a penalty by its logarithm."""
            return 1 / (1 + np.exp(log) * rough)

        def variance(log: Any) -> Any:
            """Estimate of the variance of the noise."""
            return (values @ values - z**2 @ shrinkage(log)) / degrees_of_freedom

        def criterion(log: Any) -> Any:
            """-2 times the logarithm of the restricted likelihood, up to a constant."""
            determinants = np.log1p(np.exp(log) * rough).sum()
            determinants = determinants - (len(z) - _PENALISED) * log
            return degrees_of_freedom * np.log(variance(log)) + determinants

        grid = _RANGE - np.log(np.median(rough[_PENALISED:]))
        near = min(grid, key=criterion)
        log = minimize_scalar(
            criterion, bounds=(near - 1, near + 1), method="bounded"
        ).x
        factors = shrinkage(log)
        covariance = variance(log) * (from_z * factors) @ from_z.T
        return cls(knots, from_z @ (factors * z), covariance)

    def at(self, t: Floats, derivative: int = 0) -> tuple[Floats, Floats]:
        """Value or derivative at times, and its standard error."""
        rows = _basis(self.knots, t, derivative)
        error = np.sqrt(np.maximum(((rows @ self.covariance) * rows).sum(1), 0.0))
        return rows @ self.amplitudes, error


def _basis(knots: Floats, t: Floats, derivative: int) -> Floats:
    """The B-splines or their derivatives at times, shape (times, splines)."""
    from scipy.interpolate import BSpline  # slow to load

    unit_amplitudes = np.eye(len(knots) - _DEGREE - 1)
    splines: Floats = BSpline(knots, unit_amplitudes, _DEGREE)(t, derivative)
    return splines
