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
from curlfit.inference.together.result import JointResult
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
    found: Population,
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
    of_others : the same, for predictions of draws that have not been thrown.
    ridge : of equal coefficients, where chi squared is no quadratic.
    left_open : coefficients that ridges of single throws leave open; a bound may hold
        the mean of one, which tells no more of it.
    """
    names = tuple(equal.coefficients)
    known, angle = found.of_mean(names), float(np.median(np.abs(draw.angle(*throws))))
    departures = NO_DEPARTURES if ridge is None else ridge.departures(known)
    means = found.means(names, covariates, angle, of_others)
    units = {name: item.unit for name, item in equal.coefficients.items()}
    coefficients = {
        name: one
        if one.verdict == Verdict.FIXED
        else _of_mean(one, known, row, found.dof, departures, left_open)
        for row, (name, one) in enumerate(equal.coefficients.items())
    }
    undetermined = [
        name for name, one in coefficients.items() if not one.verdict.is_known
    ]
    open_along = None
    if left_open or ridge is not None:
        open_along = np.isin(names, [*left_open]) & np.isin(names, undetermined)
    common = np.ones(len(names) + len(START), bool)
    common[len(names) :] = False
    least = {} if ridge is None else errors_of_draw(ridge, draw, common)
    quantities = _Quantities.of(
        means, found, draw, units, draws, least, open_along, undetermined
    )
    groups, differences, trend = map(tuple, quantities.effects())
    slope_differences = _slope_differences(quantities, found, covariates)
    spreads = dict(zip(found.weights, map(float, found.spreads), strict=True))
    sampled: dict[str, Quantiles] = {}
    if draws is not None:
        sampled = dict(zip(spreads, map(quantiles_of, draws.spreads.T), strict=True))
    fixed = sum(item.verdict == Verdict.FIXED for item in equal.coefficients.values())
    open_ = found.fit.model.null.shape[1] - fixed
    result = replace(
        equal,
        identifiability=replace(
            equal.identifiability,
            rank=min(
                equal.identifiability.rank, equal.identifiability.parameters - open_
            ),
        ),
        r_hat=None if draws is None else draws.r_hat,
        means=means,
        coefficients=coefficients,
        combinations=found.combinations(
            departures.kept(known.combinations), equal.combinations
        ),
        variation=tuple(
            replace(
                one,
                spread=spreads.get(one.expression, 0.0),
                shared_stderr=None,
                quantiles=sampled.get(one.expression, {}),
            )
            for one in equal.variation
        ),
        groups=groups,
        differences=differences,
        trend=trend,
        slopes=tuple(quantities.slopes_of_groups(covariates.trend_by)),
        slope_differences=tuple(slope_differences),
    )
    if draws is None:
        return result
    return replace(result, chain=_chain(found, means, draws, result.subject))


def _chain(
    found: Population, means: Means, draws: Draws, subject: dict[str, str]
) -> Chain:
    """The draws of what varies."""
    size = len(found.typical)
    weights = np.array([*found.weights.values()])
    of_mean = (found.reference + found.typical * draws.estimate[:, :size]) @ weights.T
    values = np.concatenate([of_mean, draws.estimate[:, size:], draws.spreads], 1)[
        :, None
    ]
    changes = [
        f"{by} {one} - {members[0]}"
        for by, members in means.groups.items()
        for one in members[1:]
    ] + [f"{along} per {unit}" for along, unit in means.trends.items()]
    changes += [
        f"{by} {one} - {means.groups[by][0]}, {along} per {unit}"
        for by in means.trend_by
        for along, unit in means.trends.items()
        for one in means.groups[by][1:]
    ]
    varies = list(found.weights)
    return Chain(
        names=(
            *varies,
            *(f"{change}: {name}" for change in changes for name in varies),
            *(f"spread of {name}" for name in varies),
        ),
        values=values,
        log_posterior=np.full(values.shape[:2], np.nan),
        discarded=0,
        ensembles=1,
        seed=draws.seed,
        subject=subject,
    )


def _of_mean(
    item: Estimate,
    known: Covariance,
    row: int,
    dof: float,
    departures: Departures,
    left_open: Collection[str],
) -> Estimate:
    stderr, verdict, _ = known.classified(row)
    name = known.names[row]
    stderr, verdict, reason = departures.judged(name, stderr, verdict, item.typical)
    if verdict == Verdict.AT_BOUND and name in left_open:
        verdict = Verdict.WEAK
        reason = departures.range_of(name)
    return replace(
        item,
        value=float(known.values[row]),
        stderr=stderr,
        verdict=verdict,
        dof=None if stderr is None else dof,
        reason=reason,
    )


def _unknown_of_draw(
    values: Floats,
    slopes: Floats,
    means: Means,
    found: Population,
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
    size = len(found.typical)
    scaled = slopes * found.typical
    along_null = np.linalg.norm(scaled @ found.fit.model.null, axis=1)
    along_open = np.linalg.norm(scaled * open_along, axis=1)
    whole = np.linalg.norm(scaled, axis=1)
    unseen = np.maximum(along_null, along_open) > _UNSEEN * whole
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
        found: Population,
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
        size = len(found.typical)
        centre = means.estimate[:size]
        steps = _STEP * np.diag(found.typical)
        points = np.concatenate([[centre], centre + steps, centre - steps])
        drawn = draw.quantities(points, means.angle)
        differences = drawn[1 : size + 1] - drawn[size + 1 :]
        slopes = differences.T / (2 * _STEP * found.typical)
        shown = [name for name in DRAW if name != "curl" or drawn[0, 1] > _FLAT]
        if open_along is not None:
            unknown = _unknown_of_draw(
                drawn[0], slopes, means, found, open_along, least
            )
            shown = [name for name in shown if name not in unknown]
        known = [name for name in found.weights if name not in undetermined]
        weights = np.array([found.weights[name] for name in known])
        weights = weights.reshape(len(known), size)
        units_of_known = {name: units.get(name, "1") for name in known}
        units_of_draw = {name: DRAW[name] for name in shown}
        off = np.zeros((0, size))
        if draws is not None:
            off = found.scale * (draws.estimate - found.fit.estimate)
        return cls(
            means=means,
            draw=draw,
            units=units_of_known | units_of_draw,
            weights=weights,
            slopes=np.concatenate([weights, slopes[np.isin([*DRAW], shown)]]),
            off=off,
            least=np.array([least.get(name, 0.0) for name in (*known, *shown)]),
        )

    def effects(self) -> tuple[list[Effect], list[Effect], list[Effect]]:
        """Of all throws and of the groups; differences of these from the first one of
        the same label; and one unit along the trends."""
        means, nothing = self.means, self.means.of_groups({})
        groups = self._effects(means.at(nothing), self._values(nothing[None])[0])
        differences: list[Effect] = []
        trend: list[Effect] = []
        for by, members in means.groups.items():
            columns = np.array([means.of_groups({by: one}) for one in members])
            each = list(
                zip(members, means.at(columns), self._values(columns), strict=True)
            )
            first, to, values = each[0]
            for group, own, of_group in each:
                groups += self._effects(own, of_group, by=by, group=group)
                if group != first:
                    differences += self._effects(
                        own - to,
                        of_group - values,
                        tested=True,
                        by=by,
                        group=group,
                        against=first,
                    )
        for along, unit in means.trends.items():
            to = means.at(means.along_trend(along)) - means.at(0 * nothing)
            change = self.slopes @ to @ means.estimate
            trend += self._effects(to, change, tested=True, by=along, per=unit)
        return groups, differences, trend

    def slopes_of_groups(
        self, labels: Iterable[str], *, compared: bool = False
    ) -> list[Effect]:
        """The changes along each trend of the groups of some labels; `compared` with
        that of the first group of the label, of the others."""
        means = self.means
        at_mean = means.at(means.of_groups({}))
        found: list[Effect] = []
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
                found += self._effects(
                    to,
                    self.slopes @ to @ means.estimate,
                    tested=True,
                    by=by,
                    per=unit,
                    along=along,
                    group=group,
                    against=first,
                )
        return found

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
        to: Floats,
        values: Floats,
        *,
        tested: bool = False,
        per: str = "1",
        by: str = "",
        **about: str,
    ) -> list[Effect]:
        """Values whose changes are the slopes times `to`, a matrix, times those of
        the estimate."""
        matrix, dof, made = self.slopes @ to, self.means.dof, []
        variances = np.einsum("ij,jk,ik->i", matrix, self.means.covariance, matrix)
        errors = np.sqrt(np.maximum(variances, 0.0))
        if not tested:
            errors = np.maximum(errors, self.least)
        for row, (name, unit) in enumerate(self.units.items()):
            value, error = float(values[row]), float(errors[row])
            p = 2 * float(stdtr(dof, -abs(value) / error)) if tested and error else None
            unit = unit if per == "1" else f"{unit}/{per}"
            samples = value + self.off @ matrix[row] if len(self.off) else None
            quantiles = {} if samples is None else quantiles_of(samples)
            made.append(
                Effect(
                    name,
                    value,
                    error,
                    dof,
                    p,
                    by,
                    unit=unit,
                    quantiles=quantiles,
                    **about,
                )
            )
        return made


def _slope_differences(
    of_equal_slopes: _Quantities, found: Population, covariates: Covariates
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
            own_slopes = with_own_slopes(found.fit, covariates, label)
            if own_slopes is None:
                continue
            population = found._replace(fit=own_slopes.fit)
            equal_means = of_equal_slopes.means
            means = population.means(
                equal_means.names, own_slopes.covariates, equal_means.angle
            )
            none_off = of_equal_slopes.off[:0]
            quantities = of_equal_slopes._replace(means=means, off=none_off)
        differences += quantities.slopes_of_groups([label], compared=True)
    return differences
