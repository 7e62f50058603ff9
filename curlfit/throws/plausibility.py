"""Whether data and fit are plausible for a curling stone: findings, each with its remedy.

What is impossible (a stone that speeds up, a path longer than the sheet, friction a million times
too small) is refused before a fit and makes it unusable after it; what is merely unusual gives a
warning. Data that are implausible but correct are accepted with `as_given`. `_STAGES` lists the
checks of the data. Limits without a source are judgement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LENGTH, WIDTH
from curlfit.stone import GRAVITY
from curlfit.throws.motion import (
    FEWEST,
    SURE,
    MeasuredMotion,
    motion_of,
    path_of,
    turning,
    velocity_jump,
)
from curlfit.throws.readers.axes import MAX_SPIN, AmbiguousTurnError, corrected, unwrap
from curlfit.throws.readers.columns import in_unit
from curlfit.throws.throw import Conventions, Throw

FRICTION = (0.002, 0.1)
"""Limits of the mean coefficient of friction; published values are 0.006 to 0.02 (Penner 2001,
Denny 2002), several times as much on frosted ice."""
_USUAL_FRICTION = (0.003, 0.04)  # the published values, with a factor of two on either side
SPEED = 6.0
"""Limit in m/s. The fastest throws take 6 to 7 s from hog line to hog line (21.9 m): 3.5 m/s."""
_USUAL_SPEED = 4.5  # m/s; the same with a margin for the slowing down before the hog line
_LENGTH = 1.05 * LENGTH  # 5 % for an error in scale
_USUAL_CURL = 4.0  # m; ordinary throws curl 0.5 to 2 m
_MOST_TURNS = 10.0  # a thrown stone makes two to four
_GROWTH = 0.1  # m/s; largest growth of a speed, that of friction 0.01 in 1 s
_CLEAR_CURL, _CLEAR_TURN = 0.2, 0.5  # m, rad; above these their senses are compared
_AGREE = 0.8, 1.25  # ratio of a measured rate to that of the path: calibration is within 20 %
_MOST_ROWS = 1500  # for speed; more are condensed
_UNITS = {
    "t": ("s", "ms", "us", "min", "30fps"), "phi": ("rad", "deg", "mrad"),
    "omega": ("rad/s", "deg/s", "rpm"), "speed": ("m/s", "km/h", "ft/s", "mph", "cm/s", "mm/s"),
    "x": ("m", "cm", "mm", "ft", "in"),
}  # fmt: skip
_NAMES = {
    "ms": "milliseconds", "us": "microseconds", "min": "minutes", "cm": "centimetres",
    "mm": "millimetres", "ft": "feet", "in": "inches", "s": "seconds", "m": "metres",
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """Something implausible in a throw or its fit.

    Attributes
    ----------
    kind : keyword for programs, such as "units", "axes", "growing speed".
    says : what was found, with the evidence. remedy : what to type, as a clause; may be empty.
    refused : whether it is impossible for a curling stone, not merely unusual.
    """

    kind: str
    says: str
    remedy: str
    refused: bool = True

    def __str__(self) -> str:
        """The finding, followed by its remedy."""
        return f"{self.says}; {self.remedy}" if self.remedy else self.says


def examine(throw: Throw) -> tuple[Finding, ...]:
    """Implausible features of a throw before it is fitted, the most serious first.

    Consequences of a fault are not examined: a stone that was hit may have any curl, and in wrong
    units any stone seems to have been hit.
    """
    one = throw.condensed(_MOST_ROWS)
    motion = motion_of(one)
    found = [*_wrapped(one), *_turns(one)]
    if motion is None:
        found += _scale_of_few(one)
    else:
        for stage in _STAGES:
            here = [finding for check in stage for finding in check(one, motion)]
            found += here
            if any(finding.refused for finding in here):
                break
    return tuple(sorted(found, key=lambda finding: not finding.refused))


def require_plausible(throw: Throw) -> tuple[Finding, ...]:
    """Findings on a throw that are no reason to refuse it.

    Raises
    ------
    InputError : the stone never moves, or the data cannot be those of a curling stone; the latter
        is accepted if `as_given` is among the throw's defaults.
    """
    throw.require_motion()
    found = examine(throw)
    if throw.defaults.get("as_given"):
        return tuple(replace(finding, refused=False) for finding in found)
    refused = [str(finding) for finding in found if finding.refused]
    if refused:
        right = (
            '`Throw.from_arrays(..., defaults={"as_given": True})`'
            if throw.conventions is None
            else "`--as-given`"
        )
        raise InputError(
            f"{throw.name}: {'. '.join(refused)}. To accept the data as they are: {right}"
        )
    return found


def examine_fit(
    throw: Throw, t: Floats, speed: Floats, start_speed: float, start_error: float | None
) -> tuple[Finding, ...]:
    """Implausible features of a fitted motion.

    Parameters
    ----------
    throw : the data, for their uncertainty and the wording of a remedy.
    t, speed : times (s) and fitted speeds (m/s), shape (n,); may be empty.
    start_speed, start_error : fitted initial speed and its standard error, m/s.
    """
    said: list[tuple[str, str]] = []
    remedy = f"if units are wrong, set them as in {_some_units(throw)}"
    if not set(throw.seen) & {"x", "y", "speed"} and not throw.events:
        remedy = "angles alone hardly determine the speed; measure it as well, or fix v0"
    error = start_error or 0.0
    if start_speed - 3 * error > SPEED:
        speeds = f"the fitted initial speed of {start_speed:.3g} m/s is more than anyone throws "
        said.append(("fitted speed", f"{speeds}(about 4 m/s)"))
    moving = speed > 1e-3
    if moving.sum() > 2:
        t, speed = t[moving], speed[moving]
        slowing = GRAVITY * float(t[-1] - t[0])
        mean, error = (float(speed[0]) - float(speed[-1])) / slowing, error / slowing
        low, high = FRICTION
        motion = None if low <= mean <= high else motion_of(throw)
        if motion is not None and math.isfinite(motion.friction_error):
            error = motion.friction_error
        if mean + 3 * error < low or mean - 3 * error > high:
            usual = f"on ice it is {low:g} to {high:g}"
            friction = f"the fitted mean coefficient of friction is {mean:.2g}; {usual}"
            speeds_up = "the fitted stone speeds up, which friction cannot cause"
            said.append(("fitted friction", speeds_up if mean < 0 else friction))
    refused = not throw.defaults.get("as_given")
    return tuple(Finding(kind, says, remedy, refused) for kind, says in said)


# Remedies


def _option(throw: Throw, name: str, value: Any) -> str:
    """An option as written on the command line, or in Python for a throw from arrays."""
    if throw.conventions is not None:
        return f"`--{name} {value}`" if value != "" else f"leave out `--{name}`"
    if value == "":
        return f"leave out `{name}`"
    if name in ("units", "axes"):
        return f'`Throw.from_arrays(..., {name}="{value}")`'
    return f"`{name}={value}`"


def _some_units(throw: Throw) -> str:
    return " or ".join(_option(throw, "units", unit) for unit in ("t=ms", "length=cm"))


def _factors(throw: Throw, quantity: str) -> dict[str, float]:
    """Units that a column may really be in, with the factors by which its values would change."""
    now = (throw.conventions or Conventions()).factors.get(quantity, 1.0)
    factors = {unit: in_unit(quantity, unit).factor / now for unit in _UNITS[quantity]}
    return {unit: factor for unit, factor in factors.items() if factor != 1}


def _candidates(throw: Throw) -> Iterator[tuple[str, dict[str, float]]]:
    """Units that may be the right ones, with the factors by which the channels would change."""
    times = _factors(throw, "t")
    yield from ((f"t={unit}", {"t": factor}) for unit, factor in times.items())
    if not np.isfinite(throw.x).any():
        speeds = _factors(throw, "speed")
        yield from ((f"speed={unit}", {"speed": factor}) for unit, factor in speeds.items())
        return
    for unit, factor in _factors(throw, "x").items():
        yield f"length={unit}", {"x": factor, "y": factor}
        yield f"x={unit}", {"x": factor}
        yield f"y={unit}", {"y": factor}
        for time, of_time in times.items():
            if not time.endswith("fps"):
                yield f"t={time},length={unit}", {"t": of_time, "x": factor, "y": factor}


def _unit_remedy(throw: Throw, oddity: Callable[[Throw, bool], float]) -> str:
    """The fewest changes of units that make this the least odd throw, as an option to type.

    Parameters
    ----------
    oddity : of a throw in other units, of one channel alone perhaps; infinite if implausible.
    """
    best, units = math.inf, ""
    for name, factors in _candidates(throw):
        scaled = {channel: factor * getattr(throw, channel) for channel, factor in factors.items()}
        alone = len(factors) == 1 and "t" not in factors
        odd = oddity(replace(throw, sigma={}, **scaled), alone) + name.count(",")
        if alone:  # rare
            odd += 1 + name.endswith(("in", "ft"))
        if odd < best:
            best, units = odd, name
    if not units:
        return f"set the units of the file, as in {_some_units(throw)}"
    flag = _option(throw, "units", units)
    if units.endswith("fps"):
        return f"if t counts frames: {flag}, with the frame rate of the camera"
    what = {"t": "the time is", "length": "lengths are"}
    parts = [part.partition("=") for part in units.split(",")]
    said = [f"{what.get(name, f'{name} is')} in {_NAMES.get(u, u)}" for name, _, u in parts]
    return f"if {' and '.join(said)}: {flag}"


# Checks of the rows


def _wrapped(throw: Throw) -> Iterator[Finding]:
    """Jumps of an angle, which readers remove but arrays may contain."""
    if throw.conventions is not None or "phi" not in throw.seen:
        return
    for period, size, unit in ((2 * math.pi, "360 degrees", "rad"), (360.0, "360", "deg")):
        try:
            _, jumps, _ = unwrap(throw.t, 2 * math.pi / period * throw.phi)
        except AmbiguousTurnError:
            continue
        if jumps and float(np.nanmax(np.abs(throw.phi))) < 1.1 * period:
            times = "once" if jumps == 1 else f"{jumps} times"
            yield Finding(
                "wrapped angle",
                f"phi jumps by {size} {times}: it is wrapped",
                f'`Throw.from_arrays(..., units="angle={unit}")` unwraps it',
            )
            return


def _turns(throw: Throw) -> Iterator[Finding]:
    """A rotation too fast for an angle in radians."""
    turned, mean = turning(throw)
    if not abs(turned) > 2 * math.pi * _MOST_TURNS:
        return
    what, unit = ("angles", "angle=deg") if "phi" in throw.seen else ("spins", "spin=deg/s")
    yield Finding(
        "turns",
        f"the stone turns {abs(turned) / (2 * math.pi):.3g} times, at {abs(mean):.3g} rad/s; "
        "stones turn at most about 10 times",
        f"if {what} are in degrees: {_option(throw, 'units', unit)}",
        abs(mean) > MAX_SPIN,
    )


def _scale_of_few(throw: Throw) -> Iterator[Finding]:
    """`_scale` for few positions, of which only the distance and the time taken are used."""
    if faults := _faults_of_few(throw):
        yield Finding("units", ", and ".join(faults), _unit_remedy(throw, _oddity_of_few))


def _extent(throw: Throw) -> tuple[float, float]:
    """Length of a path in m and time in s to 98 % of it; NaN if there are too few rows."""
    t, (x, y) = path_of(throw)
    off = np.hypot(x - x[-1:], y - y[-1:])
    if len(t) < 4 or not off[0] > 0:
        return math.nan, math.nan
    return float(off[0]), float(t[np.argmax(off < 0.02 * off[0])] - t[0])


def _faults_of_few(throw: Throw) -> list[str]:
    length, time = _extent(throw)
    faults = []
    # A stone that stops has twice its mean speed at first.
    if length > _LENGTH and 2 * length / time > _USUAL_SPEED:
        faults.append(f"the path is {length:.3g} m long, and a sheet {LENGTH:.1f} m")
    if length / time > SPEED:
        faults.append(
            f"the stone moves at {length / time:.3g} m/s, and none is thrown at more than about 4 "
            "m/s"
        )
    # A stone stopped by constant friction mu covers s in sqrt(2 s/(mu g)), a moving one in less.
    if 2 * length / (GRAVITY * time**2) < FRICTION[0] / 4:
        faults.append(
            f"it takes {time:.3g} s for {length:.3g} m, where friction on ice stops a stone within "
            f"{math.sqrt(2 * length / (GRAVITY * FRICTION[0])):.2g} s"
        )
    return faults


def _oddity_of_few(throw: Throw, alone: bool) -> float:
    length, time = _extent(throw)
    usual = not alone and not _faults_of_few(throw) and 0.3 < length / time < 3
    return abs(math.log(length / time / 1.5)) if usual else math.inf


# Checks of the motion


def _scale(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """Speeds, lengths and decelerations impossible for a stone: wrong units."""
    faults, unusual = [], []
    fastest, mu, error = motion.fastest, motion.friction, motion.friction_error
    moves = f"the stone moves at {fastest:.3g} m/s, and"
    if fastest - 3 * float(motion.error[motion.speed.argmax()]) > SPEED:
        faults.append(f"{moves} none is thrown at more than about 4 m/s")
    elif fastest > _USUAL_SPEED:
        unusual.append(f"{moves} few are thrown at more than 4 m/s")
    if motion.length > _LENGTH:
        # A stone of usual speed and friction needs no other unit to slide so far: a simulator may
        # have no back line.
        usual = fastest < _USUAL_SPEED and _USUAL_FRICTION[0] < mu < _USUAL_FRICTION[1]
        (unusual if usual else faults).append(
            f"the path is {motion.length:.3g} m long, and a sheet {LENGTH:.1f} m"
            + (", unless the ice goes on behind the back line" if usual else "")
        )
    low, high = FRICTION
    growing = mu < 0 and motion.speed[-1] > motion.speed[0]
    if not growing and (mu + 3 * error < low or mu - 3 * error > high):
        faults.append(
            f"it decelerates at {mu * GRAVITY:.2g} m/s^2, a coefficient of friction of {mu:.2g} "
            f"(on ice {low:g} to {high:g})"
        )
    if text := ", and ".join((faults or unusual)[:2]):
        yield Finding("units", text, _unit_remedy(throw, _oddity), bool(faults))


def _oddity(throw: Throw, alone: bool) -> float:
    """How far a throw is from a draw of 2 m/s, friction 0.01 and, where one axis alone is scaled,
    a curl of 1 m; infinite if it is not usual."""
    motion = motion_of(throw)
    if (
        motion is None
        or not 0.1 < motion.fastest < _USUAL_SPEED
        or motion.length > LENGTH
        or abs(motion.curl) > _USUAL_CURL
        or not _USUAL_FRICTION[0] < motion.friction < _USUAL_FRICTION[1]
    ):
        return math.inf
    odd = abs(math.log(motion.friction / 0.01)) + abs(math.log(motion.fastest / 2))
    return odd + abs(math.log(max(abs(motion.curl), 1e-3))) * alone


def _curl(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A curl impossible for a stone: a wrong unit across the sheet."""
    sure = abs(motion.curl) - 3 * motion.curl_error
    if sure > _USUAL_CURL:
        most = f"a sheet is {WIDTH:.1f} m wide" if sure > WIDTH else "few curl more than 2 m"
        text = f"the stone curls {abs(motion.curl):.3g} m, and {most}"
        yield Finding("units", text, _unit_remedy(throw, _oddity), sure > WIDTH)


