"""Conventions of axes: directions of x and y, zero of y, sense of angles."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Floats
from curlfit.sheet import LINES

WORDS = (
    *(f"{axis}-{way}" for axis in "yx" for way in ("along", "back", "right", "left")),
    "clockwise",
    "counter-clockwise",
    *(f"from-{line}" for line in LINES),
)
"""Where axes point, seen along the throw; how angles count, seen from above;
where zero lies."""
_SYNONYMS = {
    "counterclockwise": "counter-clockwise",
    "ccw": "counter-clockwise",
    "cw": "clockwise",
    "from-center": "from-centre",
}
_TWICE = {
    "x": "x points in two directions",
    "y": "y points in two directions",
    "from": "two zeros are given",
    "turn": "angles are both clockwise and counter-clockwise",
}
# Direction of a word in (right, along).
_DIRECTIONS = {"right": (1, 0), "left": (-1, 0), "along": (0, 1), "back": (0, -1)}


class AxisConvention(NamedTuple):
    """Directions of the axes of a file, and its zero.

    Attributes
    ----------
    x, y : where the file's axes point, as (right, along) with one component 1 or -1.
    turn : 1 where the file's angles are counter-clockwise seen from above, -1
        where clockwise.
    zero : distance along the sheet from the hack to the file's zero in m.
    """

    x: tuple[int, int] = (1, 0)
    y: tuple[int, int] = (0, 1)
    turn: int = 1
    zero: float = 0.0

    @property
    def handedness(self) -> int:
        """1 where y lies to the left of x (seen from above), -1 where the axes
        are mirrored."""
        return self.x[0] * self.y[1] - self.x[1] * self.y[0]

    @property
    def swapped(self) -> bool:
        """Whether the file's x runs along the sheet."""
        return self.x[0] == 0

    @property
    def words(self) -> str:
        """The fewest words that `parse_axes` reads as this convention; empty for
        curlfit's own."""
        names = {direction: word for word, direction in _DIRECTIONS.items()}
        turn = "counter-clockwise" if self.turn > 0 else "clockwise"
        line = next((name for name, y in LINES.items() if y == self.zero), "hack")
        words = [f"x-{names[self.x]}", f"y-{names[self.y]}", turn, f"from-{line}"]
        for word in reversed(list(words)):
            fewer = [other for other in words if other != word]
            if parse_axes(",".join(fewer)) == self:
                words = fewer
        return ",".join(words)

    def to_sheet(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Position with x to the right and y along the throw."""
        if self.swapped:
            right = self.y[0] * y
            along = self.x[1] * x
        else:
            right = self.x[0] * x
            along = self.y[1] * y
        return right + 0.0, along + self.zero  # 0.0, so that no zero is negative

    @property
    def matrix(self) -> Floats:
        """`to_sheet` as a matrix that acts on (x, y, 1)."""
        return np.array(
            [
                [self.x[0], self.y[0], 0.0],
                [self.x[1], self.y[1], self.zero],
                [0.0, 0.0, 1.0],
            ]
        )


def corrected(
    text: str, across: int, along: int, turn: int, *, exchanged: bool = False
) -> str:
    """Corrected words for axes that `text` describes wrongly.

    Parameters
    ----------
    across, along, turn : -1 where the direction to the right, that along the sheet, or
        the sense of the angles is opposite to that assumed. exchanged : whether right
        and along are exchanged (before the signs apply).
    """
    now = parse_axes(text)

    def moved(direction: tuple[int, int]) -> tuple[int, int]:
        right, forward = direction[::-1] if exchanged else direction
        return across * right, along * forward

    return now._replace(x=moved(now.x), y=moved(now.y), turn=turn * now.turn).words


def states_zero(text: str) -> bool:
    """Whether words for axes say where zero lies along the sheet."""
    return any(word.startswith("from-") for word in _words_in(text))


def _words_in(text: str) -> list[str]:
    """The words of a convention, in lower case and with hyphens."""
    return text.replace(",", " ").lower().replace("_", "-").split()


@lru_cache(256)
def parse_axes(text: str | None) -> AxisConvention:
    """An axis convention from words separated by commas or spaces, such
    as `x-along,clockwise`.

    Whatever no word sets is as in curlfit: `x-left` alone mirrors the axes. If one axis
    is rotated by 90 degrees, the other follows (y lies to the left of x, seen from
    above) unless a word sets it. Angles count from the file's +x toward its +y, so that
    they are clockwise in mirrored axes, unless `clockwise` or `counter-clockwise` sets
    their sense seen from above.

    Raises
    ------
    InputError : an unknown word, or words that contradict one another.
    """
    word_by_aspect: dict[str, str] = {}
    for written in _words_in(text or ""):
        word = _SYNONYMS.get(written, written)
        if word not in WORDS:
            raise InputError(
                f"axes {quoted(written)}: unknown word; expected some of "
                f"{', '.join(WORDS)}"
            )
        name = word.partition("-")[0]
        aspect = name if name in _TWICE else "turn"
        if word_by_aspect.setdefault(aspect, word) != word:
            raise InputError(f"axes {quoted(text)}: {_TWICE[aspect]}")
    x = _DIRECTIONS.get(word_by_aspect.get("x", "").removeprefix("x-"))
    y = _DIRECTIONS.get(word_by_aspect.get("y", "").removeprefix("y-"))
    if x is None:
        x = (1, 0) if y is None or y[0] == 0 else (y[1], -y[0])
    if y is None:
        y = (0, 1) if x[1] == 0 else (-x[1], x[0])
    line = word_by_aspect.get("from", "from-hack").removeprefix("from-")
    convention = AxisConvention(x, y, 1, LINES[line])
    if convention.handedness == 0:
        raise InputError(
            f"axes {quoted(text)}: x and y lie on one line; one runs along the sheet "
            "(along, back), the other across it (right, left)"
        )
    senses = {"": convention.handedness, "clockwise": -1, "counter-clockwise": 1}
    return convention._replace(turn=senses[word_by_aspect.get("turn", "")])
