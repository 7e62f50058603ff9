"""The problem that a saved fit solved, a fitted path to first order, and the bounds and
priors of many requests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.likelihood import path_jacobians
from curlfit.inference.model.model import Model
from curlfit.inference.model.priors import Penalty
from curlfit.inference.model.problem import Problem, build_problem
from curlfit.inference.model.request import Request
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.noise.independence import time_of_motion
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.whitening import Whitener
from curlfit.losses import LOSSES
from curlfit.noises import WHITE
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS


def problem_of(fit: FitResult) -> Problem:
    """The problem that a fit solved, with its noise and loss."""
    problem = build_problem(
        fit.throw, fit.stone, fit.sigma, LOSSES[fit.loss], fit.data.swept
    )
    data = linearized_fit(fit).first(len(problem.weight)) if fit.noise.sizes else None
    whitener = Whitener.of(
        fit.noise, problem.times, problem.weight, len(fit.values), data
    )
    return problem._replace(whitener=whitener)


def linearized_fit(fit: FitResult) -> Linearized:
    """The fitted path to first order, with the weights of independent noise."""
    independent = fit.sigma | fit.noise.independent
    problem = problem_of(replace(fit, sigma=independent, noise=WHITE))
    path = np.array([fit.fitted[name] for name in CHANNELS])
    if fit.events:
        # one more row, with a column for each event
        row = np.zeros((1, path.shape[1]))
        for column, event in enumerate(fit.events):
            off = event.fitted - event.event.value
            row[0, column] = problem.observed[-1, column] + off
        path = np.concatenate([path, row])
    verdicts = [estimate.verdict for estimate in fit.parameters.values()]
    adjustable = np.array(
        [verdict not in (Verdict.FIXED, Verdict.AT_BOUND) for verdict in verdicts]
    )
    typical = fit.parameter_set.typical
    return linearized(
        fit.model, problem, fit.values, path, fit.stone, typical, adjustable
    )


def penalties(requests: Sequence[Request], *, first: bool = False) -> Penalty:
    """What the priors of each throw add to its chi squared: see
    `Request.penalty`."""
    return stacked([request.penalty(first=first) for request in requests])


def bounds_of(
    requests: Sequence[Request], common: Booleans | None = None
) -> tuple[Floats, Floats]:
    """Lower and upper bounds of many throws, each of shape (throws, parameters). Those
    of parameters in `common` hold for all throws."""
    lower = np.stack([request.parameters.lower for request in requests])
    upper = np.stack([request.parameters.upper for request in requests])
    if common is not None:
        lower[:, common] = lower[:, common].max(axis=0)
        upper[:, common] = upper[:, common].min(axis=0)
    return lower, upper


def linearized(
    model: Model,
    problem: Problem,
    values: Floats,
    path: Floats,
    stone: Stone,
    typical: Floats,
    adjustable: Booleans,
) -> Linearized:
    """A fitted path of all channels, and of events if there are any, to first order.

    Parameters
    ----------
    values : of the parameters.
    path : the fitted path, shape (5 or 6, n), of at least the rows that are not
        padding.
    typical : sizes of the parameters.
    adjustable : which parameters are neither fixed nor at a bound.
    """
    jacobian = path_jacobians(model, values[None], stacked([problem]))[0]
    times = problem.times
    rows = path.shape[1]  # without padding
    measured = len(problem.weight)
    weight = np.zeros(jacobian.shape[:2])
    weight[:measured] = problem.weight
    off = problem.observed[:, :rows] - path[:measured]
    residual = np.zeros(jacobian.shape[:2])
    residual[:measured, :rows] = np.where(weight[:measured, :rows] > 0, off, 0.0)
    response = Responses.of(times[:rows], path[: len(CHANNELS)], stone)
    responses = [response.at(times, row) for row in range(len(CHANNELS))]
    if len(jacobian) > len(CHANNELS):
        responses.append(np.zeros_like(responses[0]))  # of events
    data = Linearized.of(
        times,
        weight,
        residual,
        jacobian,
        typical,
        adjustable,
        len(model.law.coefficients()),
    )
    span = time_of_motion(times[:rows], path[CHANNELS.index("speed")])
    return data._replace(span=np.asarray(span), responses=np.stack(responses))
