"""The posterior of a path without an angle, by importance sampling at held spins.

It shares no code with curlfit. At each of many spins the other parameters are fitted
with scipy to paths of the simulator; there the posterior is nearly normal, with the
covariance from the Jacobian. Draws of the spin from these approximations, and of the
other parameters from a Student distribution about the optimum at that spin, are
weighted by the ratio of the true density to that of the draw, so that the quantiles
are those of the true posterior however good the approximations are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import gammaln, logsumexp
from simulator import simulated

SPINS = 80
"""Held spins of each sense at first, two neighbours a tenth apart."""
SLOWEST = 0.005
"""rad/s: a stone turns by 5 degrees in 18 s, and does not curl."""
DRAWS = 4000
DEGREES = 6.0
"""Of freedom of the Student distribution, which has heavier tails than the
posterior."""
WIDER = 1.15
"""How much wider than the approximation draws are."""
LARGEST_SHARE = 0.05
"""Probability of an interval of the spin above which it is halved."""
COUNTS = 1e-3
"""Probability of an interval above which it is also halved until it is straight."""
MOST_BENT = 0.3
"""Standard errors at most between the optimum in the middle of an interval and the
mean of those at its ends: draws are about the straight line between these."""
HALVINGS = 8
NEGLIGIBLE = 1e-5
"""Probability of an interval of the spin, over the largest, that is left out."""

STEPS = {"c": 1e-4, "k": 5e-3, "b": 5e-4, "f0": 5e-3, "q": 1e-6}
"""Of differences: a hundredth of typical sizes. They move a path by more than 1 mm,
and the simulator errs by 0.01 mm."""
STEPS_OF_START = {"x0": 1e-3, "y0": 1e-3, "heading": 1e-4, "v0": 1e-3}


class Problem(NamedTuple):
    """Parameters to be found, the spin apart."""

    residuals: Callable[[float, np.ndarray], np.ndarray]
    """of a spin and of values, over their errors"""
    lower: np.ndarray
    upper: np.ndarray
    """bounds, between which the prior is flat, shape (parameters,)"""
    steps: np.ndarray
    """of differences, shape (parameters,)"""
    guess: np.ndarray
    """shape (parameters,)"""
    fastest: float
    """the largest spin of either sense, rad/s"""

    def jacobian(self, spin: float, values: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals, shape (residuals, parameters)."""
        residuals = self.residuals(spin, values)
        columns = [
            (self.residuals(spin, values + step) - residuals) / step.sum()
            for step in np.diag(self.steps)
        ]
        return np.column_stack(columns)

    def log_density(self, spin: float, values: np.ndarray) -> float:
        """Log-posterior up to a constant; minus infinity beyond the bounds."""
        if ((values < self.lower) | (values > self.upper)).any():
            return -np.inf
        return -float((self.residuals(spin, values) ** 2).sum()) / 2


class Optimum(NamedTuple):
    """The optimum at a spin, and the normal approximation of the posterior there."""

    values: np.ndarray
    spread: np.ndarray
    """its covariance is `spread @ spread.T`, lower triangular"""
    log_mass: float
    """logarithm of the integral of the posterior over all but the spin"""


class Cell(NamedTuple):
    """An interval of the spin, and the optima at its ends."""

    spins: tuple[float, float]
    optima: tuple[Optimum, Optimum]
    straight: bool = False
    """whether the optima between are known to be on the straight line"""

    @property
    def width(self) -> float:
        """rad/s"""
        return abs(self.spins[1] - self.spins[0])

    @property
    def log_mass(self) -> float:
        """Logarithm of the integral of the posterior over it, up to a constant, from
        the larger of both ends: the posterior may end within it, at a bound."""
        height = max(optimum.log_mass for optimum in self.optima)
        return height + float(np.log(self.width))

    def refined(self, problem: Problem, share: float) -> list[Cell]:
        """Its halves, if its probability is large or it is bent; otherwise itself."""
        if share <= COUNTS or (self.straight and share <= LARGEST_SHARE):
            return [self]
        first, last = self.spins
        spin = np.sign(first) * np.sqrt(first * last)
        start, end = self.optima
        (middle,) = optima_along(problem, [spin], start.values)
        off = middle.values - (start.values + end.values) / 2
        bent = np.linalg.norm(np.linalg.solve(middle.spread, off)) > MOST_BENT
        if share <= LARGEST_SHARE and not bent:
            return [self._replace(straight=True)]
        halves = (
            Cell((first, spin), (start, middle)),
            Cell((spin, last), (middle, end)),
        )
        return [half._replace(straight=not bent) for half in halves]


class Sample(NamedTuple):
    """Weighted draws."""

    spins: np.ndarray
    """shape (draws,)"""
    values: np.ndarray
    """shape (draws, parameters)"""
    weights: np.ndarray
    """which sum to one, shape (draws,)"""

    @property
    def effective(self) -> float:
        """How many draws of equal weights say as much."""
        return float(1 / (self.weights**2).sum())


def optimum_at(problem: Problem, spin: float, guess: np.ndarray) -> Optimum:
    """The optimum at a spin, from a guess."""
    fit = least_squares(
        lambda values: problem.residuals(spin, values),
        guess,
        lambda values: problem.jacobian(spin, values),
        (problem.lower, problem.upper),
        x_scale=problem.steps,
        xtol=1e-6,
        ftol=1e-6,
    )
    # In units of the steps, as the parameters differ in size by 10,000.
    scaled = fit.jac * problem.steps
    covariance = np.linalg.inv(scaled.T @ scaled)
    spread = problem.steps[:, None] * np.linalg.cholesky(covariance)
    log_mass = np.log(np.diag(spread)).sum() - fit.cost
    return Optimum(fit.x, spread, float(log_mass))


