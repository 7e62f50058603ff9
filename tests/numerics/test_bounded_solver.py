"""The bounded solver: scipy, many problems beside one, and models that
are not smooth."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from curlfit.inference.model.priors import Penalty
from curlfit.inference.solve.least_squares import Control
from curlfit.numerics import bounded_solver as bounded
from curlfit.numerics.arrow_matrix import Blocks

LOWER = np.array([0, -0.005, -0.3, 0])
UPPER = np.array([np.inf, 0.005, 0.3, np.inf])


def problem(seed):
    """Matrix and right-hand side of residuals of four parameters of very
    different sizes."""
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((30, 4)) * [1, 100, 1, 0.01]
    return matrix, matrix @ (random.standard_normal(4) * [1, 0.01, 1, 100])


def residual(z, of, xp=np):
    """Not linear."""
    matrix, right = of
    return xp.concatenate([matrix @ z - right, 0.1 * (z[:1] ** 3 - z[2:3])])


def solved(residual, start=(0.0,) * 4, lower=LOWER, upper=UPPER, blocks=None):
    """The optimum of a function of the values, by optimistix."""
    start, lower, upper = map(jnp.asarray, (start, lower, upper))
    blocks = Blocks.of(np.ones(start.size, bool)) if blocks is None else blocks
    solver = bounded.BoundedLeastSquares(
        descent=bounded.BoundedDescent(lower, upper, jnp.ones(start.size)),
        search=bounded.GainRatio(1e-2),
        control=Control(1e-2, 1e-14, 1e-18),
        blocks=blocks,
        penalty=Penalty.none(start.size),
    )
    return optx.least_squares(
        lambda z, _: residual(z), solver, start, max_steps=None, throw=False
    )


@jax.custom_jvp
def rippled(z, of):
    """With a ripple of 1e-5, which the derivative does not know."""
    return residual(z, of, jnp) + 1e-5 * jnp.sin(1e9 * z.sum() * (1 + jnp.arange(31)))


@rippled.defjvp
def _(at, along):
    return rippled(*at), jax.jvp(lambda z: residual(z, at[1], jnp), at[:1], along[:1])[
        1
    ]


KINDS = {
    "smooth": lambda z, of: residual(z, of, jnp),
    "rippled": rippled,
    "without a path": lambda z, of: jnp.full(31, jnp.nan) * z[0],
    "without a derivative": lambda z, of: jnp.resize(jnp.sqrt(jnp.abs(z)) + 1, 31),
}


@jax.jit
def _optimum(of, start, kind):
    """By a program for all kinds."""
    return solved(lambda z: jax.lax.switch(kind, [*KINDS.values()], z, of), start)


def optimum(of, start=(0.0,) * 4, kind="smooth"):
    return _optimum(of, jnp.asarray(start), [*KINDS].index(kind))


@pytest.mark.parametrize("seed", range(2))
def test_the_optimum_within_bounds_is_that_of_scipy(seed):
    of = problem(seed)
    solution = optimum(of)
    start = np.clip(np.zeros(4), LOWER + 1e-6, UPPER - 1e-6)
    scipys = least_squares(
        residual,
        start,
        args=(of,),
        bounds=(LOWER, UPPER),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        x_scale=[1, 0.01, 1, 100],
        max_nfev=5000,
    )
    ours = float((residual(np.asarray(solution.value), of) ** 2).sum() / 2)
    assert ours <= scipys.cost * (1 + 1e-8) + 1e-12
    assert (solution.value >= LOWER).all()
    assert (solution.value <= UPPER).all()
    assert solution.stats["num_steps"] <= 8
    at = residual(np.asarray(solution.value), of)
    np.testing.assert_allclose(solution.state.residual, at, atol=1e-6)


def test_problems_side_by_side_take_the_steps_of_each_alone():
    starts = np.array([[0.0, 0, 0, 0], [5, 0, 0.3, 200], [0, 0.005, -0.3, 0]])
    of = problem(2)
    many = jax.vmap(optimum, (None, 0))(of, starts)
    for row, start in enumerate(starts):
        alone = optimum(of, start)
        assert many.state.evaluations[row] == alone.state.evaluations
        np.testing.assert_allclose(many.value[row], alone.value, rtol=1e-9, atol=1e-12)


def test_blocks_with_common_parameters_have_the_optimum_of_all_rows():
    """Two blocks share their first two parameters; one tangent serves a
    parameter of both."""
    problems = problem(0), problem(1)
    layout = Blocks.of(np.array([True, True, False, False]), 2)
    blocks = layout.index
    np.testing.assert_array_equal(blocks, [[0, 1, 2, 3], [0, 1, 4, 5]])
    lower, upper = (np.append(end, end[2:]) for end in (LOWER, UPPER))

    def rows(z, xp=jnp):
        return xp.stack(
            [
                residual(z[block], of, xp)
                for block, of in zip(blocks, problems, strict=True)
            ]
        )

    solution = solved(rows, np.zeros(6), lower, upper, layout)
    inside = np.clip(np.zeros(6), lower + 1e-6, upper - 1e-6)
    by_scipy = least_squares(
        lambda z: rows(z, np).ravel(),
        inside,
        bounds=(lower, upper),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        x_scale=[1, 0.01, 1, 100, 1, 100],
        max_nfev=5000,
    )
    assert solution.state.success
    assert (solution.state.residual**2).sum() / 2 <= by_scipy.cost * (1 + 1e-8)
    for jacobian, (matrix, _), block in zip(
        solution.state.jacobian, problems, blocks, strict=True
    ):
        last = [0.3 * float(solution.value[block[0]]) ** 2, 0, -0.1, 0]
        np.testing.assert_allclose(jacobian, [*matrix, last], atol=1e-6)


def test_a_model_that_is_not_smooth_ends_at_the_best_values_met():
    """No trial is accepted in the end."""
    noisy = optimum(problem(1), kind="rippled")
    exact = optimum(problem(1))
    assert noisy.state.success
    assert float(noisy.state.model.f) == pytest.approx(
        float(exact.state.model.f), rel=1e-3
    )


def test_a_start_without_a_path_is_no_success():
    nowhere = optimum(problem(1), kind="without a path")
    assert nowhere.state.done
    assert not nowhere.state.success


def test_a_start_without_a_derivative_has_no_residual():
    """Where it is not known, nothing finite may stand for it."""
    solution = optimum(problem(1), kind="without a derivative")
    assert solution.result != optx.RESULTS.successful
    assert np.isnan(solution.state.residual).all()


@pytest.mark.parametrize("blocks", [1, 3])
def test_elimination_solves_as_lapack_does_and_needs_none_of_it(blocks):
    random = np.random.default_rng(0)
    layout = Blocks.of(np.arange(10) < 4, blocks)
    size = 4 + 6 * blocks
    rows = random.normal(size=(blocks, 12, 10)) * 10.0 ** random.uniform(-3, 0, 10)
    all_rows = np.zeros((blocks, 12, size))
    for block, index, part in zip(all_rows, layout.index, rows, strict=True):
        block[:, index] = part
    matrix = all_rows.reshape(-1, size).T @ all_rows.reshape(-1, size)
    scale = 1 / np.sqrt(np.diagonal(matrix))
    right = random.normal(size=size)
    dense = matrix * np.outer(scale, scale) + 1e-10 * np.eye(size)
    arrow = jax.jit(lambda rows, scale: layout.normal(rows).scaled(scale, 1e-10))(
        rows, scale
    )
    np.testing.assert_allclose(arrow.diagonal(), np.diagonal(dense), rtol=1e-12)
    np.testing.assert_allclose(arrow.mv(right), dense @ right, rtol=1e-9, atol=1e-12)
    program = jax.jit(lambda matrix, right: matrix.solve(right)).lower(arrow, right)
    assert "custom_call" not in program.as_text()
    solution = program.compile()(arrow, right)
    expected = np.linalg.solve(dense, right)
    allowed = 10 * np.finfo(float).eps * np.linalg.cond(dense)
    assert np.linalg.norm(solution - expected) < allowed * np.linalg.norm(expected)
