"""Anisotropic friction on the ring, and its coefficients: load, eq. 22-24, 27, 28, and split."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations, contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.errors import UnusableFitError
from curlfit.friction import Load, LocalLaw
from curlfit.friction.anisotropic import Radial
from curlfit.friction.front_back import FrontBack, FrontBackFirstOrder
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.paper.claim import Claim, verdict
from curlfit.paper.isotropic import TIMES, Motion, motion
from curlfit.paper.printed import (
    EQ_28_STONE,
    EQ_28_UNTIL,
    HALF_DIGIT,
    PRINTED,
    RADIUS,
    RHO,
    SOLID_RHO,
    Row,
    first_order_motion,
    jensen_shegelski_throw,
)
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.throw import Throw

_STONE = Stone(R=RADIUS, rho=RHO, h=0.057)
_OTHER_STONES = ((RADIUS, 0.1045), (0.0625, SOLID_RHO), (EQ_28_STONE.R, RHO))
"""R and rho that the paper prints elsewhere, or that round to what it prints, m."""
_SPEED = 2.0  # m/s, of the states compared
EPSILONS = np.array([0.1, 0.05, 0.025])
_SMALL = 0.005  # relative difference at eps = 0.1: half of eps^2
_TEST_VALUE = 0.01  # each coefficient in turn; the laws are linear in them
SPLIT = (0.012, 0.006)
"""mu1_eta and mu2_eta of the example, exchanged for the comparison."""
_SPLIT_EPSILONS = np.array([0.01, 0.1, 0.5, 0.9, 0.99, 1.01, 1.5, 3.0, 10.0])

RANGES = ((0.0535, 0.0545), (0.095, 0.105))
"""Ring radii that round to the printed 0.054 m, and radii of gyration assumed to be compatible with
the printed 0.1 m, m."""
_NODES = 5  # Chebyshev nodes in R and in rho, at which the path is fitted
_DRAWS = 20_000

_ORIGIN = {"x0": 0.0, "y0": 0.0, "phi0": 0.0}
_EVEN = "trajectory fit, even weights"  # 1 m weighted like 1 rad
_FITS: list[tuple[str, float, float, float, dict[str, float]]] = [
    *(("trajectory fit", *stone, 20.0, {}) for stone in ((0.054, RHO), (0.054, SOLID_RHO))),
    ("trajectory fit", 0.0535, SOLID_RHO, 20.0, {}),
    *(("trajectory fit", 0.054, SOLID_RHO, until, {}) for until in (10.0, 15.0, 18.0, 22.0)),
    (_EVEN, 0.054, RHO, 20.0, {}),
    *((_EVEN + ", from the origin", 0.054, rho, 20.0, _ORIGIN) for rho in (RHO, SOLID_RHO)),
    (_EVEN + ", from the origin at 2 m/s", 0.054, RHO, 20.0, {**_ORIGIN, "v0": 2.0}),
    (_EVEN + ", start of eq. 13", 0.054, RHO, 20.0,
     {**_ORIGIN, "v0": 2.0, "heading": 0.0, "omega0": 1.0}),
    *(("trajectory fit", RADIUS, rho, 20.0, {}) for rho in (RHO, SOLID_RHO)),
]  # fmt: skip
"""Method, R, rho, end of the window, and fixed start of the fits of the trajectory."""


def net_forces(
    law: type[LocalLaw], values: Floats, epsilon: Any, stone: Stone = _STONE, load: Load = "uniform"
) -> Floats:
    """Force over m g (right, forward) and moment over m g R, shape (n, 3).

    `values` are coefficients of shape (n, coefficients), `epsilon` has shape (n,); v = 2 m/s.
    """
    found = _net_accelerations(law, load, values, stone, _SPEED * epsilon / stone.R)
    xi, eta, angular = (np.asarray(part) for part in found)
    return np.stack([xi, eta, angular * stone.rho**2 / stone.R], 1) / GRAVITY


@compiled("law", "load")
def _net_accelerations(
    law: type[LocalLaw], load: Load, values: Array, stone: Stone, spin: Array
) -> Any:
    def one(values: Array, spin: Array) -> Any:
        return accelerations(law.from_vector(values), stone, load, jnp.asarray(_SPEED), spin)

    return jax.vmap(one)(values, spin)


def uniform_load(_found: Any) -> Claim:
    """The error of a uniform load."""
    mu, errors = np.array([[*PRINTED[:2], *[PRINTED[2] / 2] * 2]]), []
    for radius in (RADIUS, EQ_28_STONE.R):
        stone = Stone(R=radius, h=0.057)
        uniform, consistent = (
            net_forces(FrontBack, mu, EPSILONS[1:2], stone, load)
            for load in ("uniform", "consistent")
        )
        errors.append(100 * np.abs(uniform / consistent - 1)[0])
    off = np.array(errors)
    ranges = [
        " to ".join(dict.fromkeys(f"{end:.1f}" for end in (values.min(), values.max())))
        for values in off.T
    ]
    return Claim(
        "load",
        "error of a uniform load",
        "about 1 %",
        f"{ranges[0]} % in T_xi, {ranges[1]} % in T_eta, {ranges[2]} % in M_T (R = {RADIUS:g} and "
        f"{EQ_28_STONE.R:g} m)",
        verdict((off.max(1) >= 0.5).all() and (off < 2).all()),
        "Front-back law of eq. 28 with mu1_eta = mu2_eta, beside the load of eq. 8-9 with "
        "h = 0.057 m. The load of front and back differs from the mean by 2 h/R times the "
        "friction; where front and back nearly cancel in T_xi, the relative error is larger.",
    )


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
    contact = contact_of(law, stone, "uniform", _SPEED, _SPEED * epsilon / stone.R)
    ring = panels(law, *contact.motion, contact.clustering)
    return [(points.angle, jnp.stack(law.traction(points))) for points, _ in ring]


def eq_22(_found: Any) -> Claim:
    """The radial law at a point."""
    mu = np.array([0.006, 0.008, 0.009, 0.018])
    gap = max(
        np.abs(np.asarray(own) - radial_at(mu, epsilon, np.asarray(angle))).max() / mu.max()
        for epsilon in (0.1, 0.9, 3.0)
        for angle, own in _radial_at_nodes(mu, Stone(R=RADIUS), epsilon)
    )
    return Claim(
        "eq22",
        "friction of the radial law at a point of the ring",
        "eq. 22 with mu1, mu3 in front, mu2, mu4 behind",
        f"agrees with eq. 18-21 within {gap:.0e} of the largest friction",
        verdict(gap < 1e-12),
        "At the nodes of the ring's quadrature, for eps = 0.1, 0.9, 3; it is exact in eps.",
    )


def first_order_radial(mu: Floats, epsilon: Floats) -> Floats:
    """Eq. 23 over m g, m g and m g R; arguments and shape as in `net_forces`."""
    m1, m2, m3, m4 = mu.T
    across = epsilon * (m1 - m2 + 2 * m3 - 2 * m4) / (3 * np.pi)
    return np.stack([across, -(m1 + m2 + m3 + m4) / 4, -epsilon * (m3 + m4) / 4], 1)


def first_order_front_back(mu: Floats, epsilon: Floats) -> Floats:
    """The right sides of eq. 27 in the same form."""
    m1_xi, m2_xi, m1_eta, m2_eta = mu.T
    across = epsilon * (m1_xi - m2_xi) / np.pi
    return np.stack([across, -(m1_eta + m2_eta) / 2, -epsilon * (m1_xi + m2_xi) / 4], 1)


def _gaps(law: type[LocalLaw], first_order: Any) -> Floats:
    """Largest difference between first order and the ring, for each of EPSILONS in T_xi, T_eta, M:
    coefficients in turn, relative to the largest contribution, since some contribute nothing."""
    mu = np.tile(_TEST_VALUE * np.eye(4), (len(EPSILONS), 1))
    epsilon = np.repeat(EPSILONS, 4)
    approximate = first_order(mu, epsilon)
    difference = net_forces(law, mu, epsilon) - approximate
    gap, size = (np.abs(one).reshape(-1, 4, 3).max(1) for one in (difference, approximate))
    return gap / size


def solve_eq_24(radius: float = RADIUS, rho: float = RHO) -> Floats:
    """l1 = mu1 + mu2, l2 = mu3 + mu4, l3 = mu1 + 2 mu3 at each time, shape (3, n)."""
    now = motion()
    slope = radius * now.curvature * GRAVITY
    l2 = -4 * rho**2 * now.angular / (slope * radius)
    l1 = -4 * now.eta / GRAVITY - l2
    return np.stack([l1, l2, (3 * np.pi * now.xi / slope + l1 + 2 * l2) / 2])


def study_ring() -> SimpleNamespace:
    """Compare first order with the ring, solve eq. 24 along the path, exchange mu1_eta, mu2_eta."""
    combinations = solve_eq_24()
    l1 = combinations[0]
    k = np.flatnonzero(l1[:-1] * l1[1:] < 0)[:1]
    zero = TIMES[k] - l1[k] * (TIMES[k + 1] - TIMES[k]) / (l1[k + 1] - l1[k])
    radial = fit(
        jensen_shegelski_throw(), Radial, stone=Stone(R=RADIUS, rho=RHO), unbounded=True,
        details=False,
    )  # fmt: skip
    mu = [radial.parameters[f"mu{index}"].value for index in (1, 2, 3, 4)]
    one, other = (
        np.tile([0.0018, 0.058, *split], (len(_SPLIT_EPSILONS), 1))
        for split in (SPLIT, SPLIT[::-1])
    )
    uniform, consistent = (
        net_forces(FrontBack, other, _SPLIT_EPSILONS, _STONE, load)
        / net_forces(FrontBack, one, _SPLIT_EPSILONS, _STONE, load)
        - 1
        for load in ("uniform", "consistent")
    )
    return SimpleNamespace(
        t=TIMES, l=combinations, l1_zero=float(zero[0]) if len(zero) else None, epsilon=EPSILONS,
        fitted_l=(mu[0] + mu[1], mu[2] + mu[3], mu[0] + 2 * mu[2]), converged=radial.converged,
        radial_gap=_gaps(Radial, first_order_radial), split_epsilon=_SPLIT_EPSILONS,
        front_back_gap=_gaps(FrontBack, first_order_front_back),
        split_uniform=np.abs(uniform).max(1), split_consistent=consistent[:, 1],
    )  # fmt: skip


def eq_23(found: Any) -> Claim:
    """The radial law to first order."""
    gap, most = found.ring.radial_gap, (RADIUS * motion().curvature).max()
    order = np.round(np.log(gap[0, 1:] / gap[-1, 1:]).min() / np.log(EPSILONS[0] / EPSILONS[-1]), 1)
    return Claim(
        "eq23",
        "radial law to first order in eps",
        "T_xi, T_eta, M_T of eq. 23, for eps <= 0.1",
        f"T_xi exact ({gap[0, 0]:.0e}), the others within {100 * gap[0].max():.2g} % of the ring "
        f"at eps = 0.1, falling as eps^{order:g}; eps <= {most:.3f} on t <= 20 s",
        verdict(gap[0].max() < _SMALL and gap[0, 0] < 1e-6 and order == 2 and most < 0.1),
        "Each coefficient in turn, against the full ring integrals under uniform load: the "
        "next term is of second order.",
    )


def eq_24_l1(found: Any) -> Claim:
    """The first combination of eq. 24, which depends on rho/R."""
    (l1, l2, _), zero = found.ring.l, found.ring.l1_zero
    # l1 is a constant less l2, and l2 goes as (rho/R)^2.
    ratio = RHO / RADIUS * np.sqrt(((l1 + l2) / l2).max())
    largest = max(solve_eq_24(*stone)[2].max() for stone in _OTHER_STONES)
    return Claim(
        "eq24-l1",
        "l1 = mu1 + mu2 of the radial law",
        "negative for all t <= 20 s (R = 0.065 m, rho = 0.1 m)",
        f"{l1[0]:.4f}, {l1[100]:.4f}, {l1[200]:+.4f} at t = 0, 10, 20 s; negative "
        f"throughout if rho/R > {ratio:.3f}",
        verdict(zero is None),
        f"It depends on rho/R, here {RHO / RADIUS:.3f}"
        + ("" if zero is None else f": l1 changes its sign at {zero:.1f} s")
        + ". With R and rho = "
        + " or ".join(f"{radius:g} and {rho:g} m" for radius, rho in _OTHER_STONES)
        + " it is negative throughout. The conclusion rests on l3, which is negative for each "
        f"of these (at most {largest:.3f}).",
    )


def eq_24_l2(found: Any) -> Claim:
    """The second combination."""
    l2 = found.ring.l[1]
    rows = np.array([[1, -1, 2, -2], [1, 1, 1, 1], [0, 0, 1, 1]])
    combinations = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 2, 0]])
    rank, joint = (np.linalg.matrix_rank(of) for of in (rows, np.concatenate([rows, combinations])))
    return Claim(
        "eq24-l2",
        "l2 = mu3 + mu4 of the radial law",
        "determined uniquely (no value)",
        f"{l2.min():.4f} .. {l2.max():.4f}, {l2[0]:.4f} at t = 0",
        verdict(rank == joint == 3 and np.isfinite(l2).all()),
        f"Eq. 24 has rank {rank} in four unknowns and l1, l2, l3 lie in its row "
        "space; l2 is positive and no obstacle.",
    )


def eq_24_l3(found: Any) -> Claim:
    """The third combination, on which the conclusion rests."""
    l3, fitted = found.ring.l[2], found.ring.fitted_l
    return Claim(
        "eq24-l3",
        "l3 = mu1 + 2 mu3 of the radial law",
        "negative for all t <= 20 s, so the law does not apply",
        f"{l3.min():.4f} .. {l3.max():.4f}; fit of the whole path {fitted[2]:.4f}",
        verdict((l3 < 0).all() and found.ring.converged and fitted[2] < 0),
        "mu1 or mu3 would have to be negative at every t; a trajectory fit with coefficients "
        f"of either sign agrees (l1, l2, l3 = {', '.join(f'{value:.4f}' for value in fitted)}).",
    )


def eq_27(found: Any) -> Claim:
    """The front-back law to first order: forces, and paths with the coefficients of eq. 28."""
    gap = found.ring.front_back_gap
    stone, mu = Stone(R=0.054, rho=RHO), (0.0018, 0.058, 0.009, 0.009)
    padded = np.pad(TIMES, (0, 55), mode="edge")  # the shape of a fit's times
    problem = Problem(padded, np.zeros((3, 256)), np.zeros((3, 256)), stone, LEVEL_AND_STILL)
    start = np.array([*mu, 0.0, 0.0, 0.0, _SPEED, 0.0, 1.0])
    integrated, ring = (
        np.asarray(predict_channels(Model(law, "uniform"), start, problem))[:, : len(TIMES)]
        for law in (FrontBackFirstOrder, FrontBack)
    )
    closed = first_order_motion(FrontBackFirstOrder(*mu), stone, _SPEED, 1.0, TIMES)
    error = np.hypot(closed.x - integrated[0], closed.y - integrated[1]).max()
    x, y, phi = (integrated - ring)[:3]
    return Claim(
        "eq27",
        "front-back law to first order in eps",
        "right sides of eq. 27, for eps <= 0.1",
        f"T_xi exact ({gap[0, 0]:.0e}), the others within {100 * gap[0].max():.2g} % of the ring "
        f"at eps = 0.1; over 20 s the paths differ by {1000 * np.hypot(x, y).max():.2g} mm, "
        f"{1000 * np.abs(phi).max():.2g} mrad",
        verdict(gap[0].max() < _SMALL and gap[0, 0] < 1e-6 and error < 1e-5),
        "Full ring integrals under uniform load; the closed form of eq. 27 and its stepwise "
        f"integration agree to {error:.0e} m.",
    )


def pointwise(motion: Motion, radius: float, rho: float) -> Floats:
    """Eq. 27 solved at each time: mu1_xi, mu2_xi, mu1_eta + mu2_eta, shape (3, n)."""
    slope = radius * motion.curvature * GRAVITY
    difference = np.pi * motion.xi / slope
    total = -4 * rho**2 * motion.angular / (slope * radius)
    return np.stack([(total + difference) / 2, (total - difference) / 2, -2 * motion.eta / GRAVITY])


def least_squares(motion: Motion, radius: float, rho: float) -> Floats:
    """Constant coefficients by least squares on each line of eq. 27, shape (3,)."""
    weight = motion.curvature**2 / (motion.curvature**2).sum()
    across, back, along = pointwise(motion, radius, rho)
    return np.array([(across * weight).sum(), (back * weight).sum(), along.mean()])


def coefficients_of(result: FitResult) -> Floats:
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta of a fit of the front-back law."""
    mu = {name: result.parameters[name].value for name in result.coefficients}
    return np.array([mu["mu1_xi"], mu["mu2_xi"], mu["mu1_eta"] + mu["mu2_eta"]])


