"""The posterior by emcee: four ensembles, sampled until convergence, and a verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from time import monotonic
from typing import Any, Protocol

import numpy as np

from curlfit.errors import DataError, InputError, UnusableFitError
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.model.likelihood import log_posterior
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.problem import Problem
from curlfit.inference.sampling.chain import Chain, load_chain, require_same, subject_of
from curlfit.inference.sampling.density import PosteriorDensity, lanes
from curlfit.inference.sampling.emcee_alone import emcee
from curlfit.inference.sampling.ridge import Proposal, posterior_proposal, proposed
from curlfit.inference.sampling.summary import (
    CONVERGED,
    FEWEST_STEPS,
    Diagnosis,
    is_test_due,
    steps_to_discard,
    summarised,
)
from curlfit.numerics.arrays import Booleans, Floats

Progress = Callable[[float, int, float], None]

ENSEMBLES = 4
_MOSTLY_RIDGE = (0.8, 0.1, 0.1)  # shares: ridge, stretch, differential evolution
_MOSTLY_ENSEMBLE = (0.2, 0.4, 0.4)  # shares where few ridge proposals are accepted
_LEAST_ACCEPTANCE = 0.25
"""Of all proposals, below which ensemble moves do most of the work: then fewer than a
fifth of those along the ridge are accepted."""
_JITTER = 0.1  # relative standard deviation of the steps of differential evolution
_TRIES = 50  # rounds of proposals in which walkers of finite posterior are sought
# probability beyond what a chain has reached, above which it has not converged
_UNREACHED = 0.01
_EVERY = 2.0  # least time between two checkpoints, s
_TIMES_WRITING = 50  # least time between two checkpoints, in times that writing takes


class SideBySide(emcee.moves.RedBlueMove):
    """A move of emcee in several independent ensembles, evaluated in one call."""

    def __init__(self, move: Any) -> None:
        super().__init__(randomize_split=False)  # halves of each ensemble
        self.move = move
        self.setup = move.setup

    def get_proposal(
        self, s: Floats, c: list[Floats], random: Any
    ) -> tuple[Floats, Floats]:
        """Proposals for one half of each ensemble (`s`) along lines through its other
        half (in `c`), and the logarithms of their factors."""
        coords = []
        factors = []
        halves = zip(np.split(s, ENSEMBLES), np.split(c[0], ENSEMBLES), strict=True)
        for moving, other in halves:
            proposals, log_factors = self.move.get_proposal(moving, [other], random)
            coords.append(proposals)
            factors.append(log_factors)
        return np.concatenate(coords), np.concatenate(factors)


class Ensemble(emcee.EnsembleSampler):
    """emcee's sampler, in which Ctrl-C always ends a run.

    emcee sets the state of its random numbers within a bare `except`, which drops a
    Ctrl-C that comes there: one in 150.
    """

    @property
    def random_state(self) -> Any:
        """State of the random numbers, as of `numpy.random.RandomState`; None, where a
        run begins without one, leaves it as it is."""
        return self._random.get_state()

    @random_state.setter
    def random_state(self, state: Any) -> None:
        if state is not None:
            self._random.set_state(state)


def prepare_sampling(model: Model, parameters: ParameterSet, problem: Problem) -> None:
    """Start to compile what sampling of a problem needs."""
    log_posterior.prepare(
        model,
        np.zeros((lanes(parameters.free), len(parameters))),
        parameters.lower,
        parameters.upper,
        problem,
        parameters.penalty,
    )


class Density(Protocol):
    """A log-density that can be sampled.

    Attributes
    ----------
    names : of the parameters.
    free : which of them are sampled.
    lower, upper : bounds of the free parameters.
    """

    names: tuple[str, ...]
    free: Booleans
    lower: Floats
    upper: Floats

    def whole(self, free_values: Floats) -> Floats:
        """Values of all parameters from those of the free ones."""

    def log(self, free_values: Floats) -> Floats:
        """Log-density of walkers, shape (walkers,)."""


class Run:
    """An unfinished chain. It may be interrupted at any point: completed
    steps are kept.

    Attributes
    ----------
    seed : of the random numbers.
    mostly_ridge : whether most proposals are made along the ridge.
    """

    def __init__(
        self,
        density: Density,
        proposal: Proposal,
        subject: dict[str, str],
        seed: int,
        walkers: int,
    ) -> None:
        """A run without steps.

        Parameters
        ----------
        proposal : from which walkers begin, of points along the ridge.
        subject : what is sampled, see `subject_of`.
        """
        self._density = density
        self._proposal = proposal
        self._subject = subject
        self.seed = seed
        self._walkers = walkers
        self._steps: list[Any] = []
        self._next_write = -np.inf
        self.choose_moves(mostly_ridge=True)

    def choose_moves(self, *, mostly_ridge: bool) -> None:
        """Rely on proposals along the ridge, or on the ensemble moves."""
        self.mostly_ridge = mostly_ridge
        moves = [
            emcee.moves.MHMove(partial(proposed, self._proposal)),
            SideBySide(emcee.moves.StretchMove()),
            SideBySide(emcee.moves.DEMove(sigma=_JITTER)),
        ]
        shares = _MOSTLY_RIDGE if mostly_ridge else _MOSTLY_ENSEMBLE
        self._sampler = Ensemble(
            self._walkers,
            int(self._density.free.sum()),
            self._density.log,
            vectorize=True,
            moves=list(zip(moves, shares, strict=True)),
        )
        # Without emcee's wrapper, which prints a message of its own at Ctrl-C.
        self._sampler.log_prob_fn = self._density.log

    @property
    def steps(self) -> int:
        """Number of steps done."""
        return len(self._steps)

    def resume(self, file: Path) -> None:
        """Resume where a stored chain ended. Raises `DataError` if that is
        not possible."""
        chain = load_chain(file)
        require_same(chain.subject, self._subject, file)
        if chain.random_state is None or not len(chain.values):
            raise DataError(
                "cannot be resumed: the sampler's state is not in it", file=file
            )
        self.choose_moves(mostly_ridge=chain.mostly_ridge)
        free_values = chain.values[..., self._density.free]
        self._steps = list(map(emcee.State, free_values, chain.log_posterior))
        self._steps[-1].random_state = chain.random_state

    def begin(self) -> None:
        """Find initial positions of the walkers, unless a chain is resumed."""
        if self._steps:
            self._last = self._steps[-1]
            return
        random = np.random.RandomState(self.seed)  # emcee accepts no other
        coords = self._first_walkers(random)
        log_prob = self._density.log(coords)
        self._last = emcee.State(
            coords, log_prob=log_prob, random_state=random.get_state()
        )

    def _first_walkers(self, random: Any) -> Floats:
        """Initial positions drawn from the proposal, with finite posterior."""
        lower = self._density.lower
        upper = self._density.upper
        walkers: list[Floats] = []
        for _ in range(_TRIES):
            coords = self._proposal.draw(self._walkers, random)
            # Near a bound a proposal falls outside half the time; reflect it back.
            coords = np.where(coords < lower, 2 * lower - coords, coords)
            coords = np.where(coords > upper, 2 * upper - coords, coords)
            walkers.extend(coords[np.isfinite(self._density.log(coords))])
            if len(walkers) >= self._walkers:
                return np.array(walkers[: self._walkers])
        raise UnusableFitError("no point of finite posterior was found near the fit")

    def step(self) -> None:
        """Do one step of all walkers."""
        state = self._sampler.run_mcmc(
            self._last, 1, store=False, skip_initial_state_check=True
        )
        self._steps.append(state)  # first, so that an interrupt leaves a valid chain
        self._last.random_state = None  # only the last is needed
        self._last = state

    def chain(self) -> Chain:
        """The chain of the steps so far."""
        values = self._density.whole(np.stack([state.coords for state in self._steps]))
        return Chain(
            names=self._density.names,
            values=values,
            log_posterior=np.stack([state.log_prob for state in self._steps]),
            discarded=steps_to_discard(len(values)),
            ensembles=ENSEMBLES,
            seed=self.seed,
            subject=self._subject,
            random_state=self._steps[-1].random_state,
            mostly_ridge=self.mostly_ridge,
        )

    def write_if_due(self, file: Path | None) -> None:
        """Write a checkpoint if one is due."""
        now = monotonic()
        if file is None or now < self._next_write:
            return
        self.chain().save(file)
        after = monotonic()
        self._next_write = after + max(_EVERY, _TIMES_WRITING * (after - now))

    def until(
        self,
        effective: float,
        most_steps: int,
        progress: Progress | None = None,
        file: Path | None = None,
    ) -> tuple[str, Diagnosis | None]:
        """Sample until convergence, `most_steps` or Ctrl-C; how it ended, and the
        diagnosis of the chain, if it is known."""
        free = self._density.free
        try:
            self.begin()
            while True:
                if is_test_due(self.steps):
                    chain = self.chain()
                    if self.mostly_ridge and chain.acceptance < _LEAST_ACCEPTANCE:
                        self._steps = []  # they were burn-in
                        self.choose_moves(mostly_ridge=False)
                        continue
                    diagnosis = Diagnosis(chain.values[:, :, free], chain.ensembles)
                    if progress is not None:
                        progress(
                            diagnosis.least_effective, self.steps, diagnosis.worst_r_hat
                        )
                    unreached = self._proposal.unreached(chain.flat[:, free])
                    reaches_ends = unreached < _UNREACHED
                    if diagnosis.good(effective) and reaches_ends:
                        return CONVERGED, diagnosis
                    if self.steps >= most_steps:
                        ended = f"not converged after {self.steps} steps"
                        if not reaches_ends:
                            ended += ", without the ends of the values that fit"
                        return ended, diagnosis
                self.step()
                self.write_if_due(file)
        except KeyboardInterrupt:
            if self.steps < FEWEST_STEPS:
                raise
            return "stopped by the user", None


def sample(
    fit: FitResult,
    *,
    seed: int = 0,
    effective: float = 4000.0,
    most_steps: int = 2_000,
    progress: Progress | None = None,
    checkpoint: str | PathLike[str] | None = None,
    resume: bool = False,
) -> tuple[FitResult, Chain]:
    """Sample the posterior about a fit until convergence.

    A parameter without a prior in the fit has a flat one within its bounds. The noise
    has the fit's sigmas, is independent or correlated by the fit's noise model, and is
    Gaussian or has the density of the fit's loss. Ctrl-C ends the run and keeps the
    steps so far.

    Parameters
    ----------
    fit : a fit, fresh or loaded.
    seed : of the random numbers; the same seed gives the same chain.
    effective : target for the effective sample size of every parameter.
    most_steps : number of steps at which to stop if that is not reached.
    progress : called at intervals with the effective sample size so far (smallest over
        parameters), the steps so far, and R-hat (largest).
    checkpoint : a `chain.h5` to which the chain so far is written atomically: after the
        first step, then every two seconds or less often where writing takes long, and
        when the run ends.
    resume : continue where the chain in `checkpoint` ended, if there is one. The
        chain is then that of a single run, bit for bit on the same machine with the
        same packages.

    Returns
    -------
    the fit with its `posterior` filled in, and the chain.

    Raises
    ------
    UnusableFitError : no walker found a point of finite posterior.
    InputError : the chain to be resumed is of other data, law, load, stone, bounds,
        seed or version, or the checkpoint cannot be written.

    Examples
    --------
    >>> sampled, chain = curlfit.sample(fit, effective=400)
    >>> sampled.posterior.converged
    True
    """
    require_fit(fit)
    density = PosteriorDensity(fit)
    walkers = 2 * density.batch
    run = Run(density, posterior_proposal(fit), subject_of(fit, seed), seed, walkers)
    file = None if checkpoint is None else Path(checkpoint)
    if resume:
        if file is None:
            raise InputError("resume: expected a checkpoint to resume from")
        if file.exists():
            run.resume(file)
    ended, diagnosis = run.until(effective, most_steps, progress, file)
    chain = run.chain()
    if file is not None:
        chain.save(file)
    sampled = summarised(fit, chain, ended, effective, diagnosis)
    sampled = replace(sampled, quantities=quantities_of(sampled, chain))
    expressions = [quantity.expression for quantity in fit.derived]
    sampled = sampled.with_derived(expressions, chain)
    products = tuple(
        replace(sampled.derive(product.expression, chain), meaning=product.meaning)
        for product in fit.products
    )
    sampled = replace(sampled, products=products)
    return sampled, replace(chain, fit=sampled)
