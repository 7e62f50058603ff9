"""Conventions of axes and angles: directions of x and y, zero of y, sense, unwrapping."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LINES

_TURN = 2 * math.pi
MAX_SPIN = 2 * _TURN
"""rad/s; a thrown stone makes two to four turns, at about 1 rad/s or 60 degrees/s."""
WORDS = (
    *(f"{axis}-{way}" for axis in "yx" for way in ("along", "back", "right", "left")),
    "clockwise", "counter-clockwise", *(f"from-{line}" for line in LINES),
)  # fmt: skip
"""Where axes point, seen along the throw; how angles count, seen from above; where zero lies."""
_SYNONYMS = {
    "counterclockwise": "counter-clockwise", "ccw": "counter-clockwise", "cw": "clockwise",
    "from-center": "from-centre",
}  # fmt: skip
_TWICE = {
    "x": "x points in two directions", "y": "y points in two directions",
    "from": "two zeros are given", "turn": "angles are both clockwise and counter-clockwise",
}  # fmt: skip
# Direction of a word in (right, along).
_DIRECTIONS = {"right": (1, 0), "left": (-1, 0), "along": (0, 1), "back": (0, -1)}


class AxisConvention(NamedTuple):
    """Directions of the axes of a file, and its zero.

    Attributes
    ----------
    x, y : where the file's axes point, as (right, along) with one component 1 or -1.
    turn : 1 where the file's angles are counter-clockwise seen from above, -1 where clockwise.
    zero : distance along the sheet from the hack to the file's zero in m.
    """

    x: tuple[int, int] = (1, 0)
    y: tuple[int, int] = (0, 1)
    turn: int = 1
    zero: float = 0.0

    @property
    def handedness(self) -> int:
        """1 where y lies to the left of x (seen from above), -1 where the axes are mirrored."""
        return self.x[0] * self.y[1] - self.x[1] * self.y[0]

    @property
    def swapped(self) -> bool:
        """Whether the file's x runs along the sheet."""
        return self.x[0] == 0

    @property
    def words(self) -> str:
        """The fewest words that `parse_axes` reads as this convention; empty for curlfit's own."""
        names = {direction: word for word, direction in _DIRECTIONS.items()}
        turn = "counter-clockwise" if self.turn > 0 else "clockwise"
        line = next((name for name, y in LINES.items() if y == self.zero), "hack")
        words = [f"x-{names[self.x]}", f"y-{names[self.y]}", turn, f"from-{line}"]
        for word in reversed(list(words)):
            fewer = [other for other in words if other != word]
            if parse_axes(",".join(fewer)) == self:
                words = fewer
        return ",".join(words)

    def to_sheet(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Position with x to the right and y along the throw."""
        right = self.x[0] * x if not self.swapped else self.y[0] * y
        along = self.y[1] * y if not self.swapped else self.x[1] * x
        return right + 0.0, along + self.zero

    @property
    def matrix(self) -> Floats:
        """`to_sheet` as a matrix that acts on (x, y, 1)."""
        (a, b), (c, d) = self.x, self.y
        return np.array([[a, c, 0.0], [b, d, self.zero], [0.0, 0.0, 1.0]])


def corrected(text: str, across: int, along: int, turn: int, *, exchanged: bool = False) -> str:
    """Corrected words for axes that `text` describes wrongly.

    Parameters
    ----------
    across, along, turn : -1 where the direction to the right, that along the sheet, or the sense of
        the angles is opposite to that assumed. exchanged : whether right and along are exchanged
        (before the signs apply).
    """
    now = parse_axes(text)

    def moved(direction: tuple[int, int]) -> tuple[int, int]:
        right, forward = direction[::-1] if exchanged else direction
        return across * right, along * forward

    return now._replace(x=moved(now.x), y=moved(now.y), turn=turn * now.turn).words


def parse_axes(text: str | None) -> AxisConvention:
    """An axis convention from words separated by commas or spaces, such as `x-along,clockwise`.

    Whatever no word sets is as in curlfit: `x-left` alone mirrors the axes. If one axis is rotated
    by 90 degrees, the other follows (y lies to the left of x, seen from above) unless a word sets
    it. Angles count from the file's +x toward its +y, so that they are clockwise in mirrored axes,
    unless `clockwise` or `counter-clockwise` sets their sense seen from above.

    Raises
    ------
    InputError : an unknown word, or words that contradict one another.
    """
    found: dict[str, str] = {}
    for given in (text or "").replace(",", " ").lower().replace("_", "-").split():
        word = _SYNONYMS.get(given, given)
        if word not in WORDS:
            raise InputError(
                f"axes {quoted(given)}: unknown word; expected some of {', '.join(WORDS)}"
            )
        name = word.partition("-")[0]
        aspect = name if name in _TWICE else "turn"
        if found.setdefault(aspect, word) != word:
            raise InputError(f"axes {quoted(text)}: {_TWICE[aspect]}")
    x, y = (_DIRECTIONS[found[name][2:]] if name in found else None for name in "xy")
    if x is None:
        x = (1, 0) if y is None or y[0] == 0 else (y[1], -y[0])
    if y is None:
        y = (0, 1) if x[1] == 0 else (-x[1], x[0])
    convention = AxisConvention(x, y, 1, LINES[found.get("from", "from-hack")[5:]])
    if convention.handedness == 0:
        raise InputError(
            f"axes {quoted(text)}: x and y lie on one line; one runs along the sheet (along, "
            "back), the other across it (right, left)"
        )
    senses = {"": convention.handedness, "clockwise": -1, "counter-clockwise": 1}
    return convention._replace(turn=senses[found.get("turn", "")])


class AmbiguousTurnError(Exception):
    """About half a period between two rows, of ambiguous sense. `row` is the later one."""

    def __init__(self, row: int) -> None:
        super().__init__(row)
        self.row = row


def unwrap(t: Floats, phi: Floats, omega: Floats | None = None) -> tuple[Floats, int, float]:
    """The angle without its jumps, and their number and size.

    An angle that stays within one turn (or half a turn, the direction of a line) and jumps against
    its trend was reduced modulo that period. A measured spin determines the rotation between two
    rows; without one, the rotation from row to row must be well below half a period, and gaps are
    bridged at the neighbouring rate. In an angle that exceeds one turn, single jumps by whole turns
    are removed.

    Parameters
    ----------
    t : times in s, increasing. phi : angle in rad, NaN where not measured.
    omega : spin in rad/s with the same sign convention, NaN where not measured.

    Raises
    ------
    AmbiguousTurnError : the stone turns too fast for the rows.
    """
    finite = np.flatnonzero(np.isfinite(phi) & np.isfinite(t))
    if len(finite) < 3:
        return phi, 0, _TURN
    time, angle = t[finite], phi[finite]
    step, dt = np.diff(angle), np.diff(time)
    if (dt <= 0).any():
        return phi, 0, _TURN
    expected = None if omega is None else _integrated_spin(t, omega, time)
    period, wrapped = _period(angle, step)
    if expected is not None:
        true = step - period * np.round((step - expected) / period)
        if np.median(np.abs(true - expected)) > 0.25 * period:
            expected = None  # the spin has another sign or clock
    if expected is None:
        if wrapped:
            true = _unwrap_by_rate(time, step, dt, period, finite)
        else:
            period, true = _TURN, _remove_jumps(step, dt)
    jumps = int((np.abs(true - step) > period / 2).sum())
    if not jumps:
        return phi, 0, period
    result = phi.copy()
    result[finite] = angle[0] + np.concatenate([[0.0], np.cumsum(true)])
    return result, jumps, period


def jump_in_degrees(angle: Floats) -> tuple[int, int] | None:
    """Row and size (360 or 180) of the first jump of an apparently wrapped angle in degrees.

    None if the values do not look like one.
    """
    if not np.fmax.reduce(angle) - np.fmin.reduce(angle) > 90:
        return None
    finite = np.flatnonzero(np.isfinite(angle))
    degrees = np.radians(angle[finite])
    step = np.diff(degrees)
    period, reduced = _period(degrees, step)
    if not reduced:
        return None
    row = int(finite[np.argmax(np.abs(step) > 0.5 * period) + 1])
    return row, round(math.degrees(period))


def turning_rate(t: Floats, phi: Floats) -> float:
    """Largest turning rate in rad/s over a tenth of the rows, which averages out the noise."""
    finite = np.isfinite(phi)
    if not finite.all():
        t, phi = t[finite], phi[finite]
    some = slice(None, None, max(1, len(t) // 10))
    turned, dt = phi[some], t[some]
    return float(np.abs((turned[1:] - turned[:-1]) / (dt[1:] - dt[:-1])).max(initial=0.0))


def spin_quantile(omega: Floats) -> float:
    """90 % quantile of the absolute spin, rad/s."""
    return float(np.nanquantile(np.abs(omega), 0.9))


def _period(angle: Floats, step: Floats) -> tuple[float, bool]:
    """The period of an angle, and whether it is wrapped."""
    span = float(np.ptp(angle))
    for period in (_TURN / 2, _TURN):
        large = np.abs(step) > 0.5 * period
        if not large.any() or not 0.7 * period < span <= 1.02 * period:
            continue
        if not ((step > 0).any() and (step < 0).any()):
            continue  # monotonic
        if period < _TURN:
            typical = float(np.median(np.abs(step)))
            if (np.abs(np.abs(step[large]) - period) > 0.15 * period + typical).any():
                continue
        return period, True
    return _TURN, False


def _integrated_spin(t: Floats, omega: Floats, time: Floats) -> Floats | None:
    """Rotation between the times, from the spin; None if it is not known throughout."""
    known = np.isfinite(omega)
    if known.sum() < 2 or t[known][0] > time[0] + 1e-9 or t[known][-1] < time[-1] - 1e-9:
        return None
    at, rate = t[known], omega[known]
    turned = np.concatenate([[0.0], np.cumsum(np.diff(at) * (rate[1:] + rate[:-1]) / 2)])
    return np.diff(np.interp(time, at, turned))


def _unwrap_by_rate(
    time: Floats, step: Floats, dt: Floats, period: float, finite: np.ndarray
) -> Floats:
    near = step - period * np.round(step / period)
    usual = dt <= 1.5 * np.median(dt)
    fast = usual & (np.abs(near) > 0.4 * period)
    if fast.any():
        raise AmbiguousTurnError(int(finite[np.argmax(fast) + 1]))
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
        raise AmbiguousTurnError(int(finite[np.argmax(far) + 1]))
    bridged = step - period * np.round((step - expected) / period)
    return np.where(usual, near, bridged)


def _remove_jumps(step: Floats, dt: Floats) -> Floats:
    """Steps of an unwrapped angle, with single ones corrected that are off by whole turns."""
    if len(step) < 5:
        return step
    rate = step / dt
    padded = np.pad(rate, 2, "edge")
    pace = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    off = step - pace * dt
    turns = np.round(off / _TURN)
    odd = np.abs(off) > 0.1 * _TURN
    clear = (turns != 0) & (np.abs(off - turns * _TURN) < 0.15 * _TURN)
    if odd.sum() > 0.2 * len(step) or not clear.any():
        return step
    return np.where(clear, step - turns * _TURN, step)
