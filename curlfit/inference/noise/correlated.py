"""Correlated noise made independent: generalised least squares as least squares.

Of "ar1" noise each residual loses what the row before it predicts. Of "gp" noise every smooth
direction u, in which the discrepancy has s times the size of the independent noise, is scaled down
by sqrt(1 + s^2): with C = 1 + U diag(s^2) U^T, C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.linalg import eigh

from curlfit.inference.noise.models import Noise, ar1_correlation, matern
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS

_GRID = 400  # times at which a discrepancy is drawn
_MODES = 32  # of a discrepancy that are kept


class AutoregressiveWhitener(NamedTuple):
    """What whitens "ar1" noise; arrays of the shape of the data (channels, n)."""

    before: Any
    """row that was observed before this one"""
    carry: Any
    """correlation with it"""
    scale: Any
    """1 over the part of sigma that it does not predict"""


class DiscrepancyWhitener(NamedTuple):
    """What whitens "gp" noise."""

    directions: Any
    """orthonormal by channel, shape (channels, n, k)"""
    shrink: Any
    """1 - 1/sqrt(1 + s^2) by direction, shape (channels, k)"""


Whitener = AutoregressiveWhitener | DiscrepancyWhitener | None


def whitened(residual: Array, whitener: Whitener) -> Array:
    """Residuals over sigma, made independent; shape (channels, n)."""
    if whitener is None:
        return residual
    if isinstance(whitener, AutoregressiveWhitener):
        predicted = whitener.carry * jnp.take_along_axis(residual, whitener.before, axis=1)
        return (residual - predicted) * whitener.scale
    along = jnp.einsum("cnk,cn->ck", whitener.directions, residual) * whitener.shrink
    return residual - jnp.einsum("cnk,ck->cn", whitener.directions, along)


def log_determinant(whitener: Whitener) -> Floats:
    """Log-determinant of the whitening by channel, shape (channels,): what it adds to the
    log-likelihood of the residuals over sigma."""
    if isinstance(whitener, AutoregressiveWhitener):
        return np.asarray(np.log(whitener.scale).sum(-1))
    if whitener is None:
        return np.zeros(len(CHANNELS))
    return np.asarray(np.log1p(-whitener.shrink).sum(-1))


def whitener_of(noise: Noise, times: Floats, weight: Floats) -> Whitener:
    """What makes a noise independent; it changes nothing where the noise has no memory and no size.

    Parameters
    ----------
    times : s since the first row, shape (n,). weight : 1/sigma, 0 where nothing was observed, shape
        (channels, n).
    """
    if noise.kind == "ar1":
        return _memory(noise, times, weight)
    if noise.kind == "gp":
        return _smooth(noise, times, weight)
    return None


def _memory(noise: Noise, times: Floats, weight: Floats) -> AutoregressiveWhitener:
    before = np.tile(np.arange(weight.shape[1]), (len(weight), 1))
    carry, scale = np.zeros_like(weight), np.ones_like(weight)
    for row, name in enumerate(CHANNELS[: len(weight)]):
        seen = np.flatnonzero(weight[row] > 0)
        if name in noise.memory:
            steps = ar1_correlation(np.diff(times[seen]), noise.memory[name])
            before[row, seen[1:]] = seen[:-1]
            carry[row, seen[1:]] = steps
            scale[row, seen[1:]] = 1 / np.sqrt(1 - steps**2)
    return AutoregressiveWhitener(before, carry, scale)


def _smooth(noise: Noise, times: Floats, weight: Floats) -> DiscrepancyWhitener:
    directions = np.zeros((*weight.shape, _MODES))
    shrink = np.zeros((len(weight), _MODES))
    if not noise.sizes:
        return DiscrepancyWhitener(directions, shrink)
    grid = np.linspace(0.0, noise.span, _GRID)
    at_times = np.array([np.interp(times, grid, mode) for mode in _modes().T]).T
    for row, name in enumerate(CHANNELS[: len(weight)]):
        if name in noise.sizes:
            response = noise.sizes[name] * weight[row][:, None] * at_times
            left, singular, _ = np.linalg.svd(response, full_matrices=False)
            directions[row], shrink[row] = left, 1 - 1 / np.sqrt(1 + singular**2)
    return DiscrepancyWhitener(directions, shrink)


@cache
def _modes() -> Floats:
    """The greatest modes of the kernel on a grid over the time of motion, shape (grid, modes): the
    j-th has some j^-6 of the variance."""
    grid = np.linspace(0.0, 1.0, _GRID)
    squares, shapes = eigh(
        matern(grid[:, None] - grid, 1.0), subset_by_index=(_GRID - _MODES, _GRID - 1)
    )
    return np.asarray(shapes * np.sqrt(np.maximum(squares, 0.0)))
