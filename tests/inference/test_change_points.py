"""Whether residuals are said to change, and when, of throws whose course is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import codes_of, filmed
from independent_motion import Reference, follow, front_back

import curlfit
from curlfit import InitialState, Stone
from curlfit.environment import Environment
from curlfit.errors import Option

STONE = Stone()
TRACKS = Path(__file__).parent / "friction_by_speed"


def changes(throw, law="front-back"):
    """What the fit says of sudden changes of the residuals."""
    warnings = curlfit.fit(throw, law, details=False).warnings
    return [warning for warning in warnings if warning.code == "residuals-change"]


@pytest.mark.parametrize("exponent", [-0.25, -0.5])
def test_friction_that_depends_on_speed_is_no_sudden_change(exponent):
    """The law's accelerations times a power of the speed, integrated by scipy."""
    times = np.arange(0, 26, 0.1)

    ring = Reference(front_back(0.005, 0.05, 0.009, 0.009), R=STONE.R, rho=STONE.rho)

    def accelerations(v, omega, _turned, _time):
        a_xi, a_eta, moment = 9.81 * v**exponent * ring.force(v, STONE.R * omega)
        return a_xi, a_eta, moment * STONE.R / STONE.rho**2

    path = follow(
        InitialState(v=2.1, omega=1.2), times, [(accelerations, None)], STONE.rho
    )
    speed = np.hypot(*np.gradient(path[:2], times, axis=1))
    moving = speed > 0.3
    noise = np.random.default_rng(0).standard_normal(path.shape) * [
        [0.005],
        [0.005],
        [0.01],
    ]
    throw = curlfit.Throw.from_arrays(times[moving], *(path + noise)[:, moving])
    assert changes(throw) == []


@pytest.mark.parametrize("strength", [2e-5, -5e-5, 1e-4])
def test_positions_bent_by_a_lens_are_no_sudden_change(strength):
    """Radial distortion r (1 + k r^2) about the middle of the picture (Brown 1966)."""
    throw = filmed(seed=0)
    middle = throw.y.mean()
    factor = 1 + strength * (throw.x**2 + (throw.y - middle) ** 2)
    distorted = replace(
        throw, x=throw.x * factor, y=middle + (throw.y - middle) * factor
    )
    assert changes(distorted) == []


@pytest.mark.parametrize(
    ("begin", "end", "factor"), [(5, 9, 0.8), (4, 6, 0.7), (10, 15, 0.75)]
)
def test_when_the_friction_was_another_one_is_found(begin, end, factor):
    environment = Environment(
        sweep=factor, swept_from=float(begin), swept_to=float(end)
    )
    (change,) = changes(filmed(seed=begin, environment=environment))
    times = change.numbers["times"]
    assert times == pytest.approx([begin, end], abs=0.5)
    assert change.options[0] == Option("sweep", f"{times[0]:.1f}:{times[1]:.1f}")
    assert "most in y (see fit.png)" in str(change)


def test_nothing_is_said_of_a_throw_that_the_law_describes(eq12):
    assert [changes(throw) for throw in (filmed(seed=1), eq12)] == [[], []]


@pytest.mark.parametrize("name", ["12_s", "to_rest", "25_hz"])
def test_no_cause_is_guessed_of_friction_that_falls_with_speed(name):
    """Tracks of another simulation whose friction is not that of the law: the fit says
    that its residuals are correlated, and neither that they change nor why."""
    throw = curlfit.load_throw(TRACKS / f"{name}.csv")
    result = curlfit.fit(throw, details=False)
    assert "correlated" in codes_of(result)
    text = " ".join(map(str, result.warnings))
    for word in ("lens", "distorted", "change", "swe", "touch"):
        assert word not in text
