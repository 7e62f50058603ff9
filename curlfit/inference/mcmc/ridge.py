"""Proposals and initial positions of walkers along the ridge of a fit's optimum."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import directions
from curlfit.inference.mcmc.proposals import Indices, RidgeMove
from curlfit.numerics.arrays import Floats
from curlfit.output.text import join_words

_MARGIN = 4.0  # standard errors by which the proposal extends beyond the ridge's ends


def ridge_move(fit: FitResult, offset: Floats) -> RidgeMove:
    """The proposal from the estimates and information matrix of a fit."""
    parameters = fit.parameter_set
    free = parameters.free
    typical = parameters.typical[free]
    centre = (fit.values - offset)[free]
    lower = ((parameters.lower - offset)[free] - centre) / typical
    upper = ((parameters.upper - offset)[free] - centre) / typical
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
    return RidgeMove(centre, typical, rows, spread, pivots, low, high, pushed, off)


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
    if len(along) == 1:  # by far the most common, and scipy's optimizers are slow to load
        slope, product = walls[:, 0], along[0] * walls[:, 0]
        limits = along[0] * room[product != 0] / slope[product != 0]
        product = product[product != 0]
        return float(limits[product < 0].max()), float(limits[product > 0].min())
    from scipy.optimize import linprog

    least, greatest = (
        linprog(sign * along, A_ub=walls, b_ub=room, bounds=(None, None)).fun for sign in (1, -1)
    )
    return float(least), -float(greatest)


def first_walkers(
    move: RidgeMove,
    log_prob: Callable[[Floats], Floats],
    walkers: int,
    lower: Floats,
    upper: Floats,
    random: Any,
) -> Floats:
    """Initial positions of walkers drawn from the proposal, with finite posterior."""
    found: list[Floats] = []
    for _ in range(50):
        coords = move.draw(walkers, random)
        # Near a bound a proposal falls outside half the time; reflect it back.
        folded = np.where(coords < lower, 2 * lower - coords, coords)
        folded = np.where(folded > upper, 2 * upper - folded, folded)
        found.extend(folded[np.isfinite(log_prob(folded))])
        if len(found) >= walkers:
            return np.array(found[:walkers])
    raise UnusableFitError("no point of finite posterior was found near the fit")
