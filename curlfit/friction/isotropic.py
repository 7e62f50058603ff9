"""Isotropic friction: it opposes sliding, with a coefficient that depends on point and motion."""

from typing import Any

from curlfit.friction.base import LocalLaw, RingPoint, coefficient, power


def _opposing(mu: Any, point: RingPoint) -> tuple[Any, Any]:
    return -mu * point.e_xi, -mu * point.e_eta  # eq. 3-4


class Coulomb(LocalLaw):
    """Friction opposes sliding with constant magnitude."""

    name = "coulomb"
    formula = "t = -mu n v/|v|"
    source = "Ivanov and Shuvalov (2012), eq. 3-4"
    predicts = "right with consistent load (Prop. 2), not at all with uniform load"

    mu: float = coefficient(0.01, "coefficient of friction", symbol=r"\mu")

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu, point)


class Power(LocalLaw):
    """Friction is a power of the sliding speed; Penner found that it falls with the speed.

    Below about 1 mm/s the coefficient is finite and constant, so that a stone can come to rest.
    """

    name = "power"
    formula = "t = -mu n v/|v|, mu = c (|v|/(1 m/s))^k"
    source = "Penner (2001), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "right with consistent load (Prop. 3), not at all with uniform load"

    c: float = coefficient(0.008, "coefficient of friction at 1 m/s", symbol="c")
    k: float = coefficient(-0.5, "exponent of the sliding speed", lower=-0.7, upper=2.0,
                           typical=0.5, symbol="k", signed=True)  # fmt: skip

    SLOWEST = 1e-3  # m/s

    def steepness(self) -> Any:
        return abs(self.k)

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.c * power(point.speed**2 + self.SLOWEST**2, self.k / 2), point)


class Pressure(LocalLaw):
    """Friction falls with the pressure. Under uniform load it is Coulomb's."""

    name = "pressure"
    formula = "t = -mu n v/|v|, mu = mu0 (n/n0)^-k"
    source = "Johnston (1981), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "right where k < 1, left where k > 1, with consistent load; else not at all"

    mu0: float = coefficient(0.01, "coefficient of friction at the mean load", symbol=r"\mu_0")
    k: float = coefficient(0.5, "exponent of the load", upper=3.0, typical=0.5, symbol="k",
                           signed=True)  # fmt: skip

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 * power(point.load, -self.k), point)


class Angular(LocalLaw):
    """Friction differs between the front and the back of the ring, smoothly."""

    name = "angular"
    formula = "t = -mu n v/|v|, mu = mu0 (1 - f0 cos theta), theta from the front of the ring"
    source = "Shegelski (2000), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "left where f0 > 0"

    mu0: float = coefficient(0.009, "coefficient of friction at the sides", symbol=r"\mu_0")
    f0: float = coefficient(
        0.3, "relative drop at the front", lower=-1.0, typical=0.5, symbol="f_0", signed=True
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 * (1 - self.f0 * point.eta), point)


class Stribeck(LocalLaw):
    """Friction is linear in speed over load, as on part of the Stribeck curve."""

    name = "stribeck"
    formula = "t = -mu n v/|v|, mu = mu0 + mu1 |v| n0/n"
    source = "Ivanov and Shuvalov (2012), eq. 10-11"
    predicts = (
        "right where mu0 > 0, left where mu0 < 0, with consistent load, while friction slows it "
        "(Prop. 4)"
    )

    mu0: float = coefficient(0.006, "coefficient of friction at rest", lower=-1.0,
                             symbol=r"\mu_0")  # fmt: skip
    mu1: float = coefficient(0.002, "growth with the speed", unit="s/m", lower=-1.0,
                             symbol=r"\mu_1")  # fmt: skip

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 + self.mu1 * point.speed / point.load, point)
