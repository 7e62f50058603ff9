"""`curlfit design`: the expected errors of planned throws."""

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

    from curlfit.optimal_design.result import Design

_FIGURES = ("design-map", "design-errors", "design-separate")
_TRUTH = "Assumed values"
_THROWS = "The throws"
_RECORD = "The record"
_UNMEASURED = "`none`: not measured."


def design(
    law: Annotated[
        str | None,
        typer.Option(
            help="Friction law; `curlfit laws` lists them. [default: front-back]",
            rich_help_panel=_TRUTH,
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A coefficient; the law's default if not set.",
            metavar="N=V",
            rich_help_panel=_TRUTH,
        ),
    ] = None,
    fit: Annotated[
        Path | None,
        typer.Option(
            help="A saved fit, for its law, coefficients, load and stone.",
            metavar="DIR",
            rich_help_panel=_TRUTH,
        ),
    ] = None,
    load: Annotated[
        str | None,
        typer.Option(
            help="`uniform` or `consistent` (eq. 8-9). [default: uniform]", rich_help_panel=_TRUTH
        ),
    ] = None,
    stone: o.StoneValues = None,
    v0: Annotated[
        str | None,
        typer.Option(
            help="Candidate speeds, m/s. [default: 1.6,1.9,2.2]",
            metavar="V,V",
            rich_help_panel=_THROWS,
        ),
    ] = None,
    omega0: Annotated[
        str | None,
        typer.Option(
            help="Candidate spins, rad/s, counter-clockwise positive. "
            "[default: 0.5,1,2,5,10, from a draw to a hard spinner]",
            metavar="V,V",
            rich_help_panel=_THROWS,
        ),
    ] = None,
    throws: Annotated[
        int,
        typer.Option(
            help="Number of throws, chosen optimally among the candidates, with repetition.",
            rich_help_panel=_THROWS,
        ),
    ] = 3,
    rate: Annotated[
        str,
        typer.Option(
            help="Rows per second, Hz; one or more.", metavar="V,V", rich_help_panel=_RECORD
        ),
    ] = "30",
    until: Annotated[
        float | None,
        typer.Option(
            help="Length of the record, s. [default: until the stone is at rest]",
            metavar="S",
            rich_help_panel=_RECORD,
        ),
    ] = None,
    sigma_xy: Annotated[
        str,
        typer.Option(
            help=f"Noise of x and y: 0.005, 5mm, 0.2in. {_UNMEASURED}",
            metavar="V",
            rich_help_panel=_RECORD,
        ),
    ] = "5mm",
    sigma_phi: Annotated[
        str,
        typer.Option(
            help=f"Noise of the angle: 0.01, 10mrad, 0.5deg. {_UNMEASURED}",
            metavar="V",
            rich_help_panel=_RECORD,
        ),
    ] = "10mrad",
    sigma_speed: Annotated[
        str,
        typer.Option(
            help="Noise of a directly measured speed.", metavar="V", rich_help_panel=_RECORD
        ),
    ] = "none",
    sigma_omega: Annotated[
        str,
        typer.Option(
            help="Noise of a directly measured spin.", metavar="V", rich_help_panel=_RECORD
        ),
    ] = "none",
    discrepancy: Annotated[
        float,
        typer.Option(
            help="Size of the accelerations that the law may lack, over the friction, such as "
            "0.05. [default: 0, an exact law]",
            show_default=False,
            rich_help_panel=_RECORD,
        ),
    ] = 0.0,
    separate: Annotated[
        str | None,
        typer.Option(
            help="Two coefficients to be separated. [default: two of which only the sum is "
            "determined under uniform load]",
            metavar="A,B",
        ),
    ] = None,
    relative_error: Annotated[
        float,
        typer.Option(
            help="Required, of their difference, or of their mean where they are equal.",
            metavar="V",
        ),
    ] = 0.2,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("design"),
    figures: o.FigureFormats = None,
    no_figures: o.NoFigures = False,
    report: o.Report = False,
    quiet: o.Quiet = False,
) -> o.Saved | None:
    """Optimal design: the expected errors of a law's coefficients, and the best choice of throws.

    Every combination of speed, spin and rate is a candidate. Each throw has its own unknown initial
    state; the coefficients are common to all. Errors are those of least squares (from the exact
    derivatives of the trajectory), for noise that is independent from row to row. Where only the
    sum of two coefficients is determined, the report gives the precision, the throws or the changes
    of the stone that would separate them.
    Writes `design.json`, `design-map.png`, `design-errors.png` and, where two coefficients are
    separable, `design-separate.png`.

    Examples:

    `curlfit design`: the front-back law, a camera over the ice, throws from draws to hard spinners

    `curlfit design --rate 60 --sigma-xy 2mm --sigma-phi 0.2deg --v0 2.0,2.2 --omega0=-1.5,1.5`

    `curlfit design --load consistent --separate mu1_eta,mu2_eta --stone h=0.1`

    `curlfit design --fit throw-fit --until 12`: for the ice of a fitted throw
    """  # fmt: skip
    from curlfit.errors import InputError
    from curlfit.output.files import prepare_folder

    drawn = FigureFiles.of(figures, none=no_figures)
    kind = s.kind_of(fit) if fit is not None else "fit"
    if kind != "fit":
        raise InputError(f"{fit}: a result of curlfit {kind}; expected the fit of one throw")
    sigma = {
        name: s.with_unit(option, name, text)
        for option, text, names in (
            ("--sigma-xy", sigma_xy, ("x", "y")), ("--sigma-phi", sigma_phi, ("phi",)),
            ("--sigma-speed", sigma_speed, ("speed",)), ("--sigma-omega", sigma_omega, ("omega",)),
        )
        if text.strip().lower() != "none"
        for name in names
    }  # fmt: skip
    grid = {
        name: s.numbers(f"--{name}", text)
        for name, text in (("v0", v0), ("omega0", omega0), ("rate", rate))
        if text is not None
    }
    pair = [name.strip() for name in separate.split(",")] if separate is not None else None
    given = s.pairs("--set", set_ or ())
    body = s.pairs("--stone", stone or ())

    from curlfit.inference.fit.result import load_fit
    from curlfit.stone import Stone

    known = load_fit(fit).with_law(law) if fit is not None else None

    from rich.console import Console

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    drawn.draw_beside()
    errors = Console(stderr=True, quiet=quiet)
    with errors.status("Reading") as status:

        def progress(text: str) -> None:
            status.update(f"Computing {text} (a first run on a machine compiles the model)")

        progress("the information of each throw")
        from curlfit.optimal_design.design import design as compute_design

        result = compute_design(
            known or law or "front-back",
            coefficients=given,
            load=load,
            stone=(known.stone if known else Stone()).with_values(body),
            until=until,
            sigma=sigma,
            discrepancy=discrepancy,
            throws=throws,
            separate=pair,
            relative_error=relative_error,
            progress=progress,
            **grid,
        )
    folder = prepare_folder(out)
    written = [folder / "design.json"]
    result.save(written[0])

    drawn.replace(folder, _FIGURES, partial(_figures, result))

    from curlfit.optimal_design.report import print_design

    print_design(result, console)
    written += drawn.written()
    console.print("Written: " + ", ".join(map(str, written)), soft_wrap=True)
    return o.saved(folder, report=report, quiet=quiet)


def _figures(found: Design) -> dict[str, Figure]:
    from curlfit.optimal_design.figures import design_figures

    return design_figures(found)
