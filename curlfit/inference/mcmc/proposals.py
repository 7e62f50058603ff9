"""Moves for emcee: one that uses the ridge, and the usual ones for several ensembles side by side.

Along a null direction the posterior is as wide as the prior, and a random walk takes very long from
one end to the other. `RidgeMove` makes independent proposals: from a Student distribution about the
optimum along the determined directions, and uniform over the prior along the null directions. It is
mixed with ordinary moves, which take over where the posterior has another shape.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.mcmc.library import Move, State
from curlfit.numerics.arrays import Booleans, Floats

Indices = NDArray[np.int64]

_DEGREES = 8.0  # of freedom of the Student proposal: heavier tails than any Gaussian posterior


class RidgeMove(Move):
    """Independent proposals: Student along determined directions, uniform along null directions,
    exponential away from the bounds that parameters are pushed against.

    Coordinates are linear in `z = (values - centre)/typical`: determined combinations of it, for
    each null direction one parameter that takes part in it (a pivot), and each pushed parameter.

    Parameters
    ----------
    centre, typical : of the parameters, shape (p,).
    seen : rows of determined combinations, shape (r, p). spread : their standard deviations.
    pivots : indices of the pivots. low, high : their intervals, in `z`.
    pushed : indices of the pushed parameters. scale : mean distance from the bound in `z`, signed.
    """

    def __init__(
        self,
        centre: Floats,
        typical: Floats,
        seen: Floats,
        spread: Floats,
        pivots: Indices,
        low: Floats,
        high: Floats,
        pushed: Indices | None = None,
        scale: Floats | None = None,
    ) -> None:
        self.centre, self.typical = centre, typical
        self.seen, self.spread = seen, spread
        self.pivots, self.low, self.high = pivots, low, high
        self.pushed = np.array([], int) if pushed is None else pushed
        self.scale = np.array([]) if scale is None else scale
        unit = np.eye(len(centre))
        self.proposed = self.accepted = 0
        self._inverse = np.linalg.inv(np.concatenate([seen, unit[self.pivots], unit[self.pushed]]))

    @property
    def acceptance(self) -> float:
        """Fraction of its proposals accepted."""
        return self.accepted / max(self.proposed, 1)

    def draw(self, n: int, random: Any, *, gaussian: bool = False) -> Floats:
        """n parameter vectors, shape (n, p); Student or `gaussian` along determined directions."""
        along = self.spread * random.standard_normal((n, len(self.seen)))
        if not gaussian:
            along *= np.sqrt(_DEGREES / random.chisquare(_DEGREES, (n, 1)))
        across = self.low + (self.high - self.low) * random.uniform(size=(n, len(self.pivots)))
        off = self.scale * random.standard_exponential((n, len(self.pushed)))
        z = np.concatenate([along, across, off], 1) @ self._inverse.T
        return cast(Floats, self.centre + self.typical * z)

    def log_density(self, values: Floats) -> Floats:
        """Log-density of the proposal up to a constant, shape (n,)."""
        z = (values - self.centre) / self.typical
        along = z @ self.seen.T / self.spread
        rank = len(self.seen)
        value = -(_DEGREES + rank) / 2 * np.log1p((along**2).sum(1) / _DEGREES)
        across, off = z[:, self.pivots], z[:, self.pushed] / self.scale
        within = ((across >= self.low) & (across <= self.high)).all(1) & (off >= 0).all(1)
        return np.where(within, value - off.sum(1), -np.inf)

    def propose(self, model: Any, state: State) -> tuple[State, Booleans]:
        """One Metropolis-Hastings step of each walker independently."""
        old = state.coords
        new = self.draw(len(old), model.random)
        log_prob = model.compute_log_prob_fn(new)[0]
        back = self.log_density(old)
        # A walker outside the support of the proposal can only be moved by the other moves.
        with np.errstate(invalid="ignore"):
            factor = back - self.log_density(new)
            accepted = np.log(model.random.uniform(size=len(old))) < (
                factor + log_prob - state.log_prob
            )
        accepted &= np.isfinite(back)
        self.proposed += len(old)
        self.accepted += int(accepted.sum())
        return self.update(state, State(new, log_prob=log_prob), accepted), accepted


class EnsembleMove(Move):
    """Moves of affine-invariant ensembles, several ensembles side by side.

    Each half of an ensemble moves along lines through members of the other half: the stretch
    move of Goodman and Weare (2010), and the differential evolution of ter Braak (2006). All
    ensembles are evaluated in one call and stay independent of each other.
    """

    def __init__(self, ensembles: int, *, evolution: bool) -> None:
        self.ensembles, self.evolution = ensembles, evolution

    def propose(self, model: Any, state: State) -> tuple[State, Booleans]:
        """One step of each half of every ensemble."""
        walkers, dimension = state.coords.shape
        size = walkers // self.ensembles
        accepted = np.zeros(walkers, bool)
        shuffled = np.argsort(model.random.uniform(size=(self.ensembles, size)), axis=1)
        halves = np.array_split(shuffled + size * np.arange(self.ensembles)[:, None], 2, axis=1)
        for moving, others in (halves, halves[::-1]):
            n = moving.shape[1]
            old = state.coords[moving]
            if self.evolution:
                new, factor = self._evolve(state.coords, old, others, n, dimension, model.random)
            else:
                picks = model.random.randint(others.shape[1], size=(self.ensembles, n))
                other = state.coords[np.take_along_axis(others, picks, 1)]
                stretch = (model.random.uniform(size=(self.ensembles, n)) + 1.0) ** 2 / 2.0
                new = other + stretch[..., None] * (old - other)
                factor = (dimension - 1) * np.log(stretch)
            flat = moving.ravel()
            coords = new.reshape(-1, dimension)
            log_prob = model.compute_log_prob_fn(coords)[0]
            gain = factor.ravel() + log_prob - state.log_prob[flat]
            take = np.log(model.random.uniform(size=len(flat))) < gain
            state.coords[flat[take]] = coords[take]
            state.log_prob[flat[take]] = log_prob[take]
            accepted[flat] = take
        return state, accepted

    def _evolve(
        self, coords: Floats, old: Floats, others: Any, n: int, dimension: int, random: Any
    ) -> tuple[Floats, Floats]:
        first = random.randint(others.shape[1], size=(self.ensembles, n))
        step = random.randint(1, others.shape[1], size=(self.ensembles, n))
        second = (first + step) % others.shape[1]
        gap = coords[np.take_along_axis(others, first, 1)]
        gap = gap - coords[np.take_along_axis(others, second, 1)]
        jitter = np.exp(0.1 * random.standard_normal((self.ensembles, n)))
        gamma = 2.38 / np.sqrt(2 * dimension) * jitter
        return old + gamma[..., None] * gap, np.zeros((self.ensembles, n))
