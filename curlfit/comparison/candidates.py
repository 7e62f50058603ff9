"""What comparisons with one track and with several data sets say alike of
their candidates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from curlfit.comparison.adequacy import opposes_sliding
from curlfit.comparison.result import Candidate
from curlfit.errors import UnusableFitError
from curlfit.friction import Law, Load, NetLaw
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.identifiability import Combination
from curlfit.inference.verdict import Verdict
from curlfit.numerics.threads import in_threads

Progress = Callable[[str, int, int], None]

_DIFFERENCES: dict[str, tuple[str, Callable[[list[float]], float]]] = {
    "aicc": ("delta_aicc", min),
    "bic": ("delta_bic", min),
    "log_evidence": ("delta_evidence", max),
}
"""The difference from the best by each criterion, and which value is the best."""


def about(law: type[Law], load: Load) -> dict[str, Any]:
    """What is known of a candidate before it is fitted."""
    return {
        "law": law.name,
        "load": "-" if issubclass(law, NetLaw) else load.value,
        "isotropic": opposes_sliding(law),
        "signs_free": False,
    }


def described(
    estimates: Mapping[str, Estimate], combinations: Iterable[Combination]
) -> dict[str, Any]:
    """Its coefficients, and the sums of them that are determined."""

    def of(verdict: Verdict) -> tuple[str, ...]:
        return tuple(
            name for name, item in estimates.items() if item.verdict == verdict
        )

    return {
        "coefficients": {
            name: {
                key: getattr(item, key)
                for key in ("value", "stderr", "verdict", "unit")
            }
            for name, item in estimates.items()
        },
        "combinations": tuple(
            {key: getattr(item, key) for key in ("expression", "value", "stderr")}
            for item in combinations
            if item.weights.keys() & estimates.keys()
        ),
        "at_bound": of(Verdict.AT_BOUND),
        "not_identifiable": of(Verdict.NOT_IDENTIFIABLE),
    }


def computed(
    function: Callable[..., Any],
    fits: Sequence[Any],
    names: Iterable[str],
    done: int,
    total: int,
    progress: Progress | None,
) -> list[Any]:
    """What a function makes of each of several fits, in threads; its
    progress is told."""
    found = []
    with in_threads(function, fits) as results:
        for place, name in enumerate(names, done):
            if progress is not None:
                progress(name, place, total)
            found.append(next(results))
    return found


def parted(found: Iterable[Any]) -> tuple[list[Any], list[Candidate]]:
    """Those that were fitted, and those that could not be.

    Raises
    ------
    UnusableFitError : there is no fit at all.
    """
    every = list(found)
    failed = [one for one in every if isinstance(one, Candidate)]
    if len(failed) == len(every):
        raise UnusableFitError("; ".join(one.status for one in failed))
    return [one for one in every if not isinstance(one, Candidate)], failed


def ranked(known: Sequence[dict[str, Any]]) -> list[int]:
    """Which candidates come first, of what is known of each; their ranks, differences
    from the best and weights are added to that.

    A law that does not follow what another follows comes after it: with a flexible
    noise model its likelihood may be greater all the same. Differences of BIC below a
    tenth are meaningless: the order of the request is kept.
    """
    counts = [one["converged"] and not one["signs_free"] for one in known]
    followed = any(c and one["follows"] for c, one in zip(counts, known, strict=True))
    misses = [followed and one["follows"] is False for one in known]

    def place(row: int) -> tuple[bool, bool, bool, float]:
        one = known[row]
        return (
            one["signs_free"],
            not one["converged"],
            misses[row],
            round(one["bic"], 1),
        )

    order = sorted(range(len(known)), key=place)
    best = [known[row] for row in order if counts[row] and not misses[row]] or [
        known[order[0]]
    ]
    for name, (difference, best_of) in _DIFFERENCES.items():
        if name in best[0]:
            least = best_of([one[name] for one in best])
            for one in known:
                one[difference] = one[name] - least
    ranks = [row for row in order if counts[row]]
    total = sum(math.exp(known[row].get("delta_evidence", 0.0)) for row in ranks)
    for rank, row in enumerate(ranks, 1):
        known[row]["rank"] = rank
        if "delta_evidence" in known[row]:
            known[row]["weight"] = math.exp(known[row]["delta_evidence"]) / total
    return order
