"""A run of the sampler: moves, steps, and the state needed to interrupt and resume it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import log_posterior
from curlfit.inference.mcmc.chain import Chain, SamplerState, require_same, subject_of
from curlfit.inference.mcmc.convergence import BLOCK, Diagnosis, steps_to_discard
from curlfit.inference.mcmc.library import State, emcee
from curlfit.inference.mcmc.proposals import EnsembleMove
from curlfit.inference.mcmc.ridge import first_walkers, ridge_move
from curlfit.inference.model import Model
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import in_batches

ENSEMBLES = 4
_MOSTLY_RIDGE = (0.8, 0.1, 0.1)  # shares: ridge, stretch, differential evolution
_MOSTLY_ENSEMBLE = (0.2, 0.4, 0.4)  # the same where few ridge proposals are accepted
_LEAST_ACCEPTANCE = 0.2


def prepare_sampling(model: Model, parameters: ParameterSet, problem: Problem) -> None:
    """Start to compile what sampling of a problem needs."""
    log_posterior.prepare(
        model, np.zeros((_walkers(parameters) // 2, len(parameters))), parameters.lower,
        parameters.upper, problem, parameters.penalty,
    )  # fmt: skip


def _walkers(parameters: ParameterSet) -> int:
    return ENSEMBLES * max(32, 4 * ((2 * int(parameters.free.sum()) + 3) // 4))


class _Step(NamedTuple):
    """One step of all walkers, and the state of the sampler, which only the last step keeps."""

    values: Floats
    log_posterior: Floats
    state: SamplerState | None


class Run:
    """An unfinished chain. It may be interrupted at any point: completed steps are kept."""

    def __init__(self, fit: FitResult, seed: int) -> None:
        self.seed, self.subject = seed, subject_of(fit, seed)
        self._model = fit.model
        parameters = fit.parameter_set
        self._problem, origin = problem_of(fit)
        self._offset = origin.offset(len(parameters))
        self._base = fit.values - self._offset
        self._penalty = parameters.shifted(-self._offset).penalty
        self._lower, self._upper = parameters.lower - self._offset, parameters.upper - self._offset
        self.names, self.free = parameters.names, parameters.free
        self._move = ridge_move(fit, self._offset)
        self._dimension = int(self.free.sum())
        self._walkers = _walkers(parameters)
        self._mostly_ridge = True
        self._interrupted = False
        self._done: list[_Step] = []
        self._state: Any = None
        self._sampler: Any = None

    @property
    def steps(self) -> int:
        """Number of steps done."""
        return len(self._done)

    @property
    def block_is_over(self) -> bool:
        """Whether a test of convergence is due."""
        state = self._done[-1].state if self._done else None
        return state is not None and state.left == 0

    @property
    def ridge_proposals_fail(self) -> bool:
        """Whether the posterior differs from its approximation by the fit."""
        return self._mostly_ridge and self._move.acceptance < _LEAST_ACCEPTANCE

    def resume(self, chain: Chain, file: Path) -> None:
        """Resume where a stored chain ended. Raises `DataError` if that is not possible."""
        require_same(chain.subject, self.subject, file)
        state = chain.state
        if state is None or not len(chain.values):
            raise DataError("cannot be resumed: the sampler's state is not in it", file=file)
        self._mostly_ridge = state.mostly_ridge
        self._move.proposed, self._move.accepted = state.proposed, state.accepted
        self._state = State(state.coords, log_prob=chain.log_posterior[-1].copy())
        self._sampler = self._sampler_with(state.random)
        earlier = zip(chain.values[:-1], chain.log_posterior[:-1], strict=True)
        self._done = [_Step(values, log, None) for values, log in earlier]
        self._done.append(_Step(chain.values[-1], chain.log_posterior[-1], state))

    def begin(self) -> None:
        """Find initial positions of the walkers, unless a chain is resumed."""
        if self._state is not None:
            return
        random = np.random.RandomState(self.seed)  # emcee accepts no other
        ends = self._lower[self.free], self._upper[self.free]
        coords = first_walkers(self._move, self._log_prob, self._walkers, *ends, random)
        self._state = State(coords, log_prob=self._log_prob(coords))
        self._sampler = self._sampler_with(random.get_state(legacy=True))
        self._raise_if_interrupted()

    def start_over(self) -> None:
        """Discard the steps so far as burn-in, and rely on the ensemble moves."""
        self._mostly_ridge = False
        self._done.clear()
        self._sampler = self._sampler_with(self._sampler.random_state)

    def block(self) -> Iterator[None]:
        """Do the steps up to the next test of convergence."""
        before = self._done[-1].state if self._done else None
        todo = (before.left if before else 0) or max(BLOCK, self.steps // 5)
        for number, state in enumerate(
            self._sampler.sample(
                self._state, iterations=todo, store=False, skip_initial_state_check=True
            ),
            start=1,
        ):
            self._raise_if_interrupted()
            self._state = state
            coords = state.coords.copy()
            after = SamplerState(
                coords, self._sampler.random_state, todo - number, self._mostly_ridge,
                self._move.proposed, self._move.accepted,
            )  # fmt: skip
            step = _Step(self._whole(coords) + self._offset, state.log_prob.copy(), after)
            self._done.append(step)  # atomic: an interrupt leaves a valid chain
            if self.steps > 1:
                self._done[-2] = self._done[-2]._replace(state=None)
            yield

    def diagnosis(self) -> Diagnosis:
        """Convergence of the steps so far."""
        return Diagnosis(np.stack([step.values[:, self.free] for step in self._done]), ENSEMBLES)

    def chain(self) -> Chain:
        """The chain of the steps so far."""
        values = np.stack([step.values for step in self._done])
        return Chain(
            names=self.names,
            values=values,
            log_posterior=np.stack([step.log_posterior for step in self._done]),
            accepted=np.any(np.diff(values, axis=0) != 0, axis=2).sum(0),
            discarded=steps_to_discard(len(values)),
            ensembles=ENSEMBLES,
            seed=self.seed,
            subject=self.subject,
            state=self._done[-1].state,
        )

    def _sampler_with(self, random: Any) -> Any:
        shares = _MOSTLY_RIDGE if self._mostly_ridge else _MOSTLY_ENSEMBLE
        moves = (
            self._move,
            EnsembleMove(ENSEMBLES, evolution=False),
            EnsembleMove(ENSEMBLES, evolution=True),
        )
        made = emcee.EnsembleSampler(
            self._walkers,
            self._dimension,
            self._log_prob,
            vectorize=True,
            moves=list(zip(moves, shares, strict=True)),
        )
        made.random_state = random
        return made

    def _whole(self, free_values: Floats) -> Floats:
        values = np.tile(self._base, (len(free_values), 1))
        values[:, self.free] = free_values
        return values

    def _log_posterior(self, values: Floats) -> Any:
        return log_posterior(
            self._model, values, self._lower, self._upper, self._problem, self._penalty
        )

    def _log_prob(self, free_values: Floats) -> Floats:
        values = self._whole(free_values)
        try:
            # Half of the walkers at a time, as ensemble moves need them.
            return np.asarray(in_batches(self._log_posterior, (values,), self._walkers // 2))
        except KeyboardInterrupt:
            # emcee would print its own error message; this step is discarded.
            self._interrupted = True
            return np.full(len(values), -np.inf)

    def _raise_if_interrupted(self) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
