"""Groups of throws and trends: their covariates, and records of what these do."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import quoted
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.information.intervals import WithInterval
from curlfit.numerics.arrays import Floats
from curlfit.numerics.mixed_model import MixedFit, bounded, to_mean
from curlfit.records import ADDED, Matrix
from curlfit.throws.readers.clocks import HOUR, AmbiguousTimesError, times_of_day
from curlfit.throws.readers.numbers import parse_number
from curlfit.wording import join_words

_PER = {"h": "an hour", "day": "a day"}
SLOPES_DIFFER = 0.01
"""Probability that an evening whose groups change alike is said to have slopes that
differ. Of 2,000 simulated evenings of 8 to 20 draws it is said of 0.1 to 1.0 %, the
less the more the errors of stopwatch and tape are all that differs."""
Labelled = Sequence[tuple[str, Mapping[str, str]]]


@dataclass(frozen=True)
class Effect(WithInterval):
    """What a group or a trend is in one quantity, or the trend of a group.

    Attributes
    ----------
    parameter : a coefficient or combination, or of a draw to the tee "friction" (mean
        deceleration over g), "curl" (m) or "hog_to_hog" (s).
    value, stderr, dof : estimate, its standard error and the degrees of
        freedom of that.
    p : probability of a value at least as far from zero by chance; None for the
        mean of a group.
    by : the label that distinguishes the groups, or along which the trend of all runs;
        empty for all throws together.
    group, against : the group, and the one that it is compared with; empty for a trend.
    along : the label along which the trend of a group runs; empty otherwise.
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
    along: str = field(default="", metadata=ADDED)
    unit: str = "1"
    quantiles: Quantiles = field(default_factory=dict)


class Covariates(NamedTuple):
    """Groups and trends of throws as columns of numbers with mean zero, and their
    products where groups have slopes of their own."""

    groups: dict[str, tuple[str, ...]]
    """names by label, the first being the one that others are compared with"""
    trends: dict[str, str]
    """the unit by label"""
    trend_by: tuple[str, ...]
    """labels whose groups have slopes of their own along each trend"""
    mean: Floats
    """of the columns of groups and trends before it was subtracted"""
    values: Floats
    """shape (throws, columns)"""

    @classmethod
    def of(
        cls,
        throws: Labelled,
        by: str | Sequence[str],
        trend: str | Sequence[str],
        trend_by: str | Sequence[str] = (),
    ) -> Self:
        """Of throws, each with its name and its labels, by one label or several.

        Raises
        ------
        InputError : a throw lacks a label; there is one group, or a group of one throw;
            a trend is along no number; slopes by no label of groups; columns depend on
            one another.
        """
        by = _as_names(by)
        trend = _as_names(trend)
        trend_by = _as_names(trend_by)
        for name in trend_by:
            if not trend:
                raise InputError(
                    f"trend-by {name}: expected a trend too, such as --trend start"
                )
            if name not in by:
                raise InputError(
                    f"trend-by {name}: expected a label of groups, as by --by {name}"
                )
        groups = {}
        trends = {}
        columns: list[Sequence[float]] = []
        for name in by:
            labels = _labels(throws, name)
            groups[name] = tuple(sorted(set(labels), key=_natural))
            if len(groups[name]) < 2:
                raise InputError(f"by {name}: all throws have {quoted(labels[0])}")
            columns += [
                [label == group for label in labels] for group in groups[name][1:]
            ]
        for name in trend:
            numbers, trends[name] = _numbers(name, _labels(throws, name))
            columns.append(numbers)
        values = np.array(columns, float).reshape(len(columns), len(throws)).T
        mean = values.mean(0)
        shared_slopes = cls(groups, trends, (), mean, values - mean)
        covariates = shared_slopes.with_slopes_by(trend_by)
        if not covariates.distinguished:
            names = join_words([*groups, *trends])
            raise InputError(f"{names}: the throws do not distinguish their effects")
        return covariates

    @property
    def last(self) -> Floats:
        """The columns of groups and trends at the last throw."""
        return self.values[-1, : len(self.mean)]

    @property
    def distinguished(self) -> bool:
        """Whether the throws distinguish the effects of all columns."""
        design = np.column_stack([np.ones(len(self.values)), self.values])
        return bool(np.linalg.matrix_rank(design) == design.shape[1])

    def with_slopes_by(self, labels: Sequence[str]) -> Self:
        """These groups and trends, with slopes of their own for the groups of some
        labels."""
        columns = self.values[:, : len(self.mean)]
        values = _with_products(columns, self.groups, self.trends, labels)
        return self._replace(trend_by=tuple(labels), values=values)


