"""Systematic errors of planned throws, and what cancels them.

Where the ice slopes, throws with opposite spins or in opposite directions are affected in opposite
ways. For throws as planned, and with equal shares of them thrown otherwise, the shift of the
coefficients by each condition is that of the joint least-squares fit, to first order
(`curlfit.inference.fit.systematics`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from curlfit.inference.fit.systematics import shifts, widths_of
from curlfit.inference.parameters import START
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    combined,
    marginal_factor,
    record_information,
    standard_error,
)
from curlfit.optimal_design.result import Scenario

SCENARIOS = {
    "as planned": ((1, 0.0),),
    "both spins": ((1, 0.0), (-1, 0.0)),
    "both directions": ((1, 0.0), (1, math.pi)),
    "both spins and directions": ((1, 0.0), (-1, 0.0), (1, math.pi), (-1, math.pi)),
}
"""Sense of spin and heading (rad) of equal shares of the throws."""


def scenarios(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    quantities: Mapping[str, Mapping[str, float]],
) -> tuple[Scenario, ...]:
    """Expected errors of throws as planned, and with equal shares of them thrown otherwise.

    `quantities` are coefficients and combinations as weights.
    """
    typical, n = assumed.typical, len(assumed.free)
    rows = {name: assumed.weights(weights) for name, weights in quantities.items()}
    count, widths = Counter(throws), widths_of(assumed.model)
    ways = SCENARIOS["both spins and directions"]
    varied = [
        one._replace(omega0=sense * one.omega0, heading=heading)
        for one in count
        for sense, heading in ways
    ]
    records = record_information(assumed, varied, widths)
    conditions = len(assumed.values) + len(START) + np.arange(len(widths))
    columns = np.concatenate([assumed.free, conditions])
    factors = [marginal_factor(assumed, one, columns) for one in records]
    found = []
    for name, chosen in SCENARIOS.items():
        whole = combined(
            [
                factors[len(ways) * index + ways.index(way)] * math.sqrt(number / len(chosen))
                for index, number in enumerate(count.values())
                for way in chosen
            ]
        )
        factor = whole[:, :n]
        gradients = {
            condition: factor.T @ whole[:, n + k] / typical for k, condition in enumerate(widths)
        }
        by_condition = shifts(factor / typical, gradients, typical)
        by_quantity = {
            quantity: {
                condition: float(row @ (shift / typical))
                for condition, shift in by_condition.items()
            }
            for quantity, row in rows.items()
        }
        stderr = {quantity: standard_error(factor, row) for quantity, row in rows.items()}
        found.append(Scenario(name, stderr, by_quantity))
    return tuple(found)
