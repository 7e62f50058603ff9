"""Whether the truth is inside what curlfit says where the path tells only a curve.

    python tests/statistics/ridge.py [--throws N] [--laws A,B] [--sets A,B]
        [--seed N] [--workers N] [--print]

Throws by a simulator that shares no code with curlfit (`simulator.py`) are fitted with
the law that they obey, from data that leave some of its coefficients open:

- no-angle: t, x, y, with bounds that a curler would find wide;
- no-angle-wide: the same with the bounds that the program has by itself;
- no-spin: t, x, y, phi of a throw that all but does not spin;
- times: two times of a stopwatch;
- season: throws of one evening without the angle, fitted one by one by
  `curlfit batch`, and the fit of their table; half as many as there are throws;
- joint: tracks without the angle in a joint fit; half as many, too;
- sampler: one throw without the angle of each law, the posterior beside importance
  sampling at held spins (`held_spin.py`).

In the first four sets, coefficients, speed and spin are drawn evenly from ranges that
are also the bounds of the fit, and so from its prior: of all such throws, posterior
intervals contain the truth exactly as often as they should, whatever the path leaves
open. Which throws are kept is decided by what was measured, which changes nothing in
that. Counted is also how often bands of another throw, whose speed and spin are given,
contain where it comes to rest.

The rows of the laws and sets that were run take their places in the tables "ridge",
"ridge-together" and "ridge-sampler" of README.md beside this file. With `--print`
nothing is written. Each throw has random numbers of its own, so that the answers do not
depend on how many processes share the work.
"""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from held_spin import DRAWS, posterior_sample, problem_of_track, weighted_quantiles
from simulator import crossing, distance, moved
from tables import Table, put_merged, reasons, share
from verdicts import (
    CHANNELS,
    FAR_HOG_LINE,
    NOISE,
    SIGMA_TIME,
    TIMES,
    Answer,
    Statement,
    Truth,
    chosen_names,
    counts_of,
    drawn,
    drawn_coefficients,
    filmed,
    largest_pull,
    most_common,
    of_group,
    parser_of,
    statements_of,
    timed,
)

import curlfit
from curlfit.batch.columns import names_of_columns
from curlfit.batch.fit_many import fit_files
from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import GrowingTable
from curlfit.numerics.processes import worker_processes

Box = Mapping[str, tuple[float, float]]

ONE_THREAD = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
"""Of each worker process."""

FRICTION = {"c": (0.004, 0.014), "k": (-0.7, 0.3)}
PLAUSIBLE: dict[str, Box] = {
    "front-back": {
        "mu1_xi": (0.0, 0.05),
        "mu2_xi": (0.0, 0.1),
        "mu1_eta": (0.003, 0.015),
        "mu2_eta": (0.003, 0.015),
    },
    "power-angular": {**FRICTION, "f0": (-1.0, 1.0)},
    "power+transverse": {**FRICTION, "b": (0.0, 0.3)},
    "power+pivot": {**FRICTION, "q": (0.0, 0.0005)},
}
"""From a fraction of the defaults to twice them or more."""
WIDE_FRICTION = {"c": (0.002, 0.03), "k": (-0.7, 1.0)}
WIDE: dict[str, Box] = {
    "front-back": {
        "mu1_xi": (0.0, 1.0),
        "mu2_xi": (0.0, 1.0),
        "mu1_eta": (0.0, 0.04),
        "mu2_eta": (0.0, 0.04),
    },
    "power-angular": {**WIDE_FRICTION, "f0": (-1.0, 1.0)},
    "power+transverse": {**WIDE_FRICTION, "b": (0.0, 1.0)},
}
"""What the path leaves open has the bounds of its law, and what brakes the stone all
values with which it comes so far. Not of power+pivot: with most q from 0 to 1 the spin
ends at once."""
SPINLESS: dict[str, Box] = {
    "semi-empirical": {
        "a": (0.0, 0.02),
        "c": (0.05, 0.13),
        "p": (-0.5, 0.5),
        "q": (0.005, 0.06),
        "r": (-0.9, 0.5),
    },
    "fcv1": {
        "f": (0.003, 0.009),
        "d": (0.0, 0.006),
        "c": (0.01, 0.2),
        "w": (0.0, 0.02),
        "n": (-1.5, 0.0),
        "q": (0.005, 0.06),
    },
}
BOXES = {
    "no-angle": PLAUSIBLE,
    "no-angle-wide": WIDE,
    "no-spin": SPINLESS,
    "times": {"power": {"c": (0.001, 0.03), "k": (-0.7, 1.0)}},
}
"""From which the coefficients of a set are drawn, and the bounds of its fits."""
SPINS = {"no-angle": 4.0, "no-angle-wide": 4 * np.pi, "no-spin": 0.005, "times": 0.0}
"""Largest spin of either sense, rad/s. A fast stone makes ten turns in 18 s; one that
all but does not spin turns by 5 degrees; the program's own bound is two turns a
second."""
SPEEDS = {
    "no-angle": (1.9, 2.4),
    "no-angle-wide": (1.9, 2.4),
    "no-spin": (1.9, 2.4),
    "times": (1.5, 3.5),
}
"""m/s; from two times the speed is not determined, so that these are its bounds."""
MEASURED = {**CHANNELS, "no-angle-wide": CHANNELS["no-angle"]}
SEEN_ACROSS = 2.4
"""m from the centre line, on the sheet."""
SEEN_ALONG = (15.0, 45.0)
"""m from the start to the last row."""
SEEN_TIMES = {"hog_to_hog": (8.0, 18.0), "hog_to_rest": (4.0, 25.0)}
"""s"""

