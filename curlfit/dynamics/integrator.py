"""Throws followed side by side, one a lane, with their derivatives.

Method. The fifth-order formula of Dormand and Prince (1980), in steps whose lengths the motion
itself names (see `steps.py`). Nothing is rejected and repeated, so stones run in lockstep, and
derivatives are those of a fixed smooth map. The rows asked for are filled in as the stones pass
them.

A throw has some ten inputs. Its derivatives by them are carried along with it, as directions that
stand before the lanes, so that the Jacobian costs some ten paths and nothing need be stored to be
run backwards; both directions of JAX's differentiation are made from it.

Why not a general solver: diffrax with adaptive steps takes several times as long for the same
accuracy, its run-time checks keep compiled programs out of the cache, and coming to rest needs an
event whose derivative is delicate. It serves the tests as an independent oracle instead.

For speed as XLA compiles it: arrays are joined by writing rows into a larger one, since a `stack`
is computed element by element; and what is used more than once passes the border of a loop or
comes of a product of matrices, or it would be computed anew for each use.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from curlfit.dynamics.contact import crowding
from curlfit.dynamics.equations import (
    Course,
    Moving,
    State,
    at_rest,
    bend,
    quintic,
    rates,
    resting,
    rounds,
    step_size,
)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from curlfit.friction import Law, Load, NetLaw
from curlfit.stone import Stone

_MOST_STEPS = 32_000
_WINDOW = 8  # rows that are filled in together

# Dormand and Prince (1980), RK5(4)7M. The last row is the fifth-order formula itself, so that its
# slope is the first slope of the next step.
_TABLEAU = np.zeros((6, 7))
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

Motion = tuple[tuple[Array, ...], Array]
"""x, y, phi, and vx, vy, omega where they are wanted, at given times; the time of coming to rest"""


class _Both(NamedTuple):
    """A value and its derivatives, which have one more axis, of directions, before the lanes; None
    where no derivatives are wanted."""

    value: Any
    slopes: Any = None


def _map(function: Callable[..., Any], *inputs: _Both) -> _Both:
    """A function of lanes, of values and of derivatives."""
    values = tuple(item.value for item in inputs)
    if all(item.slopes is None for item in inputs):
        return _Both(function(*values))
    moved = [place for place, item in enumerate(inputs) if item.slopes is not None]

    def along(slopes: list[Any]) -> Any:
        def those(*changed: Any) -> Any:
            full = list(values)
            for place, value in zip(moved, changed, strict=True):
                full[place] = value
            return function(*full)

        return jax.jvp(those, tuple(values[place] for place in moved), tuple(slopes))

    slopes = [inputs[place].slopes for place in moved]
    return _Both(*jax.vmap(along, in_axes=-2, out_axes=(None, -2))(slopes))


def _mean(weights: Array, slopes: _Both) -> _Both:
    """Weighted sum over the first axis, the last left out.

    Term by term it becomes part of what it is used for, which is what a path alone wants.
    """
    if slopes.slopes is None:
        return _Both(sum(weights[place] * slope for place, slope in enumerate(slopes.value[:-1])))
    return _Both(*(jnp.tensordot(weights, part, 1) for part in slopes))


def _put(whole: _Both, part: _Both, function: Callable[[Array, Array], Array]) -> _Both:
    if whole.slopes is None:
        return _Both(function(whole.value, part.value))
    return _Both(function(whole.value, part.value), function(whole.slopes, part.slopes))


def _follow(
    ice: Callable[[Any], tuple[Law, Stone]],
    given: _Both,
    start: _Both,
    *,
    times: Array,
    load: Load,
    velocities: bool,
) -> tuple[_Both, _Both]:
    """Motions from the origin along +y, one a lane, at `times` >= 0.

    Parameters
    ----------
    ice : law and stone from the value of `given`.
    start : speed and spin, shape (2, lanes).
    times : in s, not falling from row to row, shape (n, lanes or 1); inf for rows that nobody asks
        for, which cost nothing and are 0.

    Returns
    -------
    x, y, phi, and vx, vy, omega if wanted, each of shape (n, lanes), and the times of coming to
    rest, (lanes,).
    """
    law, stone = ice(given.value)
    net = isinstance(law, NetLaw)
    omega0 = start.value[1]
    asked = ~(times == jnp.inf)
    last = jnp.max(jnp.where(asked, times, 0.0), 0) + jnp.zeros_like(omega0)
    span = jnp.maximum(last, 1e-9)
    tableau, moments = jnp.asarray(_TABLEAU), jnp.asarray(_TABLEAU.sum(1))
    # A speed does not go on below zero, nor the spin of a net law beyond its end.
    sense = jnp.zeros((6, len(omega0))).at[4].set(1.0)
    sense = sense.at[5].set(jnp.sign(omega0)) if net else sense

    def reached(begin: Array, dt: Array, mean: Array) -> Array:
        state = begin + dt * mean
        return jnp.where((state * sense > 0) | (sense == 0), state, 0.0)

    def step(moving: _Both) -> _Both:
        t, dt, course, begin, rate, _ = _fields(moving)
        before, change = State(*begin.value), State(*rate.value)
        crowd = crowding(before.v, stone.R * before.omega)
        most = jnp.where(dt.value > 0, rounds(law, stone, span, before, change), jnp.inf)

        def felt(given: Any, course: Course, now: Array, time: Array) -> State:
            return rates(*ice(given), load, most, course, crowd, State(*now), time)

        # A loop over the stages, not six copies of them, keeps the compiled program small.
        def stage(place: Array, carry: tuple[_Both, _Both]) -> tuple[_Both, _Both]:
            _, slopes = carry
            now = _map(reached, begin, dt, _mean(tableau[place], slopes))
            time = _map(lambda t, dt: t + dt * moments[place], t, dt)
            found = _map(felt, given, course, now, time)
            for row in range(len(State._fields)):

                def put(whole: Array, part: Array, row: int = row) -> Array:
                    at: Any = (place + 1, row, *(0 for _ in part.shape))
                    return jax.lax.dynamic_update_slice(whole, part[None, None], at)

                slopes = _put(slopes, _at(found, row), put)
            return now, slopes

        blank = _map(lambda rate: jnp.zeros((_STAGES + 1, *rate.shape)), rate)
        slopes = _put(blank, rate, lambda whole, part: whole.at[0].set(part))
        state, slopes = jax.lax.fori_loop(0, _STAGES, stage, (begin, slopes))
        return planned(
            _map(lambda t, dt: t + dt, t, dt),
            _map(lambda course, state: course.near(State(*state).heading).whole(), course, state),
            state,
            _at(slopes, -1),
        )

    def planned(t: _Both, course: _Both, state: _Both, rate: _Both) -> _Both:
        """With the length of the next step."""

        def plan(given: Any, t: Array, course: Course, state: Array, rate: Array) -> Moving:
            now, change = State(*state), State(*rate)
            dt = step_size(*ice(given), span, now, change, t)
            idle = at_rest(law, stone, now, change) | (t > last)
            dt = jnp.where(idle, 0.0, dt)
            return Moving(t, dt, course, state, rate, bend(course, now, change))

        return _map(plan, given, t, course, state, rate)

    def going(moving: Moving) -> Array:
        # A path that has become NaN is not followed further: it could hold up all the others.
        return moving.dt > 0

    kinds = 2 if velocities else 1
    window = min(_WINDOW, len(times))
    rows = jnp.pad(times, ((0, window), (0, 0)), constant_values=jnp.inf)

    def fill(a: _Both, b: _Both, low: Array, out: _Both) -> tuple[Array, _Both]:
        """The rows within a step, a window of rows at a time, and the first row that some lane has
        still before it."""
        path = _map(quintic, a, b)
        begin, end, done = a.value.t, b.value.t, ~going(b.value)
        reach = jnp.where(going(a.value), end, -jnp.inf)

        def more(carry: tuple[Array, Array, _Both]) -> Array:
            place, *_ = carry
            return (jax.lax.dynamic_index_in_dim(rows, place, keepdims=False) <= reach).any()

        def again(carry: tuple[Array, Array, _Both]) -> tuple[Array, Array, _Both]:
            place, low, out = carry
            t = jax.lax.dynamic_slice_in_dim(rows, place, window)
            inside = (t >= begin) & (t <= end)

            def put(whole: Array, part: Array) -> Array:
                old = jax.lax.dynamic_slice_in_dim(whole, place, window, 1)
                seen = inside if part.ndim == 3 else inside[:, None]
                new = jnp.where(seen, part, old)
                return jax.lax.dynamic_update_slice_in_dim(whole, new, place, 1)

            out = _put(
                out,
                _map(lambda path: path.at(t)[:kinds], path),
                lambda *pair: jax.tree.map(put, *pair),
            )
            passed = (~(t >= end) | done).all(1)
            low = jnp.where(low == place, low + jnp.cumprod(passed).sum(), low)
            return place + window, low, out

        return jax.lax.while_loop(more, again, (low, low, out))[1:]

    def rest(moving: _Both) -> _Both:
        return _map(lambda given, moving: resting(*ice(given), moving), given, moving)

    def again(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, before, _, low, out = carry
        after = step(before)
        low, out = fill(before, after, low, out)
        return count + 1, after, rest(after), low, out

    def unfinished(carry: tuple[Any, ...]) -> Array:
        count, moving, *_ = carry
        return (count < _MOST_STEPS) & ((count == 0) | going(moving.value).any())

    # The first step has no length; it is there to find the rates at the start.
    def at_start(start: Array) -> Moving:
        v0, omega0 = start
        zero = jnp.zeros_like(v0)
        state = jnp.stack([zero, zero, zero, zero, v0, omega0])
        course = Course(zero, zero, 1 + zero)
        return Moving(zero, zero, course, state, 0 * state, 0 * state[:3])

    moving = _map(at_start, start)
    blank = _map(lambda start: (jnp.full((3, len(rows), start.shape[-1]), jnp.nan),) * kinds, start)
    # Where it rests is carried along, or XLA would find it anew for each of the times.
    held = _map(lambda moving: moving.state[:4], moving)
    begin = (0, moving, held, 0, blank)
    _, moving, held, _, out = jax.lax.while_loop(unfinished, again, begin)
    state, rate = State(*moving.value.state), State(*moving.value.rate)
    over = at_rest(law, stone, state, rate) & (times >= moving.value.t)
    over |= ~asked

    def whole(held: Array, out: tuple[Array, ...]) -> tuple[Array, ...]:
        stopped = (jnp.where(asked, place, 0.0) for place in held[:3])
        ends: tuple[Any, ...] = (*stopped, 0.0, 0.0, 0.0)
        channels = (channel for kind in out for channel in kind)
        return tuple(
            jnp.where(over, end, channel[: len(times)])
            for end, channel in zip(ends, channels, strict=False)
        )

    return _map(whole, held, out), _map(lambda held: held[3], held)


def _fields(moving: _Both) -> list[_Both]:
    slopes = (None,) * len(moving.value) if moving.slopes is None else moving.slopes
    return [_Both(*pair) for pair in zip(moving.value, slopes, strict=True)]


def _at(rows: _Both, place: int) -> _Both:
    return _Both(*(part if part is None else part[place] for part in rows))


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


def _alone(law: type[Law], load: Load, velocities: bool, *arrays: Array) -> Motion:
    coefficients, stone, start, times = arrays
    ice = lambda given: (law.from_vector(given[0]), Stone(*given[1]))  # noqa: E731
    path, rest = _follow(
        ice,
        _Both((coefficients, stone)),
        _Both(start),
        times=times,
        load=load,
        velocities=velocities,
    )
    return path.value, rest.value


def _with_jacobian(
    law: type[Law], load: Load, velocities: bool, asked: tuple[bool, ...], *arrays: Array
) -> tuple[Motion, Motion]:
    """A motion, and its derivatives by the inputs asked for, along the last axis but the lanes."""
    *inputs, times = arrays
    sizes = [len(vector) * ask for ask, vector in zip(asked, inputs, strict=True)]
    lanes, total, done = inputs[0].shape[-1], sum(sizes), 0
    both = []
    for size, vector in zip(sizes, inputs, strict=True):
        basis = np.zeros((len(vector), total, 1))
        basis[:size, done : done + size, 0] = np.eye(size)
        done += size
        both.append(_Both(vector, jnp.broadcast_to(basis, (len(vector), total, lanes))))
    *ice_, start = both
    free = [item for ask, item in zip(asked, ice_, strict=False) if ask]

    def ice(given: list[Array]) -> tuple[Law, Stone]:
        rest = iter(given)
        coefficients, stone = (
            next(rest) if ask else item.value for ask, item in zip(asked, ice_, strict=False)
        )
        return law.from_vector(coefficients), Stone(*stone)

    given = _Both([item.value for item in free], [item.slopes for item in free] if free else None)
    path, rest = _follow(ice, given, start, times=times, load=load, velocities=velocities)
    return (path.value, rest.value), (path.slopes, rest.slopes)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def trajectory(
    law: type[Law],
    load: Load,
    velocities: bool,
    inputs: tuple[Array, Array, Array],
    times: Array,
) -> Motion:
    """One motion from the origin along +y.

    Parameters
    ----------
    velocities : whether these are wanted, which takes as long again as the places.
    inputs : the law's coefficients, the stone's fields and (v0, omega0), as vectors. Those that
        nobody asks about cost nothing, and what `vmap` maps over becomes lanes of one call.
    times : in s, from 0 up, not falling from one to the next, shape (n,). Rows at inf, which may
        stand at the end, cost nothing and are 0.
    """
    return _in_lanes(partial(_alone, law, load, velocities))(*inputs, times)


def _trajectory_jvp(
    law: type[Law],
    load: Load,
    velocities: bool,
    primals: tuple[Any, ...],
    tangents: tuple[Any, ...],
) -> tuple[Motion, Motion]:
    inputs, times = primals
    d_inputs, d_times = tangents
    asked = tuple(not isinstance(tangent, SymbolicZero) for tangent in d_inputs)
    if any(asked):
        function = partial(_with_jacobian, law, load, velocities, asked)
        out, jacobian = _in_lanes(function)(*inputs, times)
        step = jnp.concatenate([d for ask, d in zip(asked, d_inputs, strict=True) if ask])
        change, later = jax.tree.map(lambda part: part @ step, jacobian)
    else:
        out = _in_lanes(partial(_alone, law, load, velocities))(*inputs, times)
        change, later = jax.tree.map(jnp.zeros_like, out)
    if not isinstance(d_times, SymbolicZero):
        if not velocities:
            raise TypeError("derivatives by the times need the velocities")
        moved = (d + rate * d_times for d, rate in zip(change, out[0][3:], strict=False))
        change = (*moved, *change[3:])
    return out, (change, later)


trajectory.defjvp(_trajectory_jvp, symbolic_zeros=True)
