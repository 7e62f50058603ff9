"""What a law is capable of: friction aside from sliding, and to which sides it curls a stone."""

from __future__ import annotations

from itertools import product
from typing import Any

from curlfit.dynamics.contact import accelerations
from curlfit.dynamics.quadrature import panels

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.friction import Law, LocalLaw
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled, in_batches
from curlfit.stone import Stone

_MOST = 500
"""Coefficient vectors that a law is tried with."""


def opposes_sliding(law: type[Law]) -> bool:
    """Whether friction is opposite to sliding round the ring, whatever the coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    # With coefficients that are all different, which excludes special cases of the law.
    general = law.from_vector(
        [item.default + 0.1 * (j + 1) * item.typical for j, item in enumerate(law.coefficients())]
    )
    zero, one = jnp.zeros(()), jnp.ones(())
    for points, _ in panels(general, one, 0.1 * one, one, zero):
        xi, eta = general.traction(points)
        if not np.allclose(xi * points.e_eta, eta * points.e_xi, rtol=0, atol=1e-9):
            return False
    return True


def sides_of_curl(law: type[Law], load: str, result: FitResult) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows, within bounds."""
    items = result.coefficients.values()
    steps = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])
    ranges = [
        np.unique(np.clip(steps * item.typical, item.lower, item.upper))
        if item.verdict != "fixed"
        else np.array([item.value])
        for item in items
    ]
    grid = np.array(list(product(*ranges)))
    if len(grid) > _MOST:
        grid = grid[np.random.default_rng(0).choice(len(grid), _MOST, replace=False)]
    v = float(np.median(result.fitted["speed"]))
    omega = float(np.median(np.abs(result.fitted["omega"])))
    xi, eta, _ = _over_coefficients(law, load, grid, result.stone, v, omega)
    sideways = np.where(eta < 0, xi / np.where(eta < 0, -eta, 1.0), 0.0)
    found = [("left", (sideways < -1e-9).any()), ("right", (sideways > 1e-9).any())]
    return tuple(side for side, possible in found if possible)


def _over_coefficients(
    law: type[Law], load: str, grid: Floats, stone: Stone, v: float, omega: float
) -> tuple[Floats, ...]:
    def program(rows: Floats) -> Any:
        return _accelerations(law, load, rows, stone, v, omega)

    found: tuple[Floats, ...] = in_batches(program, (grid,), _MOST)
    return found


@compiled("law", "load")
def _accelerations(
    law: type[Law], load: Any, grid: Array, stone: Stone, v: Array, omega: Array
) -> tuple[Array, ...]:
    def one(coefficients: Array) -> tuple[Array, ...]:
        # half a radian after release, where a law that depends on the angle still does
        return accelerations(law.from_vector(coefficients), stone, load, v, omega, 0.5)

    return jax.vmap(one)(grid)
