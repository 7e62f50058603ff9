"""Each law: its path by an independent integration, its derivatives, its closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import G, Reference, follow, front_back

from curlfit import LAWS, Start, Stone, simulate
from curlfit.contact import accelerations, consistent_load
from curlfit.friction import LOADS

STONE = Stone(R=0.065, rho=0.1, h=0.057)


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
THROW = Start(x=1.0, y=-2.0, heading=0.3, v=2.0, phi=0.5, omega=1.5)
FAST_SPIN = Start(heading=-0.2, v=0.6, omega=-25.0)  # epsilon = -2.7
both_loads = pytest.mark.parametrize("load", LOADS)
any_law = pytest.mark.parametrize(("name", "values"), LAWS_OF_THE_RING)


@both_loads
@pytest.mark.parametrize("start", [THROW, FAST_SPIN], ids=["throw", "fast spin"])
@any_law
def test_path_agrees_with_an_independent_integration(name, values, load, start):
    times = np.linspace(0, 60, 61)
    exact = reference(name, values, load).path(start, times)
    path = simulate(LAWS[name](*values), STONE, start, times, load=load)
    assert np.abs(places(path) - exact).max() < 1e-7  # m, m, rad


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
    times = np.linspace(0, 19, 61)
    start = Start(heading=0.3, v=2.0, omega=omega)
    exact = reference("debris", values, "uniform").path(start, times)
    path = simulate(LAWS["debris"](*values), STONE, start, times)
    assert np.abs(places(path) - exact).max() < 1e-7


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
    times = np.linspace(0, 60, 61)
    start = replace(THROW, omega=omega)
    path = simulate(LAWS["semi-empirical"](*values), STONE, start, times)
    assert np.abs(places(path) - semi_empirical(values, start, times)).max() < 1e-7


def test_no_two_laws_are_the_same_to_jit():
    structures = [jax.tree.structure(law()) for law in LAWS.values()]
    assert all(a != b for a, b in combinations(structures, 2))


def _path(p, times, name, load):
    law = LAWS[name].from_vector(p)
    start = Start(heading=0.3, v=p[-2], omega=p[-1])
    return _stacked(simulate(law, STONE, start, times, load=load))


def _stacked(path):
    return jnp.stack([path.x, path.y, path.phi])


_forward = jax.jit(jax.jacfwd(_path), static_argnames=("name", "load"))
_value = jax.jit(_path, static_argnames=("name", "load"))


@pytest.mark.parametrize(
    ("name", "values", "load"),
    [
        *(
            (name, values, load)
            for name, values in dict(LAWS_OF_THE_RING).items()
            for load in LOADS
            if name != "front-back"  # in test_motion.py
        ),
        ("semi-empirical", (0.005, 0.085, 0.1, 0.1, -0.3), "uniform"),
    ],
)
def test_derivatives_agree_with_finite_differences(name, values, load):
    # Half a turn, where debris has a corner, is done at 2.2 s.
    times = np.array([0.0, 1.0, 2.0, 2.15, 2.2, 2.25, 2.4, 3.0, 6.0, 12.0, 20.0, 40.0])
    p = np.array([*values, 2.0, 1.5])
    forward = np.asarray(_forward(p, times, name=name, load=load))
    for k in range(len(p)):
        step = np.zeros_like(p)
        step[k] = 1e-4 * max(abs(p[k]), 1e-3)
        near, far = (
            _value(p + n * step, times, name=name, load=load)
            - _value(p - n * step, times, name=name, load=load)
            for n in (1, 2)
        )
        difference = (8 * near - far) / (12 * step[k])
        size = np.abs(forward[..., k]).max()
        np.testing.assert_allclose(
            forward[..., k], difference, rtol=0, atol=1e-6 * size + 1e-10, err_msg=str(k)
        )
