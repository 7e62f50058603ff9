"""Very long files: condensed, with the same answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import curlfit
from curlfit import LAWS, Stone
from curlfit.throws.channels import last_motion


@pytest.fixture(scope="module")
def long():
    return curlfit.synthetic_throw(
        LAWS["front-back"](),
        Stone(),
        v0=2.1,
        omega0=1.3,
        until=60.0,
        dt=0.002,
        noise_xy=0.005,
        noise_phi=0.01,
        seed=3,
    )


def test_short_throws_are_left_alone(eq12):
    assert eq12.condensed() is eq12


def test_means_over_blocks_keep_time_place_and_noise(long):
    short = long.condensed(3000)
    assert 2200 < len(short) <= 3000
    assert (np.diff(short.t) > 0).all()
    rest = last_motion(long.t, long.x, long.y)
    assert 22 < rest < 24
    moving = short.t < rest - 0.1
    step = np.diff(short.t[moving])
    assert step.max() < 0.0101
    # every row of the moving part is in one block: the means average to the mean
    rows = long.t <= rest
    assert short.x[short.t <= rest].mean() == pytest.approx(
        long.x[rows].mean(), abs=2e-3
    )
    note = short.notes[-1]
    assert note.code == "condensed"
    assert note.numbers["rows"] == 30001
    assert note.numbers["means"] == len(short)
    assert "was at rest" in str(note)


def test_gaps_stay_gaps(long):
    phi = long.phi.copy()
    phi[2000:4000] = np.nan
    short = replace(long, phi=phi).condensed(3000)
    inside = (short.t > 4.1) & (short.t < 7.9)
    assert np.isnan(short.phi[inside]).all()
    assert np.isfinite(short.x[inside]).all()
