"""The ranking of fits by BIC, first of laws that follow the path, and the difference of each from
the best by each criterion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

from curlfit.comparison.adequacy import bend
from curlfit.comparison.criteria import effective_values, with_criteria
from curlfit.comparison.cross_validation import LeaveOneOut, leave_one_out, standard_error
from curlfit.comparison.evidence import log_evidence
from curlfit.comparison.result import PLACE, Candidate, Comparison
from curlfit.errors import UnusableFitError
from curlfit.inference.fit.result import FitResult


class Fitted(NamedTuple):
    """A candidate, with its fit and the log-likelihood of each channel where there is one."""

    candidate: Candidate
    result: FitResult | None = None
    likelihood: Mapping[str, float] = {}


def ranked(found: list[Fitted]) -> Comparison:
    """The comparison of fits to one throw, given in the order of the request.

    Raises
    ------
    UnusableFitError : there is no fit at all.
    """
    fits = [one.result for one in found if one.result is not None]
    if not fits:
        raise UnusableFitError("; ".join(one.candidate.status for one in found))
    effective = effective_values(most_likely(found))
    found = [
        one
        if one.result is None
        else one._replace(
            candidate=with_criteria(one.candidate, one.result, one.likelihood, effective)
        )
        for one in found
    ]
    followed = any(one.candidate.follows and _counts(one.candidate) for one in found)
    found = sorted(found, key=lambda one: _order(one, followed))
    noises = list(dict.fromkeys(one.noise.kind for one in fits))
    independent = not effective.number and len(noises) == 1
    if independent:
        found = _with_predictions(found)
    best = [
        one.candidate for one in found if _counts(one.candidate) and not _misses(one, followed)
    ] or [found[0].candidate]
    candidates = _weighted([_with_differences(one.candidate, best) for one in found])
    first = fits[0]
    curl, side = bend(first)
    return Comparison(
        data=first.data,
        stone=first.stone,
        curl=curl,
        side=side,
        candidates=tuple(candidates),
        observed={name: first.observed[name].tolist() for name in ("t", *PLACE)},
        fits=tuple(one.result for one in found),
        loss=first.loss,
        noise=",".join(noises),
        effective=effective.number,
    )


def most_likely(found: list[Fitted]) -> FitResult:
    """The fit of greatest likelihood among those that may be ranked."""
    there = [one for one in found if one.result is not None]
    usable = [
        one for one in there if one.candidate.converged and not one.candidate.signs_free
    ] or there
    best = max(usable, key=lambda one: sum(one.likelihood.values())).result
    assert best is not None
    return best


def _order(one: Fitted, followed: bool) -> tuple[bool, bool, bool, bool, float]:
    item = one.candidate
    # Differences below a tenth are meaningless: the order of the request is kept.
    bic = round(item.bic or 0.0, 1)
    return item.bic is None, item.signs_free, not item.converged, _misses(one, followed), bic


def _misses(one: Fitted, followed: bool) -> bool:
    """Whether a law does not follow a path that another follows: with a flexible noise model its
    likelihood may be greater all the same."""
    return followed and one.candidate.follows is False


def _counts(item: Candidate) -> bool:
    """Whether a candidate is ranked."""
    return item.bic is not None and item.converged and not item.signs_free


def _with_predictions(found: list[Fitted]) -> list[Fitted]:
    """The same with evidence and leave-one-out, which are valid for independent residuals only: a
    small effective sample size does not determine the shape of a likelihood, and a row that is
    correlated with its neighbours is predicted from them whatever the law."""
    scores = [None if one.result is None else leave_one_out(one.result) for one in found]
    usable = [
        score
        for one, score in zip(found, scores, strict=True)
        if score is not None and _counts(one.candidate)
    ]
    best = max(usable, key=lambda score: score.elpd, default=None)
    return [
        one._replace(candidate=_predicting(one, score, best))
        for one, score in zip(found, scores, strict=True)
    ]


def _predicting(one: Fitted, score: LeaveOneOut | None, best: LeaveOneOut | None) -> Candidate:
    item = one.candidate
    if one.result is not None:
        evidence = log_evidence(one.result, sum(one.likelihood.values()))
        item = replace(item, log_evidence=evidence)
    if score is not None:
        item = replace(item, elpd_loo=score.elpd, elpd_loo_se=score.stderr, p_loo=score.p_loo)
    if score is not None and best is not None:
        item = replace(
            item,
            delta_elpd=score.elpd - best.elpd,
            delta_elpd_se=standard_error(score.left_out - best.left_out),
        )
    return item


def _with_differences(item: Candidate, ranked: list[Candidate]) -> Candidate:
    """The candidate with its differences from the best of the ranked ones."""

    def from_best(name: str, best: Callable[..., float]) -> float | None:
        own = getattr(item, name)
        others = [getattr(one, name) for one in ranked if getattr(one, name) is not None]
        return None if own is None or not others else own - best(others)

    return replace(
        item,
        delta_aicc=from_best("aicc", min),
        delta_bic=from_best("bic", min),
        delta_evidence=from_best("log_evidence", max),
    )


def _weighted(candidates: list[Candidate]) -> list[Candidate]:
    """The candidates with their ranks and their probabilities from the evidence."""
    place = itertools.count(1)
    odds = [
        math.exp(item.delta_evidence)
        for item in candidates
        if _counts(item) and item.delta_evidence is not None
    ]
    return [
        replace(
            item,
            rank=next(place),
            weight=None if item.delta_evidence is None else math.exp(item.delta_evidence)
            / sum(odds),
        )
        if _counts(item)
        else item
        for item in candidates
    ]  # fmt: skip
