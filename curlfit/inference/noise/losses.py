"""Robust losses: how much a residual counts when it is too large to be noise.

Each replaces the square of a residual r (in units of its sigma) by rho(r), which grows
more slowly. Least squares minimises the sum of rho as the square of `sqrt(rho)` with
the sign of r, so that one solver serves all. The constants of huber and cauchy are
those of 95 % efficiency for Gaussian noise (Huber 1981; Holland and Welsch 1977);
Student's t has 4 degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from curlfit.inference.noise.models import LOSSES
from curlfit.numerics.arrays import Floats
from curlfit.numerics.namespace import namespace

_HUBER = 1.345
_CAUCHY = 2.385
_DEGREES = 4.0


def _log_ratio(q: Any) -> Any:
    """log(1 + q)/q, also at 0."""
    xp, small = namespace(q), q < 1e-8
    return xp.where(small, 1 - q / 2, xp.log1p(q) / xp.where(small, 1.0, q))


def _huber(r: Any) -> Any:
    xp, size = namespace(r), abs(r)
    outer = xp.sqrt(xp.maximum(2 * _HUBER * size - _HUBER**2, _HUBER**2))
    return xp.where(size <= _HUBER, r, xp.sign(r) * outer)


def _soft(r: Any) -> Any:
    xp = namespace(r)
    return r * xp.sqrt(2 / (xp.sqrt(1 + r**2) + 1))


def _cauchy(r: Any) -> Any:
    return r * namespace(r).sqrt(_log_ratio(r**2 / _CAUCHY**2))


def _student(r: Any) -> Any:
    return r * namespace(r).sqrt((1 + 1 / _DEGREES) * _log_ratio(r**2 / _DEGREES))


_ROOTS: tuple[Callable[[Any], Any], ...] = (
    lambda r: r,
    _huber,
    _soft,
    _cauchy,
    _student,
)


def signed_root(r: Any, loss: Any) -> Any:
    """sqrt(rho) with the sign of r, for NumPy or JAX; `loss` is an index in
    `LOSSES`, a scalar.

    A compiled program contains all losses where `loss` is traced, one where it
    is a number.
    """
    if isinstance(loss, jax.Array):
        return jax.lax.switch(loss, _ROOTS, jnp.asarray(r))
    return _ROOTS[int(loss)](r)


class Influence(NamedTuple):
    """Influence of a residual on the optimum: psi = rho'/2, and its slope."""

    psi: Floats
    slope: Floats


def influence(r: Floats, loss: str) -> Influence:
    """psi and its slope at residuals in units of their sigma."""
    z = r**2
    if loss == "huber":
        return Influence(
            np.clip(r, -_HUBER, _HUBER), (np.abs(r) <= _HUBER).astype(float)
        )
    if loss == "soft-l1":
        return Influence(r / np.sqrt(1 + z), (1 + z) ** -1.5)
    if loss == "cauchy":
        q = 1 + z / _CAUCHY**2
        return Influence(r / q, (2 - q) / q**2)
    if loss == "student":
        n = _DEGREES
        return Influence(r * (n + 1) / (n + z), (n + 1) * (n - z) / (n + z) ** 2)
    return Influence(r, np.ones_like(r))


def log_density(r: Floats, loss: str) -> Floats:
    """Log of the density exp(-rho/2) of noise of unit sigma, which integrates to 1.

    Every loss is the likelihood of some noise: Gaussian (linear); Gaussian with
    exponential tails (huber); hyperbolic (soft-l1); Student's t, with 4 degrees of
    freedom (student) or, widened, with 4.7 (cauchy).
    """
    return -(signed_root(r, LOSSES.index(loss)) ** 2) / 2 - np.log(_NORMS[loss])


_BESSEL_K1 = 0.6019072301972346
"""K_1(1), so as not to load `scipy.special` for it alone."""


def _beta(a: float, b: float) -> float:
    return math.gamma(a) * math.gamma(b) / math.gamma(a + b)


_NORMS = {
    "linear": np.sqrt(2 * np.pi),
    "huber": np.sqrt(2 * np.pi) * math.erf(_HUBER / np.sqrt(2))
    + 2 * np.exp(-(_HUBER**2) / 2) / _HUBER,
    "soft-l1": 2 * np.exp(1.0) * _BESSEL_K1,
    "cauchy": _CAUCHY * _beta(0.5, (_CAUCHY**2 - 1) / 2),
    "student": np.sqrt(_DEGREES) * _beta(0.5, _DEGREES / 2),
}


def likeliest_sigma(residual: Floats, loss: str, floor: float = 1e-12) -> float:
    """Maximum-likelihood sigma of residuals: their rms where the loss is linear."""
    largest = float(np.abs(residual).max(initial=0.0))
    if loss == "linear" or largest <= floor:
        return max(
            float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0, floor
        )

    # of the log-likelihood by log sigma, per value
    def slope(log_sigma: float) -> float:
        r = residual / np.exp(log_sigma)
        return float(np.mean(r * influence(r, loss).psi)) - 1

    low, high = np.log(floor), np.log(largest)
    from scipy.optimize import brentq  # slow to load

    return float(np.exp(brentq(slope, low, high))) if slope(low) > 0 else floor


def precision(r: Floats, loss: str) -> float:
    """Information of a residual over that of a Gaussian one of the same sigma
    (Huber 1981)."""
    if loss == "linear" or not len(r):
        return 1.0
    found = influence(r, loss)
    slope = max(float(found.slope.mean()), 0.05)
    return slope**2 / max(float((found.psi**2).mean()), 1e-300)


MAD_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""


def robust_sigma(values: Floats) -> float:
    """Standard deviation of the bulk: 1.4826 times the median absolute value."""
    return MAD_TO_SIGMA * float(np.median(np.abs(values))) if len(values) else 0.0


def root_slope(r: Floats, loss: str) -> Floats:
    """Derivative of `signed_root` by r."""
    if loss == "linear":
        return np.ones_like(r)
    size = np.maximum(np.abs(r), 1e-6)  # even in r, and flat at 0
    return influence(size, loss).psi / np.asarray(signed_root(size, LOSSES.index(loss)))
