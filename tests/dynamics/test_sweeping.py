"""Sweeping, and friction that changes along the sheet."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.dynamics.contact import accelerations
from curlfit.environment import WEAR_KNOTS, Environment

pytestmark = pytest.mark.numerical

LAW, STONE = LAWS["front-back"](0.0018, 0.058, 0.009, 0.009), Stone()
START = InitialState(v=2.06, omega=1.005, heading=0.3)
TIMES = np.linspace(0.0, 20.0, 61)
ENVIRONMENT = Environment(1e-3, -5e-4, 0.8, wear=0.003, sweep=0.8, swept_from=5.03, swept_to=9.41)
WORN = replace(ENVIRONMENT, wear_10=0.06, wear_20=-0.04, wear_30=0.05)

friction = jax.jit(partial(accelerations, stone=STONE, load="uniform"))


@pytest.mark.parametrize(
    ("environment", "error"),
    # the third derivative of the friction jumps where the stone passes a knot
    [(ENVIRONMENT, 5e-8), (WORN, 1e-6)],
)
def test_path_agrees_with_order_8_integration_in_pieces(environment, error):
    found = simulate(LAW, STONE, START, TIMES, environment=environment).to_numpy()
    k = ENVIRONMENT.drag_rate(STONE.m)
    knots = CubicSpline(
        [0.0, 10.0, 20.0, 30.0],
        [0.0, environment.wear_10, environment.wear_20, environment.wear_30],
        bc_type="natural",
    )

    def rates(_, state, sweep):
        x, y, beta, v, _, omega = state
        s, c = np.sin(beta), np.cos(beta)
        a = friction(LAW, v=v, omega=omega)
        along = x * np.sin(START.heading) + y * np.cos(START.heading)
        factor = sweep * (1 + 0.003 * along + float(knots(along)))
        assert along < 30
        g_eta = 9.81 * (s * ENVIRONMENT.slope_x + c * ENVIRONMENT.slope_y)
        g_xi = 9.81 * (c * ENVIRONMENT.slope_x - s * ENVIRONMENT.slope_y)
        a_eta = factor * float(a.eta) + g_eta - k * v**2
        return [v * s, v * c, (factor * float(a.xi) + g_xi) / v, a_eta, omega,
                factor * float(a.angular)]  # fmt: skip

    state, parts = [0.0, 0.0, START.heading, START.v, 0.0, START.omega], []
    for begin, end, sweep in ((0, 5.03, 1.0), (5.03, 9.41, 0.8), (9.41, 20.0, 1.0)):
        inside = (begin <= TIMES) & ((end > TIMES) | (end == TIMES[-1]))
        solution = solve_ivp(
            rates, (begin, end), state, args=(sweep,), method="DOP853", rtol=1e-12, atol=1e-14,
            dense_output=True,
        )  # fmt: skip
        state = solution.y[:, -1]
        parts.append(solution.sol(TIMES[inside])[[0, 1, 4]])
    exact = np.concatenate(parts, 1)
    assert np.abs(np.stack([found.x, found.y, found.phi]) - exact).max() < error


def test_sweeping_and_times_are_counted_from_the_same_zero():
    one = simulate(LAW, STONE, START, TIMES, environment=ENVIRONMENT)
    later = replace(ENVIRONMENT, swept_from=64 + 5.03, swept_to=64 + 9.41)
    for t0 in (None, 64.0):
        other = simulate(LAW, STONE, START, 64 + TIMES, environment=later, t0=t0)
        np.testing.assert_allclose(other.x, one.x, atol=1e-12)
        np.testing.assert_allclose(other.y, one.y, atol=1e-12)
        assert other.rest == pytest.approx(64 + float(one.rest), abs=1e-9)


def test_a_stone_that_is_swept_all_along_has_less_friction():
    swept = Environment(sweep=0.7, swept_from=-1.0, swept_to=1e3)
    found = simulate(LAW, STONE, START, TIMES, environment=swept)
    less = LAWS["front-back"](*(0.7 * getattr(LAW, item.name) for item in LAW.coefficients()))
    expected = simulate(less, STONE, START, TIMES)
    np.testing.assert_allclose(found.x, expected.x, atol=2e-8)
    np.testing.assert_allclose(found.phi, expected.phi, atol=2e-8)


def test_before_it_is_swept_a_stone_knows_nothing_of_it():
    swept = simulate(LAW, STONE, START, TIMES, environment=ENVIRONMENT)
    never = replace(ENVIRONMENT, swept_from=math.inf)
    not_swept = simulate(LAW, STONE, START, TIMES, environment=never)
    before = TIMES < 5.0
    np.testing.assert_allclose(swept.y[before], not_swept.y[before], atol=2e-8)
    assert swept.y[-1] > not_swept.y[-1] + 0.5


def test_friction_along_the_sheet_is_a_natural_spline():
    """Beyond the last knot it goes on as a line; equal steps make the line that `wear` is."""
    values = [0.1, -0.2, 0.3]
    knots = CubicSpline([0.0, 10.0, 20.0, 30.0], [0.0, *values], bc_type="natural")
    environment = Environment(wear_10=values[0], wear_20=values[1], wear_30=values[2])
    slope, *bends = environment.wear_along()
    y = np.linspace(0.0, 30.0, 31)
    found = sum(bend * np.maximum(y - k, 0) ** 3 for bend, k in zip(bends, WEAR_KNOTS, strict=True))
    np.testing.assert_allclose(slope * y + found, knots(y), atol=1e-13)
    assert sum(bends) == pytest.approx(0.0, abs=1e-15)
    straight = Environment(wear_10=0.1, wear_20=0.2, wear_30=0.3).wear_along()
    assert straight == pytest.approx(Environment(wear=0.01).wear_along(), abs=1e-15)


@pytest.mark.parametrize("name", ["sweep", "wear", "wear_20"])
def test_derivatives_agree_with_finite_differences(name):
    values = {key: float(value) for key, value in vars(WORN).items()}

    @jax.jit
    def last(value):
        environment = Environment(**(values | {name: value}))
        path = simulate(LAW, STONE, START, TIMES, environment=environment, t0=0.0)
        return path.y[-1]

    step = 1e-3 * max(abs(values[name]), 0.01)
    difference = (last(values[name] + step) - last(values[name] - step)) / (2 * step)
    assert jax.grad(last)(values[name]) == pytest.approx(float(difference), rel=1e-5)
