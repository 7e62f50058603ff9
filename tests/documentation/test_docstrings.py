"""Examples in the docstrings of public names run as they stand; `help(curlfit)` is short."""

from __future__ import annotations

import pydoc
import shutil
import subprocess
import sys
from pathlib import Path

from docstring_examples import run_examples

import curlfit

ROOT = Path(__file__).parents[2]
WITHOUT = {"LAWS", "__version__"}  # a dictionary and a text have no docstring of their own
ELSEWHERE = {"reproduce", "Reproduction"}  # tests/paper, which has the computation at hand


def test_examples_of_all_public_names_run(tmp_path, monkeypatch):
    """In the order of use: the result of a verb is what the next examples are about."""
    shutil.copytree(ROOT / "data", tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    namespace, failures = {"curlfit": curlfit}, []
    for name in curlfit.__all__:
        if name in WITHOUT | ELSEWHERE:
            continue
        if name == "load_joint":  # as `curlfit fit A B --out joint` leaves it
            joint, folder = namespace["joint"], tmp_path / "joint"
            own = folder / Path(joint.throws[0].data["file"]).stem
            own.mkdir(parents=True)
            joint.save(folder / "joint.json")
            joint.throws[0].save(own / "fit.json")
        failures.append(run_examples(name, namespace))
    assert "".join(failures) == ""


def test_help_fits_two_screens():
    lines = pydoc.plain(pydoc.render_doc(curlfit)).splitlines()
    assert len(lines) <= 80
    assert max(map(len, lines)) <= 110
    for name in ("load_throw", "fit", "sample", "compare", "profile", "predict"):
        assert any(line.strip().startswith(f"{name} ") for line in lines), name


def test_names_are_completed_and_imported():
    assert set(dir(curlfit)) == set(curlfit.__all__)
    code = "from curlfit import *; print(fit.__name__, Throw.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "fit Throw\n"
