"""Gauss points on the contact ring, for any law.

With `u = R omega`, the sliding speed at polar angle `alpha` is `|v(A)|^2 = (v - |u|)^2
cos^2 b + (v + |u|)^2 sin^2 b`, where `b` is half the angle between the point and the
slowest point of the ring. Near `|epsilon| = 1` this point nearly stops sliding, and the
direction of friction reverses within an angle of `d = |v - |u||/(v + |u|)`. Gauss nodes
are placed by the sinh transform for near-singular integrals (Johnston and Elliott
2005), which resolves the reversal at any `d` with the same number of nodes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

NODES = 20
"""Gauss points of each half of the ring, or of each part of a divided half"""
# singularity distance of the densest nodes: smallest maximum error, 4e-7
_MIN_DISTANCE = 5e-5

# The error of the force is 1e-14 at |epsilon| = 0.7, 1e-9 at 0.98.
_x, _w = np.polynomial.legendre.leggauss(NODES)
_GAUSS_NODES = (_x + 1) / 2
GAUSS_WEIGHTS = _w / 2


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


def node_clustering(v: Array, u: Array) -> NodeClustering:
    """Positions of the nodes for a speed `v >= 0` and `u = R omega`, in
    m/s; any shape."""
    v, u = jax.lax.stop_gradient((v, u))
    side = jnp.where(u >= 0, 1.0, -1.0)
    # t = tan(b/2) runs over (0, 1); t = width sinh(s arcsinh(1/width)), with Gauss
    # nodes s in (0, 1), clusters nodes at t = 0.
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
    sin_b = 2 * t * q
    cos_b = (1 - t**2) * q
    square_sin = sin_b**2
    square_cos = cos_b**2
    return Nodes(
        # The slowest point is on the left (alpha = pi) for counter-clockwise spin.
        xi=side * (square_sin - square_cos),
        eta=2 * sin_b * cos_b,
        half_angle=2 * jnp.arctan(t),
        square_sin=square_sin,
        square_cos=square_cos,
        weight=2 / jnp.pi * dt * q,  # d(alpha)/(2 pi), d(alpha) = 2 db, db = 2 q dt
    )


def nodes_between(
    ends: tuple[Array, Array],
    clustering: NodeClustering,
    section: tuple[Any, Any] = (0.0, 1.0),
) -> Nodes:
    """Nodes of the part of a half of the ring between two half angles from the slowest
    point, or of a section of this part, such as (0.5, 1.0): a share of its range of s
    (`node_clustering`)."""
    side, width, sinh_range, _ = clustering

    def variable(b: Array) -> Array:
        """s of `node_clustering`, the inverse of t = width sinh(s sinh_range)."""
        return jnp.arcsinh(jnp.tan(b / 2) / width) / sinh_range

    low = variable(ends[0])
    high = variable(ends[1])
    begin = low * (1 - section[0]) + high * section[0]
    end = low * (1 - section[1]) + high * section[1]
    return _nodes(side, width, sinh_range, begin, end)


def polar_angle(b: Array, front: float | Array, side: Array) -> Array:
    """The polar angle of a point of the front half (1.0) or back half (0.0), `b` half
    the angle from the slowest point."""
    return (2 * front - 1) * (jnp.pi / 2 + side * (jnp.pi / 2 - 2 * b))


def half_angle(from_right: Array, side: Array) -> Array:
    """Half the angle from the slowest point, of an angle from the right end of a
    half."""
    return jnp.where(side > 0, jnp.pi - from_right, from_right) / 2
