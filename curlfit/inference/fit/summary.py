"""From an optimum to the record of a fit: what it determines, and its warnings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from operator import itemgetter
from typing import Any, NamedTuple, Self

import jax
import numpy as np

from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.inference.derived import derive, gradient_of
from curlfit.inference.fit.caveats import warnings_of
from curlfit.inference.fit.change_points import with_change
from curlfit.inference.fit.covariance import (
    CONVERGED,
    Covariance,
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
from curlfit.inference.fit.estimates import Estimate, RidgePoint, Systematics
from curlfit.inference.fit.factors import Factors, Reduction, chi_squared_change
from curlfit.inference.fit.prepared import (
    LeastSquaresFit,
    PreparedThrow,
    linearized,
    local_bounds,
    penalties,
)
from curlfit.inference.fit.residuals import outliers_of, residuals_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.ridge import Followed, Hold, Point, Ridge, follow
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.identifiability import Bounded, r_factors
from curlfit.inference.initial_values import default_guess
from curlfit.inference.least_squares import MOST_STEPS, Solution, Tasks, minimize_many
from curlfit.inference.likelihood import chi_squared_of_many, predict_many
from curlfit.inference.model import Model
from curlfit.inference.noise.models import Independence
from curlfit.inference.noise.whitening import posterior_mean
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import ROWS_OF_DATA, Problem
from curlfit.inference.products import products_of
from curlfit.inference.verdict import Verdict
from curlfit.losses import Loss
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked, unstacked
from curlfit.throws.plausibility import examine_fit
from curlfit.throws.throw import CHANNELS

"""First word of the status of a fit that is impossible for a curling stone."""
_MOST_STEPS = 60
"""Of a refit along a ridge."""
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
    others: Floats | None = None,
    ridges: Callable[[dict[int, float]], Sequence[Ridge]] | None = None,
    earlier: Sequence[Ridge | None] | None = None,
) -> list[FitResult]:
    """The same for fits of one model, loss and noise model, to problems of one shape.

    Parameters
    ----------
    batch : number of paths integrated side by side.
    curves : whether the records contain the fitted curves. Only with white noise and
        least squares can they be omitted.
    widths : of the fixed conditions whose systematic errors the records contain, from
        `systematics.widths_of`; only with curves.
    common : of throws that were fitted together, the parameters that they
        have in common.
    others : rows of what other throws say of the parameters of each, in place of priors
        of these, with the residual as the last column, shape (throws, rows,
        parameters + 1).
    ridges : of throws that are fitted together, follows the ridge of all with some
        parameters in common held, given by index with their standard errors.
    earlier : of searches that went on, where they had not ended or where the ridge
        leads to a lower point: the ridges followed before.
    """
    if not fits:
        return []
    many = _Many.of(fits, common, others)
    paths = (
        predict_many(many.model, many.solutions.values, many.problems, batch)
        if curves
        else None
    )
    residuals = residuals_of(many.problems, many.solutions, paths)
    found, reduction = many.covariances(residuals)
    departures = many.departures(found, reduction, batch, ridges, earlier)
    shifts: list[dict[str, Floats]] = [{}] * len(fits)
    if paths is not None and widths:
        shifts = many.shifts(found, reduction, paths, widths, batch)
    each = [None] * len(fits) if paths is None else paths
    widths_of_each = [widths or {}] * len(fits)
    alone = common is None and others is None
    results = list(
        map(
            _record,
            fits,
            each,
            residuals,
            found,
            departures,
            shifts,
            widths_of_each,
            [alone] * len(fits),
        )
    )
    if not alone:
        # What a fit of one throw says of its residuals holds for one of several too.
        results = list(map(with_change, fits, results))
    if earlier is None:
        better = many.searched_on(found, departures, batch)
        ended = summarize_many(
            list(better.values()),
            batch,
            curves=curves,
            widths=widths,
            earlier=[departures[row].ridge for row in better],
        )
        for row, result in zip(better, ended, strict=True):
            results[row] = result
    return results


class _Many(NamedTuple):
    """Fits of one model and loss, with what they need along the first axis."""

    fits: Sequence[LeastSquaresFit]
    model: Model
    loss: Loss
    throws: list[PreparedThrow]
    problems: Problem
    solutions: Solution
    offset: Floats
    bounded: Bounded
    """in the problems' coordinates"""
    typical: Floats
    penalty: Penalty
    common: Booleans | None
    others: Floats | None

    @classmethod
    def of(
        cls,
        fits: Sequence[LeastSquaresFit],
        common: Booleans | None,
        others: Floats | None,
    ) -> Self:
        throws, solutions = (
            [fit.prepared for fit in fits],
            stacked([fit.solution for fit in fits]),
        )
        offset, *ends = local_bounds(throws, common)
        penalty = penalties(throws)
        if others is not None:
            known = (others[..., :-1] != 0).any((0, 1))
            penalty = penalty._replace(weight=penalty.weight * ~known)
        return cls(
            fits,
            fits[0].model,
            fits[0].loss,
            throws,
            stacked([fit.problem for fit in fits]),
            solutions,
            offset,
            Bounded(solutions.values, *ends),
            throws[0].parameters.typical,
            penalty,
            common,
            others,
        )

    def covariances(
        self, residuals: Floats
    ) -> tuple[list[Covariance], Reduction | None]:
        """Of each throw, and how throws that are fitted together act on one another."""
        solutions, loss = self.solutions, self.loss
        about = self.bounded, self.typical, self.penalty, self.common, self.others
        factors = estimator = Factors.of(
            r_factors(solutions.jacobian, solutions.residual), *about
        )
        if loss.is_robust:
            robust = robust_jacobians(self.problems, solutions, residuals, loss)
            estimator = Factors.of(r_factors(robust, solutions.residual), *about)
        channels = ROWS_OF_DATA[: self.problems.observed.shape[1]]
        number, found = (self.problems.weight > 0).sum(-1), []
        for row, fit in enumerate(self.fits):
            total = number[row if self.common is None else ...].sum()
            known = Sigmas(number[row], np.isin(channels, [*fit.sigma]), loss, total)
            absolute = Bounded(*(part[row] + self.offset[row] for part in self.bounded))
            both = factors.at(row), estimator.at(row)
            found.append(
                Covariance.of(
                    fit.prepared.parameters.names,
                    absolute,
                    self.typical,
                    both,
                    fit.solution.jacobian,
                    known,
                    self.penalty.informative or self.others is not None,
                )
            )
        if estimator.reduction is not None:
            found = with_others(found, estimator.reduction)
        return found, factors.reduction

    def departures(
        self,
        covariances: Sequence[Covariance],
        reduction: Reduction | None,
        batch: int,
        ridges_together: Callable[[dict[int, float]], Sequence[Ridge]] | None,
        earlier: Sequence[Ridge | None] | None,
    ) -> list[Departures]:
        """How chi squared of each throw departs from its quadratic."""
        about = [
            probes_about(covariance, Bounded(*(part[row] for part in self.bounded)))
            for row, covariance in enumerate(covariances)
        ]
        rises = self._rises(about, reduction, batch)
        departing = [
            [
                pair
                for pair in zip(probes, rises_of_throw, strict=True)
                if pair[0].departs(pair[1])
            ]
            for probes, rises_of_throw in zip(about, rises, strict=True)
        ]
        coefficients = self.model.law.coefficients()
        usual = np.array([default_guess(item) for item in coefficients])
        if self.common is not None or self.others is not None:
            together = self._held_together(covariances, departing, len(coefficients))
            if ridges_together is not None and together:
                ridges = ridges_together(together)
                pairs = zip(covariances, ridges, strict=True)
                return [departures_together(*pair, usual) for pair in pairs]
            return [
                departures_nearby(covariance, pairs)
                for covariance, pairs in zip(covariances, departing, strict=True)
            ]
        held = [
            to_be_held(covariance, [probe for probe, _ in pairs], len(coefficients))
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
        covariances: Sequence[Covariance],
        departing: Sequence[Sequence[tuple[Probe, float]]],
        coefficients: int,
    ) -> dict[int, float]:
        """Parameters that throws have in common along which their ridge is to be
        followed, by index, with their standard errors."""
        if self.common is None:
            return {}
        held = {
            index
            for covariance, pairs in zip(covariances, departing, strict=True)
            if pairs
            for index in to_be_held(
                covariance, [probe for probe, _ in pairs], coefficients
            )
        }
        shared = np.flatnonzero(self.common & covariances[0].open).tolist()
        return {
            index: covariances[0].error_of(index) for index in shared if index in held
        }

    def _rises(
        self,
        about: Sequence[Sequence[Probe]],
        reduction: Reduction | None,
        batch: int,
    ) -> list[Floats]:
        """Rises of chi squared from the optimum of each throw to its probes."""
        numbers = [len(probes) for probes in about]
        owner = np.repeat(np.arange(len(about)), numbers)
        points = np.array([probe.point for probes in about for probe in probes])
        points = points.reshape(len(owner), self.solutions.values.shape[1])
        best = self.solutions.values[owner]
        problems = jax.tree.map(itemgetter(owner), self.problems)
        rises = np.zeros(0)
        if len(owner):
            rises = chi_squared_of_many(self.model, points, problems, batch)
        rises = rises - self.solutions.chi_squared[owner]
        priors = self.penalty.at(owner)
        rises += priors.chi_squared(points) - priors.chi_squared(best)
        rows = self.others if reduction is None else reduction.others
        if rows is not None:
            rises += chi_squared_change(rows[owner], points - best)
        rises = np.nan_to_num(rises, nan=np.inf)
        return np.split(rises, np.cumsum(numbers)[:-1])

    def _ridges(
        self,
        due: Sequence[int],
        covariances: Sequence[Covariance],
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
            ends = lowest[row], highest[row]
            followed.append(Followed(optimum, *ends, self.typical, errors))

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
        problems, penalty = jax.tree.map(
            itemgetter(owner), (self.problems, self.penalty)
        )
        tasks = Tasks(problems, start, lower, upper, self.typical, penalty)
        return unstacked(minimize_many(self.model, tasks, batch, most))

    def searched_on(
        self,
        covariances: Sequence[Covariance],
        departures: Sequence[Departures],
        batch: int,
    ) -> dict[int, LeastSquaresFit]:
        """Fits by number of throws whose search had not ended, or that the ridge leads
        to a lower point, searched on from there: with all parameters, and with that
        held which the ridge holds, since a search may stall where a stone hardly spins.
        """
        if self.common is not None or self.others is not None:
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
        found: Sequence[Covariance],
        reduction: Reduction | None,
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
            self.throws,
            jointly=self.common is not None,
        )
        gradients = {}
        for name, change in changes.items():
            gradient = np.einsum("tcn,tcnp->tp", change, self.solutions.jacobian)
            gradients[name] = (
                gradient if reduction is None else reduction.gradient(gradient)
            )
        return [
            one.shifts({name: g[row] for name, g in gradients.items()})
            for row, one in enumerate(found)
        ]


