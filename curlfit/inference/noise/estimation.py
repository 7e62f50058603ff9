"""Estimates of correlated noise from the residuals of a fit with white noise.

Sizes, and the correlation time of "ar1", are those of greatest restricted likelihood (Patterson and
Thompson 1971): of what no change of the parameters can make, since the fit has hidden the rest. The
ratios of the channels' sizes are taken from those residuals and held: else one channel would be
fitted perfectly and taken to be exact, and the others pay for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.noise.models import Noise, ar1_correlation, matern
from curlfit.numerics.arrays import Floats
from curlfit.throws.throw import CHANNELS, Throw

_FEWEST = 20  # values of a channel from which its noise is estimated
_MOST = 300  # values of a channel used; more are condensed to means
_LASTING = (1e-3, 10.0)  # correlation time of "ar1" noise over the time of motion
_PURE = 300.0  # greatest discrepancy over the independent noise
_NEGLIGIBLE = 0.05  # the same, below which there is none
_FAR = (-30.0, 30.0)  # limits of all logarithms


def fitted_noise(
    kind: str, throw: Throw, residual: Floats, jacobian: Floats, weight: Floats, span: float
) -> tuple[Noise, dict[str, float]]:
    """The correlated noise that the residuals of a fit with white noise show, and its sigmas.

    Parameters
    ----------
    kind : "ar1" or "gp".
    residual, jacobian : over sigma, shapes (channels, n) and (channels, n, free parameters).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
    span : time after the first row for which the stone moves, s.

    Returns
    -------
    the noise, and by channel its sigma (for "gp" that of the independent part); a channel whose
    sigma was given, or of few values, keeps its own and is not named.

    Raises
    ------
    InputError : all channels are of few values.
    """
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]].reshape(*residual.shape, -1)
    channels = [
        _ChannelResiduals.of(name, throw, residual[row], basis[row], weight[row])
        for row, name in enumerate(CHANNELS[: len(residual)])
        if (weight[row] > 0).sum() >= _FEWEST
    ]
    if not channels:
        raise InputError(f"{throw.name}: too few values to estimate a correlation of the noise")
    found = _fitted_ar1(channels, span) if kind == "ar1" else _fitted_gp(channels, span)
    sigma, more = {}, {}
    for item, (own, other) in zip(channels, found, strict=True):
        if not item.given:
            sigma[item.name] = own * item.scale
        if kind == "ar1":
            more[item.name] = other
        elif other > _NEGLIGIBLE:
            more[item.name] = other * own * item.scale
    noise = Noise(kind, memory=more) if kind == "ar1" else Noise(kind, sizes=more, span=span)
    return noise, sigma


class _ChannelResiduals(NamedTuple):
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
    ) -> _ChannelResiduals:
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

    def independent(self) -> float:
        """Variance of what is independent from row to row, from second differences."""
        steady = float(np.mean(np.diff(self.both[:, 0], 2) ** 2)) / 6
        return 1.0 if self.given else max(steady, self.squares / _PURE**2)

    def whitened_ar1(self, variance: float, memory: float) -> tuple[Floats, float]:
        """Residuals and basis with "ar1" noise whitened, and half its log-determinant."""
        # The noise of means over blocks is taken to be that of single rows so far apart.
        steps = ar1_correlation(np.diff(self.t), memory)[:, None]
        left = np.sqrt(np.maximum(1 - steps**2, 1e-14))
        white = self.both / math.sqrt(variance * self.block)
        white[1:] = (white[1:] - steps * white[:-1]) / left
        spread = len(white) / 2 * math.log(variance * self.block)
        return white, spread + float(np.log(left).sum())

    def along_modes(self, span: float) -> tuple[Floats, Floats]:
        """Residuals and basis along the axes of "gp" noise, and the squares of a discrepancy of
        unit size along these."""
        t = np.minimum(self.t, span)
        wave = self.block * matern(t[:, None] - t, span)
        squares, axes = np.linalg.eigh(self.uneven[:, None] * wave * self.uneven)
        return axes.T @ self.both, np.maximum(squares, 0.0)


def _fitted_ar1(channels: list[_ChannelResiduals], span: float) -> list[tuple[float, float]]:
    """By channel, sigma over the one so far, and memory; one scale for all sigmas not given."""

    def parts(logs: Floats) -> list[tuple[float, float]]:
        memories = np.exp(np.clip(logs[1:], *np.log(np.multiply(_LASTING, span))))
        return [
            (1.0 if item.given else math.sqrt(item.squares) * math.exp(logs[0]), float(memory))
            for item, memory in zip(channels, memories, strict=True)
        ]

    def roots(logs: Floats) -> list[tuple[Floats, float]]:
        pairs = zip(channels, parts(logs), strict=True)
        return [item.whitened_ar1(sigma**2, memory) for item, (sigma, memory) in pairs]

    starts = [[0.0] + [math.log(share * span)] * len(channels) for share in (0.01, 0.1)]
    return parts(_most_likely(roots, starts))


def _fitted_gp(channels: list[_ChannelResiduals], span: float) -> list[tuple[float, float]]:
    """By channel, sigma over the one so far, and size of the discrepancy over this; one scale for
    all discrepancies, and one for all sigmas not given."""
    steady = [item.independent() for item in channels]
    pairs = list(zip(channels, steady, strict=True))
    along_modes = [item.along_modes(span) for item in channels]
    excess = [math.sqrt(max(item.squares / own - 1, 0.0)) for item, own in pairs]

    def parts(logs: Floats) -> list[tuple[float, float]]:
        scale, size = math.exp(logs[0]), math.exp(logs[1])
        return [
            (1.0 if item.given else math.sqrt(own) * scale, min(size * over, _PURE))
            for (item, own), over in zip(pairs, excess, strict=True)
        ]

    def roots(logs: Floats) -> list[tuple[Floats, float]]:
        found = []
        for (both, squares), (sigma, size) in zip(along_modes, parts(logs), strict=True):
            spread = sigma * np.sqrt(1 + size**2 * squares)
            found.append((both / spread[:, None], float(np.log(spread).sum())))
        return found

    return parts(_most_likely(roots, [[0.0, 0.0], [0.0, 3.0]]))


def _most_likely(
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
