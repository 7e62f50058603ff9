"""What a path says of the parameters: residuals and the log-posterior, written once.

A parameter vector holds the law's coefficients and then `x0 y0 heading v0 phi0 omega0`. Inside a
`Problem` the first time is 0 and place and angle count from a reference near the first row, so
that neither a clock nor a map grid with large numbers costs precision.

Noise is Gaussian, of a sigma by channel that is given or estimated beforehand (see
`curlfit.inference.fit.fit`), and independent from row to row unless a `Noise` says how it goes
together. An unknown sigma is not varied along with the rest: where a law is not exact, that
likelihood has its maximum in a corner where one channel is fitted perfectly and the others pay for
it.

When a stone came to rest is a measurement of its own (see `Throw.stops`). A speed of zero at that
time would not do for it: a stone that came to rest earlier has it too. What is compared is the time
itself, and the place of that row is the place at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple, TypeVar

from curlfit.dynamics.trajectory import Start, places, simulate

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from curlfit.friction import Law, Load
from curlfit.inference.noise.correlated import colour_of, whitened
from curlfit.inference.noise.losses import signed_root
from curlfit.inference.noise.models import Noise
from curlfit.inference.parameters import LOSSES, START
from curlfit.numerics.compiled import kept
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS, Throw

Floats = NDArray[np.float64]
Record = TypeVar("Record")

SIGMA_FLOOR = 1e-7
"""Least noise (m and rad) that is believed: the precision of the computed path."""

LANES = 64
"""Throws or vectors that are followed side by side: few enough for a processor's cache, enough to
share the cost of a pass."""

_LATE = 60.0  # s after the measured end by which a stone is at rest under any trial
_SHORTEST = 256  # data are padded to a power of two from here up, so that few shapes are compiled


class Problem(NamedTuple):
    """A throw as arrays for the compiled model; n is the padded number of rows."""

    times: Any
    """s since the first row, shape (n,)"""
    observed: Any
    """x, y, phi relative to the reference, zero where not seen, shape (3, n); with speed and
    omega, where these were measured, (5, n)"""
    weight: Any
    """1/sigma, 0 where not seen, of the same shape"""
    stone: Stone
    loss: Any = 0
    """place of the loss in `LOSSES`"""
    stop: Any = -1
    """row whose speed stands for the time of coming to rest; -1 where there is none"""
    colour: Any = None
    """what makes noise independent that is not, see `curlfit.inference.noise.correlated`"""


class Frame(NamedTuple):
    """Where a problem's zero lies in the coordinates of the data."""

    t: float
    place: Floats
    """x, y, phi and two zeros for speed and omega, shape (5,)"""

    def offset(self, size: int) -> Floats:
        """What to add to a parameter vector of a problem to have it in the data's coordinates."""
        offset = np.zeros(size)
        names = [item.name for item in START]
        for name, value in zip(("x0", "y0", "phi0"), self.place[:3], strict=True):
            offset[size - len(START) + names.index(name)] = value
        return offset


def frame_of(throw: Throw) -> Frame:
    """The frame of a throw: its first time, and the first finite value of each channel."""
    place = np.zeros(len(CHANNELS))
    seen = throw.finite[:3]
    first = throw.observed[np.arange(3), seen.argmax(1)]
    place[:3] = np.where(seen.any(1), first, 0.0)
    return Frame(float(throw.t[0]), place)


