"""Prior densities: what is known of a parameter independently of the path."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import SIZES, is_size, quoted
from curlfit.friction import Parameter
from curlfit.numerics.arrays import Floats

FORMS = "MEAN+-SD, lognormal:MEDIAN,SIGMA, half-normal:SD or uniform:LOW,HIGH"


class Prior(ABC):
    """The prior density of one parameter; each kind is a class below.

    Attributes
    ----------
    kind : its name in the `FORMS`.
    is_flat : whether the density is constant within its bounds.
    is_logarithmic : whether the logarithm of the parameter is normal.
    """

    kind: ClassVar[str]
    is_flat: ClassVar[bool] = False
    is_logarithmic: ClassVar[bool] = False

    @property
    @abstractmethod
    def mode(self) -> float:
        """Where the density is largest; the middle of a flat one."""

    @property
    @abstractmethod
    def width(self) -> float:
        """Standard deviation of the parameter, or of its logarithm where that is
        normal; of a half-normal density, that of the whole; infinite of a flat one."""

    def fault(self) -> str:
        """What is wrong with its values; empty if nothing is."""
        return "" if self.width > 0 else "expected a positive width"

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        """The bounds of the parameter, limited to the support of the density."""
        return lower, upper

    def __str__(self) -> str:
        """As text, in one of the `FORMS`."""
        return f"{self.kind}:" + ",".join(f"{value:.10g}" for value in _values(self))


@dataclass(frozen=True)
class Normal(Prior):
    """A normal density."""

    mean: float
    sd: float
    kind: ClassVar[str] = "normal"

    @property
    def mode(self) -> float:
        return self.mean

    @property
    def width(self) -> float:
        return self.sd

    def __str__(self) -> str:
        return f"{self.mean:.10g}+-{self.sd:.10g}"


@dataclass(frozen=True)
class Lognormal(Prior):
    """A density under which the logarithm is normal; sigma is its standard
    deviation."""

    median: float
    sigma: float
    kind: ClassVar[str] = "lognormal"
    is_logarithmic: ClassVar[bool] = True

    @property
    def mode(self) -> float:
        return self.median * math.exp(-(self.sigma**2))

    @property
    def width(self) -> float:
        return self.sigma

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        # The density is zero at zero, which no step may reach.
        return max(lower, self.median * 1e-9), upper

    def fault(self) -> str:
        if self.sigma > 0 and not self.median > 0:
            return "expected a positive median"
        return super().fault()


@dataclass(frozen=True)
class HalfNormal(Prior):
    """The upper half of a normal density about zero."""

    sd: float
    kind: ClassVar[str] = "half-normal"

    @property
    def mode(self) -> float:
        return 0.0

    @property
    def width(self) -> float:
        return self.sd

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        return max(lower, 0.0), upper


@dataclass(frozen=True)
class Uniform(Prior):
    """A constant density between two ends."""

    low: float
    high: float
    kind: ClassVar[str] = "uniform"
    is_flat: ClassVar[bool] = True

    @property
    def mode(self) -> float:
        return (self.low + self.high) / 2

    @property
    def width(self) -> float:
        return math.inf

    def bounds(self, lower: float, upper: float) -> tuple[float, float]:
        return max(lower, self.low), min(upper, self.high)

    def fault(self) -> str:
        return "" if self.low < self.high else "is empty; expected LOW below HIGH"


_KINDS: dict[str, Any] = {
    prior.kind: prior for prior in (Normal, Lognormal, HalfNormal, Uniform)
}


def _values(prior: Any) -> tuple[float, ...]:
    """The numbers of a prior, in the order of its form."""
    return tuple(getattr(prior, field.name) for field in fields(prior))


def parse_prior(name: str, text: str) -> Prior:
    """The prior of a parameter from text, in one of the `FORMS`. Raises `InputError`
    for anything else."""
    kind, _, rest = text.rpartition(":")
    form = _KINDS.get(kind.strip() or Normal.kind)
    try:
        values = tuple(map(float, re.split(r"\+-|\+/-|±|,", rest)))
    except ValueError:
        values = ()
    if form is None or len(values) != len(fields(form)):
        raise InputError(
            f"prior of {name}: {quoted(text)} is no prior; expected {FORMS}"
        )
    prior: Prior = form(*values)
    fault = prior.fault()
    if not all(map(is_size, values)):
        fault = f"expected finite numbers, {SIZES}"
    if fault:
        raise InputError(f"prior of {name}: {prior} {fault}")
    return prior


def parse_priors(given: Mapping[str, str]) -> dict[str, Prior]:
    """Priors by the name of the parameter. Raises `InputError` for an invalid one."""
    return {name: parse_prior(name, text) for name, text in given.items()}


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


def penalty_of(parameters: Iterable[Parameter], priors: Mapping[str, Prior]) -> Penalty:
    """The penalty of some priors.

    That of a lognormal density is quadratic about its mode: with u = ln(p/median) and
    s = sigma, u^2/(2 s^2) + u = (u + s^2)^2/(2 s^2) - s^2/2.
    """
    names = [parameter.name for parameter in parameters]
    location, weight, logarithmic = np.zeros((3, len(names)))
    for name, prior in priors.items():
        index = names.index(name)
        weight[index] = 1 / prior.width
        if prior.is_flat:
            continue
        if prior.is_logarithmic:
            logarithmic[index] = 1.0
            location[index] = math.log(prior.mode)
        else:
            location[index] = prior.mode
    return Penalty(location, weight, logarithmic)
