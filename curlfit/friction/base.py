"""Friction laws and their coefficients.

A law is arithmetic on any numbers or arrays, without an array library, so that the same
class serves the compiled model, NumPy and a table of names and units.
"""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import (
    Any,
    ClassVar,
    NamedTuple,
    Self,
    dataclass_transform,
)

import numpy as np

from curlfit.foreign import quoted

START_NAMES = ("x0", "y0", "heading", "v0", "phi0", "omega0")
"""Parameters of the initial state, which a fit estimates together with
the coefficients."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter of a fit.

    `typical` is its order of magnitude: the scale of the fit's variables, and the
    standard error above which it counts as undetermined. `lower` and `upper` bound the
    fit and its flat prior.
    """

    name: str
    unit: str
    lower: float
    upper: float
    typical: float
    symbol: str
    meaning: str


@dataclasses.dataclass(frozen=True)
class Coefficient(Parameter):
    """A parameter of a law, with its default value.

    An `optional` one is fixed at the default in a fit unless bounds are given for it. A
    `signed` one (such as an exponent) has no natural sign. What is `usual`, a mean and
    a standard deviation, is known of it from other ice.
    """

    default: float
    optional: bool = False
    signed: bool = False
    usual: tuple[float, float] | None = None

    def unbounded(self) -> Coefficient:
        """The coefficient with negative values allowed; signed and optional ones
        are unchanged."""
        if self.signed or self.optional:
            return self
        return dataclasses.replace(self, lower=-self.upper)


def coefficient(
    default: float,
    meaning: str,
    *,
    unit: str = "1",
    lower: float = 0.0,
    upper: float = 1.0,
    typical: float = 0.01,
    symbol: str = "",
    optional: bool = False,
    signed: bool = False,
    usual: tuple[float, float] | None = None,
) -> Any:
    """Declare a coefficient as a field of a law.

    Parameters
    ----------
    default : default value.
    meaning : a few words for tables.
    unit : unit, "1" if dimensionless.
    lower, upper : physical bounds, the default bounds of a fit and its flat prior.
    typical : its order of magnitude, to which standard errors are compared.
    symbol : LaTeX without dollar signs; the name if empty.
    optional : whether it is fixed at `default` in a fit unless bounds are given for it.
    signed : whether it has no natural sign, such as an exponent.
    usual : mean and standard deviation on other ice, of a coefficient that times of
        lines and a tape hardly tell: the prior of an evening of such draws, in which it
        is the same for all.

    Examples
    --------
    >>> class Even(curlfit.LocalLaw):
    ...     mu: float = curlfit.coefficient(0.01, "coefficient of friction", upper=0.1)
    ...
    ...     def traction(self, point):
    ...         return -self.mu * point.e_xi, -self.mu * point.e_eta
    >>> Even.coefficients()[0].upper
    0.1
    """
    metadata = {
        "default": default,
        "unit": unit,
        "lower": lower,
        "upper": upper,
        "typical": typical,
        "symbol": symbol,
        "meaning": meaning,
        "optional": optional,
        "signed": signed,
        "usual": usual,
    }
    return dataclasses.field(default=default, metadata={"coefficient": metadata})


class RingPoint(NamedTuple):
    """Variables of a local law, at one or more points of the contact ring.

    Lengths are in units of the ring radius, directions in the moving frame: `eta` along
    the velocity of the centre, `xi` to its right (eq. 21).

    Attributes
    ----------
    xi : cos(alpha), the coordinate to the right of the centre; negative on
        the left half.
    eta : sin(alpha), the coordinate ahead of the centre.
    angle : alpha in rad, in (-pi, pi), counter-clockwise from `xi`.
    front : 1.0 on the front half (eta > 0), 0.0 on the back half.
    slide_xi, slide_eta : sliding velocity to the right and forward, m/s (eq. 16).
    speed : magnitude of the sliding velocity, m/s.
    e_xi, e_eta : unit vector of sliding, to the right and forward (eq. 4).
    load : normal load relative to the uniform load, n/n0.
    v, u : speed of the centre and R omega, the same at all points, m/s.
    turned : angle turned since release (the first row of a throw), rad,
        counter-clockwise positive.
    time : time since release, s.
    """

    xi: Any
    eta: Any
    angle: Any
    front: Any
    slide_xi: Any
    slide_eta: Any
    speed: Any
    e_xi: Any
    e_eta: Any
    load: Any
    v: Any
    u: Any
    turned: Any
    time: Any


