"""Motion of the stone to rest, from the friction law and the initial state."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import partial
from numbers import Real
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from curlfit.dynamics.equations import ExternalForces
from curlfit.dynamics.integrator import integrate
from curlfit.environment import Environment
from curlfit.errors import InputError, require_kind
from curlfit.foreign import counted
from curlfit.friction import Law, Load, check_load, find_law
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.output.display import Displayed
from curlfit.output.document import Document, Section
from curlfit.output.frames import frame
from curlfit.output.table import Column, Table
from curlfit.stone import Stone

_REST_TIME = 1e30  # s, by when every stone is at rest
_FEWEST_ROWS = 64  # of a program, which also serves fewer


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["x", "y", "heading", "v", "phi", "omega"],
    meta_fields=[],
)
@dataclass(frozen=True)
class InitialState:
    """Position, angle, velocity and spin at the start of a throw, in the
    axes of curlfit.

    Attributes
    ----------
    x, y : position of the centre in m, y along the sheet, x to the right of it.
    heading : direction of the velocity in rad, from +y toward +x (beta of eq. 24).
    v : speed in m/s, >= 0.
    phi : angle of the stone in rad, counter-clockwise.
    omega : spin in rad/s, counter-clockwise positive.

    Examples
    --------
    >>> curlfit.InitialState(v=2.2, omega=1.5).heading
    0.0
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
@dataclass(frozen=True, repr=False)
class Trajectory(Displayed):
    """Motion of a stone at given times; every field but `rest` is an array of the
    shape of `t`.

    t in s; x, y in m; phi in rad, not wrapped; vx, vy in m/s; omega in rad/s. After the
    stone has come to rest its position and angle are constant and its velocities are
    zero. `rest` is the time of rest in s; if the stone still moves at the last time, it
    is extrapolated from the energy loss there, and inf if there is none.

    Examples
    --------
    >>> law, times = curlfit.law_with("front-back", {}), [0.0, 5.0, 10.0, 15.0, 20.0]
    >>> curlfit.simulate(law, curlfit.Stone(), curlfit.InitialState(), times)
    Trajectory, at rest at 22.6... s: motion of a stone at 5 times, t = 0 .. 20 s
    x, y from (0, 0) m to ...
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

    def to_frame(self) -> Any:
        """The motion as a pandas DataFrame: t, x, y, phi, vx, vy, omega and
        speed (SI, rad).

        Raises
        ------
        InputError : pandas is not installed.
        """
        names = ("t", "x", "y", "phi", "vx", "vy", "omega", "speed")
        return frame({name: np.asarray(getattr(self, name)) for name in names})

    def _document(self) -> Document:
        shape = jnp.shape(self.x)
        is_series = len(shape) == 1 and shape[0] > 0
        if not is_series or _is_traced(self):
            return Document(finding=f"shape {shape}", subject="motion of a stone")
        units = {
            "t": "s",
            "x": "m",
            "y": "m",
            "phi": "rad",
            "speed": "m/s",
            "omega": "rad/s",
        }
        series = {name: np.asarray(getattr(self, name)) for name in units}
        columns: list[Column[_End]] = [Column("", key="label")]
        for name, unit in units.items():
            columns.append(_series_column(name, unit, series[name]))
        table = Table([_End("first", 0), _End("last", -1)], columns)
        rest = float(self.rest)
        finding = "does not come to rest"
        if math.isfinite(rest):
            finding = f"at rest at {rest:.5g} s"
        t = series["t"]
        x = series["x"]
        y = series["y"]
        ends = f"from ({x[0]:.4g}, {y[0]:.4g}) m to ({x[-1]:.4g}, {y[-1]:.4g}) m"
        return Document(
            finding=finding,
            subject=f"motion of a stone at {counted(len(t), 'time')}, "
            f"t = {t[0]:.5g} .. {t[-1]:.5g} s",
            lines=[f"x, y {ends}"],
            sections=[Section("ends", "Ends of the path", [table])],
        )

    def to_numpy(self) -> Trajectory:
        """The trajectory with NumPy arrays."""
        arrays: Trajectory = jax.tree.map(np.asarray, self)
        return arrays


jax.tree_util.register_dataclass(
    Environment,
    data_fields=[field.name for field in fields(Environment)],
    meta_fields=[],
)


def _is_traced(tree: Any) -> bool:
    """Whether numbers are symbols of a function that JAX is transforming."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


class _End(NamedTuple):
    """An end of a path, and its place among the times."""

    label: str
    place: int


