"""The channels of a throw, and what their rows alone tell: their noise and the last motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curlfit.numerics.arrays import Floats

CHANNELS = ("x", "y", "phi", "speed", "omega")
UNITS = {"t": "s", "x": "m", "y": "m", "phi": "rad", "speed": "m/s", "omega": "rad/s"}
_MIN_ROWS = 10  # needed to estimate the scatter of a series
_REST_DISTANCE = 0.003  # m; this close to its last position a stone is at rest


def scatter(values: Floats) -> Any:
    """Standard deviation of the noise on smooth series along the last axis, from third differences.

    Second differences would count the curvature of the path as noise. 0 where there are too few
    rows.
    """
    if values.shape[-1] < _MIN_ROWS:
        return np.zeros(values.shape[:-1])[()]
    bend = values[..., 3:] - values[..., :-3] + 3 * (values[..., 1:-2] - values[..., 2:-1])
    return _median(np.abs(bend)) / (0.6745 * math.sqrt(20))


def _median(values: Floats) -> Any:
    """Median along the last axis; several times faster than NumPy's for a few hundred values."""
    ordered, n = np.sort(values, -1), values.shape[-1]
    return (ordered[..., (n - 1) // 2] + ordered[..., n // 2]) / 2


def block_means(values: Floats, starts: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Means over blocks of rows, which begin at `starts`, of the values that are measured (NaN
    where none is), and the number of these."""
    finite = np.isfinite(values)
    count = np.add.reduceat(finite.astype(float), starts)
    total = np.add.reduceat(np.where(finite, values, 0.0), starts)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), count


def last_motion(t: Floats, x: Floats, y: Floats) -> float:
    """Time of the last row in which the stone moves; the last time if unknown."""
    complete = np.isfinite(x) & np.isfinite(y)
    if complete.sum() <= 8:
        return float(t[-1])
    positions, t = np.stack([x, y])[:, complete], t[complete]
    tail = slice(-max(3, len(t) // 50), None)
    distance = np.hypot(*(positions - _median(positions[:, tail])[:, None]))
    near = max(_REST_DISTANCE, 5 * math.hypot(*scatter(positions)))
    moving = np.flatnonzero(distance > near)
    return float(t[moving[-1]]) if len(moving) else float(t[-1])
