"""Noise that is correlated from row to row: whitening, its estimate, the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA
from conftest import command as curlfit_command
from scipy.linalg import toeplitz

import curlfit
from curlfit.inference.fit.result import load_fit
from curlfit.inference.noise.correlated import whitened, whitener_of
from curlfit.inference.noise.estimation import Sums
from curlfit.inference.noise.models import Noise, independences

T = np.arange(0.0, 15.05, 0.1)
SIGMA = {"x": 0.005, "y": 0.005, "phi": 0.01}
TRUE = {"mu1_xi": 0.005, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}
START = {"v0": 2.1, "omega0": 1.3}


def thrown(seed, correlation=0.0, law="front-back", true=TRUE):
    """A throw with noise whose neighbours are correlated."""
    start = curlfit.InitialState(v=START["v0"], omega=START["omega0"])
    path = curlfit.simulate(curlfit.law_with(law, true), curlfit.Stone(), start, T).to_numpy()
    random = np.random.default_rng(seed)
    root = np.linalg.cholesky(toeplitz(correlation ** np.arange(len(T))))
    series = {
        name: getattr(path, name) + sigma * root @ random.standard_normal(len(T))
        for name, sigma in SIGMA.items()
    }
    return curlfit.Throw.from_arrays(T, **series)


def operator(whitener, rows, channel):
    """The matrix that makes a channel of three independent."""
    found = np.zeros((rows, rows))
    for place in range(rows):
        unit = np.zeros((3, rows))
        unit[channel, place] = 1.0
        found[:, place] = np.asarray(whitened(unit, whitener))[channel]
    return found


def test_ar1_noise_is_made_independent_across_gaps():
    weight = np.ones((3, 60))
    weight[1, 20:35] = 0.0
    times = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.3, 60))
    whitener = whitener_of(Noise("ar1", memory={"x": 0.4, "y": 1.5}), times, weight)
    for channel, memory in ((0, 0.4), (1, 1.5)):
        w = operator(whitener, 60, channel)
        covariance = np.exp(-np.abs(times[:, None] - times) / memory)
        seen = np.flatnonzero(weight[channel])
        made = w @ covariance @ w.T
        np.testing.assert_allclose(made[np.ix_(seen, seen)], np.eye(len(seen)), atol=1e-10)
    np.testing.assert_array_equal(operator(whitener, 60, 2), np.eye(60))


def test_the_likelihood_of_ar1_noise_is_that_of_its_covariance():
    """Sums over neighbours, of uneven rows, against the covariance matrix."""
    random = np.random.default_rng(3)
    t = np.cumsum(random.choice([0.1, 0.2, 0.35], 80))
    columns = np.column_stack([np.ones(80), t, random.standard_normal(80)])
    sums = Sums.of(columns, t)
    np.testing.assert_allclose(sums.first + sums.later.sum(0), columns.T @ columns, rtol=1e-10)
    for memory in (0.05, 0.6, 30.0):
        covariance = np.exp(-np.abs(t[:, None] - t) / memory)
        made, half = sums.ar1(memory)
        expected = columns.T @ np.linalg.solve(covariance, columns)
        np.testing.assert_allclose(made, expected, rtol=1e-7, atol=1e-7)
        assert half == pytest.approx(np.linalg.slogdet(covariance)[1] / 2, rel=1e-8)


def test_many_rows_have_the_noise_that_they_have():
    """Of 2,001 rows white noise is found to be white, and a short memory as it is."""
    t = np.linspace(0.0, 20.0, 2001)
    start = curlfit.InitialState(v=START["v0"], omega=START["omega0"])
    path = curlfit.simulate(curlfit.LAWS["coulomb"](), curlfit.Stone(), start, t).to_numpy()
    noise = np.random.default_rng(1).standard_normal((3, len(t)))
    for memory in (0.0, 0.05):
        carry = np.exp(-0.01 / memory) if memory else 0.0
        for row in range(1, len(t)):
            noise[:, row] = carry * noise[:, row - 1] + np.sqrt(1 - carry**2) * noise[:, row]
        found = curlfit.fit(
            curlfit.Throw.from_arrays(
                t, path.x + 0.005 * noise[0], path.y + 0.005 * noise[1], path.phi + 0.01 * noise[2]
            ), "coulomb", noise="ar1",
        )  # fmt: skip
        for name, sigma in SIGMA.items():
            assert found.sigma[name] == pytest.approx(sigma, rel=0.08)
            if memory:
                assert found.noise.memory[name] == pytest.approx(memory, rel=0.25)
            else:
                assert found.noise.memory[name] < 0.005


def independence(series):
    """Of one channel of one throw."""
    return independences(series[None, None], np.array([[len(series)]]))[0][0]


def test_independence_by_hand():
    signs = np.array([1.0, 1, 1, -1, -1, 1, -1, -1, -1, 1])  # 5 of each, 5 runs
    found = independence(signs)
    assert found.runs == pytest.approx((5 - 6) / np.sqrt(5 * 4 / 9))
    assert found.lag1 == pytest.approx(0.1)  # five neighbours agree, four do not
    assert found.effective == pytest.approx(10 * 0.9 / 1.1)
    assert not found.doubtful
    white = [independence(np.random.default_rng(k).standard_normal(150)) for k in range(400)]
    assert not any(item.doubtful for item in white)
    assert np.std([item.runs for item in white]) == pytest.approx(1, abs=0.1)
    walk = np.cumsum(np.random.default_rng(0).standard_normal(150))
    assert independence(walk).doubtful
    assert independence(walk).effective < 10


def test_white_noise_is_told_from_noise_with_a_memory():
    white = curlfit.fit(thrown(3), "front-back")
    assert not any("row to row" in text or "smooth" in text for text in white.warnings)
    other = curlfit.fit(thrown(3), "front-back", noise="ar1")
    for name in ("mu1_xi", "mu2_xi", "v0"):
        one, two = white.parameters[name], other.parameters[name]
        assert two.stderr == pytest.approx(one.stderr, rel=0.25)
        assert abs(two.value - one.value) < one.stderr
    told = curlfit.fit(thrown(3, 0.9), "front-back")
    assert any("fit with --noise" in text and "too small" in text for text in told.warnings)
    assert told.independence["y"].effective < 40


def test_the_memory_of_the_noise_is_found():
    lasting, sizes = [], []
    for seed in range(6):
        found = curlfit.fit(thrown(seed, 0.8), "front-back", noise="ar1")
        lasting += [found.noise.memory[name] for name in SIGMA]
        sizes += [found.sigma[name] / SIGMA[name] for name in SIGMA]
        assert not any("correlated" in text for text in found.warnings)
        assert max(abs(item.lag1) for item in found.independence.values()) < 0.35
    assert np.exp(np.mean(np.log(lasting))) == pytest.approx(-0.1 / np.log(0.8), rel=0.25)
    assert np.mean(sizes) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize(
    ("kind", "correlation", "truth", "law"),
    [
        ("ar1", 0.9, ("front-back", TRUE), "front-back"),
        ("discrepancy", 0.0, ("power", {"c": 0.008, "k": -0.4}), "coulomb"),
        ("ar1+discrepancy", 0.7, ("power", {"c": 0.008, "k": -0.4}), "coulomb"),
    ],
)
def test_errors_are_what_repetition_shows(kind, correlation, truth, law):
    # white errors are off by far more, which is what the models are for
    off = {"white": [], kind: []}
    for seed in range(12):
        throw = thrown(seed, correlation, *truth)
        for noise, found in off.items():
            fit = curlfit.fit(throw, law, noise=noise)
            found += [
                (fit.parameters[name].value - START.get(name, 0.0)) / fit.parameters[name].stderr
                for name in ("x0", "heading", "v0", "omega0")
            ]
    size = {noise: float(np.sqrt(np.mean(np.square(found)))) for noise, found in off.items()}
    assert size["white"] > 2.5
    assert 0.4 < size[kind] < 1.6


def test_given_sigmas_are_kept():
    given = thrown(1, 0.8).with_sigma(SIGMA)
    found = curlfit.fit(given, "front-back", noise="ar1")
    assert found.sigma == {}
    assert all(0.1 < value < 2 for value in found.noise.memory.values())
    both = curlfit.fit(given, "front-back", noise="ar1+discrepancy")
    assert both.sigma == {}
    assert both.noise.memory["y"] == pytest.approx(-0.1 / np.log(0.8), rel=0.5)


def test_it_is_saved_and_sampled(tmp_path):
    found = curlfit.fit(thrown(2, 0.9), "front-back", noise="ar1")
    found.save(tmp_path / "fit.json")
    again = load_fit(tmp_path / "fit.json")
    assert again.noise == found.noise
    assert again.independence == found.independence
    sampled, _ = curlfit.sample(again, seed=1, effective=1000)
    white = curlfit.fit(thrown(2, 0.9), "front-back")
    for name in ("mu2_xi", "v0", "omega0"):
        item = found.parameters[name]
        assert sampled.posterior.sd[name] == pytest.approx(item.stderr, rel=0.1)
        assert item.stderr > 2 * white.parameters[name].stderr


def test_what_cannot_be_combined_is_refused():
    throw = thrown(0)
    for choices, words in (
        ({"noise": "pink"}, "unknown noise 'pink'; expected one of white, ar1, discrepancy"),
        ({"noise": "discrepancy", "loss": "huber"}, "cannot be combined"),
    ):
        with pytest.raises(curlfit.InputError, match=words):
            curlfit.fit(throw, **choices)
    few = replace(throw, notes=()).select_rows(until=1.0).with_sigma(SIGMA)
    with pytest.raises(curlfit.InputError, match="too few values to estimate"):
        curlfit.fit(few, "coulomb", noise="discrepancy")


def test_on_the_command_line(tmp_path):
    run = curlfit_command(
        "fit", DATA, "--noise", "discrepancy", "--no-sample", "--out", "f", cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    assert "discrepancy noise" in run.stdout
    shown = curlfit_command("show", "f", cwd=tmp_path)
    assert "discrepancy noise" in shown.stdout
    # the discrepancy is no longer taken for noise that averages out
    white = curlfit.fit(curlfit.load_throw(DATA)).combinations[0].stderr
    assert load_fit(tmp_path / "f").combinations[0].stderr > 2 * white
