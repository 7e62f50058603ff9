"""Model discrepancy of a fit: accelerations missing from the law, for the bands
of predictions.

The accelerations, the prior of their sizes, their effect on a path and the noise beside
them are those of the noise model "discrepancy", estimated as there
(`curlfit.inference.noise`). The components across the velocity and of the rotation are
proportional to the spin of the throw: the mirror image of a throw is a throw, and
proportionality is the first order of an odd function. Sizes are drawn from their
posterior, which retains sizes that the data could not have revealed. Without any
information it is the prior.

Beyond the fitted speeds the data contain no information: the discrepancy there is a
process of the same covariance, conditioned to be zero at the fitted speeds, with sizes
drawn from the prior. Below them its components by rotation grow, to all of the friction
at most, as 1/v^2: with 1/v, which is rotation relative to translation, simulated
resting places under another law are not covered.

A prediction is the path of the law; its bands extend to the side that the residuals
indicate: each draw contains the posterior mean times a random factor, uniform
between 0 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from curlfit.inference.fit.problems import linearized_fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.noise.accelerations import (
    COMPONENTS,
    SIZES,
    SPEEDS,
    Responses,
    covariance,
    leading_functions,
    log_prior,
    shapes,
)
from curlfit.inference.noise.linearized import Linearized, Regression
from curlfit.inference.noise.restricted import GRID, Estimate, estimate
from curlfit.noises import DISCREPANCY
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.prediction.ensemble import TrajectoryEnsemble
from curlfit.prediction.result import Discrepancy
from curlfit.throws.channels import CHANNELS
from curlfit.throws.events import along_path

_SMALL = 1e-3  # step of differences, relative to the friction


class MissingAccelerations(NamedTuple):
    """Draws of missing accelerations."""

    acceleration: Floats
    """at `SPEEDS`, m/s^2 (rad/s^2), shape (draws, 3, speeds)"""
    change: Floats
    """first-order correction of the parameters for it, shape (draws, parameters)"""

    def applied_to(
        self, ensemble: TrajectoryEnsemble, spin: float = 1.0
    ) -> TrajectoryEnsemble:
        """Each trajectory under one draw; `spin` is relative to that of the
        fitted throw."""
        log_speed = np.log(np.maximum(ensemble.mean_speed, SPEEDS[0]))
        log_grid = np.log(SPEEDS)
        across = []
        along = []
        angular = []
        for speed, draw in zip(log_speed, self.acceleration, strict=True):
            across.append(spin * np.interp(speed, log_grid, draw[0]))
            along.append(np.interp(speed, log_grid, draw[1]))
            angular.append(spin * np.interp(speed, log_grid, draw[2]))
        return ensemble.with_accelerations(np.stack([across, along, angular], 1))


@dataclass(frozen=True)
class DiscrepancyPosterior:
    """The posterior of the discrepancy of a law; `summary` is its record."""

    summary: Discrepancy
    _fit: FitResult
    _data: Linearized
    _estimate: Estimate
    _unseen_shapes: Floats
    """functions of speed that are zero at the fitted speeds, shape (3,
    functions, speeds)"""

    def draw(self, draws: int, random: np.random.Generator) -> MissingAccelerations:
        """Draws of missing accelerations: at the fitted speeds from their posterior,
        beyond them from the prior."""
        ceilings = np.array([*self.summary.ceilings.values()])
        amplitudes = self._draw_amplitudes(draws, random)
        by_amplitude = self._data.from_standard @ np.asarray(self._data.coupling)
        change = -amplitudes @ by_amplitude.T
        scaled = amplitudes.reshape(draws, len(COMPONENTS), -1) * ceilings[:, None]
        at_fitted_speeds = scaled @ shapes()

        prior = np.exp(log_prior(SIZES[:, None]))
        sizes = random.choice(SIZES, (draws, len(COMPONENTS)), p=prior / prior.sum())
        sizes = sizes * ceilings
        normal = random.standard_normal((draws, *self._unseen_shapes.shape[:2]))
        # draws, components, functions, speeds
        unseen = np.einsum("dcf,cfs->dcs", normal, self._unseen_shapes)
        return MissingAccelerations(
            at_fitted_speeds + sizes[..., None] * unseen, change
        )

    def _draw_amplitudes(self, draws: int, random: np.random.Generator) -> Floats:
        """Amplitudes of the functions of speed, over the ceilings of their components,
        shape (draws, components times functions).

        The sizes of the components are drawn by their posterior weight. For given sizes
        the amplitudes are Gaussian: their mean times a factor between 0 and 2, plus
        the scatter.
        """
        regression = self._estimate.regression
        assert regression is not None
        # For each size: the Cholesky factor L of the precision of z, L^T times the mean
        # of z, and F of the amplitudes F z.
        lower, white_mean, root = jax.device_get(_posteriors(regression, GRID))
        size = random.choice(len(GRID), draws, p=self._estimate.weights)
        factor = random.uniform(0.0, 2.0, (draws, 1))
        normal = random.standard_normal((draws, lower.shape[-1]))
        white = factor * white_mean[size] + normal
        z = np.linalg.solve(lower.mT[size], white[..., None])
        return cast(Floats, (root[size] @ z)[..., 0])

    def shift_parameters(self, values: Floats, missing: MissingAccelerations) -> Floats:
        """Draws of the parameters corrected for the missing accelerations, with errors
        enlarged where a fit with independent noise has correlated residuals."""
        data = self._data
        shifted = values + missing.change
        if self._fit.noise.is_white:
            t = self._fit.observed["t"]
            # rows that pad the data are at the last time
            padding = np.full(len(data.gaps) - len(t), t[-1] - t[0])
            times = np.append(t - t[0], padding)
            estimate = self._estimate
            covariance = data.covariance(estimate.noise, times, estimate.scale)
            # The covariance is relative to that of the fit, in which it would be 1:
            # offsets are stretched along its axes where it is larger.
            squares, axes = np.linalg.eigh(covariance)
            stretched = (axes * np.sqrt(np.maximum(squares, 1.0))) @ axes.T
            stretch = stretched - np.eye(len(axes))
            offset = (values - self._fit.values) @ data.to_standard.T
            shifted += offset @ stretch @ data.from_standard.T
        bounds = self._fit.parameter_set
        return cast(Floats, np.clip(shifted, bounds.lower, bounds.upper))


@compiled()
def _posteriors(regression: Regression, sizes: Any) -> Any:
    return jax.vmap(regression.posterior)(sizes)


def discrepancy_posterior(fit: FitResult) -> DiscrepancyPosterior:
    """The posterior of the model discrepancy of a fit."""
    data = linearized_fit(fit)
    t = fit.observed["t"] - fit.observed["t"][0]
    path = np.array([fit.fitted[name] for name in CHANNELS])
    responses = Responses.of(t, path, fit.stone)
    if fit.events:
        data.responses[-1, : len(fit.events)] = _response_of_events(fit, responses)
    channels = [*CHANNELS, "events"][: len(data.weight)]
    sigma_given = [name not in fit.sigma for name in channels]
    estimated = estimate(DISCREPANCY, data, sigma_given)
    # Of each component, how much less likely the data are if it is absent: of the sizes
    # of a component the smallest stands for none.
    log_likelihood = estimated.log_likelihood
    without = [log_likelihood[sizes == SIZES[0]].max() for sizes in GRID.T]
    excess = np.sqrt(2 * (log_likelihood.max() - without))

    noise = {}
    for name, scale, enough in zip(channels, estimated.scale, data.enough, strict=True):
        if enough and name in fit.sigma:
            noise[name] = float(fit.sigma[name] * scale)

    def by_component(values: Floats) -> dict[str, float]:
        return dict(zip(COMPONENTS, map(float, values), strict=True))

    summary = Discrepancy(
        sizes=by_component(np.sqrt(estimated.weights @ GRID**2) * responses.size),
        span=float(data.span),
        noise=noise,
        excess=by_component(excess) if data.enough.any() else {},
        ceilings=by_component(responses.size),
        friction=responses.friction,
    )
    unseen = _unseen_shapes(fit.fitted["speed"], responses.size / responses.largest)
    return DiscrepancyPosterior(summary, fit, data, estimated, unseen)


def _unseen_shapes(speed: Floats, share: Floats) -> Floats:
    """Functions of speed, by component, that are zero at the fitted speeds.

    `share` is the size of the components over that by all of the friction.
    """
    fitted = np.clip(SPEEDS, speed.min(), speed.max()) == SPEEDS
    prior = covariance(SPEEDS[:, None], SPEEDS)
    # a small diagonal term, since the covariance is numerically singular
    at_fitted = prior[fitted][:, fitted] + 1e-6 * np.eye(int(fitted.sum()))
    conditional = prior - prior[:, fitted] @ np.linalg.solve(at_fitted, prior[fitted])
    conditional[fitted] = 0.0
    conditional[:, fitted] = 0.0
    # as 1/v^2 from the harmonic mean of the speeds, to all of the friction at most
    growth = (speed[speed > 0] ** -1.0).mean() ** -2 / SPEEDS**2
    growth = np.clip(growth, 1.0, 1.0 / share[:, None])
    return leading_functions(conditional) * growth[:, None]


def _response_of_events(fit: FitResult, responses: Responses) -> Floats:
    """Derivatives of the events with respect to accelerations, shape (events,
    3 * SHAPES)."""
    since_start = fit.observed["t"] - fit.observed["t"][0]
    path = np.array(
        [np.interp(responses.t, since_start, fit.fitted[name]) for name in CHANNELS]
    )

    def events_under(amplitudes: Floats) -> Floats:
        channels = path + responses.by_channel @ amplitudes
        return along_path(fit.throw.events, responses.t, *channels)

    return slopes(events_under, np.zeros(responses.by_channel.shape[-1]), _SMALL)
