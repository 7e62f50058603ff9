"""The throw to be predicted: request, goal and initial state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from curlfit.dynamics.aim import Aim, aim
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import START_NAMES, before_start
from curlfit.inference.model.system import System
from curlfit.inference.together.draw import Draw
from curlfit.prediction.result import Call, Goal, Origin
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


def with_turn(
    call: Call, start: Mapping[str, float], turn: str
) -> tuple[Call, dict[str, float]]:
    """One of both turns of a call, "in" or "out", and what is given of its start.

    Broom, place, heading and spin are those of the in-turn; the out-turn has their
    mirror images.
    """
    start_of_turn = dict(start)
    broom = call.broom
    if turn == "out":
        for name in ("x0", "heading"):
            if name in start:
                start_of_turn[name] = -start[name]
        if broom is not None:
            broom = -broom
    if "omega0" in start:
        start_of_turn["omega0"] = _TURNS[turn] * abs(start["omega0"])
    return replace(call, turn=turn, broom=broom), start_of_turn


class PlannedThrow(NamedTuple):
    """The throw to be predicted, on the ice of a fit."""

    fit: FitResult
    new: bool
    """whether it is a throw other than the fitted one"""
    line: str
    goal: Goal | None
    """the point that the stone is to reach, from the tee, and its speed there; x is
    None where it is free"""
    values: dict[str, float]
    """its initial state, on the sheet"""
    origins: dict[str, Origin]
    """of each value: given, call, fitted, default or found"""
    shift: tuple[float, float]
    """from the data's x and y to those of the sheet"""


def planned(
    fit: FitResult,
    call: Call,
    given_start: Mapping[str, float],
    line: str | None,
    target: tuple[float, float] | None,
    weight: str | None,
    tee_speed: float | None,
) -> PlannedThrow:
    """The throw that is asked for; by default from the near hog line, or from where its
    data begin. Speed and heading are found if it has a target or weight.

    Raises
    ------
    InputError : contradictory or impossible requests; a place that the stone
        does not reach.
    """
    start_of_call = _start_of_call(fit, call, given_start, line or "hog")
    requested_start = {**start_of_call, **given_start}
    new = bool(requested_start) or target is not None or weight is not None
    if not line:
        line = "data" if fit.counts_from_hack and not new else "hog"
    _require_possible(fit, requested_start, line, target, weight, tee_speed)
    fitted_start = fit.start
    default_start: dict[str, float] = {}
    if new:
        default_start["x0"] = fitted_start["x0"]
        default_start["y0"] = fitted_start["y0"]
        default_start["heading"] = 0.0
        default_start["phi0"] = 0.0
    if line != "data":
        default_start["x0"] = 0.0
        default_start["y0"] = LINES[line]
    goal = _goal(
        target, weight, tee_speed, free_heading="heading" not in requested_start
    )
    found_start: dict[str, float] = {}
    if goal is not None:
        start = fitted_start | default_start | requested_start
        aim_at_goal = aimed(
            fit,
            (goal.x or 0.0, TEE + goal.y),
            start["omega0"],
            speed=goal.speed,
            start=(start["x0"], start["y0"]),
            heading=start["heading"] if goal.x is None else None,
        )
        found_start = aim_at_goal._asdict()
    # each source has the last word over those above it
    starts: dict[Origin, Mapping[str, float]] = {
        "fitted": fitted_start,
        "default": default_start,
        "found": found_start,
        "call": start_of_call,
        "given": given_start,
    }
    values: dict[str, float] = {}
    origins: dict[str, Origin] = {}
    for origin, components in starts.items():
        values |= components
        origins |= dict.fromkeys(components, origin)
    shift = (0.0, 0.0)
    if not new:
        shift = (values["x0"] - fitted_start["x0"], values["y0"] - fitted_start["y0"])
    return PlannedThrow(fit, new, line, goal, values, origins, shift)


def _goal(
    target: tuple[float, float] | None,
    weight: str | None,
    tee_speed: float | None,
    *,
    free_heading: bool,
) -> Goal | None:
    """The point that a target or weight means, and the speed there; None without them.

    A weight is on the centre line, or at any x where the heading is given.
    """
    if target is not None:
        x, y = target
        words = "target" if x or y else "to the tee"
        return Goal(words=words, x=x, y=y, speed=0.0)
    if weight is None:
        return None
    y, speed = WEIGHTS[weight]
    if tee_speed is not None:
        speed = tee_speed
    return Goal(words=weight, x=0.0 if free_heading else None, y=y, speed=speed)


