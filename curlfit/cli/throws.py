"""`curlfit check` and `curlfit simulate`: a data file inspected, a synthetic one made."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from curlfit.options import flags as o
from curlfit.options import settings as s


def check(
    data: Annotated[
        Path,
        typer.Argument(help="Data as for `curlfit fit`.", metavar="DATA", show_default=False),
    ],
    format: o.Format = None,
    axes: o.Axes = None,
    units: o.Units = None,
    reference: o.Reference = None,
    stone_index: o.StoneIndex = None,
    shot: o.Shot = None,
    handle: o.Handle = None,
    as_given: o.AsGiven = False,
    since: o.Since = None,
    until: o.Until = None,
    exclude: o.Exclude = None,
    config: o.Config = None,
    out: Annotated[
        Path | None, typer.Option(help="Draw the data to this file.", metavar="CHECK.png")
    ] = None,
) -> None:
    """Show how a data file is read: columns, units, scatter, rest, what is implausible.

    Exit status 0 where the file can be fitted, 2 where it cannot.

    Example: `curlfit check data/jensen_shegelski_2004.csv`
    """
    from curlfit.errors import InputError
    from curlfit.throws.inspection import inspect_throw
    from curlfit.throws.plausibility import examine, require_plausible
    from curlfit.throws.readers import read
    from curlfit.throws.readers.assemble import assemble

    if out is not None:
        if out.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise InputError(f"--out {out}: expected a name that ends in .png, .pdf or .svg")
        if not out.absolute().parent.is_dir():
            raise InputError(f"--out {out}: the folder {out.parent} does not exist")
    flags = o.reader_options(format, axes, units, reference, stone_index, shot, handle, as_given)
    configured = s.check_settings(s.read_config(config), str(config))
    options = s.reader_arguments(configured, flags)
    axes, points = options.pop("axes", None), options.pop("reference", None)
    as_given = options.pop("as_given", False)
    parsed = read(data, **options, pixels=points is not None)
    throw = assemble(parsed, axes=axes, reference=points and Path(points), as_given=as_given)
    flags |= {"since": since, "until": until}
    flags["exclude"] = s.periods("--exclude", exclude or ()) or None
    throw, settings, _ = s.apply_settings(throw, configured, flags)
    cut = throw.select_rows(**s.row_choices(settings))
    cut.require_motion()
    if out is not None and not throw.has_path:
        raise InputError(f"--out: {data} has timed events only, and no path to draw")
    shown = {key: value for key, value in settings.items() if key not in s.READER_OPTIONS}

    from curlfit.output.console import terminal
    from curlfit.throws.report import print_findings, print_inspection

    console = terminal(highlight=False)
    print_inspection(parsed, throw, inspect_throw(throw), shown, console)
    print_findings(examine(cut), console)
    if out is not None:
        from curlfit.output.figures import save_figure
        from curlfit.throws.figures import throw_figure

        save_figure(throw_figure(throw), out, dpi=130)
        console.print(f"Written: {out}", soft_wrap=True)
    require_plausible(cut)


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
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="File to write. [default: print]")] = None,
) -> None:
    """Simulate a throw under a friction law, in the format that `curlfit fit` reads.

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
