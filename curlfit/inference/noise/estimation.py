"""Restricted likelihood of correlated noise, from the residuals of a fit with white noise.

The parameters of a noise model are those of greatest restricted likelihood (Patterson and Thompson
1971): of what no change of the parameters can make, since the fit has hidden the rest. The ratios
of the channels' sizes are taken from those residuals and held: else one channel would be fitted
perfectly and taken to be exact, and the others pay for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS, Throw

_FEWEST = 20  # values of a channel from which its noise is estimated
_MOST = 300  # values of a channel used; more are condensed to means
_FAR = (-30.0, 30.0)  # limits of all logarithms


class ChannelResiduals(NamedTuple):
    """A channel's residuals over sigma, where observed, condensed."""

    name: str
    t: Floats
    both: Floats
    """residuals, and an orthonormal basis of the Jacobian over all channels; shape (rows, 1 + p)"""
    uneven: Floats
    """1/sigma of a row, over the channel's"""
    scale: float
    """sigma of the channel, SI"""
    block: int
    """rows that a mean is of"""
    given: bool

    @classmethod
    def of(
        cls, name: str, throw: Throw, residual: Floats, basis: Floats, weight: Floats
    ) -> ChannelResiduals:
        """Those of a row of the data."""
        there = weight > 0
        block = -(-int(there.sum()) // _MOST)
        typical = float(np.sqrt(np.mean(weight[there] ** 2)))
        both = np.column_stack([residual, basis])[there]
        return cls(
            name, block_means(throw.t[there] - throw.t[0], block),
            math.sqrt(block) * block_means(both, block),
            block_means(weight[there] / typical, block), 1 / typical, block, name in throw.sigma,
        )  # fmt: skip

    @property
    def squares(self) -> float:
        """Mean square of the residuals."""
        return float(np.mean(self.both[:, 0] ** 2)) + 1e-20


def channel_residuals(
    throw: Throw, residual: Floats, jacobian: Floats, weight: Floats
) -> list[ChannelResiduals]:
    """Those of the channels with values enough to estimate a noise.

    Parameters
    ----------
    residual, jacobian : over sigma, shapes (channels, n) and (channels, n, free parameters).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).

    Raises
    ------
    InputError : all channels are of few values.
    """
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]].reshape(*residual.shape, -1)
    channels = [
        ChannelResiduals.of(name, throw, residual[row], basis[row], weight[row])
        for row, name in enumerate(CHANNELS[: len(residual)])
        if (weight[row] > 0).sum() >= _FEWEST
    ]
    if not channels:
        raise InputError(f"{throw.name}: too few values to estimate a correlation of the noise")
    return channels


def most_likely(
    roots: Callable[[Floats], list[tuple[Floats, float]]], starts: list[list[float]]
) -> Floats:
    """The logarithms of greatest restricted likelihood.

    Parameters
    ----------
    roots : from such logarithms, by channel, the residuals and then the basis of the Jacobian, made
        independent, and half the log-determinant of the covariance.
    """
    from scipy.optimize import minimize

    def minus_log_likelihood(logs: Floats) -> float:
        try:
            parts = roots(np.clip(logs, *_FAR))
        except np.linalg.LinAlgError:
            return math.inf
        white = np.concatenate([part for part, _ in parts])
        q, triangle = np.linalg.qr(white[:, 1:])
        left = white[:, 0] - q @ (q.T @ white[:, 0])
        spent = float(np.log(np.abs(np.diag(triangle))).sum())
        return sum(half for _, half in parts) + spent + float(left @ left) / 2

    found = [
        minimize(
            minus_log_likelihood,
            start,
            method="Nelder-Mead",
            options={"xatol": 0.02, "fatol": 1e-3},
        )
        for start in starts
    ]
    return np.clip(min(found, key=lambda item: float(item.fun)).x, *_FAR)


def block_means(values: Floats, block: int) -> Floats:
    """Means over blocks of rows; a last block that is not full is left out."""
    whole = len(values) // block * block
    return np.asarray(values[:whole].reshape(whole // block, block, *values.shape[1:]).mean(1))
