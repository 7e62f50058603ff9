"""Numbers and coefficients of candidates, as comparisons show them."""

from __future__ import annotations

from rich.text import Text

from curlfit.comparison.result import Candidate, Comparison
from curlfit.output.console import Items, PlainTable
from curlfit.output.text import STYLE, compact, join_words


def difference(value: float | None) -> str:
    """A difference of a criterion; empty without one."""
    return "" if value is None else f"{value:.1f}" if abs(value) < 1000 else f"{value:.0f}"


def coefficients_table(comparison: Comparison) -> PlainTable:
    """What is known of the coefficients of each candidate."""
    return PlainTable(
        ({"law, load": item.label, "~coefficients": _said(item)} for item in comparison.candidates),
        "Coefficients of each law, with standard errors",
    )


def _said(item: Candidate) -> Text | Items:
    """The coefficients of a candidate, side by side."""
    status = Text(item.status, style="red")
    if item.coefficients is None:
        return status
    said = []
    for name, found in item.coefficients.items():
        verdict, unit = found["verdict"], found["unit"]
        if verdict != "not identifiable":
            shown = compact(found["value"], found["stderr"]) + ("" if unit == "1" else f" {unit}")
            about = "" if verdict in ("determined", "fixed") else f" {verdict}"
            said.append(Text.assemble(f"{name} = {shown}", (about, STYLE[verdict])))
    for one in item.combinations:
        said.append(Text(f"{one['expression']} = {compact(one['value'], one['stderr'])}"))
    if item.not_identifiable:
        hidden = f"{join_words(item.not_identifiable)} not identifiable"
        said.append(Text(hidden, style=STYLE["not identifiable"]))
    return Items(said if item.converged else [*said, status])
