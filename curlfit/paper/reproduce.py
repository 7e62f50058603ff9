"""The table of claims, and the studies behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from curlfit.numerics.threads import in_threads
from curlfit.output.display import Displayed
from curlfit.output.document import Document
from curlfit.paper import anisotropic as ring, isotropic as path
from curlfit.paper.claim import Claim, Judged, claims_of, document

STUDIES: dict[str, tuple[str, Callable[[], SimpleNamespace]]] = {
    "path": ("eq. 12 and its derivatives", path.study_path),
    "isotropic": ("isotropic friction (Prop. 1-4)", path.study_isotropic),
    "eq28": ("eq. 28", ring.study_eq_28),
    "ring": ("anisotropic friction (eq. 23-27)", ring.study_ring),
}
"""What each study is about, and its function."""

CLAIMS: dict[str, Callable[[Any], Judged]] = {
    "eq13": path.eq_13,
    "eq14x": path.eq_14_x,
    "eq14y": path.eq_14_y,
    "prop1": path.prop_1,
    "prop2": path.prop_2,
    "prop3": path.prop_3,
    "prop4": path.prop_4,
    "stribeck": path.stribeck,
    "prop5": path.prop_5,
    "eq15-17": path.eq_15_to_17,
    "load": ring.uniform_load,
    "eq22": ring.eq_22,
    "eq23": ring.eq_23,
    "eq24-l1": ring.eq_24_l1,
    "eq24-l2": ring.eq_24_l2,
    "eq24-l3": ring.eq_24_l3,
    "eq27": ring.eq_27,
    "eq28": ring.eq_28,
    "ratio": ring.ratio,
    "split": ring.split,
}
"""A function of all studies for each claim."""


@dataclass(frozen=True, repr=False)
class Reproduction(Displayed):
    """The paper's claims recomputed, and the numbers and series behind them.

    Examples
    --------
    >>> reproduction.claim("prop1").verdict
    'holds'
    """

    claims: tuple[Claim, ...]
    path: Any
    isotropic: Any
    eq28: Any
    ring: Any

    def _document(self) -> Document:
        return document(self)

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
    progress : called before each part with its name, the number of parts done
        and the total.
    arrived : called with the name of each study as soon as it is known, and an object
        that has it and those before it as attributes, named as in the result.

    Examples
    --------
    >>> reproduction = curlfit.reproduce()
    >>> len(reproduction.claims)
    20
    """
    progress = progress or (lambda part, done, total: None)
    studies = SimpleNamespace()
    with in_threads(
        lambda study: study(), [(study,) for _, study in STUDIES.values()]
    ) as results:
        for done, (name, (part, _)) in enumerate(STUDIES.items()):
            progress(part, done, len(STUDIES))
            setattr(studies, name, next(results))
            if arrived is not None:
                arrived(name, studies)
    progress("done", len(STUDIES), len(STUDIES))
    with in_threads(
        lambda judge: judge(studies), [(judge,) for judge in CLAIMS.values()]
    ) as judgements:
        judged_by_id = dict(zip(CLAIMS, judgements, strict=True))
    return Reproduction(claims_of(vars(studies), judged_by_id), **vars(studies))
