"""Gauss quadrature over the contact ring.

Each rule ends where the front half meets the back half, so laws that jump there are
integrated exactly; at further jump angles of a law the halves are divided, in the
variable of the nodes (`numerics.ring_nodes`), and the moving limits carry the
derivatives with respect to the jump angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from curlfit.friction import LocalLaw, RingPoint
from curlfit.numerics.ring_nodes import (
    NodeClustering,
    Nodes,
    half_angle,
    node_clustering,
    nodes_between,
    polar_angle,
)


class Panel(NamedTuple):
    """A part of the ring between two angles where friction may jump."""

    points: RingPoint
    weight: Array


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
    if clustering is None:
        clustering = node_clustering(v, u)
    ring = []
    for front in halves:
        parts = _parts(law, front, turned, clustering)
        if len(parts) == 1:
            nodes_of_parts = [clustering.half_ring]
        else:
            nodes_of_parts = [nodes_between(ends, clustering) for ends in parts]
        for nodes in nodes_of_parts:
            ring.append(_panel(nodes, front, v, u, turned, time, clustering))
    return ring


def angle_before_edges(
    law: LocalLaw, turned: Array, clustering: NodeClustering, front: float
) -> Array:
    """A polar angle on a half between its slowest point and its first edge."""
    ends = _parts(law, front, turned, clustering)[0]
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
    beyond = []
    for ends in _parts(law, front, turned, clustering)[1:]:
        angle = _angle_between(ends, front, clustering)
        nodes = nodes_between(ends, clustering)
        panel = _panel(nodes, front, v, u, turned, time, clustering)
        beyond.append((angle, panel))
    return beyond


def _panel(
    nodes: Nodes,
    front: float,
    v: Array,
    u: Array,
    turned: Array,
    time: Array,
    clustering: NodeClustering,
) -> Panel:
    """The points of some nodes on a half, for a stone in motion."""
    side = clustering.side
    # speeds of the slowest and of the fastest point; `slow` is negative where the
    # slowest point slides backward
    slow = v - side * u
    fast = v + side * u
    # v + u xi (eq. 16) and the square of the sliding speed, without cancellation
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
        angle=polar_angle(nodes.half_angle, front, side),
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


def _angle_between(
    ends: tuple[Array, Array], front: float, clustering: NodeClustering
) -> Array:
    """The polar angle in the middle of a part."""
    low, high = ends
    return jax.lax.stop_gradient(polar_angle((low + high) / 2, front, clustering.side))


def _parts(
    law: LocalLaw, front: float, turned: Array, clustering: NodeClustering
) -> list[tuple[Array, Array]]:
    """The parts of a half between edges, from the slowest point on, by half the angles
    from it at their ends; one without edges."""
    jumps = law.edges(turned)
    start = jnp.zeros_like(clustering.side)
    end = start + jnp.pi / 2
    edges = []
    for angle in jumps.front if front else jumps.back:
        from_right = (2 * front - 1) * angle + start
        # differentiable up to the ends
        inside = (from_right >= 0) & (from_right <= jnp.pi)
        from_right = jnp.where(inside, from_right, jnp.clip(from_right, 0.0, jnp.pi))
        edges.append(half_angle(from_right, clustering.side))
    if len(edges) > 1:
        edges = list(jnp.sort(jnp.stack(edges), axis=0))
    return list(pairwise((start, *edges, end)))
