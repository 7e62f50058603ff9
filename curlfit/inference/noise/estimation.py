"""Restricted likelihood of correlated noise, from the residuals of a fit with white noise.

The parameters of a noise model are estimated from its restricted likelihood (Patterson and Thompson
1971), that of the part of the residuals that no change of the fitted parameters can produce, since
the fit has absorbed the rest. The ratios of the channels' sizes are taken from those residuals and
held fixed: otherwise one channel would be fitted perfectly and taken to be exact, at the expense of
the others.

Sums. The likelihood of AR(1) noise depends on a series only through sums of products over rows and
over neighbouring rows, by the gap between them. They are formed once, from all rows.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.noise.models import ar1_correlation
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS, Throw

_FEWEST = 20  # values of a channel, at least, for its noise to be estimated
_SAME_GAP = 0.02  # relative difference of gaps that count as equal


class ChannelResiduals(NamedTuple):
    """A channel's residuals over sigma, where observed."""

    name: str
    t: Floats
    """s since the first row"""
    residual: Floats
    basis: Floats
    """rows of an orthonormal basis of the Jacobian over all channels, shape (rows, p)"""
    weight: Floats
    """1/sigma of each row, SI"""
    given: bool
    """whether sigma was given"""

    @property
    def scale(self) -> float:
        """Sigma of the channel, SI; the smallest where it varies by row."""
        return float(1 / self.weight.max())

    @property
    def square(self) -> float:
        """Mean square of the residuals."""
        return float(np.mean(self.residual**2)) + 1e-20

    @property
    def gap(self) -> float:
        """Median time between rows, s."""
        return float(np.median(np.diff(self.t)))


def channel_residuals(
    throw: Throw, residual: Floats, jacobian: Floats, weight: Floats
) -> list[ChannelResiduals]:
    """Residuals of the channels with enough values to estimate their noise.

    Parameters
    ----------
    residual, jacobian : over sigma, shapes (channels, n) and (channels, n, free parameters).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).

    Raises
    ------
    InputError : no channel has enough values.
    """
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]].reshape(*residual.shape, -1)
    channels = []
    for row, name in enumerate(CHANNELS[: len(residual)]):
        there = weight[row] > 0
        if there.sum() >= _FEWEST:
            channels.append(
                ChannelResiduals(
                    name, throw.t[there] - throw.t[0], residual[row, there], basis[row, there],
                    weight[row, there], name in throw.sigma,
                )
            )  # fmt: skip
    if not channels:
        raise InputError(f"{throw.name}: too few values to estimate a correlation of the noise")
    return channels


class Sums(NamedTuple):
    """Sums of products of columns over the rows of a channel."""

    rows: int
    gaps: Floats
    """distinct times between neighbours, s"""
    pairs: Floats
    """number of pairs of neighbours by gap"""
    first: Floats
    """of the first row, shape (columns, columns)"""
    later: Floats
    """of the later of two neighbours, shape (gaps, columns, columns)"""
    earlier: Floats
    across: Floats
    """of neighbours, symmetric"""

    @classmethod
    def of(cls, columns: Floats, t: Floats) -> Self:
        """Sums for columns, shape (rows, columns), at times in s."""
        gaps = np.maximum(np.diff(t), 1e-9)
        groups = np.round(np.log(gaps) / _SAME_GAP).astype(int)
        distinct, group, counts = np.unique(groups, return_inverse=True, return_counts=True)
        shape = (len(distinct), columns.shape[1], columns.shape[1])
        later, earlier, across = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        for index in range(len(distinct)):
            rows = np.flatnonzero(group == index)
            after, before = columns[rows + 1], columns[rows]
            later[index], earlier[index] = after.T @ after, before.T @ before
            across[index] = after.T @ before + before.T @ after
        mean = np.bincount(group, gaps) / counts
        first = np.outer(columns[0], columns[0])
        return cls(len(columns), mean, counts.astype(float), first, later, earlier, across)

    def ar1(self, memory: float) -> tuple[Floats, float]:
        """Sums of products of the columns whitened as AR(1) noise of variance 1 and a correlation
        time in s, and half the log-determinant of its covariance."""
        steps = ar1_correlation(self.gaps, memory)[:, None, None]
        left = np.maximum(-np.expm1(-2 * self.gaps / memory), 1e-14)
        each = self.later + steps**2 * self.earlier - steps * self.across
        whole: Floats = self.first + (each / left[:, None, None]).sum(0)
        return whole, float(self.pairs @ np.log(left)) / 2


def restricted(sums: Floats, n_nuisance: int) -> tuple[Floats, float]:
    """Sums of products over independent rows after a regression on the parameters.

    Parameters
    ----------
    sums : of the parameters' columns first, then others, over their noise.

    Returns
    -------
    the sums of the others' residuals from a regression on the parameters, and half the
    log-determinant of the parameters' information.

    Raises
    ------
    numpy.linalg.LinAlgError : the parameters' columns are linearly dependent.
    """
    lower = np.linalg.cholesky(sums[:n_nuisance, :n_nuisance])
    along = np.linalg.solve(lower, sums[:n_nuisance, n_nuisance:])
    left = sums[n_nuisance:, n_nuisance:] - along.T @ along
    return left, float(np.log(np.diag(lower)).sum())


def mean_standard_deviation(log_variances: Floats, log_weights: Floats, values: Floats) -> Floats:
    """Values at the point of a curve that has the mean standard deviation.

    Where a likelihood has a ridge along which noise of longer memory is larger, its maximum is a
    poor estimate: standard errors from it are too small more often than too large. The whole ridge
    is represented by the point with the mean standard deviation of the noise at low frequencies,
    which determines the errors of parameters of smooth effect.

    Parameters
    ----------
    log_variances : of noise at low frequencies, along the curve, increasing; shape (points,).
    log_weights : of the points.
    values : to interpolate, shape (points, values).
    """
    weights = np.exp(log_weights - log_weights.max())
    mean = np.log(weights @ np.exp(log_variances / 2) / weights.sum()) * 2
    return np.array([np.interp(mean, log_variances, column) for column in values.T])
