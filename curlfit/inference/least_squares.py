"""The optimum of one throw or of many, by the Levenberg-Marquardt method within bounds.

One throw is fitted by a single program of optimistix; many go through the same `advance` side by
side: each pass evaluates the residuals and Jacobians of a batch of unfinished throws, which costs
far less than one throw after another. A finished throw leaves the batch and the next takes its
place, so that none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from numpy.typing import NDArray

from curlfit.inference.identifiability import inverted
from curlfit.inference.initial_values import SmoothPath, default_guess, start_values_of_sides
from curlfit.inference.likelihood import linearize, linearize_once, weighted_residuals
from curlfit.inference.model import Model
from curlfit.inference.noise.models import LOSSES
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics import levenberg_marquardt as lm
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import BATCH, in_batches, stacked
from curlfit.numerics.compiled import compiled

Indices = NDArray[np.intp]

_PRECISE = lm.Control(1e-2, 1e-14, 1e-18)  # for one throw
_QUICK = lm.Control(1e-4, 1e-8, 1e-10)  # for many: within 1e-5 standard errors
_FEW = 16  # problems in a batch
_NOTHING = 1e-7  # length of a column, over the longest, below which it is rounding error
_ROUNDING = 1e-12  # eigenvalue, with columns of length 1, that may be rounding error
_SAME_START = 1e-3  # typical sizes within which initial values are the same
_EQUAL = 4.0  # chi squared within which optima fit equally: two standard deviations ...
_APART = 9.0  # ... if the linearized problem expects this much of their distance
_POOR = (3.0, 0.02)  # rms over that of a polynomial, and over the range, of a poor fit


class Solution(NamedTuple):
    """An optimum, in the coordinates of its problem; or many, along the first axis of each field.

    Residuals that are not finite mean that there was no path even at the initial values.
    """

    values: Any
    residual: Any
    """weighted, shape (channels, n)"""
    jacobian: Any
    """of the weighted residual by parameter, shape (channels, n, parameters)"""
    steps: Any
    success: Any
    penalty: Any = 0.0
    """the priors' part of the objective"""

    @property
    def chi_squared(self) -> Any:
        """Sum of the squared residuals."""
        return (self.residual**2).sum((-1, -2))

    @property
    def objective(self) -> Any:
        """What the optimum minimizes: chi squared of the data and of the priors."""
        return self.chi_squared + self.penalty


@compiled("model", "loss")
def _minimize(
    model: Model, loss: str, start: Array, lower: Array, upper: Array, typical: Array,
    problem: Problem, penalty: Penalty | None,
) -> Solution:  # fmt: skip
    # Imported only to compile the program: it takes as long to load as everything else together.
    import optimistix as optx

    from curlfit.numerics.bounded_solver import BoundedLevenbergMarquardt

    def residual(values: Array, problem: Problem) -> Array:
        return weighted_residuals(model, values, problem._replace(loss=LOSSES.index(loss)))

    found: Any = optx.least_squares(
        residual,
        BoundedLevenbergMarquardt(lm.Bounds(lower, upper, typical), _PRECISE, penalty),
        start,
        args=problem,
        max_steps=lm.MOST_EVALUATIONS,
        throw=False,
    )
    shape = problem.observed.shape
    return Solution(
        values=found.value,
        residual=found.state.residual.reshape(shape),
        jacobian=found.state.jacobian.reshape(*shape, -1),
        steps=found.stats["num_steps"],
        success=found.result == optx.RESULTS.successful,
        penalty=0.0 if penalty is None else penalty.chi_squared(found.value),
    )


def prepare_minimize(model: Model, parameters: ParameterSet, problem: Problem) -> None:
    """Begin to compile what `minimize` needs."""
    _minimize.prepare(*_arguments(model, np.zeros(len(parameters)), parameters, problem))


def prepare_minimize_few(model: Model, parameters: ParameterSet, problem: Problem) -> None:
    """Begin to compile what `minimize_many` needs for few problems like this one."""
    linearize_once.prepare(model, np.zeros((_FEW, len(parameters))), stacked([problem] * _FEW))


def _arguments(
    model: Model, start: Floats, parameters: ParameterSet, problem: Problem
) -> tuple[Any, ...]:
    penalty, typical = parameters.penalty, parameters.typical
    if model.family is not None:
        pad = partial(model.family.padded, model.law)
        penalty, typical = jax.tree.map(pad, penalty), pad(typical, 1.0)
    bounded = map(model.vector, (start, parameters.lower, parameters.upper))
    return (
        model.of_program, LOSSES[int(problem.loss)], *bounded, typical,
        problem._replace(loss=None), penalty,
    )  # fmt: skip


