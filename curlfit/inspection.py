"""What can be said of a throw before any fit: its clock, its noise, its faults, and its rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from curlfit.throw import Floats, Throw, last_motion, scatter

_PAUSE = 2.5  # usual intervals from which one is a pause
_FEW_PLACES = 4  # rows below which the places tell no speed
_STILL_ROWS, _STILL_TIME = 4, 0.2  # rows at rest and s of it from which rest counts as seen


@dataclass(frozen=True)
class Clock:
    """Intervals from row to row in s, and the pauses that stand out from them.

    `longest` and `after` are the length of the longest pause and when it began, None without one.
    """

    usual: float
    least: float
    most: float
    pauses: int
    longest: float | None
    after: float | None

    @property
    def even(self) -> bool:
        """Whether all intervals are the same."""
        return self.most - self.least <= 1e-6 * self.usual


@dataclass(frozen=True)
class Rest:
    """How the throw ends.

    Attributes
    ----------
    since : time in s of the first row at rest; None where rest was not seen.
    within : m around their middle in which the places at rest lie.
    speed : m/s at the last rows of a stone that still moves, or as measured there; None where
        hardly any place was seen and no speed.
    measured : whether `speed` is a measured one.
    """

    since: float | None = None
    within: float = 0.0
    speed: float | None = None
    measured: bool = False


@dataclass(frozen=True)
class Inspection:
    """Facts about a throw.

    `clock` is None for a single row. `noise` is the scatter from row to row by channel (SI), for
    those that have any; `jumps` counts steps far from those around them, by channel.
    """

    clock: Clock | None
    noise: dict[str, float]
    jumps: dict[str, int]
    rest: Rest


def inspected(throw: Throw) -> Inspection:
    """The facts about a throw."""
    noise, jumps = {}, {}
    for channel in throw.seen:
        values = getattr(throw, channel)
        seen = np.isfinite(values)
        spread = scatter(values[seen])
        if spread > 1e-12:
            noise[channel] = spread
        found = _jumps(throw.t[seen], values[seen], spread)
        if found:
            jumps[channel] = found
    return Inspection(_clock(throw.t), noise, jumps, _rest(throw))


def _clock(t: Floats) -> Clock | None:
    step = np.diff(t)
    if not len(step):
        return None
    usual = float(np.median(step))
    pauses = np.flatnonzero(step > max(_PAUSE * usual, 1.5 * float(np.quantile(step, 0.9))))
    longest = int(pauses[np.argmax(step[pauses])]) if len(pauses) else None
    return Clock(
        usual=usual,
        least=float(step.min()),
        most=float(step.max()),
        pauses=len(pauses),
        longest=None if longest is None else float(step[longest]),
        after=None if longest is None else float(t[longest]),
    )


def _jumps(t: Floats, values: Floats, noise: float) -> int:
    """Steps that differ from the median step around them by much more than the noise.

    A step over a pause may be of any size.
    """
    step = np.diff(values)
    if len(step) < 8:
        return 0
    around = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(step, 3, "edge"), 7), axis=1)
    off = np.abs(step - around)
    if not off.any():
        return 0
    usual = 6 * float(np.median(np.abs(step[step != 0])))  # numbers may be rounded coarsely
    far = off > np.maximum(max(12 * noise, usual), 3 * np.abs(around)) + 1e-9
    return int((far & (np.diff(t) < _PAUSE * np.median(np.diff(t)))).sum())


def _rest(throw: Throw) -> Rest:
    seen = np.isfinite(throw.x) & np.isfinite(throw.y)
    if seen.sum() < _FEW_PLACES:
        known = throw.speed[np.isfinite(throw.speed)]
        return Rest(speed=float(known[-1]), measured=True) if len(known) else Rest()
    t, x, y = throw.t[seen], throw.x[seen], throw.y[seen]
    still = t > last_motion(t, x, y)
    if still.sum() >= _STILL_ROWS and np.ptp(t[still]) > _STILL_TIME:
        off = np.hypot(x[still] - np.median(x[still]), y[still] - np.median(y[still]))
        return Rest(since=float(t[still][0]), within=float(off.max()))
    k = max(0, len(t) - max(4, len(t) // 20))
    return Rest(speed=float(np.hypot(x[-1] - x[k], y[-1] - y[k]) / (t[-1] - t[k])))
