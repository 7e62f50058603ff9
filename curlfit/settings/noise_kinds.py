"""How noise may be correlated from row to row, by name."""

from __future__ import annotations

from enum import StrEnum


class NoiseKind(StrEnum):
    """A model of noise; `curlfit.inference.noise.models` says what each one is."""

    WHITE = "white"
    AR1 = "ar1"
    DISCREPANCY = "discrepancy"

    @property
    def is_white(self) -> bool:
        """Whether it is independent from row to row."""
        return self is NoiseKind.WHITE

    @property
    def has_discrepancy(self) -> bool:
        """Whether it contains accelerations that the law lacks."""
        return self is NoiseKind.DISCREPANCY

    @property
    def suffix(self) -> str:
        """What headings say of it: ", ar1 noise"; nothing of independent noise."""
        return "" if self.is_white else f", {self} noise"
