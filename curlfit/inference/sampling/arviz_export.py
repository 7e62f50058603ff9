"""A posterior sample for ArviZ: `InferenceData` of its versions 0.x, xarray's
`DataTree` of 1.x."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.combinations import with_combinations
from curlfit.inference.model.likelihood import predict_channels
from curlfit.inference.model.problem import ROWS_OF_DATA, Problem
from curlfit.inference.noise.whitening import whitened
from curlfit.losses import LOSSES, Loss
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.output.frames import optional
from curlfit.version import __version__

_DRAWS = ("chain", "draw")
_MOST_CORRELATED = 6000  # largest number of values whose covariance is inverted


def inference_data(
    fit: FitResult, samples: Floats, log_posterior: Floats, *, draws: int, seed: int
) -> Any:
    """A posterior sample as ArviZ has it, see `Chain.to_arviz`.

    Parameters
    ----------
    samples : shape (ensembles, walkers, steps, parameters).
    log_posterior : shape (ensembles, walkers, steps).
    """
    if draws < 1:
        raise InputError(f"draws = {draws}: expected a positive number")
    # the first import of ArviZ in a day announces its next version
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        arviz = optional("arviz", "arviz")
    ensembles, walkers, steps, size = samples.shape
    thin = -(-ensembles * walkers * steps // draws)  # rounded up
    steps_kept = np.arange(0, steps, thin)
    # Draws of one walker are consecutive, so that autocorrelations are those of
    # the walkers.
    flat = samples[:, :, ::thin].reshape(ensembles, -1, size)
    flat_log_posterior = log_posterior[:, :, ::thin].reshape(ensembles, -1)
    index = {
        "chain": np.arange(ensembles),
        "draw": np.arange(flat.shape[1]),
        "walker": ("draw", np.repeat(np.arange(walkers), len(steps_kept))),
        "step": ("draw", np.tile(steps_kept, walkers)),
    }
    groups = {
        "posterior": (_parameters(fit, flat), index),
        "log_prior": (_log_priors(fit, flat), index),
        "sample_stats": ({"lp": (_DRAWS, flat_log_posterior)}, index),
        **_of_data(fit, flat, index, np.random.default_rng(seed)),
    }
    attrs = {
        "inference_library": "curlfit",
        "inference_library_version": __version__,
        "law": fit.law,
        "load": fit.load.value,
        "data": fit.data.file,
        "thinning": thin,
    }
    xarray = import_module("xarray")
    datasets = {
        name: xarray.Dataset(variables, coordinates)
        for name, (variables, coordinates) in groups.items()
    }
    if arviz.__version__.startswith("0."):
        return arviz.InferenceData(**datasets, attrs=attrs)
    return xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=attrs), **datasets})


def _parameters(fit: FitResult, flat: Floats) -> dict[str, Any]:
    """Free parameters and determined combinations of samples (..., parameters)."""
    samples = with_combinations(fit.parameter_set.names, flat, fit.combinations)
    fixed = fit.parameter_set.fixed
    return {
        name: (_DRAWS, values) for name, values in samples.items() if name not in fixed
    }


def _log_priors(fit: FitResult, flat: Floats) -> dict[str, Any]:
    """Log-densities of the priors of free parameters, each up to a constant; a
    flat one is 0."""
    parameters = fit.parameter_set
    log_priors = -0.5 * parameters.penalty.residual_and_slope(flat)[0] ** 2
    return {
        name: (_DRAWS, log_priors[..., index])
        for index, name in enumerate(parameters.names)
        if name not in parameters.fixed
    }


def _of_data(
    fit: FitResult, flat: Floats, index: dict[str, Any], random: np.random.Generator
) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Variables and coordinates of the groups about the data, by channel."""
    problem = problem_of(fit)
    measured = np.asarray(problem.weight) > 0
    row_of_value, _ = np.nonzero(measured)
    is_of_channel: dict[str, Booleans] = {}
    dimensions: dict[str, str] = {}
    times = {"time": fit.observed["t"]}
    for row in np.flatnonzero(measured.any(1)):
        channel = ROWS_OF_DATA[row]
        is_of_channel[channel] = row_of_value == row
        if channel == "event":
            dimensions[channel] = "measured"
            times["measured"] = np.array([event.name for event in fit.events])
            continue
        # rows that pad the data left out
        is_timed = measured[row, : len(times["time"])]
        if is_timed.all():
            dimensions[channel] = "time"
        else:
            dimensions[channel] = f"time_{channel}"
            times[f"time_{channel}"] = times["time"][is_timed]

    def by_channel(array: Floats, *outer: str, prefix: str = "") -> dict[str, Any]:
        """Variables of an array whose last axis is that of the measured values."""
        return {
            prefix + channel: ((*outer, dimension), array[..., is_of_channel[channel]])
            for channel, dimension in dimensions.items()
        }

    def by_draw(array: Floats) -> dict[str, Any]:
        return by_channel(array.reshape(*flat.shape[:2], -1), *_DRAWS)

    paths = []
    for parameters in flat.reshape(-1, flat.shape[-1]):
        path = np.asarray(predict_channels(fit.model, parameters, problem))
        paths.append(path[: len(measured)][measured])
    sigma = 1 / problem.weight[measured]
    values = _measured(fit, problem)[measured]
    # events are on the clock of the data in `values`, on that of the path in `paths`
    mean = values + np.array(paths) - problem.observed[measured]
    noise = whitening_matrix(problem)
    loss = LOSSES[fit.loss]
    replicated = mean + sigma * draw_noise(random, mean.shape, noise, loss)
    pointwise = log_likelihoods((values - mean) / sigma, noise, loss) - np.log(sigma)
    constant = {"t": ("time", times["time"]), **by_channel(sigma, prefix="sigma_")}
    return {
        "posterior_predictive": (by_draw(replicated), index | times),
        "log_likelihood": (by_draw(pointwise), index | times),
        "observed_data": (by_channel(values), times),
        "constant_data": (constant, times),
    }


