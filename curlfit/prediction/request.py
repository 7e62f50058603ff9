"""The throw to be predicted: request, goal and initial state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from curlfit.dynamics.aim import Aim, aim
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.fit.result import FitResult
from curlfit.inference.joint.draw import Draw
from curlfit.inference.parameters import START
from curlfit.inference.system import System
from curlfit.inference.verdict import Verdict
from curlfit.prediction.result import Call
from curlfit.settings.forms import VALUES, numbers
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HOG, WIDTH
from curlfit.throws.plausibility import SPEED

GUARD = -(HOUSE + TEE_TO_HOG) / 2
"""Resting position of a guard, m beyond the tee: halfway between the house and
the hog line."""
TAKEOUT = 1.5
"""Speed in m/s at which a takeout passes the tee."""
WEIGHTS = {"draw": (0.0, 0.0), "guard": (GUARD, 0.0), "takeout": (0.0, TAKEOUT)}
"""Place in m beyond the tee line that a throw reaches, and its speed there."""
TARGET = numbers(2, "X,Y in m from the tee")
_STARTING_LINES = tuple(LINES)[:-1]
_FASTEST_SPIN = 100.0  # rad/s
# The in-turn of a right-hander is clockwise.
_TURNS = {
    "clockwise": -1,
    "cw": -1,
    "in": -1,
    "counter-clockwise": 1,
    "ccw": 1,
    "out": 1,
}


def both_turns(
    call: Call, given: Mapping[str, float]
) -> list[tuple[Call, dict[str, float]]]:
    """The in-turn and the out-turn of a call, and what is given of the start of each;
    broom, place, heading and spin are those of the in-turn, and of the out-turn their
    mirror images."""
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


class PlannedThrow(NamedTuple):
    """The throw to be predicted, on the ice of a fit."""

    fit: FitResult
    new: bool
    """whether it is a throw other than the fitted one"""
    line: str
    goal: dict[str, Any] | None
    """the point that the stone is to reach, from the tee, and its speed there; x is
    None where it is free"""
    values: dict[str, float]
    """its initial state, on the sheet"""
    origins: dict[str, str]
    """of each value: given, call, fitted, default or found"""
    shift: tuple[float, float]
    """from the data's x and y to those of the sheet"""


def planned(
    fit: FitResult,
    call: Call,
    given: Mapping[str, float],
    line: str | None,
    target: tuple[float, float] | None,
    weight: str | None,
    tee_speed: float | None,
) -> PlannedThrow:
    """From what is given; by default on the near hog line, or where its data begin.
    Speed and heading are found if it has a target or weight.

    Raises
    ------
    InputError : contradictory or impossible requests; a place that the stone
        does not reach.
    """
    called = _called(fit, call, given, line or "hog")
    start, aims = {**called, **given}, target is not None or weight is not None
    new = bool(start) or aims
    line = line or ("data" if fit.counts_from_hack and not new else "hog")
    _require(fit, start, line, target, weight, tee_speed)
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    here = {name: fitted[name] for name in ("x0", "y0")}
    usual = {} if line == "data" else {"x0": 0.0, "y0": LINES[line]}
    if new:
        usual = here | {"heading": 0.0, "phi0": 0.0} | usual
    goal: dict[str, Any] | None = None
    found: dict[str, float] = {}
    if aims:
        words, x = weight, None if "heading" in start else 0.0
        y, speed = WEIGHTS.get(weight or "", (0.0, 0.0))
        if target is not None:
            words, (x, y) = "target" if any(target) else "to the tee", target
        goal = {
            "words": words,
            "x": x,
            "y": y,
            "speed": speed if tee_speed is None else tee_speed,
        }
        known = fitted | usual | start
        found = aimed(
            fit,
            (x or 0.0, TEE + y),
            known["omega0"],
            speed=goal["speed"],
            start=(known["x0"], known["y0"]),
            heading=known["heading"] if x is None else None,
        )._asdict()
    layers = {
        "fitted": fitted,
        "default": usual,
        "found": found,
        "call": called,
        "given": given,
    }
    values = {name: value for layer in layers.values() for name, value in layer.items()}
    origins = {name: origin for origin, layer in layers.items() for name in layer}
    shift = (
        (0.0, 0.0) if new else (values["x0"] - here["x0"], values["y0"] - here["y0"])
    )
    return PlannedThrow(fit, new, line, goal, values, origins, shift)


