"""Net friction of the contact ring, and its derivatives.

A local law is summed over the ring (eq. 2): in closed form where it is a polynomial of the place on
the ring (`ring_polynomials`), by Gauss quadrature otherwise (`quadrature`).

Under a consistent load `n/n0 = 1 + p xi + q eta` (eq. 9) the force is linear in p and q, so that it
is given by those under the loads 1, xi and eta. Of a law that itself depends on the load they are
those of the tangent at the balance, which has the same value and first derivatives there.

The laws of a family share what does not depend on the law: the means or the points of the ring, and
how these change with its motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

from curlfit.dynamics.law_structure import (
    depends_on_load,
    example_law,
    is_mirror_symmetric,
)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

from curlfit.dynamics import ring_polynomials
from curlfit.dynamics.elliptic import mean_directions, mean_velocities
from curlfit.dynamics.quadrature import GAUSS_WEIGHTS, NodeClustering, Panel, panels
from curlfit.dynamics.ring_polynomials import ETA, XI, Term, terms_of
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.family import LawFamily

_BALANCE_TOLERANCE = 1e-9  # change of the tilt by the last Newton step
_MAX_NEWTON_STEPS = 30
_MIN_LOAD = 1e-6  # over the uniform load, as passed to a law
_SLIDING = ("slide_xi", "slide_eta", "speed", "e_xi", "e_eta")  # fields that depend on v and u

Values = tuple[Array, ...]
Forces = tuple[Values, ...]
"""Force over m g to the right and forward and moment over m g R, under the load 1 and, where the
load is consistent, under the loads xi and eta"""


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


Tilt = tuple[Array, Array] | None
"""(p, q) of a load; None for a uniform one"""


class Slopes(NamedTuple):
    """Derivatives of force and moment by some inputs, one for each element of the first axis."""

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
        """The laws that it may be under."""
        if issubclass(self.kind, LawFamily):
            return list(self.kind.members)
        assert issubclass(self.kind, LocalLaw)
        return [self.kind]

    @property
    def closed(self) -> list[type[LocalLaw]]:
        """Those whose sum over the ring has a closed form."""
        return [law for law in self.laws if terms_of(law, self.load)]

    @property
    def summed(self) -> list[type[LocalLaw]]:
        """The others, which are summed over points."""
        return [law for law in self.laws if not terms_of(law, self.load)]

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the tractions in closed form."""
        return tuple(
            dict.fromkeys(term for law in self.closed for term in terms_of(law, self.load))
        )

    @property
    def loads(self) -> int:
        """How many loads determine the forces."""
        return 1 if self.load == "uniform" else 3

    def zeros(self, *rows: int) -> Array:
        """Zero, or rows of zeros, for each motion."""
        return jnp.zeros((*rows, *self.motion.v.shape))

    def of_law(self, function: Callable[[type[LocalLaw], Values], Any]) -> Any:
        """What a function gives for the law and its own coefficients."""
        if not issubclass(self.kind, LawFamily):
            return function(self.laws[0], self.coefficients)

        def branch(law: type[LocalLaw]) -> Callable[..., Any]:
            return lambda *inputs: function(law, inputs[1 : 1 + len(law.coefficients())])

        member = jax.lax.stop_gradient(self.coefficients[0]).astype(int).reshape(-1)[0]
        return jax.lax.switch(_common(member), [*map(branch, self.laws)], *self.coefficients)


@custom_vmap
def _common(index: Array) -> Array:
    """What all motions of a batch have in common; otherwise a `switch` would compute all cases."""
    return index


@_common.def_vmap
def _(_size: int, _mapped: list[bool], index: Array) -> tuple[Array, bool]:
    return _common(index[0]), False


