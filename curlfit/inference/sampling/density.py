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
    names, free : of all parameters, and which of them may vary.
    lower, upper : bounds of those.
    batch : number of vectors that are evaluated side by side.
    """

    names: tuple[str, ...]
    free: Booleans
    lower: Floats
    upper: Floats
    batch: int

    def __init__(self, fit: FitResult) -> None:
        parameters = fit.parameter_set
        problem = problem_of(fit)
        self.names = parameters.names
        self.free = parameters.free
        self.lower = parameters.lower[self.free]
        self.upper = parameters.upper[self.free]
        self.batch = lanes(self.free)
        self._estimates = fit.values
        self._model = fit.model
        self._about = parameters.lower, parameters.upper, problem, parameters.penalty

    def whole(self, free_values: Floats) -> Floats:
        """Values of all parameters, those that are held at their own.

        Parameters
        ----------
        free_values : shape (..., free parameters), as that of the next.
        """
        values = np.tile(self._estimates, (*free_values.shape[:-1], 1))
        values[..., self.free] = free_values
        return values

    def log(self, free_values: Floats) -> Floats:
        """Log-density up to a constant, shape (n,); minus infinity outside
        the bounds."""

        def of(values: Floats) -> Any:
            return log_posterior(self._model, values, *self._about)

        values = self.whole(free_values)
        return np.asarray(in_batches(of, (values,), self.batch))


def lanes(free: Booleans) -> int:
    """Number of parameter vectors that are evaluated side by side: half of the
    walkers of a chain, as ensemble moves need them."""
    return 2 * max(32, 4 * ((2 * int(free.sum()) + 3) // 4))
