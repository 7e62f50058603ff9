"""The draw to the tee: what coefficients mean to a curler."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL
from curlfit.inference.system import motions
from curlfit.numerics.arrays import Floats
from curlfit.sheet import HOG_TO_HOG, LINES, TEE
from curlfit.stone import GRAVITY, Stone

_START = LINES["hog"]
_LENGTH = TEE - _START
_USUAL = 2.2  # m/s, from which the speed is found
_ROUNDS, _FEW_ROUNDS = 12, 6
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
        speed = np.full(len(coefficients), _USUAL)
        for _ in range(_ROUNDS):  # the distance is nearly proportional to the square of the speed
            x, y = self._paths(coefficients, speed)
            speed *= np.sqrt(_LENGTH / (y[:, -1] - _START))
        x, y = self._paths(coefficients, speed)
        friction = speed**2 / (2 * GRAVITY * _LENGTH)
        return np.column_stack([friction, -np.sign(self.spin) * x[:, -1], _hog_to_hog(y)])

    def speeds(self, coefficients: Floats, hog_to_hog: Any) -> Floats:
        """Speeds in m/s at the near hog line of stones that take so many s to the far one, for
        vectors of the coefficients and conditions; the times are one for each or one for all.

        Raises
        ------
        InputError : most do not get there.
        """
        speed = HOG_TO_HOG / hog_to_hog + _USUAL / 4 + np.zeros(len(coefficients))
        for _ in range(_FEW_ROUNDS):
            _, y = self._paths(coefficients, speed)
            there = y[:, -1] > LINES["far-hog"]
            speed *= np.where(there, np.sqrt(_hog_to_hog(y) / hog_to_hog), 1.1)
        if there.mean() < 0.5:
            time = float(np.mean(hog_to_hog))
            raise InputError(f"hog to hog {time:g} s: it stops before the far hog line")
        return speed

    def hog_to_hog(self, coefficients: Floats, speed: Floats) -> Floats:
        """Times in s between the hog lines of stones of some speeds at the near one."""
        return _hog_to_hog(self._paths(coefficients, speed)[1])

    def _paths(self, coefficients: Floats, speed: Floats) -> tuple[Floats, Floats]:
        """x and y of throws along the centre line."""
        start = {"x0": 0.0, "y0": _START, "heading": 0.0, "phi0": 0.0, "omega0": self.spin}
        own = [np.broadcast_to(start.get(item.name, speed), speed.shape) for item in START]
        values = np.column_stack([coefficients, *own])
        state, _ = motions(self.model, values, self.stone, LEVEL_AND_STILL, _TIMES)
        return state[:, 0], state[:, 1]


def _hog_to_hog(y: Floats) -> Floats:
    """Times in s at which paths from the near hog line cross the far one."""
    return np.array([np.interp(LINES["far-hog"], own, _TIMES) for own in y])
