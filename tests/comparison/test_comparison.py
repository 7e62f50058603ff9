"""Many laws on one throw: the paper's outcome on eq. 12, and the true law on
synthetic throws."""

from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from conftest import NOISE, TIMES, filmed
from rich.console import Console
from scipy.stats import t

import curlfit
from curlfit import LAWS
from curlfit.comparison.compare import compare
from curlfit.comparison.report import conclusions, document, print_comparison
from curlfit.comparison.result import load_comparison
from curlfit.friction.registry import laws_under

ISOTROPIC = {
    "coulomb",
    "power",
    "power-angular",
    "pressure",
    "angular",
    "stribeck",
    "sutor",
    "debris",
}
RIVALS = ["front-back", "coulomb"]
MANY = [law for law, _ in laws_under(None) if law.name not in ("denny-1998", "fcv1")]
"""One law without a ring stands for three, each of which takes programs of its own."""


@pytest.fixture(scope="module")
def of_eq12(eq12):
    return compare(eq12, MANY)


def test_on_eq_12_the_outcome_is_the_paper_s(of_eq12):
    front_back = of_eq12.of("front-back")
    assert front_back.follows
    assert not front_back.negative
    assert of_eq12.side == "left"
    for name in sorted(ISOTROPIC):
        candidate = of_eq12.of(name)
        assert candidate.isotropic
        assert not candidate.follows
        assert candidate.curl_explained < 0.7  # at most, by sutor
        assert candidate.delta_bic > front_back.delta_bic + 10
        assert candidate.log_likelihood < front_back.log_likelihood - 1000
    assert not of_eq12.of("radial").follows
    negative = of_eq12.of("radial", signs_free=True)
    assert negative.follows
    assert negative.negative
    assert negative.rank is None
    text = " ".join(conclusions(of_eq12))
    assert "No isotropic law" in text
    assert "radial, uniform load, any sign: follows the path only with negative" in text


def test_laws_that_do_not_oppose_sliding_are_not_called_isotropic(of_eq12):
    assert {
        candidate.law for candidate in of_eq12.candidates if candidate.isotropic
    } == ISOTROPIC


@pytest.mark.slow
def test_where_no_law_is_named_all_are_compared_that_approximate_no_other(eq12):
    shipped = {
        law.name for law in LAWS.values() if law.shipped() and not law.approximates
    }
    assert {candidate.law for candidate in compare(eq12).candidates} == shipped


def test_sides_a_law_can_curl_to(of_eq12):
    assert of_eq12.of("coulomb").sides == ()
    assert of_eq12.of("semi-empirical").sides == ("left",)
    assert of_eq12.of("front-back").sides == ("left", "right")


def test_criteria_are_those_of_a_gaussian(of_eq12):
    candidate = of_eq12.of("front-back")
    result = of_eq12.fits[of_eq12.candidates.index(candidate)]
    n = result.n_observations
    k = candidate.n_parameters
    assert k == pytest.approx(result.identifiability.rank + 3, abs=1e-3)
    # at the most likely sigma, -2 log L = n_c (log(2 pi rms^2) + 1) in each channel
    by_channel = [201 * (np.log(2 * np.pi * rms**2) + 1) for rms in result.rms.values()]
    assert -2 * candidate.log_likelihood == pytest.approx(sum(by_channel), rel=1e-12)
    # smooth residuals count by their effective number, less what the best fit spends on
    # it: here next to nothing is left
    assert of_eq12.effective.keys() == {"x", "y", "phi"}
    assert all(1 <= count < 6 for count in of_eq12.effective.values())
    minus_two = sum(by_channel) / 201
    effective = sum(of_eq12.effective.values())
    assert candidate.bic == pytest.approx(minus_two + k * np.log(effective), rel=1e-12)
    assert candidate.aicc == pytest.approx(
        minus_two + 2 * k * n / (n - k - 1), rel=1e-12
    )
    (warning,) = document(of_eq12).warnings
    assert warning.code == "ranking-not-reliable"
    worth = {entry["channel"]: entry for entry in warning.numbers["worth"]}
    assert worth["x"] == {
        "channel": "x",
        "effective": of_eq12.effective["x"],
        "rows": 201,
    }
    assert f"({of_eq12.effective['x']:.0f} of 201 in x, " in str(warning)


def correlated_throw(seed, law):
    """20 s at 10 Hz with noise of 5 mm and 10 mrad that forgets itself
    within a second."""
    random = np.random.default_rng(seed)
    root = np.linalg.cholesky(np.exp(-np.abs(TIMES[:, None] - TIMES)))
    exact = filmed(law, noise=dict.fromkeys(NOISE, 0.0), omega=1.3 * (-1) ** seed)
    series = {
        name: getattr(exact, name) + sigma * root @ random.standard_normal(len(TIMES))
        for name, sigma in NOISE.items()
    }
    return replace(exact, **series)


