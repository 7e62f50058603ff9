"""Absurd sizes, wrong types, hostile names and numbers: refused in one sentence, or harmless."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import DATA, command

import curlfit
from curlfit.export.tables import estimates_table
from curlfit.html_report.page import page_of, render
from curlfit.inference.joint.result import folder_name
from curlfit.options.settings import result_folder
from curlfit.settings.choices import Reading

ROWS = "t,x,y\n0,0,0\n"


def refusal(ran) -> str:
    """The one sentence of a refusal."""
    assert ran.returncode == 2, ran
    assert ran.stderr.startswith("curlfit: ")
    assert ran.stderr.count("\n") == 1
    assert ran.stderr[:-1].isprintable()
    assert len(ran.stderr) < 1100
    return ran.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"# stone.{'a.' * 25000}a = 1\n{ROWS}", "line 1: a line of 50013 characters"),
        (f"# {'x' * 1000}\n{ROWS}", "line 1: a line of 1002 characters; expected at most 1000"),
        ("t,x,y" + ",a" * 500 + "\n", "line 1: a line of 1005 characters"),
        (f"{ROWS}1,2,{'3' * 20_000}\n", "line 3: a line of 20004 characters"),
        ("# stone.R = 0.05\n" * 501 + ROWS, "line 501: more than 500 settings"),
        (ROWS + "\n" * 2_000_000, "more than 2000000 lines"),
        (ROWS + "1,2,3\n" * 8_400_000, "larger than 50000 kB"),
        (f"# law = '{'x' * 900}'\n{ROWS}", "unknown law 'xxxxxx"),
    ],
)  # fmt: skip
def test_data_beyond_any_throw_are_refused(text, said, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    found = refusal(command("check", "a.csv", cwd=tmp_path))
    assert found.startswith("curlfit: a.csv")
    assert said in found
    assert "x" * 100 not in found


def test_a_line_of_json_may_be_long(tmp_path):
    (tmp_path / "a.json").write_text('{"trajectory": [' + "[]," * 10_000 + "[]]}")
    assert "no trajectory found" in refusal(command("check", "a.json", cwd=tmp_path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('fix = "x"', "fix = 'x'; expected fix.NAME = a number"),
        ("stone = 1", "stone = 1; expected stone.NAME = a number"),
        ("stone.R = [1]", "stone.R = [1]; expected a number"),
        ("stone.R = 2026-01-05", "stone.R = datetime.date(2026, 1, 5); expected a number"),
        ("start.v0 = 1" + "0" * 400, "expected a number, 0, or 1e-30 to 1e12"),
        ("until = nan", "until = nan; expected a time in s"),
        ("bound.v0 = ['a', 1]", "bound.v0 = ['a', 1]; expected [low, high]"),
        ("prior = 1", "prior = 1; expected prior.NAME"),
        ("unbounded = 1", "unbounded = 1; expected true or false"),
        ("free = [\n" + "[\n" * 25_000, "nested too deeply"),
        (f"stone.{'a.' * 300}a = 1", "stone.a = {'a': "),
        ("#" * 1001, "line 1: a line of 1001 characters"),
        ("# comment\n" * 6_401, "larger than 64 kB"),
        ('"\\u001b[31m" = 1', r"unknown setting '\x1b[31m'"),
    ],
)  # fmt: skip
def test_settings_of_wrong_types_are_refused(text, said, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    found = refusal(command("check", DATA, "--config", "c.toml", cwd=tmp_path))
    assert found.startswith("curlfit: c.toml")
    assert said in found


@pytest.mark.parametrize(
    "words",
    [
        ("design", "--rate=1e308"), ("design", "--until=1e308"), ("design", "--sigma-xy=1e-308"),
        ("design", "--sigma-phi=1e308deg"), ("design", "--set=mu1_xi=1e308"),
        ("simulate", "--dt=1e-308"), ("simulate", "--until=1e308"), ("simulate", "--noise-xy=nan"),
        ("simulate", "--v0=inf"), ("check", DATA, "--since=nan"),
        ("check", DATA, f"--shot={10**30}"), ("fit", DATA, f"--fix=v0={'9' * 400}"),
        ("fit", DATA, "--fix=v0=1e-308"), ("fit", DATA, "--stone=m=1e-308"),
        ("fit", DATA, "--prior=drag=half-normal:1e-308"),
    ],
)  # fmt: skip
def test_numbers_beyond_any_throw_are_refused(words, tmp_path):
    found = refusal(command(*words, cwd=tmp_path))
    option = words[-1].split("=")[0].strip("-")
    assert option in found
    assert "expected" in found


@pytest.mark.parametrize("symbol", [r"\mu_1", r"\input{/etc/passwd}", "}$ $", "%"])
def test_foreign_text_in_figures_and_latex(symbol, eq12_fit, tmp_path, recwarn):
    own = replace(eq12_fit.parameters["mu1_xi"], symbol=symbol, unit=r"s}\input{x}/m^$")
    fit = replace(
        eq12_fit,
        parameters={**eq12_fit.parameters, "mu1_xi": own},
        data=eq12_fit.data | {"file": "in/a$b_{\x1b日本.csv"},
        law="$x^{",
    )
    curlfit.fit_figure(fit).savefig(tmp_path / "fit.png")
    assert [str(one.message) for one in recwarn] == []
    with_law = replace(fit, law=eq12_fit.law)
    table = estimates_table(with_law)
    assert r"\input" not in table
    assert "\x1b" not in table
    assert (r"\mu_1" in table) == (symbol == r"\mu_1")


def test_a_page_sends_nothing_anywhere(eq12_fit):
    text = render(page_of(eq12_fit))
    assert "default-src 'none'; base-uri 'none'; form-action 'none';" in text


def test_names_do_not_reach_the_terminal_raw(tmp_path):
    name = "a\x1b]0;title\u202e[red].csv"
    shutil.copy(DATA, tmp_path / name)
    ran = command("check", name, cwd=tmp_path)
    assert ran.returncode == 0, ran
    assert r"a\x1b]0;title\u202e[red].csv" in ran.stdout
    assert all(line.isprintable() for line in ran.stdout.splitlines())


def test_a_name_is_no_formula_in_a_table_and_its_row_is_found_again(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("=1+1.csv", "n\nl.csv"):
        shutil.copy(DATA, tmp_path / "in" / name)
    words = ("batch", *("=1+1.csv", "n\nl.csv"), "--law=coulomb", "--out=../t.csv")
    ran = command(*words, cwd=tmp_path / "in")
    assert "2 ok" in ran.stdout, ran
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert [row["file"] for row in rows] == ["'=1+1.csv", r"n\nl.csv"]
    assert "2 of 2 files are in" in command(*words, cwd=tmp_path / "in").stdout


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("a throw.csv", "a throw"), ("日本.csv", "日本"), ("..csv", "_"), ("...csv", "__"),
        ("-x.csv", "_x"), ("NUL.csv", "NUL_"), ("end. .csv", "end__"), ("n\nl.csv", "n_nl"),
        ('a:b|"c.csv', "a_b__c"),
    ],
)  # fmt: skip
def test_folders_of_results_have_safe_names(name, folder):
    assert folder_name(name) == folder
    assert str(result_folder(Path("in") / name, "fit", Reading())) == f"{folder}-fit"


def test_folders_of_long_names_are_told_apart():
    one, other = (folder_name("é" * 120 + end + ".csv") for end in ("a", "b"))
    assert one != other
    assert max(len(text.encode()) for text in (one, other)) < 200
