"""The shipped data, its fit, and what many tests need: commands, a browser, throws."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

# before NumPy is loaded: threads of its many small matrices would wait for one another
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# isort: split
import jax
import numpy as np
import pytest
from rich.console import Console

import curlfit
from curlfit.numerics import compiled
from curlfit.settings.choices import Reading
from curlfit.throws.load import parts_of

pytest_plugins = ("page_in_browser",)  # fixtures of `curlfit app`
DATA = Path(__file__).parents[1] / "data" / "jensen_shegelski_2004.csv"


@pytest.fixture(scope="module", autouse=True)
def shipped_laws_only():
    """The laws of a test file are known to no other."""
    before = set(curlfit.LAWS)
    yield
    for name in curlfit.LAWS.keys() - before:
        del curlfit.LAWS[name]


@pytest.fixture
def write(tmp_path):
    """A function that writes a file and returns its path."""

    def to_file(content: str | bytes, name: str = "throw.csv") -> Path:
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return file

    return to_file


LONG = (
    "test_book",
    "test_population",
    "test_laws",
    "test_prediction",
    "test_results_in_notebooks",
    "test_comparison",
    "test_batch",
    "test_timings",
    "test_hard_numerics",
)


def pytest_configure(config: pytest.Config) -> None:
    """Have the tests' own programs compile as curlfit's do (see
    `curlfit.numerics.compiled`), in half the time, where this JAX knows how: set for
    the workers, before they start.

    Each program compiles in one piece, since all processors are busy with tests; that
    does not change what it computes.
    """
    os.environ.pop("COLUMNS", None)  # reports are as wide as anywhere else
    # processes run this curlfit, and its programs
    os.environ["PYTHONPATH"] = str(DATA.parents[1])
    # tests turn from law to law, and there is memory for it
    compiled._MOST_LOADED = 100
    gc.set_threshold(100_000)  # tracing makes many objects
    if hasattr(config, "workerinput"):
        return
    lowered = jax.jit(lambda x: x).lower(0.0)
    with suppress(jax.errors.JaxRuntimeError):
        options = {
            "xla_cpu_use_fusion_emitters": False,
            "xla_cpu_parallel_codegen_split_count": 1,
        }
        lowered.compile(compiler_options=options)
        flags = [f"--{name}={str(value).lower()}" for name, value in options.items()]
        # first, for of two that contradict each other XLA takes the last
        os.environ["XLA_FLAGS"] = " ".join(
            (*flags, os.environ.get("XLA_FLAGS", ""))
        ).strip()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, so that none of them runs on alone at the end."""
    rank = {name: -1 - LONG[::-1].index(name) for name in LONG}
    items.sort(key=lambda item: rank.get(item.path.stem, 0))


class Ran(NamedTuple):
    """What a run of `curlfit` left: the names are those of `subprocess`."""

    returncode: int
    stdout: str
    stderr: str


def python(
    *words: object, cwd: Path | None = None, **settings: str
) -> subprocess.CompletedProcess[str]:
    """Python as a process of its own, in a folder, with further settings of
    the environment."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=1500,
        # not that of the C library, to which readline adds the width of a terminal
        check=False,
        env=os.environ | settings,
    )


def process(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """`curlfit` as a process of its own, in a folder."""
    return python("-m", "curlfit", *words, cwd=cwd)


STRICT = ("-W", "error")  # warnings are errors, as in the tests


LAUNCH = (
    "\nimport fcntl, os, resource, signal, termios\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)"
    "  # which a background job ignores\n"
    "signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup ignores\n"
    "if os.isatty(0):\n"
    "    fcntl.ioctl(0, termios.TIOCSCTTY, 0)  # the system then tells of its end\n"
    "resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))\n"
    "from curlfit.__main__ import run\n"
    "run()\n"
)


def started(*words: object, room: int = -1, **how: Any) -> subprocess.Popen[str]:
    """The command as a running process, in a group of its own; with `room`, no file of
    it may have more bytes."""
    return subprocess.Popen(
        [sys.executable, "-c", LAUNCH.replace("ROOM", str(room)), *map(str, words)],
        start_new_session=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **how},
    )


def parts_in(file, **choices):
    """All throws in a file."""
    return parts_of(file, Reading.of(**choices))


def command(*words: object, cwd: Path) -> Ran:
    """What that process would do, in this one: it need not load JAX and the
    programs again."""
    from curlfit.cli import main
    from curlfit.errors import warn_once

    warn_once.cache_clear()
    before = sys.argv
    status = 0
    with (
        chdir(cwd),
        redirect_stdout(StringIO()) as out,
        redirect_stderr(StringIO()) as err,
    ):
        sys.argv = ["curlfit", *map(str, words)]
        try:
            main()
        except SystemExit as ended:
            status = (
                ended.code
                if isinstance(ended.code, int)
                else int(ended.code is not None)
            )
        finally:
            sys.argv = before
    return Ran(status, out.getvalue(), err.getvalue())


class Invoked(NamedTuple):
    """What a command printed, its exit status, and the error that it raised."""

    stdout: str
    stderr: str
    exit_code: int
    exception: Exception | None = None


def invoke(words: Sequence[object]) -> Invoked:
    """Carry out a command in this process and folder, without the words of `main`
    for an error."""
    from curlfit import cli

    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        try:
            status = cli.run([*map(str, words)])
            error = None
        except curlfit.CurlfitError as refusal:
            status = refusal.exit_status
            error = refusal
    return Invoked(out.getvalue(), err.getvalue(), status, error)


@pytest.fixture
def typed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """What `curlfit` with some words prints, in the folder of a test's file."""
    monkeypatch.chdir(folder)

    def run(*words: object) -> str:
        done = invoke(words)
        assert done.exit_code == 0, done.exception
        return done.stdout

    return run


BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def browser():
    """Chromium, of whose console nothing is lost."""
    webdriver = pytest.importorskip(
        "selenium.webdriver", reason="selenium is not installed"
    )
    named = (os.environ.get("CHROMIUM", ""), *BROWSERS)
    chromium = next(filter(None, map(shutil.which, named)), None)
    chromedriver = shutil.which("chromedriver")
    if chromium is None or chromedriver is None:
        pytest.skip("there is no Chromium with its chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1280,900",
    ):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(
        options=options, service=webdriver.ChromeService(chromedriver)
    )
    yield driver
    driver.quit()


def wait_for(condition: Callable[[], Any], seconds: float = 120.0) -> None:
    """Wait until something is so; it fails where it hangs, not where it is slow."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.03)


def codes_of(result: Any) -> list[str]:
    """The codes of the warnings of a result."""
    return [warning.code for warning in result.warnings]


def finding_of(result: Any, code: str) -> curlfit.Finding:
    """The one warning of a result with a code."""
    (warning,) = [warning for warning in result.warnings if warning.code == code]
    return warning


@pytest.fixture(scope="session")
def eq12() -> curlfit.Throw:
    return curlfit.load_throw(DATA)


@pytest.fixture(scope="session")
def eq12_fit(eq12: curlfit.Throw) -> curlfit.FitResult:
    return curlfit.fit(eq12)


@pytest.fixture(scope="session")
def eq12_posterior(
    eq12_fit: curlfit.FitResult,
) -> tuple[curlfit.FitResult, curlfit.Chain]:
    return curlfit.sample(eq12_fit, seed=1)


NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
TIMES = np.linspace(0.0, 20.0, 201)


def filmed(
    law: curlfit.Law | None = None,
    seed: int = 0,
    noise: dict[str, float] = NOISE,
    times: np.ndarray = TIMES,
    **how: Any,
) -> curlfit.Throw:
    """A throw of `front-back` or another law, with independent noise in the
    channels named.

    Of `how`, what `simulate` does not know is of the initial state. Times and initial
    speed are alike in most tests, so that one program serves them.
    """
    start = {
        name: how.pop(name) for name in set(how) - {"stone", "load", "environment"}
    }
    path = curlfit.simulate(
        law or curlfit.LAWS["front-back"](),
        how.pop("stone", curlfit.Stone()),
        curlfit.InitialState(**({"v": 2.1, "omega": 1.2} | start)),
        times,
        **how,
    ).to_numpy()
    random = np.random.default_rng(seed)
    channels = {
        name: getattr(path, name) + size * random.standard_normal(len(times))
        for name, size in noise.items()
    }
    return curlfit.Throw.from_arrays(times, **channels)


def shown(fit: curlfit.FitResult, width: int = 110) -> str:
    """The words of the report of a fit."""
    text = StringIO()
    curlfit.print_fit(fit, Console(width=width, file=text))
    return " ".join(text.getvalue().split())
