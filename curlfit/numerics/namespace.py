"""Formulas written once, for NumPy and for JAX."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def namespace(array: Any) -> ModuleType:
    """The module whose functions apply to an array: `jax.numpy`, or `numpy`
    for all else."""
    return jnp if isinstance(array, jax.Array) else np
