"""Draws of an evening whose speeds vary about a mean, and forecasts of the next one."""

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import t as student

import curlfit
from curlfit.inference.joint.effects import Means
from curlfit.inference.joint.posterior import sampled
from curlfit.numerics.mixed_model import MixedModel
from curlfit.sheet import LINES, TEE
from curlfit.throws.events import Event

HOG = LINES["hog"]
FAR_HOG = LINES["far-hog"]


def timed_draw(friction, speed):
    """A draw under constant friction with a speed in m/s at the near hog line: its hog
    to hog time and where it came to rest, known to 0.01 s and 1 cm."""
    deceleration = 9.81 * friction
    length = speed**2 / (2 * deceleration)

    def beyond(t):
        return speed * t - deceleration * t**2 / 2 - (FAR_HOG - HOG)

    hog_to_hog = brentq(beyond, 0.0, speed / deceleration)
    return curlfit.Throw.from_events(
        [
            Event("hog_to_hog", "time", hog_to_hog, 0.01, FAR_HOG, HOG),
            Event("rest", "y", HOG + length, 0.01),
        ]
    )


def test_draws_to_one_place_do_not_tell_the_exponent_by_how_far_they_went():
    """Draws under constant friction, which varies by 2 % whatever their speed, which
    varies by 1 %: what goes far has less friction. With speeds that may be anything the
    exponent would be -0.35 +- 0.14, and friction would vary by 14 % less."""
    frictions = [-0.026, -0.009, 0.009, 0.026]
    speeds = [-0.013, 0.0, 0.013, -0.006, 0.006]
    usual = np.sqrt(2 * 9.81 * 0.009 * (TEE - HOG))
    throws = [
        timed_draw(0.009 * (1 + friction), usual * (1 + speed))
        for friction, speed in itertools.product(frictions, speeds)
    ]
    joint = curlfit.fit_together(throws, "power")
    assert joint.converged
    exponent = joint.coefficients["k"]
    assert exponent.verdict == "determined"
    assert abs(exponent.value) < 1.5 * exponent.stderr
    (variation,) = joint.variation
    scatter = np.std(frictions * len(speeds), ddof=1)
    assert variation.spread / variation.mean == pytest.approx(scatter, rel=0.12)


def test_a_forecast_is_as_wide_as_the_spread_is_uncertain():
    """Throws that know their coefficient exactly: with a flat prior of the spread the
    next one has Student's t with two degrees of freedom less than throws."""
    seen = np.array([1.1, 0.7, 1.9, 1.3, 0.4, 1.6])
    number = len(seen)
    error = 1e-4
    model = MixedModel.of(
        np.full((number, 1, 1), 1 / error),
        seen[:, None] / error,
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
    assert mean[0] == pytest.approx(seen.mean())
    squares = ((seen - seen.mean()) ** 2).sum()
    scale = np.sqrt(squares / (number - 2) * (1 + 1 / number))
    expected = student(number - 2, loc=seen.mean(), scale=scale)
    for level in (0.025, 0.16, 0.5, 0.84, 0.975):
        # within three Monte Carlo errors of 1,000 draws of the spread
        reach = 3 * np.sqrt(level * (1 - level) / 1000)
        below = np.mean(forecast[:, 0] < expected.ppf(level))
        assert below == pytest.approx(level, abs=reach)
