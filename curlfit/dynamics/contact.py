"""The contact ring: a law of friction at a point becomes acceleration of the stone.

Sums a local law over the ring (eq. 2) under uniform or dynamically consistent load (eq. 8-9): in
closed form where the law is linear in the direction of sliding (see `elliptic.py`), which is found
out by tracing it, by quadrature everywhere else.

Quadrature. With `u = R omega`, the sliding speed at polar angle `alpha` is
`|v(A)|^2 = (v - |u|)^2 cos^2 b + (v + |u|)^2 sin^2 b`, where `b` is half the angle between the
point and the slowest point of the ring. Near `|epsilon| = 1` the slowest point hardly slides and
the direction of friction swings round within an angle of `d = |v - |u||/(v + |u|)`; Gauss nodes
are placed by the sinh transform of near-singular integrals (Johnston and Elliott 2005), which
resolves that swing at any `d` with the same few nodes. The split between the front and the
back half falls on the ends of the rule, so laws that jump there are integrated exactly; a law with
further edges has the halves cut there, in the same variable, and the moving ends carry the
derivatives with respect to the edge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import pairwise
from typing import Any, NamedTuple

from curlfit.dynamics import law_structure  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike

from curlfit.dynamics.elliptic import Means, directions, on_half
from curlfit.friction import LAWS, Law, Load, LocalLaw, Motion, NetLaw, RingPoint
from curlfit.friction.base import on_new_law
from curlfit.stone import GRAVITY, Stone

NODES = 20  # on each half of the ring: 1e-14 of the force at |epsilon| 0.7, 1e-9 at 0.98
_NARROWEST = 5e-5  # `swing` below which the nodes crowd no further: least error at worst, 4e-7
_BALANCED = 1e-9  # imbalance, relative to the weight, at which one more Newton step is exact
_MOST_NEWTON_STEPS = 30
_LEAST_LOAD = 1e-6  # over the uniform load, as shown to a law
_EVEN = (0.0, 0.0)  # tilt of the uniform load

_POINT = RingPoint(*(1.0 for _ in RingPoint._fields))

_x, _w = np.polynomial.legendre.leggauss(NODES)
_GAUSS_NODES, _GAUSS_WEIGHTS = (_x + 1) / 2, _w / 2


def _register(law: type[Law]) -> None:
    names = [item.name for item in law.coefficients()]
    # Not `register_dataclass`: to jaxlib 0.10 the structures of two dataclasses with as many
    # fields are equal, and now and then `jit` runs the program of one law for another.
    jax.tree_util.register_pytree_node(
        law,
        lambda value: ([getattr(value, name) for name in names], None),
        lambda _, values: law(*values),
    )


for _law in LAWS.values():
    _register(_law)
on_new_law.append(_register)
jax.tree_util.register_dataclass(Stone, data_fields=["m", "R", "rho", "h"], meta_fields=[])


class Accelerations(NamedTuple):
    """Acceleration of the stone in the moving frame (eq. 1, per unit mass and inertia)."""

    xi: Array
    """to the right of the motion, m/s^2"""
    eta: Array
    """along the motion, m/s^2"""
    angular: Array
    """counter-clockwise, rad/s^2"""


def swing(v: Array, u: Array) -> Array:
    """`d = |v - |u||/(v + |u|)`: the half-angle within which sliding turns round; 1 for no spin."""
    au = jnp.where(u >= 0, u, -u)
    moving = v + au > 0
    return jnp.where(moving, jnp.abs(v - au) / jnp.where(moving, v + au, 1.0), 0.0)


class Nodes(NamedTuple):
    """Gauss points of one half of the ring, or of a part of it; the same in front and behind.

    Arrays have the nodes along the first axis and the lanes, if any, along the others.
    """

    xi: Array
    eta: Array
    half_angle: Array
    """b, half the angle from the slowest point of the ring"""
    square_sin: Array
    square_cos: Array
    """of b"""
    weight: Array
    """share of the ring of each point, before the weights of the Gauss rule"""


class Crowding(NamedTuple):
    """How closely the nodes stand by the slowest point of the ring.

    Where they stand hardly matters to a sum over them, so they may be placed once for many like
    motions, and no derivative passes through their places.
    """

    side: Array
    """1 where the slowest point is on the left, -1 where it is on the right"""
    width: Array
    reach: Array
    whole: Nodes
    """of an undivided half"""


class _Panel(NamedTuple):
    """A stretch of the ring between two places where friction may jump."""

    points: RingPoint
    weight: Array


class _Mirrored(NamedTuple):
    """The front half of a ring whose back half is its mirror image."""

    front: _Panel


def crowding(v: Array, u: Array) -> Crowding:
    """Places of the nodes for a speed `v >= 0` and `u = R omega`, in m/s; any shape."""
    v, u = jax.lax.stop_gradient((v, u))
    side = jnp.where(u >= 0, 1.0, -1.0)
    # t = tan(b/2) runs over (0, 1); t = width sinh(s arcsinh(1/width)) crowds nodes at t = 0.
    width = jnp.maximum(swing(v, u), _NARROWEST) / 2
    reach = jnp.log((1 + jnp.sqrt(1 + width**2)) / width)
    return Crowding(side, width, reach, _nodes(side, width, reach, 0.0, 1.0))


def _nodes(side: Array, width: Array, reach: Array, low: Any, high: Any) -> Nodes:
    """Nodes with s between two limits."""
    gauss = _GAUSS_NODES.reshape(-1, *(1 for _ in side.shape))
    grow = jnp.exp((low + (high - low) * gauss) * reach)
    t = width * (grow - 1 / grow) / 2
    dt = (high - low) * reach * width * (grow + 1 / grow) / 2
    q = 1 / (1 + t**2)
    sin_b, cos_b = 2 * t * q, (1 - t**2) * q
    square_sin, square_cos = sin_b**2, cos_b**2
    return Nodes(
        # The slowest point is on the left (alpha = pi) for counter-clockwise spin.
        xi=side * (square_sin - square_cos),
        eta=2 * sin_b * cos_b,
        half_angle=2 * jnp.arctan(t),
        square_sin=square_sin,
        square_cos=square_cos,
        weight=2 / jnp.pi * dt * q,  # d(alpha)/(2 pi), d(alpha) = 2 db, db = 2 q dt
    )


def panels(
    law: LocalLaw,
    v: Array,
    u: Array,
    turned: Array,
    time: Array,
    crowd: Crowding | None = None,
    *,
    halves: Sequence[float] = (1.0, 0.0),
) -> list[_Panel]:
    """Gauss points of the ring under uniform load, in panels within which friction is smooth.

    Parameters
    ----------
    v, u : speed of the centre (>= 0) and `R omega`, in m/s, of shape S.
    turned, time : angle turned (rad) and time (s) since release.
    crowd : where the nodes stand, if that is known already.
    halves : front (1.0) and back (0.0), or one of them.

    Returns
    -------
    The front and the back half, or the parts into which the law's edges cut them; each with
    arrays of shape `(NODES, *S)`.
    """
    crowd = crowding(v, u) if crowd is None else crowd
    side, width, reach, whole = crowd
    slow, fast = v - side * u, v + side * u

    def panel(nodes: Nodes, front: float) -> _Panel:
        # v + omega xi (eq. 16) and the square of the sliding speed, without cancellation
        slide_eta = slow * nodes.square_cos + fast * nodes.square_sin
        square = slow**2 * nodes.square_cos + fast**2 * nodes.square_sin
        sliding = square > 0
        inverse = jnp.where(sliding, 1 / jnp.sqrt(jnp.where(sliding, square, 1.0)), 0.0)
        ahead = 2 * front - 1
        slide_xi = -u * nodes.eta * ahead  # eq. 16
        points = RingPoint(
            xi=nodes.xi,
            eta=nodes.eta * ahead,
            angle=ahead * (jnp.pi / 2 + side * (jnp.pi / 2 - 2 * nodes.half_angle)),
            front=front,
            slide_xi=slide_xi,
            slide_eta=slide_eta,
            speed=square * inverse,
            e_xi=slide_xi * inverse,
            e_eta=slide_eta * inverse,
            load=jnp.ones_like(nodes.xi),
            turned=turned,
            time=time,
        )
        return _Panel(points, nodes.weight)

    def place(from_right: Array) -> Array:
        """s of the magnitude of a polar angle; its derivative holds up to the ends of the half."""
        inside = (from_right >= 0) & (from_right <= jnp.pi)
        from_right = jnp.where(inside, from_right, jnp.clip(from_right, 0.0, jnp.pi))
        b = jnp.where(side > 0, jnp.pi - from_right, from_right) / 2
        return jnp.arcsinh(jnp.tan(b / 2) / width) / reach

    start, end = jnp.zeros_like(side), jnp.ones_like(side)
    found = []
    edges = law.edges(turned)
    for front in halves:
        cuts = edges.front if front else edges.back
        if not cuts:
            found.append(panel(whole, front))
            continue
        at = jnp.stack([place((2 * front - 1) * edge + jnp.zeros_like(side)) for edge in cuts])
        ends = [start, *jnp.sort(at, axis=0), end]
        found += [
            panel(_nodes(side, width, reach, low, high), front) for low, high in pairwise(ends)
        ]
    return found


class _Halves(NamedTuple):
    """The ring as a law sees it that is linear in the direction of sliding."""

    right: Means
    forward: Means
    turned: Array
    time: Array


_Ring = list[_Panel] | _Mirrored | _Halves


def _force(law: LocalLaw, ring: _Ring, tilt: tuple[Any, Any]) -> tuple[Any, ...]:
    """Net force over m g (right, forward) and moment over m g R, under load 1 + p xi + q eta."""
    p, q = tilt
    t_xi = t_eta = moment = 0.0
    if isinstance(ring, _Halves):
        for front in (1.0, 0.0):
            right, forward = (
                means.loaded(p, q) for means in on_half(ring.right, ring.forward, front)
            )
            point = _POINT._replace(front=front, turned=ring.turned, time=ring.time)
            across = law.traction(point._replace(e_xi=1.0, e_eta=0.0))
            along = law.traction(point._replace(e_xi=0.0, e_eta=1.0))
            t_xi += across[0] * right.one + along[0] * forward.one
            t_eta += across[1] * right.one + along[1] * forward.one
            moment += across[1] * right.xi + along[1] * forward.xi
            moment -= across[0] * right.eta + along[0] * forward.eta
        return t_xi, t_eta, moment
    if isinstance(ring, _Mirrored):
        # What is felt to the right in front is felt to the left behind.
        _, t_eta, moment = _force(law, [ring.front], tilt)
        return jnp.zeros_like(t_eta), 2 * t_eta, 2 * moment
    for points, weight in ring:
        load = 1 + p * points.xi + q * points.eta
        # A trial load may be negative; a law need not know what to do with that.
        seen = load if tilt is _EVEN else jnp.maximum(load, _LEAST_LOAD)
        along_xi, along_eta = law.traction(points._replace(load=seen))
        n_xi, n_eta = weight * load * along_xi, weight * load * along_eta  # eq. 2
        t_xi += n_xi
        t_eta += n_eta
        moment += points.xi * n_eta - points.eta * n_xi
    return tuple(jnp.tensordot(_GAUSS_WEIGHTS, density, 1) for density in (t_xi, t_eta, moment))


def _seen(function: Callable[..., Any], *inputs: Any) -> list[bool]:
    """Which inputs the outputs of a function depend on."""
    jaxpr = jax.make_jaxpr(function)(*inputs).jaxpr
    used = {id(item) for item in jaxpr.outvars}
    for equation in reversed(jaxpr.eqns):
        if any(id(item) in used for item in equation.outvars):
            used |= {id(item) for item in equation.invars}
    return [id(variable) in used for variable in jaxpr.invars]


def _sees_load(law: LocalLaw, points: RingPoint) -> bool:
    """Whether the traction per unit load depends on the load."""
    (seen,) = _seen(lambda load: law.traction(points._replace(load=load)), points.load)
    return seen


def _sees_turned_and_time(law: Law, stone: Stone) -> list[bool]:
    """Whether friction depends on the angle turned, and on the time since release."""

    def felt(turned: Array, time: Array) -> Any:
        if isinstance(law, NetLaw):
            return law.accelerations(Motion(one, one, turned, time), stone)
        assert isinstance(law, LocalLaw)
        return law.traction(_POINT._replace(turned=turned, time=time)), law.edges(turned)

    one = jnp.ones(())
    law = jax.tree.map(lambda leaf: jnp.ones(()), law)
    return _seen(felt, one, one)


def _is_linear(function: Callable[..., Any], size: int, others: int) -> bool:
    """Whether a function is a constant matrix times its first `size` inputs, whatever the others
    are."""
    one: Any = np.ones(())
    inputs = (one,) * (size + others)

    def slope(*given: Array) -> Any:
        those = lambda *first: function(*first, *given[size:])  # noqa: E731
        return jax.jvp(those, given[:size], inputs[:size])[1]

    with jax.ensure_compile_time_eval():
        at_zero = jax.tree.leaves(function(*(0 * one for _ in range(size)), *inputs[size:]))
        still = any(float(part) for part in at_zero)
    return not (still or any(_seen(slope, *inputs)) or any(_seen(function, *inputs)[size:]))


def _some(kind: type[LocalLaw]) -> LocalLaw:
    return kind.from_vector([0.1 + 0.01 * place for place, _ in enumerate(kind.coefficients())])


@cache
def _somewhere(front: float) -> RingPoint:
    """Points on one half of the ring in several motions, for numpy; those of the other half are
    their mirror images."""
    v, u = np.array([[1.1], [0.3], [2.3]]), np.array([[-0.6], [0.15], [1.7]])
    angle = (2 * front - 1) * np.linspace(0.2, 2.9, 7)
    xi, eta = np.cos(angle), np.sin(angle)
    slide_xi, slide_eta = -u * eta, v + u * xi
    speed = np.hypot(slide_xi, slide_eta)
    return RingPoint(
        xi, eta, angle, front, slide_xi, slide_eta, speed, slide_xi / speed, slide_eta / speed,
        np.ones_like(speed), 0.7 * v, 3.1 * v,
    )  # fmt: skip


def _close(one: Any, other: Any) -> bool:
    return bool(np.allclose(np.asarray(one), np.asarray(other), rtol=1e-9, atol=1e-12))


@cache
def _is_tensor(kind: type[LocalLaw], load: Load) -> bool:
    """Whether traction on each half is a constant tensor times the direction of sliding."""
    law = _some(kind)
    if any(law.edges(1.0)):
        return False
    free = {"front", "turned", "time", "e_xi", "e_eta"}
    free |= {"load"} if load == "uniform" else set()
    names = ["e_xi", "e_eta", *(name for name in RingPoint._fields if name not in free)]

    def traction(*given: Array) -> Any:
        return law.traction(_POINT._replace(**dict(zip(names, given, strict=True))))

    if not _is_linear(traction, 2, len(names) - 2):
        return False
    with jax.ensure_compile_time_eval():
        for here in (_somewhere(1.0), _somewhere(0.0)):
            across, along = (
                law.traction(here._replace(e_xi=e_xi, e_eta=1.0 - e_xi)) for e_xi in (1.0, 0.0)
            )
            for part, right, forward in zip(law.traction(here), across, along, strict=True):
                if not _close(part, right * here.e_xi + forward * here.e_eta):
                    return False
    return True


@cache
def _is_mirrored(kind: type[LocalLaw], load: Load) -> bool:
    """Whether friction behind is the mirror image of that in front, as under an isotropic law."""
    law = _some(kind)
    if load != "uniform" or any(law.edges(1.0)):
        return False
    names = ("e_xi", "slide_xi", "eta", "angle", "front")  # what differs between the halves

    def traction(part: int, *given: Array) -> Any:
        return law.traction(_POINT._replace(**dict(zip(names, given, strict=True))))[part]

    try:
        seen = _seen(partial(traction, 1), *(np.ones(()) for _ in names))
        if any(seen) or not _is_linear(partial(traction, 0), 1, len(names) - 1):
            return False
    except TypeError:  # of a law that asks Python which half it is on
        return False
    with jax.ensure_compile_time_eval():
        front, back = (law.traction(_somewhere(half)) for half in (1.0, 0.0))
        return _close(front[0], -np.asarray(back[0])) and _close(front[1], back[1])


def _imbalance(law: LocalLaw, ring: _Ring, stone: Stone, tilt: Array) -> Array:
    """How far a load `n/n0 = 1 + p xi + q eta`, given as (p, q), is from balancing the friction.

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`.
    """
    force = _force(law, ring, (tilt[0], tilt[1]))
    return tilt + 2 * stone.h / stone.R * jnp.stack(force[:2])


def _solved(slopes: tuple[Array, Array], value: Array) -> Array:
    """The change of tilt that makes up for an imbalance, from the columns of its Jacobian."""
    (a, c), (b, d) = slopes
    f, g = value
    return jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)


def _balance(law: LocalLaw, ring: _Ring, stone: Stone) -> tuple[Array, tuple[Array, Array]]:
    """The consistent load (eq. 8-9) as (p, q), and the Jacobian of the imbalance, in columns.

    NaN where no load that is nowhere negative balances the friction.
    """

    def newton(tilt: Array, given: tuple[LocalLaw, _Ring, Stone]) -> tuple[Any, ...]:
        """The next tilt, how far this one was from balance, and the Jacobian."""
        one, zero = jnp.ones_like(tilt[0]), jnp.zeros_like(tilt[0])
        value, slope = jax.linearize(partial(_imbalance, *given), tilt)
        slopes = slope(jnp.stack([one, zero])), slope(jnp.stack([zero, one]))
        return tilt - _solved(slopes, value), jnp.abs(value).max(0), slopes

    given = (law, ring, stone)
    shape = ring.right.one.shape if isinstance(ring, _Halves) else ring[0].weight.shape[1:]
    tilt = jnp.zeros((2, *shape))
    # Where the law does not see the load the balance is linear: one step solves it.
    if not isinstance(ring, _Halves) and _sees_load(law, ring[0].points):
        still = jax.lax.stop_gradient(given)  # the last step alone carries the exact derivative

        def again(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            tilt, _, count = carry
            return *newton(tilt, still)[:2], count + 1

        def going(carry: tuple[Array, Array, Array]) -> Array:
            _, left, count = carry
            return (left > _BALANCED).any() & (count < _MOST_NEWTON_STEPS)

        tilt, left, _ = jax.lax.while_loop(
            going, again, (tilt, jnp.full(tilt.shape[1:], jnp.inf), jnp.zeros((), int))
        )
        tilt = jnp.where(left <= _BALANCED, tilt, jnp.nan)
    tilt, _, slopes = newton(tilt, given)
    return jnp.where((tilt**2).sum(0) <= 1, tilt, jnp.nan), slopes


_STONE = len(Stone.__dataclass_fields__)
_Inputs = tuple[Array, ...]  # the law's coefficients, the stone's fields, v, omega, turned, time


def _parted(kind: type[Law], inputs: _Inputs) -> tuple[Any, ...]:
    k = len(kind.coefficients())
    stone: Any = Stone(*inputs[k : k + _STONE])  # type: ignore[arg-type]
    return (kind.from_vector(inputs), stone, *inputs[k + _STONE :])


def _ring(kind: Any, load: Load, inputs: _Inputs, crowd: Crowding) -> _Ring:
    law, stone, v, omega, turned, time = _parted(kind, inputs)
    if _is_tensor(kind, load):
        return _Halves(*directions(v, stone.R * omega), turned, time)
    if _is_mirrored(kind, load):
        return _Mirrored(*panels(law, v, stone.R * omega, turned, time, crowd, halves=(1.0,)))
    return panels(law, v, stone.R * omega, turned, time, crowd)


def _near(kind: type[Law], load: Load, inputs: _Inputs, crowd: Crowding) -> Any:
    """What is solved for once, before forces are taken or differentiated."""
    if load == "uniform" or issubclass(kind, NetLaw):
        return None
    law, stone, *_ = _parted(kind, inputs)
    return _balance(law, _ring(kind, load, inputs, crowd), stone)


def _accelerations(
    kind: type[Law], load: Load, inputs: _Inputs, crowd: Crowding, near: Any, *, move: bool
) -> tuple[Array, Array, Array]:
    """xi, eta, angular. `move` has the tilt of the load follow the inputs."""
    law, stone, v, omega, turned, time = _parted(kind, inputs)
    if isinstance(law, NetLaw):
        net = law.accelerations(Motion(jnp.where(v > 0, v, 1.0), omega, turned, time), stone)
        return tuple(jnp.where(v > 0, value, 0.0) for value in net)  # type: ignore[return-value]
    ring = _ring(kind, load, inputs, crowd)
    tilt: Any = _EVEN
    if near is not None:
        tilt, slopes = near
        if move:
            tilt = tilt - _solved(slopes, _imbalance(law, ring, stone, tilt))
        tilt = (tilt[0], tilt[1])
    t_xi, t_eta, moment = _force(law, ring, tilt)
    return GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _felt(
    kind: type[Law], load: Load, inputs: _Inputs, crowd: Crowding
) -> tuple[Array, Array, Array]:
    return _accelerations(kind, load, inputs, crowd, _near(kind, load, inputs, crowd), move=False)


def _felt_jvp(
    kind: type[Law], load: Load, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Any, Any]:
    """One derivative by each input. However many directions are asked for, the ring is summed but
    once for each input, and most inputs touch little of the sum."""
    inputs, crowd = primals
    near = _near(kind, load, inputs, crowd)
    out = _accelerations(kind, load, inputs, crowd, near, move=False)
    law, stone, *_ = _parted(kind, inputs)
    sees = [True] * (len(inputs) - 2) + _sees_turned_and_time(law, stone)
    change = tuple(jnp.zeros_like(value) for value in out)
    for place, (sight, tangent) in enumerate(zip(sees, tangents[0], strict=True)):
        if isinstance(tangent, SymbolicZero) or not sight:
            continue

        def along(value: Array, place: int = place) -> tuple[Array, Array, Array]:
            moved = (*inputs[:place], value, *inputs[place + 1 :])
            return _accelerations(kind, load, moved, crowd, near, move=True)

        _, slope = jax.jvp(along, (inputs[place],), (jnp.ones_like(inputs[place]),))
        change = tuple(c + s * tangent for c, s in zip(change, slope, strict=True))
    return out, change


_felt.defjvp(_felt_jvp, symbolic_zeros=True)


def accelerations(
    law: Law,
    stone: Stone,
    load: Load,
    v: Array,
    omega: Array,
    turned: ArrayLike = 0.0,
    time: ArrayLike = 0.0,
    crowd: Crowding | None = None,
) -> Accelerations:
    """Acceleration of a stone that moves at speed `v` and spins at `omega`.

    Parameters
    ----------
    law, stone : the friction law and the stone.
    load : "uniform", or "consistent" (eq. 8-9). A net law has no ring and ignores it.
    v : speed of the centre in m/s, >= 0, of any shape. `v = omega = 0` is allowed and gives zero.
    omega : spin in rad/s, either sign, of the same shape.
    turned, time : angle turned in rad and time in s since release.
    crowd : where the nodes of the ring stand, if that is known already.

    Returns
    -------
    Accelerations; NaN where no consistent load with n >= 0 everywhere exists.
    """
    if not isinstance(law, LocalLaw | NetLaw):
        raise TypeError(f"{law!r} is neither a LocalLaw nor a NetLaw")
    inputs = tuple(
        jnp.asarray(value, float)
        for value in (*jax.tree.leaves((law, stone)), v, omega, turned, time)
    )
    v, omega = inputs[-4:-2]
    crowd = crowding(v, inputs[len(law.coefficients()) + 1] * omega) if crowd is None else crowd
    return Accelerations(*_felt(type(law), load, inputs, crowd))


def consistent_load(
    law: LocalLaw, stone: Stone, v: ArrayLike, omega: ArrayLike, turned: ArrayLike = 0.0
) -> Array:
    """(n1, n2) of eq. 9 times R over n0: the consistent load is `n0 (1 + n1 xi/R + n2 eta/R)`.

    Shape (2,); NaN where no such load with n >= 0 exists. Arguments as in `accelerations`.
    """
    v, omega, turned = (jnp.asarray(value, float) for value in (v, omega, turned))
    ring = panels(law, v, stone.R * omega, turned, jnp.zeros(()))
    return _balance(law, ring, stone)[0]
