"""The spin of the row in whose interval the stone comes to rest.

Under a law of the whole stone the spin may end at rest with a jump. A measured spin,
compared with the spin at the time of its row, would make chi squared jump too where the
modelled rest passes this time, by hundreds, and a search would end at the cliff. Yet
rows tell the time of rest to no better than the interval between them. The row in whose
interval the stone comes to rest therefore has the mean spin of the interval: the change
of the angle over its length, which is continuous.

        spin                     |<- interval ->|
    ~~~~~~~~~~~~~~~~~~~~~.       |
                         |       |      row
    ---------------------+-------+-------o------+-----> time
                        rest     begin         end

While the rest moves through the interval, from its end to its beginning, the row's spin
falls from that of a moving stone to zero. The mean takes the place of the spin in the
last quarter of the interval, smoothly, so that all other rows have their spin exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from curlfit.dynamics.trajectory import Trajectory

_CHANGING = 0.25  # of the interval, at its end, in which the mean replaces the spin


class RowIntervals(NamedTuple):
    """Rows with the interval about each, as times in s since the start, shape (n,)."""

    middle: Array
    begin: Array
    end: Array

    @classmethod
    def about(cls, rows: Array, length: Array) -> RowIntervals:
        """Intervals of a length in s; where it is 0, as no spin was measured, they
        begin and end at inf: such times cost nothing."""
        half = jnp.where(length > 0, length / 2, jnp.inf)
        return cls(rows, jnp.maximum(rows - half, 0.0), rows + half)

    @property
    def times(self) -> Array:
        """Rows, beginnings and ends, shape (3 n,)."""
        return jnp.concatenate(self)

    def spin(self, path: Trajectory) -> Array:
        """Spin of the rows in rad/s; of `path`, which is that at `times`."""
        spin = path.omega[: len(self.middle)]
        _, before, after = path.phi.reshape(3, -1)
        ended = path.rest < self.end
        known = ended & jnp.isfinite(self.end)
        length = jnp.where(known, self.end - self.begin, 1.0)
        since = jnp.where(known, self.end - path.rest, 0.0)
        part = jnp.minimum(since / (_CHANGING * length), 1.0)
        share = part**2 * (3 - 2 * part)
        mean = (after - before) / length
        return jnp.where(known, spin + share * (mean - spin), spin)
