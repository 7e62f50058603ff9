"""The examples that an installation brings along."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from conftest import command, invoke

import curlfit

ROOT = Path(__file__).parents[2]


def test_data_and_notebooks_are_copied(tmp_path):
    run = invoke(["example", tmp_path / "mine"])
    assert run.exit_code == 0, run.stdout
    for part, pattern in (("data", "*"), ("notebooks", "*.ipynb")):
        originals = sorted((ROOT / part).glob(pattern))
        copies = sorted((tmp_path / "mine" / part).iterdir())
        assert [file.name for file in copies] == [file.name for file in originals]
        assert all(
            a.read_bytes() == b.read_bytes()
            for a, b in zip(copies, originals, strict=True)
        )
    assert f"cd {tmp_path / 'mine'} && curlfit fit data/" in run.stdout.replace(
        "\n", ""
    )


def test_what_is_there_is_left(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "evening.csv").write_text("my own\n")
    run = invoke(["example", tmp_path])
    assert "Left as it is:" in run.stdout
    assert (tmp_path / "data" / "evening.csv").read_text() == "my own\n"
    assert (tmp_path / "data" / "tracker.txt").exists()


def test_the_version_names_what_computes(tmp_path):
    text = command("--version", cwd=tmp_path).stdout
    assert text.startswith(f"curlfit {curlfit.__version__}\n")
    assert f"jax {version('jax')}" in text
    assert f"optimistix {version('optimistix')}" in text


def test_the_citation_is_of_this_version():
    citation = (Path(curlfit.__file__).parent / "CITATION.cff").read_text()
    assert f"\nversion: {curlfit.__version__}\n" in citation
    page = (ROOT / "notebooks" / "book" / "citing.md").read_text()
    assert f"version = {{{curlfit.__version__}}}" in page
