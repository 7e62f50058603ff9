"""Equations of motion, choice of the step size, and interpolation of the path
within a step.

With speed `v`, heading `b` (beta of eq. 24) and spin `omega`

    dv/dt = a_eta,  v db/dt = a_xi,  domega/dt = alpha,
    dx/dt = v sin b,  dy/dt = v cos b,

where a_eta and a_xi are due to friction, gravity on ice that is not level,
and air drag.

The time scales of this motion are the time to rest, the turning of the velocity and the
passage of |epsilon| = 1, where one point of the ring stops sliding and friction has a
logarithmic kink. Each step is a fixed fraction of the shortest of these, so steps
shrink geometrically toward rest. Toward the kink they shrink more slowly, for equal
errors, down to one step across the kink that is short enough for its error to be
negligible. A law may declare angles turned at which its friction has a kink (`corners`)
and a rate of explicit change in time (`quickness`): steps end at these angles, resolve
this rate, and resolve the rotation up to the last angle. Steps also end where sweeping
begins and ends, and a step of 2 ns crosses the jump of the friction there. Within a
step the path is the quintic polynomial that matches position, velocity and acceleration
at both ends.

All arrays have the batch, one throw in each column, along the last axis.
"""

from __future__ import annotations

from math import factorial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from curlfit.dynamics.contact import Accelerations, accelerations
from curlfit.environment import WEAR_KNOTS
from curlfit.friction import Law, Load, NetLaw, power
from curlfit.numerics.ring_nodes import NodeClustering, singularity_distance
from curlfit.stone import Stone

STEP = 0.25  # fraction of the shortest time scale, with 1 m or 1 rad remaining
_REST_WEIGHT = 1.3  # of the rate to rest, relative to the other rates
_KINK_WEIGHT = 1.1  # of the rate to the kink
_MAX_STEP = 0.6  # fraction of the time to rest
_MAX_TURN = 1.5  # rad in a step
_MAX_APPROACH = 0.6  # fraction of the time to the kink, by singularity distance
_REST = 1e-10  # remaining motion (m and rad together) of a stone at rest
# singularity distance to which the kink at |epsilon| = 1 is resolved, 1 m remaining
_KINK = 2e-5
_CIRCLE = 1e-10  # radius in m of the smallest circles of a stone that are followed
_ANGLE_TOLERANCE = 1e-9  # rad, for reaching an angle of the law's `corners`
# s, delay of the beginning and end of sweeping, so that steps can end there
_SWITCH = 1e-9
_MIN_SPIN = 1e-8  # rad/s, down to which the end of the spin is resolved
_SLOWEST_DECAY = 1e-9  # 1/s, in place of a rate of decay that is zero or negative


class State(NamedTuple):
    """Rows of a packed state, or of its time derivative."""

    x: Array
    y: Array
    phi: Array
    heading: Array
    v: Array
    omega: Array


def _decay_rate(law: Law, stone: Stone, state: State, rate: State) -> Array:
    """Inverse of the time to rest, from the loss of kinetic energy, 1/s; 0 for a
    stone at rest."""
    # Under a net law there is no spin without translation.
    square_radius = 0.0 if isinstance(law, NetLaw) else stone.rho**2
    # Of the kinetic energy E: 2 E/m and -(dE/dt)/m, whose quotient is |dv/dt|/v.
    energy = state.v**2 + square_radius * state.omega**2
    loss = -(state.v * rate.v + square_radius * state.omega * rate.omega)
    return jnp.where(loss > 0, loss, 0.0) / jnp.where(energy > 0, energy, 1.0)


@jax.custom_jvp
def _sine_cosine(heading: Array, s: Array, c: Array) -> tuple[Array, Array]:
    """The known sine and cosine of a heading, differentiated with respect to
    the heading."""
    return s, c


@_sine_cosine.defjvp
def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    s, c = _sine_cosine(*primals)  # so that derivatives of any order are correct
    return (s, c), (c * tangents[0], -s * tangents[0])


