"""`curlfit laws`: the friction laws."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from curlfit.settings.forms import SWITCH, option

if TYPE_CHECKING:
    from curlfit.friction import Coefficient, Law
    from curlfit.inference.conditions import Condition


def laws(
    *names: str,
    conditions: Annotated[bool, option(SWITCH)] = False,
) -> None:
    """List the friction laws: formula, coefficients, source, direction of curl.

    n is the normal load at a point of the ring, n0 its mean, v the sliding velocity
    there, xi to the right of the stone's motion and eta along it.

    Parameters
    ----------
    names
        Only these; FILE.py:CLASS for a law of your own.
    conditions
        The conditions that a fit holds (level ice, still air, the stone, the scales),
        and their standard uncertainties.
    """
    from curlfit.errors import InputError
    from curlfit.friction import LAWS, TERMS, find_law
    from curlfit.inference.conditions import ASSUMED, CONDITIONS
    from curlfit.output.console import terminal

    if conditions and names:
        raise InputError("--conditions are those of any law; give no names")
    width = terminal().width
    if conditions:
        print("\n".join(_listed("", _condition, (*CONDITIONS, *ASSUMED), width)))
        return
    every = (*LAWS.values(), *TERMS.values())
    chosen = [TERMS.get(name) or find_law(name) for name in names] if names else every
    print("\n\n".join(_text(law, width) for law in chosen))


def _summary(law: type[Law]) -> str:
    # A dataclass without a docstring is given its signature as one.
    text = (law.__doc__ or "").strip()
    first, _, _ = text.partition("\n\n")
    return "" if text.startswith(f"{law.__name__}(") else " ".join(first.split())


def _text(law: type[Law], width: int) -> str:
    lines = [law.name, *_wrap("  ", _summary(law), width)]
    for label, text in (
        ("", law.formula),
        ("source: ", law.source or law.origin),
        ("a counter-clockwise stone curls ", law.predicts),
        (
            "",
            ""
            if law.brakes
            else f"does not brake: a part of sums, as in power+{law.name}",
        ),
    ):
        if text:
            lines += _wrap("  ", f"{label}{text}", width)
    return "\n".join(
        [*lines, *_listed("    ", _coefficient, law.coefficients(), width)]
    )


def _listed(
    indent: str, describe: Callable[[Any], str], items: Sequence[Any], width: int
) -> Iterator[str]:
    """Lines of items, each with its name and description."""
    longest = max((len(item.name) for item in items), default=0)
    for item in items:
        yield from _wrap(f"{indent}{item.name:<{longest}}  ", describe(item), width)


def _wrap(head: str, text: str, width: int) -> list[str]:
    """Lines of a text after a head, with a hanging indent."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )


def _coefficient(item: Coefficient) -> str:
    unit = _unit(item)
    fixed = "; fixed there in a fit unless bounds are given" if item.optional else ""
    return (
        f"{item.meaning}; within {item.lower:g} .. {item.upper:g}{unit}, "
        f"default {item.default:g}{unit}{fixed}"
    )


def _condition(item: Condition) -> str:
    return (
        f"{item.meaning}; standard uncertainty "
        f"{item.width:g}{_unit(item)} ({item.basis})"
    )


def _unit(item: Coefficient | Condition) -> str:
    return "" if item.unit == "1" else f" {item.unit}"
