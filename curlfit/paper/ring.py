"""Claims about anisotropic friction on the ring: eq. 23, 24 and 27, and the split of eq. 28."""

from __future__ import annotations

from typing import Any

from curlfit.dynamics.contact import accelerations

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.friction import Load, LocalLaw
from curlfit.friction.anisotropic import Radial
from curlfit.friction.front_back import FrontBack, FrontBackFirstOrder
from curlfit.inference.fit.fit import fit
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Floats
from curlfit.paper.claim import Claim
from curlfit.paper.findings import RADIUS, Expansion, Kinematics, RingFindings
from curlfit.paper.printed import first_order_motion, jensen_shegelski_throw
from curlfit.stone import GRAVITY, Stone

RHO = 0.1
"""Radius of gyration of sect. 4, m."""
SPEED = 2.0
"""Speed of the test states, m/s."""
EPSILONS = np.array([0.1, 0.05, 0.025])
SPLIT = (0.012, 0.006)
"""mu1_eta and mu2_eta of the example, exchanged for the comparison."""
_SPLIT_EPSILONS = np.array([0.01, 0.1, 0.5, 0.9, 0.99, 1.01, 1.5, 3.0, 10.0])
_SMALL = 0.005  # relative difference at eps = 0.1: half of eps^2
_TEST_VALUE = 0.01  # each coefficient in turn; the laws are linear in them


def net_forces(
    law: type[LocalLaw], values: Floats, epsilon: Floats, stone: Stone, load: Load = "uniform"
) -> Floats:
    """Force over m g (right, forward) and moment over m g R, shape (n, 3).

    `values` are coefficients of shape (n, coefficients), `epsilon` has shape (n,); v = 2 m/s.
    """
    columns = [jnp.asarray(values[:, index]) for index in range(values.shape[1])]
    spin = jnp.asarray(SPEED * epsilon / stone.R)
    acceleration = _compiled_net(law.from_vector(columns), stone, spin, load)
    moment = np.asarray(acceleration.angular) * stone.rho**2 / stone.R
    return (
        np.stack([np.asarray(acceleration.xi), np.asarray(acceleration.eta), moment], 1) / GRAVITY
    )


def _net_accelerations(law: Any, stone: Stone, spin: Array, load: Load) -> Any:
    return jax.vmap(lambda law, w: accelerations(law, stone, load, jnp.asarray(SPEED), w))(
        law, spin
    )


_compiled_net = jax.jit(_net_accelerations, static_argnames="load")


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


def solve_eq_24(motion: Kinematics) -> tuple[Floats, Floats, Floats]:
    """l1 = mu1 + mu2, l2 = mu3 + mu4, l3 = mu1 + 2 mu3 at each time."""
    epsilon = motion.epsilon(RADIUS)
    difference = 3 * np.pi * motion.xi / (epsilon * GRAVITY)  # mu1 - mu2 + 2 mu3 - 2 mu4
    total = -4 * motion.eta / GRAVITY
    l2 = -4 * RHO**2 * motion.angular / (epsilon * GRAVITY * RADIUS)
    l1 = total - l2
    return l1, l2, (difference + l1 + 2 * l2) / 2


def study_ring(motion: Kinematics) -> RingFindings:
    """Compare first order with the ring, solve eq. 24 along `motion`, exchange mu1_eta, mu2_eta."""
    l1, l2, l3 = solve_eq_24(motion)
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


def ring_claims(found: RingFindings) -> dict[str, Claim]:
    """Eq. 23, 24 and 27, by id."""
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
            "negative for all t <= 20 s",
            f"{early[0]:.4f}, {early[1]:.4f}, {early[2]:+.4f} at t = 0, 10, 20 s",
            "holds" if bool(np.all(l1 < 0)) else "does not hold",
            ("With the right derivatives l1 is negative throughout."
            if found.l1_zero is None
            else f"With the right derivatives l1 changes its sign at t = {found.l1_zero:.1f} s; "
            "the conclusion rests on l3."),
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
    return {claim.id: claim for claim in claims}
