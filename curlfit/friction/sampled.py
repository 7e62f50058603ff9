"""The friction of a law in many motions at once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, ring_points
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone

STONE = Stone()
_POINTS = 4096  # evaluated in one call, so that there is one program
_ROWS = 256  # of sections of the ring, in one call
# |epsilon|; near 1 the nodes of the model crowd where sliding stops
_SPIN_RATIOS = 0.01, 0.4
_IN_PLACE = 3.0  # |epsilon| of a stone that spins almost in place
_MOST_TRIES = 20


class Conditions(NamedTuple):
    """Coefficients, shape (n, k), and motions, each field of shape (n,)."""

    coefficients: Floats
    speed: Floats
    omega: Floats
    turned: Floats
    time: Floats
    tilt_xi: Floats
    """p of the load 1 + p xi + q eta (eq. 9)"""
    tilt_eta: Floats

    def take(self, rows: Any) -> Conditions:
        """Some of the conditions, by number."""
        return Conditions(*(field[rows] for field in self))


def sample(law: type[Law], count: int, seed: int) -> Conditions:
    """Random conditions, with coefficients near the defaults, all different."""
    random = np.random.default_rng(seed)
    coefficients = law.coefficients()
    default = np.array([c.default for c in coefficients])
    reach = np.array([max(abs(c.default) / 2, c.typical) for c in coefficients])
    lower = np.array([c.lower for c in coefficients])
    upper = np.array([c.upper for c in coefficients])

    def admissible_values() -> Floats:
        for _ in range(_MOST_TRIES):
            values = default + reach * random.uniform(-1, 1, len(default))
            values = np.clip(values, lower, upper)
            if law.from_vector(values).fault() is None:
                return values
        return default

    speed = 3 * (np.arange(count) + random.uniform(0.02, 1, count)) / count
    epsilon = random.uniform(*_SPIN_RATIOS, count)
    speed[::8] = 0.1 * random.uniform(0.2, 1, len(speed[::8]))
    epsilon[::8] = _IN_PLACE
    omega = np.minimum(epsilon * speed / STONE.R, 4.0) * random.choice([-1, 1], count)
    return Conditions(
        np.array([admissible_values() for _ in range(count)]),
        speed,
        omega,
        random.uniform(-7, 14, count),
        random.uniform(0, 25, count),
        *random.uniform(-0.05, 0.05, (2, count)),
    )


class Sampled:
    """The friction of a law, compiled once."""

    def __init__(self, law: type[Law]) -> None:
        import jax  # only for user-defined laws

        from curlfit.numerics.jax_settings import require_jax

        require_jax()
        self.law = law
        function: Any = _at_point if issubclass(law, LocalLaw) else _of_stone
        self._program = jax.jit(jax.vmap(partial(function, law)))
        self._rule = jax.jit(jax.vmap(_section_rule))

    def _run(self, conditions: Conditions, rows: Any, alpha: Any) -> Floats:
        """Force to the right, forward and moment for pairs of a condition and an
        angle: (3, n)."""
        columns = [*conditions.take(rows), alpha]
        return _in_parts(self._program, columns, _POINTS).T

    def at_angles(self, conditions: Conditions, angles: Floats) -> Floats:
        """Force to the right, forward and moment at polar angles of shape
        (conditions, n) or (1, n): shape (3, conditions, n)."""
        count = len(conditions.speed)
        shape = count, angles.shape[1]
        rows = np.broadcast_to(np.arange(count)[:, None], shape)
        points = np.broadcast_to(angles, shape)
        return self._run(conditions, rows.ravel(), points.ravel()).reshape(3, *shape)

    def size(self, conditions: Conditions) -> Floats:
        """Mean magnitude of friction on the ring, shape (n,)."""
        angles = np.linspace(-np.pi, np.pi, 60, endpoint=False)[None] + 0.01
        right, forward, _ = self.at_angles(conditions, angles)
        magnitude: Floats = np.hypot(right, forward).mean(-1)
        return magnitude

    def usable(self, conditions: Conditions) -> Conditions:
        """The conditions in which there is friction, a finite one."""
        size = self.size(conditions)
        return conditions.take(np.flatnonzero(np.isfinite(size) & (size > 0)))

    def ends(self, conditions: Conditions) -> Floats:
        """Polar angles between the parts in which the law is summed, shape
        (conditions, k): ends of the halves and edges."""
        assert issubclass(self.law, LocalLaw)
        edges = self.law.from_vector(conditions.coefficients.T).edges(conditions.turned)
        shape = conditions.speed.shape
        ends = [np.full(shape, end) for end in (-np.pi, 0.0, np.pi)]
        for angle in edges.front:
            ends.append(np.clip(np.broadcast_to(angle, shape), 0, np.pi))
        for angle in edges.back:
            ends.append(np.clip(np.broadcast_to(angle, shape), -np.pi, 0))
        return np.sort(np.stack(ends, axis=1), axis=1)

    def net(self, conditions: Conditions, sections: int = 1) -> Floats:
        """Friction of the whole stone, shape (3, n): of a law of the ring the sum over
        the points of a fit, or over as many in each of several sections of the parts
        between edges."""
        if not issubclass(self.law, LocalLaw):
            rows = np.arange(len(conditions.speed))
            return self._run(conditions, rows, 0.0 * rows)
        total = np.zeros((3, len(conditions.speed)))
        for low, high in pairwise(self.ends(conditions).T):
            angles, weights = self._ring_rule(conditions, low, high, sections)
            total += (self.at_angles(conditions, angles) * weights).sum(-1)
        return total

    def _ring_rule(
        self, conditions: Conditions, low: Floats, high: Floats, sections: int
    ) -> tuple[Floats, Floats]:
        """Polar angles and weights of the Gauss points between two angles of one half,
        each of shape (n,): two arrays of shape (n, points)."""
        count = len(conditions.speed)
        rows = np.repeat(np.arange(count), sections)
        begin = np.tile(np.arange(sections) / sections, count)
        spin = STONE.R * conditions.omega
        columns = [part[rows] for part in (conditions.speed, spin, low, high)]
        rule = _in_parts(self._rule, [*columns, begin, begin + 1 / sections], _ROWS)
        angles, weights = rule.swapaxes(0, 1).reshape(2, count, -1)
        return angles, weights


def _in_parts(program: Any, columns: Sequence[Any], size: int) -> Floats:
    """Results of a compiled program for rows of columns, a part of one size at a time,
    so that it is compiled once: first axis along the rows."""
    count = len(columns[0])
    parts = []
    for first in range(0, count, size):
        # the last row fills the last part
        rows = np.minimum(np.arange(first, first + size), count - 1)
        results = program(*(column[rows] for column in columns))
        parts.append(np.asarray(results)[: count - first])
    return np.concatenate(parts)


def _section_rule(v: Any, u: Any, low: Any, high: Any, begin: Any, end: Any) -> Any:
    """Polar angles and weights of the Gauss points in a section between two angles of
    one half: shape (2, points)."""
    import jax.numpy as jnp

    from curlfit.numerics import ring_nodes

    clustering = ring_nodes.node_clustering(v, u)
    side = clustering.side
    sign = jnp.where(low + high > 0, 1.0, -1.0)  # of the half
    at_low = ring_nodes.half_angle(sign * low, side)
    at_high = ring_nodes.half_angle(sign * high, side)
    # half angles may decrease with the polar angle
    ends = (jnp.minimum(at_low, at_high), jnp.maximum(at_low, at_high))
    nodes = ring_nodes.nodes_between(ends, clustering, (begin, end))
    angles = ring_nodes.polar_angle(nodes.half_angle, (1 + sign) / 2, side)
    return jnp.stack([angles, nodes.weight * ring_nodes.GAUSS_WEIGHTS])


def _at_point(law: type[LocalLaw], coefficients: Any, *at: Any) -> Any:
    """Force to the right, forward and moment per unit of the mean load."""
    import jax.numpy as jnp

    speed, omega, turned, time, p, q, alpha = at
    point = ring_points(alpha, speed, STONE.R * omega, turned, time, array=jnp)
    load = 1 + p * point.xi + q * point.eta  # eq. 9
    across, along = law.from_vector(coefficients).traction(point._replace(load=load))
    right = load * across
    forward = load * along
    moment = point.xi * forward - point.eta * right  # eq. 2
    return jnp.stack([right, forward, moment])


def _of_stone(law: type[NetLaw], coefficients: Any, *at: Any) -> Any:
    """Accelerations, that of the rotation at the radius of gyration."""
    import jax.numpy as jnp

    speed, omega, turned, time, *_ = at
    friction = law.from_vector(coefficients)
    right, forward, angular = friction.accelerations(
        Motion(speed, omega, turned, time), STONE
    )
    return jnp.stack([right + 0.0 * speed, forward, STONE.rho * angular])
