"""Other conventions of axes: which way x and y point, where y is zero, which way angles turn."""

from __future__ import annotations

from typing import NamedTuple

from curlfit.errors import InputError
from curlfit.sheet import LINES
from curlfit.throws.throw import Floats

WORDS = {
    "y-along": "y points along the throw (as it is here)",
    "y-back": "y points back at the thrower",
    "y-right": "y points to the right, seen along the throw",
    "y-left": "y points to the left",
    "x-along": "x points along the throw",
    "x-back": "x points back at the thrower",
    "x-right": "x points to the right (as it is here)",
    "x-left": "x points to the left",
    "clockwise": "angle and spin are clockwise, seen from above",
    "counter-clockwise": "angle and spin are counter-clockwise, seen from above",
    **{f"from-{line}": f"zero lies at the {line.replace('-', ' ')}" for line in LINES},
}
_OTHER = {"counterclockwise": "counter-clockwise", "ccw": "counter-clockwise", "cw": "clockwise"}
_OTHER |= {"from-center": "from-centre"}
# Direction of a word in (right, along).
_DIRECTIONS = {"right": (1, 0), "left": (-1, 0), "along": (0, 1), "back": (0, -1)}


class Frame(NamedTuple):
    """Axes of a file.

    Attributes
    ----------
    x, y : where the file's axes point, as (right, along) with one of them 1 or -1.
    turn : 1 where the file's angles are counter-clockwise seen from above, -1 where clockwise.
    zero : distance along the sheet from the hack to the file's zero in m.
    """

    x: tuple[int, int] = (1, 0)
    y: tuple[int, int] = (0, 1)
    turn: int = 1
    zero: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether these are curlfit's own axes."""
        return self == Frame()

    @property
    def handedness(self) -> int:
        """1 where y lies to the left of x (seen from above), -1 where the frame is mirrored."""
        return self.x[0] * self.y[1] - self.x[1] * self.y[0]

    @property
    def swapped(self) -> bool:
        """Whether the file's x runs along the sheet."""
        return self.x[0] == 0

    def place(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Place in curlfit's axes, x to the right and y along the throw."""
        right = self.x[0] * x if not self.swapped else self.y[0] * y
        along = self.y[1] * y if not self.swapped else self.x[1] * x
        return right + 0.0, along + self.zero


def parse_axes(text: str | None) -> Frame:
    """A frame from words with commas or spaces between them, such as `x-along,clockwise`.

    What no word speaks of stays as it is here: `x-left` alone mirrors the frame. Where one axis is
    turned by a quarter, the other one follows (y lies to the left of x, seen from above) unless a
    word says otherwise. Angles turn from the file's +x to
    its +y the short way, so that in a mirrored frame they are clockwise, unless `clockwise` or
    `counter-clockwise` says what they are seen from above.

    Raises
    ------
    InputError : an unknown word, or words that contradict one another.
    """
    axes: dict[str, tuple[int, int]] = {}
    turn: int | None = None
    zero: float | None = None
    for given in (text or "").replace(",", " ").lower().replace("_", "-").split():
        word = _OTHER.get(given, given)
        if word not in WORDS:
            raise InputError(f"axes {given!r}: unknown word; expected some of {', '.join(WORDS)}")
        name, _, where = word.partition("-")
        if name in ("x", "y"):
            if axes.get(name, _DIRECTIONS[where]) != _DIRECTIONS[where]:
                raise InputError(f"axes {text!r}: {name} cannot point two ways")
            axes[name] = _DIRECTIONS[where]
        elif name == "from":
            if zero is not None:
                raise InputError(f"axes {text!r}: the zero cannot lie in two places")
            zero = LINES[where]
        else:
            if turn is not None:
                raise InputError(f"axes {text!r}: angles cannot turn both ways")
            turn = -1 if word == "clockwise" else 1
    x, y = axes.get("x"), axes.get("y")
    if x is None:
        x = (1, 0) if y is None or y[0] == 0 else (y[1], -y[0])
    if y is None:
        y = (0, 1) if x[1] == 0 else (-x[1], x[0])
    frame = Frame(x, y, 1, zero or 0.0)
    if frame.handedness == 0:
        raise InputError(
            f"axes {text!r}: x and y lie on one line; one runs along the sheet (along, back), the "
            "other across it (right, left)"
        )
    return frame._replace(turn=frame.handedness if turn is None else turn)
