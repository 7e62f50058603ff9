"""The shipped data, its fit, and an integration that shares no code with
the program."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from functools import lru_cache
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

# before NumPy is loaded: threads of its many small matrices would wait for one another
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# isort: split
import jax
import numpy as np
import pytest
from rich.console import Console
from scipy.integrate import solve_ivp

import curlfit
from curlfit.numerics import compiled
from curlfit.settings.choices import Reading
from curlfit.throws.load import parts_of

DATA = Path(__file__).parents[1] / "data" / "jensen_shegelski_2004.csv"
G = 9.81


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
    place = {name: -1 - LONG[::-1].index(name) for name in LONG}
    items.sort(key=lambda item: place.get(item.path.stem, 0))


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
    "\nimport resource, signal\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)"
    "  # which a background job ignores\n"
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
    before, status = sys.argv, 0
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
            status, error = cli.run([*map(str, words)]), None
        except curlfit.CurlfitError as refusal:
            status, error = refusal.exit_status, refusal
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


def wait_for(condition: Callable[[], Any], seconds: float = 30.0) -> None:
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.03)


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


class Ring(NamedTuple):
    """Points of the ring, lengths over R: what a law of the tests is given."""

    alpha: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    v_xi: np.ndarray
    v_eta: np.ndarray
    speed: np.ndarray
    weight: np.ndarray
    turned: float
    time: float


Traction = Callable[[Ring, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Force per unit normal load (right, forward), from the points and the load n/n0."""


def front_back(
    mu1_xi: float, mu2_xi: float, mu1_eta: float, mu2_eta: float
) -> Traction:
    def traction(ring: Ring, _: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        front = ring.eta > 0
        mu_xi, mu_eta = (
            np.where(front, mu1_xi, mu2_xi),
            np.where(front, mu1_eta, mu2_eta),
        )
        return -mu_xi * ring.v_xi / ring.speed, -mu_eta * ring.v_eta / ring.speed

    return traction


Rates = Callable[[float, float, float, float], Sequence[float]]
"""Accelerations (right, forward, angular) from speed, spin, angle turned and time."""


def follow(
    start: curlfit.InitialState,
    times: np.ndarray,
    phases: Sequence[tuple[Rates, Callable[[float, float], float] | None]],
    inertia: float | None,
) -> np.ndarray:
    """x, y, phi at the times, shape (3, n); held after rest.

    Each phase ends where its function of (spin, angle turned) passes zero. Without
    `inertia` the stone rests when it stops sliding, though it may still spin.
    """
    state = np.array([start.x, start.y, start.v, start.heading, start.phi, start.omega])
    now, found = 0.0, np.empty((3, len(times)))
    found[:] = state[[0, 1, 4], None]
    for accelerations, end in phases:

        def rates(
            t: float, state: np.ndarray, accelerations: Rates = accelerations
        ) -> list[float]:
            _, _, v, beta, phi, omega = state
            a_xi, a_eta, angular = accelerations(v, omega, phi - start.phi, t)
            return [v * np.sin(beta), v * np.cos(beta), a_eta, a_xi / v, omega, angular]

        def rest(_: float, state: np.ndarray) -> float:
            if inertia is None:
                return float(state[2]) - 1e-9
            v, u = state[2], inertia * abs(state[5])
            # or all but at rest, on the spot, where a heading has no meaning
            return float(min(np.hypot(v, u) - 1e-7, max(v - 1e-9, u - 2e-6)))

        def over(
            _: float,
            state: np.ndarray,
            end: Callable[[float, float], float] | None = end,
        ) -> float:
            return 1.0 if end is None else end(state[5], state[4] - start.phi)

        rest.terminal = over.terminal = True  # type: ignore[attr-defined]
        # With 1e-11 a step over |epsilon| = 1, where friction has a kink, may pass for
        # exact and be off by 1e-7, this or that way by the rounding of the machine's
        # matrix products.
        part = solve_ivp(
            rates,
            (now, times[-1]),
            state,
            method="DOP853",
            rtol=1e-13,
            atol=1e-15,
            events=(rest, over),
            dense_output=True,
        )
        assert part.success
        later = times >= now
        found[:, later] = part.sol(np.minimum(times[later], part.t[-1]))[[0, 1, 4]]
        now, state = part.t[-1], part.y[:, -1]
        if not len(part.t_events[1]):
            break
    return found


_TRIALS = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])  # of the load


