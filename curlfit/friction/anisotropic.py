"""Anisotropic friction: a constant tensor, or along the radius and the tangent
of the ring."""

from typing import Any

from curlfit.friction.base import LocalLaw, RingPoint, coefficient


class Radial(LocalLaw):
    """Friction along the radius and the tangent of the ring, sliding
    outward and inward.

    A point slides outward on the front half and inward on the back half,
    whatever the spin.
    """

    name = "radial"
    formula = (
        "t = -n (mu_n a n + mu_t b tau)/|v|, (mu1, mu3) where a > 0, "
        "(mu2, mu4) where a < 0"
    )
    source = "Ivanov and Shuvalov (2012), eq. 18-24"
    predicts = "left where mu1 + 2 mu3 < mu2 + 2 mu4, if R |omega| < v"

    mu1: float = coefficient(0.006, "outward, along the radius", symbol=r"\mu_1")
    mu2: float = coefficient(0.008, "inward, along the radius", symbol=r"\mu_2")
    mu3: float = coefficient(0.008, "outward, along the tangent", symbol=r"\mu_3")
    mu4: float = coefficient(0.018, "inward, along the tangent", symbol=r"\mu_4")

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        outward = point.e_xi * point.xi + point.e_eta * point.eta  # a/|v| of eq. 19
        tangential = point.e_eta * point.xi - point.e_xi * point.eta  # b/|v|
        # eq. 20
        along_radius = (self.mu2 + (self.mu1 - self.mu2) * point.front) * outward
        along_tangent = (self.mu4 + (self.mu3 - self.mu4) * point.front) * tangential
        return (
            -(along_radius * point.xi - along_tangent * point.eta),
            -(along_radius * point.eta + along_tangent * point.xi),
        )


class Tensor(LocalLaw):
    """A constant, symmetric, positive definite tensor of friction in the moving frame.

    Its off-diagonal term deflects the stone independently of the spin; mirroring a
    throw changes its sign.
    """

    name = "tensor"
    formula = "t = -n B v/|v|, B = ((b11, b12), (b12, b22)) along (xi, eta)"
    source = "Ivanov and Shuvalov (2012), eq. 5"
    predicts = "left where b12 > 0, for either sense of spin"

    b11: float = coefficient(0.02, "across the motion", symbol="b_{11}")
    b22: float = coefficient(0.009, "along the motion", symbol="b_{22}")
    b12: float = coefficient(
        0.0005, "off-diagonal", lower=-1.0, symbol="b_{12}", signed=True
    )

    def fault(self) -> str | None:
        if self.b11 > 0 and self.b22 > 0 and self.b12**2 < self.b11 * self.b22:
            return None
        return (
            "B is not positive definite: expected b11 > 0, b22 > 0 and b12^2 < b11 b22"
        )

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        return (
            -(self.b11 * point.e_xi + self.b12 * point.e_eta),
            -(self.b12 * point.e_xi + self.b22 * point.e_eta),
        )