def minimize(
    model: Model, start: Floats, parameters: ParameterSet, problem: Problem
) -> Solution | None:
    """The optimum reached from one set of initial values; None if chi squared is not finite."""
    found = _minimize(*_arguments(model, start, parameters, problem))
    solution: Solution = jax.tree.map(np.asarray, found)
    if model.family is not None:
        own = model.columns(len(start))
        solution = solution._replace(
            values=solution.values[own], jacobian=solution.jacobian[..., own]
        )
    return solution if np.isfinite(solution.chi_squared) else None


def starts(
    model: Model, problem: Problem, path: SmoothPath, parameters: ParameterSet
) -> tuple[list[Floats], list[Floats]]:
    """Initial values of which all are to be tried, since they may fit equally, and others.

    `path` is that of this problem alone.
    """
    bounds = parameters.lower[None], parameters.upper[None]
    sides: list[Floats] = []
    for one in start_values_of_sides(model, stacked([problem]), path, *bounds, batch=1)[:, 0]:
        far = [np.abs(one - other) > _SAME_START * parameters.typical for other in sides]
        if all(apart.any() for apart in far):
            sides.append(one)
    others = []
    k = len(model.law.coefficients())
    defaults = np.array([default_guess(item) for item in model.law.coefficients()])
    for factor in (1.0, 0.3, 3.0):
        values = sides[0].copy()
        values[:k] = defaults * factor
        others.append(np.clip(values, parameters.lower, parameters.upper))
    return sides, others


def multistart(
    model: Model,
    sides: list[Floats],
    others: list[Floats],
    parameters: ParameterSet,
    problem: Problem,
    path: SmoothPath,
) -> tuple[list[Solution], int]:
    """Optima, the best one first, and the number of initial values tried: all `sides`, and the
    others where no optimum is good."""
    found: list[Solution] = []
    tried = 0
    for values in (*sides, *others):
        # If the first optimum is poor, all are tried: a later one may be local and look good.
        one = stacked(found[:1]) if found and tried == len(sides) else None
        if one is not None and not needs_restart(one, path, stacked([problem]))[0]:
            break
        tried += 1
        other = minimize(model, values, parameters, problem)
        if other is not None:
            better = bool(found) and other.objective < (1 - 1e-9) * found[0].objective
            found.insert(0 if better else len(found), other)
    return found, tried


def fits_equally(best: Solution, other: Solution) -> Booleans:
    """Whether other optima of the same problems fit as well as the best, within two standard
    deviations of the noise, though to first order about the best they should not."""
    best, other = (jax.tree.map(np.asarray, one) for one in (best, other))
    count = np.maximum((best.jacobian != 0).any(-1).sum((-1, -2)), 1)
    noise = best.objective / count
    move = best.jacobian @ (other.values - best.values)[..., None, :, None]
    expected = (move**2).sum((-1, -2, -3))
    worse = other.objective - best.objective
    return other.success & (worse < _EQUAL * noise) & (expected > _APART * noise)


def needs_restart(solutions: Solution, paths: SmoothPath, problems: Problem) -> Booleans:
    """Which of many optima are so poor that other initial values are worth trying."""
    observed, weight = problems.observed[:, :3], problems.weight[:, :3]
    there = weight > 0
    n = there.sum(-1)
    residual = solutions.residual[:, :3] / np.where(there, weight, np.inf)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(n, 1))
    highest = np.where(there, observed, -np.inf).max(-1)
    lowest = np.where(there, observed, np.inf).min(-1)
    over_polynomial, over_range = _POOR
    off = (rms > over_polynomial * paths.rms[:, :3]) & (rms > over_range * (highest - lowest))
    return ~np.asarray(solutions.success) | (off & (n >= 3)).any(-1)


