"""Empirical accelerations of the whole stone."""

from typing import Any

from curlfit.friction.base import Motion, NetLaw, coefficient, power
from curlfit.stone import GRAVITY


def _sense(omega: Any) -> Any:
    """The sign of the spin, 0 without any."""
    return 1.0 * (omega > 0) - 1.0 * (omega < 0)


class SemiEmpirical(NetLaw):
    """Constant transverse force; deceleration and loss of spin are powers of the speed.

    It describes the motion without a model of the ring. The transverse force ends
    with the spin.
    """

    name = "semi-empirical"
    formula = "a_xi = -a sign(omega), a_eta = -c v^p, domega/dt = -q v^r sign(omega)"
    source = (
        "Jensen and Shegelski (2004), as cited by Ivanov and Shuvalov (2012), sect. 1"
    )
    predicts = "left"

    a: float = coefficient(
        0.005, "transverse acceleration", unit="m/s^2", typical=0.005, symbol="a"
    )
    c: float = coefficient(
        0.085,
        "deceleration at 1 m/s",
        unit="m/s^2",
        upper=10.0,
        typical=0.1,
        symbol="c",
    )
    p: float = coefficient(
        0.0,
        "exponent of the deceleration",
        lower=-0.9,
        upper=2.0,
        typical=0.5,
        symbol="p",
        signed=True,
    )
    q: float = coefficient(
        0.025,
        "loss of spin at 1 m/s",
        unit="rad/s^2",
        upper=10.0,
        typical=0.02,
        symbol="q",
    )
    r: float = coefficient(
        -0.3,
        "exponent of the loss of spin",
        lower=-0.9,
        upper=2.0,
        typical=0.5,
        symbol="r",
        signed=True,
    )

    def steepness(self) -> Any:
        return abs(self.p)

    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        sense = _sense(motion.omega)
        return (
            -self.a * sense,
            -self.c * power(motion.speed, self.p),
            -self.q * power(motion.speed, self.r) * sense,
        )


class Denny(NetLaw):
    """Constant friction; the path turns as the stone slows down, whatever the
    rate of spin.

    The loss of speed since release is mu g t.
    """

    name = "denny-1998"
    formula = (
        "a_xi = -sgn(omega) b v mu g t/(2 e R), a_eta = -mu g, "
        "domega/dt = -omega mu g/(e v)"
    )
    source = "Denny (1998), differentiated; as cited by the program jcurl"
    predicts = "left"

    mu: float = coefficient(0.0127, "coefficient of friction", symbol=r"\mu")
    b: float = coefficient(0.003, "asymmetry", typical=0.003, symbol="b")
    e: float = coefficient(
        2.63, "I/(m R^2)", lower=0.1, upper=100.0, typical=1.0, symbol="e"
    )

    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        braking = self.mu * GRAVITY
        turning = self.b * braking * motion.time / (2 * self.e * stone.R)
        return (
            -_sense(motion.omega) * turning * motion.speed,
            -braking,
            -motion.omega * braking / (self.e * motion.speed),
        )


class DigitalCurling(NetLaw):
    """The stone of the simulator DigitalCurling: friction falls with the speed.

    Its loss of spin, -q/max(v, 1 mm/s), is smooth here.
    """

    name = "fcv1"
    formula = (
        "a_xi = -sgn(omega) w v^(1 + n), a_eta = -g (f + d/(v + c)), "
        "domega/dt = -sgn(omega) q/v"
    )
    source = "DigitalCurling 3, simulator FCV1"
    predicts = "left"

    f: float = coefficient(
        0.00626286, "coefficient of friction at high speed", symbol="f"
    )
    d: float = coefficient(
        0.00200985, "its growth at low speed", unit="m/s", symbol="d"
    )
    c: float = coefficient(
        0.06385782,
        "speed of this growth",
        unit="m/s",
        lower=0.005,
        upper=20.0,
        typical=0.05,
        symbol="c",
    )
    w: float = coefficient(
        0.0082, "turning of the path at 1 m/s", unit="rad/s", symbol="w"
    )
    n: float = coefficient(
        -0.8,
        "exponent of the turning",
        lower=-1.9,
        upper=2.0,
        typical=0.5,
        symbol="n",
        signed=True,
    )
    q: float = coefficient(
        0.025,
        "loss of spin at 1 m/s",
        unit="rad/s^2",
        upper=10.0,
        typical=0.02,
        symbol="q",
    )

    SLOWEST = 1e-3  # m/s

    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        sense = _sense(motion.omega)
        v = motion.speed
        return (
            -sense * self.w * power(v, 1 + self.n),
            -GRAVITY * (self.f + self.d / (v + self.c)),
            -sense * self.q * power(v**2 + self.SLOWEST**2, -0.5),
        )
