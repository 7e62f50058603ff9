"""Laws under several noise models in one comparison, and what priors count."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from conftest import NOISE as SIGMA, TIMES, filmed
from rich.console import Console
from scipy.stats import multivariate_normal

import curlfit
from curlfit.comparison.report import conclusions, document, print_comparison
from curlfit.comparison.result import load_comparison

MEMORY = 0.5


@pytest.fixture(scope="module")
def throw():
    """Its noise forgets itself within half a second."""
    random = np.random.default_rng(2)
    root = np.linalg.cholesky(np.exp(-np.abs(TIMES[:, None] - TIMES) / MEMORY))
    exact = filmed(
        curlfit.LAWS["coulomb"](0.009), noise=dict.fromkeys(SIGMA, 0.0), omega=1.3
    )
    noise = {
        name: size * root @ random.standard_normal(201) for name, size in SIGMA.items()
    }
    return replace(
        exact, **{name: getattr(exact, name) + noise[name] for name in noise}
    )


@pytest.fixture(scope="module")
def found(throw):
    return curlfit.compare(throw, ["coulomb"], noise=["white", "ar1", "white"])


def test_likelihoods_of_noise_models_are_densities_of_the_data(found):
    """With the determinant of the covariance, against a dense one."""
    assert [candidate.noise for candidate in found.candidates] == ["ar1", "white"]
    for candidate, result in zip(found.candidates, found.fits, strict=True):
        total = 0.0
        t = result.observed["t"]
        for name in SIGMA:
            off = result.observed[name] - result.fitted[name]
            memory = candidate.noise_model.memory.get(name, 1e-9)
            white = candidate.noise_model.white.get(name, 1.0)
            correlation = (1 - white) * np.exp(-np.abs(t[:, None] - t) / memory)
            correlation += white * np.eye(len(t))
            # the most likely
            variance = off @ np.linalg.solve(correlation, off) / len(t)
            total += multivariate_normal.logpdf(off, cov=variance * correlation)
        assert candidate.log_likelihood == pytest.approx(total, abs=1e-6)


def test_criteria_of_noise_models_are_comparable(found):
    ar1, white = found.candidates
    assert found.effective == {}  # of the fit of greatest likelihood
    assert (ar1.rank, white.rank) == (1, 2)
    assert ar1.n_parameters == pytest.approx(white.n_parameters + 4, abs=0.01)
    n = found.fits[0].n_observations
    expected = 2 * (ar1.log_likelihood - white.log_likelihood)
    expected += (white.n_parameters - ar1.n_parameters) * np.log(n)
    assert white.delta_bic == pytest.approx(expected, rel=1e-9)
    assert white.delta_bic > 100
    assert all(0.2 < memory < 1.2 for memory in ar1.noise_model.memory.values())
    assert (
        ar1.log_evidence is white.log_evidence is ar1.elpd_loo is white.elpd_loo is None
    )


def test_report_and_record_name_the_noise_of_each_fit(found, tmp_path):
    console = Console(width=110, file=StringIO())
    print_comparison(found, console)
    output = console.file.getvalue()
    assert "white and ar1 noise" in output.splitlines()[0]
    assert "coulomb, uniform load, ar1 noise" in output
    assert "The lowest BIC is that of ar1 noise" in " ".join(conclusions(found))
    found.save(tmp_path / "compare.json")
    again = load_comparison(tmp_path)
    assert again.to_json() == found.to_json()
    assert again.noises == ("white", "ar1")
    assert found.of("coulomb", noise="white").rank == 2
    assert found.of("coulomb").noise == "ar1"
    with pytest.raises(KeyError, match="discrepancy"):
        found.of("coulomb", noise="discrepancy")
    legend = curlfit.comparison_figure(found).axes[0].get_legend_handles_labels()[1]
    assert legend[1:] == [
        "1. coulomb, uniform load, ar1 noise",
        "2. coulomb, uniform load",
    ]


def test_correlated_residuals_count_effective_values_less_those_spent(throw):
    comparison = curlfit.compare(throw, ["coulomb"])
    k = comparison.best.n_parameters
    counts = comparison.effective
    assert counts.keys() == SIGMA.keys()
    # n (1 - r)/(1 + r) of the noise that was drawn
    r = np.exp(-0.1 / MEMORY)
    assert sum(counts.values()) == pytest.approx(3 * 201 * (1 - r) / (1 + r), rel=0.3)
    minus_two = 0.0
    for name, rms in comparison.best.rms.items():
        spent = (k - 3) / 3  # a third of the parameters but the sigmas
        minus_two += (np.log(2 * np.pi * rms**2) + 1) * (counts[name] - spent)
    expected = minus_two + k * np.log(sum(counts.values()))
    assert comparison.best.bic == pytest.approx(expected, rel=1e-9)
    report = document(comparison)
    assert [note.code for note in report.notes] == ["evidence-not-given"]
    (warning,) = report.warnings
    (remedy,) = warning.remedies
    assert str(remedy) == "`--noise white,ar1` compares noise models"


def test_what_a_prior_says_is_not_counted_as_what_the_data_determine(throw):
    mu = 0.009
    free = curlfit.compare(throw, ["coulomb"])
    prior = curlfit.compare(throw, ["coulomb"], priors={"mu": f"{mu}+-1e-9"})
    fixed = curlfit.compare(throw, ["coulomb"], fix={"mu": mu})
    counts = [comparison.best.n_parameters for comparison in (free, prior, fixed)]
    assert counts == pytest.approx([10, 9, 9], abs=1e-3)
    # nor in the correction of the correlation of residuals for the
    # parameters of the fit
    assert prior.effective == pytest.approx(fixed.effective, rel=1e-4)
    assert prior.best.bic == pytest.approx(fixed.best.bic, abs=1e-3)
    assert prior.best.aicc == pytest.approx(fixed.best.aicc, abs=1e-3)
    half = curlfit.compare(
        throw,
        ["coulomb"],
        priors={"mu": f"{mu}+-{free.best.coefficients['mu']['stderr']}"},
    )
    assert half.best.n_parameters == pytest.approx(9.5, abs=0.1)
