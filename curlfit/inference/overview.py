"""Fits and posteriors at a glance, for `repr` and notebooks. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.text import Text

from curlfit.inference.derived_report import derived_table, quantities_line, quantities_table
from curlfit.inference.fit.result import FitResult, Posterior
from curlfit.inference.joint.result import JointResult
from curlfit.inference.report import about_posterior, identifiability
from curlfit.output.display import Overview
from curlfit.output.text import STYLE, compact, from_to, plain_table

if TYPE_CHECKING:
    from curlfit.inference.fit.result import Estimate, Systematics
    from curlfit.inference.identifiability import Combination


@singledispatch
def overview(result: Any) -> Overview:
    """A fit, of one throw or several, or a posterior at a glance."""
    raise TypeError(type(result).__name__)


@overview.register
def _(fit: FitResult) -> Overview:
    loss = "" if fit.loss == "linear" else f", {fit.loss} loss"
    noise = "" if fit.noise.kind == "white" else f", {fit.noise.kind} noise"
    parts: list[RenderableType] = [
        table_of(fit.parameters, fit.combinations, fit.systematics, len(fit.coefficients)),
        *derived_table(fit.derived),
        *quantities_table(fit.quantities, discrepancy=bool(fit.noise.sizes)),
        Text(identifiability(fit)),
    ]
    if fit.posterior is not None:
        parts.append(about_posterior(fit.posterior))
    return Overview(
        _uncapitalized(fit.status),
        f"{fit.law} law, {fit.load} load{loss}{noise}, fitted to {fit.data['file']}",
        [*_lines(fit.coefficients, fit.combinations), quantities_line(fit.quantities)],
        parts,
        fit.warnings,
        style="green" if fit.converged else "bold red",
    )


@overview.register
def _(joint: JointResult) -> Overview:
    table = table_of(joint.coefficients, joint.combinations, joint.systematics)
    differing = [item.expression for item in joint.differences if item.significant]
    said = f"Differs between throws: {', '.join(differing)}." if differing else ""
    determined = f"The throws determine {joint.rank} of {joint.parameters} parameters."
    return Overview(
        _uncapitalized(joint.status),
        f"{joint.law} law, {joint.load} load, {len(joint.throws)} throws together",
        [*_lines(joint.coefficients, joint.combinations), said],
        [table, f"{determined} {said}"],
        joint.warnings,
        style="green" if joint.converged else "bold red",
    )


@overview.register
def _(posterior: Posterior) -> Overview:
    table = plain_table()
    for head in ("quantity", "68 %", "95 %"):
        table.add_column(head, justify="left" if head == "quantity" else "right")
    spans = (("16", "84"), ("2.5", "97.5"))
    for name, found in posterior.quantiles.items():
        size = (found["84"] - found["16"]) / 3
        table.add_row(name, *(from_to(found[low], found[high], size) for low, high in spans))
    said = about_posterior(posterior).plain.partition("; ")[2]
    return Overview(
        posterior.status,
        f"{len(posterior.ess)} parameters",
        [said],
        [table, said],
        style="green" if posterior.converged else "bold yellow",
    )


def _uncapitalized(status: str) -> str:
    return status[:1].lower() + status[1:]


def _lines(coefficients: Mapping[str, Estimate], combinations: Sequence[Combination]) -> list[str]:
    """Coefficients and determined combinations, and what is not identifiable."""
    unseen = [name for name, item in coefficients.items() if item.verdict == "not identifiable"]
    known = [
        f"{name} = {compact(item.value, item.stderr)}{_remark(item.verdict)}"
        for name, item in coefficients.items()
        if name not in unseen
    ]
    known += [f"{item.expression} = {compact(item.value, item.stderr)}" for item in combinations]
    hidden = f"not identifiable: {', '.join(unseen)}" if unseen else ""
    return [", ".join(known), hidden]


def _remark(verdict: str) -> str:
    return "" if verdict == "determined" else f" ({verdict})"


def table_of(
    parameters: Mapping[str, Estimate],
    combinations: Sequence[Combination],
    systematics: Systematics,
    place: int | None = None,
) -> Any:
    """A table of estimates with their standard errors in parentheses.

    Parameters
    ----------
    place : the row before which the combinations are inserted; the end if None.
    """
    table, errors = plain_table(), systematics.errors
    table.add_column("parameter")
    table.add_column("estimate", justify="right")
    if errors:
        table.add_column("systematic", justify="right")
    table.add_column("verdict")
    rows = []
    for name, item in parameters.items():
        hidden = item.verdict == "not identifiable"
        shown = "-" if hidden else compact(item.value, item.stderr)
        label = f"{name} ({item.unit})" if item.unit not in ("", "1") else name
        rows.append((name, label, shown, item.verdict))
    place = len(rows) if place is None else place
    rows[place:place] = [
        (one.expression, one.expression, compact(one.value, one.stderr), "determined")
        for one in combinations
    ]
    for name, label, shown, verdict in rows:
        error = [f"{errors[name]:.2g}" if name in errors else "-"] if errors else []
        table.add_row(label, shown, *error, Text(verdict, style=STYLE[verdict]))
    return table
