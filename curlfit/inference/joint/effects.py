"""Groups of throws and trends: their covariates, and what these do to the coefficients."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.identifiability import WithInterval
from curlfit.inference.joint.draw import DRAW, Draw
from curlfit.inference.joint.population import Population
from curlfit.numerics.arrays import Floats
from curlfit.output.text import join_words
from curlfit.throws.throw import Throw

_STEP = 1e-3  # typical sizes, of differences
_CLOCK = re.compile(r"(\d{1,2})[:h](\d{2})(?::(\d{2}))?")
_DAY = 24.0  # h
_LATE = 12.0  # h by which a clock goes back at midnight


@dataclass(frozen=True)
class Effect(WithInterval):
    """What a group or a trend is in one quantity.

    Attributes
    ----------
    parameter : a coefficient or combination, or of a draw to the tee "friction" (mean deceleration
        over g), "curl" (m) or "hog_to_hog" (s).
    value, stderr, dof : estimate, its standard error and the degrees of freedom of that.
    p : probability of a value at least as far from zero by chance; None for the mean of a group.
    by : the label that distinguishes the groups, or along which the trend runs; empty for all
        throws together.
    group, against : the group, and the one that it is compared with; empty for a trend.
    unit : of the value.
    """

    parameter: str
    value: float
    stderr: float
    dof: float | None
    p: float | None
    by: str
    group: str = ""
    against: str = ""
    unit: str = "1"


class Covariates(NamedTuple):
    """Groups and trends of throws as columns of numbers with mean zero."""

    groups: dict[str, tuple[str, ...]]
    """names by label, the first being the one that others are compared with"""
    trends: dict[str, str]
    """the unit by label"""
    mean: Floats
    """of the columns before it was subtracted"""
    values: Floats
    """shape (throws, columns)"""

    @classmethod
    def of(cls, throws: Sequence[Throw], by: Sequence[str], trend: Sequence[str]) -> Self:
        """Of throws with labels.

        Raises
        ------
        InputError : a throw lacks a label; there is one group, or a group of one throw; a trend
            is along no number; columns depend on one another.
        """
        groups, trends = {}, {}
        columns: list[Sequence[float]] = []
        for name in by:
            labels = _labels(throws, name)
            groups[name] = tuple(sorted(set(labels), key=_natural))
            if len(groups[name]) < 2:
                raise InputError(f"by {name}: all throws have {quoted(labels[0])}")
            columns += [[label == one for label in labels] for one in groups[name][1:]]
        for name in trend:
            numbers, trends[name] = _numbers(name, _labels(throws, name))
            columns.append(numbers)
        values = np.array(columns, float).reshape(len(columns), len(throws)).T
        mean = values.mean(0)
        if np.linalg.matrix_rank(np.column_stack([np.ones(len(throws)), values])) <= len(columns):
            names = join_words([*groups, *trends])
            raise InputError(f"{names}: the throws do not distinguish their effects")
        return cls(groups, trends, mean, values - mean)

    def of_group(self, name: str, group: str) -> Floats:
        """The columns of the mean of a group, at the mean of all others."""
        found, place = np.zeros(len(self.mean)), 0
        for label, names in self.groups.items():
            own = slice(place, place + len(names) - 1)
            if label == name:
                found[own] = np.array([one == group for one in names[1:]]) - self.mean[own]
            place = own.stop
        return found

    def of_trend(self, name: str) -> Floats:
        """The columns of one unit along a trend."""
        found = np.zeros(len(self.mean))
        found[len(self.mean) - len(self.trends) + list(self.trends).index(name)] = 1.0
        return found


def _labels(throws: Sequence[Throw], name: str) -> list[str]:
    for throw in throws:
        if name not in throw.labels:
            known = ", ".join(throw.labels) or "none"
            raise InputError(f"{throw.name}: no label {quoted(name)}; it has {known}")
    return [throw.labels[name] for throw in throws]


def _natural(label: str) -> list[tuple[int, Any]]:
    """For the usual order of labels, of sheet 10 after sheet 2."""
    parts = re.split(r"(\d+)", label)
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]


def _numbers(name: str, labels: Sequence[str]) -> tuple[list[float], str]:
    """Hours of a clock, which may pass midnight, or numbers; and their unit."""
    clocks = [_CLOCK.fullmatch(label) for label in labels]
    found: list[float] = []
    for label, clock in zip(labels, clocks, strict=True):
        try:
            value = float(label) if clock is None else float(clock[1]) + float(clock[2]) / 60
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or (clock is None) != (clocks[0] is None):
            raise InputError(
                f"trend {name}: {quoted(label)} found, expected numbers or times such as 19:05"
            )
        if clock is not None:
            value += float(clock[3] or 0) / 3600
            while found and value < found[-1] - _LATE:
                value += _DAY
        found.append(value)
    return found, "1" if clocks[0] is None else "h"


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