def problem_of(
    throw: Throw,
    stone: Stone,
    frame: Frame,
    sigma: dict[str, float],
    loss: str = "linear",
    noise: Noise | None = None,
) -> Problem:
    """The throw in a frame, padded. `sigma` serves the channels of which the throw gives none."""
    n = len(throw)
    rows = 5 if {"speed", "omega"} & set(throw.seen) else 3
    long = max(_SHORTEST, 1 << (n - 1).bit_length())
    seen = throw.finite[:rows]
    times = np.full(long, throw.t[-1] - frame.t)
    times[:n] = throw.t - frame.t
    observed, weight = np.zeros((rows, long)), np.zeros((rows, long))
    observed[:, :n] = np.where(seen, throw.observed[:rows] - frame.place[:rows, None], 0.0)
    for row, name in enumerate(CHANNELS[:rows]):
        weight[row, :n] = np.where(seen[row], 1 / _size(throw, sigma, name), 0.0)
    return Problem(
        times=times,
        observed=observed,
        weight=weight,
        stone=_as_arrays(*map(float, vars(stone).values())),
        loss=np.asarray(LOSSES.index(loss)),
        stop=np.asarray(n - 1 if throw.stops else -1),
        colour=None if noise is None else colour_of(noise, times, weight),
    )


@lru_cache(64)
def _as_arrays(*values: float) -> Stone:
    return Stone(*map(np.asarray, values))  # type: ignore[arg-type]


def _size(throw: Throw, sigma: dict[str, float], name: str) -> Any:
    """Sigma of a channel; 1 where a value was not seen."""
    given = throw.sigma.get(name)
    return sigma.get(name, 1.0) if given is None else np.where(given > 0, given, 1.0)


def split(law: type[Law], values: Any) -> tuple[Law, Start]:
    """A parameter vector as law and start."""
    k = len(law.coefficients())
    x0, y0, heading, v0, phi0, omega0 = (values[k + place] for place in range(len(START)))
    start = Start(x=x0, y=y0, heading=heading, v=v0, phi=phi0, omega=omega0)
    return law.from_vector(values), start


