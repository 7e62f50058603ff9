"""Motion of the stone: from friction law and start to the path, and to rest.

Method. In the moving frame the state is speed `v`, heading `b` (eq. 24's beta), spin `omega`:

    dv/dt = a_eta,  v db/dt = a_xi,  domega/dt = alpha,  dx/dt = v sin b,  dy/dt = v cos b.

The motion names its own time scales: the time to rest, the turning of the velocity, and the
passage of |epsilon| = 1, where one point of the ring stops sliding and friction has a logarithmic
kink. Each step is a fixed fraction of the shortest of these, so it shrinks geometrically toward
rest and toward the kink. A law may name angles turned at which its friction has a corner, and how
fast it changes by itself; steps end at the one and follow the other, and up to the last corner
they follow the turning too. Within a step the fifth-order
formula of Dormand and Prince (1980) is used, and between steps the quintic polynomial through
position, velocity and acceleration at both ends. Nothing is rejected and repeated, so stones run in
lockstep under `vmap`, and derivatives are those of a fixed smooth map.

Why not a general solver: diffrax with adaptive steps takes several times as long for the same
accuracy, its run-time checks keep compiled programs out of the cache, and coming to rest needs an
event whose derivative is delicate. It serves the tests as an independent oracle instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

from curlfit.contact import accelerations, swing

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike

from curlfit.friction import Law, Load, NetLaw, check_load
from curlfit.stone import Stone

STEP = 0.25  # step over the shortest time scale, for a motion with 1 m or 1 rad to go
_LARGEST_STEP = 0.6
_REST = 1e-10  # a stone with less than this to go (m and rad together) is at rest
_KINK = 3e-3  # width in `swing` below which the kink at |epsilon| = 1 is not resolved further
_MOST_TURNING = 5000.0  # rad of turning of the velocity in one time scale of the motion
_CORNER = 1e-9  # rad before a corner of the law at which it counts as reached
_LEAST_SPIN = 1e-8  # rad/s below which the end of the spin is not resolved further
_CHUNK = 8  # steps between two looks at the clock
_MOST_CHUNKS = 4096

# Dormand and Prince (1980), RK5(4)7M. The last row is the fifth-order formula itself, so that its
# slope is the first slope of the next step.
_TABLEAU = np.zeros((6, 6))
for _stage, _row in enumerate(
    (
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    )
):
    _TABLEAU[_stage, : len(_row)] = _row
_STAGES = len(_TABLEAU)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["x", "y", "heading", "v", "phi", "omega"],
    meta_fields=[],
)
@dataclass(frozen=True)
class Start:
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
class Path:
    """Motion of a stone at given times; every field but `rest` is an array of the shape of `t`.

    t in s; x, y in m; phi in rad, not wrapped; vx, vy in m/s; omega in rad/s. After the stone
    has come to rest its place and angle are held and its velocities are zero. `rest` is the time
    at which it comes to rest, in s; where it still moves at the last time, what its loss of energy
    there lets expect.
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

    def to_numpy(self) -> Path:
        """The same path with numpy arrays."""
        arrays: Any = (np.asarray(getattr(self, field.name)) for field in fields(self))
        return Path(*arrays)


class _State(NamedTuple):
    x: Array
    y: Array
    heading: Array
    v: Array
    phi: Array
    omega: Array


def _slowing(law: Law, stone: Stone, state: _State, rate: _State) -> Array:
    """One over the time to rest, from the loss of kinetic energy, 1/s; 0 for a stone at rest."""
    # A net law knows no spin without sliding: all is over when the stone stops.
    inertia = 0.0 if isinstance(law, NetLaw) else stone.rho**2
    square = state.v**2 + inertia * state.omega**2
    power = -(state.v * rate.v + inertia * state.omega * rate.omega)
    return jnp.maximum(power, 0.0) / jnp.where(square > 0, square, 1.0)


def _rates(law: Law, stone: Stone, load: Load, span: Array, state: _State, time: Array) -> _State:
    """Time derivative of the state."""
    a = accelerations(law, stone, load, state.v, state.omega, state.phi, time)
    moving = state.v > 0
    rate = _State(
        x=state.v * jnp.sin(state.heading),
        y=state.v * jnp.cos(state.heading),
        heading=jnp.where(moving, a.xi / jnp.where(moving, state.v, 1.0), 0.0),
        v=a.eta,
        phi=state.omega,
        omega=a.angular,
    )
    # A stone that all but spins in place, under a force across its motion, runs round circles of
    # radius v^2/a_xi. Once it does so thousands of times before anything else changes, those are
    # below 1e-7 m, and it is pinned to their centre.
    rounds = _MOST_TURNING * (1 / span + _slowing(law, stone, state, rate))
    pinned = jnp.abs(rate.heading) > rounds
    return rate._replace(
        **{name: jnp.where(pinned, 0.0, getattr(rate, name)) for name in ("x", "y", "heading")}
    )


