"""The path of a fit's law at other values of its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.likelihood import chi_squared_of_many, predict_channels
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked
from curlfit.throws.channels import CHANNELS


@dataclass(frozen=True)
class Curves:
    """A path and the residuals of the data.

    Attributes
    ----------
    t : evenly spaced times over the data, s.
    path : x, y, phi, speed and omega at these times (SI, rad), NaN where the law
        admits no motion.
    residuals : measured minus computed, by measured channel, at the times of the data.
    chi_squared : of the data, under the noise model and the loss of the fit.
    """

    t: Floats
    path: dict[str, Floats]
    residuals: dict[str, Floats]
    chi_squared: float


class CurveModel:
    """The curves of a fit, as a function of its parameters."""

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        self._model = fit.model
        self._problem = problem_of(fit)
        observed = fit.observed["t"]
        # As many times as padded rows: the program for the data also
        # computes the curves.
        count = len(self._problem.times)
        self._t = np.linspace(observed[0], observed[-1], count)
        unweighted = np.zeros_like(self._problem.weight)
        self._at_rows = self._problem._replace(events=None)
        self._evenly = self._at_rows._replace(
            times=self._t - observed[0], weight=unweighted
        )
        if self._problem.spins is not None:  # those of other rows
            unmeasured = self._problem.spins._replace(interval=np.zeros(()))
            self._evenly = self._evenly._replace(spins=unmeasured)

    def at(self, values: Floats) -> Curves:
        """The curves at a parameter vector, in the order of the fit's parameters."""
        values = np.asarray(values, float)
        path = predict_channels(self._model, values, self._evenly)
        rows = predict_channels(self._model, values, self._at_rows)
        (chi_squared,) = chi_squared_of_many(
            self._model, values[None], stacked([self._problem]), batch=1
        )
        number = len(self.fit.observed["t"])
        computed = dict(zip(CHANNELS, rows[:, :number], strict=True))
        return Curves(
            self._t,
            dict(zip(CHANNELS, path, strict=True)),
            {name: self.fit.observed[name] - computed[name] for name in self.fit.rms},
            float(chi_squared),
        )
