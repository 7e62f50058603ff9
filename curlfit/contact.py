"""The contact ring: a law of friction at a point becomes acceleration of the stone.

Sums a local law over the ring (eq. 2) under uniform or dynamically consistent load (eq. 8-9).

Quadrature. With `u = R omega`, the sliding speed at polar angle `alpha` is
`|v(A)|^2 = (v - |u|)^2 cos^2 b + (v + |u|)^2 sin^2 b`, where `b` is half the angle between the
point and the slowest point of the ring. Near `|epsilon| = 1` the slowest point hardly slides and
the direction of friction swings round within an angle of `d = |v - |u||/(v + |u|)`; Gauss nodes
are placed by the sinh transform of near-singular integrals (Johnston and Elliott 2005), which
resolves that swing at any `d` with the same few nodes. The split between the front and the
back half falls on the ends of the rule, so laws that jump there are integrated exactly.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from curlfit import backend  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from curlfit.friction import LAWS, Law, Load, LocalLaw, Motion, NetLaw, RingPoint
from curlfit.friction.base import on_new_law
from curlfit.stone import GRAVITY, Stone

NODES = (
    16  # on each half of the ring: 1e-12 of the force at |epsilon| 0.7, 1e-7 at 0.98, 5e-6 at worst
)
_NARROWEST = 2e-4  # `swing` below which the nodes crowd no further: smallest error at worst
_NEWTON_STEPS = 6  # enough for 1e-12, load effects being a few percent

_x, _w = np.polynomial.legendre.leggauss(NODES)
_GAUSS_NODES, _GAUSS_WEIGHTS = (_x + 1) / 2, _w / 2


def _register(law: type[Law]) -> None:
    jax.tree_util.register_dataclass(
        law, data_fields=[item.name for item in law.coefficients()], meta_fields=[]
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


class _Half(NamedTuple):
    """One half of the ring: its points and their weights, a share of 1/2 of the whole ring."""

    points: RingPoint
    weight: Array


def halves(v: Array, u: Array, turned: Array) -> tuple[_Half, _Half]:
    """Gauss points of the front and the back half of the ring, under uniform load.

    Parameters
    ----------
    v, u : speed of the centre (>= 0) and `R omega`, in m/s, scalars.
    turned : angle turned since release, rad.

    Returns
    -------
    front, back : each with arrays of shape `(NODES,)`.
    """
    side = jnp.where(u >= 0, 1.0, -1.0)
    au = side * u
    # t = tan(b/2) runs over (0, 1); t = width sinh(s arcsinh(1/width)) crowds nodes at t = 0.
    width = jnp.maximum(swing(v, u), _NARROWEST) / 2
    stretch = jnp.log((1 + jnp.sqrt(1 + width**2)) / width)
    grow = jnp.exp(_GAUSS_NODES * stretch)
    t = width * (grow - 1 / grow) / 2
    dt = stretch * width * (grow + 1 / grow) / 2
    q = 1 / (1 + t**2)
    sin_b, cos_b = 2 * t * q, (1 - t**2) * q
    weight = 2 / jnp.pi * dt * q  # d(alpha)/(2 pi), d(alpha) = 2 db, db = 2 q dt

    # The slowest point is on the left (alpha = pi) for counter-clockwise spin.
    square_sin, square_cos = sin_b**2, cos_b**2
    xi = side * (square_sin - square_cos)
    eta = 2 * sin_b * cos_b
    # v + omega xi (eq. 16) and the square of the sliding speed, without cancellation
    slide_eta = (v - au) * square_cos + (v + au) * square_sin
    square = (v - au) ** 2 * square_cos + (v + au) ** 2 * square_sin
    sliding = square > 0
    inverse = jnp.where(sliding, jax.lax.rsqrt(jnp.where(sliding, square, 1.0)), 0.0)
    speed = square * inverse

    def half(front: float) -> _Half:
        ahead = 2 * front - 1
        slide_xi = -u * eta * ahead  # eq. 16
        points = RingPoint(
            xi=xi,
            eta=eta * ahead,
            front=front,
            slide_xi=slide_xi,
            slide_eta=slide_eta,
            speed=speed,
            e_xi=slide_xi * inverse,
            e_eta=slide_eta * inverse,
            load=jnp.ones(NODES),
            turned=turned,
        )
        return _Half(points, weight)

    return half(1.0), half(0.0)


def _force(law: LocalLaw, ring: tuple[_Half, _Half], tilt: tuple[Any, Any]) -> tuple[Any, ...]:
    """Net force over m g (right, forward) and moment over m g R, under load 1 + p xi + q eta."""
    p, q = tilt
    t_xi = t_eta = moment = 0.0
    for points, weight in ring:
        load = 1 + p * points.xi + q * points.eta
        along_xi, along_eta = law.traction(points._replace(load=load))
        n_xi, n_eta = weight * load * along_xi, weight * load * along_eta  # eq. 2
        t_xi += n_xi
        t_eta += n_eta
        moment += points.xi * n_eta - points.eta * n_xi
    return tuple(jnp.dot(density, _GAUSS_WEIGHTS) for density in (t_xi, t_eta, moment))


def _consistent_tilt(law: LocalLaw, ring: tuple[_Half, _Half], stone: Stone) -> Array:
    """The linear load `n/n0 = 1 + p xi + q eta` that balances the friction (eq. 8-9), as (p, q).

    On a thin ring eq. 8 reads `(p, q) = -2 (h/R) T/(m g)`. NaN where the balance needs a
    negative load somewhere.
    """

    def imbalance(tilt: Array) -> Array:
        force = _force(law, ring, (tilt[0], tilt[1]))
        return tilt + 2 * stone.h / stone.R * jnp.stack(force[:2])

    def newton(tilt: Array) -> Array:
        (a, b), (c, d) = jax.jacfwd(imbalance)(tilt)
        f, g = imbalance(tilt)
        return tilt - jnp.stack([d * f - b * g, a * g - c * f]) / (a * d - b * c)

    tilt = jnp.zeros(2)
    if law.load_matters:  # otherwise the balance is linear, and one step solves it
        tilt = jax.lax.fori_loop(0, _NEWTON_STEPS, lambda _, value: newton(value), tilt)
        tilt = jax.lax.stop_gradient(tilt)  # the last step alone carries the exact derivative
    tilt = newton(tilt)
    return jnp.where(tilt @ tilt <= 1, tilt, jnp.nan)


def accelerations(
    law: Law, stone: Stone, load: Load, v: Array, omega: Array, turned: Array | float = 0.0
) -> Accelerations:
    """Acceleration of a stone that moves at speed `v` and spins at `omega`.

    Parameters
    ----------
    law, stone : the friction law and the stone.
    load : "uniform", or "consistent" (eq. 8-9). A net law has no ring and ignores it.
    v : speed of the centre in m/s, >= 0, scalar. `v = omega = 0` is allowed and gives zero.
    omega : spin in rad/s, either sign, scalar.
    turned : angle turned since release in rad.
    """
    v, omega, turned = jnp.asarray(v, float), jnp.asarray(omega, float), jnp.asarray(turned, float)
    if isinstance(law, NetLaw):
        net = law.accelerations(Motion(jnp.where(v > 0, v, 1.0), omega, turned), stone)
        return Accelerations(*(jnp.where(v > 0, value, 0.0) for value in net))
    if not isinstance(law, LocalLaw):
        raise TypeError(f"{law!r} is neither a LocalLaw nor a NetLaw")
    ring = halves(v, stone.R * omega, turned)
    tilt = _consistent_tilt(law, ring, stone) if load == "consistent" else (0.0, 0.0)
    t_xi, t_eta, moment = _force(law, ring, (tilt[0], tilt[1]))
    return Accelerations(GRAVITY * t_xi, GRAVITY * t_eta, GRAVITY * stone.R * moment / stone.rho**2)
