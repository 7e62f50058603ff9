"""Independent proposals along the ridge of a fit's optimum.

Along a null direction the posterior is as wide as the prior, and a random walk takes very long from
one end to the other. These proposals need no walk: from a Student distribution about the optimum
along the determined directions, and uniform over the prior along the null directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import UnusableFitError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import directions
from curlfit.numerics.arrays import Floats
from curlfit.output.text import join_words

Indices = NDArray[np.int64]

_MARGIN = 4.0  # standard errors by which the proposal extends beyond the ridge's ends
_DEGREES = 8.0  # of freedom of the Student distribution: heavier tails than any Gaussian posterior


@dataclass(frozen=True)
class RidgeProposal:
    """Student along determined directions, uniform along null directions, exponential away from the
    bounds that parameters are pushed against.

    Coordinates are linear in `z = (values - centre)/typical`: determined combinations of it, for
    each null direction one parameter that takes part in it (a pivot), and each pushed parameter.

    Attributes
    ----------
    centre, typical : of the parameters, shape (p,).
    seen : rows of determined combinations, shape (r, p). spread : their standard deviations.
    pivots : indices of the pivots. low, high : their intervals, in `z`.
    pushed : indices of the pushed parameters. scale : mean distance from the bound in `z`, signed.
    """

    centre: Floats
    typical: Floats
    seen: Floats
    spread: Floats
    pivots: Indices
    low: Floats
    high: Floats
    pushed: Indices
    scale: Floats

    @cached_property
    def _inverse(self) -> Floats:
        unit = np.eye(len(self.centre))
        return np.linalg.inv(np.concatenate([self.seen, unit[self.pivots], unit[self.pushed]]))

    def draw(self, n: int, random: Any, *, gaussian: bool = False) -> Floats:
        """n parameter vectors, shape (n, p); Student or `gaussian` along determined directions."""
        along = self.spread * random.standard_normal((n, len(self.seen)))
        if not gaussian:
            along *= np.sqrt(_DEGREES / random.chisquare(_DEGREES, (n, 1)))
        across = self.low + (self.high - self.low) * random.uniform(size=(n, len(self.pivots)))
        off = self.scale * random.standard_exponential((n, len(self.pushed)))
        z = np.concatenate([along, across, off], 1) @ self._inverse.T
        draws: Floats = self.centre + self.typical * z
        return draws

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        z = (values - self.centre) / self.typical
        along = z @ self.seen.T / self.spread
        rank = len(self.seen)
        value = -(_DEGREES + rank) / 2 * np.log1p((along**2).sum(1) / _DEGREES)
        across, off = z[:, self.pivots], z[:, self.pushed] / self.scale
        within = ((across >= self.low) & (across <= self.high)).all(1) & (off >= 0).all(1)
        return np.where(within, value - off.sum(1), -np.inf)

    def propose(self, coords: Floats, random: Any) -> tuple[Floats, Floats]:
        """Proposals for emcee's Metropolis-Hastings move, and the log of their factors in its
        ratio."""
        new, back = self.draw(len(coords), random), self.log_density(coords)
        # A walker outside the support of the proposal can only be moved by the other moves.
        reachable = np.isfinite(back)
        return new, np.where(
            reachable, np.where(reachable, back, 0) - self.log_density(new), -np.inf
        )


def ridge_proposal(fit: FitResult) -> RidgeProposal:
    """The proposal from the estimates and information matrix of a fit."""
    parameters = fit.parameter_set
    free = parameters.free
    typical = parameters.typical[free]
    centre = fit.values[free]
    lower = (parameters.lower[free] - centre) / typical
    upper = (parameters.upper[free] - centre) / typical
    information = typical[:, None] * np.array(fit.information["matrix"]) * typical
    gradient = np.array(fit.information["gradient"]) * typical
    verdicts = [fit.parameters[name].verdict for name in fit.information["names"]]
    at_bound = np.array([verdict == "at bound" for verdict in verdicts])
    pushed, open_ = np.flatnonzero(at_bound), np.flatnonzero(~at_bound)

    block = information[np.ix_(open_, open_)]
    seen, singular, null = directions(block, np.ones(len(open_)))
    spread = 1 / singular
    rows = np.zeros((len(seen), len(centre)))
    rows[:, open_] = seen
    # As a pushed parameter leaves its bound, the others follow along their regression on it.
    rows[:, pushed] = (seen @ information[np.ix_(open_, pushed)]) / singular[:, None] ** 2
    wide = np.zeros((len(null), len(centre)))
    wide[:, open_] = null
    reach = np.zeros(len(centre))
    reach[open_] = _MARGIN * np.sqrt(((seen.T * spread) ** 2).sum(1))
    names = np.array(parameters.names_where(free))
    pivots, low, high = _pivots(wide, lower, upper, reach, names)
    # Away from the bound the log-posterior falls by its slope and curvature, which set the scale.
    curvature = np.diag(information)[pushed] - ((rows[:, pushed] * singular[:, None]) ** 2).sum(0)
    push = np.abs(gradient[pushed]) + np.sqrt(np.maximum(curvature, 0.0))
    off = -np.sign(gradient[pushed]) / push
    return RidgeProposal(centre, typical, rows, spread, pivots, low, high, pushed, off)


def _pivots(
    null: Floats, lower: Floats, upper: Floats, reach: Floats, names: np.ndarray
) -> tuple[Indices, Floats, Floats]:
    """A bounded parameter for each null direction, and its range along the ridge."""
    pivots: list[int] = []
    rest = null.copy()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    for _ in range(len(null)):
        size = np.where(bounded, (rest**2).sum(0), 0.0)
        if size.max() < 1e-12:
            open_ = list(names[(rest**2).sum(0) >= 1e-12])
            none_of = "which has no" if len(open_) == 1 else "and none of them has"
            raise UnusableFitError(
                f"the path does not determine {join_words(open_)}, {none_of} finite bounds; give "
                "bounds"
            )
        pivot = int(np.argmax(size))
        pivots.append(pivot)
        column = rest[:, pivot] / np.linalg.norm(rest[:, pivot])
        rest = rest - np.outer(column, column @ rest)
    walls = np.concatenate([null.T, -null.T])
    room = np.concatenate([upper + reach, reach - lower])
    finite = np.isfinite(room)
    ends = [_extent(null[:, pivot], walls[finite], room[finite]) for pivot in pivots]
    low, high = np.clip(np.array(ends).T.reshape(2, -1), lower[pivots], upper[pivots])
    return np.array(pivots, int), low, high


def _extent(along: Floats, walls: Floats, room: Floats) -> tuple[float, float]:
    """Least and greatest `along @ z` of all z with `walls @ z <= room`."""
    from scipy.optimize import linprog

    least, greatest = (
        linprog(sign * along, A_ub=walls, b_ub=room, bounds=(None, None)).fun for sign in (1, -1)
    )
    return float(least), -float(greatest)


def first_walkers(
    proposal: RidgeProposal,
    log_prob: Callable[[Floats], Floats],
    walkers: int,
    lower: Floats,
    upper: Floats,
    random: Any,
) -> Floats:
    """Initial positions of walkers drawn from the proposal, with finite posterior."""
    found: list[Floats] = []
    for _ in range(50):
        coords = proposal.draw(walkers, random)
        # Near a bound a proposal falls outside half the time; reflect it back.
        folded = np.where(coords < lower, 2 * lower - coords, coords)
        folded = np.where(folded > upper, 2 * upper - folded, folded)
        found.extend(folded[np.isfinite(log_prob(folded))])
        if len(found) >= walkers:
            return np.array(found[:walkers])
    raise UnusableFitError("no point of finite posterior was found near the fit")
