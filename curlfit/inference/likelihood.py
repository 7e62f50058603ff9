"""What a path says of the parameters: residuals and the log-posterior, written once.

A parameter vector holds the law's coefficients and then `x0 y0 heading v0 phi0 omega0`, in the
coordinates of a `Problem`.

Noise is Gaussian, of a sigma by channel that is given or estimated beforehand (see
`curlfit.inference.fit.rounds`), and independent from row to row unless a `Noise` says how it is
correlated. An unknown sigma is not varied along with the rest: where a law is not exact, that
likelihood has its maximum in a corner where one channel is fitted perfectly and the others pay for
it.

When a stone came to rest is a measurement of its own (see `Throw.stops`). A speed of zero at that
time would not do for it: a stone that came to rest earlier has it too. What is compared is the time
itself, and the position in that row is that at rest.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from curlfit.dynamics.trajectory import InitialState, positions, simulate

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from curlfit.friction import Law, Load
from curlfit.inference.noise.correlated import whitened
from curlfit.inference.noise.losses import signed_root
from curlfit.inference.parameters import START
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import BATCH, compiled, in_batches, unstacked

SIGMA_FLOOR = 1e-7
"""Least standard deviation of noise (m and rad): the precision of the computed path."""

_LATE = 60.0  # s after the measured end by which a stone is at rest under any trial


def split(law: type[Law], values: Any) -> tuple[Law, InitialState]:
    """A parameter vector as law and start."""
    k = len(law.coefficients())
    x0, y0, heading, v0, phi0, omega0 = (values[k + index] for index in range(len(START)))
    start = InitialState(x=x0, y=y0, heading=heading, v=v0, phi=phi0, omega=omega0)
    return law.from_vector(values), start


def _channels(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """x, y, phi, speed and spin at the times of a problem, shape (5, n).

    In the row that says when the stone came to rest they are those at rest, and the speed is the
    time that this is too late, at the mean loss of speed: below 0 where the stone stops too early.
    """
    friction, start = split(law, values)
    rows = jnp.arange(problem.times.shape[-1])
    stop = rows == problem.stop
    times = jnp.where(stop, problem.times + _LATE, _unpadded_times(problem))
    path = simulate(friction, problem.stone, start, times, load=load, t0=0.0, ordered=True)
    left = start.v * (1 - problem.times / jnp.maximum(path.rest, 1e-9))
    speed = jnp.where(stop, left, path.speed)
    return jnp.stack([path.x, path.y, path.phi, speed, path.omega])


predict_channels = compiled("law", "load")(_channels)


@compiled("law", "load")
def _batch_of_channels(law: type[Law], load: Load, values: Array, problems: Problem) -> Array:
    return jax.vmap(partial(_channels, law, load))(values, problems)


def predict_many(
    law: type[Law], load: Load, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """What `predict_channels` finds for each of many throws, shape (throws, 5, n)."""
    if batch == 1:
        pairs = zip(values, unstacked(problems), strict=True)
        return np.array([predict_channels(law, load, *pair) for pair in pairs])
    program = partial(_batch_of_channels, law, load)
    return np.asarray(in_batches(program, (values, problems), batch))


def _unpadded_times(problem: Problem) -> Array:
    """The times, inf in padded rows, which repeat the last."""
    padded = jnp.diff(problem.times, prepend=-jnp.inf) == 0
    return jnp.where(padded, jnp.inf, problem.times)


def weighted_residuals(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """(model - data) times weight, independent and as the loss has it, of the shape of the data."""
    return signed_root(_independent_residuals(law, load, values, problem), problem.loss)


def _independent_residuals(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """The same under squared loss."""
    if len(problem.observed) == 3:
        friction, start = split(law, values)
        path = positions(friction, problem.stone, start, _unpadded_times(problem), load=load)
    else:
        path = _channels(law, load, values, problem)
    residual = jnp.where(problem.weight > 0, (path - problem.observed) * problem.weight, 0.0)
    return whitened(residual, problem.whitener)


def _under_losses(residual: Array, losses: Array) -> tuple[Array, Array]:
    """Residuals of many throws as their losses have them, and the derivative of that."""

    def robust(residual: Array) -> tuple[Array, Array]:
        found: tuple[Array, Array] = jax.jvp(
            lambda r: jax.vmap(signed_root)(r, losses), (residual,), (jnp.ones_like(residual),)
        )
        return found

    def squared(residual: Array) -> tuple[Array, Array]:
        return residual, jnp.ones_like(residual)

    return jax.lax.cond((losses > 0).any(), robust, squared, residual)


@compiled("law", "load", optimize=True)
def linearize(law: type[Law], load: Load, values: Array, problems: Problem) -> tuple[Array, Array]:
    """Residuals of many throws (throws, channels, n), and their Jacobian by their parameters."""

    def one(values: Array, problem: Problem) -> tuple[Array, Array]:
        def residual(values: Array) -> tuple[Array, Array]:
            found = _independent_residuals(law, load, values, problem)
            return found, found

        return jax.jacfwd(residual, has_aux=True)(values)

    jacobian, found = jax.vmap(one)(values, problems)
    found, slope = _under_losses(found, problems.loss)
    return found, slope[..., None] * jacobian


def log_likelihood(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """Log-likelihood up to a constant; -inf where the law admits no motion."""
    value = -0.5 * (weighted_residuals(law, load, values, problem) ** 2).sum()
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


@compiled("law", "load")
def log_posterior(
    law: type[Law], load: Load, values: Array, lower: Array, upper: Array, problem: Problem
) -> Array:
    """Log-posterior of many parameter vectors, shape (walkers, parameters), under a flat prior."""
    inside = ((values >= lower) & (values <= upper)).all(-1)
    # A vector outside the bounds is never followed: it could hold up all the others.
    safe = jnp.clip(values, lower, upper)
    value = jax.vmap(lambda one: log_likelihood(law, load, one, problem))(safe)
    return jnp.where(inside, value, -jnp.inf)


@compiled("law", "load")
def _chi_squared(law: type[Law], load: Load, values: Array, problems: Problem) -> Array:
    found = jax.vmap(partial(_independent_residuals, law, load))(values, problems)
    return (_under_losses(found, problems.loss)[0] ** 2).sum((1, 2))


def chi_squared_of_many(
    law: type[Law], load: Load, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """Chi squared of each of many throws, shape (throws,); NaN where there is no motion."""
    if not len(values):
        return np.zeros(0)
    if batch > 1:
        program = partial(_chi_squared, law, load)
        return np.asarray(in_batches(program, (values, problems), batch))
    found = raw_residuals(law, load, values, problems, batch)
    roots = [signed_root(*pair) for pair in zip(found, problems.loss, strict=True)]
    return np.asarray((np.asarray(roots) ** 2).sum((1, 2)))


def raw_residuals(
    law: type[Law], load: Load, values: Floats, problems: Problem, batch: int = BATCH
) -> Floats:
    """(model - data) times weight of many throws, independent but under squared loss."""
    path = predict_many(law, load, values, problems, batch)
    residual = (path[:, : problems.observed.shape[1]] - problems.observed) * problems.weight
    if problems.whitener is None:
        return residual
    pairs = zip(residual, unstacked(problems.whitener), strict=True)
    return np.array([whitened(*pair) for pair in pairs])
