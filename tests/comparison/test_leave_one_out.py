"""Leave-one-out in closed form, against fits without the row and exact integrals.

Against importance sampling of chains: `tests/statistics/test_samplers.py`.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gammaln
from scipy.stats import expon, multivariate_normal, norm, truncnorm

import curlfit
from curlfit.comparison.leave_one_out import _bound_factors, densities, leave_one_out
from curlfit.friction import LocalLaw
from curlfit.friction.registry import laws_under

SIGMA = {"x": 0.005, "y": 0.005, "phi": 0.01}
START = {
    "x0": "x",
    "y0": "y",
    "heading": "heading",
    "v0": "v",
    "phi0": "phi",
    "omega0": "omega",
}


@pytest.fixture(scope="module")
def throw():
    """31 rows, so that a row matters, five of them without x."""
    full_throw = curlfit.synthetic_throw(
        curlfit.LAWS["coulomb"](0.009),
        curlfit.Stone(),
        v0=2.0,
        omega0=1.2,
        until=15.0,
        dt=0.5,
        noise_xy=0.005,
        noise_phi=0.01,
        seed=3,
    )
    x = full_throw.x.copy()
    x[4:9] = np.nan
    return curlfit.Throw.from_arrays(
        full_throw.t, x, full_throw.y, full_throw.phi, sigma=SIGMA
    )


@pytest.fixture(scope="module")
def fit(throw):
    return curlfit.fit(throw, "coulomb", systematics={"all": 0.0})


def path_of(result, times):
    """x, y, phi of a fit whose first row is at time 0, shape (rows, 3)."""
    value = {name: estimate.value for name, estimate in result.parameters.items()}
    return path(value, times)


def path(value, times):
    start = curlfit.InitialState(**{START[name]: value[name] for name in START})
    trajectory = curlfit.simulate(
        curlfit.LAWS["coulomb"](value["mu"]), curlfit.Stone(), start, times
    )
    return np.stack([trajectory.x, trajectory.y, trajectory.phi], -1)


def test_the_closed_form_against_fits_without_the_row(throw, fit):
    # The first row stays: where it is left out, the initial state is that of
    # another time.
    rows = np.arange(1, len(throw), 2)
    cut = [
        curlfit.Throw.from_arrays(
            *(
                np.delete(series, row)
                for series in (throw.t, throw.x, throw.y, throw.phi)
            ),
            sigma=SIGMA,
        )
        for row in rows
    ]
    names = list(fit.parameters)
    value = {name: fit.parameters[name].value for name in names}
    slopes = []
    for name in names:
        step = fit.parameters[name].stderr
        up = path({**value, name: value[name] + step}, throw.t)
        down = path({**value, name: value[name] - step}, throw.t)
        slopes.append((up - down) / (2 * step))
    slopes = np.moveaxis(slopes, 0, -1)
    measured = np.stack([throw.x, throw.y, throw.phi], -1)

    def log_predictive(other, row):
        assert list(other.covariance.names) == names
        covariance = slopes[row] @ other.covariance.matrix @ slopes[row].T
        covariance += np.diag(np.square(list(SIGMA.values())))
        off = measured[row] - path_of(other, throw.t)[row]
        finite = np.isfinite(off)
        return multivariate_normal.logpdf(
            off[finite], cov=covariance[np.ix_(finite, finite)]
        )

    by_closed_form = leave_one_out(fit)
    refits = [curlfit.fit(shortened, "coulomb", details=False) for shortened in cut]
    expected = [log_predictive(*pair) for pair in zip(refits, rows, strict=True)]
    np.testing.assert_allclose(by_closed_form.left_out[rows], expected, atol=2e-3)
    fitted = [log_predictive(fit, row) for row in rows]
    np.testing.assert_allclose(by_closed_form.fitted[rows], fitted, atol=2e-3)


def test_an_estimated_sigma_against_the_exact_integral():
    """Of a regression p(y_i | y_-i) = p(y)/p(y_-i), with p(sigma) = 1/sigma."""
    random = np.random.default_rng(0)
    design = random.standard_normal((12, 3))
    y = 0.3 * random.standard_normal(12)

    def log_marginal(rows):
        x = design[rows]
        squares = np.linalg.lstsq(x, y[rows], rcond=None)[1]
        half = (len(rows) - 3) / 2
        spread = np.linalg.slogdet(x.T @ x)[1]
        return gammaln(half) - spread / 2 - half * np.log(np.pi * squares[0])

    all_rows = np.arange(12)
    expected = [
        log_marginal(all_rows) - log_marginal(np.delete(all_rows, row))
        for row in all_rows
    ]
    residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    by_closed_form = densities(
        2 * residual[None],
        2 * design[None],
        np.full((1, 12), 2.0),
        np.zeros((0, 3)),
        np.zeros(0),
        np.array([True]),
    )
    np.testing.assert_allclose(by_closed_form.left_out, expected, rtol=1e-9)


def test_a_prior_counts_as_a_row_that_is_never_left_out():
    random = np.random.default_rng(1)
    design = random.standard_normal((6, 2))
    y = random.standard_normal(6)
    sd = np.array([0.3, 2.0])
    mean = np.array([0.1, -0.2])
    # marginal of y, with the parameters integrated out
    covariance = np.eye(6) + (design * sd**2) @ design.T
    off = y - design @ mean
    expected = []
    for row in range(6):
        rest = np.delete(np.arange(6), row)
        gain = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, row])
        spread = covariance[row, row] - gain @ covariance[rest, row]
        expected.append(norm.logpdf(off[row], gain @ off[rest], np.sqrt(spread)))
    by_closed_form = densities(
        y[None],
        design[None],
        np.ones((1, 6)),
        np.diag(1 / sd),
        mean / sd,
        np.array([False]),
    )
    np.testing.assert_allclose(by_closed_form.left_out, expected, rtol=1e-9)


@pytest.fixture(scope="module")
def of_ring(throw):
    laws = [law for law, _ in laws_under(None) if issubclass(law, LocalLaw)]
    return curlfit.compare(throw, laws)


def test_a_ridge_is_no_parameter(of_ring):
    """Under uniform load `pressure` is `coulomb`, and tells and costs as much."""
    coulomb = of_ring.of("coulomb")
    pressure = of_ring.of("pressure")
    assert pressure.not_identifiable == ("k",)
    for name in ("elpd_loo", "p_loo", "delta_elpd", "delta_elpd_se"):
        assert getattr(pressure, name) == pytest.approx(
            getattr(coulomb, name), abs=1e-4
        )
    assert coulomb.log_evidence == pytest.approx(pressure.log_evidence, abs=1e-3)
    assert coulomb.weight == pytest.approx(pressure.weight, abs=1e-3)
    assert 0.1 < coulomb.weight <= 0.5


@pytest.mark.parametrize("push", [0.0, 0.7, 8.0, 49.0, 51.0, 1e6])
@pytest.mark.parametrize("inward", [1.0, -1.0])
def test_a_bound_has_the_mean_and_variance_of_what_it_leaves(push, inward):
    precision = np.array([[5.0, 1.0], [1.0, 4.0]])
    gradient = np.array([0.5, 0.0])
    stiffness = 4.0 - 1 / 5
    # with the other integrated out
    gradient[1] = 0.5 / 5 - inward * push * np.sqrt(stiffness)
    factors = _bound_factors(precision, gradient, np.array([0.0, inward]))
    assert (factors.mean[0], factors.precision[0]) == (0.0, 0.0)
    total_stiffness = stiffness + factors.precision[1]
    mean = (
        factors.precision[1] * factors.mean[1] - inward * push * np.sqrt(stiffness)
    ) / total_stiffness
    left = expon(scale=1 / push) if push > 100 else truncnorm(push, np.inf, loc=-push)
    assert inward * mean * np.sqrt(stiffness) == pytest.approx(left.mean(), rel=2e-3)
    assert stiffness / total_stiffness == pytest.approx(left.var(), rel=5e-3)


def test_a_row_that_alone_determines_a_parameter_is_not_predicted():
    design = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])[None]

    def score(design):
        """Of residuals of zero, without a prior and with sigma given."""
        return densities(
            np.zeros((1, 3)),
            design,
            np.ones((1, 3)),
            np.zeros((0, design.shape[-1])),
            np.zeros(0),
            np.array([False]),
        )

    assert score(design) is None
    assert score(design[..., :1])
