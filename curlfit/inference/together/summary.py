"""From a population of throws to what groups and trends do to its mean."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from scipy.special import stdtr

from curlfit.inference.derived.quantiles import Quantiles, quantiles_of
from curlfit.inference.fit.departures import NO_DEPARTURES, Departures
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.parameters import START
from curlfit.inference.sampling.chain import Chain
from curlfit.inference.together.draw import DRAW, Draw
from curlfit.inference.together.effects import (
    Covariates,
    Effect,
    Means,
    with_own_slopes,
)
from curlfit.inference.together.population import Population
from curlfit.inference.together.posterior import Draws
from curlfit.inference.together.result import (
    DeterminedTogether,
    JointResult,
    Variation,
)
from curlfit.inference.together.ridge import JointRidge, errors_of_draw
from curlfit.numerics.arrays import Booleans, Floats

_STEP = 1e-3  # typical sizes, of differences
_FLAT = 1e-4  # m, curl of a law that cannot curl
_UNSEEN = 0.05
"""Share of the change of a draw outside what is determined, above which it is not
known: that of the friction of a draw, which hardly depends on b, is 0.01."""
_ROUGH = 0.5
"""Standard error over value, from which nothing is said of a draw: its 95 % interval
then contains zero."""


def about_mean(
    equal: JointResult,
    population: Population,
    covariates: Covariates,
    draw: Draw,
    throws: tuple[Floats, Floats],
    draws: Draws | None,
    ridge: JointRidge | None = None,
    *,
    of_others: Draws | None = None,
    left_open: Collection[str] = (),
) -> JointResult:
    """The result where throws vary, from that where they are equal.

    Parameters
    ----------
    throws : vectors of the common parameters and initial spins of throws, whose draws
        to the tee have the usual angle.
    draws : from the posterior of the population, whose quantiles are given.
    of_others : from the posterior of the population, for predictions of draws that have
        not been thrown.
    ridge : of equal coefficients, where chi squared is no quadratic.
    left_open : coefficients that ridges of single throws leave open; a bound may hold
        the mean of one, which tells no more of it.
    """
    names = tuple(equal.coefficients)
    covariance = population.of_mean(names)
    departures = NO_DEPARTURES if ridge is None else ridge.departures(covariance)
    coefficients = {}
    for row, (name, estimate) in enumerate(equal.coefficients.items()):
        coefficients[name] = estimate
        if estimate.verdict != Verdict.FIXED:
            coefficients[name] = _of_mean(
                estimate, covariance, row, population.dof, departures, left_open
            )
    undetermined = [
        name for name, estimate in coefficients.items() if not estimate.verdict.is_known
    ]
    open_along = None
    if left_open or ridge is not None:
        open_along = np.isin(names, [*left_open]) & np.isin(names, undetermined)
    least = {}
    if ridge is not None:
        is_common = np.arange(len(names) + len(START)) < len(names)
        least = errors_of_draw(ridge, draw, is_common)
    angle = draw.usual_angle(*throws)
    means = population.means(names, covariates, angle, of_others)
    units = {name: estimate.unit for name, estimate in equal.coefficients.items()}
    quantities = _Quantities.of(
        means, population, draw, units, draws, least, open_along, undetermined
    )
    groups, differences, trend = quantities.effects()
    result = replace(
        equal,
        identifiability=_determined(equal, population),
        means=means,
        coefficients=coefficients,
        combinations=population.combinations(
            departures.kept(covariance.combinations), equal.combinations
        ),
        variation=_with_spreads(equal.variation, population, draws),
        groups=tuple(groups),
        differences=tuple(differences),
        trend=tuple(trend),
        slopes=tuple(quantities.slopes_of_groups(covariates.trend_by)),
        slope_differences=tuple(_slope_differences(quantities, population, covariates)),
    )
    if draws is None:
        return replace(result, r_hat=None)
    chain = _chain(population, means, draws, result.subject)
    return replace(result, r_hat=draws.r_hat, chain=chain)


def _determined(equal: JointResult, population: Population) -> DeterminedTogether:
    """How much throws determine that vary: no more than if they are equal."""
    determined = equal.identifiability
    fixed = sum(
        estimate.verdict == Verdict.FIXED for estimate in equal.coefficients.values()
    )
    undetermined = population.fit.model.null.shape[1] - fixed
    rank = min(determined.rank, determined.parameters - undetermined)
    return replace(determined, rank=rank)


def _with_spreads(
    variations: Sequence[Variation], population: Population, draws: Draws | None
) -> tuple[Variation, ...]:
    """What varies, with the spreads of the population and quantiles of these."""
    spreads = dict(zip(population.weights, population.spreads.tolist(), strict=True))
    quantiles: dict[str, Quantiles] = {}
    if draws is not None:
        for expression, samples in zip(
            population.weights, draws.spreads.T, strict=True
        ):
            quantiles[expression] = quantiles_of(samples)
    return tuple(
        replace(
            variation,
            spread=spreads.get(variation.expression, 0.0),
            shared_stderr=None,
            quantiles=quantiles.get(variation.expression, {}),
        )
        for variation in variations
    )


def _chain(
    population: Population, means: Means, draws: Draws, subject: dict[str, str]
) -> Chain:
    """The draws of what varies, of its changes with groups and trends, and of its
    spreads."""
    size = len(population.typical)
    weights = np.array([*population.weights.values()])
    means_drawn = population.reference + population.typical * draws.estimate[:, :size]
    of_effects = draws.estimate[:, size:]
    values = np.concatenate([means_drawn @ weights.T, of_effects, draws.spreads], 1)
    changes = []
    for by, members in means.groups.items():
        changes += [f"{by} {group} - {members[0]}" for group in members[1:]]
    for along, unit in means.trends.items():
        changes.append(f"{along} per {unit}")
    for by in means.trend_by:
        first_group, *other_groups = means.groups[by]
        for along, unit in means.trends.items():
            changes += [
                f"{by} {group} - {first_group}, {along} per {unit}"
                for group in other_groups
            ]
    varying = list(population.weights)
    values = values[:, None]  # one walker
    return Chain(
        names=(
            *varying,
            *(f"{change}: {name}" for change in changes for name in varying),
            *(f"spread of {name}" for name in varying),
        ),
        values=values,
        log_posterior=np.full(values.shape[:2], np.nan),
        discarded=0,
        ensembles=1,
        seed=draws.seed,
        subject=subject,
    )


def _of_mean(
    equal: Estimate,
    covariance: Covariance,
    row: int,
    dof: float,
    departures: Departures,
    left_open: Collection[str],
) -> Estimate:
    """The estimate of a parameter of the mean, in place of that of equal throws."""
    name = covariance.names[row]
    stderr, verdict, _ = covariance.classified(row)
    stderr, verdict, reason = departures.judged(name, stderr, verdict, equal.typical)
    if verdict == Verdict.AT_BOUND and name in left_open:
        verdict = Verdict.WEAK
        reason = departures.range_of(name)
    return replace(
        equal,
        value=float(covariance.values[row]),
        stderr=stderr,
        verdict=verdict,
        dof=None if stderr is None else dof,
        reason=reason,
    )


def _unknown_of_draw(
    values: Floats,
    slopes: Floats,
    means: Means,
    population: Population,
    open_along: Booleans,
    least: Mapping[str, float],
) -> set[str]:
    """Quantities of a draw that are not known where throws leave coefficients open:
    those that depend on what is open, or that are as uncertain as they are large. Its
    friction is known, as what slows the throws is.

    Parameters
    ----------
    values, slopes : of the quantities of `DRAW`, and their derivatives by the
        coefficients.
    open_along, least : see `_Quantities.of`.
    """
    size = len(population.typical)
    scaled = slopes * population.typical
    along_null = np.linalg.norm(scaled @ population.fit.model.null, axis=1)
    along_open = np.linalg.norm(scaled * open_along, axis=1)
    norm = np.linalg.norm(scaled, axis=1)
    unseen = np.maximum(along_null, along_open) > _UNSEEN * norm
    variances = ((slopes @ means.covariance[:size, :size]) * slopes).sum(1)
    errors = np.sqrt(np.maximum(variances, 0.0))
    errors = np.maximum(errors, [least.get(name, 0.0) for name in DRAW])
    rough = errors >= _ROUGH * np.abs(values)
    return set(itertools.compress(DRAW, unseen | rough)) - {"friction"}


class _Quantities(NamedTuple):
    """What is said of groups and trends: what varies, and a draw to the tee."""

    means: Means
    draw: Draw
    units: dict[str, str]
    """by name of the quantity"""
    weights: Floats
    """of the parameters in what varies"""
    slopes: Floats
    """derivatives by the parameters of the mean, shape (quantities, parameters)"""
    off: Floats
    """samples of the posterior about the estimate, shape (samples, numbers)"""
    least: Floats
    """least errors of the quantities, as far as they move along the ridge"""

    @classmethod
    def of(
        cls,
        means: Means,
        population: Population,
        draw: Draw,
        units: Mapping[str, str],
        draws: Draws | None,
        least: Mapping[str, float],
        open_along: Booleans | None,
        undetermined: Sequence[str],
    ) -> Self:
        """Of a mean; where throws leave coefficients open, without what is then not
        known of a draw.

        Parameters
        ----------
        least : errors of a draw along the ridge; those of first order are no smaller.
        open_along : the coefficients that single throws leave open and all do not
            determine; None where throws leave nothing open. A draw that depends on one
            turns as throws do whose spin is not known either.
        undetermined : coefficients, of which nothing is said by group.
        """
        size = len(population.typical)
        centre = means.estimate[:size]
        steps = _STEP * np.diag(population.typical)
        points = np.concatenate([[centre], centre + steps, centre - steps])
        drawn = draw.quantities(points, means.angle)
        differences = drawn[1 : size + 1] - drawn[size + 1 :]
        slopes = differences.T / (2 * _STEP * population.typical)
        shown = [name for name in DRAW if name != "curl" or drawn[0, 1] > _FLAT]
        if open_along is not None:
            unknown = _unknown_of_draw(
                drawn[0], slopes, means, population, open_along, least
            )
            shown = [name for name in shown if name not in unknown]
        determined = [name for name in population.weights if name not in undetermined]
        weights = np.array([population.weights[name] for name in determined])
        weights = weights.reshape(len(determined), size)
        units_of_determined = {name: units.get(name, "1") for name in determined}
        units_of_draw = {name: DRAW[name] for name in shown}
        off = np.zeros((0, size))
        if draws is not None:
            off = population.scale * (draws.estimate - population.fit.estimate)
        return cls(
            means=means,
            draw=draw,
            units=units_of_determined | units_of_draw,
            weights=weights,
            slopes=np.concatenate([weights, slopes[np.isin([*DRAW], shown)]]),
            off=off,
            least=np.array([least.get(name, 0.0) for name in (*determined, *shown)]),
        )

    def effects(self) -> tuple[list[Effect], list[Effect], list[Effect]]:
        """Of all throws and of the groups; differences of these from the first one of
        the same label; and one unit along the trends."""
        means = self.means
        at_all = means.of_groups({})
        groups = self._effects(means.at(at_all), self._values(at_all[None])[0])
        differences: list[Effect] = []
        trend: list[Effect] = []
        for by, members in means.groups.items():
            columns = np.array([means.of_groups({by: group}) for group in members])
            matrices = means.at(columns)
            values = self._values(columns)
            for row, group in enumerate(members):
                groups += self._effects(matrices[row], values[row], by=by, group=group)
                if row > 0:
                    differences += self._effects(
                        matrices[row] - matrices[0],
                        values[row] - values[0],
                        tested=True,
                        by=by,
                        group=group,
                        against=members[0],
                    )
        for along, unit in means.trends.items():
            matrix = means.at(means.along_trend(along)) - means.at(0 * at_all)
            change = self.slopes @ matrix @ means.estimate
            trend += self._effects(matrix, change, tested=True, by=along, per=unit)
        return groups, differences, trend

    def slopes_of_groups(
        self, labels: Iterable[str], *, compared: bool = False
    ) -> list[Effect]:
        """The changes along each trend of the groups of some labels; `compared` with
        that of the first group of the label, of the others."""
        means = self.means
        at_mean = means.at(means.of_groups({}))
        slopes: list[Effect] = []
        for by, (along, unit) in itertools.product(labels, means.trends.items()):
            members = means.groups[by]
            changes = {
                group: means.at(means.along_trend(along, {by: group})) - at_mean
                for group in members
            }
            first = members[0] if compared else ""
            for group, to in changes.items():
                if group == first:
                    continue
                if compared:
                    to = to - changes[first]
                slopes += self._effects(
                    to,
                    self.slopes @ to @ means.estimate,
                    tested=True,
                    by=by,
                    per=unit,
                    along=along,
                    group=group,
                    against=first,
                )
        return slopes

    def _values(self, columns: Floats) -> Floats:
        """The quantities where covariates have some values, shape
        (points, quantities)."""
        points = self.means.at(columns) @ self.means.estimate
        drawn = self.draw.quantities(points, self.means.angle)
        return np.concatenate(
            [points @ self.weights.T, drawn[:, np.isin([*DRAW], [*self.units])]], 1
        )

    def _effects(
        self,
        matrix: Floats,
        values: Floats,
        *,
        tested: bool = False,
        per: str = "1",
        by: str = "",
        **about: str,
    ) -> list[Effect]:
        """Records of values that move with the numbers of the mean.

        Parameters
        ----------
        matrix : parameters of the mean by its numbers: times the slopes, the
            derivatives of the values.
        tested : whether zero is told from the values, by Student's t.
        per : unit of what the values are changes along.
        """
        dof = self.means.dof
        slopes = self.slopes @ matrix
        variances = np.einsum("ij,jk,ik->i", slopes, self.means.covariance, slopes)
        errors = np.sqrt(np.maximum(variances, 0.0))
        if not tested:
            errors = np.maximum(errors, self.least)
        effects = []
        for row, (name, unit) in enumerate(self.units.items()):
            value = float(values[row])
            error = float(errors[row])
            p_value = None
            if tested and error:
                p_value = 2 * float(stdtr(dof, -abs(value) / error))
            quantiles: Quantiles = {}
            if len(self.off):
                quantiles = quantiles_of(value + self.off @ slopes[row])
            effects.append(
                Effect(
                    name,
                    value,
                    error,
                    dof,
                    p_value,
                    by,
                    unit=unit if per == "1" else f"{unit}/{per}",
                    quantiles=quantiles,
                    **about,
                )
            )
        return effects


def _slope_differences(
    of_equal_slopes: _Quantities, population: Population, covariates: Covariates
) -> list[Effect]:
    """The differences of slopes between the groups of each label. Where all groups of a
    label have one slope, they are those of a second fit, to the same quadratics of the
    throws, in which each has its own; none where throws do not distinguish them."""
    if not covariates.trends:
        return []
    differences: list[Effect] = []
    for label in covariates.groups:
        quantities = of_equal_slopes
        if label not in covariates.trend_by:
            own_slopes = with_own_slopes(population.fit, covariates, label)
            if own_slopes is None:
                continue
            population = population._replace(fit=own_slopes.fit)
            equal_means = of_equal_slopes.means
            means = population.means(
                equal_means.names, own_slopes.covariates, equal_means.angle
            )
            none_off = of_equal_slopes.off[:0]
            quantities = of_equal_slopes._replace(means=means, off=none_off)
        differences += quantities.slopes_of_groups([label], compared=True)
    return differences
