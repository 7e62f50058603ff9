"""A good throw, and the same with one mistake each, as new users make them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from conftest import DATA

Columns = dict[str, np.ndarray]
NOISE = {"x": 0.003, "y": 0.003, "phi": 0.005}


def good() -> Columns:
    """Eq. 12 up to 20 s with the noise of a camera: 27 m, counter-clockwise,
    to the left."""
    body = DATA.read_text().split("t,x,y,phi\n")[1]
    rows = np.loadtxt(body.splitlines(), delimiter=",")[:201]
    random = np.random.default_rng(12)
    columns = dict(zip(("t", "x", "y", "phi"), rows.T, strict=True))
    for name, size in NOISE.items():
        columns[name] = columns[name] + size * random.standard_normal(len(rows))
    return columns


def scaled(**factors: float) -> Callable[[Columns], Columns]:
    """Some columns multiplied."""
    return lambda c: {
        name: factors.get(name, 1.0) * values for name, values in c.items()
    }


def exchanged(c: Columns) -> Columns:
    """x and y exchanged."""
    return c | {"x": c["y"], "y": c["x"]}


def pushed(c: Columns) -> Columns:
    """Filmed from the hack: 3 s in which the hand brings the stone from rest
    to its speed."""
    v = np.array([(c[axis][10] - c[axis][0]) / 1.0 for axis in "xy"])
    before = np.arange(-30, 0) * 0.1
    gone = (before + 3.0) ** 2 / 6 - 1.5  # speed grows evenly to 1 at t = 0
    random = np.random.default_rng(3)
    early = {
        "t": before,
        "phi": c["phi"][0] + 0 * before,
        "x": c["x"][0] + v[0] * gone + 0.003 * random.standard_normal(30),
        "y": c["y"][0] + v[1] * gone + 0.003 * random.standard_normal(30),
    }
    return {name: np.concatenate([early[name], c[name]]) for name in c}


def picked_up(c: Columns) -> Columns:
    """It rests from 20 s on, and is pushed aside at 24 s."""
    t = 20 + 0.1 * np.arange(1, 71)
    random = np.random.default_rng(4)
    push = 0.4 * np.clip(t - 24, 0, None) ** 2
    stop = np.clip(t - 20, 0, 1)
    last = {name: c[name][-10:].mean() for name in c}
    late = {
        "t": t,
        "x": last["x"] - 0.1 + push + 0.003 * random.standard_normal(70),
        "y": last["y"] + 0.5 * stop + 0.003 * random.standard_normal(70),
        "phi": last["phi"] + 0 * t,
    }
    return {name: np.concatenate([c[name], late[name]]) for name in c}


def collided(c: Columns) -> Columns:
    """At 12 s it hits another stone and goes on with half its speed to the side."""
    hit = 120
    result = {name: values.copy() for name, values in c.items()}
    dy = c["y"][hit:] - c["y"][hit]
    result["y"][hit:] = c["y"][hit] + 0.4 * dy
    result["x"][hit:] = c["x"][hit] + 0.3 * dy
    return result


def wrapped(
    period: float, low: float, unit: float = 1.0
) -> Callable[[Columns], Columns]:
    """The angle in another unit within one turn."""
    return lambda c: c | {"phi": np.remainder(unit * c["phi"] - low, period) + low}


DEGREES = 180 / np.pi