def _record(
    fit: LeastSquaresFit,
    path: Floats | None,
    residual: Floats,
    found: Covariance,
    departures: Departures,
    shifts: Mapping[str, Floats],
    widths: Mapping[str, float],
    alone: bool,
) -> FitResult:
    law, throw, known = fit.model.law, fit.prepared.throw, found.identifiability
    reference, residual = throw.reference, residual[:, : len(throw)]
    path = None if path is None else path[:, : len(throw)]
    curves = _curves(fit, path)
    series = _by_channel(fit, residual)
    enough = {name: pair for name, pair in series.items() if len(pair[0]) > _FEWEST}
    lag1 = {name: Independence.of(off).lag1 for name, (off, _) in enough.items()}
    rival = _rival(fit)
    distance = found.distance
    if departures.distance is not None:
        distance = departures.distance
    estimates = _estimates(fit.prepared.parameters, found, departures, rival)
    outliers = outliers_of(throw, residual, lag1, found.dof, found.leverage, fit.loss)
    misfit = _misfit(fit, series, outliers)
    unusual = _unusual(fit, estimates["v0"], curves, misfit, alone=alone)
    systematics = Systematics()
    if shifts:
        systematics = Systematics(dict(widths), found.shifts_of_determined(shifts))
    result = FitResult(
        law=law.name,
        load=fit.model.load.value,
        stone=fit.prepared.stone,
        data=_data(fit),
        converged=distance < CONVERGED
        and not any(finding.is_refusal for finding in unusual),
        status=_status(fit, distance, unusual),
        warnings=(),
        n_observations=throw.n_observations,
        rms={
            name: float(np.sqrt(np.mean(off**2))) for name, (off, _) in series.items()
        },
        sigma=fit.sigma,
        lag1=lag1,
        parameters=estimates,
        systematics=systematics,
        chi_squared=float(fit.solution.chi_squared),
        prior_chi_squared=float(fit.solution.penalty),
        combinations=tuple(departures.kept(found.combinations)),
        rank=known.rank,
        singular_values=tuple(map(float, known.singular_values)),
        null_directions=known.null_directions,
        covariance={"names": list(known.names), "matrix": known.covariance.tolist()},
        information=found.information(),
        ridge=_ridge_points(fit, departures),
        reference=reference if reference and reference.law == law.name else None,
        observed=_observed(fit),
        fitted=curves,
        discrepancy=_discrepancy(fit, path, found),
        loss=fit.loss.name,
        noise=fit.noise,
        independence={
            name: Independence.of(white) for name, (_, white) in enough.items()
        },
        outliers=outliers,
        events=tuple(
            asdict(event) | {"fitted": event.value - float(off)}
            for event, off in zip(throw.events, residual[-1], strict=False)
        ),
    )
    result = _with_products(result, shifts)
    warnings = warnings_of(fit, result, residual, unusual, rival, departures)
    return replace(result, warnings=warnings)


