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
        for place, fit in enumerate(fits):
            if fit is not None:
                parameters = [fit.parameters[name] for name in names]
                values[place] = [item.value for item in parameters]
                typical = np.array([item.typical for item in parameters])
                rows_by_throw[place] = all_coefficient_rows(fit, names)[:, :-1]
                stated[place] = _stated_errors(fit)
        most = max(map(len, rows_by_throw))
        rows = np.zeros((len(fits), most, len(names)))
        for place, of_throw in enumerate(rows_by_throw):
            rows[place, : len(of_throw)] = of_throw
        return cls(values, rows, typical, stated)

    def estimates(
        self, expression: str, weights: Floats
    ) -> list[tuple[float, float] | None]:
        """A weighted sum of the parameters and its standard error from each throw."""
        by_rows = errors_by_rows(self.rows, weights, self.typical)
        errors = [
            stated.get(expression, error)
            for stated, error in zip(self.stated, by_rows, strict=True)
        ]
        values = self.values @ weights
        return [
            None if error is None else (float(value), error)
            for value, error in zip(values, errors, strict=True)
        ]


def _stated_errors(fit: FitResult) -> dict[str, float]:
    """Standard errors that a fit states, by coefficient and combination."""
    of_parameters = {name: item.stderr for name, item in fit.parameters.items()}
    of_combinations = {item.expression: item.stderr for item in fit.combinations}
    return {
        name: stderr
        for name, stderr in {**of_parameters, **of_combinations}.items()
        if stderr is not None
    }


def errors_by_rows(
    rows: Floats, weights: Floats, typical: Floats
) -> list[float | None]:
    """Standard error of a weighted sum of parameters, as the rows of each throw tell
    it; None where they do not."""
    return [standard_error(of_throw * typical, weights * typical) for of_throw in rows]


def fitted_alone(
    together: Together, held: Mapping[str, float]
) -> list[FitResult | None]:
    """Each throw fitted by itself, with some parameters `held`; None where that does
    not converge. The priors of what throws have in common count once, for all of them,
    and are not among these."""
    stack = together.stack
    names = stack.requests[0].parameters.names_where(together.common)
    again = ThrowStack(
        stack.model,
        [_by_itself(request, names, held) for request in stack.requests],
        shape=stack.problems.observed.shape[1:],
        batch=side_by_side(len(stack.requests)),
    )
    fits = fitted(again)
    usable = [one for one in fits if not isinstance(one, CurlfitError)]
    curves = again.loss.is_robust or not again.noises[0].is_white
    records = iter(summarize_many(usable, again.batch, curves=curves))
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
