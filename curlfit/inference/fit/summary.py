"""From an optimum to the record of a fit: what it determines, and its warnings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import NamedTuple, Self

import numpy as np

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.derived.derive import derive
from curlfit.inference.fit.caveats import warnings_of
from curlfit.inference.fit.change_points import with_change
from curlfit.inference.fit.covariance import (
    FitCovariance,
    Sigmas,
    robust_jacobians,
    with_others,
)
from curlfit.inference.fit.departures import (
    NO_DEPARTURES,
    Departures,
    Probe,
    departures_along,
    departures_nearby,
    departures_together,
    probes_about,
    to_be_held,
)
from curlfit.inference.fit.entries import (
    DataOfFit,
    Determined,
    FittedEvent,
    GaussNewtonInformation,
    Outlier,
)
from curlfit.inference.fit.estimates import Estimate, RidgePoint, Systematics
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of, linearized, penalties
from curlfit.inference.fit.products import products_of
from curlfit.inference.fit.residuals import outliers_of, residuals_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.ridge import Followed, Hold, Point, Ridge, follow
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.likelihood import chi_squared_of_many, predict_many
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import ROWS_OF_DATA, Problem
from curlfit.inference.model.request import Request
from curlfit.inference.noise.independence import Independence
from curlfit.inference.noise.whitening import posterior_mean
from curlfit.inference.solve.initial_values import default_guess
from curlfit.inference.solve.least_squares import (
    MOST_STEPS,
    Solution,
    Tasks,
    minimize_many,
)
from curlfit.losses import Loss
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import at, stacked, unstacked
from curlfit.throws.plausibility import examine_fit
from curlfit.throws.throw import CHANNELS

_MOST_STEPS = 60  # of a refit along a ridge
_FEWEST = 3  # values of a channel, above which their correlation is given
# typical sizes by which solutions that fit equally differ in a parameter
_DIFFERENT = 0.1


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
    ridges: Callable[[dict[int, float]], Sequence[Ridge]] | None = None,
    earlier: Sequence[Ridge | None] | None = None,
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
    ridges : of throws that are fitted together, follows the ridge of all with some
        parameters in common held, given by index with their standard errors.
    earlier : of searches that went on, where they had not ended or where the ridge
        leads to a lower point: the ridges followed before.
    """
    if not fits:
        return []
    many = _Many.of(fits, common, others)
    paths = None
    if curves:
        paths = predict_many(many.model, many.solutions.values, many.problems, batch)
    residuals = residuals_of(many.problems, many.solutions, paths)
    searched = many.information(many.solutions.jacobian)
    covariances = many.covariances(searched, residuals)
    departures = many.departures(covariances, searched, batch, ridges, earlier)
    widths = widths or {}
    shifts: list[dict[str, Floats]] = [{}] * len(fits)
    if paths is not None and widths:
        shifts = many.shifts(covariances, searched, paths, widths, batch)
    results = []
    for row, fit in enumerate(fits):
        result = _record(
            fit,
            None if paths is None else paths[row],
            residuals[row],
            covariances[row],
            departures[row],
            shifts[row],
            widths,
            alone=many.alone,
        )
        if not many.alone:
            # What a fit of one throw says of its residuals holds for one of several.
            result = with_change(fit, result)
        results.append(result)
    if earlier is None:
        better = many.searched_on(covariances, departures, batch)
        results_of_better = summarize_many(
            list(better.values()),
            batch,
            curves=curves,
            widths=widths,
            earlier=[departures[row].ridge for row in better],
        )
        for row, result in zip(better, results_of_better, strict=True):
            results[row] = result
    return results


class _Informations(NamedTuple):
    """What is known of throws, along the first axis; of each with what others say of
    the parameters that they have in common."""

    whole: Information
    of_data: Information | None
    """without the priors; None where nothing but the throw's own data is known"""
    others: Information | None
    """what other throws say"""
    marginal: Marginal | None
    """of throws that are fitted together, about the parameters in common"""


