"""Quantiles of a sample of the posterior, at the levels that every table has."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.records import Names

LEVELS = ("2.5", "16", "50", "84", "97.5")
"""Of the quantiles, in percent."""
Quantiles = Annotated[dict[str, float], Names(LEVELS)]


def quantiles_of(samples: Floats) -> dict[str, float]:
    """Quantiles of samples, by `LEVELS`."""
    values = np.quantile(samples, [float(level) / 100 for level in LEVELS])
    return dict(zip(LEVELS, map(float, values), strict=True))
