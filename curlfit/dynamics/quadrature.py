"""Gauss quadrature over the contact ring.

With `u = R omega`, the sliding speed at polar angle `alpha` is `|v(A)|^2 = (v - |u|)^2
cos^2 b + (v + |u|)^2 sin^2 b`, where `b` is half the angle between the point and the
slowest point of the ring. Near `|epsilon| = 1` this point nearly stops sliding, and the
direction of friction reverses within an angle of `d = |v - |u||/(v + |u|)`. Gauss nodes
are placed by the sinh transform for near-singular integrals (Johnston and Elliott
2005), which resolves the reversal at any `d` with the same number of nodes. Each rule
ends where the front half meets the back half, so laws that jump there are integrated
exactly; at further jump angles of a law the halves are divided, in the same variable,
and the moving limits carry the derivatives with respect to the jump angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.friction import LocalLaw, RingPoint
from curlfit.friction.divisions import NODES

# singularity distance of the densest nodes: smallest maximum error, 4e-7
_MIN_DISTANCE = 5e-5

# The error of the force is 1e-14 at |epsilon| = 0.7, 1e-9 at 0.98.
_x, _w = np.polynomial.legendre.leggauss(NODES)
_GAUSS_NODES, GAUSS_WEIGHTS = (_x + 1) / 2, _w / 2


def singularity_distance(v: Array, u: Array) -> Array:
    """`d = |v - |u||/(v + |u|)`: half-angle within which sliding reverses; 1
    without spin."""
    au = jnp.where(u >= 0, u, -u)
    moving = v + au > 0
    return jnp.where(moving, jnp.abs(v - au) / jnp.where(moving, v + au, 1.0), 0.0)


class Nodes(NamedTuple):
    """Gauss points of one half of the ring, or of a part of it; the same on
    both halves.

    Arrays have the nodes along the first axis and the batch, if any, along the others.
    """

    xi: Array
    eta: Array
    half_angle: Array
    """b, half the angle from the slowest point of the ring"""
    square_sin: Array
    square_cos: Array
    """of b"""
    weight: Array
    """fraction of the ring that each point represents, without the weights of
    the Gauss rule"""


class NodeClustering(NamedTuple):
    """How densely the nodes lie near the slowest point of the ring.

    The sum over the nodes is insensitive to their positions, so these may be computed
    once for several similar motions, and no derivative passes through them.
    """

    side: Array
    """1 where the slowest point is on the left, -1 where it is on the right"""
    width: Array
    sinh_range: Array
    half_ring: Nodes
    """of an undivided half"""


class Panel(NamedTuple):
    """A part of the ring between two angles where friction may jump."""

    points: RingPoint
    weight: Array


def node_clustering(v: Array, u: Array) -> NodeClustering:
    """Positions of the nodes for a speed `v >= 0` and `u = R omega`, in
    m/s; any shape."""
    v, u = jax.lax.stop_gradient((v, u))
    side = jnp.where(u >= 0, 1.0, -1.0)
    # t = tan(b/2) runs over (0, 1); t = width sinh(s arcsinh(1/width)) clusters
    # nodes at t = 0.
    width = jnp.maximum(singularity_distance(v, u), _MIN_DISTANCE) / 2
    sinh_range = jnp.log((1 + jnp.sqrt(1 + width**2)) / width)
    return NodeClustering(
        side, width, sinh_range, _nodes(side, width, sinh_range, 0.0, 1.0)
    )


def _nodes(side: Array, width: Array, sinh_range: Array, low: Any, high: Any) -> Nodes:
    """Nodes with s of `node_clustering` between two limits."""
    gauss = _GAUSS_NODES.reshape(-1, *(1 for _ in side.shape))
    exponential = jnp.exp((low + (high - low) * gauss) * sinh_range)
    t = width * (exponential - 1 / exponential) / 2
    dt = (high - low) * sinh_range * width * (exponential + 1 / exponential) / 2
    q = 1 / (1 + t**2)
    sin_b, cos_b = 2 * t * q, (1 - t**2) * q
    square_sin, square_cos = sin_b**2, cos_b**2
    return Nodes(
        # The slowest point is on the left (alpha = pi) for counter-clockwise spin.
        xi=side * (square_sin - square_cos),
        eta=2 * sin_b * cos_b,
        half_angle=2 * jnp.arctan(t),
        square_sin=square_sin,
        square_cos=square_cos,
        weight=2 / jnp.pi * dt * q,  # d(alpha)/(2 pi), d(alpha) = 2 db, db = 2 q dt
    )


def panels(
    law: LocalLaw,
    v: Array,
    u: Array,
    turned: Array,
    time: Array,
    clustering: NodeClustering | None = None,
    *,
    halves: Sequence[float] = (1.0, 0.0),
) -> list[Panel]:
    """Gauss points of the ring under uniform load, in panels within which
    friction is smooth.

    Parameters
    ----------
    v, u : speed of the centre (>= 0) and `R omega`, in m/s, of shape S.
    turned, time : angle turned (rad) and time (s) since release.
    clustering : positions of the nodes; computed if not given.
    halves : front (1.0) and back (0.0), or one of them.

    Returns
    -------
    The front and the back half, or the parts divided at the law's jump angles; each
    with arrays of shape `(NODES, *S)`.
    """
    clustering = node_clustering(v, u) if clustering is None else clustering
    ring = []
    for front in halves:
        parts = [
            clustering.half_ring if whole else _nodes_between(ends, clustering)
            for ends, whole in _parts(law, front, turned, clustering)
        ]
        ring += [
            _panel(nodes, front, v, u, turned, time, clustering) for nodes in parts
        ]
    return ring


def angle_before_edges(
    law: LocalLaw, turned: Array, clustering: NodeClustering, front: float
) -> Array:
    """A polar angle on a half between its slowest point and its first edge."""
    (ends, _), *_ = _parts(law, front, turned, clustering)
    return _angle_between(ends, front, clustering)


def parts_beyond_edges(
    law: LocalLaw,
    turned: Array,
    clustering: NodeClustering,
    front: float,
    v: Array,
    u: Array,
    time: Array,
) -> list[tuple[Array, Panel]]:
    """The parts of a half beyond its first edge: for each, a polar angle and the
    Gauss points."""
    return [
        (
            _angle_between(ends, front, clustering),
            _panel(
                _nodes_between(ends, clustering), front, v, u, turned, time, clustering
            ),
        )
        for ends, _ in _parts(law, front, turned, clustering)[1:]
    ]


def _panel(
    nodes: Nodes,
    front: float,
    v: Array,
    u: Array,
    turned: Array,
    time: Array,
    clustering: NodeClustering,
) -> Panel:
    side = clustering.side
    slow, fast = v - side * u, v + side * u
    # v + omega xi (eq. 16) and the square of the sliding speed, without cancellation
    slide_eta = slow * nodes.square_cos + fast * nodes.square_sin
    square = slow**2 * nodes.square_cos + fast**2 * nodes.square_sin
    sliding = square > 0
    inverse_speed = jnp.where(
        sliding, 1 / jnp.sqrt(jnp.where(sliding, square, 1.0)), 0.0
    )
    sign = 2 * front - 1
    slide_xi = -u * nodes.eta * sign  # eq. 16
    points = RingPoint(
        xi=nodes.xi,
        eta=nodes.eta * sign,
        angle=_angle(nodes.half_angle, front, side),
        front=front,
        slide_xi=slide_xi,
        slide_eta=slide_eta,
        speed=square * inverse_speed,
        e_xi=slide_xi * inverse_speed,
        e_eta=slide_eta * inverse_speed,
        load=jnp.ones_like(nodes.xi),
        v=v,
        u=u,
        turned=turned,
        time=time,
    )
    return Panel(points, nodes.weight)


def _angle(half_angle: Array, front: float, side: Array) -> Array:
    """The polar angle of a point."""
    return (2 * front - 1) * (jnp.pi / 2 + side * (jnp.pi / 2 - 2 * half_angle))


def _angle_between(
    ends: tuple[Array, Array], front: float, clustering: NodeClustering
) -> Array:
    """The polar angle in the middle of a part."""
    low, high = ends
    return jax.lax.stop_gradient(_angle((low + high) / 2, front, clustering.side))


def _parts(
    law: LocalLaw, front: float, turned: Array, clustering: NodeClustering
) -> list[tuple[tuple[Array, Array], bool]]:
    """The parts of a half between edges: for each, half the angles from the slowest
    point at its ends, increasing, and whether it is the whole half."""
    jumps = law.edges(turned)
    start = jnp.zeros_like(clustering.side)
    end = start + jnp.pi / 2
    edges = []
    for angle in jumps.front if front else jumps.back:
        from_right = (2 * front - 1) * angle + start
        # differentiable up to the ends
        inside = (from_right >= 0) & (from_right <= jnp.pi)
        from_right = jnp.where(inside, from_right, jnp.clip(from_right, 0.0, jnp.pi))
        edges.append(
            jnp.where(clustering.side > 0, jnp.pi - from_right, from_right) / 2
        )
    if len(edges) > 1:
        edges = list(jnp.sort(jnp.stack(edges), axis=0))
    return [(ends, not edges) for ends in pairwise((start, *edges, end))]


def _nodes_between(ends: tuple[Array, Array], clustering: NodeClustering) -> Nodes:
    side, width, sinh_range, _ = clustering
    s = (jnp.arcsinh(jnp.tan(b / 2) / width) / sinh_range for b in ends)
    return _nodes(side, width, sinh_range, *s)
