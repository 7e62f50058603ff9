"""Rounds of a fit: each assumes the noise estimated from the residuals of the
previous one.

Where no sigma is given, a first fit weights the channels equally, 1 m like 1 rad. The
scatter of its residuals, corrected for the number of parameters, is the sigma of the
second fit (two-step generalised least squares). This is not iterated to convergence:
where a law is not exact, that ends with one channel fitted perfectly at the expense of
the others. Where a sigma is far below the others, further fits lead down to it. With a
robust loss, sigma is taken from the bulk of the residuals, repeatedly. Correlated
noise is estimated from the residuals of a fit with white noise, and a last fit
accounts for it.

One throw, many side by side, and several with common coefficients all go through
these rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of, linearized
from curlfit.inference.initial_values import (
    SmoothPath,
    default_guess,
    smooth,
    start_values_of_sides,
)
from curlfit.inference.least_squares import Indices, Solution, as_slice, residual_sigma
from curlfit.inference.likelihood import (
    SIGMA_FLOOR,
    predict_many,
    whitened_residuals_of_many,
)
from curlfit.inference.model import Model
from curlfit.inference.noise.independence import time_of_motion
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.restricted import estimate
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.problem import ROWS_OF_DATA, Problem, build_problem
from curlfit.inference.request import Request
from curlfit.losses import place_of, robust_sigma
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked, unstacked
from curlfit.throws.throw import CHANNELS, Throw

_ROBUST_FITS = 4  # each with sigma from the bulk of the last
_TIGHTER = 0.1  # sigma of a channel over that of the fit before, at least
# factor on the usual coefficients, or one over it, within which a rough path tells them
_ROUGHLY = 4.0
_WITH_SIGMA = 2  # the first round once every sigma is known


class Rounds:
    """The problems of throws of one law, as the rounds of their fits revise them.

    Attributes
    ----------
    problems : throws along the first axis. initial_problems : the same for the
        initial values.
    sigma : of each throw and channel, the smallest where it varies by row; 0 where the
        throw gives its own.
    failures : by index, the error that prevents a further round.
    """

    def __init__(
        self,
        model: Model,
        requests: Sequence[Request],
        *,
        shape: tuple[int, int] | None = None,
        batch: int = 1,
    ) -> None:
        """Of requests with one loss and one kind of noise.

        Parameters
        ----------
        shape : of all problems; the smallest possible if None.
        batch : number of paths integrated side by side.

        Raises
        ------
        InputError : the noise is that of rows, and a throw has timed events too.
        """
        loss = requests[0].loss
        noise = requests[0].noise
        if not noise.is_white:
            for request in requests:
                if request.throw.events and request.throw.has_path:
                    raise InputError(
                        f"{request.throw.name}: noise {noise.kind} is that of rows, "
                        "and this throw has timed events beside its path; "
                        "fit the path alone, or with white noise"
                    )
        noise = type(noise)()  # not estimated
        self.model = model
        self.requests = requests
        self.batch = batch
        self.loss = loss
        equal_sigmas = [request.equal_sigma() for request in requests]
        throws = [request.throw for request in requests]
        self.problems = _problems(requests, throws, equal_sigmas, shape)
        self.initial_problems = self.problems
        if not noise.is_white:
            # Until the noise is estimated, these change nothing.
            whiteners = [
                Whitener.of(noise, times, weight, len(requests[0].parameters))
                for times, weight in zip(
                    self.problems.times, self.problems.weight, strict=True
                )
            ]
            self.problems = self.problems._replace(whitener=stacked(whiteners))
        if self.problems.events is not None:
            # Initial values do without events; a throw with nothing else needs
            # a rough path.
            self.initial_problems = _problems(
                requests,
                [throw.sketched() for throw in throws],
                equal_sigmas,
                (len(CHANNELS), self.problems.times.shape[-1]),
            )
        self.channels = ROWS_OF_DATA[: self.problems.observed.shape[1]]
        self.unknown = np.array(
            [[name in sigma for name in self.channels] for sigma in equal_sigmas]
        )
        self.sigma = np.array(
            [[sigma.get(name, 0.0) for name in self.channels] for sigma in equal_sigmas]
        )
        self._estimated = np.zeros_like(self.sigma)
        self.free = np.stack([request.parameters.free for request in requests])
        self.noises = [noise] * len(requests)
        self.failures: dict[int, InputError] = {}
        robust_fits = _ROBUST_FITS if loss.is_robust else 0
        self._rounds: list[Callable[[Indices, Solution], None]] = [
            self._estimate_sigma,
            self._tighten,
            *[self._estimate_robust_sigma] * robust_fits,
        ]
        if not noise.is_white:
            self._rounds.append(self._estimate_noise)
        # of each throw, the number of the round that follows its present fit
        self._next = np.where(self.unknown.any(1), 0, _WITH_SIGMA)

    def starts(self) -> tuple[SmoothPath, Floats]:
        """Smooth paths, and initial values on all sides that may fit equally, with
        their shapes as of `start_values_of_sides`. The rough path of a throw that has
        none tells the size of coefficients, but no exponent and no sign: without
        friction a stone would never rest."""
        paths = smooth(self.initial_problems)
        lower, upper = bounds_of(self.requests)
        rough = np.array([not request.throw.has_path for request in self.requests])
        for index, coefficient in enumerate(self.model.law.coefficients()):
            usual = default_guess(coefficient)
            factor = 1.0 if coefficient.signed else _ROUGHLY
            low = lower[rough, index]
            high = upper[rough, index]
            lower[rough, index] = np.clip(usual / factor, low, high)
            upper[rough, index] = np.clip(usual * factor, low, high)
        return paths, start_values_of_sides(
            self.model, self.initial_problems, paths, lower, upper, batch=self.batch
        )

    def revise(self, which: Indices, solutions: Solution) -> Indices:
        """Revise the problems of throws that are due for a further fit; return
        these throws.

        Parameters
        ----------
        which : throws, by index. solutions : their optima, along the first axis.
        """
        next_rounds = self._next[which]  # a copy: each throw goes through one round
        has_round = next_rounds < len(self._rounds)
        for number in np.unique(next_rounds[has_round]):
            in_round = next_rounds == number
            throws = which[in_round]
            self._next[throws] += 1
            self._rounds[number](throws, _at(solutions, in_round))
        return which[has_round & ~np.isin(which, [*self.failures])]

    def with_own_sigma(self, solutions: Solution) -> Solution:
        """Optima of all throws with the sigmas of their own residuals in place of
        those that the fit estimated before, where that is by least squares with
        independent noise."""
        plain = not self.loss.is_robust and self.noises[0].is_white
        if not (plain and self.unknown.any()):
            return solutions
        sigma = residual_sigma(solutions, self.problems, self.free) + SIGMA_FLOOR
        ratio = np.where(self.unknown, self.sigma / sigma, 1.0)[..., None]
        self.sigma = np.where(self.unknown, sigma, self.sigma)
        self._reweight(np.arange(len(self.requests)))
        return solutions._replace(
            residual=solutions.residual * ratio,
            jacobian=solutions.jacobian * ratio[..., None],
        )

    def record(
        self,
        index: int,
        solution: Solution,
        tried: int = 1,
        rival: Solution | None = None,
    ) -> LeastSquaresFit:
        """The outcome of the fit of a throw."""
        sigma = {
            self.channels[row]: float(self.sigma[index, row])
            for row in np.flatnonzero(self.unknown[index])
        }
        return LeastSquaresFit(
            request=self.requests[index],
            model=self.model,
            noise=self.noises[index],
            problem=_at(self.problems, index),
            sigma=sigma,
            solution=solution,
            tried=tried,
            rival=rival,
        )

    def _estimate_sigma(self, throws: Indices, solutions: Solution) -> None:
        """Estimate the sigmas from a fit with equal weights."""
        problems = self._problems_of(throws)
        unknown = self.unknown[throws]
        sigma = residual_sigma(solutions, problems, self.free[throws]) + SIGMA_FLOOR
        estimated = np.where(unknown, sigma, 0.0)
        largest = estimated.max(axis=1, keepdims=True)
        self._estimated[throws] = estimated
        self.sigma[throws] = np.where(unknown, largest, 0.0)
        self._tighten(throws, solutions)

    def _tighten(self, throws: Indices, _: Solution) -> None:
        """Continue toward the estimated sigmas, from equal ones.

        An angle has a kink at rest. If it is fitted almost exactly, chi squared has a
        wall where the stone comes to rest at the last row. Its slope is seen only from
        beyond the wall, where a weaker weight leads (the quadratic penalty method:
        Nocedal and Wright 2006, ch. 17.1).
        """
        estimated = self._estimated[throws]
        sigma = np.maximum(estimated, _TIGHTER * self.sigma[throws])
        reached = (sigma == estimated).all(axis=1)
        self.sigma[throws] = sigma
        self._next[throws] = np.where(reached, _WITH_SIGMA, _WITH_SIGMA - 1)
        self._reweight(throws)

    def _estimate_robust_sigma(self, throws: Indices, solutions: Solution) -> None:
        """Take sigma from the bulk of the residuals, and apply the robust loss."""
        problems = self._problems_of(throws)
        residuals = whitened_residuals_of_many(
            self.model, solutions.values, problems, self.batch
        )
        for throw, residual, weight in zip(
            throws, residuals, problems.weight, strict=True
        ):
            for channel in np.flatnonzero(self.unknown[throw]):
                observed = weight[channel] > 0
                bulk = robust_sigma(residual[channel, observed])
                sigma = bulk * self.sigma[throw, channel] + SIGMA_FLOOR
                self.sigma[throw, channel] = sigma
        self.problems.loss[throws] = place_of(self.loss)
        # Where every sigma is given, one fit with the loss is enough.
        is_given = ~self.unknown[throws].any(axis=1)
        self._next[throws[is_given]] = _WITH_SIGMA + _ROBUST_FITS
        self._reweight(throws)

    def _estimate_noise(self, throws: Indices, solutions: Solution) -> None:
        """Estimate the correlation of the noise, and whiten the residuals by it."""
        problems = self._problems_of(throws)
        paths = predict_many(self.model, solutions.values, problems, self.batch)
        for row, throw in enumerate(throws.tolist()):
            problem = _at(problems, row)
            data = self._linearized(throw, problem, _at(solutions, row), paths[row])
            if not data.enough.any():
                name = self.requests[throw].throw.name
                self.failures[throw] = InputError(
                    f"{name}: too few values to estimate a correlation of the noise"
                )
                continue
            unknown = self.unknown[throw]
            estimated = estimate(self.noises[throw], data, ~unknown)
            noise = estimated.noise
            if noise.sizes:
                # The sigmas of independent noise are kept beside the discrepancy.
                independent = {
                    self.channels[channel]: float(self.sigma[throw, channel])
                    for channel in np.flatnonzero(unknown)
                }
                noise = replace(noise, independent=independent)
            self.noises[throw] = noise
            scale = np.where(unknown, estimated.scale, 1.0)
            self.sigma[throw] = scale * self.sigma[throw] + SIGMA_FLOOR * unknown
            self._reweight(np.array([throw]))
            whitener = Whitener.of(
                noise,
                problem.times,
                self.problems.weight[throw],
                len(data.from_standard),
                data,
            )
            stack = jax.tree.leaves(self.problems.whitener)
            for of_all, of_throw in zip(stack, jax.tree.leaves(whitener), strict=True):
                of_all[throw] = of_throw

    def _linearized(
        self, throw: int, problem: Problem, solution: Solution, path: Floats
    ) -> Linearized:
        """A fit with white noise to first order."""
        request = self.requests[throw]
        lower, upper = bounds_of([request])
        adjustable = (lower[0] < solution.values) & (solution.values < upper[0])
        typical = request.parameters.typical
        rows = len(request.throw)
        if self.noises[throw].has_discrepancy:
            return linearized(
                self.model,
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
            len(self.model.law.coefficients()),
        )
        speed = path[CHANNELS.index("speed"), :rows]
        return data._replace(
            span=np.asarray(time_of_motion(problem.times[:rows], speed))
        )

    def _reweight(self, throws: Indices) -> None:
        """Weight the channels whose sigma is estimated by 1/sigma, where the relative
        weights of their rows stay."""
        weight = self.problems.weight[throws]
        unknown = self.unknown[throws][..., None]
        sigma = np.where(unknown, self.sigma[throws][..., None], 1.0)
        largest = weight.max(axis=-1, keepdims=True)
        relative = weight / np.maximum(largest, np.finfo(float).tiny)
        estimated = unknown & (weight > 0)
        self.problems.weight[throws] = np.where(estimated, relative / sigma, weight)

    def _problems_of(self, throws: Indices) -> Problem:
        problems: Problem = _at(self.problems, as_slice(throws))
        return problems


def _problems(
    requests: Sequence[Request],
    throws: Sequence[Throw],
    sigmas: Sequence[dict[str, float]],
    shape: tuple[int, int] | None,
) -> Problem:
    """The problems of throws along the first axis, with these sigmas by channel.

    Parameters
    ----------
    throws : the data, those of the requests or sketches of them.
    """
    problems = [
        build_problem(
            throw,
            request.stone,
            sigma,
            swept=request.swept,
            shape=shape,
        )
        for request, throw, sigma in zip(requests, throws, sigmas, strict=True)
    ]
    return stacked(problems)


def _at(stack: Any, which: Any) -> Any:
    """The records of a stack at an index, or at several."""
    return jax.tree.map(itemgetter(which), stack)


def first_problem(request: Request) -> tuple[Model, ParameterSet, Problem]:
    """The problem that a fit begins with, for programs that are compiled beside it."""
    model = Model.of(request)
    (problem,) = unstacked(Rounds(model, [request]).problems)
    return model, request.parameters, problem
