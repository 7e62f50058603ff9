"""Paths of a stone under every law of curlfit, by none of its code.

Formulas and integration are those of `tests/independent_laws.py` and
`tests/independent_motion.py`, with fewer points on the ring and wider tolerances than
in the tests: a path is exact to 1e-5 m.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

sys.path.append(str(Path(__file__).parents[1]))

from independent_laws import FORMULAS, motion_of_the_whole, reference
from independent_motion import Accuracy, G, Motion, Reference, Start, integrated

NODES = 24
ACCURACY = Accuracy(relative=1e-6, absolute=1e-6, rest=1e-6)
LONGEST = 300.0  # s


class Stone(NamedTuple):
    """A stone, SI: radii of the contact ring and of gyration, height of the centre of
    mass."""

    R: float = 0.065
    rho: float = 0.1
    h: float = 0.057


def ring_of(law: str, coefficients: Mapping[str, float]) -> Reference:
    """A law at the points of the ring, under uniform load."""
    values = tuple(coefficients.values())
    return reference(law, values, "uniform", Stone(), NODES, ACCURACY)


def moved(
    law: str,
    coefficients: Mapping[str, float],
    v0: float,
    omega0: float,
    until: float = LONGEST,
) -> Motion:
    """The motion from the origin along +y, until rest.

    The coefficients are in the order of the law; optional ones may be left out.
    """
    start = Start(v=v0, omega=omega0)
    if law in FORMULAS:
        return ring_of(law, coefficients).motion(start, until)
    values = tuple(coefficients.values())
    return motion_of_the_whole(law, values, Stone(), start, until, ACCURACY)


def moved_with(
    law: str,
    coefficients: Mapping[str, float],
    v0: float,
    omega0: float,
    until: float,
    factor: Callable[[float, float], float],
) -> Motion:
    """The motion under a law at the points of the ring, with its friction times a
    factor that is a function of speed and time."""
    ring = ring_of(law, coefficients)
    stone = Stone()

    def accelerations(
        v: float, omega: float, turned: float, time: float
    ) -> tuple[float, float, float]:
        friction = factor(v, time) * ring.force(v, stone.R * omega, turned, time)
        a_xi, a_eta, moment = G * friction
        return a_xi, a_eta, moment * stone.R / stone.rho**2

    start = Start(v=v0, omega=omega0)
    return integrated(start, until, [(accelerations, None)], stone.rho, ACCURACY)


def simulated(
    law: str,
    coefficients: Mapping[str, float],
    v0: float,
    omega0: float,
    times: np.ndarray,
) -> np.ndarray:
    """x, y, phi at the times, shape (3, n); held after rest."""
    return moved(law, coefficients, v0, omega0, times[-1]).at(times)


def distance(motion: Motion) -> float:
    """How far along y the stone comes, m."""
    return float(motion.at(np.array([motion.end]))[1, 0])


def crossing(motion: Motion, y: float) -> float:
    """The time at which the stone crosses a line that it passes, s."""
    return brentq(lambda t: motion.at(np.array([t]))[1, 0] - y, 0.0, motion.end)


def braking(
    law: str,
    coefficients: Mapping[str, float],
    speeds: np.ndarray,
) -> np.ndarray:
    """Braking force over the weight of a stone without spin, of a law at the points of
    the ring."""
    ring = ring_of(law, coefficients)
    return np.array([-ring.force(speed, 0.0)[1] for speed in speeds])
