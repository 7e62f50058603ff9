"""A row of a stopwatch table with a value that contradicts the other rows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class OddRow:
    """A row of a stopwatch table with a value that contradicts the other rows.

    Attributes
    ----------
    file : the table. row : its number among the throws. line : in the file.
    column, value, unit : of the odd value.
    deviation : the value less what the other rows say; None for a value beyond any
        stone.
    left_out : whether a joint fit leaves the row out; where more than a fifth of the
        rows are odd it uses them.

    Examples
    --------
    >>> odd = curlfit.load_throws("data/two_sheets.csv")[0].odd_rows[0]
    >>> odd.line, odd.column, odd.value
    (12, 'hog to rest', 1.21)
    """

    file: str
    row: int
    line: int
    column: str
    value: float
    unit: str
    deviation: float | None
    left_out: bool = True

    @property
    def fault(self) -> str:
        """The value and how far it is from what the other rows say."""
        value = f"{self.column} {self.value:.4g} {self.unit}"
        if self.deviation is None:
            return f"{value}, beyond any stone"
        more = "more" if self.deviation > 0 else "less"
        off = f"{abs(self.deviation):.3g} {self.unit}"
        return f"{value}: {off} {more} than the other rows say"

    @property
    def words(self) -> str:
        """Where the row is, and its fault."""
        return f"line {self.line} (row {self.row}, {self.fault})"


def odd_rows_in_words(odd_rows: Iterable[OddRow]) -> list[str]:
    """A sentence for each table on the odd rows that are left out, or that are used
    since they are many."""
    by_table: dict[tuple[str, bool], list[OddRow]] = {}
    for odd in odd_rows:
        by_table.setdefault((odd.file, odd.left_out), []).append(odd)
    several_tables = len({file for file, _ in by_table}) > 1
    sentences = []
    for (file, left_out), rows in by_table.items():
        table = f"{file}: " if several_tables else ""
        listed = "; ".join(odd.words for odd in rows)
        if left_out:
            lines = ",".join(str(odd.line) for odd in rows)
            keeps = "keeps it" if len(rows) == 1 else "keeps them"
            sentences.append(
                f"{table}Left out as odd: {listed}; `--keep {lines}` {keeps}."
            )
        else:
            sentences.append(
                f"{table}Odd rows, used since they are more than a fifth: {listed}."
            )
    return sentences