def _step_size(
    law: Law, stone: Stone, state: _State, rate: _State, time: Array, span: Array
) -> tuple[Array, Array]:
    """Next step in s, and whether the stone is at rest."""
    v, u = state.v, stone.R * state.omega
    slowing = _slowing(law, stone, state, rate)
    spin_counts = not isinstance(law, NetLaw)
    moving = (v > 0) | (u != 0) if spin_counts else v > 0
    # How far the stone has still to go, with 1 rad counted as 1 m.
    square = v**2 + state.omega**2
    to_go = jnp.sqrt(jnp.where(moving, square, 1.0)) / jnp.maximum(slowing, 1e-9)
    at_rest = ~moving | (to_go < _REST)

    au, du = jnp.abs(u), stone.R * jnp.sign(u) * rate.omega
    total = jnp.where(v + au > 0, v + au, 1.0)
    swing_rate = 2 * jnp.abs(au * rate.v - v * du) / total**2 / (swing(v, u) + _KINK)
    # Where dv/dt ~ v^-n, the time to rest is v/|dv/dt| over 1 + n; the kink is steeper, too.
    steepness = law.steepness()
    ending, passing = slowing * (1 + steepness), swing_rate * (1 + 2 * steepness)
    frequency = 1 / span + ending + jnp.abs(rate.heading) + passing + law.quickness(time)
    if not spin_counts:
        frequency += jnp.abs(rate.omega) / (jnp.abs(state.omega) + _LEAST_SPIN)
    if law.corners:
        turning = jnp.sqrt(1 / span**2 + state.omega**2 + jnp.abs(rate.omega))
        frequency += turning * (jnp.abs(state.phi) < max(law.corners) - _CORNER)
    # The error of a step goes as its fraction to the sixth power, times what is left to go.
    fraction = jnp.minimum(STEP * to_go ** (-1 / 6), _LARGEST_STEP)
    dt = fraction / frequency
    for corner in law.corners:
        left = _time_to_turn(corner, state, rate)
        # In two steps, for the time is foretold the better the shorter it is.
        dt = jnp.where(left < dt / 8, left, jnp.minimum(dt, 7 / 8 * left))
    return dt, at_rest


def _time_to_turn(corner: float, state: _State, rate: _State) -> Array:
    """Time in which the stone turns to an angle, from its spin and the loss of it; or inf."""
    sense = jnp.sign(state.omega)
    spin, gain = sense * state.omega, sense * rate.omega
    angle = sense * (corner - state.phi)
    square = spin**2 + 2 * gain * angle
    ahead = (angle > _CORNER) & (square > 0)
    root = jnp.sqrt(jnp.where(ahead, square, 1.0))
    return jnp.where(ahead, 2 * angle / (spin + root), jnp.inf)


class _Moving(NamedTuple):
    """Between two steps: time, length of the next step (0 when there is nothing more to do),
    the state and its time derivative as vectors, and whether all is done."""

    t: Array
    dt: Array
    state: Array
    rate: Array
    idle: Array


class _Knots(NamedTuple):
    """Ends of steps: t, and for x, y, phi the value and its first two time derivatives."""

    t: Array
    value: Array
    first: Array
    second: Array


def _knot(moving: _Moving) -> _Knots:
    state, rate = _State(*moving.state), _State(*moving.rate)
    s, c = jnp.sin(state.heading), jnp.cos(state.heading)
    along, across = rate.v, state.v * rate.heading
    return _Knots(
        moving.t,
        jnp.stack([state.x, state.y, state.phi]),
        jnp.stack([rate.x, rate.y, rate.phi]),
        jnp.stack([along * s + across * c, along * c - across * s, rate.omega]),
    )


