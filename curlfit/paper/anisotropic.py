"""Anisotropic friction on the ring, and its coefficients: load, eq. 22-24, 27,
28, and split."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
from jax import Array

from curlfit.dynamics.contact import contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.errors import UnusableFitError
from curlfit.friction import Load, LocalLaw
from curlfit.friction.anisotropic import Radial
from curlfit.friction.front_back import FrontBack, FrontBackFirstOrder
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.initial_values import accelerations_along
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import LEVEL_AND_STILL, Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked
from curlfit.numerics.compiled import compiled
from curlfit.paper.claim import Judged, judged
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
"""Ring radii that round to the printed 0.054 m, and radii of gyration assumed to be
compatible with the printed 0.1 m, m."""
_NODES = 5  # Chebyshev nodes in R and in rho, at which the path is fitted
_DRAWS = 20_000

_ORIGIN = {"x0": 0.0, "y0": 0.0, "phi0": 0.0}
_EVEN = "trajectory fit, even weights"  # 1 m weighted like 1 rad
_FITS: list[tuple[str, float, float, float, dict[str, float]]] = [
    *(
        ("trajectory fit", *stone, 20.0, {})
        for stone in ((0.054, RHO), (0.054, SOLID_RHO))
    ),
    ("trajectory fit", 0.0535, SOLID_RHO, 20.0, {}),
    *(
        ("trajectory fit", 0.054, SOLID_RHO, until, {})
        for until in (10.0, 15.0, 18.0, 22.0)
    ),
    (_EVEN, 0.054, RHO, 20.0, {}),
    *(
        (_EVEN + ", from the origin", 0.054, rho, 20.0, _ORIGIN)
        for rho in (RHO, SOLID_RHO)
    ),
    (_EVEN + ", from the origin at 2 m/s", 0.054, RHO, 20.0, {**_ORIGIN, "v0": 2.0}),
    (
        _EVEN + ", start of eq. 13",
        0.054,
        RHO,
        20.0,
        {**_ORIGIN, "v0": 2.0, "heading": 0.0, "omega0": 1.0},
    ),
    *(("trajectory fit", RADIUS, rho, 20.0, {}) for rho in (RHO, SOLID_RHO)),
]
"""Method, R, rho, end of the window, and fixed start of the fits of the trajectory."""


def net_forces(
    law: type[LocalLaw],
    values: Floats,
    epsilon: Floats,
    stone: Stone = _STONE,
    load: Load = Load.UNIFORM,
) -> Floats:
    """Force over m g (right, forward) and moment over m g R, shape (n, 3).

    `values` are coefficients of shape (n, coefficients), `epsilon` has shape
    (n,); v = 2 m/s.
    """
    states = np.zeros((1, 4, len(values)))
    states[:, 0], states[:, 1] = _SPEED, _SPEED * epsilon / stone.R
    found = accelerations_along(
        Model(law, load), values[None], stacked([stone]), states, batch=1
    )
    return found[0].T * [1.0, 1.0, stone.rho**2 / stone.R] / GRAVITY


def uniform_load(_found: Any) -> Judged:
    """The error of a uniform load."""
    mu, errors = np.array([[*PRINTED[:2], *[PRINTED[2] / 2] * 2]]), []
    for radius in (RADIUS, EQ_28_STONE.R):
        stone = Stone(R=radius, h=0.057)
        uniform, consistent = (
            net_forces(FrontBack, mu, EPSILONS[1:2], stone, load)
            for load in (Load.UNIFORM, Load.CONSISTENT)
        )
        errors.append(100 * np.abs(uniform / consistent - 1)[0])
    off = np.array(errors)
    ranges = [
        " to ".join(dict.fromkeys(f"{end:.1f}" for end in (values.min(), values.max())))
        for values in off.T
    ]
    return judged((off.max(1) >= 0.5).all() and (off < 2).all(), ranges=ranges)


def radial_at(mu: Floats, epsilon: float, angle: Floats) -> Floats:
    """Eq. 22: friction of the radial law to the right and forward over the load,
    shape (2, n).

    `mu` are mu1..mu4, `angle` the polar angles of the points in rad, shape (n,).
    """
    normal, tangent = np.where(angle > 0, mu[0::2, None], mu[1::2, None])
    sin, cos = np.sin(angle), np.cos(angle)
    right = (normal - tangent) * sin * cos - epsilon * tangent * sin
    forward = normal * sin**2 + tangent * cos**2 + epsilon * tangent * cos
    return -np.stack([right, forward]) / np.sqrt(1 + 2 * epsilon * cos + epsilon**2)


@compiled()
def _at_nodes(mu: Array, epsilon: Array) -> list[tuple[Array, tuple[Array, Array]]]:
    """Angles of the nodes of the ring's quadrature, and friction there by
    the radial law."""
    law = Radial.from_vector(mu)
    contact = contact_of(law, _STONE, Load.UNIFORM, _SPEED, _SPEED * epsilon / RADIUS)
    rows = panels(law, *contact.motion, contact.clustering)
    return [(points.angle, law.traction(points)) for points, _ in rows]


def eq_22(_found: Any) -> Judged:
    """The radial law at the nodes of the ring's quadrature."""
    mu, gaps = np.array([0.006, 0.008, 0.009, 0.018]), []
    for epsilon in (0.1, 0.9, 3.0):
        for angle, friction in _at_nodes(mu, epsilon):
            by_hand = radial_at(mu, epsilon, np.asarray(angle))
            gaps.append(np.abs(np.stack(friction) - by_hand).max() / mu.max())
    return judged(max(gaps) < 1e-12, gap=max(gaps))


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
    """Largest difference between first order and the ring, for each of EPSILONS in
    T_xi, T_eta, M: coefficients in turn, relative to the largest contribution, since
    some contribute nothing."""
    mu = np.tile(_TEST_VALUE * np.eye(4), (len(EPSILONS), 1))
    epsilon = np.repeat(EPSILONS, 4)
    approximate = first_order(mu, epsilon)
    difference = net_forces(law, mu, epsilon) - approximate
    gap, size = (
        np.abs(one).reshape(-1, 4, 3).max(1) for one in (difference, approximate)
    )
    return gap / size


