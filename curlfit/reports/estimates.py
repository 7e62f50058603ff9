"""Lines and tables of estimates, of fits and joint fits alike."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from curlfit.inference.conditions import CALIBRATION, if_off
from curlfit.inference.derived import Derived, scaled, to_its_side
from curlfit.output.console import PlainTable
from curlfit.output.document import Said
from curlfit.output.text import (
    capital,
    compact,
    format_estimate,
    from_to,
    join_words,
    judged,
    labelled,
)
from curlfit.sheet import FOOT

if TYPE_CHECKING:
    from curlfit.inference.fit.result import Estimate, Systematics
    from curlfit.inference.identifiability import Combination

_NOTABLE = 0.1  # systematic shift that is reported, over the standard error


def status_line(result: Any) -> Said:
    """Whether a fit, of one throw or several, converged, as a line."""
    return Said(capital(result.status), style=style_of(result))


def caution(result: Any) -> Said:
    """What the warnings of a fit that may be used are about, in a line."""
    if not result.converged:
        return Said("")
    of_throws = dict.fromkeys(
        one for throw in getattr(result, "throws", ()) for one in throw.warnings
    )
    own = [one for one in result.warnings if not one.endswith(tuple(of_throws))]
    about = dict.fromkeys(re.split(r" \(|[;:,] ", one)[0] for one in (*own, *of_throws))
    return Said(f"Caution: {'; '.join(about)}." if about else "No warnings.")


def style_of(result: Any) -> str:
    """The style of the status of a fit."""
    return "green" if result.converged else "bold red"


def lines_of(result: Any) -> list[str]:
    """Coefficients and determined combinations in a line, and what is not identifiable."""
    unseen = [
        name for name, item in result.coefficients.items() if item.verdict == "not identifiable"
    ]
    known = [
        f"{name} = {compact(item.value, item.stderr)}"
        + ("" if item.verdict == "determined" else f" ({item.verdict})")
        for name, item in result.coefficients.items()
        if name not in unseen
    ]
    known += [f"{one.expression} = {compact(one.value, one.stderr)}" for one in result.combinations]
    return [", ".join(known), f"not identifiable: {', '.join(unseen)}" if unseen else ""]


def estimate_cells(
    name: str, item: Estimate | Combination, systematics: Systematics, head: str = "parameter"
) -> dict[str, Any]:
    """Cells of a row of a table of estimates."""
    verdict, error = getattr(item, "verdict", "determined"), systematics.errors.get(name)
    cells = _cells(head, name, item, getattr(item, "unit", ""), error)
    return cells | {"verdict": judged(verdict)}


def _cells(head: str, name: str, item: Any, unit: str, error: float | None) -> dict[str, Any]:
    """An estimate with its standard and systematic errors."""
    hidden = getattr(item, "verdict", "") == "not identifiable"
    value, stderr = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
    return {
        head: labelled(name, unit), ">estimate": value, ">std. error": stderr,
        ">systematic": None if error is None else f"{error:.2g}",
    }  # fmt: skip


def reported(result: Any) -> dict[str, tuple[float, float | None]]:
    """Value and standard error of coefficients and determined combinations."""
    found = {name: (item.value, item.stderr) for name, item in result.coefficients.items()}
    return found | {item.expression: (item.value, item.stderr) for item in result.combinations}


def systematics(result: Any) -> str:
    """The largest systematic error of each coefficient or combination, and that due to the
    calibration of a camera, in sentences."""
    found, named = result.systematics, dict[str, list[str]]()
    for name, (_, stderr) in reported(result).items():
        shifts = {
            condition: shift
            for condition, shift in found.shifts.get(name, {}).items()
            if not condition.startswith(CALIBRATION)
        }
        condition = max(shifts, key=lambda one: abs(shifts[one]), default="")
        size = abs(shifts.get(condition, 0.0))
        if stderr is None or size < _NOTABLE * stderr:
            continue
        verb = "higher" if shifts[condition] > 0 else "lower"
        named.setdefault(condition, []).append(f"{name} is {size:.2g} {verb}")
    text = ""
    if named:
        sentences = [
            f"{if_off(condition, found.widths[condition])}, the true {join_words(parts)}"
            for condition, parts in named.items()
        ]
        text = (
            "Systematic errors come from conditions that the fit holds fixed; the largest: "
            + "; ".join(sentences)
            + ". `--systematic` sets the standard uncertainties of the conditions; `--prior` or "
            "`--free` estimates them with the coefficients. "
        )
    calibration = [
        f"{found.of_calibration.get(name, 0.0):.2g} to {name}"
        for name, (_, stderr) in reported(result).items()
        if stderr and found.of_calibration.get(name, 0.0) >= _NOTABLE * stderr
    ]
    if calibration:
        text += (
            f"The calibration of the camera contributes {join_words(calibration)}, according to "
            "the residual of its known points."
        )
    return text.strip()


def derived_table(items: Sequence[Derived]) -> PlainTable:
    """Derived quantities with their errors."""
    return PlainTable(
        (_derived_row("derived", item) | {"verdict": judged(item.verdict)} | _quantiles(item)
         for item in items),
        "Derived quantities",
    )  # fmt: skip


def quantities_table(quantities: Mapping[str, Derived], *, discrepancy: bool) -> PlainTable:
    """Quantities of the fitted path within the record, or of that of the law without the model
    discrepancy."""
    path = "path of the law" if discrepancy else "fitted path"
    rows = []
    for name, item in quantities.items():
        item = to_its_side(item)
        rows.append(item)
        if name == "curl":
            rows.append(scaled(replace(item, unit="ft"), 1 / FOOT))
    return PlainTable(
        (_derived_row(f"along the {path}", item) | _quantiles(item) for item in rows),
        f"Along the {path}" + ", without the discrepancy" * discrepancy,
    )


def draw_text(quantities: Mapping[str, Derived]) -> str:
    """Time and curl of a draw, as curlers state them."""
    if not {"draw_time", "curl"} <= quantities.keys():
        return ""
    time, curl = quantities["draw_time"].value, abs(quantities["curl"].value) / FOOT
    return f"{time:.1f} s / {curl:.1f} ft: time of the draw from the near hog line, and its curl."


def quantities_line(quantities: Mapping[str, Derived]) -> str:
    """The main quantities of the path in one line."""
    parts = []
    for name in ("friction", "curl", "turns", "hog_to_hog"):
        if name not in quantities:
            continue
        item = quantities[name]
        one = to_its_side(item)
        unit = "" if item.unit in ("", "1") else f" {item.unit}"
        parts.append(f"{one.meaning.partition(',')[0]} {compact(one.value, one.stderr)}{unit}")
    return ", ".join(parts)


def _derived_row(head: str, item: Derived) -> dict[str, Any]:
    return _cells(head, item.meaning or item.expression, item, item.unit, item.systematic)


def _quantiles(item: Derived) -> dict[str, str]:
    found = item.quantiles
    return {"68 % of posterior": from_to(found["16"], found["84"]) if found else ""}
