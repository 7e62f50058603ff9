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
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding, Level, Remedy
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LENGTH, WIDTH
from curlfit.stone import GRAVITY
from curlfit.throws.channels import median, running_median, scatter
from curlfit.throws.motion import (
    FEWEST,
    MIN_RATES,
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
from curlfit.throws.throw import Throw

FRICTION = (0.002, 0.1)
"""Limits of the mean coefficient of friction; published values are 0.006 to 0.02
(Penner 2001, Denny 2002), several times as much on frosted ice."""
SPEED = 6.0
"""Limit in m/s. The fastest throws take 6 to 7 s from hog line to hog line (21.9
m): 3.5 m/s."""
_LENGTH = 1.05 * LENGTH  # 5 % for an error in scale
_MOST_TURNS = 10.0  # a thrown stone makes two to four
_GROWTH = 0.1  # m/s; largest growth of a speed, that of friction 0.01 in 1 s
# of the throw; a speed that grows from there to the end is one that never falls
_FIRST_PART = 0.2
# The sense of a curl above this (m) is compared with that of a turn above this (rad).
_CLEAR_CURL = 0.2
_CLEAR_TURN = 0.5
# ratio of a measured rate to that of the path: calibration is within 20 %
_AGREE = 0.8, 1.25
# m; of 300 simulated throws with noise up to 0.1 m, fitted with coulomb by least
# squares, two have as much, both with outliers of 1 m in one row of ten
_MISFIT = 0.5
_MOST_ROWS = 1500  # for speed; more are condensed
_LONGEST_GAP = 60.0  # s; no throw takes as long
_MANY_STEPS = 100.0  # a gap is longer than so many usual steps of time
_BESIDE = 5  # values with whose median each is compared
_FEW = 0.2  # fraction of the values that may be far off; of more the unit is wrong


def examine(throw: Throw) -> tuple[Finding, ...]:
    """Implausible features of a throw before it is fitted, the most serious first.

    Consequences of a fault are not examined: a stone that was hit may have any curl,
    and in wrong units any stone seems to have been hit.
    """
    astray = (*_gap(throw), *_far(throw))
    if astray:
        return astray
    condensed = throw.condensed(_MOST_ROWS)
    findings = [*_wrapped(condensed), *_turns(condensed)]
    motion = motion_of(condensed)
    if motion is not None:
        for stage in _STAGES:
            findings_of_stage: list[Finding] = []
            for check in stage:
                findings_of_stage += check(condensed, motion)
            findings += findings_of_stage
            if any(finding.is_refusal for finding in findings_of_stage):
                break
    return tuple(sorted(findings, key=lambda finding: not finding.is_refusal))


def require_plausible(throw: Throw) -> tuple[Finding, ...]:
    """Findings on a throw that are no reason to refuse it.

    Raises
    ------
    InputError : the stone never moves, or the data cannot be those of a curling stone;
        the latter is accepted if `as_given` is among the throw's defaults.
    """
    require_motion(throw)
    findings = examine(throw)
    if throw.defaults.get("as_given"):
        return tuple(finding.at_level(Level.WARNING) for finding in findings)
    refused = [finding for finding in findings if finding.is_refusal]
    if refused:
        as_given = Option("as-given", in_python=throw.conventions is None)
        options = [option for finding in refused for option in finding.options]
        raise InputError(
            f"{throw.name}: {'. '.join(map(str, refused))}. To accept the data as "
            f"they are: {as_given}",
            options=(*options, as_given),
        )
    return findings


def require_motion(throw: Throw) -> None:
    """Raise `DataError` if the motion does not exceed the scatter of the data."""
    x = throw.x[np.isfinite(throw.x)]
    y = throw.y[np.isfinite(throw.y)]
    if not len(x) and not len(y):
        return
    if not _moves(x) and not _moves(y):
        fault = (
            "the stone never moves by more than the scatter of the data; "
            "nothing can be fitted"
        )
        raise DataError(fault, file=throw.name)


def _moves(values: Floats) -> bool:
    """Whether positions vary by more than their noise. Independent noise has the same
    spread over the whole throw as from row to row."""
    if len(values) < 2 or np.ptp(values) <= 1e-6:
        return False
    return bool(values.std() > 3 * scatter(values))


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
    level = Level.WARNING if throw.defaults.get("as_given") else Level.REFUSAL
    remedy = Remedy("wrong-units", *some_units(throw))
    if not set(throw.seen) & {"x", "y", "speed"} and not throw.events:
        remedy = Remedy("measure-speed")
    error = start_error or 0.0
    findings = []
    if start_speed - 3 * error > SPEED:
        numbers = {"speed": start_speed}
        findings.append(Finding("fitted-speed", level, numbers, (remedy,)))
    moving = speed > 1e-3
    if moving.sum() > 2:
        friction, friction_error = _fitted_friction(
            throw, t[moving], speed[moving], error
        )
        low, high = FRICTION
        if friction + 3 * friction_error < low or friction - 3 * friction_error > high:
            numbers = {"friction": friction, "low": low, "high": high}
            code = "fitted-speeds-up" if friction < 0 else "fitted-friction"
            findings.append(Finding(code, level, numbers, (remedy,)))
    return (*findings, *_misfitting(throw, misfit, level if alone else Level.WARNING))


def _fitted_friction(
    throw: Throw, t: Floats, speed: Floats, speed_error: float
) -> tuple[float, float]:
    """Mean deceleration over g of a fitted motion, and its standard error: that of the
    measured motion if the friction is not usual, else from the error of a speed."""
    low, high = FRICTION
    slowing = GRAVITY * float(t[-1] - t[0])
    friction = (float(speed[0]) - float(speed[-1])) / slowing
    motion = None if low <= friction <= high else motion_of(throw)
    if motion is not None and math.isfinite(motion.friction_error):
        return friction, motion.friction_error
    return friction, speed_error / slowing


def _misfitting(
    throw: Throw, misfit: Mapping[str, float], level: Level
) -> Iterator[Finding]:
    """Residuals as large as no camera and no friction make them."""
    far = [
        {"channel": name, "size": misfit[name]}
        for name in ("x", "y")
        if misfit.get(name, 0) > _MISFIT
    ]
    if far:
        remedy = Remedy("wrong-rows", option(throw, "loss", "student"))
        yield Finding("misfit", level, {"misfit": far}, (remedy,))


# Checks of the rows


def _wrapped(throw: Throw) -> Iterator[Finding]:
    """Jumps of an angle, which readers remove but arrays may contain."""
    if throw.conventions is not None or "phi" not in throw.seen:
        return
    for period, unit in ((2 * math.pi, "rad"), (360.0, "deg")):
        with suppress(AmbiguousTurnError, ContradictoryAnglesError):
            jumps = unwrap(throw.t, 2 * math.pi / period * throw.phi).jumps
            if jumps and float(np.nanmax(np.abs(throw.phi))) < 1.1 * period:
                unwraps = Option("units", f"angle={unit}", in_python=True)
                yield Finding.refusal(
                    "wrapped-angle", Remedy("unwraps", unwraps), count=jumps
                )
                return


def _turns(throw: Throw) -> Iterator[Finding]:
    """A rotation too fast for an angle in radians."""
    turned, mean = turning(throw)
    if not abs(turned) > 2 * math.pi * _MOST_TURNS:
        return
    if "phi" in throw.seen:
        remedy = Remedy("angles-in-degrees", option(throw, "units", "angle=deg"))
    else:
        remedy = Remedy("spins-in-degrees", option(throw, "units", "spin=deg/s"))
    level = Level.REFUSAL if abs(mean) > MAX_SPIN else Level.WARNING
    numbers = {"turns": abs(turned) / (2 * math.pi), "spin": abs(mean)}
    yield Finding("turns", level, numbers, (remedy,))


def _gap(throw: Throw) -> Iterator[Finding]:
    """Rows that are later or earlier than the others by more than a throw takes."""
    steps = np.diff(throw.t)
    if len(steps) < 3:
        return
    last = int(np.argmax(steps))
    usual = float(median(steps))
    if steps[last] < _LONGEST_GAP or steps[last] < _MANY_STEPS * usual:
        return
    if last + 1 < len(throw) / 2:
        row = last
        code = "rows-before-a-gap"
        cut = option(throw, "since", f"{throw.t[last + 1]:.10g}")
    else:
        row = last + 1
        code = "rows-after-a-gap"
        cut = option(throw, "until", f"{throw.t[last]:.10g}")
    remedy = Remedy("correct-times", cut)
    if row in (0, len(throw) - 1):  # alone
        code = "row-beyond-a-gap"
        remedy = Remedy("correct-time", cut)
    yield Finding.refusal(
        code,
        remedy,
        t=float(throw.t[row]),
        line=_line(throw, row),
        gap=float(steps[last]),
    )


def _far(throw: Throw) -> Iterator[Finding]:
    """Single values farther from those beside them than any sheet is long."""
    for name in ("x", "y"):
        rows = np.flatnonzero(np.isfinite(getattr(throw, name)))
        values = getattr(throw, name)[rows]
        if len(values) < 2 * _BESIDE or np.ptp(values) <= _LENGTH:
            continue
        off = np.abs(values - running_median(values, _BESIDE))
        far = off > _LENGTH
        if not far.any() or far.mean() > _FEW or np.ptp(values[~far]) > 2 * _LENGTH:
            continue
        worst = int(np.argmax(off))
        row = int(rows[worst])
        time = float(throw.t[row])
        step = 0.5 * float(np.diff(throw.t[max(row - 1, 0) : row + 2]).min())
        cut = option(throw, "exclude", f"{time - step:.10g}:{time + step:.10g}")
        yield Finding.refusal(
            "far-away",
            Remedy("correct-value", cut),
            channel=name,
            value=float(values[worst]),
            t=time,
            line=_line(throw, row),
            others=counted(far.sum() - 1, "other") if far.sum() > 1 else None,
            off=float(off[worst]),
            sheet=LENGTH,
        )


def _line(throw: Throw, row: int) -> int | None:
    """The line of a row in its file."""
    return None if throw.lines is None else int(throw.lines[row])


# Checks of the motion


def _jump(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A position that jumps from one row to the next."""
    jump = position_jump(motion)
    if jump is None:
        return
    before, after, size = jump
    row = int(np.searchsorted(throw.t, after))
    # The shorter part of the throw is the one to leave out.
    if after - throw.t[0] < throw.t[-1] - before:
        since = option(throw, "since", f"{after:.10g}")
        remedy = Remedy("rows-before-jump", since)
    else:
        until = option(throw, "until", f"{before:.10g}")
        remedy = Remedy("rows-after-jump", until)
    yield Finding.refusal(
        "jump",
        remedy,
        size=float(size),
        before=float(before),
        after=float(after),
        line=_line(throw, row),
    )


def _scale(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """Speeds, lengths and decelerations impossible for a stone: wrong units."""
    fastest = motion.fastest
    mu = motion.friction
    error = motion.friction_error
    low, high = FRICTION
    least_usual, most_usual = USUAL_FRICTION
    slows = not (mu < 0 and motion.speed[-1] > motion.speed[0])
    is_long = motion.length > _LENGTH
    # A stone of usual speed and friction needs no other unit to slide so far: a
    # simulator may have no back line.
    is_usual = fastest < USUAL_SPEED and least_usual < mu < most_usual
    at_least = fastest - 3 * float(motion.error[motion.speed.argmax()])
    unphysical = mu + 3 * error < low or mu - 3 * error > high
    # Of several findings the first is given, since they have the same cause.
    level = Level.REFUSAL
    if at_least > SPEED:
        code = "impossible-speed"
    elif is_long and not is_usual:
        code = "impossible-length"
    elif slows and unphysical:
        code = "impossible-friction"
    else:
        level = Level.WARNING
        if fastest > USUAL_SPEED:
            code = "high-speed"
        elif is_long:
            code = "long-path"
        elif slows and mu + 3 * error < least_usual:
            code = "low-friction"
        else:
            return
    numbers = {
        "speed": float(fastest),
        "length": float(motion.length),
        "sheet": LENGTH,
        "deceleration": float(mu * GRAVITY),
        "friction": float(mu),
        "low": low,
        "high": high,
    }
    yield Finding(code, level, numbers, (unit_remedy(throw),))


def _curl(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A curl impossible for a stone: a wrong unit across the sheet."""
    sure = abs(motion.curl) - 3 * motion.curl_error
    numbers = {"curl": abs(float(motion.curl)), "width": WIDTH}
    if sure > WIDTH:
        yield Finding.refusal("impossible-curl", unit_remedy(throw), **numbers)
    elif sure > USUAL_CURL:
        yield Finding.warning("large-curl", unit_remedy(throw), **numbers)


class _Touch(NamedTuple):
    """A change of the motion that friction does not cause.

    Attributes
    ----------
    code, numbers : of its finding.
    remedy : the code of what to do.
    cut : since or until, if its rows can be cut off; else empty.
    time : at which they are cut off, s.
    """

    code: str
    numbers: dict[str, float]
    remedy: str = ""
    cut: str = ""
    time: float = math.nan

    def finding(self, throw: Throw) -> Finding:
        """The finding, which proposes to cut off the rows."""
        cut = None
        if self.cut:
            cut = option(throw, self.cut, f"{_rounded(self.cut, self.time):g}")
        return Finding.refusal(self.code, Remedy(self.remedy, cut), **self.numbers)


def _push(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """The hand that holds a stone before the release, or the touch of a hand or
    another stone."""
    touch = _touch(throw, motion)
    released = release(throw)
    if touch is not None and touch.cut == "since":
        if released is not None and _clear(throw, released) == released:
            # The angle tells better than the speed where the hand lets go.
            touch = touch._replace(remedy="rows-before-release", time=released)
        else:
            touch = touch._replace(time=_clear(throw, touch.time))
        yield touch.finding(throw)
        return
    if released is not None:
        numbers = {"t": released}
        held = _Touch("held", numbers, "rows-before-release", "since", released)
        yield held.finding(throw)
    if touch is not None:
        yield touch.finding(throw)


def _clear(throw: Throw, time: float) -> float:
    """The time, from one on, after which no touch is left that is cut off at
    the beginning."""
    while True:
        rows_after = throw.select_rows(since=_rounded("since", time))
        motion = motion_of(rows_after)
        touch = None if motion is None else _touch(rows_after, motion)
        if touch is None or touch.cut != "since":
            return time
        time = touch.time


def _touch(throw: Throw, motion: MeasuredMotion) -> _Touch | None:
    """A velocity that jumps, or a speed that grows."""
    return _jump_of_velocity(throw, motion) or _growth_of_speed(motion)


def _jump_of_velocity(throw: Throw, motion: MeasuredMotion) -> _Touch | None:
    """A velocity that jumps; the shorter part of the throw is the one to leave out."""
    jump = velocity_jump(throw, motion)
    if jump is None:
        return None
    at, change = jump
    numbers = {"change": float(change), "t": float(at)}
    if at - throw.t[0] >= throw.t[-1] - at:
        return _Touch("collision", numbers, "rows-after", cut="until", time=at)
    # An angle would show where the stone is let go.
    remedy = "rows-before" if "phi" in throw.seen else "rows-before-and-slide"
    return _Touch("collision", numbers, remedy, cut="since", time=at)


def _growth_of_speed(motion: MeasuredMotion) -> _Touch | None:
    """A speed that grows by more than its errors: throughout, in the first half of the
    throw, as while a hand is on the stone, or later."""
    speed = motion.speed
    error = motion.error
    rise = speed - np.minimum.accumulate(speed)
    peak = int(np.argmax(rise))
    trough = int(np.argmin(speed[: peak + 1]))
    if rise[peak] <= max(_GROWTH, SURE * math.hypot(error[peak], error[trough])):
        return None
    numbers = {
        "low": float(speed[trough]),
        "high": float(speed[peak]),
        "begin": float(motion.t[trough]),
        "end": float(motion.t[peak]),
    }
    last = len(speed) - 1
    if peak == last and trough < _FIRST_PART * len(speed):
        return _Touch("speed-grows-throughout", numbers, "check-times")
    middle = (motion.t[0] + motion.t[-1]) / 2
    if motion.t[trough] < middle and peak < last - 1:
        end = float(motion.end[peak])
        remedy = "rows-before-letting-go"
        # the first row after the block, whose last one is at `end`
        time = end + 1e-9
        return _Touch("pushed-at-first", numbers, remedy, cut="since", time=time)
    begin = float(motion.begin[trough])
    return _Touch("pushed", numbers, "rows-after", cut="until", time=begin)


def _axes(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A motion across the sheet, or curl and spin of opposite sense. A stone curls to
    the side to which its front turns (Penner 2001): to the left if it turns
    counter-clockwise from above."""
    words = "" if throw.conventions is None else throw.conventions.axes
    x, y = motion.direction
    along_x = abs(x) > 2 * abs(y)
    forward = 1 if (x if along_x else y) > 0 else -1

    def corrected_axes(across: int, along: int) -> Option:
        """The option with axes that point the other way where a sign is -1."""
        changed = corrected(words, across, along, 1, exchanged=along_x)
        return option(throw, "axes", changed)

    certain = abs(motion.curl) - SURE * motion.curl_error > _CLEAR_CURL
    turned = turning(throw)[0] if certain else math.nan
    if abs(turned) > _CLEAR_TURN and motion.curl * turned < 0:
        to_the_left = motion.curl > 0
        if along_x:
            other_axes = Remedy("if-x-is-along", corrected_axes(forward, forward))
        elif forward > 0:
            other_axes = Remedy("if-x-is-to-the-left", corrected_axes(-1, 1))
        else:
            other_axes = Remedy("if-y-points-back", corrected_axes(1, -1))
        other_sense = option(throw, "axes", corrected(words, 1, 1, -1))
        yield Finding.warning(
            "curls-the-wrong-way",
            other_axes,
            Remedy("if-angles-count-the-other-way", other_sense),
            sense="clockwise" if to_the_left else "counter-clockwise",
            side="left" if to_the_left else "right",
            curl=abs(float(motion.curl)),
        )
    elif along_x:
        rotated = corrected_axes(-forward, forward)
        code = "across-by-axes" if words else "across"
        yield Finding.warning(code, Remedy("if-it-is-along", rotated), axes=words)


def _rates(throw: Throw, motion: MeasuredMotion) -> Iterator[Finding]:
    """A measured speed that disagrees with the path, a spin that disagrees
    with the angle."""
    yield from _disagreement(
        throw, "speed", "the path", _ratio_of_speeds(throw, motion)
    )
    yield from _disagreement(throw, "spin", "the angle", _ratio_of_turns(throw))


def _ratio_of_speeds(throw: Throw, motion: MeasuredMotion) -> float | None:
    """The measured speed over that of the path, where the stone is fast enough; None
    where too few rows tell it."""
    measured = np.isfinite(throw.speed)
    surely_moving = 10 * float(median(motion.error))
    fast = motion.speed > max(0.3 * motion.fastest, surely_moving)
    if measured.sum() < MIN_RATES or fast.sum() < 3:
        return None
    speed = np.interp(motion.t, throw.t[measured], throw.speed[measured])
    return float(median(speed[fast] / motion.speed[fast]))


def _ratio_of_turns(throw: Throw) -> float | None:
    """The integral of the measured spin over the change of the angle; None where too
    few rows tell it, or the stone hardly turns."""
    has_angle = np.isfinite(throw.phi)
    has_spin = np.isfinite(throw.omega)
    if has_angle.sum() < FEWEST or has_spin.sum() < MIN_RATES:
        return None
    turned, _ = turning(throw)
    if abs(turned) <= 1.0:
        return None
    t = throw.t[has_angle]
    spin = np.interp(t, throw.t[has_spin], throw.omega[has_spin])
    return float(np.trapezoid(spin, t)) / turned


def _disagreement(
    throw: Throw, rate: str, of: str, ratio: float | None
) -> Iterator[Finding]:
    """A rate that is not what positions or angles say.

    Parameters
    ----------
    rate : speed or spin. of : what it is compared with, in words.
    ratio : of the measured rate and that; None if it is not known.
    """
    low, high = _AGREE
    if ratio is None or low < ratio < high:
        return
    opposite = low < -ratio < high
    unit = _unit_of_rate(throw, rate, ratio)
    remedy = Remedy("other-column", numbers={"rate": rate})
    if unit:
        typed = option(throw, "units", f"{rate}={unit}")
        remedy = Remedy("unit-of-rate", typed, {"unit": unit})
    level = Level.REFUSAL if unit or opposite else Level.WARNING
    code = "rate-unlike-path"
    if opposite and not unit and rate == "spin":
        code = "spin-against-angle"
    numbers = {"rate": rate, "ratio": ratio, "of": of}
    yield Finding(code, level, numbers, (remedy,))


def _unit_of_rate(throw: Throw, rate: str, ratio: float) -> str:
    """The unit that explains a ratio within 10 %; empty if none does."""
    quantity = "speed" if rate == "speed" else "omega"
    for unit, factor in factors(throw, quantity).items():
        if ratio * factor > 0 and abs(math.log(ratio * factor)) < 0.1:
            return unit
    return ""


def _rounded(name: str, time: float) -> float:
    """A time for an option, in hundredths of a second, so that no row that is to be
    cut off is kept: later for `since`, earlier for `until`."""
    if name == "since":
        return math.ceil(100 * time) / 100
    return math.floor(100 * time - 1e-9) / 100


_STAGES = ((_scale,), (_jump,), (_push,), (_curl,), (_axes, _rates))
"""Checks of the motion, by stages; a stage is examined only if the one before
refuses nothing."""