def _called(
    fit: FitResult, call: Call, given: Mapping[str, float], line: str
) -> dict[str, float]:
    """Components of the initial state by the call."""
    called, spin = {}, fit.parameters["omega0"].value
    if call.turn is not None:
        if call.turn not in _TURNS:
            raise InputError(
                f"turn {quoted(call.turn)}: expected one of {', '.join(_TURNS)}, both"
            )
        called["omega0"] = _TURNS[call.turn] * abs(spin)
    if call.broom is not None:
        slope, y0 = call.broom / TEE, LINES.get(line, fit.parameters["y0"].value)
        called |= {"heading": math.atan(slope), "x0": slope * y0}
    if call.hog_to_hog is not None:
        if line != "hog":
            raise InputError(
                "hog to hog: the throw starts on the near hog line; leave out line"
            )
        spin = {"omega0": spin, **called, **given}["omega0"]
        coefficients, draw = fit.values[None, : -len(START)], Draw(fit.model, fit.stone)
        called["v0"] = float(draw.speeds(coefficients, spin, call.hog_to_hog)[0])
    return called


def _require(
    fit: FitResult,
    start: Mapping[str, float],
    line: str,
    target: tuple[float, float] | None,
    weight: str | None,
    tee_speed: float | None,
) -> None:
    """Raise `InputError` for contradictory or impossible requests."""
    names = [item.name for item in START]
    for name in start:
        if name not in names:
            raise InputError(
                f"start: unknown {quoted(name)}; expected some of {', '.join(names)}"
            )
    VALUES.checked("start", start)
    aside, _ = (0.0, 0.0) if target is None else TARGET.checked("target", target)
    aims = target is not None or weight is not None
    v0, omega0 = start.get("v0", 1.0), start.get("omega0", 0.0)
    unknown_spin = fit.parameters["omega0"].verdict == Verdict.NOT_IDENTIFIABLE
    for refused, why in (
        (
            not 0 < v0 <= SPEED,
            f"v0 = {v0:g} m/s: expected a speed up to {SPEED:g} m/s; none "
            "is thrown at more than about 4 m/s",
        ),
        (
            abs(omega0) > _FASTEST_SPIN,
            f"omega0 = {omega0:g} rad/s: expected at most {_FASTEST_SPIN:g} rad/s",
        ),
        (
            line not in (*_STARTING_LINES, "data"),
            f"start on {quoted(line)}: expected "
            f"one of {', '.join(_STARTING_LINES)}, data",
        ),
        (
            abs(aside) > WIDTH / 2,
            f"target {aside:g} m to the side: expected at most "
            f"{WIDTH / 2:g} m, half the width of the sheet",
        ),
        (
            target is not None and weight is not None,
            "a target and a weight are given; expected one of them",
        ),
        (
            weight not in (None, *WEIGHTS),
            f"weight {quoted(weight)}: expected {', '.join(WEIGHTS)}",
        ),
        (
            tee_speed is not None and weight != "takeout",
            "a speed at the tee needs the weight takeout",
        ),
        (
            aims and "v0" in start,
            "v0 is given, but the target or weight determines it; leave one out",
        ),
        (
            target is not None and "heading" in start,
            "heading is given, but the target determines it; leave one out",
        ),
        (
            (start or aims) and "omega0" not in start and unknown_spin,
            "the fit does not determine the spin (omega0); give one",
        ),
    ):
        if refused:
            raise InputError(why)


def aimed(
    fit: FitResult, target: tuple[float, float], omega0: float, **how: Any
) -> Aim:
    """Speed and heading of a throw on the ice of a fit that rests at a target, or
    passes it; `how` as `curlfit.aim` takes it."""
    system = System.of(fit.model, fit.values, fit.stone, Environment())
    return aim(
        system.law,
        system.stone,
        target,
        omega0=omega0,
        load=fit.load,
        environment=system.environment if fit.model.conditions else None,
        **how,
    )