def rounds_to_print(mu: Floats) -> Any:
    """Whether coefficients, shape (..., 3), round to eq. 28 as printed."""
    return (np.abs(mu - PRINTED) <= HALF_DIGIT).all(-1)


def _fitted(
    throw: Throw, radius: float, rho: float, until: float = EQ_28_UNTIL, fix: Any = None
) -> FitResult:
    """A fit with coefficients of either sign."""
    result = fit(
        throw, "front-back", stone=Stone(R=radius, rho=rho), until=until, unbounded=True,
        details=False, systematics={ALL: 0.0}, fix=fix or None,
    )  # fmt: skip
    if not result.converged:
        raise UnusableFitError(f"R = {radius:g} m, rho = {rho:g} m: {result.status}")
    return result


def study_eq_28() -> SimpleNamespace:
    """Compute eq. 28 by every method that is compatible with the paper."""
    throw, R = jensen_shegelski_throw(), EQ_28_STONE.R
    even = throw.with_sigma({"x": 1.0, "y": 1.0, "phi": 1.0})
    mean = "eq. 27 at each t, mean"
    rows = []
    for radius, rho, until in (
        (R, RHO, 20.0), (R, SOLID_RHO, 20.0), (0.0535, SOLID_RHO, 20.0), (R, SOLID_RHO, 18.0),
    ):  # fmt: skip
        mu = pointwise(motion(until), radius, rho).mean(1)
        rows.append(Row(mean, radius, rho, until, mu))
    for radius, until in ((R, 20.0), (R, 18.0), (0.0535, 18.0)):
        mu = least_squares(motion(until), radius, SOLID_RHO)
        rows.append(Row(mean.replace("mean", "least squares"), radius, SOLID_RHO, until, mu))
    for ending, printed in ((", wrong sign of eq. 14", "x"), (", eq. 14 as printed", "xy")):
        mu = pointwise(motion(printed=printed), R, RHO).mean(1)
        rows.append(Row(mean + ending, R, RHO, 20.0, mu))
    fits = []
    for method, radius, rho, until, fix in _FITS:
        fits.append(_fitted(even if method.startswith(_EVEN) else throw, radius, rho, until, fix))
        rows.append(Row(method, radius, rho, until, coefficients_of(fits[-1])))
    return SimpleNamespace(
        rows=rows, fit=fits[0], solid=fits[1], posterior=marginalize_stone(throw, fits[0])
    )