def _as_names(names: str | Sequence[str]) -> Sequence[str]:
    """One name or several as a list."""
    return [names] if isinstance(names, str) else names


def _with_products(
    columns: Floats,
    groups: Mapping[str, Sequence[str]],
    trends: Mapping[str, str],
    trend_by: Sequence[str],
) -> Floats:
    """Covariates of groups and trends, shape (..., columns), then the products on which
    slopes of groups depend: by label, by trend, by group.

    Both factors have mean zero, so that at the mean of the groups the slope is that of
    the trend, and at the mean place along the trend a group differs as without them.
    """
    first_trend = columns.shape[-1] - len(trends)
    of_groups = {}
    begin = 0
    for name, members in groups.items():
        of_groups[name] = columns[..., begin : begin + len(members) - 1]
        begin += len(members) - 1
    parts = [columns]
    for name in trend_by:
        parts += [
            of_groups[name] * columns[..., trend : trend + 1]
            for trend in range(first_trend, columns.shape[-1])
        ]
    return np.concatenate(parts, -1)


def _labels(throws: Labelled, name: str) -> list[str]:
    for throw, labels in throws:
        if name not in labels:
            names = ", ".join(labels) or "none"
            raise InputError(f"{throw}: no label {quoted(name)}; it has {names}")
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
    numbers = [parse_number(label, decimal_comma=False) for label in labels]
    if None not in numbers and np.isfinite(np.array(numbers, float)).all():
        return np.array(numbers, float).tolist(), "1"
    try:
        seconds = times_of_day(labels)
    except AmbiguousTimesError as error:
        raise InputError(
            f"trend {name}: {error}; expected dates such as 2026-02-27"
        ) from None
    if seconds is not None:
        return (seconds / HOUR).tolist(), "h"
    strange = next(
        (
            label
            for label, number in zip(labels, numbers, strict=True)
            if number is None and times_of_day([label]) is None
        ),
        labels[0],
    )
    raise InputError(
        f"trend {name}: {quoted(strange)} found, expected numbers, "
        "times such as 19:05, or dates such as 2026-02-27"
    )


