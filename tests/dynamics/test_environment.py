"""Ice that is not level or worn, sweeping, and the air: scipy, closed forms,
derivatives, aim."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_motion import G
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from curlfit import LAWS, InitialState, Stone, aim, simulate
from curlfit.dynamics.contact import accelerations
from curlfit.environment import AIR_DENSITY, FRONTAL_AREA, WEAR_KNOTS, Environment

pytestmark = pytest.mark.numerical

LAW = LAWS["front-back"]
PAPER = (0.0004, 0.0555, 0.009, 0.0083)
STONE = Stone(m=19.0, R=0.06, rho=0.1)
TIMES = np.linspace(0.0, 40.0, 41)
START = (1.0, -2.0, 0.3, 2.1, 0.5, 1.3)  # x, y, heading, v, phi, omega

friction = jax.jit(partial(accelerations, stone=STONE, load="uniform"))


LEVEL = Environment()
NAMES = [*vars(LEVEL), *vars(InitialState())]
STEPS = {
    "slope_x": 1e-5,
    "slope_y": 1e-5,
    "drag": 1e-2,
    "sweep": 1e-3,
    "wear_20": 1e-4,
    "heading": 1e-3,
}
DIRECTIONS = np.array([[name == step for name in NAMES] for step in STEPS], float)


@jax.jit
def motion(mu, p, times):
    """x, y, phi, vx, vy, omega and the time of rest, and their slopes in the
    directions, by vectors, so that one program serves all."""

    def found(p):
        path = simulate(
            LAW.from_vector(mu),
            STONE,
            InitialState(*p[len(vars(LEVEL)) :]),
            times,
            t0=0.0,
            environment=Environment(*p[: len(vars(LEVEL))]),
        )
        return jnp.stack(
            [path.x, path.y, path.phi, path.vx, path.vy, path.omega]
        ), path.rest

    along = jax.vmap(lambda e: jax.jvp(found, (p,), (e,)), out_axes=(None, 0))
    return along(jnp.asarray(DIRECTIONS))


def moved(mu=PAPER, start=START, environment=LEVEL, times=TIMES):
    p = np.array([*vars(environment).values(), *start], float)
    (path, rest), _ = motion(np.array(mu, float), p, np.array(times))
    return np.asarray(path), float(rest)


SWEPT = (5.03, 9.41)
WORN = Environment(
    1e-3,
    -5e-4,
    0.8,
    wear=0.003,
    wear_10=0.06,
    wear_20=-0.04,
    wear_30=0.05,
    sweep=0.8,
    swept_from=SWEPT[0],
    swept_to=SWEPT[1],
)


def integrated(environment, start, mu=PAPER, times=TIMES):
    """x, y, phi by scipy's method of order 8, and the last time, which is
    that of rest."""
    law = LAW(*mu)
    first = start[2]
    k = 0.5 * AIR_DENSITY * FRONTAL_AREA / STONE.m * environment.drag
    knots = CubicSpline(
        [0.0, 10.0, 20.0, 30.0],
        [0.0, environment.wear_10, environment.wear_20, environment.wear_30],
        bc_type="natural",
    )

    def rates(_, state, sweep):
        x, y, v, beta, _, omega = state
        s = np.sin(beta)
        c = np.cos(beta)
        a = friction(law, v=v, omega=omega)
        along = (x - start[0]) * np.sin(first) + (y - start[1]) * np.cos(first)
        factor = sweep * (1 + environment.wear * along + float(knots(along)))
        down = G * (s * environment.slope_x + c * environment.slope_y) - k * v**2
        aside = G * (c * environment.slope_x - s * environment.slope_y)
        turning = (factor * float(a.xi) + aside) / v
        return [
            v * s,
            v * c,
            factor * float(a.eta) + down,
            turning,
            omega,
            factor * float(a.angular),
        ]

    def rest(_, state, sweep):
        v = state[2]
        u = STONE.rho * abs(state[5])
        return min(np.hypot(v, u) - 1e-7, max(v - 1e-9, u - 2e-6))

    rest.terminal = True
    x, y, beta, v, phi, omega = start
    state = [x, y, v, beta, phi, omega]
    path = np.empty((3, len(times)))
    swept = environment.swept_from < times[-1]
    ends = (0.0, *SWEPT, times[-1]) if swept else (0.0, times[-1])
    for number, (begin, end) in enumerate(pairwise(ends)):
        part = solve_ivp(
            rates,
            (begin, end),
            state,
            args=(environment.sweep if number == 1 else 1.0,),
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            events=rest,
            dense_output=True,
        )
        assert part.success
        later = times >= begin
        path[:, later] = part.sol(np.minimum(times[later], part.t[-1]))[[0, 1, 4]]
        state = part.y[:, -1]
    return path, part.t[-1]


@pytest.mark.parametrize(
    ("environment", "start"),
    [
        (Environment(2e-3, -1e-3, 0.8), START),
        (Environment(-1e-3, 2e-3, 3.0), (0.0, 0.0, -0.7, 2.5, 0.0, -4.0)),
        (Environment(1e-4, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0, 0.0, 1.0)),
    ],
)
def test_path_to_rest_agrees_with_order_8_integration(environment, start):
    path, rest = moved(start=start, environment=environment)
    exact, end = integrated(environment, start)
    assert np.abs(path[:3] - exact).max() < 1e-7  # m, m, rad
    assert rest == pytest.approx(end, abs=1e-5)


@pytest.mark.parametrize(
    ("environment", "error"),
    # the third derivative of the friction jumps where the stone passes a knot
    [(replace(WORN, wear_10=0.0, wear_20=0.0, wear_30=0.0), 5e-8), (WORN, 1e-6)],
)
def test_path_of_a_swept_stone_on_worn_ice_agrees_with_integration_in_pieces(
    environment, error
):
    times = TIMES / 2
    start = (0.0, 0.0, 0.3, 2.06, 0.0, 1.005)
    path, _ = moved(start=start, environment=environment, times=times)
    assert (
        np.abs(path[:3] - integrated(environment, start, times=times)[0]).max() < error
    )


def test_sweeping_and_times_are_counted_from_the_same_zero():
    early_path, rest = moved(environment=WORN)
    later = replace(WORN, swept_from=64 + SWEPT[0], swept_to=64 + SWEPT[1])
    path = simulate(
        LAW(*PAPER), STONE, InitialState(*START), 64 + TIMES, environment=later
    )
    np.testing.assert_allclose(np.stack([path.x, path.y]), early_path[:2], atol=1e-12)
    assert path.rest == pytest.approx(64 + rest, abs=1e-9)


def test_constant_friction_and_a_slope_along_the_throw_decelerate_uniformly():
    mu = 0.012
    slope = 2e-3
    v = 1.7
    loss = G * (mu - slope)
    path, rest = moved((mu,) * 4, (0, 0, 0, v, 0, 0), Environment(slope_y=slope))
    t = np.minimum(TIMES, v / loss)
    np.testing.assert_allclose(path[1], v * t - loss * t**2 / 2, atol=1e-8)
    np.testing.assert_allclose(path[4], v - loss * t, atol=1e-7)
    np.testing.assert_allclose(path[0], 0, atol=1e-14)
    assert rest == pytest.approx(v / loss, abs=1e-6)


def test_without_friction_a_stone_falls_as_a_stone_thrown_in_vacuum():
    """slope_x > 0 falls to the right, slope_y > 0 along the throw; the spin stays."""
    path, _ = moved((0,) * 4, START, Environment(3e-4, 2e-4))
    x, y, beta, v, phi, omega = START
    np.testing.assert_allclose(
        path[0], x + v * np.sin(beta) * TIMES + G * 3e-4 * TIMES**2 / 2, atol=1e-7
    )
    np.testing.assert_allclose(
        path[1], y + v * np.cos(beta) * TIMES + G * 2e-4 * TIMES**2 / 2, atol=1e-7
    )
    np.testing.assert_allclose(path[2], phi + omega * TIMES, atol=1e-9)


def test_the_air_alone_slows_with_the_square_of_the_speed():
    drag = 5.0
    v = 2.5
    path, _ = moved((0,) * 4, (0, 0, 0, v, 0, 1), Environment(drag=drag))
    k = Environment(drag=drag).drag_rate(STONE.m)
    assert k == pytest.approx(0.5 * 1.27 * (0.914 / np.pi * 0.114) * drag / 19.0)
    np.testing.assert_allclose(path[4], v / (1 + k * v * TIMES), atol=1e-8)
    np.testing.assert_allclose(path[1], np.log1p(k * v * TIMES) / k, atol=1e-7)


def test_derivatives_agree_with_finite_differences():
    p = np.array([*vars(WORN).values(), *START], float)
    mu = np.array(PAPER)

    def places(p):
        return np.asarray(motion(mu, p, TIMES)[0][0][:3])

    _, (forward, _) = motion(mu, p, TIMES)
    for slope, e, step in zip(forward[:, :3], DIRECTIONS, STEPS.values(), strict=True):
        near, far = (
            places(p + k * step * e) - places(p - k * step * e) for k in (1, 2)
        )
        difference = (8 * near - far) / (12 * step)
        tolerance = 2e-6 * np.abs(slope).max()
        np.testing.assert_allclose(slope, difference, rtol=0, atol=tolerance)


@pytest.mark.parametrize("heading", [None, 0.05])
def test_aim_on_sloping_ice_comes_to_rest_on_the_target(heading):
    environment = Environment(1e-3, -5e-4, 0.8)
    target = (0.4, 25.0)
    release = aim(
        LAW(*PAPER),
        STONE,
        target,
        omega0=1.2,
        start=(0.1, -3.0),
        heading=heading,
        environment=environment,
    )
    path, _ = moved(
        start=(0.1, -3.0, release.heading, release.v0, 0.0, 1.2),
        environment=environment,
    )
    assert path[1, -1] == pytest.approx(25.0, abs=5e-8)
    if heading is None:
        assert path[0, -1] == pytest.approx(0.4, abs=5e-8)
    else:
        assert release.heading == heading
    level = aim(
        LAW(*PAPER), STONE, target, omega0=1.2, start=(0.1, -3.0), heading=heading
    )
    assert release.v0 > level.v0 + 0.01  # uphill, and through the air
    if heading is None:
        assert release.heading < level.heading - 1e-3  # the ice falls to the right


def test_friction_along_the_sheet_is_a_natural_spline():
    """Beyond the last knot it goes on as a line; equal steps make the line
    that `wear` is."""
    values = [0.1, -0.2, 0.3]
    knots = CubicSpline([0.0, 10.0, 20.0, 30.0], [0.0, *values], bc_type="natural")
    environment = Environment(wear_10=values[0], wear_20=values[1], wear_30=values[2])
    slope, *bends = environment.wear_along()
    y = np.linspace(0.0, 30.0, 31)
    curved_part = sum(
        bend * np.maximum(y - k, 0) ** 3
        for bend, k in zip(bends, WEAR_KNOTS, strict=True)
    )
    np.testing.assert_allclose(slope * y + curved_part, knots(y), atol=1e-13)
    assert sum(bends) == pytest.approx(0.0, abs=1e-15)
    straight = Environment(wear_10=0.1, wear_20=0.2, wear_30=0.3).wear_along()
    assert straight == pytest.approx(Environment(wear=0.01).wear_along(), abs=1e-15)
