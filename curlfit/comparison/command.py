"""`curlfit compare`: many laws, one throw."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s
from curlfit.options.figures import FigureFiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.comparison.result import Comparison


def compare(
    data: Annotated[
        Path,
        typer.Argument(help="Data as for `curlfit fit`.", metavar="DATA", show_default=False),
    ],
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws to compare, separated by commas; FILE.py:CLASS for your own. [default: all]",
            metavar="A,B,...",
        ),
    ] = None,
    load: Annotated[
        str | None,
        typer.Option(help="`uniform`, `consistent` (eq. 8-9) or `both`. [default: uniform]"),
    ] = None,
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    sweep: o.Swept = None,
    fix: o.Fix = None,
    bound: o.Bound = None,
    unbounded: o.Unbounded = False,
    free: o.Free = None,
    prior: o.PriorText = None,
    start: o.Start = None,
    sigma: o.Sigma = None,
    loss: o.Loss = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="Noise models, as in `curlfit fit`; with several, every law is fitted under each "
            "of them, and all fits are ranked together. [default: white]",
            metavar="A,B,...",
        ),
    ] = None,
    stone: o.StoneValues = None,
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: o.StoneIndex = None,
    shot: o.Shot = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    config: o.Config = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results. [default: DATA's name, with the numbers given by --shot "
            "and --stone-index, and -compare]"
        ),
    ] = None,
    figures: o.FigureFormats = None,
    no_figures: o.NoFigures = False,
    report: o.Report = False,
    quiet: o.Quiet = False,
) -> o.Saved | None:
    """Fit many friction laws to one throw, under one or several noise models, and rank them.

    Each law is fitted within its own bounds; one that fails with a coefficient at zero is fitted
    again with either sign allowed, which is shown and not ranked. Laws are ranked by BIC; with a
    robust `--loss`, by that of the corresponding noise distribution. If residuals are independent,
    the log evidence (dlnZ) and the expected log predictive density of leave-one-out (delpd, with
    the standard error of the difference) are given too. `--fix`, `--bound` and `--start` hold
    for the laws that have such a parameter.
    Writes `compare.json` and `compare.png`.

    Example: `curlfit compare data/jensen_shegelski_2004.csv --load both`
    """
    from curlfit.comparison.noise_models import noise_models
    from curlfit.errors import InputError
    from curlfit.friction import LAWS, check_load, find_law
    from curlfit.inference.noise.models import check_loss
    from curlfit.inference.parameters import ParameterSet, options_of, require_known
    from curlfit.output.files import prepare_folder
    from curlfit.throws.plausibility import require_plausible
    from curlfit.throws.throw import require_path

    drawn = FigureFiles.of(figures, none=no_figures)
    flags = s.fit_flags(
        o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given),
        law=None, load=None if load == "both" else load, since=since, until=until,
        exclude=exclude, swept=sweep, stone=stone, sigma=sigma, fix=fix, bound=bound, start=start,
        unbounded=unbounded, free=free, prior=prior, loss=loss, noise=s.names(noise or ()) or None,
    )  # fmt: skip
    throw, settings, the_stone = s.prepare(data, config, flags)
    check_load(settings.get("load", "uniform"))
    loss = check_loss(settings.get("loss", "linear"))
    noises = noise_models(settings.get("noise", "white"), loss)
    names = [name.strip() for name in laws.split(",") if name.strip()] if laws else None
    if names == []:
        raise InputError("--laws: expected names with commas between")
    chosen = [find_law(name) for name in names] if names else None
    cut = throw.select_rows(**s.row_choices(settings))
    unusual = require_plausible(cut)
    laws_of = chosen or list(LAWS.values())
    options = {name: settings.get(name, {}) for name in ("fix", "bound", "start", "prior")}
    options["free"] = dict.fromkeys(settings.get("free", ()), True)
    require_known(laws_of, {f"--{name}": values for name, values in options.items()})
    for law in laws_of:
        own = options_of(law, options)
        ParameterSet.for_throw(
            law,
            cut,
            fix=own["fix"],
            bounds=own["bound"],
            free=own["free"],
            priors=own["prior"],
            swept="swept" in settings,
        )
    require_path(cut)
    folder = prepare_folder(out or s.result_folder(data, "compare", shot, stone_index))

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    drawn.draw_beside()
    with Progress(
        TextColumn("Fitting {task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("(a first run on a machine compiles each law)"),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    ) as progress:
        task = progress.add_task("", total=None)

        def show_progress(name: str, done: int, total: int) -> None:
            progress.update(task, description=name, completed=done, total=total)

        from curlfit.comparison.compare import compare as compare_laws

        found = compare_laws(
            throw,
            chosen,
            load="both" if load == "both" else settings.get("load", "uniform"),
            stone=the_stone,
            **s.row_choices(settings),
            swept=settings.get("swept"),
            fix=options["fix"],
            bounds=options["bound"],
            unbounded=bool(settings.get("unbounded", False)),
            free=tuple(options["free"]),
            priors=options["prior"],
            start=options["start"],
            loss=loss,
            noise=noises,
            progress=show_progress,
        )
    written = [folder / "compare.json"]
    found.save(written[0])
    drawn.replace(folder, ["compare"], partial(_figures, found))

    from curlfit.comparison.report import print_comparison

    print_comparison(found, console)
    for finding in unusual:
        console.print(f"Warning: {finding}.", style="yellow")
    written += drawn.written()
    console.print("Written: " + ", ".join(map(str, written)), soft_wrap=True)
    return o.saved(folder, report=report, quiet=quiet)


def _figures(found: Comparison) -> dict[str, Figure]:
    from curlfit.comparison.figures import comparison_figure

    return {"compare": comparison_figure(found)}
