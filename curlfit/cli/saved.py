"""`curlfit show`, `plot` and `report`: print or draw a saved result, or write its page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

import curlfit
from curlfit.options import flags as o
from curlfit.options.figures import FigureFiles, write_figures
from curlfit.options.settings import chain_beside, kind_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.mcmc.chain import Chain


class _Kind(NamedTuple):
    """Public names of what loads, prints and draws a result."""

    load: str
    print: str
    draw: str


_KINDS = {
    "joint": _Kind("load_joint", "print_joint", "joint_figure"),
    "compare": _Kind("load_comparison", "print_comparison", "comparison_figure"),
    "predict": _Kind("load_prediction", "print_prediction", "prediction_figure"),
    "profile": _Kind("load_profile", "print_profile", "profile_figure"),
    "design": _Kind("load_design", "print_design", "design_figures"),
    "fit": _Kind("load_fit", "print_fit", "fit_figure"),
}


def show(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of results, or the JSON file in it.", metavar="DIR"),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the JSON record.")] = False,
    derive: o.Derive = None,
) -> None:
    """Print the report of a saved fit, joint fit, comparison, prediction, profile or design.

    Example: `curlfit show throw-fit --derive "mu2_xi - mu1_xi"`
    """
    from curlfit.errors import InputError
    from curlfit.output.console import terminal

    kind = kind_of(folder)
    names = _KINDS[kind]
    result: Any
    if kind == "fit":
        result, chain = _load_fit(folder)
        if derive and chain is None and result.posterior is not None:
            file = chain_beside(folder)
            chain = curlfit.load_chain(file) if file.is_file() else None
        result = result.with_derived(derive, chain) if derive else result
    else:
        if derive and kind != "joint":
            raise InputError(f"--derive: {folder} is no fit; expected the folder of a fit")
        result = getattr(curlfit, names.load)(folder)
        result = result.with_derived(derive) if derive else result
    if as_json:
        print(json.dumps(result.summary(), indent=1))
    else:
        getattr(curlfit, names.print)(result, terminal())


def plot(
    folder: Annotated[Path, typer.Argument(help="Folder of results.", metavar="DIR")],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures. [default: DIR]")] = None,
    format: Annotated[
        str,
        typer.Option(help="`png`, `pdf` or `svg`; several separated by commas.", metavar="FORMAT"),
    ] = "png",
) -> None:
    """Draw the figures again of a saved fit, joint fit, comparison, prediction, profile, design."""
    from curlfit.output.files import prepare_folder

    formats = FigureFiles.of(format, "--format").formats
    kind = kind_of(folder)
    target = out or (folder if folder.is_dir() else folder.parent)
    figures: dict[str, Figure] = {}
    if kind == "fit":
        result, chain = _load_fit(folder)
        if chain is None and result.posterior is not None:
            chain = curlfit.load_chain(chain_beside(folder))
        figures["fit"] = curlfit.fit_figure(result)
        if chain is not None:
            figures["corner"] = curlfit.corner_figure(result, chain)
    else:
        names = _KINDS[kind]
        drawn = getattr(curlfit, names.draw)(getattr(curlfit, names.load)(folder))
        figures |= drawn if kind == "design" else {kind: drawn}
    written = write_figures(prepare_folder(target), figures, formats)
    typer.echo("Written: " + ", ".join(map(str, written)))


def report(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of results, or the JSON file in it.", metavar="DIR"),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The file. [default: DIR/report.html]", metavar="FILE.html"),
    ] = None,
    show_it: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
) -> None:
    """Write a saved result as one HTML file to send: numbers, figures, warnings, animations.

    Of a fit, joint fit, comparison, prediction, profile or design. The file needs no network and no
    other file; animated are the stone on the sheet, the directions that the path does not
    determine, and the draws of a prediction.

    Example: `curlfit report throw-fit --open`
    """
    file = write_page(folder, out)
    typer.echo(f"Written: {file}")
    if show_it:
        import webbrowser

        webbrowser.open(file.resolve().as_uri())


def write_page(folder: Path, out: Path | None = None) -> Path:
    """Write the page of a saved result; returns the file."""
    kind = kind_of(folder)
    result: Any
    chain = None
    if kind == "fit":
        result, chain = _load_fit(folder)
        if chain is None and result.posterior is not None and chain_beside(folder).is_file():
            chain = curlfit.load_chain(chain_beside(folder))
    else:
        result = getattr(curlfit, _KINDS[kind].load)(folder)
    file = out or (folder if folder.is_dir() else folder.parent) / "report.html"
    curlfit.write_report(result, file, chain=chain)
    return file


def _load_fit(folder: Path) -> tuple[FitResult, Chain | None]:
    """A saved fit, with the chain so far if its sampling was interrupted."""
    result = curlfit.load_fit(folder)
    if result.sampling == "unfinished":
        from curlfit.inference.mcmc.summary import unfinished_posterior

        return unfinished_posterior(result, chain_beside(folder)) or (result, None)
    return result, None
