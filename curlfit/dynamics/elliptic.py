"""Sums over the ring in closed form, for friction that is linear in the
direction of sliding.

Under such a law, `t = -n M v/|v|` with a tensor M that is a polynomial in the position
on each half of the ring (`ring_polynomials`), the force of the ring follows from ten
means of the direction of sliding. In units of the larger of the two speeds `v` and
`|u| = R |omega|`, with `q` the smaller one and `c` the cosine of the angle from the
fastest point, the sliding speed is `rho = sqrt(1 + q^2 + 2 q c)`. Over a half ring

- means odd in `eta` are integrals of polynomials in c over rho, and
  `1/rho = sum (-q)^n P_n(c)` is the generating function of Legendre's polynomials
  (DLMF 18.12.11);
- means even in `eta` are those of `c^n/rho`, complete elliptic integrals of the modulus
  q (DLMF 19.2.8 and, for n > 1, by parts).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# of the arithmetic-geometric mean: exact to rounding for m1 >= _MIN_M1
_AGM_ITERATIONS = 5
_MIN_M1 = 1e-10  # 1 - q^2: an error of 1e-9 of the force at |epsilon| = 1
_SMALL_M = 1e-5  # m below which dG/dm is taken from its series


class _Complete(NamedTuple):
    """Complete elliptic integrals of the parameter `m = q^2`: integrals from 0 to pi/2,
    with Delta = sqrt(1 - m sin^2)."""

    B: Array
    """of cos^2/Delta"""
    H: Array
    """(1 - m) D"""
    D: Array
    """of sin^2/Delta"""
    G: Array
    """(D - B)/m"""


@jax.custom_jvp
def _complete(m: Array, m1: Array) -> _Complete:
    """Complete integrals by the arithmetic-geometric mean, at m in [0, 1) and m1 =
    1 - m, given separately to avoid cancellation."""
    a = jnp.ones_like(m)
    b = jnp.sqrt(m1)
    first = 1 / (2 * (a + b))  # c_1/m
    # the sum over n > 1 of 2^n c_n^2, with c_n = (a_(n-1) - b_(n-1))/2
    total = jnp.zeros_like(m)
    power = 2.0
    for _ in range(_AGM_ITERATIONS):
        a, b = (a + b) / 2, jnp.sqrt(a * b)
        power *= 2
        total += power * ((a - b) / 2) ** 2
    K = jnp.pi / (a + b)  # DLMF 19.8.5
    # From DLMF 19.8.6; the first term of the sum is accurate for small m.
    over_m = 2 * m * first**2 + total / jnp.maximum(m, 1e-30)
    D = K * (1 + over_m) / 2
    B = K * (1 - over_m) / 2
    G = K * (2 * first**2 + total / jnp.maximum(m, 1e-30) ** 2)
    return _Complete(B, m1 * D, D, G)


@_complete.defjvp
def _(inputs: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
    m, m1 = inputs
    integrals = _complete(m, m1)
    D = integrals.D
    G = integrals.G
    # From DLMF 19.4.1-2.
    small = m < _SMALL_M
    dG = (D - 4 * G + 3 * m * G) / (2 * jnp.where(small, 1.0, m) * m1)
    dG = jnp.where(small, jnp.pi / 16 * (3 / 4 + 75 / 64 * m), dG)
    by_m = _Complete(B=G / 2, H=-(D + G) / 2, D=(D - G) / (2 * m1), G=dG)
    return integrals, _Complete(*(slope * tangents[0] for slope in by_m))


class Means(NamedTuple):
    """Half-ring means (integrals over the front half divided by 2 pi) of one component
    of a vector, times 1, xi, xi^2, eta and xi eta: arrays, or numbers that are the same
    in all motions."""

    one: Any
    xi: Any
    xi_xi: Any
    eta: Any
    xi_eta: Any


MEAN_PLACES = Means(one=0.5, xi=0.0, xi_xi=0.25, eta=1 / np.pi, xi_eta=0.0)
"""Means of the places alone, of what acts at all points in the same direction"""


def mean_directions(v: Array, u: Array) -> tuple[Means, Means]:
    """Means of the directions of sliding, to the right and forward, on the front half.

    `v >= 0` is the speed of the centre and `u = R omega`, of any shape. On the back
    half the means odd in eta have the opposite sign: to the right those of 1, xi and
    xi^2, forward those of eta and xi eta. Zero for a stone at rest.
    """
    s = jnp.where(u >= 0, 1.0, -1.0)
    au = s * u
    translating = v >= au
    larger = jnp.where(translating, v, au)
    smaller = jnp.where(translating, au, v)
    moving = larger > 0
    scale = jnp.where(moving, 1 / jnp.where(moving, larger, 1.0), 0.0)
    q = smaller * scale
    V = v * scale
    U = au * scale
    m = q * q
    m1 = jnp.maximum((1 - q) * (1 + q), _MIN_M1)
    factor = jnp.where(moving, 1 / jnp.pi, 0.0)
    B, H, D, G = (factor * integral for integral in _complete(m, m1))
    # Of 1, c, c^2 over rho, odd in eta.
    integral_c = q * (-1 / 3)
    integral_cc = 1 / 3 + 2 / 15 * m
    odd_1 = 1 / jnp.pi
    odd_c = integral_c * odd_1
    odd_cc = integral_cc * odd_1
    # Of c^2, c^3 and (1 - c^2) c over rho, even in eta.
    cc = (B + (2 + m) * D) * (1 / 3)
    c_ss = q * ((1 + m) * (G + 2 * D) * (1 / 15) - 2 / 5 * D)
    ccc = -q * D - c_ss
    forward = Means(
        one=jnp.where(translating, B + H, q * B),
        xi=s * jnp.where(translating, q * (B - H), B + 2 * H) * (1 / 3),
        xi_xi=V * cc + U * ccc,
        eta=V * odd_1 + U * odd_c,
        xi_eta=s * (V * odd_c + U * odd_cc),
    )
    right = Means(
        one=-s * U * odd_1,
        xi=-U * odd_c,
        xi_xi=-s * U * odd_cc,
        eta=-s * U * (2 * B + H) * (1 / 3),
        xi_eta=-U * c_ss,
    )
    return right, forward


def mean_velocities(v: Array, u: Array) -> tuple[Means, Means]:
    """Means of the sliding velocity (-u eta, v + u xi) of eq. 16 in m/s, to the right
    and forward, on the front half; on the back half as those of `mean_directions`."""
    pi = jnp.pi
    zero = jnp.zeros_like(v)
    right = Means(one=-u / pi, xi=zero, xi_xi=-u / (3 * pi), eta=-u / 4, xi_eta=zero)
    forward = Means(one=v / 2, xi=u / 4, xi_xi=v / 4, eta=v / pi, xi_eta=u / (3 * pi))
    return right, forward
