"""Calibration: are error bars as wide as repetition shows?

    python tests/statistics/calibration.py ranks [THROWS [LAW]]    posterior and errors, law by law
    python tests/statistics/calibration.py noise [THROWS]          noise models, right, wrong laws

write their tables and figures beside this file. A throw is 15 s at 10 Hz with noise of 5 mm on x
and y and 10 mrad on phi; its coefficients and its start are drawn evenly from a box, which is
also the prior of the fit, and the sigmas are known. So the rank of the true value among
independent draws of the posterior is even (Talts et al. 2018).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binom, chisquare
from tables import DOUBTFUL, HERE, LEVELS, put, share

import curlfit

SIGMA = {"x": 0.005, "y": 0.005, "phi": 0.01}
DRAWS = 99
BINS = 20
START = {
    "x0": (-0.05, 0.05), "y0": (-0.05, 0.05), "heading": (-0.02, 0.02), "v0": (1.9, 2.3),
    "phi0": (-0.1, 0.1), "omega0": (0.8, 1.6),
}  # fmt: skip
BOXES: dict[str, dict[str, tuple[float, float]]] = {
    "front-back": {
        "mu1_xi": (0.0, 0.02), "mu2_xi": (0.02, 0.1), "mu1_eta": (0.0, 0.015),
        "mu2_eta": (0.004, 0.015),
    },
    "coulomb": {"mu": (0.006, 0.011)},
    "power": {"c": (0.007, 0.01), "k": (-0.6, 0.2)},
    "semi-empirical": {
        "a": (0.0, 0.01), "c": (0.07, 0.1), "p": (-0.2, 0.3), "q": (0.01, 0.04), "r": (-0.5, 0.0),
    },
}  # fmt: skip


class Asked(NamedTuple):
    """Of one throw and one quantity."""

    rank: int
    """of the true value among `DRAWS` draws of the posterior, thinned to be independent"""
    posterior: dict[str, bool]
    """by level, whether the interval of the posterior holds it"""
    errors: dict[str, bool] | None
    """the same of the standard error; None where there is none"""


def drawn(box: Mapping[str, tuple[float, float]], random: np.random.Generator) -> dict[str, float]:
    """A place in a box."""
    return {name: random.uniform(*ends) for name, ends in box.items()}


def thrown(
    law: str, true: Mapping[str, float], random: np.random.Generator, correlation: float = 0.0
) -> curlfit.Throw:
    """A measured throw."""
    coefficients = {name: value for name, value in true.items() if name not in START}
    start = curlfit.Start(
        x=true["x0"], y=true["y0"], heading=true["heading"], v=true["v0"], phi=true["phi0"],
        omega=true["omega0"],
    )  # fmt: skip
    t = np.arange(0.0, 15.05, 0.1)
    path = curlfit.simulate(curlfit.law_with(law, coefficients), curlfit.Stone(), start, t)
    series = {}
    for name, sigma in SIGMA.items():
        noise = random.standard_normal(len(t))
        for k in range(1, len(t)):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
        series[name] = np.asarray(getattr(path, name)) + sigma * noise
    return curlfit.Throw.from_arrays(t, **series)


def asked(law: str, throws: int, seed: int = 0) -> Iterator[dict[str, Asked]]:
    """Ranks and coverage of each parameter, and of what is determined in place of some."""
    random = np.random.default_rng(seed)
    box = BOXES[law] | START
    for number in range(throws):
        true = drawn(box, random)
        throw = thrown(law, true, random).with_sigma(SIGMA)
        fit = curlfit.fit(throw, law, bounds=box)
        _, chain = curlfit.sample(fit, seed=number, effective=1000)
        found = {
            name: _asked(true[name], chain.of({name: 1.0}), item.value, item.stderr, random)
            for name, item in fit.parameters.items()
        }
        for one in fit.combinations:
            if len(one.weights) > 1 and fit.law == "front-back":
                value = sum(weight * true[name] for name, weight in one.weights.items())
                draws = chain.of(one.weights)
                found[one.expression] = _asked(value, draws, one.value, one.stderr, random)
        yield found


def _asked(
    true: float, draws: np.ndarray, value: float, stderr: float | None, random: np.random.Generator
) -> Asked:
    ends = {"68 %": (16, 84), "95 %": (2.5, 97.5)}
    return Asked(
        int((random.choice(draws, DRAWS) < true).sum()),
        {
            level: bool(np.percentile(draws, low) <= true <= np.percentile(draws, high))
            for level, (low, high) in ends.items()
        },
        None if stderr is None
        else {level: abs(value - true) <= z * stderr for level, (_, z) in LEVELS.items()},
    )  # fmt: skip


def ranks_table(found: list[dict[str, Asked]]) -> str:
    """Markdown of ranks and coverage of a law."""
    lines = [
        "| | ranks even: p | posterior 68 % | 95 % | standard error 68 % | 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for name in _common(found):
        items = [answer[name] for answer in found]
        p = float(chisquare(np.bincount(_bins(items), minlength=BINS)).pvalue)
        cells = [f"{p:.2g}{' (!)' if p < DOUBTFUL else ''}"]
        for level, (nominal, _) in LEVELS.items():
            cells.append(share(sum(i.posterior[level] for i in items), len(items), nominal))
        told = [item.errors for item in items if item.errors is not None]
        for level, (nominal, _) in LEVELS.items():
            cells.append(share(sum(e[level] for e in told), len(told), nominal) or "none given")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _common(found: list[dict[str, Asked]]) -> list[str]:
    return [name for name in found[0] if all(name in answer for answer in found)]


def _bins(items: list[Asked]) -> np.ndarray:
    return np.array([item.rank * BINS // (DRAWS + 1) for item in items])


def ranks_figure(law: str, found: list[dict[str, Asked]]) -> None:
    """Histograms of the ranks, with the band that holds 99 % of the bars if they are even."""
    names = _common(found)
    figure, axes = plt.subplots(2, -(-len(names) // 2), figsize=(11, 4.2), layout="constrained",
                                sharex=True, sharey=True, squeeze=False)  # fmt: skip
    low, high = binom.interval(0.99, len(found), 1 / BINS)
    for axis, name in zip(axes.flat, names, strict=False):
        axis.axhspan(low, high, color="0.88")
        axis.axhline(len(found) / BINS, color="0.6", linewidth=0.8)
        counts = np.bincount(_bins([answer[name] for answer in found]), minlength=BINS)
        axis.stairs(counts, np.linspace(0, 1, BINS + 1), color="C0", linewidth=1.4)
        axis.set_title(name, fontsize=10)
    for axis in axes.flat[len(names) :]:
        axis.set_axis_off()
    figure.supxlabel("rank of the true value among draws of the posterior", fontsize=10)
    figure.supylabel("throws", fontsize=10)
    figure.suptitle(f"{law} law, {len(found)} throws; grey: 99 % of the bars of even ranks",
                    fontsize=11)  # fmt: skip
    figure.savefig(HERE / f"ranks_{law}.png", dpi=110)
    plt.close(figure)


class Case(NamedTuple):
    """Which law the throws obey, which is fitted, and what the noise is like."""

    title: str
    truth: str
    fitted: str
    correlation: float = 0.0


CASES = (
    Case("right law, white noise", "front-back", "front-back"),
    Case("right law, noise correlated by 0.9 from row to row", "front-back", "front-back", 0.9),
    Case("`stribeck` fitted by `coulomb`, white noise", "stribeck", "coulomb"),
    Case("`power` fitted by `coulomb`, white noise", "power", "coulomb"),
)
_TRUTHS = {
    "stribeck": {"mu0": (0.005, 0.007), "mu1": (0.0015, 0.0025)},
    "power": {"c": (0.007, 0.01), "k": (-0.6, -0.3)},
}


def covered(case: Case, throws: int, seed: int = 0) -> Iterator[dict[str, dict[str, float]]]:
    """By noise model and parameter that both laws have, how many standard errors it is off."""
    random = np.random.default_rng(seed)
    box = BOXES.get(case.truth, _TRUTHS.get(case.truth, {})) | START
    for _ in range(throws):
        true = drawn(box, random)
        throw = thrown(case.truth, true, random, case.correlation)
        found: dict[str, dict[str, float]] = {}
        for kind in ("white", "ar1", "gp"):
            fit = curlfit.fit(throw, case.fitted, noise=kind)
            asked = {name: (item.value, item.stderr, {name: 1.0}) for name, item in
                     fit.parameters.items()}  # fmt: skip
            asked |= {one.expression: (one.value, one.stderr, one.weights)
                      for one in fit.combinations if case.truth == "front-back"}  # fmt: skip
            found[kind] = {
                name: (value - sum(w * true[n] for n, w in weights.items())) / stderr
                for name, (value, stderr, weights) in asked.items()
                if stderr is not None and set(weights) <= set(true)
            }
        yield found


def noise_table(case: Case, found: list[dict[str, dict[str, float]]]) -> str:
    """Markdown of the coverage of a case."""
    lines = [
        f"### {case.title[0].upper()}{case.title[1:]}", "", f"{len(found)} throws.", "",
        "| | white 68 % | 95 % | ar1 68 % | 95 % | gp 68 % | 95 % |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for name in found[0]["white"]:
        cells = []
        for kind in ("white", "ar1", "gp"):
            off = [abs(answer[kind][name]) for answer in found if name in answer[kind]]
            for nominal, z in LEVELS.values():
                cells.append(share(sum(value <= z for value in off), len(off), nominal))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(what: str, throws: int = 1000, only: str | None = None) -> None:
    """Run, and write tables and figures."""
    if what == "ranks":
        for law in BOXES if only is None else [only]:
            found = list(_counted(law, asked(law, throws), throws))
            put(f"ranks {law}", f"{len(found)} throws.\n\n{ranks_table(found)}")
            ranks_figure(law, found)
    else:
        for number, case in enumerate(CASES, 1):
            answers = list(_counted(case.title, covered(case, throws), throws))
            put(f"noise {number}", noise_table(case, answers))


def _counted(title: str, items: Iterator[Any], of: int) -> Iterator[Any]:
    began = time.time()
    for number, item in enumerate(items, 1):
        print(f"\r{title}: {number} of {of}", end="", file=sys.stderr)
        yield item
    print(f", {time.time() - began:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3, 4) or sys.argv[1] not in ("ranks", "noise"):
        sys.exit(__doc__)
    main(sys.argv[1], *map(int, sys.argv[2:3]), *sys.argv[3:])
