"""Whether data and fit are plausible for a curling stone: findings, each
with its remedy.

What is impossible (a stone that speeds up, a path longer than the sheet, friction a
million times too small) is refused before a fit and makes it unusable after it;
what is merely unusual gives a warning. Data that are implausible but correct are
accepted with `as_given`. `_STAGES` lists the checks of the data. Limits without a
source are judgement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LENGTH, WIDTH
from curlfit.stone import GRAVITY
from curlfit.throws.channels import running_median
from curlfit.throws.motion import (
    FEWEST,
    SURE,
    MeasuredMotion,
    motion_of,
    position_jump,
    release,
    turning,
    velocity_jump,
)
from curlfit.throws.readers.angles import MAX_SPIN
from curlfit.throws.readers.axes import corrected
from curlfit.throws.readers.unwrapping import (
    AmbiguousTurnError,
    ContradictoryAnglesError,
    unwrap,
)
from curlfit.throws.remedies import (
    USUAL_CURL,
    USUAL_FRICTION,
    USUAL_SPEED,
    factors,
    option,
    some_units,
    unit_remedy,
)
from curlfit.throws.throw import Throw, scatter

FRICTION = (0.002, 0.1)
"""Limits of the mean coefficient of friction; published values are 0.006 to 0.02
(Penner 2001, Denny 2002), several times as much on frosted ice."""
SPEED = 6.0
"""Limit in m/s. The fastest throws take 6 to 7 s from hog line to hog line (21.9
m): 3.5 m/s."""
_LENGTH = 1.05 * LENGTH  # 5 % for an error in scale
_MOST_TURNS = 10.0  # a thrown stone makes two to four
_GROWTH = 0.1  # m/s; largest growth of a speed, that of friction 0.01 in 1 s
_CLEAR_CURL, _CLEAR_TURN = 0.2, 0.5  # m, rad; above these their senses are compared
# ratio of a measured rate to that of the path: calibration is within 20 %
_AGREE = 0.8, 1.25
# m; of 300 simulated throws with noise up to 0.1 m, fitted with coulomb by least
# squares, two have as much, both with outliers of 1 m in one row of ten
_MISFIT = 0.5
_MOST_ROWS = 1500  # for speed; more are condensed
# s, and times the usual step of time: no throw takes a minute
_LONGEST_GAP = 60.0, 100.0
_BESIDE = 5  # values with whose median each is compared
_FEW = 0.2  # fraction of the values that may be far off; of more the unit is wrong


@dataclass(frozen=True)
class Finding:
    """Something implausible in a throw or its fit.

    Attributes
    ----------
    kind : keyword for programs, such as "units", "axes", "growing speed".
    says : what was found, with the evidence. remedy : what to type, as a clause;
        may be empty.
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

    Consequences of a fault are not examined: a stone that was hit may have any curl,
    and in wrong units any stone seems to have been hit.
    """
    astray = (*_gap(throw), *_far(throw))
    if astray:
        return astray
    one = throw.condensed(_MOST_ROWS)
    found = [*_wrapped(one), *_turns(one)]
    if (motion := motion_of(one)) is not None:
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
    InputError : the stone never moves, or the data cannot be those of a curling stone;
        the latter is accepted if `as_given` is among the throw's defaults.
    """
    require_motion(throw)
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
            f"{throw.name}: {'. '.join(refused)}. To accept the data as "
            f"they are: {right}"
        )
    return found


def require_motion(throw: Throw) -> None:
    """Raise `DataError` if the motion does not exceed the scatter of the data."""
    seen = [values[np.isfinite(values)] for values in (throw.x, throw.y)]
    # Independent noise has the same spread over the whole throw as from row to row.
    moves = (len(v) > 1 and np.ptp(v) > 1e-6 and v.std() > 3 * scatter(v) for v in seen)
    if any(map(len, seen)) and not any(moves):
        fault = (
            "the stone never moves by more than the scatter of the data; "
            "nothing can be fitted"
        )
        raise DataError(fault, file=throw.name)


