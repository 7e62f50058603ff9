"""Whether the true values are where a fit says that they are determined to be.

    python tests/statistics/verdicts.py [--throws N] [--laws A,B] [--sets A,B]
        [--seed N] [--print]

Throws of every law, by a simulator that shares no code with curlfit (`simulator.py`),
are fitted with the same law from the columns of a set:

- angle: t, x, y, phi;
- no-angle: t, x, y;
- times: the times from hog line to hog line and from there to rest, by a stopwatch,
  of a throw without spin, as the fit assumes where that was not measured;
- times-turning: the same of a throw with spin, which is among the systematic errors:
  they are added to the errors;
- no-spin: t, x, y, phi of a throw without spin;
- friction-table: friction against speed, not a throw;
- design: a planned throw made many times, and the errors that `curlfit.design` expects
  of it, with the angle and without.

Counted is how often the 95 % intervals of what is called determined contain the true
value. The rows of the laws and sets that were run take their places in the table
"verdicts" of README.md beside this file; "verdicts-design" is written if all laws of
that set were run. With `--print` nothing is written.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from simulator import braking, crossing, distance, moved, simulated
from tables import Table, put_merged, reasons, share

import curlfit
from curlfit.inference.fit.fit import fit_throws

LAWS = tuple(curlfit.LAWS)
LAWS_OF_TABLES = ("coulomb", "power", "stribeck", "sutor")
LAWS_OF_DESIGNS = (
    "front-back",
    "power+transverse",
    "power-angular",
    "power+pivot",
    "sutor",
)
CHANNELS = {
    "angle": ("x", "y", "phi"),
    "no-angle": ("x", "y"),
    "no-spin": ("x", "y", "phi"),
}
SETS = (
    "angle",
    "no-angle",
    "times",
    "no-spin",
    "friction-table",
    "design",
    "times-turning",
)

TIMES = np.linspace(0.0, 18.0, 181)
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
FAR_HOG_LINE = 21.945  # m from the near one
SIGMA_TIME = 0.05  # s, of a stopwatch
SIGMA_MU = 4e-4
PLANNED = {"v0": 2.15, "omega0": 1.2}
RATE = 10.0  # Hz, of TIMES

SYSTEMATICS = {"all": 0.0, "unknown_spin": 1.2}
"""Of times of a throw that turns: nothing else differs from what the fit assumes."""
NORMAL = 1.96  # standard errors of a 95 % interval
FAR = 5.0
"""Standard errors within which the truth should always be."""
COMMON = 4
"""How many combinations are named, the most frequent ones."""


class Truth(NamedTuple):
    """A throw from the origin along +y."""

    coefficients: dict[str, float]
    v0: float
    omega0: float

    @property
    def parameters(self) -> dict[str, float]:
        """True values of all parameters of a fit."""
        start = {"v0": self.v0, "omega0": self.omega0}
        start |= dict.fromkeys(("x0", "y0", "heading", "phi0"), 0.0)
        return self.coefficients | start


class Statement(NamedTuple):
    """A parameter or combination that a fit calls determined, beside its true value."""

    name: str
    group: str
    """coefficients, initial state or combinations"""
    pull: float
    """distance of the estimate from the truth in standard errors"""
    inside: bool
    """whether the 95 % interval contains the truth"""


class Answer(NamedTuple):
    """What the fit of a throw says, or why it says nothing."""

    statements: tuple[Statement, ...]
    failure: str = ""


GROUPS = ("coefficients", "initial state", "combinations")
CELLS = ("n", "within 95 %", "beyond 5 errors")
MARK = "verdicts"
ORDER = [(law, kind) for kind in SETS for law in LAWS]
"""Of the rows."""


# Throws


def drawn_coefficients(law: str, random: np.random.Generator) -> dict[str, float]:
    """Coefficients within 20 % of their defaults, exponents of 0 within 0.1; without
    optional ones."""
    values = {}
    for coefficient in curlfit.LAWS[law].coefficients():
        if coefficient.optional:
            continue
        if coefficient.default == 0:
            values[coefficient.name] = random.uniform(-0.1, 0.1)
        else:
            values[coefficient.name] = coefficient.default * random.uniform(0.8, 1.2)
    return values


def drawn(law: str, kind: str, random: np.random.Generator) -> Truth:
    """A throw of a law; without spin in the set "no-spin", and in the set "times", of
    which curlfit assumes it."""
    coefficients = drawn_coefficients(law, random)
    v0 = random.uniform(2.0, 2.3)
    sense = 0 if kind in ("no-spin", "times") else random.choice([-1, 1])
    return Truth(coefficients, v0, sense * random.uniform(0.7, 1.6))


def filmed(
    law: str, truth: Truth, channels: Sequence[str], random: np.random.Generator
) -> curlfit.Throw:
    """The path with noise, of which some columns are measured."""
    path = simulated(law, *truth, TIMES)
    noisy = {
        name: series + NOISE[name] * random.standard_normal(len(TIMES))
        for name, series in zip(NOISE, path, strict=True)
    }
    measured = {name: noisy[name] for name in channels}
    sigma = {name: NOISE[name] for name in channels}
    return curlfit.Throw.from_arrays(TIMES, **measured, sigma=sigma)


def drawn_past_the_hog_line(law: str, kind: str, random: np.random.Generator) -> Truth:
    """A throw from the near hog line that comes to rest a metre or more past the far
    one."""
    while True:
        truth = drawn(law, kind, random)
        if distance(moved(law, *truth)) > FAR_HOG_LINE + 1:
            return truth


def timed(law: str, truth: Truth, random: np.random.Generator) -> curlfit.Throw:
    """What a stopwatch measures, read from a text file."""
    motion = moved(law, *truth)
    hog_to_hog = crossing(motion, FAR_HOG_LINE)
    hog_to_rest = motion.end - hog_to_hog
    error = SIGMA_TIME * random.standard_normal(2)
    lines = (
        f"hog_to_hog = {hog_to_hog + error[0]:.4f}",
        f"hog_to_rest = {hog_to_rest + error[1]:.4f}",
        f"sigma_time = {SIGMA_TIME}",
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "throw.txt"
        file.write_text("\n".join(lines) + "\n")
        return curlfit.load_throw(file)


def friction_table(
    law: str, coefficients: Mapping[str, float], random: np.random.Generator
) -> curlfit.FrictionTable:
    """Measured friction at 8 to 13 speeds, without spin."""
    rows = int(random.integers(8, 14))
    speeds = np.linspace(0.2, 2.1, rows)
    mu = braking(law, coefficients, speeds) + SIGMA_MU * random.standard_normal(rows)
    sigma = np.full(rows, SIGMA_MU)
    return curlfit.FrictionTable("drawn", speeds, mu, np.zeros(rows), sigma)


# What is said of them


def form(expression: str) -> str:
    """A combination with w in place of the weights that differ from throw to throw."""
    return re.sub(r"\d+\.\d+(e[-+]\d+)?|\d+e[-+]\d+", "w", expression)


def compared(
    name: str, group: str, estimate: Any, truth: float, systematic: float
) -> Statement:
    """An estimate, with its systematic error, beside its true value."""
    low, high = estimate.interval(0.95)
    pull = (estimate.value - truth) / np.hypot(estimate.stderr, systematic)
    inside = abs(pull) <= NORMAL if systematic else low <= truth <= high
    return Statement(name, group, pull, inside)


def statements_of(
    estimates: Mapping[str, Any],
    combinations: Iterable[Any],
    truth: Truth,
    systematic: Mapping[str, float],
) -> tuple[Statement, ...]:
    """All parameters and combinations that a fit calls determined, with their
    systematic errors, beside the truth."""
    true_values = truth.parameters
    statements = []
    for name, estimate in estimates.items():
        if estimate.verdict == "determined":
            of_the_law = name in truth.coefficients
            group = "coefficients" if of_the_law else "initial state"
            error = systematic.get(name, 0.0)
            statements.append(compared(name, group, estimate, true_values[name], error))
    for combination in combinations:
        terms = combination.weights.items()
        true_sum = sum(weight * true_values[name] for name, weight in terms)
        name = form(combination.expression)
        error = systematic.get(combination.expression, 0.0)
        statement = compared(name, "combinations", combination, true_sum, error)
        statements.append(statement)
    return tuple(statements)


def answer_of(fit: curlfit.FitResult | Exception, truth: Truth) -> Answer:
    """What the fit of a throw says, or why it says nothing."""
    if isinstance(fit, Exception):
        print(f"{type(fit).__name__}: {fit}", file=sys.stderr)
        return Answer((), type(fit).__name__)
    if not fit.converged:
        return Answer((), "not converged")
    systematic = fit.systematics.errors
    return Answer(statements_of(fit.parameters, fit.combinations, truth, systematic))


def answers_of_throws(
    law: str, kind: str, number: int, random: np.random.Generator
) -> list[Answer]:
    """Throws of a law, each fitted from the columns of a set."""
    truths = []
    throws = []
    for _ in range(number):
        if kind in ("times", "times-turning"):
            truth = drawn_past_the_hog_line(law, kind, random)
            throw = timed(law, truth, random)
        else:
            truth = drawn(law, kind, random)
            throw = filmed(law, truth, CHANNELS[kind], random)
        truths.append(truth)
        throws.append(throw)
    turning = kind == "times-turning"
    systematics = SYSTEMATICS if turning else None
    fits = fit_throws(throws, law, curves=turning, systematics=systematics)
    return [answer_of(fit, truth) for fit, truth in zip(fits, truths, strict=True)]


def answers_of_tables(
    law: str, number: int, random: np.random.Generator
) -> list[Answer]:
    """Tables of friction, each fitted with the law that it obeys."""
    answers = []
    for _ in range(number):
        coefficients = drawn_coefficients(law, random)
        table = friction_table(law, coefficients, random)
        fit = curlfit.fit_friction(table, law).fits[0]
        if not fit.converged:
            answers.append(Answer((), "not converged"))
            continue
        truth = Truth(coefficients, v0=0.0, omega0=0.0)
        statements = statements_of(fit.coefficients, fit.combinations, truth, {})
        answers.append(Answer(statements))
    return answers


# Designs


def planned(law: str, channels: Sequence[str]) -> curlfit.Design:
    """The errors expected of the planned throw, under the defaults of a law."""
    sigma = {name: NOISE[name] for name in channels}
    return curlfit.design(
        law,
        v0=[PLANNED["v0"]],
        omega0=[PLANNED["omega0"]],
        rate=RATE,
        until=TIMES[-1],
        sigma=sigma,
        throws=1,
    )


class GivenError(NamedTuple):
    """The standard error that a fit gives, and the verdict on the estimate."""

    size: float
    verdict: str


def given_errors(fit: curlfit.FitResult) -> dict[str, GivenError]:
    """The standard errors of coefficients and combinations by name."""
    errors = {
        name: GivenError(estimate.stderr, estimate.verdict)
        for name, estimate in fit.coefficients.items()
        if estimate.stderr is not None
    }
    for combination in fit.combinations:
        name = form(combination.expression)
        errors[name] = GivenError(combination.stderr, "determined")
    return errors


def fits_of_plan(
    law: str, truth: Truth, kind: str, number: int, seed: int
) -> list[curlfit.FitResult]:
    """Fits of a planned throw that is made many times; those that converged."""
    random = np.random.default_rng([seed, LAWS.index(law), SETS.index("design")])
    throws = [filmed(law, truth, CHANNELS[kind], random) for _ in range(number)]
    fits = fit_throws(throws, law, curves=False)
    return [fit for fit in fits if not isinstance(fit, Exception) and fit.converged]


def rows_of_design(law: str, kind: str, number: int, seed: int) -> list[list[object]]:
    """How many fits give an error of each quantity that a design expects to be known,
    and how large it is."""
    design = planned(law, CHANNELS[kind])
    expected = design.best["D"]
    truth = Truth(design.coefficients, **PLANNED)
    fits = fits_of_plan(law, truth, kind, number, seed)
    errors_by_fit = [given_errors(fit) for fit in fits]
    rows: list[list[object]] = []
    for expression, size in expected.stderr.items():
        if size is None:
            continue
        name = form(expression)
        stated_errors = [errors[name] for errors in errors_by_fit if name in errors]
        determined = sum(error.verdict == "determined" for error in stated_errors)
        ratio = (
            size / np.median([error.size for error in stated_errors])
            if stated_errors
            else None
        )
        verdict = expected.verdicts.get(expression, "determined")
        quantity = [f"`{law}`", kind, f"`{name}`", verdict, f"{size:.2g}"]
        counts = [
            f"{len(stated_errors)} of {len(fits)}",
            f"{determined} of {len(fits)}",
        ]
        rows.append([*quantity, *counts, "" if ratio is None else f"{ratio:.2f}"])
    return rows


# Tables


def of_group(statements: Iterable[Statement], group: str) -> list[Statement]:
    """The statements about coefficients, the initial state or combinations."""
    return [statement for statement in statements if statement.group == group]


def counts_of(statements: Sequence[Statement]) -> list[object]:
    """How many statements, the share of intervals with the truth, how many far off."""
    number = len(statements)
    inside = sum(statement.inside for statement in statements)
    far = sum(abs(statement.pull) > FAR for statement in statements)
    return [number or "", share(inside, number, 0.95), far or ""]


def largest_pull(statements: Sequence[Statement]) -> str:
    """The statement that is the most standard errors off, and how many."""
    if not statements:
        return ""
    worst = max(statements, key=lambda statement: abs(statement.pull))
    return f"{abs(worst.pull):.1f}, `{worst.name}`"


def most_common(combinations: Sequence[Statement]) -> str:
    """How often the intervals of the most frequent combinations contain the truth."""
    counts = Counter(statement.name for statement in combinations)
    inside = Counter(statement.name for statement in combinations if statement.inside)
    common = counts.most_common(COMMON)
    return ", ".join(f"`{name}` {inside[name]} of {count}" for name, count in common)


def row_of(law: str, kind: str, answers: Sequence[Answer]) -> list[object]:
    """The cells of a law and a set."""
    counted = [answer for answer in answers if not answer.failure]
    statements = [statement for answer in counted for statement in answer.statements]
    by_group = {group: of_group(statements, group) for group in GROUPS}
    counts = [cell for group in by_group.values() for cell in counts_of(group)]
    failures = reasons(answer.failure for answer in answers)
    return [
        f"`{law}`",
        kind,
        len(counted),
        failures,
        *counts,
        largest_pull(statements),
        most_common(by_group["combinations"]),
    ]


def chosen_names(text: str, names: Sequence[str]) -> list[str]:
    """The names in a list with commas, or all if it is empty; ends the program where
    there is no such name."""
    chosen = text.split(",") if text else list(names)
    unknown = set(chosen) - set(names)
    if unknown:
        sys.exit(f"{', '.join(unknown)}: expected some of {', '.join(names)}")
    return chosen


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """The options of a run of many throws of laws in sets of columns."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--throws", type=int, default=40, help="of a law and a set")
    parser.add_argument("--laws", default="", help="all by default")
    parser.add_argument("--sets", default="", help="all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--print", action="store_true", help="and write nothing")
    return parser


