"""The Kalman filter of noise that is partly correlated from row to row.

The innovations of the filter are independent (Schweppe 1965, IEEE Trans. Inf. Theory
11, 61): an exact whitening in a time proportional to the number of rows, however
they are spaced.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
from jax import Array

from curlfit.numerics.compiled import compiled

_SHORTEST = 1e-9  # s, in place of a correlation time of 0


class KalmanFilter(NamedTuple):
    """Predicts each row of a channel from those before it; arrays of shape
    (channels, n).

    The prediction of a row is `decay` times that of the row before, plus `gain` times
    what that left unpredicted, its innovation.
    """

    decay: Any
    gain: Any
    scale: Any
    """1 over the standard deviation of an innovation; 0 where nothing was observed"""

    @classmethod
    def of(cls, memory: Any, white: Any, gaps: Any, seen: Any) -> Self:
        """The filter of an Ornstein-Uhlenbeck process plus independent noise, together
        of variance 1.

        Parameters
        ----------
        memory, white : correlation time in s and independent share of the
            variance, by channel.
        gaps : time to the next row, s, shape (n,).
        seen : which values were observed, shape (channels, n).
        """
        rate = gaps / jnp.maximum(memory, _SHORTEST)[:, None]

        def advance(
            variance: Array, row: tuple[Array, Array]
        ) -> tuple[Array, tuple[Array, Array]]:
            """The variance of the process before the next row, from that before this
            one (in all the variance is 1), with gain and scale of this row."""
            rate, seen = row
            total = variance + white
            gain = jnp.where(seen, variance / total, 0.0)
            renewed = -jnp.expm1(-2 * rate)  # share of the variance, in the gap
            left = (1 - renewed) * (1 - gain) * variance
            scale = jnp.where(seen, 1 / jnp.sqrt(total), 0.0)
            return left + renewed * (1 - white), (gain, scale)

        _, (gain, scale) = jax.lax.scan(advance, 1 - white, (rate.T, seen.T))
        decay = jnp.exp(-rate)
        return cls(decay, decay * gain.T, scale.T)

    def innovations(self, columns: Any) -> Array:
        """What the rows before do not predict, over its standard deviation, of columns
        of values, shape (channels, n, columns)."""
        innovations: Array = _innovations(self, columns)
        return innovations

    def log_determinant(self) -> Array:
        """Logarithm of the determinant of the whitening, by channel."""
        return jnp.log(jnp.where(self.scale > 0, self.scale, 1.0)).sum(-1)


@compiled()
def _innovations(kalman: KalmanFilter, columns: Array) -> Array:
    by_row = [jnp.swapaxes(part, 0, 1)[..., None] for part in kalman]
    columns = jnp.swapaxes(columns, 0, 1)
    first = jnp.zeros_like(columns[0])
    _, innovations = jax.lax.scan(_innovation, first, (*by_row, columns))
    return jnp.swapaxes(innovations, 0, 1)


def _innovation(prediction: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
    """The prediction of the next row, and the innovation of this one."""
    decay, gain, scale, value = row
    innovation = value - prediction
    return decay * prediction + gain * innovation, scale * innovation
