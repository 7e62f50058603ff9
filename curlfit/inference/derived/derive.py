"""From the text of an expression to the quantity with its errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.derived.along_ridge import along_ridge, is_seen_elsewhere
from curlfit.inference.derived.assessed import assessed
from curlfit.inference.derived.expression import CONSTANTS, parse
from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.derived.quantity import Derived, with_quantiles
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.stone import UNITS as STONE_UNITS

_LARGEST = 1e100  # of a value or a slope, so that its square is finite


def check_derived(texts: Sequence[str], names: Sequence[str]) -> None:
    """Raise `InputError`, before a fit, for an expression that is not valid for
    its parameters."""
    # each once: a parameter may have the name of a constant
    distinct = [*dict.fromkeys((*names, *STONE_UNITS, *CONSTANTS))]
    for text in texts:
        parse(text, distinct, {})


def derive(
    first_order: FirstOrder, text: str, samples: Mapping[str, Floats] | None = None
) -> Derived:
    """A derived quantity from its expression.

    Parameters
    ----------
    text : arithmetic of parameters, determined combinations, the stone's R, rho, h and
        m, g and pi.
    samples : of the posterior, by parameter.

    Raises
    ------
    InputError : it is not arithmetic of such names, or has no finite value or
        derivative at the estimates.
    """
    values = first_order.values
    constants = {**CONSTANTS, **first_order.stone}
    sums = {
        combination.expression: combination.weights
        for combination in first_order.combinations
    }
    expression = parse(text, [*(values | constants)], sums)

    # a parameter with the name of a constant takes its place
    def value_at(point: Mapping[str, float]) -> float:
        return float(expression.of({**constants, **point}))

    def slopes_at(point: Mapping[str, float]) -> dict[str, float]:
        gradient = expression.gradient({**constants, **point})
        return {name: slope for name, slope in gradient.items() if name in values}

    value = value_at(values)
    gradient = expression.gradient({**constants, **values})
    by_parameter = {name: slope for name, slope in gradient.items() if name in values}
    label = f"derive {quoted(expression.text)}"
    if not abs(value) < _LARGEST:
        raise InputError(f"{label}: it has no finite value at the estimates")
    if not all(abs(slope) < _LARGEST for slope in gradient.values()):
        raise InputError(f"{label}: it has no derivative at the estimates")
    if not by_parameter:
        raise InputError(
            f"{label}: it contains no parameter of the fit; the parameters are "
            f"{', '.join(values)}"
        )
    changes = {
        name: slope * first_order.widths[name]
        for name, slope in gradient.items()
        if name not in values and name in first_order.widths
    }
    along = None
    if first_order.ridge:
        along = along_ridge(first_order, value_at, slopes_at)
    quantity = assessed(
        first_order,
        expression.text,
        value,
        by_parameter,
        changes,
        seen=is_seen_elsewhere(first_order, slopes_at),
        along=along,
    )
    if along is not None:
        quantity = _as_the_fit_says(first_order, quantity)
    if samples is None:
        return quantity
    return with_quantiles(quantity, expression.of({**constants, **samples}))


def _as_the_fit_says(first_order: FirstOrder, quantity: Derived) -> Derived:
    """The quantity with the error and verdict of the parameter or combination that it
    is, if it is one."""
    estimate = first_order.parameters.get(quantity.expression)
    if estimate is not None:
        stderr = estimate.stderr
        return replace(
            quantity,
            stderr=stderr,
            verdict=estimate.verdict,
            systematic=quantity.systematic if stderr is not None else None,
            reason=estimate.reason,
        )
    for combination in first_order.combinations:
        if combination.expression == quantity.expression:
            return replace(
                quantity, stderr=combination.stderr, verdict=Verdict.DETERMINED
            )
    return quantity
