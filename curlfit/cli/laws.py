"""`curlfit laws`: what laws there are."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from curlfit.friction import Coefficient, Law


def laws(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Only these; FILE.py:CLASS for a law of your own.", metavar="[NAME]..."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON, for programs.")] = False,
) -> None:
    """List the friction laws: formula, coefficients, source, and which way they curl a stone.

    n is the normal load at a point of the ring, n0 its mean, v the sliding velocity there, xi to
    the right of the stone's motion and eta along it.
    """
    from curlfit.friction import LAWS, find_law

    chosen = [find_law(name) for name in names] if names else list(LAWS.values())
    if as_json:
        typer.echo(json.dumps([_record(law) for law in chosen], indent=1))
        return
    typer.echo("\n\n".join(_text(law) for law in chosen))


def _record(law: type[Law]) -> dict[str, object]:
    return {
        "name": law.name,
        "summary": _summary(law),
        "formula": law.formula,
        "source": law.source,
        "predicts": law.predicts,
        "coefficients": [asdict(item) for item in law.coefficients()],
    }


def _summary(law: type[Law]) -> str:
    # A dataclass without a docstring is given its signature as one.
    text = (law.__doc__ or "").strip()
    return "" if text.startswith(f"{law.__name__}(") else text.partition("\n\n")[0]


def _text(law: type[Law]) -> str:
    lines = [law.name]
    lines += [f"  {line.strip()}" for line in _summary(law).splitlines()]
    for label, text in (
        ("", law.formula),
        ("source: ", law.source or law.origin),
        ("a counter-clockwise stone curls ", law.predicts),
    ):
        if text:
            lines.append(f"  {label}{text}")
    width = max((len(item.name) for item in law.coefficients()), default=0)
    lines += [f"    {item.name:<{width}}  {_about(item)}" for item in law.coefficients()]
    return "\n".join(lines)


def _about(item: Coefficient) -> str:
    unit = "" if item.unit == "1" else f" {item.unit}"
    held = "; held there in a fit unless bounds are given" if item.optional else ""
    return (
        f"{item.meaning}; within {item.lower:g} .. {item.upper:g}{unit}, "
        f"default {item.default:g}{unit}{held}"
    )
