"""Odd terminals, pipes, full disks, and homes that no shell names."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import pytest
from conftest import DATA, command, python

from curlfit import InputError, cli, load_throw
from curlfit.batch.columns import names_of_columns
from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import GrowingTable
from curlfit.numerics import program_cache
from curlfit.settings.forms import PATH
from curlfit.throws.load import found_files

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="pipes and /dev of POSIX")


@pytest.mark.parametrize("width", ["0", "1"])
def test_a_terminal_without_width_is_taken_for_a_file(width):
    words = ("-m", "curlfit", "check", DATA)
    usual = python(*words, COLUMNS="110")
    assert python(*words, COLUMNS=width).stdout == usual.stdout != ""


@POSIX
def test_a_folder_is_searched_for_files_alone(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "throw.csv").write_bytes(DATA.read_bytes())
    assert found_files([str(tmp_path)]) == [tmp_path / "throw.csv"]


@POSIX
def test_a_pipe_is_read_once_and_kept():
    reading, writing = os.pipe()
    os.write(writing, DATA.read_bytes())
    os.close(writing)
    first, second = (load_throw(f"/dev/fd/{reading}") for _ in range(2))
    assert first == second == load_throw(DATA)
    os.close(reading)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("std::bad_alloc"),
        ImportError("libscipy_openblas.so: failed to map segment from shared object"),
    ],
)
def test_too_little_memory_is_one_sentence(monkeypatch, tmp_path, error):
    def exhausted(words):
        raise error

    monkeypatch.setattr(cli, "run", exhausted)
    ran = command("fit", DATA, cwd=tmp_path)
    assert ran.returncode == 1
    assert ran.stderr.startswith("curlfit: not enough memory; expected about 2 GB")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
@pytest.mark.parametrize("words", [f"fit {DATA}", f"batch {DATA.parent}"])
def test_too_few_addresses_are_one_sentence_before_jax_is_loaded(words, tmp_path):
    limited = f"ulimit -v 1000000; exec {sys.executable} -P -m curlfit {words}"
    ran = subprocess.run(
        ["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True
    )
    assert (ran.returncode, ran.stdout) == (1, "")
    assert ran.stderr.startswith("curlfit: not enough memory; expected about 2 GB")


class FullDisk(BytesIO):
    def write(self, _):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_is_told_with_the_name_of_the_table(tmp_path):
    settings = BatchSettings.of()
    names = names_of_columns(settings)
    with GrowingTable(tmp_path / "r.csv", names, settings.recorded(), []) as table:
        table.stream.close()
        table.stream = FullDisk()
        row = dict.fromkeys(names, "") | {"status": "ok"}
        with pytest.raises(InputError, match=r"r\.csv: cannot be written \(No space"):
            table.add([row])


def test_a_program_under_the_name_of_another_is_not_run(tmp_path):
    program_cache.write(tmp_path / "one", b"program")
    (tmp_path / "other").write_bytes((tmp_path / "one").read_bytes())
    (tmp_path / "other").chmod(0o600)
    assert program_cache.read(tmp_path / "one") == b"program"
    assert program_cache.read(tmp_path / "other") is None


def test_a_tilde_is_the_home_and_a_name_may_begin_with_one(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert PATH.read_word("--out ", "~/throw") == tmp_path / "throw"
    assert PATH.read_word("--out ", "~.csv") == Path("~.csv")
