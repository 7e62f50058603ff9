"""Angles without their jumps: which whole turns belong to each row.

An angle is parted where a step is not what its neighbours turn, at gaps, and where a
value stands still. Of the pieces, those are taken for the course of the angle that
follow from one another, but for whole turns, and hold the most rows: the longest chain.
A piece outside it, such as a mark that was lost for some rows, moves no other row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.channels import running_median, slope

TURN = 2 * np.pi
_SMALLEST_JUMP = 0.25 * (TURN / 2)
"""rad; an angle without such a step between two rows is not wrapped."""
_PACE_ROWS = 9
"""Steps whose median is the pace of the turning between two rows."""
_PACE_TIME = 1.0
"""s, at an end of a piece, whose rows tell the pace there by a straight line."""
_LEAST_TIME = 0.3
"""s; a shorter piece tells no pace."""
_FEWEST_OF_PACE = 3
"""Rows; a piece of fewer tells no pace."""
_SCATTERS = 5.0
"""Robust standard deviations of the steps that a step may be off."""
_LEAST_OFF = 0.05
"""Of a period: the least of that tolerance."""
_MOST_OFF = 0.25
"""Of a period: the most of that tolerance."""
_PACE_ERROR = 0.25
"""Relative error of a rotation that only the pace on both sides of a gap tells."""
_AMBIGUOUS = 0.4
"""Of a period: beyond it a rotation may as well be one to the other side."""
_LEAST_SPAN = 0.7
"""Of a period: the least extent of the values of a wrapped angle."""
_MOST_SPAN = 1.02
"""Of a period: the largest extent of these values."""
_JUMP_ERROR = 0.15
"""Of half a turn, beside a usual step: how far a jump by it may be from it."""
_UNEXPLAINED = 0.25
"""Of a period: the median of the steps that a spin may leave unexplained."""
_MOST_OFF_COURSE = 0.2
"""Of the rows, that may be off the course."""
_FEWEST = 6
"""Angles, of which whole turns are taken out where they exceed one turn."""
_ABOUT = 3
"""Rows before and after a fault that stand for themselves."""
_STANDING = 2
"""Rows that repeat the angle before them exactly, from which on it stands still."""
_GAP = 1.5
"""Of the median step of time, above which a step is a gap."""
_PIECES_BEFORE = 200
"""Pieces, up to the one before, from which a piece may follow."""


class AmbiguousTurnError(Exception):
    """About half a period from the row before, of ambiguous sense."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


class ContradictoryAnglesError(Exception):
    """Many of the measured angles contradict the others, the first in this row."""

    def __init__(self, row: int, rows: int, measured: int) -> None:
        super().__init__(row, rows, measured)
        self.row = row
        self.rows = rows
        self.measured = measured


class Unwrapped(NamedTuple):
    """An angle without its jumps.

    Attributes
    ----------
    angle : rad, shape (n,), NaN where not measured.
    jumps : how many whole periods were removed. period : their size, rad.
    off_course : rows that contradict those before and after them, shape (n,).
    """

    angle: Floats
    jumps: int
    period: float
    off_course: Booleans


class _Course(NamedTuple):
    """The longest chain of pieces.

    Attributes
    ----------
    angle : rad, with whole periods added, shape (rows,).
    on_course : whether a row is in the chain, shape (rows,).
    rotation : from each row to the next as its neighbours turn, rad, shape (rows - 1,).
    links : those of the chain, in the order of time.
    """

    angle: Floats
    on_course: Booleans
    rotation: Floats
    links: list[_Link]


class _Piece(NamedTuple):
    """Rows whose angles follow from one another: the first, the last, and the pace at
    both in rad/s, NaN where they are too few."""

    first: int
    last: int
    first_pace: float
    last_pace: float


class _Link(NamedTuple):
    """Over the gap before a piece, in rad: the rotation as both sides turn, and the
    whole periods by which the angle jumps besides."""

    piece: _Piece
    rotation: float
    jump: float


