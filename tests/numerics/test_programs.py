"""Compiled programs in the user's cache folder, those that threads load or compile
before they are needed, and JAX's width of numbers."""

from __future__ import annotations

import json
import os
import stat
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import STRICT, python

from curlfit.errors import warn_once
from curlfit.numerics import compiled, program_cache as cache
from curlfit.numerics.threads import cores

CODE = """
import numpy as np
from curlfit.numerics import compiled as programs

traced = []

@programs.compiled("word")
def twice(word, values):
    traced.append(word)
    return {"of": values * 2, "word": (values,)} if word == "double" else values
"""
CALLS = """
assert twice("double", np.arange(3.0))["of"].tolist() == [0.0, 2.0, 4.0]
assert twice("same", np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]
assert twice("double", np.arange(4.0))["of"].tolist() == [0.0, 2.0, 4.0, 6.0]
print(len(traced))
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """The number that code prints where no program is loaded, as in a new process: by
    default how often the function is traced. Its cache lies in a folder of the test."""

    def run(code=CODE + CALLS, stderr=False, **settings):
        monkeypatch.setattr(compiled, "_programs", {})
        for name, value in (
            {"CURLFIT_CACHE": str(tmp_path / "cache")} | settings
        ).items():
            monkeypatch.setenv(name, value)
        cache.folder.cache_clear()
        warn_once.cache_clear()
        exec(code, {"__name__": "script"})
        out, err = capsys.readouterr()
        assert stderr or err == ""
        return (int(out), err) if stderr else int(out)

    run.folder = tmp_path / "cache" / "programs"
    yield run
    cache.folder.cache_clear()


def test_a_second_process_traces_nothing(run, tmp_path):
    assert run() == 3
    for count in (3, 0):  # and in processes of their own
        done = python(
            *STRICT, "-c", CODE + CALLS, CURLFIT_CACHE=str(tmp_path / "other")
        )
        assert (done.returncode, done.stdout, done.stderr) == (0, f"{count}\n", "")
    assert len(list(run.folder.iterdir())) == 3  # each word and shape has its own
    assert run() == 0


@pytest.mark.skipif(cores() < 2, reason="nothing is done beside on a single core")
def test_a_program_in_preparation_is_compiled_once(run, monkeypatch):
    prepared = (
        'twice.prepare("double", np.ones(3)); twice.prepare("double", np.zeros(3))\n'
    )
    assert run(CODE + prepared + CALLS) == 3
    # What the thread has read stands though no file can be read any more.
    read = "while not any(p.done() for p in programs._programs.values()): pass\n"
    unreadable = "programs.cache.read = lambda file: None\n"
    monkeypatch.setattr(cache, "read", cache.read)  # afterwards
    assert run(CODE + prepared + read + unreadable + CALLS) == 2


def test_an_error_in_preparation_comes_with_the_call(run):
    code = """
@programs.compiled()
def wrong(values):
    raise ValueError("no such path")

wrong.prepare(np.ones(3))
try:
    wrong(np.ones(3))
except ValueError as error:
    print(str(error) == "no such path" and 7)
"""
    assert run(CODE + code) == 7


def test_a_single_wrong_bit_is_noticed_and_the_program_made_again(run):
    """XLA itself would crash, or compute other numbers."""
    run()
    for file in run.folder.iterdir():
        program = file.read_bytes()
        offsets = np.linspace(0, len(program) - 1, 8).astype(int)
        file.write_bytes(program[:-200])  # cut short
        assert cache.read(file) is None
        for bit, offset in enumerate(offsets):  # from the first byte to the last
            damaged = bytearray(program)
            damaged[offset] ^= 1 << bit
            file.write_bytes(damaged)
            assert cache.read(file) is None
    assert run() == 3  # with the right numbers
    assert run() == 0


def test_a_cache_of_jax_named_by_the_user_is_left_to_jax(tmp_path):
    """What JAX takes out of its cache and stores again cannot be run."""
    environment = {
        "CURLFIT_CACHE": str(tmp_path / "cache"),
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    done = python(*STRICT, "-c", CODE + CALLS, **environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, "3\n", "")
    assert list((tmp_path / "cache" / "programs").iterdir()) == []
    assert list((tmp_path / "jax").iterdir()) != []


OWN_LAW = """
import numpy as np
from curlfit.numerics.compiled import compiled