OF_ONE_THROW = tuple(BOXES)
OF_MANY = ("season", "joint")
SAMPLED = {
    "power-angular": ("no-angle-wide", 0),
    "power+transverse": ("no-angle-wide", 0),
    "power+pivot": ("no-angle", 2),
}
"""The set from which the throw of a law is, whose posterior is compared, and its
number, such that its spin is open."""
LAWS_BY_SET: dict[str, tuple[str, ...]] = {
    **{kind: tuple(boxes) for kind, boxes in BOXES.items()},
    **dict.fromkeys(OF_MANY, ("front-back", "power+transverse")),
    "sampler": tuple(SAMPLED),
}
SETS = tuple(LAWS_BY_SET)
LAWS = (*PLAUSIBLE, *SPINLESS, "power")
ORDER = [(law, kind) for kind in SETS for law in LAWS]
"""Of the rows of all tables."""

PLANNED_SPEEDS = (1.9, 2.4)
PLANNED_SPINS = (0.5, 2.0)
"""Of either sense, rad/s, of the throw that is predicted."""
TO_TEE = FAR_HOG_LINE + 6.401
"""m, from the near hog line to the far tee (World Curling, rule R1)."""
PRODUCT = "b*omega0"
"""What a path under power+transverse determines without the angle."""
EFFECTIVE = 1000
CURLED = 0.3
"""m, of these throws: a straight path has another posterior, which
goes through a spin of zero."""
THROWS_OF_SEASON = 24
TRACKS_OF_JOINT = 10
QUANTILES = ("2.5", "16", "50", "84", "97.5")
ROUNDS = 12
"""Until a draw ends at the tee: speed and spin are nearly right after two."""


class Planned(NamedTuple):
    """The initial speed and spin of a throw that is predicted."""

    v0: float
    omega0: float


class Case(NamedTuple):
    """A law, and what is measured of its throws."""

    law: str
    kind: str

    @property
    def box(self) -> Box:
        """From which coefficients are drawn."""
        return BOXES[self.kind][self.law]

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """The bounds of the fit: what the truth is drawn from."""
        if self.kind == "times":
            return {**self.box, "v0": SPEEDS[self.kind]}
        fastest = SPINS[self.kind]
        return {**self.box, "omega0": (-fastest, fastest)}


class Quantity(NamedTuple):
    """What has intervals, and what these are from."""

    name: str
    source: str


class Held(NamedTuple):
    """Whether the intervals of 68 and 95 % contain the true value."""

    narrow: bool
    wide: bool


Outcome = Held | str
"""Or why there are no intervals."""
Outcomes = dict[Quantity, Outcome]

POSTERIOR = "posterior"
FIT = "fit"
BANDS = "prediction"
BANDS_OF_SAMPLES = "prediction, samples"
REST = {"rest_x": "rest across", "rest_y": "rest along", "time": "time to rest"}


# Throws


def within_limits(
    values: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    margin: float = 0.0,
) -> bool:
    """Whether values are within their limits, or so much beyond them."""
    return all(
        low - margin < values[name] < high + margin
        for name, (low, high) in limits.items()
    )


