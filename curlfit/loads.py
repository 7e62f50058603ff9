"""Loads: how the weight of the stone is distributed over its contact ring."""

from __future__ import annotations

from enum import StrEnum

from curlfit.errors import InputError
from curlfit.foreign import quoted


class Load(StrEnum):
    """Distribution of the weight over the ring: uniform, or consistent with
    friction (eq. 8-9)."""

    UNIFORM = "uniform"
    CONSISTENT = "consistent"

    def __repr__(self) -> str:
        return repr(self.value)


LOADS: tuple[str, ...] = tuple(Load)


def check_load(load: str) -> Load:
    """The name of a load. Raises `InputError` for any other name."""
    if load not in LOADS:
        raise InputError(f"unknown load {quoted(load)}; expected {' or '.join(LOADS)}")
    return Load(load)


def no_motion_because(load: str) -> str:
    """The likely reason why a law admits no motion, to be appended to a message."""
    if load != Load.CONSISTENT:
        return ""
    return "; the consistent load (eq. 8-9) would have to be negative somewhere"
