"""Report of a data file by `curlfit check`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.console import Console

from curlfit.errors import CurlfitError
from curlfit.foreign import counted
from curlfit.output.console import Printed
from curlfit.output.table import Column, Table
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.channels import CHANNELS, UNITS, scatter
from curlfit.throws.motion import MIN_POSITIONS, final_speed, first_row_at_rest, path_of
from curlfit.throws.odd_row import odd_rows_in_words
from curlfit.wording import compact

if TYPE_CHECKING:
    from curlfit.findings import Finding
    from curlfit.numerics.arrays import Floats
    from curlfit.throws.events import Event
    from curlfit.throws.friction_table import FrictionTable
    from curlfit.throws.load import Part
    from curlfit.throws.readers.parsed_file import ParsedFile, Series
    from curlfit.throws.throw import Throw


_MOST_SHOWN = 100
"""Rows of a table that are printed."""
_PAUSE = 2.5  # a longer interval is a pause; in median intervals


def print_inspection(
    parsed: ParsedFile,
    throw: Throw,
    settings: Mapping[str, Any],
    console: Console,
) -> None:
    """Print the columns of a file, the findings on its throw, the reader's
    notes and curves.

    `settings` are those that a fit of the file would use; those of how it is read
    are left out.
    """
    write = console.print
    odd = odd_rows_in_words(throw.odd_rows)
    if throw.has_path:
        write(
            f"{parsed.source}: {parsed.format}, {counted(len(throw), 'row')}, "
            f"t = {throw.t[0]:.6g} .. {throw.t[-1]:.6g} s"
        )
        write(Printed(Table(parsed.series, _SERIES_COLUMNS)))
    else:
        events = counted(len(throw.events), "event")
        write(f"{parsed.source}: {parsed.format}, {events} at lines and at rest")
        for sentence in odd:
            write(sentence, style="yellow", markup=False)
        write(Printed(Table(throw.events, _EVENT_COLUMNS)))
    write()
    for line in facts(throw, settings):
        write(line)
    _print_notes(throw.notes, console)


def print_rows(parts: Sequence[Part], file: Path, console: Console) -> None:
    """Print the throws in the rows of a stopwatch table, which of them a joint fit
    leaves out, and the reader's notes.

    Parameters
    ----------
    parts : those that can be read.
    """
    throws = [part.throw for part in parts if not isinstance(part.throw, CurlfitError)]
    odd_rows = throws[0].odd_rows if throws else ()
    console.print(f"{file}: timings, {counted(len(parts), 'throw')} in rows")
    for sentence in odd_rows_in_words(odd_rows):
        console.print(sentence, style="yellow", markup=False)
    rows = [_ThrowRow(part, throw) for part, throw in zip(parts, throws, strict=True)]
    labels = dict.fromkeys(label for throw in throws for label in throw.labels)
    measurements = dict.fromkeys(
        _heading(event) for throw in throws for event in throw.events
    )
    columns: list[Column[_ThrowRow]] = [
        Column("row", lambda row: row.part.shot, right=True),
        *map(_label_column, labels),
        *map(_event_column, measurements),
        Column("", lambda row: "left out" if row.part.left_out else ""),
    ]
    console.print(Printed(Table(rows[:_MOST_SHOWN], columns)))
    if len(rows) > _MOST_SHOWN:
        console.print(f"... and {len(rows) - _MOST_SHOWN} more")
    notes = dict.fromkeys(
        note
        for throw in throws
        for note in throw.notes
        if note.code not in ("odd-value", "impossible-value")  # said above
    )
    _print_notes(list(notes), console)


def print_friction(table: FrictionTable, console: Console) -> None:
    """Print a table of friction against speed, and the reader's notes."""
    console.print(
        f"{table.name}: friction against speed, {counted(len(table.mu), 'row')}"
    )
    columns = [
        _series_column("speed (m/s)", table.speed),
        _series_column("mu", table.mu),
    ]
    if table.sigma is not None:
        columns.append(_series_column("sigma of mu", table.sigma))
    if table.omega.any():
        columns.append(_series_column("spin (rad/s)", table.omega))
    rows = range(min(len(table.mu), _MOST_SHOWN))
    console.print(Printed(Table(rows, columns)))
    _print_notes(table.notes, console)


def _series_column(heading: str, series: Floats) -> Column[int]:
    """The column of a series, by row."""
    return Column(heading, series.__getitem__, ".5g", right=True)


def _print_notes(notes: Sequence[Finding], console: Console) -> None:
    """Print what the reader says, if it says anything."""
    if not notes:
        return
    console.print("\nNotes")
    for note in notes:
        console.print(f"- {note}")


class _ThrowRow(NamedTuple):
    """A throw in a row of a stopwatch table."""

    part: Part
    throw: Throw


def _label_column(label: str) -> Column[_ThrowRow]:
    """The column of a label of the throws."""
    return Column(label, lambda row: row.throw.labels.get(label), missing="")


