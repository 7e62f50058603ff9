"""The log-posterior of the free parameters of a fit."""

from __future__ import annotations

from typing import Any

import numpy as np

from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.likelihood import log_posterior
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches


class PosteriorDensity:
    """The posterior density about the estimates of a fit, under the noise and the loss
    of the fit, and its priors.

    Attributes
    ----------
    names : of all parameters.
    free : which of them may vary.
    lower, upper : bounds of the free parameters.
    batch : number of parameter vectors that are evaluated side by side.
    """

    names: tuple[str, ...]
    free: Booleans
    lower: Floats
    upper: Floats
    batch: int

    def __init__(self, fit: FitResult) -> None:
        parameters = fit.parameter_set
        self.names = parameters.names
        self.free = parameters.free
        self.lower = parameters.lower[self.free]
        self.upper = parameters.upper[self.free]
        self.batch = lanes(self.free)
        self._estimates = fit.values
        self._model = fit.model
        self._parameters = parameters
        self._problem = problem_of(fit)

    def whole(self, free_values: Floats) -> Floats:
        """Values of all parameters, the fixed ones at their estimates, from those of
        the free ones, shape (..., free parameters)."""
        values = np.tile(self._estimates, (*free_values.shape[:-1], 1))
        values[..., self.free] = free_values
        return values

    def log(self, free_values: Floats) -> Floats:
        """Log-density up to a constant, shape (n,), at values of the free parameters,
        shape (n, free parameters); minus infinity outside the bounds."""
        parameters = self._parameters

        def log_density(values: Floats) -> Any:
            return log_posterior(
                self._model,
                values,
                parameters.lower,
                parameters.upper,
                self._problem,
                parameters.penalty,
            )

        values = self.whole(free_values)
        return np.asarray(in_batches(log_density, (values,), self.batch))


def lanes(free: Booleans) -> int:
    """Number of parameter vectors that are evaluated side by side: half of the
    walkers of a chain, as ensemble moves need them."""
    return 2 * max(32, 4 * ((2 * int(free.sum()) + 3) // 4))
