"""Anisotropic friction on the ring, and its coefficients: load, eq. 22-24, 27,
28, and split."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from jax import Array

from curlfit.dynamics.contact import contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.errors import UnusableFitError
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.anisotropic import Radial
from curlfit.friction.front_back import FrontBack, FrontBackFirstOrder
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.conditions import ALL
from curlfit.inference.model.likelihood import predict_channels
from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import LEVEL_AND_STILL, Problem
from curlfit.inference.solve.initial_values import accelerations_along
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


class PathFit(NamedTuple):
    """A fit of the front-back law to eq. 12: the stone (m), the rows (s), and what is
    fixed of the start."""

    method: str
    radius: float
    rho: float
    until: float = EQ_28_UNTIL
    start: dict[str, float] | None = None


_TRAJECTORY = "trajectory fit"
_EVEN = "trajectory fit, even weights"  # 1 m weighted like 1 rad
_ORIGIN = {"x0": 0.0, "y0": 0.0, "phi0": 0.0}
_ORIGIN_AT_2 = {**_ORIGIN, "v0": 2.0}
_EQ_13 = {**_ORIGIN_AT_2, "heading": 0.0, "omega0": 1.0}
_FITS = [
    PathFit(_TRAJECTORY, 0.054, RHO),
    PathFit(_TRAJECTORY, 0.054, SOLID_RHO),
    PathFit(_TRAJECTORY, 0.0535, SOLID_RHO),
    PathFit(_TRAJECTORY, 0.054, SOLID_RHO, 10.0),
    PathFit(_TRAJECTORY, 0.054, SOLID_RHO, 15.0),
    PathFit(_TRAJECTORY, 0.054, SOLID_RHO, 18.0),
    PathFit(_TRAJECTORY, 0.054, SOLID_RHO, 22.0),
    PathFit(_EVEN, 0.054, RHO),
    PathFit(_EVEN + ", from the origin", 0.054, RHO, start=_ORIGIN),
    PathFit(_EVEN + ", from the origin", 0.054, SOLID_RHO, start=_ORIGIN),
    PathFit(_EVEN + ", from the origin at 2 m/s", 0.054, RHO, start=_ORIGIN_AT_2),
    PathFit(_EVEN + ", start of eq. 13", 0.054, RHO, start=_EQ_13),
    PathFit(_TRAJECTORY, RADIUS, RHO),
    PathFit(_TRAJECTORY, RADIUS, SOLID_RHO),
]


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
    states[:, 0] = _SPEED
    states[:, 1] = _SPEED * epsilon / stone.R
    accelerations = accelerations_along(
        Model(law, load), values[None], stacked([stone]), states, batch=1
    )
    # by the moment of inertia m rho^2, over m g R
    units = [1.0, 1.0, stone.rho**2 / stone.R]
    return accelerations[0].T * units / GRAVITY


def uniform_load(_studies: Any) -> Judged:
    """The error of a uniform load."""
    mu1_xi, mu2_xi, mu_eta = PRINTED
    mu = np.array([[mu1_xi, mu2_xi, mu_eta / 2, mu_eta / 2]])
    epsilon = EPSILONS[1:2]
    ratios = []
    for radius in (RADIUS, EQ_28_STONE.R):
        stone = Stone(R=radius, h=0.057)
        uniform = net_forces(FrontBack, mu, epsilon, stone, Load.UNIFORM)
        consistent = net_forces(FrontBack, mu, epsilon, stone, Load.CONSISTENT)
        ratios.append((uniform / consistent)[0])
    percent = 100 * np.abs(np.array(ratios) - 1)  # shape (stones, 3)
    ranges = [_rounded_range(errors) for errors in percent.T]
    holds = (percent.max(1) >= 0.5).all() and (percent < 2).all()
    return judged(holds, ranges=ranges)


def _rounded_range(values: Floats) -> str:
    low = f"{values.min():.1f}"
    high = f"{values.max():.1f}"
    return low if low == high else f"{low} to {high}"


def radial_at(mu: Floats, epsilon: float, angle: Floats) -> Floats:
    """Eq. 22: friction of the radial law to the right and forward over the load,
    shape (2, n).

    `mu` are mu1..mu4, `angle` the polar angles of the points in rad, shape (n,).
    """
    # mu1 and mu3 act in front, where the angle is positive, mu2 and mu4 behind
    normal, tangent = np.where(angle > 0, mu[0::2, None], mu[1::2, None])
    sin = np.sin(angle)
    cos = np.cos(angle)
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


def eq_22(_studies: Any) -> Judged:
    """The radial law at the nodes of the ring's quadrature."""
    mu = np.array([0.006, 0.008, 0.009, 0.018])
    gaps = []
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
    """Eq. 27 over m g, m g and m g R; arguments and shape as in `net_forces`."""
    m1_xi, m2_xi, m1_eta, m2_eta = mu.T
    across = epsilon * (m1_xi - m2_xi) / np.pi
    return np.stack([across, -(m1_eta + m2_eta) / 2, -epsilon * (m1_xi + m2_xi) / 4], 1)


