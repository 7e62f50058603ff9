"""Verdicts, stones, rows and sides as text."""

from __future__ import annotations

from rich.text import Text

from curlfit.stone import UNITS, Stone

STYLE = {
    "determined": "green",
    "prior": "green",
    "weak": "yellow",
    "not identifiable": "bold red",
    "at bound": "yellow",
    "fixed": "dim",
}

_OTHER_SIDE = {
    "to the right": "to the left",
    "right of": "left of",
    "counter-clockwise": "clockwise",
    "beyond": "before",
}


def coloured_verdict(verdict: str) -> Text:
    """A verdict on a parameter in its colour."""
    return Text(verdict, style=STYLE[verdict])


def labelled(name: str, unit: str) -> str:
    """A name with its unit in parentheses, if it has one."""
    return name if unit in ("", "1") else f"{name} ({unit})"


def stone_text(stone: Stone, *, mass: bool = True) -> str:
    """Constants of a stone."""
    names = ["R", "rho", "h"]
    if mass:
        names.append("m")
    return ", ".join(
        f"{name} = {getattr(stone, name):g} {UNITS[name]}" for name in names
    )


def sided(meaning: str, value: float) -> tuple[str, float]:
    """The meaning of a signed quantity with its side in words, and the sign that makes
    it positive.

    For a negative value whose meaning names a side these are the opposite side and -1.
    """
    if value < 0:
        for positive, negative in _OTHER_SIDE.items():
            if positive in meaning:
                return meaning.replace(positive, negative), -1.0
    return meaning, 1.0
