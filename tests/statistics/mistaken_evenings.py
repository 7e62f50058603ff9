"""Typing errors in the stopwatch tables of evenings: how many are named, how many right
rows are.

    python tests/statistics/mistaken_evenings.py [EVENINGS]

The evenings are those of `evenings.py`, written as people write them. Into each come
three errors at random places: two neighbouring digits of a value exchanged, one digit
replaced by another, and a place in feet written as metres. An error is counted by its
size, over the scatter of its column in the evening without errors: no one can tell an
error of less than the scatter from a throw. The table "mistaken evenings" of README.md
beside this file.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from evenings import COLUMNS, TRUTHS, Evening
from tables import Table

import curlfit
from curlfit.errors import CurlfitError

FOOT = 0.3048
HEADINGS = {
    "hog_to_hog": "hog to hog",
    "hog_to_rest": "hog to rest",
    "rest": "rest",
    "curl": "curl",
    "turns": "turns",
}
WITHOUT_GAPS = ("two", "curl", "three")
SIZES = {"3 to 6": (3.0, 6.0), "6 to 12": (6.0, 12.0), "12 and more": (12.0, np.inf)}


class Mistake(NamedTuple):
    """What was typed in place of a value, in the units of the table."""

    row: int
    column: str
    kind: str
    typed: str
    off: float
    """typed less right"""


def as_typed(column: str, value: float) -> float:
    """A value in the unit of its column: s, m, or turns of the handle."""
    return value / (2 * np.pi) if column == "turns" else value


def digits_exchanged(text: str, random: np.random.Generator) -> str:
    """Two neighbouring digits exchanged."""
    positions = [
        k
        for k in range(len(text) - 1)
        if text[k : k + 2].isdigit() and text[k] != text[k + 1]
    ]
    if not positions:
        return text
    k = int(random.choice(positions))
    return text[:k] + text[k + 1] + text[k] + text[k + 2 :]


def one_digit_wrong(text: str, random: np.random.Generator) -> str:
    """A digit replaced by another."""
    k = int(random.choice([k for k, sign in enumerate(text) if sign.isdigit()]))
    other = random.choice([digit for digit in "0123456789" if digit != text[k]])
    return f"{text[:k]}{other}{text[k + 1 :]}"


def mistakes_of(
    table: list[dict[str, str]], random: np.random.Generator
) -> list[Mistake]:
    """One mistake of each kind, in different rows."""
    rows = random.permutation(len(table))[:3].tolist()
    columns = list(table[0])
    lengths = [name for name in columns if name in ("rest", "curl")]
    chosen = [random.choice(columns), random.choice(columns), random.choice(lengths)]
    mistakes = []
    for row, column, kind in zip(
        rows, chosen, ("digits exchanged", "digit wrong", "feet as metres"), strict=True
    ):
        text = table[row][column]
        if kind == "digits exchanged":
            typed = digits_exchanged(text, random)
        elif kind == "digit wrong":
            typed = one_digit_wrong(text, random)
        else:
            typed = f"{float(text) / FOOT:.2f}"
        mistakes.append(Mistake(row, column, kind, typed, float(typed) - float(text)))
    return mistakes


def scatters(table: list[dict[str, str]]) -> dict[str, float]:
    """Standard deviation of each column of an evening, of places and curls of their
    sizes, as far as the order of the rows does not explain it."""
    deviations = {}
    for name in table[0]:
        values = np.array([float(row[name]) for row in table])
        if name in ("curl", "turns"):
            values = np.abs(values)
        order = np.arange(len(values))
        left = values - np.polyval(np.polyfit(order, values, 1), order)
        deviations[name] = float(left.std(ddof=2))
    return deviations


def written(table: list[dict[str, str]], evening: Evening, file: Path) -> None:
    """Write an evening as a table."""
    lines = [",".join(["sheet", "hour", *(HEADINGS[name] for name in table[0])])]
    for sheet, hour, row in zip(evening.sheets, evening.hours, table, strict=True):
        cells = [cell(name, text) for name, text in row.items()]
        lines.append(",".join([f"{sheet}", f"{hour:.3f}", *cells]))
    file.write_text("\n".join(lines) + "\n")


def cell(column: str, text: str) -> str:
    """A value as people write it: curls with their side, turns without a sense."""
    size = text.lstrip("-")
    if column == "curl":
        side = "right" if text.startswith("-") else "left"
        return f"{size} m {side}"
    return size if column == "turns" else text


def odd_rows_of(file: Path) -> set[int] | None:
    """The rows that curlfit calls odd, from 0; None where it refuses the table."""
    try:
        throws = curlfit.load_throws(file)
    except CurlfitError:
        return None
    return {odd.row - 1 for odd in throws[0].odd_rows}


def main(evenings: int) -> None:
    """Count, and write the table."""
    named: Counter[tuple[str, str]] = Counter()
    totals: Counter[tuple[str, str]] = Counter()
    right_rows = 0
    called_odd = 0
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "evening.csv"
        for truth in TRUTHS.values():
            for columns in WITHOUT_GAPS:
                for seed in range(evenings):
                    evening = Evening(truth, COLUMNS[columns], seed)
                    table = [
                        {
                            name: f"{as_typed(name, value):.2f}"
                            for name, value in row.items()
                        }
                        for row in evening.rows
                    ]
                    mistakes = mistakes_of(table, evening.random)
                    sizes = scatters(table)
                    for mistake in mistakes:
                        table[mistake.row][mistake.column] = mistake.typed
                    written(table, evening, file)
                    odd = odd_rows_of(file)
                    if odd is None:
                        refused += 1
                        continue
                    wrong = {mistake.row for mistake in mistakes if mistake.off}
                    right_rows += len(table) - len(wrong)
                    called_odd += len(odd - wrong)
                    for mistake in mistakes:
                        size = abs(mistake.off) / sizes[mistake.column]
                        for words, (low, high) in SIZES.items():
                            if low <= size < high:
                                totals[mistake.kind, words] += 1
                                named[mistake.kind, words] += mistake.row in odd
    lines = Table("mistake", "size over scatter", "made", "named")
    for kind, words in sorted(totals):
        count = totals[kind, words]
        share = 100 * named[kind, words] / count
        lines.add(kind, words, count, f"{share:.0f} %")
    before = (
        f"{evenings} evenings of each law and set of columns, {refused} refused; "
        f"{called_odd} of {right_rows} right rows were called odd."
    )
    lines.put("mistaken evenings", before)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