def looks_like_a_throw(kind: str, throw: curlfit.Throw) -> bool:
    """Whether what was measured is that of a stone on a sheet."""
    if kind == "times":
        times = {event.name: event.value for event in throw.events}
        return within_limits(times, SEEN_TIMES)
    low, high = SEEN_ALONG
    return bool((np.abs(throw.x) < SEEN_ACROSS).all() and low < throw.y[-1] < high)


def measured(
    case: Case, truth: Truth, random: np.random.Generator
) -> curlfit.Throw | None:
    """What is measured of a throw; None of one whose times are far from those that a
    throw may have, which cannot be read."""
    if case.kind != "times":
        return filmed(case.law, truth, MEASURED[case.kind], random)
    motion = moved(case.law, *truth)
    if distance(motion) < FAR_HOG_LINE:
        return None
    hog_to_hog = crossing(motion, FAR_HOG_LINE)
    times = {"hog_to_hog": hog_to_hog, "hog_to_rest": motion.end - hog_to_hog}
    if not within_limits(times, SEEN_TIMES, margin=10 * SIGMA_TIME):
        return None
    return timed(case.law, truth, random)


def drawn_from_prior(
    case: Case, random: np.random.Generator
) -> tuple[Truth, curlfit.Throw]:
    """A throw from the prior of its fit, among those that look like one."""
    fastest = SPINS[case.kind]
    while True:
        truth = Truth(
            {name: random.uniform(*limits) for name, limits in case.box.items()},
            random.uniform(*SPEEDS[case.kind]),
            random.uniform(-fastest, fastest),
        )
        throw = measured(case, truth, random)
        if throw is not None and looks_like_a_throw(case.kind, throw):
            # Whether the friction is usual is no matter here.
            return truth, replace(throw, defaults={"as_given": True})


def planned(kind: str, random: np.random.Generator) -> Planned:
    """Another throw; without spin in the set "times", as the law does not curl."""
    v0 = random.uniform(*PLANNED_SPEEDS)
    if kind == "times":
        return Planned(v0, 0.0)
    return Planned(v0, random.choice([-1, 1]) * random.uniform(*PLANNED_SPINS))


def true_rest(law: str, truth: Truth, other: Planned) -> dict[str, float]:
    """Where and when another throw from the near hog line comes to rest on the ice of
    a throw, in the names of a prediction."""
    motion = moved(law, truth.coefficients, *other)
    x, y, _ = motion.at(np.array([motion.end]))[:, 0]
    return {"rest_x": float(x), "rest_y": float(y) - TO_TEE, "time": motion.end}


# What is said of one throw


def quantities_of(case: Case) -> list[Quantity]:
    """Everything that is counted, in the order of the rows."""
    product = [PRODUCT] if case.law == "power+transverse" else []
    # power does not curl
    rest = [name for name in REST if case.kind != "times" or name != "rest_x"]
    return [
        *(Quantity(name, POSTERIOR) for name in (*case.bounds, *product)),
        *(Quantity(name, FIT) for name in product),
        *(Quantity(name, BANDS_OF_SAMPLES) for name in rest),
        *(Quantity(name, BANDS) for name in rest),
    ]


def true_values(case: Case, truth: Truth, other: Planned) -> dict[str, float]:
    """True values of everything that is counted."""
    values = truth.parameters | true_rest(case.law, truth, other)
    if case.law == "power+transverse":
        values[PRODUCT] = values["b"] * values["omega0"]
    return values


def within(quantiles: Mapping[str, float], value: float) -> Held:
    """Whether a value is between quantiles."""
    return Held(
        quantiles["16"] <= value <= quantiles["84"],
        quantiles["2.5"] <= value <= quantiles["97.5"],
    )


def of_estimate(estimate: Any, value: float) -> Outcome:
    """Whether the intervals of an estimate contain a value, or its verdict where it is
    not determined."""
    if estimate.verdict != "determined":
        return str(estimate.verdict)
    narrow, wide = (estimate.interval(level) for level in (0.68, 0.95))
    return Held(narrow[0] <= value <= narrow[1], wide[0] <= value <= wide[1])


def fault_of(error: Exception) -> str:
    """The kind of an error, which is shown as a whole: none is expected."""
    print("".join(traceback.format_exception(error)[-4:]), file=sys.stderr)
    return type(error).__name__


def every(quantities: Iterable[Quantity], reason: str, *sources: str) -> Outcomes:
    """The same reason for all quantities from some sources."""
    return {quantity: reason for quantity in quantities if quantity.source in sources}


