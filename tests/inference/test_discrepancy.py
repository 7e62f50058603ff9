"""Missing accelerations as noise: what they do to a path, and errors under
a wrong law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import TIMES, filmed
from scipy.linalg import block_diag

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.inference.fit.problems import linearized_fit, problem_of
from curlfit.inference.noise import accelerations
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.noise.whitening import whitened
from curlfit.throws.channels import CHANNELS

STONE = Stone()
SERIES = ("x", "y", "phi")


def path_of(law, start):
    path = simulate(law, STONE, start, TIMES).to_numpy()
    return np.array([path.x, path.y, path.phi, path.speed, path.omega], dtype=float)


# a constant acceleration across the velocity, along it, and of the spin,
# against its sense
@pytest.mark.parametrize(
    ("component", "name"), [("across", "a"), ("along", "c"), ("turning", "q")]
)
def test_responses_are_the_derivatives_of_the_path(component, name):
    values = {"a": 0.006, "c": 0.088, "p": 0.0, "q": 0.02, "r": 0.0}
    start = InitialState(v=2.1, omega=1.4, heading=0.2)
    step = 1e-4
    law = LAWS["semi-empirical"]
    path = path_of(law(**values), start)
    up, down = (
        path_of(law(**values | {name: values[name] + d}), start) for d in (step, -step)
    )
    expected = (down - up) / (2 * step)
    responses = Responses.of(TIMES, path, STONE)
    # a constant, by the shapes
    shapes = accelerations.shapes()
    constant = np.linalg.lstsq(shapes.T, np.ones(shapes.shape[1]), rcond=None)[0]
    along = np.zeros((3, accelerations.SHAPES))
    row = accelerations.COMPONENTS.index(component)
    along[row] = constant
    size = responses.size[row]
    for channel in range(len(CHANNELS)):
        response = responses.at(TIMES, channel) @ along.ravel() / size
        scale = np.abs(expected[channel]).max()
        if scale > 1e-3 * np.abs(expected).max():
            # of the shapes that are left out, and differences in time
            tolerance = 0.03 * scale
            np.testing.assert_allclose(response, expected[channel], atol=tolerance)


def test_under_the_right_law_errors_are_those_of_noise_and_somewhat_larger():
    throw = filmed(LAWS["coulomb"](), seed=11)
    white_fit, discrepancy_fit = (
        curlfit.fit(throw, "coulomb", noise=kind) for kind in ("white", "discrepancy")
    )
    for name, estimate in white_fit.parameters.items():
        ratio = discrepancy_fit.parameters[name].stderr / estimate.stderr
        assert 0.9 < ratio < (40 if name == "mu" else 12)
        assert (
            abs(discrepancy_fit.parameters[name].value - estimate.value)
            < 4 * discrepancy_fit.parameters[name].stderr
        )
    assert set(discrepancy_fit.noise.sizes) == set(accelerations.COMPONENTS)
    assert max(discrepancy_fit.noise.sizes.values()) < 0.1
    assert discrepancy_fit.sigma["x"] == pytest.approx(0.005, rel=0.2)


@pytest.fixture(scope="module")
def wrong_law():
    """A fit by a wrong law, with a gap in x."""
    throw = filmed(LAWS["power"](0.008, -0.4), seed=11)
    x = throw.x.copy()
    x[60:80] = np.nan
    return curlfit.fit(replace(throw, x=x), "coulomb", noise="discrepancy")


def dense(fit):
    """Of a fit under discrepancy, for the values that were observed, over sigma:
    covariance, the changes for each amplitude, of standard deviation 1, the
    covariance of the amplitudes, and the changes of all five channels for each
    amplitude, in metres.

    The least-squares estimates, with the weights of independent noise, and what they
    leave are independent of one another.
    """
    data = linearized_fit(fit)
    n = len(TIMES)
    blocks = []
    for name in ("x", "y", "phi"):
        memory = max(fit.noise.memory[name], 1e-9)
        white = fit.noise.white[name]
        correlated = np.exp(-np.abs(TIMES[:, None] - TIMES) / memory)
        blocks.append((1 - white) * correlated + white * np.eye(n))
    before = data.weight[:3, :n].ravel()
    observed = before > 0
    before = before[observed]
    factor = np.repeat(
        [fit.sigma[name] / fit.noise.independent[name] for name in SERIES], n
    )[observed]
    weight = before / factor
    noise = block_diag(*blocks)[observed][:, observed]
    jacobian, responses = (
        part[:3, :n].reshape(3 * n, -1)[observed]
        for part in (data.jacobian, data.responses)
    )
    j = weight[:, None] * jacobian
    s = weight[:, None] * responses
    estimate = (before * factor)[:, None] * jacobian
    change = estimate.T @ s
    of_law = (data.from_standard @ change)[: len(fit.coefficients)]
    free = np.repeat(np.square(list(fit.noise.sizes.values())), accelerations.SHAPES)
    amplitudes = np.diag(free) - (free * of_law).T @ np.linalg.solve(
        (of_law * free) @ of_law.T, of_law * free
    )
    left = np.eye(len(j)) - j @ estimate.T
    state = data.to_standard[:, -6:]
    of_estimates = estimate.T @ noise @ estimate
    of_estimates += state @ np.array(fit.noise.initial_state) @ state.T
    covariance = j @ of_estimates @ j.T + left @ (noise + s @ amplitudes @ s.T) @ left.T
    paid = data.responses[:, :n] - data.jacobian[:, :n] @ change
    return covariance, left @ s, amplitudes, paid


def test_its_whitening_is_the_inverse_root_of_its_covariance(wrong_law):
    fit = wrong_law
    problem = problem_of(fit)
    covariance, *_ = dense(fit)
    n = len(TIMES)
    weight = np.asarray(problem.weight)
    residual = np.random.default_rng(0).standard_normal(weight.shape)
    residual[weight == 0] = 0.0
    white = np.asarray(whitened(residual, problem.whitener))[:, :n].ravel()
    observed = residual[:, :n][weight[:, :n] > 0]
    assert white @ white == pytest.approx(
        observed @ np.linalg.solve(covariance, observed), rel=1e-6
    )
    determinant = -0.5 * np.linalg.slogdet(covariance)[1]
    assert problem.whitener.log_determinant().sum() == pytest.approx(
        determinant, rel=1e-6
    )


def test_the_recorded_discrepancy_is_its_mean_given_the_residuals(wrong_law, tmp_path):
    """K (K + N)^-1 r with dense matrices, in metres; at rows in the gap and channels
    that were not measured by the covariances with those that were."""
    fit = wrong_law
    covariance, lacking, amplitudes, paid = dense(fit)
    residual = np.concatenate(
        [fit.residuals[name] / fit.sigma[name] for name in SERIES]
    )
    gain = np.linalg.solve(covariance, residual[np.isfinite(residual)])
    expected = paid @ (amplitudes @ lacking.T @ gain)
    for name, mean in zip(CHANNELS, expected, strict=True):
        scale = np.abs(mean).max()
        np.testing.assert_allclose(fit.discrepancy[name], mean, atol=1e-4 * scale)
        np.testing.assert_array_equal(
            fit.predicted[name], fit.fitted[name] + fit.discrepancy[name]
        )
    # the law alone is far off along the path, both together are as near as the noise
    left = fit.observed["y"] - fit.predicted["y"]
    assert np.std(fit.residuals["y"]) > 3 * np.std(left)
    assert np.std(left) == pytest.approx(0.005, rel=0.3)

    fit.save(tmp_path / "fit.json")
    again = curlfit.load_fit(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.discrepancy["omega"], fit.discrepancy["omega"])
    assert "discrepancy" not in again.summary()


def test_the_law_is_fitted_as_without_a_discrepancy(wrong_law):
    """Its coefficients and its path are those nearest to the data; the initial state
    has the error that a discrepancy may hide in it."""
    white = curlfit.fit(wrong_law.throw, "coulomb", details=False)
    mu = wrong_law["mu"]
    other = white["mu"]
    assert mu.value == pytest.approx(other.value, rel=1e-4)
    for name, size in white.rms.items():
        assert wrong_law.rms[name] == pytest.approx(size, rel=0.01)
    assert wrong_law["v0"].stderr > 5 * white["v0"].stderr
