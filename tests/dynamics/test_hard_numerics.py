"""Ends of the range: |epsilon| = 1, no spin and hard spin, crawling and fast stones,
sparse and dense data, short clips."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from independent_motion import G

from curlfit import LAWS, Stone, fit, law_with, synthetic_throw
from curlfit.dynamics.contact import accelerations

STONE = Stone(R=0.0625, rho=0.1)
FRONT_BACK = (0.005, 0.05, 0.009, 0.008)

_of_coulomb = jax.jit(partial(accelerations, LAWS["coulomb"](0.01), STONE, "uniform"))
_slope_of_coulomb = jax.jit(jax.jacfwd(lambda v, omega: _of_coulomb(v, omega).eta))


@pytest.mark.numerical
@pytest.mark.parametrize("omega", [16.0, -16.0])
def test_friction_where_one_point_does_not_slide(omega):
    # v = R omega exactly. Coulomb's law there: |e_eta| = |cos b|, mean 2/pi; the
    # moment alike.
    assert STONE.R * abs(omega) == 1.0
    at = _of_coulomb(1.0, omega)
    over = np.array([at.xi, at.eta, at.angular * STONE.rho**2 / STONE.R]) / (0.01 * G)
    np.testing.assert_allclose(
        over, [0, -2 / np.pi, -np.sign(omega) * 2 / np.pi], atol=1e-6
    )
    for beside in (-1e-3, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3):
        slope = _slope_of_coulomb(1.0 + beside, omega)
        # d/dv of the elliptic integrals: (1/pi)(log(8/|v - u|) - ...), so it grows
        # without haste
        assert np.isfinite(slope)
        assert -0.01 * G * 10 < slope < 0
        near = _of_coulomb(1.0 + beside, omega)
        assert abs(near.eta - at.eta) < 0.01 * G * (abs(beside) * 10 + 1e-6)


def thrown(seed, *, rate, until, noise_xy=0.002, noise_phi=0.004, **start):
    law = law_with("front-back", dict(zip(NAMES, FRONT_BACK, strict=True)))
    return synthetic_throw(
        law,
        STONE,
        until=until,
        dt=1 / rate,
        noise_xy=noise_xy,
        noise_phi=noise_phi,
        seed=seed,
        **start,
    )


NAMES = ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta")


def honest(result, start):
    """What is called determined, and that it is within 4.5 standard errors
    of the truth."""
    assert result.converged, result.status
    truth = dict(zip(NAMES, FRONT_BACK, strict=True)) | start
    determined = set()
    for name, quantity in result.parameters.items():
        assert np.isfinite(quantity.value)
        if quantity.verdict == "determined" and name in truth:
            assert abs(quantity.value - truth[name]) < 4.5 * quantity.stderr, name
            determined.add(name)
    for quantity in result.combinations:
        if quantity.expression == "mu1_eta + mu2_eta":
            assert abs(quantity.value - 0.017) < 4.5 * quantity.stderr
            determined.add(quantity.expression)
    return determined


@pytest.mark.parametrize(
    ("rate", "until", "start", "told"),
    [
        (1, 24, {"v0": 2.1, "omega0": 1.2}, {"mu1_xi", "mu2_xi", "mu1_eta + mu2_eta"}),
        (30, 2, {"v0": 2.1, "omega0": 1.2}, {"mu1_eta + mu2_eta"}),
        (100, 2, {"v0": 6.0, "omega0": 60.0}, {"mu2_xi", "mu1_eta + mu2_eta"}),
        (10, 20, {"v0": 2.1, "omega0": 0.0}, {"mu1_eta + mu2_eta"}),
        (200, 1, {"v0": 0.05, "omega0": 0.1}, set()),
    ],
    ids=["1 Hz", "2 s", "6 m/s, 60 rad/s", "no spin", "0.05 m/s"],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_a_fit_says_of_hard_data_is_so(rate, until, start, told, seed):
    fine = 0.1 if start["v0"] < 1 else 1.0
    throw = thrown(
        seed,
        rate=rate,
        until=until,
        noise_xy=0.002 * fine,
        noise_phi=0.004 * fine,
        **start,
    )
    # no one throws a stone that spins so
    throw = replace(throw, defaults={"as_given": True})
    determined = honest(fit(throw, stone=STONE), start)
    assert determined >= told
    if start["omega0"] == 0:  # friction across the motion needs spin to show
        assert not {"mu1_xi", "mu2_xi"} & determined
