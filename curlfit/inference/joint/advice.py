"""How a joint fit ended, and its warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from curlfit.foreign import counted
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.summary import IMPLAUSIBLE
from curlfit.inference.joint.effects import slope_warnings
from curlfit.inference.joint.result import JointResult, Variation, warnings_of
from curlfit.inference.least_squares import Solution
from curlfit.numerics.arrays import Booleans


def with_throws(
    result: JointResult, throws: Sequence[FitResult], solution: Solution
) -> JointResult:
    """The result with its throws, and with the status and the warnings that follow from
    them; where the search for the optimum of all failed, none of them has converged."""
    implausible = [one for one in throws if one.status.startswith(IMPLAUSIBLE)]
    failed = [
        one.status for one in throws if not one.converged and one not in implausible
    ]
    steps = counted(int(solution.steps[0]), "step")
    if not solution.success.all():
        failed.append(f"not converged ({steps})")
    if failed:
        throws = [
            one
            if one in implausible
            else replace(one, converged=False, status=failed[0])
            for one in throws
        ]
    result = replace(
        result,
        throws=tuple(throws),
        converged=not (failed or implausible),
        status=". ".join(f"{one.data['file']}: {one.status}" for one in implausible)
        or (failed or [f"converged ({steps})"])[0],
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


def _of_spins(result: JointResult) -> list[str]:
    """A warning if throws of opposite spins differ."""
    # For a throw without a path the curl is at most one number, which the
    # heading absorbs.
    paths = any(one.rms for one in result.throws)
    senses = np.array([one.parameters["omega0"].value > 0 for one in result.throws])
    differ = any(
        _differs_by_spin(item, senses) for item in result.variation if item.significant
    )
    if not differ or not paths or result.throws[0].model.has_slope:
        return []
    return [
        "throws of opposite spins differ, as they do on ice that is not level; "
        "`--free slope_x` fits a common slope"
    ]


def warnings_of_slopes(result: JointResult) -> list[str]:
    """Warnings about groups that change differently along a trend."""
    if result.means is None or not result.converged:
        return []
    friction = next(one.value for one in result.groups if one.parameter == "friction")
    trend_by = result.means.trend_by
    return slope_warnings(result.slope_differences, friction, trend_by)


def _differs_by_spin(item: Variation, counter_clockwise: Booleans) -> bool:
    """Whether throws of the same sense of spin agree much better than all throws do."""
    known = np.array([one is not None for one in item.each])
    value, error = np.array([one for one in item.each if one is not None]).T
    sense = counter_clockwise[known]

    def chi_squared(rows: Booleans) -> float:
        weights = error[rows] ** -2
        return float(
            weights @ (value[rows] - weights @ value[rows] / weights.sum()) ** 2
        )

    within = sum(chi_squared(rows) for rows in (sense, ~sense) if rows.any())
    return within < chi_squared(np.ones_like(sense)) / 2


def _of_equality(result: JointResult) -> list[str]:
    """Warnings about equal coefficients that differ from throw to throw."""
    return [
        f"{item.expression} varies between throws by more than its errors "
        f"({item.p_text}); its standard error is that of the mean over such throws, "
        "and large residuals of single throws may be due to the common value rather "
        "than to their data"
        for item in reversed(result.variation)
        if item.significant and not result.varies
    ]
