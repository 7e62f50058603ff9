"""Claims about anisotropic friction on the ring: load, eq. 22-24, 27, and the split of eq. 28."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations, contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.friction import Load, LocalLaw
from curlfit.friction.anisotropic import Radial
from curlfit.friction.front_back import FrontBack, FrontBackFirstOrder
from curlfit.inference.fit.fit import fit
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.paper.claim import Claim
from curlfit.paper.findings import PRINTED, RADIUS, Expansion, Kinematics, RingFindings
from curlfit.paper.printed import (
    EQ_28_STONE,
    SOLID_RHO,
    first_order_motion,
    jensen_shegelski_throw,
)
from curlfit.stone import GRAVITY, Stone

RHO = 0.1
"""Radius of gyration of sect. 4, m."""
SPEED = 2.0
"""Speed of the test states, m/s."""
EPSILONS = np.array([0.1, 0.05, 0.025])
SPLIT = (0.012, 0.006)
"""mu1_eta and mu2_eta of the example, exchanged for the comparison."""
_SPLIT_EPSILONS = np.array([0.01, 0.1, 0.5, 0.9, 0.99, 1.01, 1.5, 3.0, 10.0])
_OTHER_STONES = ((RADIUS, 0.1045), (0.0625, SOLID_RHO), (EQ_28_STONE.R, RHO))
"""R and rho that the paper prints elsewhere, or that round to what it prints, m."""
_SMALL = 0.005  # relative difference at eps = 0.1: half of eps^2
_TEST_VALUE = 0.01  # each coefficient in turn; the laws are linear in them


def net_forces(
    law: type[LocalLaw], values: Floats, epsilon: Floats, stone: Stone, load: Load = "uniform"
) -> Floats:
    """Force over m g (right, forward) and moment over m g R, shape (n, 3).

    `values` are coefficients of shape (n, coefficients), `epsilon` has shape (n,); v = 2 m/s.
    """
    acceleration = _net_accelerations(law, load, values, stone, SPEED * epsilon / stone.R)
    moment = np.asarray(acceleration.angular) * stone.rho**2 / stone.R
    return (
        np.stack([np.asarray(acceleration.xi), np.asarray(acceleration.eta), moment], 1) / GRAVITY
    )


@compiled("law", "load")
def _net_accelerations(
    law: type[LocalLaw], load: Load, values: Array, stone: Stone, spin: Array
) -> Any:
    def one(values: Array, spin: Array) -> Any:
        return accelerations(law.from_vector(values), stone, load, jnp.asarray(SPEED), spin)

    return jax.vmap(one)(values, spin)


def radial_at(mu: Floats, epsilon: float, angle: Floats) -> Floats:
    """Eq. 22: friction of the radial law to the right and forward over the load, shape (2, n).

    `mu` are mu1..mu4, `angle` the polar angles of the points in rad, shape (n,).
    """
    normal, tangent = np.where(angle > 0, mu[0::2, None], mu[1::2, None])
    sin, cos = np.sin(angle), np.cos(angle)
    right = (normal - tangent) * sin * cos - epsilon * tangent * sin
    forward = normal * sin**2 + tangent * cos**2 + epsilon * tangent * cos
    return -np.stack([right, forward]) / np.sqrt(1 + 2 * epsilon * cos + epsilon**2)


@compiled()
def _radial_at_nodes(mu: Array, stone: Stone, epsilon: Array) -> list[tuple[Array, Array]]:
    """Angles of the nodes of the ring's quadrature, and the friction there, for each panel."""
    law = Radial.from_vector(mu)
    contact = contact_of(law, stone, "uniform", SPEED, SPEED * epsilon / stone.R)
    ring = panels(law, *contact.motion, contact.clustering)
    return [(points.angle, jnp.stack(law.traction(points))) for points, _ in ring]


def _largest_gap_of_eq_22() -> float:
    """Relative to the largest friction, at the nodes of the ring's quadrature."""
    mu, gap = np.array([0.006, 0.008, 0.009, 0.018]), 0.0
    for epsilon in (0.1, 0.9, 3.0):
        for angle, own in _radial_at_nodes(mu, Stone(R=RADIUS), epsilon):
            gap = max(
                gap, np.abs(np.asarray(own) - radial_at(mu, epsilon, np.asarray(angle))).max()
            )
    return float(gap / mu.max())


