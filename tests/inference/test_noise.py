"""Noise that is correlated from row to row: whitening, its estimate, the errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA, NOISE as SIGMA, codes_of, filmed, finding_of, shown
from scipy.linalg import block_diag, toeplitz

import curlfit
from curlfit.errors import Option
from curlfit.inference.noise.accelerations import SHAPES
from curlfit.inference.noise.independence import Independence
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.restricted import _slope
from curlfit.inference.noise.whitening import Whitener, filter_of, whitened
from curlfit.noises import NOISES, Ar1
from curlfit.settings.choices import Comparing, Modelling

TRUE = {"mu1_xi": 0.005, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}
START = {"v0": 2.1, "omega0": 1.3}


T = np.arange(0.0, 15.05, 0.1)


def thrown(seed, correlation=0.0, law="front-back", true=TRUE, times=T):
    """A throw with noise whose neighbours are correlated."""
    path = filmed(
        curlfit.law_with(law, true),
        noise=dict.fromkeys(SIGMA, 0),
        times=times,
        v=START["v0"],
        omega=START["omega0"],
    )
    random = np.random.default_rng(seed)
    root = np.linalg.cholesky(toeplitz(correlation ** np.arange(len(times))))
    series = {
        name: getattr(path, name) + sigma * root @ random.standard_normal(len(times))
        for name, sigma in SIGMA.items()
    }
    return curlfit.Throw.from_arrays(times, **series)


def operator(whitener, rows, channel):
    """The matrix that makes a channel of three independent."""
    matrix = np.zeros((rows, rows))
    for row in range(rows):
        unit = np.zeros((3, rows))
        unit[channel, row] = 1.0
        matrix[:, row] = np.asarray(whitened(unit, whitener))[channel]
    return matrix


def ornstein_uhlenbeck(times, memory, white):
    """Covariance of noise of variance 1 with an independent share."""
    correlated = np.exp(-np.abs(times[:, None] - times) / memory)
    return (1 - white) * correlated + white * np.eye(len(times))


def test_correlated_noise_is_made_independent_across_gaps():
    weight = np.ones((3, 60))
    weight[1, 20:35] = 0.0
    times = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.3, 60))
    noise = Ar1(memory={"x": 0.4, "y": 1.5}, white={"x": 0.0, "y": 0.3})
    whitener = Whitener.of(noise, times, weight, 0)
    for channel, memory, white in ((0, 0.4, 0.0), (1, 1.5, 0.3)):
        w = operator(whitener, 60, channel)
        rows = np.flatnonzero(weight[channel])
        covariance = ornstein_uhlenbeck(times[rows], memory, white)
        whitened_covariance = (
            w[np.ix_(rows, rows)] @ covariance @ w[np.ix_(rows, rows)].T
        )
        np.testing.assert_allclose(whitened_covariance, np.eye(len(rows)), atol=1e-10)
        determinant = -np.linalg.slogdet(covariance)[1] / 2
        assert whitener.log_determinant()[channel] == pytest.approx(
            determinant, rel=1e-8
        )
    np.testing.assert_array_equal(operator(whitener, 60, 2), np.eye(60))


def test_the_restricted_likelihood_is_that_of_the_covariance():
    """Of uneven rows with gaps, against dense matrices; the amplitudes of a discrepancy
    are those that leave the first two parameters as they are."""
    random = np.random.default_rng(3)
    t = np.cumsum(random.choice([0.1, 0.2, 0.35], 50))
    weight = np.where(random.random((2, 50)) < 0.9, [[3.0], [0.5]], 0.0)
    jacobian = random.standard_normal((2, 50, 4))
    responses = random.standard_normal((2, 50, 3 * SHAPES))
    residual = np.where(weight > 0, random.standard_normal((2, 50)), 0.0)
    data = Linearized.of(
        t, weight, residual, jacobian, np.ones(4), np.ones(4, bool), 2
    )._replace(span=np.asarray(9.0), responses=responses)
    measured = weight.ravel() > 0
    j, s = (part.reshape(100, -1)[measured] for part in (jacobian, responses))
    r = residual.ravel()[measured]
    sigma = 1 / weight.ravel()[measured]

    def expected(logs):
        scale = np.exp(logs[:2])
        share = 1 / (1 + np.exp(-logs[2:4]))
        blocks = [
            ornstein_uhlenbeck(t, np.exp(logs[4]), share[row]) * scale[row] ** 2
            for row in (0, 1)
        ]
        covariance = (
            sigma[:, None] * block_diag(*blocks)[np.ix_(measured, measured)] * sigma
        )
        # of the estimates of least squares, whatever the noise
        change = np.linalg.lstsq(j / sigma[:, None], s / sigma[:, None], rcond=None)[0]
        free = np.repeat(np.exp(2 * logs[5:]), SHAPES)
        held = change[:2] * free
        amplitudes = np.diag(free) - held.T @ np.linalg.solve(held @ change[:2].T, held)
        inverse = np.linalg.inv(covariance + s @ amplitudes @ s.T)
        spent = j.T @ inverse @ j
        left = inverse - inverse @ j @ np.linalg.solve(spent, j.T @ inverse)
        return (
            np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(spent)[1] - r @ left @ r
        ) / 2

    first = np.array([0.1, -0.2, 0.3, -2.0, -1.0, -1.0, -2.0, -3.0])
    second = np.array([0.3, 0.2, -1.0, 2.0, 0.5, -3.0, -1.5, -1.0])
    likelihoods = [
        float(_slope("discrepancy", logs, data)[2]) for logs in (first, second)
    ]
    assert likelihoods[0] - likelihoods[1] == pytest.approx(
        expected(first) - expected(second), rel=1e-6
    )
    _, slope, _ = _slope("discrepancy", first, data)
    for index in range(8):
        step = 1e-5 * (np.arange(8) == index)
        up = float(_slope("discrepancy", first + step, data)[0])
        down = float(_slope("discrepancy", first - step, data)[0])
        assert slope[index] == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-5)


CORRELATED = [noise for noise in NOISES.values() if not noise.is_white]


@pytest.mark.parametrize("noise", CORRELATED, ids=lambda noise: noise.kind)
def test_every_filter_is_that_of_noise_of_variance_1(noise):
    """Whatever the correlations C of the rows: with W C W^T = 1 and W from the filter,
    C is (W^T W)^-1, with ones on its diagonal, and W has the determinant it says."""
    unknowns = noise.search([True, True, False], gap=0.1, span=9.0)
    for unknown in unknowns:
        assert all(unknown.lower <= start <= unknown.upper for start in unknown.starts)
    start = np.array([unknown.starts[0] for unknown in unknowns])
    values = {name: np.asarray(of) for name, of in noise.values(start).items()}
    assert values.keys() == noise.parameters.keys()
    assert np.isfinite(noise.log_prior(start, 9.0))
    by_name = {
        name: dict(zip("xy", of.tolist(), strict=False)) for name, of in values.items()
    }
    estimated = replace(noise, **by_name)
    assert set(estimated.correlated) == {"x", "y"}
    assert estimated.words("x") != estimated.words("phi") == "independent"
    assert 2 <= estimated.number_of_parameters <= 2 * len(noise.parameters)

    random = np.random.default_rng(1)
    times = np.cumsum(random.uniform(0.05, 0.3, 40))
    measured = random.random((3, 40)) < 0.8
    of_noise = filter_of(estimated, times, measured)
    for channel in range(3):
        rows = np.flatnonzero(measured[channel])
        columns = np.zeros((3, 40, 40))
        columns[channel] = np.eye(40)
        whitening = np.asarray(of_noise.innovations(columns))[channel][rows][:, rows]
        correlation = np.linalg.inv(whitening.T @ whitening)
        np.testing.assert_allclose(np.diag(correlation), 1, rtol=1e-9)
        if channel == 2:
            np.testing.assert_allclose(correlation, np.eye(len(rows)), atol=1e-9)
        else:
            assert np.abs(np.diag(correlation, 1)).max() > 0.1
        assert np.asarray(of_noise.log_determinant())[channel] == pytest.approx(
            np.linalg.slogdet(whitening)[1], abs=1e-9
        )


@pytest.mark.parametrize("noise", CORRELATED, ids=lambda noise: noise.kind)
def test_every_noise_is_fitted_said_and_saved(noise, tmp_path):
    fit = curlfit.fit(thrown(3, 0.9), noise=noise.kind, details=False)
    assert fit.converged
    assert fit.noise.correlated
    assert 0.3 < fit.sigma["y"] / SIGMA["y"] < 3
    text = shown(fit, 200)
    assert f"{noise.kind} noise" in text
    assert fit.noise.words("x") in text
    fit.save(tmp_path / "fit.json")
    assert curlfit.load_fit(tmp_path / "fit.json").noise == fit.noise
    assert curlfit.load_fit(tmp_path / "fit.json").noise.kind == noise.kind


def test_every_noise_is_a_choice():
    for name, noise in NOISES.items():
        for choice in (name, noise):
            assert Modelling.of(noise=choice).noise == noise
            assert Comparing.of(noise=[choice, choice]).noise == (noise,)
        assert Modelling.of(noise=name).words()[-1] == f"--noise={name}"
    help_of_fit = Modelling.help("noise")
    for name, noise in NOISES.items():
        assert f"`{name}` {noise.about}" in help_of_fit


@pytest.mark.parametrize(
    "noise", ["ar1", pytest.param("discrepancy", marks=pytest.mark.slow)]
)
def test_a_file_without_noise_is_fitted_as_with_independent_noise(noise):
    """Eq. 12 is a formula: its residuals are smoother than any noise."""
    throw = curlfit.load_throw(DATA)
    white, other = (
        curlfit.fit(throw, noise=kind, details=False) for kind in ("white", noise)
    )
    assert other.converged
    for name, estimate in white.coefficients.items():
        if estimate.verdict == "determined":
            assert other[name].value == pytest.approx(estimate.value, rel=0.1)
    for before, after in zip(white.combinations, other.combinations, strict=True):
        assert after.value == pytest.approx(before.value, rel=0.1)
    for name, size in white.rms.items():
        assert other.rms[name] < 2 * size
        assert other.sigma[name] > size / 2


def test_independence_by_hand():
    signs = np.array([1.0, 1, 1, -1, -1, 1, -1, -1, -1, 1])  # 5 of each, 5 runs
    of_signs = Independence.of(signs)
    assert of_signs.runs == pytest.approx((5 - 6) / np.sqrt(5 * 4 / 9))
    assert of_signs.lag1 == pytest.approx(0.1)  # five neighbours agree, four do not
    assert of_signs.effective == pytest.approx(10 * 0.9 / 1.1)
    assert not of_signs.doubtful
    white = [
        Independence.of(np.random.default_rng(k).standard_normal(150))
        for k in range(400)
    ]
    assert not any(independence.doubtful for independence in white)
    assert np.std([independence.runs for independence in white]) == pytest.approx(
        1, abs=0.1
    )
    walk = np.cumsum(np.random.default_rng(0).standard_normal(150))
    assert Independence.of(walk).doubtful
    assert Independence.of(walk).effective < 10


def test_white_noise_is_told_from_noise_with_a_memory():
    white = curlfit.fit(thrown(3), "front-back")
    assert "correlated" not in codes_of(white)
    other = curlfit.fit(thrown(3), "front-back", noise="ar1")
    for name in ("mu1_xi", "mu2_xi", "v0"):
        of_white = white.parameters[name]
        of_ar1 = other.parameters[name]
        assert of_ar1.stderr == pytest.approx(of_white.stderr, rel=0.25)
        assert abs(of_ar1.value - of_white.value) < of_white.stderr
    with_memory = curlfit.fit(thrown(3, 0.9), "front-back")
    (remedy,) = finding_of(with_memory, "correlated").remedies
    assert remedy.option == Option("noise", "ar1")
    assert "`--noise ar1`, which was tried, leaves independent residuals" in str(remedy)
    assert with_memory.independence["y"].effective < 40


def test_the_memory_of_the_noise_is_found():
    memories = []
    sizes = []
    for seed in range(4):
        fit = curlfit.fit(thrown(seed, 0.8), noise="ar1", details=False)
        memories += [fit.noise.memory[name] for name in SIGMA]
        sizes += [fit.sigma[name] / SIGMA[name] for name in SIGMA]
        assert not {"correlated", "noise-not-described"} & set(codes_of(fit))
        assert (
            max(abs(independence.lag1) for independence in fit.independence.values())
            < 0.35
        )
    assert np.exp(np.mean(np.log(memories))) == pytest.approx(
        -0.1 / np.log(0.8), rel=0.25
    )
    assert np.mean(sizes) == pytest.approx(1, abs=0.15)


def test_given_sigmas_are_kept():
    throw = thrown(1, 0.8).with_sigma(SIGMA)
    fit = curlfit.fit(throw, "front-back", noise="ar1")
    assert fit.sigma == {}
    assert all(0.1 < value < 2 for value in fit.noise.memory.values())


def test_what_cannot_be_combined_is_refused():
    throw = thrown(0)
    for choices, words in (
        ({"noise": "pink"}, "noise = 'pink'; expected one of white, ar1, discrepancy"),
        ({"noise": "discrepancy", "loss": "huber"}, "cannot be combined"),
    ):
        with pytest.raises(curlfit.InputError, match=words):
            curlfit.fit(throw, **choices)
    few = replace(throw, notes=()).select_rows(until=1.0).with_sigma(SIGMA)
    with pytest.raises(curlfit.InputError, match="too few values to estimate"):
        curlfit.fit(few, "coulomb", noise="discrepancy")
