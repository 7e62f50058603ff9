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

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

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
    Ranks,
)
from curlfit.optimal_design.information import Assumptions, PlannedThrow
from curlfit.optimal_design.rivals import Rival, Truth
from curlfit.optimal_design.selection import exchanged
from curlfit.stone import Stone

# the draw in which all laws agree
_ORDINARY_SPEED = 2.0  # m/s
_ORDINARY_SPIN = 1.0  # rad/s
_MOST = 64  # throws
_ONE_BY_ONE = 8  # throws that are chosen one by one; more are these repeated
_NO_THROW = "between: no such throw stays on the sheet under each of these laws"


@dataclass(frozen=True)
class Contest:
    """A rival fitted to the throws of the true law.

    Attributes
    ----------
    rows : of each candidate, see `Rival`.
    ranks : of the coefficients of the true law and of the rival, from all candidates.
    """

    truth: Truth
    rival: Rival
    rows: Floats
    ranks: Ranks

    def promise(self, throws: Sequence[int], rows: Floats | None = None) -> Pair:
        """What candidates promise together, by their rows, or by others about a better
        fit of them."""
        if rows is None:
            rows = self.rows[[*throws]]
        left = self.rival.fit_rows(rows).chi_squared
        rows_of_records = sum(self.truth.throws[index].rows for index in throws)
        values = len(self.truth.assumed.sigma) * rows_of_records
        rival = self.rival.model.law.name
        return Pair.of(self.truth.law, rival, left, self.ranks, values)

    def verified(self, throws: Sequence[int], times: int) -> Pair:
        """What candidates promise, each repeated so many times, from a fit of them
        together."""
        repeated = [*throws] * times
        linear = self.promise(repeated)
        if len(throws) == 1:  # fitted already
            return linear
        start = self.rival.fit_rows(self.rows[[*throws]]).coefficients
        joint = self.rival.fit_together(self.truth.at(throws).throws, start)
        pair = self.promise(repeated, np.tile(joint.rows, (times, 1, 1)))
        if joint.converged or pair.chi_squared < linear.chi_squared:
            return pair
        return linear


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
        _law(laws[0]),
        coefficients=coefficients,
        load=load,
        stone=stone,
        v0=v0,
        omega0=omega0,
        rate=rate,
        sigma=sigma,
        until=until,
        throws=1 if throws is None else throws,
        both_senses=True,
    )
    rival_laws = [find_law(_law(law)) for law in laws[1:]]  # type: ignore[arg-type]
    names = [law.name for law in (assumed.law, *rival_laws)]
    if len({*names}) < len(names):
        raise InputError(f"between: {', '.join(names)}; expected different laws")
    contests = _contests(assumed, rival_laws, planned, systematics)
    choice = _chosen(contests, throws)
    throws_of_first = contests[0].truth.throws
    candidates = []
    for index, throw in enumerate(throws_of_first):
        candidate = PossibleThrow(
            v0=throw.planned.v0,
            omega0=throw.planned.omega0,
            rest=throw.rest.time,
            distance=throw.rest.distance,
            log_odds=tuple(contest.promise([index]).log_odds for contest in contests),
        )
        candidates.append(candidate)
    possible = {throw.planned for throw in throws_of_first}
    left_out = [(plan.v0, abs(plan.omega0)) for plan in planned if plan not in possible]
    return Discrimination(
        laws=_coefficients_by_law(contests),
        load=assumed.load,
        stone=planned[0].stone,
        sigma=dict(assumed.sigma),
        rate=planned[0].rate,
        until=assumed.until,
        candidates=tuple(candidates),
        throws=tuple(choice.throws),
        pairs=tuple(choice.pairs),
        asked=throws,
        left_out=tuple(dict.fromkeys(left_out)),
    )


def _coefficients_by_law(contests: Sequence[Contest]) -> dict[str, dict[str, float]]:
    """Assumed coefficients of each law."""
    by_law: dict[str, dict[str, float]] = {}
    for contest in contests:
        assumed = contest.truth.assumed
        names = [coefficient.name for coefficient in assumed.law.coefficients()]
        by_law[assumed.law.name] = dict(
            zip(names, assumed.values.tolist(), strict=True)
        )
    return by_law


def _law(law: str | type[Law] | FitResult) -> type[Law] | FitResult:
    """A law; a mechanism as its sum."""
    if isinstance(law, FitResult):
        return law
    if isinstance(law, str) and law in TERMS:
        law = f"power+{law}"
    return find_law(law)


