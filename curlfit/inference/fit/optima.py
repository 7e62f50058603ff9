"""What the optima of throws determine: to first order, and where chi squared departs
from its quadratic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np

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
from curlfit.inference.fit.fit_covariance import (
    FitCovariance,
    Sigmas,
    robust_jacobians,
    with_others,
)
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of, penalties
from curlfit.inference.fit.residuals import residuals_of
from curlfit.inference.fit.ridge import Followed, Hold, Point, Ridge, follow
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.information import Information, Marginal
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.model.likelihood import chi_squared_of_many, predict_many
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import ROWS_OF_DATA
from curlfit.inference.solve.initial_values import default_guess
from curlfit.inference.solve.least_squares import (
    MOST_STEPS,
    Indices,
    Solution,
    Tasks,
    minimize_many,
)
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import at, stacked, unstacked

_MOST_STEPS_ALONG_RIDGE = 60
"""Of a refit, which begins close to its optimum."""

RidgesTogether = Callable[[dict[int, float]], Sequence[Ridge]]
"""Follows the ridge of throws that are fitted together with some parameters in common
held, given by index with their standard errors; gives the part of each throw."""


class _Informations(NamedTuple):
    """What is known of throws, along the first axis."""

    whole: Information
    """from the data and priors of each throw, and from other throws about what they
    have in common"""
    without_priors: Information | None
    """None where nothing but the throw's own data is known"""
    others: Information | None
    """what other throws say"""
    marginal: Marginal | None
    """of throws that are fitted together, about the parameters in common"""


class _Start(NamedTuple):
    """Where a search begins."""

    row: int
    """of the throw"""
    values: Floats
    held: int | None = None
    """index of a parameter that stays at its value"""


