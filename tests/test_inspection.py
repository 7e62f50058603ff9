"""What is said of a throw before a fit, against throws of which it is known."""

from __future__ import annotations

import numpy as np
import pytest

from curlfit import Throw
from curlfit.inspection import inspected
from curlfit.report_inspection import braille, facts
from curlfit.throw import scatter

SLOWING, SPEED = 0.1, 2.0  # m/s^2, m/s: at rest after 20 s and 20 m


def stone(t, noise=0.0, seed=0):
    s = np.minimum(t, SPEED / SLOWING)
    y = SPEED * s - SLOWING * s**2 / 2
    return y + noise * np.random.default_rng(seed).standard_normal(len(t))


def throw(t, noise=0.0, **more):
    return Throw.from_arrays(t, stone(t, noise, 1) ** 2 / 400, stone(t, noise, 2), **more)


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_scatter_is_the_noise_and_not_the_bend(noise):
    t = np.arange(0, 20, 0.1)
    assert scatter(stone(t, noise)) == pytest.approx(noise, rel=0.2)
    bent = np.cos(t)  # its second differences reach 0.01
    assert scatter(bent) < 5e-4
    assert scatter(bent[:9]) == 0


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_rest_is_where_the_stone_stopped(noise):
    rest = inspected(throw(np.arange(0, 25, 0.02), noise)).rest
    # within a second of 20 s a stone moves less than 5 cm
    assert rest.since == pytest.approx(20, abs=np.sqrt(2 * (0.003 + 8 * noise) / SLOWING))
    assert rest.within < 0.003 + 8 * noise


def test_a_moving_end_has_a_speed():
    rest = inspected(throw(np.arange(0, 15, 0.02))).rest
    assert rest.since is None
    assert rest.speed == pytest.approx(
        np.hypot(0.5, 0.5 * stone(np.array([15.0]))[0] / 200), rel=0.1
    )


def test_pauses_and_jumps_are_counted():
    t = np.delete(np.arange(0, 15, 0.05), slice(100, 130))
    one = throw(t, 0.001)
    spoiled = one.y.copy()
    spoiled[50] += 3.0  # there and back
    found = inspected(Throw.from_arrays(t, one.x, spoiled))
    assert found.clock.pauses == 1
    assert found.clock.longest == pytest.approx(1.55)
    assert found.clock.after == pytest.approx(4.95)
    assert found.jumps == {"y": 2}
    lines = list(facts(one, found, {"until": 12}))
    assert "interval   0.05 s (0.05 .. 1.55 s), 20 rows a second" in lines
    assert "pauses     1, the longest 1.55 s after t = 4.95 s" in lines
    assert "settings   until = 12" in lines


def test_a_speed_that_was_measured_says_how_the_throw_ends():
    t = np.arange(0.0, 10.0)
    for last, words in ((0.0, "at the last row"), (0.5, "not reached: 0.5 m/s at the end")):
        one = Throw.from_arrays(t, speed=np.linspace(2.0, last, 10))
        assert f"rest       {words}" in list(facts(one, inspected(one), {}))
    spin = Throw.from_arrays(t, omega=t)
    assert "rest       not known: the place is hardly seen" in list(
        facts(spin, inspected(spin), {})
    )


def test_a_line_in_dots_rises_from_corner_to_corner():
    lines = braille(np.arange(100.0), np.arange(100.0), width=10, height=2)
    assert [len(line) for line in lines] == [10, 5]
    dots = sum((ord(sign) - 0x2800).bit_count() for line in lines for sign in line)
    assert dots >= 20  # each column has one at least
    assert ord(lines[0][9]) & 0x08  # top right
    assert ord(lines[1][0]) & 0x40  # bottom left
