"""`curlfit simulate`: a synthetic throw."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s


def simulate(
    law: Annotated[str, typer.Option(help="Friction law; `curlfit laws` lists them.")] = (
        "front-back"
    ),
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="A coefficient; the law's default if not set.", metavar="N=V"),
    ] = None,
    unbounded: o.Unbounded = False,
    load: Annotated[str, typer.Option(help="`uniform` or `consistent`.")] = "uniform",
    stone: o.StoneValues = None,
    v0: Annotated[float, typer.Option(help="Initial speed, m/s.")] = 2.0,
    omega0: Annotated[float, typer.Option(help="Initial spin, rad/s, counter-clockwise.")] = 1.0,
    heading: Annotated[
        float, typer.Option(help="Initial direction, rad, from +y toward +x.")
    ] = 0.0,
    until: Annotated[float, typer.Option(help="Last time, s.")] = 20.0,
    dt: Annotated[float, typer.Option(help="Time between rows, s.")] = 0.1,
    noise_xy: Annotated[float, typer.Option(help="Standard deviation on x and y, m.")] = 0.0,
    noise_phi: Annotated[float, typer.Option(help="Standard deviation on phi, rad.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Of the noise.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="File to write. [default: print]")] = None,
) -> None:
    """Make a synthetic throw from a friction law, in the form that `curlfit fit` reads.

    Example: `curlfit simulate --set mu2_xi=0.06 --noise-xy 0.005 --noise-phi 0.01 --out a.csv`
    """
    from curlfit.errors import warn_once
    from curlfit.stone import Stone
    from curlfit.throws.synthetic import law_with, synthetic_throw, write_table

    throw = synthetic_throw(
        law_with(law, s.pairs("--set", set_ or ()), unbounded=unbounded),
        Stone().with_values(s.pairs("--stone", stone or ())),
        load=load,
        v0=v0,
        omega0=omega0,
        heading=heading,
        until=until,
        dt=dt,
        noise_xy=noise_xy,
        noise_phi=noise_phi,
        seed=seed,
    )
    for note in throw.notes:
        warn_once(note)
    text = write_table(throw)
    if out is None:
        typer.echo(text, nl=False)
        return
    from curlfit.errors import InputError
    from curlfit.output.files import atomic_write

    if not out.parent.is_dir():
        raise InputError(f"{out}: the folder {out.parent} does not exist")
    with atomic_write(out) as temporary:
        temporary.write_text(text)
    typer.echo(f"Written: {out}")
