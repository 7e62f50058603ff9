"""A row of a stopwatch table with a value that contradicts the other rows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.wording import capital


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
    def finding(self) -> Finding:
        """The value and how far it is from what the other rows say."""
        numbers = {"column": self.column, "value": self.value, "unit": self.unit}
        if self.deviation is None:
            return Finding.note("impossible-value", **numbers)
        return Finding.note("odd-value", **numbers, **_deviation(self.deviation))

    @property
    def fault(self) -> str:
        """The finding in words."""
        return str(self.finding)


def _deviation(deviation: float | None) -> dict[str, Any]:
    """A deviation as its size and direction."""
    if deviation is None:
        return {"off": None, "direction": None}
    return {"off": abs(deviation), "direction": "more" if deviation > 0 else "less"}


def odd_row_findings(odd_rows: Iterable[OddRow]) -> list[Finding]:
    """A finding for each table on the odd rows that are left out, or that are used
    since they are many; about the table, where there are several."""
    rows_by_table: dict[tuple[str, bool], list[OddRow]] = {}
    for odd in odd_rows:
        rows_by_table.setdefault((odd.file, odd.left_out), []).append(odd)
    several_tables = len({file for file, _ in rows_by_table}) > 1
    findings = []
    for (file, left_out), odd_of_table in rows_by_table.items():
        rows = [
            {
                "line": odd.line,
                "row": odd.row,
                "column": odd.column,
                "value": odd.value,
                "unit": odd.unit,
                "impossible": odd.deviation is None,
                **_deviation(odd.deviation),
            }
            for odd in odd_of_table
        ]
        finding = Finding.warning("odd-rows-used", rows=rows)
        if left_out:
            lines = ",".join(str(odd.line) for odd in odd_of_table)
            keep = Remedy("keep-rows", Option("keep", lines), {"count": len(rows)})
            finding = Finding.warning("odd-rows-left-out", keep, rows=rows)
        findings.append(finding.of(file) if several_tables else finding)
    return findings


def odd_rows_in_words(odd_rows: Iterable[OddRow]) -> list[str]:
    """Sentences on odd rows, one for each table."""
    return [
        f"{finding if finding.about else capital(str(finding))}."
        for finding in odd_row_findings(odd_rows)
    ]
