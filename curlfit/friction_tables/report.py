"""What fits to a table of friction say. Nothing is computed here."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.inference.fit.estimate_columns import EstimateRow
from curlfit.inference.information.verdict import Verdict
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.table import Column, Table
from curlfit.reports.estimates import estimates_table, reported, style_of
from curlfit.wording import compact, join_words

_NEAR = 6.0  # of BIC: a difference beyond is strong evidence (Kass and Raftery 1995)


def print_friction(result: FrictionFits, console: Console | None = None) -> None:
    """Print the report of fits to a table of friction.

    Examples
    --------
    >>> curlfit.print_friction(friction)
    friction against speed: 13 values, ...
    """
    show(document(result), console)


def document(result: FrictionFits) -> Document:
    """The laws with their criteria, and the coefficients of each."""
    speed = result.observed["speed"]
    first = result.fits[0]
    finding = f"{len(result.fits)} laws, {first.law} first by BIC"
    if len(result.fits) == 1:
        finding = "converged" if first.converged else "not converged"
    notes = []
    if result.data.sigma == "estimated":
        notes.append(Finding.note("sigma-by-law"))
    return Document(
        finding=finding,
        style=style_of(first),
        subject=(
            f"friction at {len(speed)} speeds, {speed.min():g} .. {speed.max():g} m/s"
        ),
        headline=Text.assemble(
            ("friction against speed", "bold"),
            f": {len(speed)} values, {speed.min():g} .. {speed.max():g} m/s, "
            f"{result.data.file}",
        ),
        about=(_conclusion(result),),
        lines=[_determined(first)],
        sections=(
            Section("laws", "Laws", (_laws(result),)),
            Section(
                "coefficients", "Coefficients", tuple(map(_coefficients, result.fits))
            ),
        ),
        warnings=[
            warning.of(fit.law) for fit in result.fits for warning in fit.warnings
        ],
        notes=notes,
        title=f"{result.data.file}: friction against speed",
        settings={"Data": result.data.file, "Sigma": result.data.sigma},
        command=command_line("compare", result.data.file),
    )


def _conclusion(result: FrictionFits) -> str:
    """Which laws the table leaves possible."""
    first, *other_fits = result.fits
    if not other_fits:
        return _determined(first)
    near = [
        fit.law for fit in other_fits if fit.converged and fit.bic - first.bic <= _NEAR
    ]
    rest = "the others are far behind"
    if near:
        rest = f"not to be told from it: {join_words(near)}"
    return f"{first.law} describes the values best by BIC; {rest}."


def _determined(fit: FrictionFit) -> str:
    """What of a law the table determines."""
    hidden = [
        name
        for name, estimate in fit.coefficients.items()
        if estimate.verdict == Verdict.NOT_IDENTIFIABLE
    ]
    estimates = [
        f"{name} = {compact(value, stderr)}"
        for name, (value, stderr) in reported(fit).items()
        if name not in hidden
    ]
    text = f"{fit.law}: {', '.join(estimates)}"
    if not hidden:
        return f"{text}."
    return f"{text}; friction along the motion does not determine {join_words(hidden)}."


def _laws(result: FrictionFits) -> Table[FrictionFit]:
    """The laws with their criteria, the first with the least BIC."""
    least = result.fits[0].bic
    columns: tuple[Column[FrictionFit], ...] = (
        Column("law"),
        Column("load"),
        Column("determined", right=True, key="rank"),
        Column("rms", format=".2g", right=True),
        Column("dBIC", lambda fit: fit.bic - least, ".1f", right=True),
        Column("", lambda fit: "" if fit.converged else "not converged"),
    )
    return Table(
        result.fits,
        columns,
        "Laws by BIC: number of coefficients that the values determine, "
        "and rms of the residuals",
    )


def _coefficients(fit: FrictionFit) -> Table[EstimateRow]:
    """Coefficients of a law, and their determined combinations."""
    rows = [
        EstimateRow.of(name, estimate) for name, estimate in fit.coefficients.items()
    ]
    rows += [
        EstimateRow.of(combination.expression, combination)
        for combination in fit.combinations
    ]
    return estimates_table(fit.law, rows, f"Coefficients of {fit.law}")
