"""One throw gets one answer, whichever verb asks and whatever it is fitted beside."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import NOISE, TIMES, filmed

import curlfit
from curlfit import LAWS, Stone
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.model.likelihood import linearize, predict_channels
from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import build_problem
from curlfit.numerics.batches import BATCH, stacked


@pytest.fixture(scope="module")
def throws():
    """Throws of 60 rows, an outlier in the first, correlated noise in both."""
    noisy_throws = []
    for seed in range(2):
        random = np.random.default_rng(seed)
        start = {"v": 1.9 + 0.1 * seed, "omega": (-1) ** seed * 1.5, "heading": 0.02}
        path = filmed(noise=dict.fromkeys(NOISE, 0), **start).observed[:3, :180:3]
        noise = np.zeros((3, 60))
        for row in range(60):
            noise[:, row] = 0.7 * noise[:, row - 1] + random.standard_normal(3)
        path = path + noise * [[0.004], [0.004], [0.008]]
        path[0, 30] += 0.3 * (seed == 0)
        noisy_throws.append(
            curlfit.Throw.from_arrays(TIMES[:180:3], *path, name=f"{seed}")
        )
    return noisy_throws


BOUNDED = {
    "fix": {"mu1_eta": 0.009},
    "bounds": {"mu2_xi": (0.0, 0.045)},
    "unbounded": True,
    "start": {"mu1_xi": 0.02, "v0": 2.0},
}


@pytest.mark.parametrize(
    "choices",
    [
        BOUNDED,
        pytest.param({"loss": "student"}, marks=pytest.mark.slow),
        pytest.param({"noise": "ar1+discrepancy"}, marks=pytest.mark.slow),
        pytest.param({"priors": {"mu1_eta": "0.008+-0.001"}}, marks=pytest.mark.slow),
    ],
)
def test_a_batch_has_the_answers_of_single_fits(throws, choices):
    for throw, many in zip(throws, fit_throws(throws, **choices), strict=True):
        alone = curlfit.fit(throw, **choices)
        assert many.converged
        assert alone.converged
        assert many.noise.kind == alone.noise.kind
        for name, estimate in alone.parameters.items():
            in_batch = many.parameters[name]
            assert (in_batch.verdict, in_batch.prior) == (
                estimate.verdict,
                estimate.prior,
            )
            if estimate.stderr is not None:
                assert in_batch.value == pytest.approx(
                    estimate.value, abs=1e-3 * estimate.stderr
                )
                assert in_batch.stderr == pytest.approx(estimate.stderr, rel=1e-3)


@pytest.mark.slow
def test_paths_side_by_side_are_those_of_single_throws():
    """With vectors of 512 bits XLA compiles this law wrongly, for a whole
    batch at a time."""
    law = LAWS["debris"]
    start = curlfit.InitialState(v=2.1, omega=-2.6)
    stone = Stone()
    t = np.arange(60) * 0.25
    path = curlfit.simulate(law(), stone, start, t).to_numpy()
    throw = curlfit.Throw.from_arrays(t, path.x, path.y, path.phi)
    problem = build_problem(throw, stone, dict.fromkeys(("x", "y", "phi"), 1.0))
    defaults = [coefficient.default for coefficient in law.coefficients()]
    values = np.array([*defaults, 0.0, 0.0, 0.0, 2.1, 0.0, -2.6])
    residual, _ = linearize(
        Model(law, "uniform"), np.tile(values, (BATCH, 1)), stacked([problem] * BATCH)
    )
    single = np.asarray(predict_channels(Model(law, "uniform"), values, problem))[:3]
    expected = np.where(problem.weight > 0, single - problem.observed, 0.0)
    np.testing.assert_allclose(residual, np.tile(expected, (BATCH, 1, 1)), atol=1e-10)
