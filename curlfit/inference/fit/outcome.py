"""The outcome of a fit, and what was fitted."""

from __future__ import annotations

from typing import NamedTuple

from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import Problem
from curlfit.inference.model.request import Request
from curlfit.inference.solve.least_squares import Solution
from curlfit.noises import Noise


class LeastSquaresFit(NamedTuple):
    """The outcome of a fit, and what was fitted."""

    request: Request
    model: Model
    noise: Noise
    """as it was estimated"""
    problem: Problem
    sigma: dict[str, float]
    """of the channels for which it was not given"""
    solution: Solution
    tried: int
    """number of initial values tried"""
    rival: Solution | None = None
    """another optimum that fits as well"""
