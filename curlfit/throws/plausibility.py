"""Whether data and fit are plausible for a curling stone: findings, each with its remedy.

What is impossible (a stone that speeds up, a path longer than the sheet, friction a million times
too small) is refused before a fit and makes it unusable after it; what is merely unusual gives a
warning. Data that are implausible but correct are accepted with `as_given`. Limits without a named
source are judgement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    extent,
    motion_of,
    turning,
    velocity_jump,
)
from curlfit.throws.readers.axes import MAX_SPIN, corrected, unwrap
from curlfit.throws.readers.columns import units_of
from curlfit.throws.throw import Conventions, Throw

FRICTION = (0.002, 0.1)
"""Limits of the mean coefficient of friction; published values are 0.006 to 0.02 (Penner 2001,
Denny 2002), several times as much on frosted ice."""
_USUAL_FRICTION = (0.003, 0.04)
SPEED = 6.0
"""Limit in m/s. The fastest throws take 6 to 7 s from hog line to hog line (21.9 m): 3.5 m/s."""
_USUAL_SPEED = 4.5
_LENGTH = 1.05 * LENGTH  # 5 % for an error in scale
_USUAL_CURL = 4.0  # m; ordinary throws curl 0.5 to 2 m
_MOST_TURNS = 10.0
_GROWTH = 0.1, 0.05  # largest growth of a speed: m/s, and relative to the highest speed
_CLEAR_CURL, _CLEAR_TURN = 0.2, 0.5  # m, rad; above these their senses are compared
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
    """Implausible features of a throw before it is fitted, the most serious first."""
    most = 1500
    one = throw if len(throw) <= most else throw.condensed(most)
    motion = motion_of(one)
    found = [*_wrapped(one), *_spin(one)]
    if motion is not None:
        found += _sound(one, motion)
    else:
        found += _scale_of_few(one)
    return tuple(sorted(found, key=lambda item: not item.refused))


def _sound(throw: Throw, motion: MeasuredMotion) -> list[Finding]:
    """Findings on the motion. Consequences of a fault are not examined: a stone that was hit may
    have any curl, and in wrong units any stone seems to have been hit."""
    off = list(_scale(throw, motion))
    if any(item.refused for item in off):
        return off
    hands = list(_other_hands(throw, motion))
    if hands:
        return [*off, *hands]
    off += _curl(throw, motion)
    if any(item.refused for item in off):
        return off
    return [*off, *_axes(throw, motion), *_measured_speed(throw, motion)]


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
        return tuple(replace(item, refused=False) for item in found)
    refused = [str(item) for item in found if item.refused]
    if refused:
        right = _option(throw, "as-given", None)
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
    found = []
    remedy = f"if units are wrong, set them as in {_units_words(throw, 't=ms', 'length=cm')}"
    if not set(throw.seen) & {"x", "y", "speed"} and not throw.events:
        remedy = "angles alone hardly determine the speed; measure it as well, or fix v0"
    sure = 3 * (start_error or 0.0)
    if start_speed - sure > SPEED:
        found.append(
            Finding(
                "fitted speed",
                f"the fitted initial speed of {start_speed:.3g} m/s is more than anyone throws "
                f"(about 4 m/s)",
                remedy,
            )
        )
    moving = speed > 1e-3
    if moving.sum() > 2:
        t, speed = t[moving], speed[moving]
        span = float(t[-1] - t[0])
        mean = (float(speed[0]) - float(speed[-1])) / (GRAVITY * span)
        motion = motion_of(throw)
        error = sure / (3 * GRAVITY * span)
        if motion is not None and math.isfinite(motion.friction_error):
            error = motion.friction_error
        if mean + 3 * error < FRICTION[0] or mean - 3 * error > FRICTION[1]:
            usual = f"on ice it is {FRICTION[0]:g} to {FRICTION[1]:g}"
            found.append(
                Finding(
                    "fitted friction",
                    "the fitted stone speeds up, which friction cannot cause"
                    if mean < 0
                    else f"the fitted mean coefficient of friction is {mean:.2g}; {usual}",
                    remedy,
                )
            )
    if throw.defaults.get("as_given"):
        found = [replace(item, refused=False) for item in found]
    return tuple(found)


def _option(throw: Throw, name: str, value: Any) -> str:
    """An option as written on the command line, or in Python for a throw from arrays."""
    if value == "":
        return f"leave out `{name}`" if throw.conventions is None else f"leave out `--{name}`"
    if throw.conventions is not None:
        return f"`--{name}`" if value is None else f"`--{name} {value}`"
    if value is None:
        return f'`Throw.from_arrays(..., defaults={{"{name.replace("-", "_")}": True}})`'
    if name in ("units", "axes"):
        return f'`Throw.from_arrays(..., {name}="{value}")`'
    if name == "exclude":
        low, high = str(value).split(":")
        return f"`exclude=[({low}, {high})]`"
    return f"`{name}={value}`"


def _units_words(throw: Throw, *choices: str) -> str:
    return " or ".join(_option(throw, "units", choice) for choice in choices)


def _factors(throw: Throw, quantity: str) -> dict[str, float]:
    """Units that a column may really be in, with the factors by which its values would change."""
    conventions = throw.conventions or Conventions()
    known = units_of(quantity)
    now = known.get(_plain(conventions.units.get(quantity, "")), 1.0)
    names = {
        "t": ("s", "ms", "us", "min", "30fps"), "phi": ("rad", "deg", "mrad"),
        "omega": ("rad/s", "deg/s", "rpm"), "speed": ("m/s", "km/h", "ft/s", "mph", "cm/s", "mm/s"),
    }.get(quantity, ("m", "cm", "mm", "ft", "in"))  # fmt: skip
    frames = {"30fps": 1 / 30}
    factors = {unit: (frames | known).get(_plain(unit), 0.0) / now for unit in names}
    return {unit: factor for unit, factor in factors.items() if factor and factor != 1}


def _plain(unit: str) -> str:
    return "".join(char for char in unit.lower() if char not in "/ .[]()")


def _is_usual(motion: MeasuredMotion) -> bool:
    return (
        0.1 < motion.fastest < _USUAL_SPEED
        and motion.length < LENGTH
        and not abs(motion.curl) > _USUAL_CURL
        and not (motion.friction < _USUAL_FRICTION[0] or motion.friction > _USUAL_FRICTION[1])
    )


def _scale(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """Speeds, lengths and decelerations impossible for a stone: wrong units."""
    faults, unusual = [], []
    if motion.fastest - 3 * float(motion.error[motion.speed.argmax()]) > SPEED:
        faults.append(f"the stone moves at {motion.fastest:.3g} m/s, and none is thrown at more "
                      "than about 4 m/s")  # fmt: skip
    elif motion.fastest > _USUAL_SPEED:
        unusual.append(f"the stone moves at {motion.fastest:.3g} m/s, and few are thrown at more "
                       "than 4 m/s")  # fmt: skip
    mu, error = motion.friction, motion.friction_error
    low, high = FRICTION
    if motion.length > _LENGTH:
        # A stone of usual speed and friction needs no other unit to slide so far: a simulator may
        # have no back line.
        usual = motion.fastest < _USUAL_SPEED and _USUAL_FRICTION[0] < mu < _USUAL_FRICTION[1]
        (unusual if usual else faults).append(
            f"the path is {motion.length:.3g} m long, and a sheet {LENGTH:.1f} m"
            + (", unless the ice goes on behind the back line" if usual else "")
        )
    growing = mu < 0 and motion.speed[-1] > motion.speed[0]
    if not growing and (mu + 3 * error < low or mu - 3 * error > high):
        deceleration = mu * GRAVITY
        faults.append(
            f"it decelerates at {deceleration:.2g} m/s^2, a coefficient of friction of {mu:.2g} "
            f"(on ice {low:g} to {high:g})"
        )
    if faults or unusual:
        text = ", and ".join((faults or unusual)[:2])
        yield Finding("units", text, _unit_remedy(throw), refused=bool(faults))


def _curl(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A curl impossible for a stone: a wrong unit across the sheet."""
    sure = abs(motion.curl) - 3 * motion.curl_error
    if sure > _USUAL_CURL:
        most = f"a sheet is {WIDTH:.1f} m wide" if sure > WIDTH else "few curl more than 2 m"
        text = f"the stone curls {abs(motion.curl):.3g} m, and {most}"
        yield Finding("units", text, _unit_remedy(throw), refused=sure > WIDTH)


