"""Each law: its path by an independent integration, its derivatives, its closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import G, Reference, follow, front_back

from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.dynamics.contact import accelerations, contact_of
from curlfit.dynamics.ring_forces import ring_forces
from curlfit.dynamics.ring_sum import balanced_tilt
from curlfit.friction import LOADS

STONE = Stone(R=0.065, rho=0.1, h=0.057)
ROWS = 61  # of all paths, so that a law has one program for each load


def against(mu):
    """Friction against sliding, its coefficient a function of the ring and the load."""

    def traction(ring, load):
        over = mu(ring, load) / ring.speed
        return -over * ring.v_xi, -over * ring.v_eta

    return traction


def debris(mu_clean, mu_dirty, tau=0.0):
    def mu(ring, _):
        # Turned back to where the front half was at release, then round with the stone.
        round_ = np.mod(ring.alpha if ring.turned >= 0 else np.pi - ring.alpha, 2 * np.pi)
        fouled = round_ < np.pi + abs(ring.turned)
        share = 1 - np.exp(-ring.time / tau) if tau > 0 else 1.0
        return np.where(fouled, mu_clean + share * (mu_dirty - mu_clean), mu_clean)

    return against(mu)


def radial(mu1, mu2, mu3, mu4):
    def traction(ring, _):
        # v = a n + b tau, n = (cos, sin), tau = (-sin, cos)
        c, s = ring.xi, ring.eta
        a, b = ring.v_xi * c + ring.v_eta * s, ring.v_eta * c - ring.v_xi * s
        a = np.where(s > 0, mu1, mu2) * a
        b = np.where(s > 0, mu3, mu4) * b
        return -(a * c - b * s) / ring.speed, -(a * s + b * c) / ring.speed

    return traction


def tensor(b11, b22, b12):
    def traction(ring, _):
        force = -np.array([[b11, b12], [b12, b22]]) @ np.stack([ring.v_xi, ring.v_eta])
        return force / ring.speed

    return traction


FORMULAS = {
    "coulomb": lambda mu: against(lambda ring, load: mu),
    "power": lambda c, k: against(lambda ring, load: c * (ring.speed**2 + 1e-6) ** (k / 2)),
    "pressure": lambda mu0, k: against(lambda ring, load: mu0 / load**k),
    "angular": lambda mu0, f0: against(lambda ring, load: mu0 * (1 - f0 * np.sin(ring.alpha))),
    "stribeck": lambda mu0, mu1: against(lambda ring, load: mu0 + mu1 * ring.speed / load),
    "debris": debris,
    "radial": radial,
    "tensor": tensor,
    "front-back": front_back,
}


def reference(name, values, load, stone=STONE):
    more = {}
    if name == "debris":
        more["edges"] = lambda turned: (
            () if abs(turned) >= np.pi else (turned - np.pi if turned >= 0 else turned,)
        )
        more["corner"] = np.pi
    return Reference(
        FORMULAS[name](*values), stone.R, stone.rho, stone.h if load == "consistent" else None,
        **more,
    )  # fmt: skip


def semi_empirical(values, start, times):
    a, c, p, q, r = values
    sense = np.sign(start.omega)

    def spinning(v, *_):
        return -a * sense, -c * abs(v) ** p, -q * abs(v) ** r * sense

    def sliding(v, *_):
        return 0.0, -c * abs(v) ** p, 0.0

    return follow(start, times, [(spinning, lambda omega, _: omega * sense), (sliding, None)], None)


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
]
THROW = InitialState(x=1.0, y=-2.0, heading=0.3, v=2.0, phi=0.5, omega=1.5)
EXACT = 5e-8  # m and rad; the book promises 1e-7
FAST_SPIN = InitialState(heading=-0.2, v=0.6, omega=-25.0)  # epsilon = -2.7
both_loads = pytest.mark.parametrize("load", LOADS)
any_law = pytest.mark.parametrize(("name", "values"), LAWS_OF_THE_RING)


@pytest.mark.numerical
@both_loads
@pytest.mark.parametrize("start", [THROW, FAST_SPIN], ids=["throw", "fast spin"])
@any_law
def test_path_agrees_with_an_independent_integration(name, values, load, start):
    times = np.linspace(0, 60, ROWS)
    exact = reference(name, values, load).path(start, times)
    path = simulate(LAWS[name](*values), STONE, start, times, load=load)
    assert np.abs(places(path) - exact).max() < EXACT


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("name", "values", "v", "omega"),
    [
        # |epsilon| = 1 with some nine seconds to go
        ("power", (0.008, -0.5), 2.3, 9.0),
        ("angular", (0.009, 0.3), 1.8, 9.3),
        ("coulomb", (0.01,), 2.25, 9.2),
        # |epsilon| = 1 from the start
        ("coulomb", (0.01,), 1.3, 20.0),
        ("front-back", (0.005, 0.05, 0.009, 0.008), 2.6, -40.0),
        ("power", (0.008, -0.5), 1.95, -30.0),
        # a hard throw
        ("coulomb", (0.01,), 6.0, 60.0),
        ("power", (0.008, -0.5), 6.0, 60.0),
    ],
)
def test_path_agrees_over_the_kink(name, values, v, omega):
    times, start = np.linspace(0, 150, ROWS), InitialState(v=v, omega=omega)
    exact = reference(name, values, "uniform").path(start, times)
    path = simulate(LAWS[name](*values), STONE, start, times)
    assert np.abs(places(path) - exact).max() < EXACT


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("values", "omega"),
    [
        ((0.013, 0.008), -1.0),
        ((0.013, 0.008, 0.1), -1.0),
        ((0.013, 0.008), 0.05),  # turns back, and back again
        ((0.013, 0.008), 0.2),
        ((0.013, 0.008), 0.45),
        ((0.008, 0.013), -0.1),
    ],
)
def test_path_of_debris_agrees_through_and_short_of_half_a_turn(values, omega):
    times = np.linspace(0, 19, ROWS)
    start = InitialState(heading=0.3, v=2.0, omega=omega)
    exact = reference("debris", values, "uniform").path(start, times)
    path = simulate(LAWS["debris"](*values), STONE, start, times)
    assert np.abs(places(path) - exact).max() < EXACT


@pytest.mark.numerical
@pytest.mark.parametrize("omega", [1.0, -1.7])
@pytest.mark.parametrize(
    "values",
    [
        (0.005, 0.085, 0.0, 0.025, -0.3),  # spins until it stops
        (0.005, 0.085, -0.5, 0.025, 0.5),
        (0.005, 0.085, -0.1, 0.025, 0.0),
        (0.05, 0.085, 0.0, 0.3, -0.3),  # the spin ends first
        (0.005, 0.085, 0.5, 0.3, 0.7),
        (0.005, 0.085, 1.5, 0.1, 0.7),  # never stops
    ],
)
def test_path_of_semi_empirical_agrees_with_an_independent_integration(values, omega):
    times = np.linspace(0, 60, ROWS)
    start = replace(THROW, omega=omega)
    path = simulate(LAWS["semi-empirical"](*values), STONE, start, times)
    assert np.abs(places(path) - semi_empirical(values, start, times)).max() < EXACT


def test_no_two_laws_are_the_same_to_jit():
    structures = [jax.tree.structure(law()) for law in LAWS.values()]
    assert all(a != b for a, b in combinations(structures, 2))


def _path(p, times, name, load):
    law = LAWS[name].from_vector(p)
    start = InitialState(heading=0.3, v=p[-2], omega=p[-1])
    return _stacked(simulate(law, STONE, start, times, load=load))


def _stacked(path):
    return jnp.stack([path.x, path.y, path.phi])


_forward = jax.jit(jax.jacfwd(_path), static_argnames=("name", "load"))


@pytest.mark.parametrize(
    ("name", "values", "load"),
    [
        *(
            pytest.param(
                name,
                values,
                load,
                # Laws of one kind have one code path, and loads one under every law; the edge of
                # debris under consistent load is differentiated below.
                marks=[pytest.mark.slow]
                if name in ("stribeck", "angular", "radial")
                or (load == "consistent" and name != "power")
                else [],
            )
            for name, values in dict(LAWS_OF_THE_RING).items()
            for load in LOADS
            if name != "front-back"  # in test_motion.py
        ),
        ("debris", (0.013, 0.008, 0.0), "uniform"),
        ("semi-empirical", (0.005, 0.085, 0.1, 0.1, -0.3), "uniform"),
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
            _path(p + n * step, times, name, load) - _path(p - n * step, times, name, load)
            for n in (1, 2)
        )
        difference = (8 * near - far) / (12 * step[k])
        size = np.abs(forward[..., k]).max()
        np.testing.assert_allclose(
            forward[..., k], difference, rtol=0, atol=1e-6 * size + 1e-10, err_msg=str(k)
        )


net = jax.jit(accelerations, static_argnames="load")


def consistent_load(law, stone, v, omega, turned=0.0):
    """(p, q) = (n1, n2) R/n0 of eq. 9: the consistent load is `n0 (1 + p xi/R + q eta/R)`."""
    contact = contact_of(law, stone, "consistent", v, omega, turned)
    return balanced_tilt(ring_forces(contact), contact.lever)


tilt_of_load = jax.jit(consistent_load)


def over_weight(name, values, load, *motion):
    """Of v, omega and the angle turned, which is 0 where not given."""
    motion = [np.float64(item) for item in (*motion, 0.0)[:3]]  # of one type, for one program
    a = net(LAWS[name](*values), STONE, load, *motion)
    return np.array([a.xi, a.eta, a.angular * STONE.rho**2 / STONE.R]) / G


def _debris_force(turned, v, omega, load):
    a = net(LAWS["debris"](0.013, 0.008), STONE, load, v, omega, turned)
    return jnp.stack([a.xi, a.eta, a.angular * STONE.rho**2 / STONE.R]) / G


_by_turned = jax.jit(jax.jacfwd(_debris_force), static_argnames="load")


@both_loads
@pytest.mark.parametrize(("v", "omega"), [(2.0, 1.5), (2.0, -1.0), (0.6, -25.0)])
@pytest.mark.parametrize("turned", [1e-9, 0.5, 2.0, np.pi - 1e-9, np.pi + 1e-9])
def test_edge_of_debris_moves_the_force_by_its_jump(turned, v, omega, load):
    turned *= np.sign(omega)
    force = partial(_debris_force, v=v, omega=omega, load=load)
    found = _by_turned(turned, v, omega, load=load)
    if abs(turned) < np.pi:
        edge = turned - np.pi if turned > 0 else turned
        c, s = np.cos(edge), np.sin(edge)
        sliding = np.array([-STONE.R * omega * s, v + STONE.R * omega * c])
        jump = np.sign(turned) * 0.005 / (2 * np.pi) * sliding / np.hypot(*sliding)
        jump = np.array([*jump, c * jump[1] - s * jump[0]])
    else:
        jump = np.zeros(3)
    if load == "uniform":
        np.testing.assert_allclose(found, jump, rtol=1e-9, atol=1e-15)
        return
    # The load shifts with the force; a step within one side of the corners
    step = 1e-5 if 1e-5 < abs(turned) < np.pi - 1e-5 else 2e-10
    difference = (force(turned + step) - force(turned - step)) / (2 * step)
    np.testing.assert_allclose(found, difference, rtol=0, atol=1e-9 if step == 1e-5 else 1e-6)


@any_law
@pytest.mark.parametrize(("v", "omega"), [(2.0, 1.0), (2.0, -9.0), (0.5, 25.0), (1.0, 0.0)])
def test_consistent_load_balances_the_friction(name, values, v, omega):
    dense = reference(name, values, "consistent")
    tilt = np.asarray(tilt_of_load(LAWS[name](*values), STONE, v, omega))
    force = dense.net(dense.ring(v, STONE.R * omega), tilt)
    np.testing.assert_allclose(tilt, -2 * STONE.h / STONE.R * force[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        over_weight(name, values, "consistent", v, omega), force, rtol=0, atol=1e-12
    )


@any_law
def test_force_and_normal_moment_and_the_upward_make_a_right_triple(name, values):
    # Prop. 1, with M_N = oint r x k n (eq. 2) in units of m g R
    v, omega = 2.0, 5.0
    p, q = tilt_of_load(LAWS[name](*values), STONE, v, omega)
    alpha = 2 * np.pi * np.arange(64) / 64
    xi, eta = np.cos(alpha), np.sin(alpha)
    n = 1 + p * xi + q * eta
    moment = np.array([np.mean(n * eta), -np.mean(n * xi)])
    force = over_weight(name, values, "consistent", v, omega)[:2]
    size = np.hypot(*force)
    assert force @ moment == pytest.approx(0, abs=1e-12 * size)
    assert force[0] * moment[1] - force[1] * moment[0] > 0
    assert np.hypot(*moment) == pytest.approx(STONE.h / STONE.R * size, rel=1e-10)


def test_a_load_is_found_though_a_step_towards_it_goes_too_far():
    # From the uniform load, Newton's first step is to a tilt beyond 1.
    force = over_weight("pressure", (0.6, 0.5), "consistent", 2.0, 0.5)
    tilt = np.asarray(tilt_of_load(LAWS["pressure"](0.6, 0.5), STONE, 2.0, 0.5))
    assert 0.9 < np.hypot(*tilt) < 1
    np.testing.assert_allclose(tilt, -2 * STONE.h / STONE.R * force[:2], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "within", "beyond"),
    # without spin q = 2 (h/R) mu, and n >= 0 behind needs q <= 1
    [
        ("coulomb", (0.570,), (0.571,)),
        ("tensor", (0.9, 0.570, 0.0), (0.9, 0.571, 0.0)),
        ("pressure", (0.3, 0.5), (0.9, 0.5)),
        ("stribeck", (0.370, 0.1), (0.371, 0.1)),
    ],
)
def test_a_load_that_would_have_to_be_negative_is_refused(name, within, beyond):
    assert np.isfinite(over_weight(name, within, "consistent", 2.0, 0.0)).all()
    assert np.isnan(over_weight(name, beyond, "consistent", 2.0, 0.0)).all()
    times, start = np.linspace(0, 1, ROWS), InitialState(v=2.0, omega=0.0)
    path = simulate(LAWS[name](*beyond), STONE, start, times, load="consistent")
    assert np.isnan(path.y[1:]).all()


@pytest.mark.parametrize("name", sorted(dict(LAWS_OF_THE_RING)))
def test_only_laws_that_see_the_load_repeat_its_solution(name):
    program = str(jax.make_jaxpr(lambda law: consistent_load(law, STONE, 2.0, 1.0))(LAWS[name]()))
    assert ("while" in program) == (name == "pressure")


@pytest.mark.parametrize(
    ("name", "values", "load", "omega", "right", "forward"),
    [
        ("coulomb", (0.01,), "consistent", 1, 2.9e-6, -1.0e-2),
        ("coulomb", (0.01,), "consistent", 10, 2.7e-5, -9.7e-3),
        ("coulomb", (0.01,), "consistent", 40, 3.4e-5, -4.2e-3),
        ("coulomb", (0.01,), "consistent", 200, 6.8e-6, -7.7e-4),
        ("power", (0.008, -0.5), "consistent", 1, 9.1e-7, -5.7e-3),
        ("power", (0.008, -0.5), "consistent", 10, 8.8e-6, -5.5e-3),
        ("power", (0.008, -0.5), "consistent", 40, 4.9e-6, -1.2e-3),
        ("stribeck", (0.01, 0.002), "consistent", 1, 4.0e-6, "negative"),
        ("stribeck", (0.01, 0.002), "consistent", 40, 6.6e-5, "negative"),
        ("stribeck", (0.01, 0.002), "consistent", 100, 4.8e-5, "negative"),
        ("stribeck", (0.02, -0.004), "consistent", 1, 6.8e-6, "negative"),
        ("stribeck", (0.02, -0.004), "consistent", 40, 7.3e-6, "negative"),
        ("stribeck", (0.02, -0.004), "consistent", 100, -8.5e-5, 4.9e-3),
        ("stribeck", (-0.01, 0.01), "consistent", 1, -2.9e-6, "negative"),
        ("stribeck", (-0.01, 0.01), "consistent", 40, -1.3e-4, "negative"),
        ("stribeck", (-0.01, 0.01), "consistent", 100, -1.6e-4, "negative"),
        ("pressure", (0.01, 0.5), "uniform", 1, 0.0, -1.0e-2),
        ("pressure", (0.01, 0.5), "consistent", 1, 1.4e-6, -1.0e-2),
        ("pressure", (0.01, 1.5), "consistent", 1, -1.4e-6, -1.0e-2),
        ("angular", (0.01, 0.5), "uniform", 1, -8.1e-5, -1.0e-2),
    ],
)
def test_propositions_2_to_4_as_checked(name, values, load, omega, right, forward):
    force = over_weight(name, values, load, 2.0, omega)
    assert force[0] == pytest.approx(right, rel=0.03, abs=1e-15)
    if forward == "negative":
        assert force[1] < 0
    else:
        assert force[1] == pytest.approx(forward, rel=0.03)


@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_stribeck_curls_right_by_the_sign_of_mu0_while_it_slows(speed):
    for mu0, mu1 in ((0.01, 0.003), (0.01, -0.004), (-0.002, 0.01), (-0.01, 0.004)):
        for epsilon in (0.05, 0.9, 1.1, 4.0, 30.0):
            force = over_weight(
                "stribeck", (mu0, mu1), "consistent", speed, epsilon * speed / STONE.R
            )
            assert np.sign(force[0]) == -np.sign(mu0 * force[1])


def test_radial_curls_by_its_sum_up_to_epsilon_one_and_then_by_the_tangential_pair():
    def right(values, epsilon):
        return over_weight("radial", values, "uniform", 2.0, epsilon * 2.0 / STONE.R)[0]

    for epsilon in (0.05, 0.5, 0.99):
        for pair in (0, 1):  # mu1 and mu2, mu3 and mu4
            alone = np.eye(4)[2 * pair : 2 * pair + 2] * 0.01
            assert right(alone[0], epsilon) == pytest.approx(-right(alone[1], epsilon), rel=1e-6)
        ratio = right((0, 0, 0.01, 0), epsilon) / right((0.01, 0, 0, 0), epsilon)
        assert ratio == pytest.approx(2, rel=1e-6)
    for epsilon, times in ((1.5, 5.74), (100.0, 3e4)):
        ratio = right((0, 0, 0.01, 0), epsilon) / right((0.01, 0, 0, 0), epsilon)
        assert ratio == pytest.approx(times, rel=0.01)


@pytest.mark.parametrize(
    ("name", "values", "load"),
    [
        ("pressure", (0.01, 0.7), "uniform"),
        *(
            (name, values, load)
            for name, values in [
                ("power", (0.01, 0.0)),
                ("pressure", (0.01, 0.0)),
                ("angular", (0.01, 0.0)),
                ("stribeck", (0.01, 0.0)),
                ("tensor", (0.01, 0.01, 0.0)),
                ("radial", (0.01,) * 4),
                ("front-back", (0.01,) * 4),
                ("debris", (0.01, 0.01)),
                ("debris", (0.3, 0.01)),  # half a turn done
            ]
            for load in LOADS
        ),
    ],
)
def test_where_it_is_coulombs_law(name, values, load):
    for omega in (1.0, -20.0, 80.0):
        np.testing.assert_allclose(
            over_weight(name, values, load, 2.0, omega, 4.0 * np.sign(omega)),
            over_weight("coulomb", (0.01,), load, 2.0, omega),
            rtol=1e-12,
            atol=1e-17,
        )


@both_loads
def test_debris_at_release_is_an_isotropic_front_and_back(load):
    np.testing.assert_allclose(
        over_weight("debris", (0.013, 0.008), load, 2.0, 7.0),
        over_weight("front-back", (0.008, 0.013, 0.008, 0.013), load, 2.0, 7.0),
        rtol=1e-12,
    )


MU = (0.006, 0.012, 0.007, 0.013)


@pytest.mark.parametrize(
    ("name", "values", "first_order"),
    [
        # mu0 (1 - f0 sin) times (-eps sin, 1), summed over the ring
        ("angular", (0.009, 0.3), lambda eps: (-eps * 0.009 * 0.3 / 2, -0.009, -eps * 0.009 / 2)),
        (
            "radial",
            MU,
            lambda eps: (  # eq. 23
                eps * (MU[0] - MU[1] + 2 * MU[2] - 2 * MU[3]) / (3 * np.pi),
                -sum(MU) / 4,
                -eps * (MU[2] + MU[3]) / 4,
            ),
        ),
    ],
)
def test_first_order_in_epsilon(name, values, first_order):
    gaps = []
    for eps in (0.1, 0.05, 0.025):
        force = over_weight(name, values, "uniform", 2.0, 2.0 * eps / STONE.R)
        gaps.append(np.abs(force / first_order(eps) - 1).max())
    assert gaps[0] < 4e-3
    assert gaps[0] / gaps[1] == pytest.approx(4, rel=0.05)
    assert gaps[1] / gaps[2] == pytest.approx(4, rel=0.05)


@both_loads
@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_throw_in_the_mirror(name, load):
    law = LAWS[name]()
    mirrored = replace(law, b12=-law.b12) if name == "tensor" else law
    times = np.linspace(0, 19, ROWS)
    start = InitialState(heading=0.2, v=2.0, omega=2.0)
    one = simulate(law, STONE, start, times, load=load)
    other = simulate(mirrored, STONE, replace(start, heading=-0.2, omega=-2.0), times, load=load)
    assert abs(one.x[-1] - one.y[-1] * np.tan(0.2)) > (1e-6 if load == "consistent" else -1.0)
    np.testing.assert_allclose(places(other), places(one) * [[-1], [1], [-1]], atol=1e-11)


@pytest.mark.parametrize("values", [(0.01, 0.01, 0.011), (0.01, 0.01, -0.011), (0.0, 0.01, 0.0)])
def test_a_tensor_that_is_not_positive_definite_is_named(values):
    assert "not positive definite" in LAWS["tensor"](*values).fault()
    assert LAWS["tensor"](0.01, 0.01, -0.009).fault() is None
