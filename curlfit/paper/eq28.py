"""Eq. 28: the coefficients of the front-back law, and how they move with what is not printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.paper.claim import Claim, Verdict
from curlfit.paper.kinematics import Kinematics, PathFindings
from curlfit.paper.printed import EQ_28, EQ_28_STONE, EQ_28_UNTIL, SOLID_RHO, jensen_shegelski_throw
from curlfit.paper.ring import SPLIT, RingFindings
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.throw import Throw

NAMES = ("mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")
PRINTED: Floats = np.array([EQ_28[name] for name in NAMES])
HALF_DIGIT: Floats = np.array([0.00005, 0.0005, 0.0005])
"""Half a unit of the last printed digit of each."""


R_RANGE = (0.0535, 0.0545)
"""Ring radii that print as 0.054 m."""
RHO_RANGE = (0.095, 0.105)
"""Radii of gyration taken to print as 0.1 m, m."""

_NODES = 5  # Chebyshev nodes in R and in rho, at which the path is fitted
_DRAWS = 20_000


class Row(NamedTuple):
    """Eq. 28 computed in one way."""

    how: str
    radius: float
    rho: float
    window: float
    mu: Floats
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta"""


def pointwise(motion: Kinematics, radius: float, rho: float) -> Floats:
    """Eq. 27 solved at each time: mu1_xi, mu2_xi, mu1_eta + mu2_eta, shape (3, n)."""
    epsilon = motion.epsilon(radius)
    difference = np.pi * motion.xi / (epsilon * GRAVITY)
    total = -4 * rho**2 * motion.angular / (epsilon * GRAVITY * radius)
    return np.stack([(total + difference) / 2, (total - difference) / 2, -2 * motion.eta / GRAVITY])


def least_squares(motion: Kinematics, radius: float, rho: float) -> Floats:
    """Constant coefficients that satisfy each line of eq. 27 best over all times, shape (3,)."""
    epsilon = motion.epsilon(radius) * GRAVITY
    square = float((epsilon**2).sum())
    difference = float(np.pi * (motion.xi * epsilon).sum() / square)
    total = float(-4 * rho**2 / radius * (motion.angular * epsilon).sum() / square)
    along = float(-2 * motion.eta.mean() / GRAVITY)
    return np.array([(total + difference) / 2, (total - difference) / 2, along])


