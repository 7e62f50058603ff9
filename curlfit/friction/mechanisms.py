"""Forces that turn the path of a stone without braking it: terms of sums, as
in "power+sideways".

Each is a traction on the ring, proportional to the load, of which only the force and
the moment matter. The slow side is where rotation opposes the motion, the left of a
counter-clockwise stone.
"""

from typing import Any

from curlfit.friction.base import LocalLaw, RingPoint, arctan, coefficient, power
from curlfit.stone import GRAVITY

_SLOWEST = 1e-2
"""Speed in m/s below which a force ceases, lest a stone turn ever faster as it comes to
rest, and R omega below which the torque of a pivot does, which ends the spin of a
moving stone"""
_USUAL_RIM = 0.065
"""R omega in m/s of a ring of 65 mm at 1 rad/s, a turn in 6 s"""
_SIDE = 1e-3
"""R omega in m/s below which the side of a force changes gradually"""


def _to_the_slow_side(u: Any, exponent: float, slowest: float = _SIDE) -> Any:
    """-sgn(u) |u|^exponent, smooth where u changes its sign."""
    return -u * power(u**2 + slowest**2, (exponent - 1) / 2)


class Sideways(LocalLaw):
    """A force to the slow side without torque, a power of the speed whatever the
    rate of spin.

    Pivot-slide models give n = 2, scratch-guiding with a friction like v^-1/2
    gives n = -1/2.
    """

    name = "sideways"
    brakes = False
    formula = "a_xi = -sgn(omega) a (v/(1 m/s))^n, no torque"
    source = (
        "our reading of pivot-slide (Shegelski and Lozowski 2016) and scratch-guiding "
        "(Nyberg et al. 2013), of which no formula could be read"
    )
    predicts = "left"

    a: float = coefficient(
        0.005, "sideways acceleration at 1 m/s", unit="m/s^2", typical=0.005, symbol="a"
    )
    n: float = coefficient(
        0.0,
        "exponent of the speed",
        lower=-0.9,
        upper=3.0,
        typical=0.5,
        symbol="n",
        signed=True,
        usual=(0.0, 1.0),  # from n = -1/2 to n = 2 in the models of it
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        size = (
            self.a
            / GRAVITY
            * point.v
            * power(point.v**2 + _SLOWEST**2, (self.n - 1) / 2)
        )
        return size * _to_the_slow_side(point.u, 0.0), 0.0


class Deflection(LocalLaw):
    """A force to the slow side without torque, a power of the rate of spin whatever the
    speed: what the curl of a draw tells, and no more.

    Models whose force grows with R omega/v give m = 1, those that hold whatever the
    spin m = 0.
    """

    name = "deflection"
    brakes = False
    formula = "a_xi = -sgn(omega) a (R |omega|/(0.065 m/s))^m, no torque"
    source = (
        "an empirical law in the numbers of a draw: between the forces of `sideways` "
        "(m = 0) and `transverse` (m = 1)"
    )
    predicts = "left"

    a: float = coefficient(
        0.005,
        "sideways acceleration at R omega = 0.065 m/s",
        unit="m/s^2",
        typical=0.005,
        symbol="a",
    )
    m: float = coefficient(
        0.5,
        "exponent of the spin",
        lower=-1.0,
        upper=2.0,
        typical=0.5,
        symbol="m",
        signed=True,
        usual=(0.5, 0.5),  # what the models of it say, from m = 0 to m = 1
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        moving = point.v * power(point.v**2 + _SLOWEST**2, -0.5)
        side = _to_the_slow_side(point.u / _USUAL_RIM, self.m, _SIDE / _USUAL_RIM)
        return self.a / GRAVITY * moving * side, 0.0


class Transverse(LocalLaw):
    """A force proportional to the angle between the velocities in front of the
    ring and behind.

    Without torque. In a draw it has the shape of the front-back law, as long as R
    omega < v/10.
    """

    name = "transverse"
    brakes = False
    formula = "a_xi = -2 b arctan(R omega/v), no torque"
    source = "our reading of Honkanen (2018), fig. 5"
    predicts = "left"

    b: float = coefficient(
        0.05,
        "sideways acceleration over the angle",
        unit="m/s^2",
        typical=0.05,
        symbol="b",
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        speed = power(point.v**2 + _SLOWEST**2, 0.5)
        angle = 2 * arctan(point.u / speed)
        return -self.b / GRAVITY * angle * point.v / speed, 0.0


class Pivot(LocalLaw):
    """A force at the slowest point of the ring, to its side; more for a slowly
    spinning stone.

    The force is applied with the torque that it has about the centre, against the spin.
    """

    name = "pivot"
    brakes = False
    formula = "F_xi = -sgn(omega) m g q (R |omega|/(1 m/s))^-1/2, M = R F_xi"
    source = "Leaney (2020), as implemented by J. Poole (2025)"
    predicts = "left"

    q: float = coefficient(
        1.1e-4, "force over the weight at R omega = 1 m/s", typical=1e-4, symbol="q"
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        push = self.q * _to_the_slow_side(point.u, -0.5, _SLOWEST)
        return push * (1 - point.eta), push * point.xi  # the torque along the ring
