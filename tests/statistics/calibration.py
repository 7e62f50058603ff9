"""Calibration: do error bars have their nominal coverage?

    python tests/statistics/calibration.py [ranks|noise|small|all] [--throws N]
        [--workers N]

ranks: posterior and standard errors under every law; noise: noise models, right and
wrong laws; small: few rows. Each table is written into README.md beside this file as it
is done; after all ranks come their summary and the figure ranks.png.

A throw is 15 s at 10 Hz with noise of 5 mm on x and y and 10 mrad on phi; its
coefficients and its start are drawn evenly from a box, its sense of spin by a coin.
Each throw has random numbers of its own, so that answers do not depend on how many
processes shared the work.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
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
    "x0": (-0.05, 0.05),
    "y0": (-0.05, 0.05),
    "heading": (-0.02, 0.02),
    "v0": (1.9, 2.3),
    "phi0": (-0.1, 0.1),
    "omega0": (0.8, 1.6),
}
BOXES: dict[str, dict[str, tuple[float, float]]] = {
    "front-back": {
        "mu1_xi": (0.0, 0.02),
        "mu2_xi": (0.02, 0.1),
        "mu1_eta": (0.0, 0.015),
        "mu2_eta": (0.004, 0.015),
    },
    "coulomb": {"mu": (0.006, 0.011)},
    "power": {"c": (0.007, 0.01), "k": (-0.6, 0.2)},
    "pressure": {"mu0": (0.006, 0.011), "k": (0.0, 3.0)},
    "stribeck": {"mu0": (0.004, 0.008), "mu1": (0.001, 0.003)},
    "angular": {"mu0": (0.006, 0.011), "f0": (-0.5, 0.8)},
    "debris": {"mu_clean": (0.01, 0.016), "mu_dirty": (0.005, 0.01)},
    "radial": {
        "mu1": (0.0, 0.012),
        "mu2": (0.0, 0.016),
        "mu3": (0.004, 0.012),
        "mu4": (0.012, 0.024),
    },
    "tensor": {"b11": (0.01, 0.03), "b22": (0.006, 0.011), "b12": (-0.002, 0.002)},
    "semi-empirical": {
        "a": (0.0, 0.01),
        "c": (0.07, 0.1),
        "p": (-0.2, 0.3),
        "q": (0.01, 0.04),
        "r": (-0.5, 0.0),
    },
}


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
    """whether the sigmas and the box of the parameters are given to the fit,
    as its prior"""

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
        Trial(
            "noise white",
            "front-back",
            "front-back",
            "Right law, white noise",
            **_MODELS,
        ),
        Trial(
            "noise 0.3 s",
            "front-back",
            "front-back",
            "Right law, noise with a correlation "
            "time of 0.3 s (correlated by 0.72 from row to row)",
            correlation=math.exp(-0.1 / 0.3),
            **_MODELS,
        ),
        Trial(
            "noise 0.95 s",
            "front-back",
            "front-back",
            "Right law, noise with a correlation "
            "time of 0.95 s (correlated by 0.9 from row to row)",
            correlation=0.9,
            **_MODELS,
        ),
        Trial(
            "noise stribeck",
            "stribeck",
            "coulomb",
            "`stribeck` fitted by `coulomb`, white noise",
            **_MODELS,
        ),
        Trial(
            "noise power",
            "power",
            "coulomb",
            "`power` fitted by `coulomb`, white noise",
            **_MODELS,
        ),
        *(
            Trial(f"small {law} {rows}", law, law, f"`{law}`, {rows} rows", rows=rows)
            for law in ("front-back", "coulomb")
            for rows in (12, 24)
        ),
    )
}
_TRUTHS = {  # away from what `coulomb` can imitate
    "noise stribeck": {"mu0": (0.005, 0.007), "mu1": (0.0015, 0.0025)},
    "noise power": {"c": (0.007, 0.01), "k": (-0.6, -0.3)},
}


class Quantity(NamedTuple):
    """What one fit says of one parameter or combination, against the truth."""

    pull: float | None
    """standard errors off; None where there is no standard error"""
    held: tuple[bool, ...]
    """by level, whether `interval` holds the truth; empty where there is no
    standard error"""
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
    """whether the correlation time of the noise was said to be too long to be
    estimated well"""
    outliers: int = 0


class Answer(NamedTuple):
    """Of one throw."""

    sense: int
    """of the spin: 1 counter-clockwise, -1 clockwise"""
    outcomes: dict[str, Outcome]
    """by noise model fitted"""


# One throw


def answer(trial: Trial, number: int) -> Answer:
    """Draw, throw and fit once."""
    random = np.random.default_rng([0, list(TRIALS).index(trial.name), number])
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
        x=true["x0"],
        y=true["y0"],
        heading=true["heading"],
        v=true["v0"],
        phi=true["phi0"],
        omega=true["omega0"],
    )
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
    trial: Trial,
    throw: curlfit.Throw,
    true: Mapping[str, float],
    box: Mapping[str, tuple[float, float]],
    kind: str,
    random: np.random.Generator,
) -> Outcome:
    """What a fit says of a throw, and its posterior where the prior is known."""
    fit = curlfit.fit(
        throw,
        trial.fitted,
        load=trial.load,
        noise=kind,
        bounds=box if trial.known else None,
    )
    if not fit.converged:
        return Outcome({}, left="not converged")
    asked: dict[str, tuple[Any, dict[str, float], str]] = {
        name: (estimate, {name: 1.0}, estimate.verdict)
        for name, estimate in fit.parameters.items()
    }
    for combination in fit.combinations:
        if len(combination.weights) > 1:
            asked[combination.expression] = (
                combination,
                combination.weights,
                "no standard error",
            )
    # What the fitted law has and the true one has not has no true value.
    asked = {
        name: question
        for name, question in asked.items()
        if set(question[1]) <= set(true)
    }
    quantities = {
        name: _against(
            estimate, sum(weight * true[n] for n, weight in weights.items()), why
        )
        for name, (estimate, weights, why) in asked.items()
    }
    sampler = ""
    if trial.known:
        try:
            sampled, chain = curlfit.sample(
                fit, seed=int(random.integers(2**32)), effective=1000
            )
        except curlfit.CurlfitError as error:
            sampler = f"raised {type(error).__name__}"
        else:
            sampler = "" if sampled.posterior.converged else "not converged"
            for name, (_, weights, _) in asked.items():
                value = sum(weight * true[n] for n, weight in weights.items())
                quantities[name] = quantities[name]._replace(
                    **_among(chain.of(weights), value, random)
                )
    codes = {warning.code for warning in fit.warnings}
    return Outcome(
        quantities,
        sampler=sampler,
        correlated=bool(codes & {"correlated", "noise-not-described"}),
        lasting="long-memory" in codes,
        outliers=len(fit.outliers),
    )


def _against(item: Any, true: float, why: str) -> Quantity:
    """An estimate or a combination against its true value."""
    if item.stderr is None or not math.isfinite(item.stderr):
        return Quantity(None, (), why if item.stderr is None else "not finite")
    ends = [item.interval(nominal) for nominal, _ in LEVELS.values()]
    pull = float(f"{(item.value - true) / item.stderr:.4g}")
    return Quantity(pull, tuple(bool(low <= true <= high) for low, high in ends))


def _among(
    draws: np.ndarray, true: float, random: np.random.Generator
) -> dict[str, Any]:
    """The true value among draws of the posterior."""
    tails = [50 * (1 - nominal) for nominal, _ in LEVELS.values()]
    ends = [np.percentile(draws, (tail, 100 - tail)) for tail in tails]
    return {
        "rank": int((random.choice(draws, DRAWS) < true).sum()),
        "posterior": tuple(bool(low <= true <= high) for low, high in ends),
    }


# Tables

Answers = list[Answer]


def table(trial: Trial, answers: Answers) -> str:
    """The table of a trial."""
    tabulate = {"ranks": ranks_table, "noise": noise_table, "small": small_table}[
        trial.section
    ]
    return tabulate(trial, answers)


def counted(answers: Answers, kind: str = "white", sense: int = 0) -> list[Outcome]:
    """Outcomes that are not left out, of one sense if it is not 0."""
    outcomes = [a.outcomes[kind] for a in answers if sense in (0, a.sense)]
    return [outcome for outcome in outcomes if not outcome.left]


def sentence_of_drawn(answers: Answers) -> str:
    """How many throws were drawn."""
    senses = Counter(of_throw.sense for of_throw in answers)
    drawn = ", ".join(f"{senses[sense]} {name}" for sense, name in SENSES.items())
    return f"{len(answers)} throws drawn ({drawn})."


def sentence_of_counted(answers: Answers, kind: str = "white") -> str:
    """How many throws are counted, and why the others are not."""
    left = reasons(of_throw.outcomes[kind].left for of_throw in answers)
    return f"{len(counted(answers, kind))} counted" + (
        f"; left out: {left}." if left else "."
    )


def names_of(outcomes: list[Outcome]) -> list[str]:
    """Quantities that at least half of the outcomes speak of, parameters first."""
    often = Counter(name for outcome in outcomes for name in outcome.quantities)
    return [name for name in often if 2 * often[name] >= len(outcomes)]


def items_of(outcomes: list[Outcome], name: str) -> list[Quantity]:
    """What outcomes say of a quantity."""
    return [
        outcome.quantities[name] for outcome in outcomes if name in outcome.quantities
    ]


def coverage(items: Sequence[Quantity], what: str = "held") -> list[str]:
    """Cells that say how often intervals hold the truth, by level."""
    return [
        share(
            sum(getattr(quantity, what)[level] for quantity in items),
            len(items),
            nominal,
        )
        for level, (nominal, _) in enumerate(LEVELS.values())
    ]


def not_given(outcomes: list[Outcome], names: Sequence[str]) -> list[str]:
    """What has no standard error and why, and whether other combinations
    were formed."""
    lines = []
    for name in names:
        why = [
            o.quantities[name].why if name in o.quantities else "not formed"
            for o in outcomes
        ]
        none = sum(map(bool, why))
        if none:
            lines.append(
                f"No standard error of {name} in {none} of {len(why)}: {reasons(why)}."
            )
    some = sum(bool(set(outcome.quantities) - set(names)) for outcome in outcomes)
    if some:
        lines.append(
            f"Other combinations, formed in {some} of {len(outcomes)}, are not counted."
        )
    return lines


def evenness(outcomes: list[Outcome], name: str) -> str:
    """A cell that says how probable ranks as uneven as these are, by chi squared."""
    ranks = [
        quantity.rank
        for quantity in items_of(outcomes, name)
        if quantity.rank is not None
    ]
    if not ranks:
        return ""
    bins = np.bincount([rank * BINS // (DRAWS + 1) for rank in ranks], minlength=BINS)
    p = float(chisquare(bins).pvalue)
    return marked(f"{p:.2g}", p)


def pooled(answers: Answers, sense: int) -> str:
    """Coverage of all parameters' intervals in the throws of one sense.

    Parameters of a throw are correlated, so that a throw counts once in what
    chance explains.
    """
    held = [
        np.mean(
            [
                q.held
                for name, q in o.quantities.items()
                if name.isidentifier() and q.held
            ],
            0,
        )
        for o in counted(answers, sense=sense)
        if any(q.held and name.isidentifier() for name, q in o.quantities.items())
    ]
    if len(held) < 2:
        return f"{SENSES[sense]} too few throws"
    cells = []
    for shares, (nominal, _) in zip(np.array(held).T, LEVELS.values(), strict=True):
        p = float(ttest_1samp(shares, nominal).pvalue) if np.ptp(shares) > 0 else 1.0
        cells.append(marked(f"{100 * np.mean(shares):.1f} %", p))
    return f"{SENSES[sense]} {' and '.join(cells)} ({len(held)} throws)"


def with_ranks(answers: Answers, sense: int = 0) -> list[Outcome]:
    """Outcomes whose posterior counts."""
    return [outcome for outcome in counted(answers, sense=sense) if not outcome.sampler]


def ranks_table(trial: Trial, answers: Answers) -> str:
    """Ranks and coverage under a law."""
    outcomes = counted(answers)
    names = names_of(outcomes)
    lines = head(
        "",
        "n of ranks",
        "ranks even: p",
        "counter-clockwise",
        "clockwise",
        "posterior 68 %",
        "95 %",
        "n of standard errors",
        "68 %",
        "95 %",
    )
    for name in names:
        ranked = items_of(with_ranks(answers), name)
        with_error = [
            quantity for quantity in items_of(outcomes, name) if quantity.held
        ]
        evens = [evenness(with_ranks(answers, sense), name) for sense in (0, *SENSES)]
        errors = [cell or "none given" for cell in coverage(with_error)]
        lines.append(
            row(
                [
                    name,
                    len(ranked),
                    *evens,
                    *coverage(ranked, "posterior"),
                    len(with_error),
                    *errors,
                ]
            )
        )
    sides = "; ".join(pooled(answers, sense) for sense in SENSES)
    remarks = [f"Standard errors of all parameters, 68 % and 95 %: {sides}."]
    astray = reasons(outcome.sampler for outcome in outcomes)
    if astray:
        remarks.append(f"Not in n of ranks, of {len(outcomes)}: sampler {astray}.")
    load = f" {trial.load.capitalize()} load." if trial.load != "uniform" else ""
    remarks += not_given(outcomes, names)
    return _page([f"{_drawn_and_counted(answers)}{load}"], lines, remarks)


def noise_table(trial: Trial, answers: Answers) -> str:
    """Coverage, pulls and warnings by noise model."""
    outcomes = {kind: counted(answers, kind) for kind in trial.noises}
    names = names_of(outcomes["white"])
    lines = head(
        "", *(c for kind in trial.noises for c in (f"{kind} 68 %", "95 %", "pull"))
    )
    for name in names:
        cells = []
        for of_kind in outcomes.values():
            quantities = [
                quantity for quantity in items_of(of_kind, name) if quantity.held
            ]
            pulls = [quantity.pull for quantity in quantities]
            pull = (
                f"{np.mean(pulls):.2f} ± {np.std(pulls, ddof=1):.2f}"
                if len(pulls) > 1
                else ""
            )
            cells += [*coverage(quantities), pull]
        if any(cells):  # else no fit gives a standard error, as is said below
            lines.append(row([name, *cells]))
    lines += ["", *head("warnings", *trial.noises)]
    titles = {
        "residuals correlated": "correlated",
        "correlation time too long": "lasting",
    }
    for title, what in titles.items():
        counts = (
            f"{sum(getattr(o, what) for o in f)} of {len(f)}" for f in outcomes.values()
        )
        lines.append(row([title, *counts]))
    remarks = []
    for kind, of_kind in outcomes.items():
        sentences = [sentence_of_counted(answers, kind), *not_given(of_kind, names)]
        remarks.append(f"{kind}: {' '.join(sentences)}")
    return _page([f"### {trial.title}", "", sentence_of_drawn(answers)], lines, remarks)


def small_table(trial: Trial, answers: Answers) -> str:
    """Coverage by the Gaussian's and by Student's interval."""
    outcomes = counted(answers)
    names = names_of(outcomes)
    nominal, reach = LEVELS["95 %"]
    lines = head("", "n", "1.96 standard errors", "`interval(0.95)`")
    for name in names:
        quantities = [
            quantity for quantity in items_of(outcomes, name) if quantity.held
        ]
        gauss = sum(abs(quantity.pull or 0.0) <= reach for quantity in quantities)
        cells = [share(gauss, len(quantities), nominal), coverage(quantities)[1]]
        lines.append(
            row([name, len(quantities), *(cell or "none given" for cell in cells)])
        )
    named = sum(outcome.outliers > 0 for outcome in outcomes)
    remarks = [f"An outlier was named by chance in {named} of {len(outcomes)}."]
    remarks += not_given(outcomes, names)
    return _page(
        [f"### {trial.title}", "", _drawn_and_counted(answers)], lines, remarks
    )


def _drawn_and_counted(answers: Answers) -> str:
    return f"{sentence_of_drawn(answers)} {sentence_of_counted(answers)}"


def _page(first: list[str], lines: list[str], said: list[str]) -> str:
    return "\n".join([*first, "", *lines, "", *(f"- {remark}" for remark in said), ""])


def summary(parts: Mapping[str, Answers]) -> str:
    """All laws at a glance, by their names."""
    lines = head(
        "law", "load", "throws drawn", "counted", "without a posterior", "cells marked"
    )
    total = np.zeros(2, int)
    for law, answers in parts.items():
        trial = TRIALS[f"ranks {law}"]
        outcomes = counted(answers)
        rows = [
            line.split("|")
            for line in table(trial, answers).splitlines()
            if "|" in line
        ][2:]
        cells = [cell.strip() for cells in rows for cell in (*cells[3:8], *cells[9:11])]
        tested = [cell for cell in cells if cell not in ("", "none given")]
        marks = np.array([sum("(!)" in cell for cell in tested), len(tested)])
        total += marks
        unsampled = sum(bool(outcome.sampler) for outcome in outcomes)
        lines.append(
            row(
                [
                    law,
                    trial.load,
                    len(answers),
                    len(outcomes),
                    unsampled,
                    f"{marks[0]} of {marks[1]}",
                ]
            )
        )
    lines += [
        "",
        f"{total[0]} of {total[1]} cells are marked; chance marks about "
        f"{total[1] / 100:.0f}.",
    ]
    return "\n".join(lines) + "\n"


def ranks_figure(laws: Mapping[str, Answers], file: Path) -> None:
    """Share of ranks below each rank, less that of even ranks, for every law
    and quantity."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        -(-len(laws) // 5),
        5,
        figsize=(11, 5.2),
        layout="constrained",
        sharex=True,
        sharey=True,
    )
    possible_ranks = np.arange(DRAWS + 1)
    even = (possible_ranks + 1) / (DRAWS + 1)
    for axis in axes.flat[len(laws) :]:
        axis.set_axis_off()
    for axis, (law, answers) in zip(axes.flat, laws.items(), strict=False):
        mine = {sense: with_ranks(answers, sense) for sense in SENSES}
        for sense, colour in zip(SENSES, ("C0", "C1"), strict=True):
            for name in names_of(mine[sense]):
                ranks = np.sort(
                    [quantity.rank for quantity in items_of(mine[sense], name)]
                )
                below = np.searchsorted(ranks, possible_ranks, side="right") / max(
                    len(ranks), 1
                )
                axis.plot(even, below - even, color=colour, linewidth=0.8, alpha=0.8)
        low, high = _band(min(map(len, mine.values())))
        axis.fill_between(even, low, high, color="0.88", zorder=0)
        axis.set_title(f"{law}, {sum(map(len, mine.values()))} throws", fontsize=9)
    handles = [plt.Line2D([], [], color=colour) for colour in ("C0", "C1")]
    figure.legend(
        handles, SENSES.values(), loc="outside upper right", ncols=2, frameon=False
    )
    figure.supxlabel(
        "rank of the true value among draws of the posterior, over their number"
    )
    figure.supylabel("share of throws below, less that of even ranks")
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _band(throws: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of what holds 99 % of the curves of even ranks all along: binomial at
    each rank, at a level found by simulation (Sailynoja, Buerkner and Vehtari
    2022, sect. 3)."""
    random = np.random.default_rng(0)
    even = np.arange(1, DRAWS + 2) / (DRAWS + 1)
    ranks = random.integers(DRAWS + 1, size=(4000, throws))
    below = np.array(
        [np.bincount(sample, minlength=DRAWS + 1).cumsum() for sample in ranks]
    )
    tails = np.minimum(
        binom.cdf(below, throws, even), binom.sf(below - 1, throws, even)
    )
    level = 1 - 2 * np.quantile(tails[:, :-1].min(1), 0.01)
    low, high = binom.interval(level, throws, even)
    return low / throws - even, high / throws - even


# Runs


def main() -> None:
    """Run the trials, and write tables and figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("all", *THROWS), default="all")
    parser.add_argument("--throws", type=int, help="of each table")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    answers_by_trial: dict[str, Answers] = {}
    os.environ.update(_SETTINGS)  # of the processes, which load JAX
    with ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool:
        for name, trial in TRIALS.items():
            if asked.what in ("all", trial.section):
                numbers = range(asked.throws or THROWS[trial.section])
                answers = pool.map(partial(answer, trial), numbers, chunksize=BLOCK)
                answers_by_trial[name] = list(answers)
                put(name, table(trial, answers_by_trial[name]))
                print(name, file=sys.stderr)
    ranks = {
        TRIALS[name].truth: a
        for name, a in answers_by_trial.items()
        if name.startswith("ranks")
    }
    if ranks:
        put("ranks", summary(ranks))
        ranks_figure(ranks, HERE / "ranks.png")


_SETTINGS = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}


if __name__ == "__main__":
    main()
