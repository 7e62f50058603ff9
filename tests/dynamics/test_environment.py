"""Ice that is not level, and the air: scipy, closed forms, symmetry, derivatives, aim."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import G
from scipy.integrate import solve_ivp

from curlfit import LAWS, InitialState, Stone, aim, simulate
from curlfit.dynamics.contact import accelerations
from curlfit.environment import AIR_DENSITY, FRONTAL_AREA, Environment

pytestmark = pytest.mark.numerical

LAW = LAWS["front-back"]
PAPER = (0.0004, 0.0555, 0.009, 0.0083)
STONE = Stone(m=19.0, R=0.06, rho=0.1)
TIMES = np.linspace(0.0, 40.0, 41)
START = (1.0, -2.0, 0.3, 2.1, 0.5, 1.3)  # x, y, heading, v, phi, omega

friction = jax.jit(partial(accelerations, stone=STONE, load="uniform"))


@jax.jit
def motion(mu, start, environment):
    """x, y, phi, vx, vy, omega and the time of rest, by vectors, so that one program serves all."""
    path = simulate(
        LAW.from_vector(mu), STONE, InitialState(*start), TIMES, t0=0.0,
        environment=Environment(*environment),
    )  # fmt: skip
    return jnp.stack([path.x, path.y, path.phi, path.vx, path.vy, path.omega]), path.rest


def moved(mu=PAPER, start=START, environment=(0.0, 0.0, 0.0)):
    found, rest = motion(*(np.array(part, float) for part in (mu, start, environment)))
    return np.asarray(found), float(rest)


def integrated(mu, start, environment):
    """x, y, phi by scipy's method of order 8."""
    law, (slope_x, slope_y, drag) = LAW(*mu), environment
    k = 0.5 * AIR_DENSITY * FRONTAL_AREA / STONE.m * drag

    def rates(_, state):
        _, _, v, beta, _, omega = state
        s, c = np.sin(beta), np.cos(beta)
        a = friction(law, v=v, omega=omega)
        dv = float(a.eta) + G * (s * slope_x + c * slope_y) - k * v**2
        turning = (float(a.xi) + G * (c * slope_x - s * slope_y)) / v
        return [v * s, v * c, dv, turning, omega, float(a.angular)]

    def rest(_, state):
        v, u = state[2], STONE.rho * abs(state[5])
        return min(np.hypot(v, u) - 1e-7, max(v - 1e-9, u - 2e-6))

    rest.terminal = True
    x, y, beta, v, phi, omega = start
    found = solve_ivp(
        rates, (0, TIMES[-1]), [x, y, v, beta, phi, omega], method="DOP853", rtol=1e-12, atol=1e-14,
        events=rest, dense_output=True,
    )  # fmt: skip
    assert found.success
    return found.sol(np.minimum(TIMES, found.t[-1]))[[0, 1, 4]], found.t[-1]


@pytest.mark.parametrize(
    ("environment", "start"),
    [
        ((2e-3, -1e-3, 0.8), START),
        ((-1e-3, 2e-3, 3.0), (0.0, 0.0, -0.7, 2.5, 0.0, -4.0)),
        ((1e-4, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0, 0.0, 1.0)),
    ],
)
def test_path_to_rest_agrees_with_order_8_integration(environment, start):
    found, rest = moved(start=start, environment=environment)
    exact, end = integrated(PAPER, start, environment)
    assert np.abs(found[:3] - exact).max() < 1e-7  # m, m, rad
    assert rest == pytest.approx(end, abs=1e-5)


def test_constant_friction_and_a_slope_along_the_throw_decelerate_uniformly():
    mu, slope, v = 0.012, 2e-3, 1.7
    loss = G * (mu - slope)
    found, rest = moved((mu,) * 4, (0, 0, 0, v, 0, 0), (0.0, slope, 0.0))
    t = np.minimum(TIMES, v / loss)
    np.testing.assert_allclose(found[1], v * t - loss * t**2 / 2, atol=1e-8)
    np.testing.assert_allclose(found[4], v - loss * t, atol=1e-7)
    np.testing.assert_allclose(found[0], 0, atol=1e-14)
    assert rest == pytest.approx(v / loss, abs=1e-6)


def test_without_friction_a_stone_falls_as_a_stone_thrown_in_vacuum():
    """slope_x > 0 falls to the right, slope_y > 0 along the throw; the spin stays."""
    found, _ = moved((0,) * 4, START, (3e-4, 2e-4, 0.0))
    x, y, beta, v, phi, omega = START
    np.testing.assert_allclose(found[0], x + v * np.sin(beta) * TIMES + G * 3e-4 * TIMES**2 / 2,
                               atol=1e-7)  # fmt: skip
    np.testing.assert_allclose(found[1], y + v * np.cos(beta) * TIMES + G * 2e-4 * TIMES**2 / 2,
                               atol=1e-7)  # fmt: skip
    np.testing.assert_allclose(found[2], phi + omega * TIMES, atol=1e-9)