def _load_errors(epsilon: float) -> Floats:
    """Relative errors of T_xi, T_eta, M under uniform load, for eq. 28, shape (radii, 3)."""
    mu = np.array([[*PRINTED[:2], *[PRINTED[2] / 2] * 2]])
    errors = []
    for radius in (RADIUS, EQ_28_STONE.R):
        stone = Stone(R=radius, h=0.057)
        uniform, consistent = (
            net_forces(FrontBack, mu, np.array([epsilon]), stone, load)
            for load in ("uniform", "consistent")
        )
        errors.append((uniform / consistent - 1)[0])
    return np.array(errors)


def first_order_radial(mu: Floats, epsilon: Floats) -> Floats:
    """Eq. 23 over m g, m g and m g R; arguments and shape as in `net_forces`."""
    m1, m2, m3, m4 = mu.T
    return np.stack(
        [
            epsilon * (m1 - m2 + 2 * m3 - 2 * m4) / (3 * np.pi),
            -(m1 + m2 + m3 + m4) / 4,
            -epsilon * (m3 + m4) / 4,
        ],
        1,
    )


def first_order_front_back(mu: Floats, epsilon: Floats) -> Floats:
    """The right sides of eq. 27 in the same form."""
    m1_xi, m2_xi, m1_eta, m2_eta = mu.T
    return np.stack(
        [
            epsilon * (m1_xi - m2_xi) / np.pi,
            -(m1_eta + m2_eta) / 2,
            -epsilon * (m1_xi + m2_xi) / 4,
        ],
        1,
    )


def _expansion(law: type[LocalLaw], first_order: Any) -> Expansion:
    mu = np.tile(_TEST_VALUE * np.eye(4), (len(EPSILONS), 1))
    epsilon = np.repeat(EPSILONS, 4)
    exact = net_forces(law, mu, epsilon, Stone(R=RADIUS, rho=RHO))
    approximate = first_order(mu, epsilon)
    # Relative to the largest contribution of all coefficients, since some contribute nothing.
    size = np.abs(approximate).reshape(-1, 4, 3).max(1)
    gap = np.abs(exact - approximate).reshape(-1, 4, 3).max(1) / size
    with np.errstate(divide="ignore", invalid="ignore"):
        order = np.log(gap[0] / gap[-1]) / np.log(EPSILONS[0] / EPSILONS[-1])
    return Expansion(EPSILONS, gap, np.where(gap[0] > 1e-9, order, np.nan))


def solve_eq_24(
    motion: Kinematics, radius: float = RADIUS, rho: float = RHO
) -> tuple[Floats, Floats, Floats]:
    """l1 = mu1 + mu2, l2 = mu3 + mu4, l3 = mu1 + 2 mu3 at each time."""
    epsilon = motion.epsilon(radius)
    difference = 3 * np.pi * motion.xi / (epsilon * GRAVITY)  # mu1 - mu2 + 2 mu3 - 2 mu4
    total = -4 * motion.eta / GRAVITY
    l2 = -4 * rho**2 * motion.angular / (epsilon * GRAVITY * radius)
    l1 = total - l2
    return l1, l2, (difference + l1 + 2 * l2) / 2


def study_ring(motion: Kinematics) -> RingFindings:
    """Compare first order with the ring, solve eq. 24 along `motion`, exchange mu1_eta, mu2_eta."""
    l1, l2, l3 = solve_eq_24(motion)
    l3_elsewhere = [solve_eq_24(motion, *stone)[2].max() for stone in _OTHER_STONES]
    rows = np.array([[1, -1, 2, -2], [1, 1, 1, 1], [0, 0, 1, 1]])
    combinations = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 2, 0]])
    crossing = np.flatnonzero(l1[:-1] * l1[1:] < 0)
    zero = None
    if len(crossing):
        k = crossing[0]
        zero = float(motion.t[k] - l1[k] * (motion.t[k + 1] - motion.t[k]) / (l1[k + 1] - l1[k]))
    radial_fit = fit(
        jensen_shegelski_throw(), Radial, stone=Stone(R=RADIUS, rho=RHO), unbounded=True,
        details=False,
    )  # fmt: skip
    closed_gap, ring_gap = _trajectory_differences()
    uniform, consistent = _exchange_effects()
    mu = [radial_fit.parameters[f"mu{index}"].value for index in (1, 2, 3, 4)]
    return RingFindings(
        eq_22_gap=_largest_gap_of_eq_22(),
        load_errors=_load_errors(float(EPSILONS[1])),
        radial=_expansion(Radial, first_order_radial),
        front_back=_expansion(FrontBack, first_order_front_back),
        closed_gap=closed_gap,
        ring_gap=ring_gap,
        t=motion.t,
        l1=l1,
        l2=l2,
        l3=l3,
        rank=(
            int(np.linalg.matrix_rank(rows)),
            int(np.linalg.matrix_rank(np.concatenate([rows, combinations]))),
        ),
        l1_zero=zero,
        # l1 is a constant less l2, and l2 goes as (rho/R)^2.
        l1_ratio=float(RHO / RADIUS * np.sqrt(np.max((l1 + l2) / l2))),
        l3_largest=float(max(l3_elsewhere)),
        greatest_epsilon=float(motion.epsilon(RADIUS).max()),
        radial_fit=radial_fit,
        radial_l=(mu[0] + mu[1], mu[2] + mu[3], mu[0] + 2 * mu[2]),
        split_epsilon=_SPLIT_EPSILONS,
        split_uniform=uniform,
        split_consistent=consistent,
    )


