"""Estimates and the path with its residuals as CSV; estimates as the table of a paper,
in LaTeX."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from curlfit.foreign import counted, csv_lines
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.derived.quantity import Derived, to_its_side
from curlfit.inference.fit.estimate_columns import (
    DOF,
    HIGH,
    LOW,
    NAME,
    POSTERIOR,
    PRIOR,
    STDERR,
    SYSTEMATIC,
    UNIT,
    VALUE,
    VERDICT,
    EstimateRow,
)
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.verdict import Verdict
from curlfit.output import latex
from curlfit.output.frames import csv_of
from curlfit.output.table import Table
from curlfit.wording import compact, rounded_ends

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.together.result import JointResult


def rows_of(
    result: FitResult | JointResult, *, in_words: bool = False
) -> list[EstimateRow]:
    """Coefficients first, then determined combinations, other parameters and
    derived quantities.

    With `in_words`, quantities of the path are positive, their meaning names the side.
    """
    coefficients = result.coefficients
    estimates: dict[str, Any] = dict(coefficients)
    for combination in result.combinations:
        estimates[combination.expression] = combination
    for name, parameter in getattr(result, "parameters", {}).items():
        if name not in coefficients:
            estimates[name] = parameter
    for derived in result.all_derived:
        estimates[derived.expression] = derived
    for name, quantity in getattr(result, "quantities", {}).items():
        estimates[name] = to_its_side(quantity) if in_words else quantity
    errors = result.systematics.errors
    return [
        EstimateRow.of(name, estimate, errors.get(name))
        for name, estimate in estimates.items()
    ]


_IN_CSV = (
    NAME,
    VALUE,
    STDERR,
    SYSTEMATIC,
    LOW,
    HIGH,
    DOF,
    VERDICT,
    UNIT,
    PRIOR,
)


def parameters_csv(result: FitResult | JointResult) -> str:
    """The estimates of a fit as CSV in SI units, one per row; empty cells where a
    number is not determined. For a joint fit with the parameters of each throw; the
    first column names the throw.
    """
    rows = rows_of(result)
    throws: Sequence[FitResult] = getattr(result, "throws", ())
    if not throws:
        return csv_of(Table(rows, _IN_CSV))
    shared = {row.name for row in rows}
    rows_by_throw = [("all", row) for row in rows]
    for fit in throws:
        for row in rows_of(fit):
            if row.name not in shared:
                rows_by_throw.append((fit.data.file, row))
    lines = [["throw", *(column.name for column in _IN_CSV)]]
    for throw, row in rows_by_throw:
        lines.append([throw, *(column.get(row) for column in _IN_CSV)])
    return csv_lines(lines)


def path_csv(fits: Sequence[FitResult]) -> str:
    """Measured value, fitted value and residual of each measured channel (SI, rad), one
    row per time; for several throws the first column names the throw."""
    channels = list(
        dict.fromkeys(name for fit in fits for name in fit.rms if name in fit.fitted)
    )
    several = len(fits) > 1
    header = ["throw", "t"] if several else ["t"]
    for name in channels:
        header += [name, f"{name}_fitted", f"{name}_residual"]
    lines: list[Sequence[Any]] = [header]
    for fit in fits:
        times = fit.observed["t"]
        not_measured = np.full(len(times), math.nan)
        series = [times]
        for name in channels:
            observed = fit.observed.get(name, not_measured)
            fitted = fit.fitted.get(name, not_measured)
            series += [observed, fitted, observed - fitted]
        label = [fit.data.file] if several else []
        for numbers in np.column_stack(series).tolist():
            lines.append([*label, *numbers])
    return csv_lines(lines)


def estimates_table(result: FitResult | JointResult) -> str:
    """Coefficients, initial state, combinations and derived quantities of a fit, in
    LaTeX: values with standard errors in units of the last digits."""
    rows = rows_of(result, in_words=True)
    symbols = {
        row.name: _symbol(row.estimate.symbol)
        for row in rows
        if isinstance(row.estimate, Estimate) and row.estimate.symbol
    }
    posterior = getattr(result, "posterior", None)
    quantiles: Mapping[str, Quantiles] = {}
    if posterior is not None and posterior.converged:
        quantiles = posterior.quantiles
    columns = (
        NAME.but(words=lambda row: _label(row, symbols)),
        VALUE.but(words=_estimate, right=False),
        SYSTEMATIC.but(
            format=lambda error: latex.number(f"{error:.2g}"), missing="", right=False
        ),
        POSTERIOR.but(
            heading=r"68\,\% of posterior",
            value=lambda row: quantiles.get(row.name),
            format=_interval,
            missing="",
        ),
        UNIT.but(format=_unit),
    )
    return latex.latex_of(Table(rows, columns, _caption(result)))


def _caption(result: FitResult | JointResult) -> str:
    """What was fitted to which data with which stone."""
    fits: Sequence[Any] = getattr(result, "throws", (result,))
    if result.kind == "joint":
        data = f"{cast('JointResult', result).count} throws together"
    else:
        file = latex.file_name(fits[0].data.file)
        data = f"{file} ({counted(fits[0].data.rows, 'row')})"
    law = latex.escaped(result.law)
    load = latex.escaped(result.load)
    stone = result.stone
    text = (
        f"Estimates of the {law} law under {load} load, fitted to {data}; "
        f"stone $R = {stone.R:g}$\\,m, $\\rho = {stone.rho:g}$\\,m, "
        f"$h = {stone.h:g}$\\,m, $m = {stone.m:g}$\\,kg. "
        "Standard errors in parentheses, in units of the last digits"
    )
    if result.systematics.errors:
        text += "; systematic errors come from conditions that the fit holds fixed"
    if fits and not fits[0].noise.is_white:
        text += f"; noise model {latex.escaped(fits[0].noise.kind)}"
    return f"{text}. {latex.made_with()}"


def _symbol(symbol: str) -> str:
    """The symbol of a parameter for math mode of LaTeX."""
    from curlfit.output.figures import math_symbol

    # The symbol of a coefficient without one is its name, upright.
    inner = re.fullmatch(r"\\mathrm\{(\w+)\}", symbol)
    return rf"\mathrm{{{latex.escaped(inner[1])}}}" if inner else math_symbol(symbol)


def _label(row: EstimateRow, symbols: dict[str, str]) -> str:
    """What a row is of: a symbol, a sum of symbols, words or an expression."""
    estimate = row.estimate
    if row.name in symbols:
        return f"${symbols[row.name]}$"
    if isinstance(estimate, Combination):
        return f"${_sum(estimate.weights, symbols)}$"
    # of quantities of the path, which have units
    if isinstance(estimate, Derived) and estimate.unit and estimate.meaning:
        return latex.escaped(estimate.meaning)
    return _expression(row.name, symbols)


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
        text += symbols.get(name, latex.escaped(name))
    return text


def _expression(text: str, symbols: dict[str, str]) -> str:
    """Sums, products and quotients of parameters in symbols; other
    expressions verbatim."""
    parts = re.split(r"(\w+)", text.replace(" ", ""))
    words = parts[1::2]
    signs = "".join(parts[::2])
    has_symbols = all(word in symbols or re.fullmatch(r"\d+", word) for word in words)
    if not has_symbols or "**" in signs or not set(signs) <= set("+-*/()"):
        return rf"\texttt{{{latex.escaped(text)}}}"
    formula = "".join(symbols.get(part, part) for part in parts).replace("*", r"\,")
    return f"${formula}$"


def _estimate(row: EstimateRow) -> str:
    """A value with its standard error, and its verdict unless it is determined."""
    if row.value is None:
        return "not identifiable"
    text = latex.number(compact(row.value, row.estimate.stderr))
    verdict = row.estimate.verdict
    if verdict == Verdict.DETERMINED:
        return text
    return f"{text} ({'with prior' if verdict == Verdict.PRIOR else verdict})"


def _interval(quantiles: Quantiles) -> str:
    """The interval that holds 68 % of the posterior."""
    low, high = rounded_ends(quantiles["16"], quantiles["84"])
    return rf"{latex.number(low)} to {latex.number(high)}"


def _unit(unit: str) -> str:
    """A unit such as "rad/s^2", upright and with negative powers."""
    if unit in ("", "1"):
        return ""
    above, *below = unit.split("/")
    parts = [] if above == "1" else [rf"\mathrm{{{latex.escaped(above)}}}"]
    for part in below:
        name, _, power = part.partition("^")
        parts.append(
            rf"\mathrm{{{latex.escaped(name)}}}^{{-{latex.escaped(power) or 1}}}"
        )
    joined = r"\,".join(parts)
    return f"${joined}$" if parts else ""
