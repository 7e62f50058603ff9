"""Logs of the DigitalCurling 3 server: the path of every stone of a shot,
frame by frame.

The format is that of github.com/digitalcurling/DigitalCurling3-Server (src/log.cpp,
src/game.cpp, src/trajectory_compressor.cpp, commit 02e51c3). A shot's file
`shot_eEEEsSS.json`, or a line of `server.log`, is {"tag": "sht", "log": {"end", "shot",
"trajectory": ...}}; a trajectory contains `seconds_per_frame`, the stones at the
`start` and the `finish` by `team0` and `team1` (each {"position": {"x", "y"}, "angle"}
or null), and `frames`, each a list of what changed: {"team", "index", "value"}. A
client sees the same in `last_move.trajectory`. Positions are in m from the hack that is
thrown from, y along the throw and x to the right, angles in rad and counter-clockwise:
curlfit's own axes (coordinate.hpp of digitalcurling/DigitalCurling). The log of a game,
`game.dcl2`, has no trajectories. The server adds a last frame when every stone has
stopped, so that its time is accurate to one frame.
"""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.findings import Finding
from curlfit.foreign import is_number, quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column
from curlfit.throws.readers.format import Contents, Format, choose
from curlfit.throws.readers.json_values import (
    MOST_NUMBERS,
    does_not_move,
    values_in,
)
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.text import TextFile

_EXPECTED = (
    'expected a log of a DigitalCurling 3 shot with a "trajectory" '
    "(shot_*.json or server.log)"
)
_MOST_STONES = 64
_DEEPEST = 6  # entry around a trajectory
_HEAD = 200  # lines whose comments are settings
_MOVED = 1e-4  # m; positions are 32-bit numbers
_CHANGE = (
    "expected changes of stones of the start, each with team, index and value, "
    "this with a position x, y and an angle, all finite numbers"
)


class Shot(NamedTuple):
    """One shot of a log: its line, its name, and its trajectory as logged."""

    line: int
    name: str
    trajectory: dict[str, Any]