def examine_fit(
    throw: Throw,
    t: Floats,
    speed: Floats,
    start_speed: float,
    start_error: float | None,
    misfit: Mapping[str, float],
    *,
    alone: bool = True,
) -> tuple[Finding, ...]:
    """Implausible features of a fitted motion.

    Parameters
    ----------
    throw : the data, for their uncertainty and the wording of a remedy.
    t, speed : times (s) and fitted speeds (m/s), shape (n,); may be empty.
    start_speed, start_error : fitted initial speed and its standard error, m/s.
    misfit : root mean square of the residuals by channel, without outliers from which
        a robust loss protects the fit.
    alone : whether the throw was fitted by itself. Throws that were fitted together
        may differ by more than `_MISFIT`; that is unusual, not impossible.
    """
    said: dict[str, str] = {}
    remedy = f"if units are wrong, set them as in {some_units(throw)}"
    if not set(throw.seen) & {"x", "y", "speed"} and not throw.events:
        remedy = (
            "angles alone hardly determine the speed; measure it as well, or fix v0"
        )
    error = start_error or 0.0
    if start_speed - 3 * error > SPEED:
        speeds = (
            f"the fitted initial speed of {start_speed:.3g} m/s is more "
            "than anyone throws "
        )
        said["fitted speed"] = f"{speeds}(about 4 m/s)"
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
            said["fitted friction"] = speeds_up if mean < 0 else friction
    refused = not throw.defaults.get("as_given")
    found = [Finding(kind, says, remedy, refused) for kind, says in said.items()]
    return (*found, *_misfitting(throw, misfit, refused=refused and alone))


def _misfitting(
    throw: Throw, misfit: Mapping[str, float], *, refused: bool
) -> Iterator[Finding]:
    """Residuals as large as no camera and no friction make them."""
    far = {name: misfit[name] for name in ("x", "y") if misfit.get(name, 0) > _MISFIT}
    if far:
        listed = " and ".join(f"{size:.2g} m in {name}" for name, size in far.items())
        yield Finding(
            "misfit",
            f"the fit misses the data by {listed} (root mean square)",
            "if rows are wrong, leave them out or use "
            f"{option(throw, 'loss', 'student')}; otherwise check units, axes, fixed "
            "values and bounds",
            refused,
        )


# Checks of the rows


def _wrapped(throw: Throw) -> Iterator[Finding]:
    """Jumps of an angle, which readers remove but arrays may contain."""
    if throw.conventions is not None or "phi" not in throw.seen:
        return
    for period, unit in ((2 * math.pi, "rad"), (360.0, "deg")):
        with suppress(AmbiguousTurnError, ContradictoryAnglesError):
            jumps = unwrap(throw.t, 2 * math.pi / period * throw.phi).jumps
            if jumps and float(np.nanmax(np.abs(throw.phi))) < 1.1 * period:
                yield Finding(
                    "wrapped angle",
                    f"phi jumps by 360 degrees {counted(jumps, 'time')}: it is wrapped",
                    f'`Throw.from_arrays(..., units="angle={unit}")` unwraps it',
                )
                return


def _turns(throw: Throw) -> Iterator[Finding]:
    """A rotation too fast for an angle in radians."""
    turned, mean = turning(throw)
    if not abs(turned) > 2 * math.pi * _MOST_TURNS:
        return
    what, unit = (
        ("angles", "angle=deg") if "phi" in throw.seen else ("spins", "spin=deg/s")
    )
    yield Finding(
        "turns",
        f"the stone turns {abs(turned) / (2 * math.pi):.3g} times, "
        f"at {abs(mean):.3g} rad/s; stones turn at most about 10 times",
        f"if {what} are in degrees: {option(throw, 'units', unit)}",
        abs(mean) > MAX_SPIN,
    )


