"""`curlfit predict`: prediction of a throw."""

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

    from curlfit.prediction.result import Prediction

_START = "Another throw: its start (by default that of the fitted throw)"
_GOAL = "Another throw: its goal (speed and heading are found)"
_CHECK = "Comparison with measured rows"


def predict(
    fit: Annotated[
        Path,
        typer.Argument(
            help="A saved fit: its folder, or the fit.json in it.",
            metavar="FIT",
            show_default=False,
        ),
    ],
    v0: Annotated[float | None, typer.Option(help="Speed, m/s.", rich_help_panel=_START)] = None,
    omega0: Annotated[
        float | None,
        typer.Option(help="Spin, rad/s, counter-clockwise positive.", rich_help_panel=_START),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            help="Direction, rad, from +y toward +x. [default: 0, along the sheet]",
            rich_help_panel=_START,
        ),
    ] = None,
    x0: Annotated[
        float | None,
        typer.Option(
            help="Position, m right of the centre line. [default: 0]", rich_help_panel=_START
        ),
    ] = None,
    y0: Annotated[
        float | None,
        typer.Option(
            help="Position, m from the hack thrown from. [default: that of --from]",
            rich_help_panel=_START,
        ),
    ] = None,
    phi0: Annotated[
        float | None,
        typer.Option(help="Angle of the stone, rad. [default: 0]", rich_help_panel=_START),
    ] = None,
    line: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Line on which the throw starts: `hack`, `back`, `tee`, `hog` (the near ones), "
            "`centre` or `far-hog`; or `data`: at the start of the data, with y from the hack. "
            "[default: hog; data for the fitted throw where its file states its zero of y]",
            metavar="LINE",
        ),
    ] = None,
    to_tee: Annotated[
        bool, typer.Option("--to-tee", help="Come to rest on the tee.", rich_help_panel=_GOAL)
    ] = False,
    weight: Annotated[
        str | None,
        typer.Option(
            help="`draw`: rests on the tee line; `guard`: rests halfway between hog line and "
            "house, 4.115 m before the tee line; `takeout`: passes the tee line at 1.5 m/s. On the "
            "centre line, or at any x with --heading.",
            metavar="NAME",
            rich_help_panel=_GOAL,
        ),
    ] = None,
    tee_speed: Annotated[
        float | None,
        typer.Option(
            help="Speed of a takeout at the tee line, m/s. [default: 1.5]", rich_help_panel=_GOAL
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            help="Come to rest at this point: m to the right of the tee and m beyond it. Write "
            "--target=-0.5,1 if the first number is negative.",
            metavar="X,Y",
            rich_help_panel=_GOAL,
        ),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            help="The data of the fitted throw; rows after the fitted ones are compared.",
            metavar="DATA",
            rich_help_panel=_CHECK,
        ),
    ] = None,
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: o.StoneIndex = None,
    shot: o.Shot = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    draws: Annotated[int, typer.Option(help="Number of draws from the posterior.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of the draws.", min=0)] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. [default: the fit's name with -predict]"),
    ] = None,
    law: o.LawOfFit = None,
    figures: o.FigureFormats = None,
    no_figures: o.NoFigures = False,
    report: o.Report = False,
    quiet: o.Quiet = False,
) -> o.Saved | None:
    """Predict a throw: path and resting position, with their uncertainties.

    Without options: the fitted throw, extrapolated to rest. With a start or a goal: another throw
    on the same ice, by default from the near hog line with the spin of the fitted one. Bands
    include the errors of the parameters and the model discrepancy.
    Writes `predict.json`, `predict.csv` (the path with its bands) and `predict.png`.

    Examples:

    `curlfit predict throw-fit --v0 2.2 --omega0 -1.5`: the path of another throw

    `curlfit predict throw-fit --to-tee`: how to throw a draw to the button

    `curlfit predict throw-fit --target=-0.6,0.3`: to rest left of the tee and behind it

    `curlfit fit a.csv --until 12`, then `curlfit predict a-fit --check a.csv`: was it right?
    """
    from curlfit.errors import InputError
    from curlfit.output.files import atomic_write, prepare_folder

    drawn = FigureFiles.of(figures, none=no_figures)
    start = {
        name: value
        for name, value in {
            "x0": x0, "y0": y0, "heading": heading, "v0": v0, "phi0": phi0, "omega0": omega0,
        }.items()
        if value is not None
    }  # fmt: skip
    goals = [bool(to_tee), weight is not None, target is not None]
    if sum(goals) > 1:
        raise InputError("--to-tee, --weight and --target: expected one of them")
    point = (0.0, 0.0) if to_tee else None if target is None else _point(target)
    result, chain = s.load_fit_and_chain(fit, law)
    throw = None
    if check is not None:
        from curlfit.throws.readers import load_throw

        options = s.reader_arguments(
            {},
            o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given),
        )
        throw = load_throw(check, **options)

    from curlfit.output.console import terminal

    console = terminal(quiet=quiet)
    drawn.draw_beside()
    with console.status("Simulating the draws (a first run on a machine compiles the model)"):
        from curlfit.prediction.predict import predict as prediction_of

        found = prediction_of(
            result, chain, start=start, line=line, target=point, weight=weight,
            tee_speed=tee_speed, draws=draws, seed=seed, check=throw,
        )  # fmt: skip
    folder = prepare_folder(out or Path(f"{s.name_of(fit)}-predict"))
    written = [folder / "predict.json", folder / "predict.csv"]
    found.save(written[0])
    with atomic_write(written[1]) as temporary:
        temporary.write_text(found.table())
    drawn.replace(folder, ["predict"], partial(_figures, found))

    from curlfit.prediction.report import print_prediction

    print_prediction(found, console)
    written += drawn.written()
    console.print("Written: " + ", ".join(map(str, written)), soft_wrap=True)
    return o.saved(folder, report=report, quiet=quiet)


def _point(text: str) -> tuple[float, float]:
    from curlfit.errors import InputError

    parts = text.split(",")
    if len(parts) != 2:
        raise InputError(f"--target {text}: expected X,Y in m from the tee")
    x, y = (s.number("--target", name, part) for name, part in zip("XY", parts, strict=True))
    return x, y


def _figures(found: Prediction) -> dict[str, Figure]:
    from curlfit.prediction.figures import prediction_figure

    return {"predict": prediction_figure(found)}
