"""How noise may be correlated from row to row, by name."""

from __future__ import annotations

from enum import StrEnum


class NoiseKind(StrEnum):
    """A model of noise; `curlfit.inference.noise.models` says what each one is."""

    WHITE = "white"
    AR1 = "ar1"
    DISCREPANCY = "discrepancy"

    @property
    def suffix(self) -> str:
        """What headings say of it: ", ar1 noise"; nothing of independent noise."""
        return "" if self == NoiseKind.WHITE else f", {self} noise"