def _stone_posterior(throw: Throw, sigma: Mapping[str, float], radius: float, rho: float) -> Floats:
    """The Gaussian posterior of a fit with a given stone: the mean of the three coefficients, the
    lower triangle of the Cholesky factor of their covariance, chi-squared, and half the logarithm
    of the determinant of the covariance of all parameters."""
    result = _fitted(throw, radius, rho)
    names = result.information["names"]
    # Only the sum of mu1_eta and mu2_eta enters: one column in place of two.
    columns = [name for name in names if name != "mu2_eta"]
    basis = np.zeros((len(names), len(columns)))
    for index, name in enumerate(names):
        half = name in ("mu1_eta", "mu2_eta")
        basis[index, columns.index("mu1_eta" if half else name)] = 0.5 if half else 1.0
    information = basis.T @ np.array(result.information["matrix"]) @ basis
    order = [columns.index(name) for name in ("mu1_xi", "mu2_xi", "mu1_eta")]
    factor = np.linalg.cholesky(np.linalg.inv(information)[np.ix_(order, order)])
    residual = [(result.observed[name] - result.fitted[name]) / sigma[name] for name in sigma]
    spread = np.sum(np.square(residual)), -0.5 * np.linalg.slogdet(information)[1]
    return np.array([*coefficients_of(result), *factor[np.tril_indices(3)], *spread])