class _Many(NamedTuple):
    """Fits of one model and loss, with what they need along the first axis."""

    fits: Sequence[LeastSquaresFit]
    model: Model
    loss: Loss
    requests: list[Request]
    problems: Problem
    solutions: Solution
    bounded: Bounded
    typical: Floats
    penalty: Penalty
    common: Booleans | None
    others: Information | None

    @classmethod
    def of(
        cls,
        fits: Sequence[LeastSquaresFit],
        common: Booleans | None,
        others: Information | None,
    ) -> Self:
        requests = [fit.request for fit in fits]
        solutions = stacked([fit.solution for fit in fits])
        lower, upper = bounds_of(requests, common)
        penalty = penalties(requests)
        if others is not None:
            is_known = (others.scaled != 0).any((0, 1))
            known_names = [*compress(others.names, is_known)]
            is_known = np.isin(requests[0].parameters.names, known_names)
            penalty = penalty._replace(weight=penalty.weight * ~is_known)
        return cls(
            fits=fits,
            model=fits[0].model,
            loss=requests[0].loss,
            requests=requests,
            problems=stacked([fit.problem for fit in fits]),
            solutions=solutions,
            bounded=Bounded(solutions.values, lower, upper),
            typical=requests[0].parameters.typical,
            penalty=penalty,
            common=common,
            others=others,
        )

    @property
    def alone(self) -> bool:
        """Whether each throw is fitted by itself."""
        return self.common is None and self.others is None

    def information(self, jacobian: Floats) -> _Informations:
        """From Jacobians of shape (throws, channels, n, parameters)."""
        of_data = Information.of(
            self.requests[0].parameters.names,
            self.bounded,
            self.typical,
            jacobian,
            self.solutions.residual,
        )
        has_priors = self.penalty.informative
        priors = self.penalty.rows(self.bounded.values)
        if self.common is None:
            if self.others is not None:
                of_data = of_data + self.others
                has_priors = True
            whole = of_data.with_rows(priors)
            return _Informations(
                whole, of_data if has_priors else None, self.others, None
            )
        # Priors of what is in common count once.
        with_own_priors = of_data.with_rows(priors * ~self.common[:, None])
        marginal = with_own_priors.marginal(self.common)
        others = marginal.information.of_others()
        whole = (of_data + others).with_rows(priors)
        if not has_priors:
            return _Informations(whole, None, others, marginal)
        of_data = of_data + of_data.marginal(self.common).information.of_others()
        return _Informations(whole, of_data, others, marginal)

    def covariances(
        self, searched: _Informations, residuals: Floats
    ) -> list[FitCovariance]:
        """Covariance of each throw."""
        estimator = searched
        if self.loss.is_robust:
            estimator = self.information(
                robust_jacobians(self.problems, self.solutions, residuals, self.loss)
            )
        of_data = estimator.of_data
        channels = ROWS_OF_DATA[: self.problems.observed.shape[1]]
        counts = (self.problems.weight > 0).sum(-1)
        covariances = []
        for row, fit in enumerate(self.fits):
            count = counts[row] if self.common is None else counts
            sigmas = Sigmas(
                number=counts[row],
                estimated=np.array([channel in fit.sigma for channel in channels]),
                loss=self.loss,
                total=count.sum(),
            )
            covariance = FitCovariance.of_fit(
                searched.whole.at(row),
                estimator.whole.at(row),
                None if of_data is None else of_data.at(row),
                fit.solution.jacobian,
                sigmas,
            )
            covariances.append(covariance)
        if estimator.marginal is not None:
            covariances = with_others(covariances, estimator.marginal)
        return covariances

    def departures(
        self,
        covariances: Sequence[FitCovariance],
        searched: _Informations,
        batch: int,
        ridges_together: Callable[[dict[int, float]], Sequence[Ridge]] | None,
        earlier: Sequence[Ridge | None] | None,
    ) -> list[Departures]:
        """How chi squared of each throw departs from its quadratic."""
        probes_by_throw = [probes_about(covariance) for covariance in covariances]
        rises_by_throw = self._rises(probes_by_throw, searched, batch)
        departing = [
            [
                (probe, rise)
                for probe, rise in zip(probes, rises, strict=True)
                if probe.departs(rise)
            ]
            for probes, rises in zip(probes_by_throw, rises_by_throw, strict=True)
        ]
        coefficients = self.model.law.coefficients()
        usual = np.array([default_guess(coefficient) for coefficient in coefficients])
        held = [
            to_be_held(covariance, [probe for probe, _ in pairs], len(coefficients))
            for covariance, pairs in zip(covariances, departing, strict=True)
        ]
        if not self.alone:
            together = self._held_together(covariances, departing, held)
            if ridges_together is not None and together:
                ridges = ridges_together(together)
                return [
                    departures_together(covariance, ridge, usual)
                    for covariance, ridge in zip(covariances, ridges, strict=True)
                ]
            return [
                departures_nearby(covariance, pairs)
                for covariance, pairs in zip(covariances, departing, strict=True)
            ]
        departures = [NO_DEPARTURES] * len(covariances)
        beside = self._ridges_beside(earlier)
        due = [row for row, ridges in enumerate(beside) if held[row] or ridges]
        ridges = self._ridges(due, covariances, held, batch)
        for row, ridge in zip(due, ridges, strict=True):
            for other in beside[row]:
                ridge = ridge.joined(other)
            departures[row] = departures_along(covariances[row], ridge, usual)
        return departures

    def _ridges_beside(
        self, earlier: Sequence[Ridge | None] | None
    ) -> list[list[Ridge]]:
        """What is known of each throw besides its own ridge: another solution, and the
        ridge from which its search went on."""
        beside: list[list[Ridge]] = [[] for _ in self.fits]
        for row, fit in enumerate(self.fits):
            if fit.rival is not None:
                priors = self.penalty.at(row)
                beside[row].append(Ridge.of_point(Point.of(fit.rival, priors)))
        for row, ridge in enumerate(earlier or ()):
            if ridge is not None:
                beside[row].append(ridge)
        return beside

    def _held_together(
        self,
        covariances: Sequence[FitCovariance],
        departing: Sequence[Sequence[tuple[Probe, float]]],
        held: Sequence[Sequence[int]],
    ) -> dict[int, float]:
        """Parameters that throws have in common along which their ridge is to be
        followed, by index, with their standard errors; `held` are those of each throw
        by itself."""
        if self.common is None:
            return {}
        of_departing: set[int] = set()
        for pairs, indices in zip(departing, held, strict=True):
            if pairs:
                of_departing.update(indices)
        shared = np.flatnonzero(self.common & covariances[0].open).tolist()
        return {
            index: covariances[0].error_of(index)
            for index in shared
            if index in of_departing
        }

    def _rises(
        self,
        probes_by_throw: Sequence[Sequence[Probe]],
        searched: _Informations,
        batch: int,
    ) -> list[Floats]:
        """Rises of chi squared from the optimum of each throw to its probes."""
        counts = [len(probes) for probes in probes_by_throw]
        points = np.array(
            [probe.point for probes in probes_by_throw for probe in probes]
        )
        if not len(points):
            return [np.zeros(0) for _ in counts]
        owner = np.repeat(np.arange(len(counts)), counts)  # throw of each point
        best = self.solutions.values[owner]
        problems = at(self.problems, owner)
        rises = chi_squared_of_many(self.model, points, problems, batch)
        rises = rises - self.solutions.chi_squared[owner]
        priors = self.penalty.at(owner)
        rises += priors.chi_squared(points) - priors.chi_squared(best)
        if searched.others is not None:
            others = searched.others.at(owner)
            concerned = np.isin(searched.whole.names, others.names)
            rises += others.rise((points - best)[:, concerned])
        rises = np.nan_to_num(rises, nan=np.inf)
        return np.split(rises, np.cumsum(counts)[:-1])

    def _ridges(
        self,
        due: Sequence[int],
        covariances: Sequence[FitCovariance],
        held: Sequence[Sequence[int]],
        batch: int,
    ) -> list[Ridge]:
        """The ridges of throws that are due, followed with these parameters held."""
        _, lowest, highest = self.bounded
        followed = []
        for row in due:
            priors = self.penalty.at(row)
            optimum = Point.of(self.fits[row].solution, priors)
            errors = {index: covariances[row].error_of(index) for index in held[row]}
            fit = Followed(optimum, lowest[row], highest[row], self.typical, errors)
            followed.append(fit)

        def refit(holds: Sequence[Hold]) -> list[Point]:
            rows = [due[hold.fit] for hold in holds]
            starts = [hold.start for hold in holds]
            parameters = [hold.parameter for hold in holds]
            optima = self._minima(rows, starts, parameters, batch, _MOST_STEPS)
            priors = [self.penalty.at(row) for row in rows]
            return list(map(Point.of, optima, priors, parameters))

        return follow(followed, refit)

    def _minima(
        self,
        rows: Sequence[int],
        starts: Sequence[Floats],
        held: Sequence[int | None],
        batch: int,
        most: int = MOST_STEPS,
    ) -> list[Solution]:
        """Optima of throws, by their rows, from initial values; one parameter of each
        may be held at its own."""
        owner = np.array(rows)
        start = np.array(starts)
        _, lower, upper = (part[owner] for part in self.bounded)
        for number, index in enumerate(held):
            if index is not None:
                lower[number, index] = upper[number, index] = start[number, index]
        problems, penalty = at((self.problems, self.penalty), owner)
        tasks = Tasks(problems, start, lower, upper, self.typical, penalty)
        return unstacked(minimize_many(self.model, tasks, batch, most))

    def searched_on(
        self,
        covariances: Sequence[FitCovariance],
        departures: Sequence[Departures],
        batch: int,
    ) -> dict[int, LeastSquaresFit]:
        """Fits by number of throws whose search had not ended, or that the ridge leads
        to a lower point, searched on from there: with all parameters, and with that
        held which the ridge holds, since a search may stall where a stone hardly spins.
        """
        if not self.alone:
            return {}
        owner: list[int] = []
        starts: list[Floats] = []
        held: list[int | None] = []
        for row, (covariance, departure) in enumerate(
            zip(covariances, departures, strict=True)
        ):
            if departure.lower is not None:
                owner += [row, row]
                starts += [departure.lower.values, departure.lower.values]
                held += [departure.lower.held, None]
            elif covariance.distance >= CONVERGED:
                owner.append(row)
                starts.append(self.solutions.values[row])
                held.append(None)
        if not owner:
            return {}
        better: dict[int, LeastSquaresFit] = {}
        optima = self._minima(owner, starts, held, batch)
        for row, optimum in zip(owner, optima, strict=True):
            best = better.get(row, self.fits[row]).solution
            if optimum.objective < best.objective:
                better[row] = self.fits[row]._replace(solution=optimum)
        return better

    def shifts(
        self,
        covariances: Sequence[FitCovariance],
        searched: _Informations,
        paths: Floats,
        widths: Mapping[str, float],
        batch: int,
    ) -> list[dict[str, Floats]]:
        """Shifts of the open parameters of each throw due to conditions, which are
        common to throws that are fitted together."""
        changes = residual_changes(
            self.model,
            self.problems,
            self.solutions.values,
            paths,
            widths,
            batch,
            self.requests,
            jointly=self.common is not None,
        )
        gradients = {}
        for condition, change in changes.items():
            gradient = np.einsum("tcn,tcnp->tp", change, self.solutions.jacobian)
            if searched.marginal is not None:
                gradient = searched.marginal.gradient(gradient)
            gradients[condition] = gradient
        shifts = []
        for row, covariance in enumerate(covariances):
            of_throw = {name: gradient[row] for name, gradient in gradients.items()}
            shifts.append(covariance.shifts(of_throw))
        return shifts


