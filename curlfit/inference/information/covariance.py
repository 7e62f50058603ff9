"""Errors and verdicts at an optimum, where some parameters may be at their bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.identifiability import Identifiability
from curlfit.inference.information.information import Information
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats


@dataclass(frozen=True, eq=False)
class Covariance:
    """First-order uncertainties of parameters at an optimum.

    Bounds and the distance to the optimum are judged by the rows of the search, errors
    and verdicts by those of the estimator, which differ under a robust loss. Errors are
    those of the tangent: `curlfit.inference.fit.departures` may widen them where chi
    squared is no quadratic.
    """

    information: Information
    """as the search has it, with the priors"""
    unconfined: Information
    """the same without the directions that only the bounds determine"""
    identifiability: Identifiability
    """of the open parameters; its covariance gives the errors, and has the spread of
    the parameters at a bound"""
    identifiability_of_data: Identifiability
    """the same from the data without the priors"""
    at_bound: Booleans
    """which parameters the data push against a bound"""
    open: Booleans
    """which parameters can move: neither fixed nor held at a bound; one at the end of a
    ridge that a bound cuts counts as open"""
    conditional_matrix: Floats
    """covariance of the open parameters while those at a bound stay there"""
    count: int
    """number of values in the data"""

    @classmethod
    def of(
        cls,
        information: Information,
        estimator: Information | None = None,
        of_data: Information | None = None,
        count: int | None = None,
    ) -> Self:
        """At the optimum of a problem. All three informations are the same but under a
        robust loss (`estimator`) and with priors (`of_data`).

        Parameters
        ----------
        information : whose least squares the search has found.
        estimator : whose normal equations are those of the estimator, if they differ.
        of_data : the estimator without the priors, if there are any.
        count : number of values in the data; by default that of the parameters.
        """
        if estimator is None:
            estimator = information
        unconfined = information.without_confined()
        at_bound = unconfined.at_bound()
        is_open, spread = unconfined.open(at_bound)
        identifiability = Identifiability.of(estimator.only(is_open), spread)
        without_priors = identifiability
        if of_data is not None:
            without_priors = Identifiability.of(of_data.only(is_open), spread)
        columns = information.typical[is_open][:, None] * spread
        return cls(
            information=information,
            unconfined=unconfined,
            identifiability=identifiability,
            identifiability_of_data=without_priors,
            at_bound=at_bound,
            open=is_open,
            conditional_matrix=identifiability.covariance - columns @ columns.T,
            count=len(information.names) if count is None else count,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return self.information.names

    @property
    def values(self) -> Floats:
        """Values at the optimum."""
        return self.information.values

    @property
    def typical(self) -> Floats:
        """Typical sizes of all parameters."""
        return self.information.typical

    @property
    def free(self) -> Booleans:
        """Which parameters are not fixed."""
        return self.information.free

    @cached_property
    def distance(self) -> float:
        """Distance to the optimum, standard errors."""
        return self.distance_beside(())

    def distance_beside(self, indices: Iterable[int]) -> float:
        """Distance to the optimum along all parameters but these, in standard errors,
        over the noise where the values scatter by more than their sigma.

        A step along a direction that only the bounds determine would leave the bounds;
        without such directions, parameters at a bound may seem free to move. Both
        distances are upper limits.
        """
        held = np.zeros(len(self.names), bool)
        held[[*indices]] = True
        unconfined = self.unconfined.held(held)
        decrement = float(unconfined.newton_decrement(unconfined.movable()))
        if self.unconfined is not self.information:
            whole = self.information.held(held)
            of_whole = float(whole.newton_decrement(whole.movable()))
            decrement = min(decrement, of_whole)
        reduced = float((unconfined.residual**2).sum()) / max(self.count, 1)
        return decrement / math.sqrt(max(reduced, 1.0))

    def degrees_of_freedom(self, weights: Floats) -> list[float | None]:
        """For the variances of weighted sums of the open parameters, one per row of
        weights; None where all sigmas are known."""
        return [None] * len(weights)

    @property
    def combinations(self) -> tuple[Combination, ...]:
        """What is determined in place of single parameters."""
        combinations = self.identifiability.combinations
        if not combinations:
            return ()
        statements = self.identifiability.weights_of_determined()
        weights = [statements[combination.expression] for combination in combinations]
        degrees = self.degrees_of_freedom(np.array(weights))
        return tuple(
            replace(combination, dof=dof)
            for combination, dof in zip(combinations, degrees, strict=True)
        )

    @cached_property
    def _dof_of_parameters(self) -> list[float | None]:
        """Degrees of freedom of the standard errors of the open parameters."""
        return self.degrees_of_freedom(np.eye(int(self.open.sum())))

    def _among_open(self, index: int) -> int:
        """Place of an open parameter among the open ones."""
        return int(self.open[:index].sum())

    def classified(self, index: int) -> tuple[float | None, Verdict, float | None]:
        """Standard error of a free parameter, where there is one, its verdict, and the
        degrees of freedom of the error."""
        if self.at_bound[index]:
            return None, Verdict.AT_BOUND, None
        among_open = self._among_open(index)
        stderr, verdict = self.identifiability.classified(among_open)
        if stderr is None:
            return None, verdict, None
        if verdict == Verdict.DETERMINED:
            _, verdict_of_data = self.identifiability_of_data.classified(among_open)
            if verdict_of_data != verdict:
                verdict = Verdict.PRIOR
        return stderr, verdict, self._dof_of_parameters[among_open]

    def shifts(self, gradients: Mapping[str, Floats]) -> dict[str, Floats]:
        """Shifts of the open parameters from the estimates to the true values, by
        condition; `gradients` are J^T times the change of the residuals by each
        condition."""
        information = self.unconfined.only(self.open)
        return {
            condition: information.response(gradient[self.open])
            for condition, gradient in gradients.items()
        }

    def shifts_of_determined(
        self, by_condition: Mapping[str, Floats]
    ) -> dict[str, dict[str, float]]:
        """Shifts of what is determined, by parameter or combination and by condition,
        from those of the open parameters."""
        return {
            name: {
                condition: float(row @ shift)
                for condition, shift in by_condition.items()
            }
            for name, row in self.identifiability.weights_of_determined().items()
        }

    def stderr(self, weights: Floats) -> float:
        """Standard error of a weighted sum of the open parameters."""
        covariance = self.identifiability.covariance
        return math.sqrt(weights @ covariance @ weights)

    def error_of(self, index: int) -> float:
        """Standard error of a parameter; infinite where nothing is known of it."""
        if not self.open[index]:
            return math.inf
        among_open = self._among_open(index)
        if self.identifiability.unseen[among_open]:
            return math.inf
        return math.sqrt(self.identifiability.covariance[among_open, among_open])

    def in_all(self, weights: Floats) -> Floats:
        """Weights of the open parameters as those of all."""
        in_all = np.zeros(len(self.typical))
        in_all[self.open] = weights
        return in_all

    def rooms(self) -> dict[str, float]:
        """Widths of the intervals between the bounds of the parameters, over their
        typical sizes, by name."""
        information = self.information
        widths = (information.upper - information.lower) / self.typical
        return dict(zip(self.names, widths.tolist(), strict=True))
