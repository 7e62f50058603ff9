"""The best choice of throws, and what they determine together.

Throws are chosen with repetition. D: largest determinant of the information, that is
the smallest volume of the confidence ellipsoid. A: smallest sum of squared standard
errors over typical sizes (Atkinson, Donev and Tobias 2007). C: smallest standard error
of one linear combination. Where all candidates together do not determine all
directions, D and A refer to the subspace that they determine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from curlfit.inference.information.directions import r_factor, visible
from curlfit.numerics.arrays import Booleans, Floats

_MAX_ROUNDS = 50
# shares of the information of all candidates
_SINGULAR = 1e-12  # in an undetermined direction
_SHARE_AT_FIRST = 1e-6  # added while few throws are chosen

Criterion = Callable[[Floats], Floats]


def combined(factors: Sequence[Floats]) -> Floats:
    """R factor of the information of several throws together."""
    return r_factor(np.concatenate(list(factors)))


class CandidateSet(NamedTuple):
    """The information of candidates, whitened by that of all of them together."""

    information: Floats
    """of each candidate, shape (candidates, rank, rank); their sum is the
    identity matrix"""
    basis: Floats
    """whitened directions in coefficients over their typical sizes, shape
    (free, rank)"""
    factors: Sequence[Floats]
    """R factor of the information of each candidate"""

    @property
    def rank(self) -> int:
        """Number of directions that the candidates together determine."""
        return self.basis.shape[1]

    @classmethod
    def from_factors(cls, factors: Sequence[Floats]) -> CandidateSet:
        """The set from the R factors of the information of each candidate."""
        _, singular, right = np.linalg.svd(combined(factors))
        mask = visible(singular)
        basis = right[mask].T / singular[mask]
        whitened = np.stack([factor @ basis for factor in factors])
        return cls(np.swapaxes(whitened, 1, 2) @ whitened, basis, factors)

    def together(self, indices: Sequence[int]) -> Floats:
        """R factor of the information of some candidates together."""
        return combined([self.factors[index] for index in indices])


def d_criterion(information: Floats) -> Floats:
    """D: minus the logarithm of the determinant, up to a constant."""
    sign, size = np.linalg.slogdet(information)
    return np.where(_nonsingular(information) & (sign > 0), -size, np.inf)


def error_criterion(candidates: CandidateSet, weights: Floats) -> Criterion:
    """Sum of the squared standard errors of linear combinations (rows of weights by
    typical sizes): A for the coefficients themselves, C for one combination."""
    along = np.atleast_2d(weights) @ candidates.basis
    squares = along.T @ along

    def sum_of_squares(information: Floats) -> Floats:
        """Trace of the inverse of the information times the squares of the weights;
        infinite where there is no inverse."""
        nonsingular = _nonsingular(information)
        identity = np.eye(information.shape[-1])
        safe = np.where(nonsingular[..., None, None], information, identity)
        trace = np.trace(np.linalg.solve(safe, squares), axis1=-2, axis2=-1)
        return np.where(nonsingular, trace, np.inf)

    return sum_of_squares


def _nonsingular(information: Floats) -> Booleans:
    return np.linalg.eigvalsh(information)[..., 0] > _SINGULAR


def exchanged(throws: Sequence[int], best: Callable[[list[int]], int]) -> list[int]:
    """Throws, one at a time exchanged for the best beside the others, until that
    changes none (Fedorov 1972); sorted."""
    chosen = [*throws]
    if len(chosen) == 1:
        return chosen
    for _ in range(_MAX_ROUNDS):
        before = sorted(chosen)
        for _ in before:
            beside = chosen[1:]
            chosen = [*beside, best(beside)]
        if sorted(chosen) == before:
            break
    return sorted(chosen)


def select_design(
    candidates: CandidateSet, criterion: Criterion, throws: int
) -> tuple[int, ...] | None:
    """Indices of the optimal throws, sorted; None if no choice determines
    all directions.

    They are exchanged from a greedy start.
    """
    information = candidates.information

    def best(others: list[int], share_of_all: float = 0.0) -> int:
        fixed = information[others].sum(0) + share_of_all * information.sum(0)
        return int(np.argmin(criterion(fixed + information)))

    chosen: list[int] = []
    for _ in range(throws):
        # A small share of the information of all keeps the criterion finite at first.
        chosen.append(best(chosen, _SHARE_AT_FIRST))
    chosen = exchanged(chosen, best)
    if np.isfinite(criterion(information[chosen].sum(0))):
        return tuple(chosen)
    return None
