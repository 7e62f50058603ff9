"""Tables: estimates, the path with its residuals and candidates of a comparison as CSV;
estimates and candidates as the table of a paper, in LaTeX with booktabs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from curlfit.foreign import counted, csv_lines, printable
from curlfit.inference.derived import Derived, to_its_side
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.identifiability import Combination
from curlfit.inference.verdict import Verdict
from curlfit.output.console import PlainTable
from curlfit.version import __version__
from curlfit.wording import compact, from_to

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
_CANDIDATE = (
    "rank",
    "law",
    "load",
    "signs_free",
    "converged",
    "n_parameters",
    "bic",
    "delta_bic",
    "aicc",
    "delta_aicc",
    "log_evidence",
    "delta_evidence",
    "weight",
    "curl_explained",
    "follows",
)


_ESTIMATE = (
    "name",
    "value",
    "stderr",
    "systematic",
    "low_95",
    "high_95",
    "dof",
    "verdict",
    "unit",
    "prior",
)


class Row(NamedTuple):
    """An estimate, a determined combination or a derived quantity, and its cells in a
    CSV table, by their headings."""

    item: Estimate | Combination | Derived
    cells: dict[str, Any]


def rows_of(result: FitResult | JointResult, *, in_words: bool = False) -> list[Row]:
    """Coefficients first, then determined combinations, other parameters and
    derived quantities.

    With `in_words`, quantities of the path are positive, their meaning names the side.
    """
    coefficients = result.coefficients
    parameters = getattr(result, "parameters", {})
    if not isinstance(parameters, dict):  # a joint fit has their number there
        parameters = {}
    quantities = getattr(result, "quantities", {})
    if in_words:
        quantities = {name: to_its_side(item) for name, item in quantities.items()}
    everything: dict[str, Estimate | Combination | Derived] = {
        **coefficients,
        **{item.expression: item for item in result.combinations},
        **{name: item for name, item in parameters.items() if name not in coefficients},
        **{item.expression: item for item in result.all_derived},
        **quantities,
    }
    rows = []
    for name, item in everything.items():
        value = None if item.verdict == Verdict.NOT_IDENTIFIABLE else item.value
        systematic = result.systematics.errors.get(name)
        if isinstance(item, Derived):
            systematic = item.systematic
        low, high = item.interval() or (None, None)
        cells = {
            "name": name,
            "value": value,
            "stderr": item.stderr,
            "systematic": systematic,
            "low_95": low,
            "high_95": high,
            "dof": item.dof,
            "verdict": item.verdict,
            "unit": "" if isinstance(item, Combination) else item.unit,
            "prior": item.prior if isinstance(item, Estimate) else "",
        }
        rows.append(Row(item, cells))
    return rows


def parameters_csv(result: FitResult | JointResult) -> str:
    """The estimates of a fit as CSV in SI units, one per row; empty cells where a
    number is not determined. For a joint fit with the parameters of each throw; the
    first column names the throw.
    """
    throws: Sequence[FitResult] = getattr(result, "throws", ())
    rows = rows_of(result)
    if not throws:
        return csv_lines([_ESTIMATE, *([*row.cells.values()] for row in rows)])
    lines = [("all", *row.cells.values()) for row in rows]
    shared = {row.cells["name"] for row in rows}
    for fit in throws:
        for row in rows_of(fit):
            if row.cells["name"] not in shared:
                lines.append((fit.data.file, *row.cells.values()))
    return csv_lines([("throw", *_ESTIMATE), *lines])


def path_csv(fits: Sequence[FitResult]) -> str:
    """Measured value, fitted value and residual of each measured channel (SI, rad), one
    row per time; for several throws the first column names the throw."""
    measured = [name for fit in fits for name in fit.rms if name in fit.fitted]
    channels = list(dict.fromkeys(measured))
    several = len(fits) > 1
    head = ["throw", "t"] if several else ["t"]
    for name in channels:
        head += [name, f"{name}_fitted", f"{name}_residual"]
    lines: list[Sequence[Any]] = [head]
    for fit in fits:
        columns = [fit.observed["t"]]
        empty = math.nan * fit.observed["t"]
        for name in channels:
            observed = fit.observed.get(name, empty)
            fitted = fit.fitted.get(name, empty)
            columns += [observed, fitted, observed - fitted]
        label = [fit.data.file] if several else []
        lines += [[*label, *row] for row in np.column_stack(columns).tolist()]
    return csv_lines(lines)


def candidates_csv(comparison: Any) -> str:
    """The candidates of a comparison, best first; the coefficients of each
    in one cell."""
    lines = [(*_CANDIDATE, "rms_x", "rms_y", "rms_phi", "coefficients")]
    for candidate in comparison.candidates:
        cells = [getattr(candidate, name) for name in _CANDIDATE]
        rms = candidate.rms or {}
        cells += [rms.get(name) for name in ("x", "y", "phi")]
        coefficients = [
            f"{name} = {item['value']:.6g}"
            for name, item in (candidate.coefficients or {}).items()
        ]
        lines.append((*cells, "; ".join(coefficients)))
    return csv_lines(lines)


def estimates_table(result: FitResult | JointResult) -> str:
    """Coefficients, initial state, combinations and derived quantities of a fit, as a
    `table` with `booktabs`: values with standard errors in units of the last digits."""
    rows = rows_of(result, in_words=True)
    posterior = getattr(result, "posterior", None)
    symbols = {
        row.cells["name"]: _symbol(row.item.symbol)
        for row in rows
        if isinstance(row.item, Estimate) and row.item.symbol
    }
    cells = (
        {
            "parameter": _label(row, symbols),
            "estimate": _estimate(row),
            "systematic": _rounded(row.cells["systematic"], ".2g"),
            r"68\,\% of posterior": _interval(posterior, row),
            "unit": _unit(row.cells["unit"]),
        }
        for row in rows
    )
    return _drawn(PlainTable(cells, _caption(result)))


def candidates_table(comparison: Any) -> str:
    """The candidates of a comparison, as a `table` with `booktabs`."""
    sizes = {">$x$ (mm)": "x", ">$y$ (mm)": "y", r">$\varphi$ (mrad)": "phi"}
    follows = {True: "yes", False: "no", None: "unclear"}
    rows = []
    for candidate in comparison.candidates:
        sign = " (any sign)" if candidate.signs_free else ""
        number = candidate.n_parameters
        residuals = candidate.residual_size
        row = {
            "law": escaped(candidate.law + sign),
            "load": "--" if candidate.load == "-" else escaped(candidate.load),
            ">$k$": "" if number is None else f"{number:.0f}",
            r">$\Delta$BIC": _rounded(candidate.delta_bic, ".1f"),
            r">$\Delta$AICc": _rounded(candidate.delta_aicc, ".1f"),
        }
        for head, name in sizes.items():
            row[head] = _rounded(residuals.get(name), ".3g", 1000)
        row["follows"] = follows[candidate.follows] if candidate.converged else "no fit"
        rows.append(row)
    caption = (
        f"Friction laws fitted to {_file(comparison.data.file)}, by BIC: "
        "number of parameters $k$, rms of the residuals, and whether the law follows "
        f"the path. {_software()}"
    )
    return _drawn(PlainTable(rows, caption))


def escaped(text: str) -> str:
    """Text with the special characters of TeX and control characters escaped."""
    return "".join(
        _SPECIAL.get(character, character) for character in printable(str(text))
    )


def _drawn(table: PlainTable) -> str:
    """A table whose caption and cells are LaTeX, by the template `table.tex.in`."""
    columns = [[str(column.header), *column.cells] for column in table.columns]
    lines = [
        "    " + " & ".join(map(str, line)) + r" \\"
        for line in zip(*columns, strict=True)
    ]
    head, *rows = lines
    sides = " ".join(
        "r" if column.justify == "right" else "l" for column in table.columns
    )
    text = Path(__file__).with_name("table.tex.in").read_text(encoding="utf-8")
    return Template(text).substitute(
        caption=table.called, sides=sides, head=head, rows="\n".join(rows)
    )


def _rounded(value: float | None, digits: str, scale: float = 1) -> str:
    return "" if value is None else _number(f"{scale * value:{digits}}")


def _caption(result: FitResult | JointResult) -> str:
    fits: Sequence[Any] = getattr(result, "throws", (result,))
    if result.kind == "joint":
        what = f"{cast('JointResult', result).count} throws together"
    else:
        what = f"{_file(fits[0].data.file)} ({counted(fits[0].data.rows, 'row')})"
    stone = result.stone
    text = (
        f"Estimates of the {escaped(result.law)} law under "
        f"{escaped(result.load)} load, fitted to {what}; stone $R = {stone.R:g}$\\,m, "
        f"$\\rho = {stone.rho:g}$\\,m, $h = {stone.h:g}$\\,m, $m = {stone.m:g}$\\,kg. "
        "Standard errors in parentheses, in units of the last digits"
    )
    if result.systematics.errors:
        text += "; systematic errors come from conditions that the fit holds fixed"
    if fits and not fits[0].noise.is_white:
        text += f"; noise model {escaped(fits[0].noise.kind)}"
    return f"{text}. {_software()}"


def _file(name: str) -> str:
    return escaped(re.split(r"[\\/]", name)[-1])


def _software() -> str:
    return f"Computed with curlfit {escaped(__version__)}."


def _symbol(symbol: str) -> str:
    from curlfit.output.figures import math_symbol

    # The symbol of a coefficient without one is its name, upright.
    inner = re.fullmatch(r"\\mathrm\{(\w+)\}", symbol)
    return rf"\mathrm{{{escaped(inner[1])}}}" if inner else math_symbol(symbol)


def _label(row: Row, symbols: dict[str, str]) -> str:
    name = row.cells["name"]
    item = row.item
    if name in symbols:
        return f"${symbols[name]}$"
    if isinstance(item, Combination):
        return f"${_sum(item.weights, symbols)}$"
    # of quantities of the path, which have units
    meaning = item.meaning if isinstance(item, Derived) and item.unit else ""
    return escaped(meaning) or _expression(name, symbols)


def _sum(weights: Mapping[str, float], symbols: dict[str, str]) -> str:
    """A weighted sum of parameters, in symbols."""
    text = ""
    for name, weight in weights.items():
        if text:
            text += " - " if weight < 0 else " + "
        elif weight < 0:
            text = "-"
        if abs(weight) != 1:
            text += rf"{abs(weight):.4g}\,"
        text += symbols.get(name, escaped(name))
    return text


def _expression(text: str, symbols: dict[str, str]) -> str:
    """Sums, products and quotients of parameters in symbols; other
    expressions verbatim."""
    parts = re.split(r"(\w+)", text.replace(" ", ""))
    words = parts[1::2]
    signs = "".join(parts[::2])
    plain = all(word in symbols or re.fullmatch(r"\d+", word) for word in words)
    if not plain or "**" in signs or not set(signs) <= set("+-*/()"):
        return rf"\texttt{{{escaped(text)}}}"
    shown = (symbols.get(part, part).replace("*", r"\,") for part in parts)
    return f"${''.join(shown)}$"


def _estimate(row: Row) -> str:
    verdict = row.cells["verdict"]
    if row.cells["value"] is None:
        return "not identifiable"
    text = _number(compact(row.item.value, row.item.stderr))
    if verdict == Verdict.DETERMINED:
        return text
    return f"{text} ({'with prior' if verdict == Verdict.PRIOR else verdict})"


def _number(text: str) -> str:
    """A number as written by `compact`, in math mode."""
    text = text.replace("+-", r"\pm")
    text = re.sub(
        r"e([-+]?)0*(\d+)", lambda m: rf" \times 10^{{{m[1].strip('+')}{m[2]}}}", text
    )
    return f"${text}$"


def _interval(posterior: Any, row: Row) -> str:
    if posterior is None or not posterior.converged:
        return ""
    quantiles = posterior.quantiles.get(row.cells["name"])
    if not quantiles:
        return ""
    low, _, high = from_to(quantiles["16"], quantiles["84"]).partition(" .. ")
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
