"""A stone that was swept: its friction meanwhile, and that a fit without it says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import TIMES, filmed

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
    item = fitted.parameters["sweep"]
    assert item.verdict == "determined"
    assert abs(item.value - 0.85) < 3 * item.stderr < 0.01
    assert fitted.conditions.keys() == {"sweep"}
    total = fitted.combinations[0]
    assert abs(total.value - 0.018) < 3 * total.stderr
    assert not any("the residuals change" in text for text in fitted.warnings)


def test_a_fit_that_does_not_know_of_it_says_so(swept):
    """And what it says to try finds the sweeping (see also `test_change_points`)."""
    (warning,) = (
        text for text in curlfit.fit(swept).warnings if "the residuals change" in text
    )
    said = [
        float(time) for time in warning.split("--sweep ")[1].split("`")[0].split(":")
    ]
    assert said == pytest.approx([T0 + time for time in SWEPT], abs=1.5)
    again = curlfit.fit(swept, swept=said, details=False)
    assert again.parameters["sweep"].value == pytest.approx(0.85, abs=0.05)


def abrupt_changes(result):
    """Warnings of a joint fit, by the throw that they name."""
    found = {}
    for one in result.throws:
        texts = [text for text in one.warnings if "the residuals change" in text]
        if texts:
            (found[one.data["file"]],) = texts
    return found


def test_a_joint_fit_says_what_single_fits_say(swept):
    """The throw that was swept is named, with the times that its own fit gives; the
    others are not. Beside one whose sweeping is known, too: `sweep` is then a
    parameter of all, and has no effect on this one."""
    others = [replace(thrown(seed, factor=1.0), name=f"{seed}") for seed in (2, 3)]
    suspect = replace(swept, name="suspect")
    (alone,) = (
        text for text in curlfit.fit(suspect).warnings if "the residuals change" in text
    )
    together = curlfit.fit_together([suspect, *others], share="all")
    said = abrupt_changes(together)
    assert said.keys() == {"suspect"}
    times = [
        text.split("--sweep ")[1].split("`")[0] for text in (alone, said["suspect"])
    ]
    (begin, end), joint = ([float(time) for time in one.split(":")] for one in times)
    assert joint == pytest.approx([begin, end], abs=1.0)
    assert any(
        text.startswith("suspect: the residuals change") for text in together.warnings
    )
    known = replace(
        thrown(4), name="known", defaults={"swept": [T0 + time for time in SWEPT]}
    )
    mixed = curlfit.fit_together([suspect, known, others[0]], share="all")
    assert abrupt_changes(mixed).keys() == {"suspect"}


def test_joint_fits_of_throws_that_vary_say_so_too(swept):
    throws = [replace(thrown(seed, factor=1.0), name=f"{seed}") for seed in range(2, 6)]
    result = curlfit.fit_together([replace(swept, name="suspect"), *throws])
    assert result.varies
    assert abrupt_changes(result).keys() == {"suspect"}


@pytest.mark.parametrize(
    ("at", "size", "flag", "limits"),
    [(12.0, 0.2, "--until", (10.5, 12.0)), (6.0, 0.2, "--since", (6.0, 7.5))],
)
def test_a_stone_that_another_one_touches_is_found(at, size, flag, limits):
    plain = thrown(1, factor=1.0)
    hit = plain.x + size * np.maximum(TIMES - at, 0.0)
    throw = Throw.from_arrays(plain.t, hit, plain.y, plain.phi)
    said = curlfit.fit(throw, details=False).warnings
    (warning,) = (text for text in said if "the residuals change" in text)
    assert float(warning.split("t = ")[1].split()[0]) == pytest.approx(T0 + at, abs=0.6)
    value = float(warning.split(f"`{flag} ")[1].split("`")[0]) - T0
    assert limits[0] <= value <= limits[1]
    cut = {"--until": "until", "--since": "since"}[flag]
    again = curlfit.fit(throw, **{cut: T0 + value}, details=False)
    assert not any("the residuals change" in text for text in again.warnings)


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
