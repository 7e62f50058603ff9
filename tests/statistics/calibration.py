"""Calibration: do error bars have their nominal coverage?

    python tests/statistics/calibration.py [ranks|noise|small|all] [--throws N] [--laws A,B]
                                           [--workers N] [--seed N] [--out DIR]
    python tests/statistics/calibration.py --tables FILE.json [--out DIR]

ranks: posterior and standard errors under every law; noise: noise models, right and wrong laws;
small: few rows. A run keeps every answer in DIR/calibration.json and writes the tables into
DIR/README.md as each is done, and at last the figure DIR/ranks.png; DIR is the folder of this file
unless named, and what it holds of other tables stays. `--tables` makes tables and figure from kept
answers.

A throw is 15 s at 10 Hz with noise of 5 mm on x and y and 10 mrad on phi; its coefficients and its
start are drawn evenly from a box, its sense of spin by a coin. Each throw has random numbers of its
own, so that answers do not depend on how many processes shared the work.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binom, chisquare, ttest_1samp
from tables import HERE, LEVELS, correlated, head, marked, put, reasons, row, share

import curlfit

SIGMA = {"x": 0.005, "y": 0.005, "phi": 0.01}
DRAWS = 99
BINS = 10
BLOCK = 10  # throws a task
THROWS = {"ranks": 150, "noise": 300, "small": 400}
SENSES = {1: "counter-clockwise", -1: "clockwise"}
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
    "pressure": {"mu0": (0.006, 0.011), "k": (0.0, 3.0)},
    "stribeck": {"mu0": (0.004, 0.008), "mu1": (0.001, 0.003)},
    "angular": {"mu0": (0.006, 0.011), "f0": (-0.5, 0.8)},
    "debris": {"mu_clean": (0.01, 0.016), "mu_dirty": (0.005, 0.01)},
    "radial": {
        "mu1": (0.0, 0.012), "mu2": (0.0, 0.016), "mu3": (0.004, 0.012), "mu4": (0.012, 0.024),
    },
    "tensor": {"b11": (0.01, 0.03), "b22": (0.006, 0.011), "b12": (-0.002, 0.002)},
    "semi-empirical": {
        "a": (0.0, 0.01), "c": (0.07, 0.1), "p": (-0.2, 0.3), "q": (0.01, 0.04), "r": (-0.5, 0.0),
    },
}  # fmt: skip


class Trial(NamedTuple):
    """What is repeated: which law the throws obey, which is fitted, and how."""

    name: str
    """of its table"""
    truth: str
    fitted: str
    title: str = ""
    load: str = "uniform"
    correlation: float = 0.0
    """of the noise from row to row"""
    rows: int = 151
    noises: tuple[str, ...] = ("white",)
    """noise models that are fitted"""
    known: bool = False
    """whether the sigmas and the box of the parameters are given to the fit, as its prior"""

    @property
    def section(self) -> str:
        """The part of README.md that it belongs to."""
        return self.name.split()[0]


# Under uniform load the exponent of the pressure does not enter the motion.
_LOADS = {"pressure": "consistent"}
_MODELS = {"noises": ("white", "ar1", "discrepancy")}
TRIALS = {
    trial.name: trial
    for trial in (
        *(
            Trial(f"ranks {law}", law, law, load=_LOADS.get(law, "uniform"), known=True)
            for law in BOXES
        ),
        Trial("noise white", "front-back", "front-back", "Right law, white noise", **_MODELS),
        Trial("noise 0.3 s", "front-back", "front-back", "Right law, noise with a correlation "
              "time of 0.3 s (correlated by 0.72 from row to row)",
              correlation=math.exp(-0.1 / 0.3), **_MODELS),
        Trial("noise 0.95 s", "front-back", "front-back", "Right law, noise with a correlation "
              "time of 0.95 s (correlated by 0.9 from row to row)", correlation=0.9, **_MODELS),
        Trial("noise stribeck", "stribeck", "coulomb",
              "`stribeck` fitted by `coulomb`, white noise", **_MODELS),
        Trial("noise power", "power", "coulomb",
              "`power` fitted by `coulomb`, white noise", **_MODELS),
        *(
            Trial(f"small {law} {rows}", law, law, f"`{law}`, {rows} rows", rows=rows)
            for law in ("front-back", "coulomb") for rows in (12, 24)
        ),
    )
}  # fmt: skip
_TRUTHS = {  # away from what `coulomb` can imitate
    "noise stribeck": {"mu0": (0.005, 0.007), "mu1": (0.0015, 0.0025)},
    "noise power": {"c": (0.007, 0.01), "k": (-0.6, -0.3)},
}


class Quantity(NamedTuple):
    """What one fit says of one parameter or combination, against the truth."""

    pull: float | None
    """standard errors off; None where there is no standard error"""
    held: tuple[bool, ...]
    """by level, whether `interval` holds the truth; empty where there is no standard error"""
    why: str = ""
    """why there is no standard error"""
    rank: int | None = None
    """of the truth among `DRAWS` draws of the posterior, thinned to be independent"""
    posterior: tuple[bool, ...] = ()
    """by level, whether the interval of the posterior holds the truth"""


class Outcome(NamedTuple):
    """Of one fit of one throw."""

    quantities: dict[str, Quantity]
    left: str = ""
    """why it is not counted"""
    sampler: str = ""
    """why its posterior is not counted"""
    correlated: bool = False
    """whether the residuals were said to be correlated"""
    lasting: bool = False
    """whether the correlation time of the noise was said to be too long to be estimated well"""
    outliers: int = 0

    @classmethod
    def from_json(cls, found: Sequence[Any]) -> Outcome:
        """The record from JSON, which has lists for tuples."""
        quantities, *rest = found
        return cls({name: Quantity(*item) for name, item in quantities.items()}, *rest)


class Answer(NamedTuple):
    """Of one throw."""

    sense: int
    """of the spin: 1 counter-clockwise, -1 clockwise"""
    outcomes: dict[str, Outcome]
    """by noise model fitted"""

    @classmethod
    def from_json(cls, found: Sequence[Any]) -> Answer:
        """The record from JSON."""
        sense, outcomes = found
        return cls(sense, {kind: Outcome.from_json(item) for kind, item in outcomes.items()})


# One throw


def answer(trial: Trial, number: int, seed: int = 0) -> Answer:
    """Draw, throw and fit once."""
    random = np.random.default_rng([seed, list(TRIALS).index(trial.name), number])
    sense = int(random.choice([1, -1]))
    coefficients = _TRUTHS.get(trial.name, BOXES[trial.truth])
    low, high = (sense * end for end in START["omega0"])
    box = coefficients | START | {"omega0": (min(low, high), max(low, high))}
    true = {name: float(random.uniform(*ends)) for name, ends in box.items()}
    throw = thrown(trial, true, random)
    if throw is None:
        left = Outcome({}, left="the law admits no such motion")
        return Answer(sense, dict.fromkeys(trial.noises, left))
    outcomes = {}
    for kind in trial.noises:
        try:
            outcomes[kind] = fitted(trial, throw, true, box, kind, random)
        except Exception as error:
            outcomes[kind] = Outcome({}, left=f"the fit raised {type(error).__name__}")
            print(f"\n{trial.name}, throw {number}: {error}", file=sys.stderr)
    return Answer(sense, outcomes)


def thrown(
    trial: Trial, true: Mapping[str, float], random: np.random.Generator
) -> curlfit.Throw | None:
    """A measured throw; None where the stone cannot move so."""
    law = curlfit.law_with(
        trial.truth, {name: value for name, value in true.items() if name not in START}
    )
    start = curlfit.InitialState(
        x=true["x0"], y=true["y0"], heading=true["heading"], v=true["v0"], phi=true["phi0"],
        omega=true["omega0"],
    )  # fmt: skip
    t = np.linspace(0.0, 15.0, trial.rows)
    path = curlfit.simulate(law, curlfit.Stone(), start, t, load=trial.load).to_numpy()
    if not np.isfinite(path.x).all():
        return None
    series = {}
    for name, sigma in SIGMA.items():
        noise = correlated(random.standard_normal(len(t)), trial.correlation)
        series[name] = getattr(path, name) + sigma * noise
    throw = curlfit.Throw.from_arrays(t, **series)
    return throw.with_sigma(SIGMA) if trial.known else throw


def fitted(
    trial: Trial, throw: curlfit.Throw, true: Mapping[str, float],
    box: Mapping[str, tuple[float, float]], kind: str, random: np.random.Generator,
) -> Outcome:  # fmt: skip
    """What a fit says of a throw, and its posterior where the prior is known."""
    fit = curlfit.fit(
        throw, trial.fitted, load=trial.load, noise=kind, bounds=box if trial.known else None
    )
    if not fit.converged:
        return Outcome({}, left="not converged")
    asked: dict[str, tuple[Any, dict[str, float], str]] = {
        name: (item, {name: 1.0}, item.verdict) for name, item in fit.parameters.items()
    }
    for one in fit.combinations:
        if len(one.weights) > 1:
            asked[one.expression] = (one, one.weights, "no standard error")
    # What the fitted law has and the true one has not has no true value.
    asked = {name: item for name, item in asked.items() if set(item[1]) <= set(true)}
    found = {
        name: _against(item, sum(weight * true[n] for n, weight in weights.items()), why)
        for name, (item, weights, why) in asked.items()
    }
    sampler = ""
    if trial.known:
        try:
            sampled, chain = curlfit.sample(fit, seed=int(random.integers(2**32)), effective=1000)
        except curlfit.CurlfitError as error:
            sampler = f"raised {type(error).__name__}"
        else:
            sampler = "" if sampled.posterior.converged else "not converged"
            for name, (_, weights, _) in asked.items():
                value = sum(weight * true[n] for n, weight in weights.items())
                found[name] = found[name]._replace(**_among(chain.of(weights), value, random))
    return Outcome(
        found,
        sampler=sampler,
        correlated=any("lag-1 correlation" in text for text in fit.warnings),
        lasting=any("the noise has a correlation time" in text for text in fit.warnings),
        outliers=len(fit.outliers),
    )


def _against(item: Any, true: float, why: str) -> Quantity:
    """An estimate or a combination against its true value."""
    if item.stderr is None or not math.isfinite(item.stderr):
        return Quantity(None, (), why if item.stderr is None else "not finite")
    ends = [item.interval(nominal) for nominal, _ in LEVELS.values()]
    pull = float(f"{(item.value - true) / item.stderr:.4g}")
    return Quantity(pull, tuple(bool(low <= true <= high) for low, high in ends))


def _among(draws: np.ndarray, true: float, random: np.random.Generator) -> dict[str, Any]:
    """The true value among draws of the posterior."""
    tails = [50 * (1 - nominal) for nominal, _ in LEVELS.values()]
    ends = [np.percentile(draws, (tail, 100 - tail)) for tail in tails]
    return {
        "rank": int((random.choice(draws, DRAWS) < true).sum()),
        "posterior": tuple(bool(low <= true <= high) for low, high in ends),
    }


# Tables

Answers = list[Answer]


class Table(NamedTuple):
    """A table and how many of its cells are marked."""

    text: str
    cells: int = 0
    marks: int = 0


def table(trial: Trial, answers: Answers) -> Table:
    """The table of a trial."""
    return {"ranks": ranks_table, "noise": noise_table, "small": small_table}[trial.section](
        trial, answers
    )


def counted(answers: Answers, kind: str = "white") -> list[Outcome]:
    """Outcomes that are not left out."""
    return [a.outcomes[kind] for a in answers if not a.outcomes[kind].left]


def sentence_of_drawn(answers: Answers) -> str:
    """How many throws were drawn."""
    senses = Counter(item.sense for item in answers)
    drawn = ", ".join(f"{senses[sense]} {name}" for sense, name in SENSES.items())
    return f"{len(answers)} throws drawn ({drawn})."


def sentence_of_counted(answers: Answers, kind: str = "white") -> str:
    """How many throws are counted, and why the others are not."""
    left = reasons(item.outcomes[kind].left for item in answers)
    return f"{len(counted(answers, kind))} counted" + (f"; left out: {left}." if left else ".")


def names_of(outcomes: list[Outcome]) -> list[str]:
    """Quantities that at least half of the outcomes speak of, parameters first."""
    often = Counter(name for outcome in outcomes for name in outcome.quantities)
    return [name for name in often if 2 * often[name] >= len(outcomes)]


def without_errors(outcomes: list[Outcome], names: Iterable[str]) -> list[str]:
    """For each quantity that some give no standard error of, in how many of them and why."""
    lines = []
    for name in names:
        why = [o.quantities[name].why if name in o.quantities else "not formed" for o in outcomes]
        none = sum(map(bool, why))
        if none:
            lines.append(f"No standard error of {name} in {none} of {len(why)}: {reasons(why)}.")
    return lines


def other_combinations(outcomes: list[Outcome], names: Iterable[str]) -> list[str]:
    """A sentence on combinations that are too seldom formed to be counted one by one."""
    some = sum(bool(set(outcome.quantities) - set(names)) for outcome in outcomes)
    return [f"Other combinations, formed in {some} of {len(outcomes)}, are not counted."] * (
        some > 0
    )


def evenness(items: Sequence[Quantity]) -> str:
    """A cell that says how probable ranks as uneven as these are, by chi squared."""
    if not items:
        return ""
    places = [item.rank * BINS // (DRAWS + 1) for item in items if item.rank is not None]
    p = float(chisquare(np.bincount(places, minlength=BINS)).pvalue)
    return marked(f"{p:.2g}", p)


def pooled(answers: Answers, sense: int) -> str:
    """Coverage of all parameters' intervals in the throws of one sense.

    Parameters of a throw are correlated, so that a throw counts once in what chance explains.
    """
    cells, throws = [], 0
    for place, (nominal, _) in enumerate(LEVELS.values()):
        shares = []
        for outcome in counted([item for item in answers if item.sense == sense]):
            held = [item.held[place] for name, item in outcome.quantities.items()
                    if name.isidentifier() and item.held]  # fmt: skip
            if held:
                shares.append(np.mean(held))
        throws = len(shares)
        if throws < 2:
            return f"{SENSES[sense]} too few throws"
        p = float(ttest_1samp(shares, nominal).pvalue) if np.ptp(shares) > 0 else 1.0
        cells.append(marked(f"{100 * np.mean(shares):.1f} %", p))
    return f"{SENSES[sense]} {' and '.join(cells)} ({throws} throws)"


def ranks_table(trial: Trial, answers: Answers) -> Table:
    """Ranks and coverage under a law."""
    outcomes = counted(answers)
    names = names_of(outcomes)
    lines = head(
        "", "n of ranks", "ranks even: p", "counter-clockwise", "clockwise", "posterior 68 %",
        "95 %", "n of standard errors", "68 %", "95 %",
    )  # fmt: skip
    tested: list[str] = []
    for name in names:
        ranked = {
            sense: [
                item.quantities[name]
                for item in counted([one for one in answers if one.sense == sense])
                if name in item.quantities and not item.sampler
            ]
            for sense in SENSES
        }
        both = [item for items in ranked.values() for item in items]
        given = [o.quantities[name] for o in outcomes if name in o.quantities]
        given = [item for item in given if item.held]
        evens = [evenness(both), *(evenness(items) for items in ranked.values())]
        shares: dict[str, list[str]] = {"posterior": [], "held": []}
        for place, (nominal, _) in enumerate(LEVELS.values()):
            for what, items in (("posterior", both), ("held", given)):
                inside = sum(getattr(item, what)[place] for item in items)
                shares[what].append(share(inside, len(items), nominal))
        lines.append(
            row([name, len(both), *evens, *shares["posterior"], len(given),
                 *(cell or "none given" for cell in shares["held"])])
        )  # fmt: skip
        tested += [*evens, *shares["posterior"], *shares["held"]]
    sides = [pooled(answers, sense) for sense in SENSES]
    lines += ["", f"Standard errors of all parameters, 68 % and 95 %: {'; '.join(sides)}."]
    astray = reasons(outcome.sampler for outcome in outcomes)
    if astray:
        lines.append(f"Not in n of ranks, of {len(outcomes)}: sampler {astray}.")
    lines += without_errors(outcomes, names) + other_combinations(outcomes, names)
    load = f" {trial.load.capitalize()} load." if trial.load != "uniform" else ""
    text = "\n".join([f"{_drawn_and_counted(answers)}{load}", "", *_listed(lines)])
    cells = [cell for cell in tested if cell]
    return Table(text, len(cells), sum("(!)" in cell for cell in cells))


def noise_table(trial: Trial, answers: Answers) -> Table:
    """Coverage, pulls and warnings by noise model."""
    outcomes = {kind: counted(answers, kind) for kind in trial.noises}
    names = names_of(outcomes["white"])
    lines = head("", *(c for kind in trial.noises for c in (f"{kind} 68 %", "95 %", "pull")))
    for name in names:
        cells = []
        for found in outcomes.values():
            items = [o.quantities[name] for o in found if name in o.quantities]
            items = [item for item in items if item.held]
            for place, (nominal, _) in enumerate(LEVELS.values()):
                cells.append(share(sum(i.held[place] for i in items), len(items), nominal))
            pulls = [item.pull for item in items]
            cells.append(
                f"{np.mean(pulls):.2f} ± {np.std(pulls, ddof=1):.2f}" if len(pulls) > 1 else ""
            )
        if any(cells):  # else no fit gives a standard error, as is said below
            lines.append(row([name, *cells]))
    lines += ["", *head("warnings", *trial.noises)]
    titles = {"residuals correlated": "correlated", "correlation time too long": "lasting"}
    for title, what in titles.items():
        lines.append(
            row([title, *(f"{sum(getattr(o, what) for o in found)} of {len(found)}"
                          for found in outcomes.values())])
        )  # fmt: skip
    lines.append("")
    for kind, found in outcomes.items():
        sentences = [sentence_of_counted(answers, kind), *without_errors(found, names)]
        lines.append(f"- {kind}: {' '.join(sentences + other_combinations(found, names))}")
    text = [f"### {trial.title}", "", sentence_of_drawn(answers), "", *lines, ""]
    return Table("\n".join(text))


def small_table(trial: Trial, answers: Answers) -> Table:
    """Coverage by the Gaussian's and by Student's interval."""
    outcomes = counted(answers)
    names = names_of(outcomes)
    nominal, reach = LEVELS["95 %"]
    place = list(LEVELS).index("95 %")
    lines = head("", "n", "1.96 standard errors", "`interval(0.95)`")
    for name in names:
        items = [o.quantities[name] for o in outcomes if name in o.quantities]
        items = [item for item in items if item.held]
        gauss = sum(abs(item.pull or 0.0) <= reach for item in items)
        student = sum(item.held[place] for item in items)
        cells = [share(k, len(items), nominal) or "none given" for k in (gauss, student)]
        lines.append(row([name, len(items), *cells]))
    named = sum(outcome.outliers > 0 for outcome in outcomes)
    lines += ["", f"An outlier was named by chance in {named} of {len(outcomes)}."]
    lines += without_errors(outcomes, names) + other_combinations(outcomes, names)
    text = [f"### {trial.title}", "", _drawn_and_counted(answers), "", *_listed(lines)]
    return Table("\n".join(text))


def _drawn_and_counted(answers: Answers) -> str:
    return f"{sentence_of_drawn(answers)} {sentence_of_counted(answers)}"


def _listed(lines: list[str]) -> list[str]:
    """A table as it is, and the sentences after its first empty line as a list."""
    cut = lines.index("")
    return [*lines[: cut + 1], *(f"- {line}" for line in lines[cut + 1 :]), ""]


def summary(parts: Mapping[str, Answers]) -> str:
    """All laws at a glance."""
    lines = head("law", "load", "throws drawn", "counted", "without a posterior",
                 "cells marked")  # fmt: skip
    cells = marks = 0
    for name, answers in parts.items():
        trial = TRIALS[name]
        if trial.section != "ranks":
            continue
        found, outcomes = table(trial, answers), counted(answers)
        cells, marks = cells + found.cells, marks + found.marks
        lines.append(
            row([trial.truth, trial.load, len(answers), len(outcomes),
                 sum(bool(o.sampler) for o in outcomes), f"{found.marks} of {found.cells}"])
        )  # fmt: skip
    lines += ["", f"{marks} of {cells} cells are marked; chance marks about {cells / 100:.0f}."]
    return "\n".join(lines) + "\n"


def ranks_figure(parts: Mapping[str, Answers], file: Path) -> None:
    """Share of ranks below each rank, less that of even ranks, for every law and quantity."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    laws = {TRIALS[name].truth: a for name, a in parts.items() if TRIALS[name].section == "ranks"}
    if not laws:
        return
    figure, axes = plt.subplots(-(-len(laws) // 5), min(len(laws), 5), figsize=(11, 5.2),
                                layout="constrained", sharex=True, sharey=True,
                                squeeze=False)  # fmt: skip
    places = np.arange(DRAWS + 1)
    even = (places + 1) / (DRAWS + 1)
    for axis in axes.flat[len(laws) :]:
        axis.set_axis_off()
    for axis, (law, answers) in zip(axes.flat, laws.items(), strict=False):
        least, most = len(answers), 0
        for sense, colour in zip(SENSES, ("C0", "C1"), strict=True):
            mine = [o for o in counted([a for a in answers if a.sense == sense]) if not o.sampler]
            least, most = min(least, len(mine)), most + len(mine)
            for name in names_of(mine):
                ranks = [o.quantities[name].rank for o in mine if name in o.quantities]
                below = np.searchsorted(np.sort(ranks), places, side="right") / max(len(ranks), 1)
                axis.plot(even, below - even, color=colour, linewidth=0.8, alpha=0.8)
        if least:
            axis.fill_between(even, *_band(least), color="0.88", zorder=0)
        axis.set_title(f"{law}, {most} throws", fontsize=9)
        axis.tick_params(labelsize=8)
    handles = [
        plt.Line2D([], [], color=colour, label=name)
        for colour, name in zip(("C0", "C1"), SENSES.values(), strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, fontsize=9, frameon=False)
    figure.supxlabel("rank of the true value among draws of the posterior, over their number",
                     fontsize=10)  # fmt: skip
    figure.supylabel("share of throws below, less that of even ranks", fontsize=10)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _band(throws: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of what holds 99 % of the curves of even ranks all along: binomial at each rank, at a
    level found by simulation (Sailynoja, Buerkner and Vehtari 2022, sect. 3)."""
    random = np.random.default_rng(0)
    even = np.arange(1, DRAWS + 2) / (DRAWS + 1)
    ranks = random.integers(DRAWS + 1, size=(4000, throws))
    below = np.array([np.bincount(one, minlength=DRAWS + 1).cumsum() for one in ranks])
    tails = np.minimum(binom.cdf(below, throws, even), binom.sf(below - 1, throws, even))
    level = 1 - 2 * np.quantile(tails[:, :-1].min(1), 0.01)
    low, high = binom.interval(level, throws, even)
    return low / throws - even, high / throws - even


# Runs


class Record:
    """Answers so far, and the files made of them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "calibration.json"
        self.parts: dict[str, Answers] = {}
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "README.md").exists():
            shutil.copy(HERE / "README.md", folder)

    def load(self, file: Path) -> None:
        """Take the answers that are kept in a file."""
        kept = json.loads(file.read_text())["parts"]
        self.parts |= {
            name: [Answer.from_json(item) for item in kept[name]] for name in TRIALS if name in kept
        }

    def add(self, name: str, answers: Answers) -> None:
        """Keep the answers of a trial that is done, and write its table."""
        self.parts[name] = answers
        self.parts = {one: self.parts[one] for one in TRIALS if one in self.parts}
        text = json.dumps({"curlfit": curlfit.__version__, "parts": self.parts}, allow_nan=False)
        beside = self.file.with_suffix(".part")
        beside.write_text(text)
        beside.replace(self.file)
        self.write(name)

    def write(self, name: str) -> None:
        """Write the table of a trial."""
        put(name, table(TRIALS[name], self.parts[name]).text, self.folder)
        if TRIALS[name].section == "ranks":
            put("ranks", summary(self.parts), self.folder)


def run(wanted: Mapping[str, int], workers: int, seed: int = 0) -> Iterator[tuple[str, Answers]]:
    """Answers of each trial, as it is done, from a number of throws of each."""
    blocks = [
        (name, range(first, min(first + BLOCK, throws)))
        for name, throws in wanted.items()
        for first in range(0, throws, BLOCK)
    ]
    # The first block of each trial compiles its programs, for all; then trial by trial.
    blocks.sort(key=lambda block: block[1].start > 0)
    left = Counter(name for name, _ in blocks)
    found: dict[str, dict[int, Answers]] = {name: {} for name in wanted}
    began = time.time()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        tasks = {pool.submit(_block, name, list(block), seed): (name, block.start)
                 for name, block in blocks}  # fmt: skip
        for done, task in enumerate(as_completed(tasks), 1):
            name, first = tasks[task]
            found[name][first] = task.result()
            left[name] -= 1
            print(f"\r{done} of {len(tasks)} blocks, {time.time() - began:.0f} s",
                  end="", file=sys.stderr)  # fmt: skip
            if not left[name]:
                print(f": {name}", file=sys.stderr)
                parts = found.pop(name)
                yield name, [one for first in sorted(parts) for one in parts[first]]


def _block(name: str, numbers: Sequence[int], seed: int) -> Answers:
    return [answer(TRIALS[name], number, seed) for number in numbers]


_SETTINGS = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}


def main() -> None:
    """Run or read, and write tables and figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("all", *THROWS), default="all")
    parser.add_argument("--throws", type=int, help="of each table")
    parser.add_argument("--laws", help="that throws obey, separated by commas")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=HERE, metavar="DIR")
    parser.add_argument("--tables", type=Path, metavar="FILE.json")
    asked = parser.parse_args()
    laws = asked.laws.split(",") if asked.laws else list(BOXES)
    unknown = set(laws) - set(BOXES)
    if unknown:
        parser.error(f"unknown law {', '.join(sorted(unknown))}; expected {', '.join(BOXES)}")
    record = Record(asked.out)
    if asked.tables:
        record.load(asked.tables)
        for name in record.parts:
            record.write(name)
    else:
        if record.file.exists():
            record.load(record.file)
        wanted = {
            name: asked.throws or THROWS[trial.section]
            for name, trial in TRIALS.items()
            if asked.what in ("all", trial.section) and trial.truth in laws
        }
        # Processes that are spawned take these over before they load JAX.
        os.environ.update(_SETTINGS)
        with TemporaryDirectory() as folder:
            os.environ.setdefault("CURLFIT_CACHE", folder)
            for name, answers in run(wanted, asked.workers, asked.seed):
                record.add(name, answers)
    ranks_figure(record.parts, record.folder / "ranks.png")


if __name__ == "__main__":
    main()
