"""What an evening of draws tells that were timed and taped, not tracked.

A draw gives a few numbers: times between lines, where it came to rest, its curl, its
turns. They hold its friction and how strongly it curls, and these may differ from draw
to draw, between sheets and along the evening. They hold next to nothing of how friction
and curl depend on speed and spin, which is the same for all draws: such a coefficient
has the prior of what is `usual` on other ice, so that its uncertainty is in every
standard error, and an evening that does tell it (by two times of each draw, or by turns
that differ) has its own.

With one time and its rest a draw has as many numbers along the sheet as unknowns, its
speed and its friction. Then only a comparison of draws could tell how friction depends
on speed, and it misleads: of draws to one place, those that met less friction went
farther, as they would if friction fell with speed. Of 40 simulated evenings under
constant friction, such comparisons made an exponent of -0.25 +- 0.25 one of -0.34 +-
0.16. So the prior of such a coefficient stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from curlfit.friction import Law
from curlfit.friction.sums import Sum
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.priors import Normal
from curlfit.numerics.mixed_model import added_by_cut
from curlfit.settings.choices import Fitting
from curlfit.throws.throw import Throw

_ALONG = ("time", "y", "speed")
"""Quantities that tell how a draw moves along the sheet."""
_UNKNOWNS = 2
"""Of this motion: the speed of a draw, and its friction."""


def same_in_all(
    throws: Sequence[Throw], law: type[Law]
) -> dict[str, tuple[float, float]]:
    """Coefficients that are the same for all draws of an evening, with mean and
    standard deviation on other ice; none if one of the throws has a path."""
    if any(throw.has_path for throw in throws):
        return {}
    return {
        coefficient.name: coefficient.usual
        for coefficient in law.coefficients()
        if coefficient.usual
    }


def with_usual_priors(
    throws: Sequence[Throw], chosen: Sequence[Fitting], law: type[Law]
) -> list[Fitting]:
    """The choices of throws, with priors of the coefficients that are the same in all,
    unless a choice names them."""
    named = _named(chosen[0])
    usual = {
        name: f"{mean!r}+-{deviation!r}"
        for name, (mean, deviation) in same_in_all(throws, law).items()
        if name not in named
    }
    return [replace(choice, priors={**choice.priors, **usual}) for choice in chosen]


def untold(
    throws: Sequence[Throw], chosen: Sequence[Fitting], law: type[Law]
) -> dict[str, Normal]:
    """What is usual on other ice of coefficients of how draws are slowed that none of
    these draws tells; without those that a choice names."""
    for throw in throws:
        along = [event for event in throw.events if event.quantity in _ALONG]
        if len(along) > _UNKNOWNS:
            return {}
    named = _named(chosen[0])
    slowing = _slowing(law)
    return {
        name: Normal(mean, deviation)
        for name, (mean, deviation) in same_in_all(throws, law).items()
        if name in slowing and name not in named
    }


def untold_by(throw: Throw, law: type[Law]) -> set[str]:
    """Coefficients of what turns a draw aside, where neither its path nor its curl was
    measured: what others say of them stays."""
    curl_is_known = any(event.quantity == "x" for event in throw.events)
    if throw.has_path or curl_is_known:
        return set()
    return {coefficient.name for coefficient in law.coefficients()} - _slowing(law)


def with_untold(fit: FitResult, untold: Mapping[str, Normal]) -> FitResult:
    """A throw that was fitted with what is untold held at its mean, with the
    uncertainty of that, and what follows from it for the other parameters."""
    covariance = fit.covariance
    names = [name for name in untold if name in covariance.names]
    if not names:
        return fit
    which = np.array([covariance.names.index(name) for name in names])
    variances = np.array([untold[name].sd ** 2 for name in names])
    added = added_by_cut(covariance.matrix, which, variances)
    parameters = by_prior(fit.parameters, untold)
    for name, variance in zip(covariance.names, np.diagonal(added), strict=True):
        estimate = parameters[name]
        if estimate.stderr is not None:
            stderr = math.sqrt(estimate.stderr**2 + variance)
            parameters[name] = replace(estimate, stderr=stderr)
    information = fit.information
    squares = information.matrix.copy()
    rows = [information.names.index(name) for name in names]
    held = covariance.among(names)
    squares[np.ix_(rows, rows)] += np.diag(1 / variances) - np.linalg.inv(held)
    return replace(
        fit,
        parameters=parameters,
        covariance=replace(covariance, matrix=covariance.matrix + added),
        information=replace(information, matrix=squares),
    )


def by_prior(
    estimates: Mapping[str, Estimate], untold: Collection[str]
) -> dict[str, Estimate]:
    """Estimates, of which those of what is untold are what is usual on other ice."""
    as_usual = dict(estimates)
    for name in estimates.keys() & set(untold):
        as_usual[name] = replace(as_usual[name], verdict=Verdict.PRIOR, reason="")
    return as_usual


def _named(choice: Fitting) -> set[str]:
    """Parameters of which a choice says something."""
    return {name for of_names in choice.by_parameter.values() for name in of_names}


def _slowing(law: type[Law]) -> set[str]:
    """Coefficients of the law, or of those parts of a sum, that slow a stone."""
    parts = law.parts if issubclass(law, Sum) else (law,)
    return {
        coefficient.name
        for part in parts
        if part.brakes
        for coefficient in part.coefficients()
    }