def ring_forces(contact: Contact) -> Forces:
    """Net friction of the ring."""
    parts = []
    if contact.closed:
        terms = contact.terms

        def coefficients(law: type[LocalLaw], own: Values) -> Values:
            if law not in contact.closed:
                return (contact.zeros(),) * len(terms)
            return _coefficients(law.from_vector(own), contact.motion, contact.load, terms)

        means = _means(contact.motion.v, contact.motion.u)
        form = partial(_in_closed_form, terms, contact.of_law(coefficients), means)
        loads = (1.0, XI, ETA)[: contact.loads]
        parts.append(tuple(form(load, constant=number == 0) for number, load in enumerate(loads)))
    if contact.summed:
        shared = _shared_ring(contact)

        def forces(law: type[LocalLaw], own: Values) -> Forces:
            if law not in contact.summed:
                return ((contact.zeros(),) * 3,) * contact.loads
            one = law.from_vector(own)
            return _sum(one, _ring(one, shared, contact, contact.motion), contact)

        parts.append(contact.of_law(forces))
    return _total(parts)


def ring_slopes(contact: Contact, tilt: Tilt, wanted: Iterable[int]) -> list[Slopes]:
    """Derivatives of the net friction under a given load, by the inputs with some numbers."""
    k = len(contact.coefficients)
    first = int(issubclass(contact.kind, LawFamily))  # which member it is, is no variable
    moving = tuple(number for number in wanted if number in (k, k + 1))
    own = tuple(number for number in wanted if number >= first and number not in moving)
    found = []
    if contact.closed:
        found.append(_slopes_in_closed_form(contact, tilt, own, moving))
    if contact.summed:
        found.append(_slopes_of_sum(contact, tilt, own, moving))
    return [
        Slopes(parts[0].inputs, _total([one.values for one in parts]))
        for parts in zip(*found, strict=True)
    ]


def _total(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *values: sum(values[1:], values[0]), *parts)


def _coefficients(law: LocalLaw, motion: RingMotion, load: Load, terms: tuple[Term, ...]) -> Values:
    """Of the terms of the traction, for each motion."""
    found = ring_polynomials.coefficients(law, load, terms, motion.turned, motion.time)
    return tuple(value + jnp.zeros_like(motion.v) for value in found)


def _in_closed_form(
    terms: tuple[Term, ...], coefficients: Values, means: Any, load: Any, *, constant: bool = True
) -> Values:
    """Linear in the coefficients, and in the means; `load` and `constant` as in `Force.under`."""
    total: Values = (jnp.zeros(()),) * 3
    for front in (1.0, 0.0):
        force = ring_polynomials.force(terms, coefficients, front).under(load, constant=constant)
        parts = (ring_polynomials.mean(part, means, front) for part in force)
        total = tuple(sum_ + part for sum_, part in zip(total, parts, strict=True))
    return total


def _means(v: Array, u: Array) -> Any:
    return mean_directions(v, u), mean_velocities(v, u)


def _slopes_in_closed_form(
    contact: Contact, tilt: Tilt, own: tuple[int, ...], moving: tuple[int, ...]
) -> list[Slopes]:
    terms = contact.terms

    def coefficients_and_rows(law: type[LocalLaw], values: Values) -> tuple[Values, Values]:
        if law not in contact.closed:
            return (contact.zeros(),) * len(terms), (contact.zeros(len(own)),) * len(terms)
        found: tuple[Values, Values] = _OwnInputs.of(contact, law, values, own).derivatives(
            partial(_coefficients, load=contact.load, terms=terms)
        )
        return found

    def form(coefficients: Values, means: Any) -> Values:
        load = 1.0 if tilt is None else 1 + tilt[0] * XI + tilt[1] * ETA
        return _in_closed_form(terms, coefficients, means, load)

    coefficients, rows = contact.of_law(coefficients_and_rows)
    place = contact.motion.v, contact.motion.u
    slopes = []
    if own:
        slopes.append(Slopes(own, jax.vmap(form, (0, None))(rows, _means(*place))))
    if moving:
        _, changes = _along(_means, place, _directions(contact, moving))
        slopes.append(Slopes(moving, jax.vmap(form, (None, 0))(coefficients, changes)))
    return slopes


