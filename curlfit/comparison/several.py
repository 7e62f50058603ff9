"""Comparison of laws on several data sets, all of which one set of coefficients
must answer.

The noise of a data set without sigma is the least that any law leaves on this set
alone, for all laws alike. Where that is correlated it counts as its effective sample
size; where it is smaller than the noise of an ordinary tracker too, it is what the laws
miss, and sigma is the latter. A common optimum is thus one of weighted least squares,
and the rise of chi squared from the optima of the sets alone tests whether they agree
under a law: it has as many degrees of freedom as these determine more parameters than
the common one (Maltoni and Schwetz 2003, Testing the statistical compatibility of
independent data sets).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import jax
import numpy as np
from scipy.special import chdtrc, chdtri

from curlfit.comparison.candidates import (
    Progress,
    best_first,
    computed,
    parted,
    unfitted,
    with_coefficients,
    with_ranks,
)
from curlfit.comparison.result import FOLLOWS, Candidate, Comparison, OnSet, SetOfData
from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, Load
from curlfit.friction.family import family_of
from curlfit.friction.registry import laws_under
from curlfit.inference.fit.entries import DataOfFit
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.model.problem import ROWS_OF_DATA
from curlfit.inference.solve.least_squares import Solution
from curlfit.inference.together.data_sets import LawOnSets, Noise, best, data_sets
from curlfit.losses import LINEAR
from curlfit.noises import WHITE
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.settings.choices import Comparing
from curlfit.throws.friction_table import FrictionTable
from curlfit.throws.odd_row import OddRow
from curlfit.throws.throw import Throw

_CHANCE = 0.01
"""Probability of a larger chi squared, down to which a law follows a data set: few
values make larger ones likely."""
_AGREE = 0.001
"""Probability of a larger rise of chi squared by common coefficients, down to which
data sets agree."""
_LARGEST = 3  # residuals that are named

_ONE_TRACK: dict[str, Any] = {
    "loss": LINEAR,
    "noise": (WHITE,),
    "priors": {},
    "free": (),
}
"""Choices that only one track may have, with their usual values."""


class _FitsAlone(NamedTuple):
    """A law fitted to each data set alone."""

    law: LawOnSets
    optima: list[Solution]
    noises: list[Noise]
    """that the residuals of each show"""

    @classmethod
    def of(cls, law: LawOnSets) -> Self:
        """Fit the law to each of its data sets."""
        optima = []
        noises = []
        for number in range(len(law.sets)):
            optimum, noise = law.alone(number)
            optima.append(optimum)
            noises.append(noise)
        return cls(law, optima, noises)


def compare_sets(
    data: Sequence[Throw | FrictionTable],
    chosen: Comparing,
    progress: Progress | None = None,
) -> Comparison:
    """The comparison of laws on several data sets, or on a table of throws.

    Raises
    ------
    InputError : as `compare`; a choice that holds for one track alone.
    """
    sets = data_sets(data)
    for name, usual in _ONE_TRACK.items():
        value = getattr(chosen, name)
        if (tuple(value) if isinstance(value, list) else value) != usual:
            raise InputError(
                f"{name}: expected it with one track; several data sets have none"
            )
    laws_and_loads = laws_under(chosen.laws, chosen.load)
    family = family_of(law for law, _ in laws_and_loads)
    count = len(laws_and_loads)

    def fitted_alone(law: type[Law], load: Load) -> _FitsAlone | Candidate:
        try:
            return _FitsAlone.of(LawOnSets(law, load, sets, chosen, family))
        except UnusableFitError as error:
            return replace(unfitted(law, load), status=str(error))

    names = [law.name for law, _ in laws_and_loads]
    fits, failed = parted(
        computed(fitted_alone, laws_and_loads, names, 0, 2 * count, progress)
    )
    noise, laws_of_noise = _common_noise(fits)
    names = [fit.law.law.name for fit in fits]
    arguments = [(fit, noise) for fit in fits]
    candidates = _counted_from_least_bic(
        computed(_compared, arguments, names, count, 2 * count, progress)
    )
    in_order = [candidates[index] for index in best_first(candidates)]
    first = fits[0].law
    return Comparison(
        data=DataOfFit(
            file=", ".join(data_set.name for data_set in sets),
            rows=int(first.counts().sum()),
            begin=0.0,
            end=0.0,
            flags=tuple(chosen.words()),
        ),
        stone=first.stack.requests[0].stone,
        curl=0.0,
        side=None,
        candidates=(*with_ranks(in_order), *failed),
        observed={name: [] for name in ("t", "x", "y", "phi")},
        odd_rows=_odd_rows(data),
        sets=tuple(
            _described(first, number, noise, law)
            for number, law in enumerate(laws_of_noise)
        ),
    )


def _odd_rows(data: Sequence[Throw | FrictionTable]) -> tuple[OddRow, ...]:
    """Odd rows of the tables that the throws are of; each throw has all of its
    table."""
    throws = [throw for throw in data if isinstance(throw, Throw)]
    return tuple(dict.fromkeys(odd for throw in throws for odd in throw.odd_rows))


def _deviances(
    optimum: Solution, weight: Floats, unknown: Booleans, values: Floats
) -> Floats:
    """-2 log-likelihood of each throw or table, up to a constant that all laws share.

    Parameters
    ----------
    unknown : by throw or table and channel, whether sigma has its likeliest value.
    values : effective numbers of values, of the same shape.
    """
    chi_squared = (optimum.residual**2).sum(-1)
    is_measured = values > 0
    squares = np.where(is_measured, chi_squared, 1.0)
    variance = squares / np.where(is_measured, values * weight.max(-1) ** 2, 1.0)
    of_unknown = values * np.log(np.maximum(variance, np.finfo(float).tiny))
    return np.where(unknown, of_unknown, chi_squared).sum(-1)


def _common_noise(fits: Sequence[_FitsAlone]) -> tuple[Noise, list[str]]:
    """The least noise of each throw or table and channel that any law leaves on its
    data set alone; and these laws, by data set."""
    first = fits[0].law
    rows = np.arange(len(first.owner))
    by_law = stacked([stacked(fit.noises) for fit in fits])
    # of each law, the noise of a row is that of the fit to its data set
    noises: Noise = jax.tree.map(lambda values: values[:, first.owner, rows], by_law)
    least = np.nan_to_num(noises.sigma, nan=np.inf).argmin(0)
    common = jax.tree.map(
        lambda values: np.take_along_axis(values, least[None], 0)[0], noises
    )
    laws_of_noise = []
    for number in range(len(first.sets)):
        of_set = first.of_set(number)[:, None]
        estimated = of_set & first.unknown & (first.counts() > 0)
        laws = [fits[index].law.law.name for index in least[estimated]]
        laws_of_noise.append(", ".join(dict.fromkeys(laws)))
    return common, laws_of_noise


def _counted_from_least_bic(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates whose BIC on each data set alone is counted from the least."""
    bic = np.array(
        [
            [on_set.own_delta_bic for on_set in candidate.sets]
            for candidate in candidates
        ]
    )
    differences = (bic - bic.min(axis=0)).tolist()
    counted = []
    for candidate, of_law in zip(candidates, differences, strict=True):
        sets = [
            replace(on_set, own_delta_bic=difference)
            for on_set, difference in zip(candidate.sets, of_law, strict=True)
        ]
        counted.append(replace(candidate, sets=tuple(sets)))
    return counted