def _sides(motion: Motion, radius: float, rho: float) -> tuple[Floats, Floats, Floats]:
    """What eq. 24 and 27 equate to sums of coefficients: across, along, and
    of the moment."""
    slope = radius * motion.curvature * GRAVITY
    moment = -4 * rho**2 * motion.angular / (slope * radius)
    return np.pi * motion.xi / slope, -motion.eta / GRAVITY, moment


def solve_eq_24(radius: float = RADIUS, rho: float = RHO) -> Floats:
    """l1 = mu1 + mu2, l2 = mu3 + mu4, l3 = mu1 + 2 mu3 at each time, shape (3, n)."""
    across, along, l2 = _sides(motion(), radius, rho)
    l1 = 4 * along - l2
    return np.stack([l1, l2, (3 * across + l1 + 2 * l2) / 2])


def study_ring() -> SimpleNamespace:
    """Compare first order with the ring, solve eq. 24 along the path, exchange
    mu1_eta, mu2_eta."""
    combinations = solve_eq_24()
    l1 = combinations[0]
    k = np.flatnonzero(l1[:-1] * l1[1:] < 0)[:1]
    zero = TIMES[k] - l1[k] * (TIMES[k + 1] - TIMES[k]) / (l1[k + 1] - l1[k])
    radial = fit(
        jensen_shegelski_throw(),
        Radial,
        stone=Stone(R=RADIUS, rho=RHO),
        unbounded=True,
        details=False,
    )
    mu = [radial.parameters[f"mu{index}"].value for index in (1, 2, 3, 4)]
    one, other = (
        np.tile([0.0018, 0.058, *split], (len(_SPLIT_EPSILONS), 1))
        for split in (SPLIT, SPLIT[::-1])
    )
    uniform, consistent = (
        net_forces(FrontBack, other, _SPLIT_EPSILONS, _STONE, load)
        / net_forces(FrontBack, one, _SPLIT_EPSILONS, _STONE, load)
        - 1
        for load in (Load.UNIFORM, Load.CONSISTENT)
    )
    return SimpleNamespace(
        t=TIMES,
        l=combinations,
        l1_zero=float(zero[0]) if len(zero) else None,
        epsilon=EPSILONS,
        fitted_l=(mu[0] + mu[1], mu[2] + mu[3], mu[0] + 2 * mu[2]),
        converged=radial.converged,
        radial_gap=_gaps(Radial, first_order_radial),
        split_epsilon=_SPLIT_EPSILONS,
        front_back_gap=_gaps(FrontBack, first_order_front_back),
        split_uniform=np.abs(uniform).max(1),
        split_consistent=consistent[:, 1],
    )