def _gaps(law: type[LocalLaw], first_order: Any) -> Floats:
    """Largest difference between first order and the ring in T_xi, T_eta and M, shape
    (EPSILONS, 3).

    Each of the four coefficients acts alone in turn; the difference is relative to the
    largest contribution, since some contribute nothing.
    """
    # rows: the four coefficients at the first epsilon, then at the second ...
    mu = np.tile(_TEST_VALUE * np.eye(4), (len(EPSILONS), 1))
    epsilon = np.repeat(EPSILONS, 4)
    approximate = first_order(mu, epsilon)
    difference = net_forces(law, mu, epsilon) - approximate
    largest_difference = np.abs(difference).reshape(-1, 4, 3).max(1)
    largest_contribution = np.abs(approximate).reshape(-1, 4, 3).max(1)
    return largest_difference / largest_contribution


def _sums_of_coefficients(
    motion: Motion, radius: float, rho: float
) -> tuple[Floats, Floats, Floats]:
    """What eq. 24 and 27 equate to sums of coefficients, at each time: from the force
    across, the force along, and the moment."""
    slope = radius * motion.curvature * GRAVITY
    across = np.pi * motion.xi / slope
    along = -motion.eta / GRAVITY
    moment = -4 * rho**2 * motion.angular / (slope * radius)
    return across, along, moment


def solve_eq_24(radius: float = RADIUS, rho: float = RHO) -> Floats:
    """l1 = mu1 + mu2, l2 = mu3 + mu4, l3 = mu1 + 2 mu3 at each time, shape (3, n)."""
    across, along, l2 = _sums_of_coefficients(motion(), radius, rho)
    l1 = 4 * along - l2
    return np.stack([l1, l2, (3 * across + l1 + 2 * l2) / 2])


def study_ring() -> SimpleNamespace:
    """Compare first order with the ring, solve eq. 24 along the path, exchange
    mu1_eta, mu2_eta."""
    combinations = solve_eq_24()
    radial = fit(
        jensen_shegelski_throw(),
        Radial,
        stone=Stone(R=RADIUS, rho=RHO),
        unbounded=True,
        details=False,
    )
    mu = {name: estimate.value for name, estimate in radial.parameters.items()}
    split = np.tile([0.0018, 0.058, *SPLIT], (len(_SPLIT_EPSILONS), 1))
    exchanged = split[:, [0, 1, 3, 2]]

    def change(load: Load) -> Floats:
        forces = net_forces(FrontBack, split, _SPLIT_EPSILONS, _STONE, load)
        changed = net_forces(FrontBack, exchanged, _SPLIT_EPSILONS, _STONE, load)
        return changed / forces - 1

    return SimpleNamespace(
        t=TIMES,
        l=combinations,
        l1_zero=_first_zero(TIMES, combinations[0]),
        epsilon=EPSILONS,
        fitted_l=(
            mu["mu1"] + mu["mu2"],
            mu["mu3"] + mu["mu4"],
            mu["mu1"] + 2 * mu["mu3"],
        ),
        converged=radial.converged,
        radial_gap=_gaps(Radial, first_order_radial),
        split_epsilon=_SPLIT_EPSILONS,
        front_back_gap=_gaps(FrontBack, first_order_front_back),
        split_uniform=np.abs(change(Load.UNIFORM)).max(1),
        split_consistent=change(Load.CONSISTENT)[:, 1],
    )


def _first_zero(t: Floats, values: Floats) -> float | None:
    """Time of the first change of sign, by linear interpolation; None without one."""
    rows_before_zero = np.flatnonzero(values[:-1] * values[1:] < 0)
    if not len(rows_before_zero):
        return None
    k = rows_before_zero[0]
    return float(t[k] - values[k] * (t[k + 1] - t[k]) / (values[k + 1] - values[k]))


