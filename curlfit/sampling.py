"""The posterior by emcee: four ensembles, sampled until converged, and a verdict on the sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, cast

import emcee
import h5py
import numpy as np
from emcee.state import State
from numpy.typing import NDArray
from scipy.optimize import linprog

from curlfit.errors import DataError, UnusableFitError
from curlfit.files import replaced
from curlfit.friction import check_load
from curlfit.identifiability import directions
from curlfit.likelihood import frame_of, log_posterior, problem_of
from curlfit.moves import EnsembleMove, Floats, Indices, RidgeMove
from curlfit.results import FitResult, Posterior
from curlfit.version import __version__

ENSEMBLES = 4
R_HAT = 1.01
EFFECTIVE = 4000.0
_MARGIN = 4.0  # standard errors by which the proposal reaches past the ridge's ends
_BOLD = (0.8, 0.1, 0.1)  # shares of the moves: ridge, stretch, differential evolution
_WARY = (0.2, 0.4, 0.4)  # the same where ridge proposals are accepted less often than
_TOO_FEW = 0.2
_BLOCK = 20  # steps between the first looks at convergence; later a fifth of those done
_SHORTEST_IN_TIMES = 30.0  # steps over autocorrelation time, below which no estimate is trusted
_QUANTILES = ("2.5", "16", "50", "84", "97.5")


@dataclass(frozen=True)
class Chain:
    """A posterior sample.

    Attributes
    ----------
    names : of the parameters, fixed ones included.
    values : shape (steps, walkers, parameters). log_posterior : shape (steps, walkers).
    accepted : number of accepted proposals by walker. discarded : steps to leave out at first.
    ensembles : the walkers are divided evenly among these. seed : of the run.
    """

    names: tuple[str, ...]
    values: Floats
    log_posterior: Floats
    accepted: NDArray[np.int64]
    discarded: int
    ensembles: int
    seed: int

    @property
    def flat(self) -> Floats:
        """The kept samples, shape (samples, parameters)."""
        return self.values[self.discarded :].reshape(-1, len(self.names))

    def of(self, weights: dict[str, float]) -> Floats:
        """Samples of a combination of parameters."""
        return cast(
            Floats,
            sum(weight * self.flat[:, self.names.index(name)] for name, weight in weights.items()),
        )

    def save(self, file: str | PathLike[str]) -> None:
        """Write `chain.h5`, in the layout of emcee's HDF backend with curlfit's own attributes."""
        with replaced(Path(file)) as temporary, h5py.File(temporary, "w") as out:
            group = out.create_group("mcmc")
            steps, walkers, dimension = self.values.shape
            group.attrs.update(
                version=emcee.__version__,
                nwalkers=walkers,
                ndim=dimension,
                has_blobs=False,
                iteration=steps,
            )
            group.create_dataset("chain", data=self.values, compression="gzip", shuffle=True)
            group.create_dataset("log_prob", data=self.log_posterior)
            group.create_dataset("accepted", data=self.accepted)
            out.attrs.update(
                curlfit=__version__,
                names=list(self.names),
                discarded=self.discarded,
                ensembles=self.ensembles,
                seed=self.seed,
            )


def load_chain(file: str | PathLike[str]) -> Chain:
    """Read a `chain.h5`. Raises `DataError` where it is missing or is not one."""
    path = Path(file)
    if not path.is_file():
        raise DataError("no such file", file=path)
    try:
        with h5py.File(path, "r") as stored:
            return Chain(
                names=tuple(str(name) for name in stored.attrs["names"]),
                values=stored["mcmc/chain"][:],
                log_posterior=stored["mcmc/log_prob"][:],
                accepted=stored["mcmc/accepted"][:],
                discarded=int(stored.attrs["discarded"]),
                ensembles=int(stored.attrs["ensembles"]),
                seed=int(stored.attrs["seed"]),
            )
    except (OSError, KeyError) as error:
        raise DataError(f"not a chain.h5 of curlfit ({error})", file=path) from None


def sample(
    fit: FitResult,
    *,
    seed: int = 0,
    effective: float = EFFECTIVE,
    most_steps: int = 2_000,
    progress: Callable[[float, int, float], None] | None = None,
) -> tuple[FitResult, Chain]:
    """Sample the posterior about a fit, until it is converged.

    The prior is even within the bounds of the parameters. Noise is independent, of the fit's
    sigmas, Gaussian or as the fit's loss has it. Ctrl-C ends the run and keeps what there is.

    Parameters
    ----------
    fit : a fit, fresh or loaded.
    seed : of the random numbers; the same seed gives the same chain.
    effective : effective samples wanted of every parameter.
    most_steps : where to stop if that is not reached.
    progress : called now and then with the effective samples so far (smallest over parameters),
        the steps so far, and R-hat.

    Returns
    -------
    the fit with its `posterior` filled in, and the chain.

    Raises
    ------
    UnusableFitError : no walker found a place of finite posterior.
    """
    law, load = fit.law_class, check_load(fit.load)
    throw, parameters = fit.throw, fit.parameter_set
    frame = frame_of(throw)
    problem = problem_of(throw, fit.stone, frame, fit.sigma, fit.loss)
    offset = frame.offset(len(parameters))
    free = parameters.free
    base = fit.values - offset
    lower, upper = parameters.lower - offset, parameters.upper - offset

    def whole(free_values: Floats) -> Floats:
        values = np.tile(base, (len(free_values), 1))
        values[:, free] = free_values
        return values

    interrupted: list[bool] = []

    def log_prob(free_values: Floats) -> Floats:
        values = whole(free_values)
        try:
            return np.asarray(log_posterior(law, load, values, lower, upper, problem))
        except KeyboardInterrupt:
            # emcee would print its own account of it; this step is refused and the loop ends.
            interrupted.append(True)
            return np.full(len(values), -np.inf)

    move = _ridge_move(fit, offset)
    dimension = int(free.sum())
    per_ensemble = max(32, 4 * ((2 * dimension + 3) // 4))
    walkers = ENSEMBLES * per_ensemble
    random = np.random.RandomState(seed)  # emcee takes no other
    coords = _first_walkers(move, log_prob, walkers, lower[free], upper[free], random)

    def sampler_with(shares: tuple[float, float, float], random_state: Any) -> Any:
        moves = (
            move,
            EnsembleMove(ENSEMBLES, evolution=False),
            EnsembleMove(ENSEMBLES, evolution=True),
        )
        made = emcee.EnsembleSampler(
            walkers,
            dimension,
            log_prob,
            vectorize=True,
            moves=list(zip(moves, shares, strict=True)),
        )
        made.random_state = random_state
        return made

    sampler = sampler_with(_BOLD, random.get_state())
    bold = True
    kept: list[Floats] = []
    kept_log: list[Floats] = []
    ended = "stopped by the user"
    try:
        state: Any = State(coords, log_prob=log_prob(coords))
        while True:
            for state in sampler.sample(  # noqa: B020
                state,
                iterations=max(_BLOCK, len(kept) // 5),
                store=False,
                skip_initial_state_check=True,
            ):
                kept.append(state.coords.copy())
                kept_log.append(state.log_prob.copy())
                if interrupted:
                    raise KeyboardInterrupt
            if bold and move.acceptance < _TOO_FEW:
                # The posterior is not what the fit foresaw. What was sampled so far was on the way.
                bold = False
                sampler = sampler_with(_WARY, sampler.random_state)
                kept.clear()
                kept_log.clear()
                continue
            diagnosis = _diagnose(np.stack(kept), ENSEMBLES)
            if progress is not None:
                progress(diagnosis.least_effective, len(kept), diagnosis.worst_r_hat)
            if diagnosis.good(effective):
                ended = "converged"
                break
            if len(kept) >= most_steps:
                ended = f"not converged after {len(kept)} steps"
                break
    except KeyboardInterrupt:
        if len(kept) < 4:
            raise
        diagnosis = _diagnose(np.stack(kept), ENSEMBLES)
    values = np.stack(kept)
    accepted = np.any(np.diff(values, axis=0) != 0, axis=2).sum(0)
    full = whole(values.reshape(-1, dimension)).reshape(*values.shape[:2], -1) + offset
    chain = Chain(
        names=parameters.names,
        values=full,
        log_posterior=np.stack(kept_log),
        accepted=accepted,
        discarded=diagnosis.discarded,
        ensembles=ENSEMBLES,
        seed=seed,
    )
    posterior = _summary(fit, chain, parameters.names_where(free), diagnosis, ended, effective)
    if not bold:
        wary = (
            "; it is not of the shape that the fit foresaw, so ensemble moves did most of the work"
        )
        posterior = replace(posterior, status=posterior.status + wary)
    return fit.with_posterior(posterior), chain


def _ridge_move(fit: FitResult, offset: Floats) -> RidgeMove:
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
    raise UnusableFitError("no place of finite posterior was found near the fit")


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


def _diagnose(values: Floats, ensembles: int) -> _Diagnosis:
    """Autocorrelation time, effective samples and R-hat of values (steps, walkers, parameters)."""
    steps, walkers, dimension = values.shape
    discarded = min(max(_BLOCK // 2, steps // 10), steps // 2)
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


def _summary(
    fit: FitResult,
    chain: Chain,
    names: list[str],
    diagnosis: _Diagnosis,
    ended: str,
    effective: float,
) -> Posterior:
    quantities = {name: chain.of({name: 1.0}) for name in names}
    correlation = np.atleast_2d(np.corrcoef(np.stack(list(quantities.values()))))
    quantities |= {item.expression: chain.of(item.weights) for item in fit.combinations}
    levels = [float(level) / 100 for level in _QUANTILES]
    steps, walkers, _ = chain.values.shape
    good = diagnosis.good(effective)
    status = ended
    if ended != "converged":
        status += (
            f": {diagnosis.least_effective:.0f} effective samples of {effective:.0f} wanted, "
            f"R-hat {diagnosis.worst_r_hat:.3f}"
        )
    return Posterior(
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
        converged=good,
        status=status,
    )