def _contests(
    assumed: Assumptions,
    rival_laws: Sequence[type[Law]],
    planned: Sequence[PlannedThrow],
    systematics: Mapping[str, float] | None,
) -> list[Contest]:
    """Every law against every other, over the throws that are possible under each."""
    ordinary = planned[0]._replace(v0=_ORDINARY_SPEED, omega0=_ORDINARY_SPIN)
    draw = Truth.of(assumed, [ordinary])
    truths = [Truth.of(assumed, planned)]
    rivals = [Rival(assumed, ordinary.stone, systematics)]
    for law in rival_laws:
        rival = Rival(replace(assumed, law=law), ordinary.stone, systematics)
        fit = rival.fit_each(draw.throws)
        if np.isnan(fit.rows).any():
            raise InputError(
                f"between: {law.name} cannot be fitted to a draw of {draw.law}"
            )
        of_rival = replace(assumed, law=law, values=fit.coefficients[0])
        truths.append(Truth.of(of_rival, planned))
        rivals.append(rival)
    plausible = [
        index
        for index in range(len(planned))
        if all(truth.throws[index].is_plausible for truth in truths)
    ]
    if not plausible:
        raise InputError(_NO_THROW)
    # by the numbers of the true law and of its rival
    rows_by_pair: dict[tuple[int, int], Floats] = {}
    for number, rival in enumerate(rivals):
        opponents = [other for other in range(len(truths)) if other != number]
        # all fits of a law side by side, in one batch
        throws = [
            truths[opponent].throws[index]
            for opponent in opponents
            for index in plausible
        ]
        rows = np.split(rival.fit_each(throws).rows, len(opponents))
        for opponent, rows_of_opponent in zip(opponents, rows, strict=True):
            rows_by_pair[opponent, number] = rows_of_opponent
    fitted_by_all = np.all(
        [np.isfinite(rows).all((1, 2)) for rows in rows_by_pair.values()], 0
    )
    if not fitted_by_all.any():
        raise InputError(_NO_THROW)
    possible = list(itertools.compress(plausible, fitted_by_all))
    rows_by_pair = {
        pair: rows[fitted_by_all] for pair, rows in sorted(rows_by_pair.items())
    }
    ranks = []
    for number, rival in enumerate(rivals):
        last_opponent = max(truth for truth, other in rows_by_pair if other == number)
        ranks.append(rival.rank(rows_by_pair[last_opponent, number]))
    return [
        Contest(
            truths[truth].at(possible),
            rivals[rival],
            rows,
            Ranks(ranks[truth], ranks[rival]),
        )
        for (truth, rival), rows in rows_by_pair.items()
    ]


def _margin(contests: Sequence[Contest], throws: Sequence[int]) -> float:
    """Margin of the log odds of the worst pair."""
    return min(contest.promise(throws).margin() for contest in contests)


def _extended(contests: Sequence[Contest], throws: Sequence[int]) -> list[int]:
    """The best throws, one more than given: added, then exchanged."""
    candidates = range(len(contests[0].rows))

    def best(others: Sequence[int]) -> int:
        # Throws that are equal but for rounding: the first of them.
        return max(
            candidates,
            key=lambda candidate: round(_margin(contests, [*others, candidate]), 6),
        )

    return exchanged([*throws, best(throws)], best)


class _Choice(NamedTuple):
    """Chosen throws."""

    throws: list[int]
    """indices of candidates, repeated for repeated throws"""
    pairs: list[Pair]
    """what they promise when fitted together"""

    @property
    def decides(self) -> bool:
        """Whether they decide with the required probability, whichever law is true."""
        return min(pair.decides for pair in self.pairs) >= PROBABILITY


def _chosen(contests: Sequence[Contest], count: int | None) -> _Choice:
    """So many throws; if no number is given, the least that decides, or `_MOST`."""

    def verified(throws: Sequence[int], times: int = 1) -> _Choice:
        pairs = [contest.verified(throws, times) for contest in contests]
        return _Choice(sorted([*throws] * times), pairs)

    throws: list[int] = []
    if count is not None:
        for _ in range(count):
            throws = _extended(contests, throws)
        return verified(throws)
    for _ in range(_ONE_BY_ONE):
        throws = _extended(contests, throws)
        if _margin(contests, throws) >= MARGIN:
            choice = verified(throws)
            if choice.decides:
                return choice
    most_times = _MOST // len(throws)
    for times in range(2, most_times):
        if _margin(contests, throws * times) >= MARGIN:
            choice = verified(throws, times)
            if choice.decides:
                return choice
    return verified(throws, most_times)
