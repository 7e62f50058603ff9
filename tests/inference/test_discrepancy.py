"""Missing accelerations as noise: what they do to a path, and errors under a wrong law."""

from __future__ import annotations

import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InitialState, Stone, Throw, simulate
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.noise import accelerations
from curlfit.inference.noise.accelerations import Responses
from curlfit.throws.throw import CHANNELS

STONE = Stone()
TIMES = np.linspace(0.0, 20.0, 201)


def path_of(law, start):
    path = simulate(law, STONE, start, TIMES).to_numpy()
    return np.array([path.x, path.y, path.phi, path.speed, path.omega], dtype=float)


@pytest.mark.parametrize(
    ("component", "name", "sign"),
    # a constant acceleration across the velocity, along it, and of the spin
    [("across", "a", -1.0), ("along", "c", -1.0), ("angular", "q", -1.0)],
)
def test_responses_are_the_derivatives_of_the_path(component, name, sign):
    values = {"a": 0.006, "c": 0.088, "p": 0.0, "q": 0.02, "r": 0.0}
    start, step = InitialState(v=2.1, omega=1.4, heading=0.2), 1e-4
    law = LAWS["semi-empirical"]
    path = path_of(law(**values), start)
    up, down = (path_of(law(**values | {name: values[name] + d}), start) for d in (step, -step))
    expected = sign * (up - down) / (2 * step)
    found = Responses.of(TIMES, path, STONE)
    # a constant, by the shapes
    shapes = accelerations._shapes()
    constant = np.linalg.lstsq(shapes.T, np.ones(shapes.shape[1]), rcond=None)[0]
    along = np.zeros((3, accelerations.SHAPES))
    row = accelerations.COMPONENTS.index(component)
    along[row] = constant
    ratio = np.mean(np.minimum(STONE.R * np.abs(path[4]) / np.maximum(path[3], 1e-9), 1.0))
    size = found.friction * 9.81 * (STONE.R / STONE.rho**2 * ratio if component == "angular" else 1)
    for channel in range(len(CHANNELS)):
        response = found.at(TIMES, channel) @ along.ravel() / size
        scale = np.abs(expected[channel]).max()
        if scale > 1e-3 * np.abs(expected).max():
            tolerance = 0.03 * scale  # of the shapes that are left out, and differences in time
            np.testing.assert_allclose(response, expected[channel], atol=tolerance)


def thrown(law, count, noise=0.005):
    random = np.random.default_rng(11)
    found = []
    for index in range(count):
        start = InitialState(
            v=random.uniform(1.9, 2.2), omega=(-1) ** index * random.uniform(0.6, 2.0)
        )
        path = path_of(law, start)[:3]
        series = path + noise * np.array([[1], [1], [2]]) * random.standard_normal(path.shape)
        found.append((start, Throw.from_arrays(TIMES, *series)))
    return found


def pulls_of(thrown, law, noise):
    fits = fit_throws([throw for _, throw in thrown], law, noise=noise)
    return np.array(
        [
            [
                (fit.parameters[name].value - true) / fit.parameters[name].stderr
                for name, true in (("v0", start.v), ("omega0", start.omega))
            ]
            for (start, _), fit in zip(thrown, fits, strict=True)
        ]
    )


def test_errors_hold_the_truth_under_a_wrong_law():
    throws = thrown(LAWS["stribeck"](), 24)
    white = pulls_of(throws, "coulomb", "white")
    assert np.sqrt((white**2).mean(0)).min() > 10
    own = np.sqrt((pulls_of(throws, "coulomb", "discrepancy") ** 2).mean(0))
    # 24 values each: chi squared within 0.1 %, and some room for a discrepancy that recurs
    assert (own < 2.0).all()
    assert (own > 0.4).all()


def test_under_the_right_law_errors_are_those_of_noise_and_somewhat_larger():
    (_, throw), *_ = thrown(LAWS["coulomb"](), 1)
    white, own = (curlfit.fit(throw, "coulomb", noise=kind) for kind in ("white", "discrepancy"))
    for name, item in white.parameters.items():
        ratio = own.parameters[name].stderr / item.stderr
        assert 0.9 < ratio < (40 if name == "mu" else 12)
        assert abs(own.parameters[name].value - item.value) < 4 * own.parameters[name].stderr
    assert set(own.noise.sizes) == set(accelerations.COMPONENTS)
    assert max(own.noise.sizes.values()) < 0.1
    assert own.sigma["x"] == pytest.approx(0.005, rel=0.2)


def test_its_whitening_is_the_inverse_root_of_its_covariance():
    (_, throw), *_ = thrown(LAWS["stribeck"](), 1)
    fit = curlfit.fit(throw, "coulomb", noise="discrepancy")
    problem, _ = problem_of(fit)
    n, weight = len(TIMES), np.asarray(problem.weight)
    responses = Responses.of(TIMES, np.array([fit.fitted[name] for name in CHANNELS]), fit.stone)
    sizes = np.repeat([fit.noise.sizes[name] for name in accelerations.COMPONENTS],
                      accelerations.SHAPES)  # fmt: skip
    rows = np.concatenate([weight[c, :n, None] * responses.at(TIMES, c) * sizes for c in range(3)])
    covariance = np.eye(3 * n) + rows @ rows.T
    residual = np.random.default_rng(0).standard_normal((3, weight.shape[1]))
    residual[:, n:] = 0.0
    white = np.asarray(problem.whitener.whiten(residual))[:, :n].ravel()
    own = residual[:, :n].ravel()
    assert white @ white == pytest.approx(own @ np.linalg.solve(covariance, own), rel=1e-8)
    determinant = -0.5 * np.linalg.slogdet(covariance)[1]
    assert problem.whitener.log_determinant().sum() == pytest.approx(determinant, rel=1e-8)


def test_a_mirrored_throw_has_the_same_discrepancy():
    (_, throw), *_ = thrown(LAWS["stribeck"](), 1)
    mirrored = Throw.from_arrays(TIMES, -throw.x, throw.y, -throw.phi)
    one, other = (curlfit.fit(item, "coulomb", noise="discrepancy") for item in (throw, mirrored))
    assert other.noise.sizes == pytest.approx(one.noise.sizes, rel=1e-3)
    item = one.parameters["mu"]
    assert other.parameters["mu"].value == pytest.approx(item.value, abs=1e-3 * item.stderr)
    assert other.parameters["mu"].stderr == pytest.approx(item.stderr, rel=1e-3)
