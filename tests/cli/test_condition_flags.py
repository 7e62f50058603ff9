"""--free, --prior and --systematic in the commands that have them, and as settings."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from conftest import command

from curlfit import (
    LAWS,
    InitialState,
    Stone,
    Throw,
    load_comparison,
    load_fit,
    load_joint,
    simulate,
)
from curlfit.cli import main
from curlfit.environment import Environment
from curlfit.inference.conditions import CONDITIONS
from curlfit.throws.synthetic import write_table

FLAGS = ("--free", "slope_x", "--prior", "mu=0.01+-0.001")
COULOMB = ("--law", "coulomb")
QUICK = ("--no-sample", "--no-figures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two throws on ice that falls 0.2 mm/m to the right."""
    folder, random = tmp_path_factory.mktemp("flags"), np.random.default_rng(5)
    for name, omega in (("a", 1.3), ("b", -1.6)):
        path = simulate(
            LAWS["coulomb"](0.009), Stone(), InitialState(v=2.0, omega=omega),
            np.linspace(0, 20, 201), environment=Environment(slope_x=2e-4),
        ).to_numpy()  # fmt: skip
        noisy = [
            series + size * random.standard_normal(201)
            for series, size in ((path.x, 0.005), (path.y, 0.005), (path.phi, 0.01))
        ]
        (folder / f"{name}.csv").write_text(write_table(Throw.from_arrays(path.t, *noisy)))
    return folder


def body(text):
    return " ".join(text[: text.index("Written:")].split())


def test_fit_estimates_a_slope_with_a_prior_and_names_systematic_errors(typed, folder):
    out = typed("fit", "a.csv", *COULOMB, *FLAGS, "--systematic", "all=0,slope_y=1e-4", *QUICK)
    fit = load_fit(folder / "a-fit")
    assert set(fit.conditions) == {"slope_x"}
    for name, true in (("slope_x", 2e-4), ("mu", 0.009)):
        item = fit.parameters[name]
        assert item.verdict == "determined"
        assert abs(item.value - true) < 4 * item.stderr
    assert fit.parameters["mu"].prior == "0.01+-0.001"
    assert fit.systematics.widths == {"slope_y": 1e-4}
    shift = fit.systematics.shifts["mu"]["slope_y"]
    assert 9e-5 < shift < 1.01e-4
    said = body(out)
    assert "slope_x (m/m)" in said
    assert "The path and the priors determine 8 of 8 parameters" in said
    assert "slopes down along the throw by 0.1 mm/m, the true mu is 9.9e-05 higher" in said
    assert " ".join(typed("show", "a-fit").split()) == said
    record = json.loads(typed("show", "a-fit", "--json"))
    assert record["systematics"]["widths"] == {"slope_y": 1e-4}
    assert record["parameters"]["mu"]["prior"] == "0.01+-0.001"
    assert record["chi_squared"] > 0
    assert record["prior_chi_squared"] == pytest.approx(1.0, rel=0.1)  # one width off


def test_settings_of_a_file_mean_what_the_flags_mean(typed, folder):
    typed("fit", "a.csv", *COULOMB, *FLAGS, "--systematic", "rho=0.001", *QUICK, "--out", "flags")
    (folder / "c.toml").write_text(
        'law = "coulomb"\nfree = ["slope_x"]\nprior.mu = "0.01+-0.001"\nsystematic.rho = 0.001\n'
    )
    typed("fit", "a.csv", "--config", "c.toml", *QUICK, "--out", "config")
    flags, config = (
        json.loads((folder / name / "fit.json").read_text()) for name in ("flags", "config")
    )
    assert config == flags
    assert flags["systematics"]["widths"]["rho"] == 0.001
    # a flag is over the file, table by table
    typed("fit", "a.csv", "--config", "c.toml", "--prior", "mu=0.02+-0.01", *QUICK, "--out", "both")
    assert load_fit(folder / "both").parameters["mu"].prior == "0.02+-0.01"


def test_several_throws_share_the_conditions(typed, folder):
    out = typed("fit", "a.csv", "b.csv", "--free", "slope_x", "--prior",
 "mu1_xi=0.01+-0.001", "--systematic", "rho=0", "--no-figures")  # fmt: skip
    joint = load_joint(folder / "joint-fit")
    assert joint.coefficients["mu1_xi"].prior == "0.01+-0.001"
    assert abs(joint.coefficients["slope_x"].value - 2e-4) < 4e-5
    assert {"slope_x", "rho"}.isdisjoint(joint.systematics.widths)
    assert joint.systematics.errors["mu1_xi"] > 0
    said = body(out)
    assert "shared: mu1_xi, mu2_xi, mu1_eta, mu2_eta, slope_x" in said
    assert "Systematic errors come from conditions that the fit holds fixed" in said
    assert " ".join(typed("show", "joint-fit").split()) == said
    saved = load_fit(folder / "joint-fit" / "a")
    assert saved.systematics.widths == joint.systematics.widths


