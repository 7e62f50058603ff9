"""Answers of curling-stone-tracker: the stones in a video of a sheet, ten times a
second.

The format is that of github.com/abranch6364/curling-stone-tracker (`dict_for_json` in
util/curling_shot_tracker.py of the backend, commit 03b35e4 and later): {"state":
{"stones": [...]}, "mosaic_detections", "mosaic_detection_times"}, or the state alone.
Each of the stones has a `color`, `time_history` in s of the video and
`position_history` in feet from the centre of the sheet, y along it. `velocity_history`
and `acceleration_history` are what the tracker's filter makes of the positions.

The tracker begins a new stone where one comes back into sight, so that a throw seen by
cameras above the two ends has two entries. After a stone was last seen its filter goes
on for a second: these rows have the acceleration of the row before, to the last bit.
The first row may be written twice, and may have a height as its third number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import counted, cut, is_number, quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.sheet import FOOT
from curlfit.throws.readers.columns import Column
from curlfit.throws.readers.format import Contents, Format
from curlfit.throws.readers.json_values import MOST_NUMBERS, does_not_move, value_in
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.text import TextFile

_NAME = "curling-stone-tracker"
_EXPECTED = (
    "expected an answer of curling-stone-tracker: a state with stones, each with "
    "color, time_history and position_history"
)
_KEYS = (
    '"mosaic_detections"',
    '"mosaic_detection_times"',
    '"position_history"',
    '"velocity_history"',
    '"acceleration_history"',
)
"""Of which one is among the first lines, however the file is laid out."""
_COMPUTED = ("velocity_history", "acceleration_history", "position_covariance_history")
_HEAD = 200  # lines whose comments are settings
_MOST_ENTRIES = 500
_MOVED = 1.0  # ft; about the width of a stone
_FEW_ROWS = 5  # half a second; the tracker drops stones with fewer
_ROWS_OF_VELOCITY = 10  # a second of the tracker
_WAY_OFF = 0.2
"""How far a stone in sight again may be from where a constant deceleration brings it,
as a part of the way; and in ft `_MOVED` besides. Of 310 simulated throws in videos of
one to three, of one colour and through the tracker's filter, all are joined at noise of
up to 0.1 ft, where they miss by at most 0.11 of the way, and 307 at 0.25 ft; no two
throws are."""
_FASTER = 1.0  # ft/s by which it may seem faster than before, from noise alone


@dataclass(frozen=True, eq=False)
class _Piece:
    """A stone from where it came into sight to where it was lost: an entry of the file.

    Attributes
    ----------
    t : s, shape (n,). positions : ft from the centre of the sheet, shape (n, 2).
    extrapolated : number of rows after these that the tracker has made.
    computed : keys of what it computes from the positions.
    """

    color: str
    t: Floats
    positions: Floats
    extrapolated: int
    computed: list[str]

    @cached_property
    def first_velocity(self) -> Floats:
        """Velocity over the first second, ft/s."""
        rows = slice(0, _ROWS_OF_VELOCITY)
        return _slope(self.t[rows], self.positions[rows])

    @cached_property
    def last_velocity(self) -> Floats:
        """Velocity over the last second, ft/s."""
        rows = slice(-_ROWS_OF_VELOCITY, None)
        return _slope(self.t[rows], self.positions[rows])


class _Stone(NamedTuple):
    """The pieces of one stone, in the order of time."""

    pieces: list[_Piece]

    @property
    def color(self) -> str:
        return self.pieces[0].color

    @property
    def t(self) -> Floats:
        return np.concatenate([piece.t for piece in self.pieces])

    @property
    def positions(self) -> Floats:
        return np.concatenate([piece.positions for piece in self.pieces])

    @property
    def way(self) -> Floats:
        """From its first place to its last one, ft."""
        return self.positions[-1] - self.positions[0]

    @property
    def moves(self) -> bool:
        """Whether medians of its first and last places are apart, which the noise of a
        single one does not change."""
        positions = self.positions
        few = max(1, min(_FEW_ROWS, len(positions) // 2))
        first = np.median(positions[:few], axis=0)
        last = np.median(positions[-few:], axis=0)
        return math.hypot(*(last - first)) > _MOVED

    @property
    def begins_to_move(self) -> float:
        """When it is first away from where it was, s; infinite for one at rest."""
        if not self.moves:
            return math.inf
        first = np.median(self.positions[:_FEW_ROWS], axis=0)
        away = np.hypot(*(self.positions - first).T)
        return float(self.t[np.argmax(away > _MOVED)])

    @property
    def name(self) -> str:
        """Colour and way, as in lists of the stones."""
        if not self.moves:
            return f"{self.color} at rest, {counted(len(self.t), 'row')}"
        metres = FOOT * math.hypot(*self.way)
        return f"{self.color}, {metres:.1f} m in t = {self.t[0]:g} .. {self.t[-1]:g} s"


def _recognizes(head: list[str]) -> bool:
    begins = head[0].lstrip()[:1] == "{"
    return begins and any(key in line for line in head for key in _KEYS)


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The stones of a video in the order in which they begin to move, those at rest
    after them; the usual one is the first.

    Raises
    ------
    DataError : the file is no answer of the tracker, or an entry cannot be read.
    """
    stones = _joined(_pieces(file))
    stones.sort(key=lambda stone: stone.begins_to_move)
    moving = [k for k, stone in enumerate(stones) if stone.moves]
    if not moving:
        at_rest = "; ".join(stone.name for stone in stones)
        raise file.error(f"no stone moves: {at_rest}")
    return Contents(
        [stone.name for stone in stones],
        lambda index: _read_stone(file, stones, index, reading),
        moving,
    )


