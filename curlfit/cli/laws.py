"""`curlfit laws`: the friction laws."""

from __future__ import annotations

import json
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from curlfit.settings.forms import SWITCH, option

if TYPE_CHECKING:
    from curlfit.friction import Coefficient, Law


def laws(
    *names: str,
    conditions: Annotated[bool, option(SWITCH)] = False,
    as_json: Annotated[bool, option(SWITCH, name="--json")] = False,
) -> None:
    """List the friction laws: formula, coefficients, source, direction of curl.

    n is the normal load at a point of the ring, n0 its mean, v the sliding velocity there, xi to
    the right of the stone's motion and eta along it.

    Parameters
    ----------
    names
        Only these; FILE.py:CLASS for a law of your own.
    conditions
        The conditions that a fit holds (level ice, still air, the stone, the scales), and their
        standard uncertainties.
    as_json
        As JSON, for programs.
    """
    from curlfit.errors import InputError
    from curlfit.friction import LAWS, TERMS, find_law

    if conditions:
        if names:
            raise InputError("--conditions are those of any law; give no names")
        _print_conditions(as_json=as_json)
        return
    every = (*LAWS.values(), *TERMS.values())
    chosen = [TERMS.get(name) or find_law(name) for name in names] if names else every
    if as_json:
        print(json.dumps([_record(law) for law in chosen], indent=1))
        return
    from curlfit.output.console import terminal

    width = terminal().width
    print("\n\n".join(_text(law, width) for law in chosen))


def _print_conditions(*, as_json: bool) -> None:
    from curlfit.inference.conditions import CONDITIONS, SPIN
    from curlfit.output.console import terminal

    every = (*CONDITIONS, SPIN)
    if as_json:
        print(json.dumps([asdict(item) for item in every], indent=1))
        return
    width = terminal().width
    longest = max(len(item.name) for item in every)
    for item in every:
        unit = "" if item.unit == "1" else f" {item.unit}"
        text = f"{item.meaning}; standard uncertainty {item.width:g}{unit} ({item.basis})"
        print("\n".join(_wrap(f"{item.name:<{longest}}  ", text, width)))


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


def _text(law: type[Law], width: int) -> str:
    lines = [law.name, *_wrap("  ", _summary(law), width)]
    for label, text in (
        ("", law.formula),
        ("source: ", law.source or law.origin),
        ("a counter-clockwise stone curls ", law.predicts),
        ("", "" if law.brakes else f"does not brake: a part of sums, as in power+{law.name}"),
    ):
        if text:
            lines += _wrap("  ", f"{label}{text}", width)
    longest = max((len(item.name) for item in law.coefficients()), default=0)
    for item in law.coefficients():
        lines += _wrap(f"    {item.name:<{longest}}  ", _describe(item), width)
    return "\n".join(lines)


def _wrap(head: str, text: str, width: int) -> list[str]:
    """Lines of a text after a head, with a hanging indent."""
    return textwrap.wrap(
        text, width, initial_indent=head, subsequent_indent=" " * len(head),
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _describe(item: Coefficient) -> str:
    unit = "" if item.unit == "1" else f" {item.unit}"
    fixed = "; fixed there in a fit unless bounds are given" if item.optional else ""
    return (
        f"{item.meaning}; within {item.lower:g} .. {item.upper:g}{unit}, "
        f"default {item.default:g}{unit}{fixed}"
    )