def _recognizes(head: list[str]) -> bool:
    return bool(re.match(r"\s*(\{|\[\s*([{\[]|$))", head[0]))


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The shots of a log; of each the path of one stone, by default of the
    stone thrown.

    Raises
    ------
    DataError : the file is not a log of a shot. InputError : there is no such stone.
    """
    shots = _shots_of(file)
    return Contents(
        [shot.name for shot in shots],
        lambda index: _read_shot(file, shots[index], reading.stone_index),
    )


DIGITALCURLING = Format(
    name="digitalcurling",
    recognizes=_recognizes,
    contents=_contents,
    what="shot",
    selected_by="shot",
    usual=None,
    selections=("shot", "stone_index"),
)


def _read_shot(file: TextFile, chosen: Shot, stone_index: int | None) -> ParsedFile:
    parsed = ParsedFile.begin(file, "digitalcurling", _HEAD)
    notes = parsed.notes
    paths = _paths(file, chosen)
    names = paths.names
    positions = paths.positions
    xy = positions[:, :, :2]
    extent = np.fmax.reduce(xy, axis=1) - np.fmin.reduce(xy, axis=1)
    way = np.hypot(*extent.T)
    # the frame in which a stone is first elsewhere, of each that moves
    first_frame = {
        int(stone): _first_change(positions[stone])
        for stone in np.flatnonzero(way > _MOVED)
    }
    if not first_frame:
        raise file.error(f"no stone moves in {chosen.name}", chosen.line - 1)
    earliest = min(first_frame.values())
    first_stones = [stone for stone in first_frame if first_frame[stone] == earliest]
    thrown = max(first_stones, key=lambda stone: way[stone])
    stone = choose("stone", "--stone-index", stone_index, names, thrown)
    if stone not in first_frame:
        moving = {other: names[other] for other in first_frame}
        fault = does_not_move(stone, names[stone], moving)
        raise file.error(fault, chosen.line - 1)
    # A free throw: from its first motion until another stone moves.
    time = paths.period * np.arange(positions.shape[1])
    begin = first_frame[stone]
    frames_of_others = [
        frame
        for other, frame in first_frame.items()
        if other != stone and frame > begin
    ]
    if frames_of_others:
        end = float(time[min(frames_of_others) - 1])
        parsed.settings.setdefault("until", end)
        notes.append(Finding.note("another-stone-moves", t=end))
    keep = np.isfinite(positions[stone, :, 0]) & (np.arange(len(time)) >= begin - 1)
    logged = Finding.note(
        "logged-stone",
        shot=chosen.name,
        number=stone + 1,
        stones=len(names),
        name=names[stone],
        thrown=bool(stone == thrown),
        count=int(keep.sum()),
        period=paths.period,
    )
    notes.insert(0, logged)
    notes.append(Finding.note("simulated"))
    parsed.lines = np.full(int(keep.sum()), chosen.line, np.int64)
    parsed.add("seconds_per_frame", Column("t", "s", 1.0), np.asarray(time[keep]))
    x, y, angle = positions[stone, keep].T
    parsed.add("position.x", Column("x", "m", 1.0), x)
    parsed.add("position.y", Column("y", "m", 1.0), y)
    parsed.add("angle", Column("phi", "rad", 1.0), angle)
    return parsed


def _shots_of(file: TextFile) -> list[Shot]:
    """Every shot in the file: one JSON value, or one per line.

    Raises
    ------
    DataError : the file is not a log, or contains no shot.
    """
    shots = []
    for line, value in values_in(file, _EXPECTED):
        for entry in value if isinstance(value, list) else [value]:
            shot = _shot(line, entry)
            if shot is not None:
                shots.append(shot)
    if not shots:
        raise file.error(f"no trajectory found; {_EXPECTED}")
    return shots


def _shot(
    line: int, entry: Any, name: str = "shot", deepest: int = _DEEPEST
) -> Shot | None:
    """The first trajectory in an entry, named after the end and the shot
    given beside it."""
    if not isinstance(entry, dict) or not deepest:
        return None
    if "frames" in entry and "seconds_per_frame" in entry:
        return Shot(line, name, entry)
    if isinstance(entry.get("end"), int) and isinstance(entry.get("shot"), int):
        name = f"end {entry['end']} shot {entry['shot']}"
    for part in entry.values():
        shot = _shot(line, part, name, deepest - 1)
        if shot is not None:
            return shot
    return None


class _Paths(NamedTuple):
    """The paths of all stones of a shot.

    Attributes
    ----------
    period : time between frames, s.
    positions : x, y (m) and angle (rad), shape (stones, frames, 3); NaN for a stone
        that is not on the sheet.
    names : of the stones.
    """

    period: float
    positions: Floats
    names: list[str]


def _paths(file: TextFile, shot: Shot) -> _Paths:
    """The paths of the stones, from where they start and what changes in each frame.

    Raises
    ------
    DataError : the trajectory is no such log, or too large.
    """

    def refuse(message: str) -> DataError:
        return file.error(f"{shot.name}: {message}", shot.line - 1)

    period: Any = shot.trajectory.get("seconds_per_frame")
    if not is_number(period) or not 1e-6 <= period <= 60:
        raise refuse(
            f"seconds_per_frame = {quoted(period)}; expected a positive number"
        )
    start = shot.trajectory.get("start")
    frames = shot.trajectory.get("frames")
    if not isinstance(start, dict) or not isinstance(frames, list):
        raise refuse("a trajectory needs a start and frames")
    stones = {
        (team, k): stone
        for team in sorted(start)
        if isinstance(start[team], list)
        for k, stone in enumerate(start[team])
    }
    if not 0 < len(stones) <= min(_MOST_STONES, MOST_NUMBERS / (len(frames) + 1)):
        raise refuse("the start needs some stones by team")
    number_of = {key: number for number, key in enumerate(stones)}
    positions = np.empty((len(stones), len(frames) + 1, 3))
    frame = 0
    try:
        positions[:, 0] = [_stone(stone) for stone in stones.values()]
        for frame, changes in enumerate(frames, 1):
            positions[:, frame] = positions[:, frame - 1]
            for change in changes:
                team = change["team"]
                if not isinstance(team, str):
                    team = f"team{team}"
                stone = number_of[team, change["index"]]
                positions[stone, frame] = _stone(change["value"])
    except (KeyError, TypeError, ValueError):
        raise refuse(f"frame {frame}: {_CHANGE}") from None
    names = [f"{team} stone {k + 1}" for team, k in stones]
    return _Paths(float(period), positions, names)


def _stone(value: Any) -> list[float]:
    """x, y, angle of a logged stone, NaN for null. Raises `KeyError`,
    `TypeError`, `ValueError`."""
    if value is None:
        return [math.nan] * 3
    numbers = [value["position"]["x"], value["position"]["y"], value["angle"]]
    if not all(map(is_number, numbers)):
        raise ValueError
    return numbers


def _first_change(stone: Floats) -> int:
    """First frame in which a stone has moved."""
    step = np.abs(np.diff(stone[:, :2], axis=0)).max(axis=1)
    return int(np.argmax(step > 0)) + 1
