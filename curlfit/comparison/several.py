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

import numpy as np
from scipy.special import chdtrc, chdtri

from curlfit.comparison.candidates import (
    Progress,
    about,
    computed,
    described,
    parted,
    ranked,
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
from curlfit.settings.choices import Comparing
from curlfit.throws.friction_table import FrictionTable
from curlfit.throws.odd_row import OddRow
from curlfit.throws.throw import Throw

# probability of a larger chi squared, where few values make larger ones likely
_CHANCE = 0.01
_AGREE = 0.001  # the same, for the rise of chi squared by common coefficients
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
            return Candidate(**about(law, load), status=str(error))

    names = [law.name for law, _ in laws_and_loads]
    fits, failed = parted(
        computed(fitted_alone, laws_and_loads, names, 0, 2 * count, progress)
    )
    noise, laws_of_noise = _common_noise(fits)
    names = [fit.law.law.name for fit in fits]
    arguments = [(fit, noise) for fit in fits]
    fields_by_law = computed(_fields_of, arguments, names, count, 2 * count, progress)
    _count_from_least_bic(fields_by_law)
    ordered = [fields_by_law[row] for row in ranked(fields_by_law)]
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
        candidates=(*(Candidate(**fields) for fields in ordered), *failed),
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
    optimum: Solution, weight: Floats, unknown: Booleans, count: Floats
) -> Floats:
    """-2 log-likelihood of each throw or table, up to a constant that all laws share;
    an unknown sigma has its likeliest value."""
    chi_squared = (optimum.residual**2).sum(-1)
    largest = weight.max(-1)
    is_measured = count > 0
    variance = np.where(is_measured, chi_squared, 1.0) / np.where(
        is_measured, count * largest**2, 1.0
    )
    of_unknown = count * np.log(np.maximum(variance, np.finfo(float).tiny))
    return np.where(unknown, of_unknown, chi_squared).sum(-1)


def _common_noise(fits: Sequence[_FitsAlone]) -> tuple[Noise, list[str]]:
    """The least noise of each throw or table and channel that any law leaves on its
    data set alone; and these laws, by data set."""
    first = fits[0].law
    rows = np.arange(len(first.owner))
    # Of each law, the noise of a row is that of the fit to its data set.
    noises = [
        Noise(
            sigma=np.stack([noise.sigma for noise in fit.noises])[first.owner, rows],
            share=np.stack([noise.share for noise in fit.noises])[first.owner, rows],
            assumed=np.stack([noise.assumed for noise in fit.noises])[
                first.owner, rows
            ],
        )
        for fit in fits
    ]
    sigmas = np.nan_to_num([noise.sigma for noise in noises], nan=np.inf)
    least = sigmas.argmin(0)[None]

    def of_least(parts: Sequence[Any]) -> Any:
        return np.take_along_axis(np.array(parts), least, 0)[0]

    common = Noise(
        sigma=of_least([noise.sigma for noise in noises]),
        share=of_least([noise.share for noise in noises]),
        assumed=of_least([noise.assumed for noise in noises]),
    )
    laws_of_noise = []
    for number in range(len(first.sets)):
        of_set = first.of_set(number)[:, None]
        estimated = of_set & first.unknown & (first.counts() > 0)
        laws = [fits[index].law.law.name for index in least[0][estimated]]
        laws_of_noise.append(", ".join(dict.fromkeys(laws)))
    return common, laws_of_noise


def _count_from_least_bic(fields_by_law: Sequence[dict[str, Any]]) -> None:
    """Let the BIC of laws on each data set alone be differences from the least."""
    bic = np.array(
        [[on_set.own_delta_bic for on_set in law["sets"]] for law in fields_by_law]
    )
    differences = (bic - bic.min(axis=0)).tolist()
    for fields, of_law in zip(fields_by_law, differences, strict=True):
        fields["sets"] = tuple(
            replace(on_set, own_delta_bic=difference)
            for on_set, difference in zip(fields["sets"], of_law, strict=True)
        )


