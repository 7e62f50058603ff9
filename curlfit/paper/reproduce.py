"""All claims in order, with the results behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from curlfit.numerics.threads import in_threads
from curlfit.output.display import Displayed
from curlfit.paper.claim import Claim
from curlfit.paper.eq28 import Eq28Findings, eq_28_claims, study_eq_28
from curlfit.paper.isotropic import IsotropicFindings, isotropic_claims, study_isotropic
from curlfit.paper.kinematics import PathFindings, path_claims, study_path
from curlfit.paper.ring import RingFindings, ring_claims, study_ring

ORDER = (
    "eq13", "eq14x", "eq14y", "prop1", "prop2", "prop3", "prop4", "prop5", "eq15-17",
    "eq23", "eq24-l1", "eq24-l2", "eq24-l3", "eq27", "eq28", "ratio", "split",
)  # fmt: skip
"""Ids of the claims, in the order of the table."""


@dataclass(frozen=True, repr=False)
class Reproduction(Displayed):
    """The paper's claims recomputed, and the numbers and series behind them.

    Examples
    --------
    >>> reproduction.claim("prop1").verdict
    'holds'
    """

    _report: ClassVar[str] = "curlfit.paper.page"

    claims: tuple[Claim, ...]
    path: PathFindings
    isotropic: IsotropicFindings
    ring: RingFindings
    eq28: Eq28Findings

    def claim(self, name: str) -> Claim:
        """The claim of that id."""
        return {claim.id: claim for claim in self.claims}[name]


def reproduce(progress: Callable[[str, int, int], None] | None = None) -> Reproduction:
    """Recompute every numbered claim of Ivanov and Shuvalov (2012) from the model.

    Parameters
    ----------
    progress : called before each part with its name, the number of parts done and the total.

    Examples
    --------
    >>> reproduction = curlfit.reproduce()
    >>> len(reproduction.claims)
    17
    """

    def report(part: str, done: int) -> None:
        if progress is not None:
            progress(part, done, 4)

    report("eq. 12 and its derivatives", 0)
    path = study_path()
    studies: list[tuple[Callable[[], Any]]] = [
        (study_isotropic,), (partial(study_ring, path.motion),), (partial(study_eq_28, path),),
    ]  # fmt: skip
    with in_threads(lambda study: study(), studies) as results:
        report("isotropic friction (Prop. 1-4)", 1)
        isotropic = next(results)
        report("anisotropic friction (eq. 23-27)", 2)
        ring = next(results)
        report("eq. 28", 3)
        eq28 = next(results)
    report("done", 4)
    claims = (
        path_claims(path)
        | isotropic_claims(isotropic)
        | ring_claims(ring)
        | eq_28_claims(eq28, ring)
    )
    return Reproduction(tuple(claims[name] for name in ORDER), path, isotropic, ring, eq28)
