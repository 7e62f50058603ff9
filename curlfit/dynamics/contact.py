"""The contact ring: from a friction law at a point to the acceleration of the stone.

The forces of the ring (`ring_forces`) are taken under a uniform load, or under the
dynamically consistent load that balances them (eq. 8-9).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.typing import ArrayLike

from curlfit.dynamics.law_structure import depends_on_turned_and_time, example_law
from curlfit.dynamics.ring_forces import Contact, ring_forces, ring_slopes
from curlfit.dynamics.ring_sum import RingForces, RingMotion, Values, balanced_tilt
from curlfit.friction import Law, Load, LocalLaw, Motion, NetLaw
from curlfit.friction.family import LawFamily
from curlfit.numerics.ring_nodes import NodeClustering, node_clustering
from curlfit.stone import GRAVITY, Stone


class Accelerations(NamedTuple):
    """Acceleration of the stone in the moving frame (eq. 1, per unit mass
    and inertia)."""

    xi: Array
    """to the right of the motion, m/s^2"""
    eta: Array
    """along the motion, m/s^2"""
    angular: Array
    """counter-clockwise, rad/s^2"""


class _Inputs(NamedTuple):
    """What accelerations depend on: numbers, or arrays of one shape."""

    coefficients: tuple[Array, ...]
    stone: Stone
    v: Array
    omega: Array
    turned: Array
    time: Array

    def contact(
        self, kind: type[Law], load: Load, clustering: NodeClustering
    ) -> Contact:
        """The ring, with all that its friction depends on."""
        R, h = self.stone.R, self.stone.h
        motion = RingMotion(self.v, R * self.omega, self.turned, self.time)
        lever = 2 * h / R + jnp.zeros_like(self.v)
        return Contact(kind, load, self.coefficients, motion, clustering, lever)


def accelerations_under(forces: RingForces, stone: Stone) -> Accelerations:
    """Accelerations due to the forces of a ring; NaN where no load with n >= 0
    balances them."""
    t_xi, t_eta, moment = forces[0]
    if len(forces) > 1:
        p, q = balanced_tilt(forces, jnp.asarray(2 * stone.h / stone.R))
        t_xi, t_eta, moment = (
            one + p * xi + q * eta for one, xi, eta in zip(*forces, strict=True)
        )
    return Accelerations(
        GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2
    )


def _of_net_law(kind: type[NetLaw], inputs: _Inputs) -> Accelerations:
    v, omega, turned, time = inputs[2:]
    law = kind.from_vector(inputs.coefficients)
    motion = Motion(jnp.where(v > 0, v, 1.0), omega, turned, time)
    found = law.accelerations(motion, inputs.stone)
    return Accelerations(*(jnp.where(v > 0, value, 0.0) for value in found))


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _accelerations(
    kind: type[Law], load: Load, inputs: _Inputs, clustering: NodeClustering
) -> Accelerations:
    if issubclass(kind, NetLaw):
        return _of_net_law(kind, inputs)
    return accelerations_under(
        ring_forces(inputs.contact(kind, load, clustering)), inputs.stone
    )


def _accelerations_jvp(
    kind: type[Law], load: Load, primals: tuple[Any, Any], tangents: tuple[Any, Any]
) -> tuple[Accelerations, Accelerations]:
    """The derivative with respect to each input is computed once, for any number
    of directions."""
    inputs, clustering = primals
    change, _ = tangents
    if issubclass(kind, NetLaw):
        return _along(partial(_of_net_law, kind), inputs, change)
    stone: Stone = inputs.stone
    of_stone, of_ring = _ring_change(kind, inputs, change)
    contact = inputs.contact(kind, load, clustering)
    forces = ring_forces(contact)
    tilt = None if load == Load.UNIFORM else tuple(balanced_tilt(forces, contact.lever))
    out, total = _along(partial(accelerations_under, forces), stone, of_stone)

    def under_load(change: Values) -> Accelerations:
        """Effect of a change of the forces at fixed load, to which the load
        then responds."""

        def at(constant: Values) -> Accelerations:
            return accelerations_under((constant, *forces[1:]), stone)

        found: Accelerations = jax.jvp(at, (forces[0],), (change,))[1]
        return found

    for group in ring_slopes(contact, tilt, of_ring):
        rows = jax.vmap(under_load)(group.values)
        for number, *row in zip(group.inputs, *rows, strict=True):
            if number in of_ring:
                direction = of_ring[number]
                terms = zip(total, row, strict=True)
                total = Accelerations(
                    *(sum_ + part * direction for sum_, part in terms)
                )
    return out, total


def _ring_change(
    kind: type[Law], inputs: _Inputs, change: _Inputs
) -> tuple[Stone, dict[int, Any]]:
    """Tangents of the stone's fields, and of the ring's inputs by their number."""
    numbered: list[Any] = [
        *change.coefficients,
        change.v,
        None,
        change.turned,
        change.time,
    ]
    k = len(change.coefficients)
    spin, radius = change.omega, change.stone.R
    terms = [
        factor * part
        for factor, part in ((inputs.stone.R, spin), (inputs.omega, radius))
        if not _is_zero(part)
    ]
    numbered[k + 1] = sum(terms) if terms else spin
    laws = kind.members if issubclass(kind, LawFamily) else (kind,)
    depends = (
        depends_on_turned_and_time(example_law(law), inputs.stone) for law in laws
    )
    seen = [True] * (k + 2) + [any(flags) for flags in zip(*depends, strict=True)]
    return change.stone, {
        number: part
        for number, part in enumerate(numbered)
        if seen[number] and not _is_zero(part)
    }


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _along(
    function: Callable[[Any], Accelerations], inputs: Any, change: Any
) -> tuple[Accelerations, Accelerations]:
    """A function and its derivative along a direction that may be zero in
    some inputs."""
    leaves, tree = jax.tree.flatten(inputs)
    parts = jax.tree.leaves(change, is_leaf=_is_zero)
    varying = [number for number, part in enumerate(parts) if not _is_zero(part)]

    def restricted(*values: Array) -> Accelerations:
        moved = list(leaves)
        for number, value in zip(varying, values, strict=True):
            moved[number] = value
        return function(jax.tree.unflatten(tree, moved))

    if not varying:
        out = restricted()
        return out, Accelerations(*map(jnp.zeros_like, out))
    primals = tuple(leaves[number] for number in varying)
    found: tuple[Accelerations, Accelerations] = jax.jvp(
        restricted, primals, tuple(parts[number] for number in varying)
    )
    return found


_accelerations.defjvp(_accelerations_jvp, symbolic_zeros=True)


def accelerations(
    law: Law,
    stone: Stone,
    load: Load,
    v: Array,
    omega: Array,
    turned: ArrayLike = 0.0,
    time: ArrayLike = 0.0,
    clustering: NodeClustering | None = None,
) -> Accelerations:
    """Acceleration of a stone that moves at speed `v` and spins at `omega`.

    Parameters
    ----------
    law, stone : the friction law and the stone.
    load : "uniform", or "consistent" (eq. 8-9). A net law has no ring and ignores it.
    v : speed of the centre in m/s, >= 0, of any shape. `v = omega = 0` is allowed
        and gives zero.
    omega : spin in rad/s, either sign, of the same shape.
    turned, time : angle turned in rad and time in s since release.
    clustering : positions of the nodes of the ring; computed if not given.

    Returns
    -------
    Accelerations; NaN where no consistent load with n >= 0 everywhere exists.
    """
    if not isinstance(law, LocalLaw | NetLaw | LawFamily):
        raise TypeError(f"{law!r} is neither a LocalLaw nor a NetLaw")
    inputs = _inputs(law, stone, v, omega, turned, time)
    if clustering is None:
        clustering = node_clustering(inputs.v, inputs.stone.R * inputs.omega)
    return _accelerations(type(law), load, inputs, clustering)


def contact_of(
    law: Law,
    stone: Stone,
    load: Load,
    v: ArrayLike,
    omega: ArrayLike,
    turned: ArrayLike = 0.0,
) -> Contact:
    """The ring of a stone in motion. Arguments as in `accelerations`; not
    for a net law."""
    inputs = _inputs(law, stone, v, omega, turned, 0.0)
    clustering = node_clustering(inputs.v, inputs.stone.R * inputs.omega)
    return inputs.contact(type(law), load, clustering)


def _inputs(law: Law, stone: Stone, *motion: ArrayLike) -> _Inputs:
    given = _Inputs(tuple(jax.tree.leaves(law)), stone, *motion)  # type: ignore[arg-type]
    found: _Inputs = jax.tree.map(lambda value: jnp.asarray(value, float), given)
    return found
