"""How often fits state what is false when the constants of their check are halved or
doubled.

    python tests/statistics/thresholds.py [--throws N] [--laws A,B] [--seed N]
        [--print]

The same throws of a few laws without the angle, drawn as by `verdicts.py`, are fitted
with each constant by which a fit decides whether chi squared is a quadratic, and what
is determined along its ridge, at half and at twice its value. The table "thresholds" of
README.md beside this file has a row for each; with `--print` nothing is written.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from tables import Table, reasons, share
from verdicts import (
    CHANNELS,
    FAR,
    LAWS,
    SETS,
    Answer,
    Truth,
    answer_of,
    chosen_names,
    drawn,
    filmed,
    parser_of,
)

import curlfit
from curlfit.inference.fit.fit import fit_throws

TRIED = ("front-back", "power+transverse", "power-angular", "power+pivot")
"""Laws of which a path without the angle leaves coefficients open."""
KIND = "no-angle"
FACTORS = (0.5, 2.0)
CONSTANTS = {
    "curlfit.inference.fit.departures": (
        "_PROBED",
        "_QUADRATIC",
        "_ABOUT",
        "_LEVEL",
        "_FAINT",
        "_TAKES_PART",
        "_LOWER",
        "_NO_SPIN",
    ),
    "curlfit.inference.identifiability": (
        "LITTLE",
        "STRETCHED",
        "WIDE",
        "FAR_LESS",
        "UNKNOWN",
        "WEAK_ERROR",
    ),
    "curlfit.inference.fit.ridge": ("_FIRST_STEP", "_GROWTH", "_TOWARD_ZERO"),
}
"""By the module in which each has its value and its meaning."""


class Throws(NamedTuple):
    """Throws of a law, and their true parameters."""

    law: str
    throws: list[curlfit.Throw]
    truths: list[Truth]


def drawn_throws(law: str, number: int, seed: int) -> Throws:
    """The throws of a law that `verdicts.py` draws without the angle."""
    random = np.random.default_rng([seed, LAWS.index(law), SETS.index(KIND)])
    throws = []
    truths = []
    for _ in range(number):
        truth = drawn(law, KIND, random)
        truths.append(truth)
        throws.append(filmed(law, truth, CHANNELS[KIND], random))
    return Throws(law, throws, truths)


@contextlib.contextmanager
def constant_at(module: str, name: str, factor: float) -> Iterator[float]:
    """A constant at a multiple of its value, wherever it was imported; the value."""
    value = getattr(sys.modules[module], name)
    users = [
        user
        for title, user in list(sys.modules.items())
        if title.startswith("curlfit.") and getattr(user, name, None) is value
    ]
    for user in users:
        setattr(user, name, factor * value)
    try:
        yield value
    finally:
        for user in users:
            setattr(user, name, value)


def answers_of(drawn_by_law: Sequence[Throws]) -> list[Answer]:
    """What the fits of all throws say."""
    answers = []
    for law, throws, truths in drawn_by_law:
        fits = fit_throws(throws, law, curves=False)
        answers += [
            answer_of(fit, truth) for fit, truth in zip(fits, truths, strict=True)
        ]
    return answers


def row_of(name: str, value: object, answers: Sequence[Answer]) -> list[object]:
    """How many statements there are, and how many of them are false."""
    statements = [statement for answer in answers for statement in answer.statements]
    number = len(statements)
    inside = sum(statement.inside for statement in statements)
    far = sum(abs(statement.pull) > FAR for statement in statements)
    failures = reasons(answer.failure for answer in answers)
    return [name, value, number, share(inside, number, 0.95), far or "", failures]


def count_by_constant(laws: Sequence[str], options: argparse.Namespace) -> Table:
    """A row for the constants as they are, and two for each of them."""
    drawn_by_law = [drawn_throws(law, options.throws, options.seed) for law in laws]
    table = Table(
        "constant", "value", "statements", "within 95 %", "beyond 5 errors", "not given"
    )
    table.add(*row_of("as they are", "", answers_of(drawn_by_law)))
    for module, names in CONSTANTS.items():
        for name in names:
            for factor in FACTORS:
                with constant_at(module, name, factor) as value:
                    answers = answers_of(drawn_by_law)
                label = f"`{name.lstrip('_')}`"
                table.add(*row_of(label, f"{factor * value:.3g}", answers))
    return table


def main() -> None:
    """Run what is asked for, and write its table."""
    options = parser_of(__doc__).parse_args()
    laws = chosen_names(options.laws, TRIED)
    table = count_by_constant(laws, options)
    if not options.print:
        title = f"{options.throws} throws of each law: {', '.join(laws)}."
        table.put("thresholds", title)


if __name__ == "__main__":
    main()
