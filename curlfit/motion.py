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
from math import factorial
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
_LARGEST_STEP = 0.6  # over the time to rest
_LARGEST_TURN = 1.5  # rad in a step
_REST = 1e-10  # a stone with less than this to go (m and rad together) is at rest
_KINK = 3e-3  # width in `swing` below which the kink at |epsilon| = 1 is not resolved further
_MOST_TURNING = 5000.0  # rad of turning of the velocity in one time scale of the motion
_CORNER = 1e-9  # rad before a corner of the law at which it counts as reached
_LEAST_SPIN = 1e-8  # rad/s below which the end of the spin is not resolved further
_MOST_STEPS = 32_000
_WINDOW = 8  # rows that are filled in together

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
    phi: Array
    v: Array
    omega: Array


def _slowing(law: Law, stone: Stone, state: _State, rate: _State) -> Array:
    """One over the time to rest, from the loss of kinetic energy, 1/s; 0 for a stone at rest."""
    # A net law knows no spin without sliding: all is over when the stone stops.
    inertia = 0.0 if isinstance(law, NetLaw) else stone.rho**2
    square = state.v**2 + inertia * state.omega**2
    power = -(state.v * rate.v + inertia * state.omega * rate.omega)
    return jnp.maximum(power, 0.0) / jnp.where(square > 0, square, 1.0)


class _Course(NamedTuple):
    """A heading with its sine and cosine."""

    heading: Array
    s: Array
    c: Array

    def near(self, heading: Array) -> _Course:
        """Another one, by series, which unlike the library's functions run in a processor's
        vectors: to 1e-11 for up to 0.6 rad between them, to 1e-7 for 1.5 rad."""
        turn = heading - self.heading
        square = turn**2
        sine = cosine = 0.0
        for n in range(5, -1, -1):
            sine = sine * square + (-1) ** n / factorial(2 * n + 1)
            cosine = cosine * square + (-1) ** n / factorial(2 * n)
        sine *= turn
        return _Course(heading, self.s * cosine + self.c * sine, self.c * cosine - self.s * sine)

    def whole(self) -> _Course:
        """The same with no error in the sum of the squares."""
        scale = 1 / jnp.sqrt(self.s**2 + self.c**2)
        return self._replace(s=scale * self.s, c=scale * self.c)


def _rates(
    law: Law,
    stone: Stone,
    load: Load,
    rounds: Array,
    course: _Course,
    crowd: Crowding,
    state: _State,
    time: Array,
) -> _State:
    """Time derivative of the state; `course` is one that it had shortly before.

    A stone that all but spins in place, under a force across its motion, runs round circles of
    radius v^2/a_xi. Where it turns faster than `rounds` (rad/s), it is pinned to their centre.
    """
    a = accelerations(law, stone, load, state.v, state.omega, state.phi, time, crowd)
    moving = state.v > 0
    turning = jnp.where(moving, a.xi / jnp.where(moving, state.v, 1.0), 0.0)
    pinned = jnp.abs(turning) > rounds
    along, turning = (jnp.where(pinned, 0.0, value) for value in (state.v, turning))
    _, s, c = course.near(state.heading)
    return _State(along * s, along * c, turning, state.omega, a.eta, a.angular)


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
    wanted = frequency * to_go ** (1 / 6) / STEP
    needed = jnp.maximum(ending / _LARGEST_STEP, jnp.abs(rate.heading) / _LARGEST_TURN)
    dt = 1 / jnp.maximum(wanted, needed)
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


@jax.custom_jvp
def _weighted(weights: Array, slopes: Array) -> Array:
    """Sum over the first axis.

    Alone, term by term, it becomes part of what it is used for. With derivatives it is a product
    of matrices, which XLA does not make part of anything: it would find them anew for each use.
    """
    return sum(weights[place] * slope for place, slope in enumerate(slopes[:-1]))


@_weighted.defjvp
def _(inputs: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
    weights, _ = inputs
    return jnp.tensordot(weights, inputs[1], 1), jnp.tensordot(weights, tangents[1], 1)


class _Moving(NamedTuple):
    """Between two steps: time, length of the next step (0 when there is nothing more to do), the
    course, the state and its time derivative, each of shape (6, lanes), and whether all is done.
    """

    t: Array
    dt: Array
    course: _Course
    state: Array
    rate: Array
    idle: Array


def _knot(moving: _Moving) -> Array:
    """End of a step, shape (10, lanes): t, and of x, y, phi the values, their first and their
    second time derivatives."""
    state, rate = _State(*moving.state), _State(*moving.rate)
    _, s, c = moving.course
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
    _, s, c = moving.course
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


def _quintic(a: Array, b: Array) -> Array:
    """Polynomials between two knots in `s`, which goes from 0 to 1: six coefficients for each of
    x, y, phi, shape (6, 3, lanes)."""
    h = b[0] - a[0]
    p0, v0, a0 = a[1:4], h * a[4:7], h**2 * a[7:] / 2
    rise = b[1:4] - (p0 + v0 + a0)
    slope = h * b[4:7] - (v0 + 2 * a0)
    bend = h**2 * b[7:] / 2 - a0
    c3 = 10 * rise - 4 * slope + bend
    c4 = -15 * rise + 7 * slope - 2 * bend
    c5 = 6 * rise - 3 * slope + bend
    return jnp.stack([p0, v0, a0, c3, c4, c5])


def _values(quintic: Array, s: Array) -> tuple[Array, Array]:
    """Values of x, y, phi at `s` (n, lanes), and their derivatives by it, each (3, n, lanes)."""
    c0, c1, c2, c3, c4, c5 = quintic[:, :, None]
    return (
        c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5)))),
        c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5))),
    )


