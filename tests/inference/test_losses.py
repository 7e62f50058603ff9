"""Robust losses: against scipy's, against the textbook's efficiency, and
outliers held off."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from conftest import filmed, finding_of
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import norm, t

import curlfit
from curlfit.errors import InputError, Option
from curlfit.losses import LOSSES
from curlfit.reports.fit import outliers

R = np.concatenate([-np.logspace(3, -9, 60), [0.0], np.logspace(-9, 3, 60)])


def rho(name):
    return np.asarray(LOSSES[name].signed_root(R)) ** 2


def test_losses_are_scipy_s():
    # scipy.optimize.least_squares: rho(z) with z = (r/scale)^2, times scale^2
    z = R**2
    np.testing.assert_allclose(
        rho("soft-l1"), 2 * (np.sqrt(1 + z) - 1), rtol=1e-12, atol=1e-14
    )
    k = 1.345
    huber = np.where(z <= k**2, z, 2 * k * np.abs(R) - k**2)
    np.testing.assert_allclose(rho("huber"), huber, rtol=1e-12)
    c = 2.385
    np.testing.assert_allclose(rho("cauchy"), c**2 * np.log1p(z / c**2), rtol=1e-12)
    likelihood = -2 * (t.logpdf(R, 4) - t.logpdf(0, 4))
    np.testing.assert_allclose(rho("student"), likelihood, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("loss", LOSSES.values(), ids=LOSSES)
def test_derivatives(loss):
    def root(r):
        return loss.signed_root(r)

    def half(r):
        return root(r) ** 2 / 2

    slopes = jax.grad(root), jax.grad(half), jax.grad(jax.grad(half))
    slope, psi, bend = jax.jit(
        jax.vmap(lambda r: [derivative(r) for derivative in slopes])
    )(R)
    assert np.isfinite(slope[R == 0]).all()
    some = np.abs(R) > 1e-6
    np.testing.assert_allclose(loss.root_slope(R)[some], slope[some], rtol=1e-6)
    np.testing.assert_allclose(loss.psi(R)[some], psi[some], rtol=1e-7)
    some &= np.abs(np.abs(R) - 1.345) > 1e-3
    psi_slope = loss.psi_slope(R)[some]
    np.testing.assert_allclose(psi_slope, bend[some], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("loss", LOSSES.values(), ids=LOSSES)
def test_every_loss_is_the_likelihood_of_some_noise(loss):
    def density(r):
        return np.exp(loss.log_density(np.array([r]))[0])

    assert 2 * quad(density, 0, np.inf, limit=400)[0] == pytest.approx(1, rel=1e-7)
    for r in (0.3, 1.0, 2.0, 9.0):
        fall = -2 * np.log(density(r) / density(0.0))
        assert fall == pytest.approx(float(loss.signed_root(r)) ** 2, rel=1e-9)
    if loss.name in ("linear", "student"):
        distribution = norm if loss.name == "linear" else t(4)
        np.testing.assert_allclose(
            loss.log_density(R), distribution.logpdf(R), rtol=1e-9
        )


@pytest.mark.parametrize("loss", LOSSES.values(), ids=LOSSES)
def test_the_likeliest_sigma(loss):
    random = np.random.default_rng(4)
    values = 0.03 * random.standard_t(4, 4000)

    def minus_log(log_sigma):
        return -(loss.log_density(values / np.exp(log_sigma)) - log_sigma).sum()

    sigma = loss.likeliest_sigma(values)
    best = minimize_scalar(minus_log, bounds=(np.log(1e-3), 0), method="bounded")
    assert np.log(sigma) == pytest.approx(best.x, abs=1e-4)
    if loss.name == "student":
        assert sigma == pytest.approx(t.fit(values, fdf=4, floc=0)[2], rel=1e-3)
        assert sigma == pytest.approx(0.03, rel=0.05)
    assert loss.likeliest_sigma(np.zeros(9)) == 1e-12


@pytest.mark.parametrize("name", ["huber", "cauchy"])
def test_constants_give_95_percent_of_the_information_of_gaussian_noise(name):
    loss = LOSSES[name]

    def mean(f):
        return quad(lambda r: f(np.array([r]))[0] * norm.pdf(r), -8, 8, limit=400)[0]

    slope = mean(lambda r: loss.psi_slope(r))
    square = mean(lambda r: loss.psi(r) ** 2)
    assert slope**2 / square == pytest.approx(0.95, abs=2e-3)
    sample = np.random.default_rng(0).standard_normal(200_000)
    assert loss.precision(sample) == pytest.approx(0.95, abs=0.01)


@pytest.fixture(scope="module")
def clean():
    return filmed(seed=3, omega=-1.3)


@pytest.fixture(scope="module")
def plain(clean):
    return curlfit.fit(clean)


@pytest.fixture(scope="module")
def spoiled(clean):
    random = np.random.default_rng(1)
    channels = {}
    hit = {}
    for name, size in (("x", 0.3), ("y", 1.0), ("phi", 2.0)):
        values = getattr(clean, name).copy()
        rows = random.choice(len(values), len(values) // 20, replace=False)
        values[rows] += size * np.sign(random.standard_normal(len(rows)))
        channels[name] = values
        hit[name] = {float(clean.t[row]) for row in rows}
    return replace(clean, **channels), hit


@pytest.mark.parametrize(
    "loss", [pytest.param("huber", marks=pytest.mark.slow), "student"]
)
def test_five_percent_outliers_move_nothing_by_a_standard_error(
    loss, plain, clean, spoiled
):
    before, after = (
        curlfit.fit(throw, loss=loss, details=False) for throw in (clean, spoiled[0])
    )
    # clean data lose next to nothing
    reference = plain["mu2_xi"]
    estimate = before["mu2_xi"]
    assert estimate.stderr / reference.stderr < 1.1
    assert abs(estimate.value - reference.value) < reference.stderr
    for name in ("mu1_xi", "mu2_xi", "v0", "omega0", "heading"):
        reference = before.parameters[name]
        estimate = after.parameters[name]
        assert abs(reference.value - estimate.value) < reference.stderr, name
        assert 0.95 < estimate.stderr / reference.stderr < 1.4
    (reference,) = before.combinations
    (estimate,) = after.combinations
    assert abs(reference.value - estimate.value) < reference.stderr


def test_least_squares_is_pulled_and_says_so(plain, spoiled):
    after = curlfit.fit(spoiled[0])
    reference = plain.parameters["mu1_xi"]
    pulled = after.parameters["mu1_xi"]
    assert abs(reference.value - pulled.value) > 3 * reference.stderr
    assert Option("loss", "student") in finding_of(after, "outliers").options
    assert not plain.outliers


def test_outliers_are_called_by_name(spoiled):
    throw, hit = spoiled
    fit = curlfit.fit(throw, loss="student")
    for name, times in hit.items():
        assert {
            outlier["t"] for outlier in fit.outliers if outlier["channel"] == name
        } == times
    text = outliers(fit)
    assert text.count(" by ") == 6
    assert f"and {len(fit.outliers) - 6} more" in text
    assert curlfit.fit_figure(fit).axes


def test_an_unknown_loss_is_refused(clean):
    with pytest.raises(InputError, match="loss = 'l7'; expected one of"):
        curlfit.fit(clean, loss="l7")
