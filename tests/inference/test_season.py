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
    folder = tmp_path_factory.mktemp("season")
    random = np.random.default_rng(1)
    notes = ["track,sheet,day"]
    (folder / "tracks").mkdir()
    for number in range(10):
        sheet = number % 2 + 1
        half = 0.009 * (1 + 0.04 * sheet + 0.01 * random.standard_normal())
        law = law_with(
            "front-back",
            {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": half, "mu2_eta": half},
        )
        throw = synthetic_throw(
            law,
            STONE,
            v0=random.uniform(2.1, 2.3),
            omega0=random.uniform(1, 2) * (-1) ** number,
            dt=0.2,
            noise_xy=0.005,
            noise_phi=0.01,
            seed=number,
        )
        (folder / "tracks" / f"t{number}.csv").write_text(write_table(throw))
        notes.append(
            f"t{number}.csv,{sheet},2026-02-{number + 20 if number < 9 else 28}"
        )
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
    from_table = curlfit.load_joint(folder / "season-fit")
    for kind in ("groups", "differences", "trend"):
        for effect, other in zip(
            getattr(from_table, kind), getattr(joint, kind), strict=True
        ):
            assert (effect.parameter, effect.by, effect.group) == (
                other.parameter,
                other.by,
                other.group,
            )
            assert effect.value == pytest.approx(other.value, abs=0.03 * other.stderr)
            assert effect.stderr == pytest.approx(other.stderr, rel=0.03)
    for name, coefficient in joint.coefficients.items():
        assert from_table.coefficients[name].verdict == coefficient.verdict
        if coefficient.stderr is not None:
            assert from_table.coefficients[name].value == pytest.approx(
                coefficient.value, abs=0.03 * coefficient.stderr
            )
    (total,) = from_table.combinations
    assert total.expression == "mu1_eta + mu2_eta"
    determined = from_table.identifiability
    assert (determined.rank, determined.parameters) == (3, 4)
    assert from_table.trend[0].unit.endswith("/day")
    assert 1 <= from_table.r_hat < 1.02
    warning = "the posterior of the spreads has not converged (R-hat 1.200)"
    assert warning not in ran.stdout
    curlfit.print_joint(
        replace(from_table, r_hat=1.2), Console(file=(text := StringIO()), width=200)
    )
    assert warning in text.getvalue()


def test_the_next_throw_of_a_season_is_that_of_the_joint_fit(season, tmp_path):
    """For the same random numbers; the bands differ by what the means do."""
    folder, joint, _ = season
    asked = ["--sheet", "1", "--to-tee", "--no-figures", "--out", tmp_path]
    assert command("predict", "season-fit", *asked, cwd=folder).returncode == 0
    prediction = curlfit.load_prediction(tmp_path)
    call = curlfit.Call({"sheet": "1"})
    other = curlfit.predict(joint, call=call, target=(0.0, 0.0))
    assert prediction.quantities.keys() == other.quantities.keys()
    assert prediction.start["omega0"]["value"] == pytest.approx(
        other.start["omega0"]["value"], abs=1e-3
    )
    for name, quantity in other.quantities.items():
        mine = prediction.quantities[name]
        for level, value in quantity.quantiles.items():
            assert mine.quantiles[level] == pytest.approx(
                value, abs=0.1 * quantity.sd + 1e-6
            ), name
    assert list(map(str, prediction.warnings)) == list(map(str, other.warnings))
    assert list(map(str, prediction.notes)) == list(map(str, other.notes))
    assert prediction.weights[2].hog_to_hog == pytest.approx(
        other.weights[2].hog_to_hog, abs=2e-3
    )
    # a record of an earlier version is read, but foretells nothing
    saved = json.loads((folder / "season-fit/joint.json").read_text())
    file = tmp_path / "a.json"
    for name in ("starts", "duration", "speeds", "spins", "null_directions"):
        del saved["table"][name]
    file.write_text(json.dumps(saved))
    with pytest.raises(curlfit.InputError, match="does not say how its throws began"):
        curlfit.predict(curlfit.load_joint(file), call=call, target=(0.0, 0.0))


def test_what_throws_leave_open_does_not_explain_what_differs_between_them():
    """Under the consistent load a throw tells the halves of the friction hardly apart.
    A division far outside the bounds would explain the scatter of the sum."""
    random = np.random.default_rng(7)
    fits = []
    for number in range(6):
        half = 0.009 * (1 + 0.01 * random.standard_normal())
        law = law_with("front-back", {"mu1_eta": half, "mu2_eta": half})
        throw = synthetic_throw(
            law,
            STONE,
            load="consistent",
            v0=2 + 0.02 * (number % 4),
            dt=0.2,
            noise_xy=0.005,
            omega0=(1.0, 2.0, 4.0)[number % 3] * (-1) ** number,
            noise_phi=0.01,
            seed=number,
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
        (combination,) = fit.combinations
        assert combination.weights["mu2_eta"] == pytest.approx(0.98, abs=0.005)
        sums.append(combination.value)
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
    table = [head, *([row[0], "ab"[k % 2], *row[1:]] for k, row in enumerate(rows[1:]))]
    table[3][head.index("status")] = "not usable"
    with (tmp_path / "added.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(table)
    (tmp_path / "added.settings.json").write_text(
        (folder / "season.settings.json").read_text()
    )
    ran = command("fit", "added.csv", "--by", "rink", "--out", "out", cwd=tmp_path)
    assert "1 row is not ok and is left out" in " ".join(ran.stdout.split())
    joint = curlfit.load_joint(tmp_path / "out")
    assert joint.count == 9
    assert {difference.group for difference in joint.differences} == {"b"}
    for words, output in (
        (["export", "--to", "latex", "--out"], "table.tex"),
        (["report", "--out"], "x.html"),
        (["plot", "--out"], "joint.png"),
    ):
        where = tmp_path / ("x.html" if words[0] == "report" else words[0])
        assert (
            command(words[0], "out", *words[1:], str(where), cwd=tmp_path).returncode
            == 0
        ), output


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
    (tmp_path / "mine.py").write_text("raise SystemExit('the law of a stranger')\n")
    (tmp_path / "a.settings.json").write_text(json.dumps(settings))
    ran = command("fit", "a.csv", "--out", "out", cwd=tmp_path)
    assert (ran.returncode, "a stranger" in ran.stderr) == (2, False)


def test_the_figure_of_a_table_names_all_groups(season):
    """Also where the first panel is of a coefficient that does not vary,
    and has none."""
    folder, *_ = season
    joint = curlfit.fit_season(folder / "season.csv", by="sheet")
    first, *other_variations = joint.variation
    groups = [group for group in joint.groups if group.parameter != first.expression]
    figure = curlfit.joint_figure(replace(joint, groups=tuple(groups)))
    (legend,) = figure.legends
    assert {text.get_text() for text in legend.get_texts()} == {
        "throws, each alone",
        "sheet 1",
        "sheet 2",
    }
    assert other_variations


def without_column(table: str, name: str, empty: tuple[str, ...] = ()) -> str:
    """A table of a batch without a column, and without the cells of some others."""
    rows = list(csv.reader(table.splitlines()))
    position = rows[0].index(name)
    emptied = [rows[0].index(other) for other in empty]
    for row in rows[1:]:
        for column in emptied:
            row[column] = ""
    text = StringIO()
    kept = [[*row[:position], *row[position + 1 :]] for row in rows]
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
