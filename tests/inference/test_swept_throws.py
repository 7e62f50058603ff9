"""A stone that was swept: its friction meanwhile, and that a fit without it says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import TIMES, codes_of, filmed, finding_of

import curlfit
from curlfit import LAWS, InputError, Throw
from curlfit.environment import Environment

LAW = LAWS["front-back"](0.005, 0.05, 0.009, 0.009)
T0 = 100.0  # of the clock
SWEPT = (5.0, 9.0)


def thrown(seed, factor=0.85):
    environment = Environment(sweep=factor, swept_from=SWEPT[0], swept_to=SWEPT[1])
    omega = (-1) ** seed * 1.2
    throw = filmed(LAW, seed, v=2.05, omega=omega, environment=environment)
    return replace(throw, t=T0 + TIMES)


@pytest.fixture(scope="module")
def swept():
    return thrown(0)


@pytest.fixture(scope="module")
def fitted(swept):
    return curlfit.fit(swept, swept=[T0 + time for time in SWEPT])


def test_the_friction_while_swept_is_found(fitted):
    sweep = fitted.parameters["sweep"]
    assert sweep.verdict == "determined"
    assert abs(sweep.value - 0.85) < 3 * sweep.stderr < 0.01
    assert fitted.conditions.keys() == {"sweep"}
    total = fitted.combinations[0]
    assert abs(total.value - 0.018) < 3 * total.stderr
    assert "residuals-change" not in codes_of(fitted)


def test_a_fit_that_does_not_know_of_it_says_so(swept):
    """And what it says to try finds the sweeping (see also `test_change_points`)."""
    times = sweep_of(finding_of(curlfit.fit(swept), "residuals-change"))
    assert times == pytest.approx([T0 + time for time in SWEPT], abs=1.5)
    again = curlfit.fit(swept, swept=times, details=False)
    assert again.parameters["sweep"].value == pytest.approx(0.85, abs=0.05)


def sweep_of(finding):
    """The times between which a finding proposes that a throw was swept, s."""
    (option,) = [option for option in finding.options if option.name == "sweep"]
    return [float(time) for time in option.value.split(":")]


def abrupt_changes(result):
    """Warnings of a joint fit, by the throw that they name."""
    return {
        throw.data.file: finding_of(throw, "residuals-change")
        for throw in result.throws
        if "residuals-change" in codes_of(throw)
    }


def test_a_joint_fit_says_what_single_fits_say(swept):
    """The throw that was swept is named, with the times that its own fit gives; the
    others are not. Beside one whose sweeping is known, too: `sweep` is then a
    parameter of all, and has no effect on this one."""
    unswept = [replace(thrown(seed, factor=1.0), name=f"{seed}") for seed in (2, 3)]
    suspect = replace(swept, name="suspect")
    alone = finding_of(curlfit.fit(suspect), "residuals-change")
    together = curlfit.fit_together([suspect, *unswept], share="all")
    changes = abrupt_changes(together)
    assert changes.keys() == {"suspect"}
    assert sweep_of(changes["suspect"]) == pytest.approx(sweep_of(alone), abs=1.0)
    assert finding_of(together, "residuals-change").about == ("suspect",)
    declared = replace(
        thrown(4), name="known", defaults={"swept": [T0 + time for time in SWEPT]}
    )
    mixed = curlfit.fit_together([suspect, declared, unswept[0]], share="all")
    assert abrupt_changes(mixed).keys() == {"suspect"}


def test_joint_fits_of_throws_that_vary_say_so_too(swept):
    throws = [replace(thrown(seed, factor=1.0), name=f"{seed}") for seed in range(2, 6)]
    result = curlfit.fit_together([replace(swept, name="suspect"), *throws])
    assert result.varies
    assert abrupt_changes(result).keys() == {"suspect"}


@pytest.mark.parametrize(
    ("at", "size", "cut", "limits"),
    [(12.0, 0.2, "until", (10.5, 12.0)), (6.0, 0.2, "since", (6.0, 7.5))],
)
def test_a_stone_that_another_one_touches_is_found(at, size, cut, limits):
    plain = thrown(1, factor=1.0)
    hit = plain.x + size * np.maximum(TIMES - at, 0.0)
    throw = Throw.from_arrays(plain.t, hit, plain.y, plain.phi)
    change = finding_of(curlfit.fit(throw, details=False), "residuals-change")
    assert change.numbers["times"][0] == pytest.approx(T0 + at, abs=0.6)
    (option,) = [option for option in change.options if option.name == cut]
    value = float(option.value) - T0
    assert limits[0] <= value <= limits[1]
    again = curlfit.fit(throw, **{cut: T0 + value}, details=False)
    assert "residuals-change" not in codes_of(again)


@pytest.mark.parametrize(
    ("choices", "fault"),
    [
        ({"swept": (9.0, 5.0)}, "the earlier first"),
        ({"swept": (5.0,)}, "two times"),
        ({"free": ["sweep"]}, "a parameter only of a swept stone"),
        ({"priors": {"sweep": "0.9+-0.1"}}, "a parameter only of a swept stone"),
    ],
)
def test_what_is_not_said_well_is_refused(swept, choices, fault):
    with pytest.raises(InputError, match=fault):
        curlfit.fit(swept, **choices)
