"""Whether data and fit are plausible for a curling stone: findings, each with its remedy.

What is impossible (a stone that speeds up, a path longer than the sheet, friction a million times
too small) is refused before a fit and makes it unusable after it; what is merely unusual gives a
warning. Data that are implausible but correct are accepted with `as_given`. `_STAGES` has
the checks of the data, each with its sentence and remedy. Limits without a source are judgement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

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
from curlfit.throws.readers.axes import MAX_SPIN, AmbiguousTurnError, corrected, unwrap
from curlfit.throws.readers.columns import units_of
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
_GROWTH = 0.1, 0.05  # largest growth of a speed: m/s, and relative to the highest speed
_CLEAR_CURL, _CLEAR_TURN = 0.2, 0.5  # m, rad; above these their senses are compared
_AGREE = 0.8, 1.25  # ratio of a measured rate to that of the path: calibration is within 20 %
_MOST_ROWS = 1500  # for speed; more are condensed
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


class _Check(NamedTuple):
    """What is examined, and what is said of it.

    Attributes
    ----------
    kind : as of `Finding`. values : finds what the sentences need; None if nothing is implausible.
    says, remedy : sentences with places for these values.
    refused : as of `Finding`. Values named `kind` and `refused` take precedence.
    """

    kind: str
    values: Callable[[Throw, Any], Mapping[str, Any] | None]
    says: str
    remedy: str
    refused: bool = True

    def finding(self, throw: Throw, motion: MeasuredMotion | None) -> Iterator[Finding]:
        """The finding, if there is one."""
        found = self.values(throw, motion)
        if found is not None:
            says, remedy = (text.format(**found) for text in (self.says, self.remedy))
            refused = bool(found.get("refused", self.refused))
            yield Finding(str(found.get("kind", self.kind)), says, remedy, refused)


def examine(throw: Throw) -> tuple[Finding, ...]:
    """Implausible features of a throw before it is fitted, the most serious first.

    Consequences of a fault are not examined: a stone that was hit may have any curl, and in wrong
    units any stone seems to have been hit.
    """
    one = throw if len(throw) <= _MOST_ROWS else throw.condensed(_MOST_ROWS)
    motion = motion_of(one)
    found = [item for check in _OF_ROWS for item in check.finding(one, motion)]
    for stage in (_OF_FEW,) if motion is None else _STAGES:
        here = [item for check in stage for item in check.finding(one, motion)]
        found += here
        if any(item.refused for item in here):
            break
    return tuple(sorted(found, key=lambda item: not item.refused))


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
    said: list[tuple[str, str]] = []
    remedy = f"if units are wrong, set them as in {_units_words(throw, 't=ms', 'length=cm')}"
    if not set(throw.seen) & {"x", "y", "speed"} and not throw.events:
        remedy = "angles alone hardly determine the speed; measure it as well, or fix v0"
    sure = 3 * (start_error or 0.0)
    if start_speed - sure > SPEED:
        speeds = f"the fitted initial speed of {start_speed:.3g} m/s is more than anyone throws "
        said.append(("fitted speed", f"{speeds}(about 4 m/s)"))
    moving = speed > 1e-3
    if moving.sum() > 2:
        t, speed = t[moving], speed[moving]
        slowing = GRAVITY * float(t[-1] - t[0])
        mean = (float(speed[0]) - float(speed[-1])) / slowing
        motion = motion_of(throw)
        error = sure / (3 * slowing)
        if motion is not None and math.isfinite(motion.friction_error):
            error = motion.friction_error
        low, high = FRICTION
        if mean + 3 * error < low or mean - 3 * error > high:
            usual = f"on ice it is {low:g} to {high:g}"
            friction = f"the fitted mean coefficient of friction is {mean:.2g}; {usual}"
            speeds_up = "the fitted stone speeds up, which friction cannot cause"
            said.append(("fitted friction", speeds_up if mean < 0 else friction))
    refused = not throw.defaults.get("as_given")
    return tuple(Finding(kind, says, remedy, refused) for kind, says in said)


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


def _wrapped(throw: Throw, _: object) -> dict[str, Any] | None:
    """Jumps of an angle, which readers remove but arrays may contain."""
    if throw.conventions is not None or not np.isfinite(throw.phi).any():
        return None
    for period, size, unit in ((2 * math.pi, "360 degrees", "rad"), (360.0, "360", "deg")):
        try:
            _, jumps, _ = unwrap(throw.t, 2 * math.pi / period * throw.phi)
        except AmbiguousTurnError:
            continue
        if jumps and float(np.nanmax(np.abs(throw.phi))) < 1.1 * period:
            return {
                "size": size, "unit": unit, "times": "once" if jumps == 1 else f"{jumps} times",
            }  # fmt: skip
    return None


def _turns(throw: Throw, _: object) -> dict[str, Any] | None:
    """A rotation too fast for an angle in radians."""
    turned, mean = turning(throw)
    if turned is None or mean is None or abs(turned) < 2 * math.pi * _MOST_TURNS:
        return None
    angles = np.isfinite(throw.phi).sum() >= 2
    return {
        "turns": abs(turned) / (2 * math.pi), "rate": abs(mean), "refused": abs(mean) > MAX_SPIN,
        "what": "angles" if angles else "spins",
        "flag": _option(throw, "units", "angle=deg" if angles else "spin=deg/s"),
    }  # fmt: skip


def _scale(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
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
    text = ", and ".join((faults or unusual)[:2])
    units = {"text": text, "refused": bool(faults)}
    return units | {"units": _unit_remedy(throw)} if text else None


def _curl(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    """A curl impossible for a stone: a wrong unit across the sheet."""
    sure = abs(motion.curl) - 3 * motion.curl_error
    if not sure > _USUAL_CURL:
        return None
    most = f"a sheet is {WIDTH:.1f} m wide" if sure > WIDTH else "few curl more than 2 m"
    return {
        "curl": abs(motion.curl), "most": most, "refused": sure > WIDTH,
        "units": _unit_remedy(throw),
    }  # fmt: skip


def _scale_of_few(throw: Throw, _: object) -> dict[str, Any] | None:
    """The same for few positions, of which only the distance and the time taken are used."""
    length_and_time = extent(throw)
    faults = [] if length_and_time is None else list(_faults_of_few(*length_and_time))
    if length_and_time is None or not faults:
        return None
    length, time = length_and_time
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
    return {"text": ", and ".join(faults), "units": remedy}


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


def _collision(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    """The touch of a hand before the release, or of another stone."""
    jump = velocity_jump(throw, motion)
    if jump is None:
        return None
    at, change = jump
    early = at - throw.t[0] < throw.t[-1] - at
    flag = _option(throw, "since", _up(at)) if early else _option(throw, "until", _down(at))
    return {"at": at, "change": change, "side": "before" if early else "after", "flag": flag}


def _growth(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    """A speed that grows, not due to friction and without a jump."""
    speed, error = motion.speed, motion.error
    rise = speed - np.minimum.accumulate(speed)
    peak = int(np.argmax(rise))
    trough = int(np.argmin(speed[: peak + 1]))
    sure = SURE * math.hypot(error[peak], error[trough])
    if rise[peak] <= max(_GROWTH[0], _GROWTH[1] * motion.fastest, sure):
        return None
    if velocity_jump(throw, motion) is not None:
        return None
    begin, end = motion.t[trough], motion.t[peak]
    if peak == len(speed) - 1 and trough < 0.2 * len(speed):
        why = "times may run backwards, or all rows are before the release"
        remedy = "check the column of the time"
    elif begin - motion.t[0] < 0.5 * (motion.t[-1] - motion.t[0]) and peak < len(speed) - 2:
        why = "a hand was still on the stone, or something pushed it"
        after = _option(throw, "since", _up(float(motion.end[peak]) + 1e-9))
        remedy = f"leave out what is before the release: {after}"
    else:
        why = "something pushed the stone"
        before = _option(throw, "until", _down(float(motion.begin[trough])))
        remedy = f"leave out what follows: {before}"
    return {
        "low": speed[trough], "high": speed[peak], "begin": begin, "end": end, "why": why,
        "remedy": remedy,
    }  # fmt: skip


def _words(throw: Throw) -> str:
    return "" if throw.conventions is None else throw.conventions.axes


def _direction(motion: MeasuredMotion) -> tuple[bool, int]:
    """Whether the stone moves along x, and 1 or -1 for the sense of its motion along its axis."""
    x, y = motion.direction
    along_x = abs(x) > 2 * abs(y)
    return along_x, 1 if (x if along_x else y) > 0 else -1


def _is_mirrored(throw: Throw, motion: MeasuredMotion) -> bool:
    """Whether curl and spin are of opposite sense. A stone curls to the side to which its front
    turns (Penner 2001): to the left if it turns counter-clockwise seen from above."""
    turned, _ = turning(throw)
    certain = abs(motion.curl) - SURE * motion.curl_error > _CLEAR_CURL
    return turned is not None and certain and abs(turned) > _CLEAR_TURN and motion.curl * turned < 0


def _across(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    along_x, forward = _direction(motion)
    if not along_x or _is_mirrored(throw, motion):
        return None
    words = _words(throw)
    word = corrected(words, -forward, forward, 1, exchanged=True)  # a rotation
    text = "the stone moves along x, and x is taken as the direction across the sheet"
    if words:
        text = f"with axes {words} the stone moves across the sheet"
    return {"text": text, "flag": _option(throw, "axes", word)}


def _mirrored(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    if not math.isfinite(motion.direction[0]) or not _is_mirrored(throw, motion):
        return None
    words, (along_x, forward) = _words(throw), _direction(motion)
    if along_x:
        first = corrected(words, forward, forward, 1, exchanged=True)
        axis = "x runs along the sheet and y across it"
    elif forward > 0:
        first, axis = corrected(words, -1, 1, 1), "x points to the left"
    else:
        first, axis = corrected(words, 1, -1, 1), "y points back at the thrower"
    to_left = motion.curl > 0
    return {
        "sense": "clockwise" if to_left else "counter-clockwise", "curl": abs(motion.curl),
        "side": "left" if to_left else "right", "axis": axis,
        "flag": _option(throw, "axes", first),
        "clockwise": _option(throw, "axes", corrected(words, 1, 1, -1)),
    }  # fmt: skip


def _speeds(throw: Throw, motion: MeasuredMotion) -> dict[str, Any] | None:
    """A measured speed that disagrees with the path."""
    seen = np.isfinite(throw.speed)
    if not np.isfinite(motion.velocity).all() or seen.sum() < 4:
        return None
    own = np.interp(motion.t, throw.t[seen], throw.speed[seen])
    fast = motion.speed > max(0.3 * motion.fastest, 10 * float(np.median(motion.error)))
    if fast.sum() < 3:
        return None
    return _ratio(throw, "speed", float(np.median(own[fast] / motion.speed[fast])))


def _spins(throw: Throw, _: object) -> dict[str, Any] | None:
    """A measured spin that disagrees with the angle."""
    angle, rate = np.isfinite(throw.phi), np.isfinite(throw.omega)
    if angle.sum() < FEWEST or rate.sum() < 4:
        return None
    turned, _mean = turning(throw)
    t = throw.t[angle]
    own = np.interp(t, throw.t[rate], throw.omega[rate])
    by_rate = float(np.sum(np.diff(t) * (own[1:] + own[:-1]) / 2))
    if turned is None or abs(turned) <= 1.0:
        return None
    return _ratio(throw, "omega", by_rate / turned)


def _ratio(throw: Throw, quantity: str, ratio: float) -> dict[str, Any] | None:
    """Of a measured rate that is `ratio` times that of the path or angle."""
    low, high = _AGREE
    if low < ratio < high:
        return None
    name = "speed" if quantity == "speed" else "spin"
    found = {"ratio": ratio, "opposite": "", "remedy": f"rename or remove the column of the {name}"}
    for unit, factor in _factors(throw, quantity).items():
        if abs(math.log(abs(ratio) * factor)) < 0.1 and ratio > 0:
            flag = _option(throw, "units", f"{name}={unit}")
            return found | {"remedy": f"if it is in {unit}: {flag}"}
    if low < -ratio < high:
        return found | {"kind": "axes", "opposite": "spin and angle count in opposite senses: "}
    return found | {"refused": False}


def _up(time: float) -> str:
    """A time rounded up to a hundredth of a second."""
    return f"{math.ceil(100 * time) / 100:g}"


def _down(time: float) -> str:
    """A time rounded down."""
    return f"{math.floor(100 * time - 1e-9) / 100:g}"


_OF_ROWS = (
    _Check(
        "wrapped angle", _wrapped, "phi jumps by {size} {times}: it is wrapped",
        '`Throw.from_arrays(..., units="angle={unit}")` unwraps it',
    ),
    _Check(
        "turns", _turns,
        "the stone turns {turns:.3g} times, at {rate:.3g} rad/s; stones turn at most about 10 "
        "times", "if {what} are in degrees: {flag}",
    ),
)  # fmt: skip
_OF_FEW = (_Check("units", _scale_of_few, "{text}", "{units}"),)
_STAGES = (
    (_Check("units", _scale, "{text}", "{units}"),),
    (
        _Check(
            "collision", _collision,
            "the velocity jumps by {change:.2g} m/s at t = {at:.4g} s, as in a collision or at "
            "the touch of a hand", "leave out what is {side}: {flag}",
        ),
        _Check(
            "growing speed", _growth,
            "the speed grows from {low:.2g} to {high:.2g} m/s between t = {begin:.3g} and "
            "{end:.3g} s, which friction cannot do: {why}", "{remedy}",
        ),
    ),
    (_Check("units", _curl, "the stone curls {curl:.3g} m, and {most}", "{units}"),),
    (
        _Check("axes", _across, "{text}", "if it moves along the sheet: {flag}", False),
        _Check(
            "axes", _mirrored,
            "the stone turns {sense} and curls {curl:.2g} m to the {side}, and stones on ice curl "
            "to the side to which they turn: unless the ice slopes, an axis or the angle is "
            "mirrored, and the fit would interchange the friction of front and back",
            "if {axis}: {flag}; if angles count the other way: {clockwise}", False,
        ),
        _Check(
            "units", _speeds, "the measured speed is {ratio:.3g} times that of the path", "{remedy}"
        ),
        _Check(
            "units", _spins, "{opposite}the measured spin is {ratio:.3g} times that of the angle",
            "{remedy}",
        ),
    ),
)  # fmt: skip
"""Checks of the motion, by stages; a stage is examined only if the one before refuses nothing."""
