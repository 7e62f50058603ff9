"""The throw to be predicted: request, goal and initial state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Self

from curlfit.dynamics.aim import Aim, aim
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.fit.result import FitResult
from curlfit.inference.joint.draw import Draw
from curlfit.inference.parameters import START
from curlfit.inference.system import System
from curlfit.prediction.result import Call
from curlfit.settings.forms import VALUES, numbers
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HOG, WIDTH
from curlfit.throws.plausibility import SPEED
from curlfit.throws.throw import Throw

GUARD = -(HOUSE + TEE_TO_HOG) / 2
"""Resting position of a guard, m beyond the tee: halfway between the house and the hog line."""
TAKEOUT = 1.5
"""Speed in m/s at which a takeout passes the tee."""
WEIGHTS = {"draw": (0.0, 0.0), "guard": (GUARD, 0.0), "takeout": (0.0, TAKEOUT)}
"""Place in m beyond the tee line that a throw reaches, and its speed there."""
TARGET = numbers(2, "X,Y in m from the tee")
_STARTING_LINES = tuple(LINES)[:-1]
_FASTEST_SPIN = 100.0  # rad/s
# The in-turn of a right-hander is clockwise.
_TURNS = {"clockwise": -1, "cw": -1, "in": -1, "counter-clockwise": 1, "ccw": 1, "out": 1}


def both_turns(call: Call, given: Mapping[str, float]) -> list[tuple[Call, dict[str, float]]]:
    """The in-turn and the out-turn of a call, and what is given of the start of each; broom, place,
    heading and spin are those of the in-turn, and of the out-turn their mirror images."""
    found = []
    for turn, side in (("in", 1), ("out", -1)):
        start = dict(given) | {
            name: side * given[name] for name in ("x0", "heading") if name in given
        }
        if "omega0" in given:
            start["omega0"] = _TURNS[turn] * abs(given["omega0"])
        broom = None if call.broom is None else side * call.broom
        found.append((replace(call, turn=turn, broom=broom), start))
    return found


class ThrowRequest(NamedTuple):
    """The throw to be predicted."""

    start: dict[str, float]
    """components of the initial state, by the call or given"""
    line: str
    target: tuple[float, float] | None
    weight: str | None
    tee_speed: float | None
    called: frozenset[str] = frozenset()
    """components of the start by the call"""

    @classmethod
    def of(
        cls,
        fit: FitResult,
        call: Call,
        given: Mapping[str, float],
        line: str | None,
        target: tuple[float, float] | None,
        weight: str | None,
        tee_speed: float | None,
    ) -> Self:
        """From what is given; by default on the near hog line, or where its data begin.

        Raises
        ------
        InputError : an unknown turn, or a stone that does not reach the far hog line.
        """
        called, start_line = {}, line or "hog"
        if call.turn is not None:
            if call.turn not in _TURNS:
                raise InputError(
                    f"turn {quoted(call.turn)}: expected one of {', '.join(_TURNS)}, both"
                )
            called["omega0"] = _TURNS[call.turn] * abs(fit.parameters["omega0"].value)
        if call.broom is not None:
            slope, y0 = call.broom / TEE, LINES.get(start_line, fit.parameters["y0"].value)
            called |= {"heading": math.atan(slope), "x0": slope * y0}
        if call.hog_to_hog is not None:
            if start_line != "hog":
                raise InputError(
                    "hog to hog: the throw starts on the near hog line; leave out line"
                )
            spin = {**called, **given}.get("omega0", fit.parameters["omega0"].value)
            coefficients, draw = fit.values[None, : -len(START)], Draw(fit.model, fit.stone)
            called["v0"] = float(draw.speeds(coefficients, spin, call.hog_to_hog)[0])
        named = frozenset(called.keys() - given.keys())
        request = cls({**called, **given}, start_line, target, weight, tee_speed, named)
        if line is None and not request.new and fit.counts_from_hack:
            return request._replace(line="data")
        return request

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
        start, target, names = self.start, self.target, [item.name for item in START]
        for name in start:
            if name not in names:
                raise InputError(
                    f"start: unknown {quoted(name)}; expected some of {', '.join(names)}"
                )
        VALUES.checked("start", start)
        aside, _ = (0.0, 0.0) if target is None else TARGET.checked("target", target)
        v0, omega0 = start.get("v0", 1.0), start.get("omega0", 0.0)
        unknown_spin = fit.parameters["omega0"].verdict == "not identifiable"
        for refused, why in (
            (not 0 < v0 <= SPEED, f"v0 = {v0:g} m/s: expected a speed up to {SPEED:g} m/s; none "
             "is thrown at more than about 4 m/s"),
            (abs(omega0) > _FASTEST_SPIN,
             f"omega0 = {omega0:g} rad/s: expected at most {_FASTEST_SPIN:g} rad/s"),
            (self.line not in (*_STARTING_LINES, "data"), f"start on {quoted(self.line)}: expected "
             f"one of {', '.join(_STARTING_LINES)}, data"),
            (abs(aside) > WIDTH / 2, f"target {aside:g} m to the side: expected at most "
             f"{WIDTH / 2:g} m, half the width of the sheet"),
            (target is not None and self.weight is not None,
             "a target and a weight are given; expected one of them"),
            (self.weight not in (None, *WEIGHTS),
             f"weight {quoted(self.weight)}: expected {', '.join(WEIGHTS)}"),
            (self.tee_speed is not None and self.weight != "takeout",
             "a speed at the tee needs the weight takeout"),
            (self.aimed and "v0" in start,
             "v0 is given, but the target or weight determines it; leave one out"),
            (target is not None and "heading" in start,
             "heading is given, but the target determines it; leave one out"),
            (check is not None and self.new, "measured rows are compared with the fitted throw; "
             "leave out the start, target or weight"),
            (self.new and "omega0" not in start and unknown_spin,
             "the fit does not determine the spin (omega0); give one"),
        ):  # fmt: skip
            if refused:
                raise InputError(why)

    def goal(self) -> dict[str, Any] | None:
        """The point that the stone is to reach, from the tee, and its speed there; x is None where
        it is free."""
        if self.target is not None:
            x, y = self.target
            words = "to the tee" if (x, y) == (0.0, 0.0) else "target"
            return {"words": words, "x": x, "y": y, "speed": 0.0}
        if self.weight is None:
            return None
        y, speed = WEIGHTS[self.weight]
        return {
            "words": self.weight, "x": None if "heading" in self.start else 0.0, "y": y,
            "speed": speed if self.tee_speed is None else self.tee_speed,
        }  # fmt: skip


class ThrowStart(NamedTuple):
    """Initial state of the throw, on the sheet."""

    values: dict[str, float]
    origins: dict[str, str]
    """of each value: given, fitted, default or found"""
    shift: tuple[float, float]
    """from the data's x and y to those of the sheet"""

    def described(self) -> dict[str, dict[str, Any]]:
        """Value, unit and origin of each component."""
        return {
            item.name: {
                "value": float(self.values[item.name]), "unit": item.unit,
                "origin": self.origins[item.name],
            }
            for item in START
        }  # fmt: skip


