"""What is seen of files before a fit: their motion in a few words and figures,
what is odd."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from curlfit.errors import CurlfitError, Option
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.html_report.blocks import blocks_of
from curlfit.html_report.drawings import inline_svg
from curlfit.html_report.page import rendered
from curlfit.options.settings import ConfiguredThrow, prepare_all, read_config
from curlfit.output.table import Column, Table
from curlfit.output.text import sided
from curlfit.settings.choices import Fitting, Reading
from curlfit.throws.odd_row import odd_row_findings

if TYPE_CHECKING:
    from curlfit.throws.events import Event
    from curlfit.throws.throw import Throw


@dataclass(frozen=True)
class Seen:
    """What was read.

    Attributes
    ----------
    finding : in a line. fault : why it cannot be fitted; empty if it can.
    options : what to type to mend the fault. oddities, notes : of the data.
    shown : figures or a table, as HTML.
    text : as `curlfit check` prints it.
    """

    finding: str = ""
    fault: str = ""
    options: Sequence[Option] = ()
    oddities: Sequence[Finding] = ()
    notes: Sequence[Finding] = ()
    shown: str = ""
    text: str = ""


def look(files: Sequence[Path], chosen: Mapping[str, Any]) -> Seen:
    """Read files with choices by name, as `curlfit fit` does."""
    from curlfit.throws.friction_table import is_friction_table, load_friction_table

    try:
        worksheet = chosen.get("worksheet")
        if len(files) == 1 and is_friction_table(files[0], worksheet):
            table = load_friction_table(files[0], worksheet)
            span = f"{table.speed.min():.3g} to {table.speed.max():.3g} m/s"
            finding = f"{len(table.speed)} values of friction against speed, {span}"
            return Seen(finding, notes=table.notes)
        of_reading = chosen.keys() & Reading.forms().keys()
        of_fitting = chosen.keys() & Fitting.forms().keys()
        reading = Reading(**{name: chosen[name] for name in of_reading})
        fitting = Fitting(**{name: chosen[name] for name in of_fitting})
        config = chosen.get("config")
        jobs = list(prepare_all(files, config, reading, fitting).values())
        if len(jobs) > 1:
            return _several([job.throw for job in jobs])
        return _one(files[0], jobs[0], reading, config)
    except CurlfitError as error:
        return Seen(fault=str(error), options=error.options)


def _several(throws: Sequence[Throw]) -> Seen:
    """What was read of several throws: a table with a row for each."""
    labels = dict.fromkeys(label for throw in throws for label in throw.labels)
    measurements = dict.fromkeys(
        _heading(event) for throw in throws for event in throw.events
    )
    columns: list[Column[Throw]] = [
        Column("throw", key="name"),
        *map(_label_column, labels),
        Column("motion", motion_in_words),
        *map(_event_column, measurements),
    ]
    return Seen(
        f"{len(throws)} throws, which are fitted together",
        oddities=odd_row_findings(throws[0].odd_rows),
        notes=list(dict.fromkeys(note for throw in throws for note in throw.notes)),
        shown="".join(map(rendered, blocks_of([Table(throws, columns)]))),
    )


def _label_column(label: str) -> Column[Throw]:
    """The column of a label of the throws."""
    return Column(label, lambda throw: throw.labels.get(label), missing="")


def _event_column(heading: str) -> Column[Throw]:
    """The column of a measurement of the throws."""

    def value(throw: Throw) -> float | None:
        for event in throw.events:
            if _heading(event) == heading:
                return event.value
        return None

    return Column(heading, value, ".5g", missing="", right=True)


def _heading(event: Event) -> str:
    """The name and unit of a measurement."""
    return f"{event.name.replace('_', ' ')} ({event.unit})"


def _one(
    file: Path, job: ConfiguredThrow[Fitting], reading: Reading, config: Path | None
) -> Seen:
    """What was read of one throw: figures, what is odd, and why it cannot be fitted."""
    from curlfit.throws.figures import motion_figures
    from curlfit.throws.load import read
    from curlfit.throws.plausibility import examine, require_motion
    from curlfit.throws.report import print_inspection

    throw = job.throw
    printed = StringIO()
    fault = ""
    options: tuple[Option, ...] = ()
    oddities: list[Finding] = []
    settings = {**throw.settings, **read_config(config)}
    print_inspection(
        read(file, reading), throw, settings, Console(file=printed, width=110)
    )
    figures = motion_figures(throw) if throw.has_path else {}
    try:
        require_motion(job.rows)
        findings = examine(job.rows)
        oddities = [finding for finding in findings if not finding.is_refusal]
        _ = job.request
    except CurlfitError as error:
        fault = str(error)
        options = error.options
    pictures = [
        inline_svg(figure, f"seen-{name}-", name) for name, figure in figures.items()
    ]
    return Seen(
        finding=motion_in_words(throw) or f"{len(throw.events)} times and places",
        fault=fault,
        options=options,
        oddities=oddities,
        notes=throw.notes,
        shown="".join(pictures),
        text=printed.getvalue(),
    )


def motion_in_words(throw: Throw) -> str:
    """How long, how fast and how turning a path is, before a fit; nothing of events."""
    from curlfit.throws.motion import motion_of, turning

    if not throw.has_path:
        return ""
    duration = throw.t[-1] - throw.t[0]
    words = [f"{counted(len(throw), 'row')} in {duration:.4g} s"]
    motion = motion_of(throw)
    if motion is not None:
        side, _ = sided("to the right", -motion.curl)
        words.append(f"a path of {motion.length:.3g} m")
        words.append(f"{motion.speed[0]:.3g} m/s at the start")
        words.append(f"curls {abs(motion.curl):.1f} m {side}")
    turns = turning(throw)[0] / (2 * math.pi)
    if math.isfinite(turns):
        sense, _ = sided("counter-clockwise", turns)
        words.append(f"turns {abs(turns):.2g} times {sense}")
    return ", ".join(words)