def residual_sigma(solutions: Solution, problems: Problem, free: Booleans) -> NDArray[np.float64]:
    """sqrt(sum of squares/(n - p)) by channel of many throws; p is a channel's share of parameters.

    Parameters
    ----------
    free : which parameters were fitted, shape (throws, parameters).

    Returns
    -------
    In the channels' units, shape (throws, channels); 0 where nothing was observed.
    """
    jacobian = np.asarray(solutions.jacobian)
    normal = jacobian.mT @ jacobian * (free[:, None, :, None] & free[:, None, None, :])
    whole = normal.sum(1)
    size = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
    scale = inverted(size, size > _NOTHING * size.max(1, initial=0.0)[:, None])
    squares, axes = np.linalg.eigh(whole * scale[:, None] * scale[..., None])
    axes = axes * scale[..., None]
    inverse = axes * inverted(squares, squares > _ROUNDING)[:, None] @ axes.mT
    paid = (normal * inverse[:, None]).sum((-1, -2))
    dof = np.maximum((problems.weight > 0).sum(-1) - paid, 1.0)
    largest = problems.weight.max(-1)
    rms = np.sqrt((solutions.residual**2).sum(-1) / dof)
    return np.where(largest > 0, rms / np.where(largest > 0, largest, 1.0), 0.0)


class Tasks(NamedTuple):
    """Problems of one shape, their initial values and bounds; throws along the first axis."""

    problems: Problem
    start: Floats
    """shape (throws, parameters), as the next two"""
    lower: Floats
    upper: Floats
    typical: Floats
    """shape (parameters,)"""
    penalty: Penalty | None = None
    """each field of the shape of `start`"""
    revised_penalty: Penalty | None = None
    """the penalty once a problem is revised; needed where there is a penalty and a revision"""


class Revision(NamedTuple):
    """Throws to be fitted again, with other weights or another noise model."""

    throws: Indices
    problems: Problem
    """their new problems, along the first axis"""
    scale: Floats | None
    """new over old weights, shape (throws, channels, n), where nothing else has changed"""


Revise = Callable[[Indices, Solution], list[Revision]]
"""Revisions from throws that are done and their optima."""


def minimize_many(
    model: Model,
    tasks: Tasks,
    revise: Revise | None = None,
    progress: Callable[[int], None] | None = None,
    *,
    few: bool = False,
) -> Solution:
    """The optima of many problems.

    Parameters
    ----------
    revise : returns which of the throws that are done to fit again, and how.
    progress : called with the number of throws that need no further fit.
    few : whether throws are so few that a program compiled quickly is better than a fast one.
    """
    program, batch = (linearize_once, _FEW) if few else (linearize, BATCH)
    searches = _Searches(tasks)
    going = np.ones(len(tasks.start), bool)
    while going.any():
        now = np.flatnonzero(going)[:batch]
        trial, problems = searches.trials(now)
        found = in_batches(partial(program, model), (trial, problems), batch)
        done = now[searches.advance(now, *found)]
        while revise is not None and len(done):
            going[done] = False
            revisions = revise(done, searches.solution(done))
            again = [revision.throws[searches.revise(revision)] for revision in revisions]
            for revision in revisions:
                going[revision.throws] = True
            done = np.sort(np.concatenate(again)) if again else done[:0]
        going[done] = False
        if progress is not None:
            progress(int((~going).sum()))
    return searches.solution(np.arange(len(going)))


def best_of_sides(model: Model, tasks: Tasks, sides: Floats) -> dict[int, Floats]:
    """Set the initial values of each of many throws to the best optimum of those that may fit
    equally, and return other optima that do, by throw.

    `sides` is what `start_values_of_sides` returns; the first are replaced by those of the tasks.
    """
    apart = np.abs(sides - sides[:1]) > _SAME_START * tasks.typical
    throws = np.flatnonzero(apart.any((0, 2)))
    if not len(throws):
        return {}
    some: Tasks = tasks._replace(
        **{
            name: jax.tree.map(itemgetter(throws), getattr(tasks, name))
            for name in ("problems", "start", "lower", "upper", "penalty")
        }
    )
    found = [
        minimize_many(model, some._replace(start=start))
        for start in (some.start, *sides[1:, throws])
    ]
    objective = np.array([np.where(one.success, one.objective, np.inf) for one in found])
    better = objective.min(0) < (1 - 1e-9) * objective[0]
    place = np.where(better, objective.argmin(0), 0), np.arange(len(throws))
    best = jax.tree.map(lambda *parts: np.stack(parts)[place], *found)
    tasks.start[throws] = best.values
    rivals: dict[int, Floats] = {}
    for one in found:
        for row in np.flatnonzero(fits_equally(best, one)):
            rivals.setdefault(int(throws[row]), one.values[row])
    return rivals


def as_slice(indices: Indices) -> Indices | slice:
    """Increasing indices; as a slice where they are contiguous, which avoids a copy."""
    if len(indices) and indices[-1] - indices[0] == len(indices) - 1:
        return slice(indices[0], indices[-1] + 1)
    return indices


