"""`curlfit check`: what was understood of a data file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from curlfit.options import flags as o
from curlfit.options import reading as r
from curlfit.options import settings as s


def check(
    data: Annotated[
        Path,
        typer.Argument(help="Data as for `curlfit fit`.", metavar="DATA", show_default=False),
    ],
    format: r.Format = None,
    axes: r.Axes = None,
    units: r.Units = None,
    reference: r.Reference = None,
    stone_index: r.StoneIndex = None,
    shot: r.Shot = None,
    config: o.Config = None,
    out: Annotated[
        Path | None, typer.Option(help="Draw the data to this file.", metavar="CHECK.png")
    ] = None,
) -> None:
    """Show what was understood of a data file, and fit nothing.

    Exit status 0 where a fit could begin, 2 where the file cannot be used.

    Example: `curlfit check data/jensen_shegelski_2004.csv`
    """
    from curlfit.errors import InputError
    from curlfit.throws.inspection import inspected
    from curlfit.throws.readers import read
    from curlfit.throws.readers.assemble import assemble

    if out is not None:
        if out.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(f"--out {out}: expected a name that ends in .png, .pdf or .svg")
        if not out.absolute().parent.is_dir():
            raise InputError(f"--out {out}: the folder {out.parent} does not exist")
    flags = r.how(format, axes, units, reference, stone_index, shot)
    configured = s.checked(s.read_config(config), str(config))
    how = s.how_to_read(configured, flags)
    axes, points = how.pop("axes", None), how.pop("reference", None)
    reading = read(data, **how, pixels=points is not None)
    throw = assemble(reading, axes=axes, reference=points and Path(points))
    throw, wanted, _ = s.settled(throw, configured, flags)
    throw.until(wanted.get("until")).require_motion()

    from curlfit.output.console import terminal
    from curlfit.throws.report import print_inspection

    console = terminal(highlight=False)
    settings = {key: value for key, value in wanted.items() if key not in s.HOW}
    print_inspection(reading, throw, inspected(throw), settings, console)
    if out is not None:
        from curlfit.output.figures import save_figure
        from curlfit.throws.figures import throw_figure

        save_figure(throw_figure(throw), out, dpi=130)
        console.print(f"Written: {out}", soft_wrap=True)