def _slopes_of_sum(
    contact: Contact, tilt: Tilt, own: tuple[int, ...], moving: tuple[int, ...]
) -> list[Slopes]:
    """By one input after the other, as most enter little of it; of a single motion by several at
    once, which is a smaller program."""
    shared = _shared_ring(contact)
    # Where a law has its edges, these move with all its inputs.
    groups = [own, moving] if shared else [own + moving]
    if contact.motion.v.size > 1 and not issubclass(contact.kind, LawFamily):
        groups = [(number,) for group in groups for number in group]
    groups = [group for group in groups if group]

    def sliding(v: Array, u: Array) -> Any:
        return _sliding(_shared_ring(contact._replace(motion=contact.motion._replace(v=v, u=u))))

    place = contact.motion.v, contact.motion.u
    changes = {
        group: _along(sliding, place, _directions(contact, group))[1]
        for group in groups
        if shared and group[0] in moving
    }

    def rows_of(law: type[LocalLaw], coefficients: Values, group: tuple[int, ...]) -> Values:
        if law not in contact.summed:
            return (contact.zeros(len(group)),) * 3
        if group in changes and not _has_edges(law):
            one = law.from_vector(coefficients)

            def on_moved(fields: Any) -> Values:
                return _under_load(one, _with_sliding(shared, fields), tilt, contact)

            found: Values = _along(on_moved, (_sliding(shared),), (changes[group],))[1]
            return found

        def force(law: LocalLaw, motion: RingMotion) -> Values:
            return _under_load(law, _ring(law, shared, contact, motion), tilt, contact)

        rows: Values
        _, rows = _OwnInputs.of(contact, law, coefficients, group).derivatives(force)
        return rows

    def all_rows(law: type[LocalLaw], coefficients: Values) -> list[Values]:
        return [rows_of(law, coefficients, group) for group in groups]

    return list(map(Slopes, groups, contact.of_law(all_rows)))


def _along(
    function: Callable[..., Any], inputs: tuple[Any, ...], directions: tuple[Any, ...]
) -> tuple[Any, Any]:
    """A function, and its derivatives along directions, one for each element of the first axis."""

    def along(*direction: Any) -> Any:
        return jax.jvp(function, inputs, direction)

    if not inputs:
        return function(), ()
    found: tuple[Any, Any] = jax.vmap(along, out_axes=(None, 0))(*directions)
    return found


def _each(inputs: Values) -> Values:
    """The directions of each of several inputs."""
    count = len(inputs)
    basis = np.eye(count).reshape(count, count, *(1 for _ in jnp.shape(inputs[0] if inputs else 0)))
    return tuple(
        jnp.broadcast_to(basis[:, column], (count, *jnp.shape(value)))
        for column, value in enumerate(inputs)
    )


def _directions(contact: Contact, moving: tuple[int, ...]) -> Values:
    """Those of the speed of the centre, of the speed of rotation, or of both."""
    rows = [number - len(contact.coefficients) for number in moving]
    return tuple(part[np.array(rows)] for part in _each((contact.motion.v, contact.motion.u)))