def _scale_of_few(throw: Throw) -> Iterator[Finding]:
    """The same for few positions, of which only the distance and the time taken are used."""
    length_and_time = extent(throw)
    if length_and_time is None:
        return
    length, time = length_and_time
    faults = list(_faults_of_few(length, time))
    if not faults:
        return
    usual = None
    for units, factors in _candidates(throw):
        if len(factors) == 1 and "t" not in factors:
            continue
        scaled = factors.get("x", 1.0) * length, factors.get("t", 1.0) * time
        speed = scaled[0] / scaled[1]
        if not list(_faults_of_few(*scaled)) and 0.3 < speed < 3:
            off = abs(math.log(speed / 1.5)) + units.count(",")
            usual = min(usual or (off, units), (off, units))
    remedy = (
        f"set the units of the file, as in {_units_words(throw, 't=ms', 'length=cm')}"
        if usual is None
        else f"if those are its units: {_option(throw, 'units', usual[1])}"
    )
    yield Finding("units", ", and ".join(faults), remedy)


def _faults_of_few(length: float, time: float) -> Iterator[str]:
    """Impossible features of a path of this length (m) and duration (s)."""
    # A stone that stops has twice its mean speed at first.
    if length > _LENGTH and 2 * length / time > _USUAL_SPEED:
        yield f"the path is {length:.3g} m long, and a sheet {LENGTH:.1f} m"
    if length / time > SPEED:
        yield (
            f"the stone moves at {length / time:.3g} m/s, and none is thrown at more than about 4 "
            "m/s"
        )
    # A stone stopped by constant friction mu covers s in sqrt(2 s/(mu g)), a moving one in less.
    if 2 * length / (GRAVITY * time**2) < FRICTION[0] / 4:
        yield (
            f"it takes {time:.3g} s for {length:.3g} m, where friction on ice stops a stone within "
            f"{math.sqrt(2 * length / (GRAVITY * FRICTION[0])):.2g} s"
        )


