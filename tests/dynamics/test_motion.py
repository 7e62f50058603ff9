"""The path: closed forms, scipy, symmetry, order of convergence."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_motion import Reference, front_back

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.dynamics import equations
from curlfit.paper.printed import first_order_motion

STONE = Stone(R=0.054, rho=0.1)
PAPER = (0.0004, 0.0555, 0.009, 0.0083)
FRONT_BACK = LAWS["front-back"](*PAPER)
ROWS = 61  # of most paths, so that one program is enough for each load


def places(path, xp=np):
    return xp.stack([path.x, path.y, path.phi])


def moved(law, start, times, **how):
    """A path at a few times, the last of them repeated up to the usual
    number of rows."""
    return simulate(
        law, STONE, start, np.pad(times, (0, ROWS - len(times)), mode="edge"), **how
    )


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("mu", "h", "v", "omega", "heading", "until"),
    [
        (PAPER, None, 2.06, 1.005, 0.0, 20.0),  # eq. 12
        (PAPER, None, 2.06, 1.005, 0.0, 30.0),  # on to rest, through |epsilon| = 1
        (PAPER, None, 1.0, 60.0, 0.3, 70.0),  # epsilon = 3 from the start
        ((0.004, 0.035, 0.009, 0.008), None, 2.2, -5.0, -0.2, 40.0),
        ((0.01,) * 4, None, 2.0, -3.0, 0.0, 30.0),
        ((0.01,) * 4, None, 0.05, 30.0, 0.0, 40.0),
        (PAPER, 0.057, 2.06, -1.5, 0.1, 30.0),  # consistent load
    ],
)
def test_path_agrees_with_order_8_integration_on_a_dense_ring(
    mu, h, v, omega, heading, until
):
    start = InitialState(x=1.0, y=-2.0, heading=heading, v=v, phi=0.5, omega=omega)
    times = np.linspace(0, until, ROWS)
    load = "uniform" if h is None else "consistent"
    stone = Stone(R=0.054, rho=0.1, h=h or 0.057)
    path = simulate(LAWS["front-back"](*mu), stone, start, times, load=load)
    error = np.abs(places(path) - Reference(front_back(*mu), h=h).path(start, times))
    assert error.max() < 5e-8  # m, m, rad; the book promises 1e-7


def test_error_falls_with_the_fifth_power_of_the_step(monkeypatch):
    times = np.linspace(0, 20, ROWS)
    start = InitialState(v=2.06, omega=1.005)
    exact = Reference(front_back(*PAPER)).path(start, times)
    errors = []
    for step in (0.5, 0.25):
        monkeypatch.setattr(equations, "STEP", step)
        jax.clear_caches()
        # traced here: the program of known times is kept from call to call
        path = jax.jit(
            lambda times: places(simulate(FRONT_BACK, STONE, start, times, t0=0.0), jnp)
        )
        errors.append(np.abs(path(times) - exact).max())
    monkeypatch.undo()
    jax.clear_caches()
    assert 4.0 < np.log2(errors[0] / errors[1]) < 7.0


@pytest.mark.numerical
def test_first_order_law_agrees_with_its_closed_form():
    law = LAWS["front-back-first-order"](*PAPER)
    times = np.linspace(0, 21, ROWS)
    path = simulate(law, STONE, InitialState(v=2.06, omega=1.005), times)
    exact = first_order_motion(law, STONE, 2.06, 1.005, times)
    for name, symbol in (
        ("x", "x"),
        ("y", "y"),
        ("phi", "phi"),
        ("speed", "v"),
        ("omega", "omega"),
    ):
        np.testing.assert_allclose(
            getattr(path, name), getattr(exact, symbol), atol=5e-8
        )


def test_closed_form_has_no_meaning_after_the_stop():
    with pytest.raises(ValueError, match="the stone stops at"):
        first_order_motion(
            LAWS["front-back-first-order"](*PAPER), STONE, 2.0, 1.0, [100.0]
        )


def test_turned_and_shifted_throws_have_the_same_path():
    times = np.linspace(0, 30, ROWS)
    path = simulate(
        FRONT_BACK, STONE, InitialState(v=2.0, heading=0.2, omega=2.0), times
    )
    shifted = simulate(
        FRONT_BACK,
        STONE,
        InitialState(x=3, y=-7, heading=0.2 + 0.5, v=2.0, phi=40, omega=2.0),
        times + 100,
    )
    # heading turns from +y toward +x
    s = np.sin(0.5)
    c = np.cos(0.5)
    exact = [3 + c * path.x + s * path.y, -7 - s * path.x + c * path.y, 40 + path.phi]
    np.testing.assert_allclose(places(shifted), exact, atol=1e-12)


def test_rest_is_held_and_order_of_times_does_not_matter():
    times = [50.0, 0.0, 24.0, 26.0, 3.0, 100.0]
    start = InitialState(v=2.06, omega=1.0)
    path = moved(FRONT_BACK, start, times, t0=0.0)
    assert path.x[0] == path.x[5] == path.x[3]
    assert path.speed[0] == 0
    assert path.omega[0] == 0
    ordered = simulate(FRONT_BACK, STONE, start, np.sort(path.t))
    np.testing.assert_array_equal(np.sort(path.y), ordered.y)


def test_stones_side_by_side_go_each_its_own_way():
    # Fast and slow, spinning, at rest, without a path
    v = np.array([2.1, 0.02, 3.0, 0.05, 0.0, 1.0, 2.1, 1.5])
    omega = np.array([1.0, -2.0, 0.0, 40.0, 0.0, 15.4, np.nan, -6.0])
    times = np.linspace(0, 40, ROWS)

    def one(v, omega):
        path = simulate(FRONT_BACK, STONE, InitialState(v=v, omega=omega), times)
        return [path.x, path.y, path.phi, path.vx, path.vy, path.omega]

    beside = np.stack(jax.jit(jax.vmap(one))(v, omega), 1)
    for k in np.flatnonzero(np.isfinite(omega)):
        np.testing.assert_allclose(
            beside[k], one(v[k], omega[k]), rtol=1e-12, atol=1e-12
        )
    assert np.isnan(beside[np.isnan(omega)]).any((0, 2)).all()


def test_compiled_code_sorts_times_that_it_does_not_know():
    times = np.array([50.0, 0.0, 24.0, 26.0, 3.0, 100.0])

    def y(times):
        path = simulate(
            FRONT_BACK, STONE, InitialState(v=2.06, omega=1.0), times, t0=0.0
        )
        return path.y, path

    slope, path = jax.jit(jax.jacfwd(y, has_aux=True))(times)
    np.testing.assert_allclose(path.y, y(times)[0], rtol=1e-12)
    np.testing.assert_allclose(slope, np.diag(path.vy), atol=1e-9)


def test_at_its_first_moment_a_stone_is_at_its_start():
    path = moved(
        FRONT_BACK, InitialState(x=1.0, y=2.0, v=2.0, phi=0.5, omega=1.0), [0.0]
    )
    for name, value in (
        ("x", 1.0),
        ("y", 2.0),
        ("phi", 0.5),
        ("vy", 2.0),
        ("omega", 1.0),
    ):
        np.testing.assert_allclose(getattr(path, name), value, rtol=1e-15)
    assert path.rest > 20


def test_a_stone_at_rest_and_pure_spin_stay_in_place():
    still = moved(FRONT_BACK, InitialState(v=0.0, omega=0.0, x=1.0), [0.0, 5.0])
    np.testing.assert_array_equal(still.x, 1.0)
    path = moved(FRONT_BACK, InitialState(v=0.0, omega=5.0), [0.0, 1.0, 60.0])
    np.testing.assert_allclose([path.x, path.y], 0, atol=1e-15)
    # M = -m g R mean(mu_xi sin^2 + mu_eta cos^2) on a ring that slides along itself
    slowing = 9.81 * 0.054 / 0.1**2 * (sum(PAPER) / 4)
    assert path.phi[1] == pytest.approx(5 - slowing / 2, abs=1e-9)
    assert path.phi[2] == pytest.approx(25 / (2 * slowing), abs=1e-9)


def test_a_stone_of_whole_numbers_has_the_program_of_any():
    assert [type(value) for value in vars(Stone(m=20)).values()] == [float] * 4


def test_unknown_load_is_refused():
    with pytest.raises(curlfit.InputError, match="expected uniform or consistent"):
        simulate(FRONT_BACK, STONE, InitialState(), [0.0, 1.0], load="heavy")


def test_at_infinity_a_stone_is_where_it_comes_to_rest_and_nowhere_without_a_time():
    start = InitialState(y=3.0, v=2.0)
    path = moved(FRONT_BACK, start, [0.0, 1.0, np.inf])
    late = moved(FRONT_BACK, start, [0.0, 1.0, 1000.0])
    np.testing.assert_allclose(places(path), places(late), atol=1e-9)
    np.testing.assert_array_equal(path.t[:3], [0.0, 1.0, np.inf])
    assert np.isnan(moved(FRONT_BACK, start, [0.0, np.nan, 1.0], t0=0).y[1])
