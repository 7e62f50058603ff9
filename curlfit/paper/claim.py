"""A recomputed claim."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

Verdict = Literal["holds", "holds with a correction", "does not hold"]


@dataclass(frozen=True)
class Claim:
    """A numbered statement of the paper beside the result of the model.

    Attributes
    ----------
    id : equation or proposition, "eq14x" or "prop2" for instance.
    claim : a short statement of the claim.
    printed, computed : the paper's result and the one computed, with units.
    verdict : "holds", "holds with a correction" or "does not hold".
    why : one sentence.

    Examples
    --------
    >>> claim = curlfit.Claim("eq13", "speed at t = 0", "2 m/s", "2.06 m/s", "holds", "as computed")
    >>> claim.as_dict()["verdict"]
    'holds'
    """

    id: str
    claim: str
    printed: str
    computed: str
    verdict: Verdict
    why: str

    def as_dict(self) -> dict[str, str]:
        """The fields by name."""
        return asdict(self)
