"""Where to divide the ring, so that the friction of a law is smooth between
two divisions.

Friction is summed over `NODES` Gauss points of each part of the ring. Where many more
points give another sum, the angles at which friction jumps or has a kink are found by
bisection; parts in which it changes within a narrow range are halved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from curlfit.numerics.arrays import Booleans, Floats

NODES = 20
"""Gauss points of each part of the ring"""
MOST_PARTS = 24
"""Largest number of parts of a ring"""
HALVES = [-np.pi, 0.0, np.pi]
"""Ends of the back and the front half"""
_FINE = 20  # parts of a part, for a sum over many more points
TOLERANCE = 1e-7
"""Relative error of the sum over the ring, from which it is divided"""
_ROUGH = 1e-8  # relative error of the mean over a part in which friction is not smooth
_SHORTEST = 1e-11  # rad
_MOST_ROUGH = 30  # parts bisected at a time, and angles found

_x, _w = np.polynomial.legendre.leggauss(NODES)

Friction = Callable[[Floats], Floats]
"""Force to the right, forward, and moment, relative to the size of the force, in
several conditions, at polar angles of shape (conditions, n) or (1, n): shape (3,
conditions, n)"""


def errors_of_means(
    friction: Friction, low: Floats, high: Floats, parts: int = _FINE
) -> Floats:
    """Relative errors of the mean friction between angles of shape (conditions, k) or
    (1, k), by comparison with the mean of many parts: shape (conditions, k)."""
    ends = np.linspace(low, high, parts + 1, axis=-1)
    each = [side.reshape(len(low), -1) for side in (ends[..., :-1], ends[..., 1:])]
    many = _means(friction, *each)
    better = many.reshape(*many.shape[:2], -1, parts).mean(-1)
    found: Floats = np.abs(_means(friction, low, high) - better).max(0)
    return found


def _means(friction: Friction, low: Floats, high: Floats) -> Floats:
    angles = ((low + high) / 2)[..., None] + ((high - low) / 2)[..., None] * _x
    values = friction(angles.reshape(len(low), -1))
    return values.reshape(*values.shape[:2], -1, NODES) @ _w / 2


def sums(friction: Friction, ends: Floats) -> Floats:
    """Means over the ring, from its parts between angles of shape (conditions, k) or
    (1, k): shape (3, conditions)."""
    low, high = ends[:, :-1], ends[:, 1:]
    found: Floats = (_means(friction, low, high) * _share(low, high)).sum(-1)
    return found


def errors_of_sums(friction: Friction, ends: Floats) -> Floats:
    """Relative errors of these means, by condition."""
    low, high = ends[:, :-1], ends[:, 1:]
    found: Floats = (errors_of_means(friction, low, high) * _share(low, high)).sum(1)
    return found


def _share(low: Floats, high: Floats) -> Floats:
    return (high - low) / (2 * np.pi)


def jumps(friction: Friction) -> list[float] | None:
    """Angles at which friction jumps or has a kink, or near which it changes within a
    narrow range; None if they are too many."""

    def rough(parts: Floats) -> Booleans:
        low, high = parts.reshape(1, -1, 2).transpose(2, 0, 1)
        return errors_of_means(friction, low, high, 2).max(0) > _ROUGH

    found: list[float] = []
    halves = np.array(list(pairwise(HALVES)))
    parts = halves[rough(halves)]
    while len(parts):
        if len(parts) + len(found) > _MOST_ROUGH:
            return None
        middle = parts.mean(1)
        children = np.stack([parts[:, 0], middle, middle, parts[:, 1]], 1).reshape(
            -1, 2, 2
        )
        is_rough = rough(children).reshape(-1, 2)
        is_rough &= (parts[:, 1] - parts[:, 0] > _SHORTEST)[:, None]
        found += middle[~is_rough.any(1)].tolist()
        parts = children[is_rough]
    return sorted(found)


def divisions(friction: Friction) -> list[float] | None:
    """Angles besides 0 and pi that divide the ring into parts whose sums are accurate;
    None if they are too many."""
    at_jumps = jumps(friction)
    if at_jumps is None:
        return None
    ends = sorted({*HALVES, *at_jumps})
    while (wrong := _inaccurate(friction, ends)).any():
        ends = sorted(
            [*ends, *(np.array(ends[:-1]) + np.diff(ends) / 2)[wrong].tolist()]
        )
        if len(ends) > 2 * MOST_PARTS:
            return None
    for end in sorted(set(ends) - set(HALVES)):
        fewer = [other for other in ends if other != end]
        if not _inaccurate(friction, fewer).any():
            ends = fewer
    return (
        [end for end in ends if end not in HALVES]
        if len(ends) <= MOST_PARTS + 1
        else None
    )


def _inaccurate(friction: Friction, ends: Sequence[float]) -> Booleans:
    low, high = np.array(ends)[None, :-1], np.array(ends)[None, 1:]
    return (errors_of_means(friction, low, high) * _share(low, high)).max(0) > TOLERANCE
