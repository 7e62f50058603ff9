"""Conditions of a throw that a fit holds fixed, constrains by a prior or estimates.

Level ice, still air, the constants of the stone, the length scale and the rate of
the clock: each is held at its assumed value unless it is made a parameter. Each
one held fixed contributes a systematic error, to first order, for the width given
here (`curlfit.inference.fit.systematics`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from curlfit.environment import WEAR_KNOTS
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import Parameter


@dataclass(frozen=True)
class Condition(Parameter):
    """A condition that can be a parameter of a fit.

    Attributes
    ----------
    width : standard uncertainty of the assumed value, in the same unit.
    basis : where the width comes from.
    """

    width: float
    basis: str


CONDITIONS = (
    Condition(
        "slope_x",
        "m/m",
        -0.02,
        0.02,
        1e-3,
        r"s_x",
        "downward slope of the ice to the right",
        1e-4,
        "judgement: 1 mm in 10 m, what a careful ice maker reaches with a level",
    ),
    Condition(
        "slope_y",
        "m/m",
        -0.02,
        0.02,
        1e-3,
        r"s_y",
        "downward slope of the ice along the sheet",
        1e-4,
        "judgement: 1 mm in 10 m, what a careful ice maker reaches with a level",
    ),
    Condition(
        "drag",
        "1",
        0.0,
        5.0,
        1.0,
        r"C_d",
        "drag coefficient in still air",
        0.8,
        "a short cylinder on a plane has 0.6 to 1; without air drag it is zero",
    ),
    Condition(
        "wear",
        "1/m",
        -0.02,
        0.05,
        0.01,
        "w",
        "relative change of the friction along the throw",
        5e-4,
        "judgement: 1 % over 20 m",
    ),
    *(
        Condition(
            f"wear_{place:g}",
            "1",
            -0.5,
            1.0,
            0.1,
            f"w_{{{place:g}}}",
            f"relative change of the friction {place:g} m along the throw",
            0.0,
            "0, since `wear` covers a trend along the throw",
        )
        for place in WEAR_KNOTS[1:]
    ),
    Condition(
        "sweep",
        "1",
        0.0,
        2.0,
        0.1,
        "s",
        "ratio of the friction during sweeping to that otherwise",
        0.0,
        "0, since it is 1 for an unswept stone",
    ),
    Condition(
        "R",
        "m",
        0.01,
        0.14,
        0.01,
        "R",
        "radius of the contact ring",
        0.0015,
        "judgement: running bands are 12 to 13 cm wide",
    ),
    Condition(
        "rho",
        "m",
        0.01,
        0.2,
        0.01,
        r"\rho",
        "radius of gyration",
        0.0025,
        "0.1 m in Ivanov and Shuvalov (2012), 0.1025 m for a solid cylinder of 29 cm",
    ),
    Condition(
        "h",
        "m",
        0.005,
        0.2,
        0.01,
        "h",
        "height of the centre of mass",
        0.003,
        "judgement: 3 mm",
    ),
    Condition(
        "length_scale",
        "1",
        0.2,
        5.0,
        0.05,
        r"\lambda",
        "ratio of measured to true lengths",
        0.002,
        "judgement: 1 cm in 5 m",
    ),
    Condition(
        "time_scale",
        "1",
        0.2,
        5.0,
        0.05,
        r"\tau",
        "ratio of measured to true times",
        0.001,
        "30 frames per second counted for 29.97",
    ),
)
SPIN = Condition(
    "spin",
    "1",
    0.0,
    5.0,
    1.0,
    "",
    "ratio of the spin to the assumed one, where it was not known",
    0.25,
    "judgement: most stones turn two to three times",
)
"""It can be estimated as `omega0` alone."""
UNKNOWN_SPIN = Condition(
    "unknown_spin",
    "rad/s",
    0.0,
    5.0,
    1.0,
    "",
    "spin of a throw that is taken not to turn, since nothing tells its spin",
    1.2,
    "judgement: most stones turn two to three times",
)
"""It acts on the times of a throw with its square, whichever way the stone turns."""
ASSUMED = (SPIN, UNKNOWN_SPIN)
"""Conditions of throws whose spin was not measured."""
WIDTHS = {condition.name: condition.width for condition in (*CONDITIONS, *ASSUMED)}
ALL = "all"
CALIBRATION = "calibration"
"""The map from pixels to metres; its width is in units of its own standard
uncertainty, 1 unless given, and its independent errors are conditions named
`calibration_1` and so on."""


def is_calibration(condition: str) -> bool:
    """Whether a condition is an independent error of the map from pixels to metres."""
    return condition.startswith(CALIBRATION)


WEAK_CONDITIONS = ("R", "rho", "h", "length_scale", "time_scale")
"""Conditions that a single path hardly determines."""


def check_systematics(given: Mapping[str, float]) -> None:
    """Raise `InputError` for a negative or infinite width or an unknown condition;
    `ALL` stands for the conditions that are not named."""
    for name, width in given.items():
        if name not in (ALL, CALIBRATION, *WIDTHS):
            raise InputError(
                f"systematic: no condition {quoted(name)}; the conditions are "
                f"{', '.join(WIDTHS)}, {CALIBRATION} and {ALL}"
            )
        if not 0 <= width < math.inf:
            raise InputError(
                f"systematic: {name} = {width:g}; expected a width of 0 or more"
            )


def if_off(name: str, width: float) -> str:
    """The clause that a condition is off by one width, as the beginning
    of a sentence."""
    texts = {
        "slope_x": f"if the ice slopes down to the right by {1e3 * width:g} mm/m",
        "slope_y": f"if the ice slopes down along the throw by {1e3 * width:g} mm/m",
        "wear": f"if the friction grows by {100 * width:g} % per metre along the throw",
        "drag": f"if there is air drag with a coefficient of {width:g}",
        "length_scale": f"if measured lengths are {100 * width:g} % too long",
        "time_scale": f"if measured times are {100 * width:g} % too long",
        SPIN.name: f"if stones turn {100 * width:g} % more than assumed",
        UNKNOWN_SPIN.name: f"if the stone turns, at {width:g} rad/s",
    }
    meaning = {condition.name: condition.meaning for condition in CONDITIONS}
    return texts.get(name) or f"if the {meaning[name]} is {1e3 * width:g} mm larger"
