"""What a friction law is, and how one declares its coefficients.

This room needs no array library: a law is arithmetic on whatever numbers or arrays it is given,
so the same class serves the compiled model, numpy and a table of names and units.
"""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Literal, NamedTuple, Self, dataclass_transform, get_args

from curlfit.errors import InputError

Load = Literal["uniform", "consistent"]
"""How the stone's weight is spread over the ring: evenly, or in balance with friction (eq. 8-9)."""

LOADS: tuple[str, ...] = get_args(Load)

START_NAMES = ("x0", "y0", "heading", "v0", "phi0", "omega0")
"""Parameters of the start, which a fit has beside the coefficients (`curlfit.inference`)."""


def check_load(load: str) -> Load:
    """The name of a load, if it is one. Raises `InputError`."""
    if load not in LOADS:
        raise InputError(f"unknown load {load!r}; expected {' or '.join(LOADS)}")
    return load  # type: ignore[return-value]


def no_motion_because(load: str) -> str:
    """The likely reason, in words, where a law gives no finite path."""
    if load != "consistent":
        return ""
    return "; the consistent load (eq. 8-9) would have to be negative somewhere"


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number that a fit may determine.

    `typical` is its usual size: the scale of the fit's variables, and the precision beyond which
    it counts as unknown. `lower` and `upper` bound the fit and its flat prior.
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
    """A parameter of a law, with the value it has where none is given.

    An `optional` one keeps that value in a fit unless bounds are given for it. Of a `signed` one
    (an exponent, say) a negative value is as ordinary as a positive one.
    """

    default: float
    optional: bool = False
    signed: bool = False

    def unbounded(self) -> Coefficient:
        """The same that may be negative; exponents and the like keep their bounds."""
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
) -> Any:
    """Declare a coefficient as a field of a law.

    Parameters
    ----------
    default : value used where none is given.
    meaning : a few words for tables.
    unit : unit, "1" for a number.
    lower, upper : physical bounds, the default bounds of a fit and its flat prior.
    typical : its usual size, the scale on which "well known" and "unknown" are told apart.
    symbol : LaTeX without dollar signs; the name if empty.
    optional : held at `default` in a fit unless bounds are given for it.
    signed : a negative value is as ordinary as a positive one, as of an exponent.
    """
    about = {
        "default": default,
        "unit": unit,
        "lower": lower,
        "upper": upper,
        "typical": typical,
        "symbol": symbol,
        "meaning": meaning,
        "optional": optional,
        "signed": signed,
    }
    return dataclasses.field(default=default, metadata={"coefficient": about})


class RingPoint(NamedTuple):
    """What a local law may depend on, at one or many points of the contact ring.

    Lengths are in units of the ring radius, directions in the moving frame: `eta` along the
    velocity of the centre, `xi` to its right (eq. 21).
    """

    xi: Any
    """cos(alpha), the place of the point to the right of the centre"""
    eta: Any
    """sin(alpha), its place ahead of the centre"""
    angle: Any
    """alpha in rad, in (-pi, pi), counter-clockwise from `xi`"""
    front: Any
    """1.0 on the front half (eta > 0), 0.0 on the back half"""
    slide_xi: Any
    """sliding velocity to the right, m/s (eq. 16)"""
    slide_eta: Any
    """sliding velocity forward, m/s (eq. 16)"""
    speed: Any
    """magnitude of the sliding velocity, m/s"""
    e_xi: Any
    """unit vector of sliding, to the right (eq. 4)"""
    e_eta: Any
    """unit vector of sliding, forward (eq. 4)"""
    load: Any
    """normal load over the uniform load, n/n0"""
    turned: Any
    """angle turned since release (the first row of a throw), rad, counter-clockwise positive"""
    time: Any
    """time since release, s"""


class Edges(NamedTuple):
    """Polar angles at which friction jumps, on the front half (0, pi) and the back (-pi, 0)."""

    front: tuple[Any, ...] = ()
    back: tuple[Any, ...] = ()


class Motion(NamedTuple):
    """What a net law may depend on: the motion of the stone as a whole."""

    speed: Any
    """speed of the centre, m/s"""
    omega: Any
    """spin, rad/s, counter-clockwise positive"""
    turned: Any
    """angle turned since release, rad"""
    time: Any
    """time since release, s"""


