"""Accelerations of a stone under a law along its path, for several coefficient vectors."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations
from curlfit.friction import Law, Load
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH, in_batches
from curlfit.numerics.compiled import compiled
from curlfit.stone import Stone

POINTS = 128
"""Number of points along a path."""
_STEP = 1e-4  # of finite differences, over the typical size


def vectors_of(model: Model) -> int:
    """Number of coefficient vectors that a program takes: one, and one more per coefficient."""
    return 1 + len(model.of_program.law.coefficients())


def accelerations_along(
    model: Model, coefficients: Floats, stones: Stone, paths: Floats, batch: int = BATCH
) -> Floats:
    """Accelerations (xi, eta, angular) along the paths of many throws.

    Parameters
    ----------
    coefficients : shape (throws, `vectors_of` the model, POINTS, coefficients).
    stones : each field of shape (throws,).
    paths : speed, spin, angle and time, shape (throws, 4, POINTS).
    batch : number of throws computed together.

    Returns
    -------
    Shape (throws, vectors, 3, POINTS).
    """
    program = partial(_accelerations, model.of_program.law, model.load)
    found: Any = in_batches(program, (model.vector(coefficients), stones, paths), batch)
    return np.asarray(found)


def accelerations_and_slopes(
    model: Model, coefficients: Floats, typical: Floats, stones: Stone, paths: Floats, batch: int
) -> tuple[Floats, Floats]:
    """Accelerations for one coefficient vector per throw, and their derivatives by it.

    By finite differences, which are exact to rounding where the accelerations are linear.

    Parameters
    ----------
    coefficients : shape (throws, coefficients). typical : their order of magnitude.

    Returns
    -------
    Shapes (throws, 3, POINTS) and (throws, 3, POINTS, coefficients).
    """
    k = coefficients.shape[-1]
    vectors = np.repeat(coefficients[:, None], vectors_of(model), 1)
    step = _STEP * typical
    vectors[:, 1 : k + 1] += np.diag(step)
    everywhere = np.broadcast_to(vectors[:, :, None], (*vectors.shape[:2], POINTS, k))
    found = accelerations_along(model, everywhere, stones, paths, batch)
    first = found[:, 0]
    return first, np.moveaxis(found[:, 1 : k + 1] - first[:, None], 1, -1) / step


@compiled("law", "load")
def _accelerations(
    law: type[Law], load: Load, coefficients: Array, stones: Stone, paths: Array
) -> Array:
    def along(coefficients: Array, stone: Stone, path: Array) -> Array:
        return jnp.stack(accelerations(law.from_vector(coefficients.T), stone, load, *path))

    of_throw = jax.vmap(along, (0, None, None))
    return jax.vmap(of_throw)(coefficients, stones, paths)