def _is_first_order(gap: Floats) -> bool:
    """Whether a law agrees with its first order at eps = 0.1: T_xi exactly, the others
    to second order."""
    return bool(gap[0].max() < _SMALL and gap[0, 0] < 1e-6)


def _gap_numbers(gap: Floats) -> dict[str, float]:
    """Gaps at eps = 0.1 for the words of a claim: of T_xi, and the largest in %."""
    return {"exact": gap[0, 0], "others": 100 * gap[0].max()}


def eq_23(studies: Any) -> Judged:
    """The radial law to first order."""
    gap = studies.ring.radial_gap
    largest_epsilon = (RADIUS * motion().curvature).max()
    decrease = np.log(gap[0, 1:] / gap[-1, 1:]).min()
    order = np.round(decrease / np.log(EPSILONS[0] / EPSILONS[-1]), 1)
    holds = _is_first_order(gap) and order == 2 and largest_epsilon < 0.1
    return judged(holds, order=order, most=largest_epsilon, **_gap_numbers(gap))


def eq_24_l1(studies: Any) -> Judged:
    """The first combination of eq. 24, which depends on rho/R."""
    l1, l2, _ = studies.ring.l
    zero = studies.ring.l1_zero
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


def eq_24_l2(studies: Any) -> Judged:
    """The second combination."""
    l2 = studies.ring.l[1]
    # columns: mu1 to mu4; rows: left sides of eq. 24, and l1, l2, l3
    equations = np.array([[1, -1, 2, -2], [1, 1, 1, 1], [0, 0, 1, 1]])
    combinations = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 2, 0]])
    rank = np.linalg.matrix_rank(equations)
    joint_rank = np.linalg.matrix_rank(np.concatenate([equations, combinations]))
    holds = rank == joint_rank == 3 and np.isfinite(l2).all()
    return judged(holds, least=l2.min(), most=l2.max(), rank=rank)


def eq_24_l3(studies: Any) -> Judged:
    """The third combination, on which the conclusion rests."""
    l3 = studies.ring.l[2]
    fit_agrees = studies.ring.converged and studies.ring.fitted_l[2] < 0
    return judged((l3 < 0).all() and fit_agrees, least=l3.min(), most=l3.max())


def eq_27(studies: Any) -> Judged:
    """The front-back law to first order: forces, and paths with the
    coefficients of eq. 28."""
    gap = studies.ring.front_back_gap
    stone = Stone(R=0.054, rho=RHO)
    mu = (0.0018, 0.058, 0.009, 0.009)
    padded = np.pad(TIMES, (0, 55), mode="edge")  # the shape of a fit's times
    problem = Problem(
        padded, np.zeros((3, 256)), np.zeros((3, 256)), stone, LEVEL_AND_STILL
    )
    start = np.array([*mu, 0.0, 0.0, 0.0, _SPEED, 0.0, 1.0])

    def path_under(law: type[Law]) -> Floats:
        """x, y, phi and further channels, shape (channels, TIMES)."""
        channels = predict_channels(Model(law, Load.UNIFORM), start, problem)
        return channels[:, : len(TIMES)]

    stepwise = path_under(FrontBackFirstOrder)
    closed = first_order_motion(FrontBackFirstOrder(*mu), stone, _SPEED, 1.0, TIMES)
    error = np.hypot(closed.x - stepwise[0], closed.y - stepwise[1]).max()
    x, y, phi = (stepwise - path_under(FrontBack))[:3]
    return judged(
        _is_first_order(gap) and error < 1e-5,
        error=error,
        millimetres=1000 * np.hypot(x, y).max(),
        milliradians=1000 * np.abs(phi).max(),
        **_gap_numbers(gap),
    )


def pointwise(motion: Motion, radius: float, rho: float) -> Floats:
    """Eq. 27 solved at each time: mu1_xi, mu2_xi, mu1_eta + mu2_eta, shape (3, n)."""
    difference, along, total = _sums_of_coefficients(motion, radius, rho)
    return np.stack([(total + difference) / 2, (total - difference) / 2, 2 * along])


def least_squares(motion: Motion, radius: float, rho: float) -> Floats:
    """Constant coefficients by least squares on each line of eq. 27, shape (3,)."""
    weight = motion.curvature**2 / (motion.curvature**2).sum()
    across, back, along = pointwise(motion, radius, rho)
    return np.array([(across * weight).sum(), (back * weight).sum(), along.mean()])


