"""Properties of the stone that enter the equations of motion."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

from curlfit.errors import InputError
from curlfit.foreign import quoted

GRAVITY = 9.81  # m/s^2
SMALLEST, LARGEST = 1e-6, 0.5
"""Lower limit of all constants, in m and kg; upper limit of R, rho and h in m: stones
are at most 0.29 m across (World Curling, rule R2)."""


@dataclass(frozen=True)
class Stone:
    """A curling stone on its thin contact ring.

    Attributes
    ----------
    m : mass in kg; it scales forces and enters the motion only through air drag.
    R : radius of the contact ring in m. Ivanov and Shuvalov (2012) use 0.0625, 0.065
        and 0.054 m in one paper, so it is an input.
    rho : radius of gyration about the vertical axis in m (0.1 m in the paper; 0.1025 m
        for a solid cylinder of 29 cm diameter).
    h : height of the centre of mass above the ice in m, used by the consistent
        load (eq. 8-9).

    Raises
    ------
    InputError : a value is not a positive finite number, or a length is larger
        than any stone.

    Examples
    --------
    >>> curlfit.Stone(R=0.054).rho
    0.1
    """

    m: float = 20.0
    R: float = 0.065
    rho: float = 0.1
    h: float = 0.057

    def __post_init__(self) -> None:
        for name, unit in UNITS.items():
            value = getattr(self, name)
            if isinstance(value, str):
                raise InputError(
                    f"stone.{name} = {quoted(value)}: expected a number in {unit}"
                )
            # a mask of JAX's
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                if not (math.isfinite(value) and value >= SMALLEST):
                    raise InputError(
                        f"stone.{name} = {value} {unit}: expected a positive, finite "
                        f"number, at least {SMALLEST:g}"
                    )
                if name != "m" and value > LARGEST:
                    raise InputError(
                        f"stone.{name} = {value:g} m: expected at most {LARGEST} m; "
                        "the unit is m, not cm or mm"
                    )
                # one type, for one compiled program
                object.__setattr__(self, name, float(value))

    def with_values(self, values: dict[str, float]) -> Stone:
        """A copy with some values replaced. Raises `InputError` for an unknown name."""
        if not values:
            return self
        unknown = values.keys() - UNITS.keys()
        if unknown:
            raise InputError(
                f"the stone has no property {quoted(sorted(unknown)[0])}; it has "
                + ", ".join(f"{name} ({unit})" for name, unit in UNITS.items())
            )
        return replace(self, **values)

    def as_dict(self) -> dict[str, Any]:
        """Values by name."""
        return asdict(self)


UNITS = {"m": "kg", "R": "m", "rho": "m", "h": "m"}
