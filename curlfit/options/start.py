"""The law of a throw with its values, and the initial state, as flags."""

# Annotations are not postponed here: cyclopts evaluates those of a base class where the class that
# inherits them is defined.
from dataclasses import dataclass, field
from typing import Annotated, Any

from cyclopts import Group, Parameter

from curlfit.settings.choices import LAW, LOAD, Choices, Named
from curlfit.settings.forms import NUMBER, VALUES, option


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LawValues(Choices):
    """A law with its coefficients, the load and the stone.

    Attributes
    ----------
    law : Friction law; `curlfit laws` lists them. [default: front-back]
    coefficients : A coefficient; the law's default if not set.
    load : `uniform` or `consistent` (eq. 8-9). [default: uniform]
    stone : The stone, as in `curlfit fit`.
    """

    law: Annotated[Any, option(LAW, "NAME")] = None
    coefficients: Annotated[Named, option(VALUES, "NAME=V", name="--set")] = field(
        default_factory=dict
    )
    load: Annotated[str | None, option(LOAD, "NAME")] = None
    stone: Annotated[Named, option(VALUES, "R=V,rho=V")] = field(default_factory=dict)


@Parameter(name="*", group=Group("Start", sort_key=0))
@dataclass(frozen=True, kw_only=True)
class Start(Choices):
    """The initial state of a throw; what is not given has the default of the verb.

    Attributes
    ----------
    v0 : Speed, m/s.
    omega0 : Spin, rad/s, counter-clockwise positive.
    heading : Direction, rad, from +y toward +x. [default: 0, along the sheet]
    x0 : Position, m right of the centre line. [default: 0]
    y0 : Position along the sheet, m. [default: that of the line]
    phi0 : Angle of the stone, rad. [default: 0]
    """

    v0: Annotated[float | None, option(NUMBER, "V")] = None
    omega0: Annotated[float | None, option(NUMBER, "W")] = None
    heading: Annotated[float | None, option(NUMBER, "A")] = None
    x0: Annotated[float | None, option(NUMBER, "X")] = None
    y0: Annotated[float | None, option(NUMBER, "Y")] = None
    phi0: Annotated[float | None, option(NUMBER, "A")] = None
