"""Forecasts of another throw whose coefficients vary."""

import numpy as np
import pytest
from scipy.stats import t as student

from curlfit.inference.together.effects import Means
from curlfit.inference.together.posterior import sampled
from curlfit.numerics.mixed_model import MixedFit, MixedModel


def test_a_forecast_is_as_wide_as_the_spread_is_uncertain():
    """Throws that know their coefficient exactly: with a flat prior of the spread the
    next one has Student's t with two degrees of freedom less than throws."""
    coefficients = np.array([1.1, 0.7, 1.9, 1.3, 0.4, 1.6])
    number = len(coefficients)
    error = 1e-4
    model = MixedModel.of(
        np.full((number, 1, 1), 1 / error),
        coefficients[:, None] / error,
        np.eye(1),
        np.zeros((number, 0)),
    )
    far = np.array([100.0])
    fit = model.fitted(np.array([0.2]), -far, far)
    draws = sampled(fit, np.array([0.2]), seed=1)
    means = Means(
        names=("c",),
        groups={},
        trends={},
        centre=np.zeros(0),
        last=np.zeros(0),
        estimate=fit.estimate,
        covariance=fit.covariance,
        directions=np.eye(1),
        spreads=np.sqrt(fit.variances),
        dof=number - 1.0,
        angle=0.0,
        drawn=np.concatenate([draws.estimate, draws.spreads], 1),
    )
    mean, forecast = means.draw({}, 20_000, np.random.default_rng(2), -far, far)
    assert mean[0] == pytest.approx(coefficients.mean())
    squares = ((coefficients - coefficients.mean()) ** 2).sum()
    scale = np.sqrt(squares / (number - 2) * (1 + 1 / number))
    expected = student(number - 2, loc=coefficients.mean(), scale=scale)
    for level in (0.025, 0.16, 0.5, 0.84, 0.975):
        # within three Monte Carlo errors of 1,000 draws of the spread
        reach = 3 * np.sqrt(level * (1 - level) / 1000)
        below = np.mean(forecast[:, 0] < expected.ppf(level))
        assert below == pytest.approx(level, abs=reach)


def test_draws_contain_the_uncertainty_of_what_throws_do_not_tell():
    """The second number is cut: it keeps its standard deviation of 0.3, and the first
    moves with it by half."""
    random = np.random.default_rng(4)
    number = 12
    rows = np.tile([10.0, 5.0], (number, 1, 1))
    target = (rows @ np.array([1.0, 2.0]))[:, :] + random.normal(size=(number, 1))
    model = MixedModel.of(
        rows,
        target,
        np.array([[1.0], [0.0]]),
        np.zeros((number, 0)),
        prior=(np.array([[0.0, 1e4]]), np.array([2e4])),
    )
    far = np.full(2, 100.0)
    variances = model.variances(np.array([0.04]))
    fit = MixedFit(model, variances, -far, far, cut=np.array([0.0, 0.3**2]))
    draws = sampled(fit, np.array([0.2]), seed=1)
    first, second = draws.estimate.T
    assert second.std() == pytest.approx(0.3, rel=0.04)
    slope, _ = np.polyfit(second, first, 1)
    assert slope == pytest.approx(-0.5, abs=0.02)
