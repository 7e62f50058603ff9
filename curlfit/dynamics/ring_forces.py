"""Net friction of the contact ring, and its derivatives, under a law or a member
of a family.

The laws of a family share what does not depend on the law: the means or the points of
the ring, and how these change with its motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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
            return lambda *inputs: function(
                law, inputs[1 : 1 + len(law.coefficients())]
            )

        member = jax.lax.stop_gradient(self.coefficients[0]).astype(int).reshape(-1)[0]
        return jax.lax.switch(
            _common(member), [*map(branch, self.laws)], *self.coefficients
        )


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

    def forces(law: type[LocalLaw], own: Values) -> RingForces:
        return forces_of(
            law.from_vector(own), contact.load, contact.motion, ring, contact.lever
        )

    found: RingForces = contact.of_law(forces)
    return found


def ring_slopes(contact: Contact, tilt: Tilt, wanted: Iterable[int]) -> list[Slopes]:
    """Derivatives of the net friction under a given load with respect to
    inputs, by number."""
    k = len(contact.coefficients)
    # the index of the member is not a variable
    first = int(issubclass(contact.kind, LawFamily))
    moving = tuple(number for number in wanted if number in (k, k + 1))
    own = tuple(number for number in wanted if number >= first and number not in moving)
    groups = [group for group in (own, moving) if group]
    if contact.is_summed and contact.motion.v.size > 1:
        # Most inputs enter only a small part; for a single motion, groups make a
        # smaller program.
        groups = [(number,) for group in groups for number in group]
    ring = contact.ring()
    place = contact.motion.v, contact.motion.u

    def directions(group: tuple[int, ...]) -> Values:
        """Unit directions in the speed of the centre and in that of rotation."""
        return tuple(part[np.array(group) - k] for part in _each(place))

    changes = {
        group: _along(
            lambda v, u: contact.ring(v=v, u=u).sliding, place, directions(group)
        )
        for group in groups
        if group[0] in moving
    }

    def rows(
        law: type[LocalLaw], coefficients: Values, group: tuple[int, ...]
    ) -> Values:
        def force(one: LocalLaw, motion: RingMotion, ring: Ring = ring) -> Values:
            return force_under(one, contact.load, motion, ring, tilt)

        if group not in changes:
            return _own_rows(contact, law, coefficients, group, force)

        def moved(sliding: Any, v: Array, u: Array) -> Values:
            motion = contact.motion._replace(v=v, u=u)
            return force(
                law.from_vector(coefficients), motion, ring.with_sliding(sliding)
            )

        changed = changes[group], *directions(group)
        found: Values = _along(moved, (ring.sliding, *place), changed)
        return found

    def all_rows(law: type[LocalLaw], coefficients: Values) -> list[Values]:
        return [rows(law, coefficients, group) for group in groups]

    return list(map(Slopes, groups, contact.of_law(all_rows)))


def _own_rows(
    contact: Contact,
    law: type[LocalLaw],
    coefficients: Values,
    numbers: tuple[int, ...],
    force: Callable[[LocalLaw, RingMotion], Values],
) -> Values:
    """Derivatives with respect to inputs of a law, by number; 0 for
    coefficients it lacks."""
    first, k = int(issubclass(contact.kind, LawFamily)), len(contact.coefficients)
    count = len(coefficients)
    places = [
        number - first if number < k else number - k + count for number in numbers
    ]
    known = [
        number >= k or place < count
        for number, place in zip(numbers, places, strict=True)
    ]
    own = [place for place, is_known in zip(places, known, strict=True) if is_known]
    everything = (*coefficients, *contact.motion)

    def of_values(*values: Array) -> Values:
        moved = list(everything)
        for place, value in zip(own, values, strict=True):
            moved[place] = value
        return force(law.from_vector(moved), RingMotion(*moved[count:]))

    inputs = tuple(everything[place] for place in own)
    rows: Values = (contact.zeros(0),) * 3
    if own:
        rows = _along(of_values, inputs, _each(inputs))
    if all(known):
        return rows
    lacking, missing = known.index(False), known.count(False)

    def with_zeros(part: Array) -> Array:
        return jnp.concatenate([part[:lacking], contact.zeros(missing), part[lacking:]])

    return tuple(map(with_zeros, rows))


def _along(
    function: Callable[..., Any], inputs: tuple[Any, ...], directions: tuple[Any, ...]
) -> Any:
    """Derivatives along directions, one for each element of the first axis."""
    return jax.vmap(lambda *direction: jax.jvp(function, inputs, direction)[1])(
        *directions
    )


def _each(inputs: Values) -> Values:
    """Unit directions, one for each of several inputs."""
    count = len(inputs)
    basis = np.eye(count).reshape(count, count, *(1 for _ in jnp.shape(inputs[0])))
    return tuple(
        jnp.broadcast_to(basis[:, column], (count, *jnp.shape(value)))
        for column, value in enumerate(inputs)
    )
