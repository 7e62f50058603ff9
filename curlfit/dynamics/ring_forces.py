"""Net friction of the contact ring, and its derivatives, under a law or a member
of a family.

The laws of a family share what does not depend on the law: the means or the points of
the ring, and how these change with its motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

from curlfit.dynamics.law_structure import has_edges
from curlfit.dynamics.ring_polynomials import has_closed_form
from curlfit.dynamics.ring_sum import (
    Ring,
    RingForces,
    RingMotion,
    Tilt,
    Values,
    force_under,
    forces_of,
)
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.family import LawFamily
from curlfit.numerics.ring_nodes import NodeClustering


class Slopes(NamedTuple):
    """Derivatives of force and moment, one for each of some inputs along
    the first axis."""

    inputs: tuple[int, ...]
    """their numbers: the coefficients, then the fields of the motion"""
    values: Values


class Contact(NamedTuple):
    """A ring in motion under a law, or under a member of a family, and its load."""

    kind: type[Law]
    load: Load
    coefficients: Values
    motion: RingMotion
    clustering: NodeClustering
    """of the nodes, without derivatives"""
    lever: Array
    """2 h/R, by which a force tilts the load (eq. 8)"""

    @property
    def laws(self) -> list[type[LocalLaw]]:
        """The laws that may apply."""
        if issubclass(self.kind, LawFamily):
            return list(self.kind.members)
        assert issubclass(self.kind, LocalLaw)
        return [self.kind]

    @property
    def is_summed(self) -> bool:
        """Whether a single law applies, at least part of which is summed
        over points."""
        law = self.laws[0]
        single = not issubclass(self.kind, LawFamily)
        return single and (has_edges(law) or not has_closed_form(law, self.load))

    def ring(self, **motion: Array) -> Ring:
        """What the laws have in common, in this motion or with some of its
        fields replaced."""
        return Ring.of(
            self.laws, self.load, self.motion._replace(**motion), self.clustering
        )

    def zeros(self, rows: int) -> Array:
        """Rows of zeros for each motion."""
        return jnp.zeros((rows, *self.motion.v.shape))

    def of_law(self, function: Callable[[type[LocalLaw], Values], Any]) -> Any:
        """Result of a function for the law that applies and its own coefficients."""
        if not issubclass(self.kind, LawFamily):
            return function(self.laws[0], self.coefficients)

        def branch(law: type[LocalLaw]) -> Callable[..., Any]:
            count = len(law.coefficients())
            return lambda _index, *values: function(law, values[:count])

        # The index is the first coefficient of a family.
        member = jax.lax.stop_gradient(self.coefficients[0]).astype(int).reshape(-1)[0]
        branches = [branch(law) for law in self.laws]
        return jax.lax.switch(_common(member), branches, *self.coefficients)


@custom_vmap
def _common(index: Array) -> Array:
    """An index that all motions of a batch share; without it `switch` would
    compute all cases."""
    return index


@_common.def_vmap
def _(_size: int, _mapped: list[bool], index: Array) -> tuple[Array, bool]:
    return _common(index[0]), False


def ring_forces(contact: Contact) -> RingForces:
    """Net friction of the ring."""
    ring = contact.ring()

    def forces(law: type[LocalLaw], coefficients: Values) -> RingForces:
        friction = law.from_vector(coefficients)
        return forces_of(friction, contact.load, contact.motion, ring, contact.lever)

    net: RingForces = contact.of_law(forces)
    return net


def ring_slopes(contact: Contact, tilt: Tilt, wanted: Iterable[int]) -> list[Slopes]:
    """Derivatives of the net friction under a given load with respect to
    inputs, by number (see `Slopes`), increasing."""
    k = len(contact.coefficients)
    # the index of the member is not a variable
    first = int(issubclass(contact.kind, LawFamily))
    # Of the inputs, v and u alone change the ring itself, its points or its means.
    of_ring = tuple(number for number in wanted if number in (k, k + 1))
    of_law = tuple(
        number for number in wanted if number >= first and number not in of_ring
    )
    groups = [group for group in (of_law, of_ring) if group]
    if contact.is_summed and contact.motion.v.size > 1:
        # Most inputs enter only a small part; for a single motion, groups make a
        # smaller program.
        groups = [(number,) for group in groups for number in group]
    ring = contact.ring()
    speeds = contact.motion.v, contact.motion.u

    def directions(group: tuple[int, ...]) -> Values:
        """Unit directions in the speed of the centre and in that of rotation."""
        return tuple(part[np.array(group) - k] for part in _unit_directions(speeds))

    # once for all laws of a family
    changes_of_sliding = {
        group: _along(
            lambda v, u: contact.ring(v=v, u=u).sliding, speeds, directions(group)
        )
        for group in groups
        if group[0] in of_ring
    }

    def force(law: LocalLaw, motion: RingMotion, ring: Ring) -> Values:
        return force_under(law, contact.load, motion, ring, tilt)

    def slopes(
        law: type[LocalLaw], coefficients: Values, group: tuple[int, ...]
    ) -> Values:
        if group not in changes_of_sliding:
            on_ring = partial(force, ring=ring)
            return _slopes_on_ring(contact, law, coefficients, group, on_ring)

        def of_sliding(sliding: Any, v: Array, u: Array) -> Values:
            motion = contact.motion._replace(v=v, u=u)
            friction = law.from_vector(coefficients)
            return force(friction, motion, ring.with_sliding(sliding))

        changes = changes_of_sliding[group], *directions(group)
        along: Values = _along(of_sliding, (ring.sliding, *speeds), changes)
        return along

    def all_slopes(law: type[LocalLaw], coefficients: Values) -> list[Values]:
        return [slopes(law, coefficients, group) for group in groups]

    return list(map(Slopes, groups, contact.of_law(all_slopes)))


def _slopes_on_ring(
    contact: Contact,
    law: type[LocalLaw],
    coefficients: Values,
    numbers: tuple[int, ...],
    force: Callable[[LocalLaw, RingMotion], Values],
) -> Values:
    """Derivatives of a force with respect to inputs by number, increasing, while the
    points of the ring stay; 0 for coefficients of a family that the law lacks."""
    first = int(issubclass(contact.kind, LawFamily))
    k = len(contact.coefficients)
    count = len(coefficients)
    inputs = [*coefficients, *contact.motion]
    # indices among these, of the coefficients that the law has and of the motion
    indices = []
    lacking = 0
    for number in numbers:
        if number >= k:
            indices.append(number - k + count)
        elif number - first < count:
            indices.append(number - first)
        else:
            lacking += 1

    def force_at(*values: Array) -> Values:
        moved = list(inputs)
        for index, value in zip(indices, values, strict=True):
            moved[index] = value
        return force(law.from_vector(moved), RingMotion(*moved[count:]))

    slopes: Values = (contact.zeros(0),) * 3
    if indices:
        varied = tuple(inputs[index] for index in indices)
        slopes = _along(force_at, varied, _unit_directions(varied))
    if not lacking:
        return slopes
    # zeros for the coefficients that it lacks, after those that it has
    before = sum(index < count for index in indices)

    def with_zeros(part: Array) -> Array:
        return jnp.concatenate([part[:before], contact.zeros(lacking), part[before:]])

    return tuple(map(with_zeros, slopes))


def _along(
    function: Callable[..., Any], inputs: tuple[Any, ...], directions: tuple[Any, ...]
) -> Any:
    """Derivatives along directions, one for each element of the first axis."""
    return jax.vmap(lambda *direction: jax.jvp(function, inputs, direction)[1])(
        *directions
    )


def _unit_directions(inputs: Values) -> Values:
    """Directions along each of several inputs, which differ on a first axis."""
    count = len(inputs)
    basis = np.eye(count).reshape(count, count, *(1 for _ in jnp.shape(inputs[0])))
    return tuple(
        jnp.broadcast_to(basis[:, column], (count, *jnp.shape(value)))
        for column, value in enumerate(inputs)
    )
