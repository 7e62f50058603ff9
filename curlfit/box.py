"""Levenberg and Marquardt's method within bounds, for optimistix.

optimistix has no bounds; `BoxDescent` adds them by projection (Kanzow, Yamashita and Fukushima
2004). Damping is in proportion to the columns of the Jacobian, which makes the steps independent
of units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from curlfit import backend  # noqa: F401  (before equinox)

# isort: split
import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array

_FIRST_DAMPING = 1e-4  # of Marquardt's damping, relative to the squared columns


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


class BoxLevenbergMarquardt(optx.AbstractGaussNewton):
    """Levenberg and Marquardt's method within bounds."""

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
        self.search = optx.ClassicalTrustRegion()
        self.verbose = _silent


def _silent(**_: Any) -> None:
    return None