def bands_of(
    case: Case,
    source: str,
    values: Mapping[str, float],
    predicted: Callable[[], curlfit.Prediction],
) -> Outcomes:
    """Whether the bands of a prediction contain the true values."""
    quantities = [
        quantity for quantity in quantities_of(case) if quantity.source == source
    ]
    try:
        prediction = predicted()
    except Exception as error:
        return every(quantities, fault_of(error), source)
    if any(warning.code == "few-draws" for warning in prediction.warnings):
        return every(quantities, "few draws", source)
    return {
        quantity: within(
            prediction.quantities[quantity.name].quantiles, values[quantity.name]
        )
        for quantity in quantities
    }


def outcomes_of_sample(
    case: Case,
    fit: curlfit.FitResult,
    values: Mapping[str, float],
    other: Planned,
    seed: int,
) -> Outcomes:
    """Whether the posterior, and the bands from its draws, contain the true values."""
    quantities = quantities_of(case)
    sources = (POSTERIOR, BANDS_OF_SAMPLES)
    try:
        sampled, chain = curlfit.sample(fit, seed=seed, effective=EFFECTIVE)
        derived = {
            quantity.name: sampled.derive(quantity.name, chain).quantiles
            for quantity in quantities
            if quantity.name == PRODUCT and quantity.source == POSTERIOR
        }
    except Exception as error:
        return every(quantities, fault_of(error), *sources)
    posterior = sampled.posterior
    assert posterior is not None
    if not posterior.converged:
        return every(quantities, "not converged", *sources)
    quantiles = posterior.quantiles | derived
    outcomes: Outcomes = {
        quantity: within(quantiles[quantity.name], values[quantity.name])
        for quantity in quantities
        if quantity.source == POSTERIOR
    }
    return outcomes | bands_of(
        case,
        BANDS_OF_SAMPLES,
        values,
        lambda: curlfit.predict(sampled, chain, start=other._asdict(), seed=seed),
    )


def outcomes_of_throw(
    case: Case, throw: curlfit.Throw, truth: Truth, other: Planned, seed: int
) -> Outcomes:
    """Whether all intervals of a throw contain the true values."""
    quantities = quantities_of(case)
    sources = (POSTERIOR, FIT, BANDS, BANDS_OF_SAMPLES)
    values = true_values(case, truth, other)
    try:
        fit = curlfit.fit(
            throw,
            case.law,
            bounds=case.bounds,
            systematics={"all": 0.0},
            details=False,
        )
        outcomes: Outcomes = {
            quantity: of_estimate(fit.derive(quantity.name), values[quantity.name])
            for quantity in quantities
            if quantity.source == FIT
        }
    except Exception as error:
        return every(quantities, fault_of(error), *sources)
    if not fit.converged:
        return every(quantities, "fit not converged", *sources)
    outcomes |= bands_of(
        case,
        BANDS,
        values,
        lambda: curlfit.predict(fit, start=other._asdict(), seed=seed),
    )
    return outcomes | outcomes_of_sample(case, fit, values, other, seed)


def random_of(case: Case, seed: int, place: int) -> np.random.Generator:
    """Random numbers of one throw, or season, of a law and a set."""
    numbers = [seed, LAWS.index(case.law), SETS.index(case.kind), place]
    return np.random.default_rng(numbers)


def answer_of_throw(case: Case, seed: int, place: int) -> Outcomes:
    """A throw, fitted, sampled and predicted from."""
    random = random_of(case, seed, place)
    truth, throw = drawn_from_prior(case, random)
    other = planned(case.kind, random)
    return outcomes_of_throw(case, throw, truth, other, seed + place)


# What is said of many throws together


def season_on_disk(
    law: str, throws: Sequence[curlfit.Throw], folder: Path
) -> curlfit.JointResult:
    """Files of tracks, their table by the functions of `curlfit batch`, and its fit."""
    names = []
    for number, throw in enumerate(throws):
        file = folder / f"throw{number:02}.csv"
        rows = np.column_stack([throw.t, throw.x, throw.y])
        np.savetxt(file, rows, delimiter=",", header="t,x,y", comments="")
        names.append(str(file))
    sigma = {name: NOISE[name] for name in CHANNELS["no-angle"]}
    settings = BatchSettings.of(law=law, sigma=sigma)
    season = folder / "season.csv"
    columns = names_of_columns(settings)
    with GrowingTable(season, columns, settings.recorded(), names) as table:
        table.add(fit_files(names, settings))
    return curlfit.fit_season(season)


