"""What fits to a table of friction say. Nothing is computed here."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section, command_line, show
from curlfit.output.text import compact, format_estimate, join_words, judged, labelled, lower

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
    return Document(
        finding=finding,
        style="green" if first.converged else "bold red",
        subject=f"friction at {len(speed)} speeds, {speed.min():g} .. {speed.max():g} m/s",
        headline=Text.assemble(
            ("friction against speed", "bold"),
            f": {len(speed)} values, {speed.min():g} .. {speed.max():g} m/s, {result.data['file']}",
        ),
        about=(_conclusion(result),),
        lines=[_said(first)],
        sections=(
            Section("laws", "Laws", (_laws(result),)),
            Section("coefficients", "Coefficients", tuple(map(_coefficients, result.fits))),
        ),
        warnings=[f"{one.law}: {lower(text)}" for one in result.fits for text in one.warnings],
        notes=["sigma is estimated from the residuals of each law"]
        * (result.data["sigma"] == "estimated"),
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
    rest = f"not to be told from it: {join_words(near)}" if near else "the others are far behind"
    return f"{first.law} describes the values best by BIC; {rest}."


def _said(one: FrictionFit) -> str:
    """What of a law the table determines."""
    hidden = [name for name, item in one.coefficients.items() if item.verdict == "not identifiable"]
    known = [
        f"{name} = {compact(item.value, item.stderr)}"
        for name, item in one.coefficients.items()
        if name not in hidden
    ]
    known += [
        f"{item.expression} = {compact(item.value, item.stderr)}" for item in one.combinations
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
                "law": one.law, "load": one.load, ">determined": f"{one.rank}",
                ">rms": f"{one.rms:.2g}", ">dBIC": f"{one.bic - least:.1f}",
                "": "" if one.converged else "not converged",
            }
            for one in result.fits
        ),
        "Laws by BIC: number of coefficients that the values determine, and rms of the residuals",
    )  # fmt: skip


def _coefficients(one: FrictionFit) -> PlainTable:
    rows: list[dict[str, Any]] = []
    for name, item in one.coefficients.items():
        hidden = item.verdict == "not identifiable"
        value, error = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
        rows.append(
            {one.law: labelled(name, item.unit), ">estimate": value, ">std. error": error,
             "verdict": judged(item.verdict)}
        )  # fmt: skip
    for known in one.combinations:
        value, error = format_estimate(known.value, known.stderr)
        rows.append(
            {one.law: known.expression, ">estimate": value, ">std. error": error,
             "verdict": judged("determined")}
        )  # fmt: skip
    return PlainTable(rows, f"Coefficients of {one.law}")
