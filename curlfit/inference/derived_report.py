"""Tables of derived quantities. Nothing is computed here except conversions of units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from curlfit.inference.derived import Derived, scaled, to_its_side
from curlfit.output.console import PlainTable
from curlfit.output.text import compact, format_estimate, from_to, judged, labelled
from curlfit.sheet import FOOT


def derived_table(items: Sequence[Derived]) -> PlainTable:
    """Derived quantities with their errors."""
    return PlainTable(
        (_row("derived", item) | {"verdict": judged(item.verdict)} | _posterior(item)
         for item in items),
        "Derived quantities",
    )  # fmt: skip


def quantities_table(quantities: Mapping[str, Derived], *, discrepancy: bool) -> PlainTable:
    """Quantities of the fitted path within the record, or of that of the law without the model
    discrepancy."""
    path = "path of the law" if discrepancy else "fitted path"
    rows = []
    for name, item in quantities.items():
        item = to_its_side(item)
        rows.append(item)
        if name == "curl":
            rows.append(scaled(replace(item, unit="ft"), 1 / FOOT))
    return PlainTable(
        (_row(f"along the {path}", item) | _posterior(item) for item in rows),
        f"Along the {path}" + ", without the discrepancy" * discrepancy,
    )


def draw_text(quantities: Mapping[str, Derived]) -> str:
    """Time and curl of a draw, as curlers state them."""
    if not {"draw_time", "curl"} <= quantities.keys():
        return ""
    time, curl = quantities["draw_time"].value, abs(quantities["curl"].value) / FOOT
    return f"{time:.1f} s / {curl:.1f} ft: time of the draw from the near hog line, and its curl."


def quantities_line(quantities: Mapping[str, Derived]) -> str:
    """The main quantities of the path in one line."""
    parts = []
    for name in ("friction", "curl", "turns", "hog_to_hog"):
        if name not in quantities:
            continue
        item = quantities[name]
        one = to_its_side(item)
        unit = "" if item.unit in ("", "1") else f" {item.unit}"
        parts.append(f"{one.meaning.partition(',')[0]} {compact(one.value, one.stderr)}{unit}")
    return ", ".join(parts)


def _row(head: str, item: Derived) -> dict[str, Any]:
    hidden = item.verdict == "not identifiable"
    value, stderr = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
    return {
        head: labelled(item.meaning or item.expression, item.unit),
        ">estimate": value, ">std. error": stderr,
        ">systematic": None if item.systematic is None else f"{item.systematic:.2g}",
    }  # fmt: skip


def _posterior(item: Derived) -> dict[str, str]:
    found = item.quantiles
    return {"68 % of posterior": from_to(found["16"], found["84"]) if found else ""}