def _push(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """The touch of a hand before the release, or of another stone: a velocity that jumps, or a
    speed that grows."""
    jump = velocity_jump(throw, motion)
    if jump is not None:
        at, change = jump
        early = at - throw.t[0] < throw.t[-1] - at
        cut = _option(throw, "since", _up(at)) if early else _option(throw, "until", _down(at))
        yield Finding(
            "collision",
            f"the velocity jumps by {change:.2g} m/s at t = {at:.4g} s, as in a collision or at "
            "the touch of a hand",
            f"leave out what is {'before' if early else 'after'}: {cut}",
        )
        return
    speed, error = motion.speed, motion.error
    rise = speed - np.minimum.accumulate(speed)
    peak = int(np.argmax(rise))
    trough = int(np.argmin(speed[: peak + 1]))
    if rise[peak] <= max(_GROWTH, SURE * math.hypot(error[peak], error[trough])):
        return
    begin, end, last = motion.t[trough], motion.t[peak], len(speed) - 1
    if peak == last and trough < 0.2 * len(speed):
        why = "times may run backwards, or all rows are before the release"
        remedy = "check the column of the time"
    elif begin - motion.t[0] < 0.5 * (motion.t[-1] - motion.t[0]) and peak < last - 1:
        why = "a hand was still on the stone, or something pushed it"
        after = _option(throw, "since", _up(float(motion.end[peak]) + 1e-9))
        remedy = f"leave out what is before the release: {after}"
    else:
        why = "something pushed the stone"
        before = _option(throw, "until", _down(float(motion.begin[trough])))
        remedy = f"leave out what follows: {before}"
    yield Finding(
        "growing speed",
        f"the speed grows from {speed[trough]:.2g} to {speed[peak]:.2g} m/s between t = "
        f"{begin:.3g} and {end:.3g} s, which friction cannot do: {why}",
        remedy,
    )


def _axes(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A motion across the sheet, or curl and spin of opposite sense. A stone curls to the side to
    which its front turns (Penner 2001): to the left if it turns counter-clockwise from above."""
    words = "" if throw.conventions is None else throw.conventions.axes
    x, y = motion.direction
    along_x = abs(x) > 2 * abs(y)
    forward = 1 if (x if along_x else y) > 0 else -1

    def axes(across: int, along: int, turn: int = 1) -> str:
        return _option(throw, "axes", corrected(words, across, along, turn, exchanged=along_x))

    turned, _ = turning(throw)
    certain = abs(motion.curl) - SURE * motion.curl_error > _CLEAR_CURL
    if certain and abs(turned) > _CLEAR_TURN and motion.curl * turned < 0:
        sense, side = ("clockwise", "left") if motion.curl > 0 else ("counter-clockwise", "right")
        if along_x:
            first, axis = axes(forward, forward), "x runs along the sheet and y across it"
        elif forward > 0:
            first, axis = axes(-1, 1), "x points to the left"
        else:
            first, axis = axes(1, -1), "y points back at the thrower"
        other = _option(throw, "axes", corrected(words, 1, 1, -1))
        yield Finding(
            "axes",
            f"the stone turns {sense} and curls {abs(motion.curl):.2g} m to the {side}, and stones "
            "on ice curl to the side to which they turn: unless the ice slopes, an axis or the "
            "angle is mirrored, and the fit would interchange the friction of front and back",
            f"if {axis}: {first}; if angles count the other way: {other}",
            refused=False,
        )
    elif along_x:
        text = "the stone moves along x, and x is taken as the direction across the sheet"
        if words:
            text = f"with axes {words} the stone moves across the sheet"
        remedy = f"if it moves along the sheet: {axes(-forward, forward)}"  # a rotation
        yield Finding("axes", text, remedy, refused=False)


def _rates(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A measured speed that disagrees with the path, a spin that disagrees with the angle."""
    ratios = {}
    if np.isfinite(motion.velocity).all() and np.isfinite(throw.speed).sum() >= 4:
        seen = np.isfinite(throw.speed)
        own = np.interp(motion.t, throw.t[seen], throw.speed[seen])
        fast = motion.speed > max(0.3 * motion.fastest, 10 * float(np.median(motion.error)))
        if fast.sum() >= 3:
            ratios["speed"] = float(np.median(own[fast] / motion.speed[fast]))
    angle, rate = np.isfinite(throw.phi), np.isfinite(throw.omega)
    if angle.sum() >= FEWEST and rate.sum() >= 4 and abs(turned := turning(throw)[0]) > 1.0:
        t = throw.t[angle]
        by_rate = np.trapezoid(np.interp(t, throw.t[rate], throw.omega[rate]), t)
        ratios["omega"] = float(by_rate) / turned
    low, high = _AGREE
    for quantity, ratio in ratios.items():
        if low < ratio < high:
            continue
        name, of = ("speed", "the path") if quantity == "speed" else ("spin", "the angle")
        kind, refused = "units", True
        says = f"the measured {name} is {ratio:.3g} times that of {of}"
        remedy = f"rename or remove the column of the {name}"
        factors = _factors(throw, quantity).items() if ratio > 0 else ()
        unit = next((u for u, factor in factors if abs(math.log(ratio * factor)) < 0.1), "")
        if unit:
            remedy = f"if it is in {unit}: {_option(throw, 'units', f'{name}={unit}')}"
        elif low < -ratio < high:
            kind = "axes"
            says = "spin and angle count in opposite senses: " * (name == "spin") + says
        else:
            refused = False
        yield Finding(kind, says, remedy, refused)


def _up(time: float) -> str:
    """A time rounded up to a hundredth of a second."""
    return f"{math.ceil(100 * time) / 100:g}"


def _down(time: float) -> str:
    """A time rounded down."""
    return f"{math.floor(100 * time - 1e-9) / 100:g}"


_STAGES = ((_scale,), (_push,), (_curl,), (_axes, _rates))
"""Checks of the motion, by stages; a stage is examined only if the one before refuses nothing."""