CURLING_STONE_TRACKER = Format(
    name=_NAME,
    recognizes=_recognizes,
    contents=_contents,
    what="stone",
    selected_by="stone_index",
    usual=0,
    selections=("stone_index",),
)


def _read_stone(
    file: TextFile, stones: Sequence[_Stone], index: int, reading: Reading
) -> ParsedFile:
    stone = stones[index]
    names = [other.name for other in stones]
    moving = {k: names[k] for k, other in enumerate(stones) if other.moves}
    if index not in moving:
        raise file.error(does_not_move(index, stone.name, moving))
    parsed = ParsedFile.begin(file, _NAME, _HEAD)
    parsed.notes += _notes(stone, index, names, others_move=len(moving) > 1)
    if reading.axes is None and "axes" not in parsed.settings:
        forward = stone.way[1] >= 0
        parsed.settings["axes"] = (
            "from-centre" if forward else "y-back,x-left,from-centre"
        )
        counts = Finding.note("feet-from-the-centre", toward="+y" if forward else "-y")
        parsed.notes.append(counts)
    x, y = stone.positions.T
    parsed.add("time_history", Column("t", "s", 1.0), stone.t)
    parsed.add("position_history.x", Column("x", "ft", FOOT), x)
    parsed.add("position_history.y", Column("y", "ft", FOOT), y)
    return parsed


def _notes(
    stone: _Stone, index: int, names: Sequence[str], others_move: bool
) -> list[Finding]:
    """What of the file is the throw, and what is not."""
    remedies = []
    if others_move:
        remedies.append(Remedy("selects-another", Option("stone-index", "N")))
    listed = [{"number": number, "name": name} for number, name in enumerate(names, 1)]
    tracked = Finding.note(
        "tracked-stones", *remedies, count=len(names), stones=listed, taken=index + 1
    )
    notes = [tracked]
    pieces = stone.pieces
    if len(pieces) > 1:
        gaps = [
            {"since": float(earlier.t[-1]), "until": float(later.t[0])}
            for earlier, later in pairwise(pieces)
        ]
        joined = Finding.note("pieces-joined", count=len(pieces), gaps=gaps)
        notes.append(joined)
    extrapolated = sum(piece.extrapolated for piece in pieces)
    if extrapolated:
        notes.append(Finding.note("extrapolated-by-the-tracker", count=extrapolated))
    if pieces[0].computed:
        left_out = Finding.note("histories-not-used", histories=pieces[0].computed)
        notes.append(left_out)
    return notes


# Pieces to stones


def _joined(pieces: Sequence[_Piece]) -> list[_Stone]:
    """The stones, each with the pieces that its motion continues; of several
    continuations that which misses the expected place by least."""
    in_order = sorted(pieces, key=lambda piece: float(piece.t[0]))
    misses = []
    for before in range(len(in_order)):
        for after in range(before + 1, len(in_order)):
            miss = _miss(in_order[before], in_order[after])
            if miss is not None:
                misses.append((miss, before, after))
    next_of: dict[int, int] = {}
    continues_another = set[int]()
    for _, before, after in sorted(misses):
        if before not in next_of and after not in continues_another:
            next_of[before] = after
            continues_another.add(after)
    stones = []
    for first in range(len(in_order)):
        if first in continues_another:
            continue
        chain = [first]
        while chain[-1] in next_of:
            chain.append(next_of[chain[-1]])
        stones.append(_Stone([in_order[piece] for piece in chain]))
    return stones


