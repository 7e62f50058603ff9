"""What is seen of files before a fit: their motion in a few words and a figure, what is odd."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup
from rich.console import Console

from curlfit.errors import CurlfitError
from curlfit.html_report.blocks import blocks_of
from curlfit.html_report.drawings import inline_svg
from curlfit.html_report.page import rendered
from curlfit.options.settings import ConfiguredThrow, prepare_all, read_config
from curlfit.output.console import PlainTable
from curlfit.settings.choices import Fitting, Reading

if TYPE_CHECKING:
    from curlfit.throws.throw import Throw


@dataclass(frozen=True)
class Seen:
    """What was read.

    Attributes
    ----------
    finding : in a line. fault : why it cannot be fitted; empty if it can.
    oddities, notes : sentences. shown : figure or table, HTML. text : as `curlfit check` prints.
    """

    finding: str = ""
    fault: str = ""
    oddities: Sequence[str] = ()
    notes: Sequence[str] = ()
    shown: str = ""
    text: str = ""


def look(files: Sequence[Path], chosen: Mapping[str, Any]) -> Seen:
    """Read files with choices by name, as `curlfit fit` does."""
    from curlfit.friction_tables.table import is_friction_table

    try:
        if len(files) == 1 and is_friction_table(files[0]):
            return _friction_table(files[0])
        reading = Reading(**{k: chosen[k] for k in chosen.keys() & Reading.forms().keys()})
        flags = Fitting(**{k: chosen[k] for k in chosen.keys() & Fitting.forms().keys()})
        jobs = prepare_all(files, chosen.get("config"), reading, flags)
        if len(jobs) > 1:
            return _several([job.throw for job in jobs.values()])
        return _one(files[0], next(iter(jobs.values())), reading, chosen.get("config"))
    except CurlfitError as error:
        return Seen(fault=str(error))


def _friction_table(file: Path) -> Seen:
    from curlfit.friction_tables.table import load_friction_table

    table = load_friction_table(file)
    rows = PlainTable(
        {">speed (m/s)": f"{speed:.3g}", ">friction": f"{mu:.4g}"}
        for speed, mu in zip(table.speed, table.mu, strict=True)
    )
    low, high = table.speed.min(), table.speed.max()
    finding = f"{len(table.mu)} values of friction against speed, {low:.3g} to {high:.3g} m/s"
    return Seen(finding, shown=_table(rows))


def _several(throws: Sequence[Throw]) -> Seen:
    rows = []
    for throw in throws:
        values = (
            {f">{one.name.replace('_', ' ')} ({one.unit})": f"{one.value:.5g}"
             for one in throw.events}
            if throw.events
            else {"motion": motion_in_words(throw)}
        )  # fmt: skip
        rows.append({"throw": throw.name, **throw.labels, **values})
    notes = dict.fromkeys(note for throw in throws for note in throw.notes)
    return Seen(
        f"{len(throws)} throws, which are fitted together",
        notes=tuple(notes), shown=_table(PlainTable(rows)),
    )  # fmt: skip


def _one(file: Path, job: ConfiguredThrow[Fitting], reading: Reading, config: Path | None) -> Seen:
    from curlfit.throws.figures import motion_figures
    from curlfit.throws.load import read
    from curlfit.throws.plausibility import examine, require_motion, require_plausible
    from curlfit.throws.report import print_inspection

    throw = job.throw
    printed = StringIO()
    settings = {**throw.settings, **read_config(config)}
    print_inspection(read(file, reading), throw, settings, Console(file=printed, width=110))
    figures = motion_figures(throw) if throw.has_path else {}
    drawn = [inline_svg(one, f"seen-{name}-", name) for name, one in figures.items()]
    oddities: list[str] = []
    fault = ""
    try:
        require_motion(job.cut)
        oddities = [str(one) for one in examine(job.cut) if not one.refused]
        require_plausible(job.cut)
        _ = job.parameters
    except CurlfitError as error:
        fault = str(error)
    shown = str(Markup("").join(drawn))
    return Seen(motion_in_words(throw), fault, oddities, throw.notes, shown, printed.getvalue())


def motion_in_words(throw: Throw) -> str:
    """How far, how fast and how turning a stone went, before a fit."""
    from curlfit.output.text import sided
    from curlfit.throws.motion import motion_of, turning

    if not throw.has_path:
        return f"{len(throw.events)} times and places by stopwatch and tape"
    words = [f"{len(throw)} rows in {throw.t[-1] - throw.t[0]:.4g} s"]
    if (motion := motion_of(throw)) is not None:
        side, _ = sided("to the right", -motion.curl)
        words += [
            f"a path of {motion.length:.3g} m",
            f"{motion.speed[0]:.3g} m/s at the start",
            f"curls {abs(motion.curl):.1f} m {side}",
        ]
    turned = turning(throw)[0] / (2 * math.pi)
    if math.isfinite(turned):
        words.append(f"turns {abs(turned):.2g} times {sided('counter-clockwise', turned)[0]}")
    return ", ".join(words)


def _table(table: PlainTable) -> str:
    return str(Markup("").join(map(rendered, blocks_of([table]))))
