"""Lines and tables of estimates, of fits and joint fits alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from curlfit.findings import Finding
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.fit.estimate_columns import (
    NAME,
    POSTERIOR,
    STDERR,
    SYSTEMATIC,
    VALUE,
    VERDICT,
    EstimateRow,
)
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.conditions import if_off, is_calibration
from curlfit.output.document import Said
from curlfit.output.table import Table
from curlfit.wording import capital, compact, join_words

_NOTABLE = 0.1  # systematic shift that is reported, over the standard error


def about(result: Any, warnings: Sequence[Finding], line: str = "") -> tuple[Said, ...]:
    """The lines below the first one of a report: the status of a fit, a line of
    numbers and, where the fit may be used, the subjects of its warnings."""
    caution = ""
    if result.converged:
        subjects = dict.fromkeys(warning.brief for warning in warnings)
        caution = f"Caution: {'; '.join(subjects)}." if subjects else "No warnings."
    status = Said(capital(result.status), style=style_of(result))
    return status, Said(line), Said(caution)


def style_of(result: Any) -> str:
    """The style of the status of a fit."""
    return "green" if result.converged else "bold red"


def lines_of(result: Any) -> list[str]:
    """Two lines: coefficients, combinations and products with their errors, and the
    names of the coefficients that are not identifiable."""
    estimates = []
    not_identifiable = []
    for name, coefficient in result.coefficients.items():
        if coefficient.verdict == Verdict.NOT_IDENTIFIABLE:
            not_identifiable.append(name)
            continue
        text = f"{name} = {compact(coefficient.value, coefficient.stderr)}"
        if coefficient.verdict != Verdict.DETERMINED:
            text += f" ({coefficient.verdict})"
        estimates.append(text)
    for term in _combinations_and_products(result):
        estimates.append(f"{term.expression} = {compact(term.value, term.stderr)}")
    hidden = ""
    if not_identifiable:
        hidden = f"not identifiable: {', '.join(not_identifiable)}"
    return [", ".join(estimates), hidden]


def _combinations_and_products(result: Any) -> tuple[Any, ...]:
    """Determined combinations, and products where a result has them."""
    return (*result.combinations, *getattr(result, "products", ()))


def reported(result: Any) -> dict[str, tuple[float, float | None]]:
    """Value and standard error by name of coefficient, determined combination and
    product."""
    estimates = dict(result.coefficients)
    for term in _combinations_and_products(result):
        estimates[term.expression] = term
    return {
        name: (estimate.value, estimate.stderr) for name, estimate in estimates.items()
    }


def systematics(result: Any) -> str:
    """Sentences on the largest systematic error of each coefficient or combination, and
    on those due to the calibration of a camera; without those that are small beside
    the standard error."""
    errors = result.systematics
    shifts_by_condition: dict[str, list[str]] = {}
    from_calibration = []
    for name, (_, stderr) in reported(result).items():
        if stderr is None:
            continue
        condition, shift = _largest_shift(errors.shifts.get(name, {}))
        if shift and abs(shift) >= _NOTABLE * stderr:
            side = "higher" if shift > 0 else "lower"
            text = f"{name} is {abs(shift):.2g} {side}"
            shifts_by_condition.setdefault(condition, []).append(text)
        calibration = errors.of_calibration.get(name, 0.0)
        if stderr > 0 and calibration >= _NOTABLE * stderr:
            from_calibration.append(f"{calibration:.2g} to {name}")
    sentences = []
    if shifts_by_condition:
        largest = "; ".join(
            f"{if_off(condition, errors.widths[condition])}, "
            f"the true {join_words(shifts)}"
            for condition, shifts in shifts_by_condition.items()
        )
        sentences.append(
            "Systematic errors come from conditions that the fit holds fixed; "
            f"the largest: {largest}. `--systematic` sets the standard uncertainties "
            "of the conditions; `--prior` or `--free` estimates them with "
            "the coefficients."
        )
    if from_calibration:
        sentences.append(
            f"The calibration of the camera contributes {join_words(from_calibration)},"
            " according to the residual of its known points."
        )
    return " ".join(sentences)


def _largest_shift(shifts: Mapping[str, float]) -> tuple[str, float]:
    """The condition, calibration apart, with the largest shift, and this; "" and 0
    where there is none."""
    largest = ("", 0.0)
    for condition, shift in shifts.items():
        if not is_calibration(condition) and abs(shift) > abs(largest[1]):
            largest = (condition, shift)
    return largest


def estimates_table(
    heading: str, rows: Sequence[EstimateRow], caption: str
) -> Table[EstimateRow]:
    """Estimates with their errors, verdicts and intervals; `heading` is above their
    names."""
    columns = (
        NAME.but(heading=heading),
        VALUE,
        STDERR,
        SYSTEMATIC,
        VERDICT,
        POSTERIOR,
    )
    return Table(rows, columns, caption)


def derived_table(quantities: Sequence[Derived]) -> Table[EstimateRow]:
    """Derived quantities with their errors."""
    rows = [EstimateRow.of(quantity.expression, quantity) for quantity in quantities]
    return estimates_table("derived", rows, "Derived quantities")
