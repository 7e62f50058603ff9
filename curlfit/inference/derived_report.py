"""Tables of derived quantities. Nothing is computed here except conversions of units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.inference.derived import Derived, scaled, to_its_side
from curlfit.output.text import STYLE, compact, format_estimate, from_to, plain_table
from curlfit.sheet import FOOT


def derived_table(items: Sequence[Derived]) -> list[RenderableType]:
    """Derived quantities with their errors; empty if there are none."""
    return [_table("derived", items, verdicts=True)] if items else []


FITTED, OF_LAW = "along the fitted path", "along the path of the law"
"""Headings of the quantities of a path, without and beside a model discrepancy."""


def quantities_table(
    quantities: Mapping[str, Derived], *, discrepancy: bool = False
) -> list[RenderableType]:
    """Quantities of the fitted path within the record; empty if there are none."""
    if not quantities:
        return []
    rows = []
    for name, item in quantities.items():
        item = to_its_side(item)
        rows.append(item)
        if name == "curl":
            rows.append(scaled(replace(item, unit="ft"), 1 / FOOT))
    found: list[RenderableType] = [_table(OF_LAW if discrepancy else FITTED, rows, verdicts=False)]
    if "draw_time" in quantities and "curl" in quantities:
        time, curl = quantities["draw_time"].value, abs(quantities["curl"].value) / FOOT
        text = (
            f"{time:.1f} s / {curl:.1f} ft: time of the draw from the near hog line, and its curl."
        )
        found.append(Padding(Text(text), (0, 0, 1, 0)))
    return found


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


def _table(head: str, items: Sequence[Derived], *, verdicts: bool) -> RenderableType:
    table = plain_table()
    table.add_column(head, no_wrap=True)
    for name in ("estimate", "std. error"):
        table.add_column(name, justify="right", no_wrap=True)
    systematic = any(item.systematic for item in items)
    if systematic:
        table.add_column("systematic", justify="right", no_wrap=True)
    if verdicts:
        table.add_column("verdict", no_wrap=True)
    posterior = any(item.quantiles for item in items)
    if posterior:
        table.add_column("68 % of posterior", no_wrap=True)
    for item in items:
        hidden = item.verdict == "not identifiable"
        shown = ("-", "-") if hidden else format_estimate(item.value, item.stderr)
        label = item.meaning or item.expression
        cells: list[str | Text] = [
            f"{label} ({item.unit})" if item.unit not in ("", "1") else label, *shown,
        ]  # fmt: skip
        if systematic:
            cells.append("-" if item.systematic is None else f"{item.systematic:.2g}")
        if verdicts:
            cells.append(Text(item.verdict, style=STYLE[item.verdict]))
        if posterior:
            found = item.quantiles
            cells.append(from_to(found["16"], found["84"]) if found else "")
        table.add_row(*cells)
    return Padding(table, (0, 0, 1, 0))
