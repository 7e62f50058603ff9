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
from curlfit.output.console import PlainTable
from curlfit.output.text import sided
from curlfit.settings.choices import Fitting, Reading
from curlfit.throws.odd_row import odd_row_findings

if TYPE_CHECKING:
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
            said = f"{len(table.speed)} values of friction against speed, {span}"
            return Seen(said, notes=[table.note] if table.note else [])
        reading = Reading(
            **{k: chosen[k] for k in chosen.keys() & Reading.forms().keys()}
        )
        flags = Fitting(
            **{k: chosen[k] for k in chosen.keys() & Fitting.forms().keys()}
        )
        jobs = [*prepare_all(files, chosen.get("config"), reading, flags).values()]
        if len(jobs) > 1:
            return _several([job.throw for job in jobs])
        return _one(files[0], jobs[0], reading, chosen.get("config"))
    except CurlfitError as error:
        return Seen(fault=str(error), options=error.options)


def _several(throws: Sequence[Throw]) -> Seen:
    rows = [
        {"throw": throw.name, **throw.labels, "motion": motion_in_words(throw)}
        | {
            f">{e.name.replace('_', ' ')} ({e.unit})": f"{e.value:.5g}"
            for e in throw.events
        }
        for throw in throws
    ]
    return Seen(
        f"{len(throws)} throws, which are fitted together",
        oddities=odd_row_findings(throws[0].odd_rows),
        notes=list(dict.fromkeys(note for throw in throws for note in throw.notes)),
        shown="".join(map(rendered, blocks_of([PlainTable(rows)]))),
    )


def _one(
    file: Path, job: ConfiguredThrow[Fitting], reading: Reading, config: Path | None
) -> Seen:
    from curlfit.throws.figures import motion_figures
    from curlfit.throws.load import read
    from curlfit.throws.plausibility import examine, require_motion, require_plausible
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
        require_motion(job.cut)
        oddities = [item for item in examine(job.cut) if not item.is_refusal]
        require_plausible(job.cut)
        _ = job.parameters
    except CurlfitError as error:
        fault = str(error)
        options = error.options
    pictures = [inline_svg(fig, f"seen-{name}-", name) for name, fig in figures.items()]
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
    words = [f"{counted(len(throw), 'row')} in {throw.t[-1] - throw.t[0]:.4g} s"]
    if (motion := motion_of(throw)) is not None:
        words += [
            f"a path of {motion.length:.3g} m",
            f"{motion.speed[0]:.3g} m/s at the start",
            f"curls {abs(motion.curl):.1f} m {sided('to the right', -motion.curl)[0]}",
        ]
    turned = turning(throw)[0] / (2 * math.pi)
    if math.isfinite(turned):
        words.append(
            f"turns {abs(turned):.2g} times {sided('counter-clockwise', turned)[0]}"
        )
    return ", ".join(words)
