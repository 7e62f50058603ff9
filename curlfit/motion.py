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

from curlfit.contact import Crowding, accelerations, crowding, swing

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
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
_KNOTS = 64  # steps whose ends are kept until the times between them are looked up
_MOST_STRETCHES = 512

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
_put = jax.lax.dynamic_update_index_in_dim


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


def _rates(
    law: Law, stone: Stone, load: Load, span: Array, crowd: Crowding, state: _State, time: Array
) -> _State:
    """Time derivative of the state."""
    a = accelerations(law, stone, load, state.v, state.omega, state.phi, time, crowd)
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
    dt = 1 / jnp.maximum(frequency * to_go ** (1 / 6) / STEP, ending / _LARGEST_STEP)
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
    the state and its time derivative, each of shape (6, lanes), and whether all is done."""

    t: Array
    dt: Array
    state: Array
    rate: Array
    idle: Array


def _knot(moving: _Moving) -> Array:
    """End of a step, shape (10, lanes): t, and of x, y, phi the values, their first and their
    second time derivatives."""
    state, rate = _State(*moving.state), _State(*moving.rate)
    s, c = jnp.sin(state.heading), jnp.cos(state.heading)
    along, across = rate.v, state.v * rate.heading
    return jnp.stack(
        [
            moving.t,
            *(state.x, state.y, state.phi),
            *(rate.x, rate.y, rate.phi),
            *(along * s + across * c, along * c - across * s, rate.omega),
        ]
    )


def _resting(law: Law, stone: Stone, moving: _Moving) -> Array:
    """x, y, phi where the stone comes to rest, and when, shape (4, lanes).

    What little is left to go is gone at an even loss of speed and spin.
    """
    state, rate = _State(*moving.state), _State(*moving.rate)
    slowing = _slowing(law, stone, state, rate)
    left = 0.5 / jnp.maximum(slowing, 1e-9)
    s, c = jnp.sin(state.heading), jnp.cos(state.heading)
    ending = slowing * (1 + law.steepness())
    lost = ending > 0
    turning = 0.0 if isinstance(law, NetLaw) else jnp.abs(state.omega)
    never = jnp.where(state.v + turning > 0, jnp.inf, 0.0)
    return jnp.stack(
        [
            state.x + left * state.v * s,
            state.y + left * state.v * c,
            state.phi + left * state.omega,
            moving.t + jnp.where(lost, 1 / jnp.where(lost, ending, 1.0), never),
        ]
    )


def _quintics(knots: Array) -> Array:
    """Polynomials between knots in `s`, which goes from 0 to 1: six coefficients for each of x, y,
    phi, then the time at s = 0 and 1/h; shape (knots - 1, 20, lanes)."""
    a, b = knots[:-1], knots[1:]
    h = b[:, :1] - a[:, :1]
    h = jnp.where(h > 0, h, 1.0)
    p0, v0, a0 = a[:, 1:4], h * a[:, 4:7], h**2 * a[:, 7:] / 2
    rise = b[:, 1:4] - (p0 + v0 + a0)
    slope = h * b[:, 4:7] - (v0 + 2 * a0)
    bend = h**2 * b[:, 7:] / 2 - a0
    c3 = 10 * rise - 4 * slope + bend
    c4 = -15 * rise + 7 * slope - 2 * bend
    c5 = 6 * rise - 3 * slope + bend
    return jnp.concatenate([p0, v0, a0, c3, c4, c5, a[:, :1], 1 / h], 1)


def _values(quintics: Array, place: Array, times: Array) -> tuple[list[Array], list[Array]]:
    """Values and time derivatives of x, y, phi at `times`, each of shape (n, lanes), in the
    polynomials at `place` (n, lanes)."""
    lanes = quintics.shape[-1]
    tables = jnp.moveaxis(quintics, 1, 0).reshape(quintics.shape[1], -1)
    at = place * lanes + jnp.arange(lanes)

    def chosen(row: int) -> Array:
        return tables[row].at[at].get(mode="promise_in_bounds")

    rate = chosen(19)
    s = (times - chosen(18)) * rate
    values, firsts = [], []
    for channel in range(3):
        c0, c1, c2, c3, c4, c5 = (chosen(3 * power + channel) for power in range(6))
        values.append(c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5)))))
        firsts.append((c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) * rate)
    return values, firsts


def _integrate(
    law: Law, stone: Stone, v0: Array, omega0: Array, *, times: Array, load: Load
) -> tuple[Array, Array]:
    """Motions from the origin along +y, one a lane: x, y, phi, vx, vy, omega at `times` >= 0, and
    the times of coming to rest.

    The start has shape (lanes,), the law's coefficients that or (), the times (n, lanes) or
    (n, 1); the answers have shapes (6, n, lanes) and (lanes,).
    """
    lanes = v0.shape
    last = jnp.max(times, 0) + jnp.zeros(lanes)
    span = jnp.maximum(last, 1e-9)
    tableau = jnp.asarray(np.pad(_TABLEAU, ((0, 0), (0, 1))))
    moments = jnp.asarray(_TABLEAU.sum(1))

    def rates(crowd: Crowding, state: Array, time: Array) -> Array:
        return jnp.stack(_rates(law, stone, load, span, crowd, _State(*state), time))

    def admitted(state: Array) -> Array:
        """A state without motion backwards."""
        x, y, heading, v, phi, omega = state
        v = jnp.where(v > 0, v, 0.0)
        if isinstance(law, NetLaw):  # spin that has come to its end does not turn round
            omega = jnp.where(omega * omega0 > 0, omega, 0.0)
        return jnp.stack([x, y, heading, v, phi, omega])

    def step(moving: _Moving) -> _Moving:
        t, dt, begin, rate, _ = moving
        crowd = crowding(begin[3], stone.R * begin[5])

        # A loop over the stages, not six copies of them, keeps the compiled program small. Their
        # slopes are weighted by a dot product, which XLA does not make part of anything else: it
        # would find the slopes, and their derivatives, anew for each use of them.
        def reached(place: Array, slopes: Array) -> Array:
            return admitted(begin + dt * jnp.tensordot(tableau[place], slopes, 1))

        def stage(place: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            _, now, slopes = carry
            rate = rates(crowd, now, t + dt * moments[place])
            slopes = _put(slopes, rate, place + 1, 0)
            return now, reached(jnp.minimum(place + 1, _STAGES - 1), slopes), slopes

        slopes = jnp.zeros((_STAGES + 1, *rate.shape)).at[0].set(rate)
        first = reached(jnp.zeros((), int), slopes)
        state, _, slopes = jax.lax.fori_loop(0, _STAGES, stage, (first, first, slopes))
        rate = slopes[-1]
        return planned(moving._replace(t=t + dt, state=state, rate=rate))

    def planned(moving: _Moving) -> _Moving:
        """The same with the length of the next step."""
        state, rate = _State(*moving.state), _State(*moving.rate)
        dt, at_rest = _step_size(law, stone, state, rate, moving.t, span)
        idle = at_rest | (moving.t >= last)
        return moving._replace(dt=jnp.where(idle, 0.0, dt), idle=idle)

    def going(moving: _Moving) -> Array:
        # A path that has become NaN is not followed further: it could hold up all the others.
        return (~moving.idle & ~jnp.isnan(moving.dt)).any()

    def stretch(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        """As many steps as there are knots to keep, and what they say of the times and of rest."""
        count, moving, _, out = carry
        knots = jnp.zeros((_KNOTS, 10, *lanes)).at[0].set(_knot(moving))

        def more(carry: tuple[Any, ...]) -> Array:
            place, moving, *_ = carry
            return (place < _KNOTS) & going(moving)

        def again(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            place, moving, knots, interval = carry
            interval += times >= moving.t + moving.dt
            moving = step(moving)
            return place + 1, moving, _put(knots, _knot(moving), place, 0), interval

        begin = moving.t
        interval = jnp.zeros(out[0].shape, jnp.int32)
        steps, moving, knots, interval = jax.lax.while_loop(
            more, again, (jnp.ones((), int), moving, knots, interval)
        )
        interval = jnp.minimum(interval, steps - 2)
        value, velocity = _values(_quintics(knots), interval, times)
        inside = (times >= begin) & (times <= moving.t)
        out = tuple(
            jnp.where(inside, new, old) for new, old in zip((*value, *velocity), out, strict=True)
        )
        return count + 1, moving, _resting(law, stone, moving), out

    def unfinished(carry: tuple[Any, ...]) -> Array:
        count, moving, *_ = carry
        return (count < _MOST_STRETCHES) & going(moving)

    # A zero that comes from the start: whatever is carried depends on the start before the first
    # step, and JAX need not find out, for each loop within another, what does by trying.
    zero = 0.0 * (v0 + omega0)
    state = jnp.stack([zero, zero, zero, v0, zero, omega0])
    # The first step has no length; it is there to find the rates at the start.
    moving = _Moving(zero, zero, state, zero * state, idle=zero > 0)
    blank = jnp.full((len(times), *lanes), jnp.nan) + zero
    # Where it rests is carried along, or XLA would find it anew for each of the times.
    _, moving, held, out = jax.lax.while_loop(
        unfinished, stretch, (0, moving, zero * state[:4], (blank,) * 6)
    )
    at_rest = moving.idle & (times >= moving.t)
    path = jnp.stack(
        [
            jnp.where(at_rest, at, value)
            for at, value in zip((*held[:3], zero, zero, zero), out, strict=True)
        ]
    )
    return path, held[3]


# Both directions of differentiation from forward mode alone: a throw has some ten inputs, so its
# Jacobian costs ten tangents, and the loop need not be stored to be run backwards. The inputs are
# the law's coefficients, the stone and (v0, omega0) as vectors; those that nobody asks about cost
# nothing. What `vmap` maps over becomes lanes of one call.


def _in_lanes(function: Callable[..., Any]) -> Callable[..., Any]:
    """For a function of arrays with lanes last: the same without lanes, ready for `vmap`.

    Parameters
    ----------
    function : takes arrays of shape (k, lanes) and times (n, lanes or 1); gives arrays with the
        lanes last.
    """

    @custom_vmap
    def laned(*arrays: Array) -> Any:
        return function(*arrays)

    @laned.def_vmap
    def _(size: int, batched: list[bool], *arrays: Array) -> Any:
        if not any(batched):  # so asks JAX when it differentiates what it does not map
            out = function(*arrays)
            return out, jax.tree.map(lambda _: False, out)
        lanes = max(array.shape[-1] for array in arrays)

        def merged(array: Array, mapped: bool, shared: bool) -> Array:
            if not mapped and shared and array.shape[-1] == 1:
                return array
            array = array if mapped else array[None]
            full = jnp.broadcast_to(array, (size, array.shape[1], lanes))
            return jnp.moveaxis(full, 1, 0).reshape(-1, size * lanes)

        def parted(array: Array) -> Array:
            return jnp.moveaxis(array.reshape(*array.shape[:-1], size, lanes), -2, 0)

        last = len(arrays) - 1  # the times
        pairs = enumerate(zip(arrays, batched, strict=True))
        out = laned(*(merged(a, b, place == last) for place, (a, b) in pairs))
        return jax.tree.map(parted, out), jax.tree.map(lambda _: True, out)

    def alone(*arrays: Array) -> Any:
        return jax.tree.map(lambda a: a[..., 0], laned(*(array[:, None] for array in arrays)))

    return alone


def _whole(law: type[Law], load: Load, *arrays: Array) -> tuple[Array, Array]:
    coefficients, stone, (v0, omega0), times = arrays
    return _integrate(
        law.from_vector(coefficients), Stone(*stone), v0, omega0, times=times, load=load
    )


def _with_jacobian(
    law: type[Law], load: Load, asked: tuple[bool, ...], *arrays: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Path and time of rest, and their derivatives by the inputs asked for, along the first
    axis."""
    *inputs, times = arrays
    free = [vector for ask, vector in zip(asked, inputs, strict=True) if ask]

    def run(free: list[Array]) -> tuple[Array, Array]:
        given = iter(free)
        full = (next(given) if ask else vector for ask, vector in zip(asked, inputs, strict=True))
        return _whole(law, load, *full, times)

    sizes = [len(vector) for vector in free]
    basis = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1], axis=1)
    tangents = [
        jnp.broadcast_to(part[..., None], (*part.shape, vector.shape[-1]))
        for part, vector in zip(basis, free, strict=True)
    ]
    return jax.vmap(lambda tangent: jax.jvp(run, (free,), (tangent,)), out_axes=(None, 0))(tangents)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _trajectory(
    law: type[Law], load: Load, inputs: tuple[Array, Array, Array], times: Array
) -> tuple[Array, Array]:
    """x, y, phi, vx, vy, omega of a motion from the origin along +y, shape (6, n), and the time of
    its coming to rest."""
    return _in_lanes(partial(_whole, law, load))(*inputs, times)