def _record(
    fit: LeastSquaresFit,
    path: Floats | None,
    residual: Floats,
    covariance: FitCovariance,
    departures: Departures,
    shifts: Mapping[str, Floats],
    widths: Mapping[str, float],
    *,
    alone: bool,
) -> FitResult:
    """The record of one fit.

    Parameters
    ----------
    path : the fitted path, shape (channels, n); None without curves.
    residual : measured - fitted, shape (channels, n).
    shifts : of the open parameters, by condition.
    widths : of these conditions.
    alone : whether the throw is fitted by itself.
    """
    law = fit.model.law
    throw = fit.request.throw
    reference = throw.reference
    identifiability = covariance.identifiability
    residual = residual[:, : len(throw)]
    if path is not None:
        path = path[:, : len(throw)]
    curves = {}
    if path is not None:
        curves = dict(zip(CHANNELS, path[: len(CHANNELS)], strict=True))
    series = _by_channel(fit, residual)
    rms = {name: float(np.sqrt(np.mean(off**2))) for name, (off, _) in series.items()}
    enough = {name: both for name, both in series.items() if len(both[0]) > _FEWEST}
    lag1 = {name: Independence.of(off).lag1 for name, (off, _) in enough.items()}
    independence = {name: Independence.of(white) for name, (_, white) in enough.items()}
    rival = _rival(fit)
    distance = covariance.distance
    if departures.distance is not None:
        distance = departures.distance
    estimates = _estimates(fit.request.parameters, covariance, departures, rival)
    outliers = outliers_of(
        throw, residual, lag1, covariance.dof, covariance.leverage, fit.request.loss
    )
    misfit = _misfit(fit, series, outliers)
    unusual = _unusual(fit, estimates["v0"], curves, misfit, alone=alone)
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
    if not products and not shifts:
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


def _by_channel(
    fit: LeastSquaresFit, residual: Floats
) -> dict[str, tuple[Floats, Floats]]:
    """Residuals of each channel at its values: measured - fitted, and
    whitened over sigma."""
    rows = residual.shape[1]
    measured = fit.problem.weight[:, :rows] > 0
    whitened = fit.solution.residual[:, :rows]
    return {
        name: (off[there], white[there])
        for name, there, off, white in zip(
            CHANNELS, measured, residual, whitened, strict=False
        )
        if there.any()
    }


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
    series: Mapping[str, tuple[Floats, Floats]],
    outliers: Sequence[Outlier],
) -> dict[str, float]:
    """Root mean square of the residuals by channel, without outliers from which a
    robust loss protects the fit."""
    misfit = {}
    for name, (off, _) in series.items():
        squares = np.sort(off**2)
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
        prior = parameters.priors.get(name)
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
