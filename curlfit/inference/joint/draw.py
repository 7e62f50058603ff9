"""The draw to the tee: what coefficients mean to a curler."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL
from curlfit.inference.system import motions
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LINES, TEE
from curlfit.stone import GRAVITY, Stone

_START = LINES["hog"]
_LENGTH = TEE - _START
_USUAL = 2.2  # m/s, from which the speed is found
_ROUNDS = 12
_TIMES = np.linspace(0.0, 37.5, 301)

DRAW = {"friction": "1", "curl": "m", "hog_to_hog": "s"}
"""Quantities of a draw to the tee, with their units: mean friction from the near hog line to rest,
curl at rest to the side to which the front turns, and the time from hog line to hog line."""


class Draw(NamedTuple):
    """A stone that is released at the near hog line and comes to rest at the tee."""

    model: Model
    stone: Stone
    spin: float
    """rad/s at the release, counter-clockwise"""

    def quantities(self, coefficients: Floats) -> Floats:
        """Those of `DRAW`, shape (vectors, 3), for vectors of the coefficients and conditions."""
        start = {"x0": 0.0, "y0": _START, "heading": 0.0, "phi0": 0.0, "omega0": self.spin}
        first = [start.get(item.name, _USUAL) for item in START]
        speed = coefficients.shape[1] + [item.name for item in START].index("v0")
        values = np.column_stack([coefficients, np.tile(first, (len(coefficients), 1))])
        about = self.stone, LEVEL_AND_STILL, _TIMES
        for _ in range(_ROUNDS):  # the distance is nearly proportional to the square of the speed
            state, _ = motions(self.model, values, *about)
            values[:, speed] *= np.sqrt(_LENGTH / (state[:, 1, -1] - _START))
        x, y = motions(self.model, values, *about)[0][:, :2].swapaxes(0, 1)
        friction = values[:, speed] ** 2 / (2 * GRAVITY * _LENGTH)
        crossing = [np.interp(LINES["far-hog"], own, _TIMES) for own in y]
        return np.column_stack([friction, -np.sign(self.spin) * x[:, -1], crossing])