def test_the_air_alone_slows_with_the_square_of_the_speed():
    drag, v = 5.0, 2.5
    found, _ = moved((0,) * 4, (0, 0, 0, v, 0, 1), (0.0, 0.0, drag))
    k = Environment(drag=drag).drag_rate(STONE.m)
    assert k == pytest.approx(0.5 * 1.27 * (0.914 / np.pi * 0.114) * drag / 19.0)
    np.testing.assert_allclose(found[4], v / (1 + k * v * TIMES), atol=1e-8)
    np.testing.assert_allclose(found[1], np.log1p(k * v * TIMES) / k, atol=1e-7)


def test_mirrored_in_the_centre_line_the_motion_is_the_mirror_image():
    x, y, beta, v, phi, omega = START
    one, rest = moved(environment=(2e-3, 1e-3, 0.8))
    other, other_rest = moved(start=(-x, y, -beta, v, -phi, -omega), environment=(-2e-3, 1e-3, 0.8))
    signs = np.array([-1, 1, -1, -1, 1, -1])[:, None]
    np.testing.assert_allclose(other, signs * one, atol=1e-12)
    assert other_rest == pytest.approx(rest, abs=1e-9)


def test_turned_with_the_slope_the_path_is_turned():
    turn = 0.6  # from +y toward +x
    x, y, beta, v, phi, omega = START
    slope = np.array([2e-3, -1e-3])
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    one, _ = moved(environment=(*slope, 0.8))
    other, _ = moved(start=(*(matrix @ [x, y]), beta + turn, v, phi, omega),
                     environment=(*(matrix @ slope), 0.8))  # fmt: skip
    np.testing.assert_allclose(other[:2], matrix @ one[:2], atol=1e-10)
    np.testing.assert_allclose(other[2], one[2], atol=1e-10)


def test_level_ice_and_still_air_change_nothing():
    start = InitialState(*START)
    bare = simulate(LAW(*PAPER), STONE, start, TIMES)
    same = simulate(LAW(*PAPER), STONE, start, TIMES, environment=Environment())
    np.testing.assert_array_equal(bare.x, same.x)
    np.testing.assert_allclose(moved()[0][:3], np.stack([bare.x, bare.y, bare.phi]), atol=1e-12)


def _places(p):
    return motion(jnp.array(PAPER), p[3:], p[:3])[0][:3]


def test_derivatives_by_slope_drag_and_heading_agree_with_finite_differences():
    p = np.array([2e-3, -1e-3, 0.8, *START])
    steps = {0: 1e-5, 1: 1e-5, 2: 1e-2, 5: 1e-3}  # slope_x, slope_y, drag, heading
    directions = np.eye(len(p))[list(steps)]

    @jax.jit
    def along(p):
        return jax.vmap(lambda e: jax.jvp(_places, (p,), (e,))[1])(directions)

    @jax.jit
    def last(p):
        return jax.jacrev(lambda p: _places(p)[:, 30])(p)

    forward, reverse = np.asarray(along(p)), np.asarray(last(p))
    for row, (k, step) in enumerate(steps.items()):
        e = step * np.eye(len(p))[k]
        near, far = _places(p + e) - _places(p - e), _places(p + 2 * e) - _places(p - 2 * e)
        difference = np.asarray(8 * near - far) / (12 * step)
        size = np.abs(forward[row]).max()
        np.testing.assert_allclose(forward[row], difference, rtol=0, atol=2e-6 * size)
        np.testing.assert_allclose(reverse[:, k], forward[row, :, 30], rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("heading", [None, 0.05])
def test_aim_on_sloping_ice_comes_to_rest_on_the_target(heading):
    environment, target = Environment(1e-3, -5e-4, 0.8), (0.4, 25.0)
    found = aim(LAW(*PAPER), STONE, target, omega0=1.2, start=(0.1, -3.0), heading=heading,
                environment=environment)  # fmt: skip
    path, _ = moved(start=(0.1, -3.0, found.heading, found.v0, 0.0, 1.2),
                    environment=(1e-3, -5e-4, 0.8))  # fmt: skip
    assert path[1, -1] == pytest.approx(25.0, abs=5e-8)
    if heading is None:
        assert path[0, -1] == pytest.approx(0.4, abs=5e-8)
    else:
        assert found.heading == heading
    level = aim(LAW(*PAPER), STONE, target, omega0=1.2, start=(0.1, -3.0), heading=heading)
    assert found.v0 > level.v0 + 0.01  # uphill, and through the air
    if heading is None:
        assert found.heading < level.heading - 1e-3  # the ice falls to the right
