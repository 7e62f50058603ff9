"""Friction reduced by debris that adheres to the ring."""

from math import e, pi
from typing import Any

from curlfit.friction.base import Edges, LocalLaw, RingPoint, coefficient


class Debris(LocalLaw):
    """Ice debris lowers the friction of each part of the ring that was once in front.

    At release the ring is clean. Its front half is fouled immediately, or within the
    time constant `tau`; the fouled part grows with the rotation, and after half a turn
    the whole ring is fouled and the curl ends. The law depends on the angle turned
    alone: a part that is rotated back counts as clean again.
    """

    name = "debris"
    formula = (
        "t = -mu n v/|v|, mu_dirty where the ring was once in front, else mu_clean"
    )
    source = "Denny (2002), as cited by Ivanov and Shuvalov (2012), sect. 1"
    predicts = "left for half a turn where mu_dirty < mu_clean, then not at all"
    corners = (-pi, 0.0, pi)

    mu_clean: float = coefficient(0.013, "clean ring", symbol=r"\mu_\mathrm{clean}")
    mu_dirty: float = coefficient(0.008, "fouled ring", symbol=r"\mu_\mathrm{dirty}")
    tau: float = coefficient(
        0.0,
        "time constant of fouling after release",
        unit="s",
        upper=30.0,
        typical=2.0,
        symbol=r"\tau",
        optional=True,
    )

    def edges(self, turned: Any) -> Edges:
        counter_clockwise = 1.0 * (turned >= 0)
        return Edges(back=(turned - pi * counter_clockwise,))

    def quickness(self, time: Any) -> Any:
        gradual = self.tau > 0
        tau = self.tau + 1.0 * (self.tau <= 0)
        # exp(-time/tau) needs less resolution as it decays.
        return gradual * e ** (-time / (6 * tau)) / tau

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        # Polar angles 0 .. pi + turned are fouled (turned .. pi, clockwise).
        behind = (point.angle <= point.turned - pi) | (point.angle >= point.turned)
        fouled = point.front + (1 - point.front) * behind
        gradual = self.tau > 0
        fouled *= 1 - gradual * e ** (-point.time / (self.tau + 1.0 * (self.tau <= 0)))
        mu = self.mu_clean + (self.mu_dirty - self.mu_clean) * fouled
        return -mu * point.e_xi, -mu * point.e_eta
