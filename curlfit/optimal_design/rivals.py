"""Laws as rivals: each fitted to throws that another one makes, and what is left then.

A throw is made without noise. Its rival has an initial state of its own for each
throw; in common are its coefficients and the conditions that a fit holds fixed, which
have their usual widths (`curlfit.inference.fit.systematics`). About the optimum of a
throw, or of throws together, what is left is linear in these: rows of a small problem
of least squares.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import CurlfitError, InputError
from curlfit.inference.fit.search import fitted
from curlfit.inference.fit.systematics import residual_changes, widths_of
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.information.directions import apart_from, r_factor, visible
from curlfit.inference.model.likelihood import predict_many
from curlfit.inference.model.parameters import START, ParameterSet
from curlfit.inference.model.problem import problem_shape, shape_of_all
from curlfit.inference.model.request import Request
from curlfit.inference.solve.least_squares import Solution
from curlfit.inference.together.effects import Covariates
from curlfit.inference.together.fit import solved_together
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import side_by_side, stacked
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    Rest,
    clock_of,
    paths_of,
    rests_of,
)
from curlfit.settings.choices import Fitting
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS
from curlfit.throws.plausibility import require_plausible
from curlfit.throws.throw import Throw

_POINTS = 128  # rows of a throw without noise, weighted as all rows of its record


class NoiselessThrow(NamedTuple):
    """A throw that a law makes, without noise, at a few times."""

    planned: PlannedThrow
    throw: Throw
    rows: int
    """of the whole record, for which the few stand"""
    rest: Rest

    @property
    def is_plausible(self) -> bool:
        """Whether it stays on the sheet and is possible in other ways."""
        try:
            require_plausible(self.throw)
        except InputError:
            return False
        return True


class Truth(NamedTuple):
    """A law, and the throws that it makes."""

    assumed: Assumptions
    throws: list[NoiselessThrow]

    @classmethod
    def of(cls, assumed: Assumptions, planned: Sequence[PlannedThrow]) -> Truth:
        """The throws of a law as planned.

        Raises
        ------
        InputError : as in `record_information`.
        """
        rests = rests_of(assumed, planned)
        clocks = [
            clock_of(assumed, plan, rest.time)
            for plan, rest in zip(planned, rests, strict=True)
        ]
        times_by_throw = [
            np.linspace(0.0, clock[-1], min(_POINTS, len(clock))) for clock in clocks
        ]
        paths = paths_of(assumed, planned, times_by_throw)
        throws = []
        for plan, rest, clock, times, path in zip(
            planned, rests, clocks, times_by_throw, paths, strict=True
        ):
            # so that a few rows weigh as much as all of the record
            factor = math.sqrt(len(times) / len(clock))
            sigma: Any = {name: factor * size for name, size in assumed.sigma.items()}
            columns: Any = {
                name: path[row, : len(times)]
                for row, name in enumerate(CHANNELS)
                if name in assumed.sigma
            }
            label = f"{plan.v0:g} m/s, {plan.omega0:g} rad/s"
            throw = Throw.from_arrays(times, **columns, sigma=sigma, name=label)
            throws.append(NoiselessThrow(plan, throw, len(clock), rest))
        return cls(assumed, throws)

    @property
    def law(self) -> str:
        """Name of the law."""
        return self.assumed.law.name

    def at(self, indices: Iterable[int]) -> Truth:
        """The law with some of the throws."""
        return Truth(self.assumed, [self.throws[index] for index in indices])


class SingleFits(NamedTuple):
    """A law fitted to each of several throws on its own."""

    coefficients: Floats
    """shape (throws, coefficients)"""
    rows: Floats
    """what is left of each throw, NaN where the law cannot be fitted to it; shape
    (throws, rows, columns), see `Rival`"""


class FitTogether(NamedTuple):
    """A law fitted to several throws together."""

    rows: Floats
    """what is left of each throw, shape (throws, rows, columns), see `Rival`"""
    converged: bool


class LinearFit(NamedTuple):
    """Least squares of the rows of several throws."""

    chi_squared: float
    coefficients: Floats
    """over typical sizes"""


class Rival:
    """A law that is fitted to the throws of others.

    What a fit leaves of a throw is held in rows, whose columns are the coefficients
    over typical sizes, the conditions over widths, and the residual where all of these
    are zero.

    Attributes
    ----------
    size, typical : number and typical sizes of its coefficients.
    lower, upper : their bounds over typical sizes.
    """

    def __init__(
        self,
        assumed: Assumptions,
        stone: Stone,
        systematics: Mapping[str, float] | None = None,
    ) -> None:
        """Of a law and load; `systematics` as in `widths_of`."""
        self.model = assumed.model
        self._widths = widths_of(self.model, systematics)
        parameters = ParameterSet.build(assumed.law)
        self.size = len(assumed.law.coefficients())
        self.typical = parameters.typical[: self.size]
        self.lower = parameters.lower[: self.size] / self.typical
        self.upper = parameters.upper[: self.size] / self.typical
        self._choices = {
            "law": assumed.law,
            "load": assumed.load,
            "stone": stone.as_dict(),
        }

    def fit_each(self, throws: Sequence[NoiselessThrow]) -> SingleFits:
        """Fit each throw on its own."""
        choices = Fitting.of(**self._choices)
        requests = [Request.of(_accepted(throw), choices) for throw in throws]
        shape = shape_of_all([problem_shape(request.throw) for request in requests])
        stack = ThrowStack(
            self.model, requests, shape=shape, batch=side_by_side(len(throws))
        )
        solution_by_throw = []
        for fit in fitted(stack):
            if isinstance(fit, CurlfitError):
                raise fit
            solution_by_throw.append(fit.solution)
        solutions = stacked(solution_by_throw)
        rows = self._rows(stack, solutions)
        rows[~np.asarray(solutions.success)] = np.nan
        return SingleFits(solutions.values[:, : self.size], rows)

    def fit_together(
        self, throws: Sequence[NoiselessThrow], start: Floats
    ) -> FitTogether:
        """Fit throws together, from the coefficients `start` over typical sizes."""
        names = [coefficient.name for coefficient in self.model.law.coefficients()]
        values = (start * self.typical).tolist()
        start_by_name = dict(zip(names, values, strict=True))
        choices = Fitting.of(**self._choices, start=start_by_name)
        requests = [Request.of(_accepted(throw), choices) for throw in throws]
        none = Covariates.of([("", {})] * len(throws), (), ())
        joint = solved_together(requests, names, none, None)
        rows = self._rows(joint.stack, joint.solution)
        return FitTogether(rows, bool(np.all(joint.solution.success)))

    def _rows(self, stack: ThrowStack, solutions: Solution) -> Floats:
        """What is left of the residuals of each throw whatever its initial state."""
        parameters = stack.requests[0].parameters
        values = solutions.values
        paths = predict_many(self.model, values, stack.problems, stack.batch)
        changes = residual_changes(
            self.model, stack.problems, values, paths, self._widths, stack.batch
        )
        scaled = solutions.jacobian * (parameters.typical * parameters.free)
        of_law = (values / parameters.typical)[:, None, None, : self.size]
        at_zero = solutions.residual - (scaled[..., : self.size] * of_law).sum(-1)
        columns = np.concatenate(
            [scaled, np.stack([*changes.values(), at_zero], -1)], -1
        )
        rows = r_factor(columns.reshape(len(values), -1, columns.shape[-1]))
        state = np.arange(self.size, self.size + len(START))
        return apart_from(rows[..., state], np.delete(rows, state, -1))

    def fit_rows(self, rows: Floats) -> LinearFit:
        """Least squares of the rows of throws together, with the coefficients within
        bounds; conditions contribute to chi squared by their widths."""
        from scipy.optimize import lsq_linear  # slow to load

        factor = r_factor(rows.reshape(-1, rows.shape[-1]))
        conditions = factor.shape[-1] - 1 - self.size
        width = self.size + conditions
        # below the rows of the throws a row for each condition, as of a prior
        priors = np.eye(conditions, width, self.size)
        matrix = np.concatenate([factor[:, :-1], priors])
        target = -np.append(factor[:, -1], np.zeros(conditions))
        unbounded = np.full(conditions, np.inf)
        lower = np.append(self.lower, -unbounded)
        upper = np.append(self.upper, unbounded)
        optimum = lsq_linear(matrix, target, (lower, upper), method="bvls")
        return LinearFit(2 * float(optimum.cost), optimum.x[: self.size])

    def rank(self, rows: Floats) -> int:
        """Number of directions of the coefficients that throws together determine."""
        factor = r_factor(rows[..., : self.size].reshape(-1, self.size))
        singular = np.asarray(np.linalg.svd(factor, compute_uv=False), float)
        return int(visible(singular).sum())


def _accepted(throw: NoiselessThrow) -> Throw:
    """A throw that is fitted even if it is not possible: it is left out later."""
    return throw.throw.with_defaults(as_given=True)