def start_of(fit: FitResult, request: ThrowRequest) -> ThrowStart:
    """Initial state of the throw; speed and heading are found if it has a target or weight."""
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    here = {name: fitted[name] for name in ("x0", "y0")}
    usual = {} if request.line == "data" else {"x0": 0.0, "y0": LINES[request.line]}
    found = {}
    if request.new:
        usual = here | {"heading": 0.0, "phi0": 0.0} | usual
        if (goal := request.goal()) is not None:
            known = fitted | usual | request.start
            found = aimed(
                fit, (goal["x"] or 0.0, TEE + goal["y"]), known["omega0"], speed=goal["speed"],
                start=(known["x0"], known["y0"]),
                heading=known["heading"] if goal["x"] is None else None,
            )._asdict()  # fmt: skip
    layers = {"fitted": fitted, "default": usual, "found": found, "given": request.start}
    values = {name: value for layer in layers.values() for name, value in layer.items()}
    origins = {name: origin for origin, layer in layers.items() for name in layer}
    origins |= dict.fromkeys(request.called, "call")
    shift = values["x0"] - here["x0"], values["y0"] - here["y0"]
    return ThrowStart(values, origins, (0.0, 0.0) if request.new else shift)


def aimed(
    fit: FitResult,
    target: tuple[float, float],
    omega0: float,
    *,
    start: tuple[float, float] = (0.0, LINES["hog"]),
    heading: float | None = None,
    speed: float = 0.0,
) -> Aim:
    """Speed and heading of a throw on the ice of a fit that rests at a target, or passes it."""
    system = System.of(fit.model, fit.values, fit.stone, Environment())
    return aim(
        system.law, system.stone, target, omega0=omega0, start=start, heading=heading, speed=speed,
        load=fit.load, environment=system.environment if fit.model.conditions else None,
    )  # fmt: skip