def unwrap(t: Floats, phi: Floats, omega: Floats | None = None) -> Unwrapped:
    """The angle without its jumps.

    An angle that stays within one turn (or half a turn, the direction of a line) and
    jumps against its trend was reduced modulo that period. A measured spin determines
    the rotation between two rows; without one, the rotation from row to row must be
    well below half a period, and gaps are bridged at the pace on both sides. In an
    angle that exceeds one turn, jumps by whole turns are removed. Rows that contradict
    those before and after them move no other row, and keep their values, but for whole
    periods in a wrapped angle.

    Parameters
    ----------
    t : times in s, increasing. phi : angle in rad, NaN where not measured.
    omega : spin in rad/s with the same sign convention, NaN where not measured.

    Raises
    ------
    AmbiguousTurnError : the angle is wrapped, and the stone turns too fast for the
        rows.
    ContradictoryAnglesError : the angle stays within one turn, as a wrapped one does,
        and more than one row in five contradicts the others.
    """
    measured = np.flatnonzero(np.isfinite(phi))
    unchanged = Unwrapped(phi, 0, TURN, np.zeros(len(phi), bool))
    time = t[measured]
    angle = phi[measured]
    if len(measured) < 3 or np.abs(np.diff(angle)).max() < _SMALLEST_JUMP:
        return unchanged
    period, wrapped = period_of(time, angle)
    if not wrapped and len(measured) < _FEWEST:
        return unchanged
    turned = None if omega is None else _integrated_spin(t, omega, time)
    if turned is not None:
        unexplained = np.diff(angle - turned)
        unexplained -= period * np.round(unexplained / period)
        if np.median(np.abs(unexplained)) > _UNEXPLAINED * period:
            turned = None  # the spin has another sign or clock
    course = _course(time, angle, period, wrapped, turned)
    lost = ~course.on_course
    if lost.mean() > _MOST_OFF_COURSE:
        within_one_turn = wrapped or np.ptp(angle) <= _MOST_SPAN * TURN
        if not within_one_turn:
            return unchanged
        row = int(measured[np.argmax(lost)])
        raise ContradictoryAnglesError(row, int(lost.sum()), len(measured))
    if wrapped and turned is None:
        _require_slow(course, time, measured, period)
    periods = np.round((course.angle - angle) / period)
    unwrapped = phi.copy()
    unwrapped[measured] = np.where(periods == 0, angle, angle + period * periods)
    off_course = np.zeros(len(phi), bool)
    off_course[measured[lost]] = True
    jumps = int(np.count_nonzero(np.diff(periods[course.on_course])))
    return Unwrapped(unwrapped, jumps, period, off_course)


def period_of(time: Floats, angle: Floats) -> tuple[float, bool]:
    """The period of an angle in rad, and whether it is wrapped: the values on its
    course stay within one period, and jump by it against their trend."""
    for period in (TURN / 2, TURN):
        if np.abs(np.diff(angle)).max() < 0.5 * period:
            continue
        on_course = _course(time, angle, period, wrapped=True).on_course
        values = angle[on_course]
        step = np.diff(values)
        large = np.abs(step) > 0.5 * period
        span = np.ptp(values)
        if not large.any() or not _LEAST_SPAN * period < span <= _MOST_SPAN * period:
            continue
        is_monotonic = not ((step > 0).any() and (step < 0).any())
        if is_monotonic:
            continue
        if period < TURN:
            # An angle may jump by half a turn for other reasons: all jumps must be of
            # this size, but for those over a gap, where the stone turns besides.
            jumps = np.abs(step[large & _usual(np.diff(time[on_course]))])
            allowed = _JUMP_ERROR * period + np.median(np.abs(step))
            if not len(jumps) or (np.abs(jumps - period) > allowed).any():
                continue
        return period, True
    return TURN, False


def _integrated_spin(t: Floats, omega: Floats, time: Floats) -> Floats | None:
    """Rotation up to the times, from the spin; None if it is not known throughout."""
    measured = np.isfinite(omega)
    if measured.sum() < 2:
        return None
    t = t[measured]
    omega = omega[measured]
    if t[0] > time[0] + 1e-9 or t[-1] < time[-1] - 1e-9:
        return None
    steps = np.diff(t) * (omega[1:] + omega[:-1]) / 2
    return np.interp(time, t, np.append(0.0, np.cumsum(steps)))


def _usual(dt: Floats) -> Booleans:
    """Which steps of time are no gaps."""
    return dt <= _GAP * np.median(dt)


