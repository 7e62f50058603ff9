"""From a population of throws to what groups and trends do to its mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np

from curlfit.inference.joint.draw import DRAW, Draw
from curlfit.inference.joint.effects import Covariates, Effect, Means
from curlfit.inference.joint.population import Population
from curlfit.numerics.arrays import Floats

_STEP = 1e-3  # typical sizes, of differences


def means_of(found: Population, covariates: Covariates, names: tuple[str, ...]) -> Means:
    """The record of the means of a population."""
    effects = len(found.fit.estimate) - len(found.typical)
    scale = np.append(found.typical, np.ones(effects))
    return Means(
        names=names,
        groups=covariates.groups,
        trends=covariates.trends,
        centre=covariates.mean,
        last=covariates.values[-1],
        estimate=np.append(found.reference, np.zeros(effects)) + scale * found.fit.estimate,
        covariance=scale[:, None] * found.covariance * scale,
        directions=found.typical[:, None] * found.fit.model.directions,
        spreads=found.spreads,
        dof=found.dof,
    )


class Effects(NamedTuple):
    """All of a joint fit."""

    groups: tuple[Effect, ...] = ()
    differences: tuple[Effect, ...] = ()
    trend: tuple[Effect, ...] = ()

    @classmethod
    def of(
        cls, found: Population, covariates: Covariates, draw: Draw, units: Mapping[str, str]
    ) -> Self:
        """Of a population; `units` are those of the coefficients."""
        from scipy.special import stdtr  # slow to load

        fit, typical, covariance = found.fit, found.typical, found.covariance
        size = len(typical)

        def common(at: Floats) -> Floats:
            """Common parameters where the covariates have some values, shape (..., size)."""
            points: Floats = found.reference + typical * (fit.at(at) @ fit.estimate)
            return points

        centre = common(np.zeros((1, len(covariates.mean))))
        steps = np.concatenate([_STEP * np.diag(typical), -_STEP * np.diag(typical)])
        ends = draw.quantities(centre + steps)
        slopes = (ends[:size] - ends[size:]).T / (2 * _STEP)
        rows = np.concatenate([found.weights * typical, slopes])
        offset = found.weights @ found.reference
        names = {name: units.get(name, "1") for name in found.varying} | DRAW

        def effects(to: Floats, values: Floats, tested: bool, **about: str) -> list[Effect]:
            errors = np.sqrt(np.einsum("ij,jk,ik->i", rows @ to, covariance, rows @ to))
            made = []
            for (name, unit), value, error in zip(names.items(), values, errors, strict=True):
                p = 2 * float(stdtr(found.dof, -abs(value) / error)) if tested and error else None
                per = f"{unit}/{about['per']}" if about.get("per", "1") != "1" else unit
                known = {key: text for key, text in about.items() if key != "per"}
                made.append(
                    Effect(name, float(value), float(error), found.dof, p, unit=per, **known)
                )
            return made

        differences, trend = [], []
        middle = fit.at(0 * covariates.mean)
        mean = np.append(
            offset + found.weights * typical @ middle @ fit.estimate, draw.quantities(centre)
        )
        groups = effects(middle, mean, False, by="")
        for by, members in covariates.groups.items():
            at = np.array([covariates.of_group(by, name) for name in members])
            to, drawn = fit.at(at), draw.quantities(common(at))
            linear = offset + to @ fit.estimate @ (found.weights * typical).T
            values = np.concatenate([linear, drawn], 1)
            for group, matrix, value in zip(members, to, values, strict=True):
                groups += effects(matrix, value, False, by=by, group=group)
            for group, matrix, value in zip(members[1:], to[1:], values[1:], strict=True):
                about = {"by": by, "group": group, "against": members[0]}
                differences += effects(matrix - to[0], value - values[0], True, **about)
        for along, unit in covariates.trends.items():
            one = covariates.of_trend(along)
            to = fit.at(one) - fit.at(0 * one)
            trend += effects(to, rows @ to @ fit.estimate, True, by=along, per=unit)
        return cls(tuple(groups), tuple(differences), tuple(trend))