class HeadingFrame(NamedTuple):
    """A heading with its sine and cosine, without derivatives of its own."""

    heading: Array
    s: Array
    c: Array

    def rotated_to(self, heading: Array) -> HeadingFrame:
        """The frame of another heading, by series, which unlike the library's
        functions are vectorized: accurate to 1e-11 for turns up to 0.6 rad, to 1e-7
        up to 1.5 rad."""
        turn = jax.lax.stop_gradient(heading) - self.heading
        square = turn**2
        sine = cosine = jnp.zeros_like(turn)
        for n in range(5, -1, -1):
            sine = sine * square + (-1) ** n / factorial(2 * n + 1)
            cosine = cosine * square + (-1) ** n / factorial(2 * n)
        sine *= turn
        # the addition theorems
        s = self.s * cosine + self.c * sine
        c = self.c * cosine - self.s * sine
        return HeadingFrame(heading, *_sine_cosine(heading, s, c))

    def normalized(self) -> HeadingFrame:
        """The frame with s^2 + c^2 = 1."""
        scale = 1 / jnp.sqrt(self.s**2 + self.c**2)
        return self._replace(s=scale * self.s, c=scale * self.c)


class ExternalForces(NamedTuple):
    """Effects on a stone besides its law, in the frame of the initial heading
    (y along it)."""

    g_x: Array
    """acceleration due to gravity, m/s^2"""
    g_y: Array
    drag: Array
    """deceleration by air drag over v^2, 1/m"""
    wear: Array
    """relative change of the friction with y, 1/m"""
    bend_0: Array
    """one sixth of the jumps of its third derivative at `WEAR_KNOTS`, 1/m^3"""
    bend_10: Array
    bend_20: Array
    bend_30: Array
    sweep: Array
    """factor on the friction between the next two times, in s since the start"""
    swept_from: Array
    swept_to: Array


def rates(
    law: Law,
    stone: Stone,
    forces: Array | None,
    load: Load,
    frame: HeadingFrame,
    clustering: NodeClustering,
    state: State,
    time: Array,
) -> State:
    """Time derivative of the state; `frame` is that of a nearby heading.

    `forces` are the fields of `ExternalForces`, shape (11, batch); None for
    a law alone.

    A stone that spins almost in place, under a transverse force, moves on circles of
    radius v^2/a_xi. The smaller they are than `_CIRCLE`, the less they are followed;
    smoothly, for the sake of derivatives.
    """
    a = accelerations(
        law, stone, load, state.v, state.omega, state.phi, time, clustering
    )
    moving = state.v > 0
    _, s, c = frame.rotated_to(state.heading)

    def followed(across: Array) -> Array:
        """The part of the motion on circles that is followed, for a
        transverse acceleration."""
        return state.v**4 / jnp.where(moving, state.v**4 + (_CIRCLE * across) ** 2, 1.0)

    if forces is not None:
        outer = ExternalForces(*forces)
        swept = (time > outer.swept_from + _SWITCH) & (time <= outer.swept_to + _SWITCH)
        # a cubic spline of the distance along the throw
        worn = 1 + outer.wear * state.y
        bends = (outer.bend_0, outer.bend_10, outer.bend_20, outer.bend_30)
        for knot, bend in zip(WEAR_KNOTS, bends, strict=True):
            worn = worn + bend * jnp.maximum(state.y - knot, 0.0) ** 3
        factor = jnp.where(swept, outer.sweep, 1.0) * worn
        across = factor * a.xi + c * outer.g_x - s * outer.g_y
        gravity = followed(across) * (s * outer.g_x + c * outer.g_y)
        pull = gravity - outer.drag * state.v**2
        a = Accelerations(across, factor * a.eta + pull, factor * a.angular)
    part = followed(a.xi)
    turning = part * a.xi / jnp.where(moving, state.v, 1.0)
    along = part * state.v
    return State(
        x=along * s,
        y=along * c,
        phi=state.omega,
        heading=turning,
        v=a.eta,
        omega=a.angular,
    )


