"""The optimum of one throw, of many, or of several with common parameters,
within bounds.

One compiled program of optimistix serves all. It solves a batch of problems side by
side, which costs far less than one after another. The solves of a batch end together;
those that take many steps are therefore interrupted and grouped anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from numpy.typing import NDArray

from curlfit.friction import Law
from curlfit.inference.information.directions import inverted
from curlfit.inference.initial_values import SmoothPath, default_guess
from curlfit.inference.likelihood import weighted_residuals
from curlfit.inference.model import Model
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.batches import BATCH, in_batches, stacked, unstacked
from curlfit.numerics.compiled import compiled

Indices = NDArray[np.intp]
Stacks = tuple[Any, Any, Any, Penalty, Problem]
"""Initial values, bounds, priors and problems, along the first axis."""

MOST_STEPS = 200
_FIRST_STEPS = 12  # of many problems, until those that are not done are grouped anew
# length of a column, over the longest, below which it is rounding error
_NOTHING = 1e-7
_ROUNDING = 1e-12  # eigenvalue, with columns of length 1, that may be rounding error
_SAME_START = 1e-3  # typical sizes within which initial values are the same
_FACTORS = 1.0, 0.3, 3.0  # on the usual coefficients, for other initial values
_EQUAL = 4.0  # chi squared within which optima fit equally: two standard deviations ...
_APART = 9.0  # ... if the linearized problem expects this much of their distance
_POOR = (3.0, 0.02)  # rms over that of a polynomial, and over the range, of a poor fit


class Control(NamedTuple):
    """How a solve begins, and when it has converged."""

    damping: float
    """of the first step, relative to the squared columns: the larger, the
    more cautious"""
    extrapolated: float
    """share of chi squared that the last step, which is not evaluated, may gain"""
    remaining: float
    """share of chi squared that the step after it might gain"""
    most: int = MOST_STEPS
    """evaluations"""


PRECISE = Control(1e-2, 1e-14, 1e-18)  # for one throw
_QUICK = Control(1e-4, 1e-8, 1e-10)  # for many: within 1e-5 standard errors
ALONG_RIDGE = Control(1e-4, 1e-5, 1e-5)
"""For points of a ridge: of 1,000 values, within 0.01 of chi squared."""


class Solution(NamedTuple):
    """An optimum; or many, along the first axis of each field.

    Residuals that are not finite mean that there was no path even at the
    initial values.
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


class Tasks(NamedTuple):
    """Problems of one shape, their initial values and bounds, along the first axis.

    A problem is a throw, or several throws along its first axis that have
    parameters in common.
    """

    problems: Problem
    start: Floats
    """shape (problems, parameters), as the next two"""
    lower: Floats
    upper: Floats
    typical: Floats
    """shape (parameters,)"""
    penalty: Penalty
    """each field of the shape of `start`"""
    common: Booleans | None = None
    """which parameters of a throw the others have in common with it; None
    with one throw"""

    @classmethod
    def of(cls, throws: Iterable[tuple[ParameterSet, Problem, Floats]]) -> Tasks:
        """Single throws: the parameters, the problem and the initial values of each."""
        each = [
            cls(problem, start, own.lower, own.upper, own.typical, own.penalty)
            for own, problem, start in throws
        ]
        return stacked(each)._replace(typical=each[0].typical)

    def at(self, which: Indices) -> Tasks:
        """Some of the problems."""
        problems, start, lower, upper, penalty = jax.tree.map(
            itemgetter(as_slice(which)),
            (self.problems, self.start, self.lower, self.upper, self.penalty),
        )
        return Tasks(problems, start, lower, upper, self.typical, penalty, self.common)

    @property
    def _loss(self) -> int | None:
        """Place of the loss of all problems; None if they differ, as those do of which
        some are still fitted without it."""
        place, *others = np.unique(self.problems.loss).tolist()
        return None if others else place

    def arguments(self, model: Model, control: Control) -> tuple[Any, ...]:
        """Of the programs that solve them."""
        penalty, typical = self.penalty, self.typical
        if model.family is not None:
            pad = partial(model.family.padded, model.law)
            penalty, typical = jax.tree.map(pad, penalty), pad(typical, 1.0)
        blocks = Blocks.of(np.ones(len(typical), bool))
        if (common := self.common) is not None:
            if model.family is not None:
                common = model.family.padded(model.law, common.astype(float), 1.0) > 0
            blocks = Blocks.of(common, self.problems.observed.shape[1])
        return (
            model.of_program,
            self._loss,
            (
                *map(model.vector, (self.start, self.lower, self.upper)),
                penalty,
                self.problems,
            ),
            typical,
            blocks,
            control,
        )