def _miss(earlier: _Piece, later: _Piece) -> float | None:
    """How far the later piece begins from where the earlier one leads, ft; None if it
    is another stone.

    A stone that goes from one velocity to another at a constant deceleration goes the
    mean of both times the time between; it does not become faster.
    """
    gap = float(later.t[0] - earlier.t[-1])
    if earlier.color != later.color or gap <= 0:
        return None
    before = earlier.last_velocity
    after = later.first_velocity
    if math.hypot(*after) > math.hypot(*before) + _FASTER:
        return None
    way = (before + after) / 2 * gap
    miss = math.hypot(*(later.positions[0] - earlier.positions[-1] - way))
    return miss if miss <= _MOVED + _WAY_OFF * math.hypot(*way) else None


def _slope(t: Floats, positions: Floats) -> Floats:
    """Least-squares velocity; zero for rows of one time."""
    time = t - t.mean()
    square = float(time @ time)
    return time @ positions / square if square > 0 else np.zeros(2)


# The entries of the file


def _pieces(file: TextFile) -> list[_Piece]:
    """The entries of the file, in its order."""
    answer = value_in(file, _EXPECTED)
    state = answer.get("state", answer) if isinstance(answer, dict) else None
    stones = state.get("stones") if isinstance(state, dict) else None
    if not isinstance(stones, list):
        raise file.error(f"no stones found; {_EXPECTED}")
    if not stones:
        raise file.error("the tracker found no stone in the video: stones is empty")
    if len(stones) > _MOST_ENTRIES:
        fault = f"{len(stones)} stones; expected at most {_MOST_ENTRIES}, of one video"
        raise file.error(fault)
    return [_piece(file, number, stone) for number, stone in enumerate(stones, 1)]


def _piece(file: TextFile, number: int, entry: Any) -> _Piece:
    """An entry of the file, counting from 1."""

    of_color = ""  # in a message, as soon as it is read

    def refuse(fault: str) -> DataError:
        return file.error(f"entry {number} of its stones{of_color}: {fault}")

    if not isinstance(entry, dict):
        raise refuse(f"{quoted(entry)} found; {_EXPECTED}")
    color = entry.get("color")
    if not isinstance(color, str) or not color.strip():
        raise refuse("no color; expected one such as yellow")
    color = cut(color.strip())
    of_color = f" ({color})"
    histories = {key: value for key, value in entry.items() if key.endswith("_history")}
    for key in ("time_history", "position_history"):
        if not isinstance(histories.get(key), list) or not histories[key]:
            raise refuse(f"no {key}; expected a list with a value for each time")
    for key, history in histories.items():
        if not isinstance(history, list):
            raise refuse(f"{quoted(key)} is no list")
    lengths = {key: len(history) for key, history in histories.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{cut(key)} {length}" for key, length in lengths.items())
        raise refuse(f"histories of unlike lengths: {cut(listed, 200)}")
    times = histories["time_history"]
    positions_as_read = histories["position_history"]
    if len(times) > MOST_NUMBERS // 3:
        raise refuse(f"{len(times)} times; expected those of one video")
    for row, (time, position) in enumerate(
        zip(times, positions_as_read, strict=True), 1
    ):
        if not is_number(time):
            raise refuse(f"time {row} is {quoted(time)}; expected a number of seconds")
        if not _is_position(position):
            fault = f"position {row} is {quoted(position)}; expected x, y in feet"
            raise refuse(fault)
    t = np.array(times, np.float64)
    back = np.diff(t) < 0
    if back.any():
        row = int(np.argmax(back)) + 1
        raise refuse(
            f"time {row + 1} is {t[row]:g} s, after {t[row - 1]:g} s; expected times "
            "that do not go back"
        )
    positions = np.array([position[:2] for position in positions_as_read], float)
    extrapolated = _extrapolated(histories.get("acceleration_history", []))
    rows = len(t) - extrapolated
    computed = [key for key in _COMPUTED if key in histories]
    return _Piece(color, t[:rows], positions[:rows], extrapolated, computed)


def _is_position(value: Any) -> bool:
    """Whether a value is x, y, perhaps with a height."""
    return (
        isinstance(value, list) and len(value) in (2, 3) and all(map(is_number, value))
    )


def _extrapolated(accelerations: Sequence[Any]) -> int:
    """Number of the last rows that have the acceleration of the row before them; none
    where the file has zeros or nothing for it."""
    if not accelerations or not _is_position(accelerations[-1]):
        return 0
    last = accelerations[-1]
    if not any(last):
        return 0
    count = 0
    while count + 1 < len(accelerations) and accelerations[-count - 2] == last:
        count += 1
    return count
