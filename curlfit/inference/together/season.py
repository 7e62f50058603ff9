"""Throws that were fitted one by one, about a mean that may depend on groups and drift.

To first order about its optimum, the log-likelihood of a throw is a quadratic in the
coefficients of the law, and that is all that a second fit needs of it. Where it is no
quadratic, the throw says twice what it says: exactly, where its ridge leaves it, and as
roughly as the ridge is wide (`curlfit.inference.information.ridge_information`). The
place of the estimate on its ridge is no matter of chance: ridges of throws alike bend
the same way, and the mean of many estimates is no nearer to the truth than one. So what
throws say roughly counts once, for all of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.findings import Finding, Remedy
from curlfit.friction import Coefficient
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.information import Information
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_NAMES
from curlfit.inference.model.problem import LEVEL_AND_STILL
from curlfit.inference.model.system import motions
from curlfit.inference.together.advice import warnings_of_slopes
from curlfit.inference.together.alone import ThrowsAlone
from curlfit.inference.together.draw import TIMES, Draw
from curlfit.inference.together.effects import Covariates, Labelled
from curlfit.inference.together.population import LinearizedThrows, Population
from curlfit.inference.together.posterior import sampled
from curlfit.inference.together.result import (
    DeterminedTogether,
    JointResult,
    SeparateFits,
    StartOfThrow,
)
from curlfit.inference.together.summary import about_mean
from curlfit.inference.together.variation import (
    Varying,
    variations_of,
    weights_of_known,
)
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone

_TURNING = 200  # throws from which the usual angle of a draw is taken
_FEWEST = 4


class Season(NamedTuple):
    """Throws that were fitted one by one with the same law."""

    file: str
    model: Model
    stone: Stone
    labels: Labelled
    values: Floats
    """of the coefficients, shape (throws, coefficients)"""
    start: Floats
    """initial states, shape (throws, 6)"""
    durations: Floats
    """of the records, s"""
    coefficient_rows: Floats
    """by each, see `coefficient_rows`; of a throw with a ridge, the first
    part of `coefficient_rows_along_ridge` (`inference.fit.coefficient_rows`)"""
    notes: tuple[Finding, ...]
    conditions: tuple[str, ...] = ()
    """that each throw has for itself"""
    stretched: Floats = np.zeros((0, 0, 0))
    """by throws with a ridge, its second part; zero of others, and empty where there
    are none"""
    left_open: tuple[tuple[str, ...], ...] = ()
    """by throw, coefficients that its ridge leaves open"""

    def rows(self, share: float = 1.0) -> Floats:
        """All that throws say of the coefficients, with a share of what they say
        roughly."""
        if not self.stretched.any():
            return self.coefficient_rows
        return np.concatenate([self.coefficient_rows, share**0.5 * self.stretched], 1)

    @property
    def share(self) -> float:
        """Share of one throw in what all say roughly."""
        return 1.0 / max(int(self.stretched.any((1, 2)).sum()), 1)

    def counts_left_open(self) -> dict[str, int]:
        """Numbers of throws by coefficient that they leave open."""
        counts = Counter(name for names in self.left_open for name in names)
        return {
            coefficient.name: counts[coefficient.name]
            for coefficient in self.model.law.coefficients()
            if coefficient.name in counts
        }

    def warnings(self) -> tuple[Finding, ...]:
        """What the throws leave open, and what would help."""
        counts = self.counts_left_open()
        if not counts:
            return ()
        names_by_count: dict[int, list[str]] = {}
        for name, count in counts.items():
            names_by_count.setdefault(count, []).append(name)
        left = [
            {"count": count, "names": names} for count, names in names_by_count.items()
        ]
        remedy = Remedy("angle-or-spin")
        throws = len(self.left_open)
        return (Finding.warning("left-open", remedy, left=left, throws=throws),)

    def summary(
        self, by: Iterable[str], null_directions: tuple[dict[str, float], ...]
    ) -> SeparateFits:
        """What a prediction of another throw needs besides the mean."""
        parameters = np.column_stack([self.values, self.start])
        state, _ = motions(self.model, parameters, self.stone, LEVEL_AND_STILL, TIMES)
        # velocities and spins, shape (throws, 3, times)
        rates_by_throw = state[:, 3:]
        rates_at_end = [
            [np.interp(duration, TIMES, series) for series in rates]
            for duration, rates in zip(self.durations, rates_by_throw, strict=True)
        ]
        *velocity, spins = np.concatenate([rates_by_throw[..., 0], rates_at_end]).T
        speeds = np.hypot(*velocity)
        ends_of_spins = []
        for of_one_sense in (spins[spins < 0], spins[spins >= 0]):
            if len(of_one_sense):
                ends_of_spins += [of_one_sense.min(), of_one_sense.max()]
        last_rows = {
            tuple((name, labels[name]) for name in by): row
            for row, (_, labels) in enumerate(self.labels)
            if not self.conditions
        }
        starts = [
            StartOfThrow(
                labels=dict(labels),
                start=dict(zip(START_NAMES, self.start[row].tolist(), strict=True)),
            )
            for labels, row in sorted(last_rows.items(), key=itemgetter(1))
        ]
        return SeparateFits(
            file=self.file,
            throws=len(self.coefficient_rows),
            stone=self.stone,
            notes=self.notes,
            starts=tuple(starts),
            duration=float(self.durations.max()),
            speeds=np.array([speeds.min(), speeds.max()]),
            spins=np.array(ends_of_spins),
            null_directions=null_directions,
        )


def _linearized(season: Season, share: float) -> LinearizedThrows:
    """The throws about their own optima, with a share of what they say roughly; the
    reference is their median."""
    laws_coefficients = season.model.law.coefficients()
    typical = np.array([coefficient.typical for coefficient in laws_coefficients])
    lower = np.array([coefficient.lower for coefficient in laws_coefficients])
    upper = np.array([coefficient.upper for coefficient in laws_coefficients])
    reference = np.clip(np.median(season.values, axis=0), lower, upper)
    table = season.rows(share)
    rows = table[..., :-1]
    free = rows.any((0, 1)) | (np.ptp(season.values, axis=0) > 0)
    bounded = Bounded(
        season.values,
        np.broadcast_to(np.where(free, lower, reference), season.values.shape),
        np.broadcast_to(np.where(free, upper, reference), season.values.shape),
    )
    residual = (rows @ season.values[..., None])[..., 0] - table[..., -1]
    names = [coefficient.name for coefficient in laws_coefficients]
    information = Information.of(names, bounded, typical, rows, residual)
    return LinearizedThrows(information, reference)


def _joined(throws: LinearizedThrows, varying: Varying, columns: Floats) -> Population:
    """The mean of throws."""
    weights, spreads = varying
    projected = throws.along(throws.projection(weights, columns, spreads))
    return projected.joined(weights, columns, spreads)


def _equal(
    throws: LinearizedThrows, laws_coefficients: Sequence[Coefficient]
) -> tuple[Covariance, dict[str, Estimate]]:
    """What all throws say if they are equal."""
    nothing = Varying({}, np.zeros(0))
    same = np.zeros((len(throws.information.rows), 0))
    names = [coefficient.name for coefficient in laws_coefficients]
    covariance = _joined(throws, nothing, same).of_mean(names)
    estimates = {}
    for row, coefficient in enumerate(laws_coefficients):
        verdict = Verdict.FIXED
        if throws.free[row]:
            _, verdict, _ = covariance.classified(row)
        value = float(throws.reference[row])
        estimates[coefficient.name] = Estimate.of(coefficient, value, verdict)
    return covariance, estimates


def mean_of(
    season: Season,
    by: str | Sequence[str],
    trend: str | Sequence[str],
    seed: int | None,
    trend_by: str | Sequence[str] = (),
) -> JointResult:
    """The mean of throws, how they vary about it, and what groups and trends do.

    Parameters
    ----------
    by, trend, seed, trend_by : as in `fit_together`.

    Raises
    ------
    InputError : too few throws; labels that a throw lacks, or that give no groups or
        numbers; throws that determine nothing.
    """
    count = len(season.coefficient_rows)
    if count < _FEWEST:
        raise InputError(
            f"{season.file}: {count} usable throws; expected {_FEWEST} or more"
        )
    covariates = Covariates.of(season.labels, by, trend, trend_by)
    laws_coefficients = season.model.law.coefficients()
    throws = _linearized(season, season.share)
    covariance, coefficients = _equal(throws, laws_coefficients)
    verdicts = {name: estimate.verdict for name, estimate in coefficients.items()}
    if Verdict.AT_BOUND in verdicts.values():
        # What one throw leaves open may have gone there to explain what differs
        # between them.
        root = count**-0.5
        rows = root * throws.information.rows
        as_one = throws._replace(information=replace(throws.information, rows=rows))
        covariance, coefficients = _equal(as_one, laws_coefficients)
        verdicts = {name: estimate.verdict for name, estimate in coefficients.items()}
    known_weights = weights_of_known(
        verdicts, covariance.combinations, tuple(coefficients)
    )
    rows = season.rows()[..., :-1]
    alone = ThrowsAlone(season.values, rows, throws.typical, [{}] * count)
    variations = variations_of(alone, rows, known_weights, covariates.values)
    varying = Varying.of(rows, known_weights, variations, throws.typical)
    if not varying.weights:
        raise InputError(f"{season.file}: a throw determines no coefficient by itself")
    equal = JointResult(
        law=season.model.law.name,
        load=season.model.load,
        share=tuple(coefficients),
        converged=True,
        status=f"converged ({count} throws that were fitted one by one)",
        warnings=season.warnings(),
        coefficients=coefficients,
        combinations=covariance.combinations,
        identifiability=DeterminedTogether(
            rank=covariance.identifiability.rank, parameters=int(throws.free.sum())
        ),
        variation=tuple(variations.values()),
        table=season.summary(
            covariates.groups, covariance.identifiability.null_directions
        ),
    )
    population = _joined(throws, varying, covariates.values)
    turning = np.linspace(0, count - 1, min(count, _TURNING)).astype(int)
    result = about_mean(
        equal,
        population,
        covariates,
        Draw(season.model, season.stone),
        (season.values[turning], season.start[turning, -1]),
        sampled(population.fit, varying.first_spreads, seed),
        left_open=season.counts_left_open(),
    )
    warnings = (*result.warnings, *warnings_of_slopes(result))
    return replace(result, warnings=warnings)