_Motion = tuple[tuple[Array, ...], Array]
"""x, y, phi, vx, vy, omega at given times, and the time of coming to rest"""


def _integrate(
    law: Law, stone: Stone, v0: Array, omega0: Array, *, times: Array, load: Load
) -> _Motion:
    """Motions from the origin along +y, one a lane, at `times` >= 0.

    The start has shape (lanes,), the law's coefficients that or (), the times, which do not fall
    from row to row, (n, lanes) or (n, 1); x, y, phi, vx, vy, omega each have shape (n, lanes), the times of coming to rest
    (lanes,).
    """
    # A zero that comes from the start: whatever is carried depends on the start before the first
    # step, and JAX need not find out, for each loop within another, what does by trying.
    zero = 0.0 * (v0 + omega0)
    lanes = v0.shape
    last = jnp.max(times, 0) + jnp.zeros(lanes)
    span = jnp.maximum(last, 1e-9)
    tableau = jnp.asarray(np.pad(_TABLEAU, ((0, 0), (0, 1))))
    moments = jnp.asarray(_TABLEAU.sum(1))

    # A speed does not go on below zero, nor the spin of a net law beyond its end.
    sense = _State(*[jnp.zeros(())] * 6)._replace(v=jnp.ones(()))
    if isinstance(law, NetLaw):
        sense = sense._replace(omega=jnp.sign(omega0))
    sense = jnp.stack(jnp.broadcast_arrays(*sense, zero)[:-1])

    def admitted(state: Array) -> Array:
        """A state without motion backwards."""
        return jnp.where((state * sense > 0) | (sense == 0), state, 0.0)

    def step(moving: _Moving) -> _Moving:
        t, dt, course, begin, rate, _ = moving
        before = _State(*begin)
        crowd = crowding(before.v, stone.R * before.omega)
        # Circles that a stone runs thousands of times before anything else changes are below
        # 1e-7 m.
        slowing = _slowing(law, stone, before, _State(*rate))
        rounds = jnp.where(dt > 0, _MOST_TURNING * (1 / span + slowing), jnp.inf)

        # A loop over the stages, not six copies of them, keeps the compiled program small. Their
        # slopes are weighted by a dot product, which XLA does not make part of anything else: it
        # would find the slopes, and their derivatives, anew for each use of them.
        def stage(place: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            _, slopes = carry
            now = admitted(begin + dt * _weighted(tableau[place], slopes))
            rates = _rates(
                law, stone, load, rounds, course, crowd, _State(*now), t + dt * moments[place]
            )
            for row, rate in enumerate(rates):
                slopes = jax.lax.dynamic_update_slice(slopes, rate[None, None], (place + 1, row, 0))
            return now, slopes

        slopes = jnp.zeros((_STAGES + 1, *rate.shape)).at[0].set(rate)
        state, slopes = jax.lax.fori_loop(0, _STAGES, stage, (begin, slopes))
        course = course.near(_State(*state).heading).whole()
        return planned(moving._replace(t=t + dt, course=course, state=state, rate=slopes[-1]))

    def planned(moving: _Moving) -> _Moving:
        """The same with the length of the next step."""
        state, rate = _State(*moving.state), _State(*moving.rate)
        dt, at_rest = _step_size(law, stone, state, rate, moving.t, span)
        idle = at_rest | (moving.t >= last)
        return moving._replace(dt=jnp.where(idle, 0.0, dt), idle=idle)

    def going(moving: _Moving) -> Array:
        # A path that has become NaN is not followed further: it could hold up all the others.
        return (~moving.idle & ~jnp.isnan(moving.dt)).any()

    window = min(_WINDOW, len(times))
    rows = jnp.pad(times, ((0, window), (0, 0)), constant_values=jnp.inf)

    def said(knots: tuple[Array, Array], idle: Array, low: Array, out: Any) -> tuple[Array, Any]:
        """The rows within a step, filled in, a window of rows at a time, and the first row that
        some lane has still before it."""
        a, b = knots
        quintic = _quintic(a, b)
        rate = 1 / jnp.where(b[0] > a[0], b[0] - a[0], 1.0)

        def more(carry: tuple[Array, Array, Any]) -> Array:
            place, *_ = carry
            return (jax.lax.dynamic_index_in_dim(rows, place, keepdims=False) <= b[0]).any()

        def again(carry: tuple[Array, Array, Any]) -> tuple[Array, Array, Any]:
            place, low, out = carry
            t = jax.lax.dynamic_slice_in_dim(rows, place, window)
            value, slope = _values(quintic, (t - a[0]) * rate)
            inside = (t >= a[0]) & (t <= b[0])

            def put(out: Array, new: Array) -> Array:
                old = jax.lax.dynamic_slice_in_dim(out, place, window, 1)
                new = jnp.where(inside, new, old)
                return jax.lax.dynamic_update_slice_in_dim(out, new, place, 1)

            passed = (~(t >= b[0]) | idle).all(1)
            low = jnp.where(low == place, low + jnp.cumprod(passed).sum(), low)
            return place + window, low, (put(out[0], value), put(out[1], slope * rate))

        return jax.lax.while_loop(more, again, (low, low, out))[1:]

    def again(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, moving, knot, _, low, out = carry
        moving = step(moving)
        begin, knot = knot, _knot(moving)
        idle = moving.idle | jnp.isnan(moving.dt)
        low, out = said((begin, knot), idle, low, out)
        return count + 1, moving, knot, _resting(law, stone, moving), low, out

    def unfinished(carry: tuple[Any, ...]) -> Array:
        count, moving, *_ = carry
        return (count < _MOST_STEPS) & going(moving)

    state = jnp.stack([zero, zero, zero, zero, v0, omega0])
    # The first step has no length; it is there to find the rates at the start.
    course = _Course(zero, zero, 1 + zero)
    moving = _Moving(zero, zero, course, state, zero * state, idle=zero > 0)
    blank = jnp.full((3, len(rows), *lanes), jnp.nan) + zero
    # Where it rests is carried along, or XLA would find it anew for each of the times.
    begin = (0, moving, _knot(moving), zero * state[:4], 0, (blank, blank))
    _, moving, _, held, _, out = jax.lax.while_loop(unfinished, again, begin)
    at_rest = moving.idle & (times >= moving.t)
    ends = (*held[:3], zero, zero, zero)
    path = tuple(
        jnp.where(at_rest, end, channel[: len(times)])
        for end, channel in zip(ends, (*out[0], *out[1]), strict=True)
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


def _whole(law: type[Law], load: Load, *arrays: Array) -> _Motion:
    coefficients, stone, (v0, omega0), times = arrays
    return _integrate(
        law.from_vector(coefficients), Stone(*stone), v0, omega0, times=times, load=load
    )


def _with_jacobian(
    law: type[Law], load: Load, asked: tuple[bool, ...], *arrays: Array
) -> tuple[_Motion, _Motion]:
    """Path and time of rest, and their derivatives by the inputs asked for, along the first
    axis."""
    *inputs, times = arrays
    free = [vector for ask, vector in zip(asked, inputs, strict=True) if ask]

    def run(free: list[Array]) -> _Motion:
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
) -> _Motion:
    """One motion from the origin along +y, at n times."""
    return _in_lanes(partial(_whole, law, load))(*inputs, times)


def _trajectory_jvp(
    law: type[Law], load: Load, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[_Motion, _Motion]:
    inputs, times = primals
    d_inputs, d_times = tangents
    asked = tuple(not isinstance(tangent, SymbolicZero) for tangent in d_inputs)
    if any(asked):
        function = partial(_with_jacobian, law, load, asked)
        out, jacobian = _in_lanes(function)(*inputs, times)
        step = jnp.concatenate([d for ask, d in zip(asked, d_inputs, strict=True) if ask])
        change, later = jax.tree.map(lambda part: jnp.tensordot(step, part, 1), jacobian)
    else:
        out = _in_lanes(partial(_whole, law, load))(*inputs, times)
        change, later = jax.tree.map(jnp.zeros_like, out)
    if not isinstance(d_times, SymbolicZero):
        moved = (d + rate * d_times for d, rate in zip(change, out[0][3:], strict=False))
        change = (*moved, *change[3:])
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
    ordered: bool = False,
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
    ordered : times are known not to fall from one to the next, so that compiled code need not sort
        them.

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
    if ordered or _ordered(times):
        return _simulate(*as_floats, times, t0, load=checked)
    order = jnp.argsort(times)
    path, back = _simulate(*as_floats, times[order], t0, load=checked), jnp.argsort(order)
    return jax.tree.map(lambda values: values[back] if values.ndim else values, path)


def _ordered(times: Array) -> bool:
    """Whether times are known not to fall."""
    return not isinstance(times, jax.core.Tracer) and bool((np.diff(times) >= 0).all())