def _lower(flat: Floats) -> Floats:
    """Cholesky factors from vectors of `_stone_posterior`, shape (n, 3, 3)."""
    factor = np.zeros((len(flat), 3, 3))
    factor[:, *np.tril_indices(3)] = flat[:, 3:9]
    return factor


def marginalize_stone(throw: Throw, central: FitResult, seed: int = 1) -> SimpleNamespace:
    """The posterior of the coefficients with R and rho uniform over their printed rounding.

    At a given stone the posterior of all other parameters is Gaussian about its own fit (the
    noise, estimated once, is small beside every scale of the model). Its mean, covariance,
    chi-squared and volume are smooth in (R, rho): fits at 5 x 5 Chebyshev nodes are interpolated.
    Stones are drawn uniformly, weighted by their marginal likelihood (volume times
    exp(-chi-squared/2)), and coefficients drawn for each; draws with a negative coefficient
    are rejected, by the flat prior on mu >= 0.
    """
    known = throw.with_sigma(dict(central.sigma))
    low, high = np.array(RANGES).T

    def stones(unit: Floats) -> Floats:
        return (low + high) / 2 + (high - low) / 2 * unit

    def at(places: Any) -> Floats:
        return np.stack([_stone_posterior(known, central.sigma, *one) for one in stones(places)])

    def terms(places: Any) -> Floats:
        a, b = np.transpose(places)
        return np.polynomial.chebyshev.chebvander2d(a, b, [_NODES - 1] * 2)

    nodes = np.array([*product(np.polynomial.chebyshev.chebpts1(_NODES), repeat=2)])
    series = np.linalg.solve(terms(nodes), at(nodes))
    between = np.array([[0.9, -0.9], [-1.0, 1.0]])
    noise = np.sqrt((_lower(terms(np.zeros((1, 2))) @ series)[0] ** 2).sum(-1))
    error = np.abs(terms(between) @ series - at(between))

    random = np.random.default_rng(seed)
    places = random.uniform(-1, 1, (2, _DRAWS)).T
    found = terms(places) @ series
    evidence = found[:, -1] - found[:, -2] / 2
    weight = np.exp(evidence - evidence.max())
    mu = found[:, :3] + np.einsum("nij,nj->ni", _lower(found), random.standard_normal((_DRAWS, 3)))
    free = random.choice(_DRAWS, _DRAWS, p=weight / weight.sum())
    positive = (mu > 0).all(1)
    allowed = weight * positive
    selected = random.choice(_DRAWS, _DRAWS, p=allowed / allowed.sum())
    interval, free_interval = (
        np.quantile(mu[rows], [0.025, 0.975], axis=0).T for rows in (selected, free)
    )
    nearest = np.argmin((np.abs(found[:, :3] - PRINTED) / HALF_DIGIT).max(1))
    return SimpleNamespace(
        limits=RANGES, stones=stones(places)[selected], mu=mu[selected], interval=interval,
        free_interval=free_interval, noise=noise, preference=np.ptp(found[:, -2]),
        positive=positive[free].mean(), effective=allowed.sum() ** 2 / (allowed**2).sum(),
        check=max((error[:, :3] / noise).max(), error[:, -2:].max()),
        share=rounds_to_print(mu[selected]).mean(), nearest=stones(places)[nearest],
    )  # fmt: skip


