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
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from curlfit.comparison.adequacy import Adequacy, adequacy, sides_of_curl
from curlfit.comparison.candidates import (
    Progress,
    about,
    computed,
    described,
    parted,
    ranked,
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
from curlfit.comparison.result import PLACE, Candidate, Comparison, Lacking
from curlfit.comparison.several import compare_sets
from curlfit.errors import UnusableFitError
from curlfit.friction import Law, Load
from curlfit.friction.family import LawFamily, family_of
from curlfit.friction.registry import laws_under
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.advice import NOISE
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.parameters import options_of, require_known
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES
from curlfit.noises import NOISES, Noise
from curlfit.records import plain
from curlfit.settings.choices import Comparing, takes
from curlfit.throws.friction_table import FrictionTable
from curlfit.throws.throw import Throw, require_path, require_throw

_FAR = 5.0
"""Times the residuals of another law, or the noise of an ordinary tracker, beyond which
a law does not follow a path: 4.1 for the front-back law on the path of eq. 12, 7.7
where friction depends on the speed to the power -0.25."""


class Fitted(NamedTuple):
    """A fit, and what is known of its candidate, by field; more is added as fits
    are compared."""

    known: dict[str, Any]
    result: FitResult
    likelihood: dict[str, float]
    """logarithm, by channel"""
    adequacy: Adequacy

    @property
    def counts(self) -> bool:
        """Whether it is ranked."""
        return self.result.converged and not self.known["signs_free"]

    @property
    def size(self) -> dict[str, float]:
        """Size of the residuals by channel: of their bulk under a robust loss."""
        return self.known.get("bulk") or self.result.rms


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
    require_path(throw)
    chosen = Comparing.of(throw.settings, laws=laws, **choices)
    todo = laws_under(chosen.laws, chosen.load)
    fits = [(law, load, noise) for noise in chosen.noise for law, load in todo]
    options = {**chosen.by_parameter, "start": chosen.start}
    require_known([law for law, _ in todo], options)
    shared = vars(chosen) | {
        "family": family_of(law for law, _ in todo),
        "systematics": {ALL: 0.0},
        "details": False,
    }
    del shared["laws"]

    def fitted(law: type[Law], load: Load, noise: Noise) -> list[Fitted | Candidate]:
        own = options_of(law, options) | {"load": load, "noise": noise}
        return _with_free_signs(throw, law, shared | own)

    names = [law.name for law, *_ in fits]
    found = computed(fitted, fits, names, 0, len(fits), progress)
    if progress is not None:
        progress("", len(fits), len(fits))
    made = _compared(*parted(chain(*found)), shared["family"])
    made = replace(made, lacking=_lacking(made, shared["family"]))
    return replace(
        made, data={**made.data, "flags": [*throw.read_with, *chosen.words()]}
    )


def _lacking(made: Comparison, family: type[LawFamily] | None) -> Lacking | None:
    """What the first law lacks, if it was fitted with independent noise."""
    fits = {
        item.label: one
        for item, one in zip(made.candidates, made.fits, strict=True)
        if item.rank is not None and one is not None and NOISES[item.noise].is_white
    }
    if not fits:
        return None
    first, *others = fits.items()
    return lacking(*first, dict(others), family)


def _with_free_signs(
    throw: Throw, law: type[Law], choices: dict[str, Any]
) -> list[Fitted | Candidate]:
    """The fit of a law and, where it needs a negative coefficient, the
    fit with that."""
    one = _fitted(throw, law, choices, signs_free=False)
    if isinstance(one, Candidate) or one.known["follows"] or choices["unbounded"]:
        return [one]
    at_zero = (
        item.verdict == Verdict.AT_BOUND
        and item.lower == 0
        and item.value < 1e-6 * item.typical
        for item in one.result.coefficients.values()
    )
    if any(at_zero):
        again = _fitted(throw, law, choices | {"unbounded": True}, signs_free=True)
        if isinstance(again, Fitted) and again.known["negative"]:
            return [one, again]
    return [one]


def _fitted(
    throw: Throw, law: type[Law], choices: dict[str, Any], *, signs_free: bool
) -> Fitted | Candidate:
    known = about(law, choices["load"]) | {
        "signs_free": signs_free,
        "noise": choices["noise"].kind,
    }
    try:
        result = fit(throw, law, **choices)
    except UnusableFitError as error:
        return Candidate(**known, status=str(error))
    likelihood, adequate = log_likelihood(result), adequacy(result)
    known |= {
        name: getattr(result, name)
        for name in ("status", "converged", "rms", "warnings")
    }
    known |= described(result.coefficients, result.combinations) | {
        "noise_model": plain(result.noise),
        "n_parameters": number_of_parameters(result),
        "curl_explained": adequate.explained,
        "follows": adequate.follows,
        "log_likelihood": sum(likelihood.values()),
        "sides": sides_of_curl(law, choices["load"], result, choices["family"]),
        "negative": _needed_negative(result),
        "fitted": {name: result.fitted[name].tolist() for name in PLACE},
    }
    loss = LOSSES[result.loss]
    if loss.is_robust:
        residuals = residuals_of(result)
        known["bulk"] = {name: loss.size(r) for name, r in residuals.items()}
    return Fitted(known, result, likelihood, adequate)


def _needed_negative(result: FitResult) -> tuple[str, ...]:
    """Coefficients below zero at the point of the optimum, possibly a ridge, with the
    smallest sum of negative parts."""
    from scipy.optimize import linprog

    names = [item.name for item in result.law_class.coefficients() if not item.signed]
    value = np.array([result.parameters[name].value for name in names])
    typical = np.array([result.parameters[name].typical for name in names])
    ridge = np.array(
        [[row.get(name, 0.0) for row in result.null_directions] for name in names]
    )
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
    return tuple(
        name for name, low in zip(names, value < -1e-6 * typical, strict=True) if low
    )


def _compared(
    found: list[Fitted], failed: Sequence[Candidate], family: type[LawFamily] | None
) -> Comparison:
    """The comparison of fits to one throw, given in the order of the request."""
    first, path = found[0].result, found[0].adequacy
    noises = list(dict.fromkeys(one.result.noise.kind for one in found))
    countable = [one for one in found if one.counts] or found
    likeliest = max(countable, key=lambda one: one.known["log_likelihood"])
    effective = effective_values(likeliest.result)
    for one in found:
        one.known.update(criteria(one.result, one.likelihood, effective))
    _follow(found)
    if not effective.number and len(noises) == 1:
        _add_predictions(found, family)
    found = [found[row] for row in ranked([one.known for one in found])]
    return Comparison(
        data=first.data,
        stone=first.stone,
        curl=path.curl,
        side=path.side,
        candidates=(*(Candidate(**one.known) for one in found), *failed),
        observed={name: first.observed[name].tolist() for name in ("t", *PLACE)},
        fits=(*(one.result for one in found), *(None for _ in failed)),
        loss=first.loss,
        noise=",".join(noises),
        effective=effective.number,
    )


def _follow(found: Sequence[Fitted]) -> None:
    """No law follows the path that leaves far larger residuals than another, beyond the
    noise of an ordinary tracker."""
    able = [one for one in found if one.result.converged and not one.known["negative"]]
    for name, sigma in NOISE.items():
        sizes = [one.size[name] for one in able if name in one.size]
        least = max(sigma, min(sizes, default=math.inf))
        for one in found:
            if one.size.get(name, 0.0) > _FAR * least:
                one.known["follows"] = False


def _add_predictions(found: Sequence[Fitted], family: type[LawFamily] | None) -> None:
    """Evidence and leave-one-out, which are valid for independent residuals only: a
    small effective sample size does not determine the shape of a likelihood, and a row
    that is correlated with its neighbours is predicted from them whatever the law."""
    for one in found:
        one.known["log_evidence"] = log_evidence(
            one.result, one.known["log_likelihood"]
        )
    scored = [
        (one, score) for one in found if (score := leave_one_out(one.result, family))
    ]
    counted = [score for one, score in scored if one.counts]
    best = max(counted, key=lambda score: score.elpd, default=None)
    for one, score in scored:
        one.known.update(
            elpd_loo=score.elpd, elpd_loo_se=score.stderr, p_loo=score.p_loo
        )
        if best is not None:
            one.known["delta_elpd"] = score.elpd - best.elpd
            one.known["delta_elpd_se"] = standard_error(score.left_out - best.left_out)
