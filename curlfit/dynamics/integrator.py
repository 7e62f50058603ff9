"""Integration of a batch of throws, with derivatives.

Method. The fifth-order formula of Dormand and Prince (1980), with the step sizes of
`equations`. No step is rejected, so all throws of a batch advance together, and
derivatives are those of a smooth map. The requested rows are interpolated as the
stones pass them.

A throw has about ten inputs. Its derivatives with respect to these are integrated
alongside it as tangents, on an axis before the batch: the Jacobian costs about ten
trajectories and nothing is stored for a reverse pass; both differentiation modes of JAX
are derived from it.

Why not a general solver: diffrax with adaptive steps takes several times as long for
the same accuracy, its run-time checks keep compiled programs out of the cache, and the
derivative of the rest event is delicate. The tests use it as an independent reference.

For speed under XLA, arrays are joined by writing rows into a larger one, since a
`stack` is computed element by element; and a value used more than once crosses a loop
boundary or is the result of a matrix product, since it would otherwise be recomputed
for each use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero

from curlfit.dynamics.equations import (
    HeadingFrame,
    State,
    StepState,
    at_rest,
    extrapolated_rest,
    quintic,
    quintic_coefficients,
    rates,
    second_derivatives,
    step_size,
)
from curlfit.friction import Law, Load, NetLaw
from curlfit.numerics.ring_nodes import node_clustering
from curlfit.stone import Stone

_MAX_STEPS = 32_000  # after which a motion counts as failed
_WINDOW = 8  # rows interpolated together
_SHORTEST_SPAN = 1e-9  # s, in place of a duration of 0

# Dormand and Prince (1980), RK5(4)7M. The last row is the fifth-order formula itself,
# so that its derivative is also the first of the next step.
_TABLEAU = np.zeros((6, 7))
for _stage, _weights in enumerate(
    (
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    )
):
    _TABLEAU[_stage, : len(_weights)] = _weights
_STAGES = len(_TABLEAU)


class Solution(NamedTuple):
    """A motion, or its derivatives."""

    channels: tuple[Array, ...]
    """x, y, phi, and vx, vy, omega if requested, at the given times"""
    rest: Array
    """the time of rest"""


class _Dual(NamedTuple):
    """A value and its tangents, which have an additional axis of directions before the
    batch axis; None where no derivatives are requested."""

    value: Any
    tangents: Any = None


def _map(function: Callable[..., Any], *inputs: _Dual) -> _Dual:
    """A function of batches, at the values and along the tangents of its inputs."""
    values = tuple(dual.value for dual in inputs)
    varying = [index for index, dual in enumerate(inputs) if dual.tangents is not None]
    if not varying:
        return _Dual(function(*values))

    def of_varying(*arguments: Any) -> Any:
        full = list(values)
        for index, value in zip(varying, arguments, strict=True):
            full[index] = value
        return function(*full)

    def pushforward(direction: list[Any]) -> Any:
        primals = tuple(values[index] for index in varying)
        return jax.jvp(of_varying, primals, tuple(direction))

    tangents = [inputs[index].tangents for index in varying]
    # Values do not depend on the direction, and are computed once for all of them.
    along_all = jax.vmap(pushforward, in_axes=-2, out_axes=(None, -2))
    return _Dual(*along_all(tangents))


def _weighted_sum(weights: Array, derivatives: _Dual) -> _Dual:
    """Weighted sum over the first axis, without the last row.

    Values alone are summed term by term, which XLA fuses with the use of the sum.
    """
    if derivatives.tangents is None:
        rows = enumerate(derivatives.value[:-1])
        return _Dual(sum(weights[index] * row for index, row in rows))
    return _Dual(*(jnp.tensordot(weights, part, 1) for part in derivatives))


def _update(
    whole: _Dual, part: _Dual, function: Callable[[Array, Array], Array]
) -> _Dual:
    """A linear change of an array by another one, of values and of tangents alike."""
    value = function(whole.value, part.value)
    if whole.tangents is None:
        return _Dual(value)
    return _Dual(value, function(whole.tangents, part.tangents))


def _integrate_batch(
    system: Callable[[Any], tuple[Law, Stone]],
    forces: Callable[[Any], Array | None],
    parameters: _Dual,
    start: _Dual,
    *,
    times: Array,
    load: Load,
    velocities: bool,
) -> tuple[_Dual, _Dual]:
    """A batch of motions from the origin along +y, at `times` >= 0.

    Parameters
    ----------
    system, forces : functions of the value of `parameters`: law and stone, and forces
        besides the law (`equations.ExternalForces`).
    start : initial speed and spin, shape (2, batch).
    times : in s, non-decreasing from row to row, shape (n, batch or 1); inf for unused
        rows, which cost nothing and are 0.

    Returns
    -------
    x, y, phi, and vx, vy, omega if requested, each of shape (n, batch), and the times
    of rest, (batch,).
    """
    law, stone = system(parameters.value)
    net = isinstance(law, NetLaw)
    omega0 = start.value[1]
    used = ~(times == jnp.inf)
    last = jnp.max(jnp.where(used, times, 0.0), 0) + jnp.zeros_like(omega0)
    span = jnp.maximum(last, _SHORTEST_SPAN)
    tableau = jnp.asarray(_TABLEAU)
    nodes = jnp.asarray(_TABLEAU.sum(1))
    # The speed, and under a net law the spin, end at zero: signs that they must keep.
    sign = jnp.zeros((6, len(omega0))).at[4].set(1.0)
    if net:
        sign = sign.at[5].set(jnp.sign(omega0))

    def increment(begin: Array, dt: Array, mean: Array) -> Array:
        state = begin + dt * mean
        return jnp.where((state * sign > 0) | (sign == 0), state, 0.0)

    def advance(step: _Dual) -> _Dual:
        """The step after a step, by the formula of Dormand and Prince."""
        t, dt, frame, begin, rate, _ = _fields(step)
        # The nodes of the ring and the frame of the heading are chosen once for all
        # stages, and need no tangents: the motion does not depend on the choice, but
        # for the errors of quadrature and series.
        state_before = State(*begin.value)
        clustering = node_clustering(state_before.v, stone.R * state_before.omega)

        def derivative(parameters: Any, packed: Array, time: Array) -> State:
            outer = forces(parameters)
            law, stone = system(parameters)
            state = State(*packed)
            return rates(law, stone, outer, load, frame.value, clustering, state, time)

        # A loop over the stages, rather than six copies, keeps the compiled
        # program small.
        def stage(index: Array, carry: tuple[_Dual, _Dual]) -> tuple[_Dual, _Dual]:
            _, derivatives = carry
            mean = _weighted_sum(tableau[index], derivatives)
            state = _map(increment, begin, dt, mean)
            time = _map(lambda t, dt: t + dt * nodes[index], t, dt)
            stage_rate = _map(derivative, parameters, state, time)
            # Rows are written one by one, since XLA is slow to stack them.
            for row in range(len(State._fields)):

                def write(whole: Array, part: Array, row: int = row) -> Array:
                    at: Any = (index + 1, row, *(0 for _ in part.shape))
                    return jax.lax.dynamic_update_slice(whole, part[None, None], at)

                derivatives = _update(derivatives, _row(stage_rate, row), write)
            return state, derivatives

        empty = _map(lambda rate: jnp.zeros((_STAGES + 1, *rate.shape)), rate)
        derivatives = _update(empty, rate, lambda whole, part: whole.at[0].set(part))
        state, derivatives = jax.lax.fori_loop(0, _STAGES, stage, (begin, derivatives))

        t = _map(lambda t, dt: t + dt, t, dt)
        after = frame.value.rotated_to(State(*state.value).heading).normalized()
        return step_state(t, after, state, _row(derivatives, -1))

    def step_state(t: _Dual, frame: HeadingFrame, state: _Dual, rate: _Dual) -> _Dual:
        """The state at the end of a step, with the length of the next."""
        resting = at_rest(law, stone, State(*state.value), State(*rate.value))
        ended = resting | (t.value > last)

        def length(
            parameters: Any, t: Array, packed: Array, packed_rate: Array
        ) -> Array:
            state = State(*packed)
            rate = State(*packed_rate)
            law, stone = system(parameters)
            dt = step_size(law, stone, forces(parameters), span, state, rate, t)
            return jnp.where(ended, 0.0, dt)

        def second(packed: Array, packed_rate: Array) -> Array:
            return second_derivatives(frame, State(*packed), State(*packed_rate))

        dt = _map(length, parameters, t, state, rate)
        return _step(t, dt, _Dual(frame), state, rate, _map(second, state, rate))

    def rest_of(step: _Dual) -> _Dual:
        """x, y, phi and time at rest, extrapolated from the state of a step."""
        t, _, frame, state, rate, _ = _fields(step)

        def rest(parameters: Any, t: Array, packed: Array, packed_rate: Array) -> Array:
            law, stone = system(parameters)
            state = State(*packed)
            rate = State(*packed_rate)
            return extrapolated_rest(law, stone, t, frame.value, state, rate)

        return _map(rest, parameters, t, state, rate)

    window = min(_WINDOW, len(times))
    rows = jnp.pad(times, ((0, window), (0, 0)), constant_values=jnp.inf)

    def iterate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        count, before, _, first, out = carry
        after = advance(before)
        first, out = _fill_rows(before, after, rows, window, first, out)
        return count + 1, after, rest_of(after), first, out

    def unfinished(carry: tuple[Any, ...]) -> Array:
        count, step, *_ = carry
        return (count < _MAX_STEPS) & ((count == 0) | _active(step.value).any())

    # The first step has length zero; it computes the initial rates.
    zero = jnp.zeros_like(omega0)
    still = _map(lambda start: 0 * start[0], start)
    frame = _Dual(HeadingFrame(zero, zero, 1 + zero))
    state = _map(lambda start: jnp.stack([*(0 * start[0],) * 4, *start]), start)
    rate = _map(lambda state: 0 * state, state)
    second = _map(lambda state: 0 * state[:3], state)
    step = _step(still, still, frame, state, rate, second)

    orders = 2 if velocities else 1  # positions, and their time derivatives

    def unfilled(start: Array) -> tuple[Array, ...]:
        return (jnp.full((3, len(rows), start.shape[-1]), jnp.nan),) * orders

    empty = _map(unfilled, start)
    # Part of the carry, since XLA would otherwise recompute it for each of the times.
    rest = _map(lambda state: state[:4], state)
    _, step, rest, _, out = jax.lax.while_loop(
        unfinished, iterate, (0, step, rest, 0, empty)
    )
    ended = at_rest(law, stone, State(*step.value.state), State(*step.value.rate))
    constant = ended & (times >= step.value.t)
    constant |= ~used

    def channels(rest: Array, out: tuple[Array, ...]) -> tuple[Array, ...]:
        """The rows, with the place of rest where the stone is at rest, and 0 where they
        are unused."""
        place = [jnp.where(used, coordinate, 0.0) for coordinate in rest[:3]]
        final: list[Any] = [*place, 0.0, 0.0, 0.0]
        moving = (channel for order in out for channel in order)
        return tuple(
            jnp.where(constant, end, channel[: len(times)])
            for end, channel in zip(final, moving, strict=False)
        )

    return _map(channels, rest, out), _map(lambda rest: rest[3], rest)


def _active(step: StepState) -> Array:
    # False for NaN, so that a failed motion does not delay the batch.
    return step.dt > 0


def _fill_rows(
    a: _Dual, b: _Dual, rows: Array, window: int, first: Array, out: _Dual
) -> tuple[Array, _Dual]:
    """Interpolate the rows between two states, a window of rows at a time, from the
    row `first` on.

    Parameters
    ----------
    a, b : steps, each a `StepState`, at the beginning and at the end.
    rows : times, shape (n + window, batch or 1).
    out : a channel array, (3, n + window, batch), for each order of derivatives.

    Returns
    -------
    The first row that is not yet complete for the whole batch, and `out` with
    the new rows.
    """
    t0, _, _, *first_end = _fields(a)
    t1, _, _, *second_end = _fields(b)
    h = _map(lambda t0, t1: jnp.where(t1 > t0, t1 - t0, 1.0), t0, t1)
    coefficients = _map(quintic_coefficients, h, *first_end, *second_end)
    begin = a.value.t
    end = b.value.t
    ended = ~_active(b.value)
    reach = jnp.where(_active(a.value), end, -jnp.inf)
    orders = len(out.value)

    def within_step(carry: tuple[Array, Array, _Dual]) -> Array:
        index, *_ = carry
        row = jax.lax.dynamic_index_in_dim(rows, index, keepdims=False)
        return (row <= reach).any()

    def fill_window(carry: tuple[Array, Array, _Dual]) -> tuple[Array, Array, _Dual]:
        index, first, out = carry
        t = jax.lax.dynamic_slice_in_dim(rows, index, window)
        inside = (t >= begin) & (t <= end)

        def write(whole: Array, part: Array) -> Array:
            old = jax.lax.dynamic_slice_in_dim(whole, index, window, 1)
            mask = inside if part.ndim == 3 else inside[:, None]
            new = jnp.where(mask, part, old)
            return jax.lax.dynamic_update_slice_in_dim(whole, new, index, 1)

        def interpolated(t0: Array, h: Array, polynomials: Any) -> tuple[Array, ...]:
            return quintic(t0, h, polynomials, t)[:orders]

        def write_orders(whole: Any, part: Any) -> Any:
            return jax.tree.map(write, whole, part)

        new_rows = _map(interpolated, t0, h, coefficients)
        out = _update(out, new_rows, write_orders)
        # Rows at the end of the step are left to the next step, unless there is none.
        complete = (~(t >= end) | ended).all(1)
        first = jnp.where(first == index, first + jnp.cumprod(complete).sum(), first)
        return index + window, first, out

    return jax.lax.while_loop(within_step, fill_window, (first, first, out))[1:]


def _fields(step: _Dual) -> list[_Dual]:
    """The fields of a `StepState`, each with its tangents."""
    tangents = (None,) * len(step.value) if step.tangents is None else step.tangents
    return [_Dual(*pair) for pair in zip(step.value, tangents, strict=True)]


def _step(*fields: _Dual) -> _Dual:
    """A `StepState` from its fields, not all of which need tangents."""
    value = StepState(*(field.value for field in fields))
    if all(field.tangents is None for field in fields):
        return _Dual(value)
    return _Dual(value, StepState(*(field.tangents for field in fields)))


def _row(rows: _Dual, index: int) -> _Dual:
    value = rows.value[index]
    return _Dual(value, None if rows.tangents is None else rows.tangents[index])


def _mappable(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function of one throw from one of a batch; its `vmap` is one call
    for the batch.

    Parameters
    ----------
    function : takes arrays of shape (k, batch) and times (n, batch or 1); its results
        have the batch on the last axis.
    """

    @custom_vmap
    def of_batch(*arrays: Array) -> Any:
        return function(*arrays)

    @of_batch.def_vmap
    def _(size: int, mapped: list[bool], *arrays: Array) -> Any:
        if not any(mapped):  # JAX does this when differentiating unmapped calls
            out = function(*arrays)
            return out, jax.tree.map(lambda _: False, out)
        batch = max(array.shape[-1] for array in arrays)

        def merge(array: Array, is_mapped: bool, may_broadcast: bool) -> Array:
            if not is_mapped and may_broadcast and array.shape[-1] == 1:
                return array
            array = array if is_mapped else array[None]
            full = jnp.broadcast_to(array, (size, array.shape[1], batch))
            return jnp.moveaxis(full, 1, 0).reshape(-1, size * batch)

        def split(array: Array) -> Array:
            return jnp.moveaxis(array.reshape(*array.shape[:-1], size, batch), -2, 0)

        *inputs, times = arrays
        *mapped_inputs, mapped_times = mapped
        merged = [
            merge(array, is_mapped, may_broadcast=False)
            for array, is_mapped in zip(inputs, mapped_inputs, strict=True)
        ]
        out = of_batch(*merged, merge(times, mapped_times, may_broadcast=True))
        return jax.tree.map(split, out), jax.tree.map(lambda _: True, out)

    def of_one(*arrays: Array) -> Any:
        out = of_batch(*(array[:, None] for array in arrays))
        return jax.tree.map(lambda array: array[..., 0], out)

    return of_one


