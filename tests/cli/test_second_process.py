"""Figures that are drawn in a second process while the first computes."""

from __future__ import annotations

import os
import signal
import time

import psutil
import pytest
from conftest import DATA, STRICT, python, started

from curlfit import load_fit
from curlfit.numerics.threads import cores

DRAWN = """
import os
from pathlib import Path

def picture(text):
    from curlfit.output.figures import Picture
    if text == "wrong":
        raise ValueError(text)
    figure = Picture(figsize=(1, 1))
    figure.text(0, 0.5, text)
    Path("pid").write_text(str(os.getpid()))
    return {text: figure}
"""
CODE = """
import os, sys
from functools import partial
from pathlib import Path
from curlfit.options.figures import FigureFiles
from curlfit.numerics.threads import cores
from drawn import picture

folder = Path.cwd()
files = FigureFiles.of("png,svg")
files.draw_beside()
"""


@pytest.fixture
def run(tmp_path):
    """Run code in a new process in a folder of its own; what it prints."""

    (tmp_path / "drawn.py").write_text(DRAWN)

    def run(code):
        done = python(*STRICT, "-c", CODE + code, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.strip()

    return run


def test_files_are_those_of_this_process_and_old_ones_go(run, tmp_path):
    (tmp_path / "a.pdf").write_bytes(b"old")
    code = """
files.replace(folder, ["a"], partial(picture, "a"))
files.replace(folder, ["b"], partial(picture, "b"))
assert [file.name for file in files.written()] == ["a.png", "a.svg", "b.png", "b.svg"]
assert "matplotlib" not in sys.modules or cores() == 1
print(Path("pid").read_text() != str(os.getpid()))
there = Path("a.svg").read_bytes(), Path("a.png").read_bytes()
files.replace(folder, ["a"], lambda: picture("a"))  # which no other process can be sent
files.written()
assert Path("pid").read_text() == str(os.getpid())
assert there == (Path("a.svg").read_bytes(), Path("a.png").read_bytes())
try:
    files.replace(folder, ["wrong"], partial(picture, "wrong"))
    files.written()
except ValueError as error:
    print(error)
"""
    assert run(code).split() == [str(cores() > 1), "wrong"]
    assert not (tmp_path / "a.pdf").exists()


VERBS = (
    "fit DATA",
    "compare DATA",
    "predict FIT",
    "profile FIT --param mu1_xi",
    "design",
    "reproduce",
)


@pytest.mark.skipif(cores() < 2, reason="one core draws where it computes")
def test_no_verb_loads_jax_before_the_second_process_starts(tmp_path, eq12_fit):
    code = """
import sys
from curlfit.cli import main
from curlfit.options.figures import FigureFiles

def draw_beside(self):
    print("jax" in sys.modules)
    raise SystemExit

FigureFiles.draw_beside = draw_beside
for words in VERBS:
    sys.argv[1:] = [*words.split(), "--out", FOLDER]
    try:
        main()
    except SystemExit:
        pass
"""
    eq12_fit.save(tmp_path / "fit.json")
    verbs = [
        verb.replace("DATA", str(DATA)).replace("FIT", str(tmp_path)) for verb in VERBS
    ]
    code = f"VERBS, FOLDER = {verbs!r}, {str(tmp_path)!r}\n{code}"
    done = python("-c", code)
    assert (done.stdout.split(), done.stderr) == (["False"] * len(VERBS), "")


@pytest.mark.skipif(cores() < 2, reason="one core draws where it computes")
@pytest.mark.parametrize("delay", [pytest.param(0.0, marks=pytest.mark.slow), 0.4])
def test_ctrl_c_is_answered_while_everything_is_loading(tmp_path, delay):
    run = started("fit", DATA, "--out", tmp_path)
    while run.poll() is None and not psutil.Process(run.pid).children():
        time.sleep(0.01)
    time.sleep(delay)
    os.killpg(run.pid, signal.SIGINT)
    out, err = run.communicate(timeout=100)
    assert (run.returncode, out, err) == (130, "", "curlfit: stopped\n")


@pytest.mark.skipif(cores() < 2, reason="one core draws where it computes")
@pytest.mark.parametrize(
    "blow", [signal.SIGTERM, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)]
)
def test_no_process_is_left_by_a_stopped_fit(tmp_path, blow):
    run = started(
        "fit", DATA, "--effective", 10**8, "--max-steps", 10**6, "--out", tmp_path
    )
    while run.poll() is None and not (tmp_path / "chain.h5").exists():
        time.sleep(0.05)
    time.sleep(0.5)
    children = psutil.Process(run.pid).children(recursive=True)
    assert children
    run.send_signal(blow)
    _, err = run.communicate(timeout=100)
    assert not psutil.wait_procs(children, timeout=20)[1]
    assert run.returncode == (143 if blow == signal.SIGTERM else -blow)
    if blow == signal.SIGTERM:
        assert err.count("\n") == 1
        assert "stopped by the user" in err
        assert load_fit(tmp_path).posterior.samples > 0
        assert (tmp_path / "corner.png").exists()


DROPPED = """
import os, signal, sys, time
import curlfit.cli
from curlfit.__main__ import run

class Gone:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000):
            pass

def main():
    Gone()
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        sys.exit(130)

curlfit.cli.main = main
run()
"""


def test_a_signal_that_comes_where_python_drops_exceptions_stops_all_the_same():
    done = python("-c", DROPPED)
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no such terminals")
def test_a_closed_terminal_ends_a_fit_with_all_its_processes(tmp_path):
    end, terminal = os.openpty()
    words = ("fit", DATA, "--effective", 10**8, "--max-steps", 10**6, "--out", tmp_path)
    run = started(*words, stdin=terminal, stdout=terminal, stderr=terminal)
    os.close(terminal)
    while run.poll() is None and not (tmp_path / "chain.h5").exists():
        time.sleep(0.05)
    children = psutil.Process(run.pid).children(recursive=True)
    os.close(end)
    assert run.wait(timeout=100) == 128 + signal.SIGHUP
    assert not psutil.wait_procs(children, timeout=20)[1]
    assert load_fit(tmp_path)["mu2_xi"].value > 0  # saved before sampling began
