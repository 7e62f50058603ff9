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
from typing import Any, NamedTuple

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
from curlfit.friction.family import family_of
from curlfit.friction.registry import laws_under
from curlfit.inference.fit.entries import DataOfFit
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.joint.data_sets import LawOnSets, Noise, Told, best, data_sets
from curlfit.inference.least_squares import Solution
from curlfit.inference.problem import ROWS_OF_DATA
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


class _Alone(NamedTuple):
    """A law on each data set alone."""

    law: LawOnSets
    each: list[tuple[Solution, Noise]]


def compare_sets(
    items: Sequence[Throw | FrictionTable],
    chosen: Comparing,
    progress: Progress | None = None,
) -> Comparison:
    """The comparison of laws on several data sets, or on a table of throws.

    Raises
    ------
    InputError : as `compare`; a choice that holds for one track alone.
    """
    sets = data_sets(items)
    for name, usual in (
        ("loss", LINEAR),
        ("noise", (WHITE,)),
        ("priors", {}),
        ("free", ()),
    ):
        value = getattr(chosen, name)
        if (tuple(value) if isinstance(value, list) else value) != usual:
            raise InputError(
                f"{name}: expected it with one track; several data sets have none"
            )
    todo = laws_under(chosen.laws, chosen.load)
    family = family_of(law for law, _ in todo)

    def alone(law: Any, load: Any) -> _Alone | Candidate:
        try:
            made = LawOnSets(law, load, sets, chosen, family)
            return _Alone(made, [made.alone(number) for number in range(len(sets))])
        except UnusableFitError as error:
            return Candidate(**about(law, load), status=str(error))

    total, names = 2 * len(todo), [law.name for law, _ in todo]
    found, failed = parted(computed(alone, todo, names, 0, total, progress))
    noise, of_laws = _common_noise(found)
    names, fits = [one.law.law.name for one in found], [(one, noise) for one in found]
    made = computed(_judged, fits, names, len(todo), total, progress)
    least = np.min(
        [[item.own_delta_bic for item in one["sets"]] for one in made], axis=0
    )
    for one in made:
        one["sets"] = tuple(
            replace(item, own_delta_bic=float(item.own_delta_bic - low))
            for item, low in zip(one["sets"], least, strict=True)
        )
    candidates = (*(Candidate(**made[row]) for row in ranked(made)), *failed)
    first = found[0].law
    return Comparison(
        data=DataOfFit(
            file=", ".join(data_set.name for data_set in sets),
            rows=int(first.counts().sum()),
            begin=0.0,
            end=0.0,
            flags=tuple(chosen.words()),
        ),
        stone=first.rounds.throws[0].stone,
        curl=0.0,
        side=None,
        candidates=candidates,
        observed={name: [] for name in ("t", "x", "y", "phi")},
        odd_rows=_odd_rows(items),
        sets=tuple(_described(first, k, noise, of_laws[k]) for k in range(len(sets))),
    )


def _odd_rows(items: Sequence[Throw | FrictionTable]) -> tuple[OddRow, ...]:
    """Those of the tables of throws; each throw has all of its table."""
    throws = [item for item in items if isinstance(item, Throw)]
    return tuple(dict.fromkeys(odd for throw in throws for odd in throw.odd_rows))


def _deviance(
    found: Solution, weight: Floats, unknown: Booleans, count: Floats
) -> Floats:
    """-2 log-likelihood of each throw or table, up to a constant that all laws share;
    an unknown sigma has its likeliest value."""
    chi, largest = (found.residual**2).sum(-1), weight.max(-1)
    seen = count > 0
    some = np.where(seen, chi, 1.0) / np.where(seen, count * largest**2, 1.0)
    estimated = count * np.log(np.maximum(some, np.finfo(float).tiny))
    return np.where(unknown, estimated, chi).sum(-1)


def _common_noise(found: Sequence[_Alone]) -> tuple[Noise, list[str]]:
    """The least noise of each throw or table and channel that any law leaves on its
    data set alone; and these laws, by data set."""
    first, laws = found[0].law, [one.law.law.name for one in found]
    own = first.owner, np.arange(len(first.owner))
    noises = ([noise for _, noise in one.each] for one in found)
    each = [
        Noise(*(np.stack(part)[own] for part in zip(*one, strict=True)))
        for one in noises
    ]
    sizes = np.nan_to_num([one.sigma for one in each], nan=np.inf)
    least = sizes.argmin(0)[None]
    best_of = [
        np.take_along_axis(np.array(part), least, 0)[0]
        for part in zip(*each, strict=True)
    ]
    names = []
    for number in range(len(first.sets)):
        some = least[0][
            first.of_set(number)[:, None] & first.unknown & (first.counts() > 0)
        ]
        names.append(", ".join(dict.fromkeys(laws[index] for index in some)))
    return Noise(*best_of), names