def _values(law: type[Law], load: Load, velocities: bool, *arrays: Array) -> Solution:
    """A batch of motions; `arrays` are the inputs of `integrate` and the times, with
    the batch as the last axis."""
    *constants, start, times = arrays
    path, rest = _integrate_batch(
        lambda parameters: (law.from_vector(parameters[0]), Stone(*parameters[1])),
        _forces_in,
        _Dual(tuple(constants)),
        _Dual(start),
        times=times,
        load=load,
        velocities=velocities,
    )
    return Solution(path.value, rest.value)


def _forces_in(constants: Sequence[Array]) -> Array | None:
    """The forces in (coefficients, stone[, forces]); None without any."""
    return constants[2] if len(constants) > 2 else None


def _values_and_jacobian(
    law: type[Law],
    load: Load,
    velocities: bool,
    active: tuple[bool, ...],
    *arrays: Array,
) -> tuple[Solution, Solution]:
    """A batch of motions, and their derivatives with respect to the active inputs,
    along the axis before the batch; `arrays` as in `_values`."""
    *inputs, times = arrays
    batch = inputs[0].shape[-1]
    total = sum(
        len(vector)
        for vector, is_active in zip(inputs, active, strict=True)
        if is_active
    )
    # one direction for each element of the active inputs, in order
    duals = []
    offset = 0
    for vector, is_active in zip(inputs, active, strict=True):
        basis = np.zeros((len(vector), total, 1))
        if is_active:
            basis[:, offset : offset + len(vector), 0] = np.eye(len(vector))
            offset += len(vector)
        tangents = jnp.broadcast_to(basis, (len(vector), total, batch))
        duals.append(_Dual(vector, tangents))
    *constants, start = duals
    free = [
        index for index, is_active in enumerate(active[: len(constants)]) if is_active
    ]

    def unpacked(parameters: list[Array]) -> list[Array]:
        """All constants, from those that are active."""
        vectors = [dual.value for dual in constants]
        for index, vector in zip(free, parameters, strict=True):
            vectors[index] = vector
        return vectors

    def system(parameters: list[Array]) -> tuple[Law, Stone]:
        coefficients, stone, *_ = unpacked(parameters)
        return law.from_vector(coefficients), Stone(*stone)

    def forces(parameters: list[Array]) -> Array | None:
        return _forces_in(unpacked(parameters))

    values = [constants[index].value for index in free]
    tangents_of_free = [constants[index].tangents for index in free]
    parameters = _Dual(values, tangents_of_free if free else None)
    path, rest = _integrate_batch(
        system, forces, parameters, start, times=times, load=load, velocities=velocities
    )
    jacobian = Solution(path.tangents, rest.tangents)
    return Solution(path.value, rest.value), jacobian


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def integrate(
    law: type[Law],
    load: Load,
    velocities: bool,
    inputs: tuple[Array, ...],
    times: Array,
) -> Solution:
    """One motion from the origin along +y.

    Parameters
    ----------
    velocities : whether to return velocities, which takes as long again as
        the positions.
    inputs : the law's coefficients, the stone's fields, the external forces if there
        are any (see `equations.ExternalForces`), and (v0, omega0), as vectors. Inputs
        without tangents cost nothing; a `vmap` becomes one batch.
    times : in s, >= 0, non-decreasing, shape (n,). Rows at inf, allowed at the end,
        cost nothing and are 0.
    """
    return _mappable(partial(_values, law, load, velocities))(*inputs, times)


