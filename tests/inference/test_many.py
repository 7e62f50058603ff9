"""One throw gets one answer, whichever verb asks and whatever it is fitted beside."""

from __future__ import annotations

import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InputError, Stone
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.least_squares import Solution
from curlfit.inference.likelihood import linearize, predict_channels
from curlfit.inference.model import Model
from curlfit.inference.problem import Origin, build_problem
from curlfit.numerics.batches import BATCH, stacked
from curlfit.settings.choices import Modelling

LAW = LAWS["front-back"](mu1_xi=0.005, mu2_xi=0.05, mu1_eta=0.009, mu2_eta=0.009)


@pytest.fixture(scope="module")
def throws():
    """Four throws of 60 rows, an outlier in the first, correlated noise in all."""
    found = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        start = curlfit.InitialState(v=1.9 + 0.1 * seed, omega=(-1) ** seed * 1.5, heading=0.02)
        t = np.arange(60) * 0.25
        path = curlfit.simulate(LAW, Stone(), start, t).to_numpy()
        noise = np.zeros((3, 60))
        for row in range(60):
            noise[:, row] = 0.7 * noise[:, row - 1] + random.standard_normal(3)
        series = np.stack([path.x, path.y, path.phi]) + noise * [[0.004], [0.004], [0.008]]
        series[0, 30] += 0.3 * (seed == 0)
        found.append(curlfit.Throw.from_arrays(t, *series, name=f"{seed}"))
    return found


CHOICES = {
    "robust": {"loss": "student"},
    "ar1": {"noise": "ar1"},
    "ar1+discrepancy": {"noise": "ar1+discrepancy"},
    "fixed": {"fix": {"mu1_eta": 0.009}, "bounds": {"mu2_xi": (0.0, 0.045)}, "unbounded": True},
    "started": {"start": {"mu1_xi": 0.02, "v0": 2.0}},
}


@pytest.mark.parametrize("choices", CHOICES.values(), ids=CHOICES)
def test_a_batch_has_the_answers_of_single_fits(throws, choices):
    # two suffice where a fit takes seconds
    throws = throws[:2] if "discrepancy" in choices.get("noise", "") else throws
    for throw, many in zip(throws, fit_throws(throws, **choices), strict=True):
        alone = curlfit.fit(throw, **choices)
        assert many.converged
        assert alone.converged
        assert many.noise.kind == alone.noise.kind
        for name, item in alone.parameters.items():
            other = many.parameters[name]
            assert other.verdict == item.verdict
            if item.stderr is not None:
                assert other.value == pytest.approx(item.value, abs=1e-3 * item.stderr)
                assert other.stderr == pytest.approx(item.stderr, rel=1e-3)


def test_throws_at_different_rounds_go_through_one_each(throws):
    law = LAWS["front-back"]
    rounds = Rounds(
        Model(law, "uniform"),
        [PreparedThrow.of(throw, Modelling.of(law=law)) for throw in throws],
        noise="ar1",
    )
    called = []
    rounds._rounds = [
        lambda now, _, number=number: called.append((number, now.tolist())) for number in range(3)
    ]
    rounds._next = np.array([0, 1, 0, 3])
    again = rounds.revise(np.arange(4), Solution(*np.zeros((6, 4, 1))))
    assert again.tolist() == [0, 1, 2]
    assert called == [(0, [0, 2]), (1, [1])]
    assert rounds._next.tolist() == [1, 2, 1, 3]


def test_throws_that_share_nothing_are_fitted_together_as_alone(throws):
    """With every coefficient known, a joint fit is a fit of each throw by itself."""
    values = {item.name: getattr(LAW, item.name) for item in LAW.coefficients()}
    del values["mu1_xi"]
    for choices in ({"noise": "ar1"}, {"loss": "student"}, {"start": {"v0": 2.0}}):
        joint = curlfit.fit_together(throws[:2], fix=values, share=["mu2_xi"], **choices)
        assert joint.converged
        for throw, one in zip(throws, joint.throws, strict=False):
            alone = curlfit.fit(throw, fix=values, **choices)
            for name in ("mu1_xi", "v0", "omega0"):
                item = alone.parameters[name]
                found = one.parameters[name]
                assert found.value == pytest.approx(item.value, abs=1e-3 * item.stderr)


def test_what_cannot_be_is_refused_for_all_at_once(throws):
    with pytest.raises(InputError, match="cannot be combined"):
        fit_throws(throws, loss="student", noise="ar1")
    with pytest.raises(InputError, match="no parameter 'nonsense'"):
        fit_throws(throws, start={"nonsense": 1.0})
    with pytest.raises(InputError, match="nonsense"):
        curlfit.compare(throws[0], ["coulomb"], fix={"nonsense": 1.0})


def test_a_comparison_accounts_for_noise_and_fixed_parameters(throws):
    """The noise model is worth its parameters where the noise is as it says."""
    white, ar1 = (
        curlfit.compare(throws[1], ["front-back", "coulomb"], noise=noise, fix={"mu1_eta": 0.009})
        for noise in ("white", "ar1")
    )
    assert white.best.law == ar1.best.law == "front-back"
    assert ar1.noise == "ar1"
    assert ar1.best.coefficients["mu1_eta"]["verdict"] == "fixed"
    assert ar1.best.n_parameters == pytest.approx(white.best.n_parameters + 4, abs=1e-3)
    assert ar1.best.log_likelihood > white.best.log_likelihood + 10


def test_log_likelihood_of_correlated_noise_is_that_of_its_covariance(throws):
    from curlfit.comparison.criteria import log_likelihood

    fit = curlfit.fit(throws[1], noise="ar1")
    t = fit.observed["t"] - fit.observed["t"][0]
    for name, found in log_likelihood(fit).items():
        residual = fit.observed[name] - fit.fitted[name]
        white = fit.noise.white[name]
        covariance = (1 - white) * np.exp(-np.abs(t[:, None] - t) / fit.noise.memory[name])
        covariance += white * np.eye(len(t))
        # the most likely scale, and the density of the normal distribution there
        square = residual @ np.linalg.solve(covariance, residual) / len(t)
        _, determinant = np.linalg.slogdet(2 * np.pi * square * covariance)
        assert found == pytest.approx(-(len(t) + determinant) / 2, abs=1e-2)


@pytest.mark.slow
def test_paths_side_by_side_are_those_of_single_throws():
    """With vectors of 512 bits XLA compiles this law wrongly, for a whole batch at a time."""
    law = LAWS["debris"]
    start, stone = curlfit.InitialState(v=2.1, omega=-2.6), Stone()
    t = np.arange(60) * 0.25
    path = curlfit.simulate(law(), stone, start, t).to_numpy()
    throw = curlfit.Throw.from_arrays(t, path.x, path.y, path.phi)
    problem = build_problem(throw, stone, Origin.of(throw), dict.fromkeys(("x", "y", "phi"), 1.0))
    defaults = [item.default for item in law.coefficients()]
    values = np.array([*defaults, 0.0, 0.0, 0.0, 2.1, 0.0, -2.6])
    residual, _ = linearize(
        Model(law, "uniform"), np.tile(values, (BATCH, 1)), stacked([problem] * BATCH)
    )
    single = np.asarray(predict_channels(Model(law, "uniform"), values, problem))[:3]
    expected = np.where(problem.weight > 0, single - problem.observed, 0.0)
    np.testing.assert_allclose(residual, np.tile(expected, (BATCH, 1, 1)), atol=1e-10)
