"""Columns of tables of estimates, each once: reports, CSV, LaTeX and pandas pick from
them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.information.verdict import Verdict
from curlfit.output.table import Column
from curlfit.output.text import coloured_verdict, labelled
from curlfit.wording import format_estimate, from_to


@dataclass(frozen=True)
class EstimateRow:
    """An estimate as a row of a table.

    Attributes
    ----------
    name : of the parameter, or the expression of a combination or derived quantity.
    estimate : an `Estimate`, a `Combination` or a `Derived`.
    systematic : error due to the conditions that the fit holds fixed; None if unknown.
    quantiles : of the posterior, "2.5" to "97.5"; empty without one.
    """

    name: str
    estimate: Any
    systematic: float | None
    quantiles: Quantiles

    @classmethod
    def of(
        cls,
        name: str,
        estimate: Any,
        systematic: float | None = None,
        quantiles: Quantiles | None = None,
    ) -> EstimateRow:
        """The row of an estimate; a derived quantity knows its systematic error and
        its quantiles."""
        if isinstance(estimate, Derived):
            return cls(name, estimate, estimate.systematic, estimate.quantiles)
        return cls(name, estimate, systematic, quantiles or {})

    @property
    def value(self) -> float | None:
        """The value; None where it is not identifiable."""
        if self.estimate.verdict == Verdict.NOT_IDENTIFIABLE:
            return None
        value: float = self.estimate.value
        return value

    @property
    def interval(self) -> tuple[float | None, float | None]:
        """The interval of 95 %; two None where there is no standard error."""
        interval: tuple[float, float] | None = self.estimate.interval()
        return interval or (None, None)

    @property
    def unit(self) -> str:
        """The unit; empty for a combination, which has none of its own."""
        return getattr(self.estimate, "unit", "")

    @property
    def prior(self) -> str:
        """The prior of a parameter; empty without one."""
        return getattr(self.estimate, "prior", "")


def value_in_words(row: EstimateRow) -> str:
    """The value to two digits of its standard error."""
    if row.value is None:
        return "-"
    return format_estimate(row.value, row.estimate.stderr)[0]


def stderr_in_words(row: EstimateRow) -> str:
    """The standard error to two digits."""
    if row.value is None:
        return "-"
    return format_estimate(row.value, row.estimate.stderr)[1]


def interval_in_words(quantiles: Quantiles) -> str:
    """The interval that holds 68 % of the posterior; empty without quantiles."""
    return from_to(quantiles["16"], quantiles["84"]) if quantiles else ""


EstimateColumn = Column[EstimateRow]
NAME = EstimateColumn(
    "parameter", words=lambda row: labelled(row.name, row.unit), key="name"
)
VALUE = EstimateColumn("estimate", words=value_in_words, key="value", right=True)
STDERR = EstimateColumn(
    "std. error",
    lambda row: row.estimate.stderr,
    words=stderr_in_words,
    key="stderr",
    right=True,
)
SYSTEMATIC = EstimateColumn("systematic", format=".2g", right=True)
LOW = EstimateColumn("low", lambda row: row.interval[0], key="low_95")
HIGH = EstimateColumn("high", lambda row: row.interval[1], key="high_95")
DOF = EstimateColumn("dof", lambda row: row.estimate.dof)
VERDICT = EstimateColumn("verdict", lambda row: row.estimate.verdict, coloured_verdict)
UNIT = EstimateColumn("unit")
PRIOR = EstimateColumn("prior")
POSTERIOR = EstimateColumn(
    "68 % of posterior", format=interval_in_words, key="quantiles"
)
