"""Weights and brooms: what to throw for a place along the centre line, with either turn."""

from __future__ import annotations

import math

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL
from curlfit.prediction.call import Weight
from curlfit.prediction.ensemble import simulate_ensemble
from curlfit.prediction.request import GUARD, aimed
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HACK

_PLACES = {
    "guard": GUARD, "front of the house": -HOUSE, "tee": 0.0, "back of the house": HOUSE,
    "hack": TEE_TO_HACK,
}  # fmt: skip
_TIMES = 0.2 * np.arange(301.0)  # s


def weights_of(fit: FitResult, spin: float) -> tuple[Weight, ...]:
    """What to throw for places from guard to hack, with a spin in rad/s of either sense, on the ice
    of a fit. A place that no throw reaches is left out."""
    spin, start, found = abs(spin), LINES["hog"], []
    for name, y in _PLACES.items():
        try:
            throws = [aimed(fit, (0.0, TEE + y), omega) for omega in (-spin, spin)]
        except InputError:
            continue
        right, left = (math.tan(one.heading) * (TEE - start) for one in throws)
        state = 0.0, start, throws[1].heading, throws[1].v0, 0.0, spin
        values = np.array([[*fit.values[: -len(START)], *state]])
        path = simulate_ensemble(fit.model, values, fit.stone, LEVEL_AND_STILL, _TIMES)
        hog, tee = (float(path.crossing(LINES[line])[0][0]) for line in ("far-hog", "far-tee"))
        found.append(Weight(name, y, hog, tee if y > 0 else None, (right, left)))
    return tuple(found)
