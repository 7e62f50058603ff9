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
from typing import Any

import numpy as np

from curlfit.inference.fit.systematics import shifts, widths_of
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.optimal_design.information import (
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
    model: Model,
    values: Floats,
    throws: Sequence[PlannedThrow],
    free: Booleans,
    sigma: Mapping[str, float],
    quantities: Mapping[str, Mapping[str, float]],
    record: Mapping[str, Any],
) -> tuple[Scenario, ...]:
    """Expected errors of throws as planned, and with equal shares of them thrown otherwise.

    Parameters
    ----------
    values : of all coefficients; `free` those that are estimated.
    sigma : noise by channel.
    quantities : coefficients and combinations as weights.
    record : `until` and `channels` of `record_information`.
    """
    law, load = model.law, model.load
    items = law.coefficients()
    typical = np.array([item.typical for item in items])[free]
    names = [item.name for item, take in zip(items, free, strict=True) if take]
    rows = {
        quantity: np.array([weights.get(one, 0.0) for one in names])
        for quantity, weights in quantities.items()
    }
    count, widths = Counter(throws), widths_of(model)
    ways = SCENARIOS["both spins and directions"]
    varied = [
        one._replace(omega0=sense * one.omega0, heading=heading)
        for one in count
        for sense, heading in ways
    ]
    records = record_information(law, load, values, varied, widths=widths, **record)
    first = records[0].factors.shape[-1] - records[0].shapes - len(widths)
    conditions = first + np.arange(len(widths))
    columns = np.concatenate([np.flatnonzero(free), conditions])
    factors = [marginal_factor(law, one, sigma, columns) for one in records]
    found = []
    for name, chosen in SCENARIOS.items():
        whole = combined(
            [
                factors[len(ways) * index + ways.index(way)] * math.sqrt(number / len(chosen))
                for index, number in enumerate(count.values())
                for way in chosen
            ]
        )
        factor = whole[:, : len(names)]
        by_condition = shifts(
            factor / typical,
            {
                condition: factor.T @ whole[:, len(names) + row] / typical
                for row, condition in enumerate(widths)
            },
            typical,
        )
        by_quantity = {
            quantity: {condition: float(row @ shift) for condition, shift in by_condition.items()}
            for quantity, row in rows.items()
        }
        stderr = {quantity: standard_error(factor, row * typical) for quantity, row in rows.items()}
        found.append(Scenario(name, stderr, by_quantity))
    return tuple(found)