class _OwnInputs(NamedTuple):
    """Those of a law among inputs with some numbers, all but coefficients that it does not have."""

    values: Values
    law_and_motion: Callable[..., tuple[LocalLaw, RingMotion]]
    """from other values"""
    known: list[bool]
    """which of the inputs it has"""

    @classmethod
    def of(
        cls, contact: Contact, law: type[LocalLaw], coefficients: Values, numbers: tuple[int, ...]
    ) -> _OwnInputs:
        first, k = int(issubclass(contact.kind, LawFamily)), len(contact.coefficients)
        count = len(coefficients)
        places = [number - first if number < k else number - k + count for number in numbers]
        known = [
            number >= k or place < count for number, place in zip(numbers, places, strict=True)
        ]
        own = [place for place, is_known in zip(places, known, strict=True) if is_known]
        everything = (*coefficients, *contact.motion)

        def law_and_motion(*values: Array) -> tuple[LocalLaw, RingMotion]:
            moved = list(everything)
            for place, value in zip(own, values, strict=True):
                moved[place] = value
            return law.from_vector(moved), RingMotion(*moved[count:])

        return cls(tuple(everything[place] for place in own), law_and_motion, known)

    def derivatives(self, function: Callable[[LocalLaw, RingMotion], Values]) -> Any:
        """Of a function of the law and the motion, with its value; 0 by what the law lacks."""
        value, rows = _along(
            lambda *values: function(*self.law_and_motion(*values)), self.values, _each(self.values)
        )
        if all(self.known):
            return value, rows
        first = self.known.index(False)
        missing = self.known.count(False)

        def with_zeros(part: Array) -> Array:
            none = jnp.zeros((missing, *part.shape[1:]))
            return jnp.concatenate([part[:first], none, part[first:]])

        return value, tuple(map(with_zeros, rows))


def _has_edges(law: type[LocalLaw]) -> bool:
    return any(example_law(law).edges(1.0))


def _shared_ring(contact: Contact) -> list[Panel]:
    """The ring of all laws without edges within the halves; empty where there is none.

    Its front half suffices where the back half mirrors it.
    """
    plain = [law for law in contact.summed if not _has_edges(law)]
    if not plain:
        return []
    mirrored = all(is_mirror_symmetric(law, contact.load) for law in plain)
    halves = (1.0,) if mirrored else (1.0, 0.0)
    return panels(example_law(plain[0]), *contact.motion, contact.clustering, halves=halves)


def _ring(law: LocalLaw, shared: list[Panel], contact: Contact, motion: RingMotion) -> list[Panel]:
    """The ring of a law, after another angle turned and time than the shared one."""
    if _has_edges(type(law)):
        return panels(law, *motion, contact.clustering)
    there = {"turned": motion.turned, "time": motion.time}
    return [panel._replace(points=panel.points._replace(**there)) for panel in shared]


def _sliding(ring: list[Panel]) -> list[dict[str, Array]]:
    """What of the points depends on the motion of the ring."""
    return [{name: getattr(panel.points, name) for name in _SLIDING} for panel in ring]


def _with_sliding(ring: list[Panel], sliding: list[dict[str, Array]]) -> list[Panel]:
    return [
        panel._replace(points=panel.points._replace(**fields))
        for panel, fields in zip(ring, sliding, strict=True)
    ]


def _sum(law: LocalLaw, ring: list[Panel], contact: Contact) -> Forces:
    """Forces by quadrature."""
    if contact.load == "uniform":
        return (_under_load(law, ring, None, contact),)
    if depends_on_load(law, ring[0].points):
        return _about_balance(law, ring, contact)
    across, along = (
        [Panel(points, weight * getattr(points, name)) for points, weight in ring]
        for name in ("xi", "eta")
    )
    return _moments(law, ring), _moments(law, across), _moments(law, along)


def _under_load(law: LocalLaw, ring: list[Panel], tilt: Tilt, contact: Contact) -> Values:
    """Forces by quadrature under one load."""
    if is_mirror_symmetric(type(law), contact.load):
        # The transverse forces of the two halves cancel.
        _, t_eta, moment = _moments(law, ring[:1])
        return jnp.zeros_like(t_eta), 2 * t_eta, 2 * moment
    if tilt is None:
        return _moments(law, ring)
    p, q = tilt
    loaded = []
    for points, weight in ring:
        load = 1 + p * points.xi + q * points.eta
        # A trial load may be negative, for which a law need not be defined.
        law_load = jnp.maximum(load, _MIN_LOAD)
        loaded.append(Panel(points._replace(load=law_load), weight * load))
    return _moments(law, loaded)


