"""Initial values with the rest of the stone in other rows of a measured spin.

A law whose spin ends with a jump passes from a moving stone to a resting one within the
interval of one row (`curlfit.inference.model.spin_at_rest`). Of measured spins that
fall to zero over many rows, it may meet any one within the jump, so that chi squared
may have a minimum with the rest in each of these rows. From one of them, the others are
reached by values whose rest is some rows earlier or later, and which change the rest of
the residuals least.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from curlfit.friction import NetLaw
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import Problem
from curlfit.inference.model.system import System, motions
from curlfit.inference.solve.least_squares import Solution, Tasks, minimize_from
from curlfit.losses import loss_at
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import at
from curlfit.throws.channels import CHANNELS

MOST_REST_SEARCHES = 20  # each of which moves the rest by up to eight rows
_ROWS = np.array([-8, -4, -2, -1, 1, 2, 4, 8])  # by which the rest is moved
# Jump of the spin over its sigma. Between two rows chi squared rises by at most the
# square of half the jump: here by 1/16, which is no obstacle to a search.
_SMALL_JUMP = 0.5
_ABOUT_REST = 1.5  # intervals, within which measured spins do not hold the rest
_STEP = 1e-4  # of differences, over the typical size
# Share of the information that is added along every direction, lest the values go far
# along one that the data leave open: with 1e-10 the rest moved by 8 s in place of 0.8 s
# (fcv1 on a log of a simulator), with 1e-8 to 1e-4 it moves as it should.
_LEVEL = 1e-6


def optima_with_other_rests(
    stack: ThrowStack, tasks: Tasks, optima: Mapping[int, Solution]
) -> dict[int, list[Solution]]:
    """What is reached from optima of throws, by row, with the rest of the stone in
    other rows of a measured spin. Under a robust loss, and with correlated noise, the
    rest stays in the row where least squares have found it."""
    model = stack.model
    problems = tasks.problems
    if problems.spins is None or not issubclass(model.law, NetLaw):
        return {}
    starts = {}
    for row, optimum in optima.items():
        is_robust = loss_at(problems.loss[row]).is_robust
        if not is_robust and not stack.noises[row].sizes:
            starts[row] = starts_with_other_rests(
                model,
                optimum,
                at(problems, row),
                tasks.lower[row],
                tasks.upper[row],
                tasks.typical,
            )
    return minimize_from(model, tasks, starts, stack.batch)


def starts_with_other_rests(
    model: Model,
    optimum: Solution,
    problem: Problem,
    lower: Floats,
    upper: Floats,
    typical: Floats,
) -> list[Floats]:
    """Initial values near an optimum, with the rest in other rows; none where the spin
    was not measured to rest, or ends there without a jump.

    The law is one of the whole stone, the problem has spins, and its optimum is that
    of least squares with independent noise.
    """
    assert problem.spins is not None
    interval = float(problem.spins.interval)
    if interval == 0:
        return []
    values = np.asarray(optimum.values)
    movable = (lower < values) & (values < upper)
    rest, slopes = _rest_and_slopes(model, values, problem, typical * movable)
    spin = CHANNELS.index("omega")
    measured = problem.weight[spin] > 0
    moving = np.flatnonzero(measured & (problem.times < rest - interval / 2))
    farthest = problem.times[measured].max() + interval * _ROWS.max()
    if not (len(moving) and rest < farthest):
        return []
    row = moving[-1]
    weight = problem.weight[spin, row]
    jump = problem.observed[spin, row] + optimum.residual[spin, row] / weight
    if abs(jump) * weight < _SMALL_JUMP:
        return []
    rows = np.asarray(optimum.jacobian) * (typical * movable)
    near = np.abs(problem.times - rest) < _ABOUT_REST * interval
    rows[spin, near] = 0.0
    rows = rows.reshape(-1, len(values))
    information = rows.T @ rows
    information += _LEVEL * np.trace(information) * np.eye(len(values))
    # The change of the values, in typical sizes, that moves the rest by 1 s and the
    # residuals least.
    direction = np.linalg.solve(information, slopes)
    effect = slopes @ direction
    if not effect > 0:
        return []
    change = typical * movable * direction / effect
    return [
        np.clip(values + count * interval * change, lower, upper) for count in _ROWS
    ]


def _rest_and_slopes(
    model: Model, values: Floats, problem: Problem, steps: Floats
) -> tuple[float, Floats]:
    """Time of rest on the clock of the data, s, and its derivatives by the values over
    `steps`, by central differences."""
    change = _STEP * np.diag(steps)
    vectors = np.concatenate([values[None], values + change, values - change])
    stone = problem.stone
    environment = problem.environment
    clock = np.array(
        [System.of(model, vector, stone, environment).time_scale for vector in vectors]
    )
    _, rests = motions(model, vectors, stone, environment, np.array([np.inf]))
    unchanged, above, below = np.split(clock * rests, [1, 1 + len(values)])
    return float(unchanged[0]), (above - below) / (2 * _STEP)
