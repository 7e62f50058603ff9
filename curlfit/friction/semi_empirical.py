"""Empirical accelerations of the whole stone."""

from typing import Any

from curlfit.friction.base import Motion, NetLaw, coefficient, power


class SemiEmpirical(NetLaw):
    """Constant transverse force; deceleration and loss of spin are powers of the speed.

    It describes the motion without a model of the ring. The transverse force ends with the spin.
    """

    name = "semi-empirical"
    formula = "a_xi = -a sign(omega), a_eta = -c v^p, domega/dt = -q v^r sign(omega)"
    source = "Jensen and Shegelski (2004), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "left"

    a: float = coefficient(0.005, "transverse acceleration", unit="m/s^2", typical=0.005,
                           symbol="a")  # fmt: skip
    c: float = coefficient(0.085, "deceleration at 1 m/s", unit="m/s^2", upper=10.0, typical=0.1,
                           symbol="c")  # fmt: skip
    p: float = coefficient(0.0, "exponent of the deceleration", lower=-0.9, upper=2.0, typical=0.5,
                           symbol="p", signed=True)  # fmt: skip
    q: float = coefficient(0.025, "loss of spin at 1 m/s", unit="rad/s^2", upper=10.0, typical=0.02,
                           symbol="q")  # fmt: skip
    r: float = coefficient(-0.3, "exponent of the loss of spin", lower=-0.9, upper=2.0, typical=0.5,
                           symbol="r", signed=True)  # fmt: skip

    def steepness(self) -> Any:
        return abs(self.p)

    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        sense = 1.0 * (motion.omega > 0) - 1.0 * (motion.omega < 0)
        return (
            -self.a * sense,
            -self.c * power(motion.speed, self.p),
            -self.q * power(motion.speed, self.r) * sense,
        )
