"""Isotropic friction: it opposes sliding, with a coefficient that depends on
point and motion."""

from typing import Any

from curlfit.friction.base import LocalLaw, RingPoint, coefficient, exp, power


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
    """Friction is a power of the sliding speed; Penner found that it falls
    with the speed.

    Below about 1 mm/s the coefficient is finite and constant, so that a stone can
    come to rest.
    """

    name = "power"
    formula = "t = -mu n v/|v|, mu = c (|v|/(1 m/s))^k"
    source = "Penner (2001), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "right with consistent load (Prop. 3), not at all with uniform load"

    c: float = coefficient(0.008, "coefficient of friction at 1 m/s", symbol="c")
    k: float = coefficient(
        -0.5,
        "exponent of the sliding speed",
        lower=-0.7,
        upper=2.0,
        typical=0.5,
        symbol="k",
        signed=True,
        usual=(-0.25, 0.25),  # from constant friction to that of Penner (2001)
    )

    SLOWEST = 1e-3  # m/s

    def steepness(self) -> Any:
        return abs(self.k)

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(
            self.c * power(point.speed**2 + self.SLOWEST**2, self.k / 2), point
        )


class Pressure(LocalLaw):
    """Friction falls with the pressure. Under uniform load it is Coulomb's."""

    name = "pressure"
    formula = "t = -mu n v/|v|, mu = mu0 (n/n0)^-k"
    source = "Johnston (1981), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = (
        "right where k < 1, left where k > 1, with consistent load; else not at all"
    )

    mu0: float = coefficient(
        0.01, "coefficient of friction at the mean load", symbol=r"\mu_0"
    )
    k: float = coefficient(
        0.5, "exponent of the load", upper=3.0, typical=0.5, symbol="k", signed=True
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 * power(point.load, -self.k), point)


class Angular(LocalLaw):
    """Friction differs between the front and the back of the ring, smoothly."""

    name = "angular"
    formula = (
        "t = -mu n v/|v|, mu = mu0 (1 - f0 cos theta), theta from the front of the ring"
    )
    source = "Shegelski (2000), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "left where f0 > 0"

    mu0: float = coefficient(
        0.009, "coefficient of friction at the sides", symbol=r"\mu_0"
    )
    f0: float = coefficient(
        0.3,
        "relative drop at the front",
        lower=-1.0,
        typical=0.5,
        symbol="f_0",
        signed=True,
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 * (1 - self.f0 * point.eta), point)


class PowerAngular(Power):
    """Friction is a power of the sliding speed, lower in front than behind."""

    name = "power-angular"
    formula = "t = -mu n v/|v|, mu = c (|v|/(1 m/s))^k (1 - f0 cos theta)"
    source = "Maeno (2014), as implemented by G. Ogden"
    predicts = "left where f0 > 0"

    f0: float = coefficient(
        0.3,
        "relative drop at the front",
        lower=-1.0,
        typical=0.5,
        symbol="f_0",
        signed=True,
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        across, along = super().traction(point)
        factor = 1 - self.f0 * point.eta
        return factor * across, factor * along


class Sutor(LocalLaw):
    """Friction has a minimum in the sliding speed, and is lower in front; less so
    for fast spin."""

    name = "sutor"
    formula = (
        "t = -mu n v/|v|, mu = f_min (s + v_b^2/s)/(2 v_b) (1 - (1 - exp(-alpha cos "
        "theta)) exp(1 - R |omega|/u0)), s = |v| + v_b (r - sqrt(r^2 - 1))"
    )
    source = "Sutor (1988), with u0 = R omega0 and r = f0/f_min"
    predicts = "left"

    f_min: float = coefficient(
        0.0066, "least coefficient of friction", symbol=r"f_\mathrm{min}"
    )
    r: float = coefficient(
        2.0,
        "coefficient at rest over the least",
        lower=1.01,
        upper=50.0,
        typical=1.0,
        symbol="r",
    )
    v_b: float = coefficient(
        2.0,
        "speed of the minimum, plus what is added to the speed",
        unit="m/s",
        lower=0.05,
        upper=20.0,
        typical=1.0,
        symbol="v_b",
    )
    alpha: float = coefficient(
        0.2, "drop from behind to the front", upper=5.0, typical=0.3, symbol=r"\alpha"
    )
    u0: float = coefficient(
        0.065,
        "R omega at which the drop is alpha",
        unit="m/s",
        lower=0.01,
        upper=10.0,
        typical=0.05,
        symbol="u_0",
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        shifted = point.speed + self.v_b * (self.r - power(self.r**2 - 1, 0.5))
        mu = self.f_min / (2 * self.v_b) * (shifted + self.v_b**2 / shifted)
        asymmetry = (1 - exp(-self.alpha * point.eta)) * exp(1 - abs(point.u) / self.u0)
        return _opposing(mu * (1 - asymmetry), point)


class Stribeck(LocalLaw):
    """Friction is linear in speed over load, as on part of the Stribeck curve."""

    name = "stribeck"
    formula = "t = -mu n v/|v|, mu = mu0 + mu1 |v| n0/n"
    source = "Ivanov and Shuvalov (2012), eq. 10-11"
    predicts = (
        "right where mu0 > 0, left where mu0 < 0, with consistent load, "
        "while friction slows it (Prop. 4)"
    )

    mu0: float = coefficient(
        0.006, "coefficient of friction at rest", lower=-1.0, symbol=r"\mu_0"
    )
    mu1: float = coefficient(
        0.002, "growth with the speed", unit="s/m", lower=-1.0, symbol=r"\mu_1"
    )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return _opposing(self.mu0 + self.mu1 * point.speed / point.load, point)