def _with_products(result: FitResult, shifts: Mapping[str, Floats]) -> FitResult:
    """The result with the products that are determined along its ridge, and with their
    systematic errors, from the shifts of the open parameters by condition."""
    known = result.first_order
    found = products_of(known)
    by_product = {}
    for product in found:
        gradient = gradient_of(known, product.expression)
        by_product[product.expression] = {
            condition: known.across(gradient, shift)
            for condition, shift in shifts.items()
        }
    systematics = result.systematics
    if shifts:
        together = systematics.shifts | by_product
        systematics = replace(systematics, shifts=together)
    known = known._replace(shifts=systematics.shifts, products=tuple(by_product))
    products = tuple(
        replace(derive(known, product.expression), meaning=product.meaning)
        for product in found
    )
    return replace(result, products=products, systematics=systematics)


def _ridge_points(
    fit: LeastSquaresFit, departures: Departures
) -> tuple[RidgePoint, ...]:
    """The ridge in the data's coordinates."""
    if departures.ridge is None:
        return ()
    names = fit.prepared.parameters.names
    points = []
    pairs = zip(departures.ridge.points, departures.ridge.rises, strict=True)
    for point, rise in pairs:
        held = None if point.held is None else names[point.held]
        values = (point.values + fit.prepared.offset).tolist()
        slopes = tuple(map(tuple, point.slopes.tolist()))
        points.append(RidgePoint(held, float(rise), tuple(values), slopes))
    return tuple(points)