def test_profile_compare_and_batch_have_the_flags(typed, folder):
    typed("fit", "a.csv", *COULOMB, *FLAGS, *QUICK, "--out", "alone")
    alone = load_fit(folder / "alone")
    slope, mu = (alone.parameters[name] for name in ("slope_x", "mu"))

    out = typed("profile", "a.csv", "--param", "slope_x", *COULOMB, *FLAGS, "--points", 9,
                "--no-figures")  # fmt: skip
    found = json.loads((folder / "a-profile-slope_x" / "profile.json").read_text())
    assert found["verdict"] == "limited"
    low, high = (found["intervals"][0][end] for end in ("low", "high"))
    assert (high - low) / 2 == pytest.approx(slope.stderr, rel=0.05)
    assert "slope_x" in out
    assert " ".join(typed("show", "a-profile-slope_x").split()) == body(out)

    typed("compare", "a.csv", "--laws", "coulomb", *FLAGS, "--no-figures")
    (one,) = load_comparison(folder / "a-compare").candidates
    assert one.coefficients["mu"]["value"] == pytest.approx(mu.value, rel=1e-6)

    typed("batch", "a.csv", "b.csv", *COULOMB, *FLAGS, "--systematic", "all=0,slope_y=1e-4",
          "--workers", 1, "--out", "table.csv")  # fmt: skip
    with (folder / "table.csv").open() as file:
        first, _ = csv.DictReader(file)
    assert float(first["slope_x"]) == pytest.approx(slope.value, abs=1e-3 * slope.stderr)
    assert float(first["mu"]) == pytest.approx(mu.value, abs=1e-3 * mu.stderr)
    assert 9e-5 < float(first["mu_systematic"]) < 1.01e-4
    assert float(first["slope_x_systematic"]) < 1e-4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fit", "a.csv", "--free", "slope"), "no parameter 'slope'"),
        (("fit", "a.csv", "b.csv", "--free", "slope"), "no parameter 'slope'"),
        (("profile", "a.csv", "--param", "mu1_xi", "--free", "slope"), "no parameter 'slope'"),
        (("compare", "a.csv", "--free", "slope"), "--free: none of the laws has a parameter"),
        (("compare", "a.csv", "--prior", "slope=1+-1"), "--prior: none of the laws has a param"),
        (("batch", "a.csv", "--free", "slope"), "no parameter 'slope'"),
        (
            ("batch", "a.csv", "--systematic", "slope=1"),
            "condition 'slope'; the conditions are slope_x",
        ),
        (("fit", "a.csv", "--prior", "rho"), "--prior rho: expected NAME=PRIOR"),
        (("fit", "a.csv", "--prior", "rho=1", "--prior", "rho=2+-1"), "rho is given twice"),
        (("fit", "a.csv", "--prior", "rho=about 1"), "prior of rho: 'about 1' is no prior"),
        (("fit", "a.csv", "--prior", "rho=1+-0"), "prior of rho: 1+-0 expected a positive width"),
        (("fit", "a.csv", "--free", "rho", "--fix", "rho=0.1"), "rho is fixed and is free"),
        (
            ("fit", "a.csv", "--systematic", "slope=1"),
            "condition 'slope'; the conditions are slope_x",
        ),
        (("fit", "a.csv", "b.csv", "--systematic", "slope=1"), "no condition 'slope'"),
        (("fit", "a.csv", "--systematic", "rho=-1"), "rho = -1; expected a width of 0 or more"),
        (("fit", "a.csv", "--systematic", "rho"), "expected NAME=VALUE"),
        (("fit", "a.csv", "--config", "free.toml"), "free = 'rho'; expected a list of names"),
        (("fit", "a.csv", "--config", "prior.toml"), "prior.rho = 0.1; expected a string such as"),
        (("fit", "a.csv", "--config", "wide.toml"), "systematic.rho = 'much'; expected a number"),
        (("laws", "coulomb", "--conditions"), "--conditions are those of any law; give no names"),
    ],
)
def test_refusals(words, said, folder, monkeypatch, capsys):
    (folder / "free.toml").write_text('free = "rho"\n')
    (folder / "prior.toml").write_text("prior.rho = 0.1\n")
    (folder / "wide.toml").write_text('systematic.rho = "much"\n')
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    monkeypatch.setattr("sys.argv", ["curlfit", *words])
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    assert (stopped.value.code, out) == (2, "")
    assert err.startswith("curlfit: ")
    assert said in " ".join(err.split())
    assert sorted(folder.iterdir()) == before


def test_a_refused_condition_ends_the_process_with_status_2(tmp_path, folder):
    run = command("fit", folder / "a.csv", "--free", "slope", cwd=tmp_path)
    assert (run.returncode, run.stdout) == (2, "")
    assert f"conditions are {', '.join(item.name for item in CONDITIONS)}" in run.stderr


def test_the_conditions_are_listed_with_their_widths(typed):
    out = " ".join(typed("laws", "--conditions").split())
    for item in CONDITIONS:
        assert f"{item.name} {item.meaning}; standard uncertainty {item.width:g}" in out
        assert item.basis in out
    listed = json.loads(typed("laws", "--conditions", "--json"))
    assert [one["name"] for one in listed] == [item.name for item in CONDITIONS]
    assert [one["width"] for one in listed] == [item.width for item in CONDITIONS]