def coefficients_of(result: FitResult) -> Floats:
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta of a fit of the front-back law."""
    mu = {name: result.parameters[name].value for name in result.coefficients}
    return np.array([mu["mu1_xi"], mu["mu2_xi"], mu["mu1_eta"] + mu["mu2_eta"]])


def rounds_to_print(mu: Floats) -> Any:
    """Whether coefficients, shape (..., 3), round to eq. 28 as printed."""
    return (np.abs(mu - PRINTED) <= HALF_DIGIT).all(-1)


@dataclass(frozen=True)
class Uncertainty:
    """Posterior of eq. 28 when R and rho vary within their printed rounding.

    Attributes
    ----------
    radius, rho : draws in m, shape (n,). mu : draws of the three coefficients, shape (n, 3).
    interval : 95 % intervals, shape (3, 2). noise : the standard error at R = 0.054 m,
    rho = 0.1 m, all of it from the residuals, shape (3,).
    preference : difference in chi-squared between the best and the worst stone in the range.
    positive : share of the draws without bounds in which all coefficients are positive.
    free_interval : 95 % intervals of these unbounded draws. effective : sample size after weights.
    check : largest error of the interpolation at stones between the nodes, in standard errors.
    share : of the draws that round to all three printed numbers. nearest : the radius and rho
    within the ranges whose fit comes nearest to the print, and nearest_mu that fit.
    """

    radius: Floats
    rho: Floats
    mu: Floats
    interval: Floats
    noise: Floats
    preference: float
    positive: float
    free_interval: Floats
    effective: float
    check: float
    share: float
    nearest: tuple[float, float]
    nearest_mu: Floats

    @property
    def covered(self) -> Booleans:
        """Whether the interval of each coefficient meets the printed value within its rounding."""
        low, high = self.interval.T
        return (low <= PRINTED + HALF_DIGIT) & (high >= PRINTED - HALF_DIGIT)


@dataclass(frozen=True)
class Eq28Findings:
    """How eq. 28 is reached.

    Attributes
    ----------
    rows : the ways, in the order of the table. fit : of the trajectory with the printed stone.
    solid : the same with the radius of gyration of a solid cylinder. uncertainty : over R and rho.
    """

    rows: tuple[Row, ...]
    fit: FitResult
    solid: FitResult
    uncertainty: Uncertainty

    @property
    def ratio(self) -> tuple[float, float]:
        """Mean transversal over mean tangential coefficient, for the printed stone and `solid`."""
        mu, other = coefficients_of(self.fit), coefficients_of(self.solid)
        return float((mu[0] + mu[1]) / mu[2]), float((other[0] + other[1]) / other[2])


def study_eq_28(path: PathFindings) -> Eq28Findings:
    """Compute eq. 28 in every way that the paper leaves open."""
    throw = jensen_shegelski_throw()
    even = throw.with_sigma({"x": 1.0, "y": 1.0, "phi": 1.0})
    origin = {"x0": 0.0, "y0": 0.0, "phi0": 0.0}
    radius, rho, whole = EQ_28_STONE.R, EQ_28_STONE.rho, EQ_28_UNTIL
    rows: list[Row] = []

    def at_points(how: str, motion: Kinematics, radius: float, rho: float, until: float) -> None:
        mean = pointwise(motion.until(until), radius, rho).mean(1)
        rows.append(Row(how, radius, rho, until, mean))

    def by_fit(
        how: str, data: Throw, radius: float, rho: float, until: float, **more: Any
    ) -> FitResult:
        result = _fitted(data, radius, rho, until, **more)
        rows.append(Row(how, radius, rho, until, coefficients_of(result)))
        return result

    mean, least = "eq. 27 at each t, mean", "eq. 27 at each t, least squares"
    at_points(mean, path.motion, radius, rho, whole)
    at_points(mean, path.motion, radius, SOLID_RHO, whole)
    at_points(mean, path.motion, R_RANGE[0], SOLID_RHO, whole)
    at_points(mean, path.motion, radius, SOLID_RHO, 18.0)
    for one, until in ((radius, whole), (radius, 18.0), (R_RANGE[0], 18.0)):
        mu = least_squares(path.motion.until(until), one, SOLID_RHO)
        rows.append(Row(least, one, SOLID_RHO, until, mu))
    at_points(mean + ", wrong sign of eq. 14", path.wrong_sign, radius, rho, whole)
    at_points(mean + ", eq. 14 as printed", path.printed, radius, rho, whole)
    trajectory = "trajectory fit"
    printed = by_fit(trajectory, throw, radius, rho, whole)
    solid = by_fit(trajectory, throw, radius, SOLID_RHO, whole)
    by_fit(trajectory, throw, R_RANGE[0], SOLID_RHO, whole)
    for until in (10.0, 15.0, 18.0, 22.0):
        by_fit(trajectory, throw, radius, SOLID_RHO, until)
    evenly = "trajectory fit, even weights"  # 1 m like 1 rad
    by_fit(evenly, even, radius, rho, whole)
    from_origin = evenly + ", from the origin"
    for one in (rho, SOLID_RHO):
        by_fit(from_origin, even, radius, one, whole, fix=origin)
    by_fit(from_origin + " at 2 m/s", even, radius, rho, whole, fix=origin | {"v0": 2.0})
    exactly = origin | {"v0": 2.0, "heading": 0.0, "omega0": 1.0}
    by_fit(evenly + ", start of eq. 13", even, radius, rho, whole, fix=exactly)
    for one in (rho, SOLID_RHO):
        by_fit(trajectory, throw, 0.065, one, whole)
    return Eq28Findings(tuple(rows), printed, solid, vary_stone(throw, printed))


def _fitted(
    throw: Throw, radius: float, rho: float, until: float = EQ_28_UNTIL, **more: Any
) -> FitResult:
    """A fit with coefficients of either sign."""
    stone = Stone(R=radius, rho=rho)
    result = fit(throw, "front-back", stone=stone, until=until, unbounded=True, **more)
    if not result.converged:
        raise UnusableFitError(f"R = {radius:g} m, rho = {rho:g} m: {result.status}")
    return result


class _AtStone(NamedTuple):
    """A fit, as far as the posterior needs it."""

    mu: Floats
    factor: Floats
    """Cholesky factor of the covariance of mu, shape (3, 3)"""
    chi_squared: float
    log_volume: float
    """half the logarithm of the determinant of the covariance of all parameters"""

    def flat(self) -> Floats:
        """All numbers in one vector."""
        return np.concatenate(
            [self.mu, self.factor[np.tril_indices(3)], [self.chi_squared, self.log_volume]]
        )


def _at_stone(throw: Throw, sigma: Mapping[str, float], radius: float, rho: float) -> _AtStone:
    result = _fitted(throw, radius, rho)
    names = result.information["names"]
    # mu1_eta and mu2_eta enter by their sum alone: one column in place of two.
    columns = [name for name in names if name != "mu2_eta"]
    basis = np.zeros((len(names), len(columns)))
    for place, name in enumerate(names):
        half = name in ("mu1_eta", "mu2_eta")
        basis[place, columns.index("mu1_eta" if half else name)] = 0.5 if half else 1.0
    information = basis.T @ np.array(result.information["matrix"]) @ basis
    covariance = np.linalg.inv(information)
    order = [columns.index(name) for name in ("mu1_xi", "mu2_xi", "mu1_eta")]
    residual = [(result.observed[name] - result.fitted[name]) / sigma[name] for name in sigma]
    return _AtStone(
        mu=coefficients_of(result),
        factor=np.linalg.cholesky(covariance[np.ix_(order, order)]),
        chi_squared=float(np.sum(np.square(residual))),
        log_volume=float(-0.5 * np.linalg.slogdet(information)[1]),
    )


def vary_stone(throw: Throw, central: FitResult, seed: int = 1) -> Uncertainty:
    """The posterior of the coefficients with R and rho even over their printed rounding.

    At a given stone the posterior of all other parameters is Gaussian about its own fit (the
    noise, estimated once, is small beside every scale of the model). Its mean, covariance,
    chi-squared and volume are smooth in (R, rho): fits at 5 x 5 Chebyshev nodes are interpolated.
    Stones are drawn evenly, weighted by their marginal likelihood (volume times
    exp(-chi-squared/2)), and coefficients drawn for each; those with a negative one are left
    out, which is the flat prior on mu >= 0.
    """
    sigma = central.sigma
    known = throw.with_sigma(dict(sigma))
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)

    def stretched(unit: Any, limits: tuple[float, float]) -> Any:
        return (limits[0] + limits[1]) / 2 + (limits[1] - limits[0]) / 2 * unit

    def at(a: float, b: float) -> Floats:
        return _at_stone(known, sigma, stretched(a, R_RANGE), stretched(b, RHO_RANGE)).flat()

    table = np.stack([at(a, b) for a, b in product(nodes, nodes)])
    basis = np.polynomial.chebyshev.chebvander(nodes, _NODES - 1)
    weights = np.linalg.inv(basis)
    series = np.einsum("ia,jb,abk->ijk", weights, weights, table.reshape(_NODES, _NODES, -1))

    def interpolated(a: Floats, b: Floats) -> Floats:
        in_a, in_b = (np.polynomial.chebyshev.chebvander(s, _NODES - 1) for s in (a, b))
        return np.einsum("na,nb,abk->nk", in_a, in_b, series)

    here = np.array([[0.0, 0.0], [0.9, -0.9], [-1.0, 1.0]])
    noise = np.sqrt((_lower(at(0.0, 0.0))[0] ** 2).sum(-1))
    off = interpolated(here[:, 0], here[:, 1]) - np.stack([at(a, b) for a, b in here])
    check = max(float((np.abs(off[:, :3]) / noise).max()), float(np.abs(off[:, -2:]).max()))

    random = np.random.default_rng(seed)
    a, b = random.uniform(-1, 1, (2, _DRAWS))
    found = interpolated(a, b)
    evidence = found[:, -1] - found[:, -2] / 2
    weight = np.exp(evidence - evidence.max())
    mu = found[:, :3] + np.einsum("nij,nj->ni", _lower(found), random.standard_normal((_DRAWS, 3)))
    free = random.choice(_DRAWS, _DRAWS, p=weight / weight.sum())
    positive = (mu > 0).all(1)
    kept = random.choice(_DRAWS, _DRAWS, p=weight * positive / (weight * positive).sum())
    wanted = weight * positive
    worst = (np.abs(found[:, :3] - PRINTED) / HALF_DIGIT).max(1)
    nearest = int(np.argmin(worst))
    return Uncertainty(
        radius=stretched(a, R_RANGE)[kept],
        rho=stretched(b, RHO_RANGE)[kept],
        mu=mu[kept],
        interval=np.quantile(mu[kept], [0.025, 0.975], axis=0).T,
        noise=noise,
        preference=float(np.ptp(found[:, -2])),
        positive=float(positive[free].mean()),
        free_interval=np.quantile(mu[free], [0.025, 0.975], axis=0).T,
        effective=float(wanted.sum() ** 2 / (wanted**2).sum()),
        check=check,
        share=float(rounds_to_print(mu[kept]).mean()),
        nearest=(
            float(stretched(a[nearest], R_RANGE)),
            float(stretched(b[nearest], RHO_RANGE)),
        ),
        nearest_mu=found[nearest, :3],
    )


def _lower(flat: Floats) -> Floats:
    """Cholesky factors from the vectors of `_AtStone.flat`, shape (n, 3, 3)."""
    flat = np.atleast_2d(flat)
    factor = np.zeros((len(flat), 3, 3))
    factor[:, *np.tril_indices(3)] = flat[:, 3:9]
    return factor


def _text(mu: Floats) -> str:
    return f"{mu[0]:.4f}, {mu[1]:.4f}, {mu[2]:.4f}"


def _covered(vary: Uncertainty) -> str:
    """Which printed values the intervals reach, in words."""
    low, high = vary.interval.T
    inside = (low <= PRINTED) & (high >= PRINTED)
    held = [f"{value:g}" for value, take in zip(PRINTED, inside, strict=True) if take]
    near = [
        f"{value:g}" for value, take in zip(PRINTED, vary.covered & ~inside, strict=True) if take
    ]
    words = f"The intervals hold {' and '.join(held) or 'none of the printed values'}"
    return words + (f" and meet {' and '.join(near)} within its rounding" if near else "")


def _exactly(rows: tuple[Row, ...]) -> str:
    """The first way of computing eq. 28 that gives its printed digits, in words."""
    for row in rows:
        if rounds_to_print(row.mu):
            return f'of the way "{row.how}" with R = {row.radius:g} m, rho = {row.rho:g} m'
    return "of none of the ways tried"


def eq_28_claims(found: Eq28Findings, ring: RingFindings) -> dict[str, Claim]:
    """Eq. 28, the ratio of the two directions and the split, by id."""
    mu, solid, vary = coefficients_of(found.fit), coefficients_of(found.solid), found.uncertainty
    low, high = vary.interval.T
    reached = bool(vary.covered.all()) and vary.share > 0
    at_once: Verdict = "holds" if rounds_to_print(mu) else "holds with a correction"
    ratio, other = found.ratio
    null = found.fit.null_directions
    exchanged = len(null) == 1 and null[0] == {"mu1_eta": 1.0, "mu2_eta": -1.0}
    singular = found.fit.singular_values
    greatest = float(ring.split_uniform.max())
    slow = float(ring.split_consistent[np.searchsorted(ring.split_epsilon, 0.1)])
    claims = [
        Claim(
            "eq28",
            "mu1_xi, mu2_xi, mu1_eta + mu2_eta of the front-back law",
            f"{PRINTED[0]:g}, {PRINTED[1]:g}, {PRINTED[2]:g} (R = 0.054 m, rho = 0.1 m)",
            f"{_text(mu)}; with rho = {SOLID_RHO:.4f} m {_text(solid)}; 95 % over the rounding of "
            f"R and rho: {low[0]:.4f} .. {high[0]:.4f}, {low[1]:.4f} .. {high[1]:.4f}, "
            f"{low[2]:.5f} .. {high[2]:.5f}",
            at_once if reached else "does not hold",
            f"{_covered(vary)}; their width comes from R and rho, not from "
            f"noise ({vary.noise[0]:.0e} in mu1_xi); all printed digits come out "
            f"{_exactly(found.rows)}.",
        ),
        Claim(
            "ratio",
            "transversal over tangential friction",
            "about three",
            f"{ratio:.2f}; {other:.2f} with rho = {SOLID_RHO:.4f} m",
            "holds" if 2.5 <= ratio < 3.5 and 2.5 <= other < 3.5 else "does not hold",
            "Mean of mu1_xi and mu2_xi over mean of mu1_eta and mu2_eta, from the trajectory fit.",
        ),
        Claim(
            "split",
            "mu1_eta and mu2_eta are not defined uniquely",
            "only their sum is",
            f"singular value {singular[-1]:.0e} beside {singular[-2]:.0f} along "
            f"(1, -1); exchanging {SPLIT[0]:g} and {SPLIT[1]:g} changes the ring forces by "
            f"{greatest:.0e} (uniform load), T_eta by {100 * abs(slow):.2f} % (consistent)",
            "holds" if exchanged and greatest < 1e-12 else "does not hold",
            "Under uniform load the integrals of the two halves are equal term by term at every "
            "eps, beyond 1 too; the consistent load tells them apart, but confounds them with the "
            "sum.",
        ),
    ]  # fmt: skip
    return {claim.id: claim for claim in claims}
