"""Types of NumPy arrays, and arrays of what users give."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


def filled(values: Any) -> Any:
    """An array, in which masked entries are NaN."""
    if np.ma.isMaskedArray(values):
        return np.ma.filled(values.astype(float), np.nan)
    return np.asarray(values)


def floats(values: Any) -> Floats:
    """Numbers; masked entries, None and the NA of pandas are NaN."""
    array = filled(values)
    if array.dtype == object:
        missing = [
            value is None or type(value).__name__ == "NAType" for value in array.flat
        ]
        array = np.where(np.reshape(missing, array.shape), np.nan, array)
    return np.asarray(array, float)
