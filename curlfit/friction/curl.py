"""Whether a law can make a stone curl."""

from __future__ import annotations

from functools import lru_cache
from typing import TypeVar

import numpy as np

from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, ring_points
from curlfit.loads import Load
from curlfit.stone import Stone

AnyLaw = TypeVar("AnyLaw", bound=Law)
# polar angles on one half of the ring, rad
_POINTS = np.pi * (np.arange(32) + 0.5) / 32
_MOTIONS = (
    Motion(speed=2.0, omega=1.2, turned=0.5, time=0.5),
    Motion(speed=1.0, omega=1.2, turned=2.0, time=5.0),
)
"""Motions of a slowly spinning stone, early and late in a draw."""
_LEAST_PUSH = 1e-3  # force across over force along the motion: 3 cm of curl on 28 m


def law_in_general(kind: type[AnyLaw]) -> AnyLaw:
    """A law near its default coefficients, none of which has a special value."""
    values = []
    for number, coefficient in enumerate(kind.coefficients(), start=1):
        values.append(coefficient.default + 0.1 * number * coefficient.typical)
    return kind.from_vector(values)


@lru_cache(256)
def can_curl(kind: type[Law], load: Load, stone: Stone) -> bool:
    """Whether friction can push a slowly spinning stone across its motion by more than
    a thousandth of the force along it; otherwise it curls by less than 3 cm in a draw.

    The ring is summed for coefficients that all differ; a consistent load to first
    order in the friction (eq. 8-9).
    """
    law = law_in_general(kind)
    for motion in _MOTIONS:
        if isinstance(law, NetLaw):
            across, along, _ = law.accelerations(motion, stone)
        else:
            assert isinstance(law, LocalLaw)
            across, along = _ring_force(law, motion, stone)
            if load == Load.CONSISTENT:
                # eq. 8 on a thin ring
                lever = -2 * stone.h / stone.R
                p = lever * across
                q = lever * along
                across, along = _ring_force(law, motion, stone, p, q)
        if abs(across) > _LEAST_PUSH * abs(along):
            return True
    return False


def _ring_force(
    law: LocalLaw, motion: Motion, stone: Stone, p: float = 0.0, q: float = 0.0
) -> tuple[float, float]:
    """Force of the ring to the right and forward, over the weight, under the load
    1 + p xi + q eta (eq. 9)."""
    v, omega, turned, time = motion
    total_across = 0.0
    total_along = 0.0
    for front in (1.0, 0.0):
        angle = (2 * front - 1) * _POINTS
        points = ring_points(angle, v, stone.R * omega, turned, time, front=front)
        load = 1 + p * points.xi + q * points.eta
        across, along = law.traction(points._replace(load=load))
        total_across += float(np.mean(load * np.asarray(across))) / 2
        total_along += float(np.mean(load * np.asarray(along))) / 2
    return total_across, total_along
