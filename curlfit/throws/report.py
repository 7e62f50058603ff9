"""Report of a data file by `curlfit check`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.text import Text

from curlfit.output.console import PlainTable
from curlfit.output.text import compact
from curlfit.throws.inspection import Inspection, Rest
from curlfit.throws.throw import CHANNELS, UNITS

if TYPE_CHECKING:
    from curlfit.throws.plausibility import Finding
    from curlfit.throws.readers.parsed_file import ParsedFile
    from curlfit.throws.throw import Throw


def print_inspection(
    parsed: ParsedFile,
    throw: Throw,
    inspection: Inspection,
    settings: Mapping[str, Any],
    console: Console,
) -> None:
    """Print the columns of a file, the findings on its throw, and the reader's notes.

    `settings` are those that a fit of the file would use.
    """
    events = f"{len(throw.events)} events at lines and at rest"
    rows = f"{len(throw)} rows, t = {throw.t[0]:.6g} .. {throw.t[-1]:.6g} s"
    console.print(f"{parsed.source}: {parsed.format}, {rows if throw.has_path else events}")
    console.print(_columns(parsed) if throw.has_path else _events(throw))
    console.print()
    for name, found in facts(throw, inspection, settings):
        console.print(f"{name:<10} {found}")
    if throw.notes:
        console.print("\nNotes")
        for note in throw.notes:
            console.print(f"- {note}")


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print what is implausible in a throw, with remedies."""
    if not findings:
        return
    console.print("\nImplausible for a curling stone", style="bold")
    for finding in findings:
        console.print(f"- {finding}", style="red" if finding.refused else "yellow")


def _columns(parsed: ParsedFile) -> PlainTable:
    rows = []
    for header, column, values in parsed.series:
        finite = values[np.isfinite(values)] / column.factor
        span = f"{finite.min():.6g} .. {finite.max():.6g}" if len(finite) else "-"
        cells = {
            "column": header, "quantity": column.quantity, "unit": column.unit,
            ">factor": f"{column.factor:.6g}", ">rows": str(len(values)),
            ">gaps": str(int((~np.isfinite(values)).sum())), "range in the file": span,
        }  # fmt: skip
        rows.append({head: Text(cell) for head, cell in cells.items()})
    return PlainTable(rows)


def _events(throw: Throw) -> PlainTable:
    return PlainTable(
        {
            "measured": event.name, ">value": f"{event.value:.6g}", ">sigma": f"{event.sigma:.3g}",
            "unit": event.unit, ">at y (m)": "rest" if event.at is None else f"{event.at:.3f}",
            ">since y (m)": "" if event.since is None else f"{event.since:.3f}",
        }
        for event in throw.events
    )  # fmt: skip


def facts(
    throw: Throw, inspection: Inspection, settings: Mapping[str, Any]
) -> Iterator[tuple[str, str]]:
    """Findings on a throw before a fit, each with its name."""
    if throw.has_path:
        yield from _of_rows(throw, inspection)
    if settings:
        yield "settings", ", ".join(f"{key} = {value}" for key, value in settings.items() if value)


def _of_rows(throw: Throw, inspection: Inspection) -> Iterator[tuple[str, str]]:
    if (clock := inspection.clock) is not None:
        spread = "" if clock.regular else f" ({clock.shortest:.4g} .. {clock.longest:.4g} s)"
        rate = f"{1 / clock.median:.6g} rows per second"
        yield "interval", f"{clock.median:.6g} s{spread}, {rate}"
        if clock.longest_pause is not None:
            longest = f"the longest {clock.longest_pause:.4g} s after t = {clock.pause_start:.6g} s"
            yield "pauses", f"{clock.pauses}, {longest}"
    for name, row in (("first row", 0), ("last row", -1)):
        seen = ((channel, getattr(throw, channel)[row]) for channel in throw.seen)
        values = [f"{c} {value + 0.0:.6g} {UNITS[c]}" for c, value in seen if np.isfinite(value)]
        yield name, ", ".join([f"t {throw.t[row]:.6g} s", *values])
    for channel, times in inspection.jumps.items():
        first = f"{len(times)} in {channel}, the first at t = {times[0]:.6g} s"
        yield "jumps", f"{first}: steps that differ from the neighbouring ones"
    if inspection.noise:
        listed = (f"{c} {noise:.2g} {UNITS[c]}" for c, noise in inspection.noise.items())
        yield "scatter", ", ".join(listed) + " (from row to row)"
    if throw.sigma:
        yield "sigma", "given for " + ", ".join(c for c in CHANNELS if c in throw.sigma)
    yield "rest", _rest(inspection.rest)


def _rest(rest: Rest) -> str:
    if rest.time is not None:
        return f"reached at t = {rest.time:.5g} s, within {1000 * rest.radius:.2g} mm"
    if rest.speed is None:
        return "unknown: too few positions"
    if rest.measured:
        return f"not reached: {rest.speed:.3g} m/s at the end" if rest.speed else "at the last row"
    sure = "uncertain" if rest.speed < 2 * rest.error else "not observed"
    return f"{sure}: {compact(rest.speed, rest.error)} m/s at the last row"
