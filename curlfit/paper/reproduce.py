"""All claims in order, with the results behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from curlfit.numerics.threads import in_threads
from curlfit.output.display import Displayed
from curlfit.paper.claim import Claim
from curlfit.paper.eq28 import eq_28_claims, study_eq_28
from curlfit.paper.findings import Eq28Findings, IsotropicFindings, PathFindings, RingFindings
from curlfit.paper.isotropic import isotropic_claims, study_isotropic
from curlfit.paper.kinematics import path_claims, study_path
from curlfit.paper.ring import ring_claims, study_ring

ORDER = (
    "eq13", "eq14x", "eq14y", "prop1", "prop2", "prop3", "prop4", "stribeck", "prop5",
    "eq15-17", "load", "eq22", "eq23", "eq24-l1", "eq24-l2", "eq24-l3", "eq27", "eq28", "ratio",
    "split",
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
        """The claim with that id."""
        return {claim.id: claim for claim in self.claims}[name]


def reproduce(
    progress: Callable[[str, int, int], None] | None = None,
    arrived: Callable[[str, Any], None] | None = None,
) -> Reproduction:
    """Recompute every numbered claim of Ivanov and Shuvalov (2012) from the model.

    Parameters
    ----------
    progress : called before each part with its name, the number of parts done and the total.
    arrived : called with the findings of each study as soon as they are known, after the name of
        their attribute in the result.

    Examples
    --------
    >>> reproduction = curlfit.reproduce()
    >>> len(reproduction.claims)
    20
    """
    found: dict[str, Any] = {}

    def begin(part: str) -> None:
        if progress is not None:
            progress(part, len(found), 4)

    def keep(name: str, findings: Any) -> None:
        found[name] = findings
        if arrived is not None:
            arrived(name, findings)

    begin("eq. 12 and its derivatives")
    path = study_path()
    keep("path", path)
    studies: list[tuple[Callable[[], Any]]] = [
        (study_isotropic,), (partial(study_eq_28, path),), (partial(study_ring, path.motion),),
    ]  # fmt: skip
    with in_threads(lambda study: study(), studies) as results:
        begin("isotropic friction (Prop. 1-4)")
        keep("isotropic", next(results))
        begin("eq. 28")
        keep("eq28", next(results))
        begin("anisotropic friction (eq. 23-27)")
        keep("ring", next(results))
    begin("done")
    claims = (
        path_claims(path)
        | isotropic_claims(found["isotropic"])
        | ring_claims(found["ring"])
        | eq_28_claims(found["eq28"], found["ring"])
    )
    return Reproduction(tuple(claims[name] for name in ORDER), **found)
