"""The spin of a row that was measured close to rest.

Under a law of the whole stone the spin may end at rest with a jump. A measured spin,
compared with the spin at the time of its row, would make chi squared jump too where the
modelled rest passes this time, by hundreds, and a search would end at the cliff. Yet
rows tell the time of rest to no better than the interval between them. A row whose
interval contains the modelled rest may therefore have any spin in a range, of which the
one nearest to the measured spin is taken:

    spin
      |           ___________
      |        .-/       .-/   upper end of the range
      |       /         /
      |      /         /       between the two: no residual
      |     /         /
      |____/_________/         lower end of the range
         begin  row  end       -> modelled rest

With the rest near the time of the row the range is from 0 to the spin at the beginning
of the interval. It narrows to zero as the rest moves to the beginning of the interval,
and to the spin at the time of the row as it moves to the end, so that the residual is
continuous with its slope, and all other rows have their spin exactly. Of spins sampled
at the times of the rows, the last of which that is not zero is that of a moving stone,
the ranges admit every time of rest between this row and the next.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.trajectory import Trajectory
from curlfit.throws.throw import Throw

# Part of each half of an interval, at its outer end, in which the range narrows. Were
# it all of it, the edge of a range would hold a rest that is near the time of a row,
# with a third of the error of p of `semi-empirical` (5 of 32 simulated throws).
_CHANGING = 0.5


class MeasuredSpins(NamedTuple):
    """Measured spins of a throw."""

    interval: Any
    """median time between their rows, s; 0 with fewer than two"""
    values: Any
    """in rad/s, 0 where none was measured, shape (n,)"""

    @classmethod
    def of(cls, throw: Throw, rows: int) -> MeasuredSpins:
        """Those of a throw, padded to a number of rows."""
        measured = np.isfinite(throw.omega)
        times = throw.t[measured]
        interval = np.median(np.diff(times)) if len(times) > 1 else 0.0
        values = np.zeros(rows)
        values[: len(throw)] = np.where(measured, throw.omega, 0.0)
        return cls(np.asarray(interval), values)


class RowIntervals(NamedTuple):
    """Rows with the interval about each, as times in s since the start, shape (n,)."""

    middle: Array
    begin: Array
    half: Array
    """length of the half of an interval, s; inf where no spin was measured"""

    @classmethod
    def about(cls, rows: Array, length: Array) -> RowIntervals:
        """Intervals of a length in s; where it is 0 they begin at inf, since such times
        cost nothing."""
        half = jnp.where(length > 0, length / 2, jnp.inf)
        begin = jnp.where(length > 0, jnp.maximum(rows - half, 0.0), jnp.inf)
        return cls(rows, begin, half)

    @property
    def times(self) -> Array:
        """Rows, beginnings of intervals, and the end of the last, shape (2 n + 1,)."""
        ends = self.middle + self.half
        last = jnp.where(jnp.isfinite(ends), ends, 0.0).max(keepdims=True)
        return jnp.concatenate([self.middle, self.begin, last])

    def spins(self, path: Trajectory, measured: Array) -> Array:
        """Spins of the rows in rad/s, from the path at `times` and measured spins."""
        now, before, _ = jnp.split(path.omega, [len(self.middle), 2 * len(self.middle)])
        after_row = path.rest - self.middle
        near = (jnp.abs(after_row) < self.half) & jnp.isfinite(self.begin)
        half = jnp.where(near, self.half, 1.0)
        distance = jnp.where(near, jnp.abs(after_row), 0.0) / half
        part = jnp.minimum((1 - distance) / _CHANGING, 1.0)
        # Level at both ends, so that chi squared has a slope everywhere; so much so at
        # the outer one that the range, which is far wider than the noise, takes a
        # while to exceed it. Otherwise the rest seems known to a millisecond there.
        share = part**4 * (5 - 4 * part)
        one_end = (1 - share) * now
        other_end = one_end + share * before
        lower = jnp.minimum(one_end, other_end)
        upper = jnp.maximum(one_end, other_end)
        return jnp.where(near, jnp.clip(measured, lower, upper), now)