def answers_of(law: str, kind: str, number: int, seed: int) -> list[Answer]:
    """What fits say of the throws, or tables, of a law in a set."""
    random = np.random.default_rng([seed, LAWS.index(law), SETS.index(kind)])
    if kind == "friction-table":
        return answers_of_tables(law, number, random)
    return answers_of_throws(law, kind, number, random)


def count_verdicts(
    laws: Sequence[str], kinds: Sequence[str], options: argparse.Namespace
) -> None:
    """Count for each law and set, and write each row as it is done."""
    columns = [f"{group}: {cell}" for group in GROUPS for cell in CELLS]
    table = Table(
        "law",
        "columns",
        "throws",
        "not counted",
        *columns,
        "largest pull",
        "most frequent combinations: within 95 %",
    )
    for kind in kinds:
        of_the_kind = LAWS_OF_TABLES if kind == "friction-table" else LAWS
        for law in laws:
            if law in of_the_kind:
                answers = answers_of(law, kind, options.throws, options.seed)
                table.add(*row_of(law, kind, answers))
                if not options.print:
                    put_merged(MARK, table, ORDER)


def compare_designs(laws: Sequence[str], options: argparse.Namespace) -> None:
    """Compare the errors that designs expect with those of fits."""
    table = Table(
        "law",
        "columns",
        "quantity",
        "verdict of the design",
        "error expected",
        "fits that give an error",
        "fits that call it determined",
        "expected over given",
    )
    for law in laws:
        for kind in ("angle", "no-angle"):
            for row in rows_of_design(law, kind, options.throws, options.seed):
                table.add(*row)
    if set(laws) == set(LAWS_OF_DESIGNS) and not options.print:
        title = f"A planned throw of each law, made {options.throws} times:"
        table.put(f"{MARK}-design", title)


def main() -> None:
    """Run what is asked for, and write its tables."""
    options = parser_of(__doc__).parse_args()
    laws = chosen_names(options.laws, LAWS)
    kinds = chosen_names(options.sets, SETS)
    count_verdicts(laws, [kind for kind in kinds if kind != "design"], options)
    if "design" in kinds:
        compare_designs([law for law in laws if law in LAWS_OF_DESIGNS], options)


if __name__ == "__main__":
    main()
