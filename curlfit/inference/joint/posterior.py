"""The posterior of the mean of throws that vary, of its effects and of the spreads.

The throws' own parameters are integrated out by Laplace's approximation, and the mean and the
effects, whose prior is flat within the bounds, in closed form: what is left is the restricted
likelihood of the spreads times their prior, which is flat (Gelman 2006, Bayesian Analysis 1, 515).
emcee samples it. The mean and the effects are normal where the spreads are given; draws with means
out of bounds are left out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.joint.population import Population, Together, reduced
from curlfit.inference.least_squares import Solution, minimize_many
from curlfit.inference.mcmc.summary import effective_size, normal_scores, r_hat
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import FEW
from curlfit.numerics.mixed_model import MixedFit

_WALKERS, _STEPS, _ROUNDS = 40, 250, 20
_R_HAT, _ENOUGH = 1.02, 1000  # effective sample size
_MOST = 60  # throws; more know their spreads so well that Student's t says the same
_KEPT, _FEWEST, _TRIED = 4000, 400, 64
_SMALL = 0.1  # standard deviations by which a mean may be off
_EXACT = 1e-9  # typical sizes
_NO_PART = 1e-6  # of a parameter in what nothing determines, where its bounds say nothing
_SIZE = 50_000  # throws times draws at a time


class Draws(NamedTuple):
    """Of a posterior."""

    estimate: Floats
    """the mean and its effects, shape (draws, numbers)"""
    spreads: Floats
    """shape (draws, directions)"""
    r_hat: float
    """largest of the spreads"""


def sampled(fit: MixedFit, spreads: Floats, seed: int | None) -> Draws | None:
    """Draws from the posterior; none without a seed, where a bound holds a mean or bounds leave few
    draws, or of many throws.

    Parameters
    ----------
    spreads : standard deviations above zero, from which the search begins.
    """
    if seed is None or fit.at_bound or len(fit.model.products) > _MOST:
        return None
    import emcee

    model = fit.model
    random, size = np.random.default_rng(seed), len(spreads)

    def log_posterior(spreads: Floats) -> Floats:  # even, and smooth where one is zero
        return -model.criterion(spreads**2) / 2

    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(_WALKERS, size, log_posterior, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(seed).get_state()
    state = spreads * np.exp(0.5 * random.standard_normal((_WALKERS, size)))
    for _ in range(_ROUNDS):
        state = sampler.run_mcmc(state, _STEPS)
        chain = sampler.get_chain(discard=sampler.iteration // 2)
        scores = [normal_scores(np.abs(series)) for series in chain.T]
        worst = max(map(r_hat, scores))
        if worst < _R_HAT and min(map(effective_size, scores)) > _ENOUGH:
            break
    flat = np.abs(chain.reshape(-1, size))
    found = flat[np.linspace(0, len(flat) - 1, _KEPT).astype(int)]
    estimates = []
    for some in np.array_split(found, max(1, len(found) * len(model.products) // _SIZE)):
        normal, right, _ = model.parts(model.marginal(some**2)[0].sum(-3))
        root: Any = np.linalg.cholesky(normal)
        mean: Any = np.linalg.solve(normal, right[..., None])
        noise = random.standard_normal(mean.shape)
        estimates.append((mean + np.linalg.solve(root.mT, noise))[..., 0])
    estimate = np.concatenate(estimates)
    means = fit.at(np.unique(model.covariates, axis=0)) @ estimate.T
    beyond = (means < fit.lower[:, None]) | (means > fit.upper[:, None])
    inside = ~beyond[:, (np.abs(model.null) < _NO_PART).all(1)].any((0, 1))
    return Draws(estimate[inside], found[inside], worst) if inside.sum() > _FEWEST else None


def shifts_of_means(
    throws: Together, found: Population, solution: Solution, draws: Draws, seed: int
) -> dict[str, float]:
    """Changes of the means of what varies if no throw's likelihood is taken as quadratic, over
    their standard deviations; none where these are small, or no larger than by chance.

    To first order they are the covariances of the means with the logarithms of importance weights,
    the true likelihood of the throws over the quadratic one, each with its initial state at the
    optimum for coefficients that are drawn for it.

    Parameters
    ----------
    solution : the throws at their own coefficients.
    """
    tasks, common, model = throws.tasks, throws.common, found.fit.model
    random = np.random.default_rng(seed)
    some = random.choice(len(draws.spreads), _TRIED)
    reduction, values = reduced(throws, solution), np.array(solution.values)
    rows = reduction.in_common(found.typical)
    now = (values[:, None, common] - found.reference) / found.typical
    mean = (found.fit.at(model.covariates) @ draws.estimate[some].T).mT
    mean -= (mean - now) @ model.null @ model.null.T
    by = rows[..., :-1] @ model.directions
    off = (mean - now) @ rows[..., :-1].mT + rows[:, None, :, -1]
    spread = np.maximum(draws.spreads[some], _EXACT)
    precision = (by.mT @ by)[:, None] + spread[:, None, :] ** -2 * np.eye(spread.shape[1])
    root: Any = np.linalg.cholesky(precision)
    noise = random.standard_normal((*off.shape[:2], spread.shape[1], 1))
    own: Any = np.linalg.solve(root.mT, noise) - np.linalg.solve(precision, (off @ by)[..., None])
    ends = found.fit.lower, found.fit.upper
    each = np.clip(mean + own[..., 0] @ model.directions.T, *ends) - now
    quadratic = ((each @ rows[..., :-1].mT + rows[:, None, :, -1]) ** 2).sum(-1)
    start = values[:, None] + (each * found.typical) @ reduction.follow[:, :, common].mT
    start = np.clip(start, tasks.lower[:, None], tasks.upper[:, None])
    held = tasks.at(np.repeat(np.arange(len(values)), _TRIED))
    start = start.reshape(held.start.shape)
    held = held._replace(
        start=start, lower=np.where(common, start, held.lower),
        upper=np.where(common, start, held.upper), penalty=None,
    )  # fmt: skip
    true = minimize_many(throws.rounds.model, held, FEW).chi_squared
    weight = (quadratic - np.reshape(true, quadratic.shape)).sum(0) / 2
    size = len(found.typical)
    means = draws.estimate[:, :size] * found.typical @ np.array([*found.weights.values()]).T
    z = (means[some] - means.mean(0)) / means.std(0)
    shifts = dict(
        zip(found.weights, map(float, (weight - weight.mean()) @ z / _TRIED), strict=True)
    )
    least = max(_SMALL, 2 * weight.std() / _TRIED**0.5)
    return {name: shift for name, shift in shifts.items() if abs(shift) > least}
