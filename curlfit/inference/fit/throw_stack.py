"""The problems of many throws of one law, as the fits of these revise them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.problems import bounds_of
from curlfit.inference.fit.residuals import residual_sigma
from curlfit.inference.model.likelihood import SIGMA_FLOOR
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.problem import ROWS_OF_DATA, Problem, build_problem
from curlfit.inference.model.request import Request
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.solve.initial_values import (
    SmoothPath,
    default_guess,
    smooth,
    start_values_of_sides,
)
from curlfit.inference.solve.least_squares import Indices, Solution, as_slice
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import at, stacked, unstacked
from curlfit.throws.channels import CHANNELS
from curlfit.throws.throw import Throw

_ROUGHLY = 4.0
"""Factor on the usual coefficients, or one over it, within which a rough path tells
them."""


class ThrowStack:
    """The problems of throws of one law along the first axis, whose weights, loss and
    whitening change from fit to fit.

    Attributes
    ----------
    problems : of the next fit.
    unknown : of each throw and channel, whether its sigma is estimated.
    sigma : of each throw and channel, the smallest where it varies by row; 0 where the
        throw gives its own.
    free : which parameters of each throw are fitted.
    noises : of each throw, as estimated so far.
    failures : by index, the error that prevents a further fit.
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
        self.model = model
        self.requests = requests
        self.batch = batch
        self.loss = requests[0].loss
        kind_of_noise = type(requests[0].noise)
        self.noises = [kind_of_noise()] * len(requests)  # not estimated
        throws = [request.throw for request in requests]
        self.problems = _problems(requests, throws, shape)
        if not self.noises[0].is_white:
            _require_rows_alone(requests)
            self.problems = _with_whitening_to_come(self.problems, requests)
        self.channels = ROWS_OF_DATA[: self.problems.observed.shape[1]]
        equal_sigmas = [request.equal_sigma() for request in requests]
        self.unknown = np.array(
            [[name in sigma for name in self.channels] for sigma in equal_sigmas]
        )
        self.sigma = np.array(
            [[sigma.get(name, 0.0) for name in self.channels] for sigma in equal_sigmas]
        )
        self.free = np.stack([request.parameters.free for request in requests])
        self.failures: dict[int, InputError] = {}

    def starts(self) -> tuple[SmoothPath, Floats]:
        """Smooth paths, and initial values on all sides that may fit equally, with
        their shapes as of `start_values_of_sides`."""
        problems = self._problems_for_starts()
        paths = smooth(problems)
        lower, upper = self._bounds_for_starts()
        sides = start_values_of_sides(
            self.model, problems, paths, lower, upper, batch=self.batch
        )
        return paths, sides

    def _problems_for_starts(self) -> Problem:
        """The problems without events and whitening, of which initial values make no
        use: a throw of events alone has a rough path in their place."""
        if self.problems.events is None:
            return self.problems._replace(whitener=None)
        sketches = [request.throw.sketched() for request in self.requests]
        shape = (len(CHANNELS), self.problems.times.shape[-1])
        return _problems(self.requests, sketches, shape)

    def _bounds_for_starts(self) -> tuple[Floats, Floats]:
        """Bounds of the initial values of each throw. The rough path of a throw that
        has none tells the size of coefficients, but no exponent and no sign: without
        friction a stone would never rest."""
        lower, upper = bounds_of(self.requests)
        is_rough = np.array([not request.throw.has_path for request in self.requests])
        for index, coefficient in enumerate(self.model.law.coefficients()):
            usual = default_guess(coefficient)
            factor = 1.0 if coefficient.signed else _ROUGHLY
            low = lower[is_rough, index]
            high = upper[is_rough, index]
            lower[is_rough, index] = np.clip(usual / factor, low, high)
            upper[is_rough, index] = np.clip(usual * factor, low, high)
        return lower, upper

    def problems_of(self, throws: Indices) -> Problem:
        """The problems of some throws, by index."""
        problems: Problem = at(self.problems, as_slice(throws))
        return problems

    def reweight(self, throws: Indices) -> None:
        """Weight the channels of some throws whose sigma is estimated by 1/sigma; the
        relative weights of their rows stay."""
        weight = self.problems.weight[throws]
        unknown = self.unknown[throws][..., None]
        sigma = np.where(unknown, self.sigma[throws][..., None], 1.0)
        largest = weight.max(axis=-1, keepdims=True)
        relative = weight / np.maximum(largest, np.finfo(float).tiny)
        estimated = unknown & (weight > 0)
        self.problems.weight[throws] = np.where(estimated, relative / sigma, weight)

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
        self.reweight(np.arange(len(self.requests)))
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
            problem=at(self.problems, index),
            sigma=sigma,
            solution=solution,
            tried=tried,
            rival=rival,
        )


def _require_rows_alone(requests: Sequence[Request]) -> None:
    """Raise `InputError` for a throw with timed events beside its path: correlated
    noise is that of rows."""
    for request in requests:
        if request.throw.events and request.throw.has_path:
            raise InputError(
                f"{request.throw.name}: noise {request.noise.kind} is that of rows, "
                "and this throw has timed events beside its path; "
                "fit the path alone, or with white noise"
            )


def _problems(
    requests: Sequence[Request],
    throws: Sequence[Throw],
    shape: tuple[int, int] | None,
) -> Problem:
    """The problems of throws along the first axis, with equal sigmas of the channels
    for which none is given.

    Parameters
    ----------
    throws : the data, those of the requests or sketches of them.
    """
    problems = [
        build_problem(
            throw,
            request.stone,
            request.equal_sigma(),
            swept=request.swept,
            shape=shape,
        )
        for request, throw in zip(requests, throws, strict=True)
    ]
    return stacked(problems)


def _with_whitening_to_come(problems: Problem, requests: Sequence[Request]) -> Problem:
    """Problems with whitening that changes nothing until the noise is estimated."""
    whiteners = []
    for request, times, weight in zip(
        requests, problems.times, problems.weight, strict=True
    ):
        not_estimated = type(request.noise)()
        parameters = len(request.parameters)
        whiteners.append(Whitener.of(not_estimated, times, weight, parameters))
    return problems._replace(whitener=stacked(whiteners))


def first_problem(request: Request) -> tuple[Model, ParameterSet, Problem]:
    """The problem that a fit begins with, for programs that are compiled beside it."""
    model = Model.of(request)
    (problem,) = unstacked(ThrowStack(model, [request]).problems)
    return model, request.parameters, problem