@dataclass(frozen=True, eq=False)
class Means:
    """The means of the parameters in common.

    Attributes
    ----------
    names : the parameters.
    groups, trends : names of the groups by label, and units of trends by label.
    trend_by : labels whose groups have slopes of their own along each trend: their
        covariates are products of those of groups and trends.
    centre, last : values of the covariates, a column for each group but the first and
        each trend: their means over the throws, which have been subtracted from all,
        and those of the last throw.
    estimate, covariance : of the parameters of the mean of all throws and then, by
        covariate, of its effects along the directions in which throws vary.
    directions : changes of the parameters in these, shape (parameters, directions).
    spreads : standard deviations between throws along them. dof : degrees of
        freedom of these.
    angle : rad by which a draw to the tee turns, the median of the throws that are
        known to turn.
    drawn : from the posterior: the estimate, then the spreads, shape (draws, numbers);
        none of tracks, and of many draws, for which Student's t is right.
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
    trend_by: tuple[str, ...] = field(default=(), metadata=ADDED)
    drawn: Matrix = field(default_factory=lambda: np.zeros((0, 0)), metadata=ADDED)

    def at(self, columns: Floats) -> Floats:
        """Matrix from the estimate to the parameters where covariates have
        some values."""
        return to_mean(self.directions, columns)

    def covariates(self, of: Mapping[str, str], along: Mapping[str, float]) -> Floats:
        """The covariates of some groups, by label, at distances from the mean along
        trends, and at the mean of all else."""
        columns = np.zeros(len(self.centre))
        begin = 0
        for name, members in self.groups.items():
            end = begin + len(members) - 1
            if name in of:
                indicators = np.array([of[name] == member for member in members[1:]])
                columns[begin:end] = indicators - self.centre[begin:end]
            begin = end
        for column, name in enumerate(self.trends, begin):
            columns[column] = along.get(name, 0.0)
        return _with_products(columns, self.groups, self.trends, self.trend_by)

    def of_groups(self, of: Mapping[str, str]) -> Floats:
        """The covariates of some groups, by label, at the mean of all else."""
        return self.covariates(of, {})

    def along_trend(self, name: str, of: Mapping[str, str] | None = None) -> Floats:
        """By how much the covariates of a group change in one unit along a trend; those
        at the mean of all groups without one."""
        group = of or {}
        return self.covariates(group, {name: 1.0}) - self.covariates(group, {})

    def columns(self, labels: Mapping[str, str]) -> Floats:
        """The covariates of another throw: of its group, or the mean of all groups;
        along a trend at its label, or as at the last throw.

        Raises
        ------
        InputError : an unknown label or group.
        """
        for name, label in labels.items():
            if name not in (*self.groups, *self.trends):
                distinguished = join_words([*self.groups, *self.trends]) or "none"
                raise InputError(
                    f"{name}: the fit distinguishes no throws by "
                    f"{quoted(name)}; it has {distinguished}"
                )
            if label not in self.groups.get(name, [label]):
                expected = join_words(self.groups[name], "or")
                raise InputError(f"{name} {quoted(label)}: expected {expected}")
        first_trend = len(self.centre) - len(self.trends)
        along = {}
        for column, name in enumerate(self.trends, first_trend):
            along[name] = float(self.last[column])
            if name in labels:
                (number,), _ = _numbers(name, [labels[name]])
                along[name] = number - self.centre[column]
        return self.covariates(labels, along)

    def expected(
        self, weights: Mapping[str, float], labels: Mapping[str, str]
    ) -> tuple[float, float]:
        """A weighted sum of the parameters of another throw: mean and
        standard deviation."""
        of_fit = {
            name: label
            for name, label in labels.items()
            if name in (*self.groups, *self.trends)
        }
        vector = np.array([weights.get(name, 0.0) for name in self.names])
        row = vector @ self.at(self.columns(of_fit))
        between = ((vector @ self.directions * self.spreads) ** 2).sum()
        variance = row @ self.covariance @ row + between
        return float(row @ self.estimate), float(np.sqrt(variance))

    def draw(
        self,
        labels: Mapping[str, str],
        number: int,
        random: Any,
        lower: Floats,
        upper: Floats,
    ) -> tuple[Floats, Floats]:
        """The mean parameters of another throw, and draws of its own, shape (number,
        parameters). A draw outside the bounds is replaced by the nearest one inside,
        measured by the covariance, which changes what is determined least."""
        to = self.at(self.columns(labels))
        between = self.directions * self.spreads**2 @ self.directions.T
        squares, axes = np.linalg.eigh(to @ self.covariance @ to.T + between)
        root = axes * np.sqrt(np.maximum(squares, 0.0))
        mean = np.clip(to @ self.estimate, lower, upper)
        if len(self.drawn):
            drawn = self._drawn_by_posterior(to, number, random)
        else:
            tails = np.sqrt(self.dof / random.chisquare(self.dof, (number, 1)))
            normal = tails * random.standard_normal((number, len(mean)))
            drawn = mean + normal @ root.T
        to_normal = np.linalg.pinv(root)
        ends = lower - mean, upper - mean
        for row in np.flatnonzero(((drawn < lower) | (drawn > upper)).any(1)):
            normal_of_row = to_normal @ (drawn[row] - mean)
            drawn[row] = mean + root @ bounded(
                normal_of_row, np.eye(len(mean)), root, *ends
            )
        return mean, np.clip(drawn, lower, upper)

    def _drawn_by_posterior(self, to: Floats, number: int, random: Any) -> Floats:
        """Parameters of another throw, shape (number, parameters): each about a mean
        and with spreads of its own from the posterior; `to` is from the estimate to
        the mean."""
        chosen = self.drawn[random.integers(len(self.drawn), size=number)]
        estimates = chosen[:, : len(self.estimate)]
        spreads = chosen[:, len(self.estimate) :]
        deviations = spreads * random.standard_normal(spreads.shape)
        drawn: Floats = estimates @ to.T + deviations @ self.directions.T
        return drawn


class OwnSlopes(NamedTuple):
    """A fit in which the groups of a label have slopes of their own."""

    fit: MixedFit
    covariates: Covariates


def with_own_slopes(
    fit: MixedFit, covariates: Covariates, label: str
) -> OwnSlopes | None:
    """The fit of the same quadratics of throws where the groups of one more label have
    slopes of their own; None where the throws do not distinguish these."""
    own_slopes = covariates.with_slopes_by([*covariates.trend_by, label])
    throws, columns = own_slopes.values.shape
    if not own_slopes.distinguished or throws - 1 <= columns:
        return None
    model = fit.model.with_covariates(
        own_slopes.values[:, covariates.values.shape[1] :]
    )
    # a spread that is zero beside one slope has a tenth of an error to start from
    guess = np.maximum(fit.variances, 0.01 * model.typical)
    refitted = replace(fit, model=model, variances=model.variances(guess))
    return OwnSlopes(refitted, own_slopes)


def _with_chances(differences: Sequence[Effect]) -> list[tuple[Effect, float]]:
    """The differences of slopes in friction and curl of a draw, each with the
    probability that one of them is as unlikely as this if all slopes are alike, by
    Bonferroni."""
    tested = [
        effect for effect in differences if effect.parameter in ("friction", "curl")
    ]
    return [
        (effect, min(len(tested) * effect.p, 1.0))
        for effect in tested
        if effect.p is not None
    ]


def chances_of_alike_slopes(differences: Sequence[Effect]) -> dict[str, float]:
    """The probability of differences of slopes as large by chance, by label of the
    groups."""
    chances: dict[str, float] = {}
    for effect, chance in _with_chances(differences):
        chances[effect.by] = min(chance, chances.get(effect.by, 1.0))
    return chances


def slope_warnings(
    differences: Sequence[Effect], friction: float, trend_by: Sequence[str]
) -> list[Finding]:
    """A warning for each label whose groups change differently along a trend, while the
    fit has one slope for all.

    Parameters
    ----------
    differences : of the slopes of groups from those of the first one.
    friction : of a draw to the tee.
    trend_by : labels whose groups have slopes of their own already.
    """
    by_label: dict[str, list[dict[str, Any]]] = {}
    for effect, chance in _with_chances(differences):
        if effect.by in trend_by or chance >= SLOPES_DIFFER:
            continue
        in_unit = 1.0
        unit = "m"
        if effect.parameter == "friction":
            in_unit = 100 / friction
            unit = "%"
        time_unit = effect.unit.rpartition("/")[2]
        by_label.setdefault(effect.by, []).append(
            {
                "parameter": effect.parameter,
                "rise": [in_unit * abs(effect.value), in_unit * effect.stderr],
                "unit": unit,
                "per": _PER.get(time_unit, f"per unit of {effect.along}"),
                "direction": "more" if effect.value > 0 else "less",
                "group": effect.group,
                "against": effect.against,
                "p": chance,
            }
        )
    return [
        Finding.warning(
            "slopes-differ",
            Remedy("own-slopes", Option("trend-by", label)),
            label=label,
            differences=of_label,
        )
        for label, of_label in by_label.items()
    ]
