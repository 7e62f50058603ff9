"""Conditions of a throw that a fit holds, takes from a prior or estimates.

Level ice, still air, the constants of the stone, the scale of the lengths and the rate of the
clock: each is held at what is assumed of it unless it is made a parameter. Held ones contribute a
systematic error, to first order, of the width given here (`curlfit.inference.fit.systematics`).
"""

from __future__ import annotations

from dataclasses import dataclass

from curlfit.friction import Parameter


@dataclass(frozen=True)
class Condition(Parameter):
    """A condition as a parameter.

    Attributes
    ----------
    width : standard uncertainty of the assumed value, in the same unit.
    basis : where the width comes from.
    """

    width: float
    basis: str


CONDITIONS = (
    Condition(
        "slope_x", "m/m", -0.02, 0.02, 1e-3, r"s_x", "fall of the ice to the right", 1e-4,
        "our judgement: 1 mm in 10 m, what a careful ice maker reaches with a level",
    ),
    Condition(
        "slope_y", "m/m", -0.02, 0.02, 1e-3, r"s_y", "fall of the ice along the sheet", 1e-4,
        "our judgement: 1 mm in 10 m, what a careful ice maker reaches with a level",
    ),
    Condition(
        "drag", "1", 0.0, 5.0, 1.0, r"C_d", "drag coefficient in still air", 0.8,
        "a short cylinder on a plane has 0.6 to 1; without air drag it is zero",
    ),
    Condition(
        "R", "m", 0.01, 0.14, 0.01, "R", "radius of the contact ring", 0.0015,
        "our judgement: running bands are 12 to 13 cm wide",
    ),
    Condition(
        "rho", "m", 0.01, 0.2, 0.01, r"\rho", "radius of gyration", 0.0025,
        "0.1 m in Ivanov and Shuvalov (2012), 0.1025 m for a solid cylinder of 29 cm",
    ),
    Condition(
        "h", "m", 0.005, 0.2, 0.01, "h", "height of the centre of mass", 0.003,
        "our judgement: 3 mm",
    ),
    Condition(
        "length_scale", "1", 0.2, 5.0, 0.05, r"\lambda", "measured over true lengths", 0.002,
        "our judgement: 1 cm in 5 m",
    ),
    Condition(
        "time_scale", "1", 0.2, 5.0, 0.05, r"\tau", "measured over true times", 0.001,
        "30 frames per second counted for 29.97",
    ),
)  # fmt: skip
WIDTHS = {item.name: item.width for item in CONDITIONS}