@dataclass
class Reference:
    """A local law on a dense ring, in plain numpy, for scipy's order-8 integrator.

    The ring is cut where the law jumps: between the halves and at the polar angles
    in `edges`. Each piece has `nodes` Gauss points crowded by a cubic map toward
    the place where sliding stops. `corner` is the angle turned at which friction
    changes its course.
    """

    traction: Traction
    R: float = 0.054
    rho: float = 0.1
    h: float | None = None
    edges: Callable[[float], Sequence[float]] = lambda turned: ()
    corner: float | None = None
    nodes: int = 200

    def __post_init__(self) -> None:
        s, w = np.polynomial.legendre.leggauss(self.nodes)
        self.s, self.w = (s + 1) / 2, w / 2
        self.points = lru_cache(self.points)  # type: ignore[method-assign]

    def points(self, slow: float, edges: tuple[float, ...]) -> tuple[np.ndarray, ...]:
        """Polar angles, their cosines and sines, and weights."""
        alpha, weight = [], []
        for half in (1, -1):
            gaps = [abs(abs(edge) - slow) for edge in edges if edge * half > 0]
            # |alpha| is pi s^3 away from the slow place
            ends = [0.0, *sorted((gap / np.pi) ** (1 / 3) for gap in gaps), 1.0]
            for low, high in pairwise(ends):
                s = low + (high - low) * self.s
                alpha.append(half * np.abs(slow - np.pi * s**3))
                weight.append((high - low) * self.w * 3 * s**2 / 2)
        a, w = np.concatenate(alpha), np.concatenate(weight)
        return a, np.cos(a), np.sin(a), w

    def ring(self, v: float, u: float, turned: float = 0.0, time: float = 0.0) -> Ring:
        slow = np.pi if u >= 0 else 0.0
        a, xi, eta, w = self.points(slow, tuple(self.edges(turned)))
        v_xi, v_eta = -u * eta, v + u * xi
        return Ring(a, xi, eta, v_xi, v_eta, np.hypot(v_xi, v_eta), w, turned, time)

    def force(
        self, v: float, u: float, turned: float = 0.0, time: float = 0.0
    ) -> np.ndarray:
        """Force over m g (right, forward) and moment over m g R.

        The load (p, q) = -2 (h/R) T of eq. 8-9 is found by Newton's method
        from differences.
        """
        ring, tilt = self.ring(v, u, turned, time), np.zeros(2)
        if self.h is None:
            return self.net(ring, tilt)
        size = -2 * self.h / self.R
        force, *moved = self.net(ring, _TRIALS)
        slope = np.array([(other - force)[:2] for other in moved]).T * (
            size / _TRIALS[1, 0]
        )
        inverse = np.linalg.inv(np.eye(2) - slope)
        for _ in range(100):
            change = inverse @ (size * force[:2] - tilt)
            if np.abs(change).max() < 1e-14:
                return force
            tilt = tilt + change
            force = self.net(ring, tilt)
        raise AssertionError("the load does not settle")

    def net(self, ring: Ring, tilt: np.ndarray) -> np.ndarray:
        """The same under the load 1 + p xi + q eta, of one or many (p, q) on
        the last axis."""
        p, q = tilt[..., :1], tilt[..., 1:]
        load = 1 + p * ring.xi + q * ring.eta
        t_xi, t_eta = self.traction(ring, load)
        n_xi, n_eta = load * t_xi, load * t_eta
        moment = ring.xi * n_eta - ring.eta * n_xi
        return np.array(
            [n_xi @ ring.weight, n_eta @ ring.weight, moment @ ring.weight]
        ).T

    def path(self, start: curlfit.InitialState, times: np.ndarray) -> np.ndarray:
        """x, y, phi at the times, shape (3, n); held after rest."""

        def accelerations(
            v: float, omega: float, turned: float, time: float
        ) -> Sequence[float]:
            a_xi, a_eta, moment = G * self.force(v, self.R * omega, turned, time)
            return a_xi, a_eta, moment * self.R / self.rho**2

        phases: list = [(accelerations, None)]
        if self.corner is not None:
            corner = self.corner
            phases.insert(0, (accelerations, lambda _, turned: corner - abs(turned)))
        return follow(start, times, phases, self.rho)