def _series_column(name: str, unit: str, series: Floats) -> Column[_End]:
    """The column of a series at the ends of a path."""
    return Column(
        name,
        lambda end: series[end.place] + 0.0,  # no minus before a zero
        ".5g",
        unit=unit,
        right=True,
    )


def external_forces(
    stone: Stone, environment: Environment, heading: Array, t0: Any = 0.0
) -> Array:
    """External forces, as `integrate` takes them, in the frame of an
    initial heading."""
    right, along = environment.gravity_along(jnp.sin(heading), jnp.cos(heading))
    return jnp.stack(
        ExternalForces(
            right,
            along,
            environment.drag_rate(stone.m),
            *environment.wear_along(),
            environment.sweep,
            environment.swept_from - t0,
            environment.swept_to - t0,
        )
    )


def _motion(
    law: Law,
    stone: Stone,
    forces: Array | None,
    start: InitialState,
    times: Array,
    load: Load,
    velocities: bool,
) -> tuple[list[Array], Array]:
    """x, y, phi, with vx, vy, omega if requested, and the time of rest."""
    inputs = [jnp.stack(jax.tree.leaves(law)), jnp.stack(jax.tree.leaves(stone))]
    if forces is not None:
        inputs.append(forces)
    inputs.append(jnp.stack([start.v, start.omega]))
    channels, rest = integrate(type(law), load, velocities, tuple(inputs), times)
    # Friction is homogeneous and isotropic: initial position, heading and angle only
    # translate and rotate the path (u to the right of the initial heading, w along it).
    s = jnp.sin(start.heading)
    c = jnp.cos(start.heading)
    u, w, turned, *rates = channels
    out = [start.x + c * u + s * w, start.y - s * u + c * w, start.phi + turned]
    if rates:
        du, dw, omega = rates
        out += [c * du + s * dw, -s * du + c * dw, omega]
    return out, rest


@partial(jax.jit, static_argnames="load")
def ordered_trajectory(
    law: Law,
    stone: Stone,
    forces: Array | None,
    start: InitialState,
    times: Array,
    t0: Array,
    *,
    load: Load,
) -> Trajectory:
    """Like `simulate`, for arrays of floats, the `external_forces` or None, and
    non-decreasing times; rows at inf are unused, and are 0."""
    channels, rest = _motion(
        law, stone, forces, start, times - t0, load, velocities=True
    )
    x, y, phi, vx, vy, omega = channels
    return Trajectory(
        t=times, x=x, y=y, phi=phi, vx=vx, vy=vy, omega=omega, rest=t0 + rest
    )


def trajectory(
    law: Law,
    stone: Stone,
    forces: Array | None,
    start: InitialState,
    times: Array,
    t0: Any = 0.0,
    *,
    load: Load,
) -> Trajectory:
    """`ordered_trajectory` for times in any order."""
    order = jnp.argsort(times)
    path = ordered_trajectory(
        law, stone, forces, start, times[order], jnp.asarray(t0), load=load
    )
    back = jnp.argsort(order)
    return jax.tree.map(lambda values: values[back] if values.ndim else values, path)


def positions(
    law: Law,
    stone: Stone,
    forces: Array | None,
    start: InitialState,
    times: Array,
    *,
    load: Load,
) -> Array:
    """x, y and phi alone, shape (3, n), of a stone that starts at time 0.

    Like `ordered_trajectory`, without derivatives with respect to the times.
    """
    channels, _ = _motion(law, stone, forces, start, times, load, velocities=False)
    return jnp.stack(channels)


