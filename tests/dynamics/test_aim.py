"""Throws that are to come to rest at a place."""

from __future__ import annotations

import numpy as np
import pytest

import curlfit
from curlfit.dynamics import aim as aims
from curlfit.environment import Environment
from curlfit.errors import InputError

LAW = curlfit.law_with("front-back", {"mu2_xi": 0.055})
STONE = curlfit.Stone()
SLOPING = Environment(slope_x=0.001, slope_y=-0.0005)
TARGET = (0.4, 28.0)


@pytest.mark.parametrize("ice", [None, SLOPING])
def test_the_throw_rests_at_its_target(ice):
    throw = curlfit.aim(LAW, STONE, TARGET, omega0=1.0, environment=ice)
    start = curlfit.InitialState(v=throw.v0, heading=throw.heading, omega=1.0)
    path = curlfit.simulate(LAW, STONE, start, [0.0, np.inf], environment=ice)
    assert (path.x[-1], path.y[-1]) == pytest.approx(TARGET, abs=1e-6)


def test_a_heading_that_does_not_settle_is_refused(monkeypatch):
    monkeypatch.setattr(aims, "_MAX_TURNS", 2)
    with pytest.raises(InputError, match="its heading did not settle in 2 trials"):
        curlfit.aim(LAW, STONE, TARGET, omega0=1.0, environment=SLOPING)