def _trajectory_differences() -> tuple[tuple[float, float], tuple[float, float]]:
    """Differences of eq. 27 in closed form from eq. 27 integrated, and of that from the full ring.

    The coefficients are those of eq. 28.
    """
    stone = Stone(R=0.054, rho=RHO)
    t = np.linspace(0, 20, 201)
    padded = np.pad(t, (0, 55), mode="edge")  # the shape of a fit's times
    problem = Problem(padded, np.zeros((3, 256)), np.zeros((3, 256)), stone, LEVEL_AND_STILL)
    mu = (0.0018, 0.058, 0.009, 0.009)
    start = np.array([*mu, 0.0, 0.0, 0.0, SPEED, 0.0, 1.0])
    closed = first_order_motion(FrontBackFirstOrder(*mu), stone, SPEED, 1.0, t)
    integrated, ring = (
        np.asarray(predict_channels(Model(law, "uniform"), start, problem))[:, : len(t)]
        for law in (FrontBackFirstOrder, FrontBack)
    )

    def difference(x: Any, y: Any, phi: Any, other: Floats) -> tuple[float, float]:
        distance = np.hypot(x - other[0], y - other[1])
        return float(distance.max()), float(np.abs(phi - other[2]).max())

    return difference(closed.x, closed.y, closed.phi, integrated), difference(
        integrated[0], integrated[1], integrated[2], ring
    )


def _exchange_effects() -> tuple[Floats, Floats]:
    one, other = SPLIT
    n = len(_SPLIT_EPSILONS)
    stone = Stone(R=RADIUS, rho=RHO, h=0.057)
    first = np.tile([0.0018, 0.058, one, other], (n, 1))
    second = np.tile([0.0018, 0.058, other, one], (n, 1))
    uniform_forces = [net_forces(FrontBack, mu, _SPLIT_EPSILONS, stone) for mu in (first, second)]
    uniform = np.max(np.abs(uniform_forces[1] / uniform_forces[0] - 1), axis=1)
    consistent_forces = [
        net_forces(FrontBack, mu, _SPLIT_EPSILONS, stone, "consistent") for mu in (first, second)
    ]
    return uniform, consistent_forces[1][:, 1] / consistent_forces[0][:, 1] - 1


