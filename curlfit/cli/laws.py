"""`curlfit laws`: the friction laws."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from curlfit.settings.forms import SWITCH, option
from curlfit.wording import hanging, listed

if TYPE_CHECKING:
    from curlfit.friction import Coefficient, Law
    from curlfit.inference.model.conditions import Condition


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
    from curlfit.inference.model.conditions import ASSUMED, CONDITIONS
    from curlfit.output.console import terminal

    if conditions and names:
        raise InputError("--conditions are those of any law; give no names")
    width = terminal().width
    if conditions:
        texts = {
            condition.name: _condition(condition)
            for condition in (*CONDITIONS, *ASSUMED)
        }
        print("\n".join(listed(texts, width)))
        return
    listed_laws = [*LAWS.values(), *TERMS.values()]
    if names:
        listed_laws = [TERMS.get(name) or find_law(name) for name in names]
    print("\n\n".join(_text(law, width) for law in listed_laws))


def _summary(law: type[Law]) -> str:
    """The first paragraph of a law's docstring as one line."""
    text = (law.__doc__ or "").strip()
    # a dataclass without a docstring is given its signature as one
    if text.startswith(f"{law.__name__}("):
        return ""
    first, _, _ = text.partition("\n\n")
    return " ".join(first.split())


def _text(law: type[Law], width: int) -> str:
    """A law: name, summary, formula, source, direction of curl, coefficients."""
    paragraphs = [_summary(law), law.formula]
    source = law.source or law.origin
    if source:
        paragraphs.append(f"source: {source}")
    if law.predicts:
        paragraphs.append(f"a counter-clockwise stone curls {law.predicts}")
    if not law.brakes:
        paragraphs.append(f"does not brake: a part of sums, as in power+{law.name}")
    lines = [law.name]
    for paragraph in paragraphs:
        lines += hanging("  ", paragraph, width)
    texts = {
        coefficient.name: _coefficient(coefficient)
        for coefficient in law.coefficients()
    }
    lines += listed(texts, width, indent="    ")
    return "\n".join(lines)


def _coefficient(coefficient: Coefficient) -> str:
    """Meaning, bounds and default of a coefficient."""
    unit = _unit(coefficient)
    text = (
        f"{coefficient.meaning}; within {coefficient.lower:g} .. "
        f"{coefficient.upper:g}{unit}, default {coefficient.default:g}{unit}"
    )
    if coefficient.optional:
        text += "; fixed there in a fit unless bounds are given"
    return text


def _condition(condition: Condition) -> str:
    """Meaning and standard uncertainty of a condition, and why it is that."""
    return (
        f"{condition.meaning}; standard uncertainty "
        f"{condition.width:g}{_unit(condition)} ({condition.basis})"
    )


def _unit(quantity: Coefficient | Condition) -> str:
    """The unit after a number; empty for pure numbers."""
    return "" if quantity.unit == "1" else f" {quantity.unit}"
