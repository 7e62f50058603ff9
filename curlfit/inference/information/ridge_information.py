"""What of the information about an optimum its ridge leaves.

Another fit may take a throw as a quadratic about its own optimum. Where chi squared is
no quadratic, that quadratic says what the throw does not: without the angle the path
tells of a coefficient b and the spin omega0 hardly more than their product. To first
order that is the sum omega0' b + b' omega0 about the optimum (b', omega0'), known as
well as the product is, and if the path tells the spin a little besides, then b too. At
other points of the hyperbola b omega0 = b' omega0', which fit as well, this sum is
hundreds of its standard errors away.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.information.directions import visible
from curlfit.inference.information.information import Information
from curlfit.inference.information.thresholds import LITTLE
from curlfit.numerics.arrays import Booleans, Floats


class RidgeInformation(NamedTuple):
    """What a throw says about its parameters, in two parts that together have the
    optimum of its quadratic."""

    kept: Information
    """the part of the quadratic with which the ridge agrees: its errors are those of
    noise, so that they are independent between throws"""
    stretched: Information
    """the rest, with errors that reach as far as the ridge: the estimate is a point of
    it by chance, and its distance from the truth may be the same in all throws"""

    def marginal(self, which: Booleans) -> Self:
        """Both parts about some parameters, whatever the others are: what the others
        may be is told by both parts together, and what is told beyond the first part
        is the second."""
        kept = self.kept.marginal(which).information
        together = (self.kept + self.stretched).marginal(which).information
        beyond = together.scaled.T @ together.scaled - kept.scaled.T @ kept.scaled
        squares, axes = np.linalg.eigh(beyond)
        seen = visible(np.sqrt(np.maximum(squares[::-1], 0.0)))[::-1]
        scaled = np.sqrt(squares[seen, None]) * axes[:, seen].T
        return type(self)(
            kept.along_axes(), _rows_about(together, scaled, together.step_to_optimum())
        )


def information_along(
    information: Information, moves: Floats, rises: Floats
) -> RidgeInformation:
    """The information about an optimum, parted by what a ridge says of it.

    In coordinates in which the quadratic is the squared distance from the optimum, a
    point of the ridge is as far away as the root of the rise of chi squared there, or
    nearer. Where a point is farther away, the quadratic says too much in its direction:
    the direction of the farthest such point is taken out, and all points are looked at
    in what remains, until none is too far. Along what was taken out, distances are
    shortened until no point is too far.
    What is null already stays so: points that moved along it alone are no farther away.

    Parameters
    ----------
    information : about the values from which the ridge was followed.
    moves : of the parameters from there to points of the ridge, in typical sizes,
        shape (points, parameters).
    rises : of chi squared from there to these points.
    """
    scaled = information.along_axes().scaled
    # A point within one standard error is where any estimate may be by its noise.
    points = demanded_errors(moves @ scaled.T, rises[:, None])
    taken = np.zeros((len(scaled), 0))
    remaining = points
    while (direction := _farthest(remaining)) is not None:
        unit = direction[:, None] / np.linalg.norm(direction)
        remaining = remaining - (remaining @ unit) @ unit.T
        taken = np.column_stack([taken, unit])
    along = points @ taken
    shortened = np.eye(taken.shape[1])
    while (direction := _farthest(along @ shortened.T)) is not None:
        length = np.linalg.norm(direction)
        unit = direction / length
        # so that this point is where the rise of chi squared says
        shortened -= (1 - 1 / length) * np.outer(unit, unit @ shortened)
    step = information.step_to_optimum()
    kept = scaled - taken @ (taken.T @ scaled)
    stretched = shortened @ (taken.T @ scaled)
    return RidgeInformation(
        _rows_about(information, kept, step), _rows_about(information, stretched, step)
    )


def _rows_about(information: Information, scaled: Floats, step: Floats) -> Information:
    """Other rows about the same values, in typical sizes, whose optimum is a step
    away."""
    residual = -scaled @ (step / information.typical)
    return replace(information, rows=np.column_stack([scaled, residual]))


def demanded_errors(moved: Floats, rises: Floats) -> Floats:
    """Standard errors that the points of a ridge demand of a quantity: to first order,
    its value is within sqrt(rise) of them of the estimate.

    Parameters
    ----------
    moved : distances of its values there from the estimate. rises : of chi squared.
    """
    demanded: Floats = moved / np.sqrt(np.maximum(rises, 1.0))
    return demanded


def _farthest(points: Floats) -> Floats | None:
    """The point farthest from zero; None if none is too far."""
    if not points.size:
        return None
    lengths = np.linalg.norm(points, axis=1)
    farthest = int(np.argmax(lengths))
    return points[farthest] if lengths[farthest] > LITTLE else None