def simulate(
    law: Law,
    stone: Stone,
    start: InitialState,
    times: ArrayLike,
    *,
    load: str = "uniform",
    t0: ArrayLike | None = None,
    environment: Environment | None = None,
) -> Trajectory:
    """The trajectory of a stone under a friction law.

    Works under `jit` and `vmap`, and can be differentiated in forward and reverse mode
    with respect to the law's coefficients, the stone, the initial state and the
    environment. Derivatives of position and angle with respect to `times` are exact;
    those of velocity are taken as zero.

    Parameters
    ----------
    law, stone, start : friction law, stone and initial state.
    times : times in s, shape (n,), none before `t0`, in any order; inf gives the
        position at rest.
    load : "uniform" or "consistent" (eq. 8-9).
    t0 : time of `start` in s; the earliest of `times` if not given.
    environment : slope of the ice, air drag, wear and sweeping; none of
        them by default.

    Returns
    -------
    Trajectory of shape (n,) and the time of rest. Positions are accurate to 1e-7 m and
    angles to 1e-7 rad over a throw. NaN where the law admits no motion (a consistent
    load that would have to be negative) or the integration fails.

    Raises
    ------
    InputError : unknown `load`; `start` or the law has arrays in place of numbers, or
        `start` a negative speed; `times` of another shape. DataError : a law of your
        own that is not usable.

    Examples
    --------
    >>> law = curlfit.law_with("front-back", {"mu2_xi": 0.055})
    >>> times = [0.0, 5.0, 10.0, 15.0, 20.0]
    >>> path = curlfit.simulate(
    ...     law, curlfit.Stone(), curlfit.InitialState(v=2.0), times
    ... )
    >>> bool(path.x[-1] < 0)  # counter-clockwise spin curls to the left
    True
    """
    checked = check_load(load)
    _check_motion(law, start, times)
    is_traced = _is_traced((law, stone, start, environment, times, t0))
    if np.size(times) and not is_traced:
        return _simulate_numbers(law, stone, start, times, t0, environment, checked)
    times = jnp.asarray(times, float)
    t0 = jnp.min(times) if t0 is None else jnp.asarray(t0, float)
    law, stone, start, environment = jax.tree.map(
        lambda value: jnp.asarray(value, float), (law, stone, start, environment)
    )
    finite = jnp.where(times == jnp.inf, _REST_TIME, times)
    path = _surrounded(law, stone, environment, start, finite, t0, checked)
    return replace(path, t=times)


def _surrounded(
    law: Law,
    stone: Stone,
    environment: Environment | None,
    start: InitialState,
    times: Array,
    t0: Array,
    load: Load,
) -> Trajectory:
    """The motion in an environment, for arrays."""
    forces = None
    if environment is not None:
        forces = external_forces(stone, environment, start.heading, t0)
    return trajectory(law, stone, forces, start, times, t0, load=load)


def _check_motion(law: Law, start: InitialState, times: ArrayLike) -> None:
    """Raise InputError for arrays in place of numbers, and for an impossible start."""
    find_law(type(law))
    for record in (start, law):
        for field in fields(record):  # type: ignore[arg-type]
            name = f"{type(record).__name__}.{field.name}"
            value = getattr(record, field.name)
            if isinstance(value, jax.core.Tracer) and not value.shape:
                continue
            if np.shape(value):
                raise InputError(
                    f"{name} of shape {np.shape(value)} found, "
                    "expected a number; for many motions, `jax.vmap` a function "
                    "that simulates one"
                )
            require_kind(value, (Real, np.ndarray, Array), name, "a number")
            if record is start and not math.isfinite(value):
                raise InputError(f"{name} = {value}: expected a finite number")
    if not isinstance(start.v, jax.core.Tracer) and start.v < 0:
        raise InputError(
            f"InitialState.v = {float(start.v):g} m/s: expected a speed >= 0; "
            "`heading` gives its direction"
        )
    if np.ndim(times) != 1:
        raise InputError(f"times of shape {np.shape(times)} found, expected (n,)")


def _simulate_numbers(
    law: Law,
    stone: Stone,
    start: InitialState,
    times: ArrayLike,
    t0: ArrayLike | None,
    environment: Environment | None,
    load: Load,
) -> Trajectory:
    """`simulate` outside JAX's transformations, by a program that is stored on disk and
    serves any number of rows up to a power of two."""
    t = np.asarray(times, float)
    next_power_of_two = 1 << (len(t) - 1).bit_length()
    padded = np.full(max(_FEWEST_ROWS, next_power_of_two), np.inf)  # unused rows
    padded[: len(t)] = np.where(t == np.inf, _REST_TIME, t)
    coefficients = np.array([float(value) for value in jax.tree.leaves(law)])
    stone, start, environment = jax.tree.map(
        lambda value: np.asarray(value, float), (stone, start, environment)
    )
    first = t.min() if t0 is None else np.asarray(t0, float)
    path = _padded_trajectory(
        type(law), load, coefficients, stone, environment, start, padded, first
    )

    def without_padding(values: Array) -> Array:
        return jax.device_put(np.asarray(values)[: len(t)]) if values.ndim else values

    return replace(jax.tree.map(without_padding, path), t=jax.device_put(t))


@compiled("law", "load")
def _padded_trajectory(
    law: type[Law],
    load: Load,
    coefficients: Array,
    stone: Stone,
    environment: Environment | None,
    start: InitialState,
    times: Array,
    t0: Array,
) -> Trajectory:
    return _surrounded(
        law.from_vector(coefficients), stone, environment, start, times, t0, load
    )