_SUMS = ({"mu1_xi": 1.0}, {"mu2_xi": 1.0}, {"mu1_eta": 1.0, "mu2_eta": 1.0})
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
    throw: Throw,
    radius: float,
    rho: float,
    until: float = EQ_28_UNTIL,
    start: dict[str, float] | None = None,
) -> FitResult:
    """A fit of the front-back law with coefficients of either sign."""
    result = fit(
        throw,
        "front-back",
        stone=Stone(R=radius, rho=rho),
        until=until,
        unbounded=True,
        details=False,
        systematics={ALL: 0.0},
        fix=start,
    )
    if not result.converged:
        raise UnusableFitError(f"R = {radius:g} m, rho = {rho:g} m: {result.status}")
    return result


def study_eq_28() -> SimpleNamespace:
    """Compute eq. 28 by every method that is compatible with the paper."""
    throw = jensen_shegelski_throw()
    evenly_weighted = throw.with_sigma({"x": 1.0, "y": 1.0, "phi": 1.0})
    R = EQ_28_STONE.R
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
        method = "eq. 27 at each t, least squares"
        rows.append(Row(method, radius, SOLID_RHO, until, mu))
    for ending, printed in (
        (", wrong sign of eq. 14", "x"),
        (", eq. 14 as printed", "xy"),
    ):
        mu = pointwise(motion(printed=printed), R, RHO).mean(1)
        rows.append(Row(mean + ending, R, RHO, 20.0, mu))
    fits = []
    for method, radius, rho, until, start in _FITS:
        weighted = evenly_weighted if method.startswith(_EVEN) else throw
        result = _fitted(weighted, radius, rho, until, start)
        fits.append(result)
        rows.append(Row(method, radius, rho, until, coefficients_of(result)))
    return SimpleNamespace(
        rows=rows,
        fit=fits[0],
        solid=fits[1],
        posterior=marginalize_stone(throw, fits[0]),
    )


class StonePosteriors(NamedTuple):
    """Gaussian posteriors of the three coefficients of eq. 28, one for each stone."""

    mean: Floats
    """shape (stones, 3)"""
    factor: Floats
    """Cholesky factors of the covariances, shape (stones, 3, 3)"""
    chi_squared: Floats
    """shape (stones,)"""
    log_volume: Floats
    """logarithm of the volume that the data determine, shape (stones,)"""

    @classmethod
    def from_rows(cls, rows: Floats) -> StonePosteriors:
        """From rows of `_stone_posterior`, or between them, shape (stones, 11)."""
        factor = np.zeros((len(rows), 3, 3))
        factor[:, *np.tril_indices(3)] = rows[:, 3:9]
        return cls(rows[:, :3], factor, rows[:, 9], rows[:, 10])

    @property
    def log_evidence(self) -> Floats:
        """Logarithm of the marginal likelihood of each stone, up to a constant."""
        return self.log_volume - self.chi_squared / 2


