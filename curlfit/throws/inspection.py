"""What can be said of a throw before any fit: its clock, its noise, its faults, and its rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from curlfit.throws.throw import Floats, Throw, scatter

_PAUSE = 2.5  # usual intervals from which one is a pause
_FEW_PLACES = 4  # rows below which the places tell no speed
_STILL_ROWS, _STILL_TIME = 4, 0.2  # rows at rest and s of it from which rest counts as seen
_STILL_SPEED = 0.03  # m/s below which a stone that brakes at 0.1 m/s^2 rests within 0.3 s and 5 mm
_SWAY = 0.001  # m by which a camera may drift, whatever the scatter from row to row
_SURE = 3.0  # standard errors
_END_ROWS, _END_TIME = 6, 1.0  # rows, and s of them, that tell the speed at the end


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
    speed : m/s at the last row where rest was not seen, or as measured there; None where hardly any
        place was seen and no speed.
    error : standard error of `speed` in m/s, 0 of a measured one.
    measured : whether `speed` is a measured one.
    """

    since: float | None = None
    within: float = 0.0
    speed: float | None = None
    error: float = 0.0
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
    t, places = throw.t[seen], np.stack([throw.x[seen], throw.y[seen]])
    sure = _surely_still(t, places)
    if sure is None:
        speed, error = _speed_at_the_end(t, places)
        return Rest(speed=speed, error=error)
    still = places[:, sure:]
    off = np.hypot(*(still - np.median(still, axis=1, keepdims=True)))
    return Rest(since=float(t[sure]), within=float(off.max()))


def _surely_still(t: Floats, places: Floats) -> int | None:
    """The first of some last rows whose line shows no speed, and excludes one that matters.

    A stone that still moves is slow for a moment: it stays within its noise of where it ends, but
    the line through those rows has a slope, or an error that leaves room for one. Of all last rows
    those are taken that leave the least room.
    """
    late = t - t[-1]
    place = places - places[:, -1:]
    # Sums over the rows from each one to the last.
    n, st, stt, sp, stp, spp = (
        np.cumsum(part[..., ::-1], -1)[..., ::-1]
        for part in (np.ones_like(t), late, late**2, place, late * place, place**2)
    )
    enough = (n >= _STILL_ROWS) & (late < -_STILL_TIME)
    if not enough.any():
        return None
    n, st, stt, sp, stp, spp = (part[..., enough] for part in (n, st, stt, sp, stp, spp))
    spread = stt - st**2 / n
    slope = (stp - st * sp / n) / spread
    left = np.maximum(spp - sp**2 / n - slope**2 * spread, 0.0) / (n - 2)
    noise = np.maximum(left, np.reshape(scatter(places), (2, 1)) ** 2)
    error = np.sqrt(noise / spread + (_SWAY / late[enough]) ** 2)
    none = (np.abs(slope) < _SURE * error).all(0)
    most = np.where(none, np.hypot(*(np.abs(slope) + _SURE * error)), np.inf)
    least = int(np.argmin(most))
    return int(np.flatnonzero(enough)[least]) if most[least] < _STILL_SPEED else None


def _speed_at_the_end(t: Floats, places: Floats) -> tuple[float, float]:
    """The speed at the last row and its standard error, from a parabola through the last rows.

    Where a cubic ends with another speed than noise explains, that is part of the error.
    """
    last = max(min(len(t), _END_ROWS), int((t > t[-1] - _END_TIME).sum()))
    late, places = t[-last:] - t[-1], places[:, -last:]
    noise = scatter(places)
    (velocity, variance), (other, its_variance) = (
        _slope_at_the_end(late, places, min(degree, last - 2), noise) for degree in (2, 3)
    )
    bias = np.maximum((other - velocity) ** 2 - np.maximum(its_variance - variance, 0.0), 0.0)
    speed = float(np.hypot(*velocity))
    along = velocity**2 / speed**2 if speed > 0 else np.full(2, 0.5)
    return speed, float(np.sqrt(along @ (variance + bias) + (_SWAY / late[0]) ** 2))


def _slope_at_the_end(
    late: Floats, places: Floats, degree: int, noise: Floats
) -> tuple[Floats, Floats]:
    """Slopes of polynomials at 0 and their variances, for noise that is no less than given."""
    powers = np.vander(late, degree + 1, increasing=True)
    found, *_ = np.linalg.lstsq(powers, places.T, rcond=None)
    left = ((places.T - powers @ found) ** 2).sum(0) / (len(late) - degree - 1)
    return found[1], np.linalg.inv(powers.T @ powers)[1, 1] * np.maximum(left, noise**2)
