"""Whether residuals are independent from row to row, and as rough as noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from curlfit.numerics.arrays import Floats

_SURE = 3.5  # standard deviations from which independence is rejected
_MATTERS = 0.2  # lag-1 correlation below which errors would hardly change
_ROUGH = 1.0
"""Squares of second differences over those of first ones: 2 to 3 for noise that is not
differentiable, less than this for a smooth function."""


def is_rough(series: Floats) -> bool:
    """Whether a series is as rough as noise; others are due to a law, or
    to a formula."""
    first_differences = float(np.sum(np.diff(series) ** 2))
    second_differences = float(np.sum(np.diff(series, 2) ** 2))
    return second_differences > _ROUGH * first_differences


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
        n = len(residual)
        centred = residual - residual.mean()
        squares = float(centred @ centred)
        lag1 = float(centred[1:] @ centred[:-1]) / squares if squares else 0.0
        is_above = centred > 0
        above = int(is_above.sum())
        runs = 1 + int((is_above[1:] != is_above[:-1]).sum())
        # of the number of runs where the order of the signs is random
        mean = 1 + 2 * above * (n - above) / n
        variance = (mean - 1) * (mean - 2) / (n - 1)
        z_score = (runs - mean) / math.sqrt(variance) if variance > 0 else 0.0
        effective = n * min((1 - lag1) / (1 + lag1), 1.0)
        return cls(lag1, z_score, effective)

    @property
    def doubtful(self) -> bool:
        """Whether independence is rejected, with a correlation that matters
        for the errors."""
        number = self.effective * (1 + self.lag1) / max(1 - self.lag1, 1e-9)
        is_rejected = self.lag1 * math.sqrt(number) > _SURE or self.runs < -_SURE
        return is_rejected and self.lag1 > _MATTERS