def _stone_posterior(throw: Throw, radius: float, rho: float) -> Floats:
    """Row of `StonePosteriors` from a fit with a given stone: mean, lower triangle of
    the factor, chi squared, volume."""
    result = _fitted(throw, radius, rho)
    rows = np.array([result.first_order.vector(weights) for weights in _SUMS])
    factor = np.linalg.cholesky(rows @ result.covariance.matrix @ rows.T)
    determined = result.identifiability
    log_volume = -np.log(determined.singular_values[: determined.rank]).sum()
    triangle = factor[np.tril_indices(3)]
    return np.array(
        [*coefficients_of(result), *triangle, result.chi_squared, log_volume]
    )


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
    with_noise = throw.with_sigma(dict(central.sigma))
    low, high = np.array(RANGES).T

    # A stone is a point of the square [-1, 1] x [-1, 1], for Chebyshev's sake.
    def stones_at(square: Floats) -> Floats:
        """R and rho in m, shape (n, 2)."""
        return (low + high) / 2 + (high - low) / 2 * square

    def fitted_at(square: Floats) -> Floats:
        """Rows of posteriors by a fit for each stone."""
        stones = stones_at(square)
        return np.stack([_stone_posterior(with_noise, R, rho) for R, rho in stones])

    def terms_at(square: Floats) -> Floats:
        """Products of Chebyshev polynomials, shape (n, terms)."""
        x, y = square.T
        return np.polynomial.chebyshev.chebvander2d(x, y, [_NODES - 1, _NODES - 1])

    nodes = np.array([*product(np.polynomial.chebyshev.chebpts1(_NODES), repeat=2)])
    series = np.linalg.solve(terms_at(nodes), fitted_at(nodes))

    middle = StonePosteriors.from_rows(terms_at(np.zeros((1, 2))) @ series)
    noise = np.sqrt((middle.factor[0] ** 2).sum(-1))  # standard errors
    off_nodes = np.array([[0.9, -0.9], [-1.0, 1.0]])
    error = np.abs(terms_at(off_nodes) @ series - fitted_at(off_nodes))
    mean_error = error[:, :3] / noise
    evidence_error = error[:, -2:]

    random = np.random.default_rng(seed)
    square = random.uniform(-1, 1, (2, _DRAWS)).T
    stones = stones_at(square)
    posteriors = StonePosteriors.from_rows(terms_at(square) @ series)
    evidence = posteriors.log_evidence
    weight = np.exp(evidence - evidence.max())
    normal = random.standard_normal((_DRAWS, 3))
    mu = posteriors.mean + np.einsum("nij,nj->ni", posteriors.factor, normal)
    # draws of either sign, and those that the prior on mu >= 0 allows
    free = random.choice(_DRAWS, _DRAWS, p=weight / weight.sum())
    positive = (mu > 0).all(1)
    allowed = weight * positive
    selected = random.choice(_DRAWS, _DRAWS, p=allowed / allowed.sum())
    off_print = (np.abs(posteriors.mean - PRINTED) / HALF_DIGIT).max(1)
    return SimpleNamespace(
        limits=RANGES,
        stones=stones[selected],
        mu=mu[selected],
        interval=np.quantile(mu[selected], [0.025, 0.975], axis=0).T,
        free_interval=np.quantile(mu[free], [0.025, 0.975], axis=0).T,
        noise=noise,
        preference=np.ptp(posteriors.chi_squared),
        positive=positive[free].mean(),
        effective=allowed.sum() ** 2 / (allowed**2).sum(),
        check=max(mean_error.max(), evidence_error.max()),
        share=rounds_to_print(mu[selected]).mean(),
        nearest=stones[np.argmin(off_print)],
    )


def eq_28(studies: Any) -> Judged:
    """The coefficients of the front-back law."""
    eq28 = studies.eq28
    low, high = eq28.posterior.interval.T
    mu = coefficients_of(eq28.fit)
    inside = (low <= PRINTED) & (high >= PRINTED)
    covered = (low <= PRINTED + HALF_DIGIT) & (high >= PRINTED - HALF_DIGIT)
    contained = _values_joined(PRINTED[inside]) or "none of the printed values"
    touched = _values_joined(PRINTED[covered & ~inside])
    if touched:
        contained += f" and overlap {touched} within its rounding"
    how = "by none of the methods"
    agreeing = next((row for row in eq28.rows if rounds_to_print(row.mu)), None)
    if agreeing is not None:
        how = (
            f'by the method "{agreeing.method}" with '
            f"R = {agreeing.radius:g} m, rho = {agreeing.rho:g} m"
        )
    return judged(
        covered.all() and eq28.posterior.share > 0,
        corrected=not rounds_to_print(mu),
        mu=mu,
        solid=coefficients_of(eq28.solid),
        low=low,
        high=high,
        contained=contained,
        how=how,
    )


def _values_joined(values: Floats) -> str:
    return " and ".join(f"{value:g}" for value in values)


def _transversal_over_tangential(result: FitResult) -> float:
    mu1_xi, mu2_xi, mu_eta = coefficients_of(result)
    return (mu1_xi + mu2_xi) / mu_eta


def ratio(studies: Any) -> Judged:
    """Transversal over tangential friction."""
    printed_rho = _transversal_over_tangential(studies.eq28.fit)
    solid = _transversal_over_tangential(studies.eq28.solid)
    holds = 2.5 <= printed_rho < 3.5 and 2.5 <= solid < 3.5
    return judged(holds, one=printed_rho, other=solid)


def split(studies: Any) -> Judged:
    """What of the sum mu1_eta + mu2_eta is not determined."""
    ring = studies.ring
    fit_of_eq_28 = studies.eq28.fit
    difference = {"mu1_eta": 1.0, "mu2_eta": -1.0}
    exchanged = [*fit_of_eq_28.identifiability.null_directions] == [difference]
    greatest = ring.split_uniform.max()
    slow = ring.split_consistent[ring.split_epsilon == 0.1][0]
    return judged(
        exchanged and greatest < 1e-12,
        last=fit_of_eq_28.identifiability.singular_values[-1],
        next=fit_of_eq_28.identifiability.singular_values[-2],
        greatest=greatest,
        slow=100 * abs(slow),
    )
