"""Settings of JAX under which nothing can be computed: said in a sentence, with their
names, and not at all where nothing is computed."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from conftest import DATA, python

import curlfit

CANNOT = {
    "JAX_PLATFORMS=cuda": "JAX_PLATFORMS=cuda: JAX finds no such processor on this",
    "JAX_PLATFORMS=nonsense": "JAX_PLATFORMS=nonsense: JAX finds no such processor",
    "JAX_PLATFORM_NAME=tpu": "JAX_PLATFORM_NAME=tpu: JAX finds no such processor on",
    "JAX_DISABLE_JIT=1": "JAX_DISABLE_JIT=1: curlfit computes with programs that JAX",
    "JAX_DISABLE_JIT=True": "JAX_DISABLE_JIT=True: curlfit computes with programs th",
    "JAX_DISABLE_JIT=": "JAX_DISABLE_JIT=: curlfit computes with programs that JAX",
}
"""Settings, and how what is said of them begins."""
CAN = ("JAX_PLATFORMS=cpu", "JAX_PLATFORMS=", "JAX_DISABLE_JIT=0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, eq12_fit):
    """A folder with a saved fit."""
    folder = tmp_path_factory.mktemp("settings")
    (folder / "a-fit").mkdir()
    eq12_fit.save(folder / "a-fit" / "fit.json")
    return folder


def run(setting: str, *words: object, cwd):
    """A process under a setting, such as "JAX_DISABLE_JIT=1"."""
    name, _, value = setting.partition("=")
    return python(*words, cwd=cwd, **{name: value})


@pytest.mark.parametrize(("setting", "said"), CANNOT.items())
def test_a_command_says_why_nothing_can_be_computed(folder, setting, said):
    before = sorted(folder.rglob("*"))
    ran = run(setting, "-m", "curlfit", "fit", DATA, cwd=folder)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.startswith(f"curlfit: {said}")
    assert "leave it out, or set it to " in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "words",
    [
        f"compare {DATA}",
        f"batch {DATA}",
        f"profile {DATA} --param mu1_xi",
        "predict a-fit",
        "design",
        "simulate",
        "reproduce",
        "report a-fit",
        "export a-fit --to game",
    ],
)
@pytest.mark.parametrize("setting", ["JAX_PLATFORMS=cuda", "JAX_DISABLE_JIT=1"])
def test_every_command_that_computes_says_so(folder, setting, words):
    before = sorted(folder.rglob("*"))
    ran = run(setting, "-m", "curlfit", *words.split(), cwd=folder)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.startswith(f"curlfit: {CANNOT[setting]}")
    assert ran.stderr.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


WITHOUT_JAX = """
import sys
from curlfit import cli
sys.argv[0] = "curlfit"
try:
    cli.main()
except SystemExit as ended:
    print(ended.code, "jax" in sys.modules, file=sys.stderr)
"""


@pytest.mark.parametrize(
    "words",
    [f"check {DATA}", "show a-fit", "laws", "explain correlated", "fit no.csv", "fit"],
)
@pytest.mark.parametrize("setting", ["JAX_DISABLE_JIT=1", "JAX_DISABLE_JIT=0"])
def test_what_needs_no_jax_does_not_load_it(folder, setting, words):
    ran = run(setting, "-c", WITHOUT_JAX, *words.split(), cwd=folder)
    if setting in CANNOT and words.startswith("fit no"):
        assert ran.stderr.startswith(f"curlfit: {CANNOT[setting]}")
    assert ran.stderr.splitlines()[-1] in ("0 False", "2 False")


@pytest.mark.parametrize("words", [f"check {DATA}", "show a-fit", "laws"])
def test_what_computes_nothing_runs_under_any_setting(folder, words):
    usual = python("-m", "curlfit", *words.split(), cwd=folder)
    for setting in CANNOT:
        ran = run(setting, "-m", "curlfit", *words.split(), cwd=folder)
        assert (ran.returncode, ran.stdout) == (0, usual.stdout)


IN_PYTHON = """
import curlfit
law, stone = curlfit.law_with("front-back", {}), curlfit.Stone()
start = curlfit.InitialState(v=2.0, omega=1.0)
try:
    curlfit.simulate(law, stone, start, [0.0, 0.1])
except curlfit.CurlfitError as error:
    print(error)
else:
    print("computed")
"""


# without "JAX_DISABLE_JIT=", under which JAX itself cannot be imported
@pytest.mark.parametrize("setting", [*list(CANNOT)[:-1], *CAN])
def test_python_says_so_too(tmp_path, setting):
    ran = run(setting, "-c", IN_PYTHON, cwd=tmp_path)
    assert ran.stdout.startswith(CANNOT.get(setting, "computed")), ran.stderr


def test_a_program_is_not_run_where_jax_may_not_compile():
    law = curlfit.law_with("coulomb", {})
    stone = curlfit.Stone()
    start = curlfit.InitialState(v=2.0, omega=1.0)
    times = np.array([0.0, 0.1, 0.2])
    before = curlfit.simulate(law, stone, start, times)
    with (
        jax.disable_jit(),
        pytest.raises(curlfit.InputError, match=r"^jax\.disable_jit: curlfit computes"),
    ):
        curlfit.simulate(law, stone, start, times)
    after = curlfit.simulate(law, stone, start, times)
    np.testing.assert_array_equal(after.y, before.y)