def _solve(
    model: Model,
    loss: int | None,
    stacks: Stacks,
    typical: Array,
    blocks: Blocks,
    control: Control,
) -> Solution:
    # Imported only to compile the program: it takes half as long to load as JAX.
    import optimistix as optx

    from curlfit.numerics import bounded_solver as bounded

    def residual(values: Array, problem: Problem) -> Array:
        def one(values: Array, problem: Problem) -> Array:
            if loss is not None:
                problem = problem._replace(loss=loss)
            return weighted_residuals(model, values, problem)

        together = problem.observed.ndim > 2
        return (
            jax.vmap(one)(values[blocks.index], problem)
            if together
            else one(values, problem)
        )

    def solved(
        start: Array, lower: Array, upper: Array, penalty: Penalty, problem: Problem
    ) -> Solution:
        solver = bounded.BoundedLeastSquares(
            descent=bounded.BoundedDescent(lower, upper, typical),
            search=bounded.GainRatio(control.damping),
            control=control,
            blocks=blocks,
            penalty=penalty,
        )
        found: Any = optx.least_squares(
            residual, solver, start, problem, max_steps=None, throw=False
        )
        priors = penalty.chi_squared(found.value)
        state = found.state
        return Solution(
            found.value,
            state.residual,
            state.jacobian,
            state.evaluations,
            state.success,
            priors,
        )

    if len(stacks[0]) > 1:
        return jax.vmap(solved)(*stacks)
    # Under vmap, both branches of each condition would be computed.
    alone = solved(*jax.tree.map(lambda leaf: leaf[0], stacks))
    found: Solution = jax.tree.map(lambda leaf: leaf[None], alone)
    return found


_solve_once = compiled("model", "loss")(_solve)
_solve_often = compiled("model", "loss", optimize=True)(_solve)


def solve(
    model: Model,
    tasks: Tasks,
    how: Control = PRECISE,
    batch: int = 1,
    *,
    once: bool = True,
) -> Solution:
    """The optima of problems, a batch of them side by side.

    Parameters
    ----------
    once : whether a program compiled quickly is better than a fast one.
    """
    program = _solve_once if once else _solve_often
    law, loss, stacks, *common = tasks.arguments(model, how)
    found: Solution = in_batches(
        lambda *some: program(law, loss, some, *common), stacks, batch
    )
    if model.family is not None:
        size = tasks.start.shape[-1]
        of_throw = size if tasks.common is None else len(tasks.common)
        found = found._replace(
            values=found.values[:, model.columns(size)],
            jacobian=found.jacobian[..., model.columns(of_throw)],
        )
    return found


def prepare_minimize(
    model: Model, parameters: ParameterSet, problem: Problem, batch: int = 1
) -> None:
    """Begin to compile what `minimize_many` needs for problems like this one,
    alone or few."""
    control = PRECISE if batch == 1 else _QUICK
    tasks = Tasks.of([(parameters, problem, np.zeros(len(parameters)))] * batch)
    _solve_once.prepare(*tasks.arguments(model, control))


def minimize_many(
    model: Model,
    tasks: Tasks,
    batch: int = BATCH,
    most: int = MOST_STEPS,
    how: Control | None = None,
) -> Solution:
    """The optima of many problems.

    Parameters
    ----------
    batch : `BATCH`, `FEW`, or 1 to solve one after another, more precisely.
    most : steps after which a solve ends.
    how : how a solve begins and ends, by default as the number of problems demands.
    """
    count, loss = len(tasks.start), tasks.problems.loss
    control = (how or PRECISE)._replace(most=most)
    if batch > 1:
        control = (how or _QUICK)._replace(most=min(_FIRST_STEPS, most))
    tasks = tasks._replace(start=np.array(tasks.start))
    due, interrupted = np.arange(count), np.zeros(count, bool)
    whole: Any = None
    while len(due):
        now = due[loss[due] == loss[due[0]]][:batch]
        found = solve(model, tasks.at(now), control, batch, once=batch < BATCH)
        if whole is None:
            whole = jax.tree.map(
                lambda leaf: np.zeros((count, *leaf.shape[1:]), leaf.dtype), found
            )
        steps = whole.steps[now] + found.steps
        for leaf, new in zip(whole, found._replace(steps=steps), strict=True):
            leaf[as_slice(now)] = new
        tasks.start[now] = found.values
        interrupted[now] = (
            ~found.success & (found.steps >= control.most) & (steps < most)
        )
        due = np.setdiff1d(due, now)
        if not len(due):
            due, control = (
                np.flatnonzero(interrupted),
                control._replace(most=2 * control.most),
            )
            interrupted[:] = False
    solution: Solution = whole
    return solution


