"""Benchmarks: each against a peer in the same run, as ratios.

    python tests/benchmarks/run.py [answering] [verbs] [stopwatch] [forward] [roof]
        [batch] ...

Prints a table in Markdown; `README.md` beside this keeps the tables with date
and machine.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
DATA = HERE.parent.parent / "data" / "jensen_shegelski_2004.csv"
# the installed one, wherever this is run
CURLFIT = [sys.executable, "-P", "-m", "curlfit"]
# throws of a batch; the time of the first quarter is taken off, as it starts up
_SEASON = 4096


def row(*cells: Any) -> None:
    """A line of the table."""
    words = (f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in cells)
    print("| " + " | ".join(words) + " |", flush=True)


def processes(
    *commands: list[str], times: int = 5, env: dict[str, str] | None = None
) -> list[float]:
    """Median wall time of whole processes, s, taken in turns."""
    taken: list[list[float]] = [[] for _ in commands]
    for _ in range(times):
        for index, command in enumerate(commands):
            begin = time.perf_counter()
            subprocess.run(
                command, capture_output=True, check=False, env=os.environ | (env or {})
            )
            taken[index].append(time.perf_counter() - begin)
    return [statistics.median(series) for series in taken]


class Usage(NamedTuple):
    """What a process took; figures are drawn by a second one."""

    seconds: float
    processor: float
    """s, with the processes that it started"""
    memory: float
    """most, MB"""


def measured(command: list[str], env: dict[str, str] | None = None) -> Usage:
    """Run a process and measure what it takes."""
    begin = time.perf_counter()
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | (env or {}),
    )
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    assert status == 0, command
    processor = usage.ru_utime + usage.ru_stime
    return Usage(seconds, processor, usage.ru_maxrss / 1024)


def best(function: Callable[[], Any], seconds: float = 2.0) -> float:
    """Least wall time of a call, s, of those in some seconds, after one
    that compiles."""
    import jax

    jax.block_until_ready(function())
    times = []
    end = time.perf_counter() + seconds
    while not times or time.perf_counter() < end:
        begin = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - begin)
    return min(times)


def answering() -> None:
    """The command as a process, against the scipy script as one."""
    peer = [sys.executable, str(HERE / "peer_scipy.py"), str(DATA)]
    with tempfile.TemporaryDirectory() as folder:
        fit = [*CURLFIT, "fit", str(DATA), "--no-sample", "--out", f"{folder}/fit"]
        bare = [*fit, "--no-figures"]
        with_posterior = [*CURLFIT, "fit", str(DATA), "--out", f"{folder}/whole"]
        (first,) = processes(bare, times=1, env={"CURLFIT_CACHE": f"{folder}/cache"})
        (first_with_posterior,) = processes(
            with_posterior, times=1, env={"CURLFIT_CACHE": f"{folder}/other"}
        )
        processes(with_posterior, times=1)
        report = [*CURLFIT, "report", f"{folder}/whole"]
        commands = {
            "fit, no figures": bare,
            "fit with fit.png": fit,
            "fit, posterior and two figures": with_posterior,
            "report of that": report,
            "--help": [*CURLFIT, "--help"],
            "refusal of a bad file": [*CURLFIT, "fit", str(HERE / "run.py")],
        }
        script, *ours = processes(peer, *commands.values())
    row("scipy script", f"{script:.2f} s", 1.0)
    for name, taken in zip(commands, ours, strict=True):
        row(name, f"{taken:.2f} s", taken / script)
    row("first run on a machine, no figures", f"{first:.2f} s", first / script)
    row(
        "first run, posterior and two figures",
        f"{first_with_posterior:.2f} s",
        first_with_posterior / script,
    )


def verbs() -> None:
    """The other commands, first with nothing compiled and then again, against the
    scipy script."""
    peer = [sys.executable, str(HERE / "peer_scipy.py"), str(DATA)]
    with tempfile.TemporaryDirectory() as folder:
        fit = f"{folder}/fit"
        commands = {
            "fit": ["fit", str(DATA)],
            "compare --load both": ["compare", str(DATA), "--load", "both"],
            "predict --to-tee": ["predict", fit, "--to-tee"],
            "profile --param mu1_xi": ["profile", fit, "--param", "mu1_xi"],
            "design": ["design"],
            "reproduce": ["reproduce"],
        }
        processes([*CURLFIT, "fit", str(DATA), "--out", fit], times=1)
        (script,) = processes(peer)
        row("scipy script", f"{script:.2f} s", 1.0)
        for number, (name, words) in enumerate(commands.items()):
            environment = {"CURLFIT_CACHE": f"{folder}/cache-{number}"}
            command = [*CURLFIT, *words, "--out", f"{folder}/result-{number}"]
            runs = [measured(command, environment) for _ in range(4)]
            seconds, _, memory = runs[0]
            row(f"{name}, first", f"{seconds:.1f} s, {memory:.0f} MB", seconds / script)
            seconds, _, memory = map(statistics.median, zip(*runs[1:], strict=True))
            row(name, f"{seconds:.2f} s, {memory:.0f} MB", seconds / script)


def stopwatch() -> None:
    """A stopwatch's record by the command, against the scipy script in closed form."""
    peer = [sys.executable, str(HERE / "peer_stopwatch.py")]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "stopwatch.txt")
        file.write_text("hog_to_hog = 14.2\ncurl = 4 ft left\nrest = 0.6\n")
        fit = [*CURLFIT, "fit", str(file), "--no-sample", "--out", f"{folder}/fit"]
        processes(fit, times=1)
        bare, drawn, ours, with_figure = processes(
            [*peer, str(file)],
            [*peer, str(file), f"{folder}/a.png"],
            [*fit, "--no-figures"],
            fit,
        )
    row("scipy script", f"{bare:.2f} s", 1.0)
    row("fit, no figures", f"{ours:.2f} s", ours / bare)
    row("scipy script with a figure", f"{drawn:.2f} s", 1.0)
    row("fit with fit.png", f"{with_figure:.2f} s", with_figure / drawn)


