"""A throw in curlers' terms."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Call:
    """A throw in curlers' terms.

    Attributes
    ----------
    labels : its group in a joint fit, such as the sheet.
    hog_to_hog : s between the hog lines, which gives the speed.
    broom : m to the right of the centre line at the far tee, where the stone is aimed from the
        hack.
    thrower : standard deviations of the time between hog lines in s, and of the aim at the broom
        in m.
    turn : "clockwise" or "counter-clockwise"; "in" and "out" as of a right-hander.

    Examples
    --------
    >>> call = curlfit.Call({"sheet": "2"}, hog_to_hog=12.75, broom=-0.9, turn="in")
    >>> call.broom
    -0.9
    """

    labels: dict[str, str] = field(default_factory=dict)
    hog_to_hog: float | None = None
    broom: float | None = None
    thrower: tuple[float, float] | None = None
    turn: str | None = None


CENTRED = Call()
"""Along the centre line, with the speed and spin of the fitted throw."""


@dataclass(frozen=True)
class Weight:
    """A stone that comes to rest on the centre line.

    Attributes
    ----------
    rests : the name of the place, and `y`, m beyond the far tee.
    hog_to_hog, hog_to_tee : s from the near hog line; the latter None if it stops short.
    brooms : m to the right of the centre line at the far tee, of a stone that turns clockwise and
        of one that turns counter-clockwise.
    """

    rests: str
    y: float
    hog_to_hog: float
    hog_to_tee: float | None
    brooms: tuple[float, float]
