"""Tables of candidates: their coefficients, for reports, and all that is known of them,
as CSV and in LaTeX."""

from __future__ import annotations

from rich.text import Text

from curlfit.comparison.candidate_columns import (
    COEFFICIENTS,
    DELTA_AICC,
    DELTA_BIC,
    FOLLOWS,
    IN_CSV,
    LABEL,
    LAW,
    LOAD,
    PARAMETERS,
    SIZE_PHI,
    SIZE_X,
    SIZE_Y,
)
from curlfit.comparison.result import Candidate, Comparison
from curlfit.inference.information.verdict import Verdict
from curlfit.output import latex
from curlfit.output.frames import csv_of
from curlfit.output.table import Column, Table
from curlfit.output.text import STYLE
from curlfit.wording import compact, join_words

_FIRST = 3  # laws named in a line


def finding(comparison: Comparison) -> str:
    """Which law ranks first."""
    ranked = _ranked(comparison)
    if not ranked:
        return "no law is ranked"
    unsure = ", not reliably" if comparison.effective else ""
    return f"{ranked[0].label} ranks first{unsure}"


def order_by_bic(comparison: Comparison, more: str) -> str:
    """The first laws with their differences of BIC, and `more`, which says how many are
    not named; empty if no law is ranked."""
    ranked = _ranked(comparison)
    if not ranked:
        return ""
    order = ", ".join(
        f"{candidate.label} ({DELTA_BIC.cell(candidate)})"
        for candidate in ranked[:_FIRST]
    )
    rest = more.format(len(ranked) - _FIRST) if len(ranked) > _FIRST else ""
    return f"dBIC: {order}{rest}"


def _ranked(comparison: Comparison) -> list[Candidate]:
    return [
        candidate for candidate in comparison.candidates if candidate.rank is not None
    ]


def coefficients_table(comparison: Comparison) -> Table[Candidate]:
    """What is known of the coefficients of each candidate."""
    in_words = COEFFICIENTS.but(words=_coefficients, wraps=True)
    return Table(
        comparison.candidates,
        (LABEL, in_words),
        "Coefficients of each law, with standard errors",
    )


def _coefficients(candidate: Candidate) -> Text | tuple[Text, ...]:
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
    return tuple(texts)


def candidates_csv(comparison: Comparison) -> str:
    """The candidates of a comparison, best first; the coefficients of each
    in one cell."""
    return csv_of(Table(comparison.candidates, IN_CSV))


def candidates_table(comparison: Comparison) -> str:
    """The candidates of a comparison, in LaTeX."""
    columns = (
        LAW.but(words=_law_in_latex),
        LOAD.but(format=_load_in_latex),
        PARAMETERS.but(heading="$k$", format=".0f"),
        _in_math(DELTA_BIC.but(format=".1f"), r"$\Delta$BIC"),
        _in_math(DELTA_AICC.but(format=".1f"), r"$\Delta$AICc"),
        _in_math(SIZE_X, "$x$"),
        _in_math(SIZE_Y, "$y$"),
        _in_math(SIZE_PHI, r"$\varphi$"),
        FOLLOWS.but(words=_follows_in_latex),
    )
    caption = (
        f"Friction laws fitted to {latex.file_name(comparison.data.file)}, by BIC: "
        "number of parameters $k$, rms of the residuals, and whether the law follows "
        f"the path. {latex.made_with()}"
    )
    return latex.latex_of(Table(comparison.candidates, columns, caption))


def _law_in_latex(candidate: Candidate) -> str:
    """The law, and whether its coefficients may have any sign."""
    sign = " (any sign)" if candidate.signs_free else ""
    return latex.escaped(candidate.law + sign)


def _load_in_latex(load: str) -> str:
    """The load; a dash for a law without a ring."""
    return "--" if load == "-" else latex.escaped(load)


def _follows_in_latex(candidate: Candidate) -> str:
    """Whether a law follows the path."""
    if not candidate.converged:
        return "no fit"
    if candidate.follows is None:
        return "unclear"
    return "yes" if candidate.follows else "no"


def _in_math(column: Column[Candidate], heading: str) -> Column[Candidate]:
    """A column with its numbers in math mode."""

    def in_math(candidate: Candidate) -> str:
        number = str(column.cell(candidate))
        return latex.number(number) if number else ""

    return column.but(heading=heading, words=in_math)
