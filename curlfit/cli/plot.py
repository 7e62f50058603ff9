"""`curlfit plot`: draw a saved fit again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from curlfit.cli.settings import chain_beside, kind_of


def plot(
    folder: Annotated[Path, typer.Argument(help="Folder of results.", metavar="DIR")],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures. [default: DIR]")] = None,
    format: Annotated[str, typer.Option(help="png, pdf or svg.")] = "png",
) -> None:
    """Draw the figures of a saved fit, joint fit or comparison, without fitting again."""
    from curlfit.errors import InputError
    from curlfit.files import prepared_folder
    from curlfit.results import load_fit

    if format not in ("png", "pdf", "svg"):
        raise InputError(f"--format {format}: expected png, pdf or svg")
    kind = kind_of(folder)
    if kind != "fit":
        from curlfit.comparison import load_comparison
        from curlfit.figures import comparison_figure, joint_figure, save_figure
        from curlfit.joint import load_joint

        if kind == "compare":
            figure = comparison_figure(load_comparison(folder))
        else:
            figure = joint_figure(load_joint(folder))
        own = folder if folder.is_dir() else folder.parent
        file = prepared_folder(out or own) / f"{kind}.{format}"
        save_figure(figure, file)
        typer.echo(f"Written: {file}")
        return
    result = load_fit(folder)
    chain = None
    if result.sampling == "unfinished":
        from curlfit.sampling import so_far

        result, chain = so_far(result, chain_beside(folder)) or (result, None)
    elif result.posterior is not None:
        from curlfit.chain import load_chain

        chain = load_chain(chain_beside(folder))
    target = prepared_folder(out or (folder if folder.is_dir() else folder.parent))

    from curlfit.figures import corner_figure, fit_figure, save_figure

    written = [target / f"fit.{format}"]
    save_figure(fit_figure(result), written[0])
    if chain is not None:
        written.append(target / f"corner.{format}")
        save_figure(corner_figure(result, chain), written[1])
    typer.echo("Written: " + ", ".join(map(str, written)))
