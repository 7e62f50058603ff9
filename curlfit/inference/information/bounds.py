"""Bounds: which directions only they limit, and the spread of a parameter at one."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.information.directions import inverted, visible
from curlfit.inference.information.thresholds import LOOSE
from curlfit.numerics.arrays import Booleans, Floats

# standard errors within the bounds, below which these determine a direction
_ROOM = 0.1
_ROUNDING = 1e-9  # component of a direction that is rounding error
_WIDEST = 1e3  # typical sizes, beyond which nothing is known
_FAR = 30.0  # standard deviations above its mean, where a cut normal is an exponential


class Bounded(NamedTuple):
    """Values of parameters and their bounds, of one vector or of many."""

    values: Floats
    lower: Floats
    upper: Floats

    @classmethod
    def none(cls, values: Floats) -> Self:
        """Values without bounds."""
        infinite = np.full(np.shape(values), np.inf)
        return cls(values, -infinite, infinite)

    @property
    def free(self) -> Booleans:
        """Which parameters are not fixed: those that are have equal bounds."""
        is_free: Booleans = self.upper > self.lower
        return is_free

    def alone_limit(
        self, directions: Floats, singular: Floats, typical: Floats
    ) -> Booleans:
        """Which loosely determined directions only the bounds limit: those with less
        room within the bounds than a tenth of their standard error, 1/`singular`.

        Parameters
        ----------
        directions, singular : in scaled parameters, shape (..., directions, parameters)
            and (..., directions).
        """
        step = directions * typical / np.maximum(singular, 1e-300)[..., None]
        moved = self.free[..., None, :] & (np.abs(directions) > _ROUNDING)
        below = np.where(moved, (self.values - self.lower)[..., None, :], np.inf)
        above = np.where(moved, (self.upper - self.values)[..., None, :], np.inf)
        size = np.maximum(np.abs(step), 1e-300)
        forward = np.where(step > 0, above, below) / size
        backward = np.where(step > 0, below, above) / size
        is_narrow: Booleans = forward.min(-1) + backward.min(-1) < _ROOM
        return is_narrow & (singular < LOOSE)


def spread_at_bounds(
    rows: Floats, rows_at_bound: Floats, push: Floats, room: Floats
) -> tuple[Floats, Floats]:
    """Spread of parameters at a bound, each a normal truncated there; the open
    ones follow, along directions that the data determine: along others a small change
    at the bound would move them far beyond their own bounds.

    An optimum at a bound leaves the parameter a one-sided spread: wide where the
    data hardly push against the bound, as at the end of a ridge, and of scale 1/push
    where they do. Holding it at the bound would make the others appear more precise
    than they are.

    Parameters
    ----------
    rows, rows_at_bound : R of the open parameters and R of those at a bound, in typical
        sizes, shape (n, open) and (n, bounded).
    push : decrease of half of chi squared per typical size beyond the bound, >= 0, for
        each at a bound.
    room : widths of the intervals of bounds of those at a bound, typical sizes.

    Returns
    -------
    the rms distance of each from the bound, shape (bounded,), and how far the open
    parameters follow it, shape (open, bounded), in typical sizes: columns whose outer
    products are the covariance that this adds.
    """
    from scipy.special import log_ndtr  # slow to load

    left, singular, right = np.linalg.svd(rows, full_matrices=False)
    inverse = inverted(singular, visible(singular))[:, None] * left.T
    follow = -(right.T @ (inverse @ rows_at_bound))
    stiffness = np.linalg.norm(rows_at_bound + rows @ follow, axis=0)
    sigma = 1 / np.maximum(stiffness, 1 / _WIDEST)
    alpha = push * sigma
    # mean square distance from the cut of a normal truncated alpha sigma above its mean
    near = np.minimum(alpha, _FAR)
    hazard = np.exp(-(near**2 + np.log(2 * np.pi)) / 2 - log_ndtr(-near))
    square = np.where(
        alpha < _FAR, 1 + alpha**2 - alpha * hazard, 2 / np.maximum(alpha, 1) ** 2
    )
    distance = np.minimum(sigma * np.sqrt(square), room)
    return distance, follow * distance