class Optima:
    """Optima of throws of one model, loss and kind of noise, along the first axis.

    Attributes
    ----------
    paths : fitted channels, shape (throws, 5 or 6, n); None if they are not asked for.
    residuals : measured - fitted, shape (throws, channels, n).
    """

    def __init__(
        self,
        fits: Iterable[LeastSquaresFit],
        batch: int,
        *,
        curves: bool,
        common: Booleans | None = None,
        others: Information | None = None,
    ) -> None:
        """Of fits, with arguments as in `summary.summarize_many`."""
        self.fits = list(fits)
        self._batch = batch
        self._common = common
        self._others = others
        self._requests = [fit.request for fit in self.fits]
        self._model = self.fits[0].model
        self._loss = self._requests[0].loss
        self._parameters = self._requests[0].parameters
        self._problems = stacked([fit.problem for fit in self.fits])
        self._solutions = stacked([fit.solution for fit in self.fits])
        lower, upper = bounds_of(self._requests, common)
        self._bounded = Bounded(self._solutions.values, lower, upper)
        self._penalty = self._priors()
        self.paths: Floats | None = None
        if curves:
            values = self._solutions.values
            self.paths = predict_many(self._model, values, self._problems, batch)
        self.residuals = residuals_of(self._problems, self._solutions, self.paths)

    def _priors(self) -> Penalty:
        """The priors of each throw, but for those in whose place other throws tell."""
        priors = penalties(self._requests)
        if self._others is None:
            return priors
        is_told = (self._others.scaled != 0).any((0, 1))
        names = [*compress(self._others.names, is_told)]
        by_others = np.isin(self._parameters.names, names)
        return priors._replace(weight=priors.weight * ~by_others)

    @property
    def are_alone(self) -> bool:
        """Whether each throw is fitted by itself."""
        return self._common is None and self._others is None

    @cached_property
    def _information(self) -> _Informations:
        """As the search has it."""
        return self._information_from(self._solutions.jacobian)

    def _information_from(self, jacobian: Floats) -> _Informations:
        """From Jacobians of shape (throws, channels, n, parameters)."""
        of_data = Information.of(
            self._parameters.names,
            self._bounded,
            self._parameters.typical,
            jacobian,
            self._solutions.residual,
        )
        priors = self._penalty.rows(self._bounded.values)
        if self._common is not None:
            return self._information_together(of_data, priors, self._common)
        if self._others is not None:
            of_data = of_data + self._others
        is_of_data_alone = self._others is None and not self._penalty.informative
        return _Informations(
            whole=of_data.with_rows(priors),
            without_priors=None if is_of_data_alone else of_data,
            others=self._others,
            marginal=None,
        )

    def _information_together(
        self, of_data: Information, priors: Floats, common: Booleans
    ) -> _Informations:
        """Of throws that are fitted together, each with what the others say."""
        # Priors of what is in common count once.
        with_own_priors = of_data.with_rows(priors * ~common[:, None])
        marginal = with_own_priors.marginal(common)
        others = marginal.information.of_others()
        whole = (of_data + others).with_rows(priors)
        without_priors = None
        if self._penalty.informative:
            in_common = of_data.marginal(common).information
            without_priors = of_data + in_common.of_others()
        return _Informations(whole, without_priors, others, marginal)

    @cached_property
    def covariances(self) -> list[FitCovariance]:
        """Covariance of each throw."""
        search = self._information
        estimator = search  # its normal equations are those of the estimates
        if self._loss.is_robust:
            jacobians = robust_jacobians(
                self._problems, self._solutions, self.residuals, self._loss
            )
            estimator = self._information_from(jacobians)
        channels = ROWS_OF_DATA[: self._problems.observed.shape[1]]
        counts = (self._problems.weight > 0).sum(-1)
        covariances = []
        for row, fit in enumerate(self.fits):
            without_priors = None
            if estimator.without_priors is not None:
                without_priors = estimator.without_priors.at(row)
            sigmas = Sigmas(
                number=counts[row],
                estimated=np.array([channel in fit.sigma for channel in channels]),
                loss=self._loss,
                total=counts[row].sum() if self._common is None else counts.sum(),
            )
            covariance = FitCovariance.of_fit(
                search.whole.at(row),
                estimator.whole.at(row),
                without_priors,
                fit.solution.jacobian,
                sigmas,
            )
            covariances.append(covariance)
        if estimator.marginal is not None:
            covariances = with_others(covariances, estimator.marginal)
        return covariances

    def departures(
        self,
        ridges_together: RidgesTogether | None = None,
        earlier: Sequence[Ridge | None] | None = None,
    ) -> list[Departures]:
        """How chi squared of each throw departs from its quadratic.

        Parameters
        ----------
        ridges_together : of throws that are fitted together; without it their ridge is
            not followed.
        earlier : the ridge of each throw that led to this optimum, if any.
        """
        coefficients = self._model.law.coefficients()
        usual = np.array([default_guess(coefficient) for coefficient in coefficients])
        probes_by_throw = self._probes()
        held_by_throw = [
            to_be_held(covariance, probes, len(coefficients))
            for covariance, probes in zip(
                self.covariances, probes_by_throw, strict=True
            )
        ]
        if self.are_alone:
            return self._departures_alone(held_by_throw, usual, earlier)
        held_together = self._held_together(probes_by_throw, held_by_throw)
        if ridges_together is not None and held_together:
            ridges = ridges_together(held_together)
            return [
                departures_together(covariance, ridge, usual)
                for covariance, ridge in zip(self.covariances, ridges, strict=True)
            ]
        return [
            departures_nearby(covariance, probes)
            for covariance, probes in zip(
                self.covariances, probes_by_throw, strict=True
            )
        ]

    def _departures_alone(
        self,
        held_by_throw: Sequence[Sequence[int]],
        usual: Floats,
        earlier: Sequence[Ridge | None] | None,
    ) -> list[Departures]:
        """Of throws that are fitted by themselves, along the ridges of those that have
        parameters to be held, or other solutions."""
        known_by_throw = self._known_ridges(earlier)
        rows = [
            row
            for row, (held, known_ridges) in enumerate(
                zip(held_by_throw, known_by_throw, strict=True)
            )
            if held or known_ridges
        ]
        departures = [NO_DEPARTURES] * len(self.fits)
        for row, ridge in zip(rows, self._ridges(rows, held_by_throw), strict=True):
            for known_ridge in known_by_throw[row]:
                ridge = ridge.joined(known_ridge)
            departures[row] = departures_along(self.covariances[row], ridge, usual)
        return departures

    def _known_ridges(
        self, earlier: Sequence[Ridge | None] | None
    ) -> list[list[Ridge]]:
        """What is known of each throw before its ridge is followed: another solution,
        and the ridge that led to this optimum."""
        known_by_throw: list[list[Ridge]] = [[] for _ in self.fits]
        for row, fit in enumerate(self.fits):
            if fit.rival is not None:
                rival = Point.of(fit.rival, self._penalty.at(row))
                known_by_throw[row].append(Ridge.of_point(rival))
        for row, ridge in enumerate(earlier or ()):
            if ridge is not None:
                known_by_throw[row].append(ridge)
        return known_by_throw

    def _held_together(
        self,
        probes_by_throw: Sequence[Sequence[Probe]],
        held_by_throw: Sequence[Sequence[int]],
    ) -> dict[int, float]:
        """Parameters that throws have in common along which their ridge is to be
        followed, by index, with their standard errors: those to be held of a throw
        whose chi squared departs from its quadratic."""
        if self._common is None:
            return {}
        held: set[int] = set()
        for probes, held_of_throw in zip(probes_by_throw, held_by_throw, strict=True):
            if any(probe.departs for probe in probes):
                held.update(held_of_throw)
        covariance = self.covariances[0]
        shared = np.flatnonzero(self._common & covariance.open).tolist()
        return {index: covariance.error_of(index) for index in shared if index in held}

    def _probes(self) -> list[list[Probe]]:
        """Probes about the optimum of each throw, with their rises of chi squared."""
        rows: list[int] = []
        probes: list[Probe] = []
        for row, covariance in enumerate(self.covariances):
            of_throw = probes_about(covariance)
            rows += [row] * len(of_throw)
            probes += of_throw
        by_throw: list[list[Probe]] = [[] for _ in self.fits]
        if not probes:
            return by_throw
        points = np.array([probe.point for probe in probes])
        rises = self._rises(np.array(rows), points)
        for row, probe, rise in zip(rows, probes, rises.tolist(), strict=True):
            by_throw[row].append(probe.with_rise(rise))
        return by_throw

    def _rises(self, rows: Indices, points: Floats) -> Floats:
        """Rises of chi squared, with what priors and other throws add to it, from the
        optima of throws, by row, to points of them."""
        optima = self._solutions.values[rows]
        problems = at(self._problems, rows)
        chi_squared = chi_squared_of_many(self._model, points, problems, self._batch)
        rises = chi_squared - self._solutions.chi_squared[rows]
        priors = self._penalty.at(rows)
        rises += priors.chi_squared(points) - priors.chi_squared(optima)
        if self._information.others is not None:
            others = self._information.others.at(rows)
            concerned = np.isin(self._parameters.names, others.names)
            rises += others.rise((points - optima)[:, concerned])
        return rises

    def _ridges(
        self, rows: Sequence[int], held_by_throw: Sequence[Sequence[int]]
    ) -> list[Ridge]:
        """The ridges of some throws, by row, each followed with the parameters that are
        to be held."""
        followed = []
        for row in rows:
            covariance = self.covariances[row]
            fit = Followed(
                optimum=Point.of(self.fits[row].solution, self._penalty.at(row)),
                lower=self._bounded.lower[row],
                upper=self._bounded.upper[row],
                typical=self._parameters.typical,
                stderr={
                    index: covariance.error_of(index) for index in held_by_throw[row]
                },
            )
            followed.append(fit)

        def refit(holds: Sequence[Hold]) -> list[Point]:
            starts = [
                _Start(rows[hold.fit], hold.start, hold.parameter) for hold in holds
            ]
            optima = self._minima(starts, _MOST_STEPS_ALONG_RIDGE)
            return [
                Point.of(optimum, self._penalty.at(start.row), start.held)
                for start, optimum in zip(starts, optima, strict=True)
            ]

        return follow(followed, refit)

    def _minima(
        self, starts: Sequence[_Start], most_steps: int = MOST_STEPS
    ) -> list[Solution]:
        """The optima that searches reach."""
        rows = np.array([start.row for start in starts])
        lower = self._bounded.lower[rows]
        upper = self._bounded.upper[rows]
        for number, start in enumerate(starts):
            if start.held is not None:
                value = start.values[start.held]
                lower[number, start.held] = value
                upper[number, start.held] = value
        tasks = Tasks(
            at(self._problems, rows),
            np.array([start.values for start in starts]),
            lower,
            upper,
            self._parameters.typical,
            self._penalty.at(rows),
        )
        return unstacked(minimize_many(self._model, tasks, self._batch, most_steps))

    def searched_on(
        self, departures: Sequence[Departures]
    ) -> dict[int, LeastSquaresFit]:
        """Better fits, by row, of throws whose search had not ended, or whose ridge
        leads to a lower point.

        They are searched on from there with all parameters, and with that held which
        the ridge holds, since a search may stall where a stone hardly spins.
        """
        if not self.are_alone:
            return {}
        starts = []
        for row, covariance in enumerate(self.covariances):
            lower = departures[row].lower
            if lower is not None:
                starts.append(_Start(row, lower.values, lower.held))
                starts.append(_Start(row, lower.values))
            elif covariance.distance >= CONVERGED:
                starts.append(_Start(row, self._solutions.values[row]))
        if not starts:
            return {}
        better: dict[int, LeastSquaresFit] = {}
        for start, optimum in zip(starts, self._minima(starts), strict=True):
            best = better.get(start.row, self.fits[start.row])
            if optimum.objective < best.solution.objective:
                better[start.row] = best._replace(solution=optimum)
        return better

    def shifts(self, widths: Mapping[str, float]) -> list[dict[str, Floats]]:
        """Shifts of the open parameters of each throw due to conditions, which are
        common to throws that are fitted together; none without paths.

        Parameters
        ----------
        widths : of the conditions, from `systematics.widths_of`.
        """
        if self.paths is None or not widths:
            return [{} for _ in self.fits]
        changes = residual_changes(
            self._model,
            self._problems,
            self._solutions.values,
            self.paths,
            widths,
            self._batch,
            self._requests,
            jointly=self._common is not None,
        )
        marginal = self._information.marginal
        gradients = {}
        for condition, change in changes.items():
            gradient = np.einsum("tcn,tcnp->tp", change, self._solutions.jacobian)
            if marginal is not None:
                gradient = marginal.gradient(gradient)
            gradients[condition] = gradient
        shifts = []
        for row, covariance in enumerate(self.covariances):
            of_throw = {name: gradient[row] for name, gradient in gradients.items()}
            shifts.append(covariance.shifts(of_throw))
        return shifts
