"""The initial state of a throw, as flags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Group, Parameter

from curlfit.settings.choices import Choices
from curlfit.settings.forms import NUMBER, option


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
