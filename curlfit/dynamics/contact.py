"""The contact ring: from a law of friction at a point to the acceleration of the stone.

A local law is summed over the ring (eq. 2) under uniform or dynamically consistent load (eq. 8-9):
in closed form where tracing shows that it is linear in the direction of sliding (`elliptic`), by
Gauss quadrature otherwise (`quadrature`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from curlfit.dynamics.law_structure import (
    UNIT_POINT,
    depends_on_load,
    depends_on_turned_and_time,
    example_law,
    is_mirror_symmetric,
    is_piecewise_tensor,
)
from curlfit.friction.family import LawFamily

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jax.typing import ArrayLike

from curlfit.dynamics.elliptic import Means, mean_directions, on_half
from curlfit.dynamics.quadrature import (
    GAUSS_WEIGHTS,
    NodeClustering,
    Panel,
    node_clustering,
    panels,
)
from curlfit.friction import Law, Load, LocalLaw, Motion, NetLaw
from curlfit.stone import GRAVITY, Stone

_BALANCE_TOLERANCE = 1e-9  # imbalance over the weight at which one more Newton step is exact
_MAX_NEWTON_STEPS = 30
_MIN_LOAD = 1e-6  # over the uniform load, as passed to a law
_NO_TILT = (0.0, 0.0)  # of the uniform load


class Accelerations(NamedTuple):
    """Acceleration of the stone in the moving frame (eq. 1, per unit mass and inertia)."""

    xi: Array
    """to the right of the motion, m/s^2"""
    eta: Array
    """along the motion, m/s^2"""
    angular: Array
    """counter-clockwise, rad/s^2"""


class _MirroredRing(NamedTuple):
    """The front half of a ring whose back half is its mirror image."""

    front: Panel


class _ClosedFormRing(NamedTuple):
    """Means over a ring whose friction is linear in the direction of sliding."""

    right: Means
    forward: Means
    turned: Array
    time: Array


_Ring = list[Panel] | _MirroredRing | _ClosedFormRing


def _force(law: LocalLaw, ring: _Ring, tilt: tuple[Any, Any]) -> tuple[Any, ...]:
    """Net force over m g (right, forward) and moment over m g R, under load 1 + p xi + q eta."""
    p, q = tilt
    t_xi = t_eta = moment = 0.0
    if isinstance(ring, _ClosedFormRing):
        for front in (1.0, 0.0):
            right, forward = on_half(ring.right, ring.forward, front)
            if tilt is not _NO_TILT:
                right, forward = right.loaded(p, q), forward.loaded(p, q)
            point = UNIT_POINT._replace(front=front, turned=ring.turned, time=ring.time)
            across = law.traction(point._replace(e_xi=1.0, e_eta=0.0))
            along = law.traction(point._replace(e_xi=0.0, e_eta=1.0))
            t_xi += across[0] * right.one + along[0] * forward.one
            t_eta += across[1] * right.one + along[1] * forward.one
            moment += across[1] * right.xi + along[1] * forward.xi
            moment -= across[0] * right.eta + along[0] * forward.eta
        return t_xi, t_eta, moment
    if isinstance(ring, _MirroredRing):
        # The transverse forces of the two halves cancel.
        _, t_eta, moment = _force(law, [ring.front], tilt)
        return jnp.zeros_like(t_eta), 2 * t_eta, 2 * moment
    for points, weight in ring:
        load = 1 + p * points.xi + q * points.eta
        # A trial load may be negative, for which a law need not be defined.
        law_load = load if tilt is _NO_TILT else jnp.maximum(load, _MIN_LOAD)
        along_xi, along_eta = law.traction(points._replace(load=law_load))
        n_xi, n_eta = weight * load * along_xi, weight * load * along_eta  # eq. 2
        t_xi += n_xi
        t_eta += n_eta
        moment += points.xi * n_eta - points.eta * n_xi
    return tuple(jnp.tensordot(GAUSS_WEIGHTS, density, 1) for density in (t_xi, t_eta, moment))


def _imbalance(law: LocalLaw, ring: _Ring, stone: Stone, tilt: Array) -> Array:
    """How far a load `n/n0 = 1 + p xi + q eta`, given as (p, q), is from balancing the friction.

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`.
    """
    force = _force(law, ring, (tilt[0], tilt[1]))
    return tilt + 2 * stone.h / stone.R * jnp.stack(force[:2])


def _newton_step(jacobian: tuple[Array, Array], value: Array) -> Array:
    """The change of tilt that cancels an imbalance, from the columns of its Jacobian."""
    (a, c), (b, d) = jacobian
    f, g = value
    return jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)


def _balanced_tilt(law: LocalLaw, ring: _Ring, stone: Stone) -> Array:
    """The consistent load (eq. 8-9) as (p, q); NaN where no load that is nowhere negative balances
    the friction."""

    def newton(tilt: Array, system: tuple[LocalLaw, _Ring, Stone]) -> tuple[Array, Array]:
        """The next tilt, and the imbalance of this one."""
        one, zero = jnp.ones_like(tilt[0]), jnp.zeros_like(tilt[0])
        value, slope = jax.linearize(partial(_imbalance, *system), tilt)
        jacobian = slope(jnp.stack([one, zero])), slope(jnp.stack([zero, one]))
        return tilt - _newton_step(jacobian, value), jnp.abs(value).max(0)

    system = (law, ring, stone)
    shape = ring.right.one.shape if isinstance(ring, _ClosedFormRing) else ring[0].weight.shape[1:]
    tilt = jnp.zeros((2, *shape))
    # Where the law does not depend on the load the balance is linear: one step solves it.
    if not isinstance(ring, _ClosedFormRing) and depends_on_load(law, ring[0].points):
        constants = jax.lax.stop_gradient(system)  # the last step has the exact derivative

        def iterate(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            tilt, _, count = carry
            return *newton(tilt, constants), count + 1

        def unbalanced(carry: tuple[Array, Array, Array]) -> Array:
            _, imbalance, count = carry
            return (imbalance > _BALANCE_TOLERANCE).any() & (count < _MAX_NEWTON_STEPS)

        tilt, imbalance, _ = jax.lax.while_loop(
            unbalanced, iterate, (tilt, jnp.full(tilt.shape[1:], jnp.inf), jnp.zeros((), int))
        )
        tilt = jnp.where(imbalance <= _BALANCE_TOLERANCE, tilt, jnp.nan)
    tilt, _ = newton(tilt, system)
    return jnp.where((tilt**2).sum(0) <= 1, tilt, jnp.nan)


_STONE = tuple(Stone.__dataclass_fields__)
_Tilt = tuple[Any, Any]
_Inputs = tuple[Array, ...]  # the law's coefficients, the stone's fields, v, omega, turned, time


def _unpack(kind: type[Law], inputs: _Inputs) -> tuple[Any, ...]:
    k = len(kind.coefficients())
    end = k + len(_STONE)
    stone: Any = Stone(*inputs[k:end])  # type: ignore[arg-type]
    return (kind.from_vector(inputs), stone, *inputs[end:])


def _ring(kind: type[Law], load: Load, inputs: _Inputs, clustering: NodeClustering) -> _Ring | None:
    """The ring at some inputs; None under a law without one."""
    if issubclass(kind, NetLaw):
        return None
    assert issubclass(kind, LocalLaw)
    law, stone, v, omega, turned, time = _unpack(kind, inputs)
    if is_piecewise_tensor(kind, load):
        return _ClosedFormRing(*mean_directions(v, stone.R * omega), turned, time)
    if is_mirror_symmetric(kind, load):
        return _MirroredRing(
            *panels(law, v, stone.R * omega, turned, time, clustering, halves=(1.0,))
        )
    return panels(law, v, stone.R * omega, turned, time, clustering)


def _solve_load(kind: type[Law], load: Load, inputs: _Inputs, ring: _Ring | None) -> _Tilt:
    """The tilt of the load, which is none where the load is uniform or there is no ring."""
    if ring is None or load == "uniform":
        return _NO_TILT
    law, stone, *_ = _unpack(kind, inputs)
    p, q = _balanced_tilt(law, ring, stone)
    return p, q


def _moves_the_ring(kind: type[Law]) -> list[bool]:
    """Which inputs enter the points of the ring, or the means over it."""
    assert issubclass(kind, LocalLaw)
    edges = any(example_law(kind).edges(1.0))
    return [edges] * len(kind.coefficients()) + [name == "R" for name in _STONE] + [True] * 4


def _enter(kind: type[Law], inputs: _Inputs) -> list[bool]:
    """Which inputs enter the accelerations under a given load."""
    law, stone, *_ = _unpack(kind, inputs)
    of_stone = [issubclass(kind, NetLaw) or name in ("R", "rho") for name in _STONE]
    of_law = [True] * len(kind.coefficients())
    return [*of_law, *of_stone, True, True, *depends_on_turned_and_time(law, stone)]


def _accelerations(
    kind: type[Law], inputs: _Inputs, ring: _Ring | None, tilt: _Tilt
) -> tuple[Array, Array, Array]:
    """xi, eta, angular, under a load of a given tilt."""
    law, stone, v, omega, turned, time = _unpack(kind, inputs)
    if isinstance(law, NetLaw):
        net = law.accelerations(Motion(jnp.where(v > 0, v, 1.0), omega, turned, time), stone)
        return tuple(jnp.where(v > 0, value, 0.0) for value in net)  # type: ignore[return-value]
    assert ring is not None
    t_xi, t_eta, moment = _force(law, ring, tilt)
    return GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2


_Slopes = dict[int, tuple[Array, ...]]
"""Derivatives of the accelerations by inputs, by their index"""


def _switch(
    kind: type[LawFamily], of_member: Callable[[type[LocalLaw], _Inputs], Any], inputs: _Inputs
) -> Any:
    """What a function gives for the member of a family and its own inputs."""
    k, size = len(kind.coefficients()), len(inputs)

    def branch(member: type[LocalLaw]) -> Callable[..., Any]:
        own = kind.columns(member, size - k + len(member.coefficients()))
        return lambda *inputs: of_member(member, tuple(inputs[column] for column in own))

    index = jax.lax.stop_gradient(inputs[0]).astype(int)
    return jax.lax.switch(_common(index.reshape(-1)[0]), [*map(branch, kind.members)], *inputs)


@custom_vmap
def _common(index: Array) -> Array:
    """What all motions of a batch have in common; or a `switch` would compute every case."""
    return index


@_common.def_vmap
def _(_size: int, _mapped: list[bool], index: Array) -> tuple[Array, bool]:
    return _common(index[0]), False


def _with_slopes(
    kind: type[Law], load: Load, inputs: _Inputs, clustering: NodeClustering, wanted: list[int]
) -> tuple[tuple[Array, ...], _Slopes]:
    """Accelerations, and their derivatives by those of the wanted inputs on which they depend.

    Of a sum over points by one input after the other, since most enter little of it. Of a closed
    form, and of a single motion, by all at once, which is a smaller program.
    """
    if issubclass(kind, LawFamily):
        return _family_with_slopes(kind, load, inputs, clustering, wanted)
    ring = _ring(kind, load, inputs, clustering)
    tilt = _solve_load(kind, load, inputs, ring)
    balanced = tilt is not _NO_TILT
    everything = (*inputs, *tilt) if balanced else inputs
    count = len(inputs)
    enters = _enter(kind, inputs)
    varying = [index for index in wanted if enters[index]] + list(range(count, len(everything)))
    moves_the_ring = [True] * count if ring is None else [*_moves_the_ring(kind), False, False]

    def at(*values: Array, group: tuple[int, ...] = ()) -> tuple[Array, ...]:
        moved = list(everything)
        for index, value in zip(group, values, strict=True):
            moved[index] = value
        now = tuple(moved[:count])
        moves = bool(group) and moves_the_ring[group[0]]
        same = _ring(kind, load, now, clustering) if moves else ring
        return _accelerations(kind, now, same, (moved[-2], moved[-1]) if balanced else tilt)

    out = None
    slopes: _Slopes = {}
    separate = isinstance(ring, list | _MirroredRing) and inputs[-1].size > 1
    for group in _groups(varying, moves_the_ring, separate=separate):
        out, found = _value_and_derivatives(
            partial(at, group=group), tuple(everything[index] for index in group)
        )
        slopes |= dict(zip(group, found, strict=True))
    out = at() if out is None else out
    return out, _rebalanced(kind, inputs, out, slopes, wanted) if balanced else slopes


def _family_with_slopes(
    kind: type[LawFamily], load: Load, inputs: _Inputs, clustering: NodeClustering,
    wanted: list[int],
) -> tuple[tuple[Array, ...], _Slopes]:  # fmt: skip
    """The same for the member of a family."""
    wanted = wanted[1:] if wanted[0] == 0 else wanted  # which member it is, is no variable

    def of_member(member: type[LocalLaw], own: _Inputs) -> Any:
        columns = kind.columns(member, len(own))
        out, slopes = _with_slopes(
            member,
            load,
            own,
            clustering,
            [i for i, column in enumerate(columns) if column in wanted],
        )
        known = {columns[index]: slope for index, slope in slopes.items()}
        none = tuple(jnp.zeros_like(value) for value in out)
        return out, [known.get(column, none) for column in wanted]

    out, slopes = _switch(kind, of_member, inputs)
    return out, dict(zip(wanted, slopes, strict=True))


def _rebalanced(
    kind: type[Law], inputs: _Inputs, out: tuple[Array, ...], slopes: _Slopes, wanted: list[int]
) -> _Slopes:
    """Derivatives under a load that is consistent with the friction, from those under a given tilt
    and those by the tilt, which are the last two.

    By the implicit function theorem, of the balance `(p, q) + 2 h/(g R) (a_xi, a_eta) = 0` (eq. 8).
    """
    _, stone, *_ = _unpack(kind, inputs)
    k, count = len(kind.coefficients()), len(inputs)
    by_p, by_q = slopes[count], slopes[count + 1]
    over_h = 2 / (GRAVITY * stone.R)
    factor = over_h * stone.h
    of_stone = {
        k + _STONE.index("h"): over_h,
        k + _STONE.index("R"): -factor / stone.R,
    }
    jacobian: Any = (
        (1 + factor * by_p[0], factor * by_p[1]),
        (factor * by_q[0], 1 + factor * by_q[1]),
    )
    found: _Slopes = {}
    for index in wanted:
        direct = slopes.get(index)
        if direct is None and index not in of_stone:
            continue
        direct = tuple(jnp.zeros_like(value) for value in out) if direct is None else direct
        own = of_stone.get(index, 0.0)
        change = [factor * slope + own * value for slope, value in zip(direct, out, strict=True)]
        p, q = -_newton_step(jacobian, jnp.stack(change[:2]))
        found[index] = tuple(
            slope + p * along_p + q * along_q
            for slope, along_p, along_q in zip(direct, by_p, by_q, strict=True)
        )
    return found


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _differentiable(
    kind: type[Law], load: Load, inputs: _Inputs, clustering: NodeClustering
) -> tuple[Array, Array, Array]:
    if issubclass(kind, LawFamily):

        def of_member(member: type[LocalLaw], own: _Inputs) -> Any:
            return _differentiable(member, load, own, clustering)

        found: tuple[Array, Array, Array] = _switch(kind, of_member, inputs)
        return found
    ring = _ring(kind, load, inputs, clustering)
    return _accelerations(kind, inputs, ring, _solve_load(kind, load, inputs, ring))


def _differentiable_jvp(
    kind: type[Law], load: Load, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Any, Any]:
    """The derivative by each input is found once, whatever the number of directions."""
    inputs, clustering = primals
    directions = {
        index: tangent
        for index, tangent in enumerate(tangents[0])
        if not isinstance(tangent, SymbolicZero)
    }
    out, slopes = _with_slopes(kind, load, inputs, clustering, list(directions))
    tangent_out = tuple(jnp.zeros_like(value) for value in out)
    for index, slope in slopes.items():
        tangent_out = tuple(
            total + part * directions[index] for total, part in zip(tangent_out, slope, strict=True)
        )
    return out, tangent_out


def _groups(
    varying: list[int], moves_the_ring: list[bool], *, separate: bool
) -> list[tuple[int, ...]]:
    """Inputs whose derivatives are found together."""
    if separate:
        return [(index,) for index in varying]
    pairs = ([i for i in varying if moves_the_ring[i] is moved] for moved in (False, True))
    return [tuple(group) for group in pairs if group]


def _value_and_derivatives(
    function: Callable[..., tuple[Array, ...]], inputs: tuple[Array, ...]
) -> tuple[tuple[Array, ...], list[tuple[Array, ...]]]:
    """A function, and by each of its inputs the derivatives of all outputs."""
    basis = np.eye(len(inputs))

    def along(direction: Any) -> Any:
        steps = (part + jnp.zeros_like(x) for part, x in zip(direction, inputs, strict=True))
        return jax.jvp(function, inputs, tuple(steps))

    if len(inputs) == 1:
        value, slope = along(basis[0])
        return value, [slope]
    value, slopes = jax.vmap(along, out_axes=(None, 0))(basis)
    return value, [tuple(slope[row] for slope in slopes) for row in range(len(inputs))]


_differentiable.defjvp(_differentiable_jvp, symbolic_zeros=True)


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
    v : speed of the centre in m/s, >= 0, of any shape. `v = omega = 0` is allowed and gives zero.
    omega : spin in rad/s, either sign, of the same shape.
    turned, time : angle turned in rad and time in s since release.
    clustering : positions of the nodes of the ring; computed if not given.

    Returns
    -------
    Accelerations; NaN where no consistent load with n >= 0 everywhere exists.
    """
    if not isinstance(law, LocalLaw | NetLaw | LawFamily):
        raise TypeError(f"{law!r} is neither a LocalLaw nor a NetLaw")
    inputs = tuple(
        jnp.asarray(value, float)
        for value in (*jax.tree.leaves((law, stone)), v, omega, turned, time)
    )
    v, omega = inputs[-4:-2]
    if clustering is None:
        R = inputs[len(law.coefficients()) + 1]
        clustering = node_clustering(v, R * omega)
    return Accelerations(*_differentiable(type(law), load, inputs, clustering))


def consistent_load(
    law: LocalLaw, stone: Stone, v: ArrayLike, omega: ArrayLike, turned: ArrayLike = 0.0
) -> Array:
    """(n1, n2) of eq. 9 times R over n0: the consistent load is `n0 (1 + n1 xi/R + n2 eta/R)`.

    Shape (2,); NaN where no such load with n >= 0 exists. Arguments as in `accelerations`.
    """
    v, omega, turned = (jnp.asarray(value, float) for value in (v, omega, turned))
    ring = panels(law, v, stone.R * omega, turned, jnp.zeros(()))
    return _balanced_tilt(law, ring, stone)
