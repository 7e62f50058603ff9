"""Robust losses: how much a residual counts, once it is too large to be noise.

Each replaces the square of a residual r (in units of its sigma) by rho(r), which grows slower.
Least squares minimises the sum of rho as the square of `sqrt(rho)` with the sign of r, so that one
solver serves all. Constants are those of 95 % efficiency for Gaussian noise (Huber 1981; Holland
and Welsch 1977); Student's t has 4 degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from curlfit import backend  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from curlfit.parameters import LOSSES

Floats = NDArray[np.float64]
_HUBER = 1.345
_CAUCHY = 2.385
_DEGREES = 4.0


def _log_ratio(q: Array) -> Array:
    """log(1 + q)/q, also at 0."""
    small = q < 1e-8
    return jnp.where(small, 1 - q / 2, jnp.log1p(q) / jnp.where(small, 1.0, q))


def _huber(r: Array) -> Array:
    size = jnp.abs(r)
    outer = jnp.sqrt(jnp.maximum(2 * _HUBER * size - _HUBER**2, _HUBER**2))
    return jnp.where(size <= _HUBER, r, jnp.sign(r) * outer)


_ROOTS: tuple[Callable[[Array], Array], ...] = (
    lambda r: r,
    _huber,
    lambda r: r * jnp.sqrt(2 / (jnp.sqrt(1 + r**2) + 1)),
    lambda r: r * jnp.sqrt(_log_ratio(r**2 / _CAUCHY**2)),
    lambda r: r * jnp.sqrt((1 + 1 / _DEGREES) * _log_ratio(r**2 / _DEGREES)),
)


def signed_root(r: ArrayLike, loss: ArrayLike) -> Array:
    """sqrt(rho) with the sign of r; `loss` is a place in `LOSSES`, a scalar."""
    return jax.lax.switch(loss, _ROOTS, jnp.asarray(r))


class Influence(NamedTuple):
    """What a residual does to the optimum: psi = rho'/2, and its slope."""

    psi: Floats
    slope: Floats


def influence(r: Floats, loss: str) -> Influence:
    """psi and its slope at residuals in units of their sigma."""
    z = r**2
    if loss == "huber":
        return Influence(np.clip(r, -_HUBER, _HUBER), (np.abs(r) <= _HUBER).astype(float))
    if loss == "soft-l1":
        return Influence(r / np.sqrt(1 + z), (1 + z) ** -1.5)
    if loss == "cauchy":
        q = 1 + z / _CAUCHY**2
        return Influence(r / q, (2 - q) / q**2)
    if loss == "student":
        n = _DEGREES
        return Influence(r * (n + 1) / (n + z), (n + 1) * (n - z) / (n + z) ** 2)
    return Influence(r, np.ones_like(r))


def precision(r: Floats, loss: str) -> float:
    """Information of a residual over that of a Gaussian one of the same sigma (Huber 1981)."""
    if loss == "linear" or not len(r):
        return 1.0
    found = influence(r, loss)
    slope = max(float(found.slope.mean()), 0.05)
    return slope**2 / max(float((found.psi**2).mean()), 1e-300)


def robust_sigma(values: Floats) -> float:
    """Standard deviation of the bulk: 1.4826 times the median size."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def steepness(r: Floats, loss: str) -> Floats:
    """Derivative of `signed_root` by r."""
    if loss == "linear":
        return np.ones_like(r)
    size = np.maximum(np.abs(r), 1e-6)  # even in r, and flat at 0
    return influence(size, loss).psi / np.asarray(signed_root(size, LOSSES.index(loss)))