def fitted_together(case: Case, throws: Sequence[curlfit.Throw]) -> curlfit.JointResult:
    """The fit of a season or of tracks."""
    if case.kind == "joint":
        return curlfit.fit_together(throws, case.law, systematics={"all": 0.0})
    with TemporaryDirectory() as folder:
        return season_on_disk(case.law, throws, Path(folder))


def end_of_draw(
    law: str,
    coefficients: dict[str, float],
    omega0: float,
    angle: float | None = None,
) -> tuple[float, float]:
    """x in m, and the angle in rad, at which a draw from the near hog line rests at the
    tee; with this spin, or if an angle is given with that which leads to it."""
    v0 = 2.2
    for _ in range(ROUNDS):
        motion = moved(law, coefficients, v0, omega0)
        x, y, phi = motion.at(np.array([motion.end]))[:, 0]
        v0 *= np.sqrt(TO_TEE / y)  # nearly in proportion to the square of the speed
        if angle is not None:
            omega0 *= angle / phi  # nearly in proportion to the spin
    return float(x), float(phi)


def true_curl(law: str, coefficients: dict[str, float], angle: float) -> float:
    """Curl of a draw to the tee that turns by an angle, to the side to which its front
    turns, m."""
    x, _ = end_of_draw(law, coefficients, angle / 25, angle)
    return -float(np.sign(angle)) * x


def curls_of(
    law: str, joint: curlfit.JointResult, truths: Sequence[Truth]
) -> list[Statement]:
    """The curl of a draw that turns as these throws would, where the fit gives one,
    beside its true value."""
    curls = [effect for effect in joint.groups if effect.parameter == "curl"]
    if not curls:
        return []
    coefficients = truths[0].coefficients
    ends = [end_of_draw(law, coefficients, truth.omega0) for truth in truths]
    angle = float(np.median([abs(turned) for _, turned in ends]))
    value = true_curl(law, coefficients, angle)
    statements = []
    for effect in curls:
        pull = (effect.value - value) / effect.stderr
        low, high = effect.interval(0.95)
        inside = low <= value <= high
        statements.append(Statement("curl of a draw", "curl", pull, inside))
    return statements


def answer_together(case: Case, seed: int, place: int) -> Answer:
    """What is said of throws on the same ice."""
    random = random_of(case, seed, place)
    number = TRACKS_OF_JOINT if case.kind == "joint" else THROWS_OF_SEASON
    coefficients = drawn_coefficients(case.law, random)
    truths = []
    throws = []
    for _ in range(number):
        truth = drawn(case.law, "no-angle", random)._replace(coefficients=coefficients)
        truths.append(truth)
        throws.append(filmed(case.law, truth, CHANNELS["no-angle"], random))
    try:
        joint = fitted_together(case, throws)
    except Exception as error:
        return Answer((), fault_of(error))
    if not joint.converged:
        return Answer((), "not converged")
    truth = Truth(coefficients, v0=0.0, omega0=0.0)
    statements = statements_of(joint.coefficients, joint.combinations, truth, {})
    return Answer((*statements, *curls_of(case.law, joint, truths)))


# Tables


def rows_of_throws(case: Case, answers: Sequence[Outcomes]) -> Iterator[list[object]]:
    """A row for each quantity."""
    for quantity in quantities_of(case):
        outcomes = [answer[quantity] for answer in answers]
        counted = [outcome for outcome in outcomes if isinstance(outcome, Held)]
        failures = reasons(outcome for outcome in outcomes if isinstance(outcome, str))
        number = len(counted)
        name = REST.get(quantity.name, f"`{quantity.name}`")
        yield [
            f"`{case.law}`",
            case.kind,
            name,
            quantity.source,
            number or "",
            share(sum(held.narrow for held in counted), number, 0.68),
            share(sum(held.wide for held in counted), number, 0.95),
            failures,
        ]


GROUPS = ("coefficients", "combinations", "curl")
CELLS = ("n", "within 95 %", "beyond 5 errors")


def row_of_many(case: Case, answers: Sequence[Answer]) -> list[object]:
    """The cells of a law and a set of seasons or joint fits."""
    counted = [answer for answer in answers if not answer.failure]
    statements = [statement for answer in counted for statement in answer.statements]
    by_group = {group: of_group(statements, group) for group in GROUPS}
    counts = [cell for group in by_group.values() for cell in counts_of(group)]
    return [
        f"`{case.law}`",
        case.kind,
        len(counted),
        reasons(answer.failure for answer in answers),
        *counts,
        largest_pull(statements),
        most_common([*by_group["coefficients"], *by_group["combinations"]]),
    ]