def _measured(fit: FitResult, problem: Problem) -> Floats:
    """The data of a problem, with times of events on the clock of the data."""
    values = np.array(problem.observed)
    for column, event in enumerate(fit.events):
        values[-1, column] = event.event.value
    return values


def whitening_matrix(problem: Problem) -> Floats | None:
    """The matrix W that makes the observed residuals over sigma independent, shape (m,
    m): their covariance is (W^T W)^-1. None where they are independent.

    Raises
    ------
    InputError : there are too many values.
    """
    if problem.whitener is None:
        return None
    import jax

    measured = np.asarray(problem.weight) > 0
    number = int(measured.sum())
    if number > _MOST_CORRELATED:
        raise InputError(
            f"{number} values with correlated noise; ArviZ can be given at most "
            f"{_MOST_CORRELATED}: fit fewer rows"
        )

    def whitened_values(values: Any) -> Any:
        residual = jax.numpy.zeros(measured.shape).at[measured].set(values)
        return whitened(residual, problem.whitener)[measured]

    # whitening is linear: its matrix is its derivative, anywhere
    return np.asarray(jax.jacfwd(whitened_values)(np.zeros(number)))


def log_likelihoods(residual: Floats, whitening: Floats | None, loss: Loss) -> Floats:
    """Log-density of each residual over its sigma, shape (draws, m).

    For correlated noise it is that of the value given all others, as leave-one-out
    requires: with C^-1 = W^T W, g = C^-1 r and c = diag C^-1, it is a normal density
    with mean r - g/c and variance 1/c (Buerkner, Gabry and Vehtari 2021, Computational
    Statistics 36, eq. 9).
    """
    if whitening is None:
        return loss.log_density(residual)
    precision = (whitening**2).sum(0)  # c
    pull = residual @ whitening.T @ whitening  # g
    doubled = np.log(precision) - pull**2 / precision - np.log(2 * np.pi)
    log_densities: Floats = 0.5 * doubled
    return log_densities


def draw_noise(
    random: np.random.Generator,
    shape: tuple[int, ...],
    whitening: Floats | None,
    loss: Loss,
) -> Floats:
    """Draws of noise over its sigma, shape (draws, m): correlated, or of the
    density of a loss."""
    if whitening is not None:
        return np.asarray(np.linalg.solve(whitening, random.standard_normal(shape).T).T)
    return loss.draw(random, shape)
