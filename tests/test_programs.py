"""Compiled programs in the user's cache folder."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
import numpy as np
from curlfit import programs

calls = []

@programs.kept("word")
def twice(word, values):
    calls.append(word)
    return values * 2 if word == "double" else values

assert twice("double", np.arange(3.0)).tolist() == [0.0, 2.0, 4.0]
assert twice("same", np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]
assert twice("double", np.arange(4.0)).tolist() == [0.0, 2.0, 4.0, 6.0]
print(len(calls))
"""


@pytest.fixture
def traced(tmp_path):
    """How often a new process traces the function; its cache lies in a folder of the test."""
    script = tmp_path / "script.py"
    script.write_text(CODE)

    def run(**settings):
        cache = {"CURLFIT_CACHE": str(tmp_path / "cache")} | settings
        done = subprocess.run(
            [sys.executable, "-W", "error", str(script)], env=os.environ | cache,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        return int(done.stdout)

    run.folder = tmp_path / "cache" / "programs"
    return run


def test_a_second_process_traces_nothing(traced):
    assert traced() == 3
    assert traced() == 0


def test_each_law_word_and_shape_has_its_own(traced):
    traced()
    assert len(list(traced.folder.iterdir())) == 3


def test_files_may_be_deleted_or_damaged(traced):
    traced()
    first, second, third = sorted(traced.folder.iterdir())
    first.unlink()
    second.write_bytes(b"nonsense")
    third.write_bytes(third.read_bytes()[:-200])
    assert traced() == 3
    assert traced() == 0


def test_a_program_is_whole_though_jax_has_it_in_its_own_cache(traced):
    """What JAX takes out of its cache and stores again cannot be run."""
    traced()
    for file in traced.folder.iterdir():
        file.unlink()
    assert traced() == 3
    assert traced() == 0


def test_the_cache_can_be_switched_off(traced):
    assert traced() == traced(CURLFIT_CACHE="off") == 3
    assert not traced.folder.parent.joinpath("off").exists()
