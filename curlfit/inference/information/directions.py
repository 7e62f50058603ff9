"""Directions in parameter space, by how well rows determine them.

Columns of the rows are in typical sizes of the parameters. A singular value s then
means that the direction is determined to 1/s typical sizes: below `LOOSE` it is loosely
determined; below `UNSEEN`, or below the rounding error of the largest singular value,
it is not determined at all (`visible` decides).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from curlfit.inference.information.thresholds import (
    NO_PART,
    UNKNOWN,
    UNSEEN,
    WIDE,
)
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.principal_axes import principal_axes

_ROUNDING = 1e-9  # over the largest singular value
# Squaring costs half the digits, hence about the square root of the rounding error.
_ROUNDING_OF_SQUARES = 1e-7


def r_factor(matrix: Floats) -> Floats:
    """R factor (QR decomposition) of a matrix or of each of a stack: at most as many
    rows as columns, which replace all rows in least squares."""
    factor: Any = np.linalg.qr(matrix, mode="r")
    return factor


def visible(singular: Floats) -> Booleans:
    """Which directions the data determine, from the singular values of
    scaled Jacobians."""
    seen: Booleans = singular > np.maximum(UNSEEN, _ROUNDING * singular[..., :1])
    return seen


def inverted(singular: Floats, counts: Booleans) -> Floats:
    """1/singular where it counts, else 0: the singular values of the pseudoinverse."""
    return np.where(counts, 1 / np.where(counts, singular, 1.0), 0.0)


def apart_from(nuisances: Floats, columns: Floats) -> Floats:
    """Columns of rows, projected onto the orthogonal complement of other columns, those
    of nuisance parameters in typical sizes: what the rows say of the first whatever
    the others are. Both of one problem, or of a stack."""
    left, singular, _ = np.linalg.svd(nuisances, full_matrices=False)
    left = left * visible(singular)[..., None, :]
    for _ in range(2):  # twice, against rounding errors
        columns = columns - left @ (left.mT @ columns)
    return columns


def directions_of_squares(
    matrix: Floats, typical: Floats
) -> tuple[Floats, Floats, Floats]:
    """Determined directions and null directions from an information matrix J^T J, of
    which half the digits are lost: for what is kept as such a matrix, as in a record.

    Returns
    -------
    seen, singular, null : orthonormal directions in scaled parameters that the data
        determine, shape (directions, parameters), the singular value of each, and
        directions that span the rest.
    """
    squared, axes = principal_axes(typical[:, None] * matrix * typical)
    singular = np.sqrt(np.maximum(squared, 0.0))
    seen = singular > max(UNSEEN, _ROUNDING_OF_SQUARES * singular[0])
    return axes[seen], singular[seen], axes[~seen]


def standard_error(rows: Floats, weights: Floats) -> float | None:
    """Standard error of a weighted sum of parameters, from rows with errors of one;
    None where they do not determine it.

    Parameters
    ----------
    rows, weights : of the parameters in typical sizes, shape (n, parameters) and
        (parameters,).
    """
    _, singular, right = np.linalg.svd(rows, full_matrices=False)
    seen = visible(singular)
    determined = right[seen]
    along = determined @ weights
    rest = np.linalg.norm(weights - determined.T @ along)
    if rest > NO_PART * np.linalg.norm(weights):
        return None
    return float(np.linalg.norm(along / singular[seen]))


def wide_errors(rows: Floats, weights: Floats) -> Floats:
    """Standard errors of weighted sums of parameters; infinite where nothing is known
    of a sum.

    A direction moves a sum by no more than its parameters may move along it, `UNKNOWN`
    typical sizes. Nothing is known of a sum that null directions move by more than
    `WIDE` of its size.

    Parameters
    ----------
    rows, weights : of the parameters in typical sizes, shape (n, parameters) and
        (sums, parameters); 0 of parameters that do not move.
    """
    _, singular, right = np.linalg.svd(rows, full_matrices=False)
    seen = visible(singular)
    along = weights @ right[seen].T
    outside = UNKNOWN * np.linalg.norm(weights - along @ right[seen], axis=1)
    unknown = outside > WIDE * np.abs(weights).max(axis=1)
    reach = np.minimum(1 / singular[seen], UNKNOWN)
    inside = np.linalg.norm(along * reach, axis=1)
    return np.where(unknown, np.inf, np.hypot(inside, outside))
