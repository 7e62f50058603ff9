"""Comparison of laws on one throw: fits under one or several noise models, and their ranking.

Each law is fitted within its own bounds. Where a coefficient is then at zero and the law does not
follow the path, it is fitted once more with either sign allowed, to show what it would need; such
a fit is listed but not ranked.

Fits are ranked by BIC, first those of laws that follow the path; the criteria are in `criteria`,
and the test of whether a law follows the path in `adequacy`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.comparison.adequacy import adequacy, bend, opposes_sliding, sides_of_curl, sizes
from curlfit.comparison.criteria import (
    criteria,
    effective_values,
    leave_one_out,
    log_evidence,
    log_likelihood,
    number_of_parameters,
    residuals_of,
    standard_error,
)
from curlfit.comparison.result import PLACE, Candidate, Comparison
from curlfit.errors import UnusableFitError
from curlfit.friction import LAWS, Law, NetLaw, find_law
from curlfit.friction.family import family_of
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.advice import NOISE
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.parameters import options_of, require_known
from curlfit.numerics.threads import in_threads
from curlfit.records import plain
from curlfit.settings.choices import Comparing, takes
from curlfit.throws.throw import Throw, require_path, require_throw

_DIFFERENCES: dict[str, tuple[str, Callable[[list[float]], float]]] = {
    "aicc": ("delta_aicc", min), "bic": ("delta_bic", min), "log_evidence": ("delta_evidence", max),
}  # fmt: skip
"""The difference from the best by each criterion, and which value is the best."""
_FAR = 5.0
"""Times the residuals of another law, or the noise of an ordinary tracker, beyond which a law does
not follow a path: 4.1 for the front-back law on the path of eq. 12, 7.7 where friction depends on
the speed to the power -0.25."""


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


def plan(laws: Sequence[str | type[Law]] | None, load: str) -> list[tuple[type[Law], str]]:
    """Laws and loads to be fitted; `load` may be "both".

    Where no law is named, all of curlfit's own except those that approximate another. A law without
    a ring has no load and is listed once. Raises `InputError` for an unknown name.
    """
    wanted = laws or [law for law in LAWS.values() if law.shipped() and not law.approximates]
    chosen = [find_law(law) for law in ([wanted] if isinstance(wanted, str) else wanted)]
    loads = ("uniform", "consistent") if load == "both" else (load,)
    return [
        (law, one)
        for law in dict.fromkeys(chosen)
        for one in (loads[:1] if issubclass(law, NetLaw) else loads)
    ]


@takes(Comparing, "laws")
def compare(
    throw: Throw,
    laws: Sequence[str | type[Law]] | None = None,
    *,
    progress: Callable[[str, int, int], None] | None = None,
    **choices: Any,
) -> Comparison:
    """Fit each law to a throw, under each noise model, and rank the fits by BIC.

    Parameters of a law (`fix`, `bounds`, `free`, `priors`, `start`) hold for the laws that have
    them. With `unbounded`, the fits are ranked even so.

    Parameters
    ----------
    laws : names or classes; by default curlfit's own except those that approximate another.
    progress : called with the law being fitted, the number of fits done, and their total number.
    {choices}

    Raises
    ------
    InputError : an unknown law, load, loss or noise; a name that no law has; or a throw that cannot
        be fitted by any.

    Examples
    --------
    >>> comparison = curlfit.compare(throw, ["front-back", "coulomb"])
    >>> comparison.best.label
    'front-back, uniform load'
    """
    require_throw(throw)
    require_path(throw)
    chosen = Comparing.of(throw.settings, laws=laws, **choices)
    todo = plan(chosen.laws, chosen.load)
    fits = [(law, one_load, kind) for kind in chosen.noise for law, one_load in todo]
    options = {**chosen.by_parameter, "start": chosen.start}
    require_known([law for law, _ in todo], options)

    family = family_of(law for law, _ in todo)

    def fitted(law: type[Law], one_load: str, kind: str) -> list[Fitted]:
        own = vars(chosen) | options_of(law, options)
        own |= {
            "free": tuple(own["free"]),
            "load": one_load,
            "noise": kind,
            "family": family,
            "systematics": {ALL: 0.0},
        }
        del own["laws"]
        return _with_free_signs(throw, law, own)

    found: list[Fitted] = []
    with in_threads(fitted, fits) as results:
        for done, (law, *_) in enumerate(fits):
            if progress is not None:
                progress(law.name, done, len(fits))
            found += next(results)
    if progress is not None:
        progress("", len(fits), len(fits))
    made = ranked(_followed(found))
    return replace(made, data={**made.data, "flags": [*throw.read_with, *chosen.words()]})


def _followed(found: Sequence[Fitted]) -> list[Fitted]:
    """The fits; no law follows the path that leaves far larger residuals than another, beyond the
    noise of an ordinary tracker."""
    each = [one.candidate for one in found]
    known = [item.residual_size for item in each if item.converged and not item.negative]
    least = {
        name: max(sigma, min((size.get(name, math.inf) for size in known), default=math.inf))
        for name, sigma in NOISE.items()
    }
    far = [
        any(size > _FAR * least[name] for name, size in item.residual_size.items()) for item in each
    ]
    return [
        one.having(follows=False) if beyond else one for one, beyond in zip(found, far, strict=True)
    ]


def _with_free_signs(throw: Throw, law: type[Law], choices: dict[str, Any]) -> list[Fitted]:
    """The fit of a law and, where it needs a negative coefficient, the fit with that."""
    one = _fitted(throw, law, choices, signs_free=False)
    at_zero = one.result is not None and any(
        item.verdict == "at bound" and item.lower == 0 and item.value < 1e-6 * item.typical
        for item in one.result.coefficients.values()
    )
    if at_zero and not one.candidate.follows and not choices["unbounded"]:
        again = _fitted(throw, law, choices | {"unbounded": True}, signs_free=True)
        if again.candidate.negative:
            return [one, again]
    return [one]


def _fitted(throw: Throw, law: type[Law], choices: dict[str, Any], *, signs_free: bool) -> Fitted:
    load = "-" if issubclass(law, NetLaw) else choices["load"]
    blank = Candidate(
        law=law.name, load=load, isotropic=opposes_sliding(law), signs_free=signs_free, status="",
        noise=choices["noise"],
    )  # fmt: skip
    try:
        result = fit(throw, law, **choices, details=False)
    except UnusableFitError as error:
        return Fitted(blank).having(status=str(error))
    explained, follows = adequacy(result)
    likelihood = log_likelihood(result)
    return Fitted(blank, result, likelihood).having(
        status=result.status,
        converged=result.converged,
        coefficients={
            name: {key: getattr(item, key) for key in ("value", "stderr", "verdict", "unit")}
            for name, item in result.coefficients.items()
        },
        combinations=tuple(
            {key: getattr(item, key) for key in ("expression", "value", "stderr")}
            for item in result.combinations
            if item.weights.keys() & result.coefficients.keys()
        ),
        noise_model=plain(result.noise),
        n_parameters=number_of_parameters(result),
        rms=result.rms,
        bulk=None if result.loss == "linear" else sizes(result, residuals_of(result)),
        curl_explained=explained,
        follows=follows,
        log_likelihood=sum(likelihood.values()),
        sides=sides_of_curl(law, choices["load"], result, choices["family"]),
        negative=_needed_negative(result),
        at_bound=_with_verdict(result, "at bound"),
        not_identifiable=_with_verdict(result, "not identifiable"),
        warnings=result.warnings,
        fitted={name: result.fitted[name].tolist() for name in PLACE},
    )


def _needed_negative(result: FitResult) -> tuple[str, ...]:
    """Coefficients below zero at the point of the optimum, possibly a ridge, with the smallest sum
    of negative parts."""
    from scipy.optimize import linprog

    names = [item.name for item in result.law_class.coefficients() if not item.signed]
    value = np.array([result.parameters[name].value for name in names])
    typical = np.array([result.parameters[name].typical for name in names])
    ridge = np.array([[row.get(name, 0.0) for row in result.null_directions] for name in names])
    if ridge.size:
        # minimize the sum of s >= 0 subject to s >= -(value + ridge step)/typical
        p, d = ridge.shape
        found = linprog(
            np.concatenate([np.zeros(d), np.ones(p)]),
            A_ub=np.hstack([-ridge / typical[:, None], -np.eye(p)]),
            b_ub=value / typical,
            bounds=[(None, None)] * d + [(0, None)] * p,
        )
        value = value + ridge @ found.x[:d]
    return tuple(name for name, low in zip(names, value < -1e-6 * typical, strict=True) if low)


def _with_verdict(result: FitResult, verdict: str) -> tuple[str, ...]:
    return tuple(name for name, item in result.coefficients.items() if item.verdict == verdict)


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
        known = [value for one in best if (value := getattr(one.candidate, name)) is not None]
        found = [
            one.having(**{difference: value - best_of(known)})
            if known and (value := getattr(one.candidate, name)) is not None
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
