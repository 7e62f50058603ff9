"""Throws that were fitted one by one, about a mean that may depend on groups and drift.

To first order about its optimum, the log-likelihood of a throw is a quadratic in the
coefficients of the law, and that is all that a second fit needs of it. Where it is no
quadratic, the throw says twice what it says: exactly, where its ridge leaves it, and as
roughly as the ridge is wide (`curlfit.inference.fit.ridge_information`). The place of
the estimate on its ridge is no matter of chance: ridges of throws alike bend the same
way, and the mean of many estimates is no nearer to the truth than one. So what throws
say roughly counts once, for all of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import InputError
from curlfit.friction import Coefficient
from curlfit.inference.fit.covariance import Covariance
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.identifiability import Bounded
from curlfit.inference.joint.draw import TIMES, Draw
from curlfit.inference.joint.effects import Covariates, Labelled
from curlfit.inference.joint.population import Population, ends_from, seen_of
from curlfit.inference.joint.posterior import sampled
from curlfit.inference.joint.result import JointResult, SeparateFits, Variation
from curlfit.inference.joint.summary import about_mean
from curlfit.inference.joint.variation import (
    Alone,
    told_by_each,
    variations_of,
    wanted_of,
)
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL
from curlfit.inference.system import motions
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.mixed_model import MixedFit, MixedModel
from curlfit.output.text import join_words
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
    told: Floats
    """by each, see `FitResult.coefficient_rows`; of a throw with a ridge, the first
    part of `FitResult.coefficient_rows_along_ridge`"""
    notes: tuple[str, ...]
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
            return self.told
        return np.concatenate([self.told, share**0.5 * self.stretched], 1)

    @property
    def share(self) -> float:
        """That of one throw in what all say roughly."""
        return 1.0 / max(int(self.stretched.any((1, 2)).sum()), 1)

    def counts_left_open(self) -> dict[str, int]:
        """Numbers of throws by coefficient that they leave open."""
        counts = Counter(name for names in self.left_open for name in names)
        names = [item.name for item in self.model.law.coefficients()]
        return {name: counts[name] for name in names if name in counts}

    def warnings(self) -> tuple[str, ...]:
        """What the throws leave open, and what would help."""
        counts = self.counts_left_open()
        if not counts:
            return ()
        throws = len(self.left_open)
        left = "; ".join(
            f"{count} of {throws} throws leave "
            f"{join_words([name for name in counts if counts[name] == count])} open"
            for count in dict.fromkeys(counts.values())
        )
        return (
            f"{left}: values far apart fit each of them about as well. What would "
            "help: `curlfit batch` with an angle, or with the spin "
            "(`--fix omega0=...`); or the files themselves, `curlfit fit *.csv`",
        )

    def summary(
        self, by: Iterable[str], null_directions: tuple[dict[str, float], ...]
    ) -> SeparateFits:
        """What a prediction of another throw needs besides the mean."""
        own = np.column_stack([self.values, self.start])
        state, _ = motions(self.model, own, self.stone, LEVEL_AND_STILL, TIMES)
        ends = zip(self.durations, state[:, 3:], strict=True)
        last = [[np.interp(end, TIMES, one) for one in rates] for end, rates in ends]
        *velocity, spins = np.concatenate([state[:, 3:, 0], last]).T
        speeds, senses = np.hypot(*velocity), (spins[spins < 0], spins[spins >= 0])
        last_of = {
            tuple((name, labels[name]) for name in by): row
            for row, (_, labels) in enumerate(self.labels)
            if not self.conditions
        }
        starts = [
            {"labels": dict(labels)}
            | {
                "start": {
                    item.name: float(self.start[row, k]) for k, item in enumerate(START)
                }
            }
            for labels, row in sorted(last_of.items(), key=itemgetter(1))
        ]
        return SeparateFits(
            self.file,
            len(self.told),
            self.stone,
            self.notes,
            tuple(starts),
            float(self.durations.max()),
            np.array([speeds.min(), speeds.max()]),
            np.array(
                [end for one in senses if len(one) for end in (one.min(), one.max())]
            ),
            null_directions,
        )


class _Quadratics(NamedTuple):
    """The log-likelihoods of throws in typical sizes from a reference."""

    items: tuple[Coefficient, ...]
    reference: Floats
    typical: Floats
    free: Booleans
    bounds: tuple[Floats, Floats]
    """the reference where a coefficient is fixed"""
    rows: Floats
    target: Floats
    own: Floats
    """optima of the throws"""

    @classmethod
    def of(cls, season: Season, share: float = 1.0) -> Self:
        """About the median of the throws, with a share of what they say roughly."""
        items = season.model.law.coefficients()
        typical, lower, upper = (
            np.array([getattr(item, name) for item in items])
            for name in ("typical", "lower", "upper")
        )
        reference = np.clip(np.median(season.values, axis=0), lower, upper)
        told = season.rows(share)
        rows = told[..., :-1]
        free = rows.any((0, 1)) | (np.ptp(season.values, axis=0) > 0)
        bounds = np.where(free, lower, reference), np.where(free, upper, reference)
        target = told[..., -1] - rows @ reference
        own = (season.values - reference) / typical
        return cls(items, reference, typical, free, bounds, rows * typical, target, own)

    def population(
        self, weights: Mapping[str, Floats], columns: Floats, spreads: Floats
    ) -> Population:
        """The fit where what has these weights varies; `spreads` are first values."""
        whole = np.array([*weights.values()]).reshape(len(weights), len(self.items))
        directions: Any = np.linalg.pinv(whole * self.typical * self.free)
        ends = ends_from(self.reference, self.typical, self.free, *self.bounds)
        model = MixedModel.of(self.rows, self.target, directions, columns)
        seen = seen_of(model, spreads**2, *ends)
        unseen = self.rows @ (np.eye(len(seen)) - seen) @ self.own[..., None]
        target = self.target - unseen[..., 0]
        model = MixedModel.of(self.rows @ seen, target, directions, columns)
        variances = model.variances(spreads**2) if len(spreads) else spreads
        fit = MixedFit(model, variances, *ends)
        return Population(
            fit, self.reference, self.typical, self.bounds, dict(weights), fit
        )

    def equal(self, share: float = 1.0) -> tuple[Covariance, dict[str, Estimate]]:
        """What all throws say if they are equal, or what a share of their
        information does."""
        none, root = np.zeros((len(self.rows), 0)), share**0.5
        some = self._replace(rows=root * self.rows, target=root * self.target)
        known = some.population({}, none, none[0]).of_mean(
            [item.name for item in self.items]
        )
        found = {}
        for row, item in enumerate(self.items):
            verdict = known.classified(row)[1] if self.free[row] else "fixed"
            found[item.name] = Estimate.of(item, float(self.reference[row]), verdict)
        return known, found

    def variations(
        self, wanted: Mapping[str, Floats], covariates: Floats
    ) -> tuple[Variation, ...]:
        """Of what has these weights, as each throw alone gives it."""
        free, typical = self.free, self.typical
        at = Bounded(*(part[free] for part in (self.reference, *self.bounds)))
        alone = [
            Alone.of(rows[None, :, free], -left[None], at, typical[free])
            for rows, left in zip(self.rows, self.target, strict=True)
        ]
        pairs, open_ = [(one, one) for one in alone], np.tile(free, (len(alone), 1))
        return variations_of(pairs, open_, self.reference, wanted, typical, covariates)


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
    count = len(season.told)
    if count < _FEWEST:
        raise InputError(
            f"{season.file}: {count} usable throws; expected {_FEWEST} or more"
        )
    covariates = Covariates.of(season.labels, by, trend, trend_by)
    throws = _Quadratics.of(season, season.share)
    known, coefficients = throws.equal()
    if any(item.verdict == "at bound" for item in coefficients.values()):
        # What one throw leaves open may have gone there to explain what differs
        # between them.
        known, coefficients = throws.equal(1 / count)
    verdicts = {name: item.verdict for name, item in coefficients.items()}
    wanted = wanted_of(verdicts, known.combinations, tuple(coefficients))
    variation = {
        one.expression: one
        for one in _Quadratics.of(season).variations(wanted, covariates.values)
    }
    weights = told_by_each(
        season.rows(season.share)[..., :-1],
        throws.typical * throws.free,
        {name: wanted[name] for name in variation},
    )
    if not weights:
        raise InputError(f"{season.file}: a throw determines no coefficient by itself")
    equal = JointResult(
        law=season.model.law.name,
        load=season.model.load,
        share=tuple(coefficients),
        converged=True,
        status=f"converged ({count} throws that were fitted one by one)",
        warnings=season.warnings(),
        coefficients=coefficients,
        combinations=known.combinations,
        rank=known.identifiability.rank,
        parameters=int(throws.free.sum()),
        variation=tuple(variation.values()),
        table=season.summary(covariates.groups, known.identifiability.null_directions),
    )
    spreads = np.array([variation[name].first_spread for name in weights])
    found = throws.population(weights, covariates.values, spreads)
    some = np.linspace(0, count - 1, min(count, _TURNING)).astype(int)
    return about_mean(
        equal,
        found,
        covariates,
        Draw(season.model, season.stone),
        (season.values[some], season.start[some, -1]),
        sampled(found.fit, spreads, seed),
        left_open=season.counts_left_open(),
    )