def rows_of_sampler(case: Case, seed: int) -> Iterator[list[object]]:
    """Quantiles by importance sampling, and how far those of the posterior are from
    them, in widths of the interval of 68 %."""
    kind, number = SAMPLED[case.law]
    like = Case(case.law, kind)
    random = random_of(case, seed, number)
    _, throw = drawn_from_prior(like, random)
    while abs(throw.x[-1] - throw.x[0]) < CURLED:
        _, throw = drawn_from_prior(like, random)
    track = np.stack([throw.x, throw.y])
    problem = problem_of_track(
        case.law, TIMES, track, NOISE["x"], like.box, SPINS[like.kind]
    )
    sample = posterior_sample(problem, DRAWS, seed)
    try:
        fit = curlfit.fit(throw, case.law, bounds=like.bounds, details=False)
        fit, _ = curlfit.sample(fit, seed=seed, effective=4 * EFFECTIVE)
    except Exception as error:
        yield [f"`{case.law}`", case.kind, fault_of(error), *("" for _ in QUANTILES)]
        return
    posterior = fit.posterior
    assert posterior is not None
    ending = "off, 68 % widths" if posterior.converged else "off, not converged"
    shares = [float(level) / 100 for level in QUANTILES]
    draws = dict(zip(like.box, sample.values.T, strict=False)) | {
        "omega0": sample.spins
    }
    for name, values in draws.items():
        expected = weighted_quantiles(values, sample.weights, shares)
        quantiles = np.array([posterior.quantiles[name][level] for level in QUANTILES])
        off = (quantiles - expected) / (expected[3] - expected[1])
        head = (f"`{case.law}`", case.kind)
        title = f"`{name}` by {sample.effective:.0f} effective draws"
        yield [*head, title, *(f"{value:.4g}" for value in expected)]
        yield [*head, ending, *(f"{value:+.2f}" for value in off)]


def tables() -> dict[str, Table]:
    """The tables without rows, by their marks in README.md."""
    cells = [f"{group}: {cell}" for group in GROUPS for cell in CELLS]
    coverage = ("n", "within 68 %", "within 95 %", "not counted")
    frequent = "most frequent statements: within 95 %"
    return {
        "ridge": Table("law", "columns", "quantity", "from", *coverage),
        "ridge-together": Table(
            "law", "set", "fits", "not counted", *cells, "largest pull", frequent
        ),
        "ridge-sampler": Table(
            "law", "set", "", *(f"{level} %" for level in QUANTILES)
        ),
    }


def table_of(kind: str) -> str:
    """The mark of the table in which a set is."""
    if kind == "sampler":
        return "ridge-sampler"
    return "ridge-together" if kind in OF_MANY else "ridge"


def rows_of(
    case: Case, options: argparse.Namespace, pool: ProcessPoolExecutor
) -> Iterable[list[object]]:
    """The rows of a law and a set."""
    if case.kind == "sampler":
        return rows_of_sampler(case, options.seed)
    if case.kind in OF_MANY:
        answer = partial(answer_together, case, options.seed)
        answers = list(pool.map(answer, range(max(options.throws // 2, 1))))
        return [row_of_many(case, answers)]
    answer = partial(answer_of_throw, case, options.seed)
    return rows_of_throws(case, list(pool.map(answer, range(options.throws))))


def asked() -> argparse.Namespace:
    """What the command line asks for."""
    parser = parser_of(__doc__)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    return parser.parse_args()


def main() -> None:
    """Run what is asked for, and write each law and set as it is done."""
    options = asked()
    laws = chosen_names(options.laws, LAWS)
    kinds = chosen_names(options.sets, SETS)
    by_mark = tables()
    os.environ.update(ONE_THREAD)  # of the processes, which load JAX
    with worker_processes(options.workers) as pool:
        for kind in kinds:
            mark = table_of(kind)
            for law in LAWS_BY_SET[kind]:
                if law in laws:
                    for row in rows_of(Case(law, kind), options, pool):
                        by_mark[mark].add(*row)
                    if not options.print:
                        put_merged(mark, by_mark[mark], ORDER)


if __name__ == "__main__":
    main()
