"""The throw to be predicted: request, goal and initial state."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from curlfit.dynamics.aim import aim
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.fit.result import FitResult
from curlfit.inference.parameters import START
from curlfit.inference.system import System
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HOG, WIDTH
from curlfit.throws.plausibility import SPEED
from curlfit.throws.throw import Throw

GUARD = -(HOUSE + TEE_TO_HOG) / 2
"""Resting position of a guard, m beyond the tee: halfway between the house and the hog line."""
TAKEOUT = 1.5
"""Speed in m/s at which a takeout passes the tee."""
WEIGHTS = {
    "draw": "rests on the tee line",
    "guard": f"rests halfway between hog line and house, {-GUARD:.3f} m before the tee line",
    "takeout": f"passes the tee line at {TAKEOUT:g} m/s",
}


class ThrowRequest(NamedTuple):
    """The throw to be predicted."""

    start: dict[str, float]
    line: str
    target: tuple[float, float] | None
    weight: str | None
    tee_speed: float | None

    @property
    def new(self) -> bool:
        """Whether it is a throw other than the fitted one."""
        return bool(self.start) or self.aimed

    @property
    def aimed(self) -> bool:
        """Whether it has a target or weight, for which speed and heading are found."""
        return self.target is not None or self.weight is not None

    def require(self, fit: FitResult, check: Throw | None) -> None:
        """Raise `InputError` for contradictory or impossible requests."""
        names = [item.name for item in START]
        for name, value in self.start.items():
            if name not in names:
                raise InputError(
                    f"start: unknown {quoted(name)}; expected some of {', '.join(names)}"
                )
            if not math.isfinite(value):
                raise InputError(f"{name} = {value}: expected a finite number")
        if not 0 < self.start.get("v0", 1.0) <= SPEED:
            raise InputError(
                f"v0 = {self.start['v0']:g} m/s: expected a speed up to {SPEED:g} m/s; none is "
                "thrown at more than about 4 m/s"
            )
        if not abs(self.start.get("omega0", 0.0)) <= 100:
            raise InputError(f"omega0 = {self.start['omega0']:g} rad/s: expected at most 100 rad/s")
        if self.line not in (*list(LINES)[:-1], "data"):
            raise InputError(
                f"start on {quoted(self.line)}: expected one of {', '.join(list(LINES)[:-1])}, data"
            )
        if self.target is not None and (isinstance(self.target, str) or len(self.target) != 2):
            raise InputError(
                f"target {quoted(self.target)}: expected (x, y), m from the tee; (0, 0) is the tee"
            )
        if self.target is not None and not abs(self.target[0]) <= WIDTH / 2:
            raise InputError(
                f"target {self.target[0]:g} m to the side: expected at most {WIDTH / 2:g} m, half "
                "the width of the sheet"
            )
        if self.target is not None and self.weight is not None:
            raise InputError("a target and a weight are given; expected one of them")
        if self.weight is not None and self.weight not in WEIGHTS:
            raise InputError(f"weight {quoted(self.weight)}: expected {', '.join(WEIGHTS)}")
        if self.tee_speed is not None and self.weight != "takeout":
            raise InputError("a speed at the tee needs the weight takeout")
        if self.aimed and "v0" in self.start:
            raise InputError("v0 is given, but the target or weight determines it; leave one out")
        if self.target is not None and "heading" in self.start:
            raise InputError("heading is given, but the target determines it; leave one out")
        if check is not None and self.new:
            raise InputError(
                "measured rows are compared with the fitted throw; leave out the start, target or "
                "weight"
            )
        spin = fit.parameters["omega0"]
        if self.new and "omega0" not in self.start and spin.verdict == "not identifiable":
            raise InputError("the fit does not determine the spin (omega0); give one")

    def target_point(self) -> tuple[float | None, float, float] | None:
        """x and y from the tee, and the speed there; x is None where it is free."""
        x = None if "heading" in self.start else 0.0
        if self.target is not None:
            return (*self.target, 0.0)
        if self.weight is None:
            return None
        if self.weight == "takeout":
            return x, 0.0, TAKEOUT if self.tee_speed is None else self.tee_speed
        return x, GUARD if self.weight == "guard" else 0.0, 0.0

    def goal(self) -> dict[str, Any] | None:
        """The target point as recorded."""
        target = self.target_point()
        if target is None:
            return None
        x, y, speed = target
        words = self.weight or ("to the tee" if (x, y) == (0.0, 0.0) else "target")
        return {"words": words, "x": x, "y": y, "speed": speed}


class ThrowStart(NamedTuple):
    """Initial state of the throw."""

    values: dict[str, float]
    """of the best estimate, on the sheet"""
    shift: tuple[float, float]
    """from the data's x and y to those of the sheet"""
    line: str

    def record(self, request: ThrowRequest) -> dict[str, dict[str, Any]]:
        """Values by name, with their origin."""
        found = {}
        for item in START:
            origin = "default"
            if item.name in request.start:
                origin = "given"
            elif request.aimed and item.name in ("v0", "heading"):
                origin = "found"
            elif item.name in ("v0", "omega0") or not request.new:
                origin = "fitted"
            if origin == "fitted" and item.name in ("x0", "y0") and self.line != "data":
                origin = "default"
            found[item.name] = {
                "value": float(self.values[item.name]), "unit": item.unit, "origin": origin,
            }  # fmt: skip
        return found


def start_of(fit: FitResult, request: ThrowRequest) -> ThrowStart:
    """Initial state of the throw; speed and heading are found if it has a target or weight."""
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    line = request.line
    target_point = (fitted["x0"], fitted["y0"]) if line == "data" else (0.0, LINES[line])
    shift = target_point[0] - fitted["x0"], target_point[1] - fitted["y0"]
    values = fitted | {"x0": target_point[0], "y0": target_point[1]}
    if not request.new:
        return ThrowStart(values, shift, line)
    values |= {"heading": 0.0, "phi0": 0.0} | request.start
    goal = request.target_point()
    if goal is not None:
        x, y, speed = goal
        system = System.of(fit.model, fit.values, fit.stone, Environment())
        found = aim(
            system.law, system.stone, (x or 0.0, TEE + y), omega0=values["omega0"],
            start=(values["x0"], values["y0"]),
            heading=values["heading"] if x is None else None, speed=speed, load=fit.load,
            environment=system.environment if fit.model.conditions else None,
        )  # fmt: skip
        values |= {"v0": found.v0, "heading": found.heading}
    return ThrowStart(values, (0.0, 0.0), line)
