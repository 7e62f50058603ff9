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
        R = self.stone.R
        motion = RingMotion(self.v, R * self.omega, self.turned, self.time)
        lever = 2 * self.stone.h / R + jnp.zeros_like(self.v)
        return Contact(kind, load, self.coefficients, motion, clustering, lever)


def accelerations_under(forces: RingForces, stone: Stone) -> Accelerations:
    """Accelerations due to the forces of a ring (eq. 1); NaN where no load with n >= 0
    balances them."""
    net = forces[0]
    if len(forces) > 1:
        p, q = balanced_tilt(forces, jnp.asarray(2 * stone.h / stone.R))
        # eq. 9: the load is 1 + p xi + q eta
        net = tuple(
            constant + p * by_xi + q * by_eta
            for constant, by_xi, by_eta in zip(*forces, strict=True)
        )
    t_xi, t_eta, moment = net
    return Accelerations(
        GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2
    )


def _of_net_law(kind: type[NetLaw], inputs: _Inputs) -> Accelerations:
    v = inputs.v
    # Any speed will do where the stone is at rest, but zero, at which a law, and thus a
    # derivative, may be infinite.
    speed = jnp.where(v > 0, v, 1.0)
    motion = Motion(speed, inputs.omega, inputs.turned, inputs.time)
    law = kind.from_vector(inputs.coefficients)
    of_moving_stone = law.accelerations(motion, inputs.stone)
    return Accelerations(*(jnp.where(v > 0, part, 0.0) for part in of_moving_stone))


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
    change_of_ring = _change_of_ring(kind, inputs, change)
    contact = inputs.contact(kind, load, clustering)
    forces = ring_forces(contact)
    tilt = None if load == Load.UNIFORM else tuple(balanced_tilt(forces, contact.lever))
    out, total = _along(partial(accelerations_under, forces), stone, change.stone)

    def with_load(constant: Values) -> Accelerations:
        return accelerations_under((constant, *forces[1:]), stone)

    def effect_of(force_change: Values) -> Accelerations:
        """Effect of a change of the forces at fixed load, to which the load
        then responds."""
        effect: Accelerations = jax.jvp(with_load, (forces[0],), (force_change,))[1]
        return effect

    for group in ring_slopes(contact, tilt, change_of_ring):
        effects = jax.vmap(effect_of)(group.values)
        for number, *slope in zip(group.inputs, *effects, strict=True):
            if number in change_of_ring:
                step = change_of_ring[number]
                parts = zip(total, slope, strict=True)
                total = Accelerations(*(part + by * step for part, by in parts))
    return out, total


def _change_of_ring(
    kind: type[Law], inputs: _Inputs, change: _Inputs
) -> dict[int, Any]:
    """Tangents of the ring's inputs by their number, without those that are zero or
    that friction does not depend on.

    Inputs are numbered as in `ring_forces.Slopes`: the coefficients, then v, R omega,
    angle turned and time.
    """
    stone = inputs.stone
    # the product rule for R omega
    terms = []
    if not _is_zero(change.omega):
        terms.append(stone.R * change.omega)
    if not _is_zero(change.stone.R):
        terms.append(inputs.omega * change.stone.R)
    spin = sum(terms) if terms else change.omega
    tangents: list[Any] = [*change.coefficients, change.v, spin]
    laws = kind.members if issubclass(kind, LawFamily) else (kind,)
    dependences = [depends_on_turned_and_time(example_law(law), stone) for law in laws]
    number_of_turned = len(tangents)
    by_number = dict(enumerate(tangents))
    if any(on_turned for on_turned, _ in dependences):
        by_number[number_of_turned] = change.turned
    if any(on_time for _, on_time in dependences):
        by_number[number_of_turned + 1] = change.time
    return {number: part for number, part in by_number.items() if not _is_zero(part)}


def _is_zero(tangent: Any) -> bool:
    return isinstance(tangent, SymbolicZero)


def _along(
    function: Callable[[Any], Accelerations], inputs: Any, change: Any
) -> tuple[Accelerations, Accelerations]:
    """A function and its derivative along a direction that may be zero in
    some inputs."""
    leaves, tree = jax.tree.flatten(inputs)
    tangents = jax.tree.leaves(change, is_leaf=_is_zero)
    varying = [number for number, part in enumerate(tangents) if not _is_zero(part)]

    def of_varying(*values: Array) -> Accelerations:
        moved = list(leaves)
        for number, value in zip(varying, values, strict=True):
            moved[number] = value
        return function(jax.tree.unflatten(tree, moved))

    if not varying:
        out = of_varying()
        return out, Accelerations(*map(jnp.zeros_like, out))
    primals = tuple(leaves[number] for number in varying)
    directions = tuple(tangents[number] for number in varying)
    pair: tuple[Accelerations, Accelerations] = jax.jvp(of_varying, primals, directions)
    return pair


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
    inputs = _float_inputs(law, stone, v, omega, turned, time)
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
    inputs = _float_inputs(law, stone, v, omega, turned, 0.0)
    clustering = node_clustering(inputs.v, inputs.stone.R * inputs.omega)
    return inputs.contact(type(law), load, clustering)


def _float_inputs(law: Law, stone: Stone, *motion: ArrayLike) -> _Inputs:
    """Inputs as arrays of floats; `motion` is (v, omega, turned, time)."""
    numbers = (tuple(jax.tree.leaves(law)), stone, *motion)
    arrays = jax.tree.map(lambda value: jnp.asarray(value, float), numbers)
    return _Inputs(*arrays)
