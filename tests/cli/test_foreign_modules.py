"""Files beside the data that are named as modules do not run."""

from __future__ import annotations

import ast
import shutil
import sys
from pathlib import Path

import pytest
from conftest import DATA, python

import curlfit

SOURCES = Path(curlfit.__file__).parent
LIBRARIES = [
    *("cattrs", "cyclopts", "emcee", "equinox", "h5py", "jax", "jaxlib", "jinja2"),
    *("lazy_loader", "lineax", "markupsafe", "matplotlib", "nicegui", "numpy"),
    *("optimistix", "platformdirs", "python_calamine", "rich", "scipy", "uvicorn"),
    *("sitecustomize", "usercustomize"),
]
LAW = """
import curlfit_helper
from curlfit.friction.isotropic import Coulomb

class Own(Coulomb):
    name = "own"
"""
OF_SHELL = ("os.system", "os.popen")
# what starts a process, as a name or an attribute
STARTS = {
    "ProcessPoolExecutor",
    "Popen",
    "Process",
    "check_call",
    "check_output",
    "create_subprocess_exec",
    "create_subprocess_shell",
    "execv",
    "execve",
    "fork",
    "forkpty",
    "get_context",
    "posix_spawn",
    "set_start_method",
    "spawnv",
    "startfile",
    "subprocess_exec",
    "webbrowser",
}


def lay(folder):
    """A folder with data and, under the name of each module, a file that leaves a mark;
    returns the names."""
    for name in "ab":
        shutil.copy(DATA, folder / f"{name}.csv")
    names = {
        name
        for name in sys.stdlib_module_names
        if name not in sys.builtin_module_names
        and (name == "__future__" or name[0] != "_")
    }
    for name in names.union(LIBRARIES):
        mark = folder / f"{name}-ran"
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'w').close()\n")
    return names


def marks(folder):
    return sorted(mark.name for mark in folder.glob("*-ran"))


def without_those_of_python(folder, tmp_path):
    """Remove the files that `python -m` itself runs, before any of its module."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "nothing.py").write_text("")
    names = []
    while True:
        python("-m", "nothing", cwd=folder, PYTHONPATH=str(tmp_path / "elsewhere"))
        if not marks(folder):
            return names
        for mark in marks(folder):
            names.append(mark.removesuffix("-ran"))
            (folder / mark).unlink()
            (folder / f"{names[-1]}.py").unlink()


@pytest.fixture
def script(tmp_path):
    """The command as an installer writes it."""
    (tmp_path / "bin").mkdir()
    file = tmp_path / "bin" / "curlfit-command"
    file.write_text(
        "import sys\nfrom curlfit.__main__ import run\n"
        "if __name__ == '__main__':\n    sys.exit(run())\n"
    )
    return file


@pytest.mark.parametrize("start", ["command", "-m"])
def test_no_file_in_the_folder_of_the_data_runs(start, script, tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    names = lay(folder)
    words = [script]
    if start == "-m":
        assert len(without_those_of_python(folder, tmp_path)) < len(names) / 10
        words = ["-m", "curlfit"]
    done = python(*words, "fit", "a.csv", "--no-sample", cwd=folder)
    assert (done.returncode, marks(folder)) == (0, []), done.stderr
    done = python(*words, "batch", "a.csv", "b.csv", "--workers", 2, cwd=folder)
    assert (done.returncode, marks(folder)) == (0, []), done.stderr
    assert "2 ok" in done.stdout


WORKER = """
import os, sys
import curlfit.__main__ as entry
from curlfit.numerics.processes import worker_processes

if __name__ == "__main__":
    entry._import_nothing_from_the_working_folder()
    with worker_processes(1) as pool:
        of_worker = pool.submit(eval, "__import__('sys').path").result()
    for path in (sys.path, of_worker):
        print("" in path or os.getcwd() in path)
    print(os.environ["PYTHONPATH"], os.environ["PYTHONSAFEPATH"])
"""


def test_the_working_folder_is_on_no_path_by_an_empty_part_of_pythonpath(
    script, tmp_path
):
    script.write_text(WORKER)
    done = python(script, cwd=tmp_path, PYTHONPATH=f"{SOURCES.parent}:")
    assert done.stderr == ""
    assert done.stdout.split() == ["False", "False", str(SOURCES.parent), "1"]


def test_a_law_imports_what_is_installed_or_named_and_says_so(tmp_path):
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "curlfit_helper.py").write_text("")
    shutil.copy(DATA, tmp_path / "a.csv")
    words = ("-m", "curlfit", "fit", "a.csv", "--no-sample", "--law", "law.py:Own")
    done = python(*words, cwd=tmp_path)
    assert done.returncode == 2
    assert "curlfit_helper.py beside it is not imported" in done.stderr
    assert done.stderr.count("\n") == 1
    where = f"{SOURCES.parent}:{tmp_path}"
    assert python(*words, cwd=tmp_path, PYTHONPATH=where).returncode == 0


def starts(tree):
    """The names in a module that start a process, those of its strings and of what it
    only mentions in annotations apart."""
    names = set()
    for node in ast.walk(tree):
        name = getattr(node, "attr", getattr(node, "id", ""))
        if name in STARTS or name == "subprocess":
            names.add(name)
        elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith(OF_SHELL):
            names.add(ast.unparse(node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {alias.name for alias in node.names} & STARTS
    return names


def test_every_start_of_a_process_is_known():
    starts_by_file = {}
    for file in sorted(SOURCES.rglob("*.py")):
        if names := starts(ast.parse(file.read_text())):
            starts_by_file[str(file.relative_to(SOURCES))] = names
    assert starts_by_file == {
        # the browser: it is no Python
        "app/server.py": {"webbrowser"},
        "cli/saved.py": {"webbrowser"},
        # -P, see below
        "app/work.py": {"create_subprocess_exec", "subprocess", "Process"},
        # PYTHONSAFEPATH, in `worker_processes`, which all others call
        "numerics/processes.py": {"ProcessPoolExecutor", "get_context"},
        "options/figures.py": {"ProcessPoolExecutor"},  # a type
    }
    (call,) = [
        node
        for node in ast.walk(ast.parse((SOURCES / "app" / "work.py").read_text()))
        if isinstance(node, ast.Call)
        and getattr(node.func, "attr", "") == "create_subprocess_exec"
    ]
    assert ast.unparse(call.args[0]) == "sys.executable"
    assert ast.unparse(call.args[1]) == "'-P'"
