"""Differences between two versions are found, and there are none to the base."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import QUICK, Case, command_lines
from compare_versions import (
    ExpectedChange,
    ExpectedChanges,
    commands_by_case,
    report,
)
from conftest import DATA, command
from differences import Comparison
from versions import ask, checkout, git, sources_of

NO_CHANGES = ExpectedChanges("", ())


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the answers to one fit."""
    folder = tmp_path_factory.mktemp("answers")
    case = folder / "paper"
    case.mkdir()
    words = ("fit", DATA, "--no-sample", "--no-figures", "--out", "fitted")
    run = command(*words, cwd=case)
    (case / "1.out").write_text(run.stdout)
    (case / "1.err").write_text(run.stderr)
    (case / "answers.json").write_text(json.dumps([{"status": run.returncode}]))
    return folder


@pytest.fixture
def changed(answers: Path, tmp_path: Path) -> Callable[..., Comparison]:
    """A function that compares the answers with those after a change to them."""

    def compare(change: Callable[[Path], None]) -> Comparison:
        after = tmp_path / "after"
        shutil.copytree(answers, after)
        change(after / "paper")
        comparison = Comparison()
        comparison.cases(answers, after, ["paper"])
        return comparison

    return compare


def in_record(change: Callable[[dict], object]) -> Callable[[Path], None]:
    """A change to the record of the fit."""

    def rewrite(case: Path) -> None:
        file = case / "fitted" / "fit.json"
        record = json.loads(file.read_text())
        change(record)
        file.write_text(json.dumps(record))

    return rewrite


def in_page(words: str, others: str) -> Callable[[Path], None]:
    """A change of words on the printed page."""

    def rewrite(case: Path) -> None:
        text = (case / "1.out").read_text()
        assert words in text
        (case / "1.out").write_text(text.replace(words, others, 1))

    return rewrite


def scale_error(record: dict) -> None:
    record["parameters"]["mu1_xi"]["stderr"] *= 1.001


def move_value(record: dict) -> None:
    parameter = record["parameters"]["mu1_xi"]
    parameter["value"] += 0.002 * parameter["stderr"]


def scale_covariance(record: dict) -> None:
    record["covariance"]["matrix"][0][0] *= 1.001


def rename_key(record: dict) -> None:
    record["residual_rms"] = record.pop("rms")


CHANGES = {
    "standard errors": in_record(scale_error),
    "values": in_record(move_value),
    "verdicts": in_record(lambda r: r["parameters"]["v0"].update(verdict="weak")),
    "warnings": in_record(lambda r: r["warnings"].clear()),
    "keys": in_record(rename_key),
    "combinations": in_record(lambda r: r["combinations"].clear()),
    "directions": in_record(lambda r: r["identifiability"]["null_directions"].clear()),
    "other numbers": in_record(scale_covariance),
    "status": in_record(lambda r: r.update(status="not converged")),
    "texts": in_record(lambda r: r.update(law="angular")),
    "headings": in_page("std. error", "error"),
    "printed numbers": in_page("0.055627", "0.055629"),
    "refusals": lambda case: (case / "1.err").write_text("a warning\n"),
    "exit status": lambda case: (case / "answers.json").write_text('[{"status": 1}]'),
    "files": lambda case: (case / "fitted" / "fit.json").unlink(),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_change_is_found(kind, changed, capsys):
    comparison = changed(CHANGES[kind])
    assert {difference.kind for difference in comparison.differences} >= {kind}
    assert report(comparison, NO_CHANGES) == 1
    assert "not expected" in capsys.readouterr().out


def test_the_same_answers_do_not_differ(changed, capsys):
    comparison = changed(lambda case: None)
    assert not comparison.differences
    assert comparison.compared["values"] >= 9
    assert report(comparison, NO_CHANGES) == 0


def test_a_digit_that_is_rounded_the_other_way_is_no_change(changed):
    assert not changed(in_page("0.055627", "0.055628")).differences


def test_a_value_that_is_not_identifiable_is_not_compared(changed):
    def move(record: dict) -> None:
        record["parameters"]["mu1_eta"]["value"] = 0.001

    assert not changed(in_record(move)).differences


def test_a_verdict_near_its_threshold_is_listed_apart(changed, capsys):
    def change(record: dict) -> None:
        record["parameters"]["v0"]["verdict"] = "weak"
        record["parameters"]["v0"]["typical"] = (
            record["parameters"]["v0"]["stderr"] / 0.495
        )

    comparison = changed(in_record(change))
    (listed,) = comparison.near_threshold
    assert listed.place == "fitted/fit.json: parameters.v0.verdict"


def test_expected_changes_must_be_so(changed, capsys):
    comparison = changed(in_record(scale_error))
    about = "parameters.mu1_xi.stderr"
    change = ExpectedChange("a step", "a reason", "pap*", f"*fit.json: {about}")
    assert report(comparison, ExpectedChanges("", (change,))) == 0
    other = ExpectedChange("a step", "a reason", "pap*", "*fit.json: rms.x")
    assert report(comparison, ExpectedChanges("", (change, other))) == 1
    assert "expected, but not so: 1" in capsys.readouterr().out
    # of a part, or another commit, it need not be so
    assert report(comparison, ExpectedChanges("", (change, other)), whole=False) == 0


def test_the_base_answers_alike(tmp_path, capsys):
    expected = ExpectedChanges.read()
    try:
        git("cat-file", "-e", f"{expected.base}^{{commit}}")
    except (subprocess.CalledProcessError, FileNotFoundError):
        pytest.skip("without the history of the repository there is no base")
    base = sources_of(expected.base, tmp_path / "sources")
    commands = commands_by_case([Case("quick", command_lines(QUICK))], tmp_path)
    folders = ask(
        {"before": base, "after": checkout(tmp_path / "checkout")}, commands, tmp_path
    )
    comparison = Comparison()
    comparison.cases(folders["before"], folders["after"], ["quick"])
    status = report(comparison, expected, whole=False)
    assert status == 0, capsys.readouterr().out


@pytest.mark.slow
def test_the_base_answers_alike_to_all_commands():
    script = Path(__file__).with_name("compare_versions.py")
    run = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