def _fields_of(fits: _FitsAlone, noise: Noise) -> dict[str, Any]:
    """The fields of a law's `Candidate` with the common noise: at its common optimum,
    and beside it at those of each set, whose BIC stands in place of its difference
    from the least."""
    law = fits.law
    weight = law.weights(noise)
    members = [law.of_set(number) for number in range(len(law.sets))]
    alone = [
        law.optimum(inside, optimum.values, weight)
        for inside, optimum in zip(members, fits.optima, strict=True)
    ]
    common = law.together(alone, weight)
    alone = [
        _no_worse_than(common, law, inside, optimum, weight)
        for inside, optimum in zip(members, alone, strict=True)
    ]
    count = law.counts() * noise.share
    unknown = law.unknown & ~noise.assumed
    joint = law.at_optimum(common)
    of_all = joint.covariance()
    departures = law.departures_of_all(of_all, common, weight)
    sets = []
    ranks = 0
    for inside, optimum in zip(members, alone, strict=True):
        of_set = law.at_optimum(optimum)
        ranks += of_set.covariance(inside).identifiability.rank
        values = float(count[inside].sum())
        spent = float(of_set.parameters()[inside].sum())
        deviances = _deviances(optimum, weight, unknown, count)
        bic = float(deviances[inside].sum()) + spent * math.log(values)
        dof = max(values - float(joint.parameters()[inside].sum()), 1.0)
        own_dof = max(values - spent, 1.0)
        chi_squared = float(common.chi_squared[inside].sum())
        own_chi_squared = float(optimum.chi_squared[inside].sum())
        with_common = joint.covariance(inside)
        sets.append(
            OnSet(
                chi_squared=chi_squared,
                dof=dof,
                own_chi_squared=own_chi_squared,
                own_dof=own_dof,
                follows=_follows(chi_squared, dof),
                own_follows=_follows(own_chi_squared, own_dof),
                rank=with_common.identifiability.rank,
                determined=tuple(with_common.identifiability.weights_of_determined()),
                largest=_largest(law, inside, common, noise),
                own_delta_bic=bic,
            )
        )
    rise = sum(on_set.chi_squared - on_set.own_chi_squared for on_set in sets)
    more = ranks - of_all.identifiability.rank
    p_together = float(chdtrc(more, max(rise, 0.0))) if more > 0 else None
    agree = p_together is None or p_together >= _AGREE
    rank = float(of_all.identifiability.rank + joint.marginal.rank.sum())
    deviance = float(_deviances(common, weight, unknown, count).sum())
    is_finite = bool(np.isfinite(common.residual).all())
    converged = bool(of_all.distance < CONVERGED) and is_finite
    fields = about(law.law, law.model.load)
    fields |= described(*joint.estimates(of_all, departures=departures))
    return fields | {
        "converged": converged,
        "status": "converged" if converged else "not converged",
        "n_parameters": rank,
        "sets": tuple(sets),
        "p_together": p_together,
        "follows": agree and all(on_set.follows for on_set in sets),
        "bic": deviance + rank * math.log(count.sum()),
    }


def _no_worse_than(
    common: Solution,
    law: LawOnSets,
    inside: Booleans,
    optimum: Solution,
    weight: Floats,
) -> Solution:
    """The optimum of a data set alone; where the common one is better on it, the better
    one of those reached from both."""
    if common.chi_squared[inside].sum() >= optimum.chi_squared[inside].sum():
        return optimum
    return best([optimum, law.optimum(inside, common.values, weight)])


def _follows(chi_squared: float, dof: float) -> bool:
    """Whether a law follows data: whether chi squared is about its expectation, or not
    larger than by chance."""
    return bool(chi_squared <= max(FOLLOWS * dof, float(chdtri(dof, _CHANCE))))


def _largest(
    law: LawOnSets, inside: Booleans, optimum: Solution, noise: Noise
) -> tuple[tuple[str, float], ...]:
    """The largest residuals of a data set, model - data over sigma, by name."""
    residual = optimum.residual / np.sqrt(noise.share)[..., None]
    residual = residual * inside[:, None, None]
    order = np.argsort(-np.abs(residual), axis=None)[:_LARGEST]
    places = zip(*np.unravel_index(order, residual.shape), strict=True)
    return tuple((law.called(*place), float(residual[place])) for place in places)


def _described(
    law: LawOnSets, number: int, noise: Noise, law_of_noise: str
) -> SetOfData:
    """What a data set is, and its noise."""
    inside = law.of_set(number)
    count = law.counts()
    data_set = law.sets[number]
    estimated = law.unknown & inside[:, None] & (count > 0)
    names = [*ROWS_OF_DATA[:-1], "mu"]
    sigma = {
        names[channel]: float(noise.sigma[row, channel])
        for row, channel in np.argwhere(estimated)
    }
    return SetOfData(
        name=data_set.name,
        kind=data_set.kind,
        throws=len(data_set.throws),
        values=int(count[inside].sum()),
        effective=float((count * noise.share)[inside].sum()),
        sigma=sigma,
        noise_of=law_of_noise,
    )
