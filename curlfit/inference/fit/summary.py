"""From an optimum to the record of a fit: what it determines, and its warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.derived.derive import derive
from curlfit.inference.fit.caveats import warnings_of
from curlfit.inference.fit.change_points import with_change
from curlfit.inference.fit.departures import Departures
from curlfit.inference.fit.entries import (
    DataOfFit,
    Determined,
    FittedEvent,
    GaussNewtonInformation,
    Outlier,
)
from curlfit.inference.fit.estimates import Estimate, RidgePoint, Systematics
from curlfit.inference.fit.fit_covariance import FitCovariance
from curlfit.inference.fit.optima import Optima, RidgesTogether
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import linearized
from curlfit.inference.fit.products import products_of
from curlfit.inference.fit.residuals import outliers_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.information import Information
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.noise.independence import Independence
from curlfit.inference.noise.whitening import posterior_mean
from curlfit.inference.solve.least_squares import MOST_STEPS
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.channels import CHANNELS
from curlfit.throws.plausibility import examine_fit

_FEWEST = 3
"""Values of a channel, above which their correlation is given."""
_DIFFERENT = 0.1
"""Typical sizes by which solutions that fit equally differ in a parameter."""


def summarize(
    fit: LeastSquaresFit, widths: Mapping[str, float] | None = None
) -> FitResult:
    """The record of a fit from its optimum."""
    (result,) = summarize_many([fit], 1, widths=widths)
    return result


def summarize_many(
    fits: Sequence[LeastSquaresFit],
    batch: int,
    *,
    curves: bool = True,
    widths: Mapping[str, float] | None = None,
    common: Booleans | None = None,
    others: Information | None = None,
    ridges: RidgesTogether | None = None,
) -> list[FitResult]:
    """The records of fits of one model, loss and noise model, to problems of one shape.

    Parameters
    ----------
    batch : number of paths integrated side by side.
    curves : whether the records contain the fitted curves. Only with white noise and
        least squares can they be omitted.
    widths : of the fixed conditions whose systematic errors the records contain, from
        `systematics.widths_of`; only with curves.
    common : of throws that were fitted together, the parameters that they
        have in common.
    others : what other throws say of some parameters of each, in place of priors of
        these; a stack.
    ridges : follows the ridge of throws that were fitted together; without it, it is
        not followed.
    """
    if not fits:
        return []
    widths = widths or {}
    optima = Optima(fits, batch, curves=curves, common=common, others=others)
    departures = optima.departures(ridges)
    results = _records(optima, departures, widths)
    better = optima.searched_on(departures)
    if better:
        better_optima = Optima(better.values(), batch, curves=curves)
        earlier = [departures[row].ridge for row in better]
        departures = better_optima.departures(earlier=earlier)
        better_results = _records(better_optima, departures, widths)
        for row, result in zip(better, better_results, strict=True):
            results[row] = result
    return results


def _records(
    optima: Optima, departures: Sequence[Departures], widths: Mapping[str, float]
) -> list[FitResult]:
    """The records of optima, with the systematic errors due to conditions of these
    widths."""
    shifts = optima.shifts(widths)
    results = []
    for row, fit in enumerate(optima.fits):
        result = _record(optima, row, departures[row], shifts[row], widths)
        if not optima.are_alone:
            # What a fit of one throw says of its residuals holds for one of several.
            result = with_change(fit, result)
        results.append(result)
    return results


class _ChannelResiduals(NamedTuple):
    """Residuals of a channel at its values."""

    off: Floats
    """measured - fitted"""
    whitened: Floats
    """over sigma, and independent under the noise model"""


def _record(
    optima: Optima,
    row: int,
    departures: Departures,
    shifts: Mapping[str, Floats],
    widths: Mapping[str, float],
) -> FitResult:
    """The record of one fit.

    Parameters
    ----------
    row : of the throw.
    departures : of its chi squared from the quadratic.
    shifts : of its open parameters, by condition.
    widths : of these conditions.
    """
    fit = optima.fits[row]
    covariance = optima.covariances[row]
    identifiability = covariance.identifiability
    law = fit.model.law
    throw = fit.request.throw
    reference = throw.reference
    residual = optima.residuals[row][:, : len(throw)]
    path = None
    curves = {}
    if optima.paths is not None:
        path = optima.paths[row][:, : len(throw)]
        curves = dict(zip(CHANNELS, path[: len(CHANNELS)], strict=True))
    by_channel = _by_channel(fit, residual)
    rms = {}
    lag1 = {}
    independence = {}
    for name, residuals in by_channel.items():
        rms[name] = float(np.sqrt(np.mean(residuals.off**2)))
        if len(residuals.off) > _FEWEST:
            lag1[name] = Independence.of(residuals.off).lag1
            independence[name] = Independence.of(residuals.whitened)
    rival = _rival(fit)
    distance = covariance.distance
    if departures.distance is not None:
        distance = departures.distance
    estimates = _estimates(fit.request.parameters, covariance, departures, rival)
    outliers = outliers_of(
        throw, residual, lag1, covariance.dof, covariance.leverage, fit.request.loss
    )
    misfit = _misfit(fit, by_channel, outliers)
    unusual = _unusual(fit, estimates["v0"], curves, misfit, alone=optima.are_alone)
    is_refused = any(finding.is_refusal for finding in unusual)
    systematics = Systematics()
    if shifts:
        systematics = Systematics(dict(widths), covariance.shifts_of_determined(shifts))
    events = [
        FittedEvent.of(event, event.value - float(off))
        for event, off in zip(throw.events, residual[-1], strict=False)
    ]
    result = FitResult(
        law=law.name,
        load=fit.model.load,
        stone=fit.request.stone,
        data=_data(fit),
        converged=distance < CONVERGED and not is_refused,
        status=_status(fit, distance, unusual),
        warnings=(),
        n_observations=throw.n_observations,
        rms=rms,
        sigma=fit.sigma,
        lag1=lag1,
        parameters=estimates,
        systematics=systematics,
        chi_squared=float(fit.solution.chi_squared),
        prior_chi_squared=float(fit.solution.penalty),
        combinations=tuple(departures.kept(covariance.combinations)),
        identifiability=Determined(
            rank=identifiability.rank,
            singular_values=tuple(map(float, identifiability.singular_values)),
            null_directions=identifiability.null_directions,
        ),
        covariance=NamedMatrix(
            tuple(identifiability.names), identifiability.covariance
        ),
        information=_information_of(covariance),
        ridge=_ridge_points(fit, departures),
        reference=reference if reference and reference.law == law.name else None,
        observed=_observed(fit),
        fitted=curves,
        discrepancy=_discrepancy(fit, path, covariance),
        loss=fit.request.loss.name,
        noise=fit.noise,
        independence=independence,
        outliers=outliers,
        events=tuple(events),
    )
    result = _with_products(result, shifts)
    warnings = warnings_of(fit, result, residual, unusual, rival, departures)
    return replace(result, warnings=warnings)


def _information_of(covariance: FitCovariance) -> GaussNewtonInformation:
    """What is said of the free parameters to first order, for the record."""
    information = covariance.unconfined.only(covariance.free)
    return GaussNewtonInformation(
        names=information.names,
        matrix=information.normal_matrix,
        gradient=information.gradient,
    )


def _with_products(result: FitResult, shifts: Mapping[str, Floats]) -> FitResult:
    """The result with the products that are determined along its ridge, and with their
    systematic errors, from the shifts of the open parameters by condition."""
    first_order = result.first_order
    products = products_of(first_order)
    if not products:
        return result
    shifts_of_products = {}
    for product in products:
        gradient = first_order.gradient_of(product.expression)
        shifts_of_products[product.expression] = {
            condition: first_order.across(gradient, shift)
            for condition, shift in shifts.items()
        }
    systematics = result.systematics
    if shifts:
        systematics = replace(
            systematics, shifts=systematics.shifts | shifts_of_products
        )
    first_order = first_order._replace(
        shifts=systematics.shifts, products=tuple(shifts_of_products)
    )
    derived = tuple(
        replace(derive(first_order, product.expression), meaning=product.meaning)
        for product in products
    )
    return replace(result, products=derived, systematics=systematics)


def _ridge_points(
    fit: LeastSquaresFit, departures: Departures
) -> tuple[RidgePoint, ...]:
    """The points of the ridge, by the names of the parameters."""
    ridge = departures.ridge
    if ridge is None:
        return ()
    names = fit.request.parameters.names
    points = []
    for point, rise in zip(ridge.points, ridge.rises.tolist(), strict=True):
        held = None if point.held is None else names[point.held]
        values = tuple(point.values.tolist())
        slopes = tuple(tuple(row) for row in point.slopes.tolist())
        points.append(RidgePoint(held, rise, values, slopes))
    return tuple(points)


def _by_channel(fit: LeastSquaresFit, residual: Floats) -> dict[str, _ChannelResiduals]:
    """Residuals of the measured channels.

    Parameters
    ----------
    residual : measured - fitted, shape (channels, n).
    """
    rows = residual.shape[1]
    is_measured = fit.problem.weight[:, :rows] > 0
    whitened = fit.solution.residual[:, :rows]
    by_channel = {}
    for row, name in enumerate(CHANNELS[: len(residual)]):
        measured = is_measured[row]
        if measured.any():
            by_channel[name] = _ChannelResiduals(
                residual[row, measured], whitened[row, measured]
            )
    return by_channel


def _data(fit: LeastSquaresFit) -> DataOfFit:
    """What was fitted."""
    request = fit.request
    throw = request.throw
    sigma = {name: "estimated" if name in fit.sigma else "given" for name in throw.seen}
    return DataOfFit(
        file=throw.name,
        law_file=fit.model.law.origin or None,
        rows=len(throw) if throw.has_path else 0,
        begin=float(throw.t[0]),
        end=float(throw.t[-1]),
        **request.rows,
        swept=request.swept,
        sigma=sigma,
        notes=tuple(throw.notes),
        labels=dict(throw.labels),
        flags=tuple(request.flags),
    )


def _observed(fit: LeastSquaresFit) -> dict[str, Floats]:
    """The measured series, and sigmas that were given or vary by row."""
    throw = fit.request.throw
    shown = [
        name for name in CHANNELS if name in throw.seen or name in ("x", "y", "phi")
    ]
    by_row = throw.sigma | {
        name: fit.sigma[name] * throw.sigma_over_smallest(name)
        for name in throw.relative_sigma.keys() & fit.sigma.keys()
    }
    sigmas = {f"sigma_{name}": by_row[name] for name in CHANNELS if name in by_row}
    return {name: getattr(throw, name) for name in ("t", *shown)} | sigmas


def _discrepancy(
    fit: LeastSquaresFit, path: Floats | None, covariance: FitCovariance
) -> dict[str, Floats]:
    """Mean of the model discrepancy by channel; empty where the noise has none."""
    if path is None or not fit.noise.sizes:
        return {}
    request = fit.request
    weight_of_independent = np.array(fit.problem.weight)
    for name, sigma in fit.noise.independent.items():
        weight_of_independent[CHANNELS.index(name)] *= fit.sigma[name] / sigma
    data = linearized(
        fit.model,
        fit.problem._replace(weight=weight_of_independent),
        fit.solution.values,
        path,
        request.stone,
        request.parameters.typical,
        request.parameters.free & ~covariance.at_bound,
    )
    weight = np.zeros_like(data.weight)
    weight[: len(fit.problem.weight)] = fit.problem.weight
    mean = posterior_mean(fit.noise, fit.problem.times, weight, data)
    return dict(zip(CHANNELS, mean[:, : len(request.throw)], strict=False))


def _misfit(
    fit: LeastSquaresFit,
    by_channel: Mapping[str, _ChannelResiduals],
    outliers: Sequence[Outlier],
) -> dict[str, float]:
    """Root mean square of the residuals by channel, without outliers from which a
    robust loss protects the fit."""
    misfit = {}
    for name, residuals in by_channel.items():
        squares = np.sort(residuals.off**2)
        if fit.request.loss.is_robust:  # outliers are the largest of them
            far = [outlier for outlier in outliers if outlier.channel == name]
            squares = squares[: len(squares) - len(far)]
        misfit[name] = float(np.sqrt(squares.mean())) if len(squares) else 0.0
    return misfit


def _unusual(
    fit: LeastSquaresFit,
    start: Estimate,
    curves: dict[str, Floats],
    misfit: Mapping[str, float],
    *,
    alone: bool,
) -> tuple[Finding, ...]:
    """What is implausible in the data and in the fitted motion."""
    throw = fit.request.throw
    speed = np.zeros(0)
    start_speed = 0.0
    if start.verdict != Verdict.NOT_IDENTIFIABLE:
        speed = curves.get("speed", speed)
        start_speed = start.value
    t = throw.t[: len(speed)]
    of_motion = examine_fit(
        throw, t, speed, start_speed, start.stderr, misfit, alone=alone
    )
    return (*of_motion, *fit.request.findings)


def _status(fit: LeastSquaresFit, distance: float, unusual: Sequence[Finding]) -> str:
    """Whether the search has converged, in words; `distance` to the optimum is in
    standard errors."""
    steps = counted(int(fit.solution.steps), "step")
    if fit.tried > 1:
        steps += f", best of {fit.tried} starts"
    refused = [str(finding) for finding in unusual if finding.is_refusal]
    if refused:
        return f"implausible: {'. '.join(refused)}"
    if distance >= CONVERGED:
        return (
            f"not converged: the optimum is still about {distance:.2g} standard "
            f"errors away ({steps})"
        )
    if not fit.solution.success:
        # Before the limit, a search ends where no step is accepted however short it is.
        stopped = "at the limit of" if fit.solution.steps >= MOST_STEPS else "after"
        return (
            f"stopped {stopped} {steps}, about {distance:.1g} standard errors "
            "from an optimum"
        )
    if unusual:
        return f"converged ({steps}), but the data are unusual: see the first warning"
    return f"converged ({steps})"


def _rival(fit: LeastSquaresFit) -> dict[str, float]:
    """Parameters that differ in another solution that fits as well, with their values
    there; empty without one."""
    if fit.rival is None:
        return {}
    parameters = fit.request.parameters
    apart = np.abs(fit.rival.values - fit.solution.values)
    values = parameters.values_of(fit.rival.values)
    different = parameters.names_where(apart > _DIFFERENT * parameters.typical)
    return {name: values[name] for name in different}


def _estimates(
    parameters: ParameterSet,
    covariance: FitCovariance,
    departures: Departures,
    rival: Mapping[str, float],
) -> dict[str, Estimate]:
    """Estimates by name; see `Estimate` for the verdicts."""
    estimates = {}
    for index, parameter in enumerate(parameters.parameters):
        name = parameter.name
        prior = parameters.priors.get(name)
        stderr = None
        verdict = Verdict.FIXED
        reason = ""
        dof = None
        if name not in parameters.fixed:
            stderr, verdict, dof = covariance.classified(index)
            stderr, verdict, reason = departures.judged(
                name, stderr, verdict, parameter.typical
            )
        if verdict == Verdict.DETERMINED and name in rival:
            verdict = Verdict.WEAK
            reason = f"{rival[name]:.3g} fits as well"
        estimates[name] = Estimate.of(
            parameter,
            float(covariance.values[index]),
            verdict,
            reason=reason,
            dof=dof,
            stderr=stderr,
            prior="" if prior is None else str(prior),
        )
    return estimates
