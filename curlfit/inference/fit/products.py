"""Products of parameters that a path determines where it determines none of them.

A ridge that is straight in logarithms keeps a product: without the angle, a path of
`power+transverse` tells b omega0 alone, one of `front-back` the spin times the
difference of two coefficients. The powers of the factors are found from the points of
the ridge, and the product is then judged along it like any derived quantity.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from curlfit.inference.derived.derive import derive
from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.information.ridge_information import demanded_errors
from curlfit.inference.information.thresholds import INTERVAL
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import START_NAMES
from curlfit.numerics.arrays import Floats

_POSITIONS = ("x0", "y0", "heading", "phi0")
"""Parameters whose zero is a choice of axes, so that ratios of them mean nothing."""
_VARIES = 1.5
"""Largest over smallest size along the ridge, from which a parameter takes part: along
a shorter ridge a sum is as constant as a product."""
_STRAIGHT = 1e-3
"""One minus the correlation of two factors along the ridge, below which they lie on a
line: of b and omega0 it is 0.007 or more where b varies by half of itself."""
_ORIGIN = 0.1
"""Distance over size within which such a line passes through the origin, so that a
ratio is constant."""
_POWERS = ((1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2))
"""Of the first and the second factor; those that leave the product the most constant
are taken."""
_PRECISE = 0.25
"""Standard error over the size of a product, up to which it is said. Of 20 throws each
of front-back, power+transverse, power-angular, power+pivot and tensor without the
angle, those that are said have 0.014 to 0.19."""


class _Factor(NamedTuple):
    """A parameter, or the difference or sum of two, along the ridge."""

    text: str
    names: frozenset[str]
    along: Floats
    """its values: at the estimates, then at the points"""


class _Determined(NamedTuple):
    """A product that is determined along the ridge."""

    product: Derived
    names: frozenset[str]
    """of its parameters"""
    relative_error: float


def products_of(first_order: FirstOrder) -> tuple[Derived, ...]:
    """The products of undetermined parameters that are determined along the ridge, the
    most precise first; none without a ridge."""
    if not first_order.ridge:
        return ()
    rises = np.array([0.0, *(point.rise for point in first_order.ridge)])
    determined: list[_Determined] = []
    for first, second in itertools.combinations(_factors(first_order, rises), 2):
        if first.names & second.names or _on_a_line(first.along, second.along):
            continue
        powers = _powers(first.along, second.along, rises)
        if powers is None:
            continue
        expression = _expression(first.text, second.text, powers)
        product = derive(first_order, expression)
        if product.stderr is None or not product.verdict.is_known:
            continue
        relative_error = product.stderr / abs(product.value)
        if relative_error <= _PRECISE:
            product = replace(product, meaning=_in_words(first, second, powers))
            names = first.names | second.names
            determined.append(_Determined(product, names, relative_error))
    determined.sort(key=lambda entry: (len(entry.names), entry.relative_error))
    products = []
    groups: list[frozenset[str]] = []
    for entry in determined:
        # a product of parameters that others tie together follows from these
        if not any(entry.names <= group for group in groups):
            products.append(entry.product)
            groups = _tied(groups, entry.names)
    return tuple(products)


def _factors(first_order: FirstOrder, rises: Floats) -> list[_Factor]:
    """What may be a factor: it varies along the ridge and is nowhere zero."""
    points = [first_order.values, *first_order.points]
    names = [
        name
        for name, estimate in first_order.parameters.items()
        if (estimate.verdict.is_left_open or estimate.verdict == Verdict.AT_BOUND)
        and name not in _POSITIONS
    ]
    along = {name: np.array([point[name] for point in points]) for name in names}
    coefficients = [name for name in names if name not in START_NAMES]
    factors = [_Factor(name, frozenset([name]), along[name]) for name in coefficients]
    for first, second in itertools.combinations(coefficients, 2):
        if along[first][0] < along[second][0]:
            first, second = second, first
        pair = frozenset([first, second])
        difference = along[first] - along[second]
        factors.append(_Factor(f"({first} - {second})", pair, difference))
        sum_ = along[first] + along[second]
        factors.append(_Factor(f"({first} + {second})", pair, sum_))
    factors += [
        _Factor(name, frozenset([name]), along[name])
        for name in names
        if name in START_NAMES
    ]
    return [factor for factor in factors if _varies(factor.along[rises <= INTERVAL])]


def _varies(values: Floats) -> bool:
    """Whether values are nowhere zero, and of sizes that differ."""
    sizes = np.abs(values)
    return bool(sizes.min() > 0 and sizes.max() > _VARIES * sizes.min())


def _on_a_line(first: Floats, second: Floats) -> bool:
    """Whether two factors lie along the ridge on a line that does not pass through the
    origin, so that a sum is constant there and no product is."""
    correlation = np.corrcoef(first, second)[0, 1]
    _, at_zero = np.polyfit(second, first, 1)
    straight = abs(correlation) > 1.0 - _STRAIGHT
    return bool(straight and abs(at_zero) > _ORIGIN * np.abs(first).max())


def _powers(first: Floats, second: Floats, rises: Floats) -> tuple[int, int] | None:
    """Simple powers of two factors whose product moves the least along the ridge; None
    if all products move by more than what is said of one."""
    least = _PRECISE
    powers = None
    for power, other in _POWERS:
        with np.errstate(divide="ignore", invalid="ignore"):
            product = first**power * second ** float(other)
            moved = np.abs(product / product[0] - 1.0)
        moved = np.nan_to_num(moved, nan=math.inf, posinf=math.inf)
        largest = float(demanded_errors(moved, rises).max())
        if largest < least:
            least = largest
            powers = power, other
    return powers


def _expression(first: str, second: str, powers: tuple[int, int]) -> str:
    """A product of powers as text: q**2/omega0."""
    power, other = powers
    text = first if power == 1 else f"{first}**{power}"
    text += f"{'*' if other > 0 else '/'}{second}"
    return text if abs(other) == 1 else f"{text}**{abs(other)}"


def _in_words(first: _Factor, second: _Factor, powers: tuple[int, int]) -> str:
    """How the factors of a product change along the ridge: b falls as omega0 grows."""
    of_first = _size_in_words(first)
    of_second = _size_in_words(second)
    if powers[1] > 0:
        return f"{of_first} falls as {of_second} grows"
    return f"{of_first} grows with {of_second}"


def _size_in_words(factor: _Factor) -> str:
    """The factor, or its absolute value where it is negative."""
    return factor.text.strip("()") if factor.along[0] > 0 else f"|{factor.text}|"


def _tied(
    groups: Iterable[frozenset[str]], names: frozenset[str]
) -> list[frozenset[str]]:
    """Groups of parameters that products tie together, with one more product."""
    apart = [group for group in groups if not group & names]
    together = [group for group in groups if group & names]
    return [*apart, names.union(*together)]
