"""Models of noise that is correlated from row to row, and tests of independence.

The models:

- "white": independent from row to row.
- "ar1": independent noise, and noise whose correlation decays exponentially, as
  exp(-gap/memory) between rows (an Ornstein-Uhlenbeck process; AR(1) where rows are
  evenly spaced). For noise of the tracker: filters, a swaying camera.
- "discrepancy": the same, and accelerations that the law lacks, as functions of speed,
  propagated to all channels by the equations of motion
  (`curlfit.inference.noise.accelerations`). For a law that is not exact (Kennedy and
  O'Hagan 2001, J. R. Stat. Soc. B 63, 425). Slow noise and an inexact law leave similar
  residuals, so that neither is estimated without the other; "ar1+discrepancy" is
  another name of this model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import NOISE
from curlfit.settings.noise_kinds import NoiseKind

_SURE = 3.5  # standard deviations from which independence is rejected
_MATTERS = 0.2  # lag-1 correlation below which errors would hardly change


NOISES = NOISE.names
"""How noise is correlated from row to row."""


@dataclass(frozen=True)
class Noise:
    """How noise is correlated from row to row.

    Attributes
    ----------
    kind : one of `NOISES`.
    memory : correlation time in s by channel, 0 where the noise is independent.
    white : independent share of the variance by channel.
    sizes : for "discrepancy", the standard deviation of the missing acceleration over
        that by friction, by component (`across`, `along`, `turning`).
    independent : for "discrepancy", sigma of the fit with independent noise, by
        channel: the coefficients and the path of the law are nearest to the data with
        these weights.
    initial_state : covariance of the change of the initial state (x0, y0, heading,
        v0, phi0, omega0; SI) that compensates the discrepancy, part of the error of
        its estimate.
    """

    kind: NoiseKind = NoiseKind.WHITE
    memory: dict[str, float] = field(default_factory=dict)
    white: dict[str, float] = field(default_factory=dict)
    sizes: dict[str, float] = field(default_factory=dict)
    independent: dict[str, float] = field(default_factory=dict)
    initial_state: list[list[float]] = field(default_factory=list)

    @property
    def is_white(self) -> bool:
        """Whether it is independent from row to row."""
        return self.kind.is_white

    def white_share(self, channel: str) -> float:
        """Independent share of the variance of a channel."""
        return self.white.get(channel, 0.0 if channel in self.memory else 1.0)

    @property
    def all_sizes(self) -> Floats:
        """The sizes as an array, shape (3,)."""
        return np.array(list(self.sizes.values()))


WHITE = Noise()


# second over first differences, squared: 2 to 3 for noise that is not differentiable
_ROUGH = 1.0


def is_rough(series: Floats) -> bool:
    """Whether a series is as rough as noise; others are due to a law, or
    to a formula."""
    first, second = (float(np.sum(np.diff(series, order) ** 2)) for order in (1, 2))
    return second > _ROUGH * first


def time_of_motion(t: Floats, speed: Floats) -> float:
    """Time from the first row to the last in which a stone moves, s."""
    moving = np.flatnonzero(speed > 0)
    return float(t[moving[-1]] - t[0]) if len(moving) else 0.0


@dataclass(frozen=True)
class Independence:
    """How far the residuals of a channel are from independent noise.

    Attributes
    ----------
    lag1 : correlation of neighbours.
    runs : z-score of the number of runs of one sign, negative where there are too few
        (Wald and Wolfowitz 1940).
    effective : effective sample size, with the same information on a mean, n(1 -
        r)/(1 + r) (Bayley and Hammersley 1946).
    """

    lag1: float
    runs: float
    effective: float

    @classmethod
    def of(cls, residual: Floats) -> Self:
        """Of at least two residuals, in the order of their rows."""
        n, centred = len(residual), residual - residual.mean()
        total, up = float(centred @ centred), centred > 0
        lag1 = float(centred[1:] @ centred[:-1]) / total if total else 0.0
        above, runs = int(up.sum()), 1 + int((up[1:] != up[:-1]).sum())
        mean = 1 + 2 * above * (n - above) / n
        variance = (mean - 1) * (mean - 2) / (n - 1)
        z = (runs - mean) / math.sqrt(variance) if variance > 0 else 0.0
        return cls(lag1, z, n * min((1 - lag1) / (1 + lag1), 1.0))

    @property
    def doubtful(self) -> bool:
        """Whether independence is rejected, with a correlation that matters
        for the errors."""
        n = self.effective * (1 + self.lag1) / max(1 - self.lag1, 1e-9)
        sure = self.lag1 * math.sqrt(n) > _SURE or self.runs < -_SURE
        return sure and self.lag1 > _MATTERS
