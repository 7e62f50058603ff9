"""Damaged files: read or refused in one sentence, in no time and with little memory."""

from __future__ import annotations

import json
from pathlib import Path

import damaged_files
import pytest
from conftest import STRICT, python
from damaged_files import Outcome


def worker(folder: Path, seed: int, count: int, *what: str) -> dict:
    """The tally of many files, forked from a process without the tests' own imports."""
    words = (damaged_files.__file__, folder, seed, count, *what)
    run = python(*STRICT, *words, OPENBLAS_NUM_THREADS="1")
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_damaged_files_are_read_or_refused(tmp_path):
    tally = worker(tmp_path, 2, 150)
    assert tally["faults"] == []
    assert sum(tally["statuses"].values()) == 150
    assert tally["statuses"]["0"] > 8
    assert tally["statuses"]["2"] > 40


def test_odd_grids_of_spreadsheets_are_read_or_refused(tmp_path):
    pytest.importorskip("python_calamine")
    tally = worker(tmp_path, 1, 60, "grids")
    assert tally["faults"] == []
    assert tally["statuses"]["0"] > 3
    assert tally["statuses"]["2"] > 20


def test_a_fault_would_be_seen():
    assert Outcome(0, 50.0, "").fault() is None
    assert Outcome(2, 50.0, "curlfit: no such file\n").fault() is None
    assert Outcome(-14, 50.0, "").fault() == "exit status -14"
    assert Outcome(2, 501.0, "curlfit: no such file\n").fault() == "501 MB"
    trace = "Traceback (most recent call last):\n  ...\nValueError\n"
    assert Outcome(1, 50.0, trace).fault() == "not one sentence on stderr"
    assert Outcome(2, 50.0, "").fault() == "not one sentence on stderr"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 20))
def test_many_damaged_files_are_read_or_refused(tmp_path, seed):
    pytest.importorskip("python_calamine")
    tally = worker(tmp_path, seed, 2000, *["grids"] * (seed % 2))
    print(json.dumps(tally))
    assert tally["faults"] == []
