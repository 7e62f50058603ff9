"""From a population of throws to what groups and trends do to its mean."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.inference.derived import Quantiles, quantiles_of
from curlfit.inference.fit.covariance import Covariance
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.summary import weakness
from curlfit.inference.identifiability import Combination
from curlfit.inference.joint.draw import DRAW, Draw
from curlfit.inference.joint.effects import Covariates, Effect, Means
from curlfit.inference.joint.population import Population
from curlfit.inference.joint.posterior import Draws
from curlfit.inference.joint.result import Variation
from curlfit.numerics.arrays import Floats

_STEP = 1e-3  # typical sizes, of differences
_FLAT = 1e-4  # m, curl of a law that cannot curl


def varying_fields(
    found: Population,
    coefficients: Mapping[str, Estimate],
    combinations: Iterable[Combination],
    variation: Iterable[Variation],
    covariates: Covariates,
    bounds: tuple[Floats, Floats],
    draw: Draw,
    values: Floats,
    spins: Floats,
    draws: Draws | None = None,
) -> dict[str, Any]:
    """The fields of a joint fit whose throws vary.

    Parameters
    ----------
    coefficients, combinations, variation : of equal throws. bounds : of the coefficients.
    values, spins : those of throws, whose draws to the tee have the usual angle.
    draws : from the posterior of the population.
    """
    known = found.of_mean(list(coefficients), *bounds)
    units = {name: item.unit for name, item in coefficients.items()}
    spreads = dict(zip(found.varying, map(float, found.spreads), strict=True))
    angle = float(np.median(np.abs(draw.angle(values, spins))))
    drawn = partial(draw.quantities, angle=angle)
    effects = Effects.of(found, covariates, drawn, units, draws)
    of_spreads = {} if draws is None else dict(
        zip(found.varying, map(quantiles_of, draws.spreads.T), strict=True)
    )  # fmt: skip
    return effects._asdict() | {
        "r_hat": None if draws is None else draws.r_hat,
        "means": _means(found, covariates, tuple(coefficients), angle),
        "coefficients": {
            name: one if one.verdict == "fixed" else _of_mean(one, known, row, found.dof)
            for row, (name, one) in enumerate(coefficients.items())
        },
        "combinations": found.combinations(known.combinations, combinations),
        "variation": tuple(
            replace(
                one,
                spread=spreads.get(one.expression, 0.0),
                shared_stderr=None,
                quantiles=of_spreads.get(one.expression, {}),
            )
            for one in variation
        ),
    }


def _of_mean(item: Estimate, known: Covariance, row: int, dof: float) -> Estimate:
    stderr, verdict, _ = known.classified(row)
    return replace(
        item, value=float(known.values[row]), stderr=stderr, verdict=verdict,
        dof=None if stderr is None else dof, reason=weakness(verdict, item.typical),
    )  # fmt: skip


def _means(
    found: Population, covariates: Covariates, names: tuple[str, ...], angle: float
) -> Means:
    effects = len(found.fit.estimate) - len(found.typical)
    scale = np.append(found.typical, np.ones(effects))
    return Means(
        names=names,
        groups=covariates.groups,
        trends=covariates.trends,
        centre=covariates.mean,
        last=covariates.values[-1],
        estimate=np.append(found.reference, np.zeros(effects)) + scale * found.fit.estimate,
        covariance=scale[:, None] * found.fit.covariance * scale,
        directions=found.typical[:, None] * found.fit.model.directions,
        spreads=found.spreads,
        dof=found.dof,
        angle=angle,
    )


class Effects(NamedTuple):
    """All of a joint fit."""

    groups: tuple[Effect, ...]
    differences: tuple[Effect, ...]
    trend: tuple[Effect, ...]

    @classmethod
    def of(
        cls,
        found: Population,
        covariates: Covariates,
        drawn: Callable[[Floats], Floats],
        units: Mapping[str, str],
        draws: Draws | None = None,
    ) -> Self:
        """Of a population; `drawn` are the quantities of a draw by vectors of the parameters in
        common, `units` those of the coefficients, `draws` are from the posterior."""
        told, at = _Quantities.of(found, drawn, units, draws), found.fit.at
        nothing = 0 * covariates.mean
        groups = told.effects(at(nothing), told.values(nothing[None])[0])
        differences, trend = [], []
        for by, members in covariates.groups.items():
            columns = np.array([covariates.of_group(by, name) for name in members])
            to, values = at(columns), told.values(columns)
            for row, group in enumerate(members):
                groups += told.effects(to[row], values[row], by=by, group=group)
                if row:
                    by_group = {"by": by, "group": group, "against": members[0]}
                    off = values[row] - values[0]
                    differences += told.effects(to[row] - to[0], off, tested=True, **by_group)
        for along, unit in covariates.trends.items():
            to = at(covariates.of_trend(along)) - at(nothing)
            change = told.slopes @ to @ found.fit.estimate
            trend += told.effects(to, change, tested=True, by=along, per=unit)
        return cls(tuple(groups), tuple(differences), tuple(trend))


class _Quantities(NamedTuple):
    """What is said of groups and trends: what varies, and a draw to the tee."""

    found: Population
    drawn: Callable[[Floats], Floats]
    units: dict[str, str]
    """by name of the quantity"""
    slopes: Floats
    """derivatives by the parameters of the mean in typical sizes, shape (quantities, parameters)"""
    draws: Draws | None

    @classmethod
    def of(
        cls,
        found: Population,
        drawn_at: Callable[[Floats], Floats],
        units: Mapping[str, str],
        draws: Draws | None,
    ) -> Self:
        steps = _STEP * np.diag(found.typical)
        centre, size = found.of_mean_at(np.zeros(found.fit.model.covariates.shape[1])), len(steps)
        drawn = drawn_at(np.concatenate([[centre], centre + steps, centre - steps]))
        slopes = (drawn[1 : size + 1] - drawn[size + 1 :]).T / (2 * _STEP)
        shown = {name: unit for name, unit in DRAW.items() if name != "curl" or drawn[0, 1] > _FLAT}
        names = {name: units.get(name, "1") for name in found.varying} | shown
        kept = np.isin([*DRAW], [*shown])
        whole = np.concatenate([found.weights * found.typical, slopes[kept]])
        return cls(found, drawn_at, names, whole, draws)

    def values(self, columns: Floats) -> Floats:
        """The quantities where covariates have some values, shape (points, quantities)."""
        points = self.found.of_mean_at(columns)
        drawn = self.drawn(points)[:, np.isin([*DRAW], [*self.units])]
        return np.concatenate([points @ self.found.weights.T, drawn], 1)

    def effects(
        self, to: Floats, values: Floats, *, tested: bool = False, per: str = "1", by: str = "",
        **group: str,
    ) -> list[Effect]:  # fmt: skip
        """Values whose changes are the slopes times `to`, a matrix, times those of the estimate."""
        from scipy.special import stdtr  # slow to load

        matrix, dof, made = self.slopes @ to, self.found.dof, []
        errors = np.sqrt(np.einsum("ij,jk,ik->i", matrix, self.found.fit.covariance, matrix))
        sampled: list[Quantiles] = [{}] * len(values)
        if self.draws is not None:
            off = (self.draws.estimate - self.found.fit.estimate) @ matrix.T
            sampled = [*map(quantiles_of, (values + off).T)]
        for (name, unit), value, error, quantiles in zip(
            self.units.items(), values, errors, sampled, strict=True
        ):
            p = 2 * float(stdtr(dof, -abs(value) / error)) if tested and error else None
            unit = unit if per == "1" else f"{unit}/{per}"
            made.append(
                Effect(
                    name, float(value), float(error), dof, p, by, unit=unit, quantiles=quantiles,
                    **group,
                )
            )  # fmt: skip
        return made
