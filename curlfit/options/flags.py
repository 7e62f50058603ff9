"""Options that several verbs have, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Law = Annotated[
    str | None,
    typer.Option(help="Friction law; `curlfit laws` lists them. [default: front-back]"),
]
LoadName = Annotated[
    str | None,
    typer.Option(
        help="How the weight rests on the ring: `uniform`, or `consistent` with the friction "
        "(eq. 8-9). [default: uniform]"
    ),
]
Fix = Annotated[
    list[str] | None, typer.Option(help="Hold a parameter at a value.", metavar="NAME=V")
]
Bound = Annotated[
    list[str] | None,
    typer.Option(help="Bounds of a parameter, in place of its own.", metavar="NAME=LO:HI"),
]
Unbounded = Annotated[bool, typer.Option("--unbounded", help="Let coefficients be negative.")]
Start = Annotated[
    list[str] | None,
    typer.Option(help="Start value; found from the data if not given.", metavar="NAME=V"),
]
Until = Annotated[
    float | None, typer.Option(help="Use the rows with t up to this, in s.", metavar="S")
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
        help="How noise goes together from row to row: `white` not at all; `ar1` forgets itself "
        "exponentially, as of a filter or a camera that sways; `gp` is white on top of a smooth "
        "discrepancy, as of a law that is not exact. Estimated from the residuals. "
        "[default: white]",
        metavar="white|ar1|gp",
    ),
]
Config = Annotated[
    Path | None,
    typer.Option(help="TOML file with any settings of `curlfit fit`; flags override it."),
]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="Draw nothing.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
