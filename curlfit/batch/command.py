"""`curlfit batch`: many throws, one law, one table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s


def batch(
    data: Annotated[
        list[str],
        typer.Argument(
            help="Folders, files or patterns like `'season/*.csv'`; each file as for `curlfit "
            "fit`. A folder stands for its .csv, .tsv, .txt, .json and .jsonl files.",
            metavar="DIR_OR_GLOB...",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="Table of results, one row per throw; its settings are written beside it, as "
            "results.settings.json."
        ),
    ] = Path("results.csv"),
    law: o.Law = None,
    load: Annotated[str, typer.Option(help="`uniform` or `consistent` (eq. 8-9).")] = "uniform",
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    fix: o.Fix = None,
    bound: o.Bound = None,
    unbounded: o.Unbounded = False,
    free: o.Free = None,
    prior: o.PriorText = None,
    systematic: o.Systematic = None,
    start: o.Start = None,
    loss: o.Loss = None,
    noise: o.NoiseModel = None,
    sigma: Annotated[
        list[str] | None,
        typer.Option(help="Noise of a channel, as in `curlfit fit`.", metavar="NAME=V"),
    ] = None,
    stone: Annotated[
        list[str] | None,
        typer.Option(
            help="The stone, as in `curlfit fit`, over what the files say.", metavar="R=V,rho=V"
        ),
    ] = None,
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: Annotated[
        int | None,
        typer.Option(
            help="Only this object of Tracker exports, stone of shots or throw of tables, from 1. "
            "[default: every object or throw; the stone thrown]",
            metavar="N",
            min=1,
            rich_help_panel=o.PANEL,
        ),
    ] = None,
    shot: Annotated[
        int | None,
        typer.Option(
            help="Only this shot of logs, from 1. [default: every shot]",
            metavar="N",
            min=1,
            rich_help_panel=o.PANEL,
        ),
    ] = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    posterior: Annotated[
        bool,
        typer.Option(
            "--posterior", help="Quantiles of each throw's posterior as well; far slower."
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the posterior sampling.", min=0)] = 0,
    workers: Annotated[
        int | None, typer.Option(help="Number of processes. [default: one per core]", min=1)
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            help="Use the workers of a Dask scheduler, which see the same files. Whoever can "
            "connect to it can run code as its owner. Needs `pip install 'curlfit[dask]'`.",
            metavar="tcp://...",
        ),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Start again, overwriting the table.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Fit a friction law to many throws, each by itself, into one table.

    A row has status, rms, coefficients, standard errors, verdicts and what is determined together.
    A log of DigitalCurling 3 has a row for each shot, a Tracker export one for each object, a table
    one for each throw (columns shot and stone_index). A throw without a usable fit has the reason
    in its row and does not stop the batch: status "not usable" if the data were read, "failed" if
    they could not be read. The same command continues where an earlier run was interrupted.

    Exit status 0 if a throw in the table is ok; 1 if some were read and none is usable; 2 if none
    could be read, or the command itself is refused.

    Example: `curlfit batch season/ --stone R=0.054 --out season.csv`
    """
    from concurrent.futures import BrokenExecutor

    from curlfit.batch.settings import BatchSettings, columns, found_files, usual_law
    from curlfit.batch.table import Table, settings_file
    from curlfit.errors import CurlfitError, InputError
    from curlfit.throws.readers import states_sweeping

    if dask is not None and "://" not in dask:
        raise InputError(
            f"--dask {dask}: expected the address of a scheduler, tcp://...; for processes on this "
            "machine use --workers"
        )
    files = [str(file) for file in found_files(data, besides=(out, settings_file(out)))]
    wanted: dict[str, Any] = {
        "law": law or usual_law(files[0], format),
        "load": load,
        "since": since,
        "until": until,
        "exclude": s.periods("--exclude", exclude or ()),
        "fix": s.pairs("--fix", fix or ()),
        "bounds": s.intervals("--bound", bound or ()),
        "unbounded": unbounded,
        "free": s.names(free or ()),
        "priors": s.texts("--prior", prior or ()),
        "systematics": s.pairs("--systematic", systematic) if systematic else None,
        "start": s.pairs("--start", start or ()),
        "loss": loss or "linear",
        "noise": noise or "white",
        "sigma": s.pairs("--sigma", sigma or ()),
        "stone": s.pairs("--stone", stone or ()),
        "how": {
            name: value
            for name, value in o.reader_options(
                format, axes, units, reference, stone_index, shot, handle, as_given
            ).items()
            if value is not None
        },
        "posterior": posterior,
        "seed": seed,
        "swept": any(map(states_sweeping, files)),
    }
    # Invalid settings are refused before anything slow is loaded.
    plan = BatchSettings(**wanted)
    names = columns(plan)

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Left

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    with Table(out, names, plan.to_json(), files, again=again) as table:
        from curlfit.batch.executor import executor

        if len(table.todo) < len(files):
            console.print(f"{len(files) - len(table.todo)} of {len(files)} files are in {out}.")
        progress = Progress(
            TextColumn("Fitting"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("files"),
            Left(),
            TextColumn("(a first run on a machine compiles the model)"),
            console=console,
            disable=quiet or not console.is_terminal,
            transient=True,
        )
        task = progress.add_task("", total=len(files), completed=len(files) - len(table.todo))
        try:
            with progress, executor(plan, workers=workers, dask=dask) as fitted:
                for rows in fitted(table.todo):
                    table.add(rows)
                    progress.advance(task, len({row["file"] for row in rows}))
        except BrokenExecutor:
            raise CurlfitError(
                "a process was killed, perhaps for lack of memory; "
                f"{progress.tasks[task].completed:.0f} of {len(files)} files are in {out}, and the "
                "same command continues"
            ) from None
    counts = table.counts
    console.print(
        f"{counts['ok']} ok"
        + (f" ({table.warned} with warnings, in the column of that name)" if table.warned else "")
        + f", {counts['not usable']} not usable, {counts['failed']} failed"
        + f". Written: {out}, {table.settings}",
        soft_wrap=True,
    )
    if not counts["ok"]:
        read = counts["not usable"]
        fault = "no throw is usable" if read else "no throw could be read"
        print(f"curlfit: {fault}; the column reason of {out} says why", file=sys.stderr)
        raise typer.Exit(1 if read else 2)
