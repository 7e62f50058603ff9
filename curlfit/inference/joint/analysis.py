"""What several throws together determine: covariance, verdicts, systematic errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from curlfit.inference.fit.covariance import (
    CONVERGED,
    Covariance,
    Factors,
    Sigmas,
    covariances,
    robust_jacobians,
)
from curlfit.inference.fit.residuals import ResidualStatistics, residual_statistics
from curlfit.inference.fit.result import Estimate
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.systematics import calibrations_of, residual_changes
from curlfit.inference.identifiability import Bounded, Identifiability, r_factor, r_factors, visible
from curlfit.inference.joint.solver import JointSolution, Layout
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import predict_many
from curlfit.inference.priors import Penalty
from curlfit.numerics.arrays import Floats


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

    @cached_property
    def covariance(self) -> Covariance:
        """Of the joint vector: the throws' channels are those of one problem, whose Jacobian is
        given by R factors."""
        layout, rounds, each = self.layout, self.rounds, self.solution.each
        lower, upper, typical = layout.bounds
        bounded = Bounded(self.solution.values[None], lower[None], upper[None])
        penalty = layout.penalty and Penalty(*(part[None] for part in layout.penalty))

        def factors_of(jacobians: Floats) -> Factors:
            rows = layout.widened(r_factors(jacobians, each.residual))
            whole = r_factor(rows.reshape(1, -1, rows.shape[-1]))
            return Factors.of(whole, bounded, typical, penalty)

        factors = estimator = factors_of(each.jacobian)
        if rounds.loss != "linear":
            about = rounds.problems, each, self.statistics.residual, rounds.loss
            estimator = factors_of(robust_jacobians(*about))
        offset = layout.joined(np.stack([one.offset for one in rounds.throws]))
        by_channel = layout.widened(r_factor(each.jacobian))
        (found,) = covariances(
            layout.names,
            Bounded(*(part + offset for part in bounded)),
            typical,
            layout.free[None],
            factors,
            estimator,
            by_channel.reshape(1, -1, *by_channel.shape[2:]),
            Sigmas(
                self.statistics.number.reshape(1, -1), rounds.unknown.reshape(1, -1), rounds.loss
            ),
        )  # fmt: skip
        return found

    @property
    def converged(self) -> bool:
        """Whether the search ended, and at an optimum."""
        return bool(self.solution.success and self.covariance.distance < CONVERGED)

    @property
    def status(self) -> str:
        """How the search ended."""
        ended = "converged" if self.converged else "not converged"
        return f"{ended} ({self.solution.steps} steps)"

    @cached_property
    def identifiability(self) -> Identifiability:
        """Of the open parameters; the combinations have degrees of freedom."""
        found = self.covariance
        return replace(found.identifiability, combinations=found.combinations)

    def estimate(self, item: Estimate, joint: int) -> Estimate:
        """The estimate of a parameter of a throw, with the index `joint` in the joint vector."""
        if item.verdict == "fixed":
            return item
        stderr, verdict, dof = self.covariance.classified(joint)
        return replace(
            item, value=float(self.covariance.values[joint]), stderr=stderr, verdict=verdict,
            reason=item.reason if verdict == item.verdict else "", dof=dof,
        )  # fmt: skip

    def shifts(self, widths: Mapping[str, float]) -> dict[str, dict[str, float]]:
        """Shifts by parameter or combination due to conditions common to all throws."""
        each, layout, rounds = self.solution.each, self.layout, self.rounds
        gradients = {}
        changes = residual_changes(
            rounds.model, rounds.problems, each.values, self.paths, widths, rounds.loss,
            len(each.values), calibrations_of(rounds.throws, jointly=True),
        )  # fmt: skip
        for name, change in changes.items():
            gradients[name] = np.zeros(len(layout.names))
            along = np.einsum("tcn,tcnp->tp", change, each.jacobian)
            np.add.at(gradients[name], layout.index, along)
        return self.covariance.shifts(gradients)

    def information(self, own: Indices) -> dict[str, Any]:
        """Information of all throws on some parameters, with the other open ones projected out."""
        found = self.covariance
        matrix, residual = found.factor[:, :-1], found.factor[:, -1]
        others = found.open.copy()
        others[own] = False
        basis, singular, _ = np.linalg.svd(
            matrix[:, others] * found.typical[others], full_matrices=False
        )
        basis = basis[:, visible(singular)]
        jacobian = matrix[:, own] - basis @ (basis.T @ matrix[:, own])
        return {
            "gradient": (-residual @ jacobian).tolist(),
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
