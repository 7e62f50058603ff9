"""The trapezoidal rule."""

from __future__ import annotations

import numpy as np

from curlfit.numerics.arrays import Floats


def running_integral(values: Floats, steps: Floats) -> Floats:
    """Integral from the first point on, along the last axis; `steps` are those
    between points."""
    areas = (values[..., 1:] + values[..., :-1]) / 2 * steps
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(areas, -1)], -1)
