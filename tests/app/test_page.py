"""The page of `curlfit app` without a browser: edits that overtake one another,
commands that cannot start, the folders of pages that were killed."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from conftest import DATA
from hypothesis import given, settings, strategies as st

pytest.importorskip("nicegui", reason="NiceGUI is not installed")

from curlfit.app import folder, page
from curlfit.app.form import Written
from curlfit.app.reading import Seen
from curlfit.app.work import Work
from curlfit.cli import app


@pytest.mark.parametrize("word", ["a\0b", "x" * 140_000])
def test_a_command_that_cannot_start_is_a_complaint(word, tmp_path):
    work = Work("fit", [word])
    asyncio.run(work.run(tmp_path))
    assert work.over.is_set()
    (complaint,) = work.complaints
    assert complaint.startswith("the command cannot be started (")


@pytest.mark.parametrize("place", ["/etc/report.html", "../report.html", "report.htm"])
def test_only_a_page_within_the_folder_is_shown(place):
    work = Work("fit", [])
    work._hear(f"Written: {place}".encode())
    assert work.page is None


def test_the_verdict_is_of_the_last_edit(monkeypatch, tmp_path):
    def slow_at_first(files, chosen):
        time.sleep(0.5 if chosen["until"] == 5 else 0)
        return Seen(finding=f"until {chosen['until']:g}")

    async def edited():
        shown = page.Page(app, tmp_path, tmp_path)
        monkeypatch.setattr(page, "look", slow_at_first)
        monkeypatch.setattr(shown, "refresh", lambda: None)
        shown.files = [DATA]
        first = asyncio.create_task(shown.put(Written(line="--until 5")))
        await asyncio.sleep(0.1)
        await shown.put(Written(line="--until 9"))
        await first
        return shown.seen.finding

    assert asyncio.run(edited()) == "until 9"


def test_a_line_that_no_shell_takes_runs_nothing(tmp_path):
    shown = page.Page(app, tmp_path, tmp_path)
    shown.files = [DATA]
    shown.written = Written(line="--until '18")
    asyncio.run(shown.carry_out("fit"))
    assert shown.work is None
    assert shown.done == {}


@pytest.mark.parametrize(
    ("dropped", "taken"),
    [
        ("a throw.CSV", "a throw.CSV"),
        ("numpy.py", "numpy.py.txt"),
        ("matplotlibrc", "matplotlibrc.txt"),
        ("../../x.pth", "___.._x.pth.txt"),
        ("`--as-given`.csv", "'--as-given'.csv"),
        ("old.csv", "old_2.csv"),
    ],
)
def test_dropped_files_have_names_that_no_program_looks_for(dropped, taken, tmp_path):
    (tmp_path / "old.csv").write_text("")
    name = page.Page(app, tmp_path, tmp_path)._free_name(dropped)
    assert name == taken


SHOWN = page.Page(app, Path(), Path())


@settings(max_examples=200, deadline=None)
@given(dropped=st.text(st.characters(codec="utf-8"), max_size=300))
def test_any_name_of_a_dropped_file_is_a_name_in_the_folder(dropped):
    with TemporaryDirectory() as directory:
        SHOWN.folder = Path(directory)
        name = SHOWN._free_name(dropped)
        (Path(directory) / name).write_text("")
        assert os.listdir(directory) == [name]
    assert Path(name).suffix.lower() in page._SUFFIXES
    assert "`" not in name
    assert not name.startswith("-")


def test_the_folder_of_a_page_that_was_killed_goes(monkeypatch, tmp_path):
    monkeypatch.setattr(folder, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    left = tmp_path / "a-curlfit-app"
    foreign = tmp_path / "b-curlfit-app"
    for directory in (left, foreign):
        directory.mkdir()
        (directory / "throw.csv").write_text("")
    (left / "in-use").write_text("")
    linked = tmp_path / "c-curlfit-app"
    linked.symlink_to(left)
    with folder.temporary_folder() as first_folder:
        assert not left.exists()
        assert foreign.exists()  # no page ever locked it
        with folder.temporary_folder() as second_folder:
            assert first_folder.exists()
            assert second_folder != first_folder
    assert not first_folder.exists()