def _start_of_call(
    fit: FitResult, call: Call, given_start: Mapping[str, float], line: str
) -> dict[str, float]:
    """Components of the initial state by the call, of a throw that starts on a line."""
    start = {}
    fitted_spin = fit.parameters["omega0"].value
    if call.turn is not None:
        if call.turn not in _TURNS:
            raise InputError(
                f"turn {quoted(call.turn)}: expected one of {', '.join(_TURNS)}, both"
            )
        start["omega0"] = _TURNS[call.turn] * abs(fitted_spin)
    if call.broom is not None:
        # aimed from the hack, where x and y are 0, at the broom at the far tee
        slope = call.broom / TEE
        y0 = LINES.get(line, fit.parameters["y0"].value)
        start["heading"] = math.atan(slope)
        start["x0"] = slope * y0
    if call.hog_to_hog is not None:
        if line != "hog":
            raise InputError(
                "hog to hog: the throw starts on the near hog line; leave out line"
            )
        spin = given_start.get("omega0", start.get("omega0", fitted_spin))
        draw = Draw(fit.model, fit.stone)
        coefficients = before_start(fit.values[None])
        start["v0"] = float(draw.speeds(coefficients, spin, call.hog_to_hog)[0])
    return start


def _require_possible(
    fit: FitResult,
    start: Mapping[str, float],
    line: str,
    target: tuple[float, float] | None,
    weight: str | None,
    tee_speed: float | None,
) -> None:
    """Raise `InputError` for contradictory or impossible requests."""
    for name in start:
        if name not in START_NAMES:
            raise InputError(
                f"start: unknown {quoted(name)}; expected some of "
                f"{', '.join(START_NAMES)}"
            )
    VALUES.checked("start", start)
    aside, _ = (0.0, 0.0) if target is None else TARGET.checked("target", target)
    has_goal = target is not None or weight is not None
    v0 = start.get("v0", 1.0)
    omega0 = start.get("omega0", 0.0)
    unknown_spin = fit.parameters["omega0"].verdict == Verdict.NOT_IDENTIFIABLE
    if not 0 < v0 <= SPEED:
        raise InputError(
            f"v0 = {v0:g} m/s: expected a speed up to {SPEED:g} m/s; none "
            "is thrown at more than about 4 m/s"
        )
    if abs(omega0) > _FASTEST_SPIN:
        raise InputError(
            f"omega0 = {omega0:g} rad/s: expected at most {_FASTEST_SPIN:g} rad/s"
        )
    if line not in (*_STARTING_LINES, "data"):
        raise InputError(
            f"start on {quoted(line)}: expected "
            f"one of {', '.join(_STARTING_LINES)}, data"
        )
    if abs(aside) > WIDTH / 2:
        raise InputError(
            f"target {aside:g} m to the side: expected at most "
            f"{WIDTH / 2:g} m, half the width of the sheet"
        )
    if target is not None and weight is not None:
        raise InputError("a target and a weight are given; expected one of them")
    if weight not in (None, *WEIGHTS):
        raise InputError(f"weight {quoted(weight)}: expected {', '.join(WEIGHTS)}")
    if tee_speed is not None and weight != "takeout":
        raise InputError("a speed at the tee needs the weight takeout")
    if has_goal and "v0" in start:
        raise InputError(
            "v0 is given, but the target or weight determines it; leave one out"
        )
    if target is not None and "heading" in start:
        raise InputError(
            "heading is given, but the target determines it; leave one out"
        )
    if (start or has_goal) and "omega0" not in start and unknown_spin:
        raise InputError("the fit does not determine the spin (omega0); give one")


def aimed(
    fit: FitResult,
    target: tuple[float, float],
    omega0: float,
    *,
    start: tuple[float, float],
    speed: float = 0.0,
    heading: float | None = None,
) -> Aim:
    """Speed and heading of a throw on the ice of a fit that rests at a target, or
    passes it at a speed; arguments as of `curlfit.aim`."""
    system = System.of(fit.model, fit.values, fit.stone, Environment())
    return aim(
        system.law,
        system.stone,
        target,
        omega0=omega0,
        start=start,
        heading=heading,
        speed=speed,
        load=fit.load,
        environment=system.environment if fit.model.conditions else None,
    )