def _judged(one: _Alone, noise: Noise) -> dict[str, Any]:
    """What is known of a law with the common noise: at its common optimum, and
    beside it at those of each set, whose BIC stands in place of its difference
    from the least."""
    law = one.law
    weight = law.weights(noise)
    groups = [law.of_set(number) for number in range(len(law.sets))]
    alone = [
        law.optimum(inside, found.values, weight)
        for inside, (found, _) in zip(groups, one.each, strict=True)
    ]
    common = law.together(alone, weight)
    alone = [
        best([found, law.optimum(inside, common.values, weight)])
        if common.chi_squared[inside].sum() < found.chi_squared[inside].sum()
        else found
        for inside, found in zip(groups, alone, strict=True)
    ]
    count, unknown = law.counts() * noise.share, law.unknown & ~noise.assumed
    joint = law.told(common)
    known, made, ranks = joint.by(), [], 0
    departures = law.departures_of_all(known, common, weight)
    for inside, found in zip(groups, alone, strict=True):
        own = law.told(found)
        numbers = float(count[inside].sum())
        spent = float(own.parameters()[inside].sum())
        deviance = float(_deviance(found, weight, unknown, count)[inside].sum())
        ranks += own.by(inside).identifiability.rank
        on = _on_set(joint, inside, common, (found, numbers, spent), noise)
        made.append(replace(on, own_delta_bic=deviance + spent * math.log(numbers)))
    rise = sum(item.chi_squared - item.own_chi_squared for item in made)
    more = ranks - known.identifiability.rank
    p = float(chdtrc(more, max(rise, 0.0))) if more > 0 else None
    rank = float(known.identifiability.rank + joint.marginal.rank.sum())
    bic = float(_deviance(common, weight, unknown, count).sum())
    converged = bool(known.distance < CONVERGED and np.isfinite(common.residual).all())
    return (
        about(law.law, law.model.load)
        | described(*joint.estimates(known, departures=departures))
        | {
            "converged": converged,
            "status": "converged" if converged else "not converged",
            "n_parameters": rank,
            "sets": tuple(made),
            "p_together": p,
            "follows": all(item.follows for item in made)
            and (p is None or p >= _AGREE),
            "bic": bic + rank * math.log(count.sum()),
        }
    )


def _on_set(
    joint: Told,
    inside: Booleans,
    common: Solution,
    alone: tuple[Solution, float, float],
    noise: Noise,
) -> OnSet:
    """A law on a data set, with its common coefficients and with its own."""
    found, count, spent = alone
    dof = max(count - float(joint.parameters()[inside].sum()), 1.0)
    own_dof = max(count - spent, 1.0)
    chi, own = (float(one.chi_squared[inside].sum()) for one in (common, found))
    known = joint.by(inside)
    return OnSet(
        chi_squared=chi,
        dof=dof,
        own_chi_squared=own,
        own_dof=own_dof,
        follows=_follows(chi, dof),
        own_follows=_follows(own, own_dof),
        rank=known.identifiability.rank,
        determined=tuple(known.identifiability.determined()),
        largest=_largest(joint.of, inside, common, noise),
    )


def _follows(chi_squared: float, dof: float) -> bool:
    return bool(chi_squared <= max(FOLLOWS * dof, float(chdtri(dof, _CHANCE))))


def _largest(
    law: LawOnSets, inside: Booleans, found: Solution, noise: Noise
) -> tuple[tuple[str, float], ...]:
    """The largest residuals of a data set, model - data over sigma, by name."""
    off = found.residual / np.sqrt(noise.share)[..., None] * inside[:, None, None]
    order = np.argsort(-np.abs(off), axis=None)[:_LARGEST]
    places = zip(*np.unravel_index(order, off.shape), strict=True)
    return tuple((law.called(*place), float(off[place])) for place in places)


def _described(law: LawOnSets, number: int, noise: Noise, of_law: str) -> SetOfData:
    """What a data set is, and its noise."""
    inside, count = law.of_set(number), law.counts()
    one = law.sets[number]
    some = law.unknown & inside[:, None] & (count > 0)
    names = [*ROWS_OF_DATA[:-1], "mu"]
    sigma = {names[k]: float(noise.sigma[row, k]) for row, k in np.argwhere(some)}
    return SetOfData(
        name=one.name,
        kind=one.kind,
        throws=len(one.throws),
        values=int(count[inside].sum()),
        effective=float((count * noise.share)[inside].sum()),
        sigma=sigma,
        noise_of=of_law,
    )
