"""Hostile names and texts do no harm."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import DATA, command

import curlfit
from curlfit.export.tables import estimates_table
from curlfit.inference.together.result import folder_name
from curlfit.options.settings import result_folder
from curlfit.settings.choices import Reading


@pytest.mark.parametrize("symbol", [r"\mu_1", r"\input{/etc/passwd}$%"])
def test_foreign_text_in_figures_and_latex(symbol, eq12_fit, tmp_path, recwarn):
    parameter = replace(
        eq12_fit.parameters["mu1_xi"], symbol=symbol, unit=r"s}\input{x}/m^$"
    )
    fit = replace(
        eq12_fit,
        parameters={**eq12_fit.parameters, "mu1_xi": parameter},
        data=replace(eq12_fit.data, file="in/a$b_{\x1b日本.csv"),
        law="$x^{",
    )
    curlfit.fit_figure(fit).savefig(tmp_path / "fit.png")
    assert [str(warning.message) for warning in recwarn] == []
    with_law = replace(fit, law=eq12_fit.law)
    table = estimates_table(with_law)
    assert r"\input" not in table
    assert "\x1b" not in table
    assert (r"\mu_1" in table) == (symbol == r"\mu_1")


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
    words = ("batch", *("=1+1.csv", "n\nl.csv"), "--workers=1", "--out=../t.csv")
    ran = command(*words, cwd=tmp_path / "in")
    assert "2 ok" in ran.stdout, ran
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert [row["file"] for row in rows] == ["'=1+1.csv", r"n\nl.csv"]
    assert "2 of 2 files are in" in command(*words, cwd=tmp_path / "in").stdout


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("a throw.csv", "a throw"),
        ("日本.csv", "日本"),
        ("..csv", "_"),
        ("...csv", "__"),
        ("-x.csv", "_x"),
        ("NUL.csv", "NUL_"),
        ("end. .csv", "end__"),
        ("n\nl.csv", "n_nl"),
        ('a:b|"c.csv', "a_b__c"),
    ],
)
def test_folders_of_results_have_safe_names(name, folder):
    assert folder_name(name) == folder
    assert str(result_folder(Path("in") / name, "fit", Reading())) == f"{folder}-fit"


def test_folders_of_long_names_are_told_apart():
    first, second = (folder_name("é" * 120 + end + ".csv") for end in ("a", "b"))
    assert first != second
    assert max(len(text.encode()) for text in (first, second)) < 200
