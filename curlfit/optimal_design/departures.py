"""Whether what planned throws are expected to determine holds off the tangent too.

The information of a plan is that of first order. As in a fit, chi squared is compared
with its quadratic two standard errors from each coefficient and combination, and along
what is hardly determined (`probes_about`), here for data without noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curlfit.inference.fit.covariance import first_order
from curlfit.inference.fit.departures import Departures, departures_nearby, probes_about
from curlfit.inference.fit.factors import Factors, combined
from curlfit.numerics.arrays import Floats
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    clock_of,
    paths_from,
)
from curlfit.throws.throw import CHANNELS

_ROUNDING = 1e-13  # over the largest singular value
_ROWS = 256  # of a throw, each of which stands for several of a longer record


def expected_departures(
    assumed: Assumptions, throws: Sequence[PlannedThrow], factor: Floats
) -> Departures:
    """What does not hold of what throws determine to first order of the coefficients.

    Parameters
    ----------
    factor : R factor of their information on the free coefficients, in typical sizes.
    """
    if assumed.discrepancy:  # which widens errors, but bends nothing
        assumed = replace(assumed, discrepancy=0.0)
        factor = combined(*assumed.factors(throws))
    rows = np.column_stack([factor / assumed.typical, np.zeros(len(factor))])
    bounded, typical = assumed.bounded, assumed.typical
    covariance = first_order(
        assumed.names, Factors.of(rows, bounded, typical), bounded, typical
    )
    probes = probes_about(covariance, bounded)
    if not probes:
        return departures_nearby(covariance, [])
    steps = np.array([probe.point for probe in probes]) - bounded.values
    rises = np.zeros(len(probes))
    for throw in dict.fromkeys(throws):
        rises += throws.count(throw) * _rises(assumed, throw, steps)
    pairs = zip(probes, rises.tolist(), strict=True)
    departing = [(probe, rise) for probe, rise in pairs if probe.departs(rise)]
    return departures_nearby(covariance, departing)


def _rises(assumed: Assumptions, throw: PlannedThrow, steps: Floats) -> Floats:
    """Chi squared of a throw's exact data at coefficients off by these steps, where the
    initial state follows to first order; shape (steps,)."""
    (record,) = assumed.records([throw])
    clock = clock_of(assumed, throw, record.rest)
    some = np.unique(np.linspace(0, len(clock) - 1, _ROWS).round().astype(int))
    changes = np.zeros((1 + len(steps), len(assumed.parameters)))
    changes[1:, assumed.free] = steps
    typical = assumed.parameters.typical
    rows = assumed.rows(record)[:, : len(typical)]
    moved = (changes[1:] / typical) @ rows.T
    follow, *_ = np.linalg.lstsq(rows[:, assumed.state], -moved.T, rcond=_ROUNDING)
    changes[1:, assumed.state] = follow.T * typical[assumed.state]
    paths = paths_from(assumed, throw, clock[some], changes)[:, :, : len(some)]
    sigma = np.array([assumed.sigma.get(name, np.inf) for name in CHANNELS])
    off = (paths[1:] - paths[0]) / sigma[: paths.shape[1], None]
    square = np.where(np.isnan(off), np.inf, off) ** 2
    return square.sum((1, 2)) * len(clock) / len(some)
