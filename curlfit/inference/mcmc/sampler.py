"""The posterior by emcee: four ensembles, sampled until converged, and a verdict on the sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, cast

import emcee
import numpy as np
from emcee.state import State
from scipy.optimize import linprog

from curlfit.errors import DataError, InputError, UnusableFitError
from curlfit.inference.fit.result import FitResult, Posterior
from curlfit.inference.identifiability import directions
from curlfit.inference.likelihood import log_posterior
from curlfit.inference.mcmc.chain import Chain, SamplerState, load_chain, require_same, subject_of
from curlfit.inference.mcmc.proposals import EnsembleMove, Indices, RidgeMove
from curlfit.inference.problem import Origin, build_problem
from curlfit.numerics.arrays import Floats

ENSEMBLES = 4
R_HAT = 1.01
EFFECTIVE = 4000.0
_MARGIN = 4.0  # standard errors by which the proposal reaches past the ridge's ends
_BOLD = (0.8, 0.1, 0.1)  # shares of the moves: ridge, stretch, differential evolution
_WARY = (0.2, 0.4, 0.4)  # the same where ridge proposals are accepted less often than
_TOO_FEW = 0.2
_BLOCK = 20  # steps between the first looks at convergence; later a fifth of those done
_SHORTEST_IN_TIMES = 30.0  # steps over autocorrelation time, below which no estimate is trusted
_EVERY = 2.0  # seconds between two checkpoints, at least
_QUANTILES = ("2.5", "16", "50", "84", "97.5")


def sample(
    fit: FitResult,
    *,
    seed: int = 0,
    effective: float = EFFECTIVE,
    most_steps: int = 2_000,
    progress: Callable[[float, int, float], None] | None = None,
    checkpoint: str | PathLike[str] | None = None,
    resume: bool = False,
) -> tuple[FitResult, Chain]:
    """Sample the posterior about a fit, until it is converged.

    Where the fit has no prior, it is flat within the bounds of the parameter. Noise is of the fit's
    sigmas, independent or as the fit's noise model has it, Gaussian or as its loss has it. Ctrl-C
    ends the run and keeps what there is.

    Parameters
    ----------
    fit : a fit, fresh or loaded.
    seed : of the random numbers; the same seed gives the same chain.
    effective : effective samples wanted of every parameter.
    most_steps : where to stop if that is not reached.
    progress : called now and then with the effective samples so far (smallest over parameters),
        the steps so far, and R-hat.
    checkpoint : a `chain.h5` where the chain so far is kept, whole at any moment: after the first
        step, then every two seconds, and when the run ends.
    resume : go on where the chain in `checkpoint` ended, if there is one. The chain is then the
        one that a single run would have given, bit for bit on the same machine and packages.

    Returns
    -------
    the fit with its `posterior` filled in, and the chain.

    Raises
    ------
    UnusableFitError : no walker found a point of finite posterior.
    InputError : the chain to be resumed is of other data, law, load, stone, bounds, seed or
        version, or the checkpoint cannot be written.
    """
    run = _Run(fit, seed)
    file = None if checkpoint is None else Path(checkpoint)
    if resume:
        if file is None:
            raise InputError("resume: expected a checkpoint to resume from")
        if file.exists():
            run.take_up(load_chain(file), file)
    keeper = _Keeper(file)
    ended = "stopped by the user"
    try:
        run.begin()
        while True:
            if run.block_is_over:
                if run.is_astray:
                    run.start_over()
                    continue
                diagnosis = run.diagnosis()
                if progress is not None:
                    progress(diagnosis.least_effective, run.steps, diagnosis.worst_r_hat)
                if diagnosis.good(effective):
                    ended = "converged"
                    break
                if run.steps >= most_steps:
                    ended = f"not converged after {run.steps} steps"
                    break
            for _ in run.block():
                keeper.keep(run)
    except KeyboardInterrupt:
        if run.steps < 4:
            raise
    chain = run.chain()
    if file is not None:
        chain.save(file)
    return _summarised(fit, chain, ended, effective), chain


def so_far(fit: FitResult, file: str | PathLike[str]) -> tuple[FitResult, Chain] | None:
    """An unfinished sample that was left on disk: the fit with a posterior that says so, and the
    chain. None where `file` is missing, too short to be classify, or of another fit or version."""
    if not Path(file).is_file():
        return None
    chain = load_chain(file)
    try:
        same = chain.subject == subject_of(fit, chain.seed)
    except InputError:  # the file of a user's own law is gone
        return None
    if not same or len(chain.values) < 4:
        return None
    return replace(_summarised(fit, chain, "not finished"), sampling="unfinished"), chain


class _Keeper:
    """Writes a chain in the making now and then, for no more than a fiftieth of the time."""

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self._next = -np.inf

    def keep(self, run: _Run) -> None:
        """Write, if it is time."""
        now = monotonic()
        if self.file is None or now < self._next:
            return
        run.chain().save(self.file, compressed=False)
        after = monotonic()
        self._next = after + max(_EVERY, 50 * (after - now))


class _Step(NamedTuple):
    """One step of all walkers, and the sampler after it, which only the last step keeps."""

    values: Floats
    log_posterior: Floats
    state: SamplerState | None


class _Run:
    """A chain in the making. It may be interrupted at any point: the steps that are done stand."""

    def __init__(self, fit: FitResult, seed: int) -> None:
        self.seed, self.subject = seed, subject_of(fit, seed)
        self._model = fit.model
        throw, parameters = fit.throw, fit.parameter_set
        origin = Origin.of(throw)
        self._problem = build_problem(throw, fit.stone, origin, fit.sigma, fit.loss, fit.noise)
        self._offset = origin.offset(len(parameters))
        self._base = fit.values - self._offset
        self._penalty = parameters.shifted(-self._offset).penalty
        self._lower, self._upper = parameters.lower - self._offset, parameters.upper - self._offset
        self.names, self.free = parameters.names, parameters.free
        self._move = ridge_move(fit, self._offset)
        self._dimension = int(self.free.sum())
        self._walkers = ENSEMBLES * max(32, 4 * ((2 * self._dimension + 3) // 4))
        self._bold = True
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
        """Whether it is time to judge."""
        state = self._done[-1].state if self._done else None
        return state is not None and state.left == 0

    @property
    def is_astray(self) -> bool:
        """Whether the posterior is not what the fit foresaw."""
        return self._bold and self._move.acceptance < _TOO_FEW

    def take_up(self, chain: Chain, file: Path) -> None:
        """Go on where a stored chain ended. Raises `DataError` where it is of something else."""
        require_same(chain.subject, self.subject, file)
        state = chain.state
        if state is None or not len(chain.values):
            raise DataError("cannot be resumed: the sampler's state is not in it", file=file)
        self._bold = state.bold
        self._move.tried, self._move.taken = state.tried, state.taken
        self._state = State(state.coords, log_prob=chain.log_posterior[-1].copy())
        self._sampler = self._sampler_with(state.random)
        earlier = zip(chain.values[:-1], chain.log_posterior[:-1], strict=True)
        self._done = [_Step(values, log, None) for values, log in earlier]
        self._done.append(_Step(chain.values[-1], chain.log_posterior[-1], state))

    def begin(self) -> None:
        """Find first places for the walkers, unless a chain was taken up."""
        if self._state is not None:
            return
        random = np.random.RandomState(self.seed)  # emcee takes no other
        ends = self._lower[self.free], self._upper[self.free]
        coords = _first_walkers(self._move, self._log_prob, self._walkers, *ends, random)
        self._state = State(coords, log_prob=self._log_prob(coords))
        self._sampler = self._sampler_with(random.get_state(legacy=True))
        self._heed()

    def start_over(self) -> None:
        """Forget the steps so far, which were on the way, and rely on the ensemble moves."""
        self._bold = False
        self._done.clear()
        self._sampler = self._sampler_with(self._sampler.random_state)

    def block(self) -> Iterator[None]:
        """Do the steps up to the next look at convergence."""
        before = self._done[-1].state if self._done else None
        todo = (before.left if before else 0) or max(_BLOCK, self.steps // 5)
        for place, state in enumerate(
            self._sampler.sample(
                self._state, iterations=todo, store=False, skip_initial_state_check=True
            ),
            start=1,
        ):
            self._heed()
            self._state = state
            coords = state.coords.copy()
            after = SamplerState(
                coords, self._sampler.random_state, todo - place, self._bold,
                self._move.tried, self._move.taken,
            )  # fmt: skip
            step = _Step(self._whole(coords) + self._offset, state.log_prob.copy(), after)
            self._done.append(step)  # at one stroke
            if self.steps > 1:
                self._done[-2] = self._done[-2]._replace(state=None)
            yield

    def diagnosis(self) -> _Diagnosis:
        """Convergence of the steps so far."""
        return _diagnose(np.stack([step.values[:, self.free] for step in self._done]), ENSEMBLES)

    def chain(self) -> Chain:
        """The steps so far."""
        values = np.stack([step.values for step in self._done])
        return Chain(
            names=self.names,
            values=values,
            log_posterior=np.stack([step.log_posterior for step in self._done]),
            accepted=np.any(np.diff(values, axis=0) != 0, axis=2).sum(0),
            discarded=_discarded(len(values)),
            ensembles=ENSEMBLES,
            seed=self.seed,
            subject=self.subject,
            state=self._done[-1].state,
        )

    def _sampler_with(self, random: Any) -> Any:
        shares = _BOLD if self._bold else _WARY
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

    def _log_prob(self, free_values: Floats) -> Floats:
        values = self._whole(free_values)
        try:
            return np.asarray(
                log_posterior(
                    self._model, values, self._lower, self._upper, self._problem, self._penalty
                )
            )
        except KeyboardInterrupt:
            # emcee would print its own account of it; this step is thrown away.
            self._interrupted = True
            return np.full(len(values), -np.inf)

    def _heed(self) -> None:
        if self._interrupted:
            raise KeyboardInterrupt


def ridge_move(fit: FitResult, offset: Floats) -> RidgeMove:
    """The proposal from what the fit knows of its surroundings."""
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
    pivots, low, high = _pivots(wide, lower, upper, reach)
    # Off its bound the log-posterior falls with slope and curvature; either sets the distance.
    curvature = np.diag(information)[pushed] - ((rows[:, pushed] * singular[:, None]) ** 2).sum(0)
    push = np.abs(gradient[pushed]) + np.sqrt(np.maximum(curvature, 0.0))
    off = -np.sign(gradient[pushed]) / push
    return RidgeMove(centre, typical, rows, spread, pivots, low, high, pushed, off)


def _pivots(
    null: Floats, lower: Floats, upper: Floats, reach: Floats
) -> tuple[Indices, Floats, Floats]:
    """A bounded parameter for each unseen direction, and how far the ridge lets it go."""
    pivots: list[int] = []
    rest = null.copy()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    for _ in range(len(null)):
        size = np.where(bounded, (rest**2).sum(0), 0.0)
        if size.max() < 1e-12:
            raise UnusableFitError(
                "a direction that the data do not see has no bounds; give some with --bound"
            )
        pivot = int(np.argmax(size))
        pivots.append(pivot)
        column = rest[:, pivot] / np.linalg.norm(rest[:, pivot])
        rest = rest - np.outer(column, column @ rest)
    walls = np.concatenate([null.T, -null.T])
    room = np.concatenate([upper + reach, reach - lower])
    finite = np.isfinite(room)
    low, high = np.zeros(len(pivots)), np.zeros(len(pivots))
    for place, pivot in enumerate(pivots):
        for ends, sign in ((low, 1.0), (high, -1.0)):
            found = linprog(
                sign * null[:, pivot], A_ub=walls[finite], b_ub=room[finite], bounds=(None, None)
            )
            ends[place] = np.clip(sign * found.fun, lower[pivot], upper[pivot])
    return np.array(pivots, int), low, high


def _first_walkers(
    move: RidgeMove,
    log_prob: Callable[[Floats], Floats],
    walkers: int,
    lower: Floats,
    upper: Floats,
    random: Any,
) -> Floats:
    """Starting places drawn from the proposal, of finite posterior."""
    found: list[Floats] = []
    for _ in range(50):
        coords = move.draw(walkers, random)
        # Near a bound a proposal falls outside half the time; fold it back in.
        folded = np.where(coords < lower, 2 * lower - coords, coords)
        folded = np.where(folded > upper, 2 * upper - folded, folded)
        found.extend(folded[np.isfinite(log_prob(folded))])
        if len(found) >= walkers:
            return np.array(found[:walkers])
    raise UnusableFitError("no point of finite posterior was found near the fit")


@dataclass(frozen=True)
class _Diagnosis:
    discarded: int
    times: Floats
    effective: Floats
    r_hat: Floats
    steps: int

    @property
    def least_effective(self) -> float:
        return float(self.effective.min())

    @property
    def worst_r_hat(self) -> float:
        return float(self.r_hat.max())

    @property
    def long_enough(self) -> bool:
        return self.steps - self.discarded >= _SHORTEST_IN_TIMES * float(self.times.max())

    def good(self, effective: float) -> bool:
        return self.long_enough and self.least_effective >= effective and self.worst_r_hat < R_HAT


def _discarded(steps: int) -> int:
    """Steps to leave out at first."""
    return min(max(_BLOCK // 2, steps // 10), steps // 2)


def _diagnose(values: Floats, ensembles: int) -> _Diagnosis:
    """Autocorrelation time, effective samples and R-hat of values (steps, walkers, parameters)."""
    steps, walkers, dimension = values.shape
    discarded = _discarded(steps)
    kept = values[discarded:]
    with np.errstate(invalid="ignore"):  # a walker that never moved; counted as no information
        times = emcee.autocorr.integrated_time(kept, tol=0, has_walkers=True)
    times = np.maximum(np.nan_to_num(times, nan=float(len(kept))), 1.0)
    effective = kept.shape[0] * walkers / times
    groups = kept.reshape(len(kept), ensembles, -1, dimension)
    # Each ensemble is cut in two, so that a drift shows as well as a disagreement.
    half = len(kept) // 2
    parts = np.concatenate([groups[:half], groups[half : 2 * half]], 1)
    return _Diagnosis(discarded, times, effective, r_hat(parts), steps)


def r_hat(groups: Floats) -> Floats:
    """Potential scale reduction of Gelman and Rubin (1992).

    Parameters
    ----------
    groups : shape (steps, groups, walkers, parameters); the walkers of a group count as one chain.
    """
    n = groups.shape[0] * groups.shape[2]
    means = groups.mean((0, 2))
    within = groups.var((0, 2)).mean(0) * n / (n - 1)
    between = means.var(0, ddof=1)
    return cast(Floats, np.sqrt((n - 1) / n + between / np.where(within > 0, within, 1.0)))


def _summarised(
    fit: FitResult, chain: Chain, ended: str, effective: float | None = None
) -> FitResult:
    """The fit with the summary of a chain, which ended as `ended` says, with so many effective
    samples `effective` wanted; None where that is not known."""
    free = fit.parameter_set.free
    names = fit.parameter_set.names_where(free)
    diagnosis = _diagnose(chain.values[:, :, free], chain.ensembles)
    quantities = {name: chain.of({name: 1.0}) for name in names}
    correlation = np.atleast_2d(np.corrcoef(np.stack(list(quantities.values()))))
    quantities |= {item.expression: chain.of(item.weights) for item in fit.combinations}
    levels = [float(level) / 100 for level in _QUANTILES]
    steps, walkers, _ = chain.values.shape
    status = ended
    if ended != "converged":
        wanted = "" if effective is None else f" of {effective:.0f} wanted"
        status += (
            f": {diagnosis.least_effective:.0f} effective samples{wanted}, "
            f"R-hat {diagnosis.worst_r_hat:.3f}"
        )
    if chain.state is not None and not chain.state.bold:
        status += (
            "; it is not of the shape that the fit foresaw, so ensemble moves did most of the work"
        )
    posterior = Posterior(
        samples=len(chain.flat),
        steps=steps,
        discarded=chain.discarded,
        walkers=walkers,
        ensembles=chain.ensembles,
        seed=chain.seed,
        acceptance=float(chain.accepted.mean() / max(steps - 1, 1)),
        ess=dict(zip(names, map(float, diagnosis.effective), strict=True)),
        r_hat=dict(zip(names, map(float, diagnosis.r_hat), strict=True)),
        autocorrelation_time=dict(zip(names, map(float, diagnosis.times), strict=True)),
        quantiles={
            name: dict(zip(_QUANTILES, map(float, np.quantile(values, levels)), strict=True))
            for name, values in quantities.items()
        },
        mean={name: float(values.mean()) for name, values in quantities.items()},
        sd={name: float(values.std()) for name, values in quantities.items()},
        correlation={
            name: dict(zip(names, map(float, row), strict=True))
            for name, row in zip(names, correlation, strict=True)
        },
        converged=effective is not None and diagnosis.good(effective),
        status=status,
    )
    return fit.with_posterior(posterior)
