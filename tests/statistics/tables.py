"""Tables of README.md beside this file, each between two marks with its name."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

HERE = Path(__file__).parent
DOUBTFUL = 0.01
LEVELS = {"68 %": (0.68, 0.99446), "95 %": (0.95, 1.95996)}
"""Share of the cases that an interval should hold, and its half width in
standard errors."""


def put(name: str, text: str, folder: Path = HERE) -> None:
    """Replace a table in the README.md of a folder."""
    file = folder / "README.md"
    mark = f"<!-- {name} -->\n"
    before, _, after = file.read_text().split(mark)
    file.write_text(mark.join([before, text, after]))


def marked(text: str, p: float) -> str:
    """A cell, marked where chance explains it with a probability below `DOUBTFUL`."""
    return f"{text}{' (!)' if p < DOUBTFUL else ''}"


def share(inside: int, of: int, nominal: float) -> str:
    """A count as a cell, marked where chance does not explain it."""
    if not of:
        return ""
    return marked(f"{100 * inside / of:.1f} %", binomtest(inside, of, nominal).pvalue)


def correlated(noise: np.ndarray, carry: float) -> np.ndarray:
    """The noise with each value along the last axis correlated so much with
    the one before."""
    for k in range(1, noise.shape[-1]):
        noise[..., k] = (
            carry * noise[..., k - 1] + np.sqrt(1 - carry**2) * noise[..., k]
        )
    return noise


def row(cells: Iterable[object]) -> str:
    """A line of a table in Markdown."""
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def head(*columns: str) -> list[str]:
    """The first two lines of a table in Markdown."""
    return [row(columns), f"|{'---|' * len(columns)}"]


class Table(list[str]):
    """Lines of a table in Markdown; rows are shown as they are added, with the
    time they took."""

    def __init__(self, *columns: str) -> None:
        super().__init__(head(*columns))
        self.began = time.time()

    def add(self, *cells: object) -> None:
        """Add a row."""
        self.append(row(cells))
        print(
            self[-1], f"({time.time() - self.began:.0f} s)", file=sys.stderr, flush=True
        )
        self.began = time.time()

    def put(self, name: str, before: str = "") -> None:
        """Replace a table in README.md, with a sentence before it."""
        lines = [before, ""] if before else []
        put(name, "\n".join([*lines, *self]) + "\n")


def law_and_set(line: str) -> tuple[str, str]:
    """The law and the set of a line, which are its first two cells."""
    _, law, kind, *_ = line.split("|")
    return law.strip(" `"), kind.strip()


def merged(
    present: str, table: Sequence[str], order: Iterable[tuple[str, str]]
) -> list[str]:
    """The lines of a new table, and those of the present one of other laws and sets,
    each law and set at its place in the order."""
    lines: dict[tuple[str, str], list[str]] = {}
    new = {law_and_set(line) for line in table[2:]}
    kept = [line for line in present.splitlines()[2:] if law_and_set(line) not in new]
    for line in (*kept, *table[2:]):
        lines.setdefault(law_and_set(line), []).append(line)
    return [*table[:2], *(line for case in order for line in lines.get(case, ()))]


def put_merged(
    name: str, table: Sequence[str], order: Iterable[tuple[str, str]]
) -> None:
    """Put the lines of a table into that of README.md, in place of those of the same
    laws and sets."""
    _, present, _ = (HERE / "README.md").read_text().split(f"<!-- {name} -->\n")
    put(name, "\n".join(merged(present, table, order)) + "\n")


def reasons(found: Iterable[str]) -> str:
    """How often each reason occurs, the most frequent first; empty reasons are none."""
    causes = [reason for reason in found if reason]
    often = sorted(set(causes), key=lambda reason: (-causes.count(reason), reason))
    return ", ".join(f"{reason} {causes.count(reason)}" for reason in often)


def asked(description: str | None) -> argparse.Namespace:
    """The number of throws of each case, and which cases."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("throws", type=int, help="of each case")
    parser.add_argument(
        "--only", default="", help="cases whose title has this; nothing is written"
    )
    chosen = parser.parse_args()
    if chosen.throws < 1:
        parser.error("expected at least one throw")
    return chosen
