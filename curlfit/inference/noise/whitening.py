"""Whitening: residuals with correlated noise, or a discrepancy, made independent.

Generalised least squares is least squares of whitened residuals.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.accelerations import COMPONENTS, SHAPES, amplitude_root
from curlfit.inference.noise.linearized import Linearized, regression_of
from curlfit.noises import NOISES, Filter, Noise
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.throws.channels import CHANNELS

STATE = 6
"""Number of parameters of the initial state, the last of all."""
_COUNT = len(COMPONENTS) * SHAPES


class Whitener(NamedTuple):
    """Makes residuals with correlated noise independent.

    Without a discrepancy, by the filter W of the noise alone. With one, the estimates
    are those of least squares, b = B^T r, and independent of the rest: after the
    filter, the changes with the parameters, of orthonormal basis G, are replaced by G
    V^-1/2 b with the covariance V of b, and each direction in which the discrepancy is
    s times the noise is scaled down by sqrt(1 + s^2).
    """

    filter: Filter
    directions: Any = None
    """orthonormal, shape (channels, n, k); None without a discrepancy"""
    shrink: Any = None
    """1 - 1/sqrt(1 + s^2) by direction, and 1 for those of G, shape (k,)"""
    estimates: Any = None
    """B, shape (channels, n, parameters)"""
    restored: Any = None
    """G V^-1/2, of that shape"""
    determinant: Any = None
    """of what follows the filter, its logarithm"""

    @classmethod
    def of(
        cls,
        noise: Noise,
        times: Floats,
        weight: Floats,
        parameters: int,
        data: Linearized | None = None,
    ) -> Self | None:
        """The whitener of a noise model; None where that is white.

        It changes nothing where the noise has neither a memory nor a size.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        parameters : their number.
        data : the fit with independent noise to first order; None for a noise that has
            no size yet.
        """
        if noise.is_white:
            return None
        own = filter_of(noise, times, weight > 0)
        if not noise.has_discrepancy:
            return cls(own)
        k, n = _COUNT, weight.size
        directions, shrink = np.zeros((n, k + parameters)), np.zeros(k + parameters)
        estimates, restored = np.zeros((2, n, parameters))
        determinant = 0.0
        if noise.sizes and data is not None:
            scale = scale_between(data.weight, weight)
            by_parameters = weight[..., None] * data.jacobian
            determined = np.abs(data.from_standard).max(0) > 0
            size = int(determined.sum())
            g, triangle = np.linalg.qr(_filtered(own, by_parameters)[:, determined])
            directions[:, k : k + size], shrink[k : k + size] = g, 1.0
            estimates = (
                scale[:, None, None] * data.weight[..., None] * data.jacobian
            ).reshape(n, -1)
            covariance = data.covariance(noise, times, scale)
            to_state = data.to_standard[:, -STATE:]
            covariance += to_state @ np.array(noise.initial_state) @ to_state.T
            values, axes = np.linalg.eigh(covariance[determined][:, determined])
            restored[:, determined] = g @ (axes / np.sqrt(values)) @ axes.T
            root = amplitude_root(
                _sizes_of(noise), data.held @ np.asarray(data.coupling)
            )
            rows = _filtered(own, weight[..., None] * np.asarray(data.paid)) @ root
            rows -= g @ (g.T @ rows)
            left, singular, _ = np.linalg.svd(rows, full_matrices=False)
            directions[:, : len(singular)] = left
            shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)
            determinant = np.log1p(-shrink[:k]).sum() - np.log(values).sum() / 2
            determinant -= np.log(np.abs(np.diag(triangle))).sum()
        shape = (*weight.shape, -1)
        return cls(
            own,
            directions.reshape(shape),
            shrink,
            estimates.reshape(shape),
            restored.reshape(shape),
            np.asarray(determinant),
        )

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood;
        shape (channels,)."""
        found = np.array(self.filter.log_determinant())
        if self.determinant is not None:
            found[0] += self.determinant  # of all channels together
        return found


def filter_of(noise: Noise, times: Floats, seen: Any) -> Filter:
    """The filter of a noise with its estimates, at times in s; rows beyond the
    channels are independent.

    Parameters
    ----------
    seen : which values were observed, shape (channels, n).
    """
    channels = [*CHANNELS, ""][: len(seen)]
    values = {}
    for name, independent in noise.parameters.items():
        of_channel = getattr(noise, name)
        values[name] = np.array([of_channel.get(row, independent) for row in channels])
    gaps = np.diff(times, append=times[-1])
    whitening: Filter = _filter(noise.kind, values, gaps, seen)
    in_numpy: Filter = jax.tree.map(np.asarray, whitening)
    return in_numpy


@compiled("kind")
def _filter(kind: str, values: dict[str, Array], gaps: Array, seen: Array) -> Filter:
    return NOISES[kind].filter(values, gaps, seen)


def _sizes_of(noise: Noise) -> Floats:
    """The sizes of a discrepancy as an array, shape (3,)."""
    return np.array(list(noise.sizes.values()))


@compiled()
def _whitened(whitener: Whitener, residual: Array) -> Array:
    white = whitener.filter.innovations(residual[..., None])[..., 0]
    if whitener.directions is None:
        return white
    along = jnp.einsum("cnk,cn->k", whitener.directions, white) * whitener.shrink
    estimates = jnp.einsum("cnp,cn->p", whitener.estimates, residual)
    return white - whitener.directions @ along + whitener.restored @ estimates


def whitened(residual: Array, whitener: Whitener | None) -> Array:
    """Whitened residuals from residuals over sigma, shape (channels, n)."""
    return residual if whitener is None else _whitened(whitener, residual)


def scale_between(before: Floats, weight: Floats) -> Floats:
    """Factor between weights before and now, by channel; 1 where nothing
    was observed."""
    largest = weight.max(1)
    return np.where(
        largest > 0, before.max(1) / np.where(largest > 0, largest, 1.0), 1.0
    )


def posterior_mean(
    noise: Noise, times: Floats, weight: Floats, data: Linearized
) -> Floats:
    """Mean of the discrepancy given the residuals (Rasmussen and Williams 2006,
    eq. 2.25), beside the path of the law; SI, shape (channels, n). Parameters as
    of `Whitener.of`."""
    own = filter_of(noise, times, data.weight > 0)
    regression = regression_of(data, own, scale_between(data.weight, weight))
    found: Floats = np.asarray(data.paid) @ regression.mean(_sizes_of(noise))
    return found


def _filtered(own: Filter, columns: Floats) -> Floats:
    found = np.array(own.innovations(columns))
    return found.reshape(-1, found.shape[-1])
