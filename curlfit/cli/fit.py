"""`curlfit fit`: one throw, one law."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from curlfit.cli.joint_fit import fit_several
from curlfit.options import flags as o
from curlfit.options import reading as r
from curlfit.options.fit_settings import FitWanted, fit_flags, fit_wanted

if TYPE_CHECKING:
    from rich.console import Console

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.mcmc.chain import Chain


def fit(
    data: Annotated[
        list[Path],
        typer.Argument(
            help="Table with a header: t, x, y and if possible phi (s, m, m, rad; other units as "
            "y_ft, angle_deg ...). Leading lines `# key = value` are its defaults. Several files "
            "are fitted together.",
            metavar="DATA...",
            show_default=False,
        ),
    ],
    law: o.Law = None,
    load: o.LoadName = None,
    until: o.Until = None,
    fix: o.Fix = None,
    bound: o.Bound = None,
    unbounded: o.Unbounded = False,
    start: o.Start = None,
    sigma: o.Sigma = None,
    loss: o.Loss = None,
    noise: o.NoiseModel = None,
    share: Annotated[
        str | None,
        typer.Option(
            help="With several files: coefficients that the throws have in common. [default: all]",
            metavar="all|NAME,...",
        ),
    ] = None,
    stone: o.StoneValues = None,
    format: r.Format = None,
    axes: r.Axes = None,
    units: r.Units = None,
    reference: r.Reference = None,
    stone_index: r.StoneIndex = None,
    shot: r.Shot = None,
    config: o.Config = None,
    no_sample: Annotated[
        bool, typer.Option("--no-sample", help="Least squares only; no posterior.")
    ] = False,
    effective: Annotated[
        int, typer.Option(help="Effective samples wanted of every parameter.", min=100)
    ] = 4000,
    max_steps: Annotated[
        int, typer.Option(help="Where to stop sampling if that is not reached.", min=40)
    ] = 2_000,
    seed: Annotated[
        int | None,
        typer.Option(help="Of the posterior's random numbers. [default: 0]", min=0, max=2**32 - 1),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. [default: DATA's name with -fit]"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Go on where an earlier run in that folder ended, was stopped or was killed: its "
            "least-squares result is taken over (`--start` then does nothing) and its chain is "
            "continued.",
        ),
    ] = False,
    no_figures: o.NoFigures = False,
    quiet: o.Quiet = False,
) -> None:
    """Fit a friction law to a throw, or to several together, and say what the path determines.

    Writes `fit.json`, `fit.png` and, unless `--no-sample`, `chain.h5` and `corner.png`; for
    several throws `joint.json`, `joint.png` and a folder for each, without sampling.
    Ctrl-C during sampling keeps what there is; `--resume` goes on with it.

    Example: `curlfit fit data/jensen_shegelski_2004.csv --stone rho=0.1025`
    """
    from curlfit.errors import InputError
    from curlfit.output.files import prepare_folder

    if resume and no_sample:
        raise InputError("--resume goes on with sampling, and --no-sample does without it")
    flags = fit_flags(
        r.how(format, axes, units, reference, stone_index, shot),
        law=law, load=load, until=until, stone=stone, sigma=sigma, fix=fix, bound=bound,
        start=start, unbounded=unbounded, loss=loss, noise=noise, seed=seed,
    )  # fmt: skip
    if len(data) > 1:
        if resume:
            raise InputError("--resume goes on with the sampling of one throw; give one file")
        fit_several(data, share, config, flags, out, no_figures=no_figures, quiet=quiet)
        return
    (file,) = data
    if share is not None:
        raise InputError("--share needs several files")
    asked = fit_wanted(file, config, flags)
    seed = asked.wanted.get("seed", 0)
    folder = out or Path(f"{file.stem}-fit")
    saved = None
    if resume:
        saved = _saved(folder, seed, asked)
    folder = prepare_folder(folder)

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    if resume and saved is None:
        console.print(f"Nothing to resume in {folder}; this is a first run.", soft_wrap=True)
    if saved is None:
        with waiting(console, "Fitting (a first run on a machine compiles the model)"):
            result = asked.fit()
    else:
        result = saved
    written = [folder / "fit.json"]
    if not no_sample:
        result = result.before_sampling()
    result.save(folder / "fit.json")
    if saved is None:
        for name in ("corner.png", "chain.h5"):  # of another fit
            (folder / name).unlink(missing_ok=True)
    if not no_figures:
        from curlfit.inference.figures import fit_figure
        from curlfit.output.figures import save_figure

        save_figure(fit_figure(result), folder / "fit.png")
        written.append(folder / "fit.png")
    if not no_sample:
        chain_file = folder / "chain.h5"
        result, chain = _sampled(
            console,
            result,
            seed=seed,
            effective=effective,
            most_steps=max_steps,
            checkpoint=chain_file,
            resume=saved is not None,
        )
        result.save(folder / "fit.json")
        written.append(chain_file)
        if not no_figures:
            from curlfit.inference.figures import corner_figure

            save_figure(corner_figure(result, chain), folder / "corner.png")
            written.append(folder / "corner.png")
    _remove_stale(folder, written)

    from curlfit.inference.report import print_fit

    print_fit(result, console)
    console.print("Written: " + ", ".join(str(file) for file in written), soft_wrap=True)
    _finish(result)


def _saved(folder: Path, seed: int, asked: FitWanted) -> FitResult | None:
    """The fit that lies in the folder, if any; it and its chain must be of what is asked for."""
    if not (folder / "fit.json").exists():
        return None
    from curlfit.inference.fit.result import load_fit
    from curlfit.inference.mcmc.chain import (
        load_chain,
        require_same,
        subject_of,
        subject_of_fit,
        subject_of_saved,
    )

    found = load_fit(folder)
    now = subject_of_fit(
        asked.cut.condensed(), asked.law, asked.load, asked.stone, asked.parameters, asked.loss,
        asked.noise,
    )  # fmt: skip
    require_same(subject_of_saved(found), now, folder / "fit.json")
    chain = folder / "chain.h5"
    if chain.exists():
        require_same(load_chain(chain).subject, subject_of(found, seed), chain)
    return found


def _finish(result: FitResult) -> None:
    if not result.converged:
        print(f"curlfit: the fit is not usable: {result.status}", file=sys.stderr)
        raise typer.Exit(1)
    if result.posterior is not None and not result.posterior.converged:
        print(f"curlfit: warning: posterior {result.posterior.status}", file=sys.stderr)


def _remove_stale(folder: Path, written: list[Path]) -> None:
    """Take away what an earlier fit left in the folder and this one did not replace."""
    for name in ("fit.png", "chain.h5", "corner.png"):
        if folder / name not in written:
            (folder / name).unlink(missing_ok=True)


@contextmanager
def waiting(console: Console, text: str) -> Iterator[None]:
    """A line that says what is being done, on a terminal."""
    if console.is_terminal and not console.quiet:
        with console.status(text):
            yield
    else:
        yield


def _sampled(
    console: Console, result: FitResult, *, effective: int, **choices: Any
) -> tuple[FitResult, Chain]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from curlfit.inference.mcmc.sampler import sample

    with Progress(
        TextColumn("Sampling the posterior"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total} effective samples"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[more]}"),
        console=console,
        disable=console.quiet or not console.is_terminal,
        transient=True,
    ) as progress:
        task = progress.add_task("", total=effective, more="compiling")

        def told(least: float, steps: int, r_hat: float) -> None:
            progress.update(
                task, completed=min(least, effective), more=f"{steps} steps, R-hat {r_hat:.3f}"
            )

        report: Callable[[float, int, float], None] = told
        return sample(result, effective=effective, progress=report, **choices)
