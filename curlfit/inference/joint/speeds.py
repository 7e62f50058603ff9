"""How fast the draws of an evening are thrown: about a mean of each group, as their
coefficients are.

Where a draw came to rest tells its speed and its friction by one number. If speeds may
be anything, an exponent of friction is told by whether the draws that went far had
less friction at low speeds; but those went far because they had less friction. With
speeds that are all nearly the same, as those of draws to one place are, the exponent
would explain a third of what friction varies, and be too well known. So speeds vary
about a mean, independently of friction, and by as much as the draws say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.priors import Penalty
from curlfit.numerics.arrays import Floats

NAME = "v0"
LEAST_SPREAD = 0.005
"""Of the logarithm, 0.07 s from hog line to hog line: no one repeats a weight more
closely, where the draws say nothing of how closely it was."""


class ExpectedSpeeds(NamedTuple):
    """Normal densities of the logarithms of the speeds of draws, which depend on what
    is the same in all: with another exponent all were thrown faster. Of the logarithms,
    since speeds that are all so many times as large are then as probable."""

    place: int
    """of the speed among the parameters of a draw"""
    same: NDArray[np.int64]
    """places of what is the same in all draws"""
    at: Floats
    """values of that"""
    means: Floats
    """of the logarithm (m/s) for each draw, at these values"""
    slopes: Floats
    """derivatives of the means, shape (draws, parameters that are the same)"""
    spread: float
    """standard deviation about them"""

    def added_to(self, penalty: Penalty, values: Floats) -> Penalty:
        """The priors of each draw and these, where what is the same in all is held at
        the values of the draw's parameters."""
        location, weight, logarithmic = (np.array(part) for part in penalty)
        location[:, self.place] = self._expected(values)
        weight[:, self.place] = 1 / self.spread
        logarithmic[:, self.place] = 1.0
        return Penalty(location, weight, logarithmic)

    def rows(self, values: Floats) -> Floats:
        """Of each draw, at the values of its parameters: one row, with the residual as
        the last column, shape (draws, 1, parameters + 1)."""
        draws, parameters = values.shape
        speeds = values[:, self.place]
        found = np.zeros((draws, 1, parameters + 1))
        found[:, 0, self.place] = 1 / speeds
        found[:, 0, self.same] = -self.slopes
        found[:, 0, -1] = np.log(speeds) - self._expected(values)
        return found / self.spread

    def _expected(self, values: Floats) -> Floats:
        off = values[:, self.same] - self.at
        found: Floats = self.means + (self.slopes * off).sum(1)
        return found


def with_speed(weights: Mapping[str, Floats]) -> dict[str, Floats]:
    """Weights of the parameters in what varies, where the speed is the last parameter
    and varies too."""
    size = len(next(iter(weights.values())))
    extended = {name: np.append(own, 0.0) for name, own in weights.items()}
    return {**extended, NAME: np.append(np.zeros(size), 1.0)}
