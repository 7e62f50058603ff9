"""Conditions, priors, systematic errors, rows and sweeping: in every verb that has
their flags, in a configuration, and in the file of the data."""

from __future__ import annotations

import json
from types import NoneType
from typing import get_args, get_type_hints

import numpy as np
import pytest
from conftest import filmed

from curlfit import LAWS, load_comparison, load_fit, load_profile
from curlfit.environment import Environment
from curlfit.inference.model.conditions import CONDITIONS
from curlfit.settings.choices import Comparing, Fitting, Reading
from curlfit.throws.synthetic import write_table

COULOMB = ("--law", "coulomb")
QUICK = ("--no-sample", "--no-figures")
GIVEN = ("--bound", "mu=0:0.5", "--stone", "h=0.06")
ASSUMED = ("--free", "slope_x", "--prior", "mu=0.01+-0.001", *GIVEN)
SYSTEMATIC = ("--systematic", "all=0,slope_y=1e-3")
ROWS = ("--since", "1", "--exclude", "3:3.55,12:13", "--until", "18")
SWEPT = ("--sweep", "6:11")
CHOSEN = (*COULOMB, *ASSUMED, *ROWS, *SWEPT)
KEPT = 171 - 6 - 11
"""Of 201 rows, ten a second."""
OWN = (
    "# since = 1\n# until = 18\n# exclude = [[3, 3.55], [12, 13]]\n# swept = [6, 11]\n"
)
SETTINGS = """
law = "coulomb"
free = ["slope_x"]
prior.mu = "0.01+-0.001"
bound.mu = [0, 0.5]
stone.h = 0.06
systematic = {all = 0, slope_y = 1e-3}
since = 1
until = 18
exclude = [[3, 3.55], [12, 13]]
swept = [6, 11]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A throw on ice that falls 0.2 mm/m to the right, swept from 6 to 11 s."""
    folder = tmp_path_factory.mktemp("flags")
    ice = Environment(slope_x=2e-4, sweep=0.8, swept_from=6.0, swept_to=11.0)
    throw = filmed(LAWS["coulomb"](0.009), 5, v=2.0, omega=1.3, environment=ice)
    (folder / "a.csv").write_text(write_table(throw))
    (folder / "own.csv").write_text(OWN + (folder / "a.csv").read_text())
    (folder / "c.toml").write_text(SETTINGS)
    return folder


def holds(fit, **true):
    """Whether estimates with an error agree with the true values."""
    for name, value in true.items():
        assert fit[name].verdict == "determined"
        assert abs(fit[name].value - value) < 4 * fit[name].stderr, name


def test_a_fit_says_what_was_chosen(typed, folder):
    out = typed("fit", "a.csv", *CHOSEN, *SYSTEMATIC, *QUICK)
    report = " ".join(out[: out.index("Written:")].split())
    fit = load_fit(folder / "a-fit")
    assert set(fit.conditions) == {"slope_x", "sweep"}
    holds(fit, slope_x=2e-4, mu=0.009, sweep=0.8)
    assert fit["sweep"].stderr < 0.0125
    assert fit.data.swept == (6.0, 11.0)
    shift = fit.systematics.shifts["mu"]["slope_y"]
    assert 9e-4 < shift < 1.01e-3
    for words in (
        f"{KEPT} rows, t = 1 .. 18 s",
        "slope_x (m/m)",
        "The path and the priors determine 9 of 9 parameters",
        f"slopes down along the throw by 1 mm/m, the true mu is {shift:.2g} higher",
    ):
        assert words in report
    assert " ".join(typed("show", "a-fit").split()) == report
    record = json.loads(typed("show", "a-fit", "--json"))
    assert record["systematics"]["widths"] == {"slope_y": 1e-3}
    assert record["parameters"]["mu"]["prior"] == "0.01+-0.001"
    assert record["prior_chi_squared"] == pytest.approx(1.0, rel=0.2)  # one width off


def test_settings_of_files_mean_what_the_flags_mean(typed, folder):
    typed("fit", "a.csv", *CHOSEN, *SYSTEMATIC, *QUICK, "--out", "flags")
    typed("fit", "a.csv", "--config", "c.toml", *QUICK, "--out", "config")
    flags, config = (
        json.loads((folder / name / "fit.json").read_text())
        for name in ("flags", "config")
    )
    assert config == flags
    typed("fit", "own.csv", *COULOMB, *ASSUMED, *SYSTEMATIC, *QUICK)
    from_file = load_fit(folder / "own-fit")
    assert from_file.data.rows == KEPT
    np.testing.assert_array_equal(from_file.values, load_fit(folder / "flags").values)
    # a flag is over the file, table by table
    typed(
        "fit",
        "a.csv",
        "--config",
        "c.toml",
        "--prior",
        "mu=0.02+-0.01",
        *QUICK,
        "--out",
        "both",
    )
    assert load_fit(folder / "both").parameters["mu"].prior == "0.02+-0.01"


@pytest.fixture
def alone(typed, folder):
    typed("fit", "a.csv", *CHOSEN, *QUICK, "--out", "alone")
    return load_fit(folder / "alone")


def test_profile_and_compare_have_the_flags(typed, folder, alone):
    out = typed(
        "profile", "a.csv", "--param", "slope_x", *CHOSEN, "--points", 9, "--no-figures"
    )
    profile = load_profile(folder / "a-profile-slope_x")
    assert profile.verdict == "limited"
    near = profile.intervals[0]
    assert (near.high - near.low) / 2 == pytest.approx(
        alone["slope_x"].stderr, rel=0.05
    )
    assert profile.data.rows == KEPT
    report = " ".join(out[: out.index("Written:")].split())
    assert " ".join(typed("show", "a-profile-slope_x").split()) == report

    typed("compare", "a.csv", "--laws", "coulomb", *CHOSEN[2:], "--no-figures")
    comparison = load_comparison(folder / "a-compare")
    (candidate,) = comparison.candidates
    assert comparison.data.rows == KEPT
    assert candidate.coefficients["mu"]["value"] == pytest.approx(
        alone["mu"].value, rel=1e-6
    )


def test_the_conditions_are_listed_with_their_widths(typed):
    out = " ".join(typed("laws", "--conditions").split())
    for condition in CONDITIONS:
        assert (
            f"{condition.name} {condition.meaning}; "
            f"standard uncertainty {condition.width:g}" in out
        )
        assert condition.basis in out


@pytest.mark.parametrize("kind", [Comparing, Fitting, Reading])
def test_a_choice_that_is_not_given_is_of_its_declared_type(kind):
    """cyclopts checks defaults in a process that has loaded Pydantic, as the file
    of a law may."""
    hints = get_type_hints(kind)
    unset = [name for name in kind.forms() if getattr(kind, name, ()) is None]
    assert unset
    assert [name for name in unset if NoneType not in get_args(hints[name])] == []