def _compared(fits: _FitsAlone, noise: Noise) -> Candidate:
    """A law with the common noise: at its common optimum, and beside it at those of
    each set, whose BIC stands in place of its difference from the least."""
    law = fits.law
    weight = law.weights(noise)
    rows_by_set = [law.of_set(number) for number in range(len(law.sets))]
    optima = [
        law.optimum(rows, optimum.values, weight)
        for rows, optimum in zip(rows_by_set, fits.optima, strict=True)
    ]
    common_optimum = law.together(optima, weight)
    for number, rows in enumerate(rows_by_set):
        of_common = common_optimum.chi_squared[rows].sum()
        if of_common >= optima[number].chi_squared[rows].sum():
            continue
        # the search of this set alone ended too early
        from_common = law.optimum(rows, common_optimum.values, weight)
        optima[number] = best([optima[number], from_common])
    common = law.at_optimum(common_optimum)
    covariance = common.covariance()
    departures = law.departures_of_all(covariance, common_optimum, weight)
    values = law.counts() * noise.share  # effective numbers
    unknown = law.unknown & ~noise.assumed
    spent_by_row = common.parameters()
    sets = []
    rank_of_sets = 0
    for rows, optimum in zip(rows_by_set, optima, strict=True):
        of_set = law.at_optimum(optimum)
        rank_of_sets += of_set.covariance(rows).identifiability.rank
        values_of_set = float(values[rows].sum())
        own_spent = float(of_set.parameters()[rows].sum())
        own_deviance = float(_deviances(optimum, weight, unknown, values)[rows].sum())
        chi_squared = float(common_optimum.chi_squared[rows].sum())
        dof = max(values_of_set - float(spent_by_row[rows].sum()), 1.0)
        own_chi_squared = float(optimum.chi_squared[rows].sum())
        own_dof = max(values_of_set - own_spent, 1.0)
        with_common = common.covariance(rows).identifiability
        sets.append(
            OnSet(
                chi_squared=chi_squared,
                dof=dof,
                own_chi_squared=own_chi_squared,
                own_dof=own_dof,
                follows=_follows(chi_squared, dof),
                own_follows=_follows(own_chi_squared, own_dof),
                rank=with_common.rank,
                determined=tuple(with_common.weights_of_determined()),
                largest=_largest(law, rows, common_optimum, noise),
                own_delta_bic=own_deviance + own_spent * math.log(values_of_set),
            )
        )
    rank_of_all = covariance.identifiability.rank
    rise = sum(on_set.chi_squared - on_set.own_chi_squared for on_set in sets)
    more_parameters = rank_of_sets - rank_of_all
    p_together = None
    if more_parameters > 0:
        p_together = float(chdtrc(more_parameters, max(rise, 0.0)))
    agree = p_together is None or p_together >= _AGREE
    parameters = float(rank_of_all + common.marginal.rank.sum())
    deviance = float(_deviances(common_optimum, weight, unknown, values).sum())
    is_finite = bool(np.isfinite(common_optimum.residual).all())
    converged = bool(covariance.distance < CONVERGED) and is_finite
    candidate = with_coefficients(
        unfitted(law.law, law.model.load),
        *common.estimates(covariance, departures=departures),
    )
    return replace(
        candidate,
        converged=converged,
        status="converged" if converged else "not converged",
        n_parameters=parameters,
        sets=tuple(sets),
        p_together=p_together,
        follows=agree and all(on_set.follows for on_set in sets),
        bic=deviance + parameters * math.log(values.sum()),
    )


