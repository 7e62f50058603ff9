"""Posterior, predictions and evidence of throws whose values that fit lie on a curve.

The files are those of `test_open_throws.py`. What is compared is integrated over the
spin, with all other parameters refitted at each, and Gaussian about these optima.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import curlfit
from curlfit.comparison.criteria import log_evidence, log_likelihood
from curlfit.inference.sampling.draws import WeightedProposals, draws_along_ridge

FOLDER = Path(__file__).parent / "open_throws"
NOISE = {"x": 0.005, "y": 0.005}


@cache
def fit_of(file: str, law: str) -> curlfit.FitResult:
    """The fit of a throw without the angle."""
    throw = curlfit.load_throw(FOLDER / file)
    return curlfit.fit(throw, law, sigma=NOISE, details=False)


@cache
def fits_at_spins(
    file: str, law: str, lowest: float, highest: float
) -> dict[float, curlfit.FitResult]:
    """The fits of a throw at 30 spins that are held."""
    throw = curlfit.load_throw(FOLDER / file)
    fits = {}
    for spin in np.geomspace(lowest, highest, 30).tolist():
        fix = {"omega0": spin}
        fits[spin] = curlfit.fit(throw, law, sigma=NOISE, fix=fix, details=False)
    return fits


class AtSpins(NamedTuple):
    """A coefficient and the probability where the spin is held, for a flat prior."""

    spins: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    densities: np.ndarray

    @classmethod
    def of(cls, fits: dict[float, curlfit.FitResult], name: str) -> "AtSpins":
        """By a fit at each of the spins."""
        logs = []
        for fit in fits.values():
            _, log_volume = np.linalg.slogdet(fit.covariance.matrix)
            logs.append((log_volume - fit.chi_squared) / 2)
        return cls(
            spins=np.array([*fits]),
            values=np.array([fit[name].value for fit in fits.values()]),
            errors=np.array([fit[name].stderr for fit in fits.values()]),
            densities=np.exp(np.array(logs) - max(logs)),
        )

    def quantiles(self, levels: tuple[float, ...]) -> np.ndarray:
        """Of the coefficient."""
        random = np.random.default_rng(0)
        width = np.gradient(self.spins)
        weights = self.densities * width
        chosen = random.choice(len(width), 200_000, p=weights / weights.sum())
        spins = self.spins[chosen] + width[chosen] * random.uniform(-0.5, 0.5, 200_000)
        values = np.interp(spins, self.spins, self.values)
        errors = np.interp(spins, self.spins, self.errors)
        return np.quantile(values + errors * random.standard_normal(200_000), levels)


@pytest.mark.slow
def test_the_posterior_leads_along_the_whole_ridge():
    """b, from 0.007 to 0.86, is a constant over the spin."""
    fit = fit_of("no_angle_transverse_2.csv", "power+transverse")
    fits = fits_at_spins("no_angle_transverse_2.csv", "power+transverse", 0.056, 12.5)
    about = AtSpins.of(fits, "b")
    expected = about.quantiles((0.025, 0.16, 0.5, 0.84, 0.975))
    fit, chain = curlfit.sample(fit, seed=1, effective=2000)
    assert fit.posterior.converged
    quantiles = np.array([*fit.posterior.quantiles["b"].values()])
    # 2000 independent draws: a standard error of 0.011 in probability
    assert np.log(quantiles / expected) == pytest.approx(np.zeros(5), abs=0.2)
    product = chain.of({"b": 1.0}) * chain.of({"omega0": 1.0})
    assert np.ptp(np.quantile(product, (0.16, 0.84))) < 0.1 * np.median(product)


@pytest.mark.slow
def test_the_posterior_holds_both_solutions():
    """Turning the other way with the opposite sign of f0 leads along the same path."""
    fit = fit_of("no_angle_angular.csv", "power-angular")
    fit, chain = curlfit.sample(fit, seed=1, effective=1000)
    assert fit.posterior.converged
    f0 = chain.of({"f0": 1.0})
    assert np.mean(f0 > 0) == pytest.approx(0.5, abs=0.06)
    low, high = np.quantile(f0, (0.025, 0.975))
    assert -0.8 < low < -0.45
    assert 0.45 < high < 0.8


def test_draws_without_a_chain_are_those_of_the_posterior():
    fit = fit_of("no_angle_pivot.csv", "power+pivot")
    values, effective = draws_along_ridge(fit, 2000, np.random.default_rng(0))
    assert effective > 2000
    spin = values[:, list(fit.parameters).index("omega0")]
    about = AtSpins.of(
        fits_at_spins("no_angle_pivot.csv", "power+pivot", 0.4, 12.0), "q"
    )
    q = values[:, list(fit.parameters).index("q")]
    levels = (0.025, 0.16, 0.5, 0.84, 0.975)
    assert np.quantile(q, levels) == pytest.approx(about.quantiles(levels), rel=0.1)
    below = about.densities * np.gradient(about.spins)
    median = np.interp(0.5, np.cumsum(below) / below.sum(), about.spins)
    assert np.median(spin) == pytest.approx(median, rel=0.1)


@pytest.mark.slow
def test_a_fit_whose_law_stays_open_is_sampled_without_a_fault():
    """Of a stone thrown without spin; many steps would be needed."""
    throw = curlfit.load_throw(FOLDER / "no_spin_fcv1.csv")
    sigma = NOISE | {"phi": 0.01}
    fit = curlfit.fit(throw, "fcv1", sigma=sigma, details=False)
    fit, _ = curlfit.sample(fit, seed=1, effective=200, most_steps=20)
    assert not fit.posterior.converged
    report = str(fit)
    assert "68 %" not in report


def test_the_evidence_is_that_of_all_spins():
    fit = fit_of("no_angle_pivot.csv", "power+pivot")
    likelihood = sum(log_likelihood(fit).values())
    fits = fits_at_spins("no_angle_pivot.csv", "power+pivot", 0.4, 12.0)
    logs = []
    for held in fits.values():
        likelihood_held = sum(log_likelihood(held).values())
        logs.append(log_evidence(replace(held, ridge=()), likelihood_held))
    highest = max(logs)
    densities = np.exp(np.array(logs) - highest)
    expected = highest + np.log(np.trapezoid(densities, [*fits]))
    assert log_evidence(fit, likelihood) == pytest.approx(expected, abs=0.05)


def test_proposals_integrate_a_quadratic_exactly(eq12):
    """As Laplace's integral."""
    fit = curlfit.fit(eq12, "tensor", details=False)
    proposals = WeightedProposals.of(fit, 4096, np.random.default_rng(0))
    assert proposals.effective > 2000
    log_integral = np.log(np.mean(np.exp(proposals.log_ratio)))
    size = len(fit.covariance.names)
    _, log_volume = np.linalg.slogdet(fit.covariance.matrix)
    expected = (size * np.log(2 * np.pi) + log_volume) / 2
    assert log_integral == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("given", [None, {"v0": 2.0, "omega0": 1.4}])
def test_bands_without_a_chain_are_drawn_along_the_ridge(given):
    fit = fit_of("no_angle_pivot.csv", "power+pivot")
    prediction = curlfit.predict(fit, start=given, draws=400)
    assert prediction.draws["source"] == "ridge"
    assert "bands-along-curve" in {note.code for note in prediction.notes}


@pytest.mark.slow
def test_two_times_tell_the_time_to_rest_and_no_speed():
    """Each exponent fits; the time is the sum of two that were measured to 0.1 s."""
    fit = curlfit.fit(curlfit.load_throw(FOLDER / "two_times.txt"), "power")
    prediction = curlfit.predict(fit, draws=400)
    assert prediction.quantities["time"].parameter_sd < 0.2
    assert prediction.quantities["speed_at_hog"].parameter_sd > 0.3
