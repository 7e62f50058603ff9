"""Heterogeneity of throws that were fitted together.

The estimate that each throw alone would give, to first order about the joint optimum, is compared
with the shared one (Cochran 1954; the spread between throws by DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtrc

from curlfit.inference.fit.result import Estimate
from curlfit.inference.identifiability import Combination, visible
from curlfit.inference.joint.result import Difference
from curlfit.inference.joint.solver import JointSolution, Layout
from curlfit.numerics.arrays import Floats


def differences_of(
    solution: JointSolution,
    layout: Layout,
    coefficients: Mapping[str, Estimate],
    combinations: Sequence[Combination],
) -> tuple[Difference, ...]:
    """Differences of the shared coefficients as each throw alone gives them, to first order."""
    wanted = {
        name: ({name: 1.0}, item.value)
        for name, item in coefficients.items()
        if item.verdict in ("determined", "weak")
    } | {item.expression: (item.weights, item.value) for item in combinations}
    found = []
    for expression, (weights, value) in wanted.items():
        each: list[tuple[float, float] | None] = []
        for throw, index in enumerate(layout.index):
            vector = np.array([weights.get(layout.names[joint], 0.0) for joint in index])
            each.append(_alone(solution, layout, throw, vector, value))
        usable = np.array([item for item in each if item is not None])
        if len(usable) > 1:
            found.append(_difference(expression, each, usable))
    return tuple(found)


def _alone(
    solution: JointSolution, layout: Layout, throw: int, vector: Floats, value: float
) -> tuple[float, float] | None:
    index, each = layout.index[throw], solution.each
    free, typical = layout.free[index], layout.bounds.typical[index]
    jacobian = each.jacobian[throw].reshape(-1, len(index))[:, free] * typical[free]
    left, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    seen = visible(singular)
    weights = (vector * typical)[free]
    along = right[seen] @ weights
    if np.linalg.norm(weights - right[seen].T @ along) > 1e-3 * np.linalg.norm(weights):
        return None  # this throw does not determine it
    step = -(left[:, seen].T @ each.residual[throw].reshape(-1)) / singular[seen]
    return value + float(along @ step), float(np.linalg.norm(along / singular[seen]))


def _difference(
    expression: str, each: Sequence[tuple[float, float] | None], usable: Floats
) -> Difference:
    estimate, variance = usable[:, 0], usable[:, 1] ** 2
    weight = 1 / variance
    mean = float(weight @ estimate / weight.sum())
    q = float(weight @ (estimate - mean) ** 2)
    degrees = len(usable) - 1
    between = max(0.0, (q - degrees) / (weight.sum() - (weight**2).sum() / weight.sum()))
    total = 1 / (variance + between)
    return Difference(
        expression=expression,
        each=tuple(each),
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(between)),
        mean=float(total @ estimate / total.sum()),
        stderr=float(1 / np.sqrt(total.sum())),
    )
