"""The optimum of one throw, of many, or of several with common parameters,
within bounds.

One compiled program of optimistix serves all. It solves a batch of problems side by
side, which costs far less than one after another. The solves of a batch end together;
those that take many steps are therefore interrupted and grouped anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from numpy.typing import NDArray

from curlfit.inference.information.bounds import Bounded
from curlfit.inference.model.likelihood import weighted_residuals
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.batches import (
    BATCH,
    at,
    in_batches,
    is_worth_optimizing,
    over_stack,
    stacked,
    unstacked,
)
from curlfit.numerics.compiled import compiled

Indices = NDArray[np.intp]
Stacks = tuple[Any, Any, Any, Penalty, Problem]
"""Initial values, bounds, priors and problems, along the first axis."""

MOST_STEPS = 200
_FIRST_STEPS = 12  # of many problems, until those that are not done are grouped anew
_ROUNDING = 1e-9  # share of chi squared by which one optimum is not better than another


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
    """fields of shape (problems, ...), or (problems, throws, ...) with parameters in
    common"""
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
        tasks = [
            cls(
                problem,
                start,
                parameters.lower,
                parameters.upper,
                parameters.typical,
                parameters.penalty,
            )
            for parameters, problem, start in throws
        ]
        return stacked(tasks)._replace(typical=tasks[0].typical)

    def at(self, which: Indices) -> Tasks:
        """Some of the problems."""
        stacks = self.problems, self.start, self.lower, self.upper, self.penalty
        problems, start, lower, upper, penalty = at(stacks, as_slice(which))
        return Tasks(problems, start, lower, upper, self.typical, penalty, self.common)

    @property
    def free(self) -> Booleans:
        """Which parameters are not fixed, of the shape of `start`."""
        return Bounded(self.start, self.lower, self.upper).free

    @property
    def throws_per_problem(self) -> int:
        """Of one problem: more than one where they have parameters in common."""
        return 1 if self.common is None else self.problems.observed.shape[1]

    @property
    def _loss(self) -> int | None:
        """Place of the loss of all problems; None if they differ, as those do of which
        some are still fitted without it."""
        place, *other_places = np.unique(self.problems.loss).tolist()
        return None if other_places else place

    def arguments(self, model: Model, control: Control) -> ProgramArguments:
        """Of the programs that solve them."""
        penalty = self.penalty
        typical = self.typical
        common = self.common
        if model.family is not None:
            pad = partial(model.family.padded, model.law)
            penalty = jax.tree.map(pad, penalty)
            typical = pad(typical, 1.0)
            if common is not None:
                common = pad(common.astype(float), 1.0) > 0
        blocks = Blocks.of(np.ones(len(typical), bool))
        if common is not None:
            blocks = Blocks.of(common, self.throws_per_problem)
        stacks = (
            model.vector(self.start),
            model.vector(self.lower),
            model.vector(self.upper),
            penalty,
            self.problems,
        )
        return ProgramArguments(
            model.of_program, self._loss, stacks, typical, blocks, control
        )


class ProgramArguments(NamedTuple):
    """What the compiled programs are called with, in the order of `_solutions`."""

    model: Model
    loss: int | None
    """place among `LOSSES`; None if the problems have several"""
    stacks: Stacks
    """initial values, bounds, priors and problems, along the first axis"""
    typical: Floats
    blocks: Blocks
    """of the parameters in common and of those of each throw"""
    control: Control


def _solutions(
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

    def residual_of_throw(values: Array, problem: Problem) -> Array:
        if loss is not None:
            problem = problem._replace(loss=loss)
        return weighted_residuals(model, values, problem)

    def residual(values: Array, problem: Problem) -> Array:
        if problem.observed.ndim > 2:  # throws with parameters in common
            return jax.vmap(residual_of_throw)(values[blocks.index], problem)
        return residual_of_throw(values, problem)

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
        ended: Any = optx.least_squares(
            residual, solver, start, problem, max_steps=None, throw=False
        )
        state = ended.state
        return Solution(
            values=ended.value,
            residual=state.residual,
            jacobian=state.jacobian,
            steps=state.evaluations,
            success=state.success,
            penalty=penalty.chi_squared(ended.value),
        )

    solutions: Solution = over_stack(solved, *stacks)
    return solutions


_solve = compiled("model", "loss")(_solutions)
_solve_optimized = compiled("model", "loss", optimize=True)(_solutions)


def solve(
    model: Model, tasks: Tasks, how: Control = PRECISE, batch: int = 1
) -> Solution:
    """The optima of problems, a batch of them side by side."""
    program = _solve
    if is_worth_optimizing(batch * tasks.throws_per_problem):
        program = _solve_optimized
    arguments = tasks.arguments(model, how)
    solutions: Solution = in_batches(
        lambda *some: program(*arguments._replace(stacks=some)),
        arguments.stacks,
        batch,
    )
    if model.family is not None:
        size = tasks.start.shape[-1]
        of_throw = size if tasks.common is None else len(tasks.common)
        solutions = solutions._replace(
            values=solutions.values[:, model.columns(size)],
            jacobian=solutions.jacobian[..., model.columns(of_throw)],
        )
    return solutions


def _usual_control(batch: int) -> Control:
    """How the solves of a batch begin and end."""
    return PRECISE if batch == 1 else _QUICK


def prepare_minimize(
    model: Model, parameters: ParameterSet, problem: Problem, batch: int = 1
) -> None:
    """Begin to compile what `minimize_many` needs for problems like this one,
    alone or few."""
    tasks = Tasks.of([(parameters, problem, np.zeros(len(parameters)))] * batch)
    _solve.prepare(*tasks.arguments(model, _usual_control(batch)))


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
    count = len(tasks.start)
    first_steps = most if batch == 1 else min(_FIRST_STEPS, most)
    control = (how or _usual_control(batch))._replace(most=first_steps)
    tasks = tasks._replace(start=np.array(tasks.start))
    optima: Any = None
    due = np.arange(count)
    while len(due):
        is_interrupted = np.zeros(count, bool)
        for part in _of_one_loss(due, tasks.problems.loss, batch):
            reached = solve(model, tasks.at(part), control, batch)
            if optima is None:
                optima = jax.tree.map(
                    lambda leaf: np.zeros((count, *leaf.shape[1:]), leaf.dtype), reached
                )
            steps = optima.steps[part] + reached.steps
            is_interrupted[part] = (
                ~reached.success & (reached.steps >= control.most) & (steps < most)
            )
            for of_all, of_part in zip(
                optima, reached._replace(steps=steps), strict=True
            ):
                of_all[as_slice(part)] = of_part
            tasks.start[part] = reached.values
        due = np.flatnonzero(is_interrupted)
        control = control._replace(most=2 * control.most)
    solution: Solution = optima
    return solution


def is_lower(solution: Solution, other: Solution) -> bool:
    """Whether one optimum of a problem is better than another, beyond rounding."""
    return bool(solution.objective < (1 - _ROUNDING) * other.objective)


def minimize_from(
    model: Model, tasks: Tasks, starts: Mapping[int, Sequence[Floats]], batch: int
) -> dict[int, list[Solution]]:
    """What is reached from initial values of some of many problems, both by number of
    the problem; problems without initial values are left out."""
    rows = []
    values = []
    for row, starts_of_problem in starts.items():
        for start in starts_of_problem:
            rows.append(row)
            values.append(start)
    if not rows:
        return {}
    tasks = tasks.at(np.array(rows))._replace(start=np.array(values))
    solutions = minimize_many(model, tasks, batch)
    reached: dict[int, list[Solution]] = {}
    for row, solution in zip(rows, unstacked(solutions), strict=True):
        reached.setdefault(row, []).append(solution)
    return reached


def _of_one_loss(due: Indices, losses: Any, batch: int) -> Iterator[Indices]:
    """The problems that are due, as many at a time as are solved side by side, all of
    them with one loss: one program then serves them."""
    for loss in np.unique(losses[due]):
        alike = due[losses[due] == loss]
        yield from np.split(alike, range(batch, len(alike), batch))


def as_slice(indices: Indices) -> Indices | slice:
    """Indices; as a slice where they are contiguous, which avoids a copy."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(indices[0], indices[-1] + 1)
    return indices
