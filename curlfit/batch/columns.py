"""The columns of the table of a batch, each with its name and how it gets its value of
a throw. A value that is missing is None.

The error of a parameter is NAME_stderr, that of an expression "EXPRESSION stderr".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from curlfit.batch.settings import BatchSettings
from curlfit.batch.table import Status
from curlfit.inference.fit.coefficient_rows import all_coefficient_rows, left_open
from curlfit.output.table import Column

if TYPE_CHECKING:
    from curlfit.findings import Finding
    from curlfit.inference.fit.result import FitResult

QUANTILES = ("16", "50", "84")
"""Quantiles of the posterior, in percent."""


@dataclass(frozen=True)
class BatchRow:
    """A throw of a batch, and what became of it.

    Attributes
    ----------
    file, shot, stone_index : where it was read.
    status : whether its fit can be used.
    reason : why it is not ok.
    fit : without its curves, unless systematic errors are asked for, and without
        quantities of the path; None where there is none.
    derived : quantities that the batch asks for, by expression.
    quantiles : of the posterior, by the name of a parameter or combination.
    warnings : of the fit and of its posterior.
    """

    file: str
    shot: int | None
    stone_index: int | None
    status: Status
    reason: str | None = None
    fit: FitResult | None = None
    derived: Mapping[str, Any] = field(default_factory=dict)
    quantiles: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    warnings: Sequence[Finding] = ()

    def estimate(self, name: str) -> Any:
        """The estimate of a parameter, or of a combination by its expression; None
        without one."""
        if self.fit is None:
            return None
        for combination in self.fit.combinations:
            if combination.expression == name:
                return combination
        return self.fit.parameters.get(name)


BatchColumn = Column[BatchRow]


def _fit_column(name: str, value: Callable[[FitResult], Any]) -> BatchColumn:
    """A column of the fit, empty where there is none."""
    return Column(name, lambda row: None if row.fit is None else value(row.fit))


def _usable_fit_column(name: str, value: Callable[[FitResult], Any]) -> BatchColumn:
    """A column of the fit, empty unless it converged."""
    return _fit_column(name, lambda fit: value(fit) if fit.converged else None)


def _estimate_column(
    name: str, estimate: Callable[[BatchRow], Any], attribute: str
) -> BatchColumn:
    """The column of an attribute of an estimate, empty where there is none."""

    def value(row: BatchRow) -> Any:
        estimated = estimate(row)
        return None if estimated is None else getattr(estimated, attribute)

    return Column(name, value)


def _duration(fit: FitResult) -> float:
    return fit.data.end - fit.data.begin


def _information(fit: FitResult) -> str:
    """Rows of numbers as one list."""
    numbers = ", ".join(
        f"{number:.17g}" for number in all_coefficient_rows(fit).ravel()
    )
    return f"[{numbers}]"


def _labels(fit: FitResult) -> str:
    return "; ".join(
        f"{name} = {label.replace(';', ',')}" for name, label in fit.data.labels.items()
    )


def _combinations(fit: FitResult) -> str:
    """What is determined together, with its standard errors."""
    texts = []
    for combination in fit.combinations:
        text = f"{combination.expression} = {combination.value!r}"
        if combination.stderr is not None:
            text += f" +- {combination.stderr!r}"
        texts.append(text)
    return "; ".join(texts)


FILE = BatchColumn("file")
SHOT = BatchColumn("shot")
STONE_INDEX = BatchColumn("stone_index")
STATUS = BatchColumn("status")
OBSERVATIONS = _fit_column("n_observations", lambda fit: fit.n_observations)
RMS_X = _fit_column("rms_x", lambda fit: fit.rms.get("x"))
RMS_Y = _fit_column("rms_y", lambda fit: fit.rms.get("y"))
RMS_PHI = _fit_column("rms_phi", lambda fit: fit.rms.get("phi"))
DURATION = _fit_column("duration", _duration)
"""How long the throw was seen, in s."""
INFORMATION = _usable_fit_column("information", _information)
"""What the throw says of its coefficients, for a second fit of all throws."""
LEFT_OPEN = _usable_fit_column("left_open", lambda fit: "; ".join(left_open(fit)))
"""The coefficients that values along a ridge leave open (`FitResult.ridge`); tables of
earlier versions lack it."""
LABELS = _fit_column("labels", _labels)
COMBINATIONS = _fit_column("combinations", _combinations)
WARNINGS = BatchColumn("warnings", lambda row: "; ".join(map(str, row.warnings)))
REASON = BatchColumn("reason")


def columns(plan: BatchSettings) -> list[BatchColumn]:
    """The columns of the table; those of text, which may contain commas, come last.

    Raises
    ------
    InputError : the settings are impossible for any throw.
    """
    plan.checked()
    estimates: list[BatchColumn] = []
    for name in plan.parameter_set().names:
        estimates += _columns_of_estimate(name, f"{name}_", plan, with_verdict=True)
    for name in plan.sums():
        estimates += _columns_of_estimate(name, f"{name} ", plan)
    for expression in plan.derive:
        estimates += _columns_of_derived(expression)
    return [
        FILE,
        SHOT,
        STONE_INDEX,
        STATUS,
        OBSERVATIONS,
        RMS_X,
        RMS_Y,
        RMS_PHI,
        *estimates,
        DURATION,
        INFORMATION,
        LEFT_OPEN,
        LABELS,
        COMBINATIONS,
        WARNINGS,
        REASON,
    ]


def names_of_columns(plan: BatchSettings) -> list[str]:
    """The header of the table."""
    return [column.name for column in columns(plan)]


def _columns_of_estimate(
    name: str, prefix: str, plan: BatchSettings, *, with_verdict: bool = False
) -> list[BatchColumn]:
    """The columns of a parameter, or of a combination by its expression."""

    def estimate(row: BatchRow) -> Any:
        return row.estimate(name)

    def quantile_column(percent: str) -> BatchColumn:
        return Column(
            f"{prefix}{percent}", lambda row: row.quantiles.get(name, {}).get(percent)
        )

    of_estimate = [
        _estimate_column(name, estimate, "value"),
        _estimate_column(f"{prefix}stderr", estimate, "stderr"),
    ]
    if with_verdict:
        of_estimate.append(_estimate_column(f"{prefix}verdict", estimate, "verdict"))
    if plan.posterior:
        of_estimate += map(quantile_column, QUANTILES)
    if plan.systematics:
        of_estimate.append(
            _fit_column(
                f"{prefix}systematic", lambda fit: fit.systematics.errors.get(name)
            )
        )
    return of_estimate


def _columns_of_derived(expression: str) -> list[BatchColumn]:
    """The columns of a quantity that the batch asks for."""

    def derived(row: BatchRow) -> Any:
        return row.derived.get(expression)

    return [
        _estimate_column(expression, derived, "value"),
        _estimate_column(f"{expression} stderr", derived, "stderr"),
    ]
