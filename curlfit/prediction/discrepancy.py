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

from curlfit.inference.fit.prepared import linearized_fit
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
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.numerics.differences import slopes
from curlfit.prediction.ensemble import TrajectoryEnsemble
from curlfit.prediction.result import Discrepancy
from curlfit.settings.noise_kinds import NoiseKind
from curlfit.throws.events import along_path
from curlfit.throws.throw import CHANNELS

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
        draws, grid = zip(log_speed, self.acceleration, strict=True), np.log(SPEEDS)
        found = np.array(
            [[np.interp(at, grid, one) for one in draw] for at, draw in draws]
        )
        return ensemble.with_accelerations(found * np.array([spin, 1.0, spin])[:, None])


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
        """Draws of missing accelerations."""
        regression = self._estimate.regression
        assert regression is not None
        lower, white, root = map(np.asarray, _posteriors(regression, GRID))
        which = random.choice(len(GRID), draws, p=self._estimate.weights)
        factor = random.uniform(0.0, 2.0, (draws, 1))
        right = factor * white[which] + random.standard_normal((draws, lower.shape[-1]))
        inner = np.linalg.solve(lower.mT[which], right[..., None])
        amplitudes = (root[which] @ inner)[..., 0]
        change = (
            -amplitudes @ (self._data.from_standard @ np.asarray(self._data.coupling)).T
        )
        ceilings = np.array([*self.summary.ceilings.values()])
        fitted = amplitudes.reshape(draws, len(COMPONENTS), -1) * ceilings[:, None]
        prior = np.exp(log_prior(SIZES[:, None]))
        sizes = (
            random.choice(SIZES, (draws, len(COMPONENTS)), p=prior / prior.sum())
            * ceilings
        )
        normal = random.standard_normal((draws, *self._unseen_shapes.shape[:2]))
        unseen = sizes[..., None] * np.einsum(
            "dcf,cfs->dcs", normal, self._unseen_shapes
        )
        return MissingAccelerations(fitted @ shapes() + unseen, change)

    def shift_parameters(self, values: Floats, missing: MissingAccelerations) -> Floats:
        """Draws of the parameters corrected for the missing accelerations, with errors
        enlarged where a fit with independent noise has correlated residuals."""
        found, data = values + missing.change, self._data
        if self._fit.noise.is_white:
            t = self._fit.observed["t"]
            noise, scale = self._estimate.noise, self._estimate.scale
            times = np.append(t - t[0], np.full(len(data.gaps) - len(t), t[-1] - t[0]))
            squares, axes = np.linalg.eigh(data.covariance(noise, times, scale))
            stretch = (axes * np.sqrt(np.maximum(squares, 1.0))) @ axes.T - np.eye(
                len(axes)
            )
            offset = (values - self._fit.values) @ data.to_standard.T
            found += offset @ stretch @ data.from_standard.T
        bounds = self._fit.parameter_set
        return cast(Floats, np.clip(found, bounds.lower, bounds.upper))


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
    found = estimate(
        NoiseKind.DISCREPANCY, data, [name not in fit.sigma for name in channels]
    )
    best = found.log_likelihood.max()
    without = [found.log_likelihood[column == SIZES[0]].max() for column in GRID.T]
    excess = np.sqrt(2 * (best - without))

    def by_component(values: Floats) -> dict[str, float]:
        return dict(zip(COMPONENTS, map(float, values), strict=True))

    summary = Discrepancy(
        sizes=by_component(np.sqrt(found.weights @ GRID**2) * responses.size),
        span=float(data.span),
        noise={
            name: float(fit.sigma[name] * scale)
            for name, scale, enough in zip(
                channels, found.scale, data.enough, strict=True
            )
            if enough and name in fit.sigma
        },
        excess=by_component(excess) if data.enough.any() else {},
        ceilings=by_component(responses.size),
        friction=responses.friction,
    )
    unseen = _unseen_shapes(fit.fitted["speed"], responses.size / responses.largest)
    return DiscrepancyPosterior(summary, fit, data, found, unseen)


def _unseen_shapes(speed: Floats, share: Floats) -> Floats:
    """Functions of speed, by component, that are zero at the fitted speeds.

    `share` is the size of the components over that by all of the friction.
    """
    fitted = np.clip(SPEEDS, speed.min(), speed.max()) == SPEEDS
    whole = covariance(SPEEDS[:, None], SPEEDS)
    # a small diagonal term, since the covariance is numerically singular
    known = whole[fitted][:, fitted] + 1e-6 * np.eye(int(fitted.sum()))
    conditional = whole - whole[:, fitted] @ np.linalg.solve(known, whole[fitted])
    conditional[fitted] = conditional[:, fitted] = 0.0
    growth = (speed[speed > 0] ** -1.0).mean() ** -2 / SPEEDS**2
    growth = np.clip(growth, 1.0, 1.0 / share[:, None])
    return leading_functions(conditional) * growth[:, None]


def _response_of_events(fit: FitResult, responses: Responses) -> Floats:
    """Derivatives of the events with respect to accelerations, shape (events,
    3 * SHAPES)."""
    since = fit.observed["t"] - fit.observed["t"][0]
    path = np.array(
        [np.interp(responses.t, since, fit.fitted[name]) for name in CHANNELS]
    )
    events, by_amplitude = fit.throw.events, responses.by_channel
    return slopes(
        lambda a: along_path(events, responses.t, *(path + by_amplitude @ a)),
        np.zeros(by_amplitude.shape[-1]),
        _SMALL,
    )
