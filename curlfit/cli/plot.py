"""`curlfit plot`: draw a saved fit again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from curlfit.options.settings import chain_beside, kind_of


def plot(
    folder: Annotated[Path, typer.Argument(help="Folder of results.", metavar="DIR")],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures. [default: DIR]")] = None,
    format: Annotated[str, typer.Option(help="png, pdf or svg.")] = "png",
) -> None:
    """Draw the figures again of a saved fit, joint fit, comparison, prediction, profile, design."""
    from curlfit.errors import InputError
    from curlfit.inference.fit.result import load_fit
    from curlfit.output.files import prepare_folder

    if format not in ("png", "pdf", "svg"):
        raise InputError(f"--format {format}: expected png, pdf or svg")
    kind = kind_of(folder)
    if kind == "design":
        from curlfit.optimal_design.figures import save_figures
        from curlfit.optimal_design.result import load_design

        own = folder if folder.is_dir() else folder.parent
        design = load_design(folder)
        written = save_figures(design, prepare_folder(out or own), format)
        typer.echo("Written: " + ", ".join(map(str, written)))
        return
    if kind != "fit":
        import curlfit
        from curlfit.output.figures import save_figure

        if kind == "compare":
            figure = curlfit.comparison_figure(curlfit.load_comparison(folder))
        elif kind == "joint":
            figure = curlfit.joint_figure(curlfit.load_joint(folder))
        elif kind == "profile":
            figure = curlfit.profile_figure(curlfit.load_profile(folder))
        else:
            figure = curlfit.prediction_figure(curlfit.load_prediction(folder))
        own = folder if folder.is_dir() else folder.parent
        file = prepare_folder(out or own) / f"{kind}.{format}"
        save_figure(figure, file)
        typer.echo(f"Written: {file}")
        return
    result = load_fit(folder)
    chain = None
    if result.sampling == "unfinished":
        from curlfit.inference.mcmc.sampler import so_far

        result, chain = so_far(result, chain_beside(folder)) or (result, None)
    elif result.posterior is not None:
        from curlfit.inference.mcmc.chain import load_chain

        chain = load_chain(chain_beside(folder))
    target = prepare_folder(out or (folder if folder.is_dir() else folder.parent))

    from curlfit.inference.figures import corner_figure, fit_figure
    from curlfit.output.figures import save_figure

    written = [target / f"fit.{format}"]
    save_figure(fit_figure(result), written[0])
    if chain is not None:
        written.append(target / f"corner.{format}")
        save_figure(corner_figure(result, chain), written[1])
    typer.echo("Written: " + ", ".join(map(str, written)))
