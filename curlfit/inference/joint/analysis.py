"""What several throws together determine: covariance, verdicts, systematic errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curlfit.inference.fit.covariance import (
    CONVERGED,
    bound_warning,
    noise_dof,
    robust_jacobian,
    satterthwaite,
)
from curlfit.inference.fit.residuals import ResidualStatistics, residual_statistics
from curlfit.inference.fit.result import Estimate
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.systematics import (
    calibrations_of,
    residual_changes,
    shifts,
    shifts_by_name,
)
from curlfit.inference.identifiability import (
    Bounded,
    Identifiability,
    analyse,
    confined,
    visible,
)
from curlfit.inference.joint.solver import JointSolution, Layout
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import predict_many
from curlfit.inference.linearized_problem import LinearizedProblem, classify
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import unstacked


@dataclass(frozen=True)
class JointAnalysis:
    """First-order analysis of the joint optimum, in the joint vector of parameters."""

    rounds: Rounds
    layout: Layout
    solution: JointSolution

    @cached_property
    def paths(self) -> Floats:
        """Fitted paths in the coordinates of the problems, shape (throws, channels, n)."""
        values = self.solution.each.values
        return predict_many(self.rounds.model, values, self.rounds.problems, len(values))

    @cached_property
    def statistics(self) -> ResidualStatistics:
        """Residual statistics of all throws."""
        return residual_statistics(self.rounds.problems, self.solution.each, self.paths)

    @property
    def _bounded(self) -> Bounded:
        bounds = self.layout.bounds
        return Bounded(self.solution.values, bounds.lower, bounds.upper)

    @cached_property
    def _factor(self) -> tuple[Floats, Floats]:
        return self.solution.r_factor(self.layout)

    @cached_property
    def linearized(self) -> LinearizedProblem:
        """The joint problem, linearized at its optimum, with the priors, and without directions
        that only the bounds determine."""
        matrix, right = self._factor
        bounds = self.layout.bounds
        matrix = confined(matrix, self._bounded, bounds.typical)
        return LinearizedProblem(
            right, matrix, self.solution.values, bounds.lower, bounds.upper, bounds.typical,
            self.layout.free,
        )  # fmt: skip

    @cached_property
    def at_bound(self) -> Booleans:
        """Which parameters the data push against a bound."""
        return self.linearized.at_bound()

    @cached_property
    def _open(self) -> tuple[Booleans, Floats]:
        return self.linearized.open(self.at_bound)

    @property
    def open(self) -> Booleans:
        """Which parameters are free and not held at a bound."""
        return self._open[0]

    @cached_property
    def values(self) -> Floats:
        """The joint vector in the coordinates of the data."""
        offsets = np.stack([one.offset for one in self.rounds.throws])
        return self.solution.values + self.layout.joined(offsets)

    @property
    def converged(self) -> bool:
        """Whether the search ended, and at an optimum."""
        whole = self.linearized._replace(jacobian=self._factor[0])
        distance = self.linearized.distance(int(self.statistics.number.sum()), whole)
        return bool(self.solution.success and distance < CONVERGED)

    @property
    def status(self) -> str:
        """How the search ended."""
        ended = "converged" if self.converged else "not converged"
        return f"{ended} ({self.solution.steps} steps)"

    @cached_property
    def _matrix(self) -> Floats:
        """Matrix of the covariance: its normal equations are those of the estimator, which under a
        robust loss are not those of the search."""
        loss = self.rounds.loss
        if loss == "linear":
            return self._factor[0]
        throws = zip(
            unstacked(self.rounds.problems), unstacked(self.solution.each),
            self.statistics.residual, strict=True,
        )  # fmt: skip
        jacobians = np.stack([robust_jacobian(*one, loss) for one in throws])
        return self.solution.r_factor(self.layout, jacobians)[0]

    def _analysed(self, matrix: Floats) -> Identifiability:
        open_, slack = self._open
        names = np.array(self.layout.names)[open_]
        typical = self.layout.bounds.typical[open_]
        bounded = Bounded(*(part[open_] for part in self._bounded))
        values = self.values[open_]
        return analyse(matrix[:, open_], list(names), values, typical, slack, bounded)

    @cached_property
    def identifiability(self) -> Identifiability:
        """Of the open parameters; the combinations have degrees of freedom."""
        known = self._analysed(self._matrix)
        determined = known.determined()
        weights = [determined[item.expression] for item in known.combinations]
        dof = self._degrees_of_freedom(np.reshape(weights, (-1, len(known.names))), known)
        sums = (replace(item, dof=n) for item, n in zip(known.combinations, dof, strict=True))
        return replace(known, combinations=tuple(sums))

    @cached_property
    def of_data(self) -> Identifiability:
        """The same without the priors, whose rows are the last."""
        matrix, count = self._matrix, len(self.layout.names)
        return self._analysed(matrix if self.layout.penalty is None else matrix[:-count])

    def _degrees_of_freedom(self, weights: Floats, known: Identifiability) -> list[float | None]:
        """Of the variance of weighted sums of the open parameters, one sum per row."""
        open_, slack = self._open
        covariance = known.covariance - slack @ slack.T
        column = np.cumsum(open_) - 1
        parts, dof = [], []
        rounds, numbers = self.rounds, self.statistics.number
        for index, jacobian, number, unknown in zip(
            self.layout.index, self.solution.each.jacobian, numbers, rounds.unknown, strict=True
        ):
            own = open_[index]
            rows = covariance[column[index[own]]]
            of_channel = jacobian[..., own]
            leverage = (of_channel @ rows[:, column[index[own]]] * of_channel).sum(-1)
            dof.append(noise_dof(number, leverage, unknown, rounds.loss))
            effect = rows @ weights.T
            information = of_channel.mT @ of_channel
            parts.append(np.einsum("ks,ckl,ls->cs", effect, information, effect))
        total = ((weights @ covariance) * weights).sum(-1)
        of_priors = np.maximum(total - np.concatenate(parts).sum(0), 0.0)
        variances = np.concatenate([*parts, of_priors[None]])
        return [satterthwaite(each, np.append(dof, np.inf)) for each in variances.T]

    @cached_property
    def _dof(self) -> list[float | None]:
        """Degrees of freedom of the open parameters."""
        known = self.identifiability
        return self._degrees_of_freedom(np.eye(len(known.names)), known)

    def estimate(self, item: Estimate, joint: int) -> Estimate:
        """The estimate of a parameter of a throw, with the index `joint` in the joint vector."""
        if item.verdict == "fixed":
            return item
        known, stuck = self.identifiability, bool(self.at_bound[joint])
        index = int(np.cumsum(self.open)[joint]) - 1 if self.open[joint] else -1
        stderr, verdict = classify(item.typical, stuck, known, index)
        reason = item.reason if verdict == item.verdict else ""
        if verdict == "determined":
            alone = classify(item.typical, stuck, self.of_data, index)
            verdict = verdict if alone[1] == "determined" else "prior"
        return replace(
            item, value=float(self.values[joint]), stderr=stderr, verdict=verdict, reason=reason,
            dof=None if stderr is None else self._dof[index],
        )  # fmt: skip

    def bound_warnings(self) -> list[str]:
        """Warnings about parameters at a bound."""
        layout, known = self.layout, self.identifiability
        return [
            bound_warning(name, layout.bounds.lower[j], layout.bounds.upper[j], known)
            for j, name in enumerate(layout.names)
            if self.at_bound[j]
        ]

    def shifts(self, widths: Mapping[str, float]) -> dict[str, dict[str, float]]:
        """Shifts by parameter or combination due to conditions common to all throws."""
        each, layout, rounds = self.solution.each, self.layout, self.rounds
        gradients = {}
        changes = residual_changes(
            rounds.model, rounds.problems, each.values, self.paths, widths, rounds.loss,
            len(each.values), calibrations_of(rounds.throws, jointly=True),
        )  # fmt: skip
        for name, change in changes.items():
            total = np.zeros(len(layout.names))
            np.add.at(total, layout.index, np.einsum("tcn,tcnp->tp", change, each.jacobian))
            gradients[name] = total[self.open]
        typical = layout.bounds.typical[self.open]
        found = shifts(self.linearized.jacobian[:, self.open], gradients, typical)
        return shifts_by_name(self.identifiability, found)

    def information(self, own: Indices) -> dict[str, Any]:
        """Information of all throws on some parameters, with the other open ones projected out."""
        linearized = self.linearized
        others = self.open.copy()
        others[own] = False
        basis, singular, _ = np.linalg.svd(
            linearized.jacobian[:, others] * linearized.typical[others], full_matrices=False
        )
        basis = basis[:, visible(singular)]
        jacobian = linearized.jacobian[:, own]
        jacobian = jacobian - basis @ (basis.T @ jacobian)
        return {
            "gradient": (-linearized.residual @ jacobian).tolist(),
            "matrix": (jacobian.T @ jacobian).tolist(),
        }

    def of_throw(self, throw: int, names: Sequence[str]) -> dict[str, Any]:
        """Covariance and null directions of the parameters of a throw, by its own names."""
        known = self.identifiability
        joint = np.array(self.layout.names)[self.layout.index[throw]]
        own = dict(zip(map(str, joint), names, strict=True))
        rows = [row for row, name in enumerate(known.names) if name in own]
        directions = (
            {own[name]: weight for name, weight in item.items() if name in own}
            for item in known.null_directions
        )
        return {
            "covariance": {
                "names": [own[known.names[row]] for row in rows],
                "matrix": known.covariance[np.ix_(rows, rows)].tolist(),
            },
            "null_directions": tuple(filter(None, directions)),
        }
