"""Eq. 28: the coefficients of the front-back law, and their dependence on unprinted details."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.paper.claim import Claim, Verdict
from curlfit.paper.findings import (
    HALF_DIGIT,
    PRINTED,
    Eq28Findings,
    Kinematics,
    PathFindings,
    RingFindings,
    Row,
    Uncertainty,
    coefficients_of,
)
from curlfit.paper.printed import EQ_28_STONE, EQ_28_UNTIL, SOLID_RHO, jensen_shegelski_throw
from curlfit.paper.ring import SPLIT
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.throw import Throw

R_RANGE = (0.0535, 0.0545)
"""Ring radii that round to the printed 0.054 m."""
RHO_RANGE = (0.095, 0.105)
"""Radii of gyration assumed to be compatible with the printed 0.1 m, m."""

_NODES = 5  # Chebyshev nodes in R and in rho, at which the path is fitted
_DRAWS = 20_000


def pointwise(motion: Kinematics, radius: float, rho: float) -> Floats:
    """Eq. 27 solved at each time: mu1_xi, mu2_xi, mu1_eta + mu2_eta, shape (3, n)."""
    epsilon = motion.epsilon(radius)
    difference = np.pi * motion.xi / (epsilon * GRAVITY)
    total = -4 * rho**2 * motion.angular / (epsilon * GRAVITY * radius)
    return np.stack([(total + difference) / 2, (total - difference) / 2, -2 * motion.eta / GRAVITY])


def least_squares(motion: Kinematics, radius: float, rho: float) -> Floats:
    """Constant coefficients by least squares on each line of eq. 27, shape (3,)."""
    epsilon = motion.epsilon(radius) * GRAVITY
    square = float((epsilon**2).sum())
    difference = float(np.pi * (motion.xi * epsilon).sum() / square)
    total = float(-4 * rho**2 / radius * (motion.angular * epsilon).sum() / square)
    along = float(-2 * motion.eta.mean() / GRAVITY)
    return np.array([(total + difference) / 2, (total - difference) / 2, along])


def rounds_to_print(mu: Floats) -> Any:
    """Whether coefficients, shape (..., 3), round to eq. 28 as printed."""
    return (np.abs(mu - PRINTED) <= HALF_DIGIT).all(-1)


def study_eq_28(path: PathFindings) -> Eq28Findings:
    """Compute eq. 28 by every method that is compatible with the paper."""
    throw = jensen_shegelski_throw()
    equally_weighted = throw.with_sigma({"x": 1.0, "y": 1.0, "phi": 1.0})
    origin = {"x0": 0.0, "y0": 0.0, "phi0": 0.0}
    radius, rho, whole = EQ_28_STONE.R, EQ_28_STONE.rho, EQ_28_UNTIL
    rows: list[Row] = []

    def add_pointwise(
        method: str, motion: Kinematics, radius: float, rho: float, until: float
    ) -> None:
        mean = pointwise(motion.until(until), radius, rho).mean(1)
        rows.append(Row(method, radius, rho, until, mean))

    def add_fit(
        method: str, data: Throw, radius: float, rho: float, until: float, **more: Any
    ) -> FitResult:
        result = _fitted(data, radius, rho, until, **more)
        rows.append(Row(method, radius, rho, until, coefficients_of(result)))
        return result

    mean, least = "eq. 27 at each t, mean", "eq. 27 at each t, least squares"
    add_pointwise(mean, path.motion, radius, rho, whole)
    add_pointwise(mean, path.motion, radius, SOLID_RHO, whole)
    add_pointwise(mean, path.motion, R_RANGE[0], SOLID_RHO, whole)
    add_pointwise(mean, path.motion, radius, SOLID_RHO, 18.0)
    for one, until in ((radius, whole), (radius, 18.0), (R_RANGE[0], 18.0)):
        mu = least_squares(path.motion.until(until), one, SOLID_RHO)
        rows.append(Row(least, one, SOLID_RHO, until, mu))
    add_pointwise(mean + ", wrong sign of eq. 14", path.wrong_sign, radius, rho, whole)
    add_pointwise(mean + ", eq. 14 as printed", path.printed, radius, rho, whole)
    trajectory = "trajectory fit"
    printed = add_fit(trajectory, throw, radius, rho, whole)
    solid = add_fit(trajectory, throw, radius, SOLID_RHO, whole)
    add_fit(trajectory, throw, R_RANGE[0], SOLID_RHO, whole)
    for until in (10.0, 15.0, 18.0, 22.0):
        add_fit(trajectory, throw, radius, SOLID_RHO, until)
    equal_weights = "trajectory fit, even weights"  # 1 m weighted like 1 rad
    add_fit(equal_weights, equally_weighted, radius, rho, whole)
    from_origin = equal_weights + ", from the origin"
    for one in (rho, SOLID_RHO):
        add_fit(from_origin, equally_weighted, radius, one, whole, fix=origin)
    add_fit(
        from_origin + " at 2 m/s", equally_weighted, radius, rho, whole, fix=origin | {"v0": 2.0}
    )
    printed_start = origin | {"v0": 2.0, "heading": 0.0, "omega0": 1.0}
    add_fit(
        equal_weights + ", start of eq. 13", equally_weighted, radius, rho, whole, fix=printed_start
    )
    for one in (rho, SOLID_RHO):
        add_fit(trajectory, throw, 0.065, one, whole)
    return Eq28Findings(tuple(rows), printed, solid, marginalize_stone(throw, printed))


def _fitted(
    throw: Throw, radius: float, rho: float, until: float = EQ_28_UNTIL, **more: Any
) -> FitResult:
    """A fit with coefficients of either sign."""
    stone = Stone(R=radius, rho=rho)
    result = fit(
        throw, "front-back", stone=stone, until=until, unbounded=True, details=False,
        systematics={ALL: 0.0}, **more,
    )  # fmt: skip
    if not result.converged:
        raise UnusableFitError(f"R = {radius:g} m, rho = {rho:g} m: {result.status}")
    return result


class _StonePosterior(NamedTuple):
    """The Gaussian posterior of a fit with a given stone."""

    mu: Floats
    factor: Floats
    """Cholesky factor of the covariance of mu, shape (3, 3)"""
    chi_squared: float
    log_volume: float
    """half the logarithm of the determinant of the covariance of all parameters"""

    def flat(self) -> Floats:
        """All fields in one vector."""
        return np.concatenate(
            [self.mu, self.factor[np.tril_indices(3)], [self.chi_squared, self.log_volume]]
        )


def _stone_posterior(
    throw: Throw, sigma: Mapping[str, float], radius: float, rho: float
) -> _StonePosterior:
    result = _fitted(throw, radius, rho)
    names = result.information["names"]
    # Only the sum of mu1_eta and mu2_eta enters: one column in place of two.
    columns = [name for name in names if name != "mu2_eta"]
    basis = np.zeros((len(names), len(columns)))
    for index, name in enumerate(names):
        half = name in ("mu1_eta", "mu2_eta")
        basis[index, columns.index("mu1_eta" if half else name)] = 0.5 if half else 1.0
    information = basis.T @ np.array(result.information["matrix"]) @ basis
    covariance = np.linalg.inv(information)
    order = [columns.index(name) for name in ("mu1_xi", "mu2_xi", "mu1_eta")]
    residual = [(result.observed[name] - result.fitted[name]) / sigma[name] for name in sigma]
    return _StonePosterior(
        mu=coefficients_of(result),
        factor=np.linalg.cholesky(covariance[np.ix_(order, order)]),
        chi_squared=float(np.sum(np.square(residual))),
        log_volume=float(-0.5 * np.linalg.slogdet(information)[1]),
    )


def marginalize_stone(throw: Throw, central: FitResult, seed: int = 1) -> Uncertainty:
    """The posterior of the coefficients with R and rho uniform over their printed rounding.

    At a given stone the posterior of all other parameters is Gaussian about its own fit (the
    noise, estimated once, is small beside every scale of the model). Its mean, covariance,
    chi-squared and volume are smooth in (R, rho): fits at 5 x 5 Chebyshev nodes are interpolated.
    Stones are drawn uniformly, weighted by their marginal likelihood (volume times
    exp(-chi-squared/2)), and coefficients drawn for each; draws with a negative coefficient
    are rejected, by the flat prior on mu >= 0.
    """
    sigma = central.sigma
    known = throw.with_sigma(dict(sigma))
    nodes = np.polynomial.chebyshev.chebpts1(_NODES)

    def stretched(unit: Any, limits: tuple[float, float]) -> Any:
        return (limits[0] + limits[1]) / 2 + (limits[1] - limits[0]) / 2 * unit

    def at(a: float, b: float) -> Floats:
        return _stone_posterior(known, sigma, stretched(a, R_RANGE), stretched(b, RHO_RANGE)).flat()

    table = np.stack([at(a, b) for a, b in product(nodes, nodes)])
    basis = np.polynomial.chebyshev.chebvander(nodes, _NODES - 1)
    weights = np.linalg.inv(basis)
    series = np.einsum("ia,jb,abk->ijk", weights, weights, table.reshape(_NODES, _NODES, -1))

    def interpolated(a: Floats, b: Floats) -> Floats:
        in_a, in_b = (np.polynomial.chebyshev.chebvander(s, _NODES - 1) for s in (a, b))
        return np.einsum("na,nb,abk->nk", in_a, in_b, series)

    test_points = np.array([[0.9, -0.9], [-1.0, 1.0]])
    noise = np.sqrt((_lower(interpolated(np.zeros(1), np.zeros(1)))[0] ** 2).sum(-1))
    error = interpolated(test_points[:, 0], test_points[:, 1]) - np.stack(
        [at(a, b) for a, b in test_points]
    )
    check = max(float((np.abs(error[:, :3]) / noise).max()), float(np.abs(error[:, -2:]).max()))

    random = np.random.default_rng(seed)
    a, b = random.uniform(-1, 1, (2, _DRAWS))
    found = interpolated(a, b)
    evidence = found[:, -1] - found[:, -2] / 2
    weight = np.exp(evidence - evidence.max())
    mu = found[:, :3] + np.einsum("nij,nj->ni", _lower(found), random.standard_normal((_DRAWS, 3)))
    unbounded = random.choice(_DRAWS, _DRAWS, p=weight / weight.sum())
    positive = (mu > 0).all(1)
    selected = random.choice(_DRAWS, _DRAWS, p=weight * positive / (weight * positive).sum())
    positive_weight = weight * positive
    worst = (np.abs(found[:, :3] - PRINTED) / HALF_DIGIT).max(1)
    nearest = int(np.argmin(worst))
    return Uncertainty(
        radius=stretched(a, R_RANGE)[selected],
        rho=stretched(b, RHO_RANGE)[selected],
        mu=mu[selected],
        interval=np.quantile(mu[selected], [0.025, 0.975], axis=0).T,
        noise=noise,
        preference=float(np.ptp(found[:, -2])),
        positive=float(positive[unbounded].mean()),
        free_interval=np.quantile(mu[unbounded], [0.025, 0.975], axis=0).T,
        effective=float(positive_weight.sum() ** 2 / (positive_weight**2).sum()),
        check=check,
        share=float(rounds_to_print(mu[selected]).mean()),
        nearest=(
            float(stretched(a[nearest], R_RANGE)),
            float(stretched(b[nearest], RHO_RANGE)),
        ),
        nearest_mu=found[nearest, :3],
    )


def _lower(flat: Floats) -> Floats:
    """Cholesky factors from the vectors of `_StonePosterior.flat`, shape (n, 3, 3)."""
    flat = np.atleast_2d(flat)
    factor = np.zeros((len(flat), 3, 3))
    factor[:, *np.tril_indices(3)] = flat[:, 3:9]
    return factor


def _text(mu: Floats) -> str:
    return f"{mu[0]:.4f}, {mu[1]:.4f}, {mu[2]:.4f}"


def _coverage(posterior: Uncertainty) -> str:
    """The printed values that the intervals contain, as a sentence."""
    low, high = posterior.interval.T
    inside = (low <= PRINTED) & (high >= PRINTED)
    contained = [
        f"{value:g}" for value, is_member in zip(PRINTED, inside, strict=True) if is_member
    ]
    overlapping = [
        f"{value:g}"
        for value, is_member in zip(PRINTED, posterior.covered & ~inside, strict=True)
        if is_member
    ]
    words = f"The intervals contain {' and '.join(contained) or 'none of the printed values'}"
    return words + (
        f" and overlap {' and '.join(overlapping)} within its rounding" if overlapping else ""
    )


def _reproducing_method(rows: tuple[Row, ...]) -> str:
    """The first method that gives the printed digits of eq. 28, as a phrase."""
    for row in rows:
        if rounds_to_print(row.mu):
            return f'by the method "{row.method}" with R = {row.radius:g} m, rho = {row.rho:g} m'
    return "by none of the methods"


def eq_28_claims(found: Eq28Findings, ring: RingFindings) -> dict[str, Claim]:
    """Eq. 28, the ratio of the two directions and the split, by id."""
    mu, solid, posterior = (
        coefficients_of(found.fit),
        coefficients_of(found.solid),
        found.uncertainty,
    )
    low, high = posterior.interval.T
    reached = bool(posterior.covered.all()) and posterior.share > 0
    verdict: Verdict = "holds" if rounds_to_print(mu) else "holds with a correction"
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
            verdict if reached else "does not hold",
            f"{_coverage(posterior)}; their width comes from R and rho, not from "
            f"noise ({posterior.noise[0]:.0e} in mu1_xi); all printed digits are reproduced "
            f"{_reproducing_method(found.rows)}.",
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
            "eps, beyond 1 too; the consistent load separates them, but correlates them with the "
            "sum.",
        ),
    ]  # fmt: skip
    return {claim.id: claim for claim in claims}
