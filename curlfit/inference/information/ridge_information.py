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

from typing import NamedTuple

import numpy as np

from curlfit.inference.information.directions import directions_of_squares, visible
from curlfit.inference.information.thresholds import LITTLE
from curlfit.numerics.arrays import Booleans, Floats


class RidgeInformation(NamedTuple):
    """Rows whose squares are information about parameters, shape (directions,
    parameters)."""

    kept: Floats
    """the part of a quadratic with which the ridge agrees: its errors are those of
    noise, so that they are independent between throws"""
    stretched: Floats
    """the rest, with errors that reach as far as the ridge: the estimate is a point of
    it by chance, and its distance from the truth may be the same in all throws"""

    def of(self, wanted: Booleans, step: Floats) -> tuple[Floats, Floats]:
        """Both parts of the information about some parameters, whatever the others are,
        with what each row gives at the optimum of the quadratic as the last column.

        Parameters
        ----------
        wanted : which parameters these are.
        step : of all parameters to the optimum of the quadratic.
        """
        kept = _reduced(np.column_stack([self.kept, self.kept @ step]), wanted)
        both = np.vstack([self.kept, self.stretched])
        together = _reduced(np.column_stack([both, both @ step]), wanted)
        # What the other parameters may be is told by both parts together.
        information = together[:, :-1].T @ together[:, :-1]
        stretched_information = information - kept[:, :-1].T @ kept[:, :-1]
        squares, axes = np.linalg.eigh(stretched_information)
        seen = visible(np.sqrt(np.maximum(squares[::-1], 0.0)))[::-1]
        stretched = np.sqrt(squares[seen, None]) * axes[:, seen].T
        return kept, np.column_stack([stretched, stretched @ step[wanted]])


def information_along(
    information: Floats, moves: Floats, rises: Floats
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
    information : matrix J^T J of the parameters at the optimum, in typical sizes.
    moves : of the parameters from the optimum to points of the ridge, in typical sizes,
        shape (points, parameters).
    rises : of chi squared from the optimum to these points.
    """
    axes, singular, _ = directions_of_squares(information, np.ones(len(information)))
    rows = singular[:, None] * axes
    # A point within one standard error is where any estimate may be by its noise.
    points = demanded_errors(moves @ rows.T, rises[:, None])
    taken = np.zeros((len(rows), 0))
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
    kept = rows - taken @ (taken.T @ rows)
    return RidgeInformation(kept, shortened @ (taken.T @ rows))


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


def _reduced(rows: Floats, wanted: Booleans) -> Floats:
    """Rows on some parameters alone, whatever the others are, of which at most as many
    are left; the last column is what they give."""
    columns = np.append(wanted, True)
    basis, singular, _ = np.linalg.svd(rows[:, ~columns], full_matrices=False)
    by_others = basis[:, visible(singular)]
    beyond = rows[:, columns] - by_others @ (by_others.T @ rows[:, columns])
    basis, singular, axes = np.linalg.svd(beyond[:, :-1], full_matrices=False)
    seen = visible(singular)
    steps = basis[:, seen].T @ beyond[:, -1]
    return np.column_stack([singular[seen, None] * axes[seen], steps])