def model(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """x, y, phi, speed and spin at the times of a problem, shape (5, n).

    In the row that says when the stone came to rest they are those at rest, and the speed is the
    time that this is too late, at the mean loss of speed: below 0 where the stone stops too early.
    """
    friction, start = split(law, values)
    rows = jnp.arange(problem.times.shape[-1])
    stop = rows == problem.stop
    times = jnp.where(stop, problem.times + _LATE, _asked(problem))
    path = simulate(friction, problem.stone, start, times, load=load, t0=0.0, ordered=True)
    left = start.v * (1 - problem.times / jnp.maximum(path.rest, 1e-9))
    speed = jnp.where(stop, left, path.speed)
    return jnp.stack([path.x, path.y, path.phi, speed, path.omega])


def _asked(problem: Problem) -> Array:
    """The times, inf in padded rows, which repeat the last."""
    padded = jnp.diff(problem.times, prepend=-jnp.inf) == 0
    return jnp.where(padded, jnp.inf, problem.times)


def weighted_residuals(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """(model - data) times weight, independent and as the loss has it, of the shape of the data."""
    return signed_root(_independent(law, load, values, problem), problem.loss)


def _independent(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """The same without any loss."""
    if len(problem.observed) == 3:
        friction, start = split(law, values)
        path = places(friction, problem.stone, start, _asked(problem), load=load)
    else:
        path = model(law, load, values, problem)
    residual = jnp.where(problem.weight > 0, (path - problem.observed) * problem.weight, 0.0)
    return whitened(residual, problem.colour)


@kept("law", "load", often=True)
def linearised(law: type[Law], load: Load, values: Array, problems: Problem) -> tuple[Array, Array]:
    """Residuals of many throws (throws, channels, n), and their Jacobian by their parameters.

    One loss, that of the first throw, holds for all.
    """

    def one(values: Array, problem: Problem) -> tuple[Array, Array]:
        def residual(values: Array) -> tuple[Array, Array]:
            found = _independent(law, load, values, problem)
            return found, found

        return jax.jacfwd(residual, has_aux=True)(values)

    jacobian, found = jax.vmap(one)(values, problems)
    root = partial(signed_root, loss=problems.loss[0])
    found, slope = jax.jvp(root, (found,), (jnp.ones_like(found),))
    return found, slope[..., None] * jacobian


def log_likelihood(law: type[Law], load: Load, values: Array, problem: Problem) -> Array:
    """Log-likelihood up to a constant; -inf where the law admits no motion."""
    value = -0.5 * (weighted_residuals(law, load, values, problem) ** 2).sum()
    return jnp.where(jnp.isfinite(value), value, -jnp.inf)


@kept("law", "load")
def log_posterior(
    law: type[Law], load: Load, values: Array, lower: Array, upper: Array, problem: Problem
) -> Array:
    """Log-posterior of many parameter vectors, shape (walkers, parameters), under a flat prior."""
    inside = ((values >= lower) & (values <= upper)).all(-1)
    # A vector outside the bounds is never followed: it could hold up all the others.
    safe = jnp.clip(values, lower, upper)
    value = jax.vmap(lambda one: log_likelihood(law, load, one, problem))(safe)
    return jnp.where(inside, value, -jnp.inf)


def raw_residuals(law: type[Law], load: Load, values: Floats, problem: Problem) -> Floats:
    """(model - data) times weight, independent but without any loss, of the shape of the data."""
    path = np.asarray(trace(law, load, values, problem))
    residual = (path[: len(problem.observed)] - problem.observed) * problem.weight
    return residual if problem.colour is None else np.asarray(whitened(residual, problem.colour))


def stacked(each: Sequence[Record]) -> Record:
    """Problems or other records of one shape as one, with the throws along the first axis of each
    array."""
    found: Record = jax.tree.map(lambda *leaves: np.stack(leaves), *each)
    return found


def unstacked(stack: Any) -> list[Any]:
    """What was stacked, one by one."""
    leaves, tree = jax.tree.flatten(stack)
    return [jax.tree.unflatten(tree, parts) for parts in zip(*leaves, strict=True)]


def by_lanes(program: Callable[..., Any], stacks: tuple[Any, ...], lanes: int = LANES) -> Any:
    """What a program of `lanes` throws makes of the arrays of any number of throws."""
    count = len(jax.tree.leaves(stacks)[0])
    fill = np.minimum(np.arange(-(-count // lanes) * lanes), count - 1)
    parts = [
        program(*jax.tree.map(lambda leaf, here=fill[k : k + lanes]: leaf[here], stacks))
        for k in range(0, count, lanes)
    ]
    return jax.tree.map(
        lambda *leaves: (np.concatenate(leaves) if parts[1:] else np.asarray(leaves[0]))[:count],
        *parts,
    )


trace = kept("law", "load")(model)


@kept("law", "load")
def _traces(law: type[Law], load: Load, values: Array, problems: Problem) -> Array:
    return jax.vmap(partial(model, law, load))(values, problems)


def traced(
    law: type[Law], load: Load, values: Floats, problems: Problem, lanes: int = LANES
) -> Floats:
    """What `trace` finds for each of many throws, shape (throws, 5, n), `lanes` at a time."""
    if lanes == 1:
        pairs = zip(values, unstacked(problems), strict=True)
        return np.array([trace(law, load, *pair) for pair in pairs])
    return np.asarray(by_lanes(partial(_traces, law, load), (values, problems), lanes))


@kept("law", "load")
def _misfits(law: type[Law], load: Load, values: Array, problems: Problem) -> Array:
    found = jax.vmap(partial(_independent, law, load))(values, problems)
    return (signed_root(found, problems.loss[0]) ** 2).sum((1, 2))


def misfits(
    law: type[Law], load: Load, values: Floats, problems: Problem, lanes: int = LANES
) -> Floats:
    """Chi squared of each of many throws, shape (throws,), `lanes` at a time; NaN where there is no
    motion.

    One loss, that of the first throw, holds for all.
    """
    if not len(values):
        return np.zeros(0)
    if lanes > 1:
        return np.asarray(by_lanes(partial(_misfits, law, load), (values, problems), lanes))
    found = np.array(
        [raw_residuals(law, load, *p) for p in zip(values, unstacked(problems), strict=True)]
    )
    if LOSSES[int(problems.loss[0])] != "linear":
        found = np.asarray(signed_root(found, problems.loss[0]))
    return np.asarray((found**2).sum((1, 2)))
