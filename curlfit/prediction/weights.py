"""Weights and brooms: what to throw for a place along the centre line, with either turn."""

from __future__ import annotations

import math

import numpy as np

from curlfit.dynamics.aim import aim
from curlfit.dynamics.trajectory import InitialState, simulate
from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.system import System
from curlfit.prediction.call import Weight
from curlfit.prediction.request import GUARD
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HACK

_PLACES = {
    "guard": GUARD, "front of the house": -HOUSE, "tee": 0.0, "back of the house": HOUSE,
    "hack": TEE_TO_HACK,
}  # fmt: skip
_TIMES = np.linspace(0.0, 60.0, 601)


def weights_of(fit: FitResult, spin: float) -> tuple[Weight, ...]:
    """What to throw for places from guard to hack, with a spin in rad/s of either sense, on the ice
    of a fit. A place that no throw reaches is left out."""
    system, start = System.of(fit.model, fit.values, fit.stone, Environment()), (0.0, LINES["hog"])
    found = []
    for name, y in _PLACES.items():
        brooms = []
        try:
            for omega in (-abs(spin), abs(spin)):
                aimed = aim(
                    system.law, system.stone, (0.0, TEE + y), omega0=omega, start=start,
                    load=fit.load, environment=system.environment if fit.conditions else None,
                )  # fmt: skip
                brooms.append(math.tan(aimed.heading) * (TEE - start[1]))
        except InputError:
            continue
        begin = InitialState(y=start[1], v=aimed.v0, heading=aimed.heading, omega=omega)
        path = simulate(
            system.law, system.stone, begin, _TIMES, load=fit.load,
            environment=system.environment,
        ).to_numpy()  # fmt: skip
        hog, tee = np.interp([LINES["far-hog"], TEE], path.y, _TIMES)
        passed = float(tee) if y > 0 else None
        found.append(Weight(name, y, float(hog), passed, (brooms[0], brooms[1])))
    return tuple(found)
