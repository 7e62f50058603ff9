"""What comparisons with one track and with several data sets say alike of
their candidates.

A candidate that is still being compared is a dictionary of the fields of
`Candidate`, to which its rank and its differences from the best are added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from curlfit.comparison.adequacy import opposes_sliding
from curlfit.comparison.result import Candidate, Coefficient, Sum
from curlfit.errors import UnusableFitError
from curlfit.friction import Law, Load, NetLaw
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.threads import in_threads

Progress = Callable[[str, int, int], None]


class _Criterion(NamedTuple):
    """A field by which laws are compared."""

    field: str
    difference: str
    """field of the difference from the best"""
    best: Callable[[Iterable[float]], float]


_CRITERIA = (
    _Criterion("aicc", "delta_aicc", min),
    _Criterion("bic", "delta_bic", min),
    _Criterion("log_evidence", "delta_evidence", max),
)


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
    """The coefficients of a candidate, and the sums of them that are determined."""

    def names_of(verdict: Verdict) -> tuple[str, ...]:
        return tuple(
            name for name, estimate in estimates.items() if estimate.verdict == verdict
        )

    return {
        "coefficients": {
            name: Coefficient(
                estimate.value, estimate.stderr, estimate.verdict, estimate.unit
            )
            for name, estimate in estimates.items()
        },
        "combinations": tuple(
            Sum(combination.expression, combination.value, combination.stderr)
            for combination in combinations
            if combination.weights.keys() & estimates.keys()
        ),
        "at_bound": names_of(Verdict.AT_BOUND),
        "not_identifiable": names_of(Verdict.NOT_IDENTIFIABLE),
    }


def computed(
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, ...]],
    names: Iterable[str],
    done: int,
    total: int,
    progress: Progress | None,
) -> list[Any]:
    """The results of a function for each of several arguments, in threads.

    Parameters
    ----------
    names : of the laws, for the progress.
    done, total : number of fits done before, and altogether.
    """
    results = []
    with in_threads(function, arguments) as results_in_order:
        for number, name in enumerate(names, done):
            if progress is not None:
                progress(name, number, total)
            results.append(next(results_in_order))
    return results


def parted(fits: Iterable[Any]) -> tuple[list[Any], list[Candidate]]:
    """The fits, and the candidates that could not be fitted.

    Raises
    ------
    UnusableFitError : there is no fit at all.
    """
    fitted = []
    failed = []
    for fit in fits:
        if isinstance(fit, Candidate):
            failed.append(fit)
        else:
            fitted.append(fit)
    if not fitted:
        raise UnusableFitError("; ".join(candidate.status for candidate in failed))
    return fitted, failed


def counts(fields: dict[str, Any]) -> bool:
    """Whether a candidate is ranked: within its bounds, and converged."""
    return fields["converged"] and not fields["signs_free"]


def ranked(candidates: Sequence[dict[str, Any]]) -> list[int]:
    """The order of candidates, best first; their ranks, differences from the best and
    weights are added to their fields.

    A law that does not follow what another follows comes after it: with a flexible
    noise model its likelihood may be greater all the same. Differences of BIC below a
    tenth are meaningless: the order of the request is kept.
    """

    some_law_follows = any(
        counts(fields) and fields["follows"] for fields in candidates
    )

    def misses(fields: dict[str, Any]) -> bool:
        return some_law_follows and fields["follows"] is False

    def place(row: int) -> tuple[bool, bool, bool, float]:
        fields = candidates[row]
        return (
            fields["signs_free"],
            not fields["converged"],
            misses(fields),
            round(fields["bic"], 1),
        )

    order = sorted(range(len(candidates)), key=place)
    in_order = [candidates[row] for row in order]
    in_rank = [fields for fields in in_order if counts(fields)]
    rivals = [fields for fields in in_rank if not misses(fields)] or in_order[:1]
    for criterion in _CRITERIA:
        if criterion.field in rivals[0]:
            best = criterion.best(fields[criterion.field] for fields in rivals)
            for fields in candidates:
                fields[criterion.difference] = fields[criterion.field] - best
    total = sum(math.exp(fields.get("delta_evidence", 0.0)) for fields in in_rank)
    for rank, fields in enumerate(in_rank, 1):
        fields["rank"] = rank
        if "delta_evidence" in fields:
            fields["weight"] = math.exp(fields["delta_evidence"]) / total
    return order
