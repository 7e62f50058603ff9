"""The contact ring: a law of friction at a point becomes acceleration of the stone.

Sums a local law over the ring (eq. 2) under uniform or dynamically consistent load (eq. 8-9).

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

from itertools import pairwise
from typing import Any, NamedTuple

from curlfit import backend  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from curlfit.friction import LAWS, Law, Load, LocalLaw, Motion, NetLaw, RingPoint
from curlfit.friction.base import on_new_law
from curlfit.stone import GRAVITY, Stone

NODES = 20  # on each half of the ring: 1e-14 of the force at |epsilon| 0.7, 1e-9 at 0.98
_NARROWEST = 5e-5  # `swing` below which the nodes crowd no further: least error at worst, 4e-7
_BALANCED = 1e-9  # imbalance, relative to the weight, at which one more Newton step is exact
_MOST_NEWTON_STEPS = 30
_LEAST_LOAD = 1e-6  # over the uniform load, as shown to a law
_EVEN = (0.0, 0.0)  # tilt of the uniform load

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


class _Panel(NamedTuple):
    """A stretch of the ring between two places where friction may jump."""

    points: RingPoint
    weight: Array
    """share of the ring of each point, before the weights of the Gauss rule"""


class _Stretch(NamedTuple):
    """Points of one half of the ring, the same in front and behind."""

    xi: Array
    eta: Array
    half_angle: Array
    slide_eta: Array
    speed: Array
    inverse: Array
    weight: Array


def panels(law: LocalLaw, v: Array, u: Array, turned: Array, time: Array) -> list[_Panel]:
    """Gauss points of the ring under uniform load, in panels within which friction is smooth.

    Parameters
    ----------
    v, u : speed of the centre (>= 0) and `R omega`, in m/s, scalars.
    turned, time : angle turned (rad) and time (s) since release.

    Returns
    -------
    The front and the back half, or the parts into which the law's edges cut them; each with
    arrays of shape `(NODES,)`.
    """
    side = jnp.where(u >= 0, 1.0, -1.0)
    au = side * u
    # t = tan(b/2) runs over (0, 1); t = width sinh(s arcsinh(1/width)) crowds nodes at t = 0.
    width = jnp.maximum(swing(v, u), _NARROWEST) / 2
    reach = jnp.log((1 + jnp.sqrt(1 + width**2)) / width)

    def stretch(low: Array, high: Array) -> _Stretch:
        """Points with s between two limits."""
        grow = jnp.exp((low + (high - low) * _GAUSS_NODES) * reach)
        t = width * (grow - 1 / grow) / 2
        dt = (high - low) * reach * width * (grow + 1 / grow) / 2
        q = 1 / (1 + t**2)
        sin_b, cos_b = 2 * t * q, (1 - t**2) * q
        square_sin, square_cos = sin_b**2, cos_b**2
        # v + omega xi (eq. 16) and the square of the sliding speed, without cancellation
        square = (v - au) ** 2 * square_cos + (v + au) ** 2 * square_sin
        sliding = square > 0
        inverse = jnp.where(sliding, jax.lax.rsqrt(jnp.where(sliding, square, 1.0)), 0.0)
        return _Stretch(
            # The slowest point is on the left (alpha = pi) for counter-clockwise spin.
            xi=side * (square_sin - square_cos),
            eta=2 * sin_b * cos_b,
            half_angle=2 * jnp.arctan(t),
            slide_eta=(v - au) * square_cos + (v + au) * square_sin,
            speed=square * inverse,
            inverse=inverse,
            weight=2 / jnp.pi * dt * q,  # d(alpha)/(2 pi), d(alpha) = 2 db, db = 2 q dt
        )

    def panel(part: _Stretch, front: float) -> _Panel:
        ahead = 2 * front - 1
        slide_xi = -u * part.eta * ahead  # eq. 16
        points = RingPoint(
            xi=part.xi,
            eta=part.eta * ahead,
            angle=ahead * (jnp.pi / 2 + side * (jnp.pi / 2 - 2 * part.half_angle)),
            front=front,
            slide_xi=slide_xi,
            slide_eta=part.slide_eta,
            speed=part.speed,
            e_xi=slide_xi * part.inverse,
            e_eta=part.slide_eta * part.inverse,
            load=jnp.ones(NODES),
            turned=turned,
            time=time,
        )
        return _Panel(points, part.weight)

    def place(from_right: Array) -> Array:
        """s of the magnitude of a polar angle; its derivative holds up to the ends of the half."""
        inside = (from_right >= 0) & (from_right <= jnp.pi)
        from_right = jnp.where(inside, from_right, jnp.clip(from_right, 0.0, jnp.pi))
        b = jnp.where(side > 0, jnp.pi - from_right, from_right) / 2
        return jnp.arcsinh(jnp.tan(b / 2) / width) / reach

    start, end = jnp.zeros(()), jnp.ones(())
    whole = stretch(start, end)
    found = []
    edges = law.edges(turned)
    for front, cuts in ((1.0, edges.front), (0.0, edges.back)):
        if not cuts:
            found.append(panel(whole, front))
            continue
        ends = [start, *jnp.sort(jnp.stack([place((2 * front - 1) * edge) for edge in cuts])), end]
        found += [panel(stretch(low, high), front) for low, high in pairwise(ends)]
    return found


def _force(law: LocalLaw, ring: list[_Panel], tilt: tuple[Any, Any]) -> tuple[Any, ...]:
    """Net force over m g (right, forward) and moment over m g R, under load 1 + p xi + q eta."""
    p, q = tilt
    t_xi = t_eta = moment = 0.0
    for points, weight in ring:
        load = 1 + p * points.xi + q * points.eta
        # A trial load may be negative; a law need not know what to do with that.
        seen = load if tilt is _EVEN else jnp.maximum(load, _LEAST_LOAD)
        along_xi, along_eta = law.traction(points._replace(load=seen))
        n_xi, n_eta = weight * load * along_xi, weight * load * along_eta  # eq. 2
        t_xi += n_xi
        t_eta += n_eta
        moment += points.xi * n_eta - points.eta * n_xi
    return tuple(jnp.dot(density, _GAUSS_WEIGHTS) for density in (t_xi, t_eta, moment))


def _sees_load(law: LocalLaw, points: RingPoint) -> bool:
    """Whether the traction per unit load depends on the load."""
    closed = jax.make_jaxpr(lambda load: law.traction(points._replace(load=load)))(points.load)
    (load,) = closed.jaxpr.invars
    used = [*closed.jaxpr.outvars, *(v for eqn in closed.jaxpr.eqns for v in eqn.invars)]
    return any(variable is load for variable in used)


def _consistent_tilt(law: LocalLaw, ring: list[_Panel], stone: Stone) -> Array:
    """The linear load `n/n0 = 1 + p xi + q eta` that balances the friction (eq. 8-9), as (p, q).

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`. NaN where no load that is nowhere
    negative balances it.
    """

    def newton(tilt: Array, given: tuple[LocalLaw, list[_Panel], Stone]) -> tuple[Array, Array]:
        """The next tilt, and how far this one was from balance."""
        law, ring, stone = given

        def imbalance(tilt: Array) -> tuple[Array, Array]:
            force = _force(law, ring, (tilt[0], tilt[1]))
            value = tilt + 2 * stone.h / stone.R * jnp.stack(force[:2])
            return value, value

        ((a, b), (c, d)), (f, g) = jax.jacfwd(imbalance, has_aux=True)(tilt)
        step = jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)
        return tilt - step, jnp.maximum(jnp.abs(f), jnp.abs(g))

    given = (law, ring, stone)
    tilt = jnp.zeros(2)
    if _sees_load(law, ring[0].points):  # otherwise the balance is linear: one step solves it
        still = jax.lax.stop_gradient(given)  # the last step alone carries the exact derivative

        def again(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            tilt, _, count = carry
            return *newton(tilt, still), count + 1

        def going(carry: tuple[Array, Array, Array]) -> Array:
            _, left, count = carry
            return (left > _BALANCED) & (count < _MOST_NEWTON_STEPS)

        tilt, left, _ = jax.lax.while_loop(
            going, again, (tilt, jnp.asarray(jnp.inf), jnp.zeros((), int))
        )
        tilt = jnp.where(left <= _BALANCED, tilt, jnp.nan)
    tilt, _ = newton(tilt, given)
    return jnp.where(tilt @ tilt <= 1, tilt, jnp.nan)


def accelerations(
    law: Law,
    stone: Stone,
    load: Load,
    v: Array,
    omega: Array,
    turned: ArrayLike = 0.0,
    time: ArrayLike = 0.0,
) -> Accelerations:
    """Acceleration of a stone that moves at speed `v` and spins at `omega`.

    Parameters
    ----------
    law, stone : the friction law and the stone.
    load : "uniform", or "consistent" (eq. 8-9). A net law has no ring and ignores it.
    v : speed of the centre in m/s, >= 0, scalar. `v = omega = 0` is allowed and gives zero.
    omega : spin in rad/s, either sign, scalar.
    turned, time : angle turned in rad and time in s since release.

    Returns
    -------
    Accelerations; NaN where no consistent load with n >= 0 everywhere exists.
    """
    v, omega, turned, time = (jnp.asarray(value, float) for value in (v, omega, turned, time))
    if isinstance(law, NetLaw):
        net = law.accelerations(Motion(jnp.where(v > 0, v, 1.0), omega, turned, time), stone)
        return Accelerations(*(jnp.where(v > 0, value, 0.0) for value in net))
    if not isinstance(law, LocalLaw):
        raise TypeError(f"{law!r} is neither a LocalLaw nor a NetLaw")
    ring = panels(law, v, stone.R * omega, turned, time)
    if load == "consistent":
        p, q = _consistent_tilt(law, ring, stone)
        t_xi, t_eta, moment = _force(law, ring, (p, q))
    else:
        t_xi, t_eta, moment = _force(law, ring, _EVEN)
    return Accelerations(GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2)


def consistent_load(
    law: LocalLaw, stone: Stone, v: ArrayLike, omega: ArrayLike, turned: ArrayLike = 0.0
) -> Array:
    """(n1, n2) of eq. 9 times R over n0: the consistent load is `n0 (1 + n1 xi/R + n2 eta/R)`.

    Shape (2,); NaN where no such load with n >= 0 exists. Arguments as in `accelerations`.
    """
    v, omega, turned = (jnp.asarray(value, float) for value in (v, omega, turned))
    ring = panels(law, v, stone.R * omega, turned, jnp.zeros(()))
    return _consistent_tilt(law, ring, stone)
