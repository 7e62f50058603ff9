"""Residuals and log-posterior of the parameters given a measured path, defined
in one place.

Noise is Gaussian, with a sigma for each channel that is given or estimated beforehand
(see `curlfit.inference.fit.revisions`), and independent from row to row unless a
`Noise` describes its correlation. An unknown sigma is not estimated together with the
parameters: where a law is not exact, that likelihood has its maximum in a corner where
one channel is fitted perfectly at the expense of the others.

Timed events, such as crossing a line or coming to rest, are observations besides the
channels, each with its own sigma (see `curlfit.throws.events`). A speed of zero at
the time of rest would not do as an observation: a stone that came to rest earlier
also has it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations
from curlfit.dynamics.passages import with_passages
from curlfit.dynamics.trajectory import (
    external_forces,
    ordered_trajectory,
    positions,
    trajectory,
)
from curlfit.friction import NetLaw
from curlfit.inference.model.model import Model
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import Problem
from curlfit.inference.model.spin_at_rest import RowIntervals
from curlfit.inference.model.system import System
from curlfit.inference.noise.whitening import whitened
from curlfit.losses import LOSSES, loss_at
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH, in_batches, over_stack, stacked, unstacked
from curlfit.numerics.compiled import compiled
from curlfit.stone import GRAVITY
from curlfit.throws.events import EventArrays

SIGMA_FLOOR = 1e-7
"""Smallest standard deviation of noise (m and rad): the precision of the
computed path."""


def _forces(model: Model, system: System) -> Array:
    """Forces other than friction. A slope that is not a parameter is small: its
    dependence on the heading is left out of the derivatives, which saves those
    by the forces."""
    heading = system.start.heading
    heading = heading if model.has_slope else jax.lax.stop_gradient(heading)
    return external_forces(system.stone, system.environment, heading)


def _channels(model: Model, values: Array, problem: Problem) -> Array:
    """x, y, phi, speed and spin at the times of a problem, shape (5, n); with events, a
    sixth row has one event per column, or the friction in a state."""
    system = System.of(model, values, problem.stone, problem.environment)
    if problem.times is None:  # friction alone
        return jnp.pad(_braking(model, system, problem.states)[None], ((5, 0), (0, 0)))
    measured = _unpadded_times(problem) / system.time_scale
    count = len(measured)
    times = measured
    spins = problem.spins if issubclass(model.law, NetLaw) else None
    if spins is not None:
        intervals = RowIntervals.about(measured, spins.interval / system.time_scale)
        times = intervals.times
    of_events = None
    if problem.events is not None:
        path, of_events = _path_and_events(model, system, problem.events, times)
    else:
        motion = ordered_trajectory if spins is None else trajectory
        path = motion(
            system.law,
            system.stone,
            _forces(model, system),
            system.start,
            times,
            jnp.zeros(()),
            load=model.load,
        )
    omega = path.omega
    if spins is not None:
        omega = intervals.spins(path, spins.values)
    x = _scaled(path.x, system.start.x, system.length_scale)
    y = _scaled(path.y, system.start.y, system.length_scale)
    rows = [channel[:count] for channel in (x, y, path.phi, path.speed, omega)]
    if of_events is not None or problem.states is not None:
        beside_path = jnp.zeros(count)
        if of_events is not None:
            beside_path = beside_path.at[: len(of_events)].set(of_events)
        if problem.states is not None:
            braking = _braking(model, system, problem.states)
            beside_path = jnp.where(problem.states[0] > 0, braking, beside_path)
        rows.append(beside_path)
    return jnp.stack(rows)


def _path_and_events(
    model: Model, system: System, events: EventArrays, times: Array
) -> tuple[Any, Array]:
    """The path at some times, and the values of events as measured, shape (events,).

    An event is a weighted sum of what there is at lines and at rest, in the order of
    its weights: times, x and angles at lines; time, x, y and angle at rest; speeds and
    spins at lines.
    """
    start = system.start
    scale = system.length_scale
    weights = events.weights
    path, passages = with_passages(
        system.law,
        system.stone,
        _forces(model, system),
        start,
        start.y + (events.lines - start.y) / scale,
        times,
        (weights != 0).any(),
        load=model.load,
    )
    rest_time, rest_x, rest_y, rest_phi = passages.rest
    at_rest = jnp.stack(
        [
            rest_time * system.time_scale,
            _scaled(rest_x, start.x, scale),
            _scaled(rest_y, start.y, scale),
            rest_phi,
        ]
    )
    at_lines_and_rest = jnp.concatenate(
        [
            passages.time * system.time_scale,
            _scaled(passages.x, start.x, scale),
            passages.phi,
            at_rest,
            passages.speed,
            passages.omega,
        ]
    )
    values = jnp.where(weights != 0, weights * at_lines_and_rest, 0.0).sum(-1)
    return path, values


def _braking(model: Model, system: System, states: Array) -> Array:
    """Braking force over the weight at speeds and spins, of any size where
    a speed is 0."""
    speed, omega = states
    state = jnp.where(speed > 0, speed, 1.0), omega
    acceleration = accelerations(system.law, system.stone, model.load, *state)
    return -acceleration.eta / GRAVITY


def _scaled(position: Array, start: Array, scale: Any) -> Array:
    """Measured positions from true ones; the initial position is as measured."""
    return position if isinstance(scale, float) else start + scale * (position - start)


def predict_channels(model: Model, values: Any, problem: Problem) -> Floats:
    """x, y, phi, speed and spin at the times of a problem, shape (5, n); with events, a
    sixth row has one event per column."""
    path: Floats = predict_many(model, values[None], stacked([problem]), 1)[0]
    return path


def prepare_channels(model: Model, parameters: int, problem: Problem) -> None:
    """Begin to compile what `predict_channels` needs."""
    _stack_of_channels.prepare(
        *_of_path(model, np.zeros((1, parameters)), stacked([problem]))
    )


def _of_path(
    model: Model, values: Any, problems: Problem
) -> tuple[Model, Any, Problem]:
    """Arguments of a program for paths."""
    return model.of_program, model.vector(values), _without_data(problems)


def _without_data(problem: Problem) -> Problem:
    """Only what a path depends on: one program serves all channels, losses and
    noise models."""
    return problem._replace(observed=None, weight=None, loss=None, whitener=None)


@compiled("model")
def _stack_of_channels(model: Model, values: Array, problems: Problem) -> Any:
    return over_stack(partial(_channels, model), values, problems)


def predict_many(
    model: Model, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """The result of `predict_channels` for each of many throws, shape
    (throws, 5 or 6, n)."""
    of_program, vectors, without_data = _of_path(model, values, problems)
    program = partial(_stack_of_channels, of_program)
    return np.asarray(in_batches(program, (vectors, without_data), batch))


@compiled("model")
def _slopes_of_channels(model: Model, values: Array, problems: Problem) -> Any:
    return over_stack(jax.jacfwd(partial(_channels, model)), values, problems)


def path_jacobians(model: Model, values: Floats, problems: Problem) -> Floats:
    """Derivatives of the result of `predict_many` by the parameters, (throws, 5
    or 6, n, p)."""
    slopes = np.asarray(_slopes_of_channels(*_of_path(model, values, problems)))
    return slopes[..., model.columns(values.shape[-1])]


def _unpadded_times(problem: Problem) -> Array:
    """The times; inf in padded rows, which repeat the last time."""
    padded = jnp.diff(problem.times, prepend=-jnp.inf) == 0
    return jnp.where(padded, jnp.inf, problem.times)


def weighted_residuals(model: Model, values: Array, problem: Problem) -> Array:
    """(model - data) times weight, whitened and transformed by the loss, shaped
    like the data."""
    return _signed_root(_whitened_residuals(model, values, problem), problem.loss)


def _signed_root(residual: Any, place: Any) -> Any:
    """sqrt(rho) with the sign of the residual, of the loss at a place in `LOSSES`.

    A compiled program contains all losses where the place is traced, one where it is a
    number.
    """
    if isinstance(place, jax.Array):
        roots = [loss.signed_root for loss in LOSSES.values()]
        return jax.lax.switch(place, roots, jnp.asarray(residual))
    return loss_at(int(place)).signed_root(residual)


def _whitened_residuals(model: Model, values: Array, problem: Problem) -> Array:
    """(model - data) times weight, whitened but not transformed by the loss."""
    # Positions alone take half the time, but cannot be differentiated by the times.
    if len(problem.observed) == 3 and "time_scale" not in model.conditions:
        system = System.of(model, values, problem.stone, problem.environment)
        start = system.start
        scale = system.length_scale
        # Friction alone is faster; without such a parameter the ice is level and
        # the air still.
        forces = _forces(model, system) if model.has_environment else None
        x, y, phi = positions(
            system.law,
            system.stone,
            forces,
            start,
            _unpadded_times(problem),
            load=model.load,
        )
        path = jnp.stack([_scaled(x, start.x, scale), _scaled(y, start.y, scale), phi])
    else:
        path = _channels(model, values, problem)[: len(problem.observed)]
    residual = jnp.where(
        problem.weight > 0, (path - problem.observed) * problem.weight, 0.0
    )
    return whitened(residual, problem.whitener)


@compiled("model")
def linearize(model: Model, values: Array, problems: Problem) -> tuple[Array, Array]:
    """Residuals of throws, shape (throws, channels, n), and their Jacobian by the
    parameters; both whitened, but not transformed by a loss."""

    def of_throw(values: Array, problem: Problem) -> tuple[Array, Array]:
        def residual_twice(values: Array) -> tuple[Array, Array]:
            residual = _whitened_residuals(model, values, problem)
            return residual, residual  # to be differentiated, and as it is

        return jax.jacfwd(residual_twice, has_aux=True)(values)

    jacobians, residuals = over_stack(of_throw, values, problems)
    return residuals, jacobians


def log_likelihood(model: Model, values: Array, problem: Problem) -> Array:
    """Log-likelihood up to a constant; -inf where the law admits no motion."""
    value = -0.5 * (weighted_residuals(model, values, problem) ** 2).sum()
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


@compiled("model")
def log_posterior(
    model: Model,
    values: Array,
    lower: Array,
    upper: Array,
    problem: Problem,
    penalty: Penalty,
) -> Array:
    """Log-posterior of many parameter vectors, shape (walkers, parameters); the prior
    is uniform within the bounds except for the densities in the penalty."""
    inside = ((values >= lower) & (values <= upper)).all(-1)
    # No path is computed outside the bounds: it could hold up all the others.
    safe = jnp.clip(values, lower, upper)
    value = jax.vmap(lambda vector: log_likelihood(model, vector, problem))(safe)
    value = value - 0.5 * penalty.chi_squared(safe)
    return jnp.where(inside, value, -jnp.inf)


@compiled("model")
def _chi_squared(model: Model, values: Array, problems: Problem) -> Array:
    residuals = jax.vmap(partial(_whitened_residuals, model))(values, problems)
    return (jax.vmap(_signed_root)(residuals, problems.loss) ** 2).sum((1, 2))


def chi_squared_of_many(
    model: Model, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """Chi squared of each of many throws, shape (throws,); NaN where there
    is no motion."""
    if not len(values):
        return np.zeros(0)
    if batch > 1:
        program = partial(_chi_squared, model)
        return np.asarray(in_batches(program, (values, problems), batch))
    # of one throw: the program of its path is there already
    residuals = whitened_residuals_of_many(model, values, problems, batch)
    roots = [
        _signed_root(residual, loss)
        for residual, loss in zip(residuals, problems.loss, strict=True)
    ]
    return (np.array(roots) ** 2).sum((1, 2))


def whitened_residuals_of_many(
    model: Model, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """(model - data) times weight of many throws, whitened but not transformed
    by the loss."""
    path = predict_many(model, values, problems, batch)
    residual = (
        path[:, : problems.observed.shape[1]] - problems.observed
    ) * problems.weight
    if problems.whitener is None:
        return residual
    whiteners = unstacked(problems.whitener)
    return np.array(
        [
            whitened(of_throw, whitener)
            for of_throw, whitener in zip(residual, whiteners, strict=True)
        ]
    )