def _curves(fit: LeastSquaresFit, path: Floats | None) -> dict[str, Floats]:
    """The fitted path by channel, in the data's coordinates; empty without one."""
    if path is None:
        return {}
    return dict(
        zip(CHANNELS, path[:5] + fit.prepared.origin.place[:, None], strict=True)
    )


def _by_channel(
    fit: LeastSquaresFit, residual: Floats
) -> dict[str, tuple[Floats, Floats]]:
    """Residuals of each channel at its values: measured - fitted, and
    whitened over sigma."""
    there = fit.problem.weight[:, : residual.shape[1]] > 0
    rows = zip(CHANNELS, there, residual, fit.solution.residual, strict=False)
    return {
        name: (off[seen], white[: len(seen)][seen])
        for name, seen, off, white in rows
        if seen.any()
    }


def _data(fit: LeastSquaresFit) -> dict[str, Any]:
    """What was fitted."""
    prepared = fit.prepared
    throw = prepared.throw
    return {
        "file": throw.name,
        "law_file": fit.model.law.origin or None,
        "rows": len(throw) if throw.has_path else 0,
        "from": float(throw.t[0]),
        "to": float(throw.t[-1]),
        **prepared.rows,
        "swept": prepared.swept,
        "sigma": {
            name: "estimated" if name in fit.sigma else "given" for name in throw.seen
        },
        "notes": tuple(throw.notes),
        "labels": dict(throw.labels),
        "flags": list(prepared.flags),
    }


