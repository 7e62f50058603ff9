"""Prior densities: what is known of a parameter independently of the path."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import SIZES, is_size, quoted
from curlfit.friction import Parameter
from curlfit.numerics.arrays import Floats

FORMS = "MEAN+-SD, lognormal:MEDIAN,SIGMA, half-normal:SD or uniform:LOW,HIGH"
_VALUES = {"normal": 2, "lognormal": 2, "half-normal": 1, "uniform": 2}


@dataclass(frozen=True)
class Prior:
    """The prior density of one parameter.

    Attributes
    ----------
    kind : "normal", "lognormal", "half-normal" or "uniform".
    values : mean and standard deviation; median and standard deviation of the
        logarithm; standard deviation (of the normal density whose upper half it is);
        lower and upper end.
    """

    kind: str
    values: tuple[float, ...]

    @classmethod
    def parse(cls, name: str, text: str) -> Prior:
        """A prior from text, in one of the `FORMS`. Raises `InputError` for
        anything else."""
        kind, _, rest = text.rpartition(":")
        kind = kind.strip() or "normal"
        try:
            values = tuple(map(float, re.split(r"\+-|\+/-|±|,", rest)))
        except ValueError:
            values = ()
        if len(values) != _VALUES.get(kind):
            raise InputError(
                f"prior of {name}: {quoted(text)} is no prior; expected {FORMS}"
            )
        found, fault = cls(kind, values), None
        if not all(map(is_size, values)):
            fault = f"expected finite numbers, {SIZES}"
        elif kind == "uniform" and not values[0] < values[1]:
            fault = "is empty; expected LOW below HIGH"
        elif kind != "uniform" and not values[-1] > 0:
            fault = "expected a positive width"
        elif kind == "lognormal" and not values[0] > 0:
            fault = "expected a positive median"
        if fault:
            raise InputError(f"prior of {name}: {found} {fault}")
        return found

    def __str__(self) -> str:
        """As text, in one of the `FORMS`."""
        if self.kind == "normal":
            return f"{self.values[0]:.10g}+-{self.values[1]:.10g}"
        return f"{self.kind}:" + ",".join(f"{value:.10g}" for value in self.values)

    @property
    def mode(self) -> float:
        """Where the density is largest; the middle of a uniform one."""
        if self.kind == "lognormal":
            median, sigma = self.values
            return median * math.exp(-(sigma**2))
        return {"half-normal": 0.0, "uniform": sum(self.values) / 2}.get(
            self.kind, self.values[0]
        )

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        """The bounds of the parameter, limited to the support of the density."""
        if self.kind == "uniform":
            return max(lower, self.values[0]), min(upper, self.values[1])
        if self.kind == "half-normal":
            return max(lower, 0.0), upper
        # a density of zero at zero, which no step may reach
        if self.kind == "lognormal":
            return max(lower, self.values[0] * 1e-9), upper
        return lower, upper


def parse_priors(given: Mapping[str, str]) -> dict[str, Prior]:
    """Priors by the name of the parameter. Raises `InputError` for an invalid one."""
    return {name: Prior.parse(name, text) for name, text in given.items()}


class Penalty(NamedTuple):
    """Twice the negative logarithm of priors, as squared residuals of
    single parameters.

    Works with NumPy and with JAX, for one parameter vector and for many along the
    leading axes.
    """

    location: Any
    """of the parameter, or of its logarithm; shape (..., parameters),
    like the others"""
    weight: Any
    """1 over the standard deviation, 0 where there is no prior"""
    logarithmic: Any
    """1 where the logarithm is normal"""

    @classmethod
    def none(cls, *shape: int) -> Penalty:
        """That of no priors."""
        return cls(*np.zeros((3, *shape)))

    def at(self, which: Any) -> Penalty:
        """That of some of many parameter vectors, by an index of their arrays."""
        return Penalty(*(part[which] for part in self))

    @property
    def informative(self) -> bool:
        """Whether there is any prior."""
        return bool((self.weight > 0).any())

    def residual_and_slope(self, values: Any) -> tuple[Any, Any]:
        """Residuals of the priors, and the derivative of each by its parameter."""
        xp = values.__array_namespace__()
        logarithmic = self.logarithmic > 0
        positive = xp.where(logarithmic, xp.maximum(values, 1e-300), 1.0)
        argument = xp.where(logarithmic, xp.log(positive), values)
        return (argument - self.location) * self.weight, self.weight / positive

    def chi_squared(self, values: Any) -> Any:
        """Sum of the squared residuals."""
        return (self.residual_and_slope(values)[0] ** 2).sum(-1)

    def quadratic(self, values: Any) -> tuple[Any, Any, Any]:
        """Half the sum of the squares, its gradient, and the diagonal of its Hessian,
        which is that of Gauss and Newton."""
        residual, slope = self.residual_and_slope(values)
        return (residual**2).sum(-1) / 2, slope * residual, slope**2

    def rows(self, values: Floats) -> Floats:
        """The residuals linearized at some values: one row for each parameter, with the
        residual as the last column."""
        residual, slope = self.residual_and_slope(values)
        return np.concatenate(
            [slope[..., None] * np.eye(slope.shape[-1]), residual[..., None]], -1
        )


def penalty_of(
    parameters: Iterable[Parameter],
    priors: Mapping[str, Prior],
    offset: Floats | float = 0.0,
) -> Penalty:
    """The penalty of some priors.

    That of a lognormal density is quadratic about its mode: with u = ln(p/median) and
    s = sigma, u^2/(2 s^2) + u = (u + s^2)^2/(2 s^2) - s^2/2.

    Parameters
    ----------
    offset : added to the penalized values to obtain those that the priors refer to.
    """
    names = [item.name for item in parameters]
    location, weight, logarithmic = np.zeros((3, len(names)))
    offset = np.zeros(len(names)) + offset
    for name, prior in priors.items():
        index = names.index(name)
        if prior.kind == "uniform":
            continue
        weight[index] = 1 / prior.values[-1]
        if prior.kind == "lognormal":
            logarithmic[index] = 1.0
            location[index] = math.log(prior.mode)
        else:
            location[index] = prior.mode - offset[index]
    return Penalty(location, weight, logarithmic)