class Law:
    @classmethod
    def shipped(cls):
        return False

@compiled("law")
def force(law, values):
    return values * {factor}

print(int(force(Law, np.ones(3))[0]))
"""


def test_a_law_of_the_user_is_compiled_again_only_if_it_does_something_else(run):
    for factor, files in ((2, 1), (2, 1), (3, 2)):
        assert run(OWN_LAW.format(factor=factor)) == factor
        assert len(list(run.folder.iterdir())) == files


def test_the_cache_can_be_switched_off(run):
    assert run() == run(CURLFIT_CACHE="off") == 3
    assert not run.folder.parent.joinpath("off").exists()


HOUSEKEEPING = """
import os, sys
from pathlib import Path
from curlfit.numerics import program_cache as cache

cache.LIMIT = {limit}
folder = cache.folder()
{code}
"""


@pytest.fixture
def keeping(tmp_path):
    """Run code in a new process with `cache`, a `limit` and a `folder` of the cache."""

    def run(code, limit=cache.LIMIT, place=tmp_path / "cache", **settings):
        text = HOUSEKEEPING.format(limit=limit, code=code)
        done = python(*STRICT, "-c", text, CURLFIT_CACHE=str(place), **settings)
        assert done.returncode == 0, done.stderr
        return done

    return run


user = os.geteuid() if hasattr(os, "geteuid") else None
posix = pytest.mark.skipif(user is None, reason="permissions of POSIX")
root = pytest.mark.skipif(
    user != 0, reason="only root gives files away, and makes such folders"
)


@posix
def test_what_is_kept_is_the_users_own_whatever_the_umask(keeping, tmp_path):
    cache_folder = tmp_path / "new" / "cache"
    done = keeping(
        "os.umask(0); cache.folder.cache_clear(); folder = cache.folder()\n"
        "cache.write(folder / 'a', b'one'); print(cache.read(folder / 'a'))",
        place=cache_folder,
    )
    assert (done.stdout, done.stderr) == ("b'one'\n", "")
    assert stat.S_IMODE((cache_folder / "programs" / "a").stat().st_mode) == 0o600
    assert stat.S_IMODE((cache_folder / "programs").stat().st_mode) == 0o700


@posix
def test_a_file_that_others_may_write_is_not_run(run):
    run()
    file, *_ = run.folder.iterdir()
    file.chmod(0o620)
    assert run() == 1
    assert run() == 0
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@posix
def test_a_folder_that_others_may_write_is_no_cache(run):
    run()
    for which in ("cache/programs", "."):
        open_ = run.folder.parent.parent / which
        open_.chmod(0o770)
        count, message = run(stderr=True)
        assert count == 3
        assert message.count("\n") == 1
        assert "Warning: compiled programs are not kept in" in message
        assert f"others may write to {open_.resolve()};" in message
        open_.chmod(0o700)
    assert run() == 0


@root
def test_a_file_or_folder_of_another_user_is_not_read(run):
    run()
    file = next(run.folder.iterdir())
    os.chown(file, 12345, -1)
    assert run() == 1
    os.chown(run.folder, 12345, -1)
    count, message = run(stderr=True)
    assert count == 3
    assert "others may write to" in message
    os.chown(run.folder, 0, -1)
    assert run() == 0


@root
def test_the_folder_of_all_temporary_files_may_lie_above(keeping, tmp_path):
    """As /tmp does: anybody may write to it, and move nothing that is another's."""
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o1777)
    done = keeping("print(folder.name)", place=tmp_path / "shared" / "cache")
    assert (done.stdout, done.stderr) == ("programs\n", "")