def optima_along(
    problem: Problem, spins: Sequence[float], guess: np.ndarray
) -> list[Optimum]:
    """The optima at some spins, the first from a guess, each from the one before."""
    optima: list[Optimum] = []
    inside = problem.upper - problem.lower
    margin = np.where(np.isfinite(inside), 1e-3 * inside, 0.0)
    for spin in spins:
        # scipy needs a guess within the bounds
        guess = np.clip(guess, problem.lower + margin, problem.upper - margin)
        optima.append(optimum_at(problem, spin, guess))
        guess = optima[-1].values
    return optima


def student_log_density(offsets: np.ndarray) -> float:
    """Of the standard Student distribution, at offsets of shape (parameters,)."""
    size = len(offsets)
    constant = gammaln((DEGREES + size) / 2) - gammaln(DEGREES / 2)
    constant -= size / 2 * np.log(DEGREES * np.pi)
    return constant - (DEGREES + size) / 2 * np.log1p((offsets**2).sum() / DEGREES)


def shares_of(cells: Sequence[Cell]) -> np.ndarray:
    """Probabilities of the intervals, shape (cells,); 0 of those left out."""
    log_masses = np.array([cell.log_mass for cell in cells])
    masses = np.exp(log_masses - log_masses.max())
    masses[masses < NEGLIGIBLE] = 0.0
    return masses / masses.sum()


def cells_of(problem: Problem) -> list[Cell]:
    """Intervals of the spin, narrow where the posterior is."""
    speeds = np.geomspace(problem.fastest, SLOWEST, SPINS + 1)
    cells: list[Cell] = []
    for spins in (-speeds, speeds):
        optima = optima_along(problem, spins, problem.guess)
        ends = zip(pairwise(spins), pairwise(optima), strict=True)
        cells += [Cell(*end) for end in ends]
    for _ in range(HALVINGS):
        shares = shares_of(cells)
        cells = [
            part
            for cell, share in zip(cells, shares, strict=True)
            for part in cell.refined(problem, share)
        ]
    return cells


def posterior_sample(problem: Problem, number: int, seed: int = 0) -> Sample:
    """Weighted draws from the posterior of all parameters and the spin."""
    random = np.random.default_rng(seed)
    cells = cells_of(problem)
    shares = shares_of(cells)
    drawn_spins = np.empty(number)
    drawn_values = np.empty((number, len(problem.guess)))
    log_weights = np.empty(number)
    for draw, cell in enumerate(random.choice(len(cells), number, p=shares)):
        spins = cells[cell].spins
        first, last = cells[cell].optima
        spin = random.uniform(*sorted(spins))
        part = np.log(spin / spins[0]) / np.log(spins[1] / spins[0])
        centre = (1 - part) * first.values + part * last.values
        spread = WIDER * ((1 - part) * first.spread + part * last.spread)
        offsets = random.standard_normal(len(centre))
        offsets *= np.sqrt(DEGREES / random.chisquare(DEGREES))
        values = centre + spread @ offsets
        log_proposal = np.log(shares[cell] / cells[cell].width)
        log_proposal += student_log_density(offsets) - np.log(np.diag(spread)).sum()
        drawn_spins[draw] = spin
        drawn_values[draw] = values
        log_weights[draw] = problem.log_density(spin, values) - log_proposal
    weights = np.exp(log_weights - logsumexp(log_weights))
    return Sample(drawn_spins, drawn_values, weights)


def weighted_quantiles(
    draws: np.ndarray, weights: np.ndarray, shares: Sequence[float]
) -> np.ndarray:
    """Values below which some shares of the weight lie."""
    order = np.argsort(draws)
    below = np.cumsum(weights[order]) - weights[order] / 2
    return np.interp(shares, below, draws[order])


def problem_of_track(
    law: str,
    times: np.ndarray,
    track: np.ndarray,
    sigma: float,
    box: Mapping[str, tuple[float, float]],
    fastest: float,
) -> Problem:
    """A law fitted to a track.

    Parameters
    ----------
    track : x and y of the rows, shape (2, rows). sigma : their error, m.
    box : bounds of the coefficients, in their order.
    fastest : the bound of the spin of either sense, rad/s.
    """
    # The place and the heading move a path that has been computed.
    paths = lru_cache(maxsize=16)(
        lambda coefficients, v0, spin: simulated(
            law, dict(zip(box, coefficients, strict=True)), v0, spin, times
        )
    )
    size = len(box)

    def residuals(spin: float, values: np.ndarray) -> np.ndarray:
        x0, y0, heading, v0 = values[size:]
        right, along, _ = paths(tuple(values[:size]), v0, spin)
        x = x0 + right * np.cos(heading) + along * np.sin(heading)
        y = y0 + along * np.cos(heading) - right * np.sin(heading)
        return ((np.stack([x, y]) - track) / sigma).ravel()

    lower, upper = np.array(list(box.values())).T
    start = len(STEPS_OF_START)
    step = times[1] - times[0]
    speed = np.hypot(*(track[:, 10] - track[:, 0])) / (10 * step)
    steps = [STEPS[name] for name in box] + list(STEPS_OF_START.values())
    return Problem(
        residuals,
        np.concatenate([lower, np.full(start, -np.inf)]),
        np.concatenate([upper, np.full(start, np.inf)]),
        np.array(steps),
        np.concatenate([(lower + upper) / 2, track[:, 0], [0.0, speed]]),
        fastest,
    )