def _unit_remedy(throw: Throw) -> str:
    """Units in which this would be a usual throw, as an option to type."""
    best: tuple[float, str] | None = None
    for units, factors in _candidates(throw):
        changed = {name: factor * getattr(throw, name) for name, factor in factors.items()}
        motion = motion_of(replace(throw, sigma={}, **changed))
        if motion is None or not _is_usual(motion):
            continue
        # Nearest to a draw of 2 m/s, friction 0.01 and a curl of 1 m, with few units changed.
        off = abs(math.log(motion.friction / 0.01)) + abs(math.log(motion.fastest / 2))
        off += units.count(",")
        if len(factors) == 1 and "t" not in factors:
            off += 1 + abs(math.log(max(abs(motion.curl), 1e-3))) + units.endswith(("in", "ft"))
        if best is None or off < best[0]:
            best = off, units
    if best is None:
        return f"set the units of the file, as in {_units_words(throw, 't=ms', 'length=cm')}"
    flag = _option(throw, "units", best[1])
    if best[1].endswith("fps"):
        return f"if t counts frames: {flag}, with the frame rate of the camera"
    what = {"t": "the time is", "length": "lengths are"}
    parts = [part.partition("=") for part in best[1].split(",")]
    said = [f"{what.get(name, f'{name} is')} in {_NAMES.get(u, u)}" for name, _, u in parts]
    return f"if {' and '.join(said)}: {flag}"


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


