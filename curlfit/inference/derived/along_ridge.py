"""What the ridge of a fit says of a quantity: of values that fit about as well."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.information.directions import wide_errors
from curlfit.inference.information.thresholds import INTERVAL, UNKNOWN

_TRIES = 4  # further points along null directions at which the gradient is checked
_FOLLOWED = 0.5
"""Share of what a parameter may be, by its standard error and bounds, that the ridge
has followed: it may end early where no path was found."""
_NO_BOUND = 1e300  # a finite stand-in for an infinite bound

ValueAt = Callable[[Mapping[str, float]], float]
"""The value of a quantity at values of the parameters."""
SlopesAt = Callable[[Mapping[str, float]], Mapping[str, float]]
"""The gradient of a quantity at values of the parameters."""


class AlongRidge(NamedTuple):
    """What the ridge of a fit says of a quantity."""

    error: float
    """standard error by its profile, infinite where it is not determined"""
    size: float
    """the smallest, along the ridge, of what typical sizes of the parameters imply"""
    held: frozenset[str]
    """the parameters that were held"""
    reason: str


def along_ridge(
    first_order: FirstOrder, value_at: ValueAt, slopes_at: SlopesAt
) -> AlongRidge:
    """What the ridge says of a quantity."""
    values = first_order.values
    points = first_order.points
    estimate = value_at(values)
    gradient = slopes_at(values)
    values_along = np.array([value_at(point) for point in points])
    gradients_along = [slopes_at(point) for point in points]
    held = frozenset(
        point.held for point in first_order.ridge if point.held is not None
    )
    errors = [math.inf]
    for name in held:
        if not _is_followed(first_order, name):
            continue
        while_held = first_order.holding(name)
        if is_seen_elsewhere(while_held, slopes_at) and while_held.sees(gradient):
            errors.append(while_held.stderr(gradient))
    demanded_errors = [min(errors)]
    fit_nearly_as_well = [estimate]
    for point, value, gradient_there in zip(
        first_order.ridge, values_along, gradients_along, strict=True
    ):
        moved = abs(value - estimate)
        error = _error_at(first_order, point, gradient_there, held)
        demanded_errors.append(demanded_error(moved, error, max(point.rise, 0.0)))
        if point.rise <= INTERVAL:
            fit_nearly_as_well.append(value)
    reason = ""
    if np.isfinite(fit_nearly_as_well).all():
        smallest = min(fit_nearly_as_well)
        largest = max(fit_nearly_as_well)
        reason = f"values from {smallest:.3g} to {largest:.3g} fit nearly as well"
    sizes = [first_order.size(slopes) for slopes in (gradient, *gradients_along)]
    return AlongRidge(
        error=max(map(_nan_as_infinite, demanded_errors)),
        size=min(map(_nan_as_infinite, sizes)),
        held=held,
        reason=reason,
    )


def demanded_error(moved: float, error: float, rise: float) -> float:
    """The standard error that a point of the ridge demands of a quantity.

    By its profile: where chi squared has risen by k^2 in all, by `rise` along the ridge
    and by the rest across it, the quantity is off by moved + error sqrt(k^2 - rise),
    which is at most k standard errors. Of all k from 1 up, the largest of these counts.

    Parameters
    ----------
    moved : distance of its value at the point from the estimate.
    error : its standard error across the ridge, at the point.
    rise : of chi squared at the point.
    """
    if not math.isfinite(moved + error):
        return math.inf
    # the k at which it is largest: sqrt(rise) hypot(...) / moved
    at_largest = math.hypot(moved, math.sqrt(rise) * error)
    if at_largest * math.sqrt(rise) < moved:
        return moved + error * math.sqrt(1.0 - rise)
    return at_largest / math.sqrt(rise) if rise > 0.0 else error


def is_seen_elsewhere(first_order: FirstOrder, slopes_at: SlopesAt) -> bool:
    """Whether the gradient of a quantity vanishes along the null directions elsewhere
    along them as well: that of a product a b vanishes along a - b only where a = b."""
    space = first_order.null_space()
    if not len(space):
        return True
    values = first_order.values
    random = np.random.default_rng(0)
    for steps in random.standard_normal((_TRIES, len(space))) @ space:
        moved = dict(values)
        for name, step in zip(first_order.names, steps, strict=True):
            estimate = first_order.parameters[name]
            lower = max(estimate.lower, -_NO_BOUND)
            upper = min(estimate.upper, _NO_BOUND)
            value = values[name] + step * estimate.typical
            moved[name] = min(max(value, lower), upper)
        gradient = slopes_at(moved)
        is_finite = all(map(math.isfinite, gradient.values()))
        if is_finite and not first_order.sees(gradient):
            return False
    return True


def _error_at(
    first_order: FirstOrder,
    point: Any,
    gradient: Mapping[str, float],
    held: Collection[str],
) -> float:
    """Standard error of a quantity at a point of the ridge with a parameter held: that
    of the point, or of another solution the one that leaves the least."""
    names = list(first_order.parameters)
    weights = np.array([[gradient.get(name, 0.0) for name in names]])
    if not np.isfinite(weights).all():
        return math.inf
    estimates = first_order.parameters.values()
    is_free = [estimate.verdict.is_free for estimate in estimates]
    typical = np.array([estimate.typical for estimate in estimates]) * is_free
    errors = [math.inf]
    for name in held if point.held is None else (point.held,):
        sizes = typical.copy()
        sizes[names.index(name)] = 0.0
        (error,) = wide_errors(np.array(point.slopes) * sizes, weights * sizes)
        errors.append(float(error))
    return min(errors)


def _is_followed(first_order: FirstOrder, name: str) -> bool:
    """Whether the ridge has followed a parameter over what its standard error and its
    bounds leave open."""
    estimate = first_order.parameters[name]
    along = [estimate.value, *(point[name] for point in first_order.points)]
    left_open = min(estimate.upper - estimate.lower, UNKNOWN * estimate.typical)
    if name in first_order.names and first_order.sees({name: 1.0}):
        left_open = min(left_open, first_order.stderr({name: 1.0}))
    return max(along) - min(along) >= _FOLLOWED * left_open


def _nan_as_infinite(value: float) -> float:
    return math.inf if math.isnan(value) else float(value)
