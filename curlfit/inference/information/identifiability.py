"""What rows determine: rank, null directions, covariance and combinations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from curlfit.inference.information.bounds import WEAK
from curlfit.inference.information.combinations import (
    LITTLE_PART,
    NO_PART,
    Combination,
    combinations_of,
    named,
    tidy_basis,
)
from curlfit.inference.information.directions import inverted, r_factor, visible
from curlfit.inference.information.information import Information
from curlfit.inference.information.thresholds import WEAK_ERROR
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats


@dataclass(frozen=True)
class Identifiability:
    """Directions in parameter space, by how well the data determine them.

    Attributes
    ----------
    names : the free parameters, in the order used below.
    typical : sizes of these.
    rank : number of directions that the data determine.
    singular_values : of the scaled Jacobian, largest first.
    null_directions : directions along which the residuals stay the same, as weights by
        name, the largest being 1.
    covariance : of the free parameters, along the determined directions only.
    unseen : for each free parameter, whether it takes part in a null direction.
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
        """Split the space of the parameters into what the data determine and what
        they do not. A weakly determined direction along which the bounds leave less
        room than a tenth of a standard error is not: only the bounds determine it.

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
        if len(scaled) > 2 * count:
            scaled = r_factor(scaled)
        elif len(scaled) < count:
            scaled = np.pad(scaled, ((0, count - len(scaled)), (0, 0)))
        _, all_singular, right = np.linalg.svd(scaled, full_matrices=False)
        seen = visible(all_singular)
        seen &= ~information.bounded.confine(right, all_singular, typical)
        order = np.argsort(~seen, kind="stable")  # the others last
        seen = seen[order]
        singular = all_singular[order]
        right = right[order]
        inverse = right.T * inverted(singular, seen)
        scaled_covariance = inverse @ inverse.T
        if spread is not None:
            scaled_covariance = scaled_covariance + spread @ spread.T
        covariance = typical[:, None] * scaled_covariance * typical
        strong = seen & (singular >= WEAK)
        unseen = _shares(right[~seen]) > NO_PART
        weak = unseen | (_shares(right[seen & ~strong]) > LITTLE_PART)
        null = tidy_basis((right[~seen] * typical)[:, unseen], 1 / typical[unseen])
        return cls(
            names=names,
            typical=typical,
            rank=int(seen.sum()),
            singular_values=all_singular,
            null_directions=tuple(named(row, names, unseen) for row in null),
            covariance=covariance,
            unseen=unseen,
            combinations=combinations_of(
                right[~seen],
                inverse[:, seen & ~strong].T,
                weak,
                names,
                information.values,
                typical,
                covariance,
            ),
        )

    def determined(self) -> dict[str, Floats]:
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
        """Standard error, where there is one, and verdict of a free parameter.

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
