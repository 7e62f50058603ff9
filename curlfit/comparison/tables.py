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
    if value is None:
        return ""
    return f"{value:.1f}" if abs(value) < 1000 else f"{value:.0f}"


def summary(comparison: Comparison, first: str, more: str) -> dict[str, Any]:
    """Of a document: which law ranks first, and by how much; the `first` conclusion.
    `more` says how many laws are not named."""
    ranked = [
        candidate for candidate in comparison.candidates if candidate.rank is not None
    ]
    if not ranked:
        return {"finding": "no law is ranked", "lines": ["", first]}
    unsure = ", not reliably" if comparison.effective else ""
    order = ", ".join(
        f"{candidate.label} ({difference(candidate.delta_bic)})"
        for candidate in ranked[:_FIRST]
    )
    rest = more.format(len(ranked) - _FIRST) if len(ranked) > _FIRST else ""
    return {
        "finding": f"{ranked[0].label} ranks first{unsure}",
        "lines": [f"dBIC: {order}{rest}", first],
    }


def ranked_row(candidate: Candidate, noise: str = "") -> dict[str, Any]:
    """Cells of a candidate: its rank, law and load, and by what it is ranked."""
    sign = " any sign" if candidate.signs_free else ""
    parameters = candidate.n_parameters
    return {
        ">": "-" if candidate.rank is None else str(candidate.rank),
        "law": Text.assemble(candidate.law, (sign, "dim")),
        "load": candidate.load,
        "noise": noise,
        ">k": "" if parameters is None else f"{parameters:.3g}",
        ">dBIC": difference(candidate.delta_bic),
    }


def coefficients_table(comparison: Comparison) -> PlainTable:
    """What is known of the coefficients of each candidate."""
    return PlainTable(
        (
            {"law, load": candidate.label, "~coefficients": _coefficients(candidate)}
            for candidate in comparison.candidates
        ),
        "Coefficients of each law, with standard errors",
    )


def _coefficients(candidate: Candidate) -> Text | Items:
    """The coefficients of a candidate, side by side; its status where there is no
    fit, or none that converged."""
    status = Text(candidate.status, style="red")
    if candidate.coefficients is None:
        return status
    texts = []
    for name, coefficient in candidate.coefficients.items():
        verdict = coefficient["verdict"]
        if verdict == Verdict.NOT_IDENTIFIABLE:
            continue
        unit = "" if coefficient["unit"] == "1" else f" {coefficient['unit']}"
        value = compact(coefficient.value, coefficient.stderr)
        is_plain = verdict in (Verdict.DETERMINED, Verdict.FIXED)
        remark = "" if is_plain else f" {verdict}"
        texts.append(Text.assemble(f"{name} = {value}{unit}", (remark, STYLE[verdict])))
    for combination in candidate.combinations:
        value = compact(combination.value, combination.stderr)
        texts.append(Text(f"{combination['expression']} = {value}"))
    if candidate.not_identifiable:
        hidden = f"{join_words(candidate.not_identifiable)} not identifiable"
        texts.append(Text(hidden, style=STYLE["not identifiable"]))
    if not candidate.converged:
        texts.append(status)
    return Items(texts)
