"""The Kalman filter of noise that is partly correlated from row to row.

The noise of a channel is an Ornstein-Uhlenbeck process plus independent noise. The
innovations of its filter are independent (Schweppe 1965, IEEE Trans. Inf. Theory
11, 61): an exact whitening in a time proportional to the number of rows, however
they are spaced.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.inference.noise.models import Noise
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.throws.throw import CHANNELS

SHORTEST = 1e-9
"""s, in place of a correlation time of 0."""


class KalmanFilter(NamedTuple):
    """Predicts each row of a channel from those before it; arrays of shape
    (channels, n)."""

    decay: Any
    """of the correlated part to the next row"""
    gain: Any
    scale: Any
    """1 over the standard deviation of an innovation; 0 where nothing was observed"""

    @classmethod
    def of(cls, memory: Any, white: Any, gaps: Any, seen: Any) -> Self:
        """The filter of noise of variance 1.

        Parameters
        ----------
        memory, white : correlation time in s and independent share of the
            variance, by channel.
        gaps : time to the next row, s, shape (n,).
        seen : which values were observed, shape (channels, n).
        """
        rate = gaps / jnp.maximum(memory, SHORTEST)[:, None]

        def advance(
            variance: Array, row: tuple[Array, Array]
        ) -> tuple[Array, tuple[Array, Array]]:
            rate, seen = row
            total = variance + white
            gain = jnp.where(seen, variance / total, 0.0)
            renewed = -jnp.expm1(-2 * rate)
            left = (1 - renewed) * (1 - gain) * variance
            scale = jnp.where(seen, 1 / jnp.sqrt(total), 0.0)
            return left + renewed * (1 - white), (gain, scale)

        _, (gain, scale) = jax.lax.scan(advance, 1 - white, (rate.T, seen.T))
        return cls(jnp.exp(-rate), gain.T, scale.T)

    @classmethod
    def of_noise(cls, noise: Noise, times: Floats, seen: Any) -> Self:
        """The filter of a noise model, at times in s; rows beyond the channels
        are independent."""
        names = [*CHANNELS, ""][: len(seen)]
        memory = np.array([noise.memory.get(name, 0.0) for name in names])
        white = np.array([noise.white_share(name) for name in names])
        return cls(
            *map(
                np.asarray,
                _filter(memory, white, np.diff(times, append=times[-1]), seen),
            )
        )

    def innovations(self, columns: Any) -> Array:
        """What the rows before do not predict, over its standard deviation, of each
        column; shape (channels, n, columns)."""
        found: Array = _innovations(self, columns)
        return found

    def log_determinant(self) -> Array:
        """Of the whitening, by channel."""
        return jnp.log(jnp.where(self.scale > 0, self.scale, 1.0)).sum(-1)


@compiled()
def _innovations(own: KalmanFilter, columns: Array) -> Array:
    rows = [jnp.swapaxes(part, 0, 1)[..., None] for part in own]
    columns = jnp.swapaxes(columns, 0, 1)
    _, found = jax.lax.scan(_innovation, jnp.zeros_like(columns[0]), (*rows, columns))
    return jnp.swapaxes(found, 0, 1)


def _innovation(mean: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
    decay, gain, scale, value = row
    off = value - mean
    return decay * (mean + gain * off), scale * off


_filter = compiled()(KalmanFilter.of)