def _event_column(heading: str) -> Column[_ThrowRow]:
    """The column of a measurement; a row without it is empty."""

    def value(row: _ThrowRow) -> float | None:
        for event in row.throw.events:
            if _heading(event) == heading:
                beyond = LINES["far-tee"] if event.name == "rest" else 0.0
                return event.value - beyond
        return None

    return Column(heading, value, ".4g", missing="", right=True)


def _heading(event: Event) -> str:
    """The name and unit of a measurement, as of a table that a person keeps."""
    if event.name == "rest":
        return "rest (m past the tee)"
    return f"{event.name.replace('_', ' ')} ({event.unit})"


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print what is implausible in a throw, with remedies."""
    if not findings:
        return
    console.print("\nImplausible for a curling stone", style="bold")
    for finding in findings:
        console.print(f"- {finding}", style="red" if finding.is_refusal else "yellow")


def _gaps(series: Series) -> int:
    """Number of rows without a value."""
    return int((~np.isfinite(series.values)).sum())


def _span(series: Series) -> str:
    """Least and largest value in the units of the file."""
    finite = series.values[np.isfinite(series.values)] / series.column.factor
    return f"{finite.min():.6g} .. {finite.max():.6g}" if len(finite) else "-"


_SERIES_COLUMNS: tuple[Column[Series], ...] = (
    Column("column", key="header"),
    Column("quantity", lambda series: series.column.quantity),
    Column("unit", lambda series: series.column.unit),
    Column("factor", lambda series: series.column.factor, ".6g", right=True),
    Column("rows", lambda series: len(series.values), right=True),
    Column("gaps", _gaps, right=True),
    Column("range in the file", _span),
)


_EVENT_COLUMNS: tuple[Column[Event], ...] = (
    Column("measured", key="name"),
    Column("value", format=".6g", right=True),
    Column("sigma", format=".3g", right=True),
    Column("unit"),
    Column("at y", format=".3f", unit="m", missing="rest", right=True, key="at"),
    Column("since y", format=".3f", unit="m", missing="", right=True, key="since"),
)


def facts(throw: Throw, settings: Mapping[str, Any]) -> Iterator[str]:
    """Findings on a throw before a fit, one per line."""
    if throw.has_path:
        if len(throw) > 1:
            yield from _clock(throw.t)
        yield "first row  " + _row(throw, 0)
        yield "last row   " + _row(throw, -1)
        scatters = []
        for channel in throw.seen:
            measured = getattr(throw, channel)
            size = scatter(measured[np.isfinite(measured)])
            if size > 1e-12:
                scatters.append(f"{channel} {size:.2g} {UNITS[channel]}")
        if scatters:
            yield f"scatter    {', '.join(scatters)} (from row to row)"
        if throw.sigma:
            channels = [channel for channel in CHANNELS if channel in throw.sigma]
            yield f"sigma      given for {', '.join(channels)}"
        yield "rest       " + _rest(throw)
    of_fits = {
        key: value for key, value in settings.items() if key not in Reading.forms()
    }
    if of_fits:
        listed = (f"{key} = {value}" for key, value in of_fits.items() if value)
        yield "settings   " + ", ".join(listed)


def _row(throw: Throw, row: int) -> str:
    """The time and the measured values of a row."""
    cells = [f"t {throw.t[row]:.6g} s"]
    for channel in throw.seen:
        value = getattr(throw, channel)[row] + 0.0  # no -0
        if np.isfinite(value):
            cells.append(f"{channel} {value:.6g} {UNITS[channel]}")
    return ", ".join(cells)


def _clock(t: Floats) -> Iterator[str]:
    """The intervals between rows, and pauses, which are much longer."""
    step = np.diff(t)
    usual = float(np.median(step))
    even = np.ptp(step) <= 1e-6 * usual
    spread = "" if even else f" ({step.min():.4g} .. {step.max():.4g} s)"
    yield f"interval   {usual:.6g} s{spread}, {1 / usual:.6g} rows per second"
    pauses = step > max(_PAUSE * usual, 1.5 * float(np.quantile(step, 0.9)))
    if pauses.any():
        longest = int(np.argmax(step))
        yield (
            f"pauses     {pauses.sum()}, the longest {step[longest]:.4g} s after t = "
            f"{t[longest]:.6g} s"
        )


def _rest(throw: Throw) -> str:
    """Whether and when the stone comes to rest."""
    t, positions = path_of(throw)
    if len(t) < MIN_POSITIONS:
        measured = throw.speed[np.isfinite(throw.speed)]
        if not len(measured):
            return "unknown: too few positions"
        last = float(measured[-1])
        return f"not reached: {last:.3g} m/s at the end" if last else "at the last row"
    first = first_row_at_rest(t, positions)
    if first is not None:
        at_rest = positions[:, first:]
        off = np.hypot(*(at_rest - np.median(at_rest, axis=1, keepdims=True)))
        return f"reached at t = {t[first]:.5g} s, within {1000 * off.max():.2g} mm"
    speed, error = final_speed(t, positions)
    rest = "uncertain" if speed < 2 * error else "not observed"
    return f"{rest}: {compact(speed, error)} m/s at the last row"
