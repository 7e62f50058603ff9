"""Throws that decide between laws, before they are made (T-optimal design).

Each law in turn makes the throws, and each other is fitted to them (Atkinson and
Fedorov, Biometrika 62 (1975) 57, of two laws; 289, of several). The chi squared lambda
that is left is how far the rival stays behind. Where noise is added, chi squared of the
rival minus that of the true law has the mean lambda + k_true - k_rival and, to first
order, the variance 4 lambda + 2 (k_true + k_rival), k being the number of directions of
the coefficients that the throws determine. The variance is an upper limit: what both
laws can follow does not scatter. By BIC (Schwarz 1978) of n values, the log odds for
the true law are (that difference + (k_rival - k_true) ln n)/2.

Throws are chosen for the worst pair of a true law and a rival; those that are proposed
have been fitted together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from curlfit.errors import InputError
from curlfit.friction import TERMS, Law, find_law
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.optimal_design.design import SPEEDS, SPINS, planned_throws
from curlfit.optimal_design.discrimination import (
    MARGIN,
    PROBABILITY,
    Discrimination,
    Pair,
    PossibleThrow,
)
from curlfit.optimal_design.information import Assumptions, PlannedThrow
from curlfit.optimal_design.rivals import Rival, Truth
from curlfit.optimal_design.selection import exchanged
from curlfit.stone import Stone

_ORDINARY = 2.0, 1.0  # m/s, rad/s: the draw in which all laws agree
_MOST = 64  # throws
_ONE_BY_ONE = 8  # throws that are chosen one by one; more are these repeated


@dataclass(frozen=True)
class Contest:
    """A rival fitted to the throws of the true law.

    Attributes
    ----------
    rows : of each candidate, as `Rival` gives them.
    ranks : of the coefficients of the true law and of the rival, from all candidates.
    """

    truth: Truth
    rival: Rival
    rows: Floats
    ranks: tuple[int, int]

    def promise(self, throws: Sequence[int], rows: Floats | None = None) -> Pair:
        """Of candidates together; of their rows, if others are better."""
        left, _ = self.rival.fit(self.rows[[*throws]] if rows is None else rows)
        values = len(self.truth.assumed.sigma) * sum(
            self.truth.rows[one] for one in throws
        )
        return Pair.of(
            self.truth.law, self.rival.model.law.name, left, self.ranks, values
        )

    def verified(self, throws: Sequence[int], times: int) -> Pair:
        """The same of candidates, each repeated so many times, from a fit of
        them together."""
        whole = [*throws] * times
        linear = self.promise(whole)
        if len(throws) == 1:  # fitted already
            return linear
        _, start = self.rival.fit(self.rows[[*throws]])
        rows, converged = self.rival.together(
            [self.truth.throws[k] for k in throws], start
        )
        found = self.promise(whole, np.tile(rows, (times, 1, 1)))
        return found if converged or found.chi_squared < linear.chi_squared else linear


def discriminate(
    laws: Sequence[str | type[Law] | FitResult],
    *,
    coefficients: Mapping[str, float] | None = None,
    load: str | None = None,
    stone: Stone | None = None,
    v0: Sequence[float] = SPEEDS,
    omega0: Sequence[float] = SPINS,
    rate: float = 30.0,
    until: float | None = None,
    sigma: Mapping[str, float] | None = None,
    throws: int | None = None,
    systematics: Mapping[str, float] | None = None,
) -> Discrimination:
    """The throws that decide between laws, whichever of them is true.

    Parameters
    ----------
    laws : two or more, as names or classes, or a fit as the first, for its law,
        coefficients, load and stone. A mechanism that does not brake, such as "pivot",
        stands for its sum in `LAWS`.
    coefficients : of the first law, in place of its defaults or the fit's values. The
        others have those that fit an ordinary draw of the first (2 m/s, 1 rad/s).
    load, stone, rate, until, sigma : as in `design`.
    v0, omega0 : speeds (m/s) and spins (rad/s): all combinations, with both
        senses of spin.
    throws : their number; if not given, the least that decides at odds of 100 to 1 with
        a probability of 0.9.
    systematics : uncertainties of the conditions that are common to all throws,
        as in `fit`.

    Raises
    ------
    InputError : as in `design`; fewer than two laws; a law that cannot make or follow
        these throws.

    Examples
    --------
    >>> between = curlfit.discriminate(
    ...     ["front-back", "pivot"], v0=[2.0], omega0=[1.0, 2.0]
    ... )
    >>> between.decided, [*between.laws]
    (True, ['front-back', 'power+pivot'])
    """
    if len(laws) < 2:
        raise InputError("between: expected two or more laws, such as front-back,pivot")
    if throws is not None and throws > _MOST:
        raise InputError(
            f"throws = {throws}: expected at most {_MOST} to decide between laws"
        )
    assumed, planned = planned_throws(
        (_law(laws[0]), coefficients, load, stone),
        (v0, omega0, rate),
        sigma,
        until,
        1 if throws is None else throws,
        either=True,
    )
    others = [find_law(_law(one)) for one in laws[1:]]  # type: ignore[arg-type]
    names = [assumed.law.name, *(one.name for one in others)]
    if len({*names}) < len(names):
        raise InputError(f"between: {', '.join(names)}; expected different laws")
    contests, possible = _contests(assumed, others, planned, systematics)
    found = _record(
        contests, [planned[one] for one in possible], *_chosen(contests, throws)
    )
    left = dict.fromkeys(
        (one.v0, abs(one.omega0))
        for row, one in enumerate(planned)
        if row not in possible
    )
    return replace(found, asked=throws, left_out=tuple(left))


def _law(law: str | type[Law] | FitResult) -> type[Law] | FitResult:
    """A law; a mechanism as its sum."""
    if isinstance(law, FitResult):
        return law
    if isinstance(law, str) and law in TERMS:
        law = f"power+{law}"
    return find_law(law)


def _contests(
    assumed: Assumptions,
    others: Sequence[type[Law]],
    planned: Sequence[PlannedThrow],
    systematics: Mapping[str, float] | None,
) -> tuple[list[Contest], list[int]]:
    """Every law against every other, and which throws are possible under each."""
    ordinary = planned[0]._replace(v0=_ORDINARY[0], omega0=_ORDINARY[1])
    draw, truths = Truth.of(assumed, [ordinary]), [Truth.of(assumed, planned)]
    rivals = [
        Rival(replace(assumed, law=law), ordinary.stone, systematics)
        for law in (assumed.law, *others)
    ]
    for rival in rivals[1:]:
        (values,), one = rival.alone(draw.throws)
        law = rival.model.law
        if np.isnan(one).any():
            raise InputError(
                f"between: {law.name} cannot be fitted to a draw of {draw.law}"
            )
        truths.append(Truth.of(replace(assumed, law=law, values=values), planned))
    which = np.flatnonzero(np.all([truth.plausible() for truth in truths], 0))
    none = InputError(
        "between: no such throw stays on the sheet under each of these laws"
    )
    if not len(which):
        raise none
    rows: dict[tuple[int, int], Floats] = {}
    for place, rival in enumerate(rivals):
        against = [true for true in range(len(truths)) if true != place]
        made = chain(*(truths[true].at(which).throws for true in against))
        parts = np.split(rival.alone([*made])[1], len(against))
        rows |= {(true, place): part for true, part in zip(against, parts, strict=True)}
    followed = np.all([np.isfinite(own).all((1, 2)) for own in rows.values()], 0)
    if not followed.any():
        raise none
    which = which[followed]
    rows = {pair: own[followed] for pair, own in sorted(rows.items())}
    ranks = {place: rivals[place].rank(own) for (_, place), own in rows.items()}
    return [
        Contest(truths[true].at(which), rivals[place], own, (ranks[true], ranks[place]))
        for (true, place), own in rows.items()
    ], which.tolist()


def _margin(contests: Sequence[Contest], throws: Sequence[int]) -> float:
    """That of the worst pair."""
    return min(one.promise(throws).margin() for one in contests)


def _extended(contests: Sequence[Contest], throws: Sequence[int]) -> list[int]:
    """The best throws, one more than given: added, then exchanged."""

    def best(others: Sequence[int]) -> int:
        every = range(len(contests[0].rows))
        # Throws that are equal but for rounding: the first of them.
        return max(every, key=lambda one: round(_margin(contests, [*others, one]), 6))

    return exchanged([*throws, best(throws)], best)


def _chosen(
    contests: Sequence[Contest], count: int | None
) -> tuple[list[int], list[Pair]]:
    """The throws, and what they promise for each pair when fitted together."""
    found: list[int] = []
    pairs: list[Pair] = []
    for size in range(1, 1 + (count or _ONE_BY_ONE)):
        found = _extended(contests, found)
        if size == count or (count is None and _margin(contests, found) >= MARGIN):
            pairs = [one.verified(found, 1) for one in contests]
            if count or min(one.decides for one in pairs) >= PROBABILITY:
                return found, pairs
    for times in range(2, 1 + _MOST // len(found)):
        if (
            _margin(contests, found * times) >= MARGIN
            or len(found) * (times + 1) > _MOST
        ):
            pairs = [one.verified(found, times) for one in contests]
            if min(one.decides for one in pairs) >= PROBABILITY:
                break
    return sorted(found * times), pairs


def _record(
    contests: Sequence[Contest],
    planned: Sequence[PlannedThrow],
    throws: Sequence[int],
    pairs: Sequence[Pair],
) -> Discrimination:
    truths = {one.truth.law: one.truth for one in contests}
    first = contests[0].truth
    return Discrimination(
        laws={
            name: dict(
                zip(
                    one.assumed.parameters.names,
                    one.assumed.values.tolist(),
                    strict=False,
                )
            )
            for name, one in truths.items()
        },
        load=first.assumed.load,
        stone=planned[0].stone,
        sigma=dict(first.assumed.sigma),
        rate=planned[0].rate,
        until=first.assumed.until,
        candidates=tuple(
            PossibleThrow(
                one.v0,
                one.omega0,
                rest,
                distance,
                tuple(contest.promise([place]).log_odds for contest in contests),
            )
            for place, (one, (rest, distance)) in enumerate(
                zip(planned, first.ends.tolist(), strict=True)
            )
        ),
        throws=tuple(throws),
        pairs=tuple(pairs),
    )