def _trajectory_jvp(
    law: type[Law], load: Load, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    inputs, times = primals
    d_inputs, d_times = tangents
    asked = tuple(not isinstance(tangent, SymbolicZero) for tangent in d_inputs)
    if any(asked):
        function = partial(_with_jacobian, law, load, asked)
        out, jacobian = _in_lanes(function)(*inputs, times)
        step = jnp.concatenate([d for ask, d in zip(asked, d_inputs, strict=True) if ask])
        change, later = (jnp.tensordot(step, part, 1) for part in jacobian)
    else:
        out = _in_lanes(partial(_whole, law, load))(*inputs, times)
        change, later = map(jnp.zeros_like, out)
    if not isinstance(d_times, SymbolicZero):
        change = change.at[:3].add(out[0][3:] * d_times)
    return out, (change, later)


_trajectory.defjvp(_trajectory_jvp, symbolic_zeros=True)


@partial(jax.jit, static_argnames="load")
def _simulate(law: Law, stone: Stone, start: Start, times: Array, t0: Array, *, load: Load) -> Path:
    inputs = (
        jnp.stack(jax.tree.leaves(law)),
        jnp.stack(jax.tree.leaves(stone)),
        jnp.stack([start.v, start.omega]),
    )
    path, rest = _trajectory(type(law), load, inputs, times - t0)
    u, w, turned, du, dw, omega = path
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
        rest=t0 + rest,
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
