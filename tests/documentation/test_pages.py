"""The pages that tell a user's way from a file to a decision: typed as they stand."""

from __future__ import annotations

import re
import shutil

import pytest
from transcripts import ROOT, blocks, require_shown, typed, without_gaps

pytestmark = pytest.mark.documentation
OF_A_FILE = ("stopwatch_evening", "tracked_throws", "two_sheets")
PAGES = [
    ROOT / "notebooks" / f"{name}.md"
    for name in (*OF_A_FILE, "next_stone", "film_to_track", "which_mechanism")
]
QUOTED = re.compile(r"```text\n((?:Time|draw)[^\n]*[;,].*?)```", re.S)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_print_what_the_page_shows(page, tmp_path):
    shutil.copytree(ROOT / "data", tmp_path / "data")
    told = blocks(page.read_text())
    assert told
    for lines, shown in told:
        printed = "".join(typed(line, tmp_path) for line in lines)
        assert without_gaps(shown), lines
        require_shown(without_gaps(shown), printed)


@pytest.mark.parametrize("page", PAGES[: len(OF_A_FILE)], ids=lambda page: page.stem)
def test_the_lines_of_a_file_are_those_of_the_file(page):
    (quoted,) = QUOTED.findall(page.read_text())
    files = [file.read_text() for file in (ROOT / "data").glob("*.csv")]
    assert any(text.startswith(quoted) for text in files)
