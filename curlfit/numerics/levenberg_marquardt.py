"""Levenberg and Marquardt's method within bounds, for optimistix.

optimistix has no bounds; `BoxDescent` adds them by projection (Kanzow, Yamashita and Fukushima
2004). Damping is in proportion to the columns of the Jacobian, which makes the steps independent
of units.

It has arrived where the residual is orthogonal to all that a step could change, by the relative
offset of Bates and Watts (1981): the length of what the next step takes from the residual, over the
residual's own. Near the end such a step gains less than the rounding of the sum of squares, which
then says neither whether the step was good nor when to stop. There steps are taken for as long as
they get shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from curlfit.numerics import jax_setup  # noqa: F401  (before equinox)

# isort: split
import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array

_FIRST_DAMPING = 1e-4  # of Marquardt's damping, relative to the squared columns
_OFFSET = 1e-9  # relative offset at which the optimum is reached
_UNTOLD = 1e-10  # share of the sum of squares, a change by which may be but rounding


class _BoxState(eqx.Module):
    y: Array
    f_info: Any


class BoxDescent(optx.AbstractDescent):
    """Damped Newton step within bounds, for use in an optimistix Gauss-Newton solver.

    A variable that sits at a bound and is pushed against it takes no part in the step; the others
    take the damped step, cut off at their bounds.
    """

    lower: Array
    upper: Array

    def init(self, y: Array, f_info_struct: Any) -> _BoxState:
        """Required by optimistix."""
        blank = jax.tree.map(
            lambda leaf: (
                jnp.zeros(leaf.shape, leaf.dtype)
                if isinstance(leaf, jax.ShapeDtypeStruct)
                else leaf
            ),
            f_info_struct,
        )
        return _BoxState(y, blank)

    def query(self, y: Array, f_info: Any, state: _BoxState) -> _BoxState:
        """Required by optimistix."""
        return _BoxState(y, f_info)

    def step(self, step_size: Array, state: _BoxState) -> tuple[Array, Any]:
        """The step at damping `_FIRST_DAMPING / step_size`."""
        jacobian = state.f_info.jac.as_matrix()
        residual = state.f_info.residual.reshape(-1)
        gradient = residual @ jacobian
        held = (state.y <= self.lower) & (gradient >= 0) | (state.y >= self.upper) & (gradient <= 0)
        held |= self.lower >= self.upper
        jacobian = jnp.where(held, 0.0, jacobian)
        size = jnp.sqrt((jacobian**2).sum(0))
        size = jnp.maximum(size, 1e-12 * size.max() + 1e-300)
        damping = jnp.sqrt(_FIRST_DAMPING / step_size)
        stacked = jnp.concatenate([jacobian / size, damping * jnp.eye(len(size))])
        right = jnp.concatenate([residual, jnp.zeros_like(size)])
        solution = lx.linear_solve(
            lx.MatrixLinearOperator(stacked), right, lx.QR(), throw=False
        ).value
        move = jnp.where(held, 0.0, -solution / size)
        return jnp.clip(state.y + move, self.lower, self.upper) - state.y, optx.RESULTS.successful


def _gain(step: Array, f_info: Any) -> Array:
    """How much a step would take from half the sum of squares, to first order of the residual.

    Not as the difference of two sums, of which rounding leaves nothing near the optimum.
    """
    residual, change = f_info.residual, f_info.jac.mv(step)
    return -(residual * change).sum() - (change**2).sum() / 2


class _SearchState(eqx.Module):
    step_size: Array
    gain: Array
    """of the step last tried"""


class _TrustRegion(optx.ClassicalTrustRegion):
    """Takes steps as well of which the sum of squares cannot tell whether they are good."""

    def init(self, y: Array, f_info_struct: Any) -> Any:
        """Required by optimistix."""
        return _SearchState(jnp.array(1.0), jnp.array(jnp.inf))

    def predict_reduction(self, y_diff: Array, f_info: Any) -> Array:
        """Required by optimistix."""
        return -_gain(y_diff, f_info)

    def step(
        self, first_step: Array, y: Array, y_eval: Array, f_info: Any, f_eval_info: Any, state: Any
    ) -> tuple[Array, Array, Any, Any]:
        """Size of the next step, and whether to take this one."""
        _, accept, result, judged = super().step(first_step, y, y_eval, f_info, f_eval_info, state)
        gain, before = _gain(y_eval - y, f_info), f_info.as_min()
        untold = (jnp.abs(gain) <= _UNTOLD * before) & ~first_step
        untold &= f_eval_info.as_min() <= (1 + _UNTOLD) * before
        size = jnp.where(untold, self.high_constant * state.step_size, judged.step_size)
        gain = jnp.where(first_step, jnp.inf, gain)
        return size, accept | untold, result, _SearchState(size, gain)


class BoxLevenbergMarquardt(optx.AbstractGaussNewton):
    """Levenberg and Marquardt's method within bounds.

    Beside the relative offset optimistix's rule holds (`rtol`, `atol`), for data without noise.
    """

    rtol: float
    atol: float
    norm: Callable[..., Any]
    descent: BoxDescent
    search: optx.ClassicalTrustRegion
    verbose: Callable[..., None]

    def __init__(self, lower: Array, upper: Array, rtol: float, atol: float) -> None:
        self.rtol, self.atol = rtol, atol
        self.norm = optx.max_norm
        self.descent = BoxDescent(lower, upper)
        self.search = _TrustRegion()
        self.verbose = _silent

    def step(
        self, fn: Any, y: Array, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, Any, Any]:
        """Required by optimistix."""
        y, state, aux = super().step(fn, y, args, options, state, tags)
        half_squares = state.f_info.as_min()
        gain, last = _gain(state.y_eval - y, state.f_info), state.search_state.gain
        no_shorter = (abs(last) <= _UNTOLD * half_squares) & (abs(gain) >= abs(last))
        there = (abs(gain) <= _OFFSET**2 * half_squares) | no_shorter
        there = state.terminate | (there & (state.num_steps_since_acceptance == 0))
        return y, eqx.tree_at(lambda state: state.terminate, state, there), aux


def _silent(**_: Any) -> None:
    return None