def optima(
    model: Model, tasks: Tasks, starts: Sequence[Sequence[Floats]], batch: int
) -> list[list[Solution]]:
    """Of each problem, what is reached from each of its initial values."""
    owner = np.repeat(np.arange(len(starts)), [*map(len, starts)])
    found: list[list[Solution]] = [[] for _ in starts]
    if len(owner):
        some = tasks.at(owner)._replace(
            start=np.concatenate([one for one in starts if one])
        )
        each = unstacked(minimize_many(model, some, batch))
        for place, one in zip(owner, each, strict=True):
            found[place].append(one)
    return found


def best_first(solutions: Iterable[Solution]) -> list[Solution]:
    """The optima of a problem whose chi squared is finite, the first of the best
    before others."""
    found: list[Solution] = []
    for one in solutions:
        if np.isfinite(one.chi_squared):
            better = bool(found) and one.objective < (1 - 1e-9) * found[0].objective
            found.insert(0 if better else len(found), one)
    return found


def starts_to_try(
    law: type[Law], sides: Floats, bounds: tuple[Floats, Floats], typical: Floats
) -> tuple[list[Floats], list[Floats]]:
    """Initial values of which all are to be tried, since they may fit
    equally, and others.

    `sides` are those of a throw, from `start_values_of_sides`.
    """
    apart: list[Floats] = []
    for one in sides:
        if all((np.abs(one - other) > _SAME_START * typical).any() for other in apart):
            apart.append(one)
    defaults = np.array([default_guess(item) for item in law.coefficients()])
    others = np.array([apart[0]] * len(_FACTORS))
    others[:, : len(defaults)] = np.outer(_FACTORS, defaults)
    return apart, [*np.clip(others, *bounds)]


def fits_equally(best: Solution, other: Solution) -> Booleans:
    """Whether other optima of the same problems fit as well as the best, within
    two standard deviations of the noise, though to first order about the best
    they should not."""
    best, other = (jax.tree.map(np.asarray, one) for one in (best, other))
    count = np.maximum((best.jacobian != 0).any(-1).sum((-1, -2)), 1)
    noise = best.objective / count
    move = best.jacobian @ (other.values - best.values)[..., None, :, None]
    expected = (move**2).sum((-1, -2, -3))
    worse = other.objective - best.objective
    return other.success & (worse < _EQUAL * noise) & (expected > _APART * noise)


def needs_restart(
    solutions: Solution, paths: SmoothPath, problems: Problem
) -> Booleans:
    """Which of many optima are so poor that other initial values are worth trying."""
    observed, weight = problems.observed[:, :3], problems.weight[:, :3]
    there = weight > 0
    n = there.sum(-1)
    residual = solutions.residual[:, :3] / np.where(there, weight, np.inf)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(n, 1))
    highest = np.where(there, observed, -np.inf).max(-1)
    lowest = np.where(there, observed, np.inf).min(-1)
    over_polynomial, over_range = _POOR
    off = (rms > over_polynomial * paths.rms[:, :3]) & (
        rms > over_range * (highest - lowest)
    )
    ended = solutions.success & np.isfinite(solutions.chi_squared)
    return ~np.asarray(ended) | (off & (n >= 3)).any(-1)


def residual_sigma(
    solutions: Solution, problems: Problem, free: Booleans
) -> NDArray[np.float64]:
    """sqrt(sum of squares/(n - p)) by channel of many throws; p is a channel's share
    of parameters.

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


def as_slice(indices: Indices) -> Indices | slice:
    """Indices; as a slice where they are contiguous, which avoids a copy."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(indices[0], indices[-1] + 1)
    return indices
