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
from curlfit.numerics.differences import slopes
from curlfit.stone import Stone

POINTS = 128
"""Number of points along a path."""
_STEP = 1e-4  # of differences, over the typical size


def accelerations_along(
    model: Model, coefficients: Floats, stones: Stone, paths: Floats, batch: int = BATCH
) -> Floats:
    """Accelerations (xi, eta, angular) along the paths of many throws, shape (throws, 3, POINTS).

    Parameters
    ----------
    coefficients : shape (throws, POINTS, coefficients).
    stones : each field of shape (throws,).
    paths : speed, spin, angle and time, shape (throws, 4, POINTS).
    batch : number of throws computed together.
    """
    program = partial(_accelerations, model.of_program.law, model.load)
    found: Any = in_batches(program, (model.vector(coefficients), stones, paths), batch)
    return np.asarray(found)


def accelerations_and_slopes(
    model: Model, coefficients: Floats, typical: Floats, stones: Stone, paths: Floats, batch: int
) -> tuple[Floats, Floats]:
    """Accelerations for one coefficient vector per throw, and their derivatives by it; these are
    exact to rounding where the accelerations are linear.

    Parameters
    ----------
    coefficients : shape (throws, coefficients). typical : their order of magnitude.

    Returns
    -------
    Shapes (throws, 3, POINTS) and (throws, 3, POINTS, coefficients).
    """

    def at(change: Floats) -> Floats:
        everywhere = np.repeat((coefficients + change)[:, None], POINTS, 1)
        return accelerations_along(model, everywhere, stones, paths, batch)

    none = np.zeros(len(typical))
    first = at(none)
    return first, slopes(at, none, _STEP * typical, value=first)


@compiled("law", "load")
def _accelerations(
    law: type[Law], load: Load, coefficients: Array, stones: Stone, paths: Array
) -> Array:
    def along(coefficients: Array, stone: Stone, path: Array) -> Array:
        return jnp.stack(accelerations(law.from_vector(coefficients.T), stone, load, *path))

    return jax.vmap(along)(coefficients, stones, paths)