def forward() -> None:
    """One path of 201 times under vmap, against scipy and diffrax, compiled as
    curlfit's own programs are.

    The first-order law has the closed form of eq. 27 in place of the ring: the floor.
    """
    import jax
    import peer_scipy

    from curlfit import LAWS, InitialState, Stone, simulate

    t = np.linspace(0, 20, 201)
    random = np.random.default_rng(0)
    lanes = 256
    v = random.uniform(2.05, 2.2, lanes)
    omega = random.uniform(0.5, 3, lanes)
    p = np.array([4e-4, 0.0556, 0.0088, 0.0088, 0, 0, 0, 2.1, 0, 1.0])
    begin = time.perf_counter()
    for _ in range(5):
        peer_scipy.path(p, t)
    script = (time.perf_counter() - begin) / 5
    row("scipy, front-back", f"{script * 1e6:.0f} us a path", 1.0)
    for name, load in (
        *((name, "uniform") for name in LAWS),
        ("front-back", "consistent"),
    ):
        law = LAWS[name]()
        stone = Stone(R=0.054)

        def places(
            v: Any, omega: Any, law: Any = law, stone: Any = stone, load: str = load
        ) -> Any:
            path = simulate(law, stone, InitialState(v=v, omega=omega), t, load=load)
            return path.x, path.y, path.phi

        function = jax.jit(jax.vmap(places))
        taken = best(lambda function=function: function(v, omega)) / lanes  # type: ignore[misc]
        row(
            f"vmap of {lanes}, {name}, {load}",
            f"{taken * 1e6:.1f} us a path",
            taken / script,
        )
    taken = _by_diffrax(v, omega, t) / lanes
    row(
        f"diffrax, vmap of {lanes}, front-back",
        f"{taken * 1e6:.1f} us a path",
        taken / script,
    )


def devices() -> None:
    """One path of 201 times under vmap of more and more, on the processor
    and on a GPU."""
    import jax

    from curlfit import LAWS, InitialState, Stone, simulate

    t = np.linspace(0, 20, 201)
    random = np.random.default_rng(0)
    law = LAWS["front-back"]()

    def places(v: Any, omega: Any) -> Any:
        path = simulate(law, Stone(R=0.054), InitialState(v=v, omega=omega), t)
        return path.x, path.y, path.phi

    function = jax.jit(jax.vmap(places))
    for lanes in (256, 4096, 65536):
        v = random.uniform(2.05, 2.2, lanes)
        omega = random.uniform(0.5, 3, lanes)
        first = 0.0
        for device in dict.fromkeys((jax.devices("cpu")[0], jax.devices()[0])):
            with jax.default_device(device):
                taken = best(lambda v=v, omega=omega: function(v, omega)) / lanes  # type: ignore[misc]
            first = first or taken
            row(
                f"{lanes}, {device.device_kind}",
                f"{taken * 1e6:.3g} us a path",
                taken / first,
            )