def _agree(gap: Floats) -> dict[str, float]:
    """The gaps at eps = 0.1: of T_xi, and the largest in %."""
    return {"exact": gap[0, 0], "others": 100 * gap[0].max()}


def eq_23(found: Any) -> Judged:
    """The radial law to first order."""
    gap, most = found.ring.radial_gap, (RADIUS * motion().curvature).max()
    order = np.round(
        np.log(gap[0, 1:] / gap[-1, 1:]).min() / np.log(EPSILONS[0] / EPSILONS[-1]), 1
    )
    holds = gap[0].max() < _SMALL and gap[0, 0] < 1e-6 and order == 2 and most < 0.1
    return judged(holds, order=order, most=most, **_agree(gap))


def eq_24_l1(found: Any) -> Judged:
    """The first combination of eq. 24, which depends on rho/R."""
    (l1, l2, _), zero = found.ring.l, found.ring.l1_zero
    return judged(
        zero is None,
        # l1 is a constant less l2, and l2 goes as (rho/R)^2.
        ratio=RHO / RADIUS * np.sqrt(((l1 + l2) / l2).max()),
        here=RHO / RADIUS,
        change="" if zero is None else f": l1 changes its sign at {zero:.1f} s",
        stones=" or ".join(
            f"{radius:g} and {rho:g} m" for radius, rho in _OTHER_STONES
        ),
        largest=max(solve_eq_24(*stone)[2].max() for stone in _OTHER_STONES),
    )


def eq_24_l2(found: Any) -> Judged:
    """The second combination."""
    l2 = found.ring.l[1]
    rows = np.array([[1, -1, 2, -2], [1, 1, 1, 1], [0, 0, 1, 1]])
    combinations = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 2, 0]])
    rank, joint = (
        np.linalg.matrix_rank(of) for of in (rows, np.concatenate([rows, combinations]))
    )
    holds = rank == joint == 3 and np.isfinite(l2).all()
    return judged(holds, least=l2.min(), most=l2.max(), rank=rank)


def eq_24_l3(found: Any) -> Judged:
    """The third combination, on which the conclusion rests."""
    l3, holds = found.ring.l[2], found.ring.converged and found.ring.fitted_l[2] < 0
    return judged((l3 < 0).all() and holds, least=l3.min(), most=l3.max())


def eq_27(found: Any) -> Judged:
    """The front-back law to first order: forces, and paths with the
    coefficients of eq. 28."""
    gap = found.ring.front_back_gap
    stone, mu = Stone(R=0.054, rho=RHO), (0.0018, 0.058, 0.009, 0.009)
    padded = np.pad(TIMES, (0, 55), mode="edge")  # the shape of a fit's times
    problem = Problem(
        padded, np.zeros((3, 256)), np.zeros((3, 256)), stone, LEVEL_AND_STILL
    )
    start = np.array([*mu, 0.0, 0.0, 0.0, _SPEED, 0.0, 1.0])
    integrated, ring = (
        np.asarray(predict_channels(Model(law, Load.UNIFORM), start, problem))[
            :, : len(TIMES)
        ]
        for law in (FrontBackFirstOrder, FrontBack)
    )
    closed = first_order_motion(FrontBackFirstOrder(*mu), stone, _SPEED, 1.0, TIMES)
    error = np.hypot(closed.x - integrated[0], closed.y - integrated[1]).max()
    x, y, phi = (integrated - ring)[:3]
    return judged(
        gap[0].max() < _SMALL and gap[0, 0] < 1e-6 and error < 1e-5,
        error=error,
        millimetres=1000 * np.hypot(x, y).max(),
        milliradians=1000 * np.abs(phi).max(),
        **_agree(gap),
    )


