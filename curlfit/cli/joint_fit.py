"""`curlfit fit A B C`: several throws with coefficients in common."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from curlfit.options import settings as s


def fit_several(
    files: Sequence[Path],
    share: str | None,
    config: Path | None,
    flags: Mapping[str, Any],
    out: Path | None,
    *,
    no_figures: bool,
    quiet: bool,
) -> None:
    """Fit the throws together, print the report, write `joint.json`, figures and single fits."""
    from curlfit.errors import InputError
    from curlfit.friction import check_load, find_law
    from curlfit.inference.noise.models import check_noise
    from curlfit.inference.parameters import ParameterSet, check_loss
    from curlfit.output.files import prepare_folder

    if len({file.stem for file in files}) < len(files):
        raise InputError("two of the files have the same name; results are kept by name")
    jobs = [s.prepared(file, config, flags) for file in files]
    wanted = jobs[0].wanted
    for file, job in zip(files, jobs, strict=True):
        for key in ("law", "load"):
            if job.wanted.get(key) != wanted.get(key):
                raise InputError(
                    f"{file}: {key} = {job.wanted.get(key)!r} where {files[0]} has "
                    f"{wanted.get(key)!r}; give one with --{key}"
                )
    law = find_law(wanted.get("law", "front-back"))
    load = check_load(wanted.get("load", "uniform"))
    loss = check_loss(wanted.get("loss", "linear"))
    noise = check_noise(wanted.get("noise", "white"), loss)
    names = "all" if share in (None, "all") else [name.strip() for name in str(share).split(",")]
    own = [item.name for item in law.coefficients()]
    for name in [] if names == "all" else names:
        if name not in own:
            raise InputError(
                f"--share {name}: law {law.name} has no such coefficient; it has {', '.join(own)}"
            )
    choices: dict[str, Any] = {
        "fix": wanted.get("fix"),
        "bounds": wanted.get("bound"),
        "unbounded": bool(wanted.get("unbounded", False)),
    }
    start = wanted.get("start", {})
    ParameterSet.build(law, **choices).require("--start", start)
    throws = []
    for job in jobs:
        cut = job.throw.until(job.wanted.get("until"))
        cut.require_motion()
        ParameterSet.for_throw(law, cut, **choices)
        throws.append(cut.with_defaults(stone=job.stone.as_dict()))
    folder = prepare_folder(out or Path("joint-fit"))

    from rich.progress import Progress, TextColumn

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    with Progress(
        TextColumn(f"Fitting {len(files)} throws (a first run on a machine compiles the model)"),
        TextColumn("{task.fields[more]}"),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    ) as progress:
        task = progress.add_task("", more="")

        def told(step: int, chi_squared: float) -> None:
            progress.update(task, more=f"step {step}, chi squared {chi_squared:.6g}")

        from curlfit.inference.joint.fit import fit_together

        result = fit_together(
            throws, law, share=names, load=load, start=start, loss=loss, noise=noise,
            progress=told, **choices,
        )  # fmt: skip
    written = [folder / "joint.json"]
    result.save(written[0])
    for file, one in zip(files, result.throws, strict=True):
        own_folder = prepare_folder(folder / file.stem)
        one.save(own_folder / "fit.json")
        if not no_figures:
            from curlfit.inference.figures import fit_figure
            from curlfit.output.figures import save_figure

            save_figure(fit_figure(one), own_folder / "fit.png")
    if not no_figures:
        from curlfit.inference.figures import joint_figure
        from curlfit.output.figures import save_figure

        written.append(folder / "joint.png")
        save_figure(joint_figure(result), written[1])

    from curlfit.inference.joint.report import print_joint

    print_joint(result, console)
    console.print(
        "Written: " + ", ".join(map(str, written)) + f", and {folder}/NAME/ for each throw",
        soft_wrap=True,
    )
    if not result.converged:
        print(f"curlfit: the fit is not usable: {result.status}", file=sys.stderr)
        raise typer.Exit(1)
