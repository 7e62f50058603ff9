"""What is said of a throw before a fit, against throws of which it is known."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pytest
from conftest import command

from curlfit import Throw
from curlfit.throws.channels import scatter
from curlfit.throws.motion import final_speed, first_row_at_rest, path_of
from curlfit.throws.report import facts

SLOWING = 0.1  # m/s^2
SPEED = 2.0  # m/s: at rest after 20 s and 20 m


def stone(t, noise=0.0, seed=0):
    s = np.minimum(t, SPEED / SLOWING)
    y = SPEED * s - SLOWING * s**2 / 2
    return y + noise * np.random.default_rng(seed).standard_normal(len(t))


def throw(t, noise=0.0, **more):
    return Throw.from_arrays(
        t, stone(t, noise, 1) ** 2 / 400, stone(t, noise, 2), **more
    )


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_scatter_is_the_noise_and_not_the_bend(noise):
    t = np.arange(0, 20, 0.1)
    assert scatter(stone(t, noise)) == pytest.approx(noise, rel=0.2)
    bent = np.cos(t)  # its second differences reach 0.01
    assert scatter(bent) < 5e-4
    assert scatter(bent[:9]) == 0


def ending(power, until, noise, dt, seed):
    """A throw whose speed falls as 2 m/s (1 - t/20 s)^power, and its speed at
    the last row.

    Powers of 2/3, 1 and 2 are those of friction as v^-1/2, constant and as v^1/2.
    """
    random = np.random.default_rng(seed)
    t = np.arange(random.uniform(0, dt), until, dt)
    left = np.maximum(1 - t / 20, 0)
    along = SPEED * 20 / (power + 1) * (1 - left ** (power + 1))
    track = np.stack([0.03 * along, along]) + noise * random.standard_normal(
        (2, len(t))
    )
    return Throw.from_arrays(t, *track), np.hypot(1, 0.03) * SPEED * left[-1] ** power


def test_a_throw_cut_off_is_not_at_rest():
    off = []
    for power, noise, dt, speed in product(
        (2 / 3, 1, 2),
        (0.0, 0.001, 0.005, 0.02),
        (0.02, 0.1, 0.5),
        (0.05, 0.1, 0.15, 0.3, 0.5),
    ):
        until = 20 * (1 - (speed / SPEED) ** (1 / power))
        for seed in range(4):
            cut_throw, last = ending(power, until, noise, dt, seed)
            rows = path_of(cut_throw)
            assert first_row_at_rest(*rows) is None, (power, noise, dt, speed, seed)
            estimate, error = final_speed(*rows)
            off.append((estimate - last) / error)
    # 0.954, were the paths parabolas; the braking of the first grows without
    # limit toward rest
    assert 0.92 < np.mean(np.abs(off) < 2) < 0.98


@pytest.mark.parametrize("power", [2 / 3, 1])
@pytest.mark.parametrize(
    ("noise", "dt", "after"),
    [
        (0.0, 0.02, 0.5),
        (0.001, 0.1, 1),
        (0.005, 0.02, 1),
        (0.005, 0.1, 2),
        (0.005, 0.5, 4),
        (0.02, 0.02, 2),
        (0.02, 0.1, 4),
    ],
)
def test_rest_is_seen_where_it_lasted(power, noise, dt, after):
    for seed in range(8):
        t, positions = path_of(ending(power, 20 + after, noise, dt, seed)[0])
        first = first_row_at_rest(t, positions)
        assert first is not None, seed
        assert -0.5 - 60 * noise < t[first] - 20 < after, seed


def test_what_is_not_certain_is_said():
    for throw_and_speed, words in (
        (
            ending(1, 20.5, 0.02, 0.1, 3),
            r"uncertain: 0\.\d+\(\d+\) m/s at the last row",
        ),
        (
            ending(1, 18, 0.002, 0.1, 0),
            r"not observed: 0\.2\d+\(\d+\) m/s at the last row",
        ),
    ):
        (line,) = (
            line for line in facts(throw_and_speed[0], {}) if line.startswith("rest")
        )
        assert re.fullmatch(f"rest       {words}", line)


def test_pauses_are_counted():
    t = np.delete(np.arange(0, 15, 0.05), slice(100, 130))
    lines = list(facts(throw(t, 0.001), {"until": 12}))
    assert "interval   0.05 s (0.05 .. 1.55 s), 20 rows per second" in lines
    assert "pauses     1, the longest 1.55 s after t = 4.95 s" in lines
    assert "settings   until = 12" in lines


def test_a_speed_that_was_measured_says_how_the_throw_ends():
    t = np.arange(0.0, 10.0)
    for last, words in (
        (0.0, "at the last row"),
        (0.5, "not reached: 0.5 m/s at the end"),
    ):
        speeds = Throw.from_arrays(t, speed=np.linspace(2.0, last, 10))
        assert f"rest       {words}" in list(facts(speeds, {}))
    spin = Throw.from_arrays(t, omega=t)
    assert "rest       unknown: too few positions" in list(facts(spin, {}))


def test_what_no_fit_can_use_is_refused_by_check(tmp_path):
    (tmp_path / "two.csv").write_text("t,x,y,phi\n0,0,0,0\n1,0,2,1\n")
    run = command("check", "two.csv", cwd=tmp_path)
    assert run.returncode == 2
    assert "two.csv: 2 rows for 10 parameters; give more rows" in run.stderr
    (tmp_path / "three.csv").write_text("t,x,y,phi\n0,0,0,0\n1,0,2,1\n2,0,3.9,1.9\n")
    run = command("check", "three.csv", cwd=tmp_path)
    assert run.returncode == 0
    assert "No fit as set: three.csv: 3 rows for 10 parameters" in run.stdout
