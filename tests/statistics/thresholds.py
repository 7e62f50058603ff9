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

from tables import Table, reasons
from verdicts import answers_of, chosen_names, counts_of, parser_of

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
    "curlfit.inference.information.thresholds": (
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


@contextlib.contextmanager
def constant_at(module: str, name: str, factor: float) -> Iterator[float]:
    """A constant at a multiple of its value, wherever it was imported."""
    value = getattr(sys.modules[module], name)
    changed = factor * value
    users = [
        user
        for title, user in list(sys.modules.items())
        if title.startswith("curlfit.") and getattr(user, name, None) is value
    ]
    for user in users:
        setattr(user, name, changed)
    try:
        yield changed
    finally:
        for user in users:
            setattr(user, name, value)


def row_of(
    name: str, value: str, laws: Sequence[str], options: argparse.Namespace
) -> list[object]:
    """How many statements there are with a constant at a value, and how many of them
    are false."""
    answers = [
        answer
        for law in laws
        for answer in answers_of(law, KIND, options.throws, options.seed)
    ]
    statements = [statement for answer in answers for statement in answer.statements]
    failures = reasons(answer.failure for answer in answers)
    return [name, value, *counts_of(statements), failures]


def count_by_constant(laws: Sequence[str], options: argparse.Namespace) -> Table:
    """A row for the constants as they are, and two for each of them."""
    table = Table(
        "constant", "value", "statements", "within 95 %", "beyond 5 errors", "not given"
    )
    table.add(*row_of("as they are", "", laws, options))
    for module, names in CONSTANTS.items():
        for name in names:
            for factor in FACTORS:
                label = f"`{name.lstrip('_')}`"
                with constant_at(module, name, factor) as value:
                    table.add(*row_of(label, f"{value:.3g}", laws, options))
    return table


def main() -> None:
    """Run what is asked for, and write its table."""
    parser = parser_of(__doc__)
    options = parser.parse_args()
    if options.sets not in ("", KIND):
        parser.error(f"--sets: expected {KIND}, the set that is fitted")
    laws = chosen_names(options.laws, TRIED)
    table = count_by_constant(laws, options)
    if not options.print:
        title = f"{options.throws} throws of each law: {', '.join(laws)}."
        table.put("thresholds", title)


if __name__ == "__main__":
    main()