def _quintic(a: _Knots, b: _Knots, t: Array) -> tuple[Array, Array]:
    """Value and derivative at `t` of the quintic through two knots; arrays of shape (n, 3)."""
    h = b.t - a.t
    live = h > 0
    h = jnp.where(live, h, 1.0)[:, None]
    s = (t - a.t)[:, None] / h
    p0, v0, a0 = a.value, h * a.first, h**2 * a.second / 2
    rise = b.value - (p0 + v0 + a0)
    slope = h * b.first - (v0 + 2 * a0)
    bend = h**2 * b.second / 2 - a0
    c3 = 10 * rise - 4 * slope + bend
    c4 = -15 * rise + 7 * slope - 2 * bend
    c5 = 6 * rise - 3 * slope + bend
    value = p0 + s * (v0 + s * (a0 + s * (c3 + s * (c4 + s * c5))))
    first = (v0 + s * (2 * a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h
    return value, first


def _integrate(
    law: Law, stone: Stone, v0: Array, omega0: Array, *, times: Array, load: Load
) -> Array:
    """Motion from the origin along +y at `times` >= 0, shape (n, 7).

    The columns are x, y, phi, vx, vy, omega, and the time of coming to rest, the same in each row.
    """
    last = jnp.max(times)
    span = jnp.maximum(last, 1e-9)
    f = partial(_rates, law, stone, load, span)

    tableau, moments = jnp.asarray(_TABLEAU), jnp.asarray(_TABLEAU.sum(1))

    def moved(moving: _Moving, weights: Array, slopes: Array) -> Array:
        state = _State(*(moving.state + moving.dt * weights @ slopes[:-1]))
        state = state._replace(v=jnp.where(state.v > 0, state.v, 0.0))
        if isinstance(law, NetLaw):  # spin that has come to its end does not turn round
            state = state._replace(omega=jnp.where(state.omega * omega0 > 0, state.omega, 0.0))
        return jnp.stack(state)

    def step(moving: _Moving, _: None) -> tuple[_Moving, _Knots]:
        # A loop over the stages, not six copies of them, keeps the compiled program small.
        def stage(place: Array, slopes: Array) -> Array:
            state = moved(moving, tableau[place], slopes)
            time = moving.t + moving.dt * moments[place]
            return slopes.at[place + 1].set(jnp.stack(f(_State(*state), time)))

        slopes = jnp.zeros((_STAGES + 1, len(moving.state))).at[0].set(moving.rate)
        slopes = jax.lax.fori_loop(0, _STAGES, stage, slopes)
        after = _Moving(
            t=moving.t + moving.dt,
            dt=moving.dt,
            state=moved(moving, tableau[-1], slopes),
            rate=slopes[-1],
            idle=moving.idle,
        )
        after = planned(after)
        return after, _knot(after)

    def planned(moving: _Moving) -> _Moving:
        """The same with the length of the next step."""
        dt, at_rest = _step_size(
            law, stone, _State(*moving.state), _State(*moving.rate), moving.t, span
        )
        idle = at_rest | (moving.t >= last)
        return moving._replace(dt=jnp.where(idle, 0.0, dt), idle=idle)

    def chunk(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, moving, out = carry
        first = _knot(moving)
        moving, knots = jax.lax.scan(step, moving, None, length=_CHUNK)
        knots = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, knots)
        place = jnp.clip(jnp.searchsorted(knots.t, times, side="left"), 1, _CHUNK)
        left = jax.tree.map(lambda k: k[place - 1], knots)
        right = jax.tree.map(lambda k: k[place], knots)
        inside = (times >= knots.t[0]) & (times <= knots.t[-1])
        value, velocity = _quintic(left, right, times)
        out = jnp.where(inside[:, None], jnp.concatenate([value, velocity], 1), out)
        return count + 1, moving, out

    def going(carry: tuple[Any, ...]) -> Array:
        count, moving, _ = carry
        # A path that has become NaN is not followed further: it could hold up all the others.
        return (count < _MOST_CHUNKS) & ~moving.idle & ~jnp.isnan(moving.dt)

    zero = jnp.zeros(())
    state = _State(x=zero, y=zero, heading=zero, v=v0, phi=zero, omega=omega0)
    moving = planned(
        _Moving(
            t=zero,
            dt=zero,
            state=jnp.stack(state),
            rate=jnp.stack(f(state, zero)),
            idle=jnp.asarray(False),
        )
    )
    out = jnp.full((times.shape[0], 6), jnp.nan)
    _, moving, out = jax.lax.while_loop(going, chunk, (0, moving, out))
    final = _State(*moving.state)
    held = jnp.stack([final.x, final.y, final.phi, zero, zero, zero])
    out = jnp.where((moving.idle & (times >= moving.t))[:, None], held, out)
    ending = _slowing(law, stone, final, _State(*moving.rate)) * (1 + law.steepness())
    left = jnp.where(ending > 0, 1 / jnp.where(ending > 0, ending, 1.0), 0.0)
    return jnp.concatenate([out, jnp.full((len(times), 1), moving.t + left)], 1)


# Both directions of differentiation from forward mode alone: a throw has some ten inputs, so its
# Jacobian costs ten tangents, and the loop need not be stored to be run backwards. The inputs are
# law, stone and (v0, omega0) as vectors; those that nobody asks about cost nothing.
Unravel = tuple[Callable[[Array], Any], ...]


def _whole(unravel: Unravel, load: Load, inputs: tuple[Array, ...], times: Array) -> Array:
    law, stone, start = (make(vector) for make, vector in zip(unravel, inputs, strict=True))
    return _integrate(law, stone, *start, times=times, load=load)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _trajectory(unravel: Unravel, load: Load, inputs: tuple[Array, ...], times: Array) -> Array:
    return _whole(unravel, load, inputs, times)


def _trajectory_jvp(
    unravel: Unravel, load: Load, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Array, Array]:
    inputs, times = primals
    d_inputs, d_times = tangents
    moving = [not isinstance(tangent, SymbolicZero) for tangent in d_inputs]

    def run(asked: list[Array]) -> tuple[Array, Array]:
        given = iter(asked)
        full = tuple(
            next(given) if ask else vector for ask, vector in zip(moving, inputs, strict=True)
        )
        out = _whole(unravel, load, full, times)
        return out, out

    asked = [vector for ask, vector in zip(moving, inputs, strict=True) if ask]
    jacobians, out = jax.jacfwd(run, has_aux=True)(asked) if asked else ([], run([])[1])
    change = jnp.zeros_like(out)
    for jacobian, tangent in zip(
        jacobians, [t for ask, t in zip(moving, d_inputs, strict=True) if ask], strict=True
    ):
        change = change + jacobian @ tangent
    if not isinstance(d_times, SymbolicZero):
        velocity = jnp.concatenate([out[:, 3:6], jnp.zeros_like(out[:, 3:])], 1)
        change = change + velocity * d_times[:, None]
    return out, change


_trajectory.defjvp(_trajectory_jvp, symbolic_zeros=True)


@partial(jax.jit, static_argnames="load")
def _simulate(law: Law, stone: Stone, start: Start, times: Array, t0: Array, *, load: Load) -> Path:
    vectors, unravel = zip(
        *(ravel_pytree(tree) for tree in (law, stone, (start.v, start.omega))), strict=True
    )
    u, w, turned, du, dw, omega, rest = _trajectory(unravel, load, vectors, times - t0).T
    # Ice is the same everywhere and in every direction: place, heading and angle only move and
    # turn the path (u to the right of the first heading, w along it).
    s, c = jnp.sin(start.heading), jnp.cos(start.heading)
    return Path(
        t=times,
        x=start.x + c * u + s * w,
        y=start.y - s * u + c * w,
        phi=start.phi + turned,
        vx=c * du + s * dw,
        vy=-s * du + c * dw,
        omega=omega,
        rest=t0 + rest[0],
    )


def simulate(
    law: Law,
    stone: Stone,
    start: Start,
    times: ArrayLike,
    *,
    load: str = "uniform",
    t0: ArrayLike | None = None,
) -> Path:
    """The path of a stone under a friction law.

    Works under `jit` and `vmap`, and differentiates forward and in reverse with respect to the
    law's coefficients, the stone and the start. Derivatives of position and angle with respect to
    `times` are exact, those of velocity with respect to `times` are taken as zero.

    Parameters
    ----------
    law, stone, start : what moves, and how it begins.
    times : times in s, shape (n,), none before `t0`; order does not matter.
    load : "uniform" or "consistent" (eq. 8-9).
    t0 : time of `start` in s; the least of `times` if not given.

    Returns
    -------
    Path of shape (n,), and when the stone comes to rest. Positions are good to 1e-7 m and angles
    to 1e-7 rad over a throw. NaN where the law admits no motion (a consistent load that would have
    to be negative) or the motion cannot be followed.

    Raises
    ------
    InputError : unknown `load`.
    """
    checked = check_load(load)
    times = jnp.asarray(times, float)
    t0 = jnp.min(times) if t0 is None else jnp.asarray(t0, float)
    as_floats = jax.tree.map(lambda value: jnp.asarray(value, float), (law, stone, start))
    return _simulate(*as_floats, times, t0, load=checked)