def _moments(law: LocalLaw, ring: list[Panel]) -> Values:
    """Force and moment of the tractions at the points, with their weights (eq. 2)."""
    t_xi = t_eta = moment = 0.0
    for points, weight in ring:
        along_xi, along_eta = law.traction(points)
        n_xi, n_eta = weight * along_xi, weight * along_eta
        t_xi += n_xi
        t_eta += n_eta
        moment += points.xi * n_eta - points.eta * n_xi
    return tuple(jnp.tensordot(GAUSS_WEIGHTS, density, 1) for density in (t_xi, t_eta, moment))


def _about_balance(law: LocalLaw, ring: list[Panel], contact: Contact) -> Forces:
    """The tangent at the balance; NaN where Newton's method finds none."""
    leaves, tree = jax.tree.flatten((law, ring))
    changing = [number for number, leaf in enumerate(leaves) if isinstance(leaf, Array)]

    def tangent(arrays: list[Array], tilt: Array) -> Forces:
        """As forces under the loads 1, xi and eta."""
        now = list(leaves)
        for number, array in zip(changing, arrays, strict=True):
            now[number] = array
        law, ring = jax.tree.unflatten(tree, now)

        def force(tilt: Array) -> Array:
            return jnp.stack(_under_load(law, ring, (tilt[0], tilt[1]), contact))

        one, zero = jnp.ones_like(tilt[0]), jnp.zeros_like(tilt[0])
        value, slope = jax.linearize(force, tilt)
        by_p, by_q = slope(jnp.stack([one, zero])), slope(jnp.stack([zero, one]))
        return tuple(value - tilt[0] * by_p - tilt[1] * by_q), tuple(by_p), tuple(by_q)

    @jax.custom_jvp
    def balanced(arrays: list[Array], lever: Array) -> Forces:
        def iterate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            tilt, _, _, count = carry
            forces = tangent(arrays, tilt)
            after = _solved_tilt(forces, lever)  # on the way it may be larger than any load's
            return after, forces, jnp.abs(after - tilt).max(0), count + 1

        def unbalanced(carry: tuple[Any, ...]) -> Array:
            *_, change, count = carry
            return (change > _BALANCE_TOLERANCE).any() & (count < _MAX_NEWTON_STEPS)

        none = jnp.zeros_like(lever)
        start = jnp.stack([none, none]), ((none,) * 3,) * 3, none + jnp.inf, jnp.zeros((), int)
        _, forces, change, _ = jax.lax.while_loop(unbalanced, iterate, start)
        # The error is the square of this change.
        unknown = ~(change <= _BALANCE_TOLERANCE)
        return jax.tree.map(lambda part: jnp.where(unknown, jnp.nan, part), forces)

    @balanced.defjvp
    def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Forces, Forces]:
        (arrays, lever), (d_arrays, d_lever) = primals, tangents
        forces = balanced(arrays, lever)
        tilt = balanced_tilt(forces, lever)
        at_fixed_tilt = jax.jvp(lambda arrays: tangent(arrays, tilt), (arrays,), (d_arrays,))[1]
        d_tilt = jax.jvp(balanced_tilt, (forces, lever), (at_fixed_tilt, d_lever))[1]
        return forces, jax.jvp(tangent, (arrays, tilt), (d_arrays, d_tilt))[1]

    found: Forces = balanced([leaves[number] for number in changing], contact.lever)
    return found


def balanced_tilt(forces: Forces, lever: Array) -> Array:
    """The consistent load (eq. 8-9) as (p, q); NaN where it would be negative somewhere.

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`.
    """
    tilt = _solved_tilt(forces, lever)
    return jnp.where((tilt**2).sum(0) <= 1, tilt, jnp.nan)


def _solved_tilt(forces: Forces, lever: Array) -> Array:
    constant, by_p, by_q = forces
    f, g = lever * constant[0], lever * constant[1]
    a, b = 1 + lever * by_p[0], lever * by_q[0]
    c, d = lever * by_p[1], 1 + lever * by_q[1]
    return -jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)