def _wrapped(throw: Throw) -> Iterator[Finding]:
    """Jumps of an angle, which readers remove but arrays may contain."""
    if throw.conventions is not None or not np.isfinite(throw.phi).any():
        return
    for period, unit in ((2 * math.pi, "360 degrees"), (360.0, "360")):
        scale = 2 * math.pi / period
        try:
            _, jumps, _ = unwrap(throw.t, scale * throw.phi)
        except Exception:
            continue
        if jumps and float(np.nanmax(np.abs(throw.phi))) < 1.1 * period:
            remedy = (
                '`Throw.from_arrays(..., units="angle=deg")` unwraps it'
                if period > 7
                else '`Throw.from_arrays(..., units="angle=rad")` unwraps it'
            )
            times = "once" if jumps == 1 else f"{jumps} times"
            yield Finding("wrapped angle", f"phi jumps by {unit} {times}: it is wrapped", remedy)
            return


def _spin(throw: Throw) -> Iterator[Finding]:
    """A rotation too fast for an angle in radians."""
    turned, mean = turning(throw)
    if turned is None or mean is None or abs(turned) < 2 * math.pi * _MOST_TURNS:
        return
    turns = abs(turned) / (2 * math.pi)
    channel = "phi" if np.isfinite(throw.phi).sum() >= 2 else "omega"
    unit = "angle=deg" if channel == "phi" else "spin=deg/s"
    yield Finding(
        "turns",
        f"the stone turns {turns:.3g} times, at {abs(mean):.3g} rad/s; stones turn at most about "
        "10 times",
        f"if {'angles are' if channel == 'phi' else 'spins are'} in degrees: "
        + _option(throw, "units", unit),
        refused=abs(mean) > MAX_SPIN,
    )


