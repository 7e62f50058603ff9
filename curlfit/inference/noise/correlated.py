"""Correlated noise: whitening of residuals, and estimation of the noise.

Generalised least squares is least squares of whitened residuals. The models are in modules of their
own, `ar1` and `discrepancy`; here they are selected by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
from jax import Array

from curlfit.inference.noise import ar1, discrepancy
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.noise.estimation import ChannelResiduals
from curlfit.inference.noise.models import Noise
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone


class FittedMotion(NamedTuple):
    """The motion found by a fit."""

    times: Floats
    """of the rows, s since the first, shape (n,)"""
    path: Floats
    """x, y, phi, speed and spin at the times of the rows, shape (5, n)"""
    stone: Stone


class Whitener(Protocol):
    """Makes residuals with correlated noise independent; a NamedTuple of arrays."""

    def whiten(self, residual: Array) -> Array:
        """Whitened residuals from residuals over sigma, shape (channels, n)."""

    def log_determinant(self) -> Floats:
        """Log-determinant of the whitening by channel, for the likelihood; shape (channels,)."""


def whitener_of(
    noise: Noise, times: Floats, weight: Floats, motion: FittedMotion | None = None
) -> Whitener | None:
    """The whitener of a noise model; None where it is white.

    It changes nothing where the noise has no memory and no size.

    Parameters
    ----------
    times : s since the first row, shape (n,).
    weight : 1/sigma, 0 where nothing was observed, shape (channels, n).
    motion : of the stone; None for a noise that has no size yet.
    """
    if noise.kind == "white":
        return None
    if noise.kind == "ar1":
        return ar1.AR1Whitener.of(noise, times, weight)
    responses = None if motion is None else Responses.of(*motion)
    return discrepancy.DiscrepancyWhitener.of(noise, times, weight, responses)


def estimate(
    kind: str, channels: Sequence[ChannelResiduals], span: float, motion: FittedMotion
) -> tuple[Noise, dict[str, float]]:
    """The noise of some residuals, estimated with its sigmas.

    Parameters
    ----------
    channels : residuals of a fit with white noise, of the channels whose noise is estimated.
    span : time after the first row during which the stone moves, s.
    motion : of the stone in that fit.

    Returns
    -------
    the noise, and by channel its sigma (without the discrepancy), where it was not given.
    """
    if kind == "ar1":
        return ar1.estimate(channels, span)
    return discrepancy.estimate(channels, span, Responses.of(*motion), kind)


def whitened(residual: Array, whitener: Whitener | None) -> Array:
    """Whitened residuals from residuals over sigma, shape (channels, n)."""
    return residual if whitener is None else whitener.whiten(residual)