def ring_points(
    angle: Any,
    v: Any,
    u: Any,
    turned: Any,
    time: Any,
    *,
    front: Any = None,
    array: Any = np,
) -> RingPoint:
    """Points at polar angles on the ring of a stone in motion, under uniform load.

    Parameters
    ----------
    angle, v, u, turned, time : as in `RingPoint`, numbers or arrays.
    front : as in `RingPoint`; by default by the angle.
    array : numpy or jax.numpy.
    """
    xi = array.cos(angle)
    eta = array.sin(angle)
    slide_xi = -u * eta  # eq. 16
    slide_eta = v + u * xi
    speed = array.hypot(slide_xi, slide_eta)
    return RingPoint(
        xi=xi,
        eta=eta,
        angle=angle,
        front=1.0 * (eta > 0) if front is None else front,
        slide_xi=slide_xi,
        slide_eta=slide_eta,
        speed=speed,
        e_xi=slide_xi / speed,  # eq. 4
        e_eta=slide_eta / speed,
        load=array.ones_like(speed),
        v=v,
        u=u,
        turned=turned,
        time=time,
    )


class Edges(NamedTuple):
    """Polar angles at which friction jumps or has a kink, on the front half (0, pi) and
    the back half (-pi, 0)."""

    front: tuple[Any, ...] = ()
    back: tuple[Any, ...] = ()


class Motion(NamedTuple):
    """Variables of a net law: the motion of the stone as a whole.

    Attributes
    ----------
    speed : speed of the centre, m/s.
    omega : spin, rad/s, counter-clockwise positive.
    turned : angle turned since release, rad.
    time : time since release, s.
    """

    speed: Any
    omega: Any
    turned: Any
    time: Any


