"""The Levenberg-Marquardt method with bounds as a solver of optimistix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

from curlfit.numerics.levenberg_marquardt import (
    Bounds,
    Control,
    Search,
    advance,
    begin,
    quadratic_model,
)


class SolverState(eqx.Module):
    """A search, and the residual and Jacobian at its best values."""

    search: Search
    residual: Array
    """shape (n,)"""
    jacobian: Array
    """shape (n, parameters)"""


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """The method as a solver of optimistix, for residuals in a single array."""

    bounds: Bounds
    control: Control
    penalty: Any
    """adds a term to chi squared, by `added_to(model, values, typical)`; None for no term"""
    rtol: float
    atol: float
    norm: Callable[..., Any]

    def __init__(self, bounds: Bounds, control: Control, penalty: Any = None) -> None:
        self.bounds, self.control, self.penalty = bounds, control, penalty
        self.rtol = self.atol = control.remaining  # required by optimistix
        self.norm = optx.max_norm

    def init(
        self, fn: Any, y: Array, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any
    ) -> SolverState:
        """Required by optimistix."""
        size = f_struct.size
        unknown = jnp.full((size, 1 + y.size), jnp.nan)
        return SolverState(begin(y, self.bounds, self.control), unknown[:, 0], unknown[:, 1:])

    def step(
        self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any
    ) -> tuple[Array, SolverState, Any]:
        """Required by optimistix."""

        def residual_of(values: Array) -> tuple[Array, Any]:
            residual, aux = fn(values, args)
            return residual.reshape(-1), (residual.reshape(-1), aux)

        jacobian, (residual, aux) = jax.jacfwd(residual_of, has_aux=True)(state.search.trial)
        model = quadratic_model(residual, jacobian, self.bounds.typical)
        if self.penalty is not None:
            model = self.penalty.added_to(model, state.search.trial, self.bounds.typical)
        search, outcome = advance(state.search, model, self.bounds, self.control)
        residual = jnp.where(outcome.accepted, residual, state.residual)
        jacobian = jnp.where(outcome.accepted, jacobian, state.jacobian)
        residual = residual + jacobian @ outcome.extrapolation
        return search.values, SolverState(search, residual, jacobian), aux

    def terminate(
        self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any
    ) -> tuple[Array, Any]:
        """Required by optimistix."""
        failed = state.search.done & ~state.search.success
        result = optx.RESULTS.where(
            failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return state.search.done, result

    def postprocess(
        self, fn: Any, y: Array, aux: Any, args: Any, options: Any, state: SolverState, tags: Any,
        result: Any,
    ) -> tuple[Array, Any, dict[str, Any]]:  # fmt: skip
        """Required by optimistix."""
        return y, aux, {}
