"""Whether a law can make a stone curl."""

from __future__ import annotations

from functools import lru_cache
from typing import TypeVar

import numpy as np

from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, RingPoint
from curlfit.loads import Load
from curlfit.stone import Stone

AnyLaw = TypeVar("AnyLaw", bound=Law)
# polar angles on one half of the ring, rad
_POINTS = np.pi * (np.arange(32) + 0.5) / 32
# v (m/s), omega (1/s), turned, time (s)
_STATES = ((2.0, 1.2, 0.5, 0.5), (1.0, 1.2, 2.0, 5.0))
_LEAST_PUSH = 1e-3  # force across over force along the motion: 3 cm of curl on 28 m


def law_in_general(kind: type[AnyLaw]) -> AnyLaw:
    """A law near its default coefficients, none of which has a special value."""
    return kind.from_vector(
        [
            item.default + 0.1 * (j + 1) * item.typical
            for j, item in enumerate(kind.coefficients())
        ]
    )


@lru_cache(256)
def can_curl(kind: type[Law], load: Load, stone: Stone) -> bool:
    """Whether friction can push a slowly spinning stone across its motion by more than
    a thousandth of the force along it; otherwise it curls by less than 3 cm in a draw.

    The ring is summed for coefficients that all differ; a consistent load to first
    order in the friction (eq. 8-9).
    """
    law = law_in_general(kind)
    for v, omega, turned, time in _STATES:
        if isinstance(law, NetLaw):
            across, along, _ = law.accelerations(Motion(v, omega, turned, time), stone)
        else:
            assert isinstance(law, LocalLaw)
            across, along = _ring_force(law, v, stone.R * omega, turned, time)
            if load == Load.CONSISTENT:
                # n1 R/n0 = lever T_xi, n2 R/n0 = lever T_eta
                lever = -2 * stone.h / stone.R
                tilt = lever * across, lever * along
                across, along = _ring_force(law, v, stone.R * omega, turned, time, tilt)
        if abs(across) > _LEAST_PUSH * abs(along):
            return True
    return False


def _ring_force(
    law: LocalLaw,
    v: float,
    u: float,
    turned: float,
    time: float,
    tilt: tuple[float, float] = (0.0, 0.0),
) -> tuple[float, float]:
    """Force of the ring to the right and forward, over the weight; `u` is R omega."""
    force = np.zeros(2)
    for front in (1.0, 0.0):
        angle = (2 * front - 1) * _POINTS
        xi, eta = np.cos(angle), np.sin(angle)
        slide_xi, slide_eta = -u * eta, v + u * xi  # eq. 16
        speed, load = np.hypot(slide_xi, slide_eta), 1 + tilt[0] * xi + tilt[1] * eta
        points = RingPoint(
            xi,
            eta,
            angle,
            front,
            slide_xi,
            slide_eta,
            speed,
            slide_xi / speed,
            slide_eta / speed,
            load,
            v,
            u,
            turned,
            time,
        )
        force += [
            float(np.mean(load * np.asarray(part))) / 2 for part in law.traction(points)
        ]
    return float(force[0]), float(force[1])