@functools.singledispatch
def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent` for a base above zero, in compiled programs several times as fast."""
    return base**exponent


LAWS: dict[str, type[Law]] = {}
"""Every law by its name; a class enters it by being defined."""

on_new_law: list[Callable[[type[Law]], None]] = []
"""Called with each law class as it is defined."""


@dataclass_transform(frozen_default=True, field_specifiers=(coefficient,))
class Law:
    """A friction law: a frozen record whose fields are its coefficients.

    Derive from `LocalLaw` or `NetLaw`, not from this. Class attributes: `name` (how the command
    line calls it), `formula`, `source`, `predicts` (which way a counter-clockwise stone curls).
    """

    name: ClassVar[str] = ""
    formula: ClassVar[str] = ""
    source: ClassVar[str] = ""
    predicts: ClassVar[str] = ""
    approximates: ClassVar[str] = ""
    """Name of the law of which this one is an approximation."""
    origin: ClassVar[str] = ""
    """For a law of the user's: FILE.py:CLASS."""
    sums: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Coefficients of which only the sum enters the motion, under uniform load."""
    corners: ClassVar[tuple[float, ...]] = ()
    """Angles turned (rad) at which friction, which follows the turning until the last of them,
    changes its course abruptly."""

    def quickness(self, time: Any) -> Any:
        """How fast friction changes by itself at a time since release, in 1/s."""
        return 0.0 * time

    def steepness(self) -> Any:
        """How strongly friction depends on the speed: the exponent, either sign, of a power law."""
        return 0.0

    def fault(self) -> str | None:
        """Why these coefficients make no law of friction, where bounds cannot say it."""
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
        if cls.name:
            cls.enter(cls.name)

    @classmethod
    def shipped(cls) -> bool:
        """Whether the law is curlfit's own."""
        return cls.__module__.startswith(f"{__name__.rpartition('.')[0]}.")

    @classmethod
    def enter(cls, name: str) -> None:
        """Enter the class among the laws. Raises TypeError where curlfit itself has the name."""
        if name in LAWS and LAWS[name].shipped() and not cls.shipped():
            raise TypeError(f"{cls.__name__}: curlfit has a law {name!r} already; rename yours")
        cls.name = name
        LAWS[name] = cls
        for callback in on_new_law:
            callback(cls)

    @classmethod
    @functools.cache
    def coefficients(cls) -> tuple[Coefficient, ...]:
        """The coefficients in the order of the class's fields."""
        found = []
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]
            about: dict[str, Any] = dict(field.metadata["coefficient"])
            about["symbol"] = about["symbol"] or rf"\mathrm{{{field.name}}}"
            found.append(Coefficient(name=field.name, **about))
        return tuple(found)

    @classmethod
    def from_vector(cls, values: Any) -> Self:
        """The law with its coefficients taken in order from a sequence or array."""
        names = (item.name for item in cls.coefficients())
        return cls(**{name: values[place] for place, name in enumerate(names)})


def _check(law: type[Law], name: str, about: dict[str, Any]) -> None:
    """Raise TypeError where a coefficient cannot have that name or that default."""
    taken = ""
    if name in START_NAMES:
        taken = "a parameter of the start, fitted along with every law"
    elif any(name in vars(base) for base in law.__mro__ if base.__module__ == __name__):
        taken = "something else of every law"
    if taken:
        raise TypeError(f"{law.__name__}.{name}: this is the name of {taken}; choose another")
    default, lower, upper = (about[key] for key in ("default", "lower", "upper"))
    if not lower <= default <= upper:
        raise TypeError(
            f"{law.__name__}.{name}: default {default:g} lies outside its bounds, {lower:g} .. "
            f"{upper:g}; give coefficient(..., lower=, upper=) that hold it"
        )


class LocalLaw(Law, ABC):
    """A law of friction at a point of the contact ring (eq. 3-5).

    A subclass defines `traction`. Summing over the ring is not its concern. Between the front
    and the back half the traction may jump; other places where it does are named by `edges`. Where
    it is a constant tensor times (`e_xi`, `e_eta`) on each half, the sum is in closed form.
    """

    def edges(self, turned: Any) -> Edges:
        """Where friction jumps, besides between the halves, after an angle turned."""
        return Edges()

    @abstractmethod
    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        """Friction force per unit normal load at a ring point, as (to the right, forward)."""


class NetLaw(Law, ABC):
    """A law that gives the acceleration of the whole stone, with no ring behind it."""

    @abstractmethod
    def accelerations(self, motion: Motion, stone: Any) -> tuple[Any, Any, Any]:
        """(to the right, forward, angular) in m/s^2, m/s^2, rad/s^2, in the moving frame."""


def find_law(name: str, *, from_files: bool = True) -> type[Law]:
    """The law called `name`, or the user's own law in a file, as "FILE.py:CLASS".

    `from_files` is False where the name comes with data: reading data must not run a program.

    Raises
    ------
    InputError : there is none; the message lists the laws there are. DataError : the file holds no
        usable law.
    """
    if name in LAWS:
        return LAWS[name]
    file, colon, kind = name.rpartition(":")
    if from_files and (file.endswith(".py") or name.endswith(".py")):
        from curlfit.friction.registry import law_from_file

        return law_from_file(*((file, kind) if colon and not kind.endswith(".py") else (name, "")))
    raise InputError(
        f"unknown law {name!r}; the laws are {', '.join(sorted(LAWS))} (`curlfit laws` tells more)"
        + ("; your own is given as FILE.py:CLASS" if from_files else "")
    )
