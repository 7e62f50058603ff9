"""Ends of the range: rest and its derivatives, |epsilon| = 1, no spin and hard spin, crawling and
fast stones, coefficients of zero, sparse and dense data, short clips."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import certify

from curlfit import (
    LAWS,
    DataError,
    InitialState,
    Stone,
    fit,
    law_with,
    simulate,
    synthetic_throw,
)
from curlfit.dynamics.contact import accelerations

G = 9.81
STONE = Stone(R=0.0625, rho=0.1)
FRONT_BACK = (0.005, 0.05, 0.009, 0.008)
HEADING = 0.1


def _everything(values, times, law, load):
    """x, y, phi at the times, then the time of rest; the last three values are the start."""
    heading, v, omega = values[-3:]
    start = InitialState(heading=heading, v=v, omega=omega)
    path = simulate(LAWS[law].from_vector(values), STONE, start, times, load=load, t0=0.0)
    return jnp.concatenate([path.x, path.y, path.phi, path.rest[None]])


_value = jax.jit(_everything, static_argnames=("law", "load"))
_slopes = jax.jit(jax.jacfwd(_everything), static_argnames=("law", "load"))


def independent(values, times, law, load):
    """The same and its Jacobian by complex steps, without any code of the program."""
    program = certify
    case = program.Case(
        law, dict.fromkeys("abcd"[: len(values) - 3], 0.0), (), 1, 1, {}, load=load,
        stone={"R": STONE.R, "rho": STONE.rho, "h": STONE.h},
    )  # fmt: skip
    *coefficients, heading, v, omega = values
    full = np.array([*coefficients, 0.0, 0.0, heading, v, 0.0, omega])
    k = len(coefficients)
    asked = [*range(k), k + 2, k + 3, k + 5]
    p = np.tile(full[:, None], 1 + len(asked)).astype(np.clongdouble)
    p[asked, np.arange(1, p.shape[1])] += np.clongdouble(1j * program.TINY)
    path, rest = program.extrapolated(
        case, p, np.asarray(times, np.longdouble), columns=5, least=1e-12, share=0.4
    )
    both = np.concatenate([path.reshape(-1, p.shape[1]), rest[None]])
    return both[:, 0].real.astype(float), (both[:, 1:].imag / program.TINY).astype(float)


@pytest.mark.numerical
@pytest.mark.parametrize("mu", [0.003, 0.012, 0.2])
@pytest.mark.parametrize("v", [0.05, 1.7, 6.0])
def test_where_and_when_a_sliding_stone_stops_and_how_that_changes(mu, v):
    times = np.array([0.0, 1000.0])
    values = np.array([mu, HEADING, v, 0.0])
    way, time = v**2 / (2 * mu * G), v / (mu * G)
    s, c = np.sin(HEADING), np.cos(HEADING)
    found = np.asarray(_value(values, times, law="coulomb", load="uniform"))[[1, 3, 6]]
    np.testing.assert_allclose(found, [way * s, way * c, time], rtol=1e-9)
    slopes = np.asarray(_slopes(values, times, law="coulomb", load="uniform"))
    exact = [
        [-way * s / mu, way * c, 2 * way * s / v],
        [-way * c / mu, -way * s, 2 * way * c / v],
        [-time / mu, 0, time / v],
    ]
    np.testing.assert_allclose(slopes[[1, 3, 6], :3], exact, rtol=1e-7, atol=1e-9 * way)
    # Spin of either sign delays the rest alike: at no spin its slope is zero.
    np.testing.assert_allclose(slopes[[1, 3, 6], 3], 0, atol=1e-9 * way / mu)
    # The rest is the same if the last row is before it.
    early = times * time / 2000
    assert _value(values, early, law="coulomb", load="uniform")[6] == pytest.approx(time, rel=1e-9)
    slopes = np.asarray(_slopes(values, early, law="coulomb", load="uniform"))[6, :3]
    np.testing.assert_allclose(slopes, exact[2], rtol=1e-7, atol=1e-9 * way)


@pytest.mark.numerical
@pytest.mark.parametrize(
    ("values", "law", "load"),
    [
        ((*FRONT_BACK, HEADING, 2.1, 1.2), "front-back", "uniform"),
        ((*FRONT_BACK, HEADING, 1.2, 30.0), "front-back", "uniform"),
        ((0.0, 0.05, 0.009, 0.008, HEADING, 1.2, -30.0), "front-back", "uniform"),
        pytest.param(
            (*FRONT_BACK, HEADING, 6.0, -60.0), "front-back", "consistent", marks=pytest.mark.slow
        ),
    ],
)
def test_rest_and_its_derivatives_agree_with_an_independent_integration(values, law, load):
    times = np.array([0.0, 0.5, 5.0, 200.0])
    exact, exact_slopes = independent(values, times, law, load)
    values = np.array(values)
    found = np.asarray(_value(values, times, law=law, load=load))
    slopes = np.asarray(_slopes(values, times, law=law, load=load))
    size = max(np.abs(exact).max(), 50.0)  # m or rad
    np.testing.assert_allclose(found[:-1], exact[:-1], rtol=0, atol=1e-8 * size)
    assert found[-1] == pytest.approx(exact[-1], abs=2e-6)  # s, at a speed of less than 1e-6 m/s
    assert 0 < exact[-1] < 200  # it does come to rest
    # Each by each parameter, against the greatest of its kind. At rest those by a friction across
    # the motion that is zero are the least exact: 1.4e-5, all others 2e-6.
    largest = np.abs(exact_slopes[:-1]).max(0)
    gaps = np.abs(slopes - exact_slopes)[:-1].reshape(3, len(times), -1) / largest
    assert gaps[:, :3].max() < 1e-6
    assert gaps.max() < 2e-5
    gap = np.abs(slopes[-1] - exact_slopes[-1])
    assert (gap * largest).max() / (np.abs(exact_slopes[-1]) * largest).max() < 1e-5


_of_coulomb = jax.jit(partial(accelerations, LAWS["coulomb"](0.01), STONE, "uniform"))
_slope_of_coulomb = jax.jit(jax.jacfwd(lambda v, omega: _of_coulomb(v, omega).eta))


@pytest.mark.numerical
@pytest.mark.parametrize("omega", [16.0, -16.0])
def test_friction_where_one_point_does_not_slide(omega):
    # v = R omega exactly. Coulomb's law there: |e_eta| = |cos b|, mean 2/pi; the moment alike.
    assert STONE.R * abs(omega) == 1.0
    at = _of_coulomb(1.0, omega)
    over = np.array([at.xi, at.eta, at.angular * STONE.rho**2 / STONE.R]) / (0.01 * G)
    np.testing.assert_allclose(over, [0, -2 / np.pi, -np.sign(omega) * 2 / np.pi], atol=1e-6)
    for beside in (-1e-3, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3):
        slope = _slope_of_coulomb(1.0 + beside, omega)
        # d/dv of the elliptic integrals: (1/pi)(log(8/|v - u|) - ...), so it grows without haste
        assert np.isfinite(slope)
        assert -0.01 * G * 10 < slope < 0
        near = _of_coulomb(1.0 + beside, omega)
        assert abs(near.eta - at.eta) < 0.01 * G * (abs(beside) * 10 + 1e-6)


def test_without_any_friction_nothing_is_lost():
    values = np.array([0.0] * 4 + [HEADING, 6.0, 60.0])
    times = np.array([0.0, 3.0, 10.0, 20.0])
    found = np.asarray(_value(values, times, law="front-back", load="uniform"))
    np.testing.assert_allclose(found[4:8], 6 * np.cos(HEADING) * times, rtol=1e-12)
    np.testing.assert_allclose(found[8:12], 60 * times, rtol=1e-12)
    assert simulate(LAWS["coulomb"](0.0), STONE, InitialState(v=2.0), times).rest == np.inf
    slopes = np.asarray(_slopes(values, times, law="front-back", load="uniform"))
    assert np.isfinite(slopes[:-1]).all()
    # A little friction along the motion: -mu g t^2/2 times the mean of |e_eta|
    eps = STONE.R * 60 / 6
    alpha = 2 * np.pi * (np.arange(512) + 0.5) / 512
    e_eta = (1 + eps * np.cos(alpha)) / np.sqrt(1 + 2 * eps * np.cos(alpha) + eps**2)
    lost = -0.5 * e_eta.mean() * G * times**2 / 2
    np.testing.assert_allclose(slopes[4:8, 2], lost * np.cos(HEADING), rtol=1e-9, atol=1e-12)


def thrown(seed, *, rate, until, noise_xy=0.002, noise_phi=0.004, **start):
    law = law_with("front-back", dict(zip(NAMES, FRONT_BACK, strict=True)))
    return synthetic_throw(
        law, STONE, until=until, dt=1 / rate, noise_xy=noise_xy, noise_phi=noise_phi, seed=seed,
        **start,
    )  # fmt: skip


NAMES = ("mu1_xi", "mu2_xi", "mu1_eta", "mu2_eta")


def honest(result, start):
    """What is called determined, and that it is within 4.5 standard errors of the truth."""
    assert result.converged, result.status
    truth = dict(zip(NAMES, FRONT_BACK, strict=True)) | start
    told = set()
    for name, item in result.parameters.items():
        assert np.isfinite(item.value)
        if item.verdict == "determined" and name in truth:
            assert abs(item.value - truth[name]) < 4.5 * item.stderr, name
            told.add(name)
    for item in result.combinations:
        if item.expression == "mu1_eta + mu2_eta":
            assert abs(item.value - 0.017) < 4.5 * item.stderr
            told.add(item.expression)
    return told


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
        seed, rate=rate, until=until, noise_xy=0.002 * fine, noise_phi=0.004 * fine, **start
    )
    throw = replace(throw, defaults={"as_given": True})  # no one throws a stone that spins so
    found = honest(fit(throw, stone=STONE), start)
    assert found >= told
    if start["omega0"] == 0:  # friction across the motion needs spin to show
        assert not {"mu1_xi", "mu2_xi"} & found


def test_a_crawl_below_the_noise_is_refused_in_one_sentence():
    throw = thrown(1, rate=100, until=2, noise_xy=0.02, v0=0.05, omega0=0.0)
    with pytest.raises(DataError, match="never moves") as refusal:
        fit(throw, stone=STONE)
    assert "\n" not in str(refusal.value)
