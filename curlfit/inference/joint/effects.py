"""Groups of throws and trends: their covariates, and records of what these do."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.derived import Quantiles
from curlfit.inference.identifiability import WithInterval
from curlfit.numerics.arrays import Floats
from curlfit.numerics.mixed_model import bounded, to_mean
from curlfit.output.text import join_words
from curlfit.records import Matrix

_CLOCK = re.compile(r"(\d{1,2})[:h](\d{2})(?::(\d{2}))?")
_DAY = 24.0  # h
_LATE = 12.0  # h by which a clock goes back at midnight
Labelled = Sequence[tuple[str, Mapping[str, str]]]


@dataclass(frozen=True)
class Effect(WithInterval):
    """What a group or a trend is in one quantity.

    Attributes
    ----------
    parameter : a coefficient or combination, or of a draw to the tee "friction" (mean
        deceleration over g), "curl" (m) or "hog_to_hog" (s).
    value, stderr, dof : estimate, its standard error and the degrees of
        freedom of that.
    p : probability of a value at least as far from zero by chance; None for the
        mean of a group.
    by : the label that distinguishes the groups, or along which the trend runs; empty
        for all throws together.
    group, against : the group, and the one that it is compared with; empty for a trend.
    unit : of the value.
    quantiles : of the posterior, "2.5" to "97.5"; empty if it was not sampled.
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
    quantiles: Quantiles = field(default_factory=dict)


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
    def of(
        cls, throws: Labelled, by: str | Sequence[str], trend: str | Sequence[str]
    ) -> Self:
        """Of throws, each with its name and its labels, by one label or several.

        Raises
        ------
        InputError : a throw lacks a label; there is one group, or a group of one throw;
            a trend is along no number; columns depend on one another.
        """
        by, trend = ([one] if isinstance(one, str) else one for one in (by, trend))
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
        if np.linalg.matrix_rank(
            np.column_stack([np.ones(len(throws)), values])
        ) <= len(columns):
            names = join_words([*groups, *trends])
            raise InputError(f"{names}: the throws do not distinguish their effects")
        return cls(groups, trends, mean, values - mean)


def _labels(throws: Labelled, name: str) -> list[str]:
    for throw, labels in throws:
        if name not in labels:
            known = ", ".join(labels) or "none"
            raise InputError(f"{throw}: no label {quoted(name)}; it has {known}")
    return [labels[name] for _, labels in throws]


def _natural(label: str) -> list[tuple[int, Any]]:
    """For the usual order of labels, of sheet 10 after sheet 2."""
    parts = re.split(r"(\d+)", label)
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]


def _numbers(name: str, labels: Sequence[str]) -> tuple[list[float], str]:
    """Hours of a clock, which may pass midnight, days of dates, or numbers;
    and their unit."""
    with suppress(ValueError):
        return [float(date.fromisoformat(label).toordinal()) for label in labels], "day"
    clocks = [_CLOCK.fullmatch(label) for label in labels]
    found: list[float] = []
    for label, clock in zip(labels, clocks, strict=True):
        try:
            value = (
                float(label)
                if clock is None
                else float(clock[1]) + float(clock[2]) / 60
            )
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or (clock is None) != (clocks[0] is None):
            raise InputError(
                f"trend {name}: {quoted(label)} found, expected numbers, "
                "times such as 19:05, or dates such as 2026-02-27"
            )
        if clock is not None:
            value += float(clock[3] or 0) / 3600
            while found and value < found[-1] - _LATE:
                value += _DAY
        found.append(value)
    return found, "1" if clocks[0] is None else "h"


