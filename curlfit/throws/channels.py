"""The channels of a throw, and what their rows alone tell: noise, last
motion, means."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curlfit.findings import Finding
from curlfit.numerics.arrays import Floats

CHANNELS = ("x", "y", "phi", "speed", "omega")
UNITS = {"t": "s", "x": "m", "y": "m", "phi": "rad", "speed": "m/s", "omega": "rad/s"}
_MIN_ROWS = 10  # needed to estimate the scatter of a series
_REST_ROWS = 200  # rows of a condensed throw after the stone has come to rest
_REST_DISTANCE = 0.003  # m; this close to its last position a stone is at rest


def scatter(values: Floats) -> Any:
    """Standard deviation of the noise on smooth series along the last axis, from
    third differences.

    Second differences would count the curvature of the path as noise. 0 where there are
    too few rows.
    """
    if values.shape[-1] < _MIN_ROWS:
        return np.zeros(values.shape[:-1])[()]
    bend = (
        values[..., 3:] - values[..., :-3] + 3 * (values[..., 1:-2] - values[..., 2:-1])
    )
    return median(np.abs(bend)) / (0.6745 * math.sqrt(20))


def median(values: Floats) -> Any:
    """Median along the last axis of values without gaps; several times faster than
    NumPy's for a few hundred values."""
    ordered = np.sort(values, -1)
    n = values.shape[-1]
    return (ordered[..., (n - 1) // 2] + ordered[..., n // 2]) / 2


def slope(t: Floats, values: Floats) -> float:
    """The slope of the regression line of values over time."""
    centred = t - t.mean()
    return float(values @ centred / (centred @ centred))


def running_median(values: Floats, width: int) -> Floats:
    """Medians of an odd number of values about each one, or as many as there are; at
    the ends those of the first and the last."""
    width = min(width, (len(values) - 1) // 2 * 2 + 1)
    windows = np.lib.stride_tricks.sliding_window_view(values, width)
    return np.pad(median(windows), width // 2, "edge")


def block_means(values: Floats, starts: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Means over blocks of rows, which begin at `starts`, of the values that are
    measured (NaN where none is), and the number of these."""
    finite = np.isfinite(values)
    count = np.add.reduceat(finite.astype(float), starts)
    total = np.add.reduceat(np.where(finite, values, 0.0), starts)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), count


def last_motion(t: Floats, x: Floats, y: Floats) -> float:
    """Time of the last row in which the stone moves; the last time if unknown."""
    complete = np.isfinite(x) & np.isfinite(y)
    if complete.sum() <= 8:
        return float(t[-1])
    positions = np.stack([x, y])[:, complete]
    t = t[complete]
    tail = slice(-max(3, len(t) // 50), None)
    distance = np.hypot(*(positions - median(positions[:, tail])[:, None]))
    near = max(_REST_DISTANCE, 5 * math.hypot(*scatter(positions)))
    moving = np.flatnonzero(distance > near)
    return float(t[moving[-1]]) if len(moving) else float(t[-1])


def condensed(throw: Any, most: int) -> dict[str, Any]:
    """The fields of a throw condensed to at most about `most` rows.

    Mean time, position and angle of a block lie on the path except for its
    curvature within the block. The noise and given sigmas decrease as for any mean.
    Rows after the stone has come to rest, which repeat one measurement, are
    averaged over long blocks.
    """
    n = len(throw.t)
    rest = int(
        np.searchsorted(throw.t, last_motion(throw.t, throw.x, throw.y), side="right")
    )
    block = max(1, -(-rest // (most - _REST_ROWS)))
    rest_block = max(block, -(-(n - rest) // _REST_ROWS))  # not noisier than the others
    moving = -(-rest // block)
    still = -(-(n - rest) // rest_block)
    starts_in_motion = np.linspace(0, rest, moving, endpoint=False).astype(int)
    starts_at_rest = np.linspace(rest, n, still, endpoint=False).astype(int)
    starts = np.concatenate([starts_in_motion, starts_at_rest])
    means = {}
    counts = {}
    for name in ("t", *CHANNELS):
        means[name], counts[name] = block_means(getattr(throw, name), starts)

    def of_means(sigma_of_rows: dict[str, Floats]) -> dict[str, Floats]:
        """The standard deviations of the means, by channel."""
        sigma = {}
        for name, values in sigma_of_rows.items():
            mean_square, _ = block_means(values**2, starts)
            sigma[name] = np.sqrt(mean_square / np.maximum(counts[name], 1))
        return sigma

    length = block * float(median(np.diff(throw.t)))
    note = Finding.note(
        "condensed",
        rows=n,
        means=len(starts),
        count=block,
        milliseconds=1000 * length,
        until=float(throw.t[min(rest, n - 1)]),
        at_rest=rest_block if rest < n else None,
        measurements=still,
        # A deceleration a = 0.2 m/s^2, twice the usual, displaces a mean over T
        # by a T^2/24.
        bend=0.2 * length**2 / 24,
    )
    return {
        **means,
        "sigma": of_means(throw.sigma),
        "relative_sigma": of_means(throw.relative_sigma),
        "lines": None if throw.lines is None else throw.lines[starts],
        "notes": (*throw.notes, note),
    }
