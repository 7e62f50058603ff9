"""`curlfit fit`: a law fitted to one throw, or to several jointly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import curlfit
from curlfit.foreign import say
from curlfit.options import flags as o
from curlfit.options import settings as s

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.joint.result import JointResult
    from curlfit.inference.mcmc.chain import Chain
    from curlfit.options.figures import FigureFiles


def fit(
    data: Annotated[
        list[Path],
        typer.Argument(
            help="Table with a header: t, x, y and if possible phi (s, m, m, rad; other units as "
            "y_ft, angle_deg ...). Leading lines `# key = value` are its defaults. Several files "
            "are fitted jointly.",
            metavar="DATA...",
            show_default=False,
        ),
    ],
    law: o.Law = None,
    load: o.LoadName = None,
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    sweep: o.Swept = None,
    fix: o.Fix = None,
    bound: o.Bound = None,
    unbounded: o.Unbounded = False,
    free: o.Free = None,
    prior: o.PriorText = None,
    systematic: o.Systematic = None,
    start: o.Start = None,
    derive: o.Derive = None,
    sigma: o.Sigma = None,
    loss: o.Loss = None,
    noise: o.NoiseModel = None,
    share: Annotated[
        str | None,
        typer.Option(
            help="With several files: coefficients common to all throws. [default: all]",
            metavar="all|NAME,...",
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
    no_sample: Annotated[
        bool, typer.Option("--no-sample", help="Least squares only; no posterior.")
    ] = False,
    effective: Annotated[
        int | None,
        typer.Option(
            help="Effective sample size required for every parameter. [default: 4000]", min=100
        ),
    ] = None,
    max_steps: Annotated[
        int | None, typer.Option(help="Maximum number of sampling steps. [default: 2000]", min=40)
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of the sampling. [default: 0]", min=0, max=2**32 - 1),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results. [default: DATA's name, with the numbers given by --shot "
            "and --stone-index, and -fit]"
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue an earlier run in that folder, finished or interrupted: its "
            "least-squares result is reused (`--start` then has no effect) and its chain is "
            "continued.",
        ),
    ] = False,
    figures: o.FigureFormats = None,
    no_figures: o.NoFigures = False,
    report: o.Report = False,
    quiet: o.Quiet = False,
) -> o.Saved | None:
    """Fit a friction law to a throw, or to several jointly, and show what the path determines.

    Writes `fit.json`, `fit.png` and, unless `--no-sample`, `chain.h5` and `corner.png`; for
    several throws `joint.json`, `joint.png` and a folder for each, without sampling.
    Ctrl-C during sampling keeps the chain so far; `--resume` continues it.

    Example: `curlfit fit data/jensen_shegelski_2004.csv --stone rho=0.1025`
    """
    from curlfit.errors import InputError
    from curlfit.options.figures import FigureFiles, remove_figure
    from curlfit.output.files import prepare_folder

    drawn = FigureFiles.of(figures, none=no_figures)
    if resume and no_sample:
        raise InputError("--resume continues sampling, and --no-sample skips it; give one of them")
    flags = s.fit_flags(
        o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given),
        law=law, load=load, since=since, until=until, exclude=exclude, swept=sweep,
        stone=stone, sigma=sigma, fix=fix, bound=bound, start=start, unbounded=unbounded,
        free=free, prior=prior, loss=loss, noise=noise, seed=seed, derive=derive,
        systematic=s.pairs("--systematic", systematic or ()),
    )  # fmt: skip
    several = len(data) > 1
    if not several and shot is None:
        from curlfit.throws.readers import holds_timed_rows

        several = holds_timed_rows(data[0], format)
    jobs = s.prepare_all(data, config, flags) if several else {}
    if len(jobs) > 1:
        if resume:
            raise InputError("--resume continues the sampling of one throw; give one file")
        for name, value in {"effective": effective, "max-steps": max_steps, "seed": seed}.items():
            if value is not None:
                raise InputError(f"--{name}: several throws are fitted without sampling")
        return _fit_jointly(jobs, share, out, drawn, quiet=quiet, report=report)
    (file,) = data
    if share is not None:
        raise InputError("--share needs several files")
    request = s.request_fit(file, config, flags)
    seed = request.settings.get("seed")
    folder = out or s.result_folder(file, "fit", shot, stone_index)
    saved = None
    if resume:
        saved, seed = _load_saved(folder, seed, request)
    folder = prepare_folder(folder)

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    if resume and saved is None:
        console.print(f"Nothing to resume in {folder}; this is a first run.", soft_wrap=True)
    drawn.draw_beside()
    if saved is None:
        with _status(console, "Fitting (a first run on a machine compiles the model)"):
            if not no_sample:
                from curlfit.inference.mcmc.run import prepare_sampling

                prepare_sampling(*request.problem())
            result = request.fit()
    else:
        result = request.with_derived(saved)
    written = [folder / "fit.json"]
    if not no_sample:
        result = result.before_sampling()
    result.save(folder / "fit.json")
    if saved is None:
        remove_figure(folder, "corner")  # of an earlier fit
        (folder / "chain.h5").unlink(missing_ok=True)
    drawn.replace(folder, ["fit"], partial(_fit_figures, result))
    if not no_sample:
        chain_file = folder / "chain.h5"
        try:
            result, chain = _sample(
                console,
                result,
                seed=seed or 0,
                effective=effective or 4000,
                most_steps=max_steps or 2000,
                checkpoint=chain_file,
                resume=saved is not None,
            )
        except KeyboardInterrupt:
            drawn.written()
            raise
        result.save(folder / "fit.json")
        written.append(chain_file)
        drawn.replace(folder, ["corner"], partial(_corner_figures, result, chain))
    else:
        remove_figure(folder, "corner")
        (folder / "chain.h5").unlink(missing_ok=True)

    from curlfit.inference.report import print_fit

    print_fit(result, console)
    written += drawn.written()
    console.print("Written: " + ", ".join(str(file) for file in written), soft_wrap=True)
    if result.converged:
        _warn_of_posterior(result)
    return _finish(result, o.saved(folder, report=report, quiet=quiet))


def _fit_figures(fit: FitResult) -> dict[str, Figure]:
    return {"fit": curlfit.fit_figure(fit)}


def _corner_figures(fit: FitResult, chain: Chain) -> dict[str, Figure]:
    return {"corner": curlfit.corner_figure(fit, chain)}


def _joint_figures(joint: JointResult) -> dict[str, Figure]:
    return {"joint": curlfit.joint_figure(joint)}


def _load_saved(
    folder: Path, seed: int | None, request: s.FitRequest
) -> tuple[FitResult | None, int | None]:
    """The saved fit in a folder, if any, and the seed, of its chain unless one is given; fit and
    chain must be of the same problem."""
    if not (folder / "fit.json").exists():
        return None, seed
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
        request.cut.condensed(), request.law, request.load, request.stone, request.parameters,
        request.loss, request.noise,
    )  # fmt: skip
    require_same(subject_of_saved(found), now, folder / "fit.json")
    chain = folder / "chain.h5"
    if chain.exists():
        stored = load_chain(chain)
        seed = stored.seed if seed is None else seed
        require_same(stored.subject, subject_of(found, seed), chain)
    return found, seed


def _finish(result: FitResult | JointResult, saved: o.Saved | None) -> o.Saved | None:
    """Report an unusable fit on stderr; its page is written before the exit."""
    if not result.converged:
        say(f"curlfit: the fit is not usable: {result.status}", error=True)
        if saved is None:
            raise typer.Exit(1)
        return saved._replace(status=1)
    return saved


def _warn_of_posterior(result: FitResult) -> None:
    if result.posterior is not None and not result.posterior.converged:
        say(f"curlfit: warning: posterior {result.posterior.status}", error=True)


@contextmanager
def _status(console: Console, text: str) -> Iterator[None]:
    """A status line, on a terminal."""
    if console.is_terminal and not console.quiet:
        with console.status(text):
            yield
    else:
        yield


def _sample(
    console: Console, result: FitResult, *, effective: int, **choices: Any
) -> tuple[FitResult, Chain]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from curlfit.inference.mcmc.sampler import sample

    with Progress(
        TextColumn("Sampling the posterior"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total} effective samples"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
        console=console,
        disable=console.quiet or not console.is_terminal,
        transient=True,
    ) as progress:
        task = progress.add_task("", total=effective, state="compiling")

        def show_state(samples: float, steps: int, r_hat: float) -> None:
            progress.update(
                task, completed=min(samples, effective), state=f"{steps} steps, R-hat {r_hat:.3f}"
            )

        shown = None if progress.disable else show_state  # R-hat takes time
        return sample(result, effective=effective, progress=shown, **choices)


def _fit_jointly(
    named: Mapping[str, s.ConfiguredThrow],
    share: str | None,
    out: Path | None,
    drawn: FigureFiles,
    *,
    quiet: bool,
    report: bool,
) -> o.Saved | None:
    """Fit several throws jointly and print the report; write `joint.json`, figures, single fits."""
    from curlfit.errors import InputError
    from curlfit.friction import check_load, find_law
    from curlfit.inference.conditions import check_systematics
    from curlfit.inference.derived import check_derived
    from curlfit.inference.noise.models import check_loss, check_noise
    from curlfit.inference.parameters import ParameterSet
    from curlfit.output.files import prepare_folder
    from curlfit.throws.plausibility import require_plausible

    jobs = list(named.values())
    settings = jobs[0].settings
    for job in jobs:
        for key in ("law", "load"):
            own_value, first = (one.get(key, "none named") for one in (job.settings, settings))
            if own_value != first:
                raise InputError(
                    f"{job.throw.name}: {key}: {own_value}, where {jobs[0].throw.name} has "
                    f"{first}; give one with --{key}"
                )
    law = find_law(settings.get("law", "front-back"))
    load = check_load(settings.get("load", "uniform"))
    loss = check_loss(settings.get("loss", "linear"))
    noise = check_noise(settings.get("noise", "white"), loss)
    names = "all" if share in (None, "all") else [name.strip() for name in str(share).split(",")]
    own = [item.name for item in law.coefficients()]
    for name in [] if names == "all" else names:
        if name not in own:
            raise InputError(
                f"--share {name}: law {law.name} has no such coefficient; it has {', '.join(own)}"
            )
    derive = settings.get("derive", [])
    check_derived(derive, own)
    systematics = settings.get("systematic", {})
    check_systematics(systematics)
    # Each throw keeps the times of its own sweeping, unless a flag or the configuration gives some.
    any_swept = any("swept" in job.settings for job in jobs)
    choices = s.parameter_choices(settings) | {"swept": any_swept}
    start = settings.get("start", {})
    ParameterSet.build(law, **choices).require("--start", start)
    throws = []
    for job in jobs:
        rows = s.row_choices(job.settings)
        cut = job.throw.select_rows(**rows)
        require_plausible(cut)
        ParameterSet.for_throw(law, cut, **choices)
        own_swept = {"swept": job.settings.get("swept")}
        throws.append(cut.with_defaults(stone=job.stone.as_dict(), **rows, **own_swept))
    folder = prepare_folder(out or Path("joint-fit"))
    drawn.draw_beside()

    from rich.progress import Progress, TextColumn

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    with Progress(
        TextColumn(f"Fitting {len(jobs)} throws (a first run on a machine compiles the model)"),
        TextColumn("{task.fields[state]}"),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    ) as progress:
        task = progress.add_task("", state="")

        def show_step(step: int, chi_squared: float) -> None:
            progress.update(task, state=f"step {step}, chi squared {chi_squared:.6g}")

        from curlfit.inference.joint.fit import fit_together

        result = fit_together(
            throws, law, share=names, load=load, start=start, loss=loss, noise=noise,
            systematics=systematics, progress=show_step,
            **choices | {"swept": None},
        ).with_derived(derive)  # fmt: skip
    written = [folder / "joint.json"]
    result.save(written[0])
    for name, one in zip(named, result.throws, strict=True):
        own_folder = prepare_folder(folder / name)
        one.save(own_folder / "fit.json")
        drawn.replace(own_folder, ["fit"], partial(_fit_figures, one))
    drawn.replace(folder, ["joint"], partial(_joint_figures, result))

    from curlfit.inference.joint.report import print_joint

    print_joint(result, console)
    written += drawn.written()
    folders = list(named)
    if len(folders) > 3:
        folders[1:-1] = ["..."]
    console.print(
        "Written: "
        + ", ".join(map(str, written))
        + f", and in {folder}/ a folder for each throw: "
        + ", ".join(folders),
        soft_wrap=True,
    )
    return _finish(result, o.saved(folder, report=report, quiet=quiet))
