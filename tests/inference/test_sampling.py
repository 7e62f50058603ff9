"""The posterior: the ridge of eq. 12, moves on targets whose law is known,
the diagnostics."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from functools import partial

import emcee
import numpy as np
import pytest
import xarray
from conftest import filmed, shown
from emcee.moves import DEMove, MHMove, StretchMove
from scipy import stats
from scipy.optimize import linprog

import curlfit
from curlfit import Stone, fit, load_chain, sample
from curlfit.inference.sampling.ridge import RidgeProposal, _extent, proposed
from curlfit.inference.sampling.sampler import Ensemble, SideBySide
from curlfit.inference.sampling.summary import Diagnosis, steps_to_discard


def test_the_ridge_is_explored_to_its_ends_evenly(eq12_posterior):
    result, chain = eq12_posterior
    posterior = result.posterior
    assert posterior.converged
    assert posterior.correlation["mu1_eta"]["mu2_eta"] < -0.99
    total = posterior.mean["mu1_eta + mu2_eta"]
    for name in ("mu1_eta", "mu2_eta"):
        assert posterior.sd[name] == pytest.approx(total / np.sqrt(12), rel=0.03)
        values = chain.of({name: 1.0})
        assert values.min() < 0.01 * total
        assert values.max() > 0.99 * total
        thin = values[:: max(1, len(values) // 1000)] / total
        assert stats.kstest(thin, "uniform").pvalue > 1e-3
    assert max(posterior.r_hat.values()) < 1.01
    assert min(posterior.ess.values()) > 2000
    assert min(posterior.ess_tail.values()) > 2000
    pattern = r"at least \d+ in the bulk \(\S+\) and \d+ in the tail \(\S+\), R-hat"
    assert re.search(pattern, shown(result))


def test_determined_parameters_agree_with_least_squares(eq12_posterior):
    result, _ = eq12_posterior
    posterior = result.posterior
    for name in ("mu1_xi", "mu2_xi", "v0", "omega0"):
        estimate = result.parameters[name]
        assert posterior.sd[name] == pytest.approx(estimate.stderr, rel=0.08)
        assert abs(posterior.mean[name] - estimate.value) < 0.15 * estimate.stderr
    (combination,) = result.combinations
    assert posterior.sd[combination.expression] == pytest.approx(
        combination.stderr, rel=0.08
    )


def test_chains_are_stored_for_curlfit_and_for_emcee(eq12_posterior, tmp_path):
    _, chain = eq12_posterior
    chain.save(tmp_path / "chain.h5")
    again = load_chain(tmp_path / "chain.h5")
    np.testing.assert_array_equal(again.values, chain.values)
    assert again.names == chain.names
    backend = emcee.backends.HDFBackend(tmp_path / "chain.h5")
    np.testing.assert_array_equal(backend.get_chain(), chain.values)
    np.testing.assert_array_equal(backend.get_log_prob(), chain.log_posterior)
    np.testing.assert_array_equal(backend.accepted, chain.accepted)
    last = backend.get_last_sample()
    np.testing.assert_array_equal(last.random_state[1], chain.random_state[1])
    (tmp_path / "other.h5").write_text("no")
    with pytest.raises(curlfit.DataError, match=r"not a chain\.h5"):
        load_chain(tmp_path / "other.h5")


def test_a_parameter_at_its_bound_has_half_a_posterior(eq12):
    result = fit(eq12, stone=Stone(R=0.065, rho=0.1))
    result, chain = sample(result, effective=1000)
    values = chain.of({"mu1_xi": 1.0})
    assert result.posterior.converged
    assert values.min() >= 0
    # A linear slope of the log-posterior at a bound makes an exponential.
    assert values.std() == pytest.approx(values.mean(), rel=0.1)
    assert np.quantile(values, 0.5) == pytest.approx(values.mean() * np.log(2), rel=0.1)
    assert "68 % of posterior" in shown(result)


def test_a_run_that_is_too_short_says_so():
    result, _ = sample(fit(filmed()), most_steps=20)
    assert not result.posterior.converged
    assert result.posterior.status.startswith("not converged after 20 steps")


def test_ctrl_c_is_not_lost_while_emcee_sets_its_random_numbers(monkeypatch):
    class Interrupted(np.random.RandomState):
        def set_state(self, state):
            raise KeyboardInterrupt

    sampler = Ensemble(8, 2, lambda x: np.zeros(len(x)), vectorize=True)
    coords = np.random.default_rng(0).normal(size=(8, 2))
    last = sampler.run_mcmc(coords, 1)
    monkeypatch.setattr(sampler, "_random", Interrupted())
    with pytest.raises(KeyboardInterrupt):
        sampler.run_mcmc(last, 1)


def _run(move, log_prob, coords, steps, seed=0):
    sampler = emcee.EnsembleSampler(
        len(coords), coords.shape[1], log_prob, moves=move, vectorize=True
    )
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(coords, steps, skip_initial_state_check=True)
    return sampler.get_chain()


@pytest.mark.parametrize("move", [StretchMove(), DEMove(sigma=0.1)])
def test_ensemble_moves_leave_a_skew_target_as_it_is(move):
    random = np.random.default_rng(3)
    draws = random.standard_exponential((128, 2)) * [1, 3]

    def log_prob(x):
        inside = (x > 0).all(1)
        return np.where(inside, -(x @ [1, 1 / 3]), -np.inf)

    chain = _run(SideBySide(move), log_prob, draws, 2500)
    mean = chain[500:].mean((0, 1))
    sd = chain[500:].std((0, 1))
    np.testing.assert_allclose(mean, [1, 3], rtol=0.06)
    np.testing.assert_allclose(sd, [1, 3], rtol=0.08)


def test_ensembles_do_not_mix():
    coords = np.repeat(np.arange(4.0) * 100, 16)[:, None] + np.random.default_rng(
        0
    ).normal(size=(64, 1))
    chain = _run(SideBySide(StretchMove()), lambda x: np.zeros(len(x)), coords, 3)
    # a stretch along a line through the own ensemble stays in its neighbourhood
    np.testing.assert_array_equal(
        np.round(np.median(chain[-1].reshape(4, 16), 1), -2), [0, 100, 200, 300]
    )


def test_ridge_move_leaves_its_target_as_it_is():
    # d = (a + b)/sqrt 2 is Gaussian, a is even on (0, 2); the proposal is
    # wider than both
    combinations = np.array([[1.0, 1.0]]) / np.sqrt(2)
    proposal = RidgeProposal(
        np.array([1.0, 1.0]),
        np.ones(2),
        combinations,
        np.array([0.3]),
        np.array([0]),
        np.array([-1.4]),
        np.array([1.4]),
        np.array([], int),
        np.array([]),
    )

    def log_prob(x):
        z = (x.sum(1) - 2) / np.sqrt(2) / 0.25
        return np.where((x[:, 0] > 0) & (x[:, 0] < 2), -(z**2) / 2, -np.inf)

    first = np.column_stack([np.linspace(0.1, 1.9, 32), 2 - np.linspace(0.1, 1.9, 32)])
    chain = _run(MHMove(partial(proposed, proposal)), log_prob, first, 3000)[
        100:
    ].reshape(-1, 2)
    assert stats.kstest(chain[::40, 0] / 2, "uniform").pvalue > 1e-3
    assert (
        stats.kstest((chain[::40].sum(1) - 2) / np.sqrt(2) / 0.25, "norm").pvalue > 1e-3
    )


def test_the_density_of_a_ridge_is_a_density():
    """Student, uniform and exponential in combinations of the parameters."""
    combinations = np.array([[1.0, 0.5, 0.2, 0.0], [0.3, -1.0, 0.0, 0.4]])
    spread = np.array([0.3, 2.0])
    proposal = RidgeProposal(
        np.zeros(4),
        np.ones(4),
        combinations,
        spread,
        np.array([2]),
        np.array([-1.0]),
        np.array([2.0]),
        np.array([3]),
        np.array([-0.7]),
    )
    values = proposal.draw(5, np.random.RandomState(0))
    rows = np.concatenate([combinations, np.eye(4)[2:]])
    expected = stats.multivariate_t(shape=np.diag(spread**2), df=8).logpdf(
        values @ combinations.T
    )
    expected += stats.expon.logpdf(-values[:, 3], scale=0.7) - np.log(3)
    expected += np.linalg.slogdet(rows)[1]
    np.testing.assert_allclose(proposal.log_density(values), expected)


@pytest.mark.slow
def test_the_extent_of_one_direction_is_that_of_a_linear_program():
    random = np.random.default_rng(0)
    for size in range(1, 8):
        null = random.standard_normal((1, size))
        null[:, 1::2] = 0
        walls = np.concatenate([null.T, -null.T])
        room = random.uniform(0, 3, 2 * size)
        ends = [
            sign
            * linprog(sign * null[:, 0], A_ub=walls, b_ub=room, bounds=(None, None)).fun
            for sign in (1, -1)
        ]
        assert _extent(null[:, 0], walls, room) == pytest.approx(ends)


def test_a_curved_ridge_is_sampled_from_end_to_end():
    """Without an angle, `omega0` is known neither in sign nor size. Turning the other
    way, with front and back exchanged, leads along the same path."""
    noise = {"x": 0.003, "y": 0.003}
    throw = filmed(seed=3, noise=noise, times=np.linspace(0, 18, 61))
    fit, chain = curlfit.sample(curlfit.fit(throw, details=False), effective=1000)
    assert fit.posterior.converged
    kept = chain.values[chain.discarded :].reshape(-1, len(chain.names))
    omega = kept[:, chain.names.index("omega0")]
    assert np.quantile(np.abs(omega), 0.05) < 1.2 < np.quantile(np.abs(omega), 0.95)
    sides = [
        np.abs(omega[side])[:: len(omega) // 2000] for side in (omega > 0, omega < 0)
    ]
    assert len(sides[0]) / sum(map(len, sides)) == pytest.approx(0.5, abs=0.06)
    assert stats.ks_2samp(*sides).pvalue > 1e-3


def _walk(random, steps, memory, walkers=128):
    """Stationary normal chains, shape (steps, walkers, parameters), with
    these autocorrelations."""
    memory = np.array(memory)
    values = random.standard_normal((steps, walkers, len(memory)))
    for step in range(1, steps):
        values[step] = memory * values[step - 1] + np.sqrt(1 - memory**2) * values[step]
    return values


@pytest.mark.numerical
@pytest.mark.parametrize("steps", [40, 81])
def test_diagnostics_are_those_of_arviz(steps):
    """Walkers are its chains for effective sample sizes, ensembles for R-hat."""
    random = np.random.default_rng(steps)
    values = _walk(random, steps, [0.0, 0.5, 0.95, -0.4])
    for step in range(1, steps):  # refused proposals repeat a value
        stay = random.random(128) < 0.3
        values[step, stay] = values[step - 1, stay]
    values[:, 32:64, 0] *= 1.3
    values[..., 3] = np.maximum(values[..., 3], -0.5)
    diagnosis = Diagnosis(values, 4)

    with warnings.catch_warnings():  # ArviZ announces its next version
        warnings.simplefilter("ignore")
        import arviz
    kept = values[steps_to_discard(steps) :]
    walkers = xarray.Dataset(
        {str(k): (("chain", "draw"), kept[..., k].T) for k in range(4)}
    )
    half = len(kept) // 2
    halves = np.concatenate([kept[:half], kept[-half:]]).reshape(2 * half, 4, 32, 4)
    ensembles = xarray.Dataset(
        {
            str(k): (
                ("chain", "draw"),
                np.moveaxis(halves[..., k], 1, 0).reshape(4, -1),
            )
            for k in range(4)
        }
    )
    for expected, ours in (
        (arviz.ess(walkers, method="bulk"), diagnosis.bulk),
        (arviz.ess(walkers, method="tail", prob=(0.05, 0.95)), diagnosis.tail),
        (arviz.rhat(ensembles, method="rank"), diagnosis.r_hat),
    ):
        np.testing.assert_allclose(
            ours, [float(expected[str(k)]) for k in range(4)], rtol=1e-12
        )


def test_a_chain_of_few_steps_has_few_effective_samples():
    diagnosis = Diagnosis(np.random.default_rng(3).standard_normal((4, 128, 2)), 4)
    assert diagnosis.bulk.tolist() == diagnosis.tail.tolist() == [256, 256]
    assert not diagnosis.good(100)


def test_an_undetermined_direction_without_bounds_is_named(eq12):
    wide = dict.fromkeys(("mu1_eta", "mu2_eta"), (-np.inf, np.inf))
    with pytest.raises(
        curlfit.UnusableFitError, match="mu1_eta and mu2_eta, and none of them"
    ):
        sample(fit(eq12, stone=Stone(R=0.065, rho=0.1025), bounds=wide))


def test_emcee_is_imported_without_what_one_move_needs_and_the_move_works():
    """The import of `scipy.stats` took a tenth of the fit of an evening."""
    script = """
import sys
import numpy as np
import curlfit.inference.sampling.sampler
assert "scipy.stats" not in sys.modules
import emcee
random = np.random.default_rng(0)
moves = emcee.moves.KDEMove()
log_prob = lambda x: -0.5 * (x**2).sum()
sampler = emcee.EnsembleSampler(20, 2, log_prob, moves=moves)
sampler.run_mcmc(random.normal(size=(20, 2)), 3)
assert "scipy.stats" in sys.modules
"""
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
