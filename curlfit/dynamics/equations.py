"""One step of a stone: what moves it, how far it may go at once, and the path in between.

The speed `v`, the heading `b` (eq. 24's beta) and the spin `omega` make up the motion:

    dv/dt = a_eta,  v db/dt = a_xi,  domega/dt = alpha,  dx/dt = v sin b,  dy/dt = v cos b.

It names its own time scales: the time to rest, the turning of the velocity, and the
passage of |epsilon| = 1, where one point of the ring stops sliding and friction has a logarithmic
kink. Each step is a fixed fraction of the shortest of these, so it shrinks geometrically toward
rest. Toward the kink it shrinks more slowly, for the same error at each step, down to one over the
kink that is short enough to miss little of it. A law may name angles turned at which its friction
has a corner, and how fast it changes by itself; steps end at the one and follow the other, and up
to the last corner they follow the turning too. Between steps the path is the quintic polynomial
through position, velocity and acceleration at both ends.

All is done lane by lane, one throw in each.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

from curlfit.dynamics.contact import Crowding, accelerations, swing

# isort: split
import jax.numpy as jnp
from jaxtyping import Array

from curlfit.friction import Law, Load, NetLaw, power
from curlfit.stone import Stone

STEP = 0.25  # step over the shortest time scale, for a motion with 1 m or 1 rad to go
_ENDING, _PASSING = 1.3, 1.1  # how much the times to rest and to the kink count over the others
_LARGEST_STEP = 0.6  # over the time to rest
_LARGEST_TURN = 1.5  # rad in a step
_LARGEST_APPROACH = 0.6  # over the time to the kink, in `swing`
_REST = 1e-10  # a stone with less than this to go (m and rad together) is at rest
_KINK = 2e-5  # width in `swing` to which the kink at |epsilon| = 1 is resolved, with 1 m to go
_MOST_TURNING = 5000.0  # rad of turning of the velocity in one time scale of the motion
_CORNER = 1e-9  # rad before a corner of the law at which it counts as reached
_LEAST_SPIN = 1e-8  # rad/s below which the end of the spin is not resolved further


class State(NamedTuple):
    """Rows of a packed state, or of its time derivative."""

    x: Array
    y: Array
    phi: Array
    heading: Array
    v: Array
    omega: Array


def _slowing(law: Law, stone: Stone, state: State, rate: State) -> Array:
    """One over the time to rest, from the loss of kinetic energy, 1/s; 0 for a stone at rest."""
    # A net law knows no spin without sliding: all is over when the stone stops.
    inertia = 0.0 if isinstance(law, NetLaw) else stone.rho**2
    square = state.v**2 + inertia * state.omega**2
    power = -(state.v * rate.v + inertia * state.omega * rate.omega)
    return jnp.maximum(power, 0.0) / jnp.where(square > 0, square, 1.0)


class Course(NamedTuple):
    """A heading with its sine and cosine."""

    heading: Array
    s: Array
    c: Array

    def near(self, heading: Array) -> Course:
        """Another one, by series, which unlike the library's functions run in a processor's
        vectors: to 1e-11 for up to 0.6 rad between them, to 1e-7 for 1.5 rad."""
        turn = heading - self.heading
        square = turn**2
        sine = cosine = jnp.zeros_like(turn)
        for n in range(5, -1, -1):
            sine = sine * square + (-1) ** n / factorial(2 * n + 1)
            cosine = cosine * square + (-1) ** n / factorial(2 * n)
        sine *= turn
        return Course(heading, self.s * cosine + self.c * sine, self.c * cosine - self.s * sine)

    def whole(self) -> Course:
        """The same with no error in the sum of the squares."""
        scale = 1 / jnp.sqrt(self.s**2 + self.c**2)
        return self._replace(s=scale * self.s, c=scale * self.c)


def rates(
    law: Law,
    stone: Stone,
    load: Load,
    rounds: Array,
    course: Course,
    crowd: Crowding,
    state: State,
    time: Array,
) -> State:
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
    return State(along * s, along * c, state.omega, turning, a.eta, a.angular)


def rounds(law: Law, stone: Stone, span: Array, state: State, rate: State) -> Array:
    """Rate of turning (rad/s) from which a stone is pinned: circles that it runs thousands of times
    before anything else changes are below 1e-7 m."""
    return _MOST_TURNING * (1 / span + _slowing(law, stone, state, rate))


def _to_go(law: Law, stone: Stone, state: State, rate: State) -> tuple[Array, Array]:
    """Whether the stone moves, and how far it has still to go, with 1 rad counted as 1 m."""
    turns = (state.omega != 0) & (not isinstance(law, NetLaw))
    moving = (state.v > 0) | turns
    square = jnp.where(moving, state.v**2 + state.omega**2, 1.0)
    return moving, jnp.sqrt(square) / jnp.maximum(_slowing(law, stone, state, rate), 1e-9)


def at_rest(law: Law, stone: Stone, state: State, rate: State) -> Array:
    """Whether there is nothing left to go."""
    moving, to_go = _to_go(law, stone, state, rate)
    return ~moving | (to_go < _REST)


def step_size(law: Law, stone: Stone, span: Array, state: State, rate: State, time: Array) -> Array:
    """Next step in s."""
    v, u = state.v, stone.R * state.omega
    slowing = _slowing(law, stone, state, rate)
    _, to_go = _to_go(law, stone, state, rate)
    au, du = jnp.abs(u), stone.R * jnp.sign(u) * rate.omega
    total = jnp.where(v + au > 0, v + au, 1.0)
    swing_rate = 2 * jnp.abs(au * rate.v - v * du) / total**2
    # The error of the step over the kink goes as its square, times what is left to go.
    kink = swing(v, u) + _KINK / jnp.sqrt(jnp.maximum(to_go, _REST))
    # Where dv/dt ~ v^-n, the time to rest is v/|dv/dt| over 1 + n; the kink is steeper, too.
    steepness = law.steepness()
    ending = slowing * (1 + steepness)
    # Friction at a distance d from the kink is like d^(1-n) log d. A step h has an error of h^6
    # times its fifth derivative, the same at any d where h ~ d^((4+n)/6).
    passing = _PASSING * swing_rate * (1 + 2 * steepness) / power(kink, (4 + steepness) / 6)
    frequency = 1 / span + _ENDING * ending + jnp.abs(rate.heading) + passing + law.quickness(time)
    if isinstance(law, NetLaw):
        frequency += jnp.abs(rate.omega) / (jnp.abs(state.omega) + _LEAST_SPIN)
    if law.corners:
        turning = jnp.sqrt(1 / span**2 + state.omega**2 + jnp.abs(rate.omega))
        frequency += turning * (jnp.abs(state.phi) < max(law.corners) - _CORNER)
    # The error of a step goes as its fraction to the sixth power, times what is left to go. With
    # the seventh root the same number of steps has the least error.
    wanted = frequency * to_go ** (1 / 7) / STEP
    needed = jnp.maximum(ending / _LARGEST_STEP, jnp.abs(rate.heading) / _LARGEST_TURN)
    needed = jnp.maximum(needed, swing_rate / kink / _LARGEST_APPROACH)
    dt = 1 / jnp.maximum(wanted, needed)
    for corner in law.corners:
        left = _time_to_turn(corner, state, rate)
        # In two steps, for the time is predicted the better the shorter it is.
        dt = jnp.where(left < dt / 8, left, jnp.minimum(dt, 7 / 8 * left))
    return dt


def _time_to_turn(corner: float, state: State, rate: State) -> Array:
    """Time in which the stone turns to an angle, from its spin and the loss of it; or inf."""
    sense = jnp.sign(state.omega)
    spin, gain = sense * state.omega, sense * rate.omega
    angle = sense * (corner - state.phi)
    square = spin**2 + 2 * gain * angle
    ahead = (angle > _CORNER) & (square > 0)
    root = jnp.sqrt(jnp.where(ahead, square, 1.0))
    return jnp.where(ahead, 2 * angle / (spin + root), jnp.inf)


class Moving(NamedTuple):
    """Between two steps: time, length of the next step (0 when there is nothing more to do), the
    course, the state and its time derivative, packed, (6, lanes), and the second time derivatives
    of x, y, phi, (3, lanes)."""

    t: Array
    dt: Array
    course: Course
    state: Array
    rate: Array
    bend: Array


def bend(course: Course, state: State, rate: State) -> Array:
    """Second time derivatives of x, y, phi."""
    _, s, c = course
    along, across = rate.v, state.v * rate.heading
    return jnp.stack([along * s + across * c, along * c - across * s, rate.omega])


def resting(law: Law, stone: Stone, moving: Moving) -> Array:
    """x, y, phi where the stone comes to rest, and when, shape (4, lanes).

    What little is left to go is gone at an even loss of speed and spin.
    """
    state, rate = State(*moving.state), State(*moving.rate)
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


class Quintic(NamedTuple):
    """Polynomials of x, y, phi between two steps."""

    begin: Array
    rate: Array
    """1/h, of the step's length"""
    coefficients: tuple[Array, ...]
    """by falling power of (t - begin)/h, each (3, lanes)"""

    def at(self, t: Array) -> tuple[Array, Array]:
        """Values and time derivatives at times (n, lanes or 1), each (3, n, lanes)."""
        s = (t - self.begin) * self.rate
        value = slope = jnp.zeros_like(s)
        for coefficient in self.coefficients:
            slope = slope * s + value
            value = value * s + coefficient[:, None]
        return value, slope * self.rate


def quintic(a: Moving, b: Moving) -> Quintic:
    """The path from one step to the next."""
    h = b.t - a.t
    h = jnp.where(h > 0, h, 1.0)
    c0, c1, c2 = a.state[:3], h * a.rate[:3], h**2 * (0.5 * a.bend)
    rise = b.state[:3] - (c0 + c1 + c2)
    slope = h * b.rate[:3] - (c1 + 2 * c2)
    bend = h**2 * (0.5 * b.bend) - c2
    c3 = 10 * rise - 4 * slope + bend
    c4 = -15 * rise + 7 * slope - 2 * bend
    c5 = 6 * rise - 3 * slope + bend
    return Quintic(a.t, 1 / h, (c5, c4, c3, c2, c1, c0))
