"""What rows determine: rank, null directions, covariance and combinations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from curlfit.inference.information.combinations import (
    Combination,
    combinations_of,
    named,
    tidy_basis,
)
from curlfit.inference.information.directions import inverted, r_factor, visible
from curlfit.inference.information.information import Information
from curlfit.inference.information.thresholds import (
    LITTLE_PART,
    LOOSE,
    NO_PART,
    WEAK_ERROR,
)
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats


@dataclass(frozen=True)
class Identifiability:
    """Directions in parameter space, by how well the data determine them.

    Attributes
    ----------
    names : the parameters of the Information of which this was made, in its order: at
        an optimum those that can move, neither fixed nor held at a bound.
    typical : sizes of these.
    rank : number of directions that the data determine.
    singular_values : of the scaled Jacobian, those of the `rank` determined directions
        first, then the others, each largest first.
    null_directions : steps of the parameters along which the residuals stay the same,
        by name, the largest step being 1.
    covariance : of the parameters, along the determined directions only, with the
        spread of parameters at a bound.
    unseen : for each parameter, whether it takes part in a null direction.
    combinations : what is determined in place of parameters that are not, or
        only weakly.
    """

    names: tuple[str, ...]
    typical: Floats
    rank: int
    singular_values: Floats
    null_directions: tuple[dict[str, float], ...]
    covariance: Floats
    unseen: Booleans
    combinations: tuple[Combination, ...]

    @classmethod
    def of(cls, information: Information, spread: Floats | None = None) -> Self:
        """Split the space of the parameters, all of which can move, into what the data
        determine and what they do not. A loosely determined direction along which the
        bounds leave less room than a tenth of a standard error is not determined: only
        the bounds limit it.

        Parameters
        ----------
        spread : contribution of other parameters, at their bounds, to the spread of
            these: columns whose outer products add to the covariance, in typical sizes,
            shape (parameters, others).
        """
        names = information.names
        typical = information.typical
        scaled = information.scaled
        count = len(names)
        # so that the decomposition has all directions, null ones too, and is small
        if len(scaled) > 2 * count:
            scaled = r_factor(scaled)
        elif len(scaled) < count:
            scaled = np.pad(scaled, ((0, count - len(scaled)), (0, 0)))
        _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
        seen = visible(singular)
        seen &= ~information.bounded.alone_limit(axes, singular, typical)
        order = np.argsort(~seen, kind="stable")  # the others last
        seen = seen[order]
        singular = singular[order]
        axes = axes[order]
        # an axis times its error, as a column; 0 of an axis that is not seen
        errors = axes.T * inverted(singular, seen)
        scaled_covariance = errors @ errors.T
        if spread is not None:
            scaled_covariance = scaled_covariance + spread @ spread.T
        covariance = typical[:, None] * scaled_covariance * typical
        loose = seen & (singular < LOOSE)
        unseen = _shares(axes[~seen]) > NO_PART
        weak = unseen | (_shares(axes[loose]) > LITTLE_PART)
        # a change of the parameters along a direction, in their units
        changes = (axes[~seen] * typical)[:, unseen]
        null_directions = tidy_basis(changes, 1 / typical[unseen])
        return cls(
            names=names,
            typical=typical,
            rank=int(seen.sum()),
            singular_values=singular,
            null_directions=tuple(named(row, names, unseen) for row in null_directions),
            covariance=covariance,
            unseen=unseen,
            combinations=combinations_of(
                axes[~seen],
                errors[:, loose].T,
                weak,
                names,
                information.values,
                typical,
                covariance,
            ),
        )

    def weights_of_determined(self) -> dict[str, Floats]:
        """Weights of the parameters in what is determined: themselves and
        the combinations."""
        unit = np.eye(len(self.names))
        weights = {
            name: unit[row]
            for row, name in enumerate(self.names)
            if not self.unseen[row]
        }
        for combination in self.combinations:
            row = [combination.weights.get(name, 0.0) for name in self.names]
            weights[combination.expression] = np.array(row)
        return weights

    def classified(self, place: int) -> tuple[float | None, Verdict]:
        """Standard error, where there is one, and verdict of a parameter, by its place.

        The 95 % interval of a weakly determined parameter reaches its typical size to
        either side.
        """
        if self.unseen[place]:
            return None, Verdict.NOT_IDENTIFIABLE
        stderr = float(np.sqrt(self.covariance[place, place]))
        determined = stderr < WEAK_ERROR * self.typical[place]
        return stderr, Verdict.DETERMINED if determined else Verdict.WEAK


def _shares(axes: Floats) -> Floats:
    """How much each parameter takes part in some directions, orthonormal rows in
    typical sizes: 0 to 1."""
    return np.sqrt((axes**2).sum(0))
