"""Comparison of laws on one throw: fits under one or several noise models, and
their ranking.

Each law is fitted within its own bounds. Where a coefficient is then at zero and the
law does not follow the path, it is fitted once more with either sign allowed, to show
what it would need; such a fit is listed but not ranked.

Fits are ranked by BIC, first those of laws that follow the path; the criteria are in
`criteria`, and the test of whether a law follows the path in `adequacy`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, compress
from typing import Any, NamedTuple

import numpy as np

from curlfit.comparison.adequacy import Adequacy, adequacy, sides_of_curl
from curlfit.comparison.candidates import (
    Progress,
    best_first,
    computed,
    is_rankable,
    parted,
    unfitted,
    with_coefficients,
    with_ranks,
)
from curlfit.comparison.criteria import (
    criteria,
    effective_values,
    log_evidence,
    log_likelihood,
    number_of_parameters,
    residuals_of,
)
from curlfit.comparison.lacking import lacking
from curlfit.comparison.leave_one_out import leave_one_out, standard_error
from curlfit.comparison.requests import requests_of, with_free_signs
from curlfit.comparison.result import PLACE, Candidate, Comparison, Lacking
from curlfit.comparison.several import compare_sets
from curlfit.errors import UnusableFitError
from curlfit.friction import Law
from curlfit.friction.family import LawFamily, family_of
from curlfit.inference.fit.advice import NOISE
from curlfit.inference.fit.fit import fit_request
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.request import Request
from curlfit.losses import LOSSES
from curlfit.noises import NOISES
from curlfit.settings.choices import Comparing, takes
from curlfit.throws.friction_table import FrictionTable
from curlfit.throws.throw import Throw, require_throw

_FAR = 5.0
"""Times the residuals of another law, or the noise of an ordinary tracker, beyond which
a law does not follow a path: 4.1 for the front-back law on the path of eq. 12, 7.7
where friction depends on the speed to the power -0.25."""

_ZERO = 1e-6
"""Typical sizes, up to which a coefficient is zero but for rounding."""


class FittedLaw(NamedTuple):
    """A fit of a law, with what makes it a candidate."""

    candidate: Candidate
    """not yet compared with others"""
    result: FitResult
    likelihood: dict[str, float]
    """logarithm, by channel"""
    adequacy: Adequacy

    @property
    def log_likelihood(self) -> float:
        """Of all channels."""
        return sum(self.likelihood.values())


@takes(Comparing, "laws")
def compare(
    throw: Throw | Sequence[Throw | FrictionTable],
    laws: Sequence[str | type[Law]] | None = None,
    *,
    progress: Progress | None = None,
    **choices: Any,
) -> Comparison:
    """Fit each law to a throw, under each noise model, and rank the fits by BIC; or to
    several data sets at once.

    Of a list of throws and tables of friction, one set of coefficients of each law must
    answer all. The timed throws of one file are one data set.

    Parameters of a law (`fix`, `bounds`, `free`, `priors`, `start`) hold for the laws
    that have them. With `unbounded`, the fits are ranked even so.

    Parameters
    ----------
    laws : names or classes; by default curlfit's own except those that
        approximate another.
    progress : called with the law being fitted, the number of fits done, and their
        total number.
    {choices}

    Raises
    ------
    InputError : an unknown law, load, loss or noise; a name that no law has; or a throw
        that cannot be fitted by any.

    Examples
    --------
    >>> comparison = curlfit.compare(throw, ["front-back", "coulomb"])
    >>> comparison.best.label
    'front-back, uniform load'
    """
    if isinstance(throw, Sequence) and not isinstance(throw, str):
        return compare_sets(throw, Comparing.of(laws=laws, **choices), progress)
    require_throw(throw)
    chosen = Comparing.of(throw.settings, laws=laws, **choices)
    return compare_requests(requests_of(throw, chosen), chosen, progress)


def compare_requests(
    requests: Sequence[Request], chosen: Comparing, progress: Progress | None = None
) -> Comparison:
    """The comparison of the laws that are requested of one throw.

    Parameters
    ----------
    requests : from `requests_of` these choices.
    progress : as in `compare`.
    """
    family = family_of(dict.fromkeys(request.law for request in requests))

    def fits_of(request: Request) -> list[FittedLaw | Candidate]:
        return _fitted_with_signs(request, chosen, family)

    count = len(requests)
    names = [request.law.name for request in requests]
    fits_by_model = computed(
        fits_of, [(request,) for request in requests], names, 0, count, progress
    )
    if progress is not None:
        progress("", count, count)
    fitted, failed = parted(chain(*fits_by_model))
    comparison = _compared(fitted, failed, family)
    flags = [*requests[0].throw.read_with, *chosen.words()]
    return replace(
        comparison,
        lacking=_lacking(comparison, family),
        data=replace(comparison.data, flags=tuple(flags)),
    )


def _lacking(comparison: Comparison, family: type[LawFamily] | None) -> Lacking | None:
    """What the first law lacks, if it was fitted with independent noise."""
    fits = {
        candidate.label: fit
        for candidate, fit in zip(comparison.candidates, comparison.fits, strict=True)
        if candidate.rank is not None
        and fit is not None
        and NOISES[candidate.noise].is_white
    }
    if not fits:
        return None
    first = next(iter(fits))
    best = fits.pop(first)
    return lacking(first, best, fits, family)


def _fitted_with_signs(
    request: Request, chosen: Comparing, family: type[LawFamily] | None
) -> list[FittedLaw | Candidate]:
    """The fit of a law and, where it needs a negative coefficient, the
    fit with that."""
    within_bounds = _fitted(request, family, signs_free=False)
    if (
        isinstance(within_bounds, Candidate)
        or within_bounds.candidate.follows
        or chosen.unbounded
    ):
        return [within_bounds]
    at_zero = any(
        coefficient.verdict == Verdict.AT_BOUND
        and coefficient.lower == 0
        and coefficient.value < _ZERO * coefficient.typical
        for coefficient in within_bounds.result.coefficients.values()
    )
    if not at_zero:
        return [within_bounds]
    free = _fitted(with_free_signs(request, chosen), family, signs_free=True)
    if isinstance(free, Candidate) or not free.candidate.negative:
        return [within_bounds]
    return [within_bounds, free]


def _fitted(
    request: Request, family: type[LawFamily] | None, *, signs_free: bool
) -> FittedLaw | Candidate:
    """A law fitted to a throw; the candidate alone where there is no fit."""
    candidate = replace(
        unfitted(request.law, request.load),
        signs_free=signs_free,
        noise=request.noise.kind,
    )
    try:
        result = fit_request(request, details=False, family=family)
    except UnusableFitError as error:
        return replace(candidate, status=str(error))
    likelihood = log_likelihood(result)
    adequate = adequacy(result)
    bulk = None
    loss = LOSSES[result.loss]
    if loss.is_robust:
        residuals = residuals_of(result)
        bulk = {name: loss.size(values) for name, values in residuals.items()}
    candidate = replace(
        with_coefficients(candidate, result.coefficients, result.combinations),
        status=result.status,
        converged=result.converged,
        rms=result.rms,
        bulk=bulk,
        warnings=result.warnings,
        noise_model=result.noise,
        n_parameters=number_of_parameters(result),
        curl_explained=adequate.explained,
        follows=adequate.follows,
        log_likelihood=sum(likelihood.values()),
        sides=sides_of_curl(request.law, request.load, result, family),
        negative=_needed_negative(result),
        fitted={name: result.fitted[name].tolist() for name in PLACE},
    )
    return FittedLaw(candidate, result, likelihood, adequate)


def _needed_negative(result: FitResult) -> tuple[str, ...]:
    """Coefficients below zero at the point of the optimum, possibly a ridge, with the
    smallest sum of negative parts."""
    from scipy.optimize import linprog  # slow to load

    names = [
        coefficient.name
        for coefficient in result.law_class.coefficients()
        if not coefficient.signed
    ]
    value = np.array([result.parameters[name].value for name in names])
    typical = np.array([result.parameters[name].typical for name in names])
    null_directions = result.identifiability.null_directions
    ridge = np.array(
        [[direction.get(name, 0.0) for direction in null_directions] for name in names]
    )
    if ridge.size:
        # minimize the sum of s >= 0 subject to s >= -(value + ridge step)/typical;
        # unknowns are the steps, of any sign, and the negative parts s
        parameters, directions = ridge.shape
        optimum = linprog(
            np.concatenate([np.zeros(directions), np.ones(parameters)]),
            A_ub=np.hstack([-ridge / typical[:, None], -np.eye(parameters)]),
            b_ub=value / typical,
            bounds=[(None, None)] * directions + [(0, None)] * parameters,
        )
        value = value + ridge @ optimum.x[:directions]
    return tuple(compress(names, value < -_ZERO * typical))


def _compared(
    fits: Sequence[FittedLaw],
    failed: Sequence[Candidate],
    family: type[LawFamily] | None,
) -> Comparison:
    """The comparison of laws fitted to one throw, given in the order of the request."""
    first = fits[0].result
    path = fits[0].adequacy
    noises = list(dict.fromkeys(fit.result.noise.kind for fit in fits))
    rankable = [fit for fit in fits if is_rankable(fit.candidate)] or fits
    likeliest = max(rankable, key=lambda fit: fit.log_likelihood)
    effective = effective_values(likeliest.result)
    fits = [
        _changed(fit, **criteria(fit.result, fit.likelihood, effective))
        for fit in _judged_by_size(fits)
    ]
    if not effective.number and len(noises) == 1:
        fits = _with_predictions(fits, family)
    order = best_first([fit.candidate for fit in fits])
    fits = [fits[index] for index in order]
    ranked = with_ranks([fit.candidate for fit in fits])
    return Comparison(
        data=first.data,
        stone=first.stone,
        curl=path.curl,
        side=path.side,
        candidates=(*ranked, *failed),
        observed={name: first.observed[name].tolist() for name in ("t", *PLACE)},
        fits=(*(fit.result for fit in fits), *(None for _ in failed)),
        loss=first.loss,
        noise=",".join(noises),
        effective=effective.number,
    )


def _changed(fit: FittedLaw, **fields: Any) -> FittedLaw:
    """The fit with some fields of its candidate changed."""
    return fit._replace(candidate=replace(fit.candidate, **fields))


def _judged_by_size(fits: Sequence[FittedLaw]) -> list[FittedLaw]:
    """The fits, of which those do not follow the path that leave far larger residuals
    than another, beyond the noise of an ordinary tracker."""
    candidates = [fit.candidate for fit in fits]
    least_sizes = {}
    for name, sigma in NOISE.items():
        sizes = [
            candidate.residual_size[name]
            for candidate in candidates
            if candidate.converged
            and not candidate.negative
            and name in candidate.residual_size
        ]
        least_sizes[name] = max(sigma, min(sizes, default=math.inf))
    judged = []
    for fit in fits:
        sizes_of_fit = fit.candidate.residual_size
        if any(
            sizes_of_fit.get(name, 0.0) > _FAR * least
            for name, least in least_sizes.items()
        ):
            fit = _changed(fit, follows=False)
        judged.append(fit)
    return judged


def _with_predictions(
    fits: Sequence[FittedLaw], family: type[LawFamily] | None
) -> list[FittedLaw]:
    """The fits with evidence and leave-one-out of their candidates, which are valid
    for independent residuals only: a small effective sample size does not determine
    the shape of a likelihood, and a row that is correlated with its neighbours is
    predicted from them whatever the law."""
    predictions = [leave_one_out(fit.result, family) for fit in fits]
    best = max(
        (
            prediction
            for fit, prediction in zip(fits, predictions, strict=True)
            if prediction is not None and is_rankable(fit.candidate)
        ),
        key=lambda prediction: prediction.elpd,
        default=None,
    )
    predicted = []
    for fit, prediction in zip(fits, predictions, strict=True):
        evidence = log_evidence(fit.result, fit.log_likelihood)
        fit = _changed(fit, log_evidence=evidence)
        if prediction is not None:
            fit = _changed(
                fit,
                elpd_loo=prediction.elpd,
                elpd_loo_se=prediction.stderr,
                p_loo=prediction.p_loo,
            )
            if best is not None:
                by_row = prediction.left_out - best.left_out
                fit = _changed(
                    fit,
                    delta_elpd=prediction.elpd - best.elpd,
                    delta_elpd_se=standard_error(by_row),
                )
        predicted.append(fit)
    return predicted
