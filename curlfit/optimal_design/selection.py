"""Which throws to make: the best of all ways to choose N among candidates, each as often as wanted.

D: largest determinant of the information, that is the smallest volume of the ellipsoid of errors.
A: smallest sum of squared standard errors over typical sizes (Atkinson, Donev and Tobias 2007).
C: smallest standard error of one weighted sum.

Where not even all candidates together determine everything, D and A are judged on what they do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement
from math import comb
from typing import NamedTuple

import numpy as np

from curlfit.inference.identifiability import visible
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.optimal_design.information import joined

_MOST_TRIED = 20_000  # choices that are all looked at; beyond, exchanges of one throw at a time
_MOST_ROUNDS = 50
_NONE = 1e-12  # of the information of all candidates, along a direction: not determined

Criterion = Callable[[Floats], Floats]


class Field(NamedTuple):
    """Candidates on common ground: what all of them together determine, in units of that."""

    information: Floats
    """of each candidate, shape (candidates, rank, rank); their sum is the unit matrix"""
    back: Floats
    """from these directions to coefficients over their typical sizes, shape (free, rank)"""

    @property
    def rank(self) -> int:
        """Number of directions that the candidates together determine."""
        return self.back.shape[1]


def field_of(roots: Sequence[Floats]) -> Field:
    """Candidates on common ground, from the roots of their information."""
    _, singular, right = np.linalg.svd(joined(roots))
    seen = visible(singular)
    back = right[seen].T / singular[seen]
    white = np.stack([root @ back for root in roots])
    return Field(np.swapaxes(white, 1, 2) @ white, back)


def by_volume(field: Field) -> Criterion:
    """D: minus the logarithm of the determinant, up to a constant."""

    def judged(information: Floats) -> Floats:
        sign, size = np.linalg.slogdet(information)
        return np.where(_whole(information) & (sign > 0), -size, np.inf)

    return judged


def by_mean_error(field: Field) -> Criterion:
    """A: sum of the squared standard errors over typical sizes."""
    return lambda information: _trace(information, field.back.T @ field.back)


def by_error(field: Field, weights: Floats) -> Criterion:
    """C: squared standard error of a weighted sum (weights by typical sizes, shape (free,))."""
    along = field.back.T @ weights
    return lambda information: _trace(information, np.outer(along, along))


def _whole(information: Floats) -> Booleans:
    return np.linalg.eigvalsh(information)[..., 0] > _NONE


def _trace(information: Floats, of: Floats) -> Floats:
    whole = _whole(information)
    safe = np.where(whole[..., None, None], information, np.eye(information.shape[-1]))
    return np.where(whole, np.trace(np.linalg.solve(safe, of), axis1=-2, axis2=-1), np.inf)


def chosen(field: Field, criterion: Criterion, throws: int) -> tuple[int, ...] | None:
    """Places of the best throws, in order; None where no choice of so many determines it all.

    All choices are looked at where these are few; else the best are found by exchanging one throw
    after the other (Fedorov 1972), beginning with the best single ones.
    """
    n = len(field.information)
    if comb(n + throws - 1, throws) <= _MOST_TRIED:
        all_ = np.array(list(combinations_with_replacement(range(n), throws)))
        value = criterion(field.information[all_].sum(1))
        best = int(np.argmin(value))
        return tuple(map(int, all_[best])) if np.isfinite(value[best]) else None
    # A little of all candidates in the beginning keeps every choice finite.
    total = 1e-6 * field.information.sum(0)
    places: list[int] = []
    for _ in range(throws):
        places.append(int(np.argmin(criterion(total + field.information))))
        total = total + field.information[places[-1]]
    total = field.information[places].sum(0)
    for _ in range(_MOST_ROUNDS):
        before = list(places)
        for turn, place in enumerate(places):
            rest = total - field.information[place]
            places[turn] = int(np.argmin(criterion(rest + field.information)))
            total = rest + field.information[places[turn]]
        if places == before:
            break
    value = criterion(field.information[places].sum(0))
    return tuple(sorted(places)) if np.isfinite(value) else None