def eq_28(found: Any) -> Claim:
    """The coefficients of the front-back law."""
    eq28, vary = found.eq28, found.eq28.posterior
    mu, solid = coefficients_of(eq28.fit), coefficients_of(eq28.solid)
    low, high = vary.interval.T
    inside = (low <= PRINTED) & (high >= PRINTED)
    covered = (low <= PRINTED + HALF_DIGIT) & (high >= PRINTED - HALF_DIGIT)
    contained, touched = (
        " and ".join(f"{value:g}" for value in PRINTED[rows])
        for rows in (inside, covered & ~inside)
    )
    by_rounding = f" and overlap {touched} within its rounding" if touched else ""
    same = next((row for row in eq28.rows if rounds_to_print(row.mu)), None)
    how = "by none of the methods" if same is None else (
        f'by the method "{same.method}" with R = {same.radius:g} m, rho = {same.rho:g} m'
    )  # fmt: skip
    values, of_solid = (", ".join(f"{value:.4f}" for value in row) for row in (mu, solid))
    return Claim(
        "eq28",
        "mu1_xi, mu2_xi, mu1_eta + mu2_eta of the front-back law",
        f"{', '.join(f'{value:g}' for value in PRINTED)} (R = 0.054 m, rho = 0.1 m)",
        f"{values}; with rho = {SOLID_RHO:.4f} m {of_solid}; 95 % over the rounding of R and rho: "
        f"{low[0]:.4f} .. {high[0]:.4f}, {low[1]:.4f} .. {high[1]:.4f}, {low[2]:.5f} .. "
        f"{high[2]:.5f}",
        verdict(covered.all() and vary.share > 0, corrected=not rounds_to_print(mu)),
        f"The intervals contain {contained or 'none of the printed values'}{by_rounding}; their "
        f"width comes from R and rho, not from noise ({vary.noise[0]:.0e} in mu1_xi); all printed "
        f"digits are reproduced {how}.",
    )


