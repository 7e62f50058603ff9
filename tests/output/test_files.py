"""Folders that one process writes at a time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import DATA, command

from curlfit.errors import InputError
from curlfit.output.files import claim_folder, release_folders

HOLDER = """
import sys
from pathlib import Path
from curlfit.output.files import claim_folder
claim_folder(Path(sys.argv[1]))
print("claimed", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def held(tmp_path):
    """A folder that another process has claimed, and that process."""
    folder = tmp_path / "out"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdout.readline() == "claimed\n"
    yield folder, holder
    holder.kill()
    holder.communicate()


def test_two_fits_do_not_write_one_folder(held, tmp_path):
    folder, holder = held
    words = ("fit", DATA, "--law", "coulomb", "--no-sample", "--no-figures")
    done = command(*words, "--out", folder, cwd=tmp_path)
    message = f"{folder}: another `curlfit` is writing its results there"
    assert (done.returncode, message in done.stderr) == (2, True)
    assert list(folder.iterdir()) == []
    assert command(*words, "--out", tmp_path / "other", cwd=tmp_path).returncode == 0
    holder.kill()  # whatever ends it
    holder.wait()
    assert command(*words, "--out", folder, cwd=tmp_path).returncode == 0
    assert sorted(file.name for file in folder.iterdir()) == ["fit.json"]


def test_a_process_may_claim_its_folder_again(tmp_path):
    assert claim_folder(tmp_path) == claim_folder(Path(f"{tmp_path}/.")) == tmp_path
    release_folders()
    with pytest.raises(InputError, match="this is a file"):
        claim_folder(DATA)
