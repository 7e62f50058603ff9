"""Bounds: which directions only they limit, and the spread of a parameter at one."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.information.directions import inverted, visible
from curlfit.numerics.arrays import Booleans, Floats

WEAK = 1.0
"""Singular value below which a direction is known to no better than typical sizes."""
# standard errors within the bounds, below which these determine a direction
_ROOM = 0.1
_NO_PART = 1e-9  # component of a direction that is rounding error
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

    def confine(self, right: Floats, singular: Floats, typical: Floats) -> Booleans:
        """Which weakly determined directions, rows of `right` in scaled parameters,
        have so little room within the bounds, compared with their standard error
        1/`singular`, that only the bounds limit them."""
        step = right * typical / np.maximum(singular, 1e-300)[..., None]
        moved = (self.upper > self.lower)[..., None, :] & (np.abs(right) > _NO_PART)
        below = np.where(moved, (self.values - self.lower)[..., None, :], np.inf)
        above = np.where(moved, (self.upper - self.values)[..., None, :], np.inf)
        size = np.maximum(np.abs(step), 1e-300)
        forward = np.where(step > 0, above, below) / size
        backward = np.where(step > 0, below, above) / size
        is_narrow: Booleans = forward.min(-1) + backward.min(-1) < _ROOM
        return is_narrow & (singular < WEAK)


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
    rows, rows_at_bound : columns of the open parameters and of those at a bound, in
        typical sizes.
    push : decrease of half of chi squared per typical size beyond the bound, >= 0, for
        each at a bound.
    room : widths of the intervals of bounds of those at a bound, typical sizes.

    Returns
    -------
    the rms distance of each from the bound, and the corresponding change of the open
    parameters, shape (open, bounded), in typical sizes.
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