def _observed(fit: LeastSquaresFit) -> dict[str, Floats]:
    """The measured series, and sigmas that were given or vary by row."""
    throw = fit.prepared.throw
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
    fit: LeastSquaresFit, path: Floats | None, found: Covariance
) -> dict[str, Floats]:
    """Mean of the model discrepancy by channel; empty where the noise has none."""
    if path is None or not fit.noise.sizes:
        return {}
    n, prepared = len(fit.prepared.throw), fit.prepared
    adjustable = prepared.parameters.free & ~found.at_bound
    weight = np.array(fit.problem.weight)
    for name, sigma in fit.noise.independent.items():
        weight[CHANNELS.index(name)] *= fit.sigma[name] / sigma
    data = linearized(
        fit.model,
        fit.problem._replace(weight=weight),
        fit.solution.values,
        path,
        prepared.stone,
        prepared.parameters.typical,
        adjustable,
    )
    now = np.zeros_like(data.weight)
    now[: len(weight)] = fit.problem.weight
    mean = posterior_mean(fit.noise, fit.problem.times, now, data)[:, :n]
    return dict(zip(CHANNELS, mean, strict=False))


def _misfit(
    fit: LeastSquaresFit,
    series: Mapping[str, tuple[Floats, Floats]],
    outliers: Sequence[Mapping[str, Any]],
) -> dict[str, float]:
    """Root mean square of the residuals by channel, without outliers from which a
    robust loss protects the fit."""
    misfit = {}
    for name, (off, _) in series.items():
        squares = np.sort(off**2)
        if fit.loss.is_robust:  # outliers are the largest of them
            far = sum(item["channel"] == name for item in outliers)
            squares = squares[: len(squares) - far]
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
    throw = fit.prepared.throw
    speed, start_speed = np.zeros(0), 0.0
    if start.verdict != Verdict.NOT_IDENTIFIABLE:
        speed, start_speed = curves.get("speed", speed), start.value
    t = throw.t[: len(speed)]
    found = examine_fit(throw, t, speed, start_speed, start.stderr, misfit, alone=alone)
    return (*found, *fit.prepared.findings)


def _status(fit: LeastSquaresFit, distance: float, unusual: Sequence[Finding]) -> str:
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
    parameters = fit.prepared.parameters
    apart = np.abs(fit.rival.values - fit.solution.values)
    values = parameters.values_of(fit.rival.values + fit.prepared.offset)
    different = parameters.names_where(apart > _DIFFERENT * parameters.typical)
    return {name: values[name] for name in different}


def _estimates(
    parameters: ParameterSet,
    found: Covariance,
    departures: Departures,
    rival: Mapping[str, float],
) -> dict[str, Estimate]:
    """Estimates by name; see `Estimate` for the verdicts."""
    estimates = {}
    for row, item in enumerate(parameters.parameters):
        stderr, verdict, dof = None, Verdict.FIXED, None
        if item.name not in parameters.fixed:
            stderr, verdict, dof = found.classified(row)
        stderr, verdict, reason = departures.judged(
            item.name, stderr, verdict, item.typical
        )
        prior = parameters.priors.get(item.name)
        if verdict == Verdict.DETERMINED and item.name in rival:
            verdict = Verdict.WEAK
            reason = f"{rival[item.name]:.3g} fits as well"
        estimates[item.name] = Estimate.of(
            item,
            float(found.values[row]),
            verdict,
            reason=reason,
            dof=dof,
            stderr=stderr,
            prior="" if prior is None else str(prior),
        )
    return estimates
