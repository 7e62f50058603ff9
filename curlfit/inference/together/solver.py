"""The optimum of several throws that have parameters in common.

The normal matrix has the shape of an arrow (`curlfit.numerics.arrow_matrix`): each
throw depends on the common parameters and its own only, so that time and memory grow in
proportion to the throws.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np

from curlfit.inference.model.model import Model
from curlfit.inference.model.priors import Penalty
from curlfit.inference.solve.least_squares import Control, Solution, Tasks, solve
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.batches import at, stacked

Progress = Callable[[int, float], None]

# throws are computed in multiples of this many, so that few shapes are compiled
_TOGETHER = 4
JOINT = Control(1e-3, 1e-12, 1e-16)
BEFORE_VARIATION = Control(1e-3, 1e-7, 1e-9)
"""Where equal coefficients are no more than a point about which throws that vary are
linearised: half of the steps. Of four evenings nothing that is told moved by more than
1e-7 standard errors."""


def minimize_jointly(
    model: Model,
    throws: Tasks,
    common: Booleans,
    progress: Progress | None = None,
    how: Control = JOINT,
) -> Solution:
    """The optimum of throws together, each along the first axis of the fields.

    Parameters
    ----------
    throws : as for fits of each alone; equal bounds and priors of what they
        have in common.
    common : which parameters these are, shape (parameters of a throw,).
    progress : called at the end with the number of steps, chi squared and that
        of the priors.
    """
    count = len(throws.start)
    # Throws of no weight, whose parameters are fixed, make it a multiple
    # of `_TOGETHER`.
    every = np.minimum(np.arange(count + -count % _TOGETHER), count - 1)
    padded = jax.tree.map(np.array, throws.at(every))
    padded.problems.weight[count:] = 0.0
    for end in (padded.lower, padded.upper):
        end[count:, ~common] = padded.start[count:, ~common]

    def joined(values: Floats) -> Floats:
        return np.concatenate([values[0, common], values[:, ~common].ravel()])

    padded.start[:, common] = throws.start[:, common].mean(0)
    typical = joined(np.broadcast_to(throws.typical, padded.start.shape))
    padded.penalty.weight[count:] = 0.0
    penalty = Penalty(*map(joined, padded.penalty))
    task = Tasks(
        padded.problems,
        joined(padded.start),
        joined(padded.lower),
        joined(padded.upper),
        typical,
        penalty,
    )
    batch = stacked([task])
    batch = batch._replace(typical=typical, common=common)
    optimum: Solution = at(solve(model, batch, how), 0)
    values = optimum.values[Blocks.of(common, count).index]
    if progress is not None:
        progress(int(optimum.steps), float(optimum.chi_squared.sum() + optimum.penalty))
    return Solution(
        values,
        optimum.residual[:count],
        optimum.jacobian[:count],
        np.full(count, optimum.steps),
        np.full(count, optimum.success),
        throws.penalty.chi_squared(values),
    )