@dataclass(frozen=True, eq=False)
class Means:
    """The means of the parameters in common.

    Attributes
    ----------
    names : the parameters.
    groups, trends : names of the groups by label, and units of trends by label.
    centre, last : values of the covariates, a column for each group but the first and
        each trend: their means over the throws, which have been subtracted from all,
        and those of the last throw.
    estimate, covariance : of the parameters of the mean of all throws and then, by
        covariate, of its effects along the directions in which throws vary.
    directions : changes of the parameters in these, shape (parameters, directions).
    spreads : standard deviations between throws along them. dof : degrees of
        freedom of these.
    angle : rad by which a draw to the tee turns, the median of the throws.
    """

    names: tuple[str, ...]
    groups: dict[str, tuple[str, ...]]
    trends: dict[str, str]
    centre: Floats
    last: Floats
    estimate: Floats
    covariance: Matrix
    directions: Matrix
    spreads: Floats
    dof: float
    angle: float

    def at(self, columns: Floats) -> Floats:
        """Matrix from the estimate to the parameters where covariates have
        some values."""
        return to_mean(self.directions, columns)

    def of_groups(self, of: Mapping[str, str]) -> Floats:
        """The covariates of some groups, by label, at the mean of all else."""
        found, end = np.zeros(len(self.centre)), 0
        for name, members in self.groups.items():
            own = slice(end, end := end + len(members) - 1)
            if name in of:
                found[own] = [of[name] == one for one in members[1:]] - self.centre[own]
        return found

    def along_trend(self, name: str) -> Floats:
        """The covariates of one unit along a trend."""
        unit: Floats = np.eye(len(self.centre))[
            list(self.trends).index(name) - len(self.trends)
        ]
        return unit

    def columns(self, labels: Mapping[str, str]) -> Floats:
        """The covariates of another throw: of its group, or the mean of all groups;
        along a trend at its label, or as at the last throw.

        Raises
        ------
        InputError : an unknown label or group.
        """
        for name, label in labels.items():
            if name not in (*self.groups, *self.trends):
                known = join_words([*self.groups, *self.trends]) or "none"
                raise InputError(
                    f"{name}: the fit distinguishes no throws by "
                    f"{quoted(name)}; it has {known}"
                )
            if label not in self.groups.get(name, [label]):
                expected = join_words(self.groups[name], "or")
                raise InputError(f"{name} {quoted(label)}: expected {expected}")
        found = self.of_groups(labels)
        for name in self.trends:
            there = self.last
            if name in labels:
                there = _numbers(name, [labels[name]])[0][0] - self.centre
            found += self.along_trend(name) * there
        return found

    def expected(
        self, weights: Mapping[str, float], labels: Mapping[str, str]
    ) -> tuple[float, float]:
        """A weighted sum of the parameters of another throw: mean and
        standard deviation."""
        known = {
            name: one
            for name, one in labels.items()
            if name in (*self.groups, *self.trends)
        }
        vector = np.array([weights.get(name, 0.0) for name in self.names])
        row = vector @ self.at(self.columns(known))
        between = ((vector @ self.directions * self.spreads) ** 2).sum()
        return float(row @ self.estimate), float(
            np.sqrt(row @ self.covariance @ row + between)
        )

    def draw(
        self,
        labels: Mapping[str, str],
        number: int,
        random: Any,
        lower: Floats,
        upper: Floats,
    ) -> tuple[Floats, Floats]:
        """The mean parameters of another throw, and draws of its own, shape (number,
        parameters): by Student's t, since the spreads are estimated. A draw outside the
        bounds is replaced by the nearest one inside, measured by the covariance, which
        changes what is determined least."""
        to = self.at(self.columns(labels))
        between = self.directions * self.spreads**2 @ self.directions.T
        squares, axes = np.linalg.eigh(to @ self.covariance @ to.T + between)
        root = axes * np.sqrt(np.maximum(squares, 0.0))
        tails = np.sqrt(self.dof / random.chisquare(self.dof, (number, 1)))
        mean = np.clip(to @ self.estimate, lower, upper)
        normal = tails * random.standard_normal((number, len(mean)))
        drawn = mean + normal @ root.T
        for row in np.flatnonzero(((drawn < lower) | (drawn > upper)).any(1)):
            ends = lower - mean, upper - mean
            drawn[row] = mean + root @ bounded(
                normal[row], np.eye(len(mean)), root, *ends
            )
        return mean, np.clip(drawn, lower, upper)
