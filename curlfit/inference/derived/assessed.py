"""A quantity's error and verdict, from the tangent and from the ridge of a fit."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from curlfit.inference.derived.along_ridge import AlongRidge
from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.information.thresholds import (
    LITTLE,
    STRETCHED,
    WEAK_ERROR,
    WIDE,
)
from curlfit.inference.information.verdict import Verdict


def assessed(
    first_order: FirstOrder,
    name: str,
    value: float,
    gradient: Mapping[str, float],
    changes: Mapping[str, float],
    *,
    seen: bool = True,
    held_counts: bool = True,
    along: AlongRidge | None = None,
) -> Derived:
    """The quantity with its errors.

    Its error on the tangent counts unless the ridge demands another one: a larger one
    where it moves along the ridge, a smaller one where the ridge, unlike the tangent,
    leaves it as it is.

    Parameters
    ----------
    gradient : of the quantity, by the parameters.
    changes : of the quantity for one width of each condition, at fixed parameters.
    seen : whether the quantity is determined elsewhere along straight null directions
        as well.
    held_counts : whether dependence on a parameter at its bound leaves the quantity
        without an error.
    along : what the ridge of the fit says of the quantity, if there is one.
    """
    estimates = first_order.parameters
    free = [
        key
        for key, slope in gradient.items()
        if slope and estimates[key].verdict.is_free
    ]
    if not free:
        return Derived(name, value, None, Verdict.FIXED)
    on_tangent = seen and first_order.sees(gradient)
    at_bound = {key for key in free if key not in first_order.names}
    if along is not None and at_bound:
        on_tangent = False
        at_bound -= along.held
    if along is None and not on_tangent:
        return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE)
    if held_counts and at_bound:
        return Derived(name, value, None, Verdict.AT_BOUND)

    stderr = first_order.stderr(gradient) if on_tangent else math.inf
    size = first_order.size(
        {key: gradient[key] for key in free if key in first_order.names}
    )
    stretch = 1.0
    is_narrower = False  # along the ridge than on the tangent
    reason = ""
    if along is not None:
        stretch = along.error / stderr if stderr > 0 else math.inf
        is_narrower = stretch < 1 / LITTLE
        if is_narrower or stretch > LITTLE:
            stderr = along.error
        size = min(along.size, size)
        reason = along.reason
    if math.isinf(stderr):
        return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE, reason=reason)

    is_stretched = stretch > STRETCHED and stderr > WIDE * size
    if stderr >= WEAK_ERROR * size or is_stretched:
        verdict = Verdict.WEAK
    elif any(estimates[key].verdict == Verdict.PRIOR for key in free):
        verdict = Verdict.PRIOR
    else:
        verdict = Verdict.DETERMINED
    if verdict == Verdict.WEAK and not on_tangent:
        return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE, reason=reason)

    systematic = _systematic(first_order, gradient, changes)
    if is_narrower and not first_order.knows_shift(gradient):
        systematic = None
    return Derived(
        name,
        value,
        stderr,
        verdict,
        systematic,
        dof=_degrees_of_freedom(first_order, free, of_all=is_narrower),
        reason=reason if verdict == Verdict.WEAK else "",
    )


def _systematic(
    first_order: FirstOrder, gradient: Mapping[str, float], changes: Mapping[str, float]
) -> float | None:
    """Systematic error of a quantity: of all conditions that the fit holds, whose
    contributions are independent; None if it holds none."""
    weights = first_order.vector(gradient)
    by_condition = [
        float(weights @ first_order.shift(condition)) + changes.get(condition, 0.0)
        for condition in first_order.widths
    ]
    return math.hypot(*by_condition) if by_condition else None


def _degrees_of_freedom(
    first_order: FirstOrder, free: Collection[str], *, of_all: bool
) -> float | None:
    """The smallest degrees of freedom of the errors on which that of a quantity rests:
    of its parameters, and of the combinations that stand for those that have none.

    Parameters
    ----------
    of_all : whether of all parameters, where its own have no errors.
    """
    estimates = first_order.parameters
    hidden = {key for key in free if estimates[key].verdict == Verdict.NOT_IDENTIFIABLE}
    degrees = [estimates[key].dof for key in free]
    for combination in first_order.combinations:
        if hidden & set(combination.weights):
            degrees.append(combination.dof)
    if of_all:
        degrees += [estimate.dof for estimate in estimates.values()]
    # None where sigma was given
    return min((dof for dof in degrees if dof is not None), default=None)
