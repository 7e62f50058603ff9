"""Convergence of a chain, and its summary as the posterior in the record of its fit.

R-hat, bulk and tail effective sample sizes: Vehtari, Gelman, Simpson, Carpenter and
Buerkner (2021), Bayesian Analysis 16, 667-718.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from curlfit.errors import InputError
from curlfit.inference.derived.quantiles import quantiles_of
from curlfit.inference.fit.estimates import Posterior
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.combinations import with_combinations
from curlfit.inference.sampling.chain import Chain, load_chain
from curlfit.numerics.arrays import Floats

CONVERGED = "converged"
"""How a run ended that reached its targets."""
_BLOCK = 20  # steps between the first tests of convergence; later a fifth of those done
_R_HAT = 1.01  # the largest of a sample that has converged (sect. 4)
# quantiles whose effective sample sizes are those of the tails (sect. 4.3)
_TAILS = (0.05, 0.95)
# steps over autocorrelation time, below which no estimate is trusted
_SHORTEST_IN_TIMES = 30.0
_FEWEST = 5  # draws of a chain whose autocorrelations say anything
FEWEST_STEPS = 4
"""Steps of a chain from which on it can be judged."""


def is_test_due(steps: int) -> bool:
    """Whether convergence is tested after this number of steps."""
    end = 0
    while end < steps:
        end += max(_BLOCK, end // 5)
    return 0 < steps == end


def steps_to_discard(steps: int) -> int:
    """Number of initial steps to leave out."""
    return min(max(_BLOCK // 2, steps // 10), steps // 2)


class Diagnosis:
    """Diagnostics of a sample after the first steps, by parameter, computed when they
    are asked for.

    Walkers are the chains of effective sample sizes. Those of an ensemble move by
    one another, so that only ensembles are independent chains for R-hat. Each is
    split in halves.
    """

    def __init__(self, values: Floats, ensembles: int) -> None:
        """Of values (steps, walkers, parameters)."""
        # shape (parameters, walkers, steps), and the two halves of each walker, shape
        # (parameters, 2 walkers, steps/2)
        self._walkers = values[steps_to_discard(len(values)) :].transpose(2, 1, 0)
        half = self._walkers.shape[2] // 2
        first = self._walkers[..., :half]
        last = self._walkers[..., -half:]
        self._halves = np.ascontiguousarray(np.concatenate([first, last], 1))
        self._ensembles = ensembles

    @cached_property
    def _scores(self) -> list[Floats]:
        """Normal scores of the halves of walkers, by parameter."""
        return [normal_scores(draws) for draws in self._halves]

    @cached_property
    def bulk(self) -> Floats:
        """Effective sample sizes of the bulk."""
        return np.array([effective_size(scores) for scores in self._scores])

    @cached_property
    def tail(self) -> Floats:
        """Effective sample sizes of the tails, the smaller of those of
        two quantiles."""
        quantiles = np.quantile(self._walkers, _TAILS, (1, 2)).T
        sizes = [
            [effective_size(draws <= quantile) for quantile in of_parameter]
            for draws, of_parameter in zip(self._halves, quantiles, strict=True)
        ]
        return np.min(sizes, 1)

    @cached_property
    def r_hat(self) -> Floats:
        """R-hat, the larger of that of the draws and that of their distances
        from the median."""
        distances = [np.abs(draws - np.median(draws)) for draws in self._halves]
        folded = [normal_scores(draws) for draws in distances]
        # the halves of all walkers of an ensemble are one chain each
        shape = (2 * self._ensembles, -1)
        of_draws = [r_hat(scores.reshape(shape)) for scores in self._scores]
        of_distances = [r_hat(scores.reshape(shape)) for scores in folded]
        return np.maximum(of_draws, of_distances)

    @property
    def least_effective(self) -> float:
        """Smallest effective sample size, of bulk or tail, of all parameters."""
        return float(min(self.bulk.min(), self.tail.min()))

    @property
    def worst_r_hat(self) -> float:
        """Largest R-hat of all parameters."""
        return float(self.r_hat.max())

    def good(self, effective: float) -> bool:
        """Whether the sample has converged, with at least this effective sample size,
        and each walker is 30 times as long as the autocorrelation time, its draws over
        those effective."""
        walkers = self._walkers.shape[1]
        in_bulk = max(effective, _SHORTEST_IN_TIMES * walkers)
        return (
            float(self.bulk.min()) >= in_bulk
            and float(self.tail.min()) >= effective
            and self.worst_r_hat < _R_HAT
        )


def normal_scores(draws: Floats) -> Floats:
    """Normal scores of the ranks of draws; ties have their mean rank (eq. 14)."""
    _, inverse, count = np.unique(draws, return_inverse=True, return_counts=True)
    rank = np.cumsum(count) - (count - 1) / 2
    scores: Floats = ndtri((rank - 0.375) / (draws.size + 0.25))
    return scores[inverse].reshape(draws.shape)


def effective_size(chains: Floats) -> float:
    """Effective sample size of chains, shape (chains, draws), by Geyer's initial
    monotone sequence (eq. 10-13). Chains too short for autocorrelations count as
    one draw each."""
    number, n = chains.shape
    if n < _FEWEST:
        return float(number)
    means = chains.mean(1, keepdims=True)
    transform = np.fft.rfft(chains - means, -(-n // 4) * 8)  # zeros: no wrapping around
    covariance = np.fft.irfft((transform.real**2 + transform.imag**2).mean(0))[:n] / n
    total = covariance[0] + means.var(ddof=1)
    if total == 0:
        return float(number * n)
    correlation = 1 - (covariance[0] * n / (n - 1) - covariance) / total
    correlation[0] = 1.0
    pairs = correlation[: (n - 1) // 2 * 2].reshape(-1, 2).sum(1)
    ended = np.append(pairs[:-1] <= 0, True).argmax()
    monotone = np.minimum.accumulate(pairs[:ended]).sum()
    time = 2 * monotone - 1 + max(correlation[2 * ended], 0.0)
    return float(number * n / max(time, 1 / np.log10(number * n)))


def r_hat(chains: Floats) -> float:
    """Potential scale reduction factor of chains, shape (chains, draws) (eq. 1-4)."""
    n = chains.shape[1]
    within = chains.var(1, ddof=1).mean()
    between = chains.mean(1).var(ddof=1)
    if within == 0:
        return math.inf if between > 0 else 1.0
    return math.sqrt((n - 1) / n + between / within)


def unfinished_posterior(
    fit: FitResult, file: str | PathLike[str]
) -> tuple[FitResult, Chain] | None:
    """An unfinished sample left on disk: the fit with a posterior marked as
    unfinished, and the chain. None where `file` is missing, too short to be judged, or
    of another fit."""
    if not Path(file).is_file():
        return None
    chain = load_chain(file)
    try:
        chain = chain.with_fit(fit)
    except InputError:  # of the fit before this one
        return None
    if len(chain.values) < FEWEST_STEPS:
        return None
    return replace(summarised(fit, chain, "not finished"), sampling="unfinished"), chain


def summarised(
    fit: FitResult,
    chain: Chain,
    ended: str,
    effective: float | None = None,
    diagnosis: Diagnosis | None = None,
) -> FitResult:
    """The fit with the summary of a chain. `ended` says how the run ended, `effective`
    is the target for the effective sample size, and `diagnosis` that of the chain; None
    where they are not known."""
    free = fit.parameter_set.free
    names = fit.parameter_set.names_where(free)
    diagnosis = diagnosis or Diagnosis(chain.values[:, :, free], chain.ensembles)
    fixed = fit.parameter_set.fixed
    samples = with_combinations(chain.names, chain.flat, fit.combinations)
    quantities = {name: values for name, values in samples.items() if name not in fixed}
    correlation = np.atleast_2d(np.corrcoef(chain.flat[:, free].T))

    def by_name(numbers: Floats) -> dict[str, float]:
        return dict(zip(names, map(float, numbers), strict=True))

    steps, walkers, _ = chain.values.shape
    status = ended
    if ended != CONVERGED:
        wanted = "" if effective is None else f" of {effective:.0f} wanted"
        status += (
            f": {diagnosis.least_effective:.0f} effective samples{wanted}, "
            f"R-hat {diagnosis.worst_r_hat:.3f}"
        )
    if not chain.mostly_ridge:
        status += (
            "; its shape differs from the approximation by the fit, "
            "so most proposals were ensemble moves"
        )
    posterior = Posterior(
        samples=len(chain.flat),
        steps=steps,
        discarded=chain.discarded,
        walkers=walkers,
        ensembles=chain.ensembles,
        seed=chain.seed,
        acceptance=chain.acceptance,
        ess=by_name(diagnosis.bulk),
        ess_tail=by_name(diagnosis.tail),
        r_hat=by_name(diagnosis.r_hat),
        quantiles={name: quantiles_of(values) for name, values in quantities.items()},
        mean={name: float(values.mean()) for name, values in quantities.items()},
        sd={name: float(values.std()) for name, values in quantities.items()},
        correlation=dict(zip(names, map(by_name, correlation), strict=True)),
        converged=ended == CONVERGED,
        status=status,
    )
    return replace(fit, posterior=posterior, sampling="ended")
