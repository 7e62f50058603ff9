"""Whether residuals are independent from row to row, and as rough as noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from curlfit.numerics.arrays import Floats

_SURE = 3.5  # standard deviations from which independence is rejected
_MATTERS = 0.2  # lag-1 correlation below which errors would hardly change
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
