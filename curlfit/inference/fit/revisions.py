"""What follows the first fit of throws: each further fit assumes the noise that the
residuals of the previous one show.

Where no sigma is given, a first fit weights the channels equally, 1 m like 1 rad. The
scatter of its residuals, corrected for the number of parameters, is the sigma of the
second fit (two-step generalised least squares). This is not iterated to convergence:
where a law is not exact, that ends with one channel fitted perfectly at the expense of
the others. Where a sigma is far below the others, further fits lead down to it. With a
robust loss, sigma is taken from the bulk of the residuals, repeatedly. Correlated
noise is estimated from the residuals of a fit with white noise, and a last fit
accounts for it.

Fits of one throw, of many side by side, and of several with common coefficients are
all revised here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.problems import bounds_of, linearized
from curlfit.inference.fit.residuals import residual_sigma
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.model.likelihood import (
    SIGMA_FLOOR,
    predict_many,
    whitened_residuals_of_many,
)
from curlfit.inference.model.problem import Problem
from curlfit.inference.noise.independence import time_of_motion
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.restricted import estimate
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.solve.least_squares import Indices, Solution
from curlfit.losses import place_of, robust_sigma
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import at
from curlfit.throws.channels import CHANNELS

_ROBUST_FITS = 4
"""Each with sigma from the bulk of the last."""
_TIGHTER = 0.1
"""Sigma of a channel over that of the fit before, at least."""


def revisions(
    stack: ThrowStack, throws: Indices, optima: Callable[[Indices], Solution]
) -> Iterator[Indices]:
    """Revises the problems of throws after each of their fits, in place, and gives the
    throws, by index, that are to be fitted again before it goes on.

    Parameters
    ----------
    throws : that have been fitted, by index.
    optima : gives the present optima of some of them, along the first axis.
    """
    unknown = throws[stack.unknown[throws].any(axis=1)]
    if len(unknown):
        estimated = reweighted(stack, unknown, optima(unknown))
        yield unknown
        while len(above := tightened(stack, unknown, estimated)):
            yield above
    if stack.loss.is_robust:
        with_robust_loss(stack, throws, optima(throws))
        yield throws
        if len(unknown):  # where every sigma is given, one fit with the loss is enough
            for _ in range(_ROBUST_FITS - 1):
                with_robust_loss(stack, unknown, optima(unknown))
                yield unknown
    if not stack.noises[0].is_white:
        with_correlated_noise(stack, throws, optima(throws))
        yield throws[~np.isin(throws, [*stack.failures])]


def reweighted(stack: ThrowStack, throws: Indices, optima: Solution) -> Floats:
    """Estimate sigmas from fits with equal weights, and weight the channels by these,
    or by as much of the way to them as one fit may go.

    Returns
    -------
    the estimates by throw and channel, 0 where a sigma is given.
    """
    unknown = stack.unknown[throws]
    sigma = residual_sigma(optima, stack.problems_of(throws), stack.free[throws])
    estimated = np.where(unknown, sigma + SIGMA_FLOOR, 0.0)
    largest = estimated.max(axis=1, keepdims=True)
    stack.sigma[throws] = np.where(unknown, largest, 0.0)
    _weight_toward(stack, throws, estimated)
    return estimated


def tightened(stack: ThrowStack, throws: Indices, estimated: Floats) -> Indices:
    """Weight the throws whose sigmas are still above those that were estimated for the
    next fit on the way, and give these throws.

    An angle has a kink at rest. If it is fitted almost exactly, chi squared has a
    wall where the stone comes to rest at the last row. Its slope is seen only from
    beyond the wall, where a weaker weight leads (the quadratic penalty method:
    Nocedal and Wright 2006, ch. 17.1).
    """
    is_above = (stack.sigma[throws] > estimated).any(axis=1)
    above = throws[is_above]
    _weight_toward(stack, above, estimated[is_above])
    return above


def _weight_toward(stack: ThrowStack, throws: Indices, estimated: Floats) -> None:
    """Weight the channels by sigmas that are estimated, but none more than ten times
    as tightly as before."""
    stack.sigma[throws] = np.maximum(estimated, _TIGHTER * stack.sigma[throws])
    stack.reweight(throws)


def with_robust_loss(stack: ThrowStack, throws: Indices, optima: Solution) -> None:
    """Take sigmas from the bulk of the residuals, and apply the robust loss."""
    problems = stack.problems_of(throws)
    residuals = whitened_residuals_of_many(
        stack.model, optima.values, problems, stack.batch
    )
    for throw, residual, weight in zip(throws, residuals, problems.weight, strict=True):
        for channel in np.flatnonzero(stack.unknown[throw]):
            bulk = robust_sigma(residual[channel, weight[channel] > 0])
            sigma = bulk * stack.sigma[throw, channel] + SIGMA_FLOOR
            stack.sigma[throw, channel] = sigma
    stack.problems.loss[throws] = place_of(stack.loss)
    stack.reweight(throws)


def with_correlated_noise(stack: ThrowStack, throws: Indices, optima: Solution) -> None:
    """Estimate the correlation of the noise, and whiten the residuals by it; a throw
    with too few values for that is a failure."""
    problems = stack.problems_of(throws)
    paths = predict_many(stack.model, optima.values, problems, stack.batch)
    for row, throw in enumerate(throws.tolist()):
        problem = at(problems, row)
        data = _linearized(stack, throw, problem, at(optima, row), paths[row])
        if not data.enough.any():
            name = stack.requests[throw].throw.name
            stack.failures[throw] = InputError(
                f"{name}: too few values to estimate a correlation of the noise"
            )
            continue
        unknown = stack.unknown[throw]
        estimated = estimate(stack.noises[throw], data, ~unknown)
        noise = estimated.noise
        if noise.sizes:
            # The sigmas of independent noise are kept beside the discrepancy.
            independent = {
                stack.channels[channel]: float(stack.sigma[throw, channel])
                for channel in np.flatnonzero(unknown)
            }
            noise = replace(noise, independent=independent)
        stack.noises[throw] = noise
        scale = np.where(unknown, estimated.scale, 1.0)
        stack.sigma[throw] = scale * stack.sigma[throw] + SIGMA_FLOOR * unknown
        stack.reweight(np.array([throw]))
        whitener = Whitener.of(
            noise,
            problem.times,
            stack.problems.weight[throw],
            len(data.from_standard),
            data,
        )
        of_stack = jax.tree.leaves(stack.problems.whitener)
        for of_all, of_throw in zip(of_stack, jax.tree.leaves(whitener), strict=True):
            of_all[throw] = of_throw


def _linearized(
    stack: ThrowStack, throw: int, problem: Problem, solution: Solution, path: Floats
) -> Linearized:
    """A fit with white noise to first order."""
    request = stack.requests[throw]
    lower, upper = bounds_of([request])
    adjustable = (lower[0] < solution.values) & (solution.values < upper[0])
    typical = request.parameters.typical
    rows = len(request.throw)
    if stack.noises[throw].has_discrepancy:
        return linearized(
            stack.model,
            problem,
            solution.values,
            path[:, :rows],
            request.stone,
            typical,
            adjustable,
        ).first(len(problem.weight))
    sigma = 1 / np.where(problem.weight > 0, problem.weight, 1.0)
    data = Linearized.of(
        problem.times,
        problem.weight,
        -solution.residual * sigma,
        solution.jacobian * sigma[..., None],
        typical,
        adjustable,
        len(stack.model.law.coefficients()),
    )
    speed = path[CHANNELS.index("speed"), :rows]
    return data._replace(span=np.asarray(time_of_motion(problem.times[:rows], speed)))