@root
def test_a_user_without_a_home_has_no_cache(keeping, tmp_path):
    done = keeping(
        "import platformdirs, platformdirs.unix, pwd\n"
        "os.setuid(54321); del os.environ['HOME']; os.environ['CURLFIT_CACHE'] = ''\n"
        "os.environ.pop('XDG_CACHE_HOME', None); cache.folder.cache_clear()\n"
        "print(cache.folder())"
    )
    assert (done.stdout, done.stderr) == ("None\n", "")


def test_above_the_limit_goes_what_was_not_used_for_longest(keeping, tmp_path):
    folder = tmp_path / "cache" / "programs"
    keeping("for name in 'abcd': cache.write(folder / name, bytes(100))")
    for age, name in enumerate("abcd"):
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    (folder.parent / "mine.txt").write_text("not of the cache" * 100)
    done = keeping(
        "cache.read(folder / 'd'); cache.write(folder / 'e', bytes(100))", limit=450
    )
    assert done.stderr == ""
    assert sorted(file.name for file in folder.iterdir()) == ["a", "d", "e"]
    keeping("cache.write(folder / 'f', bytes(400))", limit=450)
    assert [file.name for file in folder.iterdir()] == ["f"]
    assert (folder.parent / "mine.txt").exists()


def test_many_processes_write_read_and_drop_at_a_time(keeping, tmp_path):
    code = """
import random
random.seed(os.getpid())
for _ in range(300):
    name = random.choice("abcdefghij")
    content = cache.read(folder / name)
    assert content in (None, name.encode() * 1000), content
    cache.write(folder / name, name.encode() * 1000)
"""
    with ThreadPoolExecutor(4) as pool:
        done = list(pool.map(lambda _: keeping(code, limit=4500), range(4)))
    assert {run.stderr for run in done} == {""}
    left = [file.stat().st_size for file in (tmp_path / "cache" / "programs").iterdir()]
    assert sum(left) <= 4500 + 4 * 1032  # what was written while another counted
    assert set(left) == {1032}  # with the checksum


FIRST_USE = """
{imports}
law = lambda: curlfit.LAWS["coulomb"](0.01)
def y(v):
    start = curlfit.InitialState(v=v, omega=0.0)
    return curlfit.simulate(law(), curlfit.Stone(), start, [0.0, 10.0, 30.0]).y
print({use})
print(y(2.0).tolist())
"""
PLACES = [0.0, 20 - 0.0981 * 10**2 / 2, 2**2 / (2 * 0.0981)]
"""v t - mu g t^2/2, and v^2/(2 mu g) at rest"""


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A cache for uses that are traced anew and compile to the same."""
    return tmp_path_factory.mktemp("cache")


PATHS = "jax.jit(y)(2.0).tolist()", PLACES
SLOPES = "jax.jvp(y, (2.0,), (1.0,))[1].tolist()", [0, 10, 2 / 0.0981]


@pytest.mark.parametrize(
    ("imports", "wide", "use", "expected"),
    [("import curlfit, jax", None, *SLOPES), ("import jax, curlfit", "0", *PATHS)],
)
def test_the_first_use_may_be_traced(imports, wide, use, expected, shared, monkeypatch):
    monkeypatch.delenv("JAX_ENABLE_X64", raising=False)
    if wide is not None:
        monkeypatch.setenv("JAX_ENABLE_X64", wide)
    code = FIRST_USE.format(imports=imports, use=use)
    run = python(*STRICT, "-c", code, CURLFIT_CACHE=str(shared))
    assert run.returncode == 0, run.stderr
    first, second = map(json.loads, run.stdout.splitlines())
    assert first == pytest.approx(expected, abs=1e-7)
    assert second == pytest.approx(PLACES, abs=1e-7)
