"""The ring: closed forms, a dense independent quadrature, symmetries."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_motion import G, Reference, front_back
from scipy.special import ellipe, ellipk

from curlfit import LAWS, LocalLaw, Stone, coefficient
from curlfit.dynamics.contact import accelerations
from curlfit.dynamics.law_structure import sample_points
from curlfit.dynamics.ring_polynomials import at_points, has_closed_form, traction
from curlfit.friction import Edges, RingPoint, power

numerical = pytest.mark.numerical

STONE = Stone(R=0.065, rho=0.1, h=0.057)
MU = (0.004, 0.05, 0.012, 0.006)
FRONT_BACK = LAWS["front-back"](*MU)

net = jax.jit(accelerations, static_argnames="load")


def over_weight(law, load, v, omega, stone=STONE):
    a = net(law, stone, load, v, omega)
    return np.array([a.xi, a.eta, a.angular * stone.rho**2 / stone.R]) / G


@numerical
@pytest.mark.parametrize("epsilon", [0.0, 0.01, 0.3, 0.9, 0.999, 1.0, 1.001, 1.5, 30.0])
def test_transverse_force_of_front_back_is_exact(epsilon):
    # int_0^pi sin a / sqrt(1 + 2 eps cos a + eps^2) da = 2 min(1, 1/eps)
    force = over_weight(FRONT_BACK, "uniform", 2.0, 2.0 * epsilon / STONE.R)
    exact = min(epsilon, 1.0) * (MU[0] - MU[1]) / np.pi
    assert force[0] == pytest.approx(
        exact, abs=1e-15, rel=5e-6 if abs(epsilon - 1) < 0.01 else 1e-9
    )


@numerical
@pytest.mark.parametrize("epsilon", [0.05, 0.5, 0.95, 1.2, 8.0])
def test_coulomb_force_is_the_complete_elliptic_integral(epsilon):
    # (1/2 pi) oint (1 + eps cos a)/|..| da by K and E of m = 4 eps/(1 + eps)^2
    m = 4 * epsilon / (1 + epsilon) ** 2
    exact = ((1 - epsilon) * ellipk(m) + (1 + epsilon) * ellipe(m)) / np.pi
    force = over_weight(LAWS["coulomb"](0.01), "uniform", 1.0, epsilon / STONE.R)
    assert -force[1] / 0.01 == pytest.approx(exact, rel=1e-9)


@numerical
@pytest.mark.parametrize("load", ["uniform", "consistent"])
@pytest.mark.parametrize(
    ("omega", "tolerance"),
    [
        (0.3, 1e-12),
        (-1.0, 1e-12),
        (7.0, 1e-12),
        (-29.0, 1e-8),
        (31.5, 1e-7),
        (200.0, 1e-12),
    ],
)
def test_front_back_agrees_with_a_dense_ring(load, omega, tolerance):
    h = STONE.h if load == "consistent" else None
    dense = Reference(front_back(*MU), R=STONE.R, h=h).force(2.0, STONE.R * omega)
    np.testing.assert_allclose(
        over_weight(FRONT_BACK, load, 2.0, omega), dense, rtol=tolerance, atol=1e-15
    )


def _as_written(kind):
    """The same law in other words, which no algebra with polynomials follows."""

    def traction(law, point):
        speed = (point.slide_xi**2 + point.slide_eta**2) ** 0.5
        turned = point._replace(
            e_xi=point.slide_xi / speed, e_eta=point.slide_eta / speed, speed=speed
        )
        return kind.traction(law, turned)

    return type(f"Written{kind.__name__}", (kind,), {"traction": traction, "name": ""})


CLOSED = {
    "uniform": {
        "front-back",
        "tensor",
        "coulomb",
        "radial",
        "angular",
        "pressure",
        "stribeck",
        "debris",
        "front-back+sideways",
    },
    "consistent": {
        "front-back",
        "tensor",
        "coulomb",
        "stribeck",
        "debris",
        "front-back+sideways",
    },
}


@pytest.mark.parametrize("load", CLOSED)
def test_laws_with_a_closed_form(load):
    ring = {name for name, law in LAWS.items() if issubclass(law, LocalLaw)}
    assert {name for name in ring if has_closed_form(LAWS[name], load)} == CLOSED[load]


@numerical
@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("debris", "uniform"),
        ("front-back", "consistent"),
        pytest.param("pressure", "uniform", marks=pytest.mark.slow),
        pytest.param("stribeck", "consistent", marks=pytest.mark.slow),
        pytest.param("debris", "consistent", marks=pytest.mark.slow),
        pytest.param("front-back+sideways", "consistent", marks=pytest.mark.slow),
    ],
)
def test_closed_form_and_quadrature_agree_with_all_derivatives(name, load):
    kind = LAWS[name]
    written = _as_written(kind)
    assert has_closed_form(kind, load)
    assert not has_closed_form(written, load)
    values = np.array((*MU, 0.005, 0.5)[: len(kind.coefficients())])

    def felt(p, law):
        stone = dataclasses.replace(STONE, R=p[-3])
        components = jnp.stack(
            accelerations(law.from_vector(p), stone, load, p[-2], p[-1])
        )
        return components, components

    # derivatives, values
    derivatives_and_values = jax.jit(
        jax.jacfwd(felt, has_aux=True), static_argnames="law"
    )
    for v, omega in [
        (2.0, 0.3),
        (2.0, -1.0),
        (1.5, 7.0),
        (1.0, -12.0),
        (1.0, 22.0),
        (0.1, -40.0),
    ]:
        p = np.array([*values, STONE.R, v, omega])
        for closed, summed in zip(
            derivatives_and_values(p, kind),
            derivatives_and_values(p, written),
            strict=True,
        ):
            np.testing.assert_allclose(closed, summed, rtol=1e-8, atol=1e-9)


@numerical
@pytest.mark.parametrize("front", [1.0, 0.0])
@pytest.mark.parametrize(
    "name", sorted(CLOSED["uniform"] - {"debris", "front-back+sideways"})
)
def test_polynomials_are_the_traction_at_every_point(name, front):
    kind = LAWS[name]
    law = kind.from_vector([0.3 + 0.1 * k for k, _ in enumerate(kind.coefficients())])
    point = sample_points(front)
    by_polynomials = [
        sum(value * at_points(point, powers) for powers, value in part.terms.items())
        for part in traction(law, "uniform", front, None, (1.0, 0.3, 0.4, 2.0))
    ]
    np.testing.assert_allclose(
        by_polynomials, law.traction(point), rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize(
    "beyond",
    [
        lambda p: p.angle * p.e_xi,
        lambda p: abs(p.eta) * p.e_xi,
        lambda p: p.e_xi if p.eta > 0 else -p.e_xi,
        lambda p: np.asarray(p.xi) * p.e_xi,
        lambda p: p.e_xi / p.eta,
        lambda p: p.e_xi**1.5,
        lambda p: p.e_xi * p.e_eta,
        lambda p: p.e_xi * p.xi**3,
        lambda p: p.e_xi + (p.turned > 1e3) * p.e_xi * p.xi**3,
        lambda p: p.e_xi + (p.time > 1e3) * 0.1 * p.speed,
    ],
)
def test_friction_beyond_polynomials_has_no_closed_form(beyond):
    class Beyond(LocalLaw):
        mu: float = coefficient(0.01, "")

        def traction(self, point):
            return -self.mu * beyond(point), -self.mu * point.e_eta

    assert not has_closed_form(Beyond, "uniform")


def test_a_term_that_only_some_coefficients_have_counts():
    class Sometimes(LocalLaw):
        mu: float = coefficient(0.01, "")
        k: float = coefficient(0.5, "", upper=3.0)

        def traction(self, point):
            mu = self.mu + (self.k > 2) * self.mu * point.xi**2
            return -mu * point.e_xi, -mu * point.e_eta

    assert not has_closed_form(Sometimes, "uniform")


def test_a_law_without_a_transverse_force_is_one_with_a_coefficient_of_zero():
    class Straight(LocalLaw):
        mu: float = coefficient(0.01, "")

        def traction(self, point):
            return 0.0, -self.mu * point.e_eta

    assert has_closed_form(Straight, "uniform")
    of_zero = LAWS["front-back"](0.0, 0.0, 0.01, 0.01)
    for v, omega in (np.array([1.5, 0.4]), np.array([2.0, -9.0])), (1.0, 0.0):
        np.testing.assert_allclose(
            over_weight(Straight(0.01), "uniform", v, omega),
            over_weight(of_zero, "uniform", v, omega),
            atol=1e-16,
        )


# How friction departs from Coulomb's: share added to its coefficient, and a pull to the
# right and forward.
UNEVEN = {
    "cubed": lambda p: (p.e_eta**2, 0.0, 0.0),
    "edged": lambda p: (1.0 * (p.angle < 1.0) * p.front, 0.0, 0.0),
    "ahead": lambda p: (0.3 * p.eta, 0.0, 0.0),
    "askew": lambda p: (0.1 * p.e_xi * p.speed, 0.0, 0.0),
    "stepped": lambda p: (p.speed, 0.3 * (p.e_xi > 0), 0.0),
    "leaning": lambda p: (1 / (p.speed + 0.1), 0.1 * (1 - p.xi), 0.0),
    "behind": lambda p: (0.0, 0.3 * (1 - p.front), 0.0),
    "asking Python": lambda p: (p.speed + 0.3 * np.asarray(p.front), 0.0, 0.0),
}


@numerical
@pytest.mark.parametrize("uneven", UNEVEN)
def test_any_friction_is_summed(uneven):
    class Uneven(LocalLaw):
        mu: float = coefficient(0.01, "")

        def edges(self, turned):
            return Edges(front=(1.0,)) if uneven == "edged" else Edges()

        def traction(self, point):
            more, right, forward = UNEVEN[uneven](point)
            return (
                self.mu * (right - (1 + more) * point.e_xi),
                self.mu * (forward - (1 + more) * point.e_eta),
            )

    v = 1.2
    u = 0.5
    nodes, weights = np.polynomial.legendre.leggauss(200)
    ends = np.array([-np.pi, 0.0, 1.0, np.pi])  # between which no friction jumps
    half = np.diff(ends)[:, None] / 2
    a = (ends[:-1, None] + half * (1 + nodes)).ravel()
    share = (half * weights).ravel() / (2 * np.pi)
    slide = -u * np.sin(a), v + u * np.cos(a)
    speed = np.hypot(*slide)
    point = RingPoint(
        xi=np.cos(a),
        eta=np.sin(a),
        angle=a,
        front=1.0 * (a > 0),
        slide_xi=slide[0],
        slide_eta=slide[1],
        speed=speed,
        e_xi=slide[0] / speed,
        e_eta=slide[1] / speed,
        load=1.0,
        v=v,
        u=u,
        turned=0.0,
        time=0.0,
    )
    t_xi, t_eta = (part + 0 * a for part in Uneven(0.01).traction(point))
    exact = share @ np.stack([t_xi, t_eta, np.cos(a) * t_eta - np.sin(a) * t_xi], 1)
    force = over_weight(Uneven(0.01), "uniform", v, u / STONE.R)
    np.testing.assert_allclose(force, exact, rtol=2e-6, atol=1e-10)
    closed = {"ahead", "edged", "behind", "asking Python"}
    assert has_closed_form(Uneven, "uniform") == (uneven in closed)


@numerical
def test_first_order_law_is_the_limit_of_the_ring():
    first_order = LAWS["front-back-first-order"](*MU)
    gaps = []
    for epsilon in (0.1, 0.05, 0.025):
        omega = 2.0 * epsilon / STONE.R
        ring = over_weight(FRONT_BACK, "uniform", 2.0, omega)
        gaps.append(
            np.abs(ring / over_weight(first_order, "uniform", 2.0, omega) - 1).max()
        )
    assert gaps[0] < 3e-3
    assert gaps[0] / gaps[1] == pytest.approx(4, rel=0.05)  # second order in epsilon
    assert gaps[1] / gaps[2] == pytest.approx(4, rel=0.05)


def test_rest_pure_spin_and_no_spin_are_finite_with_derivatives_under_consistent_load():
    """Those under a uniform load are in test_derivatives.py."""

    def force(x):
        return sum(accelerations(FRONT_BACK, STONE, "consistent", x[0], x[1]))

    value_and_slopes = jax.jit(
        lambda x: (*jax.value_and_grad(force)(x), jax.jacfwd(force)(x))
    )
    for motion in ((0.0, 0.0), (0.0, 3.0), (1.0, 0.0)):
        assert all(
            np.isfinite(part).all() for part in value_and_slopes(np.array(motion))
        )


@numerical
def test_power_is_numpys_with_its_derivatives_and_nan_below_zero():
    base = np.concatenate(
        [np.logspace(-150, 150, 601), np.nextafter(np.sqrt([0.5, 2]), 0), [1.0]]
    )
    slopes_of = jax.jit(jax.vmap(jax.grad(power, (0, 1)), (0, None)))
    for exponent in (-0.7, -0.25, 0.0, 0.5, 1.0):
        powers = jax.jit(power)(base, exponent)
        np.testing.assert_allclose(powers, base**exponent, rtol=1e-13)
        slopes = slopes_of(base, exponent)
        np.testing.assert_allclose(
            slopes[0], exponent * base ** (exponent - 1), rtol=1e-13
        )
        np.testing.assert_allclose(slopes[1], base**exponent * np.log(base), rtol=1e-13)
    assert np.isnan(jax.jit(power)(np.array([-1.0, np.nan]), 0.5)).all()
    assert power(4.0, 0.5) == 2.0
    for base in (4, True + 3, np.float32(4), np.int32(4)):
        assert jax.jit(power)(base, 0.5) == pytest.approx(2.0, rel=1e-15)


def test_a_law_must_declare_its_coefficients():
    with pytest.raises(TypeError, match="declare it as mu: float = coefficient"):

        class _Careless(LocalLaw):
            mu: float = 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    # the load of `pressure` is found by iteration, that of `radial` in one step
    [("pressure", (0.01, 0.5)), ("radial", (0.01, 0.02, 0.03, 0.015))],
)
def test_second_derivatives_under_a_consistent_load(name, values):
    def found(x):
        law = LAWS[name].from_vector(x)
        stone = Stone(h=x[-1])
        return jnp.stack(accelerations(law, stone, "consistent", x[-3], x[-2]))

    jacobian = jax.jit(jax.jacfwd(found))
    at = np.array([*values, 1.3, 2.0, 0.07])
    step = 1e-5
    difference = np.stack(
        [
            (jacobian(at + change) - jacobian(at - change)) / (2 * step)
            for change in step * np.eye(len(at))
        ],
        -1,
    )
    assert np.abs(difference).max() > 1
    np.testing.assert_allclose(
        jax.jit(jax.jacfwd(jacobian))(at), difference, rtol=0, atol=1e-7
    )
