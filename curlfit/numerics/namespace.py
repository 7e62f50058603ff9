"""Formulas written once, for NumPy and for JAX."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


def namespace(array: Any) -> ModuleType:
    """The module whose functions apply to an array: `jax.numpy`, or `numpy`
    for all else."""
    jax = sys.modules.get("jax")  # loaded where there is an array of it
    if jax is not None and isinstance(array, jax.Array):
        numpy_of_jax: ModuleType = jax.numpy
        return numpy_of_jax
    import numpy  # which `--help` does without

    return numpy