def _gap(throw: Throw) -> Iterator[Finding]:
    """Rows that are later or earlier than the others by more than a throw takes."""
    steps = np.diff(throw.t)
    if len(steps) < 3:
        return
    last = int(np.argmax(steps))
    longest, times = _LONGEST_GAP
    if steps[last] < max(longest, times * float(np.median(steps))):
        return
    early = last + 1 < len(throw) / 2
    row = last if early else last + 1
    alone = row in (0, len(throw) - 1)
    rows = "the row" if alone else "the rows until" if early else "the rows from"
    remedy = "correct the time, or leave out " + ("the row" if alone else "these rows")
    cut, time = ("since", throw.t[last + 1]) if early else ("until", throw.t[last])
    yield Finding(
        "time",
        f"{rows} t = {throw.t[row]:.6g} s{_line(throw, row)} "
        f"{'is' if alone else 'are'} {steps[last]:.3g} s from the others, and no throw "
        "takes a minute",
        f"{remedy}: {option(throw, cut, f'{time:.10g}')}",
    )


def _far(throw: Throw) -> Iterator[Finding]:
    """Single values farther from those beside them than any sheet is long."""
    for name in ("x", "y"):
        seen = np.flatnonzero(np.isfinite(getattr(throw, name)))
        values = getattr(throw, name)[seen]
        if len(values) < 2 * _BESIDE:
            continue
        off = np.abs(values - running_median(values, _BESIDE))
        far = off > _LENGTH
        if not far.any() or far.mean() > _FEW or np.ptp(values[~far]) > 2 * _LENGTH:
            continue
        worst = int(np.argmax(off))
        more = f" (and {counted(far.sum() - 1, 'other')})" if far.sum() > 1 else ""
        row = int(seen[worst])
        time = throw.t[row]
        step = 0.5 * float(np.diff(throw.t[max(row - 1, 0) : row + 2]).min())
        yield Finding(
            "far away",
            f"{name} = {values[worst]:.6g} m at t = {time:.6g} s{_line(throw, row)}"
            f"{more} is {off[worst]:.3g} m from those beside it, and a sheet is "
            f"{LENGTH:.1f} m long",
            "correct the value, or leave out the row: "
            + option(throw, "exclude", f"{time - step:.10g}:{time + step:.10g}"),
        )


def _line(throw: Throw, row: int) -> str:
    return "" if throw.lines is None else f" (line {throw.lines[row]})"


# Checks of the motion


