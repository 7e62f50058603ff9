"""A posterior sample for ArviZ: `InferenceData` of its versions 0.x, xarray's `DataTree` of 1.x."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import with_combinations
from curlfit.inference.likelihood import predict_channels
from curlfit.inference.noise.losses import log_density
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.output.frames import optional
from curlfit.throws.throw import CHANNELS
from curlfit.version import __version__

_DRAWS = ("chain", "draw")
_MOST_CORRELATED = 6000  # largest number of values whose covariance is inverted
_BLOCK = 256  # columns of a matrix that are computed at a time
_REACH = 200.0  # sigmas within which the noise of a robust loss is drawn


def inference_data(
    fit: FitResult, samples: Floats, log_posterior: Floats, *, draws: int, seed: int
) -> Any:
    """See `Chain.to_arviz`.

    Parameters
    ----------
    samples : shape (ensembles, walkers, steps, parameters). log_posterior : the same without the
        last axis.
    """
    if draws < 1:
        raise InputError(f"draws = {draws}: expected a positive number")
    _arviz()  # before what takes time
    ensembles, walkers, steps, _ = samples.shape
    thin = -(-ensembles * walkers * steps // draws)
    kept = samples[:, :, ::thin]
    # Draws of one walker are consecutive, so that autocorrelations are those of the walkers.
    flat = kept.reshape(ensembles, -1, samples.shape[-1])
    labels = {
        "walker": ("draw", np.repeat(np.arange(walkers), kept.shape[2])),
        "step": ("draw", np.tile(np.arange(0, steps, thin), walkers)),
    }
    problem, origin = problem_of(fit)
    data = _Observations.of(fit, problem, origin.place)
    paths = np.array([
        np.asarray(predict_channels(fit.model, values, problem))[data.finite_rows]
        for values in flat.reshape(-1, samples.shape[-1]) - origin.offset(samples.shape[-1])
    ])  # fmt: skip
    mean = paths + data.place
    pointwise = log_likelihoods((data.values - mean) / data.sigma, data.noise, fit.loss)
    random = np.random.default_rng(seed)
    replicated = mean + data.sigma * draw_noise(random, mean.shape, data.noise, fit.loss)

    def by_draw(array: Floats) -> dict[str, Any]:
        return data.by_channel(array.reshape(*flat.shape[:2], -1), *_DRAWS)

    lp = log_posterior[:, :, ::thin].reshape(ensembles, -1)
    times = data.coordinates(fit.observed["t"])
    groups: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "posterior": (_parameters(fit, flat), labels),
        "posterior_predictive": (by_draw(replicated), times),
        "log_likelihood": (by_draw(pointwise - np.log(data.sigma)), times),
        "log_prior": (_log_priors(fit, flat), {}),
        "sample_stats": ({"lp": (_DRAWS, lp)}, labels),
        "observed_data": (data.by_channel(data.values), times),
        "constant_data": (
            {"t": ("time", fit.observed["t"]), **data.by_channel(data.sigma, prefix="sigma_")},
            times,
        ),
    }
    attrs = {
        "inference_library": "curlfit", "inference_library_version": __version__,
        "law": fit.law, "load": fit.load, "data": fit.data["file"], "thinning": thin,
    }  # fmt: skip
    index = {"chain": np.arange(ensembles), "draw": np.arange(flat.shape[1])}
    return _assembled(groups, index, attrs)


def _assembled(
    groups: dict[str, tuple[dict[str, Any], dict[str, Any]]],
    index: dict[str, Any],
    attrs: dict[str, Any],
) -> Any:
    """The `InferenceData` or `DataTree` of variables and coordinates by group."""
    arviz, xarray = _arviz(), import_module("xarray")
    sets = {
        name: xarray.Dataset(values, coords if name.endswith("_data") else index | coords)
        for name, (values, coords) in groups.items()
    }
    if arviz.__version__.startswith("0."):
        return arviz.InferenceData(**sets, attrs=attrs)
    return xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=attrs), **sets})


def _parameters(fit: FitResult, flat: Floats) -> dict[str, Any]:
    """Free parameters and determined combinations of samples (..., parameters)."""
    found = with_combinations(fit.parameter_set.names, flat, fit.combinations)
    fixed = fit.parameter_set.fixed
    return {name: (_DRAWS, values) for name, values in found.items() if name not in fixed}


def _log_priors(fit: FitResult, flat: Floats) -> dict[str, Any]:
    """Log-densities of the priors of free parameters, each up to a constant; a flat one is 0."""
    penalty = fit.parameter_set.penalty
    logs = flat * 0.0 if penalty is None else -0.5 * penalty.residual_and_slope(flat)[0] ** 2
    names = fit.parameter_set.names
    return {name: (_DRAWS, logs[..., names.index(name)]) for name in _free(fit)}


def _free(fit: FitResult) -> Sequence[str]:
    return fit.parameter_set.names_where(fit.parameter_set.free)


def _arviz() -> Any:
    with warnings.catch_warnings():  # its first import of a day announces the next version
        warnings.simplefilter("ignore", FutureWarning)
        return optional("arviz", "arviz")


class _Observations(NamedTuple):
    """The m observed values of all channels, concatenated."""

    finite_rows: Booleans
    """which values of a problem were observed, shape (channels, padded rows)"""
    row_of: Any
    """row of the channel of each value, shape (m,)"""
    place: Floats
    """the problem's origin in the coordinates of the data, shape (m,)"""
    values: Floats
    sigma: Floats
    noise: Floats | None
    """whitening matrix of residuals over sigma, shape (m, m); None where they are independent"""
    channels: tuple[tuple[int, str], ...]
    """rows and names of the observed channels"""
    dimensions: dict[str, str]
    """by channel: `time`, or one of its own where values are missing"""
    seen: dict[str, Booleans]

    @classmethod
    def of(cls, fit: FitResult, problem: Problem, place: Floats) -> _Observations:
        weight = np.zeros((len(CHANNELS), problem.weight.shape[1]))
        weight[: len(problem.weight)] = problem.weight
        finite = weight > 0
        row_of = np.nonzero(finite)[0]
        channels = tuple((row, CHANNELS[row]) for row in np.unique(row_of).tolist())
        n = len(fit.observed["t"])
        seen = {name: finite[row, :n] for row, name in channels}
        origin = place[row_of]
        return cls(
            finite, row_of, origin, problem.observed[finite[: len(problem.weight)]] + origin,
            1 / weight[finite], whitening_matrix(problem), channels,
            {name: "time" if there.all() else f"time_{name}" for name, there in seen.items()}, seen,
        )  # fmt: skip

    def by_channel(self, array: Floats, *outer: str, prefix: str = "") -> dict[str, Any]:
        """Variables of xarray, of an array of the last axis m."""
        return {
            prefix + name: ((*outer, self.dimensions[name]), array[..., self.row_of == row])
            for row, name in self.channels
        }

    def coordinates(self, t: Floats) -> dict[str, Floats]:
        """Times of each dimension, s."""
        return {"time": t} | {
            self.dimensions[name]: t[there] for name, there in self.seen.items() if not there.all()
        }


