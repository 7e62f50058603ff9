"""Angles that were reduced to one turn, made continuous again."""

from __future__ import annotations

import math

import numpy as np

from curlfit.throws.throw import Floats

_TURN = 2 * math.pi
FASTEST = 2 * _TURN
"""rad/s; a thrown stone makes two to four turns on its way, some 1 rad/s or 60 degrees/s."""


class AmbiguousTurnError(Exception):
    """Half a turn or so between two rows: which way cannot be told. `row` is the later one."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


def unwrap(t: Floats, phi: Floats, omega: Floats | None = None) -> tuple[Floats, int, float]:
    """The angle without its jumps, how many there were, and their size.

    An angle that stays within one turn (or half a turn, the direction of a line) and jumps
    against its course was reduced modulo that. The spin, where it was measured, tells how far the
    stone turned between two rows; else the turn from row to row must be well below half a
    period, and gaps are bridged at the pace around them. In an angle that counts on beyond one
    turn, single jumps by whole turns are taken out.

    Parameters
    ----------
    t : times in s, increasing. phi : angle in rad, NaN where not seen.
    omega : spin in rad/s by the same rule of sign, NaN where not seen.

    Raises
    ------
    AmbiguousTurnError : the stone turns too fast for the rows.
    """
    seen = np.flatnonzero(np.isfinite(phi) & np.isfinite(t))
    if len(seen) < 3:
        return phi, 0, _TURN
    time, angle = t[seen], phi[seen]
    step, dt = np.diff(angle), np.diff(time)
    if (dt <= 0).any():
        return phi, 0, _TURN
    expected = _expected(t, omega, time)
    period, wrapped = _period(angle, step)
    if expected is not None:
        true = step - period * np.round((step - expected) / period)
        if np.median(np.abs(true - expected)) > 0.25 * period:
            expected = None  # another sign, or another clock
    if expected is None:
        if wrapped:
            true = _by_pace(time, step, dt, period, seen)
        else:
            period, true = _TURN, _without_jumps(step, dt)
    jumps = int((np.abs(true - step) > period / 2).sum())
    if not jumps:
        return phi, 0, period
    result = phi.copy()
    result[seen] = angle[0] + np.concatenate([[0.0], np.cumsum(true)])
    return result, jumps, period


def jump_in_degrees(angle: Floats) -> tuple[int, int] | None:
    """The row of the first jump, and its size 360 or 180, of numbers that look like an angle in
    degrees that was reduced to that; None where they do not."""
    if not np.fmax.reduce(angle) - np.fmin.reduce(angle) > 90:
        return None
    seen = np.flatnonzero(np.isfinite(angle))
    degrees = np.radians(angle[seen])
    step = np.diff(degrees)
    period, reduced = _period(degrees, step)
    if not reduced:
        return None
    row = int(seen[np.argmax(np.abs(step) > 0.5 * period) + 1])
    return row, round(math.degrees(period))


def turning_rate(t: Floats, phi: Floats) -> float:
    """The fastest turning in rad/s over some tenth of the rows, which evens out the noise."""
    seen = np.isfinite(phi)
    if not seen.all():
        t, phi = t[seen], phi[seen]
    some = slice(None, None, max(1, len(t) // 10))
    turned, dt = phi[some], t[some]
    return float(np.abs((turned[1:] - turned[:-1]) / (dt[1:] - dt[:-1])).max(initial=0.0))


def most_of(omega: Floats) -> float:
    """A spin in rad/s that hardly any row exceeds."""
    return float(np.nanquantile(np.abs(omega), 0.9))


def _period(angle: Floats, step: Floats) -> tuple[float, bool]:
    """The period an angle was reduced by, and whether it looks reduced at all."""
    span = float(np.ptp(angle))
    for period in (_TURN / 2, _TURN):
        large = np.abs(step) > 0.5 * period
        if not large.any() or not 0.7 * period < span <= 1.02 * period:
            continue
        if not ((step > 0).any() and (step < 0).any()):
            continue  # it only grows or only falls
        if period < _TURN:
            typical = float(np.median(np.abs(step)))
            if (np.abs(np.abs(step[large]) - period) > 0.15 * period + typical).any():
                continue
        return period, True
    return _TURN, False


def _expected(t: Floats, omega: Floats | None, time: Floats) -> Floats | None:
    """Turn between the times, from the spin; None where it is not known throughout."""
    if omega is None:
        return None
    known = np.isfinite(omega)
    if known.sum() < 2 or t[known][0] > time[0] + 1e-9 or t[known][-1] < time[-1] - 1e-9:
        return None
    at, rate = t[known], omega[known]
    turned = np.concatenate([[0.0], np.cumsum(np.diff(at) * (rate[1:] + rate[:-1]) / 2)])
    return np.diff(np.interp(time, at, turned))


def _by_pace(time: Floats, step: Floats, dt: Floats, period: float, seen: np.ndarray) -> Floats:
    near = step - period * np.round(step / period)
    usual = dt <= 1.5 * np.median(dt)
    fast = usual & (np.abs(near) > 0.4 * period)
    if fast.any():
        raise AmbiguousTurnError(int(seen[np.argmax(fast) + 1]))
    if usual.all():
        return near
    width = min(9, int(usual.sum()))
    rates = np.convolve(np.pad(near[usual] / dt[usual], width // 2, "edge"), np.ones(width), "same")
    weight = np.convolve(np.ones(len(rates)), np.ones(width), "same")
    inner = slice(width // 2, width // 2 + int(usual.sum()))
    middle = (time[1:] + time[:-1]) / 2
    expected = np.interp(middle, middle[usual], (rates / weight)[inner]) * dt
    far = ~usual & (np.abs(expected) * 0.25 > 0.4 * period)
    if far.any():
        raise AmbiguousTurnError(int(seen[np.argmax(far) + 1]))
    bridged = step - period * np.round((step - expected) / period)
    return np.where(usual, near, bridged)


def _without_jumps(step: Floats, dt: Floats) -> Floats:
    """An angle that counts on: single steps that are a whole turn off."""
    if len(step) < 5:
        return step
    rate = step / dt
    if np.abs(step).max() + np.abs(rate).max() * dt.max() < 0.85 * _TURN:
        return step  # none can be off by as much as a jump
    padded = np.pad(rate, 2, "edge")
    pace = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    off = step - pace * dt
    turns = np.round(off / _TURN)
    odd = np.abs(off) > 0.1 * _TURN
    clear = (turns != 0) & (np.abs(off - turns * _TURN) < 0.15 * _TURN)
    if odd.sum() > 0.2 * len(step) or not clear.any():
        return step
    return np.where(clear, step - turns * _TURN, step)
