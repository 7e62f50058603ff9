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
    """A law with its coefficients, the load and the stone."""

    law: Annotated[
        Any, option(LAW, "Friction law; `curlfit laws` lists them. [default: front-back]", "NAME")
    ] = None
    coefficients: Annotated[
        Named,
        option(VALUES, "A coefficient; the law's default if not set.", "NAME=V", name="--set"),
    ] = field(default_factory=dict)
    load: Annotated[
        str | None,
        option(LOAD, "`uniform` or `consistent` (eq. 8-9). [default: uniform]", "NAME"),
    ] = None
    stone: Annotated[Named, option(VALUES, "The stone, as in `curlfit fit`.", "R=V,rho=V")] = field(
        default_factory=dict
    )


@Parameter(name="*", group=Group("Start", sort_key=0))
@dataclass(frozen=True, kw_only=True)
class Start(Choices):
    """The initial state of a throw; what is not given has the default of the verb."""

    v0: Annotated[float | None, option(NUMBER, "Speed, m/s.", "V")] = None
    omega0: Annotated[
        float | None, option(NUMBER, "Spin, rad/s, counter-clockwise positive.", "W")
    ] = None
    heading: Annotated[
        float | None,
        option(NUMBER, "Direction, rad, from +y toward +x. [default: 0, along the sheet]", "A"),
    ] = None
    x0: Annotated[
        float | None, option(NUMBER, "Position, m right of the centre line. [default: 0]", "X")
    ] = None
    y0: Annotated[
        float | None,
        option(NUMBER, "Position along the sheet, m. [default: that of the line]", "Y"),
    ] = None
    phi0: Annotated[float | None, option(NUMBER, "Angle of the stone, rad. [default: 0]", "A")] = (
        None
    )
