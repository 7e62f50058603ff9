"""A measured curl that a law without transverse friction leaves to the heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from curlfit.dynamics.law_structure import can_curl
from curlfit.friction import check_load
from curlfit.inference.fit.result import FitResult
from curlfit.throws.motion import SURE, motion_of

_CLEAR = 0.2  # m; a smaller curl of a path may be that of the ice


def curl_warnings(fits: Sequence[FitResult]) -> list[str]:
    """A warning if throws fitted with one law were measured to curl, and the law cannot.

    A slope of the ice among the parameters may cause the curl instead.
    """
    first = fits[0]
    law, load = first.law_class, check_load(first.load)
    # mypy takes a class for one of its instances, which compare by value and have no hash.
    if can_curl(law, load, first.stone) or first.model.has_slope:  # type: ignore[arg-type]
        return []
    curls = [curl for fit in fits if (curl := measured_curl(fit)) is not None]
    if not curls:
        return []
    if len(fits) == 1:
        side = "right" if curls[0] > 0 else "left"
        what = f"the measured curl of {abs(curls[0]):.2f} m to the {side} is"
    else:
        what = f"the measured curls of {len(curls)} of {len(fits)} throws are"
    in_heading = first.parameters["heading"].verdict != "fixed"
    where = ["in the heading"] * in_heading
    where += ["in the residuals"] * (bool(first.rms) or not in_heading)
    return [
        f"the {first.law} law cannot curl a stone: {what} {' and '.join(where)}; "
        "`--law front-back` has friction that curls"
    ]


def with_curl_warning(fit: FitResult) -> FitResult:
    """The fit of a single throw with that warning, if any."""
    warnings = curl_warnings([fit])
    return replace(fit, warnings=(*fit.warnings, *warnings)) if warnings else fit


def measured_curl(fit: FitResult) -> float | None:
    """Curl in m to the right as measured, by an event or by the path; None if it is not clear."""
    across = [item for item in fit.events if item["quantity"] == "x"]
    if across:
        far = max(across, key=lambda item: abs(item["value"]))
        return far["value"] if abs(far["value"]) > SURE * far["sigma"] else None
    motion = motion_of(fit.throw) if {"x", "y"} <= fit.rms.keys() else None
    if motion is None or abs(motion.curl) - SURE * motion.curl_error < _CLEAR:
        return None
    return -motion.curl
