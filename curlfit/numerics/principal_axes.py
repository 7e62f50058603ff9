"""Principal axes of a symmetric matrix."""

from __future__ import annotations

import numpy as np

from curlfit.numerics.arrays import Floats

_EQUAL = 1e-6  # relative difference of components that are equal but for rounding


def principal_axes(matrix: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues of a symmetric matrix, greatest first, and eigenvectors as rows.

    An eigenvector is defined up to its sign, which rounding would choose. Here the
    first of its largest components is positive, so that random draws along it are the
    same on every processor.
    """
    values, vectors = np.linalg.eigh(matrix)
    rows = vectors.T[::-1]
    size = np.abs(rows)
    largest = np.argmax(size > (1 - _EQUAL) * size.max(1, initial=0.0)[:, None], axis=1)
    return values[::-1], rows * np.sign(rows[np.arange(len(rows)), largest])[:, None]