def whitening_matrix(problem: Problem) -> Floats | None:
    """The matrix W that makes the observed residuals over sigma independent, shape (m, m): their
    covariance is (W^T W)^-1. None where they are independent.

    Raises
    ------
    InputError : there are too many values.
    """
    if problem.whitener is None:
        return None
    from jax import vmap

    seen = problem.weight > 0
    places = np.argwhere(seen)
    if len(places) > _MOST_CORRELATED:
        raise InputError(
            f"{len(places)} values with correlated noise; ArviZ can be given at most "
            f"{_MOST_CORRELATED}: fit fewer rows"
        )
    whiten = vmap(problem.whitener.whiten)
    columns = []
    for first in range(0, len(places), _BLOCK):
        block = places[first : first + _BLOCK]
        units = np.zeros((_BLOCK, *seen.shape))
        units[(np.arange(len(block)), *block.T)] = 1.0
        columns.append(np.asarray(whiten(units))[: len(block), seen])
    return np.concatenate(columns).T


def log_likelihoods(residual: Floats, whitening: Floats | None, loss: str) -> Floats:
    """Log-density of each residual over its sigma, shape (draws, m).

    For correlated noise it is that of the value given all others, as leave-one-out requires: with
    C^-1 = W^T W, g = C^-1 r and c = diag C^-1, it is a normal density with mean r - g/c and
    variance 1/c (Buerkner, Gabry and Vehtari 2021, Computational Statistics 36, eq. 9).
    """
    if whitening is None:
        return log_density(residual, loss)
    diagonal = (whitening**2).sum(0)
    pull = residual @ whitening.T @ whitening
    found: Floats = 0.5 * (np.log(diagonal) - pull**2 / diagonal - np.log(2 * np.pi))
    return found


def draw_noise(
    random: np.random.Generator, shape: tuple[int, ...], whitening: Floats | None, loss: str
) -> Floats:
    """Draws of noise over its sigma, shape (draws, m): correlated, or of the density of a loss."""
    if whitening is not None:
        return np.asarray(np.linalg.solve(whitening, random.standard_normal(shape).T).T)
    if loss == "linear":
        return random.standard_normal(shape)
    # Inverse transform sampling from the tabulated distribution function.
    grid = np.sinh(np.linspace(-np.arcsinh(_REACH), np.arcsinh(_REACH), 4001))
    density = np.exp(log_density(grid, loss))
    share = np.concatenate([[0.0], np.cumsum(np.diff(grid) * (density[1:] + density[:-1]) / 2)])
    return np.interp(random.random(shape), share / share[-1], grid)
