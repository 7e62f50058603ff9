"""A throw in curlers' terms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.parameters import START
from curlfit.sheet import LINES, TEE

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult

# The in-turn of a right-hander is clockwise.
_TURNS = {"clockwise": -1, "cw": -1, "in": -1, "counter-clockwise": 1, "ccw": 1, "out": 1}


@dataclass(frozen=True)
class Call:
    """A throw in curlers' terms.

    Attributes
    ----------
    labels : its group in a joint fit, such as the sheet.
    hog_to_hog : s between the hog lines, which gives the speed.
    broom : m to the right of the centre line at the far tee, where the stone is aimed from the
        hack.
    thrower : standard deviations of the time between hog lines in s, and of the aim at the broom
        in m.
    turn : "clockwise" or "counter-clockwise"; "in" and "out" as of a right-hander.

    Examples
    --------
    >>> call = curlfit.Call({"sheet": "2"}, hog_to_hog=12.75, broom=-0.9, turn="in")
    >>> call.broom
    -0.9
    """

    labels: dict[str, str] = field(default_factory=dict)
    hog_to_hog: float | None = None
    broom: float | None = None
    thrower: tuple[float, float] | None = None
    turn: str | None = None

    def start(self, fit: FitResult, given: Mapping[str, float], line: str) -> dict[str, float]:
        """Components of the initial state on a line of the sheet; `given` are known.

        Raises
        ------
        InputError : an unknown turn, or a stone that does not reach the far hog line.
        """
        found = {}
        if self.turn is not None:
            if self.turn not in _TURNS:
                raise InputError(f"turn {quoted(self.turn)}: expected one of {', '.join(_TURNS)}")
            found["omega0"] = _TURNS[self.turn] * abs(fit.parameters["omega0"].value)
        if self.broom is not None:
            slope = self.broom / TEE
            found |= {"heading": math.atan(slope), "x0": slope * LINES[line]}
        if self.hog_to_hog is not None:
            if line != "hog":
                raise InputError(
                    "hog to hog: the throw starts on the near hog line; leave out line"
                )
            spin = {**found, **given}.get("omega0", fit.parameters["omega0"].value)
            coefficients = fit.values[: -len(START)]
            from curlfit.inference.joint.draw import Draw  # compiles

            draw = Draw(fit.model, fit.stone)
            found["v0"] = float(draw.speeds(coefficients[None], spin, self.hog_to_hog)[0])
        return found

    def options(self) -> list[str]:
        """Those of the command."""
        found = [f"--group={label}={name}" for label, name in self.labels.items()]
        if self.hog_to_hog is not None:
            found.append(f"--hog-to-hog={self.hog_to_hog:.15g}")
        if self.broom is not None:
            found.append(f"--broom={self.broom:+.15g} m")
        if self.thrower is not None:
            found.append("--thrower-sd={:.15g} s, {:.15g} m".format(*self.thrower))
        return found + ([] if self.turn is None else [f"--turn={self.turn}"])


CENTRED = Call()
"""Along the centre line, with the speed and spin of the fitted throw."""
