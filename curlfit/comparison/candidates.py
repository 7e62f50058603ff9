"""What comparisons with one track and with several data sets say alike of
their candidates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
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


def unfitted(law: type[Law], load: Load) -> Candidate:
    """A candidate before it is fitted."""
    return Candidate(
        law=law.name,
        load="-" if issubclass(law, NetLaw) else load.value,
        isotropic=opposes_sliding(law),
        signs_free=False,
        status="",
    )


def with_coefficients(
    candidate: Candidate,
    estimates: Mapping[str, Estimate],
    combinations: Iterable[Combination],
) -> Candidate:
    """The candidate with its coefficients, and the sums of them that are determined."""
    coefficients = {}
    names_by_verdict: dict[Verdict, list[str]] = {verdict: [] for verdict in Verdict}
    for name, estimate in estimates.items():
        coefficients[name] = Coefficient(
            estimate.value, estimate.stderr, estimate.verdict, estimate.unit
        )
        names_by_verdict[estimate.verdict].append(name)
    sums = [
        Sum(combination.expression, combination.value, combination.stderr)
        for combination in combinations
        if combination.weights.keys() & estimates.keys()
    ]
    return replace(
        candidate,
        coefficients=coefficients,
        combinations=tuple(sums),
        at_bound=tuple(names_by_verdict[Verdict.AT_BOUND]),
        not_identifiable=tuple(names_by_verdict[Verdict.NOT_IDENTIFIABLE]),
    )


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


def is_rankable(candidate: Candidate) -> bool:
    """Whether a candidate is ranked: within its bounds, and converged."""
    return candidate.converged and not candidate.signs_free


def best_first(candidates: Sequence[Candidate]) -> list[int]:
    """Indices of candidates in order: those that are ranked, then the others.

    A law that does not follow what another follows comes after it: with a flexible
    noise model its likelihood may be greater all the same. Differences of BIC below a
    tenth are meaningless: the order of the request is kept.
    """
    some_law_follows = any(
        is_rankable(candidate) and candidate.follows for candidate in candidates
    )

    def place(index: int) -> tuple[bool, bool, bool, float]:
        candidate = candidates[index]
        assert candidate.bic is not None
        return (
            candidate.signs_free,
            not candidate.converged,
            some_law_follows and candidate.follows is False,
            round(candidate.bic, 1),
        )

    return sorted(range(len(candidates)), key=place)


def with_ranks(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates in the order of `best_first`, with their ranks, differences from the
    best and weights."""
    rivals = [candidate for candidate in candidates if is_rankable(candidate)]
    rivals = rivals or [candidates[0]]
    if any(candidate.follows for candidate in rivals):
        rivals = [candidate for candidate in rivals if candidate.follows is not False]
    for criterion in _CRITERIA:
        values = [getattr(candidate, criterion.field) for candidate in rivals]
        if None in values:
            continue
        best = criterion.best(values)
        compared = []
        for candidate in candidates:
            difference = getattr(candidate, criterion.field) - best
            compared.append(replace(candidate, **{criterion.difference: difference}))
        candidates = compared
    rankable = [candidate for candidate in candidates if is_rankable(candidate)]
    odds = [
        math.exp(candidate.delta_evidence)
        for candidate in rankable
        if candidate.delta_evidence is not None
    ]
    weights: list[float | None] = [None] * len(rankable)
    if odds:
        weights = [value / sum(odds) for value in odds]
    ranked = [
        replace(rankable[index], rank=index + 1, weight=weight)
        for index, weight in enumerate(weights)
    ]
    return [*ranked, *candidates[len(ranked) :]]