def _jump(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A position that jumps from one row to the next."""
    found = position_jump(throw)
    if found is None:
        return
    before, after, size = found
    row = int(np.searchsorted(throw.t, after))
    early = after - throw.t[0] < throw.t[-1] - before
    cut = ("since", after) if early else ("until", before)
    yield Finding(
        "jump",
        f"the position jumps by about {size:.2g} m between t = {before:.4g} and "
        f"{after:.4g} s{_line(throw, row)}, which no stone does",
        f"correct the rows, or leave out what is {'before' if early else 'after'}: "
        + option(throw, cut[0], f"{cut[1]:.10g}"),
    )


def _scale(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """Speeds, lengths and decelerations impossible for a stone: wrong units."""
    fastest, mu, error = motion.fastest, motion.friction, motion.friction_error
    (low, high), (least, most) = FRICTION, USUAL_FRICTION
    sure = fastest - 3 * float(motion.error[motion.speed.argmax()])
    slows = not (mu < 0 and motion.speed[-1] > motion.speed[0])
    long = motion.length > _LENGTH
    # A stone of usual speed and friction needs no other unit to slide so far: a
    # simulator may have no back line.
    usual = fastest < USUAL_SPEED and least < mu < most
    moves = f"the stone moves at {fastest:.3g} m/s, and"
    path = f"the path is {motion.length:.3g} m long, and a sheet {LENGTH:.1f} m"
    braking = (
        f"it decelerates at {mu * GRAVITY:.2g} m/s^2, a coefficient of friction of "
        f"{mu:.2g} (on ice {low:g} to {high:g})"
    )
    mean = (
        f"its mean coefficient of friction is {mu:.2g}, and published ones "
        "are 0.006 to 0.02"
    )
    impossible = (
        (sure > SPEED, f"{moves} none is thrown at more than about 4 m/s"),
        (long and not usual, path),
        (slows and (mu + 3 * error < low or mu - 3 * error > high), braking),
    )
    rare = (
        (fastest > USUAL_SPEED, f"{moves} few are thrown at more than 4 m/s"),
        (long, f"{path}, unless the ice goes on behind the back line"),
        (slows and mu + 3 * error < least, mean),
    )
    for checks, refused in ((impossible, True), (rare, False)):
        if said := [says for holds, says in checks if holds]:
            yield Finding("units", ", and ".join(said[:2]), unit_remedy(throw), refused)
            return


def _curl(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A curl impossible for a stone: a wrong unit across the sheet."""
    sure = abs(motion.curl) - 3 * motion.curl_error
    if sure > USUAL_CURL:
        most = (
            f"a sheet is {WIDTH:.1f} m wide"
            if sure > WIDTH
            else "few curl more than 2 m"
        )
        text = f"the stone curls {abs(motion.curl):.3g} m, and {most}"
        yield Finding("units", text, unit_remedy(throw), sure > WIDTH)


class _Touch(NamedTuple):
    """A change of the motion that friction does not cause: its finding, and the time
    that since or until cuts it off at; neither, if it is not cut off."""

    kind: str
    says: str
    remedy: str
    cut: str = ""
    time: float = math.nan


def _push(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """The hand that holds a stone before the release, or the touch of a hand or
    another stone."""
    let_go, touch = release(throw), _touch(throw, motion)
    early, late = (touch, None) if touch and touch.cut == "since" else (None, touch)
    if let_go is not None and (early is None or _clear(throw, let_go) == let_go):
        held = f"the stone is held by a hand, and begins to turn at t = {let_go:.4g} s"
        kind, says, *_ = early or ("release", held)
        remedy = "leave out what is before the release, where it begins to turn"
        early = _Touch(kind, says, remedy, "since", let_go)
    elif early is not None:
        early = early._replace(time=_clear(throw, early.time))
    for one in filter(None, (early, late)):
        # to a hundredth of a second
        cut = (
            option(throw, one.cut, f"{_rounded(one.cut, one.time):g}")
            if one.cut
            else ""
        )
        yield Finding(one.kind, one.says, ": ".join(filter(None, (one.remedy, cut))))


def _clear(throw: Throw, time: float) -> float:
    """The time, from one on, after which no touch is left that is cut off at
    the beginning."""
    later = throw.select_rows(since=_rounded("since", time))
    motion = motion_of(later)
    touch = None if motion is None else _touch(later, motion)
    return _clear(throw, touch.time) if touch and touch.cut == "since" else time


def _touch(throw: Throw, motion: MeasuredMotion) -> _Touch | None:
    """A velocity that jumps, or a speed that grows."""
    jump = velocity_jump(throw, motion)
    if jump is not None:
        at, change = jump
        early = at - throw.t[0] < throw.t[-1] - at
        says = (
            f"the velocity jumps by {change:.2g} m/s at t = {at:.4g} s, "
            "as in a collision or at the touch of a hand"
        )
        remedy = "leave out what is " + ("before" if early else "after")
        if early and "phi" not in throw.seen:
            remedy += ", and the slide in the hand, which an angle would show"
        return _Touch("collision", says, remedy, "since" if early else "until", at)
    speed, error = motion.speed, motion.error
    rise = speed - np.minimum.accumulate(speed)
    peak = int(np.argmax(rise))
    trough = int(np.argmin(speed[: peak + 1]))
    if rise[peak] <= max(_GROWTH, SURE * math.hypot(error[peak], error[trough])):
        return None
    begin, end, last = motion.t[trough], motion.t[peak], len(speed) - 1
    cut, time = "until", float(motion.begin[trough])
    why, remedy = "something pushed the stone", "leave out what follows"
    if peak == last and trough < 0.2 * len(speed):
        why = "times may run backwards, or all rows are before the release"
        cut, remedy = "", "check the column of the time"
    elif begin - motion.t[0] < 0.5 * (motion.t[-1] - motion.t[0]) and peak < last - 1:
        why = "a hand was still on the stone, or something pushed it"
        remedy = "leave out what is before the release"
        cut, time = "since", float(motion.end[peak]) + 1e-9
    says = (
        f"the speed grows from {speed[trough]:.2g} to {speed[peak]:.2g} m/s between "
        f"t = {begin:.3g} and {end:.3g} s, which friction cannot do: {why}"
    )
    return _Touch("growing speed", says, remedy, cut, time)


def _axes(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A motion across the sheet, or curl and spin of opposite sense. A stone curls to
    the side to which its front turns (Penner 2001): to the left if it turns
    counter-clockwise from above."""
    words = "" if throw.conventions is None else throw.conventions.axes
    x, y = motion.direction
    along_x = abs(x) > 2 * abs(y)
    forward = 1 if (x if along_x else y) > 0 else -1

    def axes(across: int, along: int, turn: int = 1) -> str:
        return option(
            throw, "axes", corrected(words, across, along, turn, exchanged=along_x)
        )

    turned, _ = turning(throw)
    certain = abs(motion.curl) - SURE * motion.curl_error > _CLEAR_CURL
    if certain and abs(turned) > _CLEAR_TURN and motion.curl * turned < 0:
        sense, side = (
            ("clockwise", "left") if motion.curl > 0 else ("counter-clockwise", "right")
        )
        if along_x:
            first, axis = (
                axes(forward, forward),
                "x runs along the sheet and y across it",
            )
        elif forward > 0:
            first, axis = axes(-1, 1), "x points to the left"
        else:
            first, axis = axes(1, -1), "y points back at the thrower"
        other = option(throw, "axes", corrected(words, 1, 1, -1))
        yield Finding(
            "axes",
            f"the stone turns {sense} and curls {abs(motion.curl):.2g} m to the "
            f"{side}, and stones on ice curl to the side to which they turn: "
            "unless the ice slopes, an axis or the angle is mirrored, "
            "and the fit would interchange the friction of front and back",
            f"if {axis}: {first}; if angles count the other way: {other}",
            refused=False,
        )
    elif along_x:
        text = (
            "the stone moves along x, and x is taken as the direction across the sheet"
        )
        if words:
            text = f"with axes {words} the stone moves across the sheet"
        remedy = f"if it moves along the sheet: {axes(-forward, forward)}"  # a rotation
        yield Finding("axes", text, remedy, refused=False)


def _rates(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A measured speed that disagrees with the path, a spin that disagrees
    with the angle."""
    ratios = {}
    seen = np.isfinite(throw.speed)
    fast = motion.speed > max(0.3 * motion.fastest, 10 * float(np.median(motion.error)))
    if seen.sum() >= 4 and fast.sum() >= 3:
        own = np.interp(motion.t, throw.t[seen], throw.speed[seen])
        ratios["speed", "the path"] = float(np.median(own[fast] / motion.speed[fast]))
    angle, rate = np.isfinite(throw.phi), np.isfinite(throw.omega)
    if (
        angle.sum() >= FEWEST
        and rate.sum() >= 4
        and abs(turned := turning(throw)[0]) > 1.0
    ):
        t = throw.t[angle]
        by_rate = np.trapezoid(np.interp(t, throw.t[rate], throw.omega[rate]), t)
        ratios["spin", "the angle"] = float(by_rate) / turned
    low, high = _AGREE
    for (name, of), ratio in ratios.items():
        if low < ratio < high:
            continue
        kind, says = "units", f"the measured {name} is {ratio:.3g} times that of {of}"
        remedy = f"rename or remove the column of the {name}"
        opposite = low < -ratio < high
        units = factors(throw, "speed" if name == "speed" else "omega").items()
        unit = next(
            (u for u, f in units if ratio * f > 0 and abs(math.log(ratio * f)) < 0.1),
            "",
        )
        if unit:
            remedy = f"if it is in {unit}: {option(throw, 'units', f'{name}={unit}')}"
        elif opposite:
            kind = "axes"
            if name == "spin":
                says = f"spin and angle count in opposite senses: {says}"
        yield Finding(kind, says, remedy, bool(unit) or opposite)


def _rounded(name: str, time: float) -> float:
    hundredths = (
        math.ceil(100 * time) if name == "since" else math.floor(100 * time - 1e-9)
    )
    return hundredths / 100


_STAGES = ((_scale,), (_jump,), (_push,), (_curl,), (_axes, _rates))
"""Checks of the motion, by stages; a stage is examined only if the one before
refuses nothing."""
