"""A second fit, of a table of throws that were fitted one by one, against the
joint fit of all."""

import csv
import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from conftest import command
from rich.console import Console

import curlfit
from curlfit import Stone
from curlfit.inference.fit.coefficient_rows import coefficient_rows
from curlfit.inference.model.model import Model
from curlfit.inference.together.season import Season, mean_of
from curlfit.throws.synthetic import law_with, synthetic_throw, write_table

STONE = Stone(R=0.065)


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """Ten tracks of two sheets with notes, fitted one by one; and the joint fit
    of the same."""
    folder, random = tmp_path_factory.mktemp("season"), np.random.default_rng(1)
    notes = ["track,sheet,day"]
    (folder / "tracks").mkdir()
    for place in range(10):
        sheet = place % 2 + 1
        half = 0.009 * (1 + 0.04 * sheet + 0.01 * random.standard_normal())
        law = law_with(
            "front-back",
            {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": half, "mu2_eta": half},
        )
        throw = synthetic_throw(
            law,
            STONE,
            v0=random.uniform(2.1, 2.3),
            omega0=random.uniform(1, 2) * (-1) ** place,
            dt=0.2,
            noise_xy=0.005,
            noise_phi=0.01,
            seed=place,
        )
        (folder / "tracks" / f"t{place}.csv").write_text(write_table(throw))
        notes.append(f"t{place}.csv,{sheet},2026-02-{place + 20 if place < 9 else 28}")
    (folder / "notes.csv").write_text("\n".join(notes) + "\n")
    throws = [
        curlfit.load_throw(file, throws=folder / "notes.csv")
        for file in sorted((folder / "tracks").iterdir())
    ]
    words = [
        "tracks",
        "--throws",
        "notes.csv",
        "--stone",
        "R=0.065",
        "--out",
        "season.csv",
    ]
    command("batch", *words, "--workers", "1", cwd=folder)
    ran = command("fit", "season.csv", "--by", "sheet", "--trend", "day", cwd=folder)
    joint = curlfit.fit_together(throws, stone=STONE, by="sheet", trend="day")
    return folder, joint, ran


def test_a_table_gives_what_all_throws_give_together(season):
    folder, joint, ran = season
    assert ran.returncode == 0
    assert "10 throws that were fitted one by one" in ran.stdout + ran.stderr
    found = curlfit.load_joint(folder / "season-fit")
    for kind in ("groups", "differences", "trend"):
        for one, other in zip(getattr(found, kind), getattr(joint, kind), strict=True):
            assert (one.parameter, one.by, one.group) == (
                other.parameter,
                other.by,
                other.group,
            )
            assert one.value == pytest.approx(other.value, abs=0.03 * other.stderr)
            assert one.stderr == pytest.approx(other.stderr, rel=0.03)
    for name, item in joint.coefficients.items():
        assert found.coefficients[name].verdict == item.verdict
        if item.stderr is not None:
            assert found.coefficients[name].value == pytest.approx(
                item.value, abs=0.03 * item.stderr
            )
    (total,) = found.combinations
    assert total.expression == "mu1_eta + mu2_eta"
    determined = found.identifiability
    assert (determined.rank, determined.parameters) == (3, 4)
    assert found.trend[0].unit.endswith("/day")
    assert 1 <= found.r_hat < 1.02
    said = "the posterior of the spreads has not converged (R-hat 1.200)"
    assert said not in ran.stdout
    curlfit.print_joint(
        replace(found, r_hat=1.2), Console(file=(text := StringIO()), width=200)
    )
    assert said in text.getvalue()


def test_the_next_throw_of_a_season_is_that_of_the_joint_fit(season, tmp_path):
    """For the same random numbers; the bands differ by what the means do."""
    folder, joint, _ = season
    asked = ["--sheet", "1", "--to-tee", "--no-figures", "--out", tmp_path]
    assert command("predict", "season-fit", *asked, cwd=folder).returncode == 0
    found = curlfit.load_prediction(tmp_path)
    call = curlfit.Call({"sheet": "1"})
    other = curlfit.predict(joint, call=call, target=(0.0, 0.0))
    assert found.quantities.keys() == other.quantities.keys()
    assert found.start["omega0"]["value"] == pytest.approx(
        other.start["omega0"]["value"], abs=1e-3
    )
    for name, item in other.quantities.items():
        mine = found.quantities[name]
        for level, value in item.quantiles.items():
            assert mine.quantiles[level] == pytest.approx(
                value, abs=0.1 * item.sd + 1e-6
            ), name
    assert list(map(str, found.warnings)) == list(map(str, other.warnings))
    assert list(map(str, found.notes)) == list(map(str, other.notes))
    assert found.weights[2].hog_to_hog == pytest.approx(
        other.weights[2].hog_to_hog, abs=2e-3
    )
    # a record of an earlier version is read, but foretells nothing
    saved, file = (
        json.loads((folder / "season-fit/joint.json").read_text()),
        tmp_path / "a.json",
    )
    for name in ("starts", "duration", "speeds", "spins", "null_directions"):
        del saved["table"][name]
    file.write_text(json.dumps(saved))
    with pytest.raises(curlfit.InputError, match="does not say how its throws began"):
        curlfit.predict(curlfit.load_joint(file), call=call, target=(0.0, 0.0))


def test_what_throws_leave_open_does_not_explain_what_differs_between_them():
    """Under the consistent load a throw tells the halves of the friction hardly apart.
    A division far outside the bounds would explain the scatter of the sum."""
    random, fits = np.random.default_rng(7), []
    for place in range(6):
        half = 0.009 * (1 + 0.01 * random.standard_normal())
        law = law_with("front-back", {"mu1_eta": half, "mu2_eta": half})
        throw = synthetic_throw(
            law,
            STONE,
            load="consistent",
            v0=2 + 0.02 * (place % 4),
            dt=0.2,
            noise_xy=0.005,
            omega0=(1.0, 2.0, 4.0)[place % 3] * (-1) ** place,
            noise_phi=0.01,
            seed=place,
        )
        fits.append(curlfit.fit(throw, stone=STONE, load="consistent"))
    values = np.array([fit.values for fit in fits])
    season = mean_of(
        Season(
            "season.csv",
            Model(type(law), "consistent"),
            STONE,
            [(f"{k}", {}) for k in range(6)],
            values[:, :4],
            values[:, 4:],
            np.full(6, 20.0),
            np.array([coefficient_rows(fit) for fit in fits]),
            (),
        ),
        (),
        (),
        None,
    )
    sums = []
    for fit in fits:
        (one,) = fit.combinations
        assert one.weights["mu2_eta"] == pytest.approx(0.98, abs=0.005)
        sums.append(one.value)
    (total,) = season.combinations
    assert total.value == pytest.approx(np.mean(sums), abs=0.1 * total.stderr)
    assert total.stderr == pytest.approx(np.std(sums, ddof=1) / 6**0.5, rel=0.1)
    for name in ("mu1_eta", "mu2_eta"):
        assert season.coefficients[name].verdict == "not identifiable"
    assert season.identifiability.parameters - season.identifiability.rank == 1


def test_columns_that_were_added_to_a_table_are_labels(season, tmp_path):
    folder, *_ = season
    rows = list(csv.reader((folder / "season.csv").read_text().splitlines()))
    head = [rows[0][0], "rink", *rows[0][1:]]
    table = [head, *([one[0], "ab"[k % 2], *one[1:]] for k, one in enumerate(rows[1:]))]
    table[3][head.index("status")] = "not usable"
    with (tmp_path / "added.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(table)
    (tmp_path / "added.settings.json").write_text(
        (folder / "season.settings.json").read_text()
    )
    ran = command("fit", "added.csv", "--by", "rink", "--out", "out", cwd=tmp_path)
    assert "1 row is not ok and is left out" in " ".join(ran.stdout.split())
    found = curlfit.load_joint(tmp_path / "out")
    assert found.count == 9
    assert {one.group for one in found.differences} == {"b"}
    for words, said in (
        (["export", "--to", "latex", "--out"], "table.tex"),
        (["report", "--out"], "x.html"),
        (["plot", "--out"], "joint.png"),
    ):
        where = tmp_path / ("x.html" if words[0] == "report" else words[0])
        assert (
            command(words[0], "out", *words[1:], str(where), cwd=tmp_path).returncode
            == 0
        ), said


@pytest.mark.parametrize(
    ("change", "words", "said"),
    [
        (lambda text: text, ["--fix", "mu1_xi=0"], "--fix=mu1_xi=0: the throws of"),
        (lambda text: text, ["--by", "rink"], "no label 'rink'; it has sheet, day"),
        (
            lambda text: text.replace("information", "info"),
            [],
            "line 1: no column information",
        ),
        (
            lambda text: text.replace("[", "[1, ", 1),
            [],
            "line 2, column information: ",
        ),
        (
            lambda text: "\n".join(text.split("\n")[:3]) + "\n",
            [],
            "2 usable throws; expected 4",
        ),
    ],
)
def test_a_table_that_cannot_be_used(season, tmp_path, change, words, said):
    folder, *_ = season
    (tmp_path / "a.csv").write_text(change((folder / "season.csv").read_text()))
    (tmp_path / "a.settings.json").write_text(
        (folder / "season.settings.json").read_text()
    )
    ran = command("fit", "a.csv", *words, "--out", "out", cwd=tmp_path)
    assert ran.returncode == 2
    assert said in ran.stdout + ran.stderr
    assert not (tmp_path / "out").exists()


def test_a_table_runs_no_law_of_its_sender(season, tmp_path):
    folder, *_ = season
    (tmp_path / "a.csv").write_text((folder / "season.csv").read_text())
    settings = json.loads((folder / "season.settings.json").read_text())
    settings["plan"]["law"] = f"{tmp_path}/mine.py:Mine"
    (tmp_path / "mine.py").write_text("raise SystemExit('run')\n")
    (tmp_path / "a.settings.json").write_text(json.dumps(settings))
    ran = command("fit", "a.csv", "--out", "out", cwd=tmp_path)
    assert (ran.returncode, "run" in ran.stderr) == (2, False)


def test_the_figure_of_a_table_names_all_groups(season):
    """Also where the first panel is of a coefficient that does not vary,
    and has none."""
    folder, *_ = season
    found = curlfit.fit_season(folder / "season.csv", by="sheet")
    first, *others = found.variation
    groups = [one for one in found.groups if one.parameter != first.expression]
    figure = curlfit.joint_figure(replace(found, groups=tuple(groups)))
    (legend,) = figure.legends
    assert {text.get_text() for text in legend.get_texts()} == {
        "throws, each alone",
        "sheet 1",
        "sheet 2",
    }
    assert others


def without_column(table: str, name: str, empty: tuple[str, ...] = ()) -> str:
    """A table of a batch without a column, and without the cells of some others."""
    rows = list(csv.reader(table.splitlines()))
    place = rows[0].index(name)
    emptied = [rows[0].index(other) for other in empty]
    for row in rows[1:]:
        for column in emptied:
            row[column] = ""
    text = StringIO()
    kept = [[*row[:place], *row[place + 1 :]] for row in rows]
    csv.writer(text, lineterminator="\n").writerows(kept)
    return text.getvalue()


def test_a_table_of_an_earlier_version_is_read_where_its_throws_are_quadratics(
    season, tmp_path
):
    """It has no column of what ridges leave open. Without the angle its throws were
    taken for quadratics nevertheless."""
    folder, *_ = season
    table = (folder / "season.csv").read_text()
    settings = (folder / "season.settings.json").read_text()
    (tmp_path / "a.settings.json").write_text(settings)
    file = tmp_path / "a.csv"
    file.write_text(without_column(table, "left_open"))
    earlier = curlfit.fit_season(file)
    now = curlfit.fit_season(folder / "season.csv")
    assert earlier.to_json()["coefficients"] == now.to_json()["coefficients"]
    file.write_text(without_column(table, "left_open", ("rms_phi",)))
    with pytest.raises(curlfit.DataError, match="10 throws without an angle, which"):
        curlfit.fit_season(file)
