"""Flags shared by several verbs: those of a fit and those of reading the data file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand

from curlfit.errors import InputError
from curlfit.foreign import SIZES, cut, is_size


class Verb(TyperCommand):
    """A verb; numbers that no throw has are refused before it runs."""

    def invoke(self, ctx: Any) -> Any:
        """Run it. Raises `InputError` for such a number."""
        for option in self.params:
            value = ctx.params.get(option.name or "")
            if isinstance(value, int | float) and not is_size(value):
                raise InputError(f"{option.opts[0]} {cut(str(value))}: expected a number, {SIZES}")
        return super().invoke(ctx)


class Saved(NamedTuple):
    """What remains to be done after a verb: the page of its saved result."""

    folder: Path
    quiet: bool = False
    status: int = 0
    """exit status of the command"""


def saved(folder: Path, *, report: bool, quiet: bool) -> Saved | None:
    """What remains to be done if a page is wanted; otherwise an earlier page is removed."""
    if report:
        return Saved(folder, quiet)
    (folder / "report.html").unlink(missing_ok=True)
    return None


Law = Annotated[
    str | None,
    typer.Option(
        help="Friction law; `curlfit laws` lists them. [default: front-back; coulomb for "
        "stopwatch times]"
    ),
]
LoadName = Annotated[
    str | None,
    typer.Option(
        help="Distribution of the load on the ring: `uniform`, or `consistent` with the friction "
        "(eq. 8-9). [default: uniform]"
    ),
]
Fix = Annotated[
    list[str] | None, typer.Option(help="Fix a parameter at a value.", metavar="NAME=V")
]
Bound = Annotated[
    list[str] | None,
    typer.Option(help="Bounds of a parameter, in place of the default ones.", metavar="NAME=LO:HI"),
]
Unbounded = Annotated[bool, typer.Option("--unbounded", help="Allow negative coefficients.")]
Free = Annotated[
    list[str] | None,
    typer.Option(
        help="Estimate what is otherwise held fixed: `slope_x`, `slope_y` (downward slope of the "
        "ice, m/m), `drag` (of the air), `R`, `rho`, `h` (of the stone), `length_scale`, "
        "`time_scale` (ratio of measured to true), or an optional coefficient of the law.",
        metavar="NAME,...",
    ),
]
PriorText = Annotated[
    list[str] | None,
    typer.Option(
        "--prior",
        help="Prior of a parameter, which is then estimated: `rho=0.1+-0.0025`, "
        "`mu2_xi=lognormal:0.05,0.3` (median, sigma of the logarithm), `drag=half-normal:0.8`, "
        "`h=uniform:0.05,0.065`.",
        metavar="NAME=PRIOR",
    ),
]
Systematic = Annotated[
    list[str] | None,
    typer.Option(
        help="Standard uncertainty of a condition that is held fixed, for the systematic errors: "
        "`slope_x=2e-4`; 0 if it is known exactly, `all=0` for no systematic errors, "
        "`calibration=0` for none of the map from pixels to metres. `curlfit laws --conditions` "
        "lists the defaults.",
        metavar="NAME=V",
    ),
]
Derive = Annotated[
    list[str] | None,
    typer.Option(
        help="A quantity derived from the parameters, with its errors: `mu2_xi - mu1_xi`, "
        "`R*omega0/v0`, `sqrt(mu1_eta + mu2_eta)`; arithmetic of parameters, of "
        "R, rho, h, m, g, pi, and sqrt, exp, log, sin, cos, tan, atan, abs, hypot, min, max.",
        metavar="EXPRESSION",
    ),
]
Start = Annotated[
    list[str] | None,
    typer.Option(help="Initial value; derived from the data if not given.", metavar="NAME=V"),
]
Since = Annotated[
    float | None, typer.Option(help="Use only rows from this time on, in s.", metavar="S")
]
Until = Annotated[
    float | None, typer.Option(help="Use only rows up to this time, in s.", metavar="S")
]
Swept = Annotated[
    str | None,
    typer.Option(
        "--sweep",
        help="The stone was swept between the times A and B, in s; the parameter `sweep` is the "
        "ratio of the friction during sweeping to that otherwise.",
        metavar="A:B",
    ),
]
Exclude = Annotated[
    list[str] | None,
    typer.Option(help="Leave out the rows between the times A and B, in s.", metavar="A:B"),
]
Sigma = Annotated[
    list[str] | None,
    typer.Option(
        help="Noise of a channel: x=0.005,y=0.005,phi=0.01 (m, m, rad); estimated if not given.",
        metavar="NAME=V",
    ),
]
StoneValues = Annotated[
    list[str] | None,
    typer.Option(
        help="The stone: ring radius R, radius of gyration rho, height h of the centre of mass "
        "(m), mass m (kg).",
        metavar="R=V,rho=V",
    ),
]
Loss = Annotated[
    str | None,
    typer.Option(
        help="`linear` is least squares; `huber`, `soft-l1`, `cauchy`, `student` are robust to "
        "outliers. [default: linear]"
    ),
]
NoiseModel = Annotated[
    str | None,
    typer.Option(
        help="Correlation of the noise from row to row: `white` has none; `ar1` has an exponential "
        "autocorrelation, as from a filter or a swaying camera; `discrepancy` is white noise plus "
        "accelerations that an inexact law lacks, as functions of speed; `ar1+discrepancy` is "
        "both. Estimated from the residuals. [default: white]",
        metavar="white|ar1|discrepancy|ar1+discrepancy",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(help="TOML file with any settings of `curlfit fit`; flags override it."),
]
FigureFormats = Annotated[
    str | None,
    typer.Option(
        "--figures",
        help="Format of the figures, `png`, `pdf` or `svg`; several separated by commas. "
        "[default: png]",
        metavar="FORMAT",
    ),
]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="Draw no figures.")]
Report = Annotated[
    bool,
    typer.Option(
        "--report",
        help="Also write `report.html`, the result as one self-contained page, as `curlfit report` "
        "does.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]

PANEL = "How to read DATA"

Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="`table`, `tracker` (export of Tracker), `digitalcurling` (log of DigitalCurling 3) "
        "or `timings` (stopwatch). [default: detected from the file]",
        metavar="NAME",
        rich_help_panel=PANEL,
    ),
]
Axes = Annotated[
    str | None,
    typer.Option(
        help="The file's axes, words separated by commas: `x-along`, `x-back`, `x-right`, "
        "`x-left` and the same for y say where an axis points, seen along the throw; `from-hack`, "
        "`from-back`, `from-tee`, `from-hog`, `from-centre`, `from-far-hog`, `from-far-tee` where "
        "its zero lies; `clockwise` or `counter-clockwise` how angles count, seen from above "
        "(else from +x to +y). [default: x-right,y-along]",
        metavar="WORDS",
        rich_help_panel=PANEL,
    ),
]
Units = Annotated[
    str | None,
    typer.Option(
        help="Units in place of those of the header: t, x, y, length, angle, speed, spin.",
        metavar="t=ms,x=cm,angle=deg",
        rich_help_panel=PANEL,
    ),
]
Reference = Annotated[
    Path | None,
    typer.Option(
        help="Positions are in pixels: table of four or more known points u,v (pixels), x,y (m).",
        metavar="POINTS.csv",
        rich_help_panel=PANEL,
    ),
]
StoneIndex = Annotated[
    int | None,
    typer.Option(
        help="Object of a Tracker export, stone of a shot or throw of a table, from 1. [default: "
        "the first object; the stone thrown]",
        metavar="N",
        rich_help_panel=PANEL,
    ),
]
Shot = Annotated[
    int | None,
    typer.Option(help="Shot of a log with several, from 1.", metavar="N", rich_help_panel=PANEL),
]
Handle = Annotated[
    int | None,
    typer.Option(
        help="Object of a Tracker export, from 1, that marks the handle or any other point of the "
        "same stone: its direction from the stone is the angle.",
        metavar="N",
        rich_help_panel=PANEL,
    ),
]
AsGiven = Annotated[
    bool,
    typer.Option(
        "--as-given",
        help="Accept data that are implausible for a curling stone, with a warning.",
        rich_help_panel=PANEL,
    ),
]


def reader_options(
    format: str | None,
    axes: str | None,
    units: str | None,
    reference: Path | None,
    stone_index: int | None,
    shot: int | None,
    handle: int | None,
    as_given: bool,
) -> dict[str, Any]:
    """The flags of the readers by name, as settings."""
    return {
        "format": format,
        "axes": axes,
        "units": units,
        "reference": None if reference is None else str(reference),
        "stone_index": stone_index,
        "shot": shot,
        "handle": handle,
        "as_given": as_given or None,
    }