def ratio(found: Any) -> Claim:
    """Transversal over tangential friction."""
    one, other = (
        mu[:2].sum() / mu[2] for mu in map(coefficients_of, (found.eq28.fit, found.eq28.solid))
    )
    return Claim(
        "ratio",
        "transversal over tangential friction",
        "about three",
        f"{one:.2f}; {other:.2f} with rho = {SOLID_RHO:.4f} m",
        verdict(2.5 <= one < 3.5 and 2.5 <= other < 3.5),
        "Mean of mu1_xi and mu2_xi over mean of mu1_eta and mu2_eta, from the trajectory fit.",
    )


def split(found: Any) -> Claim:
    """What of the sum mu1_eta + mu2_eta is not determined."""
    ring, singular = found.ring, found.eq28.fit.singular_values
    exchanged = [*found.eq28.fit.null_directions] == [{"mu1_eta": 1.0, "mu2_eta": -1.0}]
    greatest, slow = ring.split_uniform.max(), ring.split_consistent[ring.split_epsilon == 0.1][0]
    return Claim(
        "split",
        "mu1_eta and mu2_eta are not defined uniquely",
        "only their sum is",
        f"singular value {singular[-1]:.0e} beside {singular[-2]:.0f} along "
        f"(1, -1); exchanging {SPLIT[0]:g} and {SPLIT[1]:g} changes the ring forces by "
        f"{greatest:.0e} (uniform load), T_eta by {100 * abs(slow):.2f} % (consistent)",
        verdict(exchanged and greatest < 1e-12),
        "Under uniform load the integrals of the two halves are equal term by term at every "
        "eps, beyond 1 too; the consistent load separates them, but correlates them with the sum.",
    )
