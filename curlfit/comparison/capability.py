"""Capabilities of a law: friction not opposite to sliding, and the sides to which it can curl."""

from __future__ import annotations

from itertools import product

import numpy as np

from curlfit.dynamics.law_structure import law_in_general, sample_points
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.initial_values import POINTS, accelerations_along
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import in_batches, stacked

_MOST = 500
"""Largest number of coefficient vectors for which a law is evaluated."""


def opposes_sliding(law: type[Law]) -> bool:
    """Whether friction opposes sliding all around the ring, whatever the coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    general = law_in_general(law)
    for half in (1.0, 0.0):
        points = sample_points(half)
        xi, eta = general.traction(points)
        if not np.allclose(xi * points.e_eta, eta * points.e_xi, rtol=0, atol=1e-9):
            return False
    return True


def sides_of_curl(
    law: type[Law], load: Load, result: FitResult, family: type[LawFamily] | None = None
) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows, within bounds.

    A law of a family is evaluated by the family's program.
    """
    items = result.coefficients.values()
    steps = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])
    ranges = [
        np.unique(np.clip(steps * item.typical, item.lower, item.upper))
        if item.verdict != "fixed"
        else np.array([item.value])
        for item in items
    ]
    grid = np.array(list(product(*ranges)))
    if len(grid) > _MOST:
        grid = grid[np.random.default_rng(0).choice(len(grid), _MOST, replace=False)]
    v = float(np.median(result.fitted["speed"]))
    omega = float(np.median(np.abs(result.fitted["omega"])))
    # half a radian after release, where a law that depends on the angle still depends on it
    state = np.tile(np.array([v, omega, 0.5, 0.0])[:, None], POINTS)
    model = Model(law, load).within(family)
    stones = stacked([result.stone])

    def accelerations(part: Floats) -> Floats:
        """In this state for each coefficient vector, shape (POINTS, 3)."""
        return accelerations_along(model, part[None], stones, state[None], batch=1)[0].T

    xi, eta = in_batches(accelerations, (grid,), POINTS)[:, :2].T
    sideways = np.where(eta < 0, xi / np.where(eta < 0, -eta, 1.0), 0.0)
    found = [("left", (sideways < -1e-9).any()), ("right", (sideways > 1e-9).any())]
    return tuple(side for side, possible in found if possible)
