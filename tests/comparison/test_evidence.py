"""The evidence of laws against integrals done otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import filmed
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.stats import halfnorm, lognorm, norm

import curlfit
from curlfit.comparison.criteria import (
    _log_box,
    _log_integral,
    effective_parameters,
    log_evidence,
    log_likelihood,
)
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.model.likelihood import chi_squared_of_many
from curlfit.numerics.batches import BATCH, stacked

FIXED = {
    "mu1_xi": 0.0018,
    "mu2_xi": 0.058,
    "x0": 0.0,
    "y0": 0.0,
    "heading": 0.0,
    "phi0": 0.0,
    "omega0": 1.0,
}


@pytest.mark.parametrize("width", [0.1, 1e-3, 1e-5])
def test_a_ridge_within_a_box(width):
    # a + b is known to `width`, each has a prior of mean 0.1 and standard deviation
    # 0.3, in 0..1
    information = np.ones((2, 2)) / width**2
    prior = np.eye(2) / 0.3**2
    log_integral = _log_integral(
        prior @ [-0.1, -0.1],
        information + prior,
        np.full(2, -0.1),
        np.full(2, 0.9),
        np.zeros(2, bool),
    )

    def along(difference):
        total = width * np.linspace(-8, 8, 4001)
        a = (total + difference) / 2
        b = (total - difference) / 2
        exponent = -(total**2) / (2 * width**2) - (a**2 + b**2 + 0.2 * (a + b)) / (
            2 * 0.3**2
        )
        inside = (a >= -0.1) & (b >= -0.1) & (a <= 0.9) & (b <= 0.9)
        return np.trapezoid(np.exp(exponent) * inside, total)

    differences = np.linspace(-1.0, 1.0, 4001)
    values = [along(difference) for difference in differences]
    assert log_integral == pytest.approx(
        np.log(np.trapezoid(values, differences) / 2), abs=2e-3
    )


@pytest.mark.parametrize("push", [0.1, 3.0, 300.0])
def test_a_parameter_pushed_against_its_bound(push):
    log_integral = _log_integral(
        np.array([-push]),
        np.array([[4.0]]),
        np.zeros(1),
        np.full(1, np.inf),
        np.ones(1, bool),
    )
    farthest = 10 / max(push, 1.0)
    expected, _ = quad(lambda d: np.exp(-push * d - 2 * d**2), 0, farthest, limit=200)
    assert log_integral == pytest.approx(np.log(expected), abs=1e-4)


@pytest.fixture(scope="module")
def few():
    """A throw of which three parameters are unknown, two of them along a ridge."""
    law = curlfit.LAWS["front-back"](0.0018, 0.058, 0.009, 0.009)
    sigma = dict.fromkeys(("x", "y", "phi"), 0.3)
    throw = filmed(
        law, 5, sigma, np.arange(0.0, 15.0, 0.1), v=2.0, omega=1.0
    ).with_sigma(sigma)
    return curlfit.fit(throw, fix=FIXED, details=False)


def test_the_number_of_parameters_does_not_jump(few):
    counts = []
    for factor in 10.0 ** np.arange(-8, 3, 0.5):
        scaled = replace(few.information, matrix=factor * few.information.matrix)
        counts.append(effective_parameters(replace(few, information=scaled)))
    # The initial speed, whose prior is flat, counts always, what is along the
    # ridge never.
    assert counts[0] == pytest.approx(1.0, abs=0.01)
    assert counts[-1] == pytest.approx(2.0, abs=1e-3)
    assert np.all(np.diff(counts) > -1e-9)
    assert np.diff(counts).max() < 0.6


@pytest.mark.parametrize(
    ("prior", "density", "sigma", "by_data"),
    [
        ("lognormal:0.05,0.5", lognorm(0.5, scale=0.05), 0.3, 1),
        ("lognormal:0.003,0.5", lognorm(0.5, scale=0.003), 0.3, 1),
        ("half-normal:0.02", halfnorm(scale=0.02), 0.3, 1),
        ("0.012+-0.002", norm(0.012, 0.002), 0.3, 1),
        ("lognormal:0.05,0.5", lognorm(0.5, scale=0.05), 1000.0, 0),  # which decides
    ],
)
def test_the_prior_of_one_coefficient_against_quadrature(
    few, prior, density, sigma, by_data
):
    throw = few.throw.with_sigma(dict.fromkeys(("x", "y", "phi"), sigma))
    fix = {**FIXED, "mu2_eta": 0.009, "v0": 2.0}
    fit = curlfit.fit(throw, fix=fix, priors={"mu1_eta": prior}, details=False)
    problem = problem_of(fit)
    value = fit["mu1_eta"].value
    stderr = fit["mu1_eta"].stderr
    low = max(value - 8 * stderr, density.ppf(1e-7), 0.0)
    high = min(value + 40 * stderr, density.ppf(1 - 1e-7))
    values = np.linspace(low, high, 64)
    points = np.tile(fit.values, (len(values), 1))
    points[:, list(fit.parameters).index("mu1_eta")] = values
    chi_squared = chi_squared_of_many(
        fit.model, points, stacked([problem] * len(values)), BATCH
    )
    likelihood = CubicSpline(values, -0.5 * (chi_squared - fit.chi_squared))
    integral = quad(
        lambda p: np.exp(likelihood(p)) * density.pdf(p),
        low,
        high,
        points=[value],
        limit=200,
    )[0]
    total = sum(log_likelihood(fit).values())
    assert log_evidence(fit, total) - total == pytest.approx(np.log(integral), abs=0.02)
    assert effective_parameters(fit) == pytest.approx(by_data, abs=0.01)


@pytest.mark.parametrize(
    "ends", [(0.0, np.inf), (-np.inf, -0.5), (3.0, np.inf), (-1.0, 2.0)]
)
def test_the_probability_of_a_box_in_one_dimension_and_in_two(ends):
    low, high = np.array(ends)
    exact = np.log(norm.sf(low) - norm.sf(high))
    far = np.array([-np.inf, np.inf])
    interval = _log_box(np.zeros(1), np.eye(1), low[None], high[None])
    rectangle = _log_box(
        np.array([0.0, 1.0]), np.eye(2), np.array([low, -1.0]), np.array([high, far[1]])
    )
    assert interval == pytest.approx(exact, rel=1e-12)
    assert rectangle == pytest.approx(exact + norm.logsf(-2.0), rel=1e-6)
