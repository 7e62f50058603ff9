"""How a joint fit ended, and its warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import counted
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.result import FitResult
from curlfit.inference.solve.least_squares import Solution
from curlfit.inference.together.effects import slope_warnings
from curlfit.inference.together.result import JointResult, Variation, warnings_of
from curlfit.numerics.arrays import Booleans


def with_throws(
    result: JointResult, throws: Sequence[FitResult], solution: Solution
) -> JointResult:
    """The result with its throws, and with the status and the warnings that follow from
    them; where the search for the optimum of all failed, none of them has converged."""
    refused = [throw for throw in throws if any(w.is_refusal for w in throw.warnings)]
    failures = [
        throw.status for throw in throws if not throw.converged and throw not in refused
    ]
    steps = counted(int(solution.steps[0]), "step")
    if not solution.success.all():
        failures.append(f"not converged ({steps})")
    status = f"converged ({steps})"
    if failures:
        status = failures[0]
        throws = [
            throw
            if throw in refused
            else replace(throw, converged=False, status=status)
            for throw in throws
        ]
    if refused:
        status = f"{refused[0].data.file}: {refused[0].status}"
        if len(refused) > 1:
            other_throws = counted(len(refused) - 1, "other throw")
            status += f". {other_throws} cannot be used either"
    result = replace(
        result,
        throws=tuple(throws),
        converged=not (failures or refused),
        status=status,
    )
    return replace(
        result,
        warnings=(
            *_of_spins(result),
            *_of_equality(result),
            *warnings_of_slopes(result),
            *curl_warnings(throws),
            *warnings_of(throws),
        ),
    )


def _of_spins(result: JointResult) -> list[Finding]:
    """A warning if throws of opposite spins differ."""
    # For a throw without a path the curl is at most one number, which the
    # heading absorbs.
    paths = any(throw.rms for throw in result.throws)
    spins = np.array([throw.parameters["omega0"].value for throw in result.throws])
    differ = any(
        _differs_by_spin(variation, spins > 0)
        for variation in result.variation
        if variation.significant
    )
    if not differ or not paths or result.throws[0].model.has_slope:
        return []
    remedy = Remedy("common-slope", Option("free", "slope_x"))
    return [Finding.warning("spins-differ", remedy)]


def warnings_of_slopes(result: JointResult) -> list[Finding]:
    """Warnings about groups that change differently along a trend."""
    if result.means is None or not result.converged:
        return []
    friction = next(
        effect.value for effect in result.groups if effect.parameter == "friction"
    )
    trend_by = result.means.trend_by
    return slope_warnings(result.slope_differences, friction, trend_by)


def _differs_by_spin(variation: Variation, counter_clockwise: Booleans) -> bool:
    """Whether throws of the same sense of spin agree much better than all throws do."""
    gives_one = np.array([estimate is not None for estimate in variation.each])
    estimates = np.array([pair for pair in variation.each if pair is not None])
    value, error = estimates.T
    sense = counter_clockwise[gives_one]

    def chi_squared(rows: Booleans) -> float:
        weights = error[rows] ** -2
        return float(
            weights @ (value[rows] - weights @ value[rows] / weights.sum()) ** 2
        )

    within = sum(chi_squared(rows) for rows in (sense, ~sense) if rows.any())
    return within < chi_squared(np.ones_like(sense)) / 2


def _of_equality(result: JointResult) -> list[Finding]:
    """Warnings about equal coefficients that differ from throw to throw."""
    if result.varies:
        return []
    return [
        Finding.warning(
            "varies-between-throws",
            expression=variation.expression,
            p=variation.p_value,
        )
        for variation in reversed(result.variation)
        if variation.significant
    ]
