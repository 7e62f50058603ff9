"""Lines and tables of estimates, of fits and joint fits alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from curlfit.findings import Finding
from curlfit.inference.conditions import if_off, is_calibration
from curlfit.inference.derived import Derived, Quantiles
from curlfit.inference.verdict import Verdict
from curlfit.output.console import PlainTable
from curlfit.output.document import Said
from curlfit.output.text import judged, labelled
from curlfit.wording import capital, compact, format_estimate, from_to, join_words

_NOTABLE = 0.1  # systematic shift that is reported, over the standard error


def about(result: Any, warnings: Sequence[Finding], line: str = "") -> tuple[Said, ...]:
    """Whether a fit, of one throw or several, converged, a line of numbers, and what
    the warnings of one that may be used are about."""
    subjects = dict.fromkeys(warning.brief for warning in warnings)
    caution = f"Caution: {'; '.join(subjects)}." if subjects else "No warnings."
    status = Said(capital(result.status), style=style_of(result))
    return status, Said(line), Said(caution * result.converged)


def style_of(result: Any) -> str:
    """The style of the status of a fit."""
    return "green" if result.converged else "bold red"


def lines_of(result: Any) -> list[str]:
    """Coefficients, determined combinations and products in a line, and what is
    not identifiable."""
    known, unseen = [], []
    for name, item in result.coefficients.items():
        if item.verdict == Verdict.NOT_IDENTIFIABLE:
            unseen.append(name)
            continue
        known.append(f"{name} = {compact(item.value, item.stderr)}")
        if item.verdict != Verdict.DETERMINED:
            known[-1] += f" ({item.verdict})"
    known += [
        f"{one.expression} = {compact(one.value, one.stderr)}"
        for one in (*result.combinations, *getattr(result, "products", ()))
    ]
    return [
        ", ".join(known),
        f"not identifiable: {', '.join(unseen)}" if unseen else "",
    ]


def row_of(
    head: str,
    name: str,
    item: Any,
    systematic: float | None = None,
    quantiles: Quantiles | None = None,
) -> dict[str, Any]:
    """Cells of a row of a table of estimates."""
    verdict = getattr(item, "verdict", Verdict.DETERMINED)
    value, stderr = "-", "-"
    if verdict != Verdict.NOT_IDENTIFIABLE:
        value, stderr = format_estimate(item.value, item.stderr)
    return {
        head: labelled(name, getattr(item, "unit", "")),
        ">estimate": value,
        ">std. error": stderr,
        ">systematic": None if systematic is None else f"{systematic:.2g}",
        "verdict": judged(verdict),
    } | of_posterior(quantiles)


def of_posterior(quantiles: Quantiles | None) -> dict[str, str]:
    """The cell of an interval of the posterior."""
    found = from_to(quantiles["16"], quantiles["84"]) if quantiles else ""
    return {"68 % of posterior": found}


def reported(result: Any) -> dict[str, tuple[float, float | None]]:
    """Value and standard error of coefficients, determined combinations and
    products."""
    found = {
        name: (item.value, item.stderr) for name, item in result.coefficients.items()
    }
    products = getattr(result, "products", ())
    return found | {
        item.expression: (item.value, item.stderr)
        for item in (*result.combinations, *products)
    }


def systematics(result: Any) -> str:
    """The largest systematic error of each coefficient or combination, and that due to
    the calibration of a camera, in sentences."""
    found, named, calibration = result.systematics, dict[str, list[str]](), []
    for name, (_, stderr) in reported(result).items():
        shifts = {
            condition: shift
            for condition, shift in found.shifts.get(name, {}).items()
            if not is_calibration(condition)
        }
        condition = max(shifts, key=lambda one: abs(shifts[one]), default="")
        shift, of_camera = (
            shifts.get(condition, 0.0),
            found.of_calibration.get(name, 0.0),
        )
        if stderr is not None and abs(shift) >= _NOTABLE * stderr and shift:
            off = f"{name} is {abs(shift):.2g} {'higher' if shift > 0 else 'lower'}"
            named.setdefault(condition, []).append(off)
        if stderr and of_camera >= _NOTABLE * stderr:
            calibration.append(f"{of_camera:.2g} to {name}")
    sentences = []
    if named:
        largest = "; ".join(
            f"{if_off(condition, found.widths[condition])}, "
            f"the true {join_words(parts)}"
            for condition, parts in named.items()
        )
        sentences.append(
            "Systematic errors come from conditions that the fit holds fixed; "
            f"the largest: {largest}. `--systematic` sets the standard uncertainties "
            "of the conditions; `--prior` or `--free` estimates them with "
            "the coefficients."
        )
    if calibration:
        sentences.append(
            f"The calibration of the camera contributes {join_words(calibration)}, "
            "according to the residual of its known points."
        )
    return " ".join(sentences)


def derived_table(items: Sequence[Derived]) -> PlainTable:
    """Derived quantities with their errors."""
    return PlainTable(
        (
            row_of("derived", one.expression, one, one.systematic, one.quantiles)
            for one in items
        ),
        "Derived quantities",
    )