def pointwise(motion: Motion, radius: float, rho: float) -> Floats:
    """Eq. 27 solved at each time: mu1_xi, mu2_xi, mu1_eta + mu2_eta, shape (3, n)."""
    difference, along, total = _sides(motion, radius, rho)
    return np.stack([(total + difference) / 2, (total - difference) / 2, 2 * along])


def least_squares(motion: Motion, radius: float, rho: float) -> Floats:
    """Constant coefficients by least squares on each line of eq. 27, shape (3,)."""
    weight = motion.curvature**2 / (motion.curvature**2).sum()
    across, back, along = pointwise(motion, radius, rho)
    return np.array([(across * weight).sum(), (back * weight).sum(), along.mean()])


_SUMS = {"mu1_xi": 1.0}, {"mu2_xi": 1.0}, {"mu1_eta": 1.0, "mu2_eta": 1.0}
"""The coefficients of eq. 28, as sums of parameters."""


def coefficients_of(result: FitResult) -> Floats:
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta of a fit of the front-back law."""
    return np.array(
        [sum(result.parameters[name].value for name in names) for names in _SUMS]
    )


def rounds_to_print(mu: Floats) -> Any:
    """Whether coefficients, shape (..., 3), round to eq. 28 as printed."""
    return (np.abs(mu - PRINTED) <= HALF_DIGIT).all(-1)


def _fitted(
    throw: Throw, radius: float, rho: float, until: float = EQ_28_UNTIL, fix: Any = None
) -> FitResult:
    """A fit with coefficients of either sign."""
    result = fit(
        throw,
        "front-back",
        stone=Stone(R=radius, rho=rho),
        until=until,
        unbounded=True,
        details=False,
        systematics={ALL: 0.0},
        fix=fix or None,
    )
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
        (R, RHO, 20.0),
        (R, SOLID_RHO, 20.0),
        (0.0535, SOLID_RHO, 20.0),
        (R, SOLID_RHO, 18.0),
    ):
        mu = pointwise(motion(until), radius, rho).mean(1)
        rows.append(Row(mean, radius, rho, until, mu))
    for radius, until in ((R, 20.0), (R, 18.0), (0.0535, 18.0)):
        mu = least_squares(motion(until), radius, SOLID_RHO)
        rows.append(
            Row(mean.replace("mean", "least squares"), radius, SOLID_RHO, until, mu)
        )
    for ending, printed in (
        (", wrong sign of eq. 14", "x"),
        (", eq. 14 as printed", "xy"),
    ):
        mu = pointwise(motion(printed=printed), R, RHO).mean(1)
        rows.append(Row(mean + ending, R, RHO, 20.0, mu))
    fits = []
    for method, radius, rho, until, fix in _FITS:
        fits.append(
            _fitted(
                even if method.startswith(_EVEN) else throw, radius, rho, until, fix
            )
        )
        rows.append(Row(method, radius, rho, until, coefficients_of(fits[-1])))
    return SimpleNamespace(
        rows=rows,
        fit=fits[0],
        solid=fits[1],
        posterior=marginalize_stone(throw, fits[0]),
    )


def _stone_posterior(throw: Throw, radius: float, rho: float) -> Floats:
    """The Gaussian posterior of a fit with a given stone: the mean of the three
    coefficients, the lower triangle of the Cholesky factor of their covariance,
    chi-squared, and the logarithm of the volume that the data determine."""
    result = _fitted(throw, radius, rho)
    rows = np.array([result.first_order.vector(weights) for weights in _SUMS])
    factor = np.linalg.cholesky(rows @ np.array(result.covariance["matrix"]) @ rows.T)
    volume = -np.log(result.singular_values[: result.rank]).sum()
    mean = coefficients_of(result)
    return np.array([*mean, *factor[np.tril_indices(3)], result.chi_squared, volume])


def _lower(flat: Floats) -> Floats:
    """Cholesky factors from vectors of `_stone_posterior`, shape (n, 3, 3)."""
    factor = np.zeros((len(flat), 3, 3))
    factor[:, *np.tril_indices(3)] = flat[:, 3:9]
    return factor


def marginalize_stone(
    throw: Throw, central: FitResult, seed: int = 1
) -> SimpleNamespace:
    """The posterior of the coefficients with R and rho uniform over their
    printed rounding.

    At a given stone the posterior of all other parameters is Gaussian about its own fit
    (the noise, estimated once, is small beside every scale of the model). Its mean,
    covariance, chi-squared and volume are smooth in (R, rho): fits at 5 x 5 Chebyshev
    nodes are interpolated. Stones are drawn uniformly, weighted by their marginal
    likelihood (volume times exp(-chi-squared/2)), and coefficients drawn for each;
    draws with a negative coefficient are rejected, by the flat prior on mu >= 0.
    """
    known = throw.with_sigma(dict(central.sigma))
    low, high = np.array(RANGES).T

    def stones(unit: Floats) -> Floats:
        return (low + high) / 2 + (high - low) / 2 * unit

    def at(places: Any) -> Floats:
        return np.stack([_stone_posterior(known, *one) for one in stones(places)])

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
    mu = found[:, :3] + np.einsum(
        "nij,nj->ni", _lower(found), random.standard_normal((_DRAWS, 3))
    )
    free = random.choice(_DRAWS, _DRAWS, p=weight / weight.sum())
    positive = (mu > 0).all(1)
    allowed = weight * positive
    selected = random.choice(_DRAWS, _DRAWS, p=allowed / allowed.sum())
    interval, free_interval = (
        np.quantile(mu[rows], [0.025, 0.975], axis=0).T for rows in (selected, free)
    )
    nearest = np.argmin((np.abs(found[:, :3] - PRINTED) / HALF_DIGIT).max(1))
    return SimpleNamespace(
        limits=RANGES,
        stones=stones(places)[selected],
        mu=mu[selected],
        interval=interval,
        free_interval=free_interval,
        noise=noise,
        preference=np.ptp(found[:, -2]),
        positive=positive[free].mean(),
        effective=allowed.sum() ** 2 / (allowed**2).sum(),
        check=max((error[:, :3] / noise).max(), error[:, -2:].max()),
        share=rounds_to_print(mu[selected]).mean(),
        nearest=stones(places)[nearest],
    )


def eq_28(found: Any) -> Judged:
    """The coefficients of the front-back law."""
    eq28, (low, high) = found.eq28, found.eq28.posterior.interval.T
    mu, solid = coefficients_of(eq28.fit), coefficients_of(eq28.solid)
    inside = (low <= PRINTED) & (high >= PRINTED)
    covered = (low <= PRINTED + HALF_DIGIT) & (high >= PRINTED - HALF_DIGIT)
    contained, touched = (
        " and ".join(f"{value:g}" for value in PRINTED[rows])
        for rows in (inside, covered & ~inside)
    )
    contained = contained or "none of the printed values"
    same = next((row for row in eq28.rows if rounds_to_print(row.mu)), None)
    return judged(
        covered.all() and eq28.posterior.share > 0,
        corrected=not rounds_to_print(mu),
        mu=mu,
        solid=solid,
        low=low,
        high=high,
        contained=contained
        + (f" and overlap {touched} within its rounding" if touched else ""),
        how="by none of the methods"
        if same is None
        else f'by the method "{same.method}" with '
        f"R = {same.radius:g} m, rho = {same.rho:g} m",
    )


def ratio(found: Any) -> Judged:
    """Transversal over tangential friction."""
    one, other = (
        mu[:2].sum() / mu[2]
        for mu in map(coefficients_of, (found.eq28.fit, found.eq28.solid))
    )
    return judged(2.5 <= one < 3.5 and 2.5 <= other < 3.5, one=one, other=other)


def split(found: Any) -> Judged:
    """What of the sum mu1_eta + mu2_eta is not determined."""
    ring, singular = found.ring, found.eq28.fit.singular_values
    exchanged = [*found.eq28.fit.null_directions] == [{"mu1_eta": 1.0, "mu2_eta": -1.0}]
    greatest, slow = (
        ring.split_uniform.max(),
        ring.split_consistent[ring.split_epsilon == 0.1][0],
    )
    return judged(
        exchanged and greatest < 1e-12,
        last=singular[-1],
        next=singular[-2],
        greatest=greatest,
        slow=100 * abs(slow),
    )