def _remaining_motion(law: Law, state: State, decay_rate: Array) -> tuple[Array, Array]:
    """Whether the stone moves, and the scale of its remaining motion, 1 rad
    counted as 1 m."""
    turns = (state.omega != 0) & (not isinstance(law, NetLaw))
    moving = (state.v > 0) | turns
    square = jnp.where(moving, state.v**2 + state.omega**2, 1.0)
    return moving, jnp.sqrt(square) / _positive(decay_rate)


def _positive(decay_rate: Array) -> Array:
    return jnp.where(decay_rate > _SLOWEST_DECAY, decay_rate, _SLOWEST_DECAY)


def at_rest(law: Law, stone: Stone, state: State, rate: State) -> Array:
    """Whether the remaining motion is negligible."""
    moving, remaining = _remaining_motion(
        law, state, _decay_rate(law, stone, state, rate)
    )
    return ~moving | (remaining < _REST)


def step_size(
    law: Law,
    stone: Stone,
    forces: Array | None,
    span: Array,
    state: State,
    rate: State,
    time: Array,
) -> Array:
    """Length of the next step in s."""
    v = state.v
    u = stone.R * state.omega
    decay_rate = _decay_rate(law, stone, state, rate)
    _, remaining = _remaining_motion(law, state, decay_rate)
    # the rate of |v - |u||/(v + |u|), the distance to the kink
    au = jnp.abs(u)
    au_rate = stone.R * jnp.sign(u) * rate.omega
    total = jnp.where(v + au > 0, v + au, 1.0)
    distance_rate = 2 * jnp.abs(au * rate.v - v * au_rate) / total**2
    # The error of the step across the kink is its square times the remaining motion.
    kink = singularity_distance(v, u) + _KINK / jnp.sqrt(jnp.maximum(remaining, _REST))
    # Where dv/dt ~ v^-n, the time to rest is v/|dv/dt|/(1 + n); the kink is
    # also steeper.
    speed_exponent = law.steepness()
    rest_rate = decay_rate * (1 + speed_exponent)
    # Friction at a distance d from the kink behaves like d^(1-n) log d. A step h
    # has an error of h^6 times the fifth derivative, which is the same at any d if
    # h ~ d^((4+n)/6).
    kink_rate = (
        _KINK_WEIGHT
        * distance_rate
        * (1 + 2 * speed_exponent)
        / power(kink, (4 + speed_exponent) / 6)
    )
    frequency = (
        1 / span
        + _REST_WEIGHT * rest_rate
        + jnp.abs(rate.heading)
        + kink_rate
        + law.quickness(time)
    )
    if isinstance(law, NetLaw):
        frequency += jnp.abs(rate.omega) / (jnp.abs(state.omega) + _MIN_SPIN)
    if law.corners:
        turning = jnp.sqrt(1 / span**2 + state.omega**2 + jnp.abs(rate.omega))
        last = jnp.stack([jnp.asarray(angle) for angle in law.corners]).max()
        frequency += turning * (jnp.abs(state.phi) < last - _ANGLE_TOLERANCE)
    # The error of a step is the sixth power of its fraction times the remaining motion;
    # the seventh root minimizes the error for a given number of steps.
    largest = frequency * remaining ** (1 / 7) / STEP
    for stability_rate in (
        rest_rate / _MAX_STEP,
        jnp.abs(rate.heading) / _MAX_TURN,
        distance_rate / kink / _MAX_APPROACH,
    ):
        # Not `maximum`, whose derivative takes ten operations.
        largest = jnp.where(largest > stability_rate, largest, stability_rate)
    dt = 1 / largest
    for angle in law.corners:
        time_left = _time_to_angle(angle, state, rate)
        # In two steps, since the prediction improves as the time becomes shorter.
        dt = jnp.where(
            time_left < dt / 8, time_left, jnp.minimum(dt, 7 / 8 * time_left)
        )
    switches = () if forces is None else ExternalForces(*forces)[-2:]
    for switch in switches:
        time_left = switch - time
        dt = jnp.where(time_left > _SWITCH, jnp.minimum(dt, time_left), dt)
        dt = jnp.where(jnp.abs(time_left) <= _SWITCH, 2 * _SWITCH, dt)
    return dt