@functools.singledispatch
def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent` for a positive base, several times as fast in
    compiled programs."""
    return base**exponent


@functools.singledispatch
def arctan(value: Any) -> Any:
    """The arc tangent, also in compiled programs."""
    return np.arctan(value)


@functools.singledispatch
def exp(value: Any) -> Any:
    """The exponential, also in compiled programs."""
    return np.exp(value)


LAWS: dict[str, type[Law]] = {}
"""All laws by name; a class that has one is registered when it is defined, others
at first use."""

TERMS: dict[str, type[Law]] = {}
"""By name what does not brake a stone by itself, but may be a part of a sum of laws."""

on_new_law: list[Callable[[type[Law]], None]] = []
"""Called with each law class as it is defined."""


@dataclass_transform(frozen_default=True, field_specifiers=(coefficient,))
class Law:
    """A friction law: a frozen record whose fields are its coefficients.

    Derive from `LocalLaw` or `NetLaw`, not from this class. Class attributes: `name`
    (used on the command line), `formula`, `source`, `predicts` (the direction in which
    a stone with counter-clockwise spin curls).

    Examples
    --------
    >>> [item.name for item in curlfit.find_law("stribeck").coefficients()]
    ['mu0', 'mu1']
    """

    name: ClassVar[str] = ""
    formula: ClassVar[str] = ""
    source: ClassVar[str] = ""
    predicts: ClassVar[str] = ""
    brakes: ClassVar[bool] = True
    """Whether it is a law by itself; otherwise it is a part of sums, as
    in "power+sideways"."""
    approximates: ClassVar[str] = ""
    """Name of the law that this one approximates."""
    origin: ClassVar[str] = ""
    """FILE.py:CLASS of a user's law."""
    sums: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Coefficients of which only the sum enters the motion, under uniform load. Tables
    of many throws have a column for each; a fit finds its sums by itself."""
    corners: ClassVar[tuple[float, ...]] = ()
    """Angles turned (rad) at which friction, as a function of that angle, has a kink;
    beyond the last of them friction no longer depends on the angle."""

    def quickness(self, time: Any) -> Any:
        """Relative rate of the explicit change of friction with time since release,
        1/s; steps in time become shorter in proportion."""
        return 0.0 * time

    def steepness(self) -> Any:
        """Absolute value of the exponent with which friction depends on the speed."""
        return 0.0

    def fault(self) -> str | None:
        """Why these coefficients are inadmissible, where bounds cannot express
        it; or None."""
        return None

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        dataclasses.dataclass(frozen=True)(cls)
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]
            if "coefficient" not in field.metadata:
                raise TypeError(
                    f"{cls.__name__}.{field.name}: declare it as {field.name}: float = "
                    "coefficient(default, meaning)"
                )
            _check(cls, field.name, field.metadata["coefficient"])
        for callback in on_new_law:
            callback(cls)
        if cls.name:
            cls.register(cls.name)

    @classmethod
    def shipped(cls) -> bool:
        """Whether the law is part of curlfit."""
        return cls.__module__.partition(".")[0] == __name__.partition(".")[0]

    @classmethod
    def register(cls, name: str) -> None:
        """Add the class to the laws. Raises TypeError if a law of curlfit
        has this name."""
        laws = LAWS if cls.brakes else TERMS
        if name in laws and laws[name].shipped() and not cls.shipped():
            raise TypeError(
                f"{cls.__name__}: curlfit has a law {quoted(name)} "
                "already; choose another"
            )
        cls.name = name
        laws[name] = cls

    @classmethod
    @functools.cache
    def coefficients(cls) -> tuple[Coefficient, ...]:
        """The coefficients in the order of the class's fields."""
        coefficients = []
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]
            metadata: dict[str, Any] = dict(field.metadata["coefficient"])
            metadata["symbol"] = metadata["symbol"] or rf"\mathrm{{{field.name}}}"
            coefficients.append(Coefficient(name=field.name, **metadata))
        return tuple(coefficients)

    @classmethod
    def from_vector(cls, values: Any) -> Self:
        """The law with its coefficients taken in order from a sequence or array, which
        may be longer."""
        return cls(*(values[index] for index in range(len(cls.coefficients()))))


def _check(law: type[Law], name: str, metadata: dict[str, Any]) -> None:
    """Raise TypeError for an invalid name or default of a coefficient."""
    namesake = ""
    if name in START_NAMES:
        namesake = "a parameter of the initial state, fitted with every law"
    elif any(name in vars(base) for base in law.__mro__ if base.__module__ == __name__):
        namesake = "an attribute of every law"
    if namesake:
        raise TypeError(
            f"{law.__name__}.{name}: this is the name of {namesake}; choose another"
        )
    default = metadata["default"]
    lower = metadata["lower"]
    upper = metadata["upper"]
    if not lower <= default <= upper:
        raise TypeError(
            f"{law.__name__}.{name}: default {default:g} lies outside its bounds, "
            f"{lower:g} .. {upper:g}; give coefficient(..., lower=, "
            "upper=) that include it"
        )


class LocalLaw(Law, ABC):
    """A law of friction at a point of the contact ring (eq. 3-5).

    A subclass defines `traction`, which curlfit integrates over the ring. The traction
    may jump between the front and the back half, and at angles that `edges` gives. If
    on each half it is a polynomial in `xi` and `eta`, up to second order, times the
    direction or the velocity of sliding, the integral has a closed form.

    Examples
    --------
    >>> class Halves(curlfit.LocalLaw):
    ...     mu_front: float = curlfit.coefficient(0.008, "in front")
    ...     mu_back: float = curlfit.coefficient(0.012, "behind")
    ...
    ...     def traction(self, point):
    ...         mu = point.front * self.mu_front + (1 - point.front) * self.mu_back
    ...         return -mu * point.e_xi, -mu * point.e_eta
    >>> Halves().mu_back
    0.012
    """

    def edges(self, turned: Any) -> Edges:
        """Jumps and kinks of friction within the halves, after an angle turned."""
        return Edges()

    @abstractmethod
    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        """Friction force per unit normal load at a ring point, as (to the
        right, forward)."""


class NetLaw(Law, ABC):
    """A law for the acceleration of the whole stone, without a contact ring.

    Examples
    --------
    >>> issubclass(curlfit.find_law("semi-empirical"), curlfit.NetLaw)
    True
    """

    @abstractmethod
    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        """(to the right, forward, angular) in m/s^2, m/s^2, rad/s^2, in the
        moving frame."""
