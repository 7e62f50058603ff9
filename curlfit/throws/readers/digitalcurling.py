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
    "digitalcurling",
    _recognizes,
    _contents,
    "shot",
    "shot",
    None,
    ("shot", "stone_index"),
)


def _read_shot(file: TextFile, chosen: Shot, stone_index: int | None) -> ParsedFile:
    parsed = ParsedFile.begin(file, "digitalcurling", _HEAD)
    notes = parsed.notes
    period, positions, names = _paths(file, chosen)
    xy = positions[:, :, :2]
    far = np.hypot(*(np.fmax.reduce(xy, axis=1) - np.fmin.reduce(xy, axis=1)).T)
    began = {int(k): _first_change(positions[k]) for k in np.flatnonzero(far > _MOVED)}
    if not began:
        raise file.error(f"no stone moves in {chosen.name}", chosen.line - 1)
    first = min(began.values())
    thrown = max((k for k in began if began[k] == first), key=lambda k: far[k])
    stone = choose("stone", "--stone-index", stone_index, names, thrown)
    if stone not in began:
        moving = {k: names[k] for k in began}
        fault = does_not_move(stone, names[stone], moving)
        raise file.error(fault, chosen.line - 1)
    # A free throw: from its first motion until another stone moves.
    time = period * np.arange(positions.shape[1])
    others = [row for k, row in began.items() if k != stone and row > began[stone]]
    if others:
        end = float(time[min(others) - 1])
        parsed.settings.setdefault("until", end)
        notes.append(Finding.note("another-stone-moves", t=end))
    keep = np.isfinite(positions[stone, :, 0]) & (
        np.arange(len(time)) >= began[stone] - 1
    )
    logged = Finding.note(
        "logged-stone",
        shot=chosen.name,
        number=stone + 1,
        stones=len(names),
        name=names[stone],
        thrown=bool(stone == thrown),
        count=int(keep.sum()),
        period=period,
    )
    notes.insert(0, logged)
    notes.append(Finding.note("simulated"))
    parsed.lines = np.full(int(keep.sum()), chosen.line, np.int64)
    parsed.add("seconds_per_frame", Column("t", "s", 1.0), np.asarray(time[keep]))
    measured = (
        ("position.x", "x", "m"),
        ("position.y", "y", "m"),
        ("angle", "phi", "rad"),
    )
    for (header, quantity, unit), values in zip(
        measured, positions[stone, keep].T, strict=True
    ):
        parsed.add(header, Column(quantity, unit, 1.0), values)
    return parsed


def _shots_of(file: TextFile) -> list[Shot]:
    """Every shot in the file: one JSON value, or one per line.

    Raises
    ------
    DataError : the file is not a log, or contains no shot.
    """
    shots = [
        Shot(number, *found)
        for number, value in values_in(file, _EXPECTED)
        for item in (value if isinstance(value, list) else [value])
        if (found := _trajectory(item)) is not None
    ]
    if not shots:
        raise file.error(f"no trajectory found; {_EXPECTED}")
    return shots


def _trajectory(
    item: Any, name: str = "shot", deepest: int = _DEEPEST
) -> tuple[str, dict[str, Any]] | None:
    """The first trajectory in an entry, named after the end and the shot
    given beside it."""
    if not isinstance(item, dict) or not deepest:
        return None
    if "frames" in item and "seconds_per_frame" in item:
        return name, item
    if isinstance(item.get("end"), int) and isinstance(item.get("shot"), int):
        name = f"end {item['end']} shot {item['shot']}"
    parts = (_trajectory(part, name, deepest - 1) for part in item.values())
    return next((found for found in parts if found is not None), None)


def _paths(file: TextFile, shot: Shot) -> tuple[float, Floats, list[str]]:
    """Frame interval in s; x, y, angle by stone and frame, shape (stones,
    n, 3); names."""

    def refuse(message: str) -> DataError:
        return file.error(f"{shot.name}: {message}", shot.line - 1)

    period: Any = shot.trajectory.get("seconds_per_frame")
    if not is_number(period) or not 1e-6 <= period <= 60:
        raise refuse(
            f"seconds_per_frame = {quoted(period)}; expected a positive number"
        )
    start, frames = shot.trajectory.get("start"), shot.trajectory.get("frames")
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
    places = {key: slot for slot, key in enumerate(stones)}
    positions = np.empty((len(stones), len(frames) + 1, 3))
    try:
        count = 0
        positions[:, 0] = [_stone(stone) for stone in stones.values()]
        for count, changes in enumerate(frames, 1):
            positions[:, count] = positions[:, count - 1]
            for change in changes:
                team, index = change["team"], change["index"]
                place = places[team if isinstance(team, str) else f"team{team}", index]
                positions[place, count] = _stone(change["value"])
    except (KeyError, TypeError, ValueError):
        raise refuse(f"frame {count}: {_CHANGE}") from None
    return float(period), positions, [f"{team} stone {k + 1}" for team, k in stones]


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
