"""Each law: its path by an independent integration, its derivatives, its
closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_laws import motion_of_the_whole, reference
from independent_motion import G

import curlfit
from curlfit import LAWS, InitialState, Stone, find_law, simulate
from curlfit.dynamics.contact import accelerations
from curlfit.friction import LOADS
from curlfit.friction.curl import can_curl, law_in_general
from curlfit.reports.fit import document

STONE = Stone(R=0.065, rho=0.1, h=0.057)
ROWS = 61  # of all paths, so that a law has one program for each load


def places(path):
    return np.stack([path.x, path.y, path.phi])


LAWS_OF_THE_RING = [
    ("coulomb", (0.01,)),
    ("power", (0.008, -0.5)),
    ("power", (0.006, -0.7)),
    ("power", (0.008, 0.7)),
    ("power", (0.004, 2.0)),
    ("pressure", (0.01, 0.5)),
    ("pressure", (0.01, 1.5)),
    ("angular", (0.009, 0.3)),
    ("angular", (0.009, -0.8)),
    ("stribeck", (0.006, 0.002)),
    ("stribeck", (0.02, -0.004)),
    ("debris", (0.013, 0.008)),
    ("debris", (0.013, 0.008, 2.0)),
    ("radial", (0.006, 0.012, 0.006, 0.012)),
    ("radial", (0.02, 0.003, 0.01, 0.015)),
    ("tensor", (0.02, 0.009, 0.0005)),
    ("front-back", (0.005, 0.05, 0.009, 0.009)),
    ("power-angular", (0.008, -0.5, 0.4)),
    ("sutor", (0.0066, 2.0, 2.0, 0.2, 0.065)),
    ("power+sideways", (0.008, -0.5, 0.005, -0.5)),
    ("power+sideways", (0.008, 0.0, 0.005, 2.0)),
    ("power+transverse", (0.008, -0.5, 0.05)),
    ("power+deflection", (0.008, -0.25, 0.005, 0.5)),
    ("power+deflection", (0.008, 0.0, 0.007, 1.0)),
    ("power+pivot", (0.008, -0.5, 1.1e-4)),
    ("power+pivot", (0.008, 0.0, 1e-3)),  # its spin ends early
    ("front-back+sideways", (0.005, 0.05, 0.009, 0.009, 0.005, 2.0)),
]
UNLIKE = ("power", "pressure", "debris", "front-back")
"""Laws whose paths under the consistent load are found in different ways: by sums over
the ring, with a load that is iterated, with a moving edge, and in closed form. The
force of every law under it is tested by itself."""
THROW = InitialState(x=1.0, y=-2.0, heading=0.3, v=2.0, phi=0.5, omega=1.5)
EXACT = 5e-8  # m and rad; the book promises 1e-7
FAST_SPIN = InitialState(heading=-0.2, v=0.6, omega=-25.0)  # epsilon = -2.7
SLOW = pytest.mark.slow


def assert_path(name, values, start, until, load="uniform"):
    """That of an integration which shares no code with the program."""
    times = np.linspace(0, until, ROWS)
    path = simulate(find_law(name)(*values), STONE, start, times, load=load)
    exact = reference(name, values, load, STONE).path(start, times)
    assert np.abs(places(path) - exact).max() < EXACT


@pytest.mark.parametrize(("name", "values"), LAWS_OF_THE_RING)
def test_path_agrees_with_an_independent_integration(name, values):
    assert_path(name, values, FAST_SPIN, 60)


@pytest.mark.numerical
@pytest.mark.parametrize("name", UNLIKE)
def test_path_under_a_consistent_load_agrees_too(name):
    assert_path(name, dict(LAWS_OF_THE_RING)[name], THROW, 60, "consistent")


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("name", "values", "v", "omega"),
    [
        # |epsilon| = 1 with some nine seconds to go
        ("power", (0.008, -0.5), 2.3, 9.0),
        ("angular", (0.009, 0.3), 1.8, 9.3),
        # |epsilon| = 1 from the start
        ("coulomb", (0.01,), 1.3, 20.0),
        ("front-back", (0.005, 0.05, 0.009, 0.008), 2.6, -40.0),
        # a hard throw
        ("power", (0.008, -0.5), 6.0, 60.0),
    ],
)
def test_path_agrees_over_the_kink(name, values, v, omega):
    assert_path(name, values, InitialState(v=v, omega=omega), 150)


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("values", "omega"),
    [
        ((0.013, 0.008), -1.0),
        ((0.013, 0.008), 0.05),  # turns back, and back again
        ((0.013, 0.008), 0.45),
        ((0.008, 0.013), -0.1),
    ],
)
def test_path_of_debris_agrees_through_and_short_of_half_a_turn(values, omega):
    assert_path("debris", values, InitialState(heading=0.3, v=2.0, omega=omega), 19)


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("values", "omega"),
    [
        ((0.005, 0.085, 0.0, 0.025, -0.3), 1.0),  # spins until it stops
        ((0.005, 0.085, -0.5, 0.025, 0.5), -1.7),
        ((0.05, 0.085, 0.0, 0.3, -0.3), -1.7),  # the spin ends first
        ((0.005, 0.085, 0.5, 0.3, 0.7), 1.0),
        ((0.005, 0.085, 1.5, 0.1, 0.7), -1.7),  # never stops
    ],
)
def test_path_of_semi_empirical_agrees_with_an_independent_integration(values, omega):
    times = np.linspace(0, 60, ROWS)
    start = replace(THROW, omega=omega)
    path = simulate(LAWS["semi-empirical"](*values), STONE, start, times)
    exact = motion_of_the_whole("semi-empirical", values, STONE, start, times[-1])
    assert np.abs(places(path) - exact.at(times)).max() < EXACT


def test_no_two_laws_are_the_same_to_jit():
    structures = [jax.tree.structure(law()) for law in LAWS.values()]
    assert all(a != b for a, b in combinations(structures, 2))


def _path(p, times, name, load, xp=np):
    law = LAWS[name].from_vector(p)
    start = InitialState(heading=0.3, v=p[-2], omega=p[-1])
    path = simulate(law, STONE, start, times, load=load, t0=0.0)
    return xp.stack([path.x, path.y, path.phi])


_forward = jax.jit(jax.jacfwd(partial(_path, xp=jnp)), static_argnames=("name", "load"))


@pytest.mark.parametrize(
    ("name", "values", "load"),
    [  # laws of one kind have one code path; front-back is in test_motion.py
        ("power", (0.004, 2.0), "uniform"),
        pytest.param("tensor", (0.02, 0.009, 0.0005), "uniform", marks=SLOW),
        ("debris", (0.013, 0.008, 2.0), "uniform"),
        ("debris", (0.013, 0.008, 0.0), "uniform"),
        pytest.param(
            "semi-empirical", (0.005, 0.085, 0.1, 0.1, -0.3), "uniform", marks=SLOW
        ),
        pytest.param("pressure", (0.01, 1.5), "uniform", marks=SLOW),
        pytest.param("stribeck", (0.02, -0.004), "consistent", marks=SLOW),
        pytest.param("radial", (0.02, 0.003, 0.01, 0.015), "consistent", marks=SLOW),
    ],
)
def test_derivatives_agree_with_finite_differences(name, values, load):
    # Half a turn, where debris has a corner, is done at 2.2 s.
    times = np.array([0.0, 1.0, 2.0, 2.15, 2.2, 2.25, 2.4, 3.0, 6.0, 12.0, 20.0, 40.0])
    times = np.pad(times, (0, ROWS - len(times)), mode="edge")
    p = np.array([*values, 2.0, 1.5])
    forward = np.asarray(_forward(p, times, name=name, load=load))
    for k in np.flatnonzero(p):
        step = np.zeros_like(p)
        step[k] = 1e-4 * max(abs(p[k]), 1e-3)
        near, far = (
            _path(p + n * step, times, name, load)
            - _path(p - n * step, times, name, load)
            for n in (1, 2)
        )
        difference = (8 * near - far) / (12 * step[k])
        size = np.abs(forward[..., k]).max()
        np.testing.assert_allclose(
            forward[..., k],
            difference,
            rtol=0,
            atol=1e-6 * size + 1e-10,
            err_msg=str(k),
        )


net = jax.jit(accelerations, static_argnames="load")


def over_weight(name, values, load, *motion, of=net):
    """Of v, omega and the angle turned, which is 0 where not given."""
    # of one type, for one program
    motion = [np.float64(quantity) for quantity in (*motion, 0.0)[:3]]
    a = of(find_law(name)(*values), STONE, load, *motion)
    return np.array([a.xi, a.eta, a.angular * STONE.rho**2 / STONE.R]) / G


_slopes = jax.jit(jax.jacfwd(accelerations, 5), static_argnames="load")


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize(("v", "omega"), [(2.0, 1.5), (0.6, -25.0)])
@pytest.mark.parametrize("turned", [1e-9, 2.0, np.pi - 1e-9, np.pi + 1e-9])
def test_edge_of_debris_moves_the_force_by_its_jump(turned, v, omega, load):
    turned *= np.sign(omega)
    values = 0.013, 0.008
    slopes = over_weight("debris", values, load, v, omega, turned, of=_slopes)
    if abs(turned) < np.pi:
        edge = turned - np.pi if turned > 0 else turned
        c = np.cos(edge)
        s = np.sin(edge)
        sliding = np.array([-STONE.R * omega * s, v + STONE.R * omega * c])
        jump = np.sign(turned) * 0.005 / (2 * np.pi) * sliding / np.hypot(*sliding)
        jump = np.array([*jump, c * jump[1] - s * jump[0]])
    else:
        jump = np.zeros(3)
    if load == "uniform":
        np.testing.assert_allclose(slopes, jump, rtol=1e-9, atol=1e-15)
        return
    # The load shifts with the force; a step within one side of the corners
    step = 1e-5 if 1e-5 < abs(turned) < np.pi - 1e-5 else 2e-10
    ahead, behind = (
        over_weight("debris", values, load, v, omega, turned + side * step)
        for side in (1, -1)
    )
    difference = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(
        slopes, difference, rtol=0, atol=1e-9 if step == 1e-5 else 1e-6
    )


ALIKE = (
    "coulomb",
    "tensor",
    "angular",
    "power-angular",
    "sutor",
    "power+sideways",
    "power+transverse",
)
"""Laws that do not see the load, of which others are: in closed form, by sums over the
ring, and with a push."""


@pytest.mark.parametrize(
    ("name", "values"),
    [
        pytest.param(*law, marks=SLOW if law[0] in ALIKE else ())
        for law in LAWS_OF_THE_RING
    ],
)
def test_consistent_load_balances_the_friction(name, values):
    dense = reference(name, values, "consistent", STONE)
    for v, omega in ((2.0, 1.0), (2.0, -9.0), (0.5, 25.0), (1.0, 0.0)):
        force = over_weight(name, values, "consistent", v, omega)
        np.testing.assert_allclose(
            force, dense.force(v, STONE.R * omega), rtol=0, atol=1e-12
        )


def test_a_load_is_found_though_a_step_towards_it_goes_too_far():
    # From the uniform load, Newton's first step is to a tilt beyond 1.
    force = over_weight("pressure", (0.6, 0.5), "consistent", 2.0, 0.5)
    tilt = -2 * STONE.h / STONE.R * force[:2]
    assert 0.9 < np.hypot(*tilt) < 1
    dense = reference("pressure", (0.6, 0.5), "consistent", STONE)
    exact = dense.net(dense.ring(2.0, STONE.R * 0.5), tilt)
    # the ring is summed less densely
    np.testing.assert_allclose(force, exact, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "within", "beyond"),
    # without spin q = 2 (h/R) mu, and n >= 0 behind needs q <= 1
    [
        ("front-back", (0.9, 0.9, 0.570, 0.570), (0.9, 0.9, 0.571, 0.571)),
        ("pressure", (0.3, 0.5), (0.9, 0.5)),
        ("stribeck", (0.370, 0.1), (0.371, 0.1)),
    ],
)
def test_a_load_that_would_have_to_be_negative_is_refused(name, within, beyond):
    assert np.isfinite(over_weight(name, within, "consistent", 2.0, 0.0)).all()
    assert np.isnan(over_weight(name, beyond, "consistent", 2.0, 0.0)).all()
    if name in UNLIKE:
        times = np.linspace(0, 1, ROWS)
        start = InitialState(v=2.0, omega=0.0)
        path = simulate(LAWS[name](*beyond), STONE, start, times, load="consistent")
        assert np.isnan(path.y[1:]).all()


@pytest.mark.parametrize("name", UNLIKE)
def test_only_laws_that_see_the_load_repeat_its_solution(name):
    program = str(
        jax.make_jaxpr(lambda law: accelerations(law, STONE, "consistent", 2.0, 1.0))(
            LAWS[name]()
        )
    )
    assert ("while" in program) == (name == "pressure")


@pytest.mark.parametrize(
    ("name", "load"),
    [
        *((name, "uniform") for name in sorted(LAWS)),
        *((name, "consistent") for name in UNLIKE),
    ],
)
def test_a_throw_in_the_mirror(name, load):
    law = LAWS[name]()
    mirrored = replace(law, b12=-law.b12) if name == "tensor" else law
    times = np.linspace(0, 19, ROWS)
    start = InitialState(heading=0.2, v=2.0, omega=2.0)
    path = simulate(law, STONE, start, times, load=load)
    mirror_path = simulate(
        mirrored, STONE, replace(start, heading=-0.2, omega=-2.0), times, load=load
    )
    aside = abs(path.x[-1] - path.y[-1] * np.tan(0.2))
    assert np.isfinite(aside)
    if load == "consistent":  # under uniform load some laws do not curl
        assert aside > 1e-6
    np.testing.assert_allclose(
        places(mirror_path), places(path) * [[-1], [1], [-1]], atol=1e-11
    )
    # whether it curls is said without a path: more than 3 cm in 28 m, from 2 m/s
    general = simulate(
        law_in_general(LAWS[name]),
        STONE,
        InitialState(v=2.0, omega=1.2),
        np.linspace(0, 12, ROWS),
        load=load,
    )
    curls = abs(general.x[-1]) > 0.03 * general.y[-1] / 28
    # debris pushes to one side, and after half a turn to the other
    assert can_curl(LAWS[name], load, STONE) == (curls or name == "debris")


@pytest.mark.parametrize(
    "values", [(0.01, 0.01, 0.011), (0.01, 0.01, -0.011), (0.0, 0.01, 0.0)]
)
def test_a_tensor_that_is_not_positive_definite_is_named(values):
    assert "not positive definite" in LAWS["tensor"](*values).fault()
    assert LAWS["tensor"](0.01, 0.01, -0.009).fault() is None


def test_a_sum_that_nobody_listed_is_fitted_saved_and_read(tmp_path):
    """Its law is found by the names of its parts, also in another process."""
    throw = curlfit.synthetic_throw(
        curlfit.law_with("coulomb+sideways", {"mu": 0.009, "a": 0.005, "n": 0.0}),
        STONE,
        noise_xy=0.005,
        noise_phi=0.01,
    )
    fit = curlfit.fit(throw, "coulomb+sideways")
    fit.save(tmp_path / "fit.json")
    again = curlfit.load_fit(tmp_path)
    assert again.law_class.parts == fit.law_class.parts
    assert again.parameters["mu"].value == pytest.approx(0.009, rel=1e-3)
    assert "coulomb+sideways law" in str(document(again))