def _integrate_jvp(
    law: type[Law],
    load: Load,
    velocities: bool,
    primals: tuple[Any, ...],
    tangents: tuple[Any, ...],
) -> tuple[Solution, Solution]:
    """The derivatives of all outputs along a direction, from the Jacobian, which is
    computed once for any number of directions."""
    inputs, times = primals
    d_inputs, d_times = tangents
    active = tuple(not isinstance(tangent, SymbolicZero) for tangent in d_inputs)
    if any(active):
        function = partial(_values_and_jacobian, law, load, velocities, active)
        out, jacobian = _mappable(function)(*inputs, times)
        direction = jnp.concatenate(
            [d for d, is_active in zip(d_inputs, active, strict=True) if is_active]
        )
        change = jax.tree.map(lambda part: part @ direction, jacobian)
    else:
        out = _mappable(partial(_values, law, load, velocities))(*inputs, times)
        change = jax.tree.map(jnp.zeros_like, out)
    if not isinstance(d_times, SymbolicZero):
        if not velocities:
            raise TypeError("derivatives with respect to the times need the velocities")
        d_positions = change.channels[:3]
        velocity = out.channels[3:]
        d_positions = tuple(
            d + rate * d_times for d, rate in zip(d_positions, velocity, strict=True)
        )
        change = change._replace(channels=(*d_positions, *change.channels[3:]))
    return out, change


integrate.defjvp(_integrate_jvp, symbolic_zeros=True)