def _by_diffrax(v: Any, omega: Any, t: Any) -> float:
    """s for the same paths by diffrax, whose steps adapt to errors of 1e-8."""
    import diffrax
    import jax
    import jax.numpy as jnp

    from curlfit import LAWS, Stone
    from curlfit.dynamics.contact import accelerations

    law = LAWS["front-back"]()
    stone = Stone(R=0.054)

    def rates(_: Any, state: Any, __: Any) -> Any:
        v, heading, phi, omega = state[2:]
        a = accelerations(law, stone, "uniform", v, omega, phi)
        east = v * jnp.sin(heading)
        north = v * jnp.cos(heading)
        return jnp.stack([east, north, a.eta, a.xi / v, omega, a.angular])

    def path(v: Any, omega: Any) -> Any:
        begin = jnp.array([0.0, 0.0, v, 0.0, 0.0, omega])
        return diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Tsit5(),
            0.0,
            float(t[-1]),
            0.1,
            begin,
            saveat=diffrax.SaveAt(ts=t),
            stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8),
        ).ys

    function = jax.jit(jax.vmap(path))
    return best(lambda: function(v, omega))


def batch() -> None:
    """Fits of throws of 201 rows, start free, against the scipy script's fit."""
    import peer_scipy

    from curlfit import Stone
    from curlfit.inference.fit.fit import fit_throws
    from curlfit.throws.synthetic import law_with, synthetic_throw, write_table

    random = np.random.default_rng(0)
    law = law_with("front-back", {"mu1_xi": 6e-4, "mu2_xi": 0.055, "mu1_eta": 0.0087})
    throws = [
        synthetic_throw(
            law,
            Stone(R=0.054),
            v0=random.uniform(1.9, 2.3),
            omega0=random.uniform(0.6, 3),
            noise_xy=0.005,
            noise_phi=0.01,
            seed=seed,
        )
        for seed in range(512)
    ]
    begin = time.perf_counter()
    peer_scipy.main(DATA)
    script = 1 / (time.perf_counter() - begin)
    row("scipy script's fit", f"{script:.2f} fits/s", 1.0)
    ours = len(throws) / best(lambda: fit_throws(throws), 5.0)
    row("fit_throws, one process", f"{ours:.0f} fits/s", ours / script)
    with tempfile.TemporaryDirectory() as folder:
        texts = list(map(write_table, throws))
        for number in range(_SEASON):
            (Path(folder) / f"{number:04}.csv").write_text(texts[number % len(texts)])
        files = sorted(Path(folder).glob("*.csv"))[: _SEASON // 4]
        options = ["--again", "--out", f"{folder}.out"]
        few = [*CURLFIT, "batch", *map(str, files), *options]
        processes(few, times=1)
        quarter_time, season_time = processes(
            few, [*CURLFIT, "batch", folder, *options], times=3
        )
        for output in (f"{folder}.out", f"{folder}.settings.json"):
            Path(output).unlink()
    ours = (_SEASON - len(files)) / (season_time - quarter_time)
    row("curlfit batch, files to table, all cores", f"{ours:.0f} fits/s", ours / script)


def together() -> None:
    """Joint fits of tracks of 201 rows from two sheets, against single fits of the
    same throws."""
    import resource

    from curlfit import Stone, fit_together
    from curlfit.inference.fit.fit import fit_throws
    from curlfit.throws.synthetic import law_with, synthetic_throw

    random = np.random.default_rng(0)
    throws = []
    for number in (10, 30, 100, 300, 1000):
        while len(throws) < number:
            sheet = len(throws) % 2 + 1
            half = 0.009 * (1 + 0.05 * (sheet - 1.5) + 0.012 * random.standard_normal())
            split = {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": half, "mu2_eta": half}
            throw = synthetic_throw(
                law_with("front-back", split),
                Stone(),
                v0=random.uniform(2.1, 2.3),
                omega0=random.uniform(1, 2),
                noise_xy=0.005,
                noise_phi=0.01,
                seed=len(throws),
            )
            throws.append(replace(throw, labels={"sheet": str(sheet)}))
        alone = best(lambda: fit_throws(throws, curves=True, systematics={}), 1.0)
        jointly = best(lambda: fit_together(throws, by="sheet"), 1.0)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row(
            f"{number} tracks",
            f"{jointly:.2f} s, at most {memory:.0f} MB",
            jointly / alone,
        )


def posterior() -> None:
    """Least effective samples a second over the parameters: peers on the
    same likelihood."""
    from curlfit import Stone, load_throw
    from curlfit.throws.synthetic import law_with, synthetic_throw

    law = law_with("front-back", {"mu1_xi": 6e-4, "mu2_xi": 0.055, "mu1_eta": 0.0087})
    short = synthetic_throw(
        law, Stone(R=0.054), until=2.5, noise_xy=0.02, noise_phi=0.05, seed=1
    )
    _posterior("eq. 12", load_throw(DATA), nuts=True)
    _posterior("2.5 s with 2 cm of noise", short, nuts=False)


def _posterior(name: str, throw: Any, *, nuts: bool) -> None:
    import emcee
    from emcee.autocorr import integrated_time

    from curlfit import fit, sample
    from curlfit.inference.model.likelihood import log_posterior
    from curlfit.inference.model.model import Model
    from curlfit.inference.model.priors import Penalty
    from curlfit.inference.model.problem import build_problem
    from curlfit.inference.model.request import Request
    from curlfit.settings.choices import Modelling

    result = fit(throw)
    sample(result, effective=500)
    begin = time.perf_counter()
    sampled, chain = sample(result, effective=4000)
    taken = time.perf_counter() - begin
    assert sampled.posterior is not None
    effective = min(sampled.posterior.ess.values())
    ours = effective / taken

    law = result.law_class
    ready = Request.of(throw, Modelling.of(throw.settings, law=law))
    parameters = ready.parameters
    problem = build_problem(ready.throw, ready.stone, result.sigma)
    walkers = 64
    steps = 8000
    random = np.random.default_rng(0)
    # It begins among our draws, so that no time is lost on finding them.
    first = random.permutation(chain.flat)[:walkers]
    nothing = Penalty.none(len(parameters))

    def log_prob(values: Any) -> Any:
        model = Model(law, "uniform")
        return np.asarray(
            log_posterior(
                model, values, parameters.lower, parameters.upper, problem, nothing
            )
        )

    stock = emcee.EnsembleSampler(walkers, len(parameters), log_prob, vectorize=True)
    begin = time.perf_counter()
    stock.run_mcmc(first, steps)
    taken = time.perf_counter() - begin
    draws = stock.get_chain()
    theirs = walkers * steps / float(np.max(integrated_time(draws, quiet=True)))
    peer = theirs / taken
    row(f"{name}: emcee, stretch move", f"{peer:.0f} effective samples/s", 1.0)
    row(f"{name}: curlfit sample", f"{ours:.0f} effective samples/s", ours / peer)

    levels = np.array([0.025, 0.16, 0.5, 0.84, 0.975])
    quantiles = np.quantile(draws.reshape(-1, len(parameters)), levels, axis=0)
    shares = (chain.flat[:, None] < quantiles).mean(0)
    error = np.sqrt(levels * (1 - levels) * (1 / effective + 1 / theirs))
    off = float(np.abs((shares - levels[:, None]) / error[:, None]).max())
    row(f"{name}: quantiles differ by at most", f"{off:.1f} Monte Carlo errors", "")
    if nuts:
        speed = _nuts(law, problem, parameters, result.values)
        row(f"{name}: numpyro, NUTS", f"{speed:.2f} effective samples/s", speed / peer)
        row(f"{name}: curlfit over NUTS", "", ours / speed)


def _nuts(law: Any, problem: Any, parameters: Any, centre: Any) -> float:
    """Least effective samples a second of NUTS on the same likelihood and priors."""
    import jax
    import numpyro
    import numpyro.distributions as dist
    from numpyro.diagnostics import effective_sample_size
    from numpyro.infer import MCMC, NUTS, init_to_value

    from curlfit.inference.model.likelihood import log_likelihood
    from curlfit.inference.model.model import Model

    scale = parameters.typical * 1e-3
    low = (parameters.lower - centre) / scale
    high = (parameters.upper - centre) / scale
    bounded = np.isfinite(low) & np.isfinite(high)

    def model() -> None:
        parts = []
        for index, inside in enumerate(bounded):
            real_line = dist.constraints.real
            prior = (
                dist.Uniform(low[index], high[index])
                if inside
                else dist.ImproperUniform(real_line, (), ())
            )
            parts.append(numpyro.sample(f"z{index}", prior))
        values = centre + scale * jax.numpy.stack(parts)
        numpyro.factor("path", log_likelihood(Model(law, "uniform"), values, problem))

    near = np.where(bounded, np.clip(0.0, low + 1e-3, high - 1e-3), 0.0)
    kernel = NUTS(
        model,
        dense_mass=True,
        max_tree_depth=8,
        init_strategy=init_to_value(
            values={f"z{k}": value for k, value in enumerate(near)}
        ),
    )
    run = MCMC(kernel, num_warmup=150, num_samples=150, progress_bar=False)
    run.warmup(jax.random.PRNGKey(0))
    begin = time.perf_counter()
    run.run(jax.random.PRNGKey(1))
    jax.block_until_ready(run.get_samples())
    taken = time.perf_counter() - begin
    samples = run.get_samples(group_by_chain=True).values()
    return (
        min(float(effective_sample_size(np.asarray(series))) for series in samples)
        / taken
    )


def roof() -> None:
    """Forward model under vmap against what the device can do:
    arithmetic and memory."""
    import jax
    import jax.numpy as jnp

    from curlfit import LAWS, InitialState, Stone, simulate
    from curlfit.dynamics import integrator
    from curlfit.dynamics.contact import accelerations
    from curlfit.numerics.ring_nodes import node_clustering

    t = np.linspace(0, 20, 201)
    lanes = 1024 if jax.default_backend() == "cpu" else 65536
    random = np.random.default_rng(0)
    v = random.uniform(2.05, 2.2, lanes)
    omega = random.uniform(0.5, 3, lanes)
    law = LAWS["front-back"]()
    stone = Stone(R=0.054)

    calls: list[int] = []
    rates = integrator.rates

    def counted(*given: Any) -> Any:
        jax.debug.callback(lambda: calls.append(1))
        return rates(*given)

    jax.clear_caches()
    integrator.rates = counted
    # within a program of its own, as one that calls back cannot be stored
    path = jax.jit(lambda v: simulate(law, stone, InitialState(v=v, omega=1.0), t).x)
    path(2.1).block_until_ready()
    jax.effects_barrier()
    integrator.rates = rates
    jax.clear_caches()

    def ring(v: Any, omega: Any) -> Any:
        return accelerations(
            law, stone, "uniform", v, omega, 0.0, 0.0, node_clustering(v, 0.054 * omega)
        )

    cost: Any = jax.jit(ring).lower(v, omega).compile().cost_analysis()
    cost = cost[0] if isinstance(cost, list) else cost
    flops = len(calls) * cost["flops"] / lanes
    least = 8.0 * (10 + 3 * len(t))  # parameters in, x y phi out
    row("evaluations of the ring a path", len(calls), "")
    row("flops of them a path", f"{flops:.3g}", "")
    row("bytes a path, at least", f"{least:.3g}", "")

    def places(v: Any, omega: Any) -> Any:
        path = simulate(law, stone, InitialState(v=v, omega=omega), t)
        return path.x, path.y, path.phi

    function = jax.jit(jax.vmap(places))
    taken = best(lambda: function(v, omega)) / lanes
    n = 2048
    square = jnp.ones((n, n))
    product = jax.jit(lambda a: a @ a)
    arithmetic = 2 * n**3 / best(lambda: product(square))
    long = jnp.ones(1 << 25)
    twice = jax.jit(lambda a: a + 1.0)
    memory = 2 * long.nbytes / best(lambda: twice(long))
    row("paths a second", f"{1 / taken:.3g}", "")
    done = flops / taken
    moved = least / taken
    row("arithmetic, over a matrix product's", f"{done:.3g} flop/s", done / arithmetic)
    row("memory, over a copy's", f"{moved:.3g} B/s", moved / memory)


ALL = {
    f.__name__: f
    for f in (
        answering,
        verbs,
        stopwatch,
        forward,
        devices,
        roof,
        batch,
        together,
        posterior,
    )
}


def about(name: str) -> str:
    """What a benchmark is, in one line."""
    return " ".join((ALL[name].__doc__ or "").partition("\n\n")[0].split())


def main() -> None:
    """Run the benchmarks asked for, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    descriptions = "; ".join(f"{name}: {about(name)}" for name in ALL)
    parser.add_argument(
        "benchmark", nargs="*", help=f"{descriptions} All, if none is named."
    )
    asked = parser.parse_args().benchmark
    unknown = set(asked) - set(ALL)
    if unknown:
        parser.error(
            f"unknown benchmark {', '.join(sorted(unknown))}; expected {', '.join(ALL)}"
        )
    import jax

    sys.path.insert(0, str(HERE))
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("jax", "scipy", "emcee")
    )
    device = jax.devices()[0]
    print(
        f"{date.today()}, {platform.processor() or platform.machine()}, "
        f"{os.cpu_count()} cores, "
    )
    print(
        f"{device.platform} {device.device_kind}, "
        f"Python {platform.python_version()}, {packages}"
    )
    for name in asked or ALL:
        print(f"\n{about(name)}\n")
        row(name, "measured", "ratio")
        row("---", "---", "---")
        ALL[name]()


if __name__ == "__main__":
    main()
