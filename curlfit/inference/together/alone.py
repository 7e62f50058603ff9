"""The throws of a joint fit, each fitted by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from curlfit.errors import CurlfitError
from curlfit.inference.fit.coefficient_rows import all_coefficient_rows
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.search import fitted
from curlfit.inference.fit.summary import summarize_many
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.information.directions import standard_error
from curlfit.inference.model.request import Request
from curlfit.inference.together.population import Together
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import side_by_side


class ThrowsAlone(NamedTuple):
    """What each of some throws tells by itself of the parameters in common."""

    values: Floats
    """shape (throws, parameters)"""
    rows: Floats
    """of unit errors, shape (throws, rows, parameters); zero of a throw that
    tells nothing"""
    typical: Floats
    stated: Sequence[Mapping[str, float]]
    """standard errors by coefficient and combination, as the fits of the throws have
    them; a sum that a fit does not state has that of its rows"""

    @classmethod
    def of_fits(cls, fits: Sequence[FitResult | None], names: Sequence[str]) -> Self:
        """Of fits of each throw by itself; None of one whose fit failed."""
        values = np.zeros((len(fits), len(names)))
        rows_by_throw = [np.zeros((0, len(names)))] * len(fits)
        typical = np.ones(len(names))
        stated: list[dict[str, float]] = [{} for _ in fits]
        for throw, fit in enumerate(fits):
            if fit is not None:
                estimates = [fit.parameters[name] for name in names]
                values[throw] = [estimate.value for estimate in estimates]
                typical = np.array([estimate.typical for estimate in estimates])
                rows_by_throw[throw] = all_coefficient_rows(fit, names)[:, :-1]
                stated[throw] = _stated_errors(fit)
        most_rows = max(len(rows_of_throw) for rows_of_throw in rows_by_throw)
        rows = np.zeros((len(fits), most_rows, len(names)))
        for throw, rows_of_throw in enumerate(rows_by_throw):
            rows[throw, : len(rows_of_throw)] = rows_of_throw
        return cls(values, rows, typical, stated)

    def estimates(
        self, expression: str, weights: Floats
    ) -> list[tuple[float, float] | None]:
        """A weighted sum of the parameters and its standard error from each throw."""
        errors_of_rows = errors_by_rows(self.rows, weights, self.typical)
        values = self.values @ weights
        estimates: list[tuple[float, float] | None] = []
        for value, error_of_rows, stated_errors in zip(
            values, errors_of_rows, self.stated, strict=True
        ):
            error = stated_errors.get(expression, error_of_rows)
            estimates.append(None if error is None else (float(value), error))
        return estimates


def _stated_errors(fit: FitResult) -> dict[str, float]:
    """Standard errors that a fit states, by coefficient and combination."""
    stderr_by_expression = {
        name: estimate.stderr for name, estimate in fit.parameters.items()
    }
    for combination in fit.combinations:
        stderr_by_expression[combination.expression] = combination.stderr
    return {
        expression: stderr
        for expression, stderr in stderr_by_expression.items()
        if stderr is not None
    }


def errors_by_rows(
    rows: Floats, weights: Floats, typical: Floats
) -> list[float | None]:
    """Standard error of a weighted sum of parameters, as the rows of each throw tell
    it; None where they do not."""
    return [
        standard_error(rows_of_throw * typical, weights * typical)
        for rows_of_throw in rows
    ]


def fitted_alone(
    together: Together, held_by_throw: Sequence[Mapping[str, float]]
) -> list[FitResult | None]:
    """Each throw fitted by itself, with some of its parameters held; None where that
    does not converge. The priors of what throws have in common count once, for all of
    them, and are not among these."""
    joint_stack = together.stack
    names = joint_stack.requests[0].parameters.names_where(together.common)
    stack = ThrowStack(
        joint_stack.model,
        [
            _by_itself(request, names, held)
            for request, held in zip(joint_stack.requests, held_by_throw, strict=True)
        ],
        shape=joint_stack.problems.observed.shape[1:],
        batch=side_by_side(len(joint_stack.requests)),
    )
    fits = fitted(stack)
    usable = [fit for fit in fits if not isinstance(fit, CurlfitError)]
    curves = stack.loss.is_robust or not stack.noises[0].is_white
    records = iter(summarize_many(usable, stack.batch, curves=curves))
    alone: list[FitResult | None] = []
    for fit in fits:
        record = None if isinstance(fit, CurlfitError) else next(records)
        alone.append(record if record is not None and record.converged else None)
    return alone


def _by_itself(
    request: Request, common: Sequence[str], held: Mapping[str, float]
) -> Request:
    """A throw without the priors of what it has in common, some values held, and no
    initial values given."""
    parameters = request.parameters
    priors = {
        name: prior for name, prior in parameters.priors.items() if name not in common
    }
    parameters = replace(parameters, priors=priors)
    for name, value in held.items():
        parameters = parameters.with_fixed(name, value)
    return replace(request, parameters=parameters, start={})
