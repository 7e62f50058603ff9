"""Fitted paths to first order, from the model."""

from __future__ import annotations

import numpy as np

from curlfit.inference.likelihood import path_jacobians
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.models import time_of_motion
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS


def linearized(
    model: Model,
    problem: Problem,
    values: Floats,
    path: Floats,
    stone: Stone,
    typical: Floats,
    adjustable: Booleans,
) -> Linearized:
    """A fitted path of all channels, and of events if there are any, to first order.

    Parameters
    ----------
    values : of the parameters, in the coordinates of the problem.
    path : the fitted path in these coordinates, shape (5 or 6, n), of at least the rows that are
        not padding.
    typical : sizes of the parameters.
    adjustable : which parameters are neither fixed nor at a bound.
    """
    jacobian = path_jacobians(model, values[None], stacked([problem]))[0]
    times, rows, seen = problem.times, path.shape[1], len(problem.weight)
    weight, residual = np.zeros(jacobian.shape[:2]), np.zeros(jacobian.shape[:2])
    weight[:seen] = problem.weight
    there = weight[:seen, :rows] > 0
    residual[:seen, :rows] = np.where(there, problem.observed[:, :rows] - path[:seen], 0.0)
    response = Responses.of(times[:rows], path[: len(CHANNELS)], stone)
    responses = [response.at(times, row) for row in range(len(CHANNELS))]
    if len(jacobian) > len(CHANNELS):
        responses.append(np.zeros_like(responses[0]))
    return Linearized.of(
        times, time_of_motion(times[:rows], path[CHANNELS.index("speed")]), weight, residual,
        jacobian, typical, adjustable, len(model.law.coefficients()), np.stack(responses),
    )  # fmt: skip
