"""Motion of the stone: from friction law and start to the path, and to rest."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

from curlfit.dynamics.integrator import trajectory

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from curlfit.friction import Law, Load, check_load
from curlfit.stone import Stone

_EVER = 1e30  # s, by when every stone is at rest


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["x", "y", "heading", "v", "phi", "omega"],
    meta_fields=[],
)
@dataclass(frozen=True)
class InitialState:
    """Where and how a throw begins. Axes and signs as everywhere (see the README).

    Attributes
    ----------
    x, y : place of the centre in m, y along the sheet, x to the right of it.
    heading : direction of the velocity in rad, from +y toward +x (beta of eq. 24).
    v : speed in m/s, >= 0.
    phi : angle of the stone in rad, counter-clockwise.
    omega : spin in rad/s, counter-clockwise positive.
    """

    x: Any = 0.0
    y: Any = 0.0
    heading: Any = 0.0
    v: Any = 2.0
    phi: Any = 0.0
    omega: Any = 1.0


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["t", "x", "y", "phi", "vx", "vy", "omega", "rest"],
    meta_fields=[],
)
@dataclass(frozen=True)
class Trajectory:
    """Motion of a stone at given times; every field but `rest` is an array of the shape of `t`.

    t in s; x, y in m; phi in rad, not wrapped; vx, vy in m/s; omega in rad/s. After the stone
    has come to rest its place and angle are held and its velocities are zero. `rest` is the time
    at which it comes to rest, in s; where it still moves at the last time, what its loss of energy
    there lets expect, inf without any.
    """

    t: Array
    x: Array
    y: Array
    phi: Array
    vx: Array
    vy: Array
    omega: Array
    rest: Array

    @property
    def speed(self) -> Array:
        """Speed of the centre in m/s; its derivative at rest is zero."""
        square = self.vx**2 + self.vy**2
        moving = square > 0
        return jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)

    def to_numpy(self) -> Trajectory:
        """The same path with numpy arrays."""
        arrays: Any = (np.asarray(getattr(self, field.name)) for field in fields(self))
        return Trajectory(*arrays)


def _moved(
    law: Law, stone: Stone, start: InitialState, times: Array, load: Load, velocities: bool
) -> tuple[list[Array], Array]:
    """x, y, phi, with vx, vy, omega if wanted, and the time of coming to rest."""
    inputs = (
        jnp.stack(jax.tree.leaves(law)),
        jnp.stack(jax.tree.leaves(stone)),
        jnp.stack([start.v, start.omega]),
    )
    path, rest = trajectory(type(law), load, velocities, inputs, times)
    # Ice is the same everywhere and in every direction: place, heading and angle only move and
    # turn the path (u to the right of the first heading, w along it).
    s, c = jnp.sin(start.heading), jnp.cos(start.heading)
    u, w, turned, *rates = path
    found = [start.x + c * u + s * w, start.y - s * u + c * w, start.phi + turned]
    if rates:
        du, dw, omega = rates
        found += [c * du + s * dw, -s * du + c * dw, omega]
    return found, rest


@partial(jax.jit, static_argnames="load")
def _simulate(
    law: Law, stone: Stone, start: InitialState, times: Array, t0: Array, *, load: Load
) -> Trajectory:
    (x, y, phi, *rates), rest = _moved(law, stone, start, times - t0, load, velocities=True)
    vx, vy, omega = rates
    return Trajectory(t=times, x=x, y=y, phi=phi, vx=vx, vy=vy, omega=omega, rest=t0 + rest)


def places(law: Law, stone: Stone, start: InitialState, times: Array, *, load: Load) -> Array:
    """x, y and phi alone, shape (3, n), of a stone that starts at time 0.

    Like `simulate`, for arrays and within compiled code, but that times must not fall, and that
    there are no derivatives by them.
    """
    found, _ = _moved(law, stone, start, times, load, velocities=False)
    return jnp.stack(found)


def simulate(
    law: Law,
    stone: Stone,
    start: InitialState,
    times: ArrayLike,
    *,
    load: str = "uniform",
    t0: ArrayLike | None = None,
    ordered: bool = False,
) -> Trajectory:
    """The path of a stone under a friction law.

    Works under `jit` and `vmap`, and differentiates forward and in reverse with respect to the
    law's coefficients, the stone and the start. Derivatives of position and angle with respect to
    `times` are exact, those of velocity with respect to `times` are taken as zero.

    Parameters
    ----------
    law, stone, start : what moves, and how it begins.
    times : times in s, shape (n,), none before `t0`; order does not matter. At inf the stone is
        where it comes to rest.
    load : "uniform" or "consistent" (eq. 8-9).
    t0 : time of `start` in s; the least of `times` if not given.
    ordered : times are known not to fall from one to the next, so that compiled code need not sort
        them; rows at inf are then not asked for, and are 0.

    Returns
    -------
    Trajectory of shape (n,) and the time of rest. Positions are accurate to 1e-7 m and angles to
    1e-7 rad over a throw. NaN where the law admits no motion (a consistent load that would have
    to be negative) or the integration fails.

    Raises
    ------
    InputError : unknown `load`.
    """
    checked = check_load(load)
    times = jnp.asarray(times, float)
    t0 = jnp.min(times) if t0 is None else jnp.asarray(t0, float)
    as_floats = jax.tree.map(lambda value: jnp.asarray(value, float), (law, stone, start))
    if ordered:
        return _simulate(*as_floats, times, t0, load=checked)
    finite = jnp.where(times == jnp.inf, _EVER, times)
    if _ordered(times):
        path = _simulate(*as_floats, finite, t0, load=checked)
    else:
        order = jnp.argsort(finite)
        path, back = _simulate(*as_floats, finite[order], t0, load=checked), jnp.argsort(order)
        path = jax.tree.map(lambda values: values[back] if values.ndim else values, path)
    return replace(path, t=times)


def _ordered(times: Array) -> bool:
    """Whether times are known not to fall."""
    return not isinstance(times, jax.core.Tracer) and bool((np.diff(times) >= 0).all())
