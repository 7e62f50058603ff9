"""Correlated noise: how residuals are made independent, and how noise is estimated.

Generalised least squares is least squares of residuals that are made independent. The models are
in files of their own, `ar1` and `discrepancy`; here they go by their names.
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


class Motion(NamedTuple):
    """The motion that a fit has found."""

    times: Floats
    """of the rows, s since the first, shape (n,)"""
    path: Floats
    """x, y, phi, speed and spin at the times of the rows, shape (5, n)"""
    stone: Stone


class Whitener(Protocol):
    """What makes residuals with correlated noise independent: a NamedTuple of arrays."""

    def whiten(self, residual: Array) -> Array:
        """Residuals over sigma, made independent; shape (channels, n)."""

    def log_determinant(self) -> Floats:
        """Of the whitening, by channel: its part of the log-likelihood; shape (channels,)."""


def whitener_of(
    noise: Noise, times: Floats, weight: Floats, motion: Motion | None = None
) -> Whitener | None:
    """What makes a noise independent; None where it is white.

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
    kind: str, channels: Sequence[ChannelResiduals], span: float, motion: Motion
) -> tuple[Noise, dict[str, float]]:
    """The noise of some residuals, and the sigmas that belong to it.

    Parameters
    ----------
    channels : residuals of a fit with white noise, of the channels to estimate a noise of.
    span : time after the first row for which the stone moves, s.
    motion : of the stone in that fit.

    Returns
    -------
    the noise, and by channel its sigma (of what is not discrepancy), where it was not given.
    """
    if kind == "ar1":
        return ar1.estimate(channels, span)
    return discrepancy.estimate(channels, span, Responses.of(*motion), kind)


def whitened(residual: Array, whitener: Whitener | None) -> Array:
    """Residuals over sigma, made independent; shape (channels, n)."""
    return residual if whitener is None else whitener.whiten(residual)
