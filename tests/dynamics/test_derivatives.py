"""Derivatives of the path and of the time of rest: closed forms, an independent
integration by complex steps, finite differences. One program has all of them,
in both modes."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import certify
from independent_motion import G

from curlfit import LAWS, InitialState, Stone, simulate

pytestmark = pytest.mark.numerical

PAPER = (0.0004, 0.0555, 0.009, 0.0083)
FRONT_BACK = (0.005, 0.05, 0.009, 0.008)
# among the parameters
HEADING = 6
V = 7
OMEGA = 9
ROWS = 61
ENDS = [ROWS - 1, 2 * ROWS - 1, -1]
"""x and y at the last time, and the time of rest."""


def parameters(mu, heading, v, omega, R=0.0625):
    """Coefficients of front-back, initial state, R, rho and h."""
    return np.array([*mu, 0.1, 0.2, heading, v, 0.2, omega, R, 0.1, 0.057])


def rows(times):
    return np.pad(times, (0, ROWS - len(times)), mode="edge")


def path(p, times, load, xp=np):
    """x, y, phi at the times, then the time of rest."""
    stone = Stone(20.0, *(p[k] for k in (10, 11, 12)))
    law = LAWS["front-back"].from_vector(p)
    start = InitialState(*(p[4 + k] for k in range(6)))
    motion = simulate(law, stone, start, times, load=load, t0=0.0)
    return xp.concatenate(
        [motion.x, motion.y, motion.phi, xp.asarray(motion.rest)[None]]
    )


@partial(jax.jit, static_argnames="load")
def derivatives(p, times, load="uniform"):
    """The path, its derivatives in forward mode, and those of the last row in
    reverse: the longest part, the integration with its tangents, is common to all
    modes of JAX."""
    motion, forward = jax.linearize(lambda p: path(p, times, load, jnp), p)
    last = (
        jnp.zeros((3, len(motion)))
        .at[jnp.arange(3), ROWS * jnp.arange(1, 4) - 1]
        .set(1.0)
    )
    (reverse,) = jax.vmap(jax.linear_transpose(forward, p))(last)
    return motion, jax.vmap(forward, out_axes=-1)(jnp.eye(len(p))), reverse


@pytest.mark.parametrize("mu", [0.003, 0.012, 0.2])
@pytest.mark.parametrize("v", [0.05, 1.7, 6.0])
def test_where_and_when_a_sliding_stone_stops_and_how_that_changes(mu, v):
    heading = 0.1
    p = parameters((mu,) * 4, heading, v, 0.0)
    way = v**2 / (2 * mu * G)
    time = v / (mu * G)
    s = np.sin(heading)
    c = np.cos(heading)
    motion, slopes, _ = map(np.asarray, derivatives(p, rows([0.0, 1000.0])))
    np.testing.assert_allclose(
        motion[ENDS], [0.1 + way * s, 0.2 + way * c, time], rtol=1e-9
    )
    exact = [
        [-way * s / mu, way * c, 2 * way * s / v],
        [-way * c / mu, -way * s, 2 * way * c / v],
        [-time / mu, 0, time / v],
    ]

    def assert_slopes(slopes, exact):
        # the friction coefficients are one
        by = np.stack(
            [slopes[..., :4].sum(-1), slopes[..., HEADING], slopes[..., V]], -1
        )
        np.testing.assert_allclose(by, exact, rtol=1e-7, atol=1e-9 * way)

    assert_slopes(slopes[ENDS], exact)
    # Spin of either sign delays the rest alike: at no spin its slope is zero.
    np.testing.assert_allclose(slopes[ENDS, OMEGA], 0, atol=1e-9 * way / mu)
    # The rest is the same if the last row is before it.
    early, slopes, _ = map(np.asarray, derivatives(p, rows([0.0, time / 2])))
    assert early[-1] == pytest.approx(time, rel=1e-9)
    assert_slopes(slopes[-1], exact[2])


def independent(p, times, load):
    """The path and its Jacobian by complex steps, without any code of the program."""
    program = certify
    case = program.Case(
        "front-back",
        dict.fromkeys("abcd", 0.0),
        (),
        1,
        1,
        {},
        load=load,
        stone=dict(zip(("R", "rho", "h"), p[10:], strict=True)),
    )
    asked = [0, 1, 2, 3, HEADING, V, OMEGA]
    steps = np.tile(p[:10, None], 1 + len(asked)).astype(np.clongdouble)
    steps[asked, np.arange(1, steps.shape[1])] += np.clongdouble(1j * program.TINY)
    channels, rest = program.extrapolated(
        case, steps, np.asarray(times, np.longdouble), columns=5, least=1e-12, share=0.4
    )
    motion = np.concatenate([channels.reshape(-1, steps.shape[1]), rest[None]])
    slopes = (motion[:, 1:].imag / program.TINY).astype(float)
    return motion[:, 0].real.astype(float), slopes, asked


@pytest.mark.parametrize(
    ("mu", "v", "omega", "load"),
    [
        (FRONT_BACK, 2.1, 1.2, "uniform"),
        (FRONT_BACK, 1.2, 30.0, "uniform"),
        ((0.0, *FRONT_BACK[1:]), 1.2, -30.0, "uniform"),
        pytest.param(FRONT_BACK, 6.0, -60.0, "consistent", marks=pytest.mark.slow),
    ],
)
def test_rest_and_its_derivatives_agree_with_an_independent_integration(
    mu, v, omega, load
):
    times = np.array([0.0, 0.5, 5.0, 200.0])
    p = parameters(mu, 0.1, v, omega)
    exact, exact_slopes, asked = independent(p, times, load)
    motion, slopes, _ = map(np.asarray, derivatives(p, rows(times), load))
    entries = [*np.add.outer(ROWS * np.arange(3), np.arange(len(times))).ravel(), -1]
    motion, slopes = motion[entries], slopes[entries][:, asked]
    size = max(np.abs(exact).max(), 50.0)  # m or rad
    np.testing.assert_allclose(motion[:-1], exact[:-1], rtol=0, atol=1e-8 * size)
    # s, at a speed of less than 1e-6 m/s
    assert motion[-1] == pytest.approx(exact[-1], abs=2e-6)
    assert 0 < exact[-1] < 200  # it does come to rest
    # Each by each parameter, against the greatest of its kind. At rest those by a
    # friction across the motion that is zero are the least exact: 1.4e-5, all
    # others 2e-6.
    largest = np.abs(exact_slopes[:-1]).max(0)
    gaps = np.abs(slopes - exact_slopes)[:-1].reshape(3, len(times), -1) / largest
    assert gaps[:, :3].max() < 1e-6
    assert gaps.max() < 2e-5
    gap = np.abs(slopes[-1] - exact_slopes[-1])
    assert (gap * largest).max() / (np.abs(exact_slopes[-1]) * largest).max() < 1e-5


def test_without_any_friction_nothing_is_lost():
    heading = 0.1
    times = np.array([0.0, 3.0, 10.0, 20.0])
    p = parameters((0.0,) * 4, heading, 6.0, 60.0)
    motion, slopes, _ = map(np.asarray, derivatives(p, rows(times)))
    along = slice(ROWS, ROWS + 4)
    np.testing.assert_allclose(
        motion[along], 0.2 + 6 * np.cos(heading) * times, rtol=1e-12
    )
    np.testing.assert_allclose(motion[2 * ROWS :][:4], 0.2 + 60 * times, rtol=1e-12)
    assert motion[-1] == np.inf
    assert np.isfinite(slopes[:-1]).all()
    # A little friction along the motion: -mu g t^2/2 times the mean of |e_eta|
    eps = p[10] * 60 / 6
    alpha = 2 * np.pi * (np.arange(512) + 0.5) / 512
    e_eta = (1 + eps * np.cos(alpha)) / np.sqrt(1 + 2 * eps * np.cos(alpha) + eps**2)
    lost = -0.5 * e_eta.mean() * G * times**2 / 2
    np.testing.assert_allclose(
        slopes[along, 2], lost * np.cos(heading), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize(
    ("load", "v", "omega", "until"),
    [
        ("uniform", 2.06, 1.005, 20.0),
        ("uniform", 2.06, 1.005, 40.0),  # to rest
        pytest.param("consistent", 2.06, -1.5, 40.0, marks=pytest.mark.slow),
        ("uniform", 0.05, 30.0, 40.0),
    ],
)
def test_derivatives_agree_with_finite_differences(load, v, omega, until):
    times = np.linspace(0, until, ROWS)
    p = parameters(PAPER, 0.1, v, omega, R=0.054)
    _, forward, reverse = map(np.asarray, derivatives(p, times, load))
    forward = forward[:-1].reshape(3, ROWS, -1)
    np.testing.assert_allclose(reverse, forward[:, -1], rtol=1e-12, atol=1e-12)
    steps = 1e-4 * np.maximum(np.abs(p), 1e-2)
    for k, step in enumerate(steps):
        near, far = (
            path(p + e, times, load) - path(p - e, times, load)
            for e in np.outer([1, 2], step * np.eye(len(p))[k])
        )
        difference = ((8 * near - far) / (12 * step))[:-1].reshape(3, ROWS)
        size = np.abs(forward[..., k]).max()
        np.testing.assert_allclose(
            forward[..., k],
            difference,
            rtol=0,
            atol=1e-6 * size + 1e-10,
            err_msg=str(k),
        )


@pytest.mark.parametrize(("v", "omega"), [(2.0, 0.0), (0.0, 3.0), (0.0, 0.0)])
def test_derivatives_stay_finite_at_the_edges(v, omega):
    p = parameters(PAPER, 0.1, v, omega)
    motion, forward, reverse = derivatives(p, np.linspace(0, 40, ROWS))
    assert all(np.isfinite(values).all() for values in (motion, forward[:-1], reverse))


@pytest.mark.slow
def test_second_derivatives_agree_with_differences_of_the_first():
    """Of a path that curls: the heading turns, and depends on everything."""
    times = np.array([0.0, 5.0, 12.0, 18.0])

    def path(p):
        law = LAWS["front-back"](p[0], p[1], 0.009, 0.0083)
        motion = simulate(
            law, Stone(R=0.054), InitialState(heading=p[2], v=p[3], omega=p[4]), times
        )
        return jnp.stack([motion.x[1:], motion.y[1:], motion.phi[1:]])

    values = np.array([0.002, 0.05, 0.1, 2.0, 1.2])
    steps = [1e-5, 1e-4, 1e-4, 1e-4, 1e-4]
    slope = jax.jit(jax.jacfwd(path))
    hessians = jax.jit(jax.jacfwd(jax.jacfwd(path)))(values)
    moves = np.diag(steps)
    differences = np.stack(
        [
            (slope(values + move) - slope(values - move)) / (2 * step)
            for move, step in zip(moves, steps, strict=True)
        ],
        -1,
    )
    gap = np.abs(hessians - differences).max((0, 1)) / np.abs(differences).max((0, 1))
    assert gap.max() < 2e-6
