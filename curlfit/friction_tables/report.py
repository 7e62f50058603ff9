"""What fits to a table of friction say. Nothing is computed here."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.findings import Finding
from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.inference.verdict import Verdict
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section, command_line, show
from curlfit.reports.estimates import reported, row_of, style_of
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
    speed, first = result.observed["speed"], result.fits[0]
    finding = f"{len(result.fits)} laws, {first.law} first by BIC"
    if len(result.fits) == 1:
        finding = "converged" if first.converged else "not converged"
    notes = []
    if result.data["sigma"] == "estimated":
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
            f"{result.data['file']}",
        ),
        about=(_conclusion(result),),
        lines=[_said(first)],
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
        title=f"{result.data['file']}: friction against speed",
        settings={"Data": result.data["file"], "Sigma": result.data["sigma"]},
        command=command_line("compare", result.data["file"]),
    )


def _conclusion(result: FrictionFits) -> str:
    """Which laws the table leaves possible."""
    first, *others = result.fits
    if not others:
        return _said(first)
    near = [one.law for one in others if one.converged and one.bic - first.bic <= _NEAR]
    rest = (
        f"not to be told from it: {join_words(near)}"
        if near
        else "the others are far behind"
    )
    return f"{first.law} describes the values best by BIC; {rest}."


def _said(one: FrictionFit) -> str:
    """What of a law the table determines."""
    hidden = [
        name
        for name, item in one.coefficients.items()
        if item.verdict == Verdict.NOT_IDENTIFIABLE
    ]
    known = [
        f"{name} = {compact(*found)}"
        for name, found in reported(one).items()
        if name not in hidden
    ]
    text = f"{one.law}: {', '.join(known)}"
    return (
        f"{text}; friction along the motion does not determine {join_words(hidden)}."
        if hidden
        else f"{text}."
    )


def _laws(result: FrictionFits) -> PlainTable:
    least = result.fits[0].bic
    return PlainTable(
        (
            {
                "law": one.law,
                "load": one.load,
                ">determined": f"{one.rank}",
                ">rms": f"{one.rms:.2g}",
                ">dBIC": f"{one.bic - least:.1f}",
                "": "" if one.converged else "not converged",
            }
            for one in result.fits
        ),
        "Laws by BIC: number of coefficients that the values determine, "
        "and rms of the residuals",
    )


def _coefficients(one: FrictionFit) -> PlainTable:
    items: dict[str, Any] = {item.expression: item for item in one.combinations}
    rows = (row_of(one.law, *item) for item in (one.coefficients | items).items())
    return PlainTable(rows, f"Coefficients of {one.law}")
