"""Printed results of Ivanov and Shuvalov (2012): trajectory, coefficients,
first-order model; and the records of what is computed beside them.

A. P. Ivanov, N. D. Shuvalov, "Friction in curling game"; equation numbers are theirs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from curlfit.friction.front_back import FrontBackFirstOrder
from curlfit.numerics.arrays import Floats
from curlfit.output.files import atomic_write
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.reference import Reference
from curlfit.throws.synthetic import write_table
from curlfit.throws.throw import Throw

EQ_28 = {"mu1_xi": 0.0018, "mu2_xi": 0.058, "mu1_eta + mu2_eta": 0.018}
"""Coefficients of the front-back law as printed in eq. 28."""

EQ_28_STONE = Stone(R=0.054, rho=0.1)
"""Ring radius of eq. 28 and radius of gyration as printed."""

SOLID_RHO = 0.1025
"""Radius of gyration of a solid cylinder of 29 cm diameter, 0.145 m/sqrt(2), m."""

EQ_28_UNTIL = 20.0
"""End of the time window of eq. 12 in the paper, s."""

RADIUS = 0.065
"""Ring radius of sect. 4, m; the 0.032 of eq. 17 corresponds to it."""

RHO = 0.1
"""Radius of gyration of sect. 4, m."""

PRINTED: Floats = np.array([*EQ_28.values()])
"""The coefficients of eq. 28, as those of a `Row`."""

HALF_DIGIT: Floats = np.array([0.00005, 0.0005, 0.0005])
"""Half a unit of the last printed digit of each coefficient."""


class Row(NamedTuple):
    """Eq. 28 computed by one method from the times up to `window`."""

    method: str
    radius: float
    rho: float
    window: float
    mu: Floats
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta"""


class Counts(NamedTuple):
    """Numbers of states of motion that exist."""

    states: int
    left: int
    """deviating to the left, for counter-clockwise spin"""
    slow: int
    """|eps| < 1: the instant centre of velocities is outside the base"""
    slow_left: int
    speeds_up: int
    remark: int
    """as the remark on Prop. 3 says: to the left, n1 > 0, n2 < 0, speeding up"""


class Configuration(NamedTuple):
    """Position and angle as functions of time: x, y in m, phi in rad."""

    x: Any
    y: Any
    phi: Any


def jensen_shegelski(t: ArrayLike) -> Configuration:
    """The fitted trajectory of Jensen and Shegelski (2004), eq. 12, for t in
    s on [0, 23]."""
    return eq_12(np.asarray(t, float))


def eq_12(t: Any) -> Configuration:
    """The formula of eq. 12 itself, for a number or array of any library,
    differentiable by JAX."""
    rest = 1 - t / 23
    return Configuration(
        x=-(0.004 * t**2 - 0.185 * t + 2.98 * (1 - rest**1.43)),
        y=25 * (1 - rest**1.897),
        phi=16.58 * (1 - (1 - t / 24) ** 1.455),
    )


def jensen_shegelski_throw() -> Throw:
    """Eq. 12 every 0.1 s on 0..22.9 s, with the settings of sect. 4 and eq. 28
    as reference."""
    t = np.arange(230) / 10
    return Throw.from_arrays(
        t,
        *jensen_shegelski(t),
        name="eq. 12",
        reference=Reference(
            "eq. 28",
            "front-back",
            EQ_28,
            stone={"rho": SOLID_RHO},
            rounding={"R": 0.0005, "rho": 0.0025},
            note=(
                "rho is printed rounded, as 0.1 m; that of a solid cylinder of the "
                "printed diameter, 29 cm, is 0.1025 m"
            ),
        ),
        defaults={
            "until": EQ_28_UNTIL,
            "stone": {"R": EQ_28_STONE.R, "rho": EQ_28_STONE.rho},
        },
    )


def write_jensen_shegelski(file: str | Path) -> None:
    """Write eq. 12 as the data file that ships with curlfit."""
    head = (
        "# Eq. 12 of Ivanov and Shuvalov (2012): a formula fitted by Jensen and "
        "Shegelski (2004)\n"
        "# to measured throws. See README.md beside this file.\n"
    )
    atomic_write(Path(file), head + write_table(jensen_shegelski_throw()))


class FirstOrderMotion(NamedTuple):
    """Motion under eq. 27: x, y in m, phi and heading in rad, v in m/s,
    omega in rad/s."""

    x: Floats
    y: Floats
    phi: Floats
    heading: Floats
    v: Floats
    omega: Floats


def first_order_motion(
    law: FrontBackFirstOrder, stone: Stone, v0: float, omega0: float, t: ArrayLike
) -> FirstOrderMotion:
    """Eq. 27 in closed form, from the origin along +y, for times before the
    stone stops.

    With `a = g (mu1_eta + mu2_eta)/2` and `k = g R^2 (mu1_xi + mu2_xi)/(4 rho^2)`:
    `v = v0 - a t`, `omega = omega0 (v/v0)^(k/a)`; the angle turned and the heading are
    powers of `v` as well. x and y are integrals of these closed forms, by 64-point
    Gauss quadrature.

    Raises
    ------
    ValueError : a time is not before the stop at `v0/a`, where the first-order law
        has no meaning.
    """
    t = np.asarray(t, float)
    a = GRAVITY * (law.mu1_eta + law.mu2_eta) / 2
    # k/a, the power of v with which the spin decays
    p = GRAVITY * stone.R**2 * (law.mu1_xi + law.mu2_xi) / (4 * stone.rho**2) / a
    # d(heading)/dt v^2/omega
    turning = GRAVITY * stone.R * (law.mu1_xi - law.mu2_xi) / np.pi
    if np.any(a * t >= v0):
        raise ValueError(f"the stone stops at {v0 / a:.6g} s; give earlier times")

    def heading(s: Floats) -> Floats:  # s = v/v0
        power = -np.log(s) if abs(p - 1) < 1e-12 else (1 - s ** (p - 1)) / (p - 1)
        return turning * omega0 / (a * v0) * power

    s = 1 - a * t / v0
    # Gauss points between the start and each time, along a last axis of 64
    nodes, weights = np.polynomial.legendre.leggauss(64)
    s_between = 1 - a * (t[..., None] * (nodes + 1) / 2) / v0
    beta = heading(s_between)
    dt = t[..., None] * weights / 2
    return FirstOrderMotion(
        x=np.sum(dt * v0 * s_between * np.sin(beta), -1),
        y=np.sum(dt * v0 * s_between * np.cos(beta), -1),
        phi=omega0 * v0 / (a * (1 + p)) * (1 - s ** (1 + p)),
        heading=heading(s),
        v=v0 * s,
        omega=omega0 * s**p,
    )
