"""Numbers and coefficients of candidates, as comparisons show them."""

from __future__ import annotations

from typing import Any

from rich.text import Text

from curlfit.comparison.result import Candidate, Comparison
from curlfit.inference.verdict import Verdict
from curlfit.output.console import Items, PlainTable
from curlfit.output.text import STYLE
from curlfit.wording import compact, join_words

_FIRST = 3  # laws named in a line


def difference(value: float | None) -> str:
    """A difference of a criterion; empty without one."""
    return (
        "" if value is None else f"{value:.1f}" if abs(value) < 1000 else f"{value:.0f}"
    )


def summary(comparison: Comparison, first: str, more: str) -> dict[str, Any]:
    """Of a document: which law ranks first, and by how much; the `first` conclusion.
    `more` says how many laws are not named."""
    ranked = [item for item in comparison.candidates if item.rank is not None]
    unsure = ", not reliably" if comparison.effective else ""
    order = ", ".join(
        f"{item.label} ({difference(item.delta_bic)})" for item in ranked[:_FIRST]
    )
    rest = more.format(len(ranked) - _FIRST) if len(ranked) > _FIRST else ""
    return {
        "finding": f"{ranked[0].label} ranks first{unsure}"
        if ranked
        else "no law is ranked",
        "lines": [f"dBIC: {order}{rest}" if ranked else "", first],
    }


def ranked_row(item: Candidate, noise: str = "") -> dict[str, Any]:
    """Cells of a candidate: its rank, law and load, and what that is by."""
    return {
        ">": "-" if item.rank is None else str(item.rank),
        "law": Text.assemble(item.law, (" any sign" * item.signs_free, "dim")),
        "load": item.load,
        "noise": noise,
        ">k": "" if item.n_parameters is None else f"{item.n_parameters:.3g}",
        ">dBIC": difference(item.delta_bic),
    }


def coefficients_table(comparison: Comparison) -> PlainTable:
    """What is known of the coefficients of each candidate."""
    return PlainTable(
        (
            {"law, load": item.label, "~coefficients": _said(item)}
            for item in comparison.candidates
        ),
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
        if verdict != Verdict.NOT_IDENTIFIABLE:
            shown = compact(found["value"], found["stderr"]) + (
                "" if unit == "1" else f" {unit}"
            )
            about = (
                "" if verdict in (Verdict.DETERMINED, Verdict.FIXED) else f" {verdict}"
            )
            said.append(Text.assemble(f"{name} = {shown}", (about, STYLE[verdict])))
    for one in item.combinations:
        said.append(
            Text(f"{one['expression']} = {compact(one['value'], one['stderr'])}")
        )
    if item.not_identifiable:
        hidden = f"{join_words(item.not_identifiable)} not identifiable"
        said.append(Text(hidden, style=STYLE["not identifiable"]))
    return Items(said if item.converged else [*said, status])
