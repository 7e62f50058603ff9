"""Tables as CSV: estimates, the path with its residuals, candidates of a comparison."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from curlfit.foreign import csv_lines
from curlfit.inference.derived import Derived, to_its_side
from curlfit.inference.fit.result import Estimate
from curlfit.inference.identifiability import Combination

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult

_CANDIDATE = (
    "rank", "law", "load", "signs_free", "converged", "n_parameters", "bic", "delta_bic", "aicc",
    "delta_aicc", "log_evidence", "delta_evidence", "weight", "curl_explained", "follows",
)  # fmt: skip


class Row(NamedTuple):
    """An estimate, a determined combination or a derived quantity, for a table."""

    name: str
    value: float | None
    """None where it is not identifiable"""
    stderr: float | None
    systematic: float | None
    low_95: float | None
    high_95: float | None
    dof: float | None
    verdict: str
    unit: str
    prior: str
    symbol: str
    """LaTeX; empty where it has none of its own"""
    weights: dict[str, float]
    """of a combination"""
    meaning: str
    """of a quantity of the path"""

    @property
    def cells(self) -> tuple[Any, ...]:
        """What of it is in a CSV table: all up to the prior."""
        return tuple(self)[:10]


def rows_of(result: FitResult | JointResult, *, in_words: bool = False) -> list[Row]:
    """Coefficients first, then determined combinations, other parameters and derived quantities.

    With `in_words`, quantities of the path are positive, their meaning names the side.
    """
    errors, found = result.systematics.errors, []
    estimates = result.coefficients
    sums = {item.expression: item for item in result.combinations}
    derived = {item.expression: item for item in result.derived}
    others = getattr(result, "parameters", {})
    others = others if isinstance(others, dict) else {}
    quoted = getattr(result, "quantities", {})
    if in_words:
        quoted = {name: to_its_side(item) for name, item in quoted.items()}
    everything: dict[str, Estimate | Combination | Derived] = {
        **estimates, **sums, **{k: v for k, v in others.items() if k not in estimates}, **derived,
        **quoted,
    }  # fmt: skip
    for name, item in everything.items():
        low, high = item.interval() or (None, None)
        verdict = "determined" if isinstance(item, Combination) else item.verdict
        found.append(
            Row(
                name=name,
                value=None if verdict == "not identifiable" else item.value,
                stderr=item.stderr,
                systematic=item.systematic if isinstance(item, Derived) else errors.get(name),
                low_95=low,
                high_95=high,
                dof=item.dof,
                verdict=verdict,
                unit="" if isinstance(item, Combination) else item.unit,
                prior=item.prior if isinstance(item, Estimate) else "",
                symbol=item.symbol if isinstance(item, Estimate) else "",
                weights=item.weights if isinstance(item, Combination) else {},
                meaning=item.meaning if isinstance(item, Derived) else "",
            )
        )
    return found


def parameters_csv(result: FitResult | JointResult) -> str:
    """The estimates of a fit as CSV in SI units, one per row; empty cells where a number is not
    determined. For a joint fit with the parameters of each throw; the first column names the throw.
    """
    throws: Sequence[FitResult] = getattr(result, "throws", ())
    head, rows = Row._fields[:10], rows_of(result)
    if not throws:
        return csv_lines([head, *(row.cells for row in rows)])
    lines = [("all", *row.cells) for row in rows]
    shared = {row.name for row in rows}
    for one in throws:
        own = (row for row in rows_of(one) if row.name not in shared)
        lines += [(one.data["file"], *row.cells) for row in own]
    return csv_lines([("throw", *head), *lines])


def path_csv(fits: Sequence[FitResult]) -> str:
    """Measured value, fitted value and residual of each measured channel (SI, rad), one row per
    time; for several throws the first column names the throw."""
    channels = list(dict.fromkeys(name for one in fits for name in one.rms if name in one.fitted))
    head = ["t"]
    for name in channels:
        head += [name, f"{name}_fitted", f"{name}_residual"]
    lines = []
    for one in fits:
        columns = [one.observed["t"]]
        empty = math.nan * one.observed["t"]
        for name in channels:
            observed, fitted = one.observed.get(name, empty), one.fitted.get(name, empty)
            columns += [observed, fitted, observed - fitted]
        label = (one.data["file"],) if len(fits) > 1 else ()
        lines += [(*label, *row) for row in zip(*(c.tolist() for c in columns), strict=True)]
    return csv_lines([("throw", *head) if len(fits) > 1 else head, *lines])


def candidates_csv(comparison: Any) -> str:
    """The candidates of a comparison, best first; the coefficients of each in one cell."""
    lines = []
    for one in comparison.candidates:
        rms = [(one.rms or {}).get(name) for name in ("x", "y", "phi")]
        coefficients = "; ".join(
            f"{name} = {item['value']:.6g}" for name, item in (one.coefficients or {}).items()
        )
        lines.append((*(getattr(one, name) for name in _CANDIDATE), *rms, coefficients))
    return csv_lines([(*_CANDIDATE, "rms_x", "rms_y", "rms_phi", "coefficients"), *lines])
