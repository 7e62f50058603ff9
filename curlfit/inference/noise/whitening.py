"""Whitening: residuals with correlated noise, or a discrepancy, made independent.

Generalised least squares is least squares of whitened residuals.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.accelerations import COMPONENTS, SHAPES
from curlfit.inference.noise.kalman import KalmanFilter
from curlfit.inference.noise.linearized import Linearized, Regression, regression_of
from curlfit.inference.noise.models import Noise
from curlfit.numerics.arrays import Floats

STATE = 6
"""Number of parameters of the initial state, the last of all."""
_COUNT = len(COMPONENTS) * SHAPES + STATE


class Whitener(NamedTuple):
    """Makes residuals with correlated noise independent.

    After the filter, each direction u of the residuals in which the discrepancy is s times the
    noise is scaled down by sqrt(1 + s^2): with C = 1 + U diag(s^2) U^T,
    C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
    """

    filter: KalmanFilter
    directions: Any = None
    """orthonormal, shape (channels, n, k); None without a discrepancy"""
    shrink: Any = None
    """1 - 1/sqrt(1 + s^2) by direction, shape (k,)"""

    @classmethod
    def of(
        cls, noise: Noise, times: Floats, weight: Floats, data: Linearized | None = None
    ) -> Self | None:
        """The whitener of a noise model; None where that is white.

        It changes nothing where the noise has neither a memory nor a size.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        data : the fitted path, with these weights; None for a noise that has no size yet.
        """
        if noise.kind == "white":
            return None
        own = KalmanFilter.of_noise(noise, times, weight > 0)
        if noise.kind != "discrepancy":
            return cls(own)
        directions, shrink = np.zeros((weight.size, _COUNT)), np.zeros(_COUNT)
        if noise.sizes and data is not None:
            rows = _discrepancy_rows(noise, own, data)
            q, r = np.linalg.qr(rows.reshape(-1, _COUNT))  # faster than an SVD of all rows
            left, singular, _ = np.linalg.svd(r, full_matrices=False)
            directions[:, : left.shape[1]] = q @ left
            shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)
        return cls(own, directions.reshape(*weight.shape, _COUNT), shrink)

    def whiten(self, residual: Array) -> Array:
        """Whitened residuals from residuals over sigma, shape (channels, n)."""
        white = self.filter.innovations(residual[..., None])[..., 0]
        if self.directions is None:
            return white
        along = jnp.einsum("cnk,cn->k", self.directions, white) * self.shrink
        return white - jnp.einsum("cnk,k->cn", self.directions, along)

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood; shape (channels,)."""
        found = np.array(self.filter.log_determinant())
        if self.shrink is not None:
            found[0] += np.log1p(-self.shrink).sum()  # of all channels together
        return found


def whitened(residual: Array, whitener: Whitener | None) -> Array:
    """Whitened residuals from residuals over sigma, shape (channels, n)."""
    return residual if whitener is None else whitener.whiten(residual)


def _discrepancy_rows(noise: Noise, own: KalmanFilter, data: Linearized) -> Floats:
    """B of the covariance 1 + B B^T of the residuals after the filter, shape (channels, n, k).

    First what no change of the parameters can produce, then that of the initial state."""
    regression = _numpy(regression_of(own, data))
    columns = np.asarray(own.innovations(data.columns))
    p, q = len(data.held.T), STATE
    paid = columns[..., p:-1] - columns[..., :p] @ regression.change[:, :-1]
    values, axes = np.linalg.eigh(np.array(noise.initial_state))
    spread = axes * np.sqrt(np.maximum(values, 0.0))
    of_state = columns[..., :p] @ data.to_standard[:, -q:] @ spread
    return np.concatenate([paid @ regression.posterior(noise.all_sizes)[2], of_state], -1)


def posterior_mean(noise: Noise, times: Floats, data: Linearized) -> Floats:
    """Mean of the discrepancy given the residuals (Rasmussen and Williams 2006, eq. 2.25), beside
    the path of the law; SI, shape (channels, n)."""
    own = KalmanFilter.of_noise(noise, times, data.weight > 0)
    regression = _numpy(regression_of(own, data))
    lower, white, root = map(np.asarray, regression.posterior(noise.all_sizes))
    amplitudes = root @ np.linalg.solve(lower.T, white)
    by_parameters = data.jacobian @ (regression.change[:, :-1] @ amplitudes)
    found: Floats = data.responses @ amplitudes - by_parameters
    return found


def _numpy(regression: Regression) -> Regression:
    found: Regression = jax.tree.map(np.asarray, regression)
    return found