def _require_slow(
    course: _Course, time: Floats, measured: np.ndarray, period: float
) -> None:
    """Raise `AmbiguousTurnError` where the stone turns too far from row to row."""
    fast = np.abs(course.rotation) > _AMBIGUOUS * period
    fast &= _usual(np.diff(time))
    if fast.any():
        raise AmbiguousTurnError(int(measured[np.argmax(fast) + 1]))
    for link in course.links:
        if _PACE_ERROR * abs(link.rotation) > _AMBIGUOUS * period:
            raise AmbiguousTurnError(int(measured[link.piece.first]))


def _course(
    time: Floats,
    angle: Floats,
    period: float,
    wrapped: bool,
    turned: Floats | None = None,
) -> _Course:
    """The course of an angle.

    Parameters
    ----------
    turned : rotation up to each row in rad, as the spin tells; None if it does not.
    """
    dt = np.diff(time)
    step = np.diff(angle)
    usual = _usual(dt)
    nearest = step - period * np.round(step / period) if wrapped else step
    uneven = np.abs(np.diff(nearest)).max(initial=0.0)
    if wrapped and turned is None and usual.all() and uneven < _LEAST_OFF * period:
        # the usual angle, without a fault: no need for pieces
        unwrapped = angle[0] + np.append(0.0, np.cumsum(nearest))
        return _Course(unwrapped, np.ones(len(angle), bool), nearest, [])
    # How the stone turns over each step: as its neighbours do, or as the spin tells.
    middle = (time[1:] + time[:-1]) / 2
    paces = (nearest / dt)[usual]
    odd_width = min(_PACE_ROWS, len(paces) // 3) // 2 * 2 + 1
    pace = np.interp(middle, middle[usual], running_median(paces, odd_width))
    rotation = pace * dt if turned is None else np.diff(turned)
    # A stone that is held, or has come to rest, turns less than its neighbours do.
    slow = np.abs(rotation) <= _AMBIGUOUS * period
    jump, off = _beyond(step, np.where(slow, 0.0, rotation), rotation, period)
    scatter = 1.4826 * float(np.median(np.abs(step - jump - rotation)[usual]))
    tolerance = float(
        np.clip(_SCATTERS * scatter, _LEAST_OFF * period, _MOST_OFF * period)
    )
    # The angle is parted at gaps, jumps, where it begins or ceases to stand still, and
    # about each fault, of whose rows any may be the bad one.
    faults = np.pad(usual & (off > tolerance), _ABOUT)
    windows = np.lib.stride_tricks.sliding_window_view(faults, 2 * _ABOUT + 1)
    parted = ~usual | windows.any(axis=1) | (jump != 0.0)
    parted |= _begins_or_ends_standing(step)
    pieces = _pieces(time, angle, parted)
    unknown_turns = not wrapped and turned is None
    chain = _longest_chain(
        pieces, time, angle, pace, turned, period, tolerance, unknown_turns
    )
    course = np.full(len(angle), np.nan)
    shift = 0.0
    for link in chain:
        rows = slice(link.piece.first, link.piece.last + 1)
        shift -= link.jump
        course[rows] = angle[rows] + shift
    on_course = np.isfinite(course)
    in_chain = np.flatnonzero(on_course)
    if wrapped:
        # A row beside the chain is the nearest to the course by whole periods.
        expected = np.interp(time, time[in_chain], course[in_chain])
        beside = angle + period * np.round((expected - angle) / period)
    else:
        # A row beside the chain is shifted as the row of the chain before it or after
        # it, whichever is shifted less.
        shifts = (course - angle)[in_chain]
        following = np.searchsorted(in_chain, np.arange(len(angle)))
        later = shifts[np.minimum(following, len(in_chain) - 1)]
        earlier = shifts[np.maximum(following - 1, 0)]
        beside = angle + np.where(np.abs(earlier) < np.abs(later), earlier, later)
    return _Course(np.where(on_course, course, beside), on_course, rotation, chain[1:])


def _beyond(
    step: Floats, rotation: Floats, other_rotation: Floats, period: float
) -> tuple[Floats, Floats]:
    """The whole periods in steps of an angle, and how far the rest of each step is
    outside the range between two rotations; all in rad."""
    middle = (rotation + other_rotation) / 2
    jump = period * np.round((step - middle) / period)
    off = np.abs(step - jump - middle) - np.abs(other_rotation - rotation) / 2
    return jump, off


def _begins_or_ends_standing(step: Floats) -> Booleans:
    """Steps at which an angle begins or ceases to repeat one value exactly, as that of
    a mark that was lost. Shape (rows - 1,)."""
    same = np.concatenate([[False], step == 0.0, [False]]).astype(int)
    change = np.diff(same)
    begin = np.flatnonzero(change == 1)
    end = np.flatnonzero(change == -1)
    long = end - begin >= _STANDING
    begins_or_ends = np.zeros(len(step) + 1, bool)
    begins_or_ends[begin[long]] = True
    begins_or_ends[end[long]] = True
    return begins_or_ends[:-1]  # the last step has no end


def _pieces(time: Floats, angle: Floats, parted: Booleans) -> list[_Piece]:
    """The pieces of an angle that is parted at some of its steps."""
    firsts = np.append(0, np.flatnonzero(parted) + 1)
    lasts = np.append(firsts[1:], len(angle)) - 1
    pieces = []
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        begin = int(np.searchsorted(time, time[first] + _PACE_TIME))
        end = int(np.searchsorted(time, time[last] - _PACE_TIME))
        head = slice(first, min(max(begin, first + _FEWEST_OF_PACE), last + 1))
        tail = slice(max(min(end, last + 1 - _FEWEST_OF_PACE), first), last + 1)
        first_pace = _pace(time[head], angle[head])
        last_pace = _pace(time[tail], angle[tail])
        pieces.append(_Piece(first, last, first_pace, last_pace))
    return pieces


def _pace(time: Floats, angle: Floats) -> float:
    """How fast an angle turns in some rows, in rad/s; NaN for too few rows, unless they
    stand still."""
    if len(time) > 1 and np.ptp(angle) == 0:
        return 0.0
    if len(time) < _FEWEST_OF_PACE or np.ptp(time) < _LEAST_TIME:
        return np.nan
    return slope(time, angle)


def _longest_chain(
    pieces: Sequence[_Piece],
    time: Floats,
    angle: Floats,
    pace: Floats,
    turned: Floats | None,
    period: float,
    tolerance: float,
    unknown_turns: bool,
) -> list[_Link]:
    """The pieces that follow from one another, but for whole periods, and have the most
    rows in all.

    Parameters
    ----------
    unknown_turns : whether a gap too long for the pace to tell its turns has those of
        the file.
    """
    first = np.array([piece.first for piece in pieces])
    last = np.array([piece.last for piece in pieces])
    first_pace = np.array([piece.first_pace for piece in pieces])
    last_pace = np.array([piece.last_pace for piece in pieces])
    # Of each piece the rows of the longest chain up to it, and the piece before it in
    # this chain; -1 for the first of a chain.
    length = last - first + 1
    behind = np.full(len(pieces), -1)
    links = [_Link(pieces[0], 0.0, 0.0)]
    for k in range(1, len(pieces)):
        before = slice(max(0, k - _PIECES_BEFORE), k)
        row = first[k]
        if turned is not None:
            going_on = turned[row] - turned[last[before]]
            as_after = going_on
        else:
            # The stone goes on as before the gap, or turns as it will after it. Where
            # one of the paces is not known, it is the other, or that of the rows about.
            gap = time[row] - time[last[before]]
            paces = last_pace[before]
            paces = np.where(np.isnan(paces), first_pace[k], paces)
            paces = np.where(np.isnan(paces), pace[row - 1], paces)
            going_on = gap * paces
            as_after = going_on
            if not np.isnan(first_pace[k]):
                as_after = gap * first_pace[k]
        rotation = (going_on + as_after) / 2
        step = angle[row] - angle[last[before]]
        jump, off = _beyond(step, going_on, as_after, period)
        error = _PACE_ERROR * np.abs(rotation)
        follows = off <= np.minimum(tolerance + error, _AMBIGUOUS * period)
        if unknown_turns:
            unknown = error > _MOST_OFF * period
            jump[unknown] = 0.0
            follows |= unknown
        links.append(_Link(pieces[k], 0.0, 0.0))
        if follows.any():
            lengths = np.where(follows, length[before], 0)
            # of equal ones the last, which is the nearest
            best = len(lengths) - 1 - int(np.argmax(lengths[::-1]))
            behind[k] = before.start + best
            length[k] += length[before][best]
            links[k] = _Link(pieces[k], float(rotation[best]), float(jump[best]))
    k = int(np.argmax(length))
    chain = [links[k]]
    while behind[k] >= 0:
        k = int(behind[k])
        chain.append(links[k])
    return chain[::-1]
