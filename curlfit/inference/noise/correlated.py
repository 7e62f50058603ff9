"""Models of correlated noise: how residuals are made independent, and how noise is estimated.

Generalised least squares is least squares of residuals that are made independent. A model is a
class here, which whitens what it stands for, and its name in `curlfit.inference.noise.models`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol, Self

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.linalg import eigh

from curlfit.inference.noise import accelerations
from curlfit.inference.noise.estimation import ChannelResiduals, most_likely
from curlfit.inference.noise.models import Noise, ar1_correlation, matern
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS

_LASTING = (1e-3, 10.0)  # correlation time of "ar1" noise over the time of motion
_GRID = 400  # times at which a discrepancy is drawn
_MODES = 32  # of a discrepancy that are kept
_PURE = 300.0  # greatest discrepancy over the independent noise
_NEGLIGIBLE = 0.05  # the same, below which there is none


class Motion(NamedTuple):
    """The motion that a fit has found."""

    times: Floats
    """of the rows, s since the first, shape (n,)"""
    path: Floats
    """x, y, phi, speed and spin at the times of the rows, shape (5, n)"""
    stone: Stone


class Whitener(Protocol):
    """What makes residuals with correlated noise independent: a NamedTuple of arrays."""

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, motion: Motion | None) -> Self:
        """That of a noise; it changes nothing where the noise has no memory and no size.

        Parameters
        ----------
        times : s since the first row, shape (n,).
        weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
        motion : of the stone; None for a noise that has no size yet.
        """

    def whiten(self, residual: Array) -> Array:
        """Residuals over sigma, made independent; shape (channels, n)."""

    def log_determinant(self) -> Floats:
        """Of the whitening, by channel: its part of the log-likelihood; shape (channels,)."""

    @staticmethod
    def estimate(
        channels: Sequence[ChannelResiduals], span: float, motion: Motion
    ) -> tuple[Noise, dict[str, float]]:
        """The noise of greatest restricted likelihood, and the sigmas that belong to it.

        Parameters
        ----------
        channels : residuals of a fit with white noise, of the channels to estimate a noise of.
        span : time after the first row for which the stone moves, s.
        motion : of the stone in that fit.

        Returns
        -------
        the noise, and by channel its sigma (of the independent part, if there is one), where it
        was not given.
        """


class AR1Whitener(NamedTuple):
    """Of "ar1" noise each residual loses what the row before it predicts.

    Arrays of the shape of the data (channels, n).
    """

    before: Any
    """row that was observed before this one"""
    carry: Any
    """correlation with it"""
    scale: Any
    """1 over the part of sigma that it does not predict"""

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, motion: Motion | None) -> Self:
        before = np.tile(np.arange(weight.shape[1]), (len(weight), 1))
        carry, scale = np.zeros_like(weight), np.ones_like(weight)
        for row, name in enumerate(CHANNELS[: len(weight)]):
            if name in noise.memory:
                there = np.flatnonzero(weight[row] > 0)
                steps = ar1_correlation(np.diff(times[there]), noise.memory[name])
                before[row, there[1:]] = there[:-1]
                carry[row, there[1:]] = steps
                scale[row, there[1:]] = 1 / np.sqrt(1 - steps**2)
        return cls(before, carry, scale)

    def whiten(self, residual: Array) -> Array:
        predicted = self.carry * jnp.take_along_axis(residual, self.before, axis=1)
        return (residual - predicted) * self.scale

    def log_determinant(self) -> Floats:
        return np.asarray(np.log(self.scale).sum(-1))

    @staticmethod
    def estimate(
        channels: Sequence[ChannelResiduals], span: float, motion: Motion
    ) -> tuple[Noise, dict[str, float]]:
        """One scale for all sigmas that were not given, and a memory for each channel."""

        def parts(logs: Floats) -> list[tuple[float, float]]:
            memories = np.exp(np.clip(logs[1:], *np.log(np.multiply(_LASTING, span))))
            return [
                (1.0 if item.given else math.sqrt(item.squares) * math.exp(logs[0]), float(memory))
                for item, memory in zip(channels, memories, strict=True)
            ]

        def whitened(logs: Floats) -> list[tuple[Floats, float]]:
            found = []
            for item, (sigma, memory) in zip(channels, parts(logs), strict=True):
                # Noise of means over blocks is taken to be that of single rows so far apart.
                steps = ar1_correlation(np.diff(item.t), memory)[:, None]
                left = np.sqrt(np.maximum(1 - steps**2, 1e-14))
                white = item.both / (sigma * math.sqrt(item.block))
                white[1:] = (white[1:] - steps * white[:-1]) / left
                spread = len(white) * math.log(sigma * math.sqrt(item.block))
                found.append((white, spread + float(np.log(left).sum())))
            return found

        starts = [[0.0] + [math.log(share * span)] * len(channels) for share in (0.01, 0.1)]
        found = list(zip(channels, parts(most_likely(whitened, starts)), strict=True))
        sigma = {item.name: own * item.scale for item, (own, _) in found if not item.given}
        return Noise("ar1", memory={item.name: memory for item, (_, memory) in found}), sigma


class DiscrepancyWhitener(NamedTuple):
    """Of "gp" noise every smooth direction u, in which the discrepancy has s times the size of the
    independent noise, is scaled down by sqrt(1 + s^2).

    With C = 1 + U diag(s^2) U^T, C^-1/2 = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T.
    """

    directions: Any
    """orthonormal by channel, shape (channels, n, k)"""
    shrink: Any
    """1 - 1/sqrt(1 + s^2) by direction, shape (channels, k)"""

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, motion: Motion | None) -> Self:
        directions = np.zeros((*weight.shape, _MODES))
        shrink = np.zeros((len(weight), _MODES))
        if not noise.sizes:
            return cls(directions, shrink)
        grid = np.linspace(0.0, noise.span, _GRID)
        at_times = np.array([np.interp(times, grid, mode) for mode in _modes().T]).T
        for row, name in enumerate(CHANNELS[: len(weight)]):
            if name in noise.sizes:
                response = noise.sizes[name] * weight[row][:, None] * at_times
                left, singular, _ = np.linalg.svd(response, full_matrices=False)
                directions[row], shrink[row] = left, 1 - 1 / np.sqrt(1 + singular**2)
        return cls(directions, shrink)

    def whiten(self, residual: Array) -> Array:
        along = jnp.einsum("cnk,cn->ck", self.directions, residual) * self.shrink
        return residual - jnp.einsum("cnk,ck->cn", self.directions, along)

    def log_determinant(self) -> Floats:
        return np.asarray(np.log1p(-self.shrink).sum(-1))

    @staticmethod
    def estimate(
        channels: Sequence[ChannelResiduals], span: float, motion: Motion
    ) -> tuple[Noise, dict[str, float]]:
        """One scale for all discrepancies, and one for all sigmas that were not given."""
        squares = [_independent_square(item) for item in channels]
        excess = [
            math.sqrt(max(item.squares / own - 1, 0.0))
            for item, own in zip(channels, squares, strict=True)
        ]
        along_modes = [_along_modes(item, span) for item in channels]

        def parts(logs: Floats) -> list[tuple[float, float]]:
            scale, size = math.exp(logs[0]), math.exp(logs[1])
            return [
                (1.0 if item.given else math.sqrt(own) * scale, min(size * over, _PURE))
                for item, own, over in zip(channels, squares, excess, strict=True)
            ]

        def whitened(logs: Floats) -> list[tuple[Floats, float]]:
            found = []
            for (both, modes), (sigma, size) in zip(along_modes, parts(logs), strict=True):
                spread = sigma * np.sqrt(1 + size**2 * modes)
                found.append((both / spread[:, None], float(np.log(spread).sum())))
            return found

        best = most_likely(whitened, [[0.0, 0.0], [0.0, 3.0]])
        found = list(zip(channels, parts(best), strict=True))
        sigma = {item.name: own * item.scale for item, (own, _) in found if not item.given}
        sizes = {
            item.name: size * own * item.scale for item, (own, size) in found if size > _NEGLIGIBLE
        }
        return Noise("gp", sizes=sizes, span=span), sigma


class AccelerationWhitener(NamedTuple):
    """Of missing accelerations every direction in all channels together is scaled down, as by
    `DiscrepancyWhitener` in one."""

    directions: Any
    """orthonormal, shape (channels, n, k)"""
    shrink: Any
    """shape (k,)"""

    @classmethod
    def of(cls, noise: Noise, times: Floats, weight: Floats, motion: Motion | None) -> Self:
        count = len(accelerations.COMPONENTS) * accelerations.SHAPES
        if not noise.sizes or motion is None:
            return cls(np.zeros((*weight.shape, count)), np.zeros(count))
        responses = accelerations.Responses.of(*motion)
        sizes = np.repeat([noise.sizes[name] for name in accelerations.COMPONENTS],
                          accelerations.SHAPES)  # fmt: skip
        rows = np.stack([responses.at(times, row) for row in range(len(weight))])
        matrix = (weight[..., None] * rows * sizes).reshape(-1, count)
        left, singular, _ = np.linalg.svd(matrix, full_matrices=False)
        directions = np.zeros((weight.size, count))
        directions[:, : left.shape[1]] = left
        shrink = np.zeros(count)
        shrink[: len(singular)] = 1 - 1 / np.sqrt(1 + singular**2)
        return cls(directions.reshape(*weight.shape, count), shrink)

    def whiten(self, residual: Array) -> Array:
        along = jnp.einsum("cnk,cn->k", self.directions, residual) * self.shrink
        return residual - jnp.einsum("cnk,k->cn", self.directions, along)

    def log_determinant(self) -> Floats:
        # of all channels together, to which the first stands for the others
        found = np.zeros(self.directions.shape[0])
        found[0] = np.log1p(-self.shrink).sum()
        return found

    @staticmethod
    def estimate(
        channels: Sequence[ChannelResiduals], span: float, motion: Motion
    ) -> tuple[Noise, dict[str, float]]:
        """Sizes of the accelerations, and one scale for all sigmas that were not given."""
        squares = [_independent_square(item) for item in channels]
        responses = accelerations.Responses.of(*motion)
        found = accelerations.estimate(channels, squares, responses)
        sigma = {
            item.name: math.sqrt(own) * found.scale * item.scale
            for item, own in zip(channels, squares, strict=True)
            if not item.given
        }
        return Noise("discrepancy", sizes=found.sizes, span=span), sigma


WHITENERS: dict[str, type[Whitener]] = {
    "ar1": AR1Whitener,
    "gp": DiscrepancyWhitener,
    "discrepancy": AccelerationWhitener,
}


def whitener_of(
    noise: Noise, times: Floats, weight: Floats, motion: Motion | None = None
) -> Whitener | None:
    """What makes a noise independent, see `Whitener.of`; None where it is white."""
    if noise.kind not in WHITENERS:
        return None
    return WHITENERS[noise.kind].of(noise, times, weight, motion)


def whitened(residual: Array, whitener: Whitener | None) -> Array:
    """Residuals over sigma, made independent; shape (channels, n)."""
    return residual if whitener is None else whitener.whiten(residual)


@cache
def _modes() -> Floats:
    """The greatest modes of the kernel on a grid over the time of motion, shape (grid, modes): the
    j-th has some j^-6 of the variance."""
    grid = np.linspace(0.0, 1.0, _GRID)
    squares, shapes = eigh(
        matern(grid[:, None] - grid, 1.0), subset_by_index=(_GRID - _MODES, _GRID - 1)
    )
    return np.asarray(shapes * np.sqrt(np.maximum(squares, 0.0)))


def _independent_square(item: ChannelResiduals) -> float:
    """Variance of what is independent from row to row, from second differences."""
    steady = float(np.mean(np.diff(item.both[:, 0], 2) ** 2)) / 6
    return 1.0 if item.given else max(steady, item.squares / _PURE**2)


def _along_modes(item: ChannelResiduals, span: float) -> tuple[Floats, Floats]:
    """Residuals and basis along the axes of "gp" noise, and the squares of a discrepancy of unit
    size along these."""
    t = np.minimum(item.t, span)
    kernel = item.block * matern(t[:, None] - t, span)
    squares, axes = np.linalg.eigh(item.uneven[:, None] * kernel * item.uneven)
    return axes.T @ item.both, np.maximum(squares, 0.0)
