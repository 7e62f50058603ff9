"""What throw is asked for, and where and how it starts."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from curlfit.dynamics.aim import aim
from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import split
from curlfit.inference.parameters import START
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HOG
from curlfit.throws.throw import Throw

GUARD = -(HOUSE + TEE_TO_HOG) / 2
"""Where a guard rests, beyond the tee: halfway between the house and the hog line (m)."""
TAKEOUT = 1.5
"""Speed in m/s with which a takeout passes the tee."""
WEIGHTS = {
    "draw": "rests on the tee line",
    "guard": f"rests halfway between hog line and house, {-GUARD:.3f} m before the tee line",
    "takeout": f"passes the tee line at {TAKEOUT:g} m/s",
}


class Wanted(NamedTuple):
    """What throw is asked for."""

    start: dict[str, float]
    line: str
    target: tuple[float, float] | None
    weight: str | None
    tee_speed: float | None

    @property
    def new(self) -> bool:
        """Whether it is another throw than the fitted one."""
        return bool(self.start) or self.aimed

    @property
    def aimed(self) -> bool:
        """Whether a place is asked for."""
        return self.target is not None or self.weight is not None

    def require(self, fit: FitResult, check: Throw | None) -> None:
        """Raise `InputError` where this cannot be meant."""
        names = [item.name for item in START]
        for name, value in self.start.items():
            if name not in names:
                raise InputError(f"start: no {name!r}; a throw starts with {', '.join(names)}")
            if not math.isfinite(value):
                raise InputError(f"{name} = {value}: expected a finite number")
        if not 0 < self.start.get("v0", 1.0) <= 10:
            raise InputError(f"v0 = {self.start['v0']:g} m/s: expected a speed up to 10 m/s")
        if not abs(self.start.get("omega0", 0.0)) <= 100:
            raise InputError(f"omega0 = {self.start['omega0']:g} rad/s: expected at most 100 rad/s")
        if self.line not in (*list(LINES)[:-1], "data"):
            raise InputError(
                f"start on {self.line!r}: expected one of {', '.join(list(LINES)[:-1])}, data"
            )
        if self.target is not None and self.weight is not None:
            raise InputError("a target and a weight are given; expected one of them")
        if self.weight is not None and self.weight not in WEIGHTS:
            raise InputError(f"weight {self.weight!r}: expected {', '.join(WEIGHTS)}")
        if self.tee_speed is not None and self.weight != "takeout":
            raise InputError("a speed at the tee is that of the weight takeout only")
        if self.aimed and "v0" in self.start:
            raise InputError("v0 is given, and the target or weight asks for it to be found")
        if self.target is not None and "heading" in self.start:
            raise InputError("heading is given, and the target asks for it to be found")
        if check is not None and self.new:
            raise InputError(
                "measured rows are compared with the fitted throw carried on; leave out its start"
            )
        spin = fit.parameters["omega0"]
        if self.new and "omega0" not in self.start and spin.verdict == "not identifiable":
            raise InputError("the fit does not know the spin (omega0); give one")

    def place(self) -> tuple[float | None, float, float] | None:
        """x and y from the tee, and the speed there; x is None where it is not aimed at."""
        x = None if "heading" in self.start else 0.0
        if self.target is not None:
            return (*self.target, 0.0)
        if self.weight is None:
            return None
        if self.weight == "takeout":
            return x, 0.0, TAKEOUT if self.tee_speed is None else self.tee_speed
        return x, GUARD if self.weight == "guard" else 0.0, 0.0

    def goal(self) -> dict[str, Any] | None:
        """The same as it is kept."""
        place = self.place()
        if place is None:
            return None
        x, y, speed = place
        words = self.weight or ("to the tee" if (x, y) == (0.0, 0.0) else "target")
        return {"words": words, "x": x, "y": y, "speed": speed}


class Begun(NamedTuple):
    """Where and how the throw starts."""

    values: dict[str, float]
    """of the best estimate, on the sheet"""
    shift: tuple[float, float]
    """what to add to the data's x and y"""
    line: str

    def record(self, fit: FitResult, wanted: Wanted) -> dict[str, dict[str, Any]]:
        """The same by name, with where each value is from."""
        found = {}
        for item in START:
            origin = "default"
            if item.name in wanted.start:
                origin = "given"
            elif wanted.aimed and item.name in ("v0", "heading"):
                origin = "found"
            elif item.name in ("v0", "omega0") or not wanted.new:
                origin = "fitted"
            if origin == "fitted" and item.name in ("x0", "y0") and self.line != "data":
                origin = "default"
            found[item.name] = {
                "value": float(self.values[item.name]), "unit": item.unit, "origin": origin,
            }  # fmt: skip
        return found


def begin(fit: FitResult, wanted: Wanted) -> Begun:
    """Where the throw starts; speed and heading are sought where a place is asked for."""
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    line = wanted.line
    place = (fitted["x0"], fitted["y0"]) if line == "data" else (0.0, LINES[line])
    shift = place[0] - fitted["x0"], place[1] - fitted["y0"]
    values = fitted | {"x0": place[0], "y0": place[1]}
    if not wanted.new:
        return Begun(values, shift, line)
    values |= {"heading": 0.0, "phi0": 0.0} | wanted.start
    goal = wanted.place()
    if goal is not None:
        x, y, speed = goal
        law, _ = split(fit.law_class, fit.values)
        found = aim(
            law, fit.stone, (x or 0.0, TEE + y), omega0=values["omega0"],
            start=(values["x0"], values["y0"]),
            heading=values["heading"] if x is None else None, speed=speed, load=fit.load,
        )  # fmt: skip
        values |= {"v0": found.v0, "heading": found.heading}
    return Begun(values, (0.0, 0.0), line)


def on_the_sheet(fit: FitResult) -> bool:
    """Whether the readers laid the data on the sheet, y counted from the hack."""
    return any(
        note.startswith("y from the hack") or (note.startswith("axes:") and "from-" in note)
        for note in fit.data["notes"]
    )
