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

import itertools
from collections.abc import Callable, Sequence
from operator import itemgetter

import jax
import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.prepared import (
    LeastSquaresFit,
    PreparedThrow,
    linearized,
    local_bounds,
)
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
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.models import Noise, time_of_motion
from curlfit.inference.noise.restricted import estimate
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.problem import ROWS_OF_DATA, Problem, build_problem
from curlfit.losses import LINEAR, Loss, place_of, robust_sigma
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked
from curlfit.settings.noise_kinds import NoiseKind
from curlfit.throws.throw import CHANNELS, Throw

_ROBUST_FITS = 4  # each with sigma from the bulk of the last
_TIGHTER = 0.1  # sigma of a channel over that of the fit before, at least
# factors on the usual coefficients, within which a rough path tells them
_ROUGHLY = 0.25, 4.0
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
        throws: Sequence[PreparedThrow],
        *,
        loss: Loss = LINEAR,
        noise: NoiseKind = NoiseKind.WHITE,
        shape: tuple[int, int] | None = None,
        batch: int = 1,
    ) -> None:
        """`shape` is that of all problems; `batch` the number of paths integrated
        side by side."""
        if not noise.is_white:
            for one in throws:
                if one.throw.events and one.throw.has_path:
                    raise InputError(
                        f"{one.throw.name}: noise {noise} is that of rows, "
                        "and this throw has timed events beside its path; "
                        "fit the path alone, or with white noise"
                    )
        self.model, self.throws, self.batch = model, throws, batch
        self.loss = loss
        even = [throw.equal_sigma() for throw in throws]

        def built(cut: Sequence[Throw], shape: tuple[int, int] | None) -> Problem:
            return stacked(
                [
                    build_problem(
                        throw,
                        one.stone,
                        one.origin,
                        sigma,
                        swept=one.swept,
                        shape=shape,
                    )
                    for throw, one, sigma in zip(cut, throws, even, strict=True)
                ]
            )

        self.initial_problems = self.problems = built(
            [one.throw for one in throws], shape
        )
        if not noise.is_white:
            size, blank = len(throws[0].parameters), Noise(noise)
            each = zip(self.problems.times, self.problems.weight, strict=True)
            whiteners = stacked([Whitener.of(blank, *one, size) for one in each])
            self.problems = self.problems._replace(whitener=whiteners)
        if self.problems.events is not None:
            # Initial values do without events; a throw with nothing else needs
            # a rough path.
            small = len(CHANNELS), self.problems.times.shape[-1]
            self.initial_problems = built(
                [one.throw.sketched() for one in throws], small
            )
        self.channels = ROWS_OF_DATA[: self.problems.observed.shape[1]]
        self.unknown = np.array(
            [[name in sigma for name in self.channels] for sigma in even]
        )
        self.sigma = np.array(
            [[sigma.get(name, 0.0) for name in self.channels] for sigma in even]
        )
        self._estimated = np.zeros_like(self.sigma)
        self.free = np.stack([throw.parameters.free for throw in throws])
        self.noises = [Noise(noise)] * len(throws)
        self.failures: dict[int, InputError] = {}
        robust = _ROBUST_FITS if loss.is_robust else 0
        self._rounds: list[Callable[[Indices, Solution], None]] = [
            self._estimate_sigma,
            self._tighten,
            *[self._estimate_robust_sigma] * robust,
        ]
        if not noise.is_white:
            self._rounds.append(self._estimate_noise)
        self._next = np.where(self.unknown.any(1), 0, _WITH_SIGMA)

    def starts(self) -> tuple[SmoothPath, Floats]:
        """Smooth paths, and initial values on all sides that may fit equally, with
        their shapes as of `start_values_of_sides`. The rough path of a throw that has
        none tells the size of coefficients, but no exponent and no sign: without
        friction a stone would never rest."""
        paths, (_, *ends) = smooth(self.initial_problems), local_bounds(self.throws)
        rough = np.array([not one.throw.has_path for one in self.throws])
        for place, item in enumerate(self.model.law.coefficients()):
            low, high = (end[:, place].copy() for end in ends)
            for end, factor in zip(ends, _ROUGHLY, strict=True):
                usual = default_guess(item) * (1.0 if item.signed else factor)
                end[:, place] = np.where(
                    rough, np.clip(usual, low, high), end[:, place]
                )
        return paths, start_values_of_sides(
            self.model, self.initial_problems, paths, *ends, batch=self.batch
        )

    def revise(self, which: Indices, solutions: Solution) -> Indices:
        """Revise the problems of throws that are due for a further fit; return
        these throws."""
        due = self._next[which]  # a copy: each throw goes through one round
        again = np.zeros(len(which), bool)
        for number in np.unique(due[due < len(self._rounds)]):
            here = due == number
            self._next[which[here]] += 1
            self._rounds[number](which[here], jax.tree.map(itemgetter(here), solutions))
            again |= here
        return which[again & ~np.isin(which, [*self.failures])]

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
        self._reweight(np.arange(len(self.throws)))
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
        estimated = np.flatnonzero(self.unknown[index])
        sigma = {self.channels[row]: float(self.sigma[index, row]) for row in estimated}
        problem = jax.tree.map(itemgetter(index), self.problems)
        return LeastSquaresFit(
            self.throws[index],
            self.model,
            self.loss,
            self.noises[index],
            problem,
            sigma,
            solution,
            tried,
            rival,
        )

    def _estimate_sigma(self, now: Indices, solutions: Solution) -> None:
        sigma = residual_sigma(solutions, self._problems_of(now), self.free[now])
        self._estimated[now] = np.where(self.unknown[now], sigma + SIGMA_FLOOR, 0.0)
        self.sigma[now] = np.where(
            self.unknown[now], self._estimated[now].max(1)[:, None], 0.0
        )
        self._tighten(now, solutions)

    def _tighten(self, now: Indices, _: Solution) -> None:
        """Continue toward the estimated sigmas, from equal ones.

        An angle has a kink at rest. If it is fitted almost exactly, chi squared has a
        wall where the stone comes to rest at the last row. Its slope is seen only from
        beyond the wall, where a weaker weight leads (the quadratic penalty method:
        Nocedal and Wright 2006, ch. 17.1).
        """
        self.sigma[now] = np.maximum(self._estimated[now], _TIGHTER * self.sigma[now])
        there = (self.sigma[now] == self._estimated[now]).all(1)
        self._next[now] = np.where(there, _WITH_SIGMA, _WITH_SIGMA - 1)
        self._reweight(now)

    def _estimate_robust_sigma(self, now: Indices, solutions: Solution) -> None:
        problems = self._problems_of(now)
        residual = whitened_residuals_of_many(
            self.model, solutions.values, problems, self.batch
        )
        for place, throw in enumerate(now):
            for row in np.flatnonzero(self.unknown[throw]):
                there = problems.weight[place, row] > 0
                bulk = robust_sigma(residual[place, row, there])
                self.sigma[throw, row] = bulk * self.sigma[throw, row] + SIGMA_FLOOR
        self.problems.loss[now] = place_of(self.loss)
        # without sigmas
        self._next[now[~self.unknown[now].any(1)]] = _WITH_SIGMA + _ROBUST_FITS
        self._reweight(now)

    def _estimate_noise(self, now: Indices, solutions: Solution) -> None:
        problems = self._problems_of(now)
        paths = predict_many(self.model, solutions.values, problems, self.batch)
        for place, (index, unknown) in enumerate(
            zip(now.tolist(), self.unknown[now], strict=True)
        ):
            solution, problem = (
                jax.tree.map(itemgetter(place), stack)
                for stack in (solutions, problems)
            )
            data = self._linearized(index, problem, solution, paths[place])
            if not data.enough.any():
                name = self.throws[index].throw.name
                self.failures[index] = InputError(
                    f"{name}: too few values to estimate a correlation of the noise"
                )
                continue
            found = estimate(self.noises[index].kind, data, ~unknown)
            noise = self.noises[index] = found.noise
            if noise.sizes:
                sigmas = zip(self.channels, self.sigma[index].tolist(), strict=True)
                noise.independent.update(itertools.compress(sigmas, unknown))
            scale = np.where(unknown, found.scale, 1.0)
            self.sigma[index] = scale * self.sigma[index] + SIGMA_FLOOR * unknown
            self._reweight(np.array([index]))
            whitener = Whitener.of(
                noise,
                problem.times,
                self.problems.weight[index],
                len(data.from_standard),
                data,
            )
            pairs = zip(
                *map(jax.tree.leaves, (self.problems.whitener, whitener)), strict=True
            )
            for leaf, new in pairs:
                leaf[index] = new

    def _linearized(
        self, index: int, problem: Problem, solution: Solution, path: Floats
    ) -> Linearized:
        """A fit with white noise to first order."""
        one, channels = self.throws[index], len(problem.weight)
        _, lower, upper = local_bounds([one])
        adjustable = ((lower < solution.values) & (solution.values < upper))[0]
        typical, n = one.parameters.typical, len(one.throw)
        if self.noises[index].kind.has_discrepancy:
            return linearized(
                self.model,
                problem,
                solution.values,
                path[:, :n],
                one.stone,
                typical,
                adjustable,
            ).first(channels)
        inverse = 1 / np.where(problem.weight > 0, problem.weight, 1.0)
        found = Linearized.of(
            problem.times,
            problem.weight,
            -solution.residual * inverse,
            solution.jacobian * inverse[..., None],
            typical,
            adjustable,
            len(self.model.law.coefficients()),
        )
        span = time_of_motion(problem.times[:n], path[CHANNELS.index("speed"), :n])
        return found._replace(span=np.asarray(span))

    def _reweight(self, now: Indices) -> None:
        before = self.problems.weight[now]
        there = before > 0
        sigma = np.where(self.unknown[now], self.sigma[now], 1.0)[..., None]
        relative = before / np.maximum(
            before.max(-1, keepdims=True), np.finfo(float).tiny
        )
        weight = np.where(
            there & self.unknown[now][..., None], relative / sigma, before
        )
        self.problems.weight[now] = weight

    def _problems_of(self, now: Indices) -> Problem:
        found: Problem = jax.tree.map(itemgetter(as_slice(now)), self.problems)
        return found
