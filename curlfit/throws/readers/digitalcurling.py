"""Logs of the DigitalCurling 3 server: the path of every stone of a shot, frame by frame.

The format is that of github.com/digitalcurling/DigitalCurling3-Server (src/log.cpp, src/game.cpp,
src/trajectory_compressor.cpp, commit 02e51c3). A shot's file `shot_eEEEsSS.json`, or a line of
`server.log`, is {"tag": "sht", "log": {"end", "shot", "trajectory": ...}}; a trajectory contains
`seconds_per_frame`, the stones at the `start` and the `finish` by `team0` and `team1` (each
{"position": {"x", "y"}, "angle"} or null), and `frames`, each a list of what changed:
{"team", "index", "value"}. A client sees the same in `last_move.trajectory`. Positions are in m
from the hack that is thrown from, y along the throw and x to the right, angles in rad and
counter-clockwise: curlfit's own axes (coordinate.hpp of digitalcurling/DigitalCurling). The log of
a game, `game.dcl2`, has no trajectories. The server adds a last frame when every stone has
stopped, so that its time is accurate to one frame.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.foreign import is_number, quoted
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Reading
from curlfit.throws.readers.columns import Column
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile, choose
from curlfit.throws.readers.text import TextFile, is_aside

_EXPECTED = (
    'expected a log of a DigitalCurling 3 shot with a "trajectory" (shot_*.json or server.log)'
)
_MOST_NUMBERS = 2_000_000
_HEAD = 200  # lines whose comments are settings
_MOVED = 1e-4  # m; positions are 32-bit numbers


class Shot(NamedTuple):
    """One shot of a log: its line, its name, and its trajectory as logged."""

    line: int
    name: str
    trajectory: dict[str, Any]


def _recognizes(head: list[str]) -> bool:
    first = head[0].lstrip()
    return first.startswith("{") or bool(re.match(r"\[\s*([{\[]|$)", first))


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The shots of a log; of each the path of one stone, by default of the stone thrown.

    Raises
    ------
    DataError : the file is not a log of a shot. InputError : there is no such stone.
    """
    shots = shots_of(file)
    return Contents(
        [shot.name for shot in shots],
        lambda index: _read_shot(file, shots[index], reading.stone_index),
    )


DIGITALCURLING = Format(
    "digitalcurling", _recognizes, _contents, "shot", "shot", None, ("shot", "stone_index")
)


def _read_shot(file: TextFile, chosen: Shot, stone_index: int | None) -> ParsedFile:
    parsed = begun(file, "digitalcurling", _HEAD)
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
        movers = ", ".join(f"{k + 1} ({names[k]})" for k in began)
        fault = f"stone {stone + 1} ({names[stone]}) does not move; those that do are {movers}"
        raise file.error(fault, chosen.line - 1)
    # A free throw: from its first motion until another stone moves.
    time = period * np.arange(positions.shape[1])
    others = [row for k, row in began.items() if k != stone and row > began[stone]]
    if others:
        end = float(time[min(others) - 1])
        parsed.settings.setdefault("until", end)
        notes.append(f"another stone moves after t = {end:g} s; until is set to that")
    keep = np.isfinite(positions[stone, :, 0]) & (np.arange(len(time)) >= began[stone] - 1)
    notes.insert(
        0,
        f"{chosen.name}: stone {stone + 1} of {len(names)} ({names[stone]}"
        + (", the one thrown)" if stone == thrown else ")")
        + f", {int(keep.sum())} frames of {period:g} s",
    )
    notes.append("a simulated throw: positions are exact to the 32 bits of the log")
    parsed.lines = np.full(int(keep.sum()), chosen.line, np.int64)
    parsed.add("seconds_per_frame", Column("t", "s", 1.0), np.asarray(time[keep]))
    xyz = positions[stone, keep].T
    for header, column, values in (
        ("position.x", Column("x", "m", 1.0), xyz[0]),
        ("position.y", Column("y", "m", 1.0), xyz[1]),
        ("angle", Column("phi", "rad", 1.0), xyz[2]),
    ):
        parsed.add(header, column, values)
    return parsed


