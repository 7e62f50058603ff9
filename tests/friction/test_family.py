"""A family of laws does what each of its members does by itself."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.dynamics.contact import accelerations
from curlfit.friction import LocalLaw
from curlfit.friction.family import family_of
from curlfit.friction.registry import laws_under
from curlfit.inference.fit.fit import fit_request
from curlfit.inference.model.model import Model
from curlfit.inference.model.request import Request
from curlfit.inference.solve.initial_values import POINTS, accelerations_and_slopes
from curlfit.numerics.batches import stacked
from curlfit.settings.choices import Fitting

STONE = Stone(R=0.065, rho=0.1, h=0.057)
FAMILY = family_of([law for law, _ in laws_under(None)])
TIMES = np.linspace(0, 25, 61)  # as many as in test_laws.py


def coefficients(law):
    """All different, and not at bounds."""
    return np.array(
        [
            coefficient.default + 0.2 * (k + 1) * coefficient.typical
            for k, coefficient in enumerate(law.coefficients())
        ]
    )


def _state(law, values, stone, motion, load="uniform"):
    acceleration = jnp.stack(
        accelerations(law.from_vector(values), stone, load, *motion)
    )
    return acceleration, acceleration


_slopes = jax.jit(
    jax.jacfwd(_state, argnums=(1, 2, 3), has_aux=True), static_argnums=(0, 4)
)
"""Derivatives by coefficients, stone and motion, and the accelerations."""


def test_all_laws_of_the_ring_are_in_one():
    assert set(FAMILY.members) == {
        law for law, _ in laws_under(None) if issubclass(law, LocalLaw)
    }


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_coefficients_at_bounds_are_no_matter_of_other_members(end):
    def of_steps(vector):
        law = FAMILY.from_vector(vector)
        return jnp.stack([law.steepness(), law.quickness(1.0)])

    slopes = jax.jit(jax.jacfwd(of_steps))
    for law in FAMILY.members:
        values = np.array(
            [getattr(coefficient, end) for coefficient in law.coefficients()]
        )
        assert np.isfinite(slopes(FAMILY.vector(law, values))).all(), law.name


SMALL = family_of([LAWS[name] for name in ("debris", "power", "tensor")])
"""A law of each kind: with an edge, summed over the ring, in closed form."""


@pytest.mark.parametrize(
    ("law", "family"),
    [
        *(pytest.param(law, SMALL, id=law.name) for law in SMALL.members),
        *(
            pytest.param(law, FAMILY, id=f"{law.name} of all", marks=pytest.mark.slow)
            for law in FAMILY.members
        ),
    ],
)
def test_a_member_has_its_own_accelerations_and_derivatives(law, family):
    load = "consistent" if law.name == "pressure" else "uniform"
    values = coefficients(law)
    columns = family.columns(law, len(values))
    for motion in ((2.0, 1.0, 0.4, 3.0), (0.3, -9.0, -2.0, 8.0)):
        motion_vector = np.array(motion)
        (by_family, *family_slopes), family_value = _slopes(
            family, family.vector(law, values), STONE, motion_vector, load
        )
        (by_law, *law_slopes), law_value = _slopes(
            law, values, STONE, motion_vector, load
        )
        assert np.abs(law_value[1]) > 1e-3
        np.testing.assert_allclose(family_value, law_value, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(
            by_family[:, columns], by_law, rtol=1e-10, atol=1e-13
        )
        foreign_slopes = np.delete(np.asarray(by_family), columns, axis=1)
        np.testing.assert_array_equal(foreign_slopes, 0.0)
        for family_slope, law_slope in zip(
            jax.tree.leaves(family_slopes), jax.tree.leaves(law_slopes), strict=True
        ):
            np.testing.assert_allclose(family_slope, law_slope, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("name", ["debris", "power"])
def test_a_member_takes_its_own_steps(name):
    # angles at which debris has a kink, and a steep law
    law = LAWS[name]
    values = coefficients(law)
    start = InitialState(v=2.0, omega=1.3)
    law_path, family_path = (
        simulate(kind.from_vector(vector), STONE, start, TIMES).to_numpy()
        for kind, vector in ((law, values), (SMALL, SMALL.vector(law, values)))
    )
    assert law_path.phi[-1] > 2 * np.pi
    for channel in ("x", "y", "phi", "rest"):
        np.testing.assert_allclose(
            getattr(family_path, channel),
            getattr(law_path, channel),
            rtol=0,
            atol=1e-13,
        )


def test_a_batch_of_one_member_evaluates_no_other():
    def of_one(v):
        return accelerations(FAMILY.from_vector(vector), STONE, "uniform", v, 1.0).eta

    vector = FAMILY.vector(LAWS["coulomb"], np.array([0.01]))
    program = str(jax.make_jaxpr(jax.vmap(of_one))(np.linspace(1, 2, 5)))
    assert "cond[" in program


def test_a_law_of_the_user_and_a_single_law_have_no_family():
    class Mine(curlfit.LocalLaw):
        mu: float = curlfit.coefficient(0.01, "friction")

        def traction(self, point):
            return -self.mu * point.e_xi, -self.mu * point.e_eta

    coulomb = LAWS["coulomb"]
    net = LAWS["semi-empirical"]
    assert family_of([coulomb, net, Mine]) is None
    assert family_of([coulomb, coulomb]) is None
    pair = family_of([coulomb, Mine, LAWS["power"]])
    assert pair.members == (coulomb, LAWS["power"])
    assert pair.shipped()
    assert pair.name not in LAWS


@pytest.mark.parametrize("name", ["tensor", "power"])
@pytest.mark.parametrize("family", [None, FAMILY], ids=["alone", "member"])
def test_forces_along_a_path_and_their_slopes(name, family):
    law = LAWS[name]
    model = Model(law, "uniform", family=family)
    values = coefficients(law)
    path = np.stack(
        [np.linspace(2, 0.2, POINTS), np.full(POINTS, 1.2), *np.zeros((2, POINTS))]
    )
    typical = np.array([coefficient.typical for coefficient in law.coefficients()])
    forces, slopes = accelerations_and_slopes(
        model, values[None], typical, stacked([STONE]), path[None], 1
    )
    for point in (0, 50, POINTS - 1):
        motion = path[:, point]
        (exact, *_), value = _slopes(law, values, STONE, motion, "uniform")
        np.testing.assert_allclose(forces[0, :, point], value, rtol=1e-11, atol=1e-16)
        # if it is linear
        rtol, atol = (1e-9, 1e-10) if name == "tensor" else (1e-3, 1e-6)
        np.testing.assert_allclose(slopes[0, :, point], exact, rtol=rtol, atol=atol)


def test_a_fit_beside_others_is_the_fit(eq12):
    alone = curlfit.fit(eq12, "coulomb", details=False)
    # that of comparisons
    request = Request.of(eq12, Fitting.of(eq12.settings, law="coulomb"))
    beside = fit_request(request, details=False, family=FAMILY)
    assert beside.coefficients.keys() == alone.coefficients.keys()
    for name, estimate in alone.parameters.items():
        other = beside.parameters[name]
        assert other.verdict == estimate.verdict
        assert other.value == pytest.approx(
            estimate.value, rel=1e-7, abs=1e-9 * estimate.typical
        )
    assert beside.rms == pytest.approx(alone.rms, rel=1e-9)
