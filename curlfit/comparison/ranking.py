"""The ranking of fits by BIC, first of laws that follow the path, and the difference of each from
the best by each criterion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from curlfit.comparison.adequacy import bend
from curlfit.comparison.criteria import criteria, effective_values
from curlfit.comparison.cross_validation import leave_one_out, standard_error
from curlfit.comparison.evidence import log_evidence
from curlfit.comparison.result import PLACE, Candidate, Comparison
from curlfit.errors import UnusableFitError
from curlfit.inference.fit.result import FitResult

_DIFFERENCES: dict[str, tuple[str, Callable[[list[float]], float]]] = {
    "aicc": ("delta_aicc", min), "bic": ("delta_bic", min), "log_evidence": ("delta_evidence", max),
}  # fmt: skip
"""The difference from the best by each criterion, and which value is the best."""


class Fitted(NamedTuple):
    """A candidate, with its fit and the log-likelihood of each channel where there is one."""

    candidate: Candidate
    result: FitResult | None = None
    likelihood: Mapping[str, float] = {}

    def having(self, **fields: Any) -> Fitted:
        """The same with some fields of the candidate replaced."""
        return self._replace(candidate=replace(self.candidate, **fields))

    @property
    def counts(self) -> bool:
        """Whether it is ranked."""
        item = self.candidate
        return item.bic is not None and item.converged and not item.signs_free


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
        one.having(**criteria(one.result, one.likelihood, effective)) if one.result else one
        for one in found
    ]
    followed = any(one.counts and one.candidate.follows for one in found)
    found = sorted(found, key=lambda one: _order(one, followed))
    noises = list(dict.fromkeys(one.noise.kind for one in fits))
    if not effective.number and len(noises) == 1:
        found = _with_predictions(found)
    best = [one for one in found if one.counts and not _misses(one, followed)] or found[:1]
    for name, (difference, best_of) in _DIFFERENCES.items():
        values = [getattr(one.candidate, name) for one in best]
        known = [value for value in values if value is not None]
        if known:
            found = [
                one.having(**{difference: value - best_of(known)})
                if (value := getattr(one.candidate, name)) is not None
                else one
                for one in found
            ]
    place = itertools.count(1)
    odds = [
        math.exp(one.candidate.delta_evidence)
        if one.counts and one.candidate.delta_evidence is not None
        else None
        for one in found
    ]
    total = sum(filter(None, odds))
    first, (curl, side) = fits[0], bend(fits[0])
    return Comparison(
        data=first.data,
        stone=first.stone,
        curl=curl,
        side=side,
        candidates=tuple(
            replace(one.candidate, rank=next(place), weight=odd and odd / total)
            if one.counts
            else one.candidate
            for one, odd in zip(found, odds, strict=True)
        ),
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


def _with_predictions(found: list[Fitted]) -> list[Fitted]:
    """The same with evidence and leave-one-out, which are valid for independent residuals only: a
    small effective sample size does not determine the shape of a likelihood, and a row that is
    correlated with its neighbours is predicted from them whatever the law."""
    scores = [None if one.result is None else leave_one_out(one.result) for one in found]
    usable = [score for one, score in zip(found, scores, strict=True) if score and one.counts]
    best = max(usable, key=lambda score: score.elpd, default=None)
    predicting = []
    for one, score in zip(found, scores, strict=True):
        fields: dict[str, float] = {}
        if one.result is not None:
            fields["log_evidence"] = log_evidence(one.result, sum(one.likelihood.values()))
        if score is not None:
            fields |= {"elpd_loo": score.elpd, "elpd_loo_se": score.stderr, "p_loo": score.p_loo}
            if best is not None:
                fields["delta_elpd"] = score.elpd - best.elpd
                fields["delta_elpd_se"] = standard_error(score.left_out - best.left_out)
        predicting.append(one.having(**fields))
    return predicting