def _follows(chi_squared: float, dof: float) -> bool:
    """Whether chi squared is about its expectation, or not larger than by chance."""
    return bool(chi_squared <= max(FOLLOWS * dof, float(chdtri(dof, _CHANCE))))


def _largest(
    law: LawOnSets, rows: Booleans, optimum: Solution, noise: Noise
) -> tuple[tuple[str, float], ...]:
    """The largest residuals of a data set, model - data over sigma, by name."""
    residual = optimum.residual / np.sqrt(noise.share)[..., None]
    residual = residual * rows[:, None, None]
    order = np.argsort(-np.abs(residual), axis=None)[:_LARGEST]
    largest = []
    for index in order:
        row, channel, column = np.unravel_index(index, residual.shape)
        name = law.called(row, channel, column)
        largest.append((name, float(residual[row, channel, column])))
    return tuple(largest)


def _described(
    law: LawOnSets, number: int, noise: Noise, law_of_noise: str
) -> SetOfData:
    """What a data set is, and its noise."""
    data_set = law.sets[number]
    rows = law.of_set(number)
    values = law.counts()
    estimated = law.unknown & rows[:, None] & (values > 0)
    names = [*ROWS_OF_DATA[:-1], "mu"]
    sigma = {
        names[channel]: float(noise.sigma[row, channel])
        for row, channel in np.argwhere(estimated)
    }
    return SetOfData(
        name=data_set.name,
        kind=data_set.kind,
        throws=len(data_set.throws),
        values=int(values[rows].sum()),
        effective=float((values * noise.share)[rows].sum()),
        sigma=sigma,
        noise_of=law_of_noise,
    )
