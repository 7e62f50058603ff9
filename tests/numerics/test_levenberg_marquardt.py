"""The bounded search: scipy, many problems beside one, and models that are not smooth."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from curlfit.numerics import levenberg_marquardt as lm
from curlfit.numerics.bounded_solver import BoundedLevenbergMarquardt

CONTROL = lm.Control(1e-2, 1e-14, 1e-18)
LOWER, UPPER = np.array([0, -0.005, -0.3, 0]), np.array([np.inf, 0.005, 0.3, np.inf])


def problem(seed):
    """Residuals of four parameters of very different sizes, not linear, and their Jacobian."""
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((30, 4)) * [1, 100, 1, 0.01]
    right = matrix @ (random.standard_normal(4) * [1, 0.01, 1, 100])

    def residual(z, xp=np):
        return xp.concatenate([matrix @ z - right, 0.1 * (z[:1] ** 3 - z[2:3])])

    def jacobian(z):
        return np.vstack([matrix, [0.3 * z[0] ** 2, 0, -0.1, 0]])

    return residual, jacobian


@pytest.mark.parametrize("seed", range(4))
def test_the_optimum_within_bounds_is_that_of_scipy(seed):
    residual, _ = problem(seed)
    bounds = lm.Bounds(jnp.array(LOWER), jnp.array(UPPER), jnp.ones(4))
    found = optx.least_squares(
        lambda z, _: residual(z, jnp), BoundedLevenbergMarquardt(bounds, CONTROL),
        jnp.zeros(4), max_steps=100,
    )  # fmt: skip
    start = np.clip(np.zeros(4), LOWER + 1e-6, UPPER - 1e-6)
    scipys = least_squares(
        residual, start, bounds=(LOWER, UPPER), xtol=1e-15, ftol=1e-15, gtol=1e-15,
        x_scale=[1, 0.01, 1, 100], max_nfev=5000,
    )  # fmt: skip
    ours = float((residual(np.asarray(found.value)) ** 2).sum() / 2)
    assert ours <= scipys.cost * (1 + 1e-8) + 1e-12
    assert (found.value >= LOWER).all()
    assert (found.value <= UPPER).all()
    assert found.stats["num_steps"] <= 8


def searched(residual, jacobian):
    """The search of one problem, by NumPy, along a leading axis."""
    bounds = lm.Bounds(LOWER[None], UPPER[None], np.ones(4))
    search = lm.begin(np.zeros((1, 4)), bounds, CONTROL)
    while not search.done.all():
        (z,) = search.trial
        model = lm.quadratic_model(residual(z)[None], jacobian(z)[None], bounds.typical)
        search, _ = lm.advance(search, model, bounds, CONTROL)
    return search


@pytest.mark.parametrize("seed", range(4))
def test_arrays_of_numpy_and_of_jax_take_the_same_steps(seed):
    residual, jacobian = problem(seed)
    search = searched(residual, jacobian)
    bounds = lm.Bounds(jnp.array(LOWER), jnp.array(UPPER), jnp.ones(4))
    found = optx.least_squares(
        lambda z, _: residual(z, jnp), BoundedLevenbergMarquardt(bounds, CONTROL),
        jnp.zeros(4), max_steps=100,
    )  # fmt: skip
    assert search.success.all()
    assert search.evaluations[0] == found.stats["num_steps"]
    np.testing.assert_allclose(search.values[0], found.value, rtol=1e-9, atol=1e-12)


def test_a_model_that_is_not_smooth_ends_at_the_best_values_met():
    """Noise of 1e-5 in the residuals: no trial is accepted in the end."""
    residual, jacobian = problem(1)
    random = np.random.default_rng(0)
    noisy = searched(lambda z: residual(z) + 1e-5 * random.standard_normal(31), jacobian)
    (exact,) = searched(residual, jacobian).model.chi_squared
    assert noisy.success.all()
    assert noisy.model.chi_squared[0] == pytest.approx(exact, rel=1e-3)


def test_a_start_without_a_path_is_no_success():
    nowhere = searched(lambda z: np.full(31, np.nan), lambda z: np.full((31, 4), np.nan))
    assert nowhere.done.all()
    assert not nowhere.success.any()


def test_a_start_without_a_derivative_has_no_residual():
    """Where it is not known, nothing finite may stand for it."""
    bounds = lm.Bounds(*(jnp.array(each) for each in (LOWER, UPPER, np.ones(4))))
    found = optx.least_squares(
        lambda z, _: jnp.sqrt(jnp.abs(z)) + 1, BoundedLevenbergMarquardt(bounds, CONTROL),
        jnp.zeros(4), max_steps=100, throw=False,
    )  # fmt: skip
    assert found.result != optx.RESULTS.successful
    assert np.isnan(found.state.residual).all()


def test_elimination_solves_as_lapack_does_and_needs_none_of_it():
    random = np.random.default_rng(0)
    factor = random.normal(size=(10, 10)) * 10.0 ** random.uniform(-3, 0, 10)
    matrix = factor @ factor.T
    size = np.sqrt(np.diagonal(matrix))
    matrix = matrix / np.outer(size, size) + 1e-10 * np.eye(10)
    right = random.normal(size=10)
    program = jax.jit(lm._solution).lower(matrix, right)
    assert "custom_call" not in program.as_text()
    found, expected = program.compile()(matrix, right), np.linalg.solve(matrix, right)
    allowed = 10 * np.finfo(float).eps * np.linalg.cond(matrix)
    assert np.linalg.norm(found - expected) < allowed * np.linalg.norm(expected)