def shots_of(file: TextFile) -> list[Shot]:
    """Every shot in the file: one JSON value, or one per line.

    Raises
    ------
    DataError : the file is not a log, or contains no shot.
    """
    shots = [
        Shot(number, *found)
        for number, value in _values(file)
        for item in (value if isinstance(value, list) else [value])
        if (found := _trajectory(item)) is not None
    ]
    if not shots:
        raise file.error(f"no trajectory found; {_EXPECTED}")
    return shots


def _values(file: TextFile) -> Iterator[tuple[int, Any]]:
    """The JSON values of the file, with their lines."""
    rows = [(k, line) for k, line in enumerate(file.lines) if not is_aside(line)]
    text = "\n".join(line for _, line in rows)
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        for index, line in rows:
            try:
                yield index + 1, json.loads(line)
            except (ValueError, RecursionError):
                raise file.error(f"not a line of JSON; {_EXPECTED}", index) from None
    else:
        yield 1, whole


def _trajectory(item: Any) -> tuple[str, dict[str, Any]] | None:
    """A trajectory and its name, at any depth of the entry."""
    label: dict[str, Any] = {}
    for _ in range(6):
        if not isinstance(item, dict):
            return None
        if isinstance(item.get("state"), dict):  # a client's update, after the shot
            label |= {key: item["state"].get(key) for key in ("end", "shot")}
        label |= {key: item[key] for key in ("end", "shot") if isinstance(item.get(key), int)}
        if isinstance(item.get("trajectory"), dict):
            item = item["trajectory"]
            break
        if "frames" in item and "seconds_per_frame" in item:
            break
        item = next(
            (item[key] for key in ("log", "last_move", "msg") if isinstance(item.get(key), dict)),
            None,
        )
    else:
        return None
    parts = [f"{key} {label[key]}" for key in ("end", "shot") if isinstance(label.get(key), int)]
    return " ".join(parts) or "shot", item


def _paths(file: TextFile, shot: Shot) -> tuple[float, Floats, list[str]]:
    """Frame interval in s; x, y, angle by stone and frame, shape (stones, n, 3); names."""

    def refuse(message: str) -> DataError:
        return file.error(f"{shot.name}: {message}", shot.line - 1)

    period: Any = shot.trajectory.get("seconds_per_frame")
    if not is_number(period) or not 1e-6 <= period <= 60:
        raise refuse(f"seconds_per_frame = {quoted(period)}; expected a positive number")
    start, frames = shot.trajectory.get("start"), shot.trajectory.get("frames")
    if not isinstance(start, dict) or not isinstance(frames, list):
        raise refuse("a trajectory needs a start and frames")
    slots = [
        (team, k)
        for team in sorted(start)
        if isinstance(start[team], list)
        for k in range(len(start[team]))
    ]
    if not slots or len(slots) > 64 or len(slots) * (len(frames) + 1) > _MOST_NUMBERS:
        raise refuse("the start needs some stones by team")
    positions = np.empty((len(slots), len(frames) + 1, 3))
    positions[:, 0] = [_stone(start[team][k], refuse) for team, k in slots]
    for count, changes in enumerate(frames, 1):
        positions[:, count] = positions[:, count - 1]
        if not isinstance(changes, list):
            raise refuse(f"frame {count}: expected a list of changes")
        for change in changes:
            if not isinstance(change, dict):
                raise refuse(f"frame {count}: a change needs team, index and value")
            side: Any = change.get("team")
            number: Any = change.get("index")
            if isinstance(side, int) and not isinstance(side, bool):
                side = f"team{side}"
            if (side, number) not in slots:
                raise refuse(f"frame {count}: no stone {quoted(number)} of team {quoted(side)}")
            stone = slots.index((side, number))
            positions[stone, count] = _stone(change.get("value"), refuse)
    return float(period), positions, [f"{team} stone {k + 1}" for team, k in slots]


def _stone(value: Any, refuse: Callable[[str], DataError]) -> list[float]:
    if value is None:
        return [math.nan] * 3
    try:
        numbers = [value["position"]["x"], value["position"]["y"], value["angle"]]
    except (TypeError, KeyError):
        numbers = [None]
    if not all(map(is_number, numbers)):
        raise refuse("a stone needs a position x, y and an angle, all finite numbers")
    return [float(number) for number in numbers]


def _first_change(stone: Floats) -> int:
    """First frame in which a stone has moved."""
    step = np.abs(np.diff(stone[:, :2], axis=0)).max(axis=1)
    return int(np.argmax(step > 0)) + 1
