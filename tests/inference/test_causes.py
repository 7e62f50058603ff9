"""What smooth residuals are said to come from: throws whose true cause is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import filmed
from independent_motion import Reference, follow, front_back

import curlfit
from curlfit import InitialState, Stone
from curlfit.environment import Environment

STONE = Stone()
CAUSES = ("changes abruptly", "depends on speed", "distorted along the sheet")


def causes(throw, law="front-back"):
    said = curlfit.fit(throw, law, details=False).warnings
    return [cause for cause in CAUSES for text in said if cause in text], said


@pytest.mark.parametrize("exponent", [-0.25, -0.5])
def test_friction_that_depends_on_speed_is_not_called_sweeping(exponent):
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
    found, said = causes(throw)
    assert found == ["depends on speed"]
    (text,) = (text for text in said if "depends on speed" in text)
    said_exponent = float(text.partition("v^")[2].partition(";")[0])
    assert said_exponent == pytest.approx(exponent, rel=0.3)


@pytest.mark.parametrize("strength", [2e-5, -5e-5, 1e-4])
def test_the_distortion_of_a_lens_is_not_called_sweeping(strength):
    """Radial distortion r (1 + k r^2) about the middle of the picture (Brown 1966)."""
    throw = filmed(seed=0)
    middle = throw.y.mean()
    factor = 1 + strength * (throw.x**2 + (throw.y - middle) ** 2)
    seen = replace(throw, x=throw.x * factor, y=middle + (throw.y - middle) * factor)
    assert causes(seen)[0] == ["distorted along the sheet"]


@pytest.mark.parametrize(
    ("begin", "end", "factor"), [(5, 9, 0.8), (4, 6, 0.7), (10, 15, 0.75)]
)
def test_sweeping_is_still_found_and_where_it_was(begin, end, factor):
    environment = Environment(
        sweep=factor, swept_from=float(begin), swept_to=float(end)
    )
    found, said = causes(filmed(seed=begin, environment=environment))
    assert found == ["changes abruptly"]
    (text,) = (text for text in said if "changes abruptly" in text)
    words = text.split()
    place = words.index("between")
    assert float(words[place + 1]) == pytest.approx(begin, abs=0.5)
    assert float(words[place + 3]) == pytest.approx(end, abs=0.5)
    assert float(words[place - 1]) == pytest.approx(factor, abs=0.08)


def test_nothing_is_said_of_a_throw_that_the_law_describes(eq12):
    assert [causes(throw)[0] for throw in (filmed(seed=1), eq12)] == [[], []]
