"""Noise that goes together, made independent: generalised least squares as least squares.

Of "ar1" noise each residual loses what the row before foretells. Of "gp" noise every smooth
direction u, in which the discrepancy has s times the size of the independent noise, is scaled down
by sqrt(1 + s^2): with C = 1 + U diag(s^2) U^T, C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray
from scipy.linalg import eigh

from curlfit.inference.noise.models import Noise, alike, matern
from curlfit.throws.throw import CHANNELS

Floats = NDArray[np.float64]

_GRID = 400  # times at which a discrepancy is drawn
_MODES = 32  # of a discrepancy that are told from noise


class Memory(NamedTuple):
    """What whitens "ar1" noise; arrays of the shape of the data (channels, n)."""

    before: Any
    """row that was seen before this one"""
    carry: Any
    """correlation with it"""
    scale: Any
    """1 over the part of sigma that it does not foretell"""


class Smooth(NamedTuple):
    """What whitens "gp" noise."""

    directions: Any
    """orthonormal by channel, shape (channels, n, k)"""
    shrink: Any
    """1 - 1/sqrt(1 + s^2) by direction, shape (channels, k)"""


Colour = Memory | Smooth | None


def whitened(residual: Array, colour: Colour) -> Array:
    """Residuals over sigma, made independent; shape (channels, n)."""
    if colour is None:
        return residual
    if isinstance(colour, Memory):
        predicted = colour.carry * jnp.take_along_axis(residual, colour.before, axis=1)
        return (residual - predicted) * colour.scale
    along = jnp.einsum("cnk,cn->ck", colour.directions, residual) * colour.shrink
    return residual - jnp.einsum("cnk,ck->cn", colour.directions, along)


def colour_of(noise: Noise, times: Floats, weight: Floats) -> Colour:
    """What whitens a noise.

    Parameters
    ----------
    times : s since the first row, shape (n,). weight : 1/sigma, 0 where nothing was seen, shape
        (channels, n).
    """
    if noise.kind == "ar1":
        return _memory(noise, times, weight)
    if noise.kind == "gp":
        return _smooth(noise, times, weight)
    return None


def _memory(noise: Noise, times: Floats, weight: Floats) -> Memory:
    before = np.tile(np.arange(weight.shape[1]), (len(weight), 1))
    carry, scale = np.zeros_like(weight), np.ones_like(weight)
    for row, name in enumerate(CHANNELS[: len(weight)]):
        seen = np.flatnonzero(weight[row] > 0)
        if name in noise.memory:
            steps = alike(np.diff(times[seen]), noise.memory[name])
            before[row, seen[1:]] = seen[:-1]
            carry[row, seen[1:]] = steps
            scale[row, seen[1:]] = 1 / np.sqrt(1 - steps**2)
    return Memory(before, carry, scale)


def _smooth(noise: Noise, times: Floats, weight: Floats) -> Smooth:
    """From the greatest modes of the kernel on a grid: the j-th has some j^-6 of the variance."""
    directions = np.zeros((*weight.shape, _MODES))
    shrink = np.zeros((len(weight), _MODES))
    grid = np.linspace(0.0, noise.span, _GRID)
    kernel = matern(grid[:, None] - grid, noise.span)
    squares, shapes = eigh(kernel, subset_by_index=(_GRID - _MODES, _GRID - 1))
    modes = shapes * np.sqrt(np.maximum(squares, 0.0))
    there = np.array([np.interp(times, grid, mode) for mode in modes.T]).T
    for row, name in enumerate(CHANNELS[: len(weight)]):
        if name in noise.sizes:
            response = noise.sizes[name] * weight[row][:, None] * there
            left, singular, _ = np.linalg.svd(response, full_matrices=False)
            directions[row], shrink[row] = left, 1 - 1 / np.sqrt(1 + singular**2)
    return Smooth(directions, shrink)
