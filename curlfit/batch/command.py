"""`curlfit batch`: many throws, one law, one table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from curlfit.foreign import say
from curlfit.options.output import COMPILES, Saved, progress_line
from curlfit.settings.choices import COUNT, SEED, Choices, Fitting, Reading
from curlfit.settings.forms import PATH, SWITCH, TEXT, option

if TYPE_CHECKING:
    from rich.console import Console

    from curlfit.batch.settings import BatchSettings
    from curlfit.batch.table import GrowingTable


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Running(Choices):
    """How the throws of a batch are fitted.

    Attributes
    ----------
    posterior : Quantiles of each throw's posterior as well; far slower.
    seed : Seed of the posterior sampling. [default: 0]
    workers : Number of processes. [default: one per core]
    dask : Use the workers of a Dask scheduler, which see the same files. Whoever can
        connect to it can run code as its owner. Needs `pip install 'curlfit[dask]'`.
    again : Start again, overwriting the table.
    quiet : Print nothing but errors.
    """

    posterior: Annotated[bool, option(SWITCH)] = False
    seed: Annotated[int, option(SEED, "N")] = 0
    workers: Annotated[int | None, option(COUNT, "N")] = None
    dask: Annotated[str | None, option(TEXT, "tcp://...")] = None
    again: Annotated[bool, option(SWITCH)] = False
    quiet: Annotated[bool, option(SWITCH, name=["--quiet", "-q"])] = False


def batch(
    *data: str,
    out: Annotated[Path, option(PATH, "FILE.csv")] = Path("results.csv"),
    flags: Fitting = Fitting(),
    reading: Reading = Reading(),
    running: Running = Running(),
) -> Saved:
    """Fit a friction law to many throws, each by itself, into one table.

    A row has status, rms, coefficients, standard errors, verdicts and what is
    determined together. A log of DigitalCurling 3 has a row for each shot, an export of
    a tracking program one for each object, a video one for each stone that moves, a
    table one for each throw (columns shot and stone_index). A throw without a usable
    fit has the reason in its row and does not stop the batch: status "not usable" if
    the data were read, "failed" if they could not be read, "odd" for a row of a
    stopwatch table that the other rows contradict (`--keep` fits it). The same command
    continues where an earlier run was interrupted.

    Exit status 0 if a throw in the table is ok; 1 if some were read and none is usable;
    2 if none could be read, or the command itself is refused.

    Example: `curlfit batch season/ --stone R=0.054 --out season.csv`

    Parameters
    ----------
    data
        Folders, files or patterns like `'season/*.csv'`; each file as for
        `curlfit fit`. A folder stands for its .csv, .tsv, .txt, .json and .jsonl files.
    out
        Table of results, one row per throw; its settings are written beside it, as
        results.settings.json. [default: results.csv]
    """
    from curlfit.batch.columns import names_of_columns
    from curlfit.batch.settings import BatchSettings
    from curlfit.batch.table import GrowingTable, settings_file
    from curlfit.errors import InputError
    from curlfit.numerics.jax_settings import require_jax
    from curlfit.output.console import terminal
    from curlfit.throws.load import found_files, states_sweeping, usual_law

    if running.dask is not None and "://" not in running.dask:
        raise InputError(
            f"--dask {running.dask}: expected the address of a scheduler, tcp://...; "
            "for processes on this machine use --workers"
        )
    files = [str(file) for file in found_files(data, besides=(out, settings_file(out)))]
    # Invalid settings are refused before anything slow is loaded.
    plan = BatchSettings.of(
        {"law": usual_law(files[0], reading)},
        vars(flags),
        vars(reading),
        vars(running),
        any_swept=any(states_sweeping(file, reading) for file in files),
    )
    if running.dask is None:
        require_jax()
    console = terminal(quiet=running.quiet)
    names = names_of_columns(plan)
    with GrowingTable(out, names, plan.recorded(), files, again=running.again) as table:
        _fill(table, plan, len(files), console, running)
    _print_contents(table, console)
    return Saved(None, status=_exit_status(table))


def _print_contents(table: GrowingTable, console: Console) -> None:
    """Print how many throws are in a table, and which of them contradict others."""
    from curlfit.batch.table import Status

    for sentence in table.odd:
        console.print(f"{sentence}.", style="yellow", markup=False, soft_wrap=True)
    counts = table.counts
    usable = f"{counts[Status.OK]} ok"
    if table.warned:
        usable += f" ({table.warned} with warnings, in the column of that name)"
    parts = [
        usable,
        f"{counts[Status.NOT_USABLE]} not usable",
        f"{counts[Status.FAILED]} failed",
    ]
    if counts[Status.ODD]:
        parts.append(f"{counts[Status.ODD]} odd")
    console.print(
        f"{', '.join(parts)}. Written: {table.file}, {table.settings}", soft_wrap=True
    )


def _exit_status(table: GrowingTable) -> int:
    """0 if a throw is usable, 1 if some were read and none is, 2 if none could be read;
    a message says the latter two."""
    from curlfit.batch.table import Status

    counts = table.counts
    if counts[Status.OK]:
        return 0
    was_read = counts[Status.NOT_USABLE] + counts[Status.ODD] > 0
    fault = "no throw is usable" if was_read else "no throw could be read"
    say(f"curlfit: {fault}; the column reason of {table.file} says why", error=True)
    return 1 if was_read else 2


def _fill(
    table: GrowingTable,
    plan: BatchSettings,
    file_count: int,
    console: Console,
    running: Running,
) -> None:
    """Fit the files that the table lacks, with a line of progress."""
    from concurrent.futures import BrokenExecutor

    from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

    from curlfit.batch.executor import executor
    from curlfit.errors import CurlfitError

    done = file_count - len(table.todo)
    if done:
        console.print(f"{done} of {file_count} files are in {table.file}.")
    bar = (
        "Fitting",
        BarColumn(),
        MofNCompleteColumn(),
        "files",
        TimeRemainingColumn(),
        COMPILES,
    )
    try:
        with (
            progress_line(console, *bar) as show,
            executor(plan, workers=running.workers, dask=running.dask) as fit_in_chunks,
        ):
            show("", done, file_count)
            for rows in fit_in_chunks(table.todo):
                table.add(rows)
                done += len({row["file"] for row in rows})
                show("", done, file_count)
    except BrokenExecutor:
        raise CurlfitError(
            f"a process was killed, perhaps for lack of memory; {done} of {file_count} "
            f"files are in {table.file}, and the same command continues"
        ) from None
