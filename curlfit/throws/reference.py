"""What belongs to a throw besides its measurements: published values and the
file's conventions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from curlfit.records import OneOf
from curlfit.stone import UNITS as STONE_UNITS

StoneValues = dict[Annotated[str, OneOf(STONE_UNITS)], float]


@dataclass(frozen=True)
class Reference:
    """Published or true values of one law, shown beside a fit.

    Attributes
    ----------
    source : name of the source, such as "eq. 28". law : the law of the coefficients.
    values : values by name, or by expression such as "mu1_eta + mu2_eta".
    stone : constants of the stone (R, rho, h in m, m in kg) on which the values are
        based, where these differ from the constants printed beside them.
    rounding : rounding error (half a unit) of the printed constants, in the same units.
    note : reason for the difference, as a clause.
    """

    source: str
    law: str
    values: dict[str, float]
    stone: StoneValues = field(default_factory=dict)
    rounding: StoneValues = field(default_factory=dict)
    note: str = ""

    def of(self, expression: str, weights: dict[str, float]) -> float | None:
        """Value of a weighted sum, as given or from its terms; None if unknown."""
        if expression in self.values:
            return self.values[expression]
        if not weights.keys() <= self.values.keys():
            return None
        return sum(weight * self.values[name] for name, weight in weights.items())


@dataclass(frozen=True)
class Conventions:
    """How the columns of a file were interpreted.

    Attributes
    ----------
    factors : of the units to SI, by quantity ("t", "x", ...). axes : words as for
        `--axes`; empty for curlfit's own.
    """

    factors: Mapping[str, float] = field(default_factory=dict)
    axes: str = ""
