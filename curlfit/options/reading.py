"""Flags that say how a data file is to be read; `fit`, `compare` and `check` share them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

PANEL = "How to read DATA"

Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="`table`, `tracker` (export of Tracker), `digitalcurling` (log of DigitalCurling 3) "
        "or `timings` (stop-watch). [default: as the file looks]",
        metavar="NAME",
        rich_help_panel=PANEL,
    ),
]
Axes = Annotated[
    str | None,
    typer.Option(
        help="The file's axes, words with commas between: `x-along`, `x-back`, `x-right`, "
        "`x-left` and the same for y say where an axis points, seen along the throw; `from-hack`, "
        "`from-back`, `from-tee`, `from-hog`, `from-centre`, `from-far-hog`, `from-far-tee` where "
        "its zero lies; `clockwise` or `counter-clockwise` how angles turn, seen from above "
        "(else from +x to +y). [default: x-right,y-along]",
        metavar="WORDS",
        rich_help_panel=PANEL,
    ),
]
Units = Annotated[
    str | None,
    typer.Option(
        help="Units over those of the header: t, x, y, length, angle, speed, spin.",
        metavar="t=ms,x=cm,angle=deg",
        rich_help_panel=PANEL,
    ),
]
Reference = Annotated[
    Path | None,
    typer.Option(
        help="Places are pixels: table of four or more known points u,v (pixels), x,y (m).",
        metavar="POINTS.csv",
        rich_help_panel=PANEL,
    ),
]
StoneIndex = Annotated[
    int | None,
    typer.Option(
        help="Which object of a Tracker export or stone of a shot, from 1. [default: the first; "
        "the stone thrown]",
        metavar="N",
        rich_help_panel=PANEL,
    ),
]
Shot = Annotated[
    int | None,
    typer.Option(
        help="Which shot of a log with several, from 1.", metavar="N", rich_help_panel=PANEL
    ),
]


def how(
    format: str | None,
    axes: str | None,
    units: str | None,
    reference: Path | None,
    stone_index: int | None,
    shot: int | None,
) -> dict[str, Any]:
    """The flags by name, as `settings.how_to_read` takes them."""
    return {
        "format": format,
        "axes": axes,
        "units": units,
        "reference": None if reference is None else str(reference),
        "stone_index": stone_index,
        "shot": shot,
    }
