"""Model discrepancy of a fit: accelerations missing from the law, for the bands of predictions.

The accelerations, their dependence on speed, the prior of their sizes and their effect on a path
are those of the noise model "discrepancy" (`curlfit.inference.noise.accelerations`). The components
across the velocity and of the rotation are proportional to the spin of the throw: the mirror image
of a throw is a throw, and proportionality is the first order of an odd function. Sizes are drawn
from their posterior, which retains sizes that the data could not have revealed. Without any
information it is the prior: exponential with a mean of a third of the friction, truncated at the
friction.

Identification. The coefficients of the law are the least-squares estimates: the accelerations are
those that leave them unchanged, to first order, while the initial state of the fitted throw adjusts
(as in Plumlee 2017, Journal of the American Statistical Association 112, 1274). Coefficients that
are fixed or at a bound do not change. The independent noise of each channel is estimated together
with the discrepancy; residuals that remain correlated from row to row enter with their effective
sample size.

Beyond the fitted speeds the data contain no information: the discrepancy there is a process of the
same covariance, conditioned to be zero at the fitted speeds, with sizes drawn from the prior.

A prediction is the path of the law; its bands extend to the side that the residuals indicate: each
draw contains the posterior mean times a random factor, uniform between 0 and 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.prepared import motion_of, problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import directions
from curlfit.inference.likelihood import linearize_once
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import (
    COMPONENTS,
    SHAPES,
    SIZES,
    SPEEDS,
    Responses,
    covariance,
    leading_functions,
    log_prior,
    shapes,
)
from curlfit.inference.noise.models import WHITE, independences
from curlfit.inference.problem import ROWS_OF_DATA, Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import stacked
from curlfit.numerics.principal_axes import principal_axes
from curlfit.prediction.ensemble import TrajectoryEnsemble
from curlfit.prediction.result import Discrepancy
from curlfit.throws.events import along_path
from curlfit.throws.throw import CHANNELS

_MIN_VALUES = 20  # number of values above which the noise of a channel is estimated
_MIN_SIGMA = 1e-5  # lower limit of the noise, m, rad, m/s or rad/s
_SMALL = 1e-3  # step of finite differences, relative to the friction
_LOG_STEP = 1e-4  # step of finite differences in the logarithm of a size
_ROUNDS = 3  # maximum number of iterations over noise and effective sample sizes


class MissingAccelerations(NamedTuple):
    """Draws of missing accelerations."""

    acceleration: Floats
    """at `SPEEDS`, m/s^2 (rad/s^2), shape (draws, 3, speeds)"""
    change: Floats
    """first-order correction of the parameters for it, shape (draws, parameters)"""

    def applied_to(self, ensemble: TrajectoryEnsemble, spin: float = 1.0) -> TrajectoryEnsemble:
        """Each trajectory under one draw; `spin` is relative to that of the fitted throw."""
        log_speed = np.log(np.clip(ensemble.mean_speeds(), SPEEDS[0], SPEEDS[-1]))
        grid = np.log(SPEEDS)
        accelerations = np.array(
            [
                [np.interp(at, grid, component) for component in draw]
                for at, draw in zip(log_speed, self.acceleration, strict=True)
            ]
        )
        return ensemble.with_accelerations(accelerations * np.array([spin, 1.0, spin])[:, None])


@dataclass(frozen=True)
class DiscrepancyPosterior:
    """The posterior of the discrepancy of a law; `summary` is its record."""

    summary: Discrepancy
    _fit: FitResult
    _model: _LinearModel
    _noise: Floats
    """variances by channel, relative to those of the fit"""
    _sizes: Floats
    """grid of sizes relative to the ceilings, shape (sizes, 3)"""
    _weights: Floats
    """posterior probabilities of the grid points"""
    _unseen_shapes: Floats
    """functions of speed that are zero at the fitted speeds, shape (functions, speeds)"""

    def draw(self, draws: int, random: np.random.Generator) -> MissingAccelerations:
        """Draws of missing accelerations."""
        distinct, of = np.unique(
            random.choice(len(self._sizes), draws, p=self._weights), return_inverse=True
        )
        lower, white, _ = self._model.posterior(self._noise, self._sizes[distinct])
        factor = random.uniform(0.0, 2.0, (draws, 1))
        right = factor * white[of] + random.standard_normal((draws, lower.shape[-1]))
        model = self._model
        amplitudes = np.linalg.solve(lower.mT[of], right[..., None])[:, model.n_parameters :, 0]
        change = np.zeros((draws, len(self._fit.parameters)))
        by_amplitude = (model.from_standard @ model.coupling).T
        change[:, _adjustable(self._fit)] = -amplitudes @ by_amplitude
        weights = amplitudes @ model.basis.T
        ceilings = np.array([self.summary.ceilings[component] for component in COMPONENTS])
        fitted = weights.reshape(draws, len(COMPONENTS), -1) * ceilings[:, None]
        sizes = random.choice(SIZES, (draws, len(COMPONENTS)), p=_prior_weights()) * ceilings
        normal = random.standard_normal((draws, len(COMPONENTS), len(self._unseen_shapes)))
        unseen = normal @ self._unseen_shapes
        return MissingAccelerations(fitted @ shapes() + sizes[..., None] * unseen, change)

    def shift_parameters(self, values: Floats, missing: MissingAccelerations) -> Floats:
        """Draws of the parameters corrected for the missing accelerations, with errors enlarged
        for the effective sample size."""
        adjustable, model = _adjustable(self._fit), self._model
        n = model.n_parameters
        inflation = np.maximum(self._noise, 1.0)
        lower = np.linalg.cholesky(np.tensordot(1 / inflation, model.gram[:, :n, :n], 1))
        offset = (values - self._fit.values)[:, adjustable] @ model.to_standard.T
        change = np.linalg.solve(lower.T, offset.T).T - offset
        found = values + missing.change
        found[:, adjustable] += change @ model.from_standard.T
        bounds = self._fit.parameter_set
        return cast(Floats, np.clip(found, bounds.lower, bounds.upper))


def discrepancy_posterior(fit: FitResult) -> DiscrepancyPosterior:
    """The posterior of the model discrepancy of a fit."""
    responses = Responses.of(*motion_of(fit))
    ceilings = responses.size
    model = _LinearModel.of(fit, responses)
    estimated = model.counts > _MIN_VALUES
    noise, shares = np.where(estimated, model.rough_noise(), 1.0), np.ones(len(model.counts))
    best = np.full(len(COMPONENTS), 0.1)
    for _ in range(_ROUNDS):
        noise, best = model.maximize_posterior(noise, shares, best, estimated)
        before = shares
        shares = np.where(estimated, model.effective_shares(noise / shares, best), 1.0)
        if np.allclose(shares, before, rtol=0.1):
            break
    n = len(COMPONENTS)
    grid = np.stack(np.meshgrid(*[SIZES] * n, indexing="ij"), -1).reshape(-1, n)
    log_likelihood = model.log_likelihood(noise, shares, grid)
    log_posterior = log_likelihood + log_prior(grid)
    weights = np.exp(log_posterior - log_posterior.max())
    weights /= weights.sum()
    sizes = ceilings * np.sqrt(weights @ grid**2)
    excess = {}
    for index, component in enumerate(COMPONENTS):
        without = log_likelihood[grid[:, index] == SIZES[0]].max()
        excess[component] = float(np.sqrt(2 * (log_likelihood.max() - without)))
    summary = Discrepancy(
        dict(zip(COMPONENTS, map(float, sizes), strict=True)),
        _duration(fit),
        {
            name: float(sigma * math.sqrt(square * share))
            for name, sigma, square, share, use in zip(
                model.names, model.sigmas, noise, shares, estimated, strict=True
            )
            if use
        },
        excess if estimated.any() else {},
        dict(zip(COMPONENTS, map(float, ceilings), strict=True)),
        responses.friction,
    )
    unseen = _unseen_shapes(fit.fitted["speed"])
    return DiscrepancyPosterior(summary, fit, model, noise, grid, weights, unseen)


@dataclass(frozen=True)
class _LinearModel:
    """The fitted rows, linearized in the parameters and the missing accelerations.

    Attributes
    ----------
    names, sigmas, counts : of the channels; sigma by which the fit weights a value; number of
        values.
    columns : by channel, divided by sigma: derivatives with respect to the determined directions of
        the parameters (in units of their standard errors) and to the accelerations (see `basis`),
        and, last, the residuals.
    gram : products of these columns by channel. n_parameters : number of parameter directions.
    from_standard, to_standard : matrix from these directions to the adjustable parameters, and its
        inverse.
    basis : accelerations that do not change the coefficients, relative to the ceilings, component
        by component as combinations of functions of speed (`shapes`).
    coupling : products of parameter and acceleration columns.
    """

    names: tuple[str, ...]
    sigmas: Floats
    counts: NDArray[np.int64]
    columns: tuple[Floats, ...]
    gram: Floats
    n_parameters: int
    from_standard: Floats
    to_standard: Floats
    basis: Floats
    coupling: Floats

    @classmethod
    def of(cls, fit: FitResult, responses: Responses) -> _LinearModel:
        """From a fit and the responses of its path to accelerations of the size of the friction."""
        jacobian, weight = _path_jacobian(fit)
        names = tuple(
            name for name, own in zip(ROWS_OF_DATA, weight, strict=False) if (own > 0).any()
        )  # fmt: skip
        since = fit.observed["t"] - fit.observed["t"][0]
        adjustable = _adjustable(fit)
        blocks, sigmas = [], []
        for name in names:
            index = ROWS_OF_DATA.index(name)
            use = weight[index] > 0
            own = np.minimum(weight[index, use], 1 / _MIN_SIGMA)[:, None]
            if name in CHANNELS:
                residual = (fit.observed[name] - fit.fitted[name])[use, None]
                response = responses.at(since, index)[use]
            else:
                response = _response_of_events(fit, responses)
                residual = np.array([[one["value"] - one["fitted"]] for one in fit.events])
            blocks.append(
                own * np.hstack([jacobian[index, use][:, adjustable], response, residual])
            )
            sigmas.append(float(1 / np.sqrt(np.mean(own**2))))
        p = int(adjustable.sum())
        rows = np.concatenate(blocks)
        typical = fit.parameter_set.typical[adjustable]
        along, singular, _ = directions(rows[:, :p].T @ rows[:, :p], typical)
        from_standard = typical[:, None] * along.T / singular
        to_standard = singular[:, None] * along / typical
        coupling = (rows[:, :p] @ from_standard).T @ rows[:, p:-1]
        law = slice(0, int(adjustable[: len(fit.coefficients)].sum()))
        basis = _null_space((from_standard @ coupling)[law] / typical[law, None])
        columns = tuple(
            np.hstack([block[:, :p] @ from_standard, block[:, p:-1] @ basis, block[:, -1:]])
            for block in blocks
        )
        return cls(
            names, np.array(sigmas), np.array([len(part) for part in columns]), columns,
            np.array([part.T @ part for part in columns]), len(singular), from_standard,
            to_standard, basis, coupling @ basis,
        )  # fmt: skip

    @property
    def min_noise(self) -> Floats:
        """Lower limits of the variances by channel, relative to those of the fit."""
        return (_MIN_SIGMA / self.sigmas) ** 2

    def posterior(self, noise: Floats, sizes: Floats) -> tuple[Floats, Floats, Floats]:
        """Gaussian posterior of the amplitudes of all columns at given sizes.

        The sizes are relative to the ceilings, shape (sizes, 3).

        Returns
        -------
        Cholesky factors L of its precision, L^T times its mean, and the logarithm of the
        determinant of the prior's precision.
        """
        inverse_squares = np.repeat(1 / sizes**2, SHAPES, axis=1)
        prior = (self.basis.T * inverse_squares[:, None]) @ self.basis
        whole = np.tensordot(1 / noise, self.gram, 1)
        precision = np.tile(whole[:-1, :-1], (len(sizes), 1, 1))
        precision[:, self.n_parameters :, self.n_parameters :] += prior
        lower = np.linalg.cholesky(precision)
        white = np.linalg.solve(lower, whole[:-1, -1:])[..., 0]
        return cast(Floats, lower), white, cast(Floats, np.linalg.slogdet(prior)[1])

    def log_likelihood(self, noise: Floats, shares: Floats, sizes: Floats) -> Floats:
        """Logarithm of the restricted likelihood of sizes relative to the ceilings, (sizes, 3)."""
        lower, white, prior = self.posterior(noise, sizes)
        log_determinant = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1) - prior
        chi_squared = self.gram[:, -1, -1] @ (1 / noise) - (white**2).sum(1)
        constant = (self.counts * shares) @ np.log(noise)
        return cast(Floats, -(log_determinant + chi_squared + constant) / 2)

    def maximize_posterior(
        self, noise: Floats, shares: Floats, sizes: Floats, estimated: Booleans
    ) -> tuple[Floats, Floats]:
        """Relative variances by channel (1 where not estimated) and sizes at the posterior mode."""
        from scipy.optimize import minimize

        def unpack(logs: Floats) -> tuple[Floats, Floats]:
            squares = np.ones(len(noise))
            squares[estimated] = np.exp(logs[len(COMPONENTS) :])
            return squares, np.exp(logs[None, : len(COMPONENTS)])

        def negative_log_posterior(logs: Floats) -> float:
            squares, sizes = unpack(logs)
            return -float((self.log_likelihood(squares, shares, sizes) + log_prior(sizes))[0])

        bounds = [(math.log(SIZES[0]), 0.0)] * len(COMPONENTS)
        bounds += [(math.log(square), 14.0) for square in self.min_noise[estimated]]
        start = np.log(np.concatenate([sizes, noise[estimated]]))
        # Over the default step of 1e-8, rounding errors exceed the change of this function.
        optimum = minimize(
            negative_log_posterior, start, method="L-BFGS-B", bounds=bounds,
            options={"eps": _LOG_STEP},
        ).x  # fmt: skip
        squares, sizes = unpack(optimum)
        return squares, sizes[0]

    def rough_noise(self) -> Floats:
        """Variances by channel, relative to those of the fit, from differences of adjacent rows."""
        squares = np.array([np.sum(np.diff(part[:, -1]) ** 2) for part in self.columns])
        return np.maximum(squares / (2 * self.counts), self.min_noise)

    def effective_shares(self, noise: Floats, sizes: Floats) -> Floats:
        """Effective sample size divided by the number of values, by channel."""
        lower, white, _ = self.posterior(noise, sizes[None])
        mean = np.linalg.solve(lower[0].T, white[0])
        found = np.ones(len(self.columns))
        for index, part in enumerate(self.columns):
            residual = (part[:, -1] - part[:, :-1] @ mean)[None, None]
            assessment = independences(residual, np.array([[residual.size]]))[0][0]
            if assessment.doubtful:
                found[index] = assessment.effective / residual.size
        return found


def _prior_weights() -> Floats:
    weights = np.exp([log_prior(np.array([size])) for size in SIZES])
    return cast(Floats, weights / weights.sum())


def _unseen_shapes(speed: Floats) -> Floats:
    """As `shapes`, of the process conditioned to be zero at the fitted ones of `SPEEDS`."""
    fitted = np.clip(SPEEDS, speed.min(), speed.max()) == SPEEDS
    whole = covariance(SPEEDS[:, None], SPEEDS)
    # a small diagonal term, since the covariance is numerically singular
    known = whole[fitted][:, fitted] + 1e-6 * np.eye(int(fitted.sum()))
    conditional = whole - whole[:, fitted] @ np.linalg.solve(known, whole[fitted])
    conditional[fitted] = conditional[:, fitted] = 0.0
    return leading_functions(conditional)


def _response_of_events(fit: FitResult, responses: Responses) -> Floats:
    """Derivatives of the events with respect to accelerations, by central differences, shape
    (events, 3 * SHAPES)."""
    since = fit.observed["t"] - fit.observed["t"][0]
    path = np.array([np.interp(responses.t, since, fit.fitted[name]) for name in CHANNELS[:4]])
    changes = _SMALL * responses.by_channel[:4].transpose(2, 0, 1)
    up, down = (
        np.array([along_path(fit.throw.events, responses.t, *(path + s * by)) for by in changes])
        for s in (1, -1)
    )
    return cast(Floats, (up - down).T / (2 * _SMALL))


def _adjustable(fit: FitResult) -> Booleans:
    """Which parameters are neither fixed nor at a bound."""
    return np.array([item.verdict not in ("fixed", "at bound") for item in fit.parameters.values()])


def _null_space(matrix: Floats) -> Floats:
    """Orthonormal basis of the null space of a matrix, as columns.

    Of all bases, that of the principal axes of fixed weights of the coordinates, so that random
    draws are the same on every processor.
    """
    n = matrix.shape[1]
    projector = np.eye(n) - np.linalg.pinv(matrix, rcond=1e-9) @ matrix
    values, rows = principal_axes(projector * np.linspace(2.0, 1.0, n) @ projector)
    return rows[values > 0.5].T


def prepare_discrepancy(fit: FitResult) -> None:
    """Begin compiling the program that the discrepancy of a fit needs."""
    linearize_once.prepare(*_path_problem(fit))


def _path_problem(fit: FitResult) -> tuple[Model, Floats, Problem]:
    # Derivatives of the path itself, not of residuals transformed by the noise model and the loss.
    problem, origin = problem_of(replace(fit, loss="linear", noise=WHITE))
    values = fit.values - origin.offset(len(fit.values))
    return fit.model, values[None], stacked([problem])


def _path_jacobian(fit: FitResult) -> tuple[Floats, Floats]:
    """Derivative of the path with respect to the parameters, shape (channels, rows, parameters),
    and 1/sigma, 0 where there is no value."""
    model, values, problems = _path_problem(fit)
    jacobian = linearize_once(model, values, problems)[1]
    n = len(fit.observed["t"])
    weighted = np.asarray(jacobian)[0, :, :n]
    weight = np.asarray(problems.weight)[0, :, :n]
    return weighted / np.where(weight > 0, weight, 1.0)[..., None], weight


def _duration(fit: FitResult) -> float:
    """Time from the first row to the last, or to rest."""
    t, speed = fit.observed["t"], fit.fitted["speed"]
    resting = np.flatnonzero(speed <= 0)
    last = int(resting[0]) if len(resting) and resting[0] > 0 else len(t) - 1
    return float(t[last] - t[0])