class _Searches:
    """Searches side by side, with residuals and Jacobians at their best values."""

    def __init__(self, tasks: Tasks) -> None:
        self.problems: Problem = jax.tree.map(np.array, tasks.problems)
        self.bounds = lm.Bounds(tasks.lower, tasks.upper, tasks.typical)
        self.penalty: Penalty | None = jax.tree.map(np.array, tasks.penalty)
        self.revised_penalty = tasks.revised_penalty
        self.state = lm.begin(tasks.start, self.bounds, _QUICK)
        shape = self.problems.observed.shape
        self.residual = np.full(shape, np.nan)
        self.jacobian = np.full((*shape, len(tasks.typical)), np.nan)

    def trials(self, now: Indices) -> tuple[Floats, Problem]:
        """Parameter vectors to evaluate, and their problems."""
        return self.state.trial[now], jax.tree.map(itemgetter(as_slice(now)), self.problems)

    def advance(self, now: Indices, residual: Floats, jacobian: Floats) -> Booleans:
        """Process the results of a pass; return which of the searches are done."""
        state, bounds = self._of(as_slice(now))
        with np.errstate(invalid="ignore", over="ignore"):  # where there is no path
            model = self._model(as_slice(now), state.trial, residual, jacobian)
            state, outcome = lm.advance(state, model, bounds, _QUICK)
        better = outcome.accepted
        if not better.all():
            residual, jacobian = residual[better], jacobian[better]
        throws = as_slice(now[better])
        self.residual[throws], self.jacobian[throws] = residual, jacobian
        return self._put(now, state, outcome)

    def revise(self, revision: Revision) -> Booleans:
        """Restart revised searches from their best values; return which are done immediately."""
        now, problems, scale = revision
        throws = as_slice(now)
        state, bounds = self._of(throws)
        if self.penalty is not None and self.revised_penalty is not None:
            for part, new in zip(self.penalty, self.revised_penalty, strict=True):
                part[throws] = new[throws]
        if scale is None:
            for leaf, new in zip(*map(jax.tree.leaves, (self.problems, problems)), strict=True):
                leaf[throws] = new
            return self._put(now, lm.begin(state.values, bounds, _QUICK), None)
        self.problems.weight[throws] = problems.weight
        self.residual[throws] *= scale
        self.jacobian[throws] *= scale[..., None]
        model = self._model(throws, state.values, self.residual[throws], self.jacobian[throws])
        return self._put(now, *lm.reweighted(state, model, bounds, _QUICK))

    def solution(self, which: Indices) -> Solution:
        """The best solutions so far; arrays may be views, valid until a search advances."""
        throws = as_slice(which)
        return Solution(
            self.state.values[throws], self.residual[throws], self.jacobian[throws],
            self.state.evaluations[throws], self.state.success[throws],
            self._penalty_chi_squared(throws),
        )  # fmt: skip

    def _of(self, throws: Indices | slice) -> tuple[lm.Search, lm.Bounds]:
        lower, upper, typical = self.bounds
        state: lm.Search = jax.tree.map(itemgetter(throws), self.state)
        return state, lm.Bounds(lower[throws], upper[throws], typical)

    def _penalty(self, throws: Indices | slice) -> Penalty | None:
        found: Penalty | None = jax.tree.map(itemgetter(throws), self.penalty)
        return found

    def _penalty_chi_squared(self, throws: Indices | slice) -> Floats:
        penalty, values = self._penalty(throws), self.state.values[throws]
        return np.zeros(len(values)) if penalty is None else penalty.chi_squared(values)

    def _model(
        self, throws: Indices | slice, values: Floats, residual: Floats, jacobian: Floats
    ) -> lm.QuadraticModel:
        count, channels, rows, size = jacobian.shape
        model = lm.quadratic_model(
            residual.reshape(count, channels * rows),
            jacobian.reshape(count, channels * rows, size),
            self.bounds.typical,
        )
        penalty = self._penalty(throws)
        if penalty is None:
            return model
        found: lm.QuadraticModel = penalty.added_to(model, values, self.bounds.typical)
        return found

    def _put(self, now: Indices, state: lm.Search, outcome: lm.Outcome | None) -> Booleans:
        throws = as_slice(now)
        for leaf, new in zip(*map(jax.tree.leaves, (self.state, state)), strict=True):
            leaf[throws] = new
        if outcome is not None and (last := outcome.extrapolation.any(1)).any():
            move = outcome.extrapolation[last][:, None, :, None]
            throws = as_slice(now[last])
            self.residual[throws] += (self.jacobian[throws] @ move)[..., 0]
        return np.asarray(state.done)
