"""Throws that were fitted one by one, about a mean that may depend on groups and drift.

To first order about its optimum, the log-likelihood of a throw is a quadratic in the coefficients
of the law, and that is all that a second fit needs of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.result import Estimate, FitResult
from curlfit.inference.identifiability import Bounded
from curlfit.inference.joint.draw import Draw
from curlfit.inference.joint.effects import Covariates, Labelled
from curlfit.inference.joint.population import Population
from curlfit.inference.joint.posterior import sampled
from curlfit.inference.joint.result import JointResult, Table
from curlfit.inference.joint.summary import varying_fields
from curlfit.inference.joint.variation import Alone, told_by_each, variations_of, wanted_of
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Floats
from curlfit.numerics.mixed_model import MixedFit, MixedModel
from curlfit.stone import Stone

_SEEN = 1e-10  # eigenvalue over the largest, of information in typical sizes, that is not rounding
_TURNING = 200  # throws from which the usual angle of a draw is taken
_FEWEST = 4


def told_by(fit: FitResult) -> Floats:
    """What a throw says of the coefficients of its law: rows that are multiplied by these, with
    what they then give as the last column, shape (coefficients, coefficients + 1); errors are one.
    """
    names, known = list(fit.coefficients), fit.information["names"]
    typical = np.array([fit.parameters[name].typical for name in known])
    matrix = np.array(fit.information["matrix"]) * typical * typical[:, None]
    gradient = np.array(fit.information["gradient"]) * typical
    own = np.isin(known, names)
    to_rest: Any = matrix[own][:, ~own] @ np.linalg.pinv(matrix[~own][:, ~own], hermitian=True)
    squares, axes = np.linalg.eigh(matrix[own][:, own] - to_rest @ matrix[~own][:, own])
    seen = squares > _SEEN * squares.max(initial=0.0)
    rows = np.zeros((len(names), len(names) + 1))
    free = np.isin(names, known)
    along = axes[:, seen].T * np.sqrt(squares[seen])[:, None]
    values = np.array([fit.parameters[name].value for name in names])
    rows[: len(along), :-1][:, free] = along / typical[own]
    push = axes[:, seen].T @ (gradient[own] - to_rest @ gradient[~own]) / np.sqrt(squares[seen])
    rows[: len(along), -1] = rows[: len(along), :-1] @ values + push
    return rows


class Season(NamedTuple):
    """Throws that were fitted one by one with the same law."""

    file: str
    model: Model
    stone: Stone
    labels: Labelled
    values: Floats
    """of the coefficients, shape (throws, coefficients)"""
    spins: Floats
    """initial, rad/s"""
    told: Floats
    """by each, see `told_by`"""
    notes: tuple[str, ...]


def mean_of(
    season: Season, by: Sequence[str], trend: Sequence[str], seed: int | None
) -> JointResult:
    """The mean of throws, how they vary about it, and what groups and trends do.

    Parameters
    ----------
    by, trend, seed : as in `fit_together`.

    Raises
    ------
    InputError : too few throws; labels that a throw lacks, or that give no groups or numbers;
        throws that determine nothing.
    """
    count, items = len(season.told), season.model.law.coefficients()
    if count < _FEWEST:
        raise InputError(f"{season.file}: {count} usable throws; expected {_FEWEST} or more")
    covariates = Covariates.of(season.labels, by, trend)
    names = tuple(item.name for item in items)
    typical, lower, upper = (
        np.array([getattr(item, name) for item in items]) for name in ("typical", "lower", "upper")
    )
    reference = np.clip(np.median(season.values, axis=0), lower, upper)
    free = season.told[..., :-1].any((0, 1)) | (np.ptp(season.values, axis=0) > 0)
    lower, upper = (np.where(free, end, reference) for end in (lower, upper))
    rows = season.told[..., :-1] * typical
    target = season.told[..., -1] - season.told[..., :-1] @ reference
    ends = [
        np.where(free, (end - reference) / typical, sign * np.inf)
        for end, sign in ((lower, -1), (upper, 1))
    ]

    def population(weights: dict[str, Floats], columns: Floats, spreads: Floats) -> Population:
        whole = np.array([*weights.values()]).reshape(len(weights), len(names))
        directions = np.linalg.pinv(whole * typical * free)
        model = MixedModel.of(rows, target, directions, columns)
        variances = model.variances(spreads**2) if len(spreads) else spreads
        fit = MixedFit(model, variances, *ends)
        return Population(fit, reference, typical, tuple(weights), whole)

    nothing = np.zeros(0)
    known = population({}, covariates.values[:, :0], nothing).of_mean(names, lower, upper)
    coefficients = {}
    for row, item in enumerate(items):
        verdict = known.classified(row)[1] if free[row] else "fixed"
        coefficients[item.name] = Estimate(
            float(reference[row]), None, verdict, item.unit, item.symbol, item.meaning,
            item.lower, item.upper, item.typical,
        )  # fmt: skip
    verdicts = {name: item.verdict for name, item in coefficients.items()}
    wanted = {
        name: np.array([own.get(one, 0.0) for one in names])
        for name, own in wanted_of(verdicts, known.combinations).items()
    }
    weights = told_by_each(season.told[..., :-1], typical * free, wanted)
    if not weights:
        raise InputError(f"{season.file}: a throw determines no coefficient by itself")
    at = Bounded(*(part[free] for part in (reference, lower, upper)))
    each = [
        Alone.of(row[None, :, free], -left[None], at, typical[free])
        for row, left in zip(rows, target, strict=True)
    ]
    open_ = np.tile(free, (count, 1))
    variation = variations_of(
        [(one, one) for one in each], open_, reference, weights, typical, covariates.values
    )
    spreads = np.array([item.first_spread for item in variation])
    some = np.linspace(0, count - 1, min(count, _TURNING)).astype(int)
    found = population(weights, covariates.values, spreads)
    fields = varying_fields(
        found, coefficients, known.combinations,
        variation, covariates, (lower, upper), Draw(season.model, season.stone),
        season.values[some], season.spins[some], sampled(found.fit, spreads, seed),
    )  # fmt: skip
    return JointResult(
        law=season.model.law.name,
        load=season.model.load,
        share=names,
        converged=True,
        status=f"converged ({count} throws that were fitted one by one)",
        warnings=(),
        rank=known.identifiability.rank,
        parameters=int(free.sum()),
        table=Table(season.file, count, season.stone, season.notes),
        **fields,
    )