def test_correlated_noise_does_not_reject_the_true_law():
    """As it would, were rows counted as if they were independent (dBIC > 6)."""
    law = LAWS["coulomb"]()
    rejected = 0
    for seed in range(5):
        comparison = compare(correlated_throw(seed, law), RIVALS)
        text = " ".join(conclusions(comparison))
        assert comparison.of("coulomb").follows is not False
        assert "No law follows" not in text
        assert "No isotropic law" not in text
        codes = {warning.code for warning in document(comparison).warnings}
        assert "ranking-not-reliable" in codes
        rejected += comparison.of("coulomb").delta_bic > 6
    assert rejected <= 1


def test_correlated_noise_does_not_hide_the_true_law():
    comparison = compare(correlated_throw(1, LAWS["front-back"]()), RIVALS)
    assert comparison.best.law == "front-back"
    assert comparison.of("coulomb").follows is False
    assert comparison.of("coulomb").delta_bic > 20


def test_given_noise_is_not_counted_and_not_estimated(eq12, clean):
    free = compare(clean, ["front-back"])
    assert free.effective == {}  # independent rows count in full
    best = free.best
    n = free.fits[0].n_observations
    expected = best.n_parameters * np.log(n) - 2 * best.log_likelihood
    assert best.bic == pytest.approx(expected, rel=1e-12)
    assert not document(free).warnings
    throw = eq12.with_sigma({"x": 0.01, "y": 0.02, "phi": 0.01})
    comparison = compare(throw, ["front-back"])
    best = comparison.best
    result = comparison.fits[0]
    assert best.n_parameters == pytest.approx(9, abs=1e-3)
    expected = 0.0
    for name, sigma in (("x", 0.01), ("y", 0.02), ("phi", 0.01)):
        r = (result.observed[name] - result.fitted[name]) / sigma
        expected += -0.5 * (r**2).sum() - len(r) * np.log(sigma * np.sqrt(2 * np.pi))
    assert best.log_likelihood == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_true_law_is_found_among_all():
    law = "semi-empirical"
    throw = curlfit.synthetic_throw(
        LAWS[law](),
        curlfit.Stone(),
        v0=2.1,
        omega0=-1.5,
        heading=0.02,
        noise_xy=0.005,
        noise_phi=0.01,
        seed=1,
    )
    comparison = compare(throw, MANY)
    candidate = comparison.of(law)
    assert candidate.follows
    assert candidate.delta_bic < 2
    result = comparison.fits[comparison.candidates.index(candidate)]
    truth = throw.reference.values
    for name, estimate in result.coefficients.items():
        if estimate.stderr is not None:
            assert abs(estimate.value - truth[name]) < 4 * estimate.stderr, name


@pytest.fixture(scope="module")
def clean():
    return curlfit.synthetic_throw(
        LAWS["front-back"](),
        curlfit.Stone(),
        v0=2.1,
        omega0=-1.3,
        heading=0.02,
        noise_xy=0.005,
        noise_phi=0.01,
        seed=3,
    )


@pytest.fixture(scope="module")
def spoiled(clean):
    """A throw without outliers, with 5 % gross ones in each channel."""
    random = np.random.default_rng(1)
    channels = {}
    for name, size in (("x", 0.3), ("y", 1.0), ("phi", 2.0)):
        channels[name] = getattr(clean, name).copy()
        rows = random.choice(len(clean), len(clean) // 20, replace=False)
        channels[name][rows] += size * np.sign(random.standard_normal(len(rows)))
    return replace(clean, **channels)


@pytest.mark.slow
def test_outliers_change_neither_the_first_law_nor_its_coefficients(clean, spoiled):
    before = compare(clean, RIVALS, loss="student")
    after = compare(spoiled, RIVALS, loss="student")
    for comparison in (before, after):
        assert comparison.best.law == "front-back"
        assert comparison.best.rank == 1
        assert comparison.side == "right"
        assert comparison.best.follows
        assert not comparison.of("coulomb").follows
        # "strong", Kass and Raftery (1995)
        assert comparison.of("coulomb").delta_bic > 6
    for name, estimate in before.best.coefficients.items():
        if estimate["stderr"] is not None:
            change = after.best.coefficients[name]["value"] - estimate["value"]
            assert abs(change) < estimate["stderr"], name
    assert after.best.residual_size["x"] == pytest.approx(0.005, rel=0.25)
    assert after.best.rms["x"] > 5 * 0.005
    assert "robust scale" in _text(after)
    total = 0.0  # criteria are those of the density of the loss
    for name in ("x", "y", "phi"):
        residual = getattr(clean, name) - before.fits[0].fitted[name]
        total += t.logpdf(residual, 4, scale=t.fit(residual, fdf=4, floc=0)[2]).sum()
    assert before.best.log_likelihood == pytest.approx(total, abs=1e-3)


def _text(found):
    console = Console(width=110, file=StringIO())
    print_comparison(found, console)
    return console.file.getvalue()


def test_saved_comparison_reads_back_the_same(of_eq12, tmp_path):
    of_eq12.save(tmp_path / "compare.json")
    words = _text(of_eq12)
    assert "loss" not in words
    assert "rms of the residuals" in words
    again = load_comparison(tmp_path)
    assert again.to_json() == of_eq12.to_json()
    record = json.loads((tmp_path / "compare.json").read_text())
    assert [candidate["rank"] for candidate in record["candidates"]][:3] == [1, 2, 3]
    assert curlfit.comparison_figure(again).axes