def _range_of(values: Floats) -> str:
    """Smallest and largest value, to a tenth."""
    low, high = (f"{value:.1f}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def _local_claims(found: RingFindings) -> list[Claim]:
    """The error of a uniform load, and eq. 22."""
    off = np.abs(100 * found.load_errors)
    load_holds = bool((off.max(1) >= 0.5).all() and (off < 2).all())
    return [
        Claim(
            "load",
            "error of a uniform load",
            "about 1 %",
            f"{_range_of(off[:, 0])} % in T_xi, {_range_of(off[:, 1])} % in T_eta, "
            f"{_range_of(off[:, 2])} % in M_T (R = {RADIUS:g} and {EQ_28_STONE.R:g} m)",
            "holds" if load_holds else "does not hold",
            "Front-back law of eq. 28 with mu1_eta = mu2_eta, beside the load of eq. 8-9 with "
            "h = 0.057 m. The load of front and back differs from the mean by 2 h/R times the "
            "friction; where front and back nearly cancel in T_xi, the relative error is larger.",
        ),
        Claim(
            "eq22",
            "friction of the radial law at a point of the ring",
            "eq. 22 with mu1, mu3 in front, mu2, mu4 behind",
            f"agrees with eq. 18-21 within {found.eq_22_gap:.0e} of the largest friction",
            "holds" if found.eq_22_gap < 1e-12 else "does not hold",
            "At the nodes of the ring's quadrature, for eps = 0.1, 0.9, 3; it is exact in eps.",
        ),
    ]  # fmt: skip


def ring_claims(found: RingFindings) -> dict[str, Claim]:
    """The load, eq. 22, 23, 24 and 27, by id."""
    t, l1, l2, l3 = found.t, found.l1, found.l2, found.l3
    order = np.round(np.nanmin(found.radial.order), 1)
    fitted = found.radial_l
    fit_converged = found.radial_fit.converged
    closed, ring = found.closed_gap, found.ring_gap
    early = [float(l1[np.searchsorted(t, s - 1e-9)]) for s in (0, 10, 20)]
    determined = found.rank == (3, 3)
    claims = [
        Claim(
            "eq23",
            "radial law to first order in eps",
            "T_xi, T_eta, M_T of eq. 23, for eps <= 0.1",
            f"T_xi exact ({found.radial.gap[0, 0]:.0e}), the others within "
            f"{100 * found.radial.largest:.2g} % of the ring at eps = 0.1, falling as "
            f"eps^{order:g}; eps <= {found.greatest_epsilon:.3f} on t <= 20 s",
            "holds" if found.radial.largest < _SMALL and order == 2
            and found.greatest_epsilon < 0.1 else "does not hold",
            "Each coefficient in turn, against the full ring integrals under uniform load: the "
            "next term is of second order.",
        ),
        Claim(
            "eq24-l1",
            "l1 = mu1 + mu2 of the radial law",
            "negative for all t <= 20 s (R = 0.065 m, rho = 0.1 m)",
            f"{early[0]:.4f}, {early[1]:.4f}, {early[2]:+.4f} at t = 0, 10, 20 s; negative "
            f"throughout if rho/R > {found.l1_ratio:.3f}",
            "holds" if found.l1_zero is None else "does not hold",
            f"It depends on rho/R, here {RHO / RADIUS:.3f}"
            + ("" if found.l1_zero is None else f": l1 changes its sign at {found.l1_zero:.1f} s")
            + ". With R and rho = "
            + " or ".join(f"{radius:g} and {rho:g} m" for radius, rho in _OTHER_STONES)
            + " it is negative throughout. The conclusion rests on l3, which is negative for each "
            f"of these (at most {found.l3_largest:.3f}).",
        ),
        Claim(
            "eq24-l2",
            "l2 = mu3 + mu4 of the radial law",
            "determined uniquely (no value)",
            f"{l2.min():.4f} .. {l2.max():.4f}, {l2[0]:.4f} at t = 0",
            "holds" if determined and bool(np.all(np.isfinite(l2))) else "does not hold",
            f"Eq. 24 has rank {found.rank[0]} in four unknowns and l1, l2, l3 lie in its row "
            "space; l2 is positive and no obstacle.",
        ),
        Claim(
            "eq24-l3",
            "l3 = mu1 + 2 mu3 of the radial law",
            "negative for all t <= 20 s, so the law does not apply",
            f"{l3.min():.4f} .. {l3.max():.4f}; fit of the whole path {fitted[2]:.4f}",
            "holds" if bool(np.all(l3 < 0)) and fit_converged and fitted[2] < 0
            else "does not hold",
            "mu1 or mu3 would have to be negative at every t; a trajectory fit with coefficients "
            "of either sign agrees (l1, l2, l3 = "
            f"{fitted[0]:.4f}, {fitted[1]:.4f}, {fitted[2]:.4f}).",
        ),
        Claim(
            "eq27",
            "front-back law to first order in eps",
            "right sides of eq. 27, for eps <= 0.1",
            f"T_xi exact ({found.front_back.gap[0, 0]:.0e}), the others within "
            f"{100 * found.front_back.largest:.2g} % of the ring at eps = 0.1; over 20 s the paths "
            f"differ by {1000 * ring[0]:.2g} mm, {1000 * ring[1]:.2g} mrad",
            "holds" if found.front_back.largest < _SMALL and found.front_back.gap[0, 0] < 1e-6
            and closed[0] < 1e-5 else "does not hold",
            "Full ring integrals under uniform load; the closed form of eq. 27 and its stepwise "
            f"integration agree to {closed[0]:.0e} m.",
        ),
    ]  # fmt: skip
    return {claim.id: claim for claim in (*_local_claims(found), *claims)}
