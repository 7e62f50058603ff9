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
from curlfit.inference.noise.linearized import (
    CHANNELS_AND_EVENTS,
    Linearized,
    regression_of,
)
from curlfit.noises import NOISES, Filter, Noise
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled

STATE = 6
"""Number of parameters of the initial state, the last of all."""
_AMPLITUDES = len(COMPONENTS) * SHAPES


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
    """G V^-1/2, shape (channels, n, parameters)"""
    determinant: Any = None
    """logarithm of the determinant of what follows the filter"""

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
        noise_filter = filter_of(noise, times, weight > 0)
        if not noise.has_discrepancy:
            return cls(noise_filter)
        n = weight.size
        directions = np.zeros((n, _AMPLITUDES + parameters))
        shrink = np.zeros(_AMPLITUDES + parameters)
        estimates = np.zeros((n, parameters))
        restored = np.zeros((n, parameters))
        determinant = 0.0
        if noise.sizes and data is not None:
            # G, and the estimates of the parameters that the data determine
            scale = scale_between(data.weight, weight)
            jacobian = _filtered(noise_filter, weight[..., None] * data.jacobian)
            determined = np.abs(data.from_standard).max(0) > 0
            basis, triangle = np.linalg.qr(jacobian[:, determined])
            end = _AMPLITUDES + int(determined.sum())
            directions[:, _AMPLITUDES:end] = basis
            shrink[_AMPLITUDES:end] = 1.0
            weights = scale[:, None, None] * data.weight[..., None]
            estimates = (weights * data.jacobian).reshape(n, -1)

            # V^-1/2
            covariance = data.covariance(noise, times, scale)
            to_state = data.to_standard[:, -STATE:]
            covariance += to_state @ np.array(noise.initial_state) @ to_state.T
            variances, axes = np.linalg.eigh(covariance[determined][:, determined])
            restored[:, determined] = basis @ (axes / np.sqrt(variances)) @ axes.T

            # the directions of the discrepancy that are orthogonal to G
            root = amplitude_root(
                _sizes_of(noise), data.held @ np.asarray(data.coupling)
            )
            adjusted = weight[..., None] * np.asarray(data.adjusted_responses)
            responses = _filtered(noise_filter, adjusted) @ root
            responses -= basis @ (basis.T @ responses)
            left, singular, _ = np.linalg.svd(responses, full_matrices=False)
            directions[:, : len(singular)] = left
            shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)

            determinant = np.log1p(-shrink[:_AMPLITUDES]).sum()
            determinant -= np.log(variances).sum() / 2
            determinant -= np.log(np.abs(np.diag(triangle))).sum()
        shape = (*weight.shape, -1)
        return cls(
            noise_filter,
            directions.reshape(shape),
            shrink,
            estimates.reshape(shape),
            restored.reshape(shape),
            np.asarray(determinant),
        )

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood;
        shape (channels,)."""
        by_channel = np.array(self.filter.log_determinant())
        if self.determinant is not None:
            by_channel[0] += self.determinant  # of all channels together
        return by_channel


def filter_of(noise: Noise, times: Floats, seen: Any) -> Filter:
    """The filter of a noise with its estimates, at times in s; rows beyond the
    channels are independent.

    Parameters
    ----------
    seen : which values were observed, shape (channels, n).
    """
    values = {}
    for name, independent in noise.parameters.items():
        estimates = getattr(noise, name)
        values[name] = np.array(
            [
                estimates.get(channel, independent)
                for channel in CHANNELS_AND_EVENTS[: len(seen)]
            ]
        )
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
    is_observed = largest > 0
    ratio = before.max(1) / np.where(is_observed, largest, 1.0)
    return np.where(is_observed, ratio, 1.0)


def posterior_mean(
    noise: Noise, times: Floats, weight: Floats, data: Linearized
) -> Floats:
    """Mean of the discrepancy given the residuals (Rasmussen and Williams 2006,
    eq. 2.25), beside the path of the law; SI, shape (channels, n).

    Parameters
    ----------
    times : s since the first row, shape (n,).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
    data : the fit with independent noise to first order.
    """
    noise_filter = filter_of(noise, times, data.weight > 0)
    scale = scale_between(data.weight, weight)
    regression = regression_of(data, noise_filter, scale)
    mean: Floats = np.asarray(data.adjusted_responses) @ regression.mean(
        _sizes_of(noise)
    )
    return mean


def _filtered(noise_filter: Filter, columns: Floats) -> Floats:
    """Columns after a filter, shape (values of all channels, columns)."""
    innovations = np.array(noise_filter.innovations(columns))
    return innovations.reshape(-1, innovations.shape[-1])
