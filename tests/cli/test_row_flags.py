"""--since, --until, --exclude and --sweep in the commands that have them, and as settings."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from curlfit import LAWS, InitialState, Stone, Throw, load_comparison, load_fit, simulate
from curlfit.cli import main
from curlfit.environment import Environment
from curlfit.throws.synthetic import write_table

COULOMB = ("--law", "coulomb")
QUICK = ("--no-sample", "--no-figures")
ROWS = ("--since", "1", "--exclude", "3:3.55,12:13", "--until", "18")
KEPT = 171 - 6 - 11
"""Of 201 rows, ten a second."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A throw that is swept from 6 to 11 s."""
    folder, random = tmp_path_factory.mktemp("rows"), np.random.default_rng(5)
    path = simulate(
        LAWS["coulomb"](0.009), Stone(), InitialState(v=2.0, omega=1.3), np.linspace(0, 20, 201),
        environment=Environment(sweep=0.8, swept_from=6.0, swept_to=11.0),
    ).to_numpy()  # fmt: skip
    noisy = [
        series + size * random.standard_normal(201)
        for series, size in ((path.x, 0.005), (path.y, 0.005), (path.phi, 0.01))
    ]
    table = write_table(Throw.from_arrays(path.t, *noisy))
    (folder / "a.csv").write_text(table)
    own = "# since = 1\n# until = 18\n# exclude = [[3, 3.55], [12, 13]]\n# swept = [6, 11]\n"
    (folder / "own.csv").write_text(own + table)
    return folder


def test_the_rows_of_a_fit_and_sweeping_are_chosen_by_flags_and_in_the_file(typed, folder):
    out = typed("fit", "a.csv", *COULOMB, *ROWS, "--sweep", "6:11", *QUICK)
    assert f"{KEPT} rows, t = 1 .. 18 s" in out
    fit = load_fit(folder / "a-fit")
    item = fit.parameters["sweep"]
    assert abs(item.value - 0.8) < 4 * item.stderr < 0.05
    assert fit.data["swept"] == (6.0, 11.0)
    typed("fit", "own.csv", *COULOMB, *QUICK)
    own = load_fit(folder / "own-fit")
    assert own.data["rows"] == KEPT
    np.testing.assert_array_equal(own.values, fit.values)
    (folder / "c.toml").write_text(
        'law = "coulomb"\nsince = 1\nuntil = 18\nexclude = [[3, 3.55], [12, 13]]\nswept = [6, 11]\n'
    )
    typed("fit", "a.csv", "--config", "c.toml", *QUICK, "--out", "config")
    np.testing.assert_array_equal(load_fit(folder / "config").values, fit.values)


def test_a_fit_that_does_not_know_of_the_sweeping_proposes_the_flag(typed):
    said = " ".join(typed("fit", "a.csv", *COULOMB, *QUICK, "--out", "plain").split())
    assert "Warning: the friction changes abruptly, by a factor of about 0." in said
    flag = said.split("`--sweep ")[1].split("`")[0]
    again = typed("fit", "a.csv", *COULOMB, "--sweep", flag, *QUICK, "--out", "again")
    assert "changes abruptly" not in again


def test_in_a_joint_fit_each_throw_keeps_what_its_file_states(typed, folder):
    random = np.random.default_rng(6)
    path = simulate(
        LAWS["coulomb"](0.009), Stone(), InitialState(v=2.1, omega=-1.3), np.linspace(0, 20, 201)
    ).to_numpy()
    channels = [series + 0.005 * random.standard_normal(201) for series in (path.x, path.y)]
    own = "# since = 2\n"
    (folder / "unswept.csv").write_text(own + write_table(Throw.from_arrays(path.t, *channels)))
    (folder / "own2.csv").write_text((folder / "own.csv").read_text())
    quick = (*COULOMB, "--no-figures")
    typed("fit", "own.csv", "unswept.csv", *quick, "--out", "joint")
    swept, unswept = (load_fit(folder / "joint" / name) for name in ("own", "unswept"))
    assert swept.data["swept"] == (6.0, 11.0)
    assert unswept.data["swept"] is None
    assert abs(swept["sweep"].value - 0.8) < 4 * swept["sweep"].stderr < 0.05
    assert unswept.data["since"] == 2.0
    # Flags override what the files state, of all throws.
    flags = ("--since", "0.5", "--sweep", "6:10.9")
    typed("fit", "own.csv", "own2.csv", *quick, *flags, "--out", "flags")
    for name in ("own", "own2"):
        fit = load_fit(folder / "flags" / name)
        assert fit.data["swept"] == (6.0, 10.9)
        assert fit.data["from"] == fit.data["since"] == 0.5


def test_a_table_of_throws_has_columns_of_sweep_if_a_file_states_it(typed, folder):
    typed("batch", "own.csv", "a.csv", *COULOMB, "--out", "swept.csv", "--workers", "1")
    plain, swept = csv.DictReader((folder / "swept.csv").read_text().splitlines())
    assert swept["status"] == plain["status"] == "ok"
    assert abs(float(swept["sweep"]) - 0.8) < 4 * float(swept["sweep_stderr"]) < 0.05
    assert (plain["file"], plain["sweep"], plain["sweep_verdict"]) == ("a.csv", "", "")


def test_other_verbs_take_them(typed, folder):
    typed("compare", "a.csv", "--laws", "coulomb", *ROWS, "--sweep", "6:11", "--no-figures")
    assert load_comparison(folder / "a-compare").data["rows"] == KEPT
    out = typed("profile", "a.csv", *COULOMB, *ROWS, "--sweep", "6:11", "--param", "sweep")
    assert "0.8" in out
    typed("batch", "a.csv", *COULOMB, *ROWS, "--out", "rows.csv", "--workers", "1")
    (row,) = csv.DictReader((folder / "rows.csv").read_text().splitlines())
    assert int(row["n_observations"]) == 3 * KEPT


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--since", "30"], "remains with since = 30 s"),
        (["--exclude", "3"], "--exclude 3: expected A:B"),
        (["--exclude", "4:3"], "A before B"),
        (["--exclude", "0:40"], "the excluded intervals leave no row"),
        (["--sweep", "5"], "--sweep 5: expected A:B"),
        (["--sweep", "5:6,7:8"], "expected A:B, times in s with A before B"),
        (["--free", "sweep"], "a parameter only of a swept stone"),
    ],
)
def test_refusals(words, fault, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.argv", ["curlfit", "fit", "a.csv", *words, "--out", "refused"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert fault in capsys.readouterr().err
    assert not (folder / "refused").exists()
