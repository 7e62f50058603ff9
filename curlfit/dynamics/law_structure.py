"""Powers as compiled programs find them, in a processor's vectors.

XLA takes the library's `pow` for one number after the other, three times as long. Here the
logarithm is of the number's exponent and of its fraction, by the series of the area tangent.
"""

from __future__ import annotations

from typing import Any

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from curlfit.friction import power

_ROOT_HALF = np.float64(0.5**0.5).view(np.int64)  # fractions run from here to the root of 2
_EXPONENT = 52  # bits to the right of it
_TERMS = 11  # to the last digit, for fractions within the root of 2


@jax.custom_jvp
def log(number: Array) -> Array:
    """Natural logarithm of 0 < `number` < inf, else NaN."""
    bits = jax.lax.bitcast_convert_type(number, jnp.int64)
    exponent = (bits - _ROOT_HALF) >> _EXPONENT
    fraction = jax.lax.bitcast_convert_type(bits - (exponent << _EXPONENT), float)
    z = (fraction - 1) / (fraction + 1)
    square, series = z * z, jnp.zeros_like(z)
    for n in reversed(range(_TERMS)):
        series = series * square + 2 / (2 * n + 1)
    inside = (number > 0) & (number < jnp.inf)
    return jnp.where(inside, exponent * np.log(2) + z * series, jnp.nan)


@log.defjvp
def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Array, Array]:
    (number,), (change,) = primals, tangents
    return log(number), change / number


@power.register(jax.core.Tracer)
def _(base: Any, exponent: Any) -> Any:
    return jnp.exp(exponent * log(jnp.asarray(base, float)))
