"""Anisotropic friction that differs between the front and the back half of the ring."""

from math import pi
from typing import Any

from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, RingPoint, coefficient
from curlfit.stone import GRAVITY


class _FrontBackCoefficients(Law):
    sums = (("mu1_eta", "mu2_eta"),)  # columns of tables; a fit finds them by itself

    mu1_xi: float = coefficient(
        0.005,
        "front half, across the motion",
        symbol=r"\mu_{1\xi}",
        usual=(0.005, 0.005),  # fits of eq. 12
    )
    mu2_xi: float = coefficient(
        0.05, "back half, across the motion", symbol=r"\mu_{2\xi}"
    )
    mu1_eta: float = coefficient(
        0.009, "front half, along the motion", symbol=r"\mu_{1\eta}"
    )
    mu2_eta: float = coefficient(
        0.009, "back half, along the motion", symbol=r"\mu_{2\eta}"
    )


class FrontBack(_FrontBackCoefficients, LocalLaw):
    """Friction across and along the motion with separate coefficients on each half
    of the ring.

    Under uniform load only `mu1_eta + mu2_eta` enters the motion. The mirror eta ->
    -eta takes the front half to the back half. There the velocity of sliding
    (-u eta, v + u xi), u = R omega, has the same component along the motion and the
    opposite one across it: e_eta stays, e_xi changes its sign. With the means < > over
    the front half, friction per unit load and its moment are, for every spin,

        T_xi  = -(mu1_xi - mu2_xi) <e_xi>/2
        T_eta = -(mu1_eta + mu2_eta) <e_eta>/2
        M     = -(mu1_eta + mu2_eta) <xi e_eta>/2 + (mu1_xi + mu2_xi) <eta e_xi>/2

    The curl tells the difference of the coefficients across the motion, the spin their
    sum, and nothing tells those along it apart (`ring_polynomials.mean_of_half` has
    these signs; under another load the mirror does not hold).
    """

    name = "front-back"
    formula = (
        "t = -n (mu_xi v_xi, mu_eta v_eta)/|v|, mu1 where eta > 0, mu2 where eta < 0"
    )
    source = "Ivanov and Shuvalov (2012), eq. 25-26"
    predicts = "left where mu2_xi > mu1_xi"

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        mu_xi = self.mu2_xi + (self.mu1_xi - self.mu2_xi) * point.front
        mu_eta = self.mu2_eta + (self.mu1_eta - self.mu2_eta) * point.front
        return -mu_xi * point.e_xi, -mu_eta * point.e_eta


class FrontBackFirstOrder(_FrontBackCoefficients, NetLaw):
    """The front-back law to first order in epsilon = R omega/v: the paper's own model.

    Accurate to 0.3 % for epsilon < 0.1; it diverges as the stone comes to rest. For
    comparison with the paper; otherwise use `front-back`.
    """

    name = "front-back-first-order"
    approximates = "front-back"
    formula = (
        "a_xi = eps g (mu1_xi - mu2_xi)/pi, a_eta = -g (mu1_eta + mu2_eta)/2, "
        "rho^2 domega/dt = -eps g R (mu1_xi + mu2_xi)/4"
    )
    source = "Ivanov and Shuvalov (2012), eq. 27"
    predicts = "left where mu2_xi > mu1_xi"

    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        epsilon = stone.R * motion.omega / motion.speed
        return (
            epsilon * GRAVITY * (self.mu1_xi - self.mu2_xi) / pi,
            -GRAVITY * (self.mu1_eta + self.mu2_eta) / 2,
            -epsilon
            * GRAVITY
            * stone.R
            * (self.mu1_xi + self.mu2_xi)
            / (4 * stone.rho**2),
        )