def _other_hands(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """Motion not due to friction: a hand before the release, another stone, a stone picked up."""
    jump = velocity_jump(throw, motion)
    if jump is not None:
        at, change = jump
        early = at - throw.t[0] < throw.t[-1] - at
        flag = ("since", _up(at)) if early else ("until", _down(at))
        yield Finding(
            "collision",
            f"the velocity jumps by {change:.2g} m/s at t = {at:.4g} s, as in a collision or at "
            "the touch of a hand",
            f"leave out what is {'before' if early else 'after'}: {_option(throw, *flag)}",
        )
        return
    speed, error = motion.speed, motion.error
    lowest = np.minimum.accumulate(speed)
    rise = speed - lowest
    peak = int(np.argmax(rise))
    trough = int(np.argmin(speed[: peak + 1]))
    limit = max(
        _GROWTH[0], _GROWTH[1] * motion.fastest, SURE * math.hypot(error[peak], error[trough])
    )
    if rise[peak] <= limit:
        return
    span = motion.t[-1] - motion.t[0]
    text = (
        f"the speed grows from {speed[trough]:.2g} to {speed[peak]:.2g} m/s between "
        f"t = {motion.t[trough]:.3g} and {motion.t[peak]:.3g} s, which friction cannot do"
    )
    if peak == len(speed) - 1 and trough < 0.2 * len(speed):
        yield Finding(
            "growing speed",
            f"{text}: times may run backwards, or all rows are before the release",
            "check the column of the time",
        )
    elif motion.t[trough] - motion.t[0] < 0.5 * span and peak < len(speed) - 2:
        after = float(motion.end[peak]) + 1e-9
        yield Finding(
            "growing speed",
            f"{text}: a hand was still on the stone, or something pushed it",
            f"leave out what is before the release: {_option(throw, 'since', _up(after))}",
        )
    else:
        before = float(motion.begin[trough])
        yield Finding(
            "growing speed",
            f"{text}: something pushed the stone",
            f"leave out what follows: {_option(throw, 'until', _down(before))}",
        )


def _axes(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """The side of the curl compared with the sense of the spin.

    A stone curls to the side to which its front turns (Penner 2001): to the left if it turns
    counter-clockwise seen from above.
    """
    turned, _ = turning(throw)
    if not math.isfinite(motion.direction[0]):
        return
    words = "" if throw.conventions is None else throw.conventions.axes
    along_x = abs(motion.direction[0]) > 2 * abs(motion.direction[1])
    certain = abs(motion.curl) - SURE * motion.curl_error > _CLEAR_CURL
    if turned is None or not (certain and abs(turned) > _CLEAR_TURN and motion.curl * turned < 0):
        if along_x:
            forward = 1 if motion.direction[0] > 0 else -1
            word = corrected(words, -forward, forward, 1, exchanged=True)  # a rotation
            yield Finding(
                "axes",
                f"with axes {words} the stone moves across the sheet"
                if words
                else "the stone moves along x, and x is taken as the direction across the sheet",
                f"if it moves along the sheet: {_option(throw, 'axes', word)}",
                refused=False,
            )
        return
    if along_x:
        forward = 1 if motion.direction[0] > 0 else -1
        first = corrected(words, forward, forward, 1, exchanged=True)
        axis = "x runs along the sheet and y across it"
    elif motion.direction[1] > 0:
        first, axis = corrected(words, -1, 1, 1), "x points to the left"
    else:
        first, axis = corrected(words, 1, -1, 1), "y points back at the thrower"
    clockwise = corrected(words, 1, 1, -1)
    side = "left" if motion.curl > 0 else "right"
    sense = "counter-clockwise" if turned > 0 else "clockwise"
    yield Finding(
        "axes",
        f"the stone turns {sense} and curls {abs(motion.curl):.2g} m to the {side}, and stones on "
        "ice curl to the side to which they turn: unless the ice slopes, an axis or the angle is "
        "mirrored, and the fit would interchange the friction of front and back",
        f"if {axis}: {_option(throw, 'axes', first)}; if angles count the other way: "
        + _option(throw, "axes", clockwise),
        refused=False,
    )


def _measured_speed(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A measured speed or spin that disagrees with the path or the angle."""
    seen = np.isfinite(throw.speed)
    if np.isfinite(motion.velocity).all() and seen.sum() >= 4:
        own = np.interp(motion.t, throw.t[seen], throw.speed[seen])
        fast = motion.speed > max(0.3 * motion.fastest, 10 * float(np.median(motion.error)))
        if fast.sum() >= 3:
            yield from _ratio(throw, "speed", float(np.median(own[fast] / motion.speed[fast])))
    angle, rate = np.isfinite(throw.phi), np.isfinite(throw.omega)
    if angle.sum() >= FEWEST and rate.sum() >= 4:
        turned, mean = turning(throw)
        t = throw.t[angle]
        own = np.interp(t, throw.t[rate], throw.omega[rate])
        by_rate = float(np.sum(np.diff(t) * (own[1:] + own[:-1]) / 2))
        if turned is not None and mean is not None and abs(turned) > 1.0:
            yield from _ratio(throw, "omega", by_rate / turned)


def _ratio(throw: Throw, quantity: str, ratio: float) -> Iterator[Finding]:
    """Finding on a measured rate that is `ratio` times that of the path or angle."""
    if 0.8 < ratio < 1.25:
        return
    name, flag = {"speed": ("speed", "speed"), "omega": ("spin", "spin")}[quantity]
    of = "path" if quantity == "speed" else "angle"
    text = f"the measured {name} is {ratio:.3g} times that of the {of}"
    for unit, factor in _factors(throw, quantity).items():
        if abs(math.log(abs(ratio) * factor)) < 0.1 and ratio > 0:
            remedy = f"if it is in {unit}: {_option(throw, 'units', f'{flag}={unit}')}"
            yield Finding("units", text, remedy)
            return
    column = f"rename or remove the column of the {name}"
    if -1.25 < ratio < -0.8:
        yield Finding("axes", f"spin and angle count in opposite senses: {text}", column)
        return
    yield Finding("units", text, column, refused=False)


def _up(time: float) -> str:
    """A time rounded up to a hundredth of a second."""
    return f"{math.ceil(100 * time) / 100:g}"


def _down(time: float) -> str:
    """A time rounded down."""
    return f"{math.floor(100 * time - 1e-9) / 100:g}"
