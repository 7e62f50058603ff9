"""The parameters of a fit, with bounds, fixed values and priors."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.foreign import counted, quoted
from curlfit.friction import Law, Load, Parameter
from curlfit.friction.curl import can_curl
from curlfit.inference.model.conditions import CONDITIONS
from curlfit.inference.model.priors import Penalty, Prior, parse_priors, penalty_of
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.stone import LARGEST, SMALLEST, UNITS, Stone
from curlfit.throws.readers.angles import MAX_SPIN
from curlfit.throws.throw import Throw

FEWEST_ROWS = 3
"""Rows of a path without given sigma below which nothing can be fitted."""

_ANY = -math.inf, math.inf
START = (
    Parameter("x0", "m", *_ANY, 1.0, "x_0", "initial position, to the right"),
    Parameter("y0", "m", *_ANY, 1.0, "y_0", "initial position, along the sheet"),
    Parameter(
        "heading", "rad", *_ANY, 1.0, r"\beta_0", "initial direction, from +y toward +x"
    ),
    Parameter("v0", "m/s", 0.0, 10.0, 1.0, "v_0", "initial speed"),
    Parameter("phi0", "rad", *_ANY, 1.0, r"\varphi_0", "initial angle"),
    Parameter(
        "omega0",
        "rad/s",
        -100.0,
        100.0,
        1.0,
        r"\omega_0",
        "initial spin, counter-clockwise",
    ),
)
"""The initial state, the last parameters of each fit."""
START_NAMES = tuple(component.name for component in START)
START_INDEX = {name: START_NAMES.index(name) - len(START) for name in START_NAMES}
"""Indices among the parameters of a fit, from their end."""

BOUNDS_WITHOUT_ANGLE = {"omega0": (-MAX_SPIN, MAX_SPIN)}
"""Bounds of the spin where neither it nor the angle was measured: far beyond these a
path stays the same as friction and spin grow."""


def parameter_names(law: type[Law]) -> list[str]:
    """Names of all possible parameters of a fit of a law, in order."""
    return [parameter.name for parameter in (*law.coefficients(), *CONDITIONS, *START)]


def before_start(values: Any) -> Any:
    """Values of the law's coefficients and of the conditions from those of all
    parameters, along the last axis."""
    return values[..., : -len(START)]


@dataclass(frozen=True)
class ParameterSet:
    """All parameters of a fit in order, and the values of fixed ones.

    Coefficients come first, then the conditions that are parameters, then the
    initial state. A fixed parameter is in `fixed`, by which records and verdicts know
    it, and has equal bounds, by which the solver and its information know it: `build`
    and `with_fixed` set both.
    """

    parameters: tuple[Parameter, ...]
    fixed: dict[str, float]
    priors: dict[str, Prior] = field(default_factory=dict)

    @classmethod
    def build(
        cls,
        law: type[Law],
        *,
        fix: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        unbounded: bool = False,
        free: Collection[str] = (),
        priors: Mapping[str, str] | None = None,
        swept: bool = False,
    ) -> ParameterSet:
        """Parameters of a fit of `law`.

        Optional coefficients are held at their default, and conditions (slope of the
        ice and so on, see `curlfit.inference.model.conditions`) at their assumed
        values, unless they are named in one of the arguments.

        Parameters
        ----------
        fix : parameters held at a value.
        bounds : (lower, upper) by name, in place of the law's own.
        unbounded : let coefficients be negative, within [-upper, upper]; exponents and
            the like keep their bounds.
        free : optional coefficients and conditions that are estimated.
        priors : prior densities by name, see `curlfit.inference.model.priors`; these
            parameters are estimated.
        swept : whether the stone is swept for a while; `sweep` is then a parameter.

        Raises
        ------
        InputError : an unknown name, a name both fixed and free, a text that is not a
            prior, an empty interval, a fixed value outside its bounds, or nothing
            left to fit.
        """
        prior_by_name = parse_priors(priors or {})
        limits = bounds or {}
        fixed = {name: float(value) for name, value in (fix or {}).items()}
        estimated = {*free, *prior_by_name}
        coefficients = law.coefficients()
        _require_named(law, fix=fixed, bounds=limits, free=free, priors=prior_by_name)
        named = {*fixed, *limits, *estimated}
        if "sweep" in named and not swept:
            raise InputError(
                "sweep is a parameter only of a swept stone; expected also `swept`, "
                "the two times in s between which it was swept"
            )
        for name in fixed.keys() & estimated:
            conflict = "has a prior" if name in prior_by_name else "is free"
            raise InputError(f"{name} is fixed and {conflict}; expected one of them")
        for parameter in coefficients:
            if parameter.optional and parameter.name not in named:
                fixed[parameter.name] = parameter.default
        if swept:
            named.add("sweep")
        if unbounded:
            coefficients = tuple(
                coefficient.unbounded() for coefficient in coefficients
            )
        conditions = [condition for condition in CONDITIONS if condition.name in named]
        possible = (*coefficients, *conditions, *START)
        parameters = tuple(
            _limited(parameter, limits, prior_by_name, fixed) for parameter in possible
        )
        parameter_set = cls(parameters, fixed, prior_by_name)
        parameter_set._require_free()
        return parameter_set

    @classmethod
    def for_throw(cls, law: type[Law], throw: Throw, **choices: Any) -> ParameterSet:
        """Parameters of a fit of `law` to a throw; `choices` as in `build`.

        What no measurement can determine of the initial state is fixed, at zero or at
        the value that the throw assumes: a coordinate that was not measured, the
        heading unless both were, the angle where it was not measured. Where only timed
        events were measured, the spin is fixed too unless it or an angle was measured
        or it was named, and the heading if only the curl was measured, which is
        counted from its direction, of a law that can curl, or if there are fewer
        events than parameters.

        Raises
        ------
        InputError : as in `build`. DataError : fewer rows than parameters.
        """
        named = {
            name
            for choice in ("bounds", "free", "priors")
            for name in choices.get(choice) or ()
        }
        measured = {event.quantity for event in throw.events}
        turning = bool({"phi", "omega"} & ({*throw.seen} | measured))
        fixed = choices.get("fix") or ()
        if not turning and "omega0" not in named and "omega0" not in fixed:
            bounds = choices.get("bounds") or {}
            choices["bounds"] = {**bounds, **BOUNDS_WITHOUT_ANGLE}
        parameters = cls.build(law, **choices)
        unseen = [f"{name}0" for name in ("x", "y", "phi") if name not in throw.seen]
        if throw.has_path and ("x" not in throw.seen or "y" not in throw.seen):
            unseen.append("heading")
        if not throw.has_path and not turning and "omega0" not in named:
            unseen.append("omega0")
        for name in unseen:
            if name not in parameters.fixed:
                parameters = parameters.with_fixed(name, throw.assumed.get(name, 0.0))
        if not throw.has_path:
            parameters = parameters._with_heading_of_events(law, throw, named)
        parameters._require_free()
        if not throw.has_path:
            return parameters
        free = int(parameters.free.sum())
        rows = int(throw.finite.any(0).sum())
        needed = max(free, FEWEST_ROWS)
        if rows < needed and not set(throw.seen) <= throw.sigma.keys():
            raise DataError(
                f"{counted(rows, 'row')} for {counted(free, 'parameter')}; "
                "give more rows, or sigmas, or fix parameters",
                file=throw.name,
            )
        return parameters

    def _with_heading_of_events(
        self, law: type[Law], throw: Throw, named: Collection[str]
    ) -> ParameterSet:
        """The set for timed events alone: the heading is held along the sheet where
        nothing tells it apart from the curl, unless a choice has named it."""
        if not self.free[self.index("heading")] or "heading" in named:
            return self
        measured = {event.quantity for event in throw.events}
        tells_x = any(
            event.quantity == "x" and event.since is None for event in throw.events
        )
        # mypy takes a class for one of its instances, which have no hash.
        curls = can_curl(law, Load.UNIFORM, Stone())  # type: ignore[arg-type]
        is_straight = not tells_x and ("x" not in measured or curls)
        if is_straight or int(self.free.sum()) > len(throw.events):
            return self.with_fixed("heading", 0.0)
        return self

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """Names of the conditions among the parameters."""
        conditions = {condition.name for condition in CONDITIONS}
        return tuple(name for name in self.names if name in conditions)

    def _array(self, attribute: str) -> Floats:
        values = np.array(
            [getattr(parameter, attribute) for parameter in self.parameters]
        )
        values.flags.writeable = False  # shared by all callers
        return values

    @cached_property
    def lower(self) -> Floats:
        """Lower bounds; the value of a fixed parameter."""
        return self._array("lower")

    @cached_property
    def upper(self) -> Floats:
        """Upper bounds; the value of a fixed parameter."""
        return self._array("upper")

    @cached_property
    def typical(self) -> Floats:
        """Typical sizes."""
        return self._array("typical")

    @cached_property
    def penalty(self) -> Penalty:
        """What the priors add to chi squared."""
        return penalty_of(self.parameters, self.priors)

    @cached_property
    def free(self) -> Booleans:
        """True for the parameters to be determined."""
        free = np.array([name not in self.fixed for name in self.names])
        free.flags.writeable = False
        return free

    def names_where(self, mask: Booleans) -> list[str]:
        """Names of the parameters that a mask picks out."""
        return [name for name, take in zip(self.names, mask, strict=True) if take]

    def _require_free(self) -> None:
        if not self.free.any():
            raise InputError("every parameter is fixed; nothing is left to fit")

    def require(self, option: str, names: Iterable[str]) -> None:
        """Raise `InputError` if one of the names is not that of a parameter."""
        for name in names:
            if name not in self.names:
                raise InputError(
                    f"{option}: no parameter {quoted(name)}; the parameters are "
                    f"{', '.join(self.names)}"
                )

    def index(self, name: str) -> int:
        """Index of a parameter in a vector."""
        return self.names.index(name)

    def values_of(self, values: Floats) -> dict[str, float]:
        """A parameter vector as a dictionary by name."""
        return dict(zip(self.names, map(float, values), strict=True))

    def with_fixed(self, name: str, value: float) -> ParameterSet:
        """The same with one more parameter fixed."""
        parameters = tuple(
            replace(parameter, lower=value, upper=value)
            if parameter.name == name
            else parameter
            for parameter in self.parameters
        )
        return replace(self, parameters=parameters, fixed={**self.fixed, name: value})


def _require_named(law: type[Law], **names_by_choice: Iterable[str]) -> None:
    """Raise `InputError` if a choice names what is no parameter of a fit of a law."""
    possible = parameter_names(law)
    for choice, names in names_by_choice.items():
        for name in names:
            if name not in possible:
                of_law = [parameter.name for parameter in (*law.coefficients(), *START)]
                conditions = [condition.name for condition in CONDITIONS]
                raise InputError(
                    f"{choice}: law {law.name} has no parameter {quoted(name)}; it has "
                    f"{', '.join(of_law)}; conditions are {', '.join(conditions)}"
                )


def _limited(
    parameter: Parameter,
    limits: Mapping[str, tuple[float, float]],
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
) -> Parameter:
    """A parameter with the bounds of a fit: those given, limited by its prior; its
    fixed value."""
    name = parameter.name
    lower, upper = limits.get(name, (parameter.lower, parameter.upper))
    if (
        name in UNITS
        and name in limits
        and not (lower >= SMALLEST and upper <= LARGEST)
    ):
        raise InputError(
            f"bound of {name}: {lower:g}:{upper:g} m is beyond every stone; "
            f"expected LOW:HIGH within {SMALLEST:g}:{LARGEST:g}"
        )
    if name in priors:
        lower, upper = priors[name].bounds(lower, upper)
    if not lower < upper:
        raise InputError(
            f"bound of {name}: {lower:g}:{upper:g} is empty; expected LOW:HIGH"
        )
    if name in fixed:
        value = fixed[name]
        if name == "v0" and value == 0:
            raise InputError(
                "v0 is fixed at 0; expected the speed of a stone that moves"
            )
        if not lower <= value <= upper:
            raise InputError(
                f"{name} is fixed at {value:g}, outside its bounds {lower:g}:{upper:g}"
                + ("" if name in limits else "; give it wider bounds to fix it there")
            )
        lower = upper = value
    if (lower, upper) == (parameter.lower, parameter.upper):
        return parameter
    return replace(parameter, lower=float(lower), upper=float(upper))


Options = Mapping[str, Mapping[str, Any] | Sequence[str]]
"""Choices that name parameters, by choice: values by name, or names."""


def require_known(laws: Iterable[type[Law]], options: Options) -> None:
    """Raise `InputError` if an option names a parameter that none of the laws has."""
    names = dict.fromkeys(name for law in laws for name in parameter_names(law))
    for option, values in options.items():
        for name in values:
            if name not in names:
                raise InputError(
                    f"{option}: none of the laws has a parameter {quoted(name)}; "
                    "the parameters are " + ", ".join(names)
                )


def options_of(law: type[Law], options: Options) -> dict[str, Any]:
    """The options, limited to the parameters that a law has."""
    names = parameter_names(law)
    of_law: dict[str, Any] = {}
    for option, values in options.items():
        if isinstance(values, Mapping):
            of_law[option] = {
                name: value for name, value in values.items() if name in names
            }
        else:
            of_law[option] = tuple(name for name in values if name in names)
    return of_law
