"""`curlfit laws`: what laws there are."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer


def laws(
    as_json: Annotated[bool, typer.Option("--json", help="As JSON, for programs.")] = False,
) -> None:
    """List the friction laws: formula, coefficients, source, and which way they curl a stone."""
    from curlfit.friction import LAWS

    if as_json:
        listing = [
            {
                "name": law.name,
                "formula": law.formula,
                "source": law.source,
                "predicts": law.predicts,
                "coefficients": [asdict(item) for item in law.coefficients()],
            }
            for law in LAWS.values()
        ]
        typer.echo(json.dumps(listing, indent=1))
        return
    for law in LAWS.values():
        typer.echo(f"{law.name}\n  {(law.__doc__ or '').strip().splitlines()[0]}")
        typer.echo(f"  {law.formula}\n  source: {law.source}")
        typer.echo(f"  a counter-clockwise stone curls {law.predicts}")
        for item in law.coefficients():
            unit = "" if item.unit == "1" else f" {item.unit}"
            typer.echo(
                f"    {item.name:<8} {item.meaning}; default {item.default:g}{unit}, "
                f"within {item.lower:g} .. {item.upper:g}"
            )
        typer.echo("")
