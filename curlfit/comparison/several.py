"""Comparison of laws on several data sets, all of which one set of coefficients must answer.

The noise of a data set without sigma is the least that any law leaves on this set alone, for all
laws alike. Where that is correlated it counts as its effective sample size; where it is smaller
than the noise of an ordinary tracker too, it is what the laws miss, and sigma is the latter. A
common optimum is thus one of weighted least squares, and the rise of chi squared from the optima of
the sets alone tests whether they agree under a law: it has as many degrees of freedom as these
determine more parameters than the common one (Maltoni and Schwetz 2003, Testing the statistical
compatibility of independent data sets).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from curlfit.comparison.adequacy import opposes_sliding
from curlfit.comparison.data_sets import LawOnSets, Noise, Told, best, data_sets
from curlfit.comparison.plan import plan
from curlfit.comparison.result import FOLLOWS, Candidate, Comparison, OnSet, SetOfData
from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import NetLaw
from curlfit.friction.family import family_of
from curlfit.friction_tables.table import FrictionTable
from curlfit.inference.fit.covariance import CONVERGED, Covariance
from curlfit.inference.least_squares import Solution
from curlfit.inference.problem import ROWS_OF_DATA
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.threads import in_threads
from curlfit.settings.choices import Comparing
from curlfit.throws.throw import Throw

_CHANCE = 0.01  # probability of a larger chi squared, where few values make larger ones likely
_AGREE = 0.001  # the same, for the rise of chi squared by common coefficients
_LARGEST = 3  # residuals that are named


class _Alone(NamedTuple):
    """A law on each data set alone."""

    law: LawOnSets
    each: list[tuple[Solution, Noise]]


class _Judged(NamedTuple):
    """A law on all data sets, and what is known of its candidate."""

    known: dict[str, Any]
    bic: float
    own_bic: list[float]


def compare_sets(
    items: Sequence[Throw | FrictionTable],
    chosen: Comparing,
    progress: Callable[[str, int, int], None] | None = None,
) -> Comparison:
    """The comparison of laws on several data sets, or on a table of throws.

    Raises
    ------
    InputError : as `compare`; a choice that holds for one track alone.
    """
    sets = data_sets(items)
    for name, usual in (("loss", "linear"), ("noise", ("white",)), ("priors", {}), ("free", ())):
        value = getattr(chosen, name)
        if (tuple(value) if isinstance(value, list) else value) != usual:
            raise InputError(f"{name}: expected it with one track; several data sets have none")
    todo = plan(chosen.laws, chosen.load)
    family = family_of(law for law, _ in todo)
    told = progress or (lambda *_: None)

    def alone(law: Any, load: Any) -> _Alone | Candidate:
        try:
            made = LawOnSets(law, load, sets, chosen, family)
            return _Alone(made, [made.alone(number) for number in range(len(sets))])
        except UnusableFitError as error:
            return Candidate(law.name, _load(law, load), opposes_sliding(law), False, str(error))

    found: list[_Alone] = []
    failed: list[Candidate] = []
    with in_threads(alone, todo) as results:
        for done, (law, _) in enumerate(todo):
            told(law.name, done, 2 * len(todo))
            one = next(results)
            if isinstance(one, _Alone):
                found.append(one)
            else:
                failed.append(one)
    if not found:
        raise UnusableFitError("; ".join(one.status for one in failed))
    noise, of_laws = _common_noise(found)
    made = []
    with in_threads(_judged, [(one, noise) for one in found]) as judged:
        for done, one in enumerate(found):
            told(one.law.law.name, len(todo) + done, 2 * len(todo))
            made.append(next(judged))
    candidates = (*_ranked(made), *failed)
    first = found[0].law
    return Comparison(
        data={
            "file": ", ".join(one.name for one in sets), "rows": int(first.counts().sum()),
            "from": 0.0, "to": 0.0, "law_file": None, "since": None, "until": None, "exclude": [],
            "swept": None, "sigma": {}, "notes": [], "flags": chosen.words(),
        },
        stone=first.rounds.throws[0].stone, curl=0.0, side=None, candidates=candidates,
        observed={name: [] for name in ("t", "x", "y", "phi")},
        sets=tuple(_described(first, k, noise, of_laws[k]) for k in range(len(sets))),
    )  # fmt: skip


def _load(law: Any, load: Any) -> str:
    return "-" if issubclass(law, NetLaw) else load


def _deviance(found: Solution, weight: Floats, unknown: Booleans, count: Floats) -> Floats:
    """-2 log-likelihood of each throw or table, up to a constant that all laws share; an unknown
    sigma has its likeliest value."""
    chi, largest = (found.residual**2).sum(-1), weight.max(-1)
    seen = count > 0
    some = np.where(seen, chi, 1.0) / np.where(seen, count * largest**2, 1.0)
    estimated = count * np.log(np.maximum(some, np.finfo(float).tiny))
    return np.where(unknown, estimated, chi).sum(-1)


def _common_noise(found: Sequence[_Alone]) -> tuple[Noise, list[str]]:
    """The least noise of each throw or table and channel that any law leaves on its data set alone;
    and these laws, by data set."""
    first, laws = found[0].law, [one.law.law.name for one in found]
    owner = np.maximum(first.owner, 0)
    each = [
        Noise(
            *(
                np.array([one.each[k][1][part][row] for row, k in enumerate(owner)])
                for part in range(3)
            )
        )
        for one in found
    ]
    sizes = np.nan_to_num([one.sigma for one in each], nan=np.inf)
    least = sizes.argmin(0)[None]
    best_of = [np.take_along_axis(np.array(part), least, 0)[0] for part in zip(*each, strict=True)]
    names = []
    for number in range(len(first.sets)):
        some = least[0][first.of_set(number)[:, None] & first.unknown & (first.counts() > 0)]
        names.append(", ".join(dict.fromkeys(laws[index] for index in some)))
    return Noise(*best_of), names


def _judged(one: _Alone, noise: Noise) -> _Judged:
    """A law with the common noise: at its common optimum, and beside it at those of each set."""
    law = one.law
    weight, every = law.weights(noise), law.owner >= 0
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
    told = law.told(common)
    known = told.by(every)
    each, own_bic, ranks = [], [], 0
    for inside, found in zip(groups, alone, strict=True):
        own = law.told(found)
        numbers = float(count[inside].sum())
        spent = float(own.parameters()[inside].sum())
        deviance = _deviance(found, weight, unknown, count)[inside].sum()
        own_bic.append(float(deviance) + spent * math.log(numbers))
        ranks += own.by(inside).identifiability.rank
        each.append(_on_set(told, inside, common, (found, numbers, spent), noise))
    rise = sum(item.chi_squared - item.own_chi_squared for item in each)
    more = ranks - known.identifiability.rank
    p = float(chdtrc(more, max(rise, 0.0))) if more > 0 else None
    rank = float(known.identifiability.rank + told.reduction.rank[every].sum())
    bic = float(_deviance(common, weight, unknown, count)[every].sum())
    converged = bool(known.distance < CONVERGED and np.isfinite(common.residual).all())
    return _Judged(
        _coefficients(law, known) | {
            "law": law.law.name, "load": _load(law.law, law.model.load),
            "isotropic": opposes_sliding(law.law),
            "signs_free": False, "converged": converged,
            "status": "converged" if converged else "not converged", "n_parameters": rank,
            "sets": tuple(each), "p_together": p,
            "follows": all(item.follows for item in each) and (p is None or p >= _AGREE),
        },
        bic + rank * math.log(count[every].sum()), own_bic,
    )  # fmt: skip


def _on_set(
    told: Told, inside: Booleans, common: Solution, alone: tuple[Solution, float, float],
    noise: Noise,
) -> OnSet:  # fmt: skip
    """A law on a data set, with its common coefficients and with its own."""
    found, count, spent = alone
    dof = max(count - float(told.parameters()[inside].sum()), 1.0)
    own_dof = max(count - spent, 1.0)
    chi, own = (float(one.chi_squared[inside].sum()) for one in (common, found))
    known = told.by(inside)
    return OnSet(
        chi_squared=chi, dof=dof, own_chi_squared=own, own_dof=own_dof,
        follows=_follows(chi, dof), own_follows=_follows(own, own_dof),
        rank=known.identifiability.rank,
        determined=tuple(known.identifiability.determined()),
        largest=_largest(told.of, inside, common, noise),
    )  # fmt: skip


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


def _coefficients(law: LawOnSets, known: Covariance) -> dict[str, Any]:
    """The coefficients of the common optimum, and the combinations that it determines."""
    found: dict[str, Any] = {}
    for place, item in enumerate(law.law.coefficients()):
        stderr, verdict = None, "fixed"
        if known.free[place]:
            stderr, verdict, _ = known.classified(place)
        value = float(known.values[place])
        found[item.name] = {"value": value, "stderr": stderr, "verdict": verdict, "unit": item.unit}
    of = {
        verdict: tuple(name for name, one in found.items() if one["verdict"] == verdict)
        for verdict in ("at bound", "not identifiable")
    }
    sums = tuple(
        {"expression": item.expression, "value": item.value, "stderr": item.stderr}
        for item in known.combinations
    )
    return {
        "coefficients": found, "combinations": sums, "at_bound": of["at bound"],
        "not_identifiable": of["not identifiable"],
    }  # fmt: skip


def _ranked(made: Sequence[_Judged]) -> list[Candidate]:
    """The candidates, best first: laws that follow all data sets before others, by BIC."""
    least = np.min([one.own_bic for one in made], axis=0)
    order = sorted(
        made,
        key=lambda one: (not one.known["converged"], not one.known["follows"], round(one.bic, 1)),
    )
    found, rank = [], 0
    for one in order:
        rank += one.known["converged"]
        sets = tuple(
            replace(item, own_delta_bic=float(bic - low))
            for item, bic, low in zip(one.known["sets"], one.own_bic, least, strict=True)
        )
        found.append(
            Candidate(
                **one.known | {"sets": sets}, bic=one.bic, delta_bic=one.bic - order[0].bic,
                rank=rank if one.known["converged"] else None,
            )
        )  # fmt: skip
    return found


def _described(law: LawOnSets, number: int, noise: Noise, of_law: str) -> SetOfData:
    """What a data set is, and its noise."""
    inside, count = law.of_set(number), law.counts()
    one = law.sets[number]
    some = law.unknown & inside[:, None] & (count > 0)
    names = [*ROWS_OF_DATA[:-1], "mu"]
    sigma = {names[k]: float(noise.sigma[row, k]) for row, k in np.argwhere(some)}
    return SetOfData(
        name=one.name, kind=one.kind, throws=len(one.throws), values=int(count[inside].sum()),
        effective=float((count * noise.share)[inside].sum()), sigma=sigma,
        noise_of=of_law,
    )  # fmt: skip
