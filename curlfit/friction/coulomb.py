"""Isotropic friction with a constant coefficient."""

from typing import Any

from curlfit.friction.base import LocalLaw, RingPoint, coefficient


class Coulomb(LocalLaw):
    """Friction opposes sliding with constant magnitude (eq. 3-4 with constant mu)."""

    name = "coulomb"
    formula = "t = -mu n v/|v|"
    source = "Ivanov and Shuvalov (2012), eq. 3-4"
    predicts = "right with consistent load (Prop. 2), straight with uniform load"

    mu: float = coefficient(0.01, "coefficient of friction", symbol=r"\mu")

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return -self.mu * point.e_xi, -self.mu * point.e_eta
