"""A throw that a discrepancy once drew away from its data; `camera.py` makes the
table of many."""

from __future__ import annotations

import numpy as np
import pytest
from camera import CASES, filmed

import curlfit


@pytest.mark.slow
def test_a_discrepancy_leaves_the_law_nearest_to_the_data():
    random = np.random.default_rng(1)
    *_, (throw, _) = (filmed(CASES[1], random) for _ in range(33))
    white_fit, discrepancy_fit = (
        curlfit.fit(throw, noise=kind, details=False)
        for kind in ("white", "discrepancy")
    )
    assert discrepancy_fit.converged
    for name, size in white_fit.rms.items():
        assert discrepancy_fit.rms[name] == pytest.approx(size, rel=0.1)
