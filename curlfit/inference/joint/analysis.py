"""What several throws together determine: covariance, verdicts, systematic errors; and whether they
agree.

The estimate that each throw alone would give, to first order about the joint optimum, is compared
with the shared one (Cochran 1954). Where sigma is not given it is that of the throw alone, since
the joint fit takes the misfit to a common value for noise. The spread between throws is that at
which the differences are as large as expected (Paule and Mandel 1982).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from curlfit.inference.fit.covariance import (
    CONVERGED,
    Covariance,
    Factors,
    Sigmas,
    robust_jacobians,
)
from curlfit.inference.fit.residuals import ResidualStatistics, residual_statistics
from curlfit.inference.fit.result import Estimate
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.systematics import calibrations_of, residual_changes
from curlfit.inference.identifiability import (
    Bounded,
    Combination,
    Identifiability,
    r_factor,
    r_factors,
    stderr_of,
    visible,
)
from curlfit.inference.joint.result import Difference
from curlfit.inference.joint.solver import JointSolution, Layout
from curlfit.inference.least_squares import Indices, residual_sigma
from curlfit.inference.likelihood import predict_many
from curlfit.inference.problem import Problem
from curlfit.numerics.arrays import Booleans, Floats


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
        bounded = Bounded(self.solution.values, lower, upper)

        def factors_of(jacobians: Floats) -> Factors:
            rows = layout.widened(r_factors(jacobians, each.residual))
            whole = r_factor(rows.reshape(-1, rows.shape[-1]))
            return Factors.of(whole, bounded, typical, layout.penalty)

        factors = estimator = factors_of(each.jacobian)
        if rounds.loss != "linear":
            about = rounds.problems, each, self.statistics.residual, rounds.loss
            estimator = factors_of(robust_jacobians(*about))
        offset = layout.joined(np.stack([one.offset for one in rounds.throws]))
        by_channel = layout.widened(r_factor(each.jacobian))
        return Covariance.of(
            layout.names,
            Bounded(*(part + offset for part in bounded)),
            typical,
            layout.free,
            (factors, estimator),
            by_channel.reshape(-1, *by_channel.shape[2:]),
            Sigmas(self.statistics.number.ravel(), rounds.unknown.ravel(), rounds.loss),
        )

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


_HALVINGS = 60  # of the interval that contains the variance between throws


class _Alone(NamedTuple):
    """What a throw alone determines, to first order about the joint optimum."""

    step: Floats
    """from the joint optimum to that of the throw, in typical sizes"""
    right: Floats
    """determined directions in typical sizes, as orthonormal rows"""
    singular: Floats
    """1 over the standard errors along them"""

    @classmethod
    def of(cls, jacobian: Floats, residual: Floats, bounded: Bounded, typical: Floats) -> _Alone:
        """`jacobian`, of the weighted residuals, is in typical sizes, shape (channels, n, p)."""
        flat = jacobian.reshape(-1, len(typical))
        left, singular, right = np.linalg.svd(flat, full_matrices=False)
        seen = visible(singular) & ~bounded.confine(right, singular, typical)
        left, singular, right = left[:, seen], singular[seen], right[seen]
        return cls(-right.T @ (left.T @ residual.ravel() / singular), right, singular)

    def stderr(self, weights: Floats) -> float | None:
        """Standard error of a weighted sum; None where the throw does not determine it."""
        return stderr_of(weights, self.right, self.singular)


def differences_of(
    solution: JointSolution,
    layout: Layout,
    coefficients: Mapping[str, Estimate],
    combinations: Sequence[Combination],
    problems: Problem,
    unknown: Booleans,
) -> tuple[Difference, ...]:
    """Differences of the shared coefficients as each throw alone gives them, to first order.

    Parameters
    ----------
    unknown : whether sigma was estimated from least squares, shape (throws, channels).
    """
    wanted = {
        name: ({name: 1.0}, item.value)
        for name, item in coefficients.items()
        if item.verdict in ("determined", "weak")
    } | {item.expression: (item.weights, item.value) for item in combinations}
    throws = _each_alone(solution, layout, problems, unknown)
    found = []
    for expression, (weights, value) in wanted.items():
        each: list[tuple[float, float] | None] = []
        weight = []
        for (joint, own), index in zip(throws, layout.index, strict=True):
            free = layout.free[index]
            vector = np.array([weights.get(layout.names[place], 0.0) for place in index])
            vector = (vector * layout.bounds.typical[index])[free]
            stderr, assumed = own.stderr(vector), joint.stderr(vector)
            if stderr is None or assumed is None:
                each.append(None)
                continue
            each.append((value + float(vector @ own.step), stderr))
            weight.append(assumed**-2)
        if len(weight) > 1:
            found.append(_difference(expression, each, np.array(weight)))
    return tuple(found)


def _each_alone(
    solution: JointSolution, layout: Layout, problems: Problem, unknown: Booleans
) -> list[tuple[_Alone, _Alone]]:
    """Of each throw, with the noise of the joint fit and with that of its own."""
    index, bounds, each = layout.index, layout.bounds, solution.each
    free, typical = layout.free[index], bounds.typical[index]
    jacobians = each.jacobian * typical[:, None, None]
    about = [
        (Bounded(*(part[index[throw]][free[throw]] for part in
                   (solution.values, bounds.lower, bounds.upper))), typical[throw][free[throw]])
        for throw in range(len(index))
    ]  # fmt: skip

    def analysed(scale: Floats) -> list[_Alone]:
        return [
            _Alone.of(
                jacobians[throw][..., free[throw]] / scale[throw][:, None, None],
                each.residual[throw] / scale[throw][:, None], *about[throw],
            )
            for throw in range(len(index))
        ]  # fmt: skip

    joint = analysed(np.ones(unknown.shape))
    steps = np.zeros(index.shape)
    for throw, one in enumerate(joint):
        steps[throw, free[throw]] = one.step
    left = each._replace(residual=each.residual + (jacobians @ steps[:, None, :, None])[..., 0])
    sigma = residual_sigma(left, problems, free) * problems.weight.max(-1)
    return list(zip(joint, analysed(np.where(unknown, sigma, 1.0)), strict=True))


def _difference(
    expression: str, each: Iterable[tuple[float, float] | None], shared: Floats
) -> Difference:
    """`shared` are the weights of the throws in the joint fit."""
    each = tuple(each)
    estimate, stderr = np.array([item for item in each if item is not None]).T
    variance, degrees = stderr**2, len(stderr) - 1

    def about_mean(between: float) -> tuple[float, float, float]:
        """Mean of the throws, its variance, and chi squared about it."""
        weight = 1 / (variance + between)
        mean = float(weight @ estimate / weight.sum())
        return mean, float(1 / weight.sum()), float(weight @ (estimate - mean) ** 2)

    q = about_mean(0.0)[2]
    low, high = 0.0, float(estimate.var(ddof=1)) if q > degrees else 0.0
    while about_mean(high)[2] > degrees:
        high *= 2
    for _ in range(_HALVINGS if high else 0):
        middle = (low + high) / 2
        low, high = (middle, high) if about_mean(middle)[2] > degrees else (low, middle)
    mean, of_mean, _ = about_mean(high)
    share = shared / shared.sum()
    return Difference(
        expression=expression,
        each=each,
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(high)),
        mean=mean,
        stderr=float(np.sqrt(of_mean)),
        shared_stderr=float(np.sqrt(share**2 @ (variance + high))),
    )
