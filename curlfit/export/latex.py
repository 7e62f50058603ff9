"""The table of a paper, in LaTeX with booktabs."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from curlfit.export.tables import Row, rows_of
from curlfit.foreign import printable
from curlfit.output.console import PlainTable
from curlfit.output.text import compact, from_to
from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult

_SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "&": r"\&", "%": r"\%", "$": r"\$",
    "#": r"\#", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
}  # fmt: skip


def estimates_table(result: FitResult | JointResult) -> str:
    """Coefficients, initial state, combinations and derived quantities of a fit, as a `table` with
    `booktabs`: values with standard errors in units of the last digits."""
    rows = rows_of(result, in_words=True)
    posterior = getattr(result, "posterior", None)
    symbols = {row.name: _symbol(row) for row in rows if row.symbol}
    cells = (
        {
            "parameter": _label(row, symbols), "estimate": _estimate(row),
            "systematic": _rounded(row.systematic, ".2g"),
            r"68\,\% of posterior": _interval(posterior, row), "unit": _unit(row.unit),
        }
        for row in rows
    )  # fmt: skip
    return _drawn(PlainTable(cells, _caption(result)))


def candidates_table(comparison: Any) -> str:
    """The candidates of a comparison, as a `table` with `booktabs`."""
    sizes = {">$x$ (mm)": "x", ">$y$ (mm)": "y", r">$\varphi$ (mrad)": "phi"}
    follows = {True: "yes", False: "no", None: "unclear"}
    rows = (
        {
            "law": escaped(one.law + " (any sign)" * one.signs_free),
            "load": "--" if one.load == "-" else escaped(one.load),
            ">$k$": "" if one.n_parameters is None else f"{one.n_parameters:.0f}",
            r">$\Delta$BIC": _rounded(one.delta_bic, ".1f"),
            r">$\Delta$AICc": _rounded(one.delta_aicc, ".1f"),
            **{
                head: _rounded((one.residual_size or {}).get(name), ".3g", 1000)
                for head, name in sizes.items()
            },
            "follows": follows[one.follows] if one.converged else "no fit",
        }
        for one in comparison.candidates
    )  # fmt: skip
    caption = (
        f"Friction laws fitted to {_file(comparison.data['file'])}, by BIC: number of parameters "
        rf"$k$, rms of the residuals, and whether the law follows the path. {_software()}"
    )
    return _drawn(PlainTable(rows, caption))


def escaped(text: str) -> str:
    """Text with the special characters of TeX and control characters escaped."""
    return "".join(_SPECIAL.get(character, character) for character in printable(str(text)))


def _drawn(table: PlainTable) -> str:
    """A table whose caption and cells are LaTeX."""
    columns = table.columns
    lines = [
        [str(one.header) for one in columns],
        *zip(*(one.cells for one in columns), strict=True),
    ]
    head, *rows = ("    " + " & ".join(map(str, line)) + r" \\" for line in lines)
    sides = " ".join("r" if one.justify == "right" else "l" for one in columns)
    return "\n".join(
        [
            r"% needs \usepackage{booktabs}",
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{table.called}}}",
            rf"  \begin{{tabular}}{{@{{}}{sides}@{{}}}}",
            r"    \toprule",
            head,
            r"    \midrule",
            *rows,
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _rounded(value: float | None, digits: str, scale: float = 1) -> str:
    return "" if value is None else _number(f"{scale * value:{digits}}")


def _caption(result: FitResult | JointResult) -> str:
    throws = getattr(result, "throws", ())
    first: FitResult = throws[0] if throws else result  # type: ignore[assignment]
    what = (
        f"{len(throws)} throws together" if throws
        else f"{_file(first.data['file'])} ({first.data['rows']} rows)"
    )  # fmt: skip
    stone = first.stone
    text = (
        f"Estimates of the {escaped(result.law)} law under {escaped(result.load)} load, fitted to "
        f"{what}; stone $R = {stone.R:g}$\\,m, $\\rho = {stone.rho:g}$\\,m, $h = {stone.h:g}$\\,m, "
        f"$m = {stone.m:g}$\\,kg. Standard errors in parentheses, in units of the last digits"
    )
    if result.systematics.errors:
        text += "; systematic errors come from conditions that the fit holds fixed"
    if first.noise.kind != "white":
        text += f"; noise model {escaped(first.noise.kind)}"
    return f"{text}. {_software()}"


def _file(name: str) -> str:
    return escaped(re.split(r"[\\/]", name)[-1])


def _software() -> str:
    return f"Computed with curlfit {escaped(__version__)}."


def _symbol(row: Row) -> str:
    from curlfit.output.figures import math_symbol

    # The symbol of a coefficient without one is its name, upright.
    inner = re.fullmatch(r"\\mathrm\{(\w+)\}", row.symbol)
    return rf"\mathrm{{{escaped(inner[1])}}}" if inner else math_symbol(row.symbol)


def _label(row: Row, symbols: dict[str, str]) -> str:
    if row.name in symbols:
        return f"${symbols[row.name]}$"
    if row.weights:
        text = ""
        for name, weight in row.weights.items():
            sign = ("-" if weight < 0 else "") if not text else (" - " if weight < 0 else " + ")
            size = "" if abs(weight) == 1 else rf"{abs(weight):.4g}\,"
            text += f"{sign}{size}{symbols.get(name, escaped(name))}"
        return f"${text}$"
    return escaped(row.meaning) or _expression(row.name, symbols)


def _expression(text: str, symbols: dict[str, str]) -> str:
    """Sums, products and quotients of parameters in symbols; other expressions verbatim."""
    parts = re.split(r"(\w+)", text.replace(" ", ""))
    words, signs = parts[1::2], "".join(parts[::2])
    plain = all(word in symbols or re.fullmatch(r"\d+", word) for word in words)
    if not plain or "**" in signs or not set(signs) <= set("+-*/()"):
        return rf"\texttt{{{escaped(text)}}}"
    shown = (symbols.get(part, part).replace("*", r"\,") for part in parts)
    return f"${''.join(shown)}$"


def _estimate(row: Row) -> str:
    if row.value is None:
        return "not identifiable"
    text = _number(compact(row.value, row.stderr))
    note = {"fixed": "fixed", "at bound": "at bound", "weak": "weak", "prior": "with prior"}
    return text + (f" ({note[row.verdict]})" if row.verdict in note else "")


def _number(text: str) -> str:
    """A number as written by `compact`, in math mode."""
    text = text.replace("+-", r"\pm")
    text = re.sub(r"e([-+]?)0*(\d+)", lambda m: rf" \times 10^{{{m[1].strip('+')}{m[2]}}}", text)
    return f"${text}$"


def _interval(posterior: Any, row: Row) -> str:
    found = posterior and posterior.quantiles.get(row.name)
    if not found:
        return ""
    low, _, high = from_to(found["16"], found["84"]).partition(" .. ")
    return rf"{_number(low)} to {_number(high)}"


def _unit(unit: str) -> str:
    """A unit such as "rad/s^2", upright and with negative powers."""
    if unit in ("", "1"):
        return ""
    above, *below = unit.split("/")
    parts = [] if above == "1" else [rf"\mathrm{{{escaped(above)}}}"]
    for part in below:
        name, _, power = part.partition("^")
        parts.append(rf"\mathrm{{{escaped(name)}}}^{{-{escaped(power) or 1}}}")
    joined = r"\,".join(parts)
    return f"${joined}$" if parts else ""