def _time_to_angle(target: Any, state: State, rate: State) -> Array:
    """Time until the angle reaches `target`, for constant angular
    acceleration; or inf."""
    # all in the sense of the rotation
    sense = jnp.sign(state.omega)
    spin = sense * state.omega
    gain = sense * rate.omega
    angle = sense * (target - state.phi)
    # of the spin at the target
    square = spin**2 + 2 * gain * angle
    ahead = (angle > _ANGLE_TOLERANCE) & (square > 0)
    root = jnp.sqrt(jnp.where(ahead, square, 1.0))
    return jnp.where(ahead, 2 * angle / (spin + root), jnp.inf)


class StepState(NamedTuple):
    """Time, length of the next step (0 where the integration has ended), heading frame,
    the packed state and its time derivative, (6, batch), and the second time
    derivatives of x, y, phi, (3, batch)."""

    t: Array
    dt: Array
    frame: HeadingFrame
    state: Array
    rate: Array
    second: Array


def second_derivatives(frame: HeadingFrame, state: State, rate: State) -> Array:
    """Second time derivatives of x, y, phi; `frame` is that of the heading."""
    s, c = _sine_cosine(state.heading, frame.s, frame.c)
    along = rate.v
    across = state.v * rate.heading
    return jnp.stack([along * s + across * c, along * c - across * s, rate.omega])


def extrapolated_rest(
    law: Law, stone: Stone, t: Array, frame: HeadingFrame, state: State, rate: State
) -> Array:
    """x, y, phi and time at rest, shape (4, batch), if speed and spin
    decrease linearly."""
    decay_rate = _decay_rate(law, stone, state, rate)
    duration = 0.5 / _positive(decay_rate)  # at the mean speed
    s, c = _sine_cosine(state.heading, frame.s, frame.c)
    rest_rate = decay_rate * (1 + law.steepness())
    decelerating = rest_rate > 0
    turning = 0.0 if isinstance(law, NetLaw) else jnp.abs(state.omega)
    otherwise = jnp.where(state.v + turning > 0, jnp.inf, 0.0)
    x = state.x + duration * state.v * s
    y = state.y + duration * state.v * c
    phi = state.phi + duration * state.omega
    time_to_rest = 1 / jnp.where(decelerating, rest_rate, 1.0)
    rest = t + jnp.where(decelerating, time_to_rest, otherwise)
    return jnp.stack([x, y, phi, rest])


def quintic_coefficients(
    h: Array,
    state_a: Array,
    rate_a: Array,
    second_a: Array,
    state_b: Array,
    rate_b: Array,
    second_b: Array,
) -> tuple[Array, ...]:
    """Polynomials for x, y, phi over a step of length h, from fields of `StepState` at
    both ends: coefficients by decreasing power of (t - t0)/h, each (3, batch)."""
    c0 = state_a[:3]
    c1 = h * rate_a[:3]
    c2 = h**2 * (0.5 * second_a)
    # what the parabola from the beginning lacks at the end
    difference = state_b[:3] - (c0 + c1 + c2)
    slope = h * rate_b[:3] - (c1 + 2 * c2)
    curvature = h**2 * (0.5 * second_b) - c2
    c3 = 10 * difference - 4 * slope + curvature
    c4 = -15 * difference + 7 * slope - 2 * curvature
    c5 = 6 * difference - 3 * slope + curvature
    return c5, c4, c3, c2, c1, c0


def quintic(
    t0: Array, h: Array, coefficients: tuple[Array, ...], t: Array
) -> tuple[Array, Array]:
    """Values and time derivatives of these polynomials at times (n, batch or 1):
    (3, n, batch)."""
    inverse_step = 1 / h
    s = (t - t0) * inverse_step
    value = slope = jnp.zeros_like(s)
    for coefficient in coefficients:
        slope = slope * s + value
        value = value * s + coefficient[:, None]
    return value, slope * inverse_step
