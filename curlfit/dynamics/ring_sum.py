"""The sum over the contact ring of the friction of one law (eq. 2).

In closed form where the law is a polynomial in the position on the ring
(`ring_polynomials`), by Gauss quadrature otherwise (`quadrature`).

Under a consistent load `n/n0 = 1 + p xi + q eta` (eq. 9) the force is linear in p and
q, so that it follows from the forces under the loads 1, xi and eta. For a law that
itself depends on the load, these are the forces of the tangent at the balance, which
has the same value and first derivatives there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from curlfit.dynamics.elliptic import mean_directions, mean_velocities
from curlfit.dynamics.law_structure import (
    depends_on_load,
    example_law,
    has_edges,
    is_mirror_symmetric,
)
from curlfit.dynamics.quadrature import (
    Panel,
    angle_before_edges,
    panels,
    parts_beyond_edges,
)
from curlfit.dynamics.ring_polynomials import (
    ETA,
    XI,
    Force,
    Powers,
    at_points,
    has_closed_form,
    mean,
    mean_of_half,
    traction,
)
from curlfit.friction import Load, LocalLaw
from curlfit.friction.sums import Sum
from curlfit.numerics.ring_nodes import GAUSS_WEIGHTS, NodeClustering

_BALANCE_TOLERANCE = 1e-9  # change of the tilt by the last Newton step
_MAX_NEWTON_STEPS = 30
_MIN_LOAD = 1e-6  # smallest load passed to a law, relative to the uniform load
_SLIDING = ("slide_xi", "slide_eta", "speed", "e_xi", "e_eta", "v", "u")

Values = tuple[Array, ...]
RingForces = tuple[Values, ...]
"""Force over m g to the right and forward and moment over m g R, under the load 1 and,
where the load is consistent, under the loads xi and eta"""

Tilt = tuple[Array, Array] | None
"""(p, q) of a load; None for a uniform one"""


class RingMotion(NamedTuple):
    """What friction on the ring depends on besides the law."""

    v: Array
    """speed of the centre, m/s"""
    u: Array
    """R omega, m/s"""
    turned: Array
    """angle turned since release, rad"""
    time: Array
    """since release, s"""


class Ring(NamedTuple):
    """What several laws have in common for a ring in motion."""

    clustering: NodeClustering
    means: Any
    """of the directions and velocities of sliding, for laws in closed form"""
    panels: list[Panel]
    """for laws without edges that are summed over points"""

    @classmethod
    def of(
        cls,
        laws: Iterable[type[LocalLaw]],
        load: Load,
        motion: RingMotion,
        clustering: NodeClustering,
    ) -> Ring:
        """The front half suffices if the back half mirrors it for all laws
        that are summed."""
        terms = [term for law in laws for term in _terms(law, load)]
        summed = [term for term in terms if not has_closed_form(term, load)]
        without_edges = [term for term in summed if not has_edges(term)]
        means = None
        if len(summed) < len(terms):
            directions = mean_directions(motion.v, motion.u)
            means = directions, mean_velocities(motion.v, motion.u)
        shared_panels = []
        if without_edges:
            mirrored = all(is_mirror_symmetric(term, load) for term in without_edges)
            halves = (1.0,) if mirrored else (1.0, 0.0)
            # The points are the same under any law without edges.
            law = example_law(without_edges[0])
            shared_panels = panels(law, *motion, clustering, halves=halves)
        return cls(clustering, means, shared_panels)

    @property
    def sliding(self) -> Any:
        """What depends on the motion of the ring."""
        return self.means, [
            {name: getattr(panel.points, name) for name in _SLIDING}
            for panel in self.panels
        ]

    def with_sliding(self, sliding: Any) -> Ring:
        """The ring in another motion."""
        means, sliding_of_panels = sliding
        moved = [
            panel._replace(points=panel.points._replace(**fields))
            for panel, fields in zip(self.panels, sliding_of_panels, strict=True)
        ]
        return self._replace(means=means, panels=moved)

    def panels_of(self, law: LocalLaw, motion: RingMotion) -> list[Panel]:
        """The panels of a law, after an angle turned and a time."""
        if has_edges(type(law)):
            return panels(law, *motion, self.clustering)
        return [
            panel._replace(
                points=panel.points._replace(turned=motion.turned, time=motion.time)
            )
            for panel in self.panels
        ]


def _terms(law: type[LocalLaw], load: Load) -> tuple[type[LocalLaw], ...]:
    """The laws that are summed over the ring each in its own way: the parts of a sum
    without a closed form, or the law itself."""
    # A consistent load balances all parts together.
    if issubclass(law, Sum) and load == Load.UNIFORM and not has_closed_form(law, load):
        return law.parts
    return (law,)


def forces_of(
    law: LocalLaw, load: Load, motion: RingMotion, ring: Ring, lever: Array
) -> RingForces:
    """Net friction of a law; `lever` is 2 h/R, by which a force tilts the
    load (eq. 8)."""
    if has_closed_form(type(law), load):
        total = partial(_total, _parts_in_closed_form(law, load, motion, ring), motion)
        if load == Load.UNIFORM:
            return (total(1.0),)
        return total(1.0), total(XI, constant=False), total(ETA, constant=False)
    if load == Load.UNIFORM:
        return (force_under(law, load, motion, ring, None),)
    ring_panels = ring.panels_of(law, motion)
    if depends_on_load(law, ring_panels[0].points):
        return _about_balance(law, ring_panels, lever)
    under_xi = [Panel(points, weight * points.xi) for points, weight in ring_panels]
    under_eta = [Panel(points, weight * points.eta) for points, weight in ring_panels]
    return _moments(law, ring_panels), _moments(law, under_xi), _moments(law, under_eta)


def force_under(
    law: LocalLaw, load: Load, motion: RingMotion, ring: Ring, tilt: Tilt
) -> Values:
    """Net friction of a law under one load."""
    if has_closed_form(type(law), load):
        tilted = 1.0 if tilt is None else 1 + tilt[0] * XI + tilt[1] * ETA
        return _total(_parts_in_closed_form(law, load, motion, ring), motion, tilted)
    if isinstance(law, Sum) and load == Load.UNIFORM:
        forces = [force_under(term, load, motion, ring, tilt) for term in law.terms]
        return tuple(
            sum(components, start=jnp.zeros_like(motion.v))
            for components in zip(*forces, strict=True)
        )
    return _by_quadrature(law, load, ring.panels_of(law, motion), tilt)


class _Part(NamedTuple):
    """A part of the ring: the force at its points, and the means of terms over it."""

    force: Force
    mean_of_term: Callable[[Powers], Array]


def _parts_in_closed_form(
    law: LocalLaw, load: Load, motion: RingMotion, ring: Ring
) -> list[_Part]:
    """The force before the first edge of a law is summed over the whole of each half in
    closed form, and its change beyond the edges by quadrature."""
    v, u, turned, time = motion
    parts = []
    for front in (1.0, 0.0):
        half = law, turned, ring.clustering, front
        angle = None
        beyond = []
        if has_edges(type(law)):
            angle = angle_before_edges(*half)
            beyond = parts_beyond_edges(*half, v, u, time)
        across_before, along_before = traction(law, load, front, angle, motion)
        over_half = partial(mean_of_half, ring.means, front)
        parts.append(_Part(Force.of(across_before, along_before), over_half))
        for angle, panel in beyond:
            across, along = traction(law, load, front, angle, motion)
            change = Force.of(across - across_before, along - along_before)
            parts.append(_Part(change, partial(_mean_of_panel, panel)))
    return parts


def _total(
    parts: list[_Part], motion: RingMotion, tilted: Any, *, constant: bool = True
) -> Values:
    """Force and moment; `tilted` is the load, with `constant` as in `Force.under`."""
    forces = [part.force.under(tilted, constant) for part in parts]
    components = []
    for row in range(len(Force._fields)):
        component = jnp.zeros_like(motion.v)
        for part, force in zip(parts, forces, strict=True):
            component = component + mean(force[row], part.mean_of_term)
        components.append(component)
    return tuple(components)


def _mean_of_panel(panel: Panel, powers: Powers) -> Array:
    """Mean of a term over a part of the ring, by quadrature."""
    densities = panel.weight * at_points(panel.points, powers)
    return jnp.tensordot(GAUSS_WEIGHTS, densities, 1)


def _by_quadrature(law: LocalLaw, load: Load, ring: list[Panel], tilt: Tilt) -> Values:
    """Forces by quadrature under one load."""
    if is_mirror_symmetric(type(law), load):
        # The transverse forces of the two halves cancel.
        _, t_eta, moment = _moments(law, ring[:1])
        return jnp.zeros_like(t_eta), 2 * t_eta, 2 * moment
    if tilt is None:
        return _moments(law, ring)
    p, q = tilt
    loaded = []
    for points, weight in ring:
        tilted = 1 + p * points.xi + q * points.eta
        # A trial load may be negative, for which a law need not be defined.
        law_load = jnp.maximum(tilted, _MIN_LOAD)
        loaded.append(Panel(points._replace(load=law_load), weight * tilted))
    return _moments(law, loaded)


def _moments(law: LocalLaw, ring: list[Panel]) -> Values:
    """Force and moment of the tractions at the points, with their weights (eq. 2)."""
    t_xi = t_eta = moment = 0.0
    for points, weight in ring:
        across, along = law.traction(points)
        force_xi = weight * across
        force_eta = weight * along
        t_xi += force_xi
        t_eta += force_eta
        moment += points.xi * force_eta - points.eta * force_xi
    return tuple(
        jnp.tensordot(GAUSS_WEIGHTS, density, 1) for density in (t_xi, t_eta, moment)
    )


def _about_balance(law: LocalLaw, ring: list[Panel], lever: Array) -> RingForces:
    """Forces of the tangent at the balance, for a law that depends on the load; NaN
    where Newton's method finds no balance.

    The balance is differentiated as an implicit function: by the tangent's derivatives
    at the balance, not through the iterations.
    """
    leaves, tree = jax.tree.flatten((law, ring))
    # A function with a derivative of its own takes what it depends on as arguments.
    changing = [number for number, leaf in enumerate(leaves) if isinstance(leaf, Array)]

    def tangent(arrays: list[Array], tilt: Array) -> RingForces:
        """The tangent at a tilt, as forces under the loads 1, xi and eta."""
        replaced = list(leaves)
        for number, array in zip(changing, arrays, strict=True):
            replaced[number] = array
        law, ring = jax.tree.unflatten(tree, replaced)

        def force(tilt: Array) -> Array:
            p_and_q = (tilt[0], tilt[1])
            return jnp.stack(_by_quadrature(law, Load.CONSISTENT, ring, p_and_q))

        ones = jnp.ones_like(tilt[0])
        zeros = jnp.zeros_like(tilt[0])
        value, slope = jax.linearize(force, tilt)
        by_p = slope(jnp.stack([ones, zeros]))
        by_q = slope(jnp.stack([zeros, ones]))
        return tuple(value - tilt[0] * by_p - tilt[1] * by_q), tuple(by_p), tuple(by_q)

    @jax.custom_jvp
    def balanced(arrays: list[Array], lever: Array) -> RingForces:
        def iterate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            tilt, _, _, count = carry
            forces = tangent(arrays, tilt)
            # an iterate may exceed any admissible load
            after = _solved_tilt(forces, lever)
            change = jnp.abs(after - tilt).max(0)
            return after, forces, change, count + 1

        def unbalanced(carry: tuple[Any, ...]) -> Array:
            *_, change, count = carry
            return (change > _BALANCE_TOLERANCE).any() & (count < _MAX_NEWTON_STEPS)

        zeros = jnp.zeros_like(lever)
        no_tilt = jnp.stack([zeros, zeros])
        no_forces = ((zeros,) * 3,) * 3
        start = (no_tilt, no_forces, zeros + jnp.inf, jnp.zeros((), int))
        _, forces, change, _ = jax.lax.while_loop(unbalanced, iterate, start)
        # The error is the square of this change.
        not_found = ~(change <= _BALANCE_TOLERANCE)
        return jax.tree.map(lambda part: jnp.where(not_found, jnp.nan, part), forces)

    @balanced.defjvp
    def _(
        primals: tuple[Any, Any], tangents: tuple[Any, Any]
    ) -> tuple[RingForces, RingForces]:
        arrays, lever = primals
        d_arrays, d_lever = tangents
        forces = balanced(arrays, lever)
        tilt = balanced_tilt(forces, lever)

        def at_balance(arrays: list[Array]) -> RingForces:
            return tangent(arrays, tilt)

        at_fixed_tilt = jax.jvp(at_balance, (arrays,), (d_arrays,))[1]
        d_tilt = jax.jvp(balanced_tilt, (forces, lever), (at_fixed_tilt, d_lever))[1]
        return forces, jax.jvp(tangent, (arrays, tilt), (d_arrays, d_tilt))[1]

    forces: RingForces = balanced([leaves[number] for number in changing], lever)
    return forces


def balanced_tilt(forces: RingForces, lever: Array) -> Array:
    """The consistent load (eq. 8-9) as (p, q); NaN where it would be
    negative somewhere.

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`.
    """
    tilt = _solved_tilt(forces, lever)
    return jnp.where((tilt**2).sum(0) <= 1, tilt, jnp.nan)


def _solved_tilt(forces: RingForces, lever: Array) -> Array:
    """Solution of eq. 8, (p, q) = -lever (T_xi, T_eta), with forces that are linear in
    p and q: a p + b q = -f, c p + d q = -g, by Cramer's rule."""
    constant, by_p, by_q = forces
    f = lever * constant[0]
    g = lever * constant[1]
    a = 1 + lever * by_p[0]
    b = lever * by_q[0]
    c = lever * by_p[1]
    d = 1 + lever * by_q[1]
    return -jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)
