"""The draw to the tee: what coefficients mean to a curler."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_NAMES
from curlfit.inference.model.problem import LEVEL_AND_STILL
from curlfit.inference.model.system import motions
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH
from curlfit.sheet import HOG_TO_HOG, LINES, TEE
from curlfit.stone import GRAVITY, Stone

_START = LINES["hog"]
_LENGTH = TEE - _START
_USUAL = 2.2  # m/s, from which the speed is found
_MOST_MOTIONS = 12  # until draws are close to what is asked for
_CLOSE = 1e-5  # 0.3 mm on the way to the tee, 0.1 ms between the hog lines
_MUCH_LONGER = 1.2  # times as asked for, where a stone does not get there
_SMALLEST_MOVE = 1e-3  # below it, rounding of times hides an exponent
TIMES = np.linspace(0.0, 37.5, 301)
"""s, within which stones come to rest."""
_DURATION = 25.0  # s, from which the spin is found
_STRAIGHT = 1e-6  # rad, below which a stone does not turn

DRAW = {"friction": "1", "curl": "m", "hog_to_hog": "s"}
"""Quantities of a draw to the tee, with their units: mean friction from the near hog
line to rest, curl at rest to the side to which the front turns, and the time from hog
line to hog line."""


class _DrawToTee(NamedTuple):
    """Motions of stones from the near hog line to rest at the tee."""

    speed: Floats
    """m/s at the hog line, shape (stones,)"""
    spin: Floats
    """rad/s at the hog line, shape (stones,)"""
    angle: Floats
    """rad, by which they turn in all, shape (stones,)"""
    x: Floats
    """m, at `TIMES`, shape (stones, times)"""
    y: Floats
    """m, at `TIMES`, shape (stones, times)"""


class _NearlyPower:
    """A quantity of each draw that is nearly a power of its speed: distance or time.
    The exponent is a usual one at first, then that between the last two motions (the
    secant of logarithms)."""

    def __init__(self, usual_exponent: float) -> None:
        self._usual = usual_exponent
        self._exponent = np.array(usual_exponent)
        self._last: tuple[Floats, Floats] | None = None

    def nearer(self, speed: Floats, ratio: Floats) -> Floats:
        """Speeds at which the quantity is more nearly as asked for, of which it is
        `ratio` times as much at these."""
        point = np.log(speed), np.log(ratio)
        if self._last is not None:
            moved, changed = np.subtract(point, self._last)
            is_known = np.abs(moved) > _SMALLEST_MOVE
            secant = changed / np.where(is_known, moved, 1.0)
            of_usual = np.clip(secant / self._usual, 0.5, 2.0)
            self._exponent = np.where(is_known, of_usual * self._usual, self._exponent)
        self._last = point
        nearer: Floats = speed * ratio ** (-1 / self._exponent)
        return nearer


class Draw(NamedTuple):
    """A stone that is released at the near hog line along the centre line."""

    model: Model
    stone: Stone

    def usual_angle(self, coefficients: Floats, spin: Floats) -> float:
        """The angle in rad by which stones of some spin turn on their way to rest at
        the tee, for vectors of the coefficients and conditions: the median of those
        that are known to turn."""
        is_turning = spin != 0.0
        if not is_turning.any():
            return 0.0
        speed = np.full(is_turning.sum(), _USUAL)
        motion = self._to_tee(coefficients[is_turning], speed, spin[is_turning], 0.0)
        return float(np.median(np.abs(motion.angle)))

    def spin(self, coefficients: Floats, angle: float) -> Floats:
        """Spins in rad/s of stones that turn by an angle on their way to
        rest at the tee."""
        return self._turning(coefficients, angle).spin

    def quantities(self, coefficients: Floats, angle: float) -> Floats:
        """The quantities of `DRAW`, shape (vectors, 3), where it turns by an angle and
        rests at the tee."""
        motion = self._turning(coefficients, angle)
        friction = motion.speed**2 / (2 * GRAVITY * _LENGTH)
        curl = -np.sign(angle) * motion.x[:, -1]
        return np.column_stack([friction, curl, _hog_to_hog(motion.y)])

    def speeds(self, coefficients: Floats, spin: Any, hog_to_hog: Any) -> Floats:
        """Speeds in m/s at the near hog line of stones that take so many s to the far
        one; spins and times are one for each or one for all.

        Raises
        ------
        InputError : most do not get there.
        """
        speed = HOG_TO_HOG / hog_to_hog + _USUAL / 4 + np.zeros(len(coefficients))
        time_at = _NearlyPower(-2.0)
        for _ in range(_MOST_MOTIONS):
            _, y, _ = self._paths(coefficients, speed, spin)
            reaches_far_hog = y[:, -1] > LINES["far-hog"]
            ratio = np.where(reaches_far_hog, _hog_to_hog(y) / hog_to_hog, _MUCH_LONGER)
            if not _is_off(ratio):
                break
            speed = time_at.nearer(speed, ratio)
        if reaches_far_hog.mean() < 0.5:
            time = float(np.mean(hog_to_hog))
            raise InputError(f"hog to hog {time:g} s: it stops before the far hog line")
        return speed

    def hog_to_hog(self, coefficients: Floats, spin: Any, speed: Floats) -> Floats:
        """Times in s between the hog lines of stones of some speeds at the near one."""
        return _hog_to_hog(self._paths(coefficients, speed, spin)[1])

    def _turning(self, coefficients: Floats, angle: float) -> _DrawToTee:
        """Motions to rest at the tee of stones that turn by an angle, searched from
        usual ones; those of many vectors from that of the first."""
        speed = np.array([_USUAL])
        spin = np.array([angle / _DURATION])
        count = len(coefficients)
        if count > BATCH:
            first = self._to_tee(coefficients[:1], speed, spin, angle)
            speed = first.speed
            spin = first.spin
        return self._to_tee(
            coefficients, np.repeat(speed, count), np.repeat(spin, count), angle
        )

    def _to_tee(
        self, coefficients: Floats, speed: Floats, spin: Floats, angle: float
    ) -> _DrawToTee:
        """Motions to rest at the tee of stones that turn by an angle (by any if it is
        0), searched from a speed and a spin."""
        distance_at = _NearlyPower(2.0)
        is_turning = abs(angle) > _STRAIGHT
        for _ in range(_MOST_MOTIONS):
            x, y, phi = self._paths(coefficients, speed, spin)
            motion = _DrawToTee(speed, spin, phi[:, -1], x, y)
            of_distance = (y[:, -1] - _START) / _LENGTH
            of_angle = motion.angle / angle if is_turning else np.ones(len(speed))
            if not (_is_off(of_distance) or _is_off(of_angle)):
                break
            speed = distance_at.nearer(speed, of_distance)
            spin = spin / of_angle  # nearly in proportion, at any speed
        return motion

    def _paths(self, coefficients: Floats, speed: Floats, spin: Any) -> Floats:
        """x, y and the angle of throws along the centre line."""
        start = {
            "x0": 0.0,
            "y0": _START,
            "heading": 0.0,
            "phi0": 0.0,
            "v0": speed,
            "omega0": spin,
        }
        columns = [np.broadcast_to(start[name], speed.shape) for name in START_NAMES]
        values = np.column_stack([coefficients, *columns])
        states, _ = motions(self.model, values, self.stone, LEVEL_AND_STILL, TIMES)
        paths: Floats = states[:, :3].swapaxes(0, 1)
        return paths


def _is_off(ratio: Floats) -> bool:
    """Whether a quantity of any draw is not as asked for."""
    return bool((np.abs(ratio - 1) > _CLOSE).any())


def _hog_to_hog(y: Floats) -> Floats:
    """Times in s at which paths from the near hog line cross the far one."""
    return np.array([np.interp(LINES["far-hog"], of_draw, TIMES) for of_draw in y])
